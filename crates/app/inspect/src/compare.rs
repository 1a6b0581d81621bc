//! Comparison of two runs, aligned by position on the path.

use std::collections::VecDeque;
use std::path::Path;

use evolvent_analysis::Limiting;
use evolvent_trace::{CycleRecord, ReadError, inputs};

use crate::jobs::{MDI, RecordedJob, recorded_jobs};
use crate::lines::LineTimes;
use crate::opened::{InspectError, Opened};

/// Maximum number of lines listed.
const MAX_LINES: usize = 40;
/// Points of the curve of the difference.
const POINTS: usize = 200;
/// Maximum number of jobs of a service listed in a note.
const MAX_NAMED: usize = 12;
/// Maximum line number whose text is looked up.
const MAX_LINE: usize = 1_000_000;
/// Differences in time below this are ignored, s.
const MIN_S: f64 = 1e-9;
/// Positions that differ by less agree, mm or degrees.
const SAME: f64 = 1e-6;
/// Two paths that differ by less in length have the same end, mm.
const SAME_PATH_MM: f64 = 1e-3;

/// A line in both runs.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct LineDifference {
    /// The program's line.
    pub line: u32,
    /// Its text in the first run.
    pub text: String,
    /// Its text in the second run, if it differs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub b_text: Option<String>,
    /// Time in it in the first run, s.
    pub a_s: f64,
    /// Time in it in the second run, s.
    pub b_s: f64,
    /// The limit that was active longest in the first run.
    pub a_limit: String,
    /// The limit that was active longest in the second run.
    pub b_limit: String,
    /// Why the slower one was slower, as far as the traces show.
    pub why: String,
}

/// Result of a comparison. The first run is A, the second B.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Comparison {
    /// Length of the path that both have driven, mm.
    pub common_path_mm: f64,
    /// Path length of A and of B, mm.
    pub path_mm: [f64; 2],
    /// Duration of A and of B, s.
    pub duration_s: [f64; 2],
    /// Time that A and B took for the common path, s.
    pub common_s: [f64; 2],
    /// Maximum distance between the runs at the same path length, mm: of X, Y and Z, or of U, V and W.
    pub max_deviation_mm: f64,
    /// Its path length, mm.
    pub deviation_at_mm: f64,
    /// Its line in A.
    pub deviation_line: u32,
    /// Maximum difference of a rotary axis at the same path length, degrees; `None` if neither machine has
    /// one.
    pub max_rotary_deviation_deg: Option<f64>,
    /// Its path length, mm.
    pub rotary_deviation_at_mm: f64,
    /// Its line in A.
    pub rotary_deviation_line: u32,
    /// The first point at which they differ by more than a nanometre or a millionth of a degree: path length
    /// and line in A.
    pub first_deviation: Option<(f64, u32)>,
    /// Lines by difference in time, the largest first.
    pub lines: Vec<LineDifference>,
    /// Path length, mm, and the delay of B relative to A there, s.
    pub lag: Vec<(f64, f64)>,
    /// Other differences: machine, program, period, planner.
    pub notes: Vec<String>,
}

/// One of two runs that are compared.
#[derive(Clone, Copy, Debug)]
pub struct ComparedRun<'a> {
    /// Its trace.
    pub trace: &'a Path,
    /// The selected job of a served machine; `None` for the whole trace.
    pub job: Option<u32>,
}

/// The cycles of a run in its trace.
#[derive(Clone, Copy, Debug)]
struct Part {
    first: u64,
    /// The first cycle after it.
    end: u64,
    is_job: bool,
}

impl Part {
    fn of(opened: &mut Opened, job: Option<u32>) -> Result<Self, InspectError> {
        let Some(job) = job else {
            return Ok(Self {
                first: 0,
                end: u64::MAX,
                is_job: false,
            });
        };
        let starts = recorded_jobs(&mut opened.trace)?;
        let first = starts.iter().position(|start| start.job == job);
        let first = first.ok_or_else(|| InspectError::NoJob {
            file: opened.trace.info().path.display().to_string(),
            job,
            jobs: starts.back().map_or(0, |start| start.job),
        })?;
        let next = starts.iter().skip(first).find(|start| start.job != job);
        Ok(Self {
            first: starts[first].sequence,
            end: next.map_or(u64::MAX, |next| next.sequence),
            is_job: true,
        })
    }

