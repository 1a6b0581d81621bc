//! Canned cycles: G73, G74, G81 to G89 in G17, G18 and G19.
//!
//! RS274/NGC, 3.5.16, with LinuxCNC's sequence of moves, so that a program leaves the tool at the same
//! position.

use evolvent_path::{Axes, AxisLetter, Plane};

use crate::codes::modal_groups::{Cycle, Motion, PlaneCode};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::execution::offsets::check_coordinate;
use crate::state::machine_state::{ProgrammedFeed, ProgrammedSpeed, SpindleAngle};
use crate::{Action, Code, MoveKind, PathMode, SpindleDirection};

/// Retract for breaking chips, and the distance above the last depth at which the rapid ends: 0.01 inch.
const CHIP_MM: f64 = 0.254;

/// Maximum number of holes of one line.
pub(super) const MAX_REPEATS: u32 = 100_000;

/// Q from which a peck deeper than its hole is probably in micrometres, as in other dialects.
const MIN_SUSPICIOUS_PECK: f64 = 100.0;

/// Pitch below which F of a tapping cycle is probably the pitch, mm. Taps begin at about 0.2 mm.
const MIN_PITCH_MM: f64 = 0.1;

/// Maximum number of pecks of one hole.
const MAX_PECKS: f64 = 100_000.0;

/// Maximum difference of equal heights: those of the tool come from machine coordinates, rounded by offsets.
const HEIGHT_TOLERANCE_MM: f64 = 1e-7;

/// The spindle stop of G87.
const ORIENT_ZERO: SpindleAngle = SpindleAngle {
    degrees: 0.0,
    direction: None,
    timeout_s: 0.0,
};

/// A hole in program coordinates, mm, along the axis of the cycle.
#[derive(Clone, Copy, Debug)]
struct Hole {
    /// Index of the axis.
    drill_axis: usize,
    r: f64,
    bottom: f64,
    /// The final height.
    clear_height: f64,
    q: f64,
    p: f64,
    path_mode: PathMode,
}

