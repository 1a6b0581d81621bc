//! Verification of a served machine: every job is recomputed from its recorded start.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;

use evolvent_gcode::{CanonicalCommand, Diagnostic, Interpreter, PersistentParameters, ToolTable};
use evolvent_motion::{MotionState, flags};
use evolvent_path::Axes;
use evolvent_runtime::{JobStart, Moved, ProgramMemory, ProgramStart, ServedAgain, Setup, Switched};
use evolvent_trace::{CycleRecord, inputs as bits};
use evolvent_turning::LoadSample;
use evolvent_verifier::{Judge, Route};

use super::comparing::Comparing;
use super::lots::{Records, read};
use super::one::recorded_inputs;
use super::signals::{RecordedSignals, tell_difference};
use super::watch::{End, Watch, judged};
use super::*;
use evolvent_inspect::{RecordedJob, before_tool_changes, recorded_jobs, travel_of};

/// The bits that identify the source of motion.
const WHAT_MOVED: u32 = bits::FOLLOWS | bits::STEERS;
/// Maximum number of consecutive missing cycles that are recomputed.
const MAX_MISSING: u64 = 100_000;
/// Maximum number of reasons that are reported individually.
const MAX_REASONS: usize = 10;

struct Served<'a> {
    again: ServedAgain,
    setup: Setup,
    /// A second handle of the file, for the attachments.
    trace: TraceFile,
    starts: VecDeque<RecordedJob>,
    travel: (Axes, Axes),
    comparing: Comparing,
    verified: &'a mut Verified,
    folder: PathBuf,
    lines: Vec<String>,
    /// The source of motion is unknown.
    lost: bool,
    /// The last cycle before a gap.
    last: Option<CycleRecord>,
    /// The last reading of the cutting load.
    load: Option<LoadSample>,
    reasons: usize,
    /// The user was notified that corrections are not recomputed.
    uncorrected_reported: bool,
}

pub(super) fn verify(
    mut opened: Opened,
    path: &Path,
    mut verified: Verified,
) -> Result<Verified, InspectError> {
    let setup = opened.setup()?;
    let limits = setup.machine.limits();
    let starts = recorded_jobs(&mut opened.trace)?;
    let travels = starts
        .iter()
        .map(|start| travel_of(start, &setup.machine))
        .collect();
    let check = LimitCheck::new(&opened.machine, opened.run.period_ns, &limits.home.into());
    let mut watch = Watch::new(check, None, travels);
    if let Some(before) = opened.run.first_sequence().checked_sub(1) {
        watch.last_sequence = Some(before);
        verified.notes.push(format!(
            "the trace continues an earlier file: it starts at cycle {}",
            before + 1
        ));
    }
    let folder = folder()?;
    let RecordedSignals { mut inputs, outputs } = if setup.machine.signals.is_empty() {
        RecordedSignals {
            inputs: Vec::new(),
            outputs: Vec::new(),
        }
    } else {
        RecordedSignals::read(&mut opened.trace)?
    };
    inputs.extend(outputs);
    let mut served = Served {
        again: ServedAgain::new(limits, opened.run.period_ns)
            .with_corrections(&setup.machine)
            .with_signals(&setup, &inputs),
        trace: TraceFile::open(path)?,
        starts,
        travel: (limits.travel_min, limits.travel_max),
        comparing: Comparing {
            axes: opened.run.axes.clone(),
            period_s: opened.period_s(),
            columns: opened.run.columns,
        },
        setup,
        verified: &mut verified,
        folder: folder.path().to_owned(),
        lines: Vec::new(),
        lost: false,
        last: None,
        load: None,
        reasons: 0,
        uncorrected_reported: false,
    };
    let trace = &mut opened.trace;
    let watch = thread::scope(|scope| -> Result<Watch<'_>, InspectError> {
        let (mut records, lots) = read(scope, trace);
        let checker = scope.spawn(move || watch.run(&lots));
        served.all(&mut records)?;
        // A panic of a thread is a bug; it is passed on.
        let watch = checker
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        match records.failure() {
            Some(error) => Err(error.into()),
            None => Ok(watch),
        }
    })?;
    served.compare_outputs();
    let reasons = served.reasons;
    if reasons > MAX_REASONS {
        let more = reasons - MAX_REASONS;
        verified
            .notes
            .push(format!("and {more} more jobs were not recomputed"));
    }
    verified.recomputed = true;
    watch.conclude(&mut verified);
    Ok(verified)
}

