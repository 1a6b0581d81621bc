//! G76 of several starts.

use evolvent_gcode::{Action, MachineFeatures, Settings};

use crate::interpreted::interpret;

/// X at the end and the start angle of each pass, in order.
fn passes(words: &str) -> Vec<(f64, f64)> {
    let settings = Settings {
        features: MachineFeatures {
            lathe: true,
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    let program = format!("G21 G18 G90 G8 S500 M3\nG0 X12 Z5\nG76 P3 Z-20 I-1 J0.4 K1.2 R1 {words}\nM2\n");
    let (commands, found) = interpret(&program, settings);
    assert!(found.is_empty(), "{found:?}");
    let threads = commands.iter().filter_map(|command| match &command.action {
        Action::Thread {
            curve, start_degrees, ..
        } => Some((curve.end()[0], *start_degrees)),
        _ => None,
    });
    threads.collect()
}

/// Each depth is cut in every groove before the next one, and the grooves divide the revolution equally: D is
/// the number of starts.
#[test]
fn the_starts_of_g76_divide_the_turn_at_each_depth() {
    let single = passes("");
    assert!(
        single.len() >= 3 && single.iter().all(|(_, degrees)| *degrees == 0.0),
        "{single:?}"
    );
    for starts in [2_usize, 3, 5] {
        let found = passes(&format!("D{starts}"));
        assert_eq!(found.len(), starts * single.len(), "D{starts}: {found:?}");
        for (depth, (grooves, alone)) in found.chunks(starts).zip(&single).enumerate() {
            for (number, (x, degrees)) in grooves.iter().enumerate() {
                let expected = 360.0 * number as f64 / starts as f64;
                assert!(
                    (x - alone.0).abs() < 1e-9,
                    "D{starts}, depth {depth}: {grooves:?}"
                );
                assert!(
                    (degrees - expected).abs() < 1e-9,
                    "D{starts}, depth {depth}: {grooves:?}"
                );
            }
        }
    }
}
