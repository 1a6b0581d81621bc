//! The data of the page's script, as JSON.

use base64::Engine as _;
use base64::prelude::BASE64_STANDARD;
use evolvent_runtime::{JobStart, Switched};
use evolvent_trace::{EventKind, EventRecord};
use serde_json::{Value, json};
use time::OffsetDateTime;

use crate::lines::LineTime;
use crate::opened::Opened;
use crate::report::gather::{Gathered, JobPart, LogBars, Span};
use crate::report::verdict::{letters, time};

/// Maximum number of lines in a table.
const MAX_ROWS: usize = 40;
/// Approximate number of rows of all jobs of a session together.
const ALL_ROWS: usize = 2000;
/// A program of at most this length is shown completely; of a longer one, the surroundings of the lines in
/// the tables.
const WHOLE_LINES: usize = 3000;
const SURROUNDINGS: usize = 4;
/// Maximum number of texts of lines for a viewer.
const MAX_TEXTS: usize = 50_000;
/// Longer lines are truncated in the page.
const LINE_CHARACTERS: usize = 200;

/// Escapes arbitrary text for HTML.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Bytes in base64 (RFC 4648, section 4).
pub(crate) fn base64(bytes: &[u8]) -> String {
    BASE64_STANDARD.encode(bytes)
}

/// Rows of the table of the run.
pub(crate) fn run_rows(opened: &Opened, g: &Gathered) -> String {
    let run = &opened.run;
    let info = opened.trace.info();
    let rate_hz = 1e9 / run.period_ns.max(1) as f64;
    let mut rows = vec![
        ("trace", info.path.display().to_string()),
        ("program", run.program_name.clone()),
        (
            "machine",
            format!("{}, axes {}", run.machine_name, letters(&run.axes)),
        ),
        ("started", utc(run.start_time_ns)),
        ("duration", time(g.counts.span() as f64 * opened.period_s())),
        ("period", format!("{} ns, {rate_hz:.2} Hz", run.period_ns)),
        ("clock", run.clock.clone()),
        ("real time", run.real_time.clone()),
        ("configuration", run.configuration_hash.clone()),
    ];
    for (name, version) in &run.versions {
        rows.push(("version", format!("{name} {version}")));
    }
    for key in ["planner", "feed_override", "start_line", "platform"] {
        if let Some(value) = run.extra.get(key) {
            rows.push((key, value.clone()));
        }
    }
    if let Some(notes) = info.summary.get("notes") {
        rows.push(("notes", notes.clone()));
    }
    rows.iter()
        .map(|(name, value)| format!("<tr><th>{name}</th><td>{}</td></tr>\n", escaped(value)))
        .collect()
}

/// Unix time as a date.
fn utc(time_ns: u64) -> String {
    let Ok(at) = OffsetDateTime::from_unix_timestamp_nanos(i128::from(time_ns)) else {
        return format!("{time_ns} ns after 1970");
    };
    format!(
        "{:04}-{:02}-{:02} {:02}:{:02}:{:02} UTC",
        at.year(),
        u8::from(at.month()),
        at.day(),
        at.hour(),
        at.minute(),
        at.second()
    )
}

/// Lines of all jobs with the largest values of a measure: those of the whole run, and for each job those in
/// its own table.
fn top(g: &Gathered, measure: impl Fn(&LineTime) -> f64) -> Vec<(&JobPart, u32, &LineTime)> {
    let per_job = (ALL_ROWS / g.jobs.len().max(1)).clamp(1, MAX_ROWS);
    let mut list: Vec<_> = g
        .jobs
        .iter()
        .flat_map(|job| {
            let lines = job.times.top(MAX_ROWS, &measure);
            lines
                .into_iter()
                .enumerate()
                .map(move |(rank, (line, time))| (rank, job, line, time))
        })
        .collect();
    list.sort_by(|a, b| measure(b.3).total_cmp(&measure(a.3)));
    let mut at = 0;
    list.retain(|(rank, ..)| {
        at += 1;
        at <= MAX_ROWS || *rank < per_job
    });
    list.into_iter()
        .map(|(_, job, line, time)| (job, line, time))
        .collect()
}

