//! Proof that a run would come out the same again.

use std::cell::{Cell, RefCell};
use std::io::{BufReader, Write as _};
use std::path::Path;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;

use evolvent_daemon::{RecordedInputs, recompute};
use evolvent_judge::{Allowances, Judge, Kind, Route};
use evolvent_motion::{Inputs, Setpoint};
use evolvent_path::AxisLetter;
use evolvent_process::LoadSample;
use evolvent_trace::{CycleRecord, ReadError, inputs as bits};

use crate::check::LimitCheck;
use crate::opened::{InspectError, Opened};

/// Ratio of the speed to the programmed feed that is let pass: the near-optimal planner keeps the feed word at its
/// stations, and between them to 0.2 %.
const FEED: f64 = 1.002;

/// LATE says when a setpoint left, not where it is.
const TIMING_FLAGS: u32 = 1;
const FLAG_STARVED: u32 = 32;
const STATE_DONE: u8 = 9;
/// Cycles that go from the reader at once, and how many such lots may wait.
const LOT: usize = 4096;
const LOTS: usize = 8;

/// The first place where recorded and recomputed setpoint are not the same.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Difference {
    /// The cycle.
    pub sequence: u64,
    /// Its path time, s.
    pub time_s: f64,
    /// The program's line there, as recorded.
    pub line: u32,
    /// The text of that line.
    pub text: String,
    /// What differs, for example `position X`.
    pub quantity: String,
    /// As recorded.
    pub recorded: f64,
    /// As computed now.
    pub recomputed: f64,
}

/// What checking a trace came to.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Verified {
    /// Cycles recorded.
    pub cycles: u64,
    /// Cycles computed again and compared.
    pub compared: u64,
    /// Cycles that are missing in the trace.
    pub missing: u64,
    /// Whether the run was computed again at all; if not, `notes` say why.
    pub recomputed: bool,
    /// How many compared setpoints differ.
    pub differing: u64,
    /// The first of them.
    pub first_difference: Option<Difference>,
    /// Greatest difference of a position, mm or degrees.
    pub greatest_difference: f64,
    /// What explains a difference: another version, another kind of processor, a starved planner.
    pub explanations: Vec<String>,
    /// Samples that break a limit, by differences of the recorded positions alone.
    pub limit_violations: u64,
    /// Everything that the independent checks object to, in words.
    pub violations: Vec<String>,
    /// Greatest distance from the programmed path, mm; `None` if the path was not checked.
    pub max_path_error_mm: Option<f64>,
    /// What else is to be known.
    pub notes: Vec<String>,
}

impl Verified {
    /// Whether nothing differs, as far as the run was computed again, and nothing is objected to.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.differing == 0 && self.first_difference.is_none() && self.violations.is_empty()
    }

    /// Whether the trace lacks something of the run: cycles, or the program to compute it again from.
    #[must_use]
    pub fn lacks_data(&self) -> bool {
        self.missing > 0 || !self.recomputed
    }
}

