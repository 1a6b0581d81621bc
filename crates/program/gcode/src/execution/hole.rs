//! G12.2 and G13.2: a hole milled along involutes, as a cycle.
//!
//! The path is that of [`evolvent_path::Hole`]: at each depth an involute from the centre out, then once round;
//! with an allowance all depths are roughed first, then finished by an approach, a circle and a departure.

use evolvent_path::{Hole, HoleError, HolePass, HoleStart, Milling, Plane, Sense, depths_mm};

use crate::Code;
use crate::MoveKind;
use crate::codes::modal_groups::{FeedMode, Group};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;

impl Executor<'_> {
    /// A line with G12.2 (conventional with M3) or G13.2 (climb).
    pub(crate) fn hole(&mut self, sense: Sense) -> Result<(), Fault> {
        let line = self.line;
        let name = if sense == Sense::Clockwise {
            "G12.2"
        } else {
            "G13.2"
        };
        if self.state.plane() != Some(Plane::Xy) {
            return Err(self.wrong_plane(name));
        }
        self.no_axes_but(b"XYZ", name)?;
        if self.state.cutter.is_on() {
            let message = format!("{name} while cutter compensation is on");
            return Err(Fault::new(Code::CompensationActive, line.motion_span(), message)
                .help("write G40 first: the cycle knows the tool's diameter"));
        }
        if self.state.modes.feed_mode == FeedMode::InverseTime {
            let message = format!("{name} in G93");
            return Err(Fault::new(Code::WrongMode, line.motion_span(), message).help("write G94 first"));
        }
        self.check_feed(name)?;
        let unit = self.state.unit_mm();
        let need = |letter: u8, what: &str| {
            line.word(letter).map(|value| value * unit).ok_or_else(|| {
                let message = format!("{name} needs {}, {what}", char::from(letter));
                Fault::new(Code::WordMissing, line.motion_span(), message)
            })
        };
        let diameter_mm = need(b'D', "the diameter of the hole")?;
        let pitch_mm = need(b'Q', "the radial pitch of the involute")?;
        let mut r = need(b'R', "the height from which the tool feeds")?;
        let mut bottom = need(b'Z', "the bottom of the hole")?;
        let allowance_mm = line.word(b'K').unwrap_or(0.0) * unit;
        let tool_diameter_mm = match line.word(b'E') {
            Some(diameter) => diameter * unit,
            None => {
                let tool = self.state.tool;
                self.tool(tool, b'T', Group::Motion)?.diameter_mm
            }
        };
        let here = self.state.program_of(self.state.position);
        if self.state.modes.incremental {
            r += here[2];
            bottom += r;
        }
        let refuse = |error: HoleError| {
            Fault::new(Code::HoleRefused, line.motion_span(), error.to_string()).help(
                "D is the hole's diameter, E or the tool table the tool's, Q the pitch, K the allowance",
            )
        };
        let step = line.word(b'I').map_or(r - bottom, |step| step * unit);
        let depths = depths_mm(r, bottom, step).map_err(refuse)?;
        let turns = line.whole(b'J')?.unwrap_or(1);
        let mut centre = here;
        for axis in 0..2 {
            if let Some(value) = line.axis(axis) {
                let value = value * self.state.word_unit(axis);
                centre[axis] = if self.state.modes.incremental {
                    here[axis] + value
                } else {
                    value
                };
            }
        }
        let machine = self.state.machine_of(centre);
        let hole = Hole {
            plane: Plane::Xy,
            centre_mm: [machine[0], machine[1]],
            diameter_mm,
            tool_diameter_mm,
            milling: if sense == Sense::Clockwise {
                Milling::Conventional
            } else {
                Milling::Climb
            },
        };
        let finishing = allowance_mm > 0.0;
        let plan = |finish: bool, depth: f64| -> Result<HolePass, HoleError> {
            let mut at = machine;
            at[2] = machine[2] + (depth - centre[2]);
            if finish {
                let start = HoleStart::CurvatureRadius(0.5 * hole.path_radius_mm(0.0)?);
                hole.finish(turns, 0.0, start, &at)
            } else {
                hole.rough(pitch_mm, None, allowance_mm, HoleStart::Centre, &at)
            }
        };
        // Nothing moves unless the whole hole is possible.
        plan(false, bottom).map_err(refuse)?;
        if finishing {
            plan(true, bottom).map_err(refuse)?;
        }
        let clear = if self.state.modes.retract_to_old {
            here[2].max(r)
        } else {
            r
        };
        let mode = self.state.modes.path_mode;
        if here[2] < r {
            let mut up = here;
            up[2] = r;
            self.go(up, MoveKind::Rapid, mode)?;
        }
        for finish in [false, true] {
            if finish && !finishing {
                break;
            }
            for &depth in &depths {
                let pass = plan(finish, depth).map_err(refuse)?;
                self.pass(&pass, r)?;
            }
        }
        let mut up = self.state.program_of(self.state.position);
        up[2] = clear;
        self.go(up, MoveKind::Rapid, mode)?;
        let mut back = up;
        (back[0], back[1]) = (centre[0], centre[1]);
        self.go(back, MoveKind::Rapid, mode)
    }

    /// One pass at one depth, from R and back there.
    fn pass(&mut self, pass: &HolePass, r: f64) -> Result<(), Fault> {
        let Some(first) = pass.blocks.first() else {
            return Ok(());
        };
        let mode = self.state.modes.path_mode;
        let start = first.curve.start();
        let mut above = start;
        above[2] = self.state.position[2];
        self.put_line(above, MoveKind::Rapid)?;
        let mut at = self.state.program_of(self.state.position);
        at[2] = r;
        self.go(at, MoveKind::Rapid, mode)?;
        self.put_line(start, MoveKind::Feed)?;
        for block in &pass.blocks {
            let feed = self.speed(block.curve.length(), false);
            self.put_curve(block.curve, MoveKind::Feed, feed, mode)?;
        }
        at = self.state.program_of(self.state.position);
        at[2] = r;
        self.go(at, MoveKind::Rapid, mode)
    }
}