    /// The cycle, counted from the beginning of the run; `None` if the job does not move the axes in it.
    fn cut(self, record: Result<CycleRecord, ReadError>) -> Option<Result<CycleRecord, ReadError>> {
        let mut record = match record {
            Ok(record) => record,
            Err(error) => return Some(Err(error)),
        };
        let is_moved = record.inputs & (inputs::FOLLOWS | inputs::STEERS) != 0;
        if !(self.first..self.end).contains(&record.sequence) || (self.is_job && !is_moved) {
            return None;
        }
        record.sequence -= self.first;
        Some(Ok(record))
    }

    /// Texts of lines: of the attached program, or of the blocks of a job.
    fn lines(self, opened: &mut Opened) -> Result<Vec<String>, InspectError> {
        let mut lines = opened.program_lines();
        if self.is_job {
            for block in opened.trace.blocks() {
                let block = block?;
                let at = block.line as usize;
                if !(self.first..self.end).contains(&block.start_sequence) || !(1..=MAX_LINE).contains(&at) {
                    continue;
                }
                if lines.len() < at {
                    lines.resize(at, String::new());
                }
                lines[at - 1] = block.text;
            }
        }
        Ok(lines)
    }
}

/// Compares two traces.
///
/// # Errors
/// [`InspectError`] of either.
pub fn compare(a: &Path, b: &Path) -> Result<Comparison, InspectError> {
    let whole = |trace| ComparedRun { trace, job: None };
    compare_runs(whole(a), whole(b))
}

/// Compares two runs: traces, or jobs in the traces of served machines.
///
/// # Errors
/// [`InspectError`] of either; a trace that has no such job.
pub fn compare_runs(run_a: ComparedRun<'_>, run_b: ComparedRun<'_>) -> Result<Comparison, InspectError> {
    let mut a = Opened::open(run_a.trace)?;
    let mut b = Opened::open(run_b.trace)?;
    let has_rotary = [&a, &b]
        .iter()
        .any(|opened| opened.run.axes.iter().any(|axis| axis.is_rotary()));
    let mut result = Comparison {
        notes: surroundings(&a, &b),
        max_rotary_deviation_deg: has_rotary.then_some(0.0),
        ..Comparison::default()
    };
    let mut jobs = [run_a.job, run_b.job];
    for ((name, opened), job) in [("A", &mut a), ("B", &mut b)].into_iter().zip(&mut jobs) {
        if job.is_none() && opened.run.extra.contains_key("served") {
            let jobs = named(&recorded_jobs(&mut opened.trace)?);
            let meant = only_program(&jobs);
            result.notes.push(of_service(name, &jobs, meant));
            *job = meant;
        }
    }
    let (part_a, part_b) = (Part::of(&mut a, jobs[0])?, Part::of(&mut b, jobs[1])?);
    let lines = [part_a.lines(&mut a)?, part_b.lines(&mut b)?];
    let mut times = [
        LineTimes::new(&a.machine, a.run.period_ns),
        LineTimes::new(&b.machine, b.run.period_ns),
    ];
    let periods = [a.period_s(), b.period_s()];
    let mut b_cycles = Ahead::new(b.trace.cycles().filter_map(|record| part_b.cut(record)));
    let mut last_lag = (0.0, 0.0);
    let mut lags = Vec::new();
    let mut end_a = None;
    for record in a.trace.cycles().filter_map(|record| part_a.cut(record)) {
        let record = record?;
        end_a = Some(record);
        times[0].cycle(&record);
        result.path_mm[0] = result.path_mm[0].max(record.path_mm);
        result.duration_s[0] = (record.sequence + 1) as f64 * periods[0];
        let place = b_cycles.reach(record.path_mm, |passed| {
            times[1].cycle(passed);
            result.path_mm[1] = result.path_mm[1].max(passed.path_mm);
            result.duration_s[1] = (passed.sequence + 1) as f64 * periods[1];
        })?;
        let Some((position, sequence)) = place else {
            continue;
        };
        // If the path length does not increase, positions cannot be matched.
        if record.path_mm <= last_lag.0 {
            continue;
        }
        result.see(&record, &position);
        let a_s = record.sequence as f64 * periods[0];
        let b_s = sequence * periods[1];
        result.common_path_mm = record.path_mm;
        result.common_s = [a_s, b_s];
        last_lag = (record.path_mm, b_s - a_s);
        thin_out(&mut lags, last_lag);
    }
    let end_b = b_cycles.finish(|passed| {
        times[1].cycle(passed);
        result.path_mm[1] = result.path_mm[1].max(passed.path_mm);
        result.duration_s[1] = (passed.sequence + 1) as f64 * periods[1];
    })?;
    // Axes that move while the path length does not increase are compared where both runs have reached its
    // end.
    if let (Some(end_a), Some(end_b)) = (end_a, end_b)
        && (end_a.path_mm - end_b.path_mm).abs() <= SAME_PATH_MM
    {
        result.see(&end_a, &end_b.position);
    }
    lags.push(last_lag);
    let step = lags.len().div_ceil(POINTS).max(1);
    result.lag = lags.iter().copied().step_by(step).chain([last_lag]).collect();
    result.lines = by_line(&times, &lines);
    Ok(result)
}

