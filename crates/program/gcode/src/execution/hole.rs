//! G12.2 and G13.2: the cycle that mills a hole along involutes.
//!
//! The path is that of [`evolvent_path::Hole`]: at each depth an involute from the centre outwards and one
//! revolution. With an allowance all depths are roughed first, then finished by approach, circle and
//! departure.

use evolvent_path::{Axes, Hole, HoleError, HolePass, HoleStart, Milling, Plane, Sense, depths_mm};

use crate::Code;
use crate::MoveKind;
use crate::codes::modal_groups::{FeedMode, Group};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;

/// A hole according to its line; heights in program coordinates.
struct HoleCycle {
    hole: Hole,
    centre: Axes,
    /// The centre in machine coordinates.
    machine: Axes,
    pitch_mm: f64,
    allowance_mm: f64,
    turns: u32,
    /// Height from which the tool feeds.
    r: f64,
    depths: Vec<f64>,
}

impl HoleCycle {
    /// Roughing, and finishing if there is an allowance for it.
    fn stages(&self) -> &'static [bool] {
        if self.allowance_mm > 0.0 {
            &[false, true]
        } else {
            &[false]
        }
    }

    fn pass(&self, finish: bool, depth: f64) -> Result<HolePass, HoleError> {
        let mut position = self.machine;
        position[2] = self.machine[2] + (depth - self.centre[2]);
        if finish {
            let start = HoleStart::CurvatureRadius(0.5 * self.hole.path_radius_mm(0.0)?);
            self.hole.finish(self.turns, 0.0, start, &position)
        } else {
            let start = HoleStart::Centre;
            self.hole
                .rough(self.pitch_mm, None, self.allowance_mm, start, &position)
        }
    }
}

impl Executor<'_> {
    /// Executes a line with G12.2 (conventional with M3) or G13.2 (climb).
    pub(crate) fn hole(&mut self, sense: Sense) -> Result<(), Fault> {
        let cycle = self.hole_cycle(sense)?;
        // No motion unless all passes are possible.
        let lowest = cycle.depths.last().copied().unwrap_or(cycle.r);
        for &finish in cycle.stages() {
            self.hole_pass(&cycle, finish, lowest)?;
        }
        let position = self.state.machine_to_program(self.state.position);
        let clear_height = if self.state.modes.retract_to_initial {
            position[2].max(cycle.r)
        } else {
            cycle.r
        };
        let mode = self.state.modes.path_mode;
        if position[2] < cycle.r {
            let mut above = position;
            above[2] = cycle.r;
            self.move_to(above, MoveKind::Rapid, mode)?;
        }
        for &finish in cycle.stages() {
            for &depth in &cycle.depths {
                let pass = self.hole_pass(&cycle, finish, depth)?;
                self.pass(&pass, cycle.r)?;
            }
        }
        let mut above = self.state.machine_to_program(self.state.position);
        above[2] = clear_height;
        self.move_to(above, MoveKind::Rapid, mode)?;
        let mut back = above;
        (back[0], back[1]) = (cycle.centre[0], cycle.centre[1]);
        self.move_to(back, MoveKind::Rapid, mode)
    }

    /// Reads the words of the line.
    fn hole_cycle(&mut self, sense: Sense) -> Result<HoleCycle, Fault> {
        let line = self.line;
        let name = if sense == Sense::Clockwise {
            "G12.2"
        } else {
            "G13.2"
        };
        if self.state.plane() != Some(Plane::Xy) {
            return Err(self.wrong_plane(name));
        }
        self.allow_only_axes(b"XYZ", name)?;
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
        let required_mm = |letter: u8, what: &str| {
            line.word(letter).map(|value| value * unit).ok_or_else(|| {
                let message = format!("{name} needs {}, {what}", char::from(letter));
                Fault::new(Code::WordMissing, line.motion_span(), message)
            })
        };
        let diameter_mm = required_mm(b'D', "the diameter of the hole")?;
        let pitch_mm = required_mm(b'Q', "the radial pitch of the involute")?;
        let mut r = required_mm(b'R', "the height from which the tool feeds")?;
        let mut bottom = required_mm(b'Z', "the bottom of the hole")?;
        let allowance_mm = line.word(b'K').unwrap_or(0.0) * unit;
        let tool_diameter_mm = match line.word(b'E') {
            Some(diameter) => diameter * unit,
            None => {
                let tool = self.state.tool;
                self.tool(tool, b'T', Group::Motion)?.diameter_mm
            }
        };
        let position = self.state.machine_to_program(self.state.position);
        if self.state.modes.incremental {
            r += position[2];
            bottom += r;
        }
        let step = line.word(b'I').map_or(r - bottom, |step| step * unit);
        let depths = depths_mm(r, bottom, step).map_err(|error| self.hole_rejected(&error))?;
        let turns = line.integer(b'J')?.unwrap_or(1);
        let mut centre = position;
        for axis in 0..2 {
            if let Some(value) = line.axis(axis) {
                let value = value * self.state.word_unit(axis);
                centre[axis] = if self.state.modes.incremental {
                    position[axis] + value
                } else {
                    value
                };
            }
        }
        let machine = self.state.program_to_machine(centre);
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
        Ok(HoleCycle {
            hole,
            centre,
            machine,
            pitch_mm,
            allowance_mm,
            turns,
            r,
            depths,
        })
    }

    fn hole_rejected(&self, error: &HoleError) -> Fault {
        Fault::new(Code::HoleRefused, self.line.motion_span(), error.to_string()).help(
            "D is the diameter of the hole, E or the tool table that of the tool, Q the pitch, K the \
                   allowance",
        )
    }

    /// The path at one depth.
    fn hole_pass(&self, cycle: &HoleCycle, finish: bool, depth: f64) -> Result<HolePass, Fault> {
        cycle
            .pass(finish, depth)
            .map_err(|error| self.hole_rejected(&error))
    }

    /// One pass at one depth, starting and ending at R.
    fn pass(&mut self, pass: &HolePass, r: f64) -> Result<(), Fault> {
        let Some(first) = pass.blocks.first() else {
            return Ok(());
        };
        let mode = self.state.modes.path_mode;
        let start = first.curve.start();
        let mut above = start;
        above[2] = self.state.position[2];
        self.emit_line(above, MoveKind::Rapid)?;
        let mut position = self.state.machine_to_program(self.state.position);
        position[2] = r;
        self.move_to(position, MoveKind::Rapid, mode)?;
        self.emit_line(start, MoveKind::Feed)?;
        for block in &pass.blocks {
            let feed = self.speed(block.curve.length(), false);
            self.emit_curve(block.curve, MoveKind::Feed, feed, mode)?;
        }
        position = self.state.machine_to_program(self.state.position);
        position[2] = r;
        self.move_to(position, MoveKind::Rapid, mode)
    }
}
