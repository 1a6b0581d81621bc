//! The verdict on a run, in sentences.

use evolvent_analysis::Limiting;
use evolvent_path::AxisLetter;

use crate::opened::Opened;
use crate::report::gather::Gathered;

/// Severity of a sentence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Gravity {
    Good,
    Note,
    Bad,
}

/// A sentence of the verdict.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub(crate) struct Sentence {
    pub(crate) gravity: Gravity,
    pub(crate) text: String,
}

/// The sentences about a run, most severe first.
pub(crate) fn verdict(opened: &Opened, g: &Gathered) -> Vec<Sentence> {
    let mut list = Vec::new();
    let mut say = |gravity, text: String| list.push(Sentence { gravity, text });
    let duration_s = g.counts.span() as f64 * opened.period_s();
    let what = format!("{} on {}", opened.run.program_name, opened.run.machine_name);
    let took = format!("{} and {:.1} mm of path", time(duration_s), g.path_mm);
    outcome(opened, &what, &took, &mut say);
    failures(opened, g, &mut say);
    limits(opened, g, &mut say);
    punctuality(opened, g, &mut say);
    completeness(opened, g, &mut say);
    if g.counts.starved > 0 {
        say(
            Gravity::Note,
            format!(
                "The planner was too slow for {} cycles: the machine was slower there than it could be.",
                g.counts.starved
            ),
        );
    }
    where_time_went(g, g.counts.cycles as f64 * opened.period_s(), &mut say);
    if g.programs > 1 {
        say(
            Gravity::Note,
            format!(
                "{} programs and blocks of MDI were run: `job` below shows one of them.",
                g.programs
            ),
        );
    }
    if !g.has_errors {
        say(
            Gravity::Note,
            "No following error was recorded: no bridge sent feedback.".to_owned(),
        );
    }
    list.sort_by_key(|sentence| std::cmp::Reverse(sentence.gravity == Gravity::Bad));
    // The first sentence describes the run, even if others are more severe.
    if let Some(at) = list.iter().position(|sentence| sentence.text.starts_with(&what)) {
        let first = list.remove(at);
        list.insert(0, first);
    }
    list
}

/// How the run ended.
fn outcome(opened: &Opened, what: &str, took: &str, say: &mut impl FnMut(Gravity, String)) {
    let summary = &opened.trace.info().summary;
    let outcome = summary.get("outcome").map_or("", String::as_str);
    match outcome {
        "done" => say(Gravity::Good, format!("{what} ran to its end: {took}.")),
        "" => say(
            Gravity::Bad,
            format!("{what} was recorded for {took}; how the run ended is not in the trace."),
        ),
        "served" => {
            let jobs = summary.get("jobs").map_or("0", String::as_str);
            let name = &opened.run.machine_name;
            say(
                Gravity::Good,
                format!("{what}: {name} was served for {took}, {jobs} jobs."),
            );
        }
        "stopped" => say(Gravity::Note, format!("{what} was stopped after {took}.")),
        other => say(
            Gravity::Bad,
            format!("{what} ended early ({other}) after {took}."),
        ),
    }
}

/// Errors, alarms and emergency stops.
fn failures(opened: &Opened, g: &Gathered, say: &mut impl FnMut(Gravity, String)) {
    let period_s = opened.period_s();
    if let Some(error) = opened.trace.info().summary.get("error") {
        say(Gravity::Bad, error.clone());
    }
    for alarm in g.timeline.alarms.iter().take(5) {
        say(
            Gravity::Bad,
            format!(
                "Alarm {} at {:.3} s: {}.",
                alarm.code,
                alarm.sequence as f64 * period_s,
                alarm.text.trim_end_matches('.')
            ),
        );
    }
    if let Some(first) = g.timeline.emergency_stops.first() {
        let times = match g.timeline.emergency_stops.len() {
            1 => "once".to_owned(),
            count => format!("{count} times"),
        };
        let at = *first as f64 * period_s;
        say(
            Gravity::Note,
            format!("Emergency stop was pressed {times}, first at {at:.3} s."),
        );
    }
}

/// Whether setpoints were in time.
fn punctuality(opened: &Opened, g: &Gathered, say: &mut impl FnMut(Gravity, String)) {
    if g.counts.late > 0 {
        say(
            Gravity::Bad,
            format!(
                "{} of {} setpoints were published after their due time; the latest wake-up was {:.1} us \
                 late.",
                g.counts.late,
                g.counts.cycles,
                g.lateness.max_ns as f64 * 1e-3
            ),
        );
    } else if opened.run.clock == "realtime" {
        say(
            Gravity::Good,
            format!(
                "No setpoint was late; the latest wake-up was {:.1} us late.",
                g.lateness.max_ns as f64 * 1e-3
            ),
        );
    }
}

