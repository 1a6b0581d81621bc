//! Tapping: the modes that a cycle restores, and taps with a measured spindle.

use evolvent_gcode::{Action, MachineFeatures, Settings};

use crate::interpreted::interpret;

#[test]
fn a_tapping_cycle_restores_overrides_and_hold() {
    for (program, cycle) in [
        ("G21 F100 S500 M3\nM50 P0\nG0 Z5\nG84 X1 Z-1 R1\nM2\n", "G84"),
        ("G21 F100 S500 M4\nM50 P0\nG0 Z5\nG74 X1 Z-1 R1\nM2\n", "G74"),
    ] {
        let (commands, found) = interpret(program, Settings::default());
        assert!(found.is_empty(), "{found:?}");
        let switches: Vec<_> = commands
            .iter()
            .map(|command| &command.action)
            .filter(|action| matches!(action, Action::Overrides { .. }))
            .collect();
        let overrides = |spindle, feed_stop, cycle| Action::Overrides {
            feed: false,
            spindles: [spindle, true, true, true],
            adaptive: None,
            feed_stop,
            cycle,
        };
        let expected = [
            overrides(true, true, None),
            overrides(false, false, Some(cycle)),
            overrides(true, true, Some(cycle)),
        ];
        assert_eq!(switches, expected.iter().collect::<Vec<_>>());
    }
}

#[test]
fn a_measured_spindle_taps_rigidly() {
    let settings = Settings {
        features: MachineFeatures {
            rigid_tapping: [true, false, false, false],
            ..MachineFeatures::default()
        },
        ..Settings::default()
    };
    for (program, pitch) in [
        (
            "G21 G94 F600 S500 M3\nG0 Z5\nG84 X1 Y2 Z-8 R1\nX5\nG80\nM2\n",
            1.2,
        ),
        (
            "G21 G95 F1.2 S500 M3\nG0 Z5\nG98 G84 X1 Y2 Z-8 R1\nX5\nG80\nM2\n",
            1.2,
        ),
        (
            "G20\nG94 F25 S500 M4\nG0 Z0.2\nG74 X1 Y2 Z-0.3 R0.1\nX5\nG80\nM2\n",
            1.27,
        ),
    ] {
        let (commands, found) = interpret(program, settings.clone());
        assert!(found.is_empty(), "{found:?}");
        let taps: Vec<_> = (commands.iter())
            .filter_map(|command| match &command.action {
                Action::RigidTap {
                    curve,
                    pitch_mm,
                    return_factor,
                    ..
                } => Some((curve.start(), curve.end(), *pitch_mm, *return_factor)),
                _ => None,
            })
            .collect();
        assert_eq!(taps.len(), 2, "{program}");
        for (start, end, pitch_mm, factor) in taps {
            assert!((pitch_mm - pitch).abs() < 1e-12 && factor == 1.0, "{pitch_mm}");
            assert!(start[2] > end[2] && start[0] == end[0] && start[1] == end[1]);
        }
        // No command to the spindle: the tap itself reverses it.
        let spindle_commands =
            (commands.iter()).filter(|command| matches!(command.action, Action::Spindle { .. }));
        assert_eq!(spindle_commands.count(), 2, "on and off: {program}");
    }
    let without_speed = "G21 G94 F600 S0 M3\nG0 Z5\nG84 X1 Y2 Z-8 R1\nM2\n";
    let found = interpret(without_speed, settings.clone()).1;
    assert_eq!(found.len(), 1, "{found:?}");
    let with_dwell = "G21 G94 F600 S500 M3\nG0 Z5\nG84 X1 Y2 Z-8 R1 P2\nM2\n";
    let commands_with_dwell = interpret(with_dwell, settings).0;
    assert!(
        commands_with_dwell
            .iter()
            .any(|command| matches!(&command.action, Action::Warning(text) if text.contains("G84: P")))
    );
}
