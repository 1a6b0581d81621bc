//! Programs as blocks, from G-code or from the canonical calls that `rs274 -g` prints.

use std::path::Path;

use evolvent_gcode::{Action, Interpreter, MoveKind, Settings};
use evolvent_path::{Arc, Axes, Curve, Line, Plane, Sense};
use evolvent_smooth::{Block, Tolerance};

/// What a program asks for.
pub enum Item {
    Block(Block),
    Rest { seconds: f64 },
}

pub fn read(path: &Path, tolerance: Tolerance) -> Result<Vec<Item>, String> {
    let text = std::fs::read_to_string(path).map_err(|error| error.to_string())?;
    if path.extension().is_some_and(|e| e == "canon") {
        Ok(canonical(&text, tolerance))
    } else {
        gcode(&text, tolerance)
    }
}

fn gcode(text: &str, tolerance: Tolerance) -> Result<Vec<Item>, String> {
    let mut items = Vec::new();
    for command in Interpreter::new(text.as_bytes(), Settings::default()) {
        let command = command.map_err(|error| format!("{error:?}"))?;
        match command.action {
            Action::Move(motion) => items.push(Item::Block(Block {
                curve: motion.curve,
                feed: motion.feed,
                rapid: motion.kind == MoveKind::Rapid,
                tolerance,
                line: command.line,
                block: items.len() as u32,
            })),
            Action::Dwell { seconds } => items.push(Item::Rest { seconds }),
            Action::ChangeTool(_) | Action::ProgramStop { .. } => items.push(Item::Rest { seconds: 0.0 }),
            _ => {}
        }
    }
    Ok(items)
}

fn canonical(text: &str, tolerance: Tolerance) -> Vec<Item> {
    let mut items = Vec::new();
    let (mut unit, mut feed, mut plane) = (1.0, 1.0, Plane::Xy);
    let mut at = Axes::zeros();
    for (number, line) in text.lines().enumerate() {
        let Some((_, call)) = line.split_once("..... ") else {
            continue;
        };
        let Some((name, rest)) = call.split_once('(') else {
            continue;
        };
        let rest = rest.trim_end().trim_end_matches(')');
        let n: Vec<f64> = rest
            .split(',')
            .map(|x| x.trim().parse().unwrap_or(f64::NAN))
            .collect();
        let mut add = |curve: Curve, feed: f64, rapid: bool| {
            items.push(Item::Block(Block {
                curve,
                feed,
                rapid,
                tolerance,
                line: number as u32,
                block: number as u32,
            }));
        };
        match name {
            "USE_LENGTH_UNITS" => unit = if rest.contains("INCH") { 25.4 } else { 1.0 },
            "SET_FEED_RATE" => feed = n[0] * unit / 60.0,
            "SELECT_PLANE" if rest.contains("YZ") => plane = Plane::Yz,
            "SELECT_PLANE" if rest.contains("XZ") => plane = Plane::Zx,
            "SELECT_PLANE" => plane = Plane::Xy,
            "DWELL" => items.push(Item::Rest { seconds: n[0] }),
            "STRAIGHT_TRAVERSE" | "STRAIGHT_FEED" => {
                let mut to = at;
                (to[0], to[1], to[2]) = (n[0] * unit, n[1] * unit, n[2] * unit);
                if (to - at).norm() > 1e-7
                    && let Ok(line) = Line::new(at, to)
                {
                    let rapid = name == "STRAIGHT_TRAVERSE";
                    add(line.into(), if rapid { f64::INFINITY } else { feed }, rapid);
                    at = to;
                }
            }
            "ARC_FEED" => {
                let (first, second, normal) = plane.axes();
                let mut to = at;
                (to[first], to[second], to[normal]) = (n[0] * unit, n[1] * unit, n[5] * unit);
                let sense = if n[4] > 0.0 {
                    Sense::CounterClockwise
                } else {
                    Sense::Clockwise
                };
                let turns = (n[4].abs() - 1.0).max(0.0) as u32;
                match Arc::new(plane, at, to, [n[2] * unit, n[3] * unit], sense, turns) {
                    Ok(arc) => add(arc.into(), feed, false),
                    Err(error) => println!("line {number}: {error}"),
                }
                at = to;
            }
            _ => {}
        }
    }
    items
}