/// Computes the run of a trace again, from the attached program, the machine and the recorded inputs, and compares every
/// setpoint bit for bit; and checks every recorded position against limits and path, without a planner.
///
/// # Errors
/// [`InspectError`]: a damaged trace, or one that cannot be understood.
pub fn verify(path: &Path) -> Result<Verified, InspectError> {
    let mut opened = Opened::open(path)?;
    let setup = opened.setup()?;
    let mut verified = Verified::default();
    let lines = opened.program_lines();
    explain_surroundings(&opened, &mut verified);
    let folder = tempfile::tempdir().map_err(|source| InspectError::Io {
        what: "a temporary folder for the attached program".to_owned(),
        source,
    })?;
    let program = folder.path().join(if opened.run.program_name.is_empty() {
        "program.ngc"
    } else {
        // The name of the recorded file without any folder: it came from outside.
        Path::new(&opened.run.program_name)
            .file_name()
            .and_then(|name| name.to_str())
            .unwrap_or("program.ngc")
    });
    let has_program = match &opened.program {
        Some(text) => {
            std::fs::File::create(&program)
                .and_then(|mut file| file.write_all(text))
                .map_err(|source| InspectError::Io {
                    what: "the attached program".to_owned(),
                    source,
                })?;
            true
        }
        None => {
            verified
                .notes
                .push("no program is attached: only limits were checked".to_owned());
            false
        }
    };
    let start_line = setup.start_line;
    let route = if has_program && start_line.is_none() {
        let text = opened.program.clone().unwrap_or_default();
        let settings = setup.interpreter_settings_for(&program);
        match Route::read(BufReader::new(text.as_slice()), settings, &opened.machine) {
            Ok(route) => Some(route),
            Err(error) => {
                verified.notes.push(format!("the path was not checked: {error}"));
                None
            }
        }
    } else {
        None
    };
    let number = |key: &str| {
        opened
            .run
            .extra
            .get(key)
            .and_then(|text| text.parse::<f64>().ok())
    };
    let feed_override = number("feed_override").unwrap_or(1.0);
    let optional_stop = opened
        .run
        .extra
        .get("optional_stop")
        .is_some_and(|text| text == "true");
    let home = setup.machine.limits().home;
    let mut watch = Watch {
        check: LimitCheck::new(&opened.machine, opened.run.period_ns, &home.into()),
        judge: route
            .as_ref()
            .map(|route| Judge::new(&opened.machine, opened.run.period_ns, route)),
        most_override: 0.0,
        last_state: 0,
        last_sequence: None,
        cycles: 0,
        missing: 0,
        first_starved: None,
        first_missed: None,
    };
    let period_s = opened.period_s();
    let run = opened.run.clone();
    let planned = if has_program { Some(()) } else { None };

    let read = thread::scope(|scope| -> Result<(), InspectError> {
        let (sender, lots) = sync_channel::<Result<Vec<CycleRecord>, ReadError>>(LOTS);
        let trace = &mut opened.trace;
        scope.spawn(move || {
            let mut lot = Vec::with_capacity(LOT);
            for record in trace.cycles() {
                match record {
                    Ok(record) => lot.push(record),
                    Err(error) => {
                        // The error comes after what is whole.
                        let _gone = sender.send(Ok(std::mem::take(&mut lot)));
                        let _gone = sender.send(Err(error));
                        return;
                    }
                }
                if lot.len() == LOT
                    && sender
                        .send(Ok(std::mem::replace(&mut lot, Vec::with_capacity(LOT))))
                        .is_err()
                {
                    return;
                }
            }
            let _gone = sender.send(Ok(lot));
        });
        let feed = RefCell::new(Feed {
            lots,
            lot: Vec::new().into_iter(),
            present: None,
            failure: None,
            watch: &mut watch,
        });
        if planned.is_some() {
            let comparing = Comparing {
                axes: run.axes.clone(),
                period_s,
                columns: run.columns,
            };
            let last = Cell::new(Inputs {
                feed_override,
                ..Inputs::default()
            });
            let result = recompute(
                &program,
                &setup,
                feed_override,
                optional_stop,
                |sequence| {
                    let mut feed = feed.borrow_mut();
                    let record = feed.advance(sequence)?;
                    match record {
                        Some(record) => {
                            last.set(inputs_of(&record, last.get().load));
                            Some(RecordedInputs {
                                inputs: last.get(),
                                waited: record.inputs & bits::WAITED != 0,
                                refused: record.inputs & bits::REFUSED != 0,
                            })
                        }
                        // A cycle that was lost: nothing is known to have changed.
                        None => Some(RecordedInputs {
                            inputs: last.get(),
                            waited: false,
                            refused: false,
                        }),
                    }
                },
                |setpoint| {
                    let record = feed.borrow().present;
                    if let Some(record) = record {
                        comparing.compare(&record, setpoint, &mut verified, &lines);
                    }
                    true
                },
            );
            match result {
                Ok(recomputed) => {
                    verified.recomputed = true;
                    if let Err(error) = recomputed.program {
                        verified.notes.push(format!("the program has an error: {error}"));
                    }
                }
                Err(source) => {
                    return Err(InspectError::Io {
                        what: "a thread for the planner".to_owned(),
                        source,
                    });
                }
            }
        }
        // What the recomputed run did not reach is checked all the same.
        let mut feed = feed.into_inner();
        let mut beyond = 0;
        while let Some(record) = feed.next_record() {
            beyond += 1;
            if verified.recomputed && verified.first_difference.is_none() {
                verified.first_difference = Some(Difference {
                    sequence: record.sequence,
                    time_s: record.sequence as f64 * period_s,
                    line: record.line,
                    text: text_of(&lines, record.line),
                    quantity: "end of the run: it is over when computed again".to_owned(),
                    recorded: record.path_mm,
                    recomputed: f64::NAN,
                });
            }
        }
        if verified.recomputed {
            verified.differing += beyond;
        }
        match feed.failure {
            Some(error) => Err(error.into()),
            None => Ok(()),
        }
    });
    read?;
    let (first_starved, first_missed) = (watch.first_starved, watch.first_missed);
    watch.conclude(&mut verified);
    if let (Some(difference), Some(starved)) = (&verified.first_difference, first_starved)
        && difference.sequence >= starved
    {
        verified.explanations.push(format!(
            "the planner of the recorded run had not finished in time at cycle {starved} (flag STARVED): how far it was is \
             not recorded, so the run can be computed again up to there only"
        ));
    }
    if let (Some(difference), Some(missed)) = (&verified.first_difference, first_missed)
        && difference.sequence >= missed
    {
        verified.explanations.push(format!(
            "at cycle {missed} the planner of the recorded run had no answer, or none in time, to a hold or another override: what it had \
             planned by then is not recorded, so the run can be computed again up to there only"
        ));
    }
    Ok(verified)
}

