//! The data of a page, gathered in one pass.

use std::collections::{BTreeMap, VecDeque};

use evolvent_motion::flags;
use evolvent_path::AxisLetter;
use evolvent_trace::{CycleRecord, EventKind, EventRecord, inputs};

use crate::check::LimitCheck;
use crate::jobs::{RecordedJob, TravelFrom, recorded_jobs, travel_of};
use crate::lines::LineTimes;
use crate::opened::{InspectError, Opened};
use crate::pyramid::{Level, Pyramid};
use crate::report::line_runs::LineRuns;
use crate::report::trail::{Spot, Trail};

/// Maximum number of parts of a curve in a page; fewer for machines with many axes, so that the page stays
/// small.
const STRETCHES: usize = 65_536;
const STRETCHES_OF_MANY: usize = 16_384;
const MANY_AXES: usize = 4;
/// Maximum number of spans of states and overrides, and of events, in a page.
const MAX_SPANS: usize = 20_000;
const MAX_EVENTS: usize = 5000;
/// Maximum number of jobs of a served machine that are distinguished.
const MAX_JOBS: usize = 2000;
/// Text of the recorded command.
const EMERGENCY_STOP: &str = "emergency stop";
/// Bars of a histogram per power of ten of nanoseconds.
const BARS: f64 = 10.0;

/// A curve and its description.
#[derive(Debug)]
pub(crate) struct Series {
    pub(crate) group: &'static str,
    pub(crate) label: String,
    pub(crate) unit: &'static str,
    pub(crate) axis: Option<usize>,
    pub(crate) limit: Option<f64>,
    pub(crate) level: Level,
}

/// Counts of times, by tenths of powers of ten.
#[derive(Clone, Debug, Default)]
pub(crate) struct LogBars {
    /// Number of early or exact ones.
    pub(crate) none: u64,
    /// Counts by tenth of a power of ten of ns.
    pub(crate) bars: BTreeMap<u32, u64>,
    pub(crate) total: u64,
    pub(crate) max_ns: i64,
}

impl LogBars {
    fn see(&mut self, ns: i64) {
        self.total += 1;
        self.max_ns = self.max_ns.max(ns);
        if ns < 1 {
            self.none += 1;
        } else {
            let bar = (BARS * (ns as f64).log10()) as u32;
            *self.bars.entry(bar).or_default() += 1;
        }
    }
}

/// A span of time with one value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Span {
    pub(crate) start: u64,
    pub(crate) value: f64,
}

/// A job of a served machine; a run of one program is one job.
#[derive(Debug)]
pub(crate) struct JobPart {
    /// Its number; 0 for a run of one program.
    pub(crate) number: u32,
    /// Its name.
    pub(crate) name: String,
    /// Its first cycle, and its last cycle with motion.
    pub(crate) start: u64,
    pub(crate) end: u64,
    pub(crate) times: LineTimes,
    /// Planned seconds and texts of lines, from the blocks.
    pub(crate) planned: BTreeMap<u32, f64>,
    pub(crate) texts: BTreeMap<u32, String>,
}

/// All gathered data.
#[derive(Debug)]
pub(crate) struct Gathered {
    pub(crate) counts: CycleCounts,
    pub(crate) timeline: Timeline,
    pub(crate) series: Vec<Series>,
    pub(crate) trail: Vec<Spot>,
    pub(crate) line_runs: LineRuns,
    pub(crate) lateness: LogBars,
    pub(crate) work: LogBars,
    pub(crate) times: LineTimes,
    pub(crate) check: LimitCheck,
    pub(crate) has_errors: bool,
    pub(crate) max_error: f64,
    pub(crate) path_mm: f64,
    last_path_mm: f64,
    /// Programs and blocks of MDI of a served machine.
    pub(crate) programs: usize,
    travels: VecDeque<TravelFrom>,
    /// In the order of their start.
    pub(crate) jobs: Vec<JobPart>,
    /// Number of jobs started.
    begun: usize,
    /// Maximum feed of a cut, mm/s; 0 if nothing was cut.
    pub(crate) fastest_cut_mm_s: f64,
}

/// Counts of recorded, missing and late cycles.
#[derive(Debug, Default)]
pub(crate) struct CycleCounts {
    pub(crate) cycles: u64,
    /// The number with which the trace begins, whether that cycle is recorded or missing.
    pub(crate) first_sequence: u64,
    pub(crate) last_sequence: u64,
    pub(crate) gaps: Vec<(u64, u64)>,
    pub(crate) missing: u64,
    pub(crate) late: u64,
    pub(crate) starved: u64,
}