/// A job of a service, listed once by its number.
#[derive(Clone, Debug, PartialEq)]
struct NamedJob {
    job: u32,
    name: String,
    is_program: bool,
}

fn named(jobs: &VecDeque<RecordedJob>) -> Vec<NamedJob> {
    let mut named: Vec<NamedJob> = (jobs.iter())
        .map(|job| NamedJob {
            job: job.job,
            name: job.name(),
            is_program: job.is_program(),
        })
        .collect();
    // A program with excursions has entries of its jogs under its number.
    named.dedup_by_key(|job| job.job);
    named
}

/// The job to select if none is given: the only program of a session, or its only job.
fn only_program(jobs: &[NamedJob]) -> Option<u32> {
    let mut programs = jobs.iter().filter(|job| job.is_program && job.name != MDI);
    match (programs.next(), programs.next(), jobs) {
        (Some(only), None, _) | (None, _, [only]) => Some(only.job),
        _ => None,
    }
}

/// The note about a service for which no job was given.
fn of_service(name: &str, jobs: &[NamedJob], meant: Option<u32>) -> String {
    let option = name.to_ascii_lowercase();
    if let Some(job) = meant {
        return format!(
            "{name} is a service, of which job {job} is compared; --job-{option} names another one"
        );
    }
    let mut list: Vec<String> = (jobs.iter().filter(|job| job.is_program))
        .map(|job| format!("{} {}", job.job, job.name))
        .collect();
    if list.len() > MAX_NAMED {
        list.truncate(MAX_NAMED);
        list.push("...".to_owned());
    }
    let list = if list.is_empty() {
        String::new()
    } else {
        format!(": {}", list.join(", "))
    };
    format!(
        "{name} is a service with {} jobs, of which each counts its path from 0: positions are matched \
         within one job only; name it with --job-{option}{list}",
        jobs.len()
    )
}

/// Keeps fewer than 16 384 points: every second one is dropped when the list is full.
fn thin_out(list: &mut Vec<(f64, f64)>, point: (f64, f64)) {
    const MAX_POINTS: usize = 16_384;
    list.push(point);
    if list.len() >= MAX_POINTS {
        let mut at = 0;
        list.retain(|_| {
            at += 1;
            at % 2 == 1
        });
    }
}

impl Comparison {
    /// Compares the positions at one path length; the record is one of A.
    fn see(&mut self, record: &CycleRecord, position: &[f64; 9]) {
        let difference: [f64; 9] = std::array::from_fn(|i| (record.position[i] - position[i]).abs());
        let distance = |from: usize| {
            let [x, y, z] = [difference[from], difference[from + 1], difference[from + 2]];
            (x * x + y * y + z * z).sqrt()
        };
        // XYZ ABC UVW.
        let off = distance(0).max(distance(6));
        let turned = difference[3..6].iter().copied().fold(0.0, f64::max);
        if off > self.max_deviation_mm {
            self.max_deviation_mm = off;
            self.deviation_at_mm = record.path_mm;
            self.deviation_line = record.line;
        }
        if let Some(max) = &mut self.max_rotary_deviation_deg
            && turned > *max
        {
            *max = turned;
            self.rotary_deviation_at_mm = record.path_mm;
            self.rotary_deviation_line = record.line;
        }
        if off.max(turned) > SAME && self.first_deviation.is_none() {
            self.first_deviation = Some((record.path_mm, record.line));
        }
    }
}