impl Executor<'_> {
    /// Executes a line of a drilling cycle.
    pub(crate) fn cycle(&mut self, cycle: Cycle) -> Result<(), Fault> {
        let line = self.line;
        let motion = Motion::Cycle(cycle);
        let name = motion.name();
        let (plane_axes, drill_axis) = match self.state.modes.plane {
            PlaneCode::Main(Plane::Xy) => ([0, 1], 2),
            PlaneCode::Main(Plane::Zx) => ([0, 2], 1),
            PlaneCode::Main(Plane::Yz) => ([1, 2], 0),
            PlaneCode::Secondary(Plane::Xy) => ([6, 7], 8),
            PlaneCode::Secondary(Plane::Zx) => ([6, 8], 7),
            PlaneCode::Secondary(Plane::Yz) => ([7, 8], 6),
        };
        self.allow_only_axes(
            if drill_axis < 3 { b"XYZ" } else { b"UVW" },
            "a cycle in this plane",
        )?;
        if line.has_polar() && drill_axis != 2 {
            return Err(self.wrong_plane("@ and ^ in a cycle"));
        }
        self.check_uncompensated(name)?;
        self.check_feed_of_cycle(name)?;
        self.check_feed(name)?;
        if !line.has_axes() {
            let message = format!("{name} needs an axis word");
            return Err(Fault::new(Code::WordMissing, line.motion_span(), message)
                .help("give the position of the hole by at least one of its axes"));
        }
        let position = self.state.machine_to_program(self.state.programmed());
        let before = self.state.cycle;
        if before.active != Some(motion) {
            // The next cycle of a series keeps the height from which the series began.
            let continues_series = before.active.is_some() && before.drill_axis == drill_axis;
            self.state.cycle = crate::state::machine_state::CycleModal {
                initial_height: if continues_series {
                    before.initial_height
                } else {
                    position[drill_axis]
                },
                drill_axis,
                active: Some(motion),
                ..crate::state::machine_state::CycleModal::default()
            };
        }
        let mut hole = self.hole_of_line(cycle, drill_axis)?;
        let has_dwell = !matches!(
            cycle,
            Cycle::Drill | Cycle::ChipBreak | Cycle::Peck | Cycle::BoreFeed
        );
        if has_dwell && line.has(b'P') {
            self.warn_of_dwell(name, hole.p);
        }
        if cycle.uses_spindle() {
            self.check_spindle(cycle, name)?;
        }
        if matches!(cycle, Cycle::Tap | Cycle::TapLeft) && before.active != Some(motion) {
            self.warn_of_tiny_pitch(name);
        }
        let repeats = self.repeats_of(cycle, &hole, name)?;
        let initial_height = self.state.cycle.initial_height;
        let mut target = position;
        if initial_height < hole.r - HEIGHT_TOLERANCE_MM {
            target[drill_axis] = hole.r;
            self.rapid_to(target, &hole)?;
        }
        hole.clear_height = if self.state.modes.retract_to_initial {
            initial_height.max(hole.r)
        } else {
            hole.r
        };
        for _ in 0..repeats {
            if line.has_polar() {
                self.polar(&mut target)?;
            }
            for axis in plane_axes {
                if let Some(value) = line.axis(axis) {
                    let value = value * self.state.word_unit(axis);
                    target[axis] = if self.state.modes.incremental {
                        target[axis] + value
                    } else {
                        value
                    };
                }
            }
            // Sideways at the present height; at R or below it, at the height to which the cycle retracts.
            if target[drill_axis] <= hole.r + HEIGHT_TOLERANCE_MM {
                target[drill_axis] = hole.clear_height;
            }
            self.rapid_to(target, &hole)?;
            target[drill_axis] = hole.r;
            self.rapid_to(target, &hole)?;
            self.execute_hole(cycle, target, &hole)?;
            target = self.state.machine_to_program(self.state.position);
        }
        Ok(())
    }

    /// The number of holes, with a limit for all pecks of the line.
    fn repeats_of(&mut self, cycle: Cycle, hole: &Hole, name: &str) -> Result<u32, Fault> {
        let line = self.line;
        let repeats = line.integer(b'L')?.unwrap_or(1);
        if repeats == 0 || repeats > MAX_REPEATS {
            let message = format!("L{repeats}: a cycle is repeated 1 to {MAX_REPEATS} times");
            let fault = Fault::new(Code::OutOfRange, line.span(b'L'), message);
            return Err(if repeats == 0 {
                fault.help(
                    "in other dialects L0 stores the words of the cycle without a hole; here, write them on the \
                     line of the first hole, and delete this line",
                )
            } else {
                fault
            });
        }
        if matches!(cycle, Cycle::ChipBreak | Cycle::Peck) && line.has(b'Q') {
            self.warn_of_peck(name, hole);
        }
        let pecks = match cycle {
            Cycle::ChipBreak | Cycle::Peck => (hole.r - hole.bottom) / hole.q,
            _ => 1.0,
        };
        if f64::from(repeats) * pecks > MAX_PECKS {
            let message = format!("{name} with more than {MAX_PECKS} pecks, L{repeats} times {pecks:.0}");
            return Err(Fault::new(Code::OutOfRange, line.span(b'L'), message));
        }
        Ok(repeats)
    }

    /// Warns of a peck that is probably meant in micrometres.
    fn warn_of_peck(&mut self, name: &str, hole: &Hole) {
        let Some(q) = self.line.word(b'Q') else { return };
        if q >= MIN_SUSPICIOUS_PECK && q.fract() == 0.0 && hole.q > hole.r - hole.bottom {
            self.emit(Action::Warning(format!(
                "{name} Q{q} is deeper than the hole, which is drilled without a peck, because Q is a \
                 length in the unit of the program in this dialect; {q} micrometres are Q{}",
                q / 1000.0
            )));
        }
    }

    /// R, depth, Q and P, from the line or from earlier lines.
    fn hole_of_line(&mut self, cycle: Cycle, drill_axis: usize) -> Result<Hole, Fault> {
        let line = self.line;
        let name = Motion::Cycle(cycle).name();
        let unit = self.state.unit_mm();
        let modal = &mut self.state.cycle;
        if let Some(r) = line.word(b'R') {
            modal.r = Some(r * unit);
        }
        if let Some(q) = line.word(b'Q') {
            if q <= 0.0 {
                let message = format!("Q{q}: the depth of a peck must be above 0");
                return Err(Fault::new(Code::OutOfRange, line.span(b'Q'), message));
            }
            modal.q = Some(q * unit);
        }
        if let Some(p) = line.word(b'P') {
            if p < 0.0 {
                return Err(crate::syntax::word_faults::negative('P', p, line.span(b'P')));
            }
            modal.p = Some(p);
        }
        let word_unit = self.state.word_unit(drill_axis);
        let modal = &mut self.state.cycle;
        if let Some(depth) = line.axis(drill_axis) {
            modal.depth = Some(depth * word_unit);
        }
        let modal = *modal;
        let missing = |text: String| Err(Fault::new(Code::WordMissing, line.motion_span(), text));
        let Some(mut r) = modal.r else {
            return missing(format!("{name} needs R, the plane from which the tool feeds"));
        };
        let Some(mut bottom) = modal.depth else {
            let letter = AxisLetter::ALL[drill_axis].letter();
            return missing(format!("{name} needs {letter}, the bottom of the hole"));
        };
        if self.state.modes.incremental {
            r += modal.initial_height;
            bottom += r;
        }
        if r < bottom {
            let message = format!(
                "{name}: R is below the bottom of the hole ({:.4} and {:.4})",
                r / unit,
                bottom / unit
            );
            return Err(Fault::new(Code::OutOfRange, line.motion_span(), message)
                .help("in G91 R is relative to the present height, and the bottom to R"));
        }
        let q = match (cycle, modal.q) {
            (Cycle::ChipBreak | Cycle::Peck, None) => {
                return missing(format!("{name} needs Q, the depth of a peck"));
            }
            (Cycle::ChipBreak | Cycle::Peck, Some(q)) if (r - bottom) / q > MAX_PECKS => {
                let message = format!("{name} with more than {MAX_PECKS} pecks");
                return Err(Fault::new(Code::OutOfRange, line.span(b'Q'), message));
            }
            (_, q) => q.unwrap_or(0.0),
        };
        let p = match (cycle, modal.p) {
            (Cycle::DrillDwell | Cycle::BoreStop | Cycle::BoreManual | Cycle::BoreDwell, None) => {
                return missing(format!("{name} needs P, the time at the bottom in seconds"));
            }
            (_, p) => p.unwrap_or(0.0),
        };
        let path_mode = match self.state.modes.path_mode {
            // Corners of a cycle are not rounded: the bottom of a hole must be reached.
            PathMode::Blend { .. } => PathMode::ExactPath,
            other => other,
        };
        Ok(Hole {
            drill_axis,
            r,
            bottom,
            clear_height: r,
            q,
            p,
            path_mode,
        })
    }

    fn check_spindle(&self, cycle: Cycle, name: &str) -> Result<(), Fault> {
        let direction = self.state.modes.spindles[self.state.modes.active_spindle].direction;
        let message = match (cycle, direction) {
            (_, SpindleDirection::Stopped) => format!("{name}, but the spindle does not turn"),
            (Cycle::Tap, SpindleDirection::CounterClockwise) => {
                format!("{name}, but the spindle turns counter-clockwise")
            }
            (Cycle::TapLeft, SpindleDirection::Clockwise) => {
                format!("{name}, but the spindle turns clockwise")
            }
            _ => return Ok(()),
        };
        Err(
            Fault::new(Code::SpindleSpeedMissing, self.line.motion_span(), message)
                .help("G84 taps right-hand threads with M3, G74 left-hand threads with M4"),
        )
    }

    fn rapid_to(&mut self, program: Axes, hole: &Hole) -> Result<(), Fault> {
        self.move_to(program, MoveKind::Rapid, hole.path_mode)
    }

    /// A straight move to a point in program coordinates. Axes that do not move keep their position bit for
    /// bit.
    pub(crate) fn move_to(
        &mut self,
        program: Axes,
        kind: MoveKind,
        path_mode: PathMode,
    ) -> Result<(), Fault> {
        let position = self.state.machine_to_program(self.state.position);
        let mut target = self.state.program_to_machine(program);
        let moves_xy = program[0] != position[0] || program[1] != position[1];
        for axis in AxisLetter::ALL {
            let index = axis.index();
            let is_coupled = index < 2 && moves_xy && self.state.rotation[0] != 0.0;
            if program[index] == position[index] && !is_coupled {
                target[index] = self.state.position[index];
            }
            check_coordinate(target[index], axis, self.line)?;
        }
        self.emit_line_in_mode(target, kind, path_mode)
    }

    /// Warns of a pitch that no tap has: F was probably meant per revolution.
    fn warn_of_tiny_pitch(&mut self, name: &str) {
        let modes = self.state.modes;
        let speed = modes.spindles[modes.active_spindle].speed;
        let (Some(ProgrammedFeed::PerMinute { linear_mm_s, .. }), ProgrammedSpeed::Rpm(rpm)) =
            (modes.feed, speed)
        else {
            return;
        };
        let feed_mm_min = linear_mm_s * 60.0;
        let pitch_mm = feed_mm_min / rpm;
        if pitch_mm.is_finite() && pitch_mm < MIN_PITCH_MM {
            let feed = feed_mm_min / self.state.unit_mm();
            self.emit(Action::Warning(format!(
                "{name} at F{feed:.4} per minute and S{rpm} has a pitch of {pitch_mm:.4} mm; if F{feed:.4} is \
                 the pitch, write F{:.4}, or G95 before the cycle",
                feed * rpm
            )));
        }
    }

    /// Rigid tapping, synchronised with the spindle angle; the pitch is feed by speed, or the feed per
    /// revolution.
    fn tap_rigidly(&mut self, cycle: Cycle, at: Axes, hole: &Hole) -> Result<(), Fault> {
        let name = Motion::Cycle(cycle).name();
        let modes = self.state.modes;
        let number = modes.active_spindle;
        let speed = modes.spindles[number].speed;
        let pitch_mm = match (modes.feed, speed) {
            (_, ProgrammedSpeed::Surface { .. }) => f64::NAN,
            (Some(ProgrammedFeed::PerRevolution { linear_mm_rev, .. }), _) => linear_mm_rev,
            (Some(ProgrammedFeed::PerMinute { linear_mm_s, .. }), ProgrammedSpeed::Rpm(rpm)) => {
                linear_mm_s * 60.0 / rpm
            }
            (None, _) => 0.0,
        };
        if speed.word() <= 0.0 || !pitch_mm.is_finite() {
            let message = format!("{name} needs a spindle speed, which determines the pitch together with F");
            return Err(
                Fault::new(Code::SpindleSpeedMissing, self.line.motion_span(), message).help(
                    "write S in revolutions per minute (G97); F is S times the pitch, or in G95 the pitch",
                ),
            );
        }
        if hole.p > 0.0 {
            let text = format!("{name}: P has no effect, a rigid tap reverses at the depth without a dwell");
            self.emit(Action::Warning(text));
        }
        let target = self
            .state
            .program_to_machine(at_height(at, hole.drill_axis, hole.bottom));
        for axis in AxisLetter::ALL {
            check_coordinate(target[axis.index()], axis, self.line)?;
        }
        let curve = self.line_to(target)?;
        self.emit(Action::RigidTap {
            spindle: number as u32,
            curve,
            pitch_mm,
            return_factor: 1.0,
        });
        Ok(())
    }

    /// From R down and up again.
    fn execute_hole(&mut self, cycle: Cycle, mut at: Axes, hole: &Hole) -> Result<(), Fault> {
        let (drill_axis, mode) = (hole.drill_axis, hole.path_mode);
        let mut to = |this: &mut Self, height: f64, kind: MoveKind| {
            at[drill_axis] = height;
            this.move_to(at, kind, mode)
        };
        let (feed, rapid) = (MoveKind::Feed, MoveKind::Rapid);
        let direction = self.state.modes.spindles[self.state.modes.active_spindle].direction;
        match cycle {
            Cycle::Drill => {
                to(self, hole.bottom, feed)?;
            }
            Cycle::DrillDwell => {
                to(self, hole.bottom, feed)?;
                self.emit(Action::Dwell { seconds: hole.p });
            }
            Cycle::ChipBreak | Cycle::Peck => {
                let mut depth = hole.r - hole.q;
                while depth > hole.bottom {
                    to(self, depth, feed)?;
                    if cycle == Cycle::Peck {
                        to(self, hole.r, rapid)?;
                    }
                    to(self, depth + CHIP_MM, rapid)?;
                    depth -= hole.q;
                }
                to(self, hole.bottom, feed)?;
            }
            Cycle::BoreFeed => {
                to(self, hole.bottom, feed)?;
                to(self, hole.r, feed)?;
            }
            Cycle::BoreDwell => {
                to(self, hole.bottom, feed)?;
                self.emit(Action::Dwell { seconds: hole.p });
                return to(self, hole.clear_height, feed);
            }
            Cycle::BoreStop => {
                to(self, hole.bottom, feed)?;
                self.emit(Action::Dwell { seconds: hole.p });
                self.set_spindle_direction(SpindleDirection::Stopped);
                to(self, hole.clear_height, rapid)?;
                self.set_spindle_direction(direction);
                return Ok(());
            }
            Cycle::BoreManual => {
                to(self, hole.bottom, feed)?;
                self.emit(Action::Dwell { seconds: hole.p });
                self.set_spindle_direction(SpindleDirection::Stopped);
                self.emit(Action::ProgramStop {
                    optional: false,
                    pallet: false,
                });
                // Resuming needs the axes back at the bottom, so it is this cycle that retracts.
                to(self, hole.clear_height, rapid)?;
                self.set_spindle_direction(direction);
                return Ok(());
            }
            Cycle::Tap | Cycle::TapLeft
                if self.settings.features.rigid_tapping[self.state.modes.active_spindle] =>
            {
                self.tap_rigidly(cycle, at, hole)?;
                return if hole.clear_height == hole.r {
                    Ok(())
                } else {
                    self.move_to(at_height(at, drill_axis, hole.clear_height), rapid, mode)
                };
            }
            Cycle::Tap | Cycle::TapLeft => {
                let modes = self.state.modes;
                self.state.modes.feed_override = false;
                self.state.modes.spindle_override[modes.active_spindle] = false;
                // A feed hold inside would stop the feed but not the spindle.
                self.state.modes.feed_stop = false;
                self.emit_overrides(Some(Motion::Cycle(cycle).name()));
                to(self, hole.bottom, feed)?;
                self.set_spindle_direction(SpindleDirection::Stopped);
                self.set_spindle_direction(match direction {
                    SpindleDirection::Clockwise => SpindleDirection::CounterClockwise,
                    _ => SpindleDirection::Clockwise,
                });
                self.emit(Action::Dwell { seconds: hole.p });
                to(self, hole.clear_height, feed)?;
                self.set_spindle_direction(SpindleDirection::Stopped);
                self.set_spindle_direction(direction);
                self.state.modes.feed_override = modes.feed_override;
                self.state.modes.spindle_override = modes.spindle_override;
                self.state.modes.feed_stop = modes.feed_stop;
                self.emit_overrides(Some(Motion::Cycle(cycle).name()));
                return Ok(());
            }
            Cycle::BackBore => return self.back_bore(at, hole, direction),
        }
        to(self, hole.clear_height, rapid)
    }

    fn set_spindle_direction(&mut self, direction: SpindleDirection) {
        let number = self.state.modes.active_spindle;
        self.state.modes.spindles[number].direction = direction;
        self.emit_spindle(number);
    }

    /// G87: through the hole beside its axis, then boring upwards.
    fn back_bore(&mut self, at: Axes, hole: &Hole, direction: SpindleDirection) -> Result<(), Fault> {
        let line = self.line;
        let drill_axis = hole.drill_axis;
        // U, V and W use I, J and K as X, Y and Z do.
        let first_axis = drill_axis / 6 * 6;
        let shift_axes = match drill_axis - first_axis {
            2 => [(first_axis, b'I'), (first_axis + 1, b'J')],
            1 => [(first_axis, b'I'), (first_axis + 2, b'K')],
            _ => [(first_axis + 1, b'J'), (first_axis + 2, b'K')],
        };
        let depth_letter = b"IJK"[drill_axis - first_axis];
        let (Some(first), Some(second), Some(top)) = (
            line.word(shift_axes[0].1),
            line.word(shift_axes[1].1),
            line.word(depth_letter),
        ) else {
            let message = "G87 needs I, J and K: the offset from the axis and the top of the bore";
            return Err(Fault::new(Code::WordMissing, line.motion_span(), message));
        };
        let unit = self.state.unit_mm();
        let top = if self.state.modes.incremental {
            hole.bottom + top * unit
        } else {
            top * unit
        };
        let mut shifted = at;
        shifted[drill_axis] = hole.r;
        shifted[shift_axes[0].0] += first * unit;
        shifted[shift_axes[1].0] += second * unit;
        let (mut below, mut inside) = (shifted, at);
        below[drill_axis] = hole.bottom;
        inside[drill_axis] = hole.bottom;
        self.move_to(shifted, MoveKind::Rapid, hole.path_mode)?;
        self.set_spindle_direction(SpindleDirection::Stopped);
        self.orient_spindle(self.state.modes.active_spindle, ORIENT_ZERO);
        self.move_to(below, MoveKind::Rapid, hole.path_mode)?;
        self.move_to(inside, MoveKind::Rapid, hole.path_mode)?;
        self.set_spindle_direction(direction);
        let mut end = inside;
        end[drill_axis] = top;
        self.move_to(end, MoveKind::Feed, hole.path_mode)?;
        self.move_to(inside, MoveKind::Feed, hole.path_mode)?;
        self.set_spindle_direction(SpindleDirection::Stopped);
        self.orient_spindle(self.state.modes.active_spindle, ORIENT_ZERO);
        self.move_to(below, MoveKind::Rapid, hole.path_mode)?;
        let mut above = below;
        above[drill_axis] = hole.clear_height;
        self.move_to(above, MoveKind::Rapid, hole.path_mode)?;
        let mut back = at;
        back[drill_axis] = hole.clear_height;
        self.move_to(back, MoveKind::Rapid, hole.path_mode)?;
        self.set_spindle_direction(direction);
        Ok(())
    }
}

/// The same point at another height.
fn at_height(mut at: Axes, drill_axis: usize, height: f64) -> Axes {
    at[drill_axis] = height;
    at
}