impl CycleCounts {
    /// Number of cycles from the first to the last one, including missing ones.
    pub(crate) fn span(&self) -> u64 {
        if self.cycles == 0 {
            return 0;
        }
        // Numbers that decrease, or end at the maximum, come from a damaged file.
        self.last_sequence
            .saturating_sub(self.first_sequence)
            .saturating_add(1)
    }
}

/// Changes and events, with their cycles.
#[derive(Debug, Default)]
pub(crate) struct Timeline {
    pub(crate) states: Vec<Span>,
    pub(crate) overrides: Vec<Span>,
    pub(crate) spans_cut: bool,
    pub(crate) events: Vec<EventRecord>,
    pub(crate) events_left_out: u64,
    pub(crate) alarms: Vec<EventRecord>,
    /// Cycles in which the emergency stop was pressed.
    pub(crate) emergency_stops: Vec<u64>,
}

struct Curves {
    feed: Pyramid,
    override_: Pyramid,
    load: Pyramid,
    /// Velocity, acceleration, jerk, following error and position by axis.
    axes: Vec<[Pyramid; 5]>,
    lateness: Pyramid,
    work: Pyramid,
}

impl Curves {
    fn new(axes: usize) -> Self {
        let capacity = if axes > MANY_AXES {
            STRETCHES_OF_MANY
        } else {
            STRETCHES
        };
        let curve = || Pyramid::new(capacity);
        Self {
            feed: curve(),
            override_: curve(),
            load: curve(),
            axes: (0..axes)
                .map(|_| [curve(), curve(), curve(), curve(), curve()])
                .collect(),
            lateness: curve(),
            work: curve(),
        }
    }

    fn skip(&mut self, samples: u64) {
        let plain = [
            &mut self.feed,
            &mut self.override_,
            &mut self.load,
            &mut self.lateness,
            &mut self.work,
        ];
        plain
            .into_iter()
            .chain(self.axes.iter_mut().flatten())
            .for_each(|curve| curve.skip(samples));
    }

    fn push(&mut self, record: &CycleRecord, axes: &[AxisLetter]) {
        self.feed.push(record.feed_mm_s);
        self.override_.push(100.0 * record.override_);
        self.load.push(record.load);
        self.lateness.push(record.wake_lateness_ns as f64 * 1e-3);
        self.work.push(f64::from(record.work_ns) * 1e-3);
        for (curves, axis) in self.axes.iter_mut().zip(axes) {
            let i = axis.index();
            let values = [
                record.velocity[i],
                record.acceleration[i],
                record.jerk[i],
                record.following_error[i],
                record.position[i],
            ];
            for (curve, value) in curves.iter_mut().zip(values) {
                curve.push(value);
            }
        }
    }
}

/// Reads the trace once.
pub(crate) fn gather(opened: &mut Opened) -> Result<Gathered, InspectError> {
    let axes = opened.run.axes.clone();
    let mut curves = Curves::new(axes.len());
    let starts = recorded_jobs(&mut opened.trace)?;
    let fastest = opened
        .machine
        .axes
        .iter()
        .map(|axis| axis.max_velocity)
        .fold(1.0, f64::max);
    let mut trail = Trail::new(fastest / 40.0);
    let mut g = Gathered::new(opened, &starts);
    opened
        .trace
        .each_cycle(0, u64::MAX, |record| -> Result<_, evolvent_trace::ReadError> {
            g.cycle(record, &mut curves, &mut trail, &axes);
            Ok(std::ops::ControlFlow::Continue(()))
        })?;
    g.take_events(opened)?;
    g.take_blocks(opened)?;
    g.trail = trail.finish();
    g.series = series(opened, &curves, &axes, g.has_errors);
    Ok(g)
}

/// The jobs of a served machine, with those of one number merged; a run of one program is a single job.
fn jobs(starts: &VecDeque<RecordedJob>, times: &LineTimes) -> Vec<JobPart> {
    let part = |number: u32, name: String, start: u64| JobPart {
        number,
        name,
        start,
        end: start,
        times: times.clone(),
        planned: BTreeMap::new(),
        texts: BTreeMap::new(),
    };
    if starts.is_empty() {
        return vec![part(0, String::new(), 0)];
    }
    let mut jobs: Vec<JobPart> = Vec::new();
    for start in starts {
        if jobs.last().is_some_and(|job| job.number == start.job) || jobs.len() >= MAX_JOBS {
            continue;
        }
        jobs.push(part(start.job, start.name(), start.sequence));
    }
    jobs
}