fn row(job: &JobPart, line: u32, time: &LineTime) -> Value {
    let limits: Vec<String> = {
        let mut list: Vec<_> = time.by_limit.iter().collect();
        list.sort_by(|a, b| b.1.total_cmp(a.1));
        list.iter()
            .take(3)
            // A value that rounds to zero is omitted.
            .filter(|(_, seconds)| **seconds >= 0.005 * time.time_s)
            .map(|(limit, seconds)| format!("{} {:.0} %", limit.name(), 100.0 * **seconds / time.time_s))
            .collect()
    };
    json!({
        "job": job.number,
        "line": line,
        "text": job.texts.get(&line).map(|text| cut(text)),
        "time": time.time_s,
        "planned": job.planned.get(&line),
        "limited": time.limited_s,
        "held": time.held_s,
        "path": time.path_mm,
        "mean": time.mean_feed_mm_s(),
        "max": time.max_feed_mm_s,
        "limits": limits.join(", "),
        "start": time.start_sequence,
    })
}

fn bars(bars: &LogBars) -> Value {
    let list: Vec<_> = bars.bars.iter().collect();
    json!({ "none": bars.none, "bars": list, "total": bars.total, "max_ns": bars.max_ns })
}

fn spans(list: &[Span]) -> Value {
    list.iter()
        .map(|span| json!([span.start, span.value]))
        .collect::<Vec<_>>()
        .into()
}

/// The data, safe within a script element.
pub(crate) fn json(opened: &Opened, g: &Gathered) -> String {
    // So that no content can end the script element.
    value(opened, g).to_string().replace('<', "\\u003c")
}

/// Adds the cycles at which each line was driven, and the texts of these lines.
pub(crate) fn link_lines(value: &mut Value, opened: &Opened, g: &Gathered) {
    let runs = g.line_runs.list();
    let starts: Vec<u8> = runs
        .iter()
        .flat_map(|(start, _)| (*start as f64).to_le_bytes())
        .collect();
    let lines: Vec<u8> = runs.iter().flat_map(|(_, line)| line.to_le_bytes()).collect();
    value["line_runs"] = json!({ "start": base64(&starts), "line": base64(&lines) });
    let program = opened.program_lines();
    let mut left = MAX_TEXTS;
    let texts: serde_json::Map<String, Value> = g
        .jobs
        .iter()
        .map(|job| {
            let texts: serde_json::Map<String, Value> = job
                .times
                .lines()
                .keys()
                .filter_map(|line| {
                    let own = job.texts.get(line).map(String::as_str);
                    let text =
                        own.or_else(|| program.get((*line as usize).checked_sub(1)?).map(String::as_str))?;
                    left = left.checked_sub(1)?;
                    Some((line.to_string(), cut(text).into()))
                })
                .collect();
            (job.number.to_string(), texts.into())
        })
        .collect();
    value["texts"] = texts.into();
}