impl Served<'_> {
    fn all(&mut self, records: &mut Records) -> Result<(), InspectError> {
        // A file that continues another one begins at an unknown position, which becomes known at rest.
        self.lost = records.peek().is_some_and(|record| record.sequence > 0);
        while let Some(record) = records.peek() {
            let sequence = record.sequence;
            while self.starts.front().is_some_and(|start| start.sequence < sequence) {
                // Its first cycle is missing.
                self.starts.pop_front();
                self.lost = true;
            }
            self.cross_gap(sequence);
            match self.starts.pop_front_if_at(sequence) {
                None => self.one(records, None),
                Some(start) => self.begin(&start, records)?,
            }
        }
        Ok(())
    }

    /// Recomputes missing cycles if the source of motion is the same before and after the gap.
    fn cross_gap(&mut self, sequence: u64) {
        let missing = sequence.saturating_sub(self.again.sequence());
        let Some(last) = self.last.filter(|_| missing > 0 && !self.lost) else {
            return;
        };
        if missing > MAX_MISSING {
            self.lost = true;
            return;
        }
        for _ in 0..missing {
            let moved = moved_by(&last, self.load);
            if self.again.step(&moved, last.override_).is_none() {
                self.lost = true;
                return;
            }
        }
    }

    fn begin(&mut self, start: &RecordedJob, records: &mut Records) -> Result<(), InspectError> {
        self.verified.jobs += 1;
        let (_, low, high) = travel_of(start, &self.setup.machine);
        self.travel = (low, high);
        // Events between jobs at the same cycle come first.
        if let Some(record) = records.peek().copied() {
            self.relocate(&record);
        }
        match &start.start {
            None => {
                self.give_up(start.job, "this version does not understand its initial state");
                self.one(records, None);
            }
            Some(JobStart::Steered(steered)) => {
                let is_known = self.find_position(records);
                if is_known && !steered.is_turn {
                    self.travel = (steered.travel_min, steered.travel_max);
                    self.again.begin_within(self.travel);
                }
                if is_known && let Err(error) = self.again.steer(steered) {
                    self.give_up(start.job, &error.to_string());
                }
                self.one(records, None);
            }
            Some(JobStart::Retrace { back }) => {
                self.retrace(start.job, *back);
                self.one(records, None);
            }
            Some(JobStart::Program(program)) => return self.program(start, program, records),
        }
        Ok(())
    }

    fn retrace(&mut self, job: u32, back: u32) {
        if !self.lost
            && let Err(error) = self.again.retrace(back)
        {
            self.give_up(job, &error.to_string());
        }
    }

    /// Begins a motion of an excursion that was recorded at this cycle. Returns whether there was one.
    fn leave(&mut self, sequence: u64) -> bool {
        let Some(start) = self.starts.front() else {
            return false;
        };
        if start.sequence != sequence {
            return false;
        }
        match start.start.clone() {
            Some(JobStart::Steered(steered)) => {
                if !self.lost
                    && let Err(error) = self.again.steer(&steered)
                {
                    self.give_up(start.job, &error.to_string());
                }
            }
            Some(JobStart::Retrace { back }) => self.retrace(start.job, back),
            _ => return false,
        }
        self.starts.pop_front();
        true
    }

    /// Takes the position of the axes from the previous record, if recomputation does not know it.
    fn find_position(&mut self, records: &mut Records) -> bool {
        if !self.lost {
            return true;
        }
        let (Some(last), Some(next)) = (self.last, records.peek()) else {
            return false;
        };
        let rests = is_at_rest(&last) && last.sequence + 1 == next.sequence;
        if rests {
            self.again
                .restart_at(self.travel, next.sequence, last.position.into(), last.path_mm);
            self.lost = false;
        }
        rests
    }

    fn give_up(&mut self, job: u32, why: &str) {
        self.lost = true;
        self.reason(format!("job {job} was not recomputed: {why}"));
    }

    /// Notes why something was not verified; of many reasons the first.
    fn reason(&mut self, text: String) {
        self.reasons += 1;
        if self.reasons <= MAX_REASONS {
            self.verified.notes.push(text);
        }
    }

    fn program(
        &mut self,
        begun: &RecordedJob,
        start: &ProgramStart,
        records: &mut Records,
    ) -> Result<(), InspectError> {
        let job = begun.job;
        let folder = self.folder.join(format!("job-{job}"));
        let wrong = |source| InspectError::Io {
            what: "a temporary folder for an attached program".to_owned(),
            source,
        };
        std::fs::create_dir_all(&folder).map_err(wrong)?;
        let file = folder.join(file_name(&start.program));
        let mut setup = self.setup.clone();
        let route = match self.prepare(start, &file, &mut setup)? {
            Err(why) => {
                self.give_up(job, &why);
                None
            }
            Ok(text) => {
                self.lines = text
                    .split(|&byte| byte == b'\n')
                    .map(|line| String::from_utf8_lossy(line).trim_end().to_owned())
                    .collect();
                let is_known = self.find_position(records);
                if is_known {
                    let limits = self.setup.machine.limits();
                    let position = &start.position;
                    self.travel = (limits.travel_min.inf(position), limits.travel_max.sup(position));
                    self.again.begin_within(self.travel);
                }
                if is_known
                    && let Err(error) =
                        self.again
                            .follow(start, begun.switched.clone(), setup.clone(), file.clone())
                {
                    self.give_up(job, &error.to_string());
                }
                if start.start_line > 1 {
                    None
                } else {
                    let settings = setup.interpreter_settings_for(&file);
                    // A program with an error has a path up to there, but no reference to compare it with.
                    let start = settings.start;
                    let commands = AsRead {
                        interpreter: Interpreter::new(BufReader::new(text.as_slice()), settings),
                        switched: &begun.switched,
                        commands: 0,
                    };
                    let route = Route::of(commands, start, &self.setup.machine);
                    route
                        .map_err(|error| {
                            let text = format!("the path of job {job} was not checked: {error}");
                            self.reason(text);
                        })
                        .ok()
                }
            }
        };
        let mut judge = route
            .as_ref()
            .map(|route| Judge::new(&self.setup.machine.clone(), self.again.period_ns(), route));
        let (mut max_override, mut end, mut next) = (0.0_f64, End::Stopped, None);
        while let Some(record) = records.peek() {
            let record = *record;
            let goes_on = next.is_none_or(|next| record.sequence == next);
            if next.is_some() && goes_on && record.inputs & WHAT_MOVED == WHAT_MOVED {
                while self.leave(record.sequence) {}
            }
            if record.inputs & bits::FOLLOWS == 0 || !goes_on {
                if !goes_on {
                    judge = None;
                }
                break;
            }
            if next.is_some()
                && self
                    .starts
                    .front()
                    .is_some_and(|start| start.sequence <= record.sequence)
            {
                break;
            }
            next = Some(record.sequence + 1);
            max_override = max_override.max(record.override_);
            end = End::at(&record);
            self.one(records, judge.as_mut());
        }
        if let Some(judge) = judge.filter(|_| next.is_some()) {
            let whose = format!("job {job}: ");
            judged(&judge.finish(), end, max_override, &whose, self.verified);
        }
        if !self.again.is_at_work() {
            // The folder is no longer needed, and there may be many.
            let _left = std::fs::remove_dir_all(&folder);
        }
        Ok(())
    }

    /// Writes the text and the other inputs of a program to their files. Returns the reason if this is not
    /// possible.
    fn prepare(
        &mut self,
        start: &ProgramStart,
        file: &Path,
        setup: &mut Setup,
    ) -> Result<Result<Vec<u8>, String>, InspectError> {
        let Some(text) = self.trace.attachment(&start.program)? else {
            return Ok(Err(format!("its text, {}, is not attached", start.program)));
        };
        write(file, &text)?;
        if let Some(folder) = file.parent() {
            write_subroutines(&mut self.trace, &start.subroutines, folder)?;
        }
        let mut memory = ProgramMemory::default();
        for (name, is_tools) in [(&start.tools, true), (&start.parameters, false)] {
            let Some(name) = name else { continue };
            let Some(bytes) = self.trace.attachment(name)? else {
                return Ok(Err(format!("{name} is not attached")));
            };
            let found = String::from_utf8_lossy(&bytes);
            let parsed = if is_tools {
                ToolTable::parse(&found)
                    .map(|tools| memory.tools = Some(tools))
                    .map_err(|error| error.to_string())
            } else {
                PersistentParameters::parse(&found)
                    .map(|kept| memory.kept = Some(kept))
                    .map_err(|error| error.to_string())
            };
            if let Err(error) = parsed {
                return Ok(Err(format!("{name}: {error}")));
            }
        }
        setup.memory = memory;
        setup.position = Some(start.position);
        setup.tool = start.tool;
        setup.selected_tool = start.selected_tool;
        setup.restored = start.restored;
        setup.outputs = start.outputs.unwrap_or_default();
        setup.is_mdi = start.is_mdi && start.outputs.is_some();
        if start.outputs.is_none() {
            before_tool_changes(&mut setup.machine);
        }
        setup.block_delete = start.switches.block_delete;
        setup.rapid_override = start.switches.rapid_override;
        setup.start_line = (start.start_line > 1).then_some(start.start_line);
        Ok(Ok(text))
    }

    fn relocate(&mut self, record: &CycleRecord) {
        if record.inputs & bits::RELOCATED == 0 || self.lost {
            return;
        }
        let position: Axes = record.position.into();
        self.travel = (self.travel.0.inf(&position), self.travel.1.sup(&position));
        if self.again.is_at_rest() {
            self.again.relocate(self.travel, position);
        }
    }

    /// Takes the next cycle, recomputes it and compares it.
    fn one(&mut self, records: &mut Records, judge: Option<&mut Judge<'_>>) {
        let Some(record) = records.next() else { return };
        if let Some(judge) = judge
            && record.inputs & WHAT_MOVED != WHAT_MOVED
        {
            judge.sample(&record.position.into());
        }
        let moved = moved_by(&record, self.load);
        if let Moved::ByPlan(recorded) | Moved::Away { plan: recorded, .. } = &moved {
            self.load = recorded.inputs.load;
        }
        let by_nothing = matches!(moved, Moved::ByNothing(_));
        if by_nothing && self.lost && is_at_rest(&record) && record.state != MotionState::Stopping as u8 {
            let position = record.position.into();
            self.again
                .restart_at(self.travel, record.sequence, position, record.path_mm);
            self.lost = false;
        }
        self.relocate(&record);
        self.last = Some(record);
        let computed = if self.lost {
            None
        } else {
            self.again.step(&moved, record.override_)
        };
        let Some(mut setpoint) = computed else {
            if !self.lost {
                let cycle = record.sequence;
                self.give_up_at(cycle);
            }
            self.verified.uncompared += 1;
            return;
        };
        let is_corrected = self.comparing.is_corrected(&record);
        if is_corrected && self.again.corrected().is_none() && !self.uncorrected_reported {
            self.uncorrected_reported = true;
            self.verified.notes.push(format!(
                "from cycle {} on the corrected setpoints were only checked against the limits: the \
                 previous directions of the axes are unknown",
                record.sequence
            ));
        }
        if record.state == MotionState::Fault as u8
            && matches!(setpoint.state, MotionState::Stopping | MotionState::Stopped)
        {
            // The drives or the planner had failed, which is not a recorded input.
            setpoint.state = MotionState::Fault;
        }
        if by_nothing {
            setpoint.flags |= record.flags & flags::LAST;
        }
        let same = self.comparing.compare(
            &record,
            &setpoint,
            self.again.corrected(),
            self.verified,
            &self.lines,
        );
        if !same && by_nothing && is_at_rest(&record) {
            // The next job is verified independently.
            let position = record.position.into();
            self.again
                .restart_at(self.travel, record.sequence + 1, position, record.path_mm);
        }
    }

    /// Checks that programs set their outputs with the same setpoints to the same values.
    fn compare_outputs(&mut self) {
        let (count, Some(first)) = self.again.output_differences() else {
            return;
        };
        self.verified.differing += count;
        let settings = &self.setup.machine.signals;
        let name = settings
            .output(first.kind, first.number)
            .map_or_else(|| first.number.to_string(), |output| output.name.clone());
        let difference = Difference {
            sequence: first.sequence,
            time_s: first.sequence as f64 * self.comparing.period_s,
            line: 0,
            text: String::new(),
            quantity: format!("output {name}"),
            recorded: first.recorded,
            recomputed: first.recomputed,
        };
        tell_difference(difference, self.verified);
    }

    fn give_up_at(&mut self, cycle: u64) {
        self.lost = true;
        self.reason(format!(
            "from cycle {cycle} on what moved the axes is unknown: the start of the job is not in the trace"
        ));
    }
}

