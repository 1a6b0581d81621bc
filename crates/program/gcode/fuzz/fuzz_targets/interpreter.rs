//! Whole programs: no panic, an end, contiguous moves, and errors with a position. The first byte selects the
//! machine.
#![no_main]

use evolvent_gcode::{Action, Interpreter, MachineFeatures, ProgramLimits, Settings, Tool, ToolTable};
use libfuzzer_sys::fuzz_target;

fn settings(kind: u8) -> Settings {
    let mut tool = Tool::new(1);
    tool.diameter_mm = 6.0;
    tool.offset[2] = 12.5;
    Settings {
        tools: Some(ToolTable::new(vec![tool])),
        features: MachineFeatures {
            user_codes: vec![101],
            lathe: kind & 1 == 1,
            load_channel: kind & 2 == 2,
            ..MachineFeatures::default()
        },
        block_delete: kind & 4 == 4,
        inches: kind & 8 == 8,
        limits: ProgramLimits {
            max_silent_lines: 2000,
            max_body_bytes: 100_000,
            max_call_depth: 20,
            ..ProgramLimits::default()
        },
        ..Settings::default()
    }
}

fuzz_target!(|data: &[u8]| {
    let Some((kind, program)) = data.split_first() else {
        return;
    };
    let settings = settings(*kind);
    let mut position = settings.start;
    for item in Interpreter::new(program, settings).take(2000) {
        match item {
            Ok(command) => {
                let curve = match &command.action {
                    Action::Move(step) => {
                        assert!(step.feed_mm_s > 0.0, "a feed of {} mm/s", step.feed_mm_s);
                        &step.curve
                    }
                    Action::Thread { curve, .. } | Action::Probe { curve, .. } => curve,
                    _ => continue,
                };
                assert!(curve.start() == position, "line {}: a gap", command.line);
                position = curve.end();
                let middle = curve.jet(0.5 * curve.domain());
                assert!(curve.length() > 0.0 && middle.position.iter().all(|value| value.is_finite()));
            }
            Err(error) => {
                assert!(error.line > 0 && error.source.get(error.span.clone()).is_some());
            }
        }
    }
});
