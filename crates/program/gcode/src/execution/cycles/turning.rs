//! G82 and G75 of a lathe: longitudinal turning and facing in passes.
//!
//! After the fixed cycles that V. A. Timiryazev, A. V. Mukhin and A. A. Ivanov compare with ("Adaptable control in
//! autoprogramming of cutting tool path on a numerical control lathe"). The tool stands outside the stock, at the corner
//! where the work begins: its X is the stock's surface (or above), its Z before the stock's face.
//!
//! ```text
//!   G82 X Z R L D H             start ───────────┐          G75 X Z K H E
//!                       R,L ╱ ◄───── pass ◄──────┤ D        start ┐ K ┐ K
//!                          ╱ ◄───── pass ◄───────┤                │   │
//!                 X,Z ────┘                      ┘                ▼ pass, one behind the other, to X
//! ```

use evolvent_path::{Axes, AxisLetter};

use crate::codes::modal_groups::{FeedMode, Motion, Turning};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::execution::offsets::check_coordinate;
use crate::{Action, Code, MoveKind, PathMode, TurningWords};

/// How far the tool is pulled off what it has cut before a rapid, mm.
const PULL_OFF_MM: f64 = 0.5;

/// Most passes of a cycle.
const MAX_PASSES: f64 = 100_000.0;

/// Which of the two cycles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TurningKind {
    /// G82: passes along Z, one below the other.
    Longitudinal,
    /// G75: passes along X, one behind the other.
    Facing,
}

/// A turning cycle as data, for a controller that finds its passes itself: from the start to the final contour, in whatever
/// passes the cutting load permits. Machine coordinates in mm; X is a radius. Beginning and end are at `start`.
///
/// A program asks for it by the word Q1 on a machine with a load channel ([`crate::Settings::load_channel`]). Whoever carries
/// it out has to bring the tool back to `start`: the moves that follow begin there. Without a load channel, or without Q1,
/// the cycle comes as plain [`Action::Move`]s in passes of `depth_mm`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurningCycle {
    /// Which way the passes run.
    pub kind: TurningKind,
    /// Where the tool stands: corner of the stock, all axes (mm, degrees).
    pub start: Axes,
    /// Final radius.
    pub x_mm: f64,
    /// End of the step along Z.
    pub z_mm: f64,
    /// G82: the cone that follows the step, from (`x_mm`, `z_mm`) to this radius and Z; none for a square shoulder.
    pub cone_mm: Option<[f64; 2]>,
    /// Depth of a plain pass, if the program gives one: what to fall back on.
    pub depth_mm: Option<f64>,
    /// What is left for the finishing pass, along X and along Z; 0 for none. That pass follows as plain moves.
    pub allowance_mm: f64,
    /// The final diameter as programmed, mm: for the cutting speed. X of the machine has offsets in it.
    pub diameter_mm: f64,
    /// Speed of the spindle, rev/min; 0 where the program has not told it, or G96 is in force.
    pub spindle_rpm: f64,
    /// Programmed speed along Z in mm/s, before override.
    pub feed_mm_s: f64,
    /// Programmed speed along X in mm/s: E of G75, else the same.
    pub cross_feed_mm_s: f64,
}

/// A cycle in program coordinates, mm and radii.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// Where the tool stands.
    x0: f64,
    z0: f64,
    /// The final corner.
    x: f64,
    z: f64,
    cone: Option<[f64; 2]>,
    allowance: f64,
    feed: f64,
    cross_feed: f64,
    /// Away from the axis of the work: +1 for outer turning.
    out: f64,
    /// From the work back to the start along Z.
    back: f64,
}

