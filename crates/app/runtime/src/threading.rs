//! Converts threads of a program to passes of the machine, and explains their results.

use std::convert::Infallible;
use std::path::Path;

use evolvent_gcode::{Action, CanonicalCommand, Diagnostic, Move, MoveKind, Outputs, PathMode};
use evolvent_machine::SpindleSettings;
use evolvent_motion::{TapReturn, ThreadLeg, ThreadObjection, ThreadPass, ThreadResult, ThreadVerdict};
use evolvent_path::{Axes, AxisLetter, Curve};
use evolvent_planner::{MoveValidator, PlanError};

use crate::job::Setup;
use crate::news::with_article;
use crate::refusal::{about_line_with, explain};

/// The next pass: its consecutive straight pieces.
#[derive(Clone, Debug, Default)]
pub(crate) struct ThreadChain {
    start: Axes,
    legs: Vec<ThreadLeg>,
    /// The pieces of the path and their pitches, mm.
    curves: Vec<(Curve, f64)>,
    /// Number of the spindle that it follows.
    spindle: u32,
    start_degrees: f64,
    clear_x: Option<f64>,
    /// The command of the first piece.
    first: Option<CanonicalCommand>,
    /// Retraction speed as a multiple of the speed in.
    return_factor: Option<f64>,
}

impl ThreadChain {
    /// Whether there is no pass.
    pub(crate) fn is_empty(&self) -> bool {
        self.legs.is_empty()
    }

    /// Number of the spindle that it follows.
    pub(crate) fn spindle(&self) -> u32 {
        self.spindle
    }

    /// Its first command.
    pub(crate) fn first(&self) -> Option<&CanonicalCommand> {
        self.first.as_ref()
    }

    /// Speed of its first piece at a speed of the spindle, mm/s.
    pub(crate) fn feed_mm_s(&self, turns_per_s: f64) -> f64 {
        let pitch_mm = self.curves.first().map_or(0.0, |(_, pitch_mm)| *pitch_mm);
        pitch_mm * turns_per_s.abs()
    }

    /// Whether the spindle reverses at its end.
    pub(crate) fn is_tap(&self) -> bool {
        self.return_factor.is_some()
    }

    /// Adds a piece that continues the last one. Returns `false` if the command is not a piece or begins
    /// another pass.
    pub(crate) fn take(&mut self, command: &CanonicalCommand) -> bool {
        let (curve, pitch_mm) = match &command.action {
            Action::Thread {
                spindle,
                curve,
                pitch_mm,
                start_degrees,
                clear_x,
                ..
            } => {
                let is_other = (*spindle, *start_degrees) != (self.spindle, self.start_degrees);
                if self.is_tap() || !self.is_empty() && is_other {
                    return false;
                }
                self.spindle = *spindle;
                self.start_degrees = *start_degrees;
                self.clear_x = *clear_x;
                (*curve, *pitch_mm)
            }
            Action::RigidTap {
                spindle,
                curve,
                pitch_mm,
                return_factor,
            } => {
                if !self.is_empty() {
                    return false;
                }
                self.spindle = *spindle;
                self.return_factor = Some(*return_factor);
                (*curve, *pitch_mm)
            }
            _ => return false,
        };
        if self.legs.is_empty() {
            self.start = curve.start();
            self.first = Some(command.clone());
        }
        self.legs.push(ThreadLeg {
            end: curve.end(),
            turns: curve.length() / pitch_mm,
            line: command.line,
        });
        self.curves.push((curve, pitch_mm));
        true
    }

    /// The pass at a spindle speed, rpm, negative counter-clockwise.
    fn pass(&self, rpm: f64, spindle: &SpindleSettings, setup: &Setup) -> ThreadPass {
        let turns_per_s = rpm / 60.0;
        ThreadPass {
            start: self.start,
            legs: self.legs.clone().into(),
            start_turns: self.start_degrees / 360.0,
            turns_per_s,
            chord_error_mm: setup.chord_error_mm(),
            max_angle_age_s: setup.machine.drives.feedback_timeout_s,
            clear_at: self.clear_x.map(|x| (AxisLetter::X.index(), x)),
            tap: self.return_factor.map(|factor| TapReturn {
                turns_per_s: factor * turns_per_s.abs(),
                braking: spindle.braking_rpm_s().map(|rate| rate / 60.0),
            }),
        }
    }

