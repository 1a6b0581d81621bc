//! The threading cycle G76.
//!
//! LinuxCNC's sequence of passes; RS274/NGC has none.

use evolvent_path::{Axes, AxisLetter};

use super::drilling::MAX_REPEATS;
use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::execution::offsets::check_coordinate;
use crate::{Code, MoveKind, PathMode};

/// A thread in program coordinates, mm.
struct ThreadCycle {
    start: Axes,
    /// Z at the end.
    end: f64,
    pitch_mm: f64,
    /// Radial distance from the drive line to the crest of the thread.
    crest: f64,
    /// Direction of X with the depth: -1 for outer threads, 1 for inner ones.
    outward: f64,
    first_depth: f64,
    full_depth: f64,
    degression: f64,
    /// Offset along Z per depth, so that the tool cuts with one flank.
    slope: f64,
    steps: u32,
    spring: u32,
    taper: f64,
    has_entry: bool,
    has_exit: bool,
    starts: u32,
}

impl Executor<'_> {
    /// G76: P pitch, Z end, I from the drive line to the crest, J first depth, K full depth; R degression, Q
    /// angle of the flank along which the tool infeeds, H spring passes, E length and L position of tapers, D
    /// number of starts (P is then the lead of one).
    pub(crate) fn thread_cycle(&mut self) -> Result<(), Fault> {
        let cycle = self.read_thread_cycle()?;
        for pass in 1..=cycle.steps + cycle.spring {
            // All starts at one depth before the next depth.
            for start in 0..cycle.starts {
                let degrees = 360.0 * f64::from(start) / f64::from(cycle.starts);
                self.thread_pass(&cycle, pass, degrees)?;
            }
        }
        let mut end = cycle.start;
        end[2] = cycle.end;
        self.move_to(end, MoveKind::Rapid, PathMode::ExactPath)
    }

    fn read_thread_cycle(&self) -> Result<ThreadCycle, Fault> {
        let line = self.line;
        self.allow_only_axes(b"Z", "G76")?;
        self.check_uncompensated("G76")?;
        let pitch_mm = self.pitch("G76", b'P')?;
        let (Some(crest), Some(first), Some(full)) = (line.word(b'I'), line.word(b'J'), line.word(b'K'))
        else {
            let message = "G76 needs I, J and K: the crest, the first depth and the full depth";
            return Err(Fault::new(Code::WordMissing, line.motion_span(), message));
        };
        let out_of_range = |letter: u8, message: &str| {
            Err(Fault::new(
                Code::OutOfRange,
                line.span(letter),
                message.to_owned(),
            ))
        };
        if crest == 0.0 {
            return out_of_range(
                b'I',
                "G76: I must be below 0 for outer and above 0 for inner threads",
            );
        }
        if first <= 0.0 || full <= 0.0 || first > full {
            return out_of_range(
                b'J',
                "G76: the first depth J must be above 0 and at most the full depth K",
            );
        }
        let degression = line.word(b'R').unwrap_or(1.0);
        if degression < 1.0 {
            return out_of_range(
                b'R',
                "G76: R must be at least 1, which gives passes of equal depth",
            );
        }
        let flank = line.word(b'Q').unwrap_or(0.0);
        if !(0.0..80.0).contains(&flank) {
            return out_of_range(b'Q', "G76: the flank angle Q must be 0 to 80 degrees");
        }
        let spring = line.integer(b'H')?.unwrap_or(0);
        let taper = line.word(b'E').unwrap_or(0.0) * self.state.unit_mm();
        let tapers = line.integer(b'L')?.unwrap_or(0);
        let start = self.state.machine_to_program(self.state.position);
        let end = self.state.machine_to_program(self.target()?)[2];
        if tapers > 3 {
            return out_of_range(b'L', "G76: L must be 0 to 3 (L1 entry, L2 exit, L3 both)");
        }
        if tapers != 0 && line.word(b'E').is_none() {
            let message = "G76 with L needs E, the length of the tapers (L1 entry, L2 exit, L3 both)";
            return Err(Fault::new(Code::WordMissing, line.span(b'L'), message));
        }
        if taper < 0.0 || tapers != 0 && taper == 0.0 {
            return out_of_range(b'E', "G76: the length E of tapers must be above 0");
        }
        if 2.0 * taper > (end - start[2]).abs() {
            return out_of_range(
                b'E',
                "G76: the length E of tapers (L1 entry, L2 exit, L3 both) must be at most half of the thread",
            );
        }
        let starts = line.integer(b'D')?.unwrap_or(1);
        if starts < 1 {
            return out_of_range(b'D', "G76: D, the number of starts, must be at least 1");
        }
        let steps = libm::pow(full / first, degression).ceil();
        if (steps + f64::from(spring)) * f64::from(starts) > f64::from(MAX_REPEATS) {
            return out_of_range(b'J', "G76 with too many passes");
        }
        // X is a diameter in G7, and so are the depths along X.
        let unit = self.state.word_unit(0);
        Ok(ThreadCycle {
            start,
            end,
            pitch_mm,
            crest: crest.abs() * unit,
            outward: if crest < 0.0 { -1.0 } else { 1.0 },
            first_depth: first * unit,
            full_depth: full * unit,
            degression,
            slope: libm::tan(flank.to_radians()),
            steps: steps as u32,
            spring,
            taper,
            has_entry: tapers & 1 == 1,
            has_exit: tapers & 2 == 2,
            starts,
        })
    }

    /// From the drive line in, along the thread, and out again.
    fn thread_pass(&mut self, cycle: &ThreadCycle, pass: u32, degrees: f64) -> Result<(), Fault> {
        let ThreadCycle {
            start,
            outward,
            taper,
            pitch_mm,
            full_depth,
            ..
        } = *cycle;
        let depth = (cycle.first_depth * libm::pow(f64::from(pass), 1.0 / cycle.degression)).min(full_depth);
        let bottom = start[0] + outward * (cycle.crest + depth);
        let crest = bottom - outward * full_depth;
        let clear = start[0] + outward * (depth - full_depth);
        let along = if cycle.end < start[2] { -1.0 } else { 1.0 };
        let begin = start[2] + along * depth * cycle.slope;
        let end = cycle.end - along * (full_depth - depth) * cycle.slope;
        let point = |x: f64, z: f64| {
            let mut at = start;
            (at[0], at[2]) = (x, z);
            at
        };
        // The same distance along Z per turn as in the thread itself.
        let taper_pitch_mm = pitch_mm * libm::hypot(taper, full_depth) / taper.max(f64::MIN_POSITIVE);
        self.move_to(point(clear, begin), MoveKind::Rapid, PathMode::ExactPath)?;
        if cycle.has_entry {
            self.thread_to(point(crest, begin), taper_pitch_mm, degrees, start[0])?;
            self.thread_to(
                point(bottom, begin + along * taper),
                taper_pitch_mm,
                degrees,
                start[0],
            )?;
        } else {
            self.move_to(point(bottom, begin), MoveKind::Rapid, PathMode::ExactPath)?;
        }
        if cycle.has_exit {
            self.thread_to(point(bottom, end - along * taper), pitch_mm, degrees, start[0])?;
            self.thread_to(point(crest, end), taper_pitch_mm, degrees, start[0])?;
        } else {
            self.thread_to(point(bottom, end), pitch_mm, degrees, start[0])?;
        }
        self.move_to(point(clear, end), MoveKind::Rapid, PathMode::ExactPath)
    }

    /// `drive_line`: X of the program at which the tool is clear of the thread.
    pub(super) fn thread_to(
        &mut self,
        program: Axes,
        pitch_mm: f64,
        start_degrees: f64,
        drive_line: f64,
    ) -> Result<(), Fault> {
        let target = self.state.program_to_machine(program);
        for axis in AxisLetter::ALL {
            check_coordinate(target[axis.index()], axis, self.line)?;
        }
        let mut clear = program;
        clear[0] = drive_line;
        let clear_x = self.state.program_to_machine(clear)[0];
        self.emit_thread(target, pitch_mm, start_degrees, Some(clear_x))
    }
}
