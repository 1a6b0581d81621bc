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

use crate::codes::{FeedMode, Motion, Turning};
use crate::diagnostic::Fault;
use crate::execute::Executor;
use crate::offsets::check_coordinate;
use crate::{Action, Code, MoveKind, PathMode, TurningWords};

/// How far the tool is pulled off what it has cut before a rapid, mm.
const PULL_OFF_MM: f64 = 0.5;

/// Most passes of a cycle.
const MOST_PASSES: f64 = 100_000.0;

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
    /// What is left for the finishing pass, along X and along Z; 0 for none.
    pub allowance_mm: f64,
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
            feed_mm_s: step.feed,
            cross_feed_mm_s: step.cross_feed,
        };
        self.out(Action::Turning(cycle));
        Ok(())
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
        if step.allowance > 0.0 {
            self.rapid(step.x, step.z0)?;
            self.cut(step.x, step.z, step.feed)?;
            self.along_wall(step, step.x, step.x0, 0.0)?;
            self.home_from(step, step.x0)?;
        }
        self.rapid(step.x0, step.z0)
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
        if step.allowance > 0.0 {
            // The step's cylinder, then its face, outwards.
            let off = step.z0 + step.back * PULL_OFF_MM;
            self.rapid(step.x0, off)?;
            self.rapid(step.x, off)?;
            self.cut(step.x, step.z, step.feed)?;
            self.cut(step.x0, step.z, step.cross_feed)?;
        }
        self.rapid(step.x0, step.z0)
    }

    fn passes(&self, total: f64, depth: f64) -> Result<u32, Fault> {
        // A rounding error is no pass.
        let passes = (total / depth - 1e-9).ceil().max(1.0);
        if passes > MOST_PASSES {
            let message = format!("{passes:.0} passes; at most {MOST_PASSES:.0} are possible");
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Diagnostic, Interpreter, Settings};

    fn lathe() -> Settings {
        let mut settings = Settings {
            lathe: true,
            ..Settings::default()
        };
        settings.axes = [true, false, true, false, false, false, false, false, false];
        (settings.start[0], settings.start[2]) = (50.0, 10.0);
        settings
    }

    fn run_with(program: &str, settings: Settings) -> Result<Vec<Action>, Diagnostic> {
        let items = Interpreter::new(program.as_bytes(), settings);
        items.map(|item| item.map(|command| command.action)).collect()
    }

    /// Ends of moves as (X, Z), cut or not, speed in mm/min.
    fn moves(program: &str) -> Vec<(f64, f64, Option<f64>)> {
        let actions = run_with(program, lathe()).unwrap();
        let ends = actions.iter().filter_map(|action| match action {
            Action::Move(step) => {
                let end = step.curve.end();
                let feed = (step.kind == MoveKind::Feed).then_some((step.feed * 60.0).round());
                // To a nanometre: sums of increments.
                Some(((end[0] * 1e6).round() / 1e6, (end[2] * 1e6).round() / 1e6, feed))
            }
            _ => None,
        });
        ends.collect()
    }

    /// The height field that is left of a cylinder from the start, in steps of 0.1 mm: what a tool without width cuts.
    fn left_over(program: &str, x0: f64, z0: f64, length: f64) -> Vec<f64> {
        let actions = run_with(program, lathe()).unwrap();
        let count = (length / 0.1).round() as usize;
        let mut field = vec![x0; count];
        for action in &actions {
            let Action::Move(step) = action else { continue };
            let (a, b) = (step.curve.start(), step.curve.end());
            for (index, height) in field.iter_mut().enumerate() {
                let z = z0 - 0.1 * (index as f64 + 0.5);
                let (low, high) = (a[2].min(b[2]), a[2].max(b[2]));
                if !(low..=high).contains(&z) || low == high {
                    continue;
                }
                let x = a[0] + (b[0] - a[0]) * (z - a[2]) / (b[2] - a[2]);
                if x < *height - 1e-9 {
                    assert_eq!(step.kind, MoveKind::Feed, "a rapid through the stock at Z{z}");
                    *height = x;
                }
            }
        }
        field
    }

    #[test]
    fn a_longitudinal_cycle_runs_in_passes_of_its_depth_and_returns() {
        // From radius 30 to 26 in passes of 3: 27, 26, shoulder at Z-20.
        let program = "G21 G18 F100\nG0 X30 Z1\nG82 X52 Z-20 D3\nM2\n";
        assert_eq!(
            moves(program),
            [
                (30.0, 1.0, None),
                (27.0, 1.0, None),
                (27.0, -20.0, Some(100.0)),
                (30.0, -20.0, Some(100.0)),
                (30.5, -19.5, None),
                (30.5, 1.0, None),
                (26.0, 1.0, None),
                (26.0, -20.0, Some(100.0)),
                (27.0, -20.0, Some(100.0)),
                (27.5, -19.5, None),
                (27.5, 1.0, None),
                (30.0, 1.0, None),
            ]
        );
    }

    #[test]
    fn what_is_left_is_the_contour_with_its_cone_and_rapids_touch_nothing() {
        for (words, allowance) in [("D1.7", 0.0), ("D1.7 H0.4", 0.0), ("D50", 0.0), ("D0.3 H1", 0.0)] {
            let program = format!("G21 G18 F100\nG0 X30 Z1\nG82 X40 Z-20 R54 L-30 {words}\nM2\n");
            let field = left_over(&program, 30.0, 1.0, 40.0);
            for (index, height) in field.iter().enumerate() {
                let z = 1.0 - 0.1 * (index as f64 + 0.5);
                // Cylinder, cone from radius 20 to 27, shoulder, stock.
                let expected = match z {
                    z if z > -20.0 => 20.0,
                    z if z > -30.0 => 20.0 + 7.0 * (-20.0 - z) / 10.0,
                    _ => 30.0,
                };
                assert!(
                    (height - expected - allowance).abs() < 1e-9,
                    "{words}: {height} at Z{z}, not {expected}"
                );
            }
        }
    }

    #[test]
    fn inner_steps_are_turned_outwards() {
        let ends = moves("G21 G18 F100\nG0 X10 Z1\nG82 X26 Z-5 D2 H0.5\nM2\n");
        let cuts: Vec<_> = ends
            .iter()
            .filter(|end| end.2.is_some())
            .map(|end| (end.0, end.1))
            .collect();
        assert_eq!(
            cuts,
            [
                (12.0, -4.5),
                (10.0, -4.5),
                (12.5, -4.5),
                (12.0, -4.5),
                (13.0, -5.0),
                (10.0, -5.0)
            ]
        );
    }

    #[test]
    fn facing_runs_along_x_at_its_own_feed_and_finishes_cylinder_and_face() {
        let ends = moves("G21 G18 F100\nG0 X30 Z0\nG75 X20 Z-5 K3 H1 E60\nM2\n");
        assert_eq!(
            ends,
            [
                (30.0, 0.0, None),
                (30.0, -3.0, None),
                (11.0, -3.0, Some(60.0)),
                (11.0, 0.0, Some(100.0)),
                (11.5, 0.5, None),
                (30.0, 0.5, None),
                (30.0, -4.0, None),
                (11.0, -4.0, Some(60.0)),
                (11.0, -3.0, Some(100.0)),
                (11.5, -2.5, None),
                (30.0, -2.5, None),
                (30.0, 0.5, None),
                (10.0, 0.5, None),
                (10.0, -5.0, Some(100.0)),
                (30.0, -5.0, Some(60.0)),
                (30.0, 0.0, None),
            ]
        );
    }

    #[test]
    fn increments_and_radii_are_as_configured() {
        let absolute = moves("G21 G18 F100\nG0 X30 Z1\nG82 X52 Z-20 D3\nM2\n");
        assert_eq!(moves("G21 G18 F100\nG0 X30 Z1\nG82 U-8 W-21 D3\nM2\n"), absolute);
        assert_eq!(
            moves("G21 G18 F100\nG0 X30 Z1\nG91\nG82 X-8 Z-21 D3\nM2\n"),
            absolute
        );
        for (words, x, mode) in [
            (TurningWords::Radius, "X26", "G8"),
            (TurningWords::Mode, "X26", "G8"),
            (TurningWords::Mode, "X52", "G7"),
        ] {
            let settings = Settings {
                turning_words: words,
                ..lathe()
            };
            let program = format!("G21 G18 F100\nG0 X30 Z1\n{mode}\nG82 {x} Z-20 D3\nM2\n");
            let program2 = "G21 G18 F100\nG0 X30 Z1\nG82 X52 Z-20 D3\nM2\n";
            assert_eq!(
                run_with(&program, settings),
                run_with(program2, lathe()),
                "{words:?}"
            );
        }
    }

    #[test]
    fn a_program_that_asks_for_it_hands_the_cycle_on_where_a_load_is_measured() {
        let program = "G21 G18 F60\nG10 L2 P1 X1 Z2\nG0 X30 Z1\nG82 X40 Z-20 R50 L-25 H0.5 Q1\nG75 X40 Z-5 K2 E30 Q1\nM2\n";
        let with_load = Settings {
            load_channel: true,
            ..lathe()
        };
        let actions = run_with(program, with_load).unwrap();
        let cycles: Vec<_> = actions
            .iter()
            .filter(|action| matches!(action, Action::Turning(_)))
            .collect();
        let mut start = Axes::zeros();
        (start[0], start[2]) = (31.0, 3.0);
        let first = TurningCycle {
            kind: TurningKind::Longitudinal,
            start,
            x_mm: 21.0,
            z_mm: -18.0,
            cone_mm: Some([26.0, -23.0]),
            depth_mm: None,
            allowance_mm: 0.5,
            feed_mm_s: 1.0,
            cross_feed_mm_s: 1.0,
        };
        let second = TurningCycle {
            kind: TurningKind::Facing,
            z_mm: -3.0,
            cone_mm: None,
            depth_mm: Some(2.0),
            allowance_mm: 0.0,
            cross_feed_mm_s: 0.5,
            ..first
        };
        assert_eq!(cycles, [&Action::Turning(first), &Action::Turning(second)]);
        assert!(cycles[0].missing_ability().is_some());
        // Without a load channel: the plain cycle if there is a depth, else an error that says why.
        let error = run_with(program, lathe()).unwrap_err();
        assert_eq!((error.code, error.line), (Code::WordMissing, 4));
        let fallback = run_with("G21 G18 F60\nG0 X30 Z1\nG82 X40 Z-20 D9 Q1\n", lathe()).unwrap();
        assert!(
            fallback
                .iter()
                .any(|action| matches!(action, Action::Message(text) if text.contains("plain")))
        );
    }

    #[test]
    fn what_cannot_be_turned_is_refused_and_a_mill_drills_with_g82() {
        let at = |line: &str| {
            let program = format!("G21 G18 F60\nG0 X30 Z1\n{line}\n");
            run_with(&program, lathe()).map_err(|error| (error.code, error.line))
        };
        for (line, code) in [
            ("G82 X52 Z-20", Code::WordMissing),
            ("G82 Z-20 D1", Code::WordMissing),
            ("G82 X52 D1", Code::WordMissing),
            ("G82 X52 Z-20 D0", Code::OutOfRange),
            ("G82 X52 Z-20 D1 H9", Code::OutOfRange),
            ("G82 X52 Z-20 D1 H-1", Code::OutOfRange),
            ("G82 X52 Z-20 D0.00001", Code::OutOfRange),
            ("G82 X52 Z-20 D1 R54", Code::WordMissing),
            ("G82 X52 Z-20 D1 R40 L-30", Code::OutOfRange),
            ("G82 X52 Z-20 D1 R54 L-10", Code::OutOfRange),
            ("G82 X60 Z-20 D1", Code::OutOfRange),
            ("G82 X52 U-1 Z-20 D1", Code::TwoUsers),
            ("G82 X52 Z-20 D1 Q2", Code::OutOfRange),
            ("G82 X52 Z-20 K1", Code::UnusedWord),
            ("G75 X52 Z-20 D1", Code::UnusedWord),
            ("G75 X52 Z-20 K1 E0", Code::OutOfRange),
            ("G93 G82 X52 Z-20 D1", Code::WrongMode),
            ("G0 U3", Code::NoSuchAxis),
            ("G82 X52 Z-20 V1 D1", Code::NoSuchAxis),
        ] {
            assert_eq!(at(line), Err((code, 3)), "{line}");
        }
        let mill = run_with("G21 F60\nG82 X5 Y5 Z-3 R1 P2\nM2\n", Settings::default()).unwrap();
        assert!(mill.contains(&Action::Dwell { seconds: 2.0 }));
        let error = run_with("G75 X1 Z1\n", Settings::default()).unwrap_err();
        assert_eq!(error.code, Code::UnsupportedG);
    }
}
