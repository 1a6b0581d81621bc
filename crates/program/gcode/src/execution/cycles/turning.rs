//! G82 and G75 of a lathe: longitudinal turning and facing in passes.
//!
//! After the fixed cycles with which V. A. Timiryazev, A. V. Mukhin and A. A. Ivanov compare ("Adaptable
//! control in autoprogramming of cutting tool path on a numerical control lathe"). The tool starts outside
//! the stock, at the corner where the work starts: its X is the surface of the stock (or above), its Z in
//! front of the face of the stock.
//!
//! ```text
//!   G82 X Z R L D H             start ───────────┐          G75 X Z K H E
//!                       R,L ╱ ◄───── pass ◄──────┤ D        start ┐ K ┐ K
//!                          ╱ ◄───── pass ◄───────┤                │   │
//!                 X,Z ────┘                      ┘                ▼ passes, one after the other, to X
//! ```

use evolvent_path::{Axes, AxisLetter};

use crate::codes::modal_groups::{Motion, Turning};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::execution::offsets::check_coordinate;
use crate::state::machine_state::ProgrammedSpeed;
use crate::{Action, Code, MoveKind, PathMode, TurningWords};

/// Retract of the tool from the cut before a rapid, mm.
const RETRACT_MM: f64 = 0.5;

/// Maximum number of passes of a cycle.
const MAX_PASSES: f64 = 100_000.0;

/// One of the two cycles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TurningKind {
    /// G82: passes along Z, at decreasing radii.
    Longitudinal,
    /// G75: passes along X, one after the other.
    Facing,
}

/// A turning cycle as data, for a controller that determines the passes from the cutting load: from the start
/// to the final contour, in the passes that the load permits. Machine coordinates in mm; X is a radius. It
/// starts and ends at `start`.
///
/// The word Q1 requests it on a machine with a load channel ([`crate::MachineFeatures::load_channel`]). The
/// consumer has to return the tool to `start`, where the following moves start. Without a load channel, or
/// without Q1, the cycle is output as plain [`Action::Move`]s in passes of `depth_mm`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningCycle {
    /// Direction of the passes.
    pub kind: TurningKind,
    /// Position of the tool: the corner of the stock, all axes (mm, degrees).
    pub start: Axes,
    /// Final radius.
    pub x_mm: f64,
    /// End of the step along Z.
    pub z_mm: f64,
    /// G82: the cone after the step, from (`x_mm`, `z_mm`) to this radius and Z; `None` for a square
    /// shoulder.
    pub cone_mm: Option<[f64; 2]>,
    /// Depth of a plain pass as a fallback, if the program gives one.
    pub depth_mm: Option<f64>,
    /// Allowance for the finishing pass, along X and Z; 0 for none. That pass follows as plain moves.
    pub allowance_mm: f64,
    /// The programmed final diameter, mm, for the cutting speed. X of the machine includes offsets.
    pub diameter_mm: f64,
    /// Number of the spindle: that of `$`, otherwise that of the last `$`.
    pub spindle: u32,
    /// Its speed, rev/min; 0 if the program has not set it, or in G96.
    pub spindle_rpm: f64,
    /// Programmed speed along Z in mm/s, before override.
    pub feed_mm_s: f64,
    /// Programmed speed along X in mm/s: E of G75, otherwise the same.
    pub cross_feed_mm_s: f64,
}

/// The words that give the end of a step along one axis.
struct EndWords {
    absolute: u8,
    increment: u8,
    meaning: &'static str,
}

const X_WORDS: EndWords = EndWords {
    absolute: b'X',
    increment: b'U',
    meaning: "the final diameter",
};
const Z_WORDS: EndWords = EndWords {
    absolute: b'Z',
    increment: b'W',
    meaning: "the end of the step",
};

/// The feed of a cut.
#[derive(Clone, Copy, Debug)]
struct CutFeed {
    mm_s: f64,
    /// In G95.
    mm_rev: Option<f64>,
}