fn surroundings(a: &Opened, b: &Opened) -> Vec<String> {
    let mut notes = Vec::new();
    let mut differ = |what: &str, a: String, b: String| {
        if a != b {
            let named = |name: String| if name.is_empty() { "none".to_owned() } else { name };
            notes.push(format!("{what}: {} against {}", named(a), named(b)));
        }
    };
    differ("machine", a.run.machine_name.clone(), b.run.machine_name.clone());
    differ(
        "period, ns",
        a.run.period_ns.to_string(),
        b.run.period_ns.to_string(),
    );
    differ("program", a.run.program_name.clone(), b.run.program_name.clone());
    let version = |opened: &Opened| opened.run.versions.get("evolvent").cloned().unwrap_or_default();
    differ("version", version(a), version(b));
    for key in ["planner", "feed_override", "start_line"] {
        let of = |opened: &Opened| opened.run.extra.get(key).cloned().unwrap_or_default();
        differ(key, of(a), of(b));
    }
    if a.program != b.program {
        notes.push("the programs differ: line numbers refer to each run's own program".to_owned());
    }
    if a.machine_text != b.machine_text {
        notes.push("the machine files differ".to_owned());
    }
    notes
}

fn by_line(times: &[LineTimes; 2], lines: &[Vec<String>; 2]) -> Vec<LineDifference> {
    let mut numbers: Vec<u32> = times
        .iter()
        .flat_map(|times| times.lines().keys().copied())
        .collect();
    numbers.sort_unstable();
    numbers.dedup();
    let mut list: Vec<LineDifference> = numbers
        .into_iter()
        .filter_map(|line| {
            let [a, b] = [times[0].lines().get(&line), times[1].lines().get(&line)];
            let seconds = |time: Option<&crate::LineTime>| time.map_or(0.0, |time| time.time_s);
            let limit = |time: Option<&crate::LineTime>| {
                time.and_then(crate::LineTime::main_limit)
                    .map_or_else(|| "not driven".to_owned(), Limiting::name)
            };
            let (a_s, b_s) = (seconds(a), seconds(b));
            if (a_s - b_s).abs() < MIN_S {
                return None;
            }
            let text = |run: usize| {
                let at = (line as usize).checked_sub(1);
                at.and_then(|at| lines[run].get(at)).cloned().unwrap_or_default()
            };
            let (text, b_text) = (text(0), text(1));
            Some(LineDifference {
                line,
                b_text: (b_text != text).then_some(b_text),
                text,
                a_s,
                b_s,
                a_limit: limit(a),
                b_limit: limit(b),
                why: a
                    .zip(b)
                    .map_or_else(|| "only one run executed it".to_owned(), |(a, b)| why(a, b)),
            })
        })
        .collect();
    list.sort_by(|a, b| (b.a_s - b.b_s).abs().total_cmp(&(a.a_s - a.b_s).abs()));
    list.truncate(MAX_LINES);
    list
}

fn why(a: &crate::LineTime, b: &crate::LineTime) -> String {
    let (slow, fast, name) = if a.time_s > b.time_s {
        (a, b, "A")
    } else {
        (b, a, "B")
    };
    let lost = slow.time_s - fast.time_s;
    if slow.held_s - fast.held_s > 0.5 * lost {
        return format!("{name} was held for {:.3} s", slow.held_s);
    }
    if slow.mean_override() < 0.99 * fast.mean_override() {
        return format!(
            "{name} ran at {:.0} % override, the other at {:.0} %",
            100.0 * slow.mean_override(),
            100.0 * fast.mean_override()
        );
    }
    if (slow.path_mm - fast.path_mm).abs() > 1e-3 * fast.path_mm.max(1e-9) {
        return format!(
            "{name} drove {:.3} mm there, the other {:.3} mm",
            slow.path_mm, fast.path_mm
        );
    }
    if slow.limited_s - fast.limited_s > 0.3 * lost
        && let Some(limit) = slow.main_machine_limit()
    {
        return format!("{name} was longer at a limit of the machine ({})", limit.name());
    }
    format!(
        "{name} was slower on average: {:.1} against {:.1} mm/s",
        slow.mean_feed_mm_s(),
        fast.mean_feed_mm_s()
    )
}

