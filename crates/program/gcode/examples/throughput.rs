//! Measures the speed of interpretation: `cargo run --release -p evolvent-gcode --example throughput
//! [PROGRAM]`; without a program, of a million plain lines.

use std::fmt::Write as _;
use std::io::Write as _;
use std::time::Instant;

use evolvent_gcode::{Interpreter, Settings};

const LINES: u32 = 1_000_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    if let Some(path) = std::env::args_os().nth(1) {
        return measure(&std::fs::read(path)?);
    }
    let mut program = String::from("G21 G90 F1000\n");
    for line in 0..LINES {
        let (x, y) = (f64::from(line % 7919) * 0.0137, f64::from(line % 6007) * 0.0171);
        writeln!(program, "G1 X{x:.4} Y{y:.4} Z{:.4}", (x - y) * 0.1)?;
    }
    measure(program.as_bytes())
}

fn measure(program: &[u8]) -> Result<(), Box<dyn std::error::Error>> {
    let lines = program.iter().filter(|byte| **byte == b'\n').count();
    let start = Instant::now();
    let mut moves = 0_u32;
    let mut length = 0.0;
    for item in Interpreter::new(program, Settings::default()) {
        if let evolvent_gcode::Action::Move(step) = item?.action {
            moves += 1;
            length += step.curve.length();
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    let megabytes = program.len() as f64 / 1e6;
    writeln!(
        std::io::stdout(),
        "{moves} moves, {length:.0} mm, {megabytes:.1} MB in {seconds:.3} s: {:.0} MB/s, {:.0} lines/s",
        megabytes / seconds,
        lines as f64 / seconds
    )?;
    Ok(())
}