/// `load` is the reading of the cycle before.
fn inputs_of(record: &CycleRecord, load: Option<LoadSample>) -> Inputs {
    Inputs {
        feed_override: record.override_,
        hold: record.inputs & bits::HOLD != 0,
        stop: record.inputs & bits::STOP != 0,
        resume: record.inputs & bits::RESUME != 0,
        load: (!record.load.is_nan()).then(|| LoadSample {
            // Readings are told apart by their numbers; which they are does not matter.
            sequence: load.map_or(0, |load| load.sequence) + u64::from(record.inputs & bits::LOAD != 0),
            value: record.load,
            range_max: if record.inputs & bits::LOAD_AT_END != 0 {
                record.load
            } else {
                f64::INFINITY
            },
        }),
    }
}

fn text_of(lines: &[String], line: u32) -> String {
    (line as usize)
        .checked_sub(1)
        .and_then(|at| lines.get(at))
        .cloned()
        .unwrap_or_default()
}

/// Another version or another kind of processor may compute other bits.
fn explain_surroundings(opened: &Opened, verified: &mut Verified) {
    let own = env!("CARGO_PKG_VERSION");
    let recorded = opened
        .run
        .versions
        .get("evolvent")
        .map_or("unknown", String::as_str);
    if recorded != own {
        verified.explanations.push(format!(
            "the trace was recorded by version {recorded}, this is {own}: planners of two versions may differ"
        ));
    }
    let platform = evolvent_daemon::platform();
    let recorded = opened.run.extra.get("platform").map_or("unknown", String::as_str);
    if recorded != platform {
        verified.explanations.push(format!(
            "the trace was recorded on {recorded}, this is {platform}: floating point is the same by the standard, \
             compilers may not be"
        ));
    }
    let hash = evolvent_trace::configuration_hash(&[opened.machine_text.as_bytes()]);
    if hash != opened.run.configuration_hash {
        verified
            .explanations
            .push("the attached machine file is not the one whose hash was recorded".to_owned());
    }
    let info = opened.trace.info();
    if !info.recovery.is_empty() {
        verified
            .notes
            .push("the trace was recovered; its end may be missing".to_owned());
    }
}

/// Independent checks of what was recorded.
struct Watch<'a> {
    check: LimitCheck,
    judge: Option<Judge<'a>>,
    most_override: f64,
    last_state: u8,
    last_sequence: Option<u64>,
    cycles: u64,
    missing: u64,
    first_starved: Option<u64>,
    first_missed: Option<u64>,
}

impl Watch<'_> {
    fn see(&mut self, record: &CycleRecord) {
        let next = self.last_sequence.map_or(0, |last| last + 1);
        self.missing += record.sequence.saturating_sub(next);
        if record.sequence != next {
            // Differences over a gap are none; the judge knows nothing of gaps.
            self.judge = None;
        }
        self.last_sequence = Some(record.sequence);
        self.cycles += 1;
        self.check.cycle(record);
        if let Some(judge) = &mut self.judge {
            judge.sample(&record.position.into());
        }
        self.most_override = self.most_override.max(record.override_);
        self.last_state = record.state;
        if record.flags & FLAG_STARVED != 0 {
            self.first_starved.get_or_insert(record.sequence);
        }
        if record.inputs & (bits::WAITED | bits::REFUSED) != 0 && record.feed_mm_s > 0.0 {
            self.first_missed.get_or_insert(record.sequence);
        }
    }

    fn conclude(self, verified: &mut Verified) {
        verified.cycles = self.cycles;
        verified.missing = self.missing;
        verified.limit_violations = self.check.broken();
        if let Some((sequence, line, text)) = self.check.first_broken() {
            verified
                .violations
                .push(format!("{text} (cycle {sequence}, line {line})"));
        }
        let Some(judge) = self.judge else {
            if self.missing > 0 {
                verified
                    .notes
                    .push("the path was not checked: cycles are missing".to_owned());
            }
            return;
        };
        let verdict = judge.finish();
        verified.max_path_error_mm = Some(verdict.deviation_mm.value);
        let is_done = self.last_state == STATE_DONE;
        let allowances = Allowances {
            feed: FEED * self.most_override.max(1.0),
            ..Allowances::default()
        };
        // A run that was stopped has no end; braking after a fault may leave the path.
        let unfinished = [Kind::Missed, Kind::Rest, Kind::End];
        // Velocity, acceleration and jerk have been said above; joints have the guard's rule there.
        let said = [Kind::Velocity, Kind::Acceleration, Kind::Jerk, Kind::Travel];
        for violation in verdict.violations(&allowances) {
            let is_meant =
                !said.contains(&violation.kind) && (is_done || !unfinished.contains(&violation.kind));
            // In blending mode a rounded corner is what the tolerance is for; the chord error is the planner's promise.
            if is_meant {
                verified.violations.push(format!("{violation}"));
            }
        }
    }
}