    /// The pass and its run-in in mm, if the machine can cut it at this speed.
    pub(crate) fn pass_on(&self, rpm: f64, setup: &Setup) -> Result<(ThreadPass, f64), ThreadRefusal> {
        let words = |message: &str, help: &str| ThreadRefusal::Words(message.to_owned(), help.to_owned());
        let spindle = setup
            .machine
            .signals
            .spindle(self.spindle)
            .filter(|spindle| spindle.has_feedback());
        let Some(spindle) = spindle else {
            let number = self.spindle;
            let message = format!(
                "threads follow the angle of the spindle, and the machine file has no spindle {number} with \
                 feedback"
            );
            let number_key = if number == 0 {
                String::new()
            } else {
                format!("number = {number} and ")
            };
            let help = format!(
                "add [[spindle]] with {number_key}feedback = true to the machine file; a bridge reports the angle \
                 on the bus"
            );
            return Err(ThreadRefusal::Words(message, help));
        };
        if self.is_tap() && !spindle.reverse {
            let message = format!(
                "a rigid tap turns the spindle back, and {} turns clockwise only",
                with_article(self.spindle)
            );
            let help =
                "tap with a floating holder, or write reverse = true at its [[spindle]] in the machine file";
            return Err(words(&message, help));
        }
        if rpm == 0.0 {
            return Err(words(
                "a thread needs a spindle that turns, and its speed is 0 or not known",
                "write S and M3 or M4 first, and G97 where G96 is in force",
            ));
        }
        let limits = setup.machine.limits();
        let mut validator = MoveValidator::new(&limits);
        for (curve, _) in &self.curves {
            let motion = Move {
                curve: *curve,
                kind: MoveKind::Feed,
                feed_mm_s: 1.0,
                path_mode: PathMode::ExactPath,
            };
            validator.validate(&motion).map_err(ThreadRefusal::Travel)?;
        }
        let pass = self.pass(rpm, spindle, setup);
        match pass.check(&limits, setup.period_ns as f64 * 1e-9) {
            Ok(run_in_mm) => Ok((pass, run_in_mm)),
            Err(objection) => {
                let (message, help) = objection_text(&objection, rpm);
                Err(ThreadRefusal::Words(message, help))
            }
        }
    }
}

/// Checks the threads of a program, command by command.
pub(crate) struct ThreadCheck {
    chain: ThreadChain,
    outputs: Outputs,
}

impl ThreadCheck {
    pub(crate) fn new(setup: &Setup) -> Self {
        Self {
            chain: ThreadChain::default(),
            outputs: setup.outputs,
        }
    }

    /// The machine's objection to the thread that ends before this command, with the first command of that
    /// thread.
    pub(crate) fn observe(
        &mut self,
        command: &CanonicalCommand,
        setup: &Setup,
    ) -> Option<(CanonicalCommand, ThreadRefusal)> {
        if self.chain.take(command) {
            return None;
        }
        let whole = std::mem::take(&mut self.chain);
        let _begun = self.chain.take(command);
        let rpm = self.outputs.spindle(whole.spindle).constant_rpm();
        self.outputs.apply(&command.action);
        let first = whole.first()?.clone();
        Some((first, whole.pass_on(rpm, setup).err()?))
    }
}

/// Why a thread is rejected before anything moves.
pub(crate) enum ThreadRefusal {
    Words(String, String),
    Travel(PlanError<Infallible>),
}

impl ThreadRefusal {
    pub(crate) fn diagnostic(self, file: &Path, line: u32) -> Diagnostic {
        match self {
            Self::Words(message, help) => about_line_with(message, Some(help), file, line),
            Self::Travel(error) => explain(&error, file, line),
        }
    }
}

