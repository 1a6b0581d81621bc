//! Commands as lines of text for comparison with another interpreter: positions in machine coordinates in mm
//! and degrees (X Y Z A B C), speeds in mm/min, the path mode with every move, and changes only.

use std::fmt::Write as _;
use std::io::BufRead;

use evolvent_gcode::{
    Action, CanonicalCommand, Interpreter, LogAction, MoveKind, PathMode, SPINDLES, Settings,
    SpindleDirection,
};
use evolvent_path::{Axes, Curve};

/// Runs a program to its end or its first error; a line of text per event.
pub(crate) fn canon(program: impl BufRead, settings: Settings) -> Vec<String> {
    let mut printer = Printer::default();
    for item in Interpreter::new(program, settings) {
        match item {
            Ok(command) => printer.command(&command),
            Err(error) => {
                printer.flush();
                // A line of another file is not a line of the program.
                let line = if error.file.is_some() { 0 } else { error.line };
                printer.lines.push(format!("error {line} {error}"));
                return printer.lines;
            }
        }
    }
    printer.flush();
    printer.lines
}

#[derive(Debug, Default)]
struct Printer {
    lines: Vec<String>,
    /// Direction and speed, by spindle.
    spindles: [(String, f64); SPINDLES],
    reported_spindles: [(String, f64); SPINDLES],
    coolant: (bool, bool),
    reported_coolant: (bool, bool),
    spline_line: u32,
}

fn coordinates(axes: &Axes) -> String {
    let mut text = String::new();
    for index in 0..6 {
        // Avoids a negative zero.
        let _ = write!(text, " {:.6}", axes[index] + 0.0);
    }
    text
}

fn direction(direction: SpindleDirection) -> &'static str {
    match direction {
        SpindleDirection::Stopped => "stop",
        SpindleDirection::Clockwise => "cw",
        SpindleDirection::CounterClockwise => "ccw",
    }
}

/// An event of a spindle; spindle 0 is written without its number.
fn numbered(event: &str, spindle: u32) -> String {
    match spindle {
        0 => event.to_owned(),
        _ => format!("{event}{spindle}"),
    }
}

/// As in rs274: no tolerance is 0, and without Q lines are merged within the tolerance.
fn path(mode: PathMode) -> String {
    match mode {
        PathMode::ExactPath => " exact".to_owned(),
        PathMode::ExactStop => " stop".to_owned(),
        PathMode::Blend {
            tolerance_mm,
            merge_mm,
        } => {
            let tolerance = tolerance_mm.unwrap_or(0.0);
            format!(" blend {tolerance:.6} {:.6}", merge_mm.unwrap_or(tolerance))
        }
    }
}

impl Printer {
    /// Outputs the states of spindle and coolant once for several consecutive commands.
    fn flush(&mut self) {
        for (number, spindle) in self.spindles.iter().enumerate() {
            let reported = &mut self.reported_spindles[number];
            if *spindle == *reported || spindle.0.is_empty() {
                continue;
            }
            // The speed of a stopped spindle is ignored.
            let stopped = spindle.0 == "stop";
            let was_stopped = matches!(reported.0.as_str(), "" | "stop");
            if !(stopped && was_stopped) {
                let speed = if stopped { 0.0 } else { spindle.1 };
                let name = numbered("spindle", number as u32);
                self.lines.push(format!("{name} {} {speed:.4}", spindle.0));
            }
            reported.clone_from(spindle);
        }
        if self.coolant != self.reported_coolant {
            let (mist, flood) = self.coolant;
            self.lines
                .push(format!("coolant {} {}", u8::from(mist), u8::from(flood)));
            self.reported_coolant = self.coolant;
        }
    }

    fn put(&mut self, text: String) {
        self.flush();
        self.lines.push(text);
    }