/// A cycle in program coordinates, mm and radii.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// Position of the tool.
    x0: f64,
    z0: f64,
    /// The final corner.
    x: f64,
    z: f64,
    cone: Option<[f64; 2]>,
    allowance: f64,
    feed: CutFeed,
    cross_feed: CutFeed,
    /// Direction away from the axis of the work: +1 for outer turning.
    outward: f64,
    /// Direction along Z from the work back to the start.
    backward: f64,
}

impl Executor<'_> {
    /// Executes a line with G82 or G75 on a lathe.
    pub(crate) fn turning(&mut self, turning: Turning) -> Result<(), Fault> {
        let line = self.line;
        let name = Motion::Turning(turning).name();
        self.allow_only_axes(b"XZUW", name)?;
        self.check_uncompensated(name)?;
        self.check_feed_of_cycle(name)?;
        if self.state.rotation[0] != 0.0 {
            return Err(self.wrong_plane("a turning cycle in rotated coordinates"));
        }
        self.check_feed(name)?;
        let step = self.step_of_line(turning, name)?;
        let depth = self.depth_of_pass(turning, name)?;
        let load_adaptive = match line.integer(b'Q')? {
            None | Some(0) => false,
            Some(1) => true,
            Some(other) => {
                let message =
                    format!("Q{other}: {name} supports Q0, plain passes, and Q1, load-adaptive passes");
                return Err(self.out_of_range(b'Q', message));
            }
        };
        if load_adaptive && self.settings.features.load_channel {
            return self.output_cycle(turning, &step, depth);
        }
        let Some(depth) = depth else {
            let letter = depth_letter(turning);
            let message = format!("{name} needs {letter}, the depth of a pass");
            let help = if load_adaptive {
                "Q1, load-adaptive passes, requires load_channel = true in the machine file"
            } else {
                "D is the depth of a pass of G82, K that of G75, both radii"
            };
            return Err(Fault::new(Code::WordMissing, line.motion_span(), message).help(help));
        };
        if load_adaptive {
            self.emit(Action::Message(format!(
                "warning: no cutting load is measured, so {name} runs in plain passes"
            )));
        }
        match turning {
            Turning::Longitudinal => self.longitudinal(&step, depth),
            Turning::Facing => self.facing(&step, depth),
        }
    }

    /// X, Z and related words.
    fn step_of_line(&self, turning: Turning, name: &str) -> Result<Step, Fault> {
        let unit = self.state.unit_mm();
        let across = match self.settings.features.turning_words {
            TurningWords::Diameter => 0.5 * unit,
            TurningWords::Radius => unit,
            TurningWords::Mode => self.state.word_unit(0),
        };
        let position = self.state.machine_to_program(self.state.position);
        let x = self.end_of_step(&X_WORDS, across, position[0], name)?;
        let z = self.end_of_step(&Z_WORDS, unit, position[2], name)?;
        if x == position[0] || z == position[2] {
            let message = format!("{name} with nothing to cut: the tool is at its X or Z");
            return Err(Fault::new(Code::OutOfRange, self.line.motion_span(), message)
                .help("the tool must be at the corner of the stock before the cycle"));
        }
        let feed = CutFeed {
            mm_s: self.speed(1.0, false),
            mm_rev: self.state.modes.feed.and_then(|feed| feed.per_revolution(false)),
        };
        let square = Step {
            x0: position[0],
            z0: position[2],
            x,
            z,
            cone: None,
            allowance: 0.0,
            feed,
            cross_feed: feed,
            outward: (position[0] - x).signum(),
            backward: (position[2] - z).signum(),
        };
        Ok(Step {
            cone: match turning {
                Turning::Longitudinal => self.cone_of_line(&square, across, name)?,
                Turning::Facing => None,
            },
            allowance: self.allowance_of_line(&square)?,
            cross_feed: self.cross_feed_of_line(feed)?,
            ..square
        })
    }

    /// The end along one axis in program coordinates, mm. The tool is at `from`. `factor`: mm per unit of a word.
    fn end_of_step(&self, words: &EndWords, factor: f64, from: f64, name: &str) -> Result<f64, Fault> {
        let line = self.line;
        let (a, b) = (char::from(words.absolute), char::from(words.increment));
        match (line.word(words.absolute), line.word(words.increment)) {
            (Some(value), None) if self.state.modes.incremental => Ok(from + value * factor),
            (Some(value), None) => Ok(value * factor),
            (None, Some(value)) => Ok(from + value * factor),
            (Some(_), Some(_)) => {
                let message = format!("{a} and {b} on one line of {name}");
                Err(Fault::new(Code::TwoUsers, line.span(words.increment), message)
                    .help("U and W are the increments of X and Z: give one of each pair"))
            }
            (None, None) => {
                let message = format!("{name} needs {a} or {b}, {}", words.meaning);
                Err(Fault::new(Code::WordMissing, line.motion_span(), message))
            }
        }
    }

    /// R and L of G82: the end of a cone.
    fn cone_of_line(&self, step: &Step, across: f64, name: &str) -> Result<Option<[f64; 2]>, Fault> {
        let (line, unit) = (self.line, self.state.unit_mm());
        let (r, l) = match (line.word(b'R'), line.word(b'L')) {
            (Some(r), Some(l)) => (r * across, l * unit),
            (None, None) => return Ok(None),
            (r, _) => {
                let (has, lacks) = if r.is_some() { ('R', 'L') } else { ('L', 'R') };
                let message = format!("{name} with {has} but without {lacks}: a cone needs both");
                return Err(Fault::new(Code::WordMissing, line.motion_span(), message));
            }
        };
        if (r - step.x) * step.outward < 0.0 || (step.z - l) * step.backward < 0.0 {
            let message = format!(
                "{name}: the cone from radius {:.4} at Z{:.4} to radius {:.4} at Z{:.4} does not continue \
                 outwards",
                step.x / unit,
                step.z / unit,
                r / unit,
                l / unit
            );
            return Err(self.out_of_range(b'R', message));
        }
        Ok(Some([r, l]))
    }

    /// H, mm.
    fn allowance_of_line(&self, step: &Step) -> Result<f64, Fault> {
        let unit = self.state.unit_mm();
        let allowance = self.line.word(b'H').unwrap_or(0.0) * unit;
        let available = ((step.x0 - step.x) * step.outward).min((step.z0 - step.z) * step.backward);
        if !(0.0..available).contains(&allowance) {
            let message = format!(
                "H{}: the allowance must be at least 0 and below the depth to be cut, {:.4}",
                allowance / unit,
                available / unit
            );
            return Err(self.out_of_range(b'H', message));
        }
        Ok(allowance)
    }

    /// E, the feed along X; `feed` without it.
    fn cross_feed_of_line(&self, feed: CutFeed) -> Result<CutFeed, Fault> {
        let Some(e) = self.line.word(b'E') else {
            return Ok(feed);
        };
        if e <= 0.0 {
            return Err(self.out_of_range(b'E', format!("E{e}: the feed along X must be above 0")));
        }
        let unit = self.state.unit_mm();
        Ok(if feed.mm_rev.is_some() {
            CutFeed {
                mm_s: e * unit * self.state.feed_rpm() / 60.0,
                mm_rev: Some(e * unit),
            }
        } else {
            CutFeed {
                mm_s: e * unit / 60.0,
                mm_rev: None,
            }
        })
    }

    fn out_of_range(&self, letter: u8, message: String) -> Fault {
        Fault::new(Code::OutOfRange, self.line.span(letter), message)
    }

    /// D or K, a radius.
    fn depth_of_pass(&self, turning: Turning, name: &str) -> Result<Option<f64>, Fault> {
        let letter = depth_letter(turning) as u8;
        let Some(depth) = self.line.word(letter) else {
            return Ok(None);
        };
        let depth_mm = depth * self.state.unit_mm();
        if depth_mm > 0.0 {
            return Ok(Some(depth_mm));
        }
        let message = format!(
            "{}{depth}: the depth of a pass of {name} must be above 0",
            char::from(letter)
        );
        Err(self.out_of_range(letter, message))
    }

    fn output_cycle(&mut self, turning: Turning, step: &Step, depth_mm: Option<f64>) -> Result<(), Fault> {
        let position = self.state.machine_to_program(self.state.position);
        let to_machine = |x: f64, z: f64| {
            let mut at = position;
            (at[0], at[2]) = (x, z);
            let at = self.state.program_to_machine(at);
            for axis in [AxisLetter::X, AxisLetter::Z] {
                check_coordinate(at[axis.index()], axis, self.line)?;
            }
            Ok([at[0], at[2]])
        };
        let [x_mm, z_mm] = to_machine(step.x, step.z)?;
        let cone_mm = step.cone.map(|[x, z]| to_machine(x, z)).transpose()?;
        let modes = &self.state.modes;
        let spindle = modes.active_spindle;
        let spindle_rpm = match modes.spindles[spindle].speed {
            ProgrammedSpeed::Rpm(rpm) => rpm,
            ProgrammedSpeed::Surface { .. } => 0.0,
        };
        let cycle = TurningCycle {
            kind: match turning {
                Turning::Longitudinal => TurningKind::Longitudinal,
                Turning::Facing => TurningKind::Facing,
            },
            start: self.state.position,
            x_mm,
            z_mm,
            cone_mm,
            depth_mm,
            allowance_mm: step.allowance,
            diameter_mm: 2.0 * step.x.abs(),
            spindle: spindle as u32,
            spindle_rpm,
            feed_mm_s: step.feed.mm_s,
            cross_feed_mm_s: step.cross_feed.mm_s,
        };
        self.emit(Action::Turning(cycle));
        // The allowance is finished as usual, from the start of the cycle.
        match turning {
            Turning::Longitudinal => self.finish_longitudinal(step)?,
            Turning::Facing => self.finish_facing(step)?,
        }
        self.rapid(step.x0, step.z0)
    }

    /// G82 in plain passes.
    fn longitudinal(&mut self, step: &Step, depth: f64) -> Result<(), Fault> {
        let total = (step.x0 - step.x) * step.outward - step.allowance;
        let pass_count = self.pass_count(total, depth)?;
        let mut previous_x = step.x0;
        for pass in 1..=pass_count {
            let x = step.x0 - step.outward * (depth * f64::from(pass)).min(total);
            self.rapid(x, step.z0)?;
            self.cut(x, step.wall_z(x, step.allowance), step.feed)?;
            // Up the shoulder or the cone, so that no step remains for the next pass.
            self.cut_wall(step, x, previous_x, step.allowance)?;
            self.retract_to_start(step, previous_x)?;
            previous_x = x;
        }
        self.finish_longitudinal(step)?;
        self.rapid(step.x0, step.z0)
    }

    /// The finishing pass, if there is an allowance.
    fn finish_longitudinal(&mut self, step: &Step) -> Result<(), Fault> {
        if step.allowance > 0.0 {
            self.rapid(step.x, step.z0)?;
            self.cut(step.x, step.z, step.feed)?;
            self.cut_wall(step, step.x, step.x0, 0.0)?;
            self.retract_to_start(step, step.x0)?;
        }
        Ok(())
    }

    /// From a point of the wall, shoulder or cone, outwards to `x`.
    fn cut_wall(&mut self, step: &Step, from: f64, x: f64, allowance: f64) -> Result<(), Fault> {
        if let Some([r, _]) = step.cone {
            let top = r + step.outward * allowance;
            let end = if (x - top) * step.outward > 0.0 { top } else { x };
            if (end - from) * step.outward > 0.0 {
                self.cut(end, step.wall_z(end, allowance), step.feed)?;
            }
        }
        let z = self.state.machine_to_program(self.state.position)[2];
        self.cut(x, z, step.cross_feed)
    }

    /// Retracts from the surface at `x`, and returns to the start of the passes.
    fn retract_to_start(&mut self, step: &Step, x: f64) -> Result<(), Fault> {
        let z = self.state.machine_to_program(self.state.position)[2];
        let clear = x + step.outward * RETRACT_MM;
        self.rapid(clear, z + step.backward * RETRACT_MM.min((step.z0 - z).abs()))?;
        self.rapid(clear, step.z0)
    }

    /// G75 in plain passes.
    fn facing(&mut self, step: &Step, depth: f64) -> Result<(), Fault> {
        let total = (step.z0 - step.z) * step.backward - step.allowance;
        let pass_count = self.pass_count(total, depth)?;
        let bottom = step.x + step.outward * step.allowance;
        let mut previous_z = step.z0;
        for pass in 1..=pass_count {
            let z = step.z0 - step.backward * (depth * f64::from(pass)).min(total);
            self.rapid(step.x0, z)?;
            self.cut(bottom, z, step.cross_feed)?;
            self.cut(bottom, previous_z, step.feed)?;
            let clear = previous_z + step.backward * RETRACT_MM;
            self.rapid(
                bottom + step.outward * RETRACT_MM.min((step.x0 - bottom).abs()),
                clear,
            )?;
            self.rapid(step.x0, clear)?;
            previous_z = z;
        }
        self.finish_facing(step)?;
        self.rapid(step.x0, step.z0)
    }

    /// The finishing pass, if there is an allowance.
    fn finish_facing(&mut self, step: &Step) -> Result<(), Fault> {
        if step.allowance > 0.0 {
            // The cylinder of the step, then its face, outwards.
            let clear = step.z0 + step.backward * RETRACT_MM;
            self.rapid(step.x0, clear)?;
            self.rapid(step.x, clear)?;
            self.cut(step.x, step.z, step.feed)?;
            self.cut(step.x0, step.z, step.cross_feed)?;
        }
        Ok(())
    }

    fn pass_count(&self, total: f64, depth: f64) -> Result<u32, Fault> {
        // Rounding must not add a pass.
        let pass_count = (total / depth - 1e-9).ceil().max(1.0);
        if pass_count > MAX_PASSES {
            let message = format!("{pass_count:.0} passes; at most {MAX_PASSES:.0} are possible");
            return Err(Fault::new(Code::OutOfRange, self.line.motion_span(), message)
                .help("check the unit of the depth of a pass (D of G82, K of G75)"));
        }
        Ok(pass_count as u32)
    }

    fn rapid(&mut self, x: f64, z: f64) -> Result<(), Fault> {
        let at = self.point(x, z);
        self.move_to(at, MoveKind::Rapid, PathMode::ExactPath)
    }

    fn cut(&mut self, x: f64, z: f64, feed: CutFeed) -> Result<(), Fault> {
        let at = self.point(x, z);
        let before = self.commands.len();
        self.move_to(at, MoveKind::Feed, PathMode::ExactPath)?;
        if self.commands.len() > before
            && let Some(last) = self.commands.back_mut()
            && let Action::Move(step) = &mut last.action
        {
            step.feed_mm_s = feed.mm_s;
            last.feed_mm_rev = feed.mm_rev;
            last.feed_spindle = self.state.modes.feed_spindle as u32;
        }
        Ok(())
    }

    fn point(&self, x: f64, z: f64) -> Axes {
        let mut at = self.state.machine_to_program(self.state.position);
        (at[0], at[2]) = (x, z);
        at
    }
}

impl Step {
    /// Position along Z at which a pass at `x` meets the wall, `allowance` before the final wall along X and
    /// Z.
    fn wall_z(&self, x: f64, allowance: f64) -> f64 {
        let (x, z) = (x - self.outward * allowance, self.z + self.backward * allowance);
        match self.cone {
            Some([r, l]) if r != self.x => {
                let fraction = ((x - self.x) / (r - self.x)).clamp(0.0, 1.0);
                z + fraction * (l - self.z)
            }
            _ => z,
        }
    }
}

fn depth_letter(turning: Turning) -> char {
    match turning {
        Turning::Longitudinal => 'D',
        Turning::Facing => 'K',
    }
}