/// The remedy where the axes cannot follow the reversal of a tap's spindle.
const SLOWER_REVERSAL: &str = "let the spindle reverse more slowly: reduce its ramp in the drive, and \
                               acceleration_rpm_s or ramp_rpm_s at its [[spindle]]";

fn objection_text(objection: &ThreadObjection, rpm: f64) -> (String, String) {
    match *objection {
        ThreadObjection::TooFast {
            axis,
            needed,
            permitted,
        } => {
            let letter = AxisLetter::letter_of(axis);
            (
                format!(
                    "at {:.0} rpm the pitch needs {:.0} mm/min of {letter} (5 % of reserve included), and \
                     its limit is {:.0} mm/min",
                    rpm.abs(),
                    needed * 60.0,
                    permitted * 60.0
                ),
                format!(
                    "turn the spindle at {:.0} rpm at most",
                    (rpm.abs() * permitted / needed).floor()
                ),
            )
        }
        ThreadObjection::TooShort {
            run_in_mm,
            run_out_mm,
            length_mm,
            ..
        } => (
            format!(
                "at {:.0} rpm this needs {run_in_mm:.3} mm of run-in to be in phase, and {run_out_mm:.3} mm \
                 to run out, but there are only {length_mm:.3} mm",
                rpm.abs()
            ),
            "begin farther away from the thread, end farther after it, or turn the spindle more slowly"
                .to_owned(),
        ),
        ThreadObjection::ReversalTooFast {
            axis,
            needed,
            permitted,
        } => {
            let letter = AxisLetter::letter_of(axis);
            (
                format!(
                    "to follow the reversal of the spindle {letter} needs an acceleration of {:.3} m/s2, and its limit \
                     is {:.3} m/s2",
                    needed / 1e3,
                    permitted / 1e3
                ),
                SLOWER_REVERSAL.to_owned(),
            )
        }
        ThreadObjection::ReversalTooSudden {
            axis,
            lag_mm,
            permitted_mm,
        } => {
            let letter = AxisLetter::letter_of(axis);
            (
                format!(
                    "{letter} would lag by {lag_mm:.3} mm behind the reversal of the spindle, because of its jerk, and \
                     {permitted_mm:.3} mm are permitted"
                ),
                format!("{SLOWER_REVERSAL}; or raise max_jerk_m_s3 of {letter} if the machine permits it"),
            )
        }
        ThreadObjection::NoOverrun {
            axis,
            needed_mm,
            available_mm,
        } => (
            format!(
                "at {:.0} rpm the spindle needs {needed_mm:.3} mm of {} beyond the depth to stop, but there are only \
                 {:.3} mm to the travel limit",
                rpm.abs(),
                AxisLetter::letter_of(axis),
                available_mm.max(0.0)
            ),
            "tap less deep or turn the spindle more slowly; acceleration_rpm_s at its [[spindle]] is the rate at \
             which it brakes, and with it the tap stops at the depth"
                .to_owned(),
        ),
    }
}