    fn command(&mut self, command: &CanonicalCommand) {
        match &command.action {
            Action::Move(step) => {
                let feed = step.feed_mm_s * 60.0;
                let end = coordinates(&step.curve.end());
                let mode = path(step.path_mode);
                match (&step.curve, step.kind) {
                    (_, MoveKind::Rapid) => self.put(format!("rapid{end}{mode}")),
                    (Curve::Line(_), _) if self.spline_line != command.line => {
                        self.put(format!("feed{end} F{feed:.4}{mode}"));
                    }
                    (Curve::Arc(arc), _) => {
                        let [c1, c2] = arc.centre_mm();
                        let turns = (arc.sweep_rad().abs() / std::f64::consts::TAU - 1e-7)
                            .ceil()
                            .max(1.0);
                        let turns = turns.copysign(arc.sweep_rad());
                        self.put(format!(
                            "arc{end} C {:.6} {:.6} {turns} F{feed:.4}{mode}",
                            c1 + 0.0,
                            c2 + 0.0
                        ));
                    }
                    (Curve::Involute(_), _) => self.put(format!("involute{end} F{feed:.4}")),
                    _ => {
                        if self.spline_line != command.line {
                            self.put(format!("spline{mode}"));
                        }
                        self.spline_line = command.line;
                    }
                }
            }
            Action::Dwell { seconds } => self.put(format!("dwell {seconds:.4}")),
            Action::SelectTool(tool) => self.put(format!("select {tool}")),
            Action::BeginToolChange(tool) => self.put(format!("begin change {tool}")),
            Action::ChangeTool(tool) => self.put(format!("change {tool}")),
            Action::ToolNumber(tool) => self.put(format!("number {tool}")),
            Action::Spindle {
                spindle,
                direction: direction_name,
                speed_rpm,
            } => self.set_spindle(*spindle, direction(*direction_name), *speed_rpm),
            Action::SurfaceSpeed {
                spindle,
                direction: direction_name,
                surface,
            } => self.set_spindle(*spindle, direction(*direction_name), surface.speed_m_min),
            Action::OrientSpindle { spindle, degrees, .. } => {
                self.spindles[*spindle as usize].0 = "stop".to_owned();
                self.put(format!("{} {degrees:.4}", numbered("orient", *spindle)));
            }
            Action::Coolant { mist, flood } => self.coolant = (*mist, *flood),
            Action::ProgramStop { optional, pallet } => {
                let kind = match (optional, pallet) {
                    (true, _) => "optional",
                    (_, true) => "pallet",
                    _ => "always",
                };
                self.put(format!("stop {kind}"));
            }
            Action::ProgramEnd => self.put("end".to_owned()),
            Action::Message(text) => self.put(format!("message {}", text.trim())),
            Action::Print(text) => self.put(format!("print {}", text.trim())),
            Action::Log(LogAction::Line(text)) => self.put(format!("log {}", text.trim())),
            Action::Thread {
                curve,
                pitch_mm,
                path_mode,
                ..
            } => {
                let mode = path(*path_mode);
                self.put(format!(
                    "thread{} K{pitch_mm:.5}{mode}",
                    coordinates(&curve.end())
                ));
            }
            Action::RigidTap { curve, pitch_mm, .. } => {
                self.put(format!("tap{} K{pitch_mm:.5}", coordinates(&curve.end())));
            }
            Action::Probe { curve, .. } => self.put(format!("probe{}", coordinates(&curve.end()))),
            Action::Output {
                index,
                on,
                synchronised,
            } => self.put(format!(
                "output {index} {} {}",
                u8::from(*on),
                u8::from(*synchronised)
            )),
            Action::AnalogOutput {
                index,
                value,
                synchronised,
            } => self.put(format!("analog {index} {value:.4} {}", u8::from(*synchronised))),
            Action::UserCommand { number, .. } => self.put(format!("user {number}")),
            _ => {}
        }
    }

    fn set_spindle(&mut self, spindle: u32, direction_name: &str, speed: f64) {
        self.spindles[spindle as usize] = (direction_name.to_owned(), speed);
    }
}