/// Recorded cycles, one after another.
struct Feed<'w, 'a> {
    lots: Receiver<Result<Vec<CycleRecord>, ReadError>>,
    lot: std::vec::IntoIter<CycleRecord>,
    /// The record of the present cycle; `None` if it was lost.
    present: Option<CycleRecord>,
    failure: Option<ReadError>,
    watch: &'w mut Watch<'a>,
}

impl Feed<'_, '_> {
    fn peek(&mut self) -> Option<&CycleRecord> {
        while self.lot.as_slice().is_empty() {
            match self.lots.recv() {
                Ok(Ok(lot)) => self.lot = lot.into_iter(),
                Ok(Err(error)) => {
                    self.failure = Some(error);
                    return None;
                }
                Err(_) => return None,
            }
        }
        self.lot.as_slice().first()
    }

    fn next_record(&mut self) -> Option<CycleRecord> {
        self.peek()?;
        let record = self.lot.next()?;
        self.watch.see(&record);
        Some(record)
    }

    /// The record of cycle `sequence`: `Some(None)` if it was lost, `None` at the end.
    fn advance(&mut self, sequence: u64) -> Option<Option<CycleRecord>> {
        let next = self.peek()?.sequence;
        self.present = if next <= sequence {
            self.next_record()
        } else {
            None
        };
        Some(self.present)
    }
}

struct Comparing {
    axes: Vec<AxisLetter>,
    period_s: f64,
    /// Columns hold jerk as singles.
    columns: bool,
}

impl Comparing {
    fn compare(&self, record: &CycleRecord, setpoint: &Setpoint, verified: &mut Verified, lines: &[String]) {
        verified.compared += 1;
        let Some((quantity, recorded, recomputed)) = self.differs(record, setpoint) else {
            return;
        };
        verified.differing += 1;
        for axis in &self.axes {
            let i = axis.index();
            let off = (record.position[i] - setpoint.position[i]).abs();
            if off > verified.greatest_difference {
                verified.greatest_difference = off;
            }
        }
        if verified.first_difference.is_none() {
            verified.first_difference = Some(Difference {
                sequence: record.sequence,
                time_s: record.sequence as f64 * self.period_s,
                line: record.line,
                text: text_of(lines, record.line),
                quantity,
                recorded,
                recomputed,
            });
        }
    }

    fn differs(&self, record: &CycleRecord, setpoint: &Setpoint) -> Option<(String, f64, f64)> {
        if record.sequence != setpoint.sequence {
            return Some((
                "sequence".to_owned(),
                record.sequence as f64,
                setpoint.sequence as f64,
            ));
        }
        let per_axis = [
            ("position", &record.position, &setpoint.position),
            ("velocity", &record.velocity, &setpoint.velocity),
            ("acceleration", &record.acceleration, &setpoint.acceleration),
            ("jerk", &record.jerk, &setpoint.jerk),
        ];
        for (name, recorded, computed) in per_axis {
            for axis in &self.axes {
                let i = axis.index();
                let computed_i = if self.columns && name == "jerk" {
                    f64::from(computed[i] as f32)
                } else {
                    computed[i]
                };
                if recorded[i].to_bits() != computed_i.to_bits() {
                    return Some((format!("{name} {}", axis.letter()), recorded[i], computed[i]));
                }
            }
        }
        let doubles = [
            ("path_mm", record.path_mm, setpoint.path_mm),
            ("feed_mm_s", record.feed_mm_s, setpoint.feed_mm_s),
            ("override", record.override_, setpoint.feed_override),
        ];
        for (name, recorded, computed) in doubles {
            if recorded.to_bits() != computed.to_bits() {
                return Some((name.to_owned(), recorded, computed));
            }
        }
        let wholes = [
            ("line", record.line, setpoint.line),
            ("state", u32::from(record.state), setpoint.state as u32),
            (
                "flags",
                record.flags & !TIMING_FLAGS,
                setpoint.flags & !TIMING_FLAGS,
            ),
        ];
        wholes
            .into_iter()
            .find(|(_, recorded, computed)| recorded != computed)
            .map(|(name, recorded, computed)| (name.to_owned(), f64::from(recorded), f64::from(computed)))
    }
}