/// The commands of a program as its planner read them, without the lines that were skipped by the switches at
/// that time.
struct AsRead<'a, R> {
    interpreter: Interpreter<R>,
    switched: &'a VecDeque<Switched>,
    commands: u64,
}

impl<R: BufRead> Iterator for AsRead<'_, R> {
    type Item = Result<CanonicalCommand, Diagnostic>;

    fn next(&mut self) -> Option<Self::Item> {
        for switched in self.switched {
            if switched.command == self.commands {
                self.interpreter.set_block_delete(switched.state.block_delete);
            }
        }
        self.commands += 1;
        self.interpreter.next()
    }
}

/// Takes the first job if it begins with this cycle.
trait AtCycle {
    fn pop_front_if_at(&mut self, sequence: u64) -> Option<RecordedJob>;
}

impl AtCycle for VecDeque<RecordedJob> {
    fn pop_front_if_at(&mut self, sequence: u64) -> Option<RecordedJob> {
        if self.front()?.sequence == sequence {
            self.pop_front()
        } else {
            None
        }
    }
}

fn is_at_rest(record: &CycleRecord) -> bool {
    let still = |values: &[f64; 9]| values.iter().all(|value| *value == 0.0);
    record.inputs & WHAT_MOVED == 0 && still(&record.velocity) && still(&record.acceleration)
}

fn moved_by(record: &CycleRecord, load: Option<LoadSample>) -> Moved {
    if record.inputs & WHAT_MOVED == WHAT_MOVED {
        Moved::Away {
            plan: recorded_inputs(record, load),
            stop: record.inputs & bits::STEERING_STOPS != 0,
        }
    } else if record.inputs & bits::FOLLOWS != 0 {
        Moved::ByPlan(recorded_inputs(record, load))
    } else if record.inputs & bits::STEERS != 0 {
        Moved::ByTransfer {
            stop: record.inputs & bits::STOP != 0,
        }
    } else {
        let fault = record.state == MotionState::Fault as u8;
        Moved::ByNothing(if fault {
            MotionState::Fault
        } else {
            MotionState::Idle
        })
    }
}