impl Gathered {
    /// The state before the first cycle.
    fn new(opened: &Opened, starts: &VecDeque<RecordedJob>) -> Self {
        let home = opened.machine.limits().home;
        Self {
            counts: CycleCounts {
                first_sequence: opened.run.first_sequence(),
                ..CycleCounts::default()
            },
            timeline: Timeline::default(),
            series: Vec::new(),
            trail: Vec::new(),
            line_runs: LineRuns::default(),
            lateness: LogBars::default(),
            work: LogBars::default(),
            times: LineTimes::new(&opened.machine, opened.run.period_ns),
            check: LimitCheck::new(&opened.machine, opened.run.period_ns, &home.into()),
            has_errors: false,
            max_error: 0.0,
            path_mm: 0.0,
            last_path_mm: 0.0,
            programs: starts.iter().filter(|start| start.is_program()).count(),
            travels: starts
                .iter()
                .map(|start| travel_of(start, &opened.machine))
                .collect(),
            jobs: jobs(starts, &LineTimes::new(&opened.machine, opened.run.period_ns)),
            begun: 0,
            fastest_cut_mm_s: 0.0,
        }
    }

    fn take_events(&mut self, opened: &mut Opened) -> Result<(), InspectError> {
        for event in opened.trace.events() {
            let event = event?;
            if event.kind == EventKind::Command && event.text == EMERGENCY_STOP {
                self.timeline.emergency_stops.push(event.sequence);
            }
            if event.kind == EventKind::Alarm && self.timeline.alarms.len() < MAX_EVENTS {
                self.timeline.alarms.push(event.clone());
            }
            if self.timeline.events.len() < MAX_EVENTS {
                self.timeline.events.push(event);
            } else {
                self.timeline.events_left_out += 1;
            }
        }
        Ok(())
    }

    /// Reads the lines of the jobs from the blocks.
    fn take_blocks(&mut self, opened: &mut Opened) -> Result<(), InspectError> {
        for block in opened.trace.blocks() {
            let block = block?;
            let at = self.jobs.partition_point(|job| job.start <= block.start_sequence);
            let Some(job) = at.checked_sub(1).and_then(|at| self.jobs.get_mut(at)) else {
                continue;
            };
            *job.planned.entry(block.line).or_default() += block.planned_duration_s;
            if self.programs > 0 {
                // The only program of a run is attached.
                job.texts.entry(block.line).or_insert(block.text);
            }
        }
        Ok(())
    }

    /// Adds a cycle to the job that moved the axes.
    fn note_job(&mut self, record: &CycleRecord) {
        while self
            .jobs
            .get(self.begun)
            .is_some_and(|job| job.start <= record.sequence)
        {
            let job = &mut self.jobs[self.begun];
            self.begun += 1;
            // The path length of a program counts from its start, and does not change during a jog.
            if record.inputs & inputs::STEERS != 0 {
                job.times.begin_at(record.path_mm);
            }
        }
        let is_served = self.jobs.first().is_some_and(|job| job.number > 0);
        let is_moved = record.inputs & (inputs::FOLLOWS | inputs::STEERS) != 0;
        if let Some(job) = self.begun.checked_sub(1).and_then(|at| self.jobs.get_mut(at))
            && (is_moved || !is_served)
        {
            job.end = record.sequence;
            job.times.cycle(record);
        }
    }