impl Executor<'_> {
    /// A line with G82 or G75 on a lathe.
    pub(crate) fn turning(&mut self, turning: Turning) -> Result<(), Fault> {
        let line = self.line;
        let name = Motion::Turning(turning).name();
        self.no_axes_but(b"XZUW", name)?;
        if self.state.cutter.is_on() {
            let message = format!("{name} while cutter compensation is on");
            return Err(
                Fault::new(Code::CompensationActive, line.motion_span(), message).help("write G40 first")
            );
        }
        if self.state.modes.feed_mode == FeedMode::InverseTime {
            let message = format!("{name} in G93");
            return Err(Fault::new(Code::WrongMode, line.motion_span(), message)
                .help("cycles need a feed per minute or revolution: G94 or G95"));
        }
        if self.state.rotation[0] != 0.0 {
            return Err(self.wrong_plane("a turning cycle in rotated coordinates"));
        }
        self.check_feed(name)?;
        let step = self.step_of_line(turning, name)?;
        let depth = self.depth_of_pass(turning, name)?;
        let itself = match line.whole(b'Q')? {
            None | Some(0) => false,
            Some(1) => true,
            Some(other) => {
                let message =
                    format!("Q{other}: {name} knows Q0, plain passes, and Q1, passes that the load finds");
                return Err(Fault::new(Code::OutOfRange, line.span(b'Q'), message));
            }
        };
        if itself && self.settings.load_channel {
            return self.hand_on(turning, &step, depth);
        }
        let Some(depth) = depth else {
            let letter = depth_letter(turning);
            let message = format!("{name} needs {letter}, the depth of a pass");
            let help = if itself {
                "Q1 finds the passes itself only where the machine file says load_channel = true"
            } else {
                "D is the depth of a pass of G82, K that of G75, both radii"
            };
            return Err(Fault::new(Code::WordMissing, line.motion_span(), message).help(help));
        };
        if itself {
            self.out(Action::Message(format!(
                "warning: no cutting load is measured, so {name} runs in plain passes"
            )));
        }
        match turning {
            Turning::Longitudinal => self.longitudinal(&step, depth),
            Turning::Facing => self.facing(&step, depth),
        }
    }

    /// X, Z and what goes with them.
    fn step_of_line(&self, turning: Turning, name: &str) -> Result<Step, Fault> {
        let line = self.line;
        let unit = self.state.unit_mm();
        let across = match self.settings.turning_words {
            TurningWords::Diameter => 0.5 * unit,
            TurningWords::Radius => unit,
            TurningWords::Mode => self.state.word_unit(0),
        };
        let here = self.state.program_of(self.state.position);
        let place = |absolute: u8, increment: u8, factor: f64, from: f64, what: &str| match (
            line.word(absolute),
            line.word(increment),
        ) {
            (Some(value), None) if self.state.modes.incremental => Ok(from + value * factor),
            (Some(value), None) => Ok(value * factor),
            (None, Some(value)) => Ok(from + value * factor),
            (Some(_), Some(_)) => {
                let (a, b) = (char::from(absolute), char::from(increment));
                let message = format!("{a} and {b} on one line of {name}");
                Err(Fault::new(Code::TwoUsers, line.span(increment), message)
                    .help("U and W are the increments of X and Z: give one of each pair"))
            }
            (None, None) => {
                let (a, b) = (char::from(absolute), char::from(increment));
                let message = format!("{name} needs {a} or {b}, {what}");
                Err(Fault::new(Code::WordMissing, line.motion_span(), message))
            }
        };
        let x = place(b'X', b'U', across, here[0], "the final diameter")?;
        let z = place(b'Z', b'W', unit, here[2], "the end of the step")?;
        let refuse =
            |letter: u8, message: String| Err(Fault::new(Code::OutOfRange, line.span(letter), message));
        let shown = |value: f64| value / unit;
        if x == here[0] || z == here[2] {
            let message = format!("{name} with nothing to cut: the tool stands at its X or Z");
            return Err(Fault::new(Code::OutOfRange, line.motion_span(), message)
                .help("the tool stands at the corner of the stock before the cycle"));
        }
        let (out, back) = ((here[0] - x).signum(), (here[2] - z).signum());
        let cone = match (line.word(b'R'), line.word(b'L'), turning) {
            (Some(r), Some(l), Turning::Longitudinal) => {
                let cone = [r * across, l * unit];
                if (cone[0] - x) * out < 0.0 || (z - cone[1]) * back < 0.0 {
                    let message = format!(
                        "{name}: the cone from radius {:.4} at Z{:.4} to radius {:.4} at Z{:.4} does not go on outwards",
                        shown(x),
                        shown(z),
                        shown(cone[0]),
                        shown(cone[1])
                    );
                    return refuse(b'R', message);
                }
                Some(cone)
            }
            (None, None, _) | (_, _, Turning::Facing) => None,
            (r, ..) => {
                let (has, lacks) = if r.is_some() { ('R', 'L') } else { ('L', 'R') };
                let message = format!("{name} with {has} but without {lacks}: a cone has both");
                return Err(Fault::new(Code::WordMissing, line.motion_span(), message));
            }
        };
        let allowance = line.word(b'H').unwrap_or(0.0) * unit;
        let room = ((here[0] - x) * out).min((here[2] - z) * back);
        if !(0.0..room).contains(&allowance) {
            let message = format!(
                "H{}: the allowance is at least 0 and below what there is to cut, {:.4}",
                shown(allowance),
                shown(room)
            );
            return refuse(b'H', message);
        }
        let feed = self.speed(1.0, false);
        let cross_feed = match line.word(b'E') {
            Some(e) if e <= 0.0 => return refuse(b'E', format!("E{e}: the feed along X is above 0")),
            Some(e) => match self.state.modes.feed_mode {
                FeedMode::PerRevolution => e * unit * self.state.modes.speed / 60.0,
                _ => e * unit / 60.0,
            },
            None => feed,
        };
        Ok(Step {
            x0: here[0],
            z0: here[2],
            x,
            z,
            cone,
            allowance,
            feed,
            cross_feed,
            out,
            back,
        })
    }

    /// D or K: a radius.
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
            "{}{depth}: the depth of a pass of {name} is above 0",
            char::from(letter)
        );
        Err(Fault::new(Code::OutOfRange, self.line.span(letter), message))
    }

    fn hand_on(&mut self, turning: Turning, step: &Step, depth_mm: Option<f64>) -> Result<(), Fault> {
        let here = self.state.program_of(self.state.position);
        let machine = |x: f64, z: f64| {
            let mut at = here;
            (at[0], at[2]) = (x, z);
            let at = self.state.machine_of(at);
            for axis in [AxisLetter::X, AxisLetter::Z] {
                check_coordinate(at[axis.index()], axis, self.line)?;
            }
            Ok([at[0], at[2]])
        };
        let [x_mm, z_mm] = machine(step.x, step.z)?;
        let cone_mm = step.cone.map(|[x, z]| machine(x, z)).transpose()?;
        let modes = &self.state.modes;
        let spindle_rpm = if modes.surface.is_none() { modes.speed } else { 0.0 };
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
            spindle_rpm,
            feed_mm_s: step.feed,
            cross_feed_mm_s: step.cross_feed,
        };
        self.out(Action::Turning(cycle));
        // What is left is finished as ever, from where the cycle has begun.
        match turning {
            Turning::Longitudinal => self.finish_longitudinal(step)?,
            Turning::Facing => self.finish_facing(step)?,
        }
        self.rapid(step.x0, step.z0)
    }

    /// G82 in plain passes.
    fn longitudinal(&mut self, step: &Step, depth: f64) -> Result<(), Fault> {
        let total = (step.x0 - step.x) * step.out - step.allowance;
        let passes = self.passes(total, depth)?;
        let mut above = step.x0;
        for pass in 1..=passes {
            let x = step.x0 - step.out * (depth * f64::from(pass)).min(total);
            self.rapid(x, step.z0)?;
            self.cut(x, step.end_of(x, step.allowance), step.feed)?;
            // Up the shoulder or the cone, so that no step is left for the next pass.
            self.along_wall(step, x, above, step.allowance)?;
            self.home_from(step, above)?;
            above = x;
        }
        self.finish_longitudinal(step)?;
        self.rapid(step.x0, step.z0)
    }

    /// The finishing pass, if something was left for it.
    fn finish_longitudinal(&mut self, step: &Step) -> Result<(), Fault> {
        if step.allowance > 0.0 {
            self.rapid(step.x, step.z0)?;
            self.cut(step.x, step.z, step.feed)?;
            self.along_wall(step, step.x, step.x0, 0.0)?;
            self.home_from(step, step.x0)?;
        }
        Ok(())
    }

    /// From a point of the wall, shoulder or cone, outwards to `x`.
    fn along_wall(&mut self, step: &Step, from: f64, x: f64, allowance: f64) -> Result<(), Fault> {
        if let Some([r, _]) = step.cone {
            let top = r + step.out * allowance;
            let end = if (x - top) * step.out > 0.0 { top } else { x };
            if (end - from) * step.out > 0.0 {
                self.cut(end, step.end_of(end, allowance), step.feed)?;
            }
        }
        let z = self.state.program_of(self.state.position)[2];
        self.cut(x, z, step.cross_feed)
    }

    /// Off the surface at `x`, and back to where passes begin.
    fn home_from(&mut self, step: &Step, x: f64) -> Result<(), Fault> {
        let z = self.state.program_of(self.state.position)[2];
        let off = x + step.out * PULL_OFF_MM;
        self.rapid(off, z + step.back * PULL_OFF_MM.min((step.z0 - z).abs()))?;
        self.rapid(off, step.z0)
    }

    /// G75 in plain passes.
    fn facing(&mut self, step: &Step, depth: f64) -> Result<(), Fault> {
        let total = (step.z0 - step.z) * step.back - step.allowance;
        let passes = self.passes(total, depth)?;
        let bottom = step.x + step.out * step.allowance;
        let mut before = step.z0;
        for pass in 1..=passes {
            let z = step.z0 - step.back * (depth * f64::from(pass)).min(total);
            self.rapid(step.x0, z)?;
            self.cut(bottom, z, step.cross_feed)?;
            self.cut(bottom, before, step.feed)?;
            let off = before + step.back * PULL_OFF_MM;
            self.rapid(bottom + step.out * PULL_OFF_MM.min((step.x0 - bottom).abs()), off)?;
            self.rapid(step.x0, off)?;
            before = z;
        }
        self.finish_facing(step)?;
        self.rapid(step.x0, step.z0)
    }

    /// The finishing pass, if something was left for it.
    fn finish_facing(&mut self, step: &Step) -> Result<(), Fault> {
        if step.allowance > 0.0 {
            // The step's cylinder, then its face, outwards.
            let off = step.z0 + step.back * PULL_OFF_MM;
            self.rapid(step.x0, off)?;
            self.rapid(step.x, off)?;
            self.cut(step.x, step.z, step.feed)?;
            self.cut(step.x0, step.z, step.cross_feed)?;
        }
        Ok(())
    }

    fn passes(&self, total: f64, depth: f64) -> Result<u32, Fault> {
        // A rounding error is no pass.
        let passes = (total / depth - 1e-9).ceil().max(1.0);
        if passes > MAX_PASSES {
            let message = format!("{passes:.0} passes; at most {MAX_PASSES:.0} are possible");
            return Err(Fault::new(Code::OutOfRange, self.line.motion_span(), message)
                .help("is the depth of a pass (D of G82, K of G75) in the right unit?"));
        }
        Ok(passes as u32)
    }

    fn rapid(&mut self, x: f64, z: f64) -> Result<(), Fault> {
        let at = self.place(x, z);
        self.go(at, MoveKind::Rapid, PathMode::ExactPath)
    }

    fn cut(&mut self, x: f64, z: f64, feed: f64) -> Result<(), Fault> {
        let at = self.place(x, z);
        let before = self.out.len();
        self.go(at, MoveKind::Feed, PathMode::ExactPath)?;
        if self.out.len() > before
            && let Some(last) = self.out.back_mut()
            && let Action::Move(step) = &mut last.action
        {
            step.feed = feed;
        }
        Ok(())
    }

    fn place(&self, x: f64, z: f64) -> Axes {
        let mut at = self.state.program_of(self.state.position);
        (at[0], at[2]) = (x, z);
        at
    }
}

impl Step {
    /// Where a pass at `x` meets the wall, which is `allowance` before the final one along X and Z.
    fn end_of(&self, x: f64, allowance: f64) -> f64 {
        let (x, z) = (x - self.out * allowance, self.z + self.back * allowance);
        match self.cone {
            Some([r, l]) if r != self.x => {
                let share = ((x - self.x) / (r - self.x)).clamp(0.0, 1.0);
                z + share * (l - self.z)
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