pub(crate) fn value(opened: &Opened, g: &Gathered) -> Value {
    let slowest = top(g, |time| time.time_s);
    let limited = top(g, |time| time.limited_s);
    let shown: Vec<u32> = slowest.iter().chain(&limited).map(|(_, line, _)| *line).collect();
    let rows = |list: &[(&JobPart, u32, &LineTime)]| -> Vec<Value> {
        list.iter()
            .map(|(job, line, time)| row(job, *line, time))
            .collect()
    };
    let rapids: Vec<u8> = g.trail.iter().map(|spot| u8::from(spot.is_rapid)).collect();
    let jobs: Vec<Value> = g
        .jobs
        .iter()
        .filter(|job| job.number > 0)
        .map(|job| json!([job.number, job.name, job.start, job.end]))
        .collect();
    let series: Vec<Value> = g
        .series
        .iter()
        .map(|series| {
            let bytes: Vec<u8> = series
                .level
                .values
                .iter()
                .flat_map(|value| value.to_le_bytes())
                .collect();
            json!({
                "group": series.group,
                "label": series.label,
                "unit": series.unit,
                "axis": series.axis,
                "limit": series.limit.filter(|limit| limit.is_finite()),
                "width": series.level.width,
                "offset": series.level.offset,
                "scale": series.level.scale,
                "least": series.level.least,
                "greatest": series.level.greatest,
                "values": base64(&bytes),
            })
        })
        .collect();
    let floats = |get: &dyn Fn(&crate::report::trail::Spot) -> f64| {
        let bytes: Vec<u8> = g
            .trail
            .iter()
            .flat_map(|spot| (get(spot) as f32).to_le_bytes())
            .collect();
        base64(&bytes)
    };
    let sequences: Vec<u8> = g
        .trail
        .iter()
        .flat_map(|spot| (spot.sequence as f64).to_le_bytes())
        .collect();
    let events: Vec<Value> = g
        .timeline
        .events
        .iter()
        .map(|event| json!([event.sequence, event.kind as u8, event.code, said(event)]))
        .collect();
    json!({
        "period_s": opened.period_s(),
        "first": g.counts.first_sequence,
        "last": g.counts.last_sequence,
        "cycles": g.counts.cycles,
        "axes": letters(&opened.run.axes),
        "series": series,
        "states": spans(&g.timeline.states),
        "overrides": spans(&g.timeline.overrides),
        "spans_cut": g.timeline.spans_cut,
        "events": events,
        "events_left_out": g.timeline.events_left_out,
        "gaps": g.counts.gaps,
        "trail": {
            "x": floats(&|spot| spot.position[0]),
            "y": floats(&|spot| spot.position[1]),
            "z": floats(&|spot| spot.position[2]),
            "feed": floats(&|spot| spot.feed_mm_s),
            "error": if g.has_errors { Value::from(floats(&|spot| spot.error)) } else { Value::Null },
            "sequence": base64(&sequences),
            "rapid": base64(&rapids),
        },
        "fastest_cut": g.fastest_cut_mm_s,
        "jobs": jobs,
        "max_error": g.max_error,
        "lateness": bars(&g.lateness),
        "work": bars(&g.work),
        "realtime": opened.run.clock == "realtime",
        "slowest": rows(&slowest),
        "limited": rows(&limited),
        "program": program(opened, &shown),
    })
}

/// Lines of the program with their numbers.
fn program(opened: &Opened, shown: &[u32]) -> Value {
    let lines = opened.program_lines();
    let is_whole = lines.len() <= WHOLE_LINES;
    let mut wanted = vec![is_whole; lines.len()];
    for &line in shown {
        let line = line as usize;
        let from = line.saturating_sub(SURROUNDINGS + 1).min(lines.len());
        let to = (line + SURROUNDINGS).min(lines.len());
        wanted[from..to].fill(true);
    }
    let list: Vec<Value> = lines
        .iter()
        .zip(&wanted)
        .enumerate()
        .filter(|(_, (_, wanted))| **wanted)
        .map(|(at, (text, _))| json!([at + 1, cut(text)]))
        .collect();
    json!({ "whole": is_whole, "count": lines.len(), "lines": list })
}

fn cut(text: &str) -> String {
    text.chars().take(LINE_CHARACTERS).collect()
}

/// The text of an event. The start of a job is a line for recomputation, of which the beginning is
/// sufficient.
fn said(event: &EventRecord) -> String {
    if event.kind == EventKind::Switched {
        return Switched::parse(&event.text)
            .map_or_else(|| event.text.clone(), |switched| read_with(&switched));
    }
    if event.kind != EventKind::Job {
        return event.text.clone();
    }
    match JobStart::parse(&event.text) {
        Some(JobStart::Program(start)) if start.is_mdi => format!("MDI, {}", start.program),
        Some(JobStart::Program(start)) => format!("program, {}", start.program),
        Some(JobStart::Steered(start)) if start.is_turn => "jog turned over".to_owned(),
        Some(JobStart::Steered(_)) => "jog or homing".to_owned(),
        Some(JobStart::Retrace { back: 0 }) => "forwards along the path".to_owned(),
        Some(JobStart::Retrace { .. }) => "backwards along the path".to_owned(),
        None => event.text.clone(),
    }
}

fn read_with(switched: &Switched) -> String {
    let state = &switched.state;
    let words = |on: bool| if on { "on" } else { "off" };
    format!(
        "read ahead behind line {}: single step {}, optional stop {}, block delete {}, rapid override {:.0} \
         %",
        switched.line,
        words(state.single_step),
        words(state.optional_stop),
        words(state.block_delete),
        100.0 * state.rapid_override
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unix_time_is_a_date() {
        assert_eq!(utc(0), "1970-01-01 00:00:00 UTC");
        assert_eq!(utc(951_827_696_000_000_000), "2000-02-29 12:34:56 UTC");
        assert_eq!(utc(1_700_000_000_000_000_000), "2023-11-14 22:13:20 UTC");
    }
}
