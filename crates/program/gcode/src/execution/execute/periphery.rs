//! Spindle, coolant and outputs of a line.

use super::{Executor, Request};
use crate::codes::modal_groups::{GCode, Group, MCode};
use crate::diagnostics::diagnostic::Fault;
use crate::parameters::values::INPUT_RESULT;
use crate::state::machine_state::{ProgrammedSpeed, SpindleAngle};
use crate::{Action, Code, SPINDLES, SpindleDirection};

impl Executor<'_> {
    #[inline]
    pub(super) fn has_periphery(&self) -> bool {
        let line = self.line;
        line.has_m() || line.has(b'S') || line.has(b'T') || line.g(Group::SpindleMode).is_some()
    }

    /// Spindle, tools, coolant, outputs.
    pub(super) fn periphery(&mut self) -> Result<Option<Request>, Fault> {
        let line = self.line;
        let number = line.spindle();
        let was_surface = self.state.modes.spindles[number].speed.is_surface();
        self.spindle_mode(number)?;
        if let Some(speed) = line.word(b'S') {
            // Feet per minute in G20.
            let unit_m = if self.state.modes.inches { 0.3048 } else { 1.0 };
            for number in self.selected_spindles() {
                match &mut self.state.modes.spindles[number].speed {
                    ProgrammedSpeed::Rpm(rpm) => *rpm = speed,
                    ProgrammedSpeed::Surface { speed_m_min, .. } => *speed_m_min = unit_m * speed,
                }
            }
        }
        if let Some(tool) = line.integer(b'T')? {
            self.reject_unknown_tool(tool, line.span(b'T'))?;
            self.state.selected_tool = Some(tool);
            self.state.pockets.select(tool, self.tools.as_ref());
            self.emit(Action::SelectTool(tool));
        }
        self.outputs()?;
        let changer = self.tool_change()?;
        let turned = line.m(Group::Spindle);
        let direction = match turned {
            Some(MCode::SpindleClockwise) => Some(SpindleDirection::Clockwise),
            Some(MCode::SpindleCounterClockwise) => Some(SpindleDirection::CounterClockwise),
            Some(MCode::SpindleStop) => Some(SpindleDirection::Stopped),
            _ => None,
        };
        let is_surface = self.state.modes.spindles[number].speed.is_surface();
        if turned == Some(MCode::SpindleOrient) {
            self.orient()?;
        } else if turned.is_some()
            || line.has(b'S')
            || line.g(Group::SpindleMode).is_some() && (was_surface || is_surface)
        {
            for number in self.selected_spindles() {
                if let Some(direction) = direction {
                    self.state.modes.spindles[number].direction = direction;
                }
                self.emit_spindle(number);
            }
        }
        let request = line.m(Group::Modes).map(Request::Modes).or(changer);
        if let Some(coolant) = line.m(Group::Coolant) {
            let modes = &mut self.state.modes;
            match coolant {
                MCode::Mist => modes.mist = true,
                MCode::Flood => modes.flood = true,
                _ => (modes.mist, modes.flood) = (false, false),
            }
            self.emit_coolant();
        }
        self.overrides()?;
        if let Some(MCode::User(number)) = line.m(Group::User) {
            let (p, q) = (line.word(b'P'), line.word(b'Q'));
            self.emit(Action::UserCommand { number, p, q });
        }
        Ok(request)
    }

    /// G96 and G97.
    fn spindle_mode(&mut self, number: usize) -> Result<(), Fault> {
        let line = self.line;
        let Some(GCode::ConstantSurfaceSpeed(on)) = line.g(Group::SpindleMode) else {
            return Ok(());
        };
        self.state.modes.active_spindle = number;
        if on && !line.has(b'S') {
            let span = line.group_span(Group::SpindleMode);
            return Err(
                Fault::new(Code::WordMissing, span, "G96 needs S, the surface speed")
                    .help("in metres per minute, or feet per minute in G20"),
            );
        }
        if let Some(limit) = line.word(b'D').filter(|_| on) {
            let span = line.span(b'D');
            if limit < 0.0 {
                return Err(crate::syntax::word_faults::negative('D', limit, span));
            }
            if limit == 0.0 {
                return Err(
                    Fault::new(Code::SpindleSpeedMissing, span, "D0 permits no spindle speed")
                        .help("D is the maximum speed in rpm; leave it out for that of the machine"),
                );
            }
        }
        if on {
            let limit = line.word(b'D').unwrap_or(f64::INFINITY);
            self.state.modes.spindles[number].speed = ProgrammedSpeed::Surface {
                speed_m_min: 0.0,
                max_rpm: limit.min(self.settings.features.spindle_max_rpm[number]),
            };
        } else if self.state.modes.spindles[number].speed.is_surface() {
            // Without S the spindle keeps its present speed.
            self.state.modes.spindles[number].speed = ProgrammedSpeed::Rpm(self.state.rpm(number));
        }
        Ok(())
    }

    /// The spindles of the line: that of `$`, 0 without it; with `$-1` all spindles of the machine.
    fn selected_spindles(&self) -> impl Iterator<Item = usize> + use<> {
        let (all, one) = (self.line.selects_all_spindles(), self.line.spindle());
        let exists = self.settings.features.spindles;
        (0..SPINDLES).filter(move |&number| if all { exists[number] } else { number == one })
    }

    pub(crate) fn emit_spindle(&mut self, number: usize) {
        self.state.modes.spindles[number].output_centre_mm = self.state.centre_mm();
        self.state.modes.spindles[number].orientation = None;
        self.emit(self.state.spindle_action(number));
    }

    /// Orients a stopped spindle.
    pub(crate) fn orient_spindle(&mut self, number: usize, angle: SpindleAngle) {
        let spindle = &mut self.state.modes.spindles[number];
        spindle.direction = SpindleDirection::Stopped;
        spindle.orientation = Some(angle);
        self.emit(angle.action(number));
    }

    /// Updates the centre of the radius of G96, which offsets may have moved.
    pub(super) fn update_surface_centre(&mut self) {
        for number in 0..SPINDLES {
            let spindle = &self.state.modes.spindles[number];
            if spindle.speed.is_surface()
                && spindle.is_rotating()
                && spindle.output_centre_mm != self.state.centre_mm()
            {
                self.emit_spindle(number);
            }
        }
    }

    pub(crate) fn emit_coolant(&mut self) {
        let modes = self.state.modes;
        self.emit(Action::Coolant {
            mist: modes.mist,
            flood: modes.flood,
        });
    }

    fn orient(&mut self) -> Result<(), Fault> {
        let line = self.line;
        let degrees = line.word(b'R').unwrap_or(0.0);
        if !(0.0..=360.0).contains(&degrees) {
            let message = format!("R{degrees}: M19 turns the spindle to 0 to 360 degrees");
            return Err(Fault::new(Code::OutOfRange, line.span(b'R'), message));
        }
        if let Some(speed) = line.word(b'S')
            && !line.has(b'R')
            && (0.0..=360.0).contains(&speed)
        {
            // Valid, but postprocessors for other controls write the angle in this form.
            self.emit(Action::Warning(format!(
                "M19 S{speed} turns the spindle to 0 degrees and sets its speed: write M19 R{speed} for an \
                 angle"
            )));
        }
        let direction = match line.integer(b'P')? {
            None | Some(0) => None,
            Some(1) => Some(SpindleDirection::Clockwise),
            Some(2) => Some(SpindleDirection::CounterClockwise),
            Some(other) => {
                let message =
                    format!("P{other}: M19 supports P0 the shorter way, P1 clockwise, P2 counter-clockwise");
                return Err(Fault::new(Code::OutOfRange, line.span(b'P'), message));
            }
        };
        let timeout_s = line.word(b'Q').unwrap_or(0.0);
        if timeout_s < 0.0 {
            return Err(crate::syntax::word_faults::negative(
                'Q',
                timeout_s,
                line.span(b'Q'),
            ));
        }
        let angle = SpindleAngle {
            degrees,
            direction,
            timeout_s,
        };
        self.orient_spindle(line.spindle(), angle);
        Ok(())
    }

    fn outputs(&mut self) -> Result<(), Fault> {
        let line = self.line;
        let Some(code) = line.m(Group::InputOutput) else {
            return Ok(());
        };
        let span = line.group_span(Group::InputOutput);
        let missing = |text: &str| Err(Fault::new(Code::WordMissing, span, text.to_owned()));
        match code {
            MCode::Output { synchronised, on } => {
                let Some(index) = line.integer(b'P')? else {
                    return missing("M62 to M65 need P, the number of the output");
                };
                self.emit(Action::Output {
                    index,
                    on,
                    synchronised,
                });
            }
            MCode::AnalogOutput(synchronised) => {
                let (Some(index), Some(value)) = (line.integer(b'E')?, line.word(b'Q')) else {
                    return missing("M67 and M68 need E, the number of the output, and Q, its value");
                };
                self.emit(Action::AnalogOutput {
                    index,
                    value,
                    synchronised,
                });
            }
            _ => {
                if self.state.cutter.is_on() || self.state.cutter.held.is_some() {
                    // The next line would be read before the result is known.
                    return Err(Fault::new(
                        Code::CompensationActive,
                        span,
                        "M66 while cutter compensation is on",
                    )
                    .help("write G40 and a move before it"));
                }
                let (digital, analog) = (line.integer(b'P')?, line.integer(b'E')?);
                let index = match (digital, analog) {
                    (Some(index), None) | (None, Some(index)) => index,
                    _ => return missing("M66 needs either P, a digital input, or E, an analog one"),
                };
                let mode = line.integer(b'L')?.unwrap_or(0);
                if mode > 4 || analog.is_some() && mode != 0 {
                    let message =
                        format!("L{mode}: M66 supports L0 immediate, L1 rise, L2 fall, L3 high, L4 low");
                    return Err(Fault::new(Code::OutOfRange, line.span(b'L'), message)
                        .help("an analog input supports L0 only"));
                }
                let timeout_s = line.word(b'Q').unwrap_or(0.0);
                if timeout_s <= 0.0 && mode != 0 {
                    return missing("M66 needs Q above 0, the time limit in seconds");
                }
                // The result on a machine whose inputs reach the awaited state, or after a timeout.
                let imagined = match (self.settings.waits_succeed, mode) {
                    (true, 1 | 3) => 1.0,
                    (true, 2 | 4) => 0.0,
                    _ => -1.0,
                };
                self.parameters.set_numbered(INPUT_RESULT, imagined);
                self.emit(Action::WaitInput {
                    index,
                    analog: analog.is_some(),
                    mode,
                    timeout_s,
                });
            }
        }
        Ok(())
    }
}