/// The error of a pass and its remedy; `None` if the program continues.
pub(crate) fn complaint(result: &ThreadResult, rpm: f64) -> Option<(String, String)> {
    // Nothing is cut before the pass is in phase.
    let has_begun = result.worst_mm > 0.0;
    let (message, help) = match result.verdict {
        ThreadVerdict::Done => return None,
        ThreadVerdict::Refused(objection) => {
            let (message, help) = objection_text(&objection, rpm);
            (format!("the spindle is faster than commanded; {message}"), help)
        }
        ThreadVerdict::Unknown => (
            "the angle of the spindle is not known: nothing has moved".to_owned(),
            "a bridge must report it and must have detected the index pulse: `evolvent top NAME` shows the \
             spindle"
                .to_owned(),
        ),
        ThreadVerdict::Lost => (
            "the angle of the spindle became unknown; the axes have stopped".to_owned(),
            "check the encoder and the bridge; retract the tool before the spindle turns again".to_owned(),
        ),
        ThreadVerdict::Stalled => (
            format!(
                "the spindle does not keep {:.0} rpm: it has nearly stopped, and so have the axes",
                rpm.abs()
            ),
            if has_begun {
                "check the spindle's drive, and the depth of the cut".to_owned()
            } else {
                "nothing has been cut: check the spindle's drive, and whether M3 or M4 with S has turned it"
                    .to_owned()
            },
        ),
        ThreadVerdict::NotTurnedBack => (
            "the spindle has not reversed at the depth; the axes have stopped in the hole".to_owned(),
            "check the spindle's drive; acceleration_rpm_s at its [[spindle]] is the rate at which it brakes"
                .to_owned(),
        ),
        ThreadVerdict::AtTravelEnd => (
            "the spindle turned too far beyond the depth: the travel ends there, and the axes have stopped in the \
             hole"
                .to_owned(),
            "check the spindle's drive; acceleration_rpm_s at its [[spindle]] is the rate at which it brakes"
                .to_owned(),
        ),
        ThreadVerdict::OutOfPhase => (
            "the axes can no longer follow the spindle, and have stopped".to_owned(),
            "turn more slowly, or find out why the speed of the spindle changes".to_owned(),
        ),
    };
    if result.is_clear {
        return Some((format!("{message}; the tool was retracted from the thread"), help));
    }
    // G33 does not specify the direction in which its tool is free.
    let is_in_thread =
        has_begun && matches!(result.verdict, ThreadVerdict::Stalled | ThreadVerdict::OutOfPhase);
    let help = if is_in_thread {
        format!("retract the tool before the spindle turns again; then {help}")
    } else {
        help
    };
    Some((message, help))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagnostic(verdict: ThreadVerdict, worst_mm: f64, is_clear: bool) -> (String, String) {
        let result = ThreadResult {
            verdict,
            stop_position: Axes::zeros(),
            is_clear,
            worst_mm,
        };
        complaint(&result, 500.0).expect("a complaint")
    }

    #[test]
    fn a_stalled_pass_advises_by_the_tool_position() {
        // G33: the axes have stopped in the thread.
        let (_, help) = diagnostic(ThreadVerdict::Stalled, 0.01, false);
        assert!(help.starts_with("retract the tool"), "{help}");
        assert!(help.contains("depth of the cut"), "{help}");
        assert!(
            diagnostic(ThreadVerdict::OutOfPhase, 0.01, false)
                .1
                .starts_with("retract the tool")
        );
        // G76: the tool is out.
        let (message, help) = diagnostic(ThreadVerdict::Stalled, 0.01, true);
        assert!(message.ends_with("retracted from the thread"), "{message}");
        assert!(!help.contains("retract the tool"), "{help}");
        // Before the pass: the depth is not the cause, and the tool is not in the thread.
        let (_, help) = diagnostic(ThreadVerdict::Stalled, 0.0, false);
        assert!(help.contains("nothing has been cut"), "{help}");
        assert!(
            !help.contains("depth") && !help.contains("retract the tool"),
            "{help}"
        );
    }

    #[test]
    fn a_reversal_beyond_an_axis_has_both_figures() {
        let objection = ThreadObjection::ReversalTooFast {
            axis: 2,
            needed: 5000.0,
            permitted: 3000.0,
        };
        let (message, help) = objection_text(&objection, 1000.0);
        assert!(
            message.contains("Z needs an acceleration of 5.000 m/s2") && message.contains("3.000"),
            "{message}"
        );
        assert!(help.contains("acceleration_rpm_s"), "{help}");
        let objection = ThreadObjection::ReversalTooSudden {
            axis: 2,
            lag_mm: 0.4321,
            permitted_mm: 0.25,
        };
        let (message, help) = objection_text(&objection, 1000.0);
        assert!(
            message.contains("Z would lag by 0.432 mm") && message.contains("0.250 mm are permitted"),
            "{message}"
        );
        assert!(
            help.contains("ramp_rpm_s") && help.contains("max_jerk_m_s3 of Z"),
            "{help}"
        );
    }
}
