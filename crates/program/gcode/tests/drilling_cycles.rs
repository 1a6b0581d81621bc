//! Drilling cycles: the height at which the tool travels from hole to hole.

use evolvent_gcode::{Action, MoveKind, Settings};
use evolvent_random::{Random, cases};

use crate::interpreted::interpret;

/// Heights above the work at which rapids move sideways.
fn heights_across(program: &str, work_zero: f64) -> Vec<f64> {
    let (commands, found) = interpret(program, Settings::default());
    assert!(found.is_empty(), "{program}{found:?}");
    let rapids = commands.iter().filter_map(|command| match &command.action {
        Action::Move(step) if step.kind == MoveKind::Rapid => Some(&step.curve),
        _ => None,
    });
    rapids
        .filter(|curve| (curve.end() - curve.start()).rows(0, 2).norm() > 1.0)
        .map(|curve| curve.end()[2] - work_zero)
        .collect()
}

/// RS274/NGC 3.5.16 and LinuxCNC: from R the tool travels at the height to which the cycle retracts, also
/// after a hole of G99. Heights are those above the work, with any offsets.
#[test]
fn g98_after_g99_approaches_at_the_initial_height() {
    let mut random = Random::from_state(0x5eed_0099);
    for case in 0..cases(300) {
        let r = random.between(0.5, 6.0);
        let r = (r * 1000.0).round() / 1000.0;
        let [work_zero, tool] = [(-250.0, -150.0), (20.0, 130.0)]
            .map(|(min, max)| (random.between(min, max) * 1000.0).round() / 1000.0);
        let offsets = match case % 3 {
            0 => format!("G10 L2 P1 Z{work_zero:.3}\nG43.1 Z{tool:.3}\n"),
            1 => format!("G43.1 Z{tool:.3}\nG92 Z{:.3}\n", -work_zero),
            _ => format!("G10 L20 P1 Z{:.3}\nG43.1 Z{tool:.3}\n", -work_zero),
        };
        let cycle = ["G81", "G82 P0.1", "G83 Q2", "G85"][case % 4];
        let program = format!(
            "G21 G90 G94 F100 S500 M3\n{offsets}G0 X0 Y0 Z30\nG99 {cycle} X10 Y10 Z-5 R{r:.3}\nX20\n\
             G98 X30\nX60\nG80\nM2\n"
        );
        let (commands, _) = interpret(&program, Settings::default());
        let last = commands.iter().rev().find_map(|command| match &command.action {
            Action::Move(step) => Some(step.curve.end()[2]),
            _ => None,
        });
        // The last hole ends at the initial height, which gives the height of the work.
        let work = last.expect("moves") - 30.0;
        let heights = heights_across(&program, work);
        let expected = [30.0, r, 30.0, 30.0];
        assert_eq!(heights.len(), expected.len(), "{program}{heights:?}");
        for (height, expected) in heights.iter().zip(expected) {
            assert!((height - expected).abs() < 1e-6, "{program}{heights:?}");
        }
    }
}