    fn cycle(&mut self, record: &CycleRecord, curves: &mut Curves, trail: &mut Trail, axes: &[AxisLetter]) {
        let next = if self.counts.cycles == 0 {
            // A trace with a damaged description may begin earlier than stated.
            self.counts.first_sequence = self.counts.first_sequence.min(record.sequence);
            self.counts.first_sequence
        } else {
            self.counts.last_sequence + 1
        };
        if record.sequence > next {
            let missing = record.sequence - next;
            self.counts.missing += missing;
            if self.counts.gaps.len() < MAX_EVENTS {
                self.counts.gaps.push((next, missing));
            }
            curves.skip(missing);
        }
        self.counts.last_sequence = record.sequence;
        self.counts.cycles += 1;
        self.counts.late += u64::from(record.flags & flags::LATE != 0);
        self.counts.starved += u64::from(record.flags & flags::STARVED != 0);
        curves.push(record, axes);
        while self
            .travels
            .front()
            .is_some_and(|(from, ..)| *from <= record.sequence)
        {
            if let Some((_, low, high)) = self.travels.pop_front() {
                self.check.set_travel(&low, &high);
            }
        }
        self.check.cycle(record);
        self.times.cycle(record);
        self.note_job(record);
        self.line_runs.push(record.sequence, record.line);
        let is_rapid = record.flags & flags::RAPID != 0 || record.inputs & inputs::STEERS != 0;
        if !is_rapid {
            self.fastest_cut_mm_s = self.fastest_cut_mm_s.max(record.feed_mm_s);
        }
        self.lateness.see(record.wake_lateness_ns);
        self.work.see(i64::from(record.work_ns));
        // The path length of each job of a served machine starts at zero.
        let further = record.path_mm - self.last_path_mm;
        self.path_mm += if further < 0.0 { record.path_mm } else { further };
        self.last_path_mm = record.path_mm;
        let error = axes
            .iter()
            .take(3)
            .map(|axis| record.following_error[axis.index()])
            .filter(|error| !error.is_nan())
            .fold(f64::NAN, |sum: f64, error| {
                if sum.is_nan() {
                    error.abs()
                } else {
                    sum.hypot(error)
                }
            });
        if !error.is_nan() {
            self.has_errors = true;
            self.max_error = self.max_error.max(error);
        }
        for (list, value) in [
            (&mut self.timeline.states, f64::from(record.state)),
            (&mut self.timeline.overrides, record.override_),
        ] {
            if list.last().is_none_or(|last| last.value != value) {
                if list.len() < MAX_SPANS {
                    list.push(Span {
                        start: record.sequence,
                        value,
                    });
                } else {
                    self.timeline.spans_cut = true;
                }
            }
        }
        trail.push(Spot {
            position: [record.position[0], record.position[1], record.position[2]],
            feed_mm_s: record.feed_mm_s,
            error,
            sequence: record.sequence,
            is_rapid,
        });
    }
}

fn series(opened: &Opened, curves: &Curves, axes: &[AxisLetter], has_errors: bool) -> Vec<Series> {
    let plain = |group, label: &str, unit, limit, curve: &Pyramid| Series {
        group,
        label: label.to_owned(),
        unit,
        axis: None,
        limit,
        level: curve.level(),
    };
    let mut list = vec![plain(
        "feed",
        "feed along the path",
        "mm/s",
        opened.machine.max_feed_mm_s,
        &curves.feed,
    )];
    let groups: [(&str, [&str; 2]); 5] = [
        ("velocity", ["mm/s", "deg/s"]),
        ("acceleration", ["mm/s2", "deg/s2"]),
        ("jerk", ["mm/s3", "deg/s3"]),
        ("following error", ["mm", "deg"]),
        ("position", ["mm", "deg"]),
    ];
    for (order, (group, units)) in groups.into_iter().enumerate() {
        if order == 3 && !has_errors {
            continue;
        }
        for (curves, letter) in curves.axes.iter().zip(axes) {
            let axis = opened.machine.axis(*letter);
            let limit = axis.and_then(|axis| match order {
                0 => Some(axis.max_velocity),
                1 => Some(axis.max_acceleration),
                2 => Some(axis.max_jerk),
                _ => None,
            });
            list.push(Series {
                group,
                label: letter.letter().to_string(),
                unit: units[usize::from(letter.is_rotary())],
                axis: Some(letter.index()),
                limit,
                level: curves[order].level(),
            });
        }
    }
    list.push(plain("override", "feed override", "%", None, &curves.override_));
    if opened.run.clock == "realtime" {
        list.push(plain(
            "lateness",
            "wake-up lateness",
            "us",
            None,
            &curves.lateness,
        ));
        list.push(plain("work", "own work", "us", None, &curves.work));
    }
    let load = curves.load.level();
    if load.values.chunks_exact(2).any(|pair| pair[0] <= pair[1]) {
        list.push(plain("load", "cutting load", "as measured", None, &curves.load));
    }
    list
}