/// The second run, read up to the path length of the first one.
struct Ahead<I> {
    cycles: I,
    before: Option<CycleRecord>,
    after: Option<CycleRecord>,
    over: bool,
}

impl<I: Iterator<Item = Result<CycleRecord, ReadError>>> Ahead<I> {
    fn new(cycles: I) -> Self {
        Self {
            cycles,
            before: None,
            after: None,
            over: false,
        }
    }

    fn next(&mut self, mut see: impl FnMut(&CycleRecord)) -> Result<(), ReadError> {
        self.before = self.after.take().or(self.before);
        match self.cycles.next().transpose()? {
            Some(record) => {
                see(&record);
                self.after = Some(record);
            }
            None => self.over = true,
        }
        Ok(())
    }

    /// Position and cycle at this path length, interpolated between two cycles; `None` beyond the end.
    fn reach(
        &mut self,
        path_mm: f64,
        mut see: impl FnMut(&CycleRecord),
    ) -> Result<Option<([f64; 9], f64)>, ReadError> {
        while !self.over && self.after.is_none_or(|after| after.path_mm < path_mm) {
            self.next(&mut see)?;
        }
        let Some(after) = self.after else { return Ok(None) };
        if after.path_mm < path_mm {
            return Ok(None);
        }
        let before = self.before.unwrap_or(after);
        let length = after.path_mm - before.path_mm;
        let fraction = if length > 0.0 {
            ((path_mm - before.path_mm) / length).clamp(0.0, 1.0)
        } else {
            1.0
        };
        let position =
            std::array::from_fn(|i| before.position[i] + fraction * (after.position[i] - before.position[i]));
        let sequence = before.sequence as f64 + fraction * (after.sequence - before.sequence) as f64;
        Ok(Some((position, sequence)))
    }

    /// Reads the rest; returns the last cycle.
    fn finish(mut self, mut see: impl FnMut(&CycleRecord)) -> Result<Option<CycleRecord>, ReadError> {
        while !self.over {
            self.next(&mut see)?;
        }
        Ok(self.after.or(self.before))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evolvent_analysis::Order;
    use evolvent_path::AxisLetter;

    use crate::LineTime;

    #[test]
    fn only_an_axis_is_named_as_a_limit_of_the_machine() {
        let line = |time_s: f64, limited_s: f64, by_limit: &[(Limiting, f64)]| {
            let mut line = LineTime::default();
            line.time_s = time_s;
            line.limited_s = limited_s;
            line.path_mm = 10.0;
            line.by_limit = by_limit.iter().copied().collect();
            line
        };
        let fast = line(
            10.0,
            1.0,
            &[
                (Limiting::Feed, 9.0),
                (Limiting::Axis(AxisLetter::X, Order::Acceleration), 1.0),
            ],
        );
        let slow = line(
            14.0,
            4.0,
            &[
                (Limiting::Feed, 5.0),
                (Limiting::Standing, 5.0),
                (Limiting::Axis(AxisLetter::X, Order::Jerk), 3.0),
                (Limiting::Axis(AxisLetter::X, Order::Acceleration), 1.0),
            ],
        );
        assert_eq!(
            why(&slow, &fast),
            "A was longer at a limit of the machine (X jerk)"
        );
    }

    fn jobs(names: &[&str]) -> Vec<NamedJob> {
        let named = names.iter().zip(1..).map(|(name, job)| NamedJob {
            job,
            name: (*name).to_owned(),
            is_program: *name != "jog or homing",
        });
        named.collect()
    }

    #[test]
    fn the_only_program_of_a_service_is_selected() {
        let (jog, part) = ("jog or homing", "program part.ngc");
        assert_eq!(only_program(&jobs(&[])), None);
        assert_eq!(only_program(&jobs(&[jog])), Some(1));
        assert_eq!(only_program(&jobs(&[jog, MDI, part, jog])), Some(3));
        assert_eq!(only_program(&jobs(&[MDI, MDI])), None);
        let two = jobs(&[part, jog, part]);
        assert_eq!(only_program(&two), None);
        let note = of_service("B", &two, None);
        assert!(
            note.ends_with("--job-b: 1 program part.ngc, 3 program part.ngc"),
            "{note}"
        );
        let note = of_service("A", &two, Some(3));
        assert!(note.contains("job 3") && note.contains("--job-a"), "{note}");
    }
}