/// Whether the trace is complete.
fn completeness(opened: &Opened, g: &Gathered, say: &mut impl FnMut(Gravity, String)) {
    let recovery = &opened.trace.info().recovery;
    if g.counts.missing > 0 {
        say(
            Gravity::Bad,
            format!(
                "{} cycles are missing in {} gaps: the plots are blank there.",
                g.counts.missing,
                g.counts.gaps.len()
            ),
        );
    } else if g.counts.cycles > 0 {
        say(
            Gravity::Good,
            format!("All {} cycles were recorded, without a gap.", g.counts.cycles),
        );
    }
    if let Some(failure) = recovery.get("failure") {
        say(Gravity::Bad, format!("Recording failed: {failure}."));
    } else if let Some(dropped) = recovery.get("bytes_dropped") {
        let damage = match opened.trace.info().damaged_places() {
            0 => "truncated".to_owned(),
            1 => "damaged in one place".to_owned(),
            places => format!("damaged in {places} places"),
        };
        say(
            Gravity::Note,
            format!("The file was {damage} and has been recovered; {dropped} bytes could not be used."),
        );
    }
}

fn limits(opened: &Opened, g: &Gathered, say: &mut impl FnMut(Gravity, String)) {
    if let Some((sequence, line, text)) = g.check.first_broken() {
        say(
            Gravity::Bad,
            format!(
                "{} samples exceeded a limit. The first: {text}, cycle {sequence}, line {line}.",
                g.check.broken()
            ),
        );
        return;
    }
    let mut worst = (0.0, String::new());
    for axis in &opened.run.axes {
        for (order, found) in g.check.worst(axis.index()).iter().enumerate() {
            if found.ratio > worst.0 {
                let quantity = ["velocity", "acceleration", "jerk"][order];
                worst = (
                    found.ratio,
                    format!("{quantity} of {} in line {}", axis.letter(), found.line),
                );
            }
        }
    }
    say(
        Gravity::Good,
        format!(
            "Every axis was within its travel, velocity, acceleration and jerk, by differences of the \
             recorded positions; the closest was {:.1} % of a limit ({}).",
            100.0 * worst.0,
            if worst.1.is_empty() {
                "nothing moved"
            } else {
                &worst.1
            }
        ),
    );
}

/// Which limits were active for which part of the recorded time.
fn where_time_went(g: &Gathered, duration_s: f64, say: &mut impl FnMut(Gravity, String)) {
    if duration_s <= 0.0 {
        return;
    }
    let mut parts: Vec<(Limiting, f64)> = g
        .times
        .by_limit()
        .iter()
        .map(|(limit, time)| (*limit, *time))
        .collect();
    parts.sort_by(|a, b| b.1.total_cmp(&a.1));
    let words: Vec<String> = parts
        .iter()
        .take(5)
        .filter(|(_, time)| *time > 0.005 * duration_s)
        .map(|(limit, time)| format!("{} {:.0} %", limit.name(), 100.0 * time / duration_s))
        .collect();
    if !words.is_empty() {
        say(
            Gravity::Note,
            format!("Limiting factors: {} of the time.", words.join(", ")),
        );
    }
    let held: f64 = g.times.lines().values().map(|line| line.held_s).sum();
    if held > 0.0 {
        say(Gravity::Note, format!("The feed was held for {}.", time(held)));
    }
    let overrides: Vec<f64> = g.timeline.overrides.iter().map(|span| span.value).collect();
    if overrides.iter().any(|value| (value - 1.0).abs() > 1e-9) {
        let min = overrides.iter().copied().fold(f64::INFINITY, f64::min);
        let max = overrides.iter().copied().fold(0.0, f64::max);
        say(
            Gravity::Note,
            format!(
                "The feed override was {:.0} to {:.0} %.",
                100.0 * min,
                100.0 * max
            ),
        );
    }
}

/// A duration as text.
pub(crate) fn time(seconds: f64) -> String {
    if seconds < 120.0 {
        format!("{seconds:.3} s")
    } else {
        let whole = seconds as u64;
        format!("{}:{:02}:{:02} h", whole / 3600, whole / 60 % 60, whole % 60)
    }
}

/// The axis letters that a run drove.
pub(crate) fn letters(axes: &[AxisLetter]) -> String {
    axes.iter().map(|axis| axis.letter()).collect()
}
