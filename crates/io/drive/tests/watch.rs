//! The core's monitoring: no alarm without a fault, and the right alarm for each fault.

use evolvent_drive::{
    BridgeState, DriveAlarm, DriveState, Note, PowerRequest, Presence, WatchMode, WatchSettings,
};
use evolvent_path::AxisMask;
use evolvent_wire::{AXES, Feedback};

use crate::watch_bench::{Bench, DELAY, PERIOD_NS, running, settings};

#[test]
fn a_bridge_that_does_its_work_is_never_complained_of() {
    let mut bench = Bench::new(settings());
    assert_eq!(bench.run(20_000), Presence::Operational);
    // Not with every second message missing either, nor with bursts.
    for n in 0..20_000_u64 {
        bench
            .cycle(|feedback| (n % 13 < 6).then_some(feedback))
            .expect("nothing is wrong");
    }
}

/// With a lead of 100 cycles the axes begin to move 0.1 s after the first setpoint of the motion, which is no
/// fault.
#[test]
fn a_long_lead_is_no_fault() {
    let mut bench = Bench::new(settings());
    bench.delay = 100;
    bench.run(200);
    assert_eq!(bench.run(20_000), Presence::Operational);
}

#[test]
fn without_a_bridge_the_mode_decides() {
    for (mode, alarm) in [
        (WatchMode::Ignore, false),
        (WatchMode::IfPresent, false),
        (WatchMode::Required, true),
    ] {
        let mut bench = Bench::new(WatchSettings { mode, ..settings() });
        let mut found = None;
        for _ in 0..500 {
            found = found.or(bench.cycle(|_| None).err());
        }
        assert_eq!(
            matches!(found, Some(DriveAlarm::Missing { .. })),
            alarm,
            "{mode:?} {found:?}"
        );
    }
    let mut bench = Bench::new(WatchSettings {
        mode: WatchMode::Ignore,
        ..settings()
    });
    for _ in 0..500 {
        let worst = |feedback: Feedback| {
            Some(Feedback {
                position: [f64::NAN; AXES],
                ..feedback
            })
        };
        assert_eq!(bench.cycle(worst), Ok(Presence::Absent));
    }
}

#[test]
fn silence_is_stale_after_the_time_that_was_set() {
    let (alarm, cycles) = running().alarm(100, |_| None);
    let DriveAlarm::Stale { age_ns, limit_ns, .. } = alarm else {
        panic!("{alarm}")
    };
    // The last sample was half a period old on arrival.
    assert_eq!((limit_ns, cycles), (20_000_000, 19));
    assert!(age_ns > limit_ns);
}

#[test]
fn a_repeated_sample_is_frozen() {
    let mut bench = running();
    let old = bench.feedback();
    let (alarm, _) = bench.alarm(100, |_| Some(old));
    assert!(matches!(alarm, DriveAlarm::Frozen { .. }), "{alarm}");
}

#[test]
fn fresh_samples_of_dead_encoder_are_a_frozen_axis() {
    let mut bench = running();
    let position = bench.feedback().position;
    let (alarm, _) = bench.alarm(500, |feedback| Some(Feedback { position, ..feedback }));
    assert!(
        matches!(
            alarm,
            DriveAlarm::FrozenAxis { axis: 0, .. } | DriveAlarm::FollowingError { axis: 0, .. }
        ),
        "{alarm}"
    );
    // Without a commanded motion the encoder may stay constant.
    let mut bench = Bench::new(settings());
    bench.run(49);
}

#[test]
fn each_number_that_is_none_is_named_by_its_axis() {
    for axis in 0..3 {
        let broken: [fn(&mut Feedback, usize); 4] = [
            |feedback, axis| feedback.position[axis] = f64::NAN,
            |feedback, axis| feedback.velocity[axis] = f64::INFINITY,
            |feedback, axis| feedback.following_error[axis] = f64::NEG_INFINITY,
            |feedback, axis| feedback.torque_ratio[axis] = f64::NAN,
        ];
        for spoil in broken {
            let (alarm, cycles) = running().alarm(1, |mut feedback| {
                spoil(&mut feedback, axis);
                Some(feedback)
            });
            assert_eq!((alarm, cycles), (DriveAlarm::NotFinite { axis }, 0));
        }
    }
    // Axes that the machine does not have may have any value.
    let mut bench = running();
    for _ in 0..10 {
        assert!(
            bench
                .cycle(|feedback| Some(Feedback {
                    position: [feedback.position[0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, f64::NAN],
                    ..feedback
                }))
                .is_ok()
        );
    }
}

#[test]
fn fault_switched_off_and_never_ready_differ() {
    let mut bench = running();
    bench.status = DriveState::FaultReactionActive;
    let (alarm, cycles) = bench.alarm(1, |feedback| {
        Some(Feedback {
            error_code: 0x7500,
            ..feedback
        })
    });
    assert!(
        matches!(
            alarm,
            DriveAlarm::DriveFault {
                axis: 0,
                error_code: 0x7500,
                ..
            }
        ),
        "{alarm}"
    );
    assert_eq!(cycles, 0);

    let mut bench = running();
    let (alarm, _) = bench.alarm(1, |mut feedback| {
        feedback.status_word[2] = u32::from(DriveState::SwitchOnDisabled.code());
        Some(feedback)
    });
    assert!(matches!(alarm, DriveAlarm::DriveOff { axis: 2, .. }), "{alarm}");

    let mut bench = Bench::new(settings());
    bench.status = DriveState::ReadyToSwitchOn;
    let (alarm, cycles) = bench.alarm(1000, Some);
    assert!(matches!(alarm, DriveAlarm::NotEnabled { axis: 0, .. }), "{alarm}");
    assert_eq!(cycles, 101, "the time that was set");

    let (alarm, _) = running().alarm(1, |feedback| {
        Some(Feedback {
            axes_mask: 0b101,
            ..feedback
        })
    });
    assert_eq!(alarm, DriveAlarm::AxisMissing { axis: 1 });
}

#[test]
fn jump_and_growing_following_error_are_distinguished() {
    let (alarm, cycles) = running().alarm(3, |mut feedback| {
        feedback.position[0] += 2.0;
        Some(feedback)
    });
    assert!(matches!(alarm, DriveAlarm::Jump { axis: 0, .. }), "{alarm}");
    assert_eq!(cycles, 0);

    // At rest Y may be 0.5 mm off; it creeps away by 10 um a cycle.
    let mut bench = running();
    let begin = bench.cycle;
    let mut found = None;
    while found.is_none() && bench.cycle < begin + 200 {
        let off = (bench.cycle - begin) as f64 * 0.01;
        found = bench
            .cycle(|mut feedback| {
                feedback.position[1] += off;
                Some(feedback)
            })
            .err();
    }
    let Some(DriveAlarm::FollowingError {
        axis: 1,
        error,
        bound,
        ..
    }) = found
    else {
        unreachable!("{found:?}")
    };
    assert_eq!(bound, 0.5);
    assert!((error + 0.51).abs() < 1e-9, "{error}");
}

/// Following begins at a distance from the setpoints, and each bridge removes it by its own method. Until then
/// no axis may move.
#[test]
fn drives_are_operational_once_axes_are_at_setpoints() {
    // Distance of Y from its setpoint by cycle, and the cycle from which on it is operational.
    let decays = |n: u64| 0.49 * (1.0 - n as f64 / 40.0).max(0.0);
    let stays = |_: u64| 0.3;
    let is_at_once = |_: u64| 0.2;
    type Distance = fn(u64) -> f64;
    let cases: [(Distance, u64); 3] = [(decays, 20), (stays, 101), (is_at_once, 0)];
    for (distance, expected) in cases {
        for sign in [1.0, -1.0] {
            let mut bench = Bench::new(settings());
            let mut first = None;
            for n in 0..300 {
                let off = sign * distance(n);
                let presence = bench.cycle(|mut feedback| {
                    feedback.position[1] += off;
                    Some(feedback)
                });
                match presence {
                    Ok(Presence::Operational) => first = first.or(Some(n)),
                    found => assert_eq!((found, first), (Ok(Presence::Enabling), None), "{n}"),
                }
            }
            assert_eq!(first, Some(expected));
        }
    }
}

/// An encoder that counts backwards drives its axis away from the start.
#[test]
fn axes_never_at_their_setpoints_are_still_monitored() {
    for (off, moves) in [(0.51, 0.0), (0.3, 0.01), (0.3, 2.0)] {
        let mut bench = Bench::new(settings());
        let mut found = None;
        for n in 0..50 {
            let result = bench.cycle(|mut feedback| {
                feedback.position[2] += off + moves * f64::from(n);
                Some(feedback)
            });
            assert_ne!(result, Ok(Presence::Operational));
            found = found.or(result.err());
        }
        let is_right = match found {
            Some(DriveAlarm::FollowingError { axis: 2, .. }) => moves < 1.0,
            Some(DriveAlarm::Jump { axis: 2, .. }) => moves > 1.0,
            _ => false,
        };
        assert!(is_right, "{off} {moves}: {found:?}");
    }
    let mut bench = Bench::new(settings());
    let far = |mut feedback: Feedback| {
        feedback.position[1] += 0.3;
        Some(feedback)
    };
    assert_eq!(bench.cycle(far), Ok(Presence::Enabling));
    bench.status = DriveState::Fault;
    assert!(matches!(
        bench.cycle(far),
        Err(DriveAlarm::DriveFault { axis: 0, .. })
    ));
    bench.status = DriveState::OperationEnabled;
    bench.state = BridgeState::Holding;
    assert!(matches!(bench.cycle(far), Err(DriveAlarm::BridgeStopped { .. })));
}

#[test]
fn following_error_bound_grows_with_velocity() {
    // 20 ms at 300 mm/s are 6 mm: a lag of 15 ms is permitted, one of 30 ms is not.
    for (trail_s, fine) in [(0.015, true), (0.030, false)] {
        let mut bench = Bench::new(settings());
        let mut found = None;
        while found.is_none() && bench.cycle < 2000 {
            let time_s = (bench.cycle as f64 - DELAY as f64 - 50.0) * 1e-3 - trail_s;
            found = bench
                .cycle(|mut feedback| {
                    feedback.position[0] = Bench::position(time_s)[0];
                    Some(feedback)
                })
                .err();
        }
        assert_eq!(found.is_none(), fine, "{trail_s} {found:?}");
        assert!(
            matches!(found, None | Some(DriveAlarm::FollowingError { axis: 0, .. })),
            "{found:?}"
        );
    }
}

#[test]
fn restarted_stopped_or_foreign_bridge_is_detected() {
    let mut bench = running();
    bench.instance = 2;
    assert_eq!(bench.alarm(1, Some).0, DriveAlarm::BridgeRestarted);

    let mut bench = running();
    bench.state = BridgeState::Holding;
    let (alarm, _) = bench.alarm(1, |feedback| {
        Some(Feedback {
            note: Note::Silence.number(),
            ..feedback
        })
    });
    assert_eq!(alarm, DriveAlarm::BridgeStopped { state: 4, note: 2 });

    let (alarm, _) = running().alarm(1, |feedback| {
        Some(Feedback {
            sequence: 1 << 40,
            ..feedback
        })
    });
    assert!(matches!(alarm, DriveAlarm::Implausible { .. }), "{alarm}");
}

#[test]
fn limit_switch_stops_only_motion_towards_it() {
    let at = |velocity_sign: f64, positive: bool| {
        let mut bench = running();
        while bench.command().velocity[0] * velocity_sign < 50.0 {
            bench.run(1);
        }
        bench.cycle(|feedback| {
            Some(Feedback {
                positive_limit_mask: u32::from(positive),
                negative_limit_mask: u32::from(!positive),
                ..feedback
            })
        })
    };
    for positive in [true, false] {
        let towards = if positive { 1.0 } else { -1.0 };
        assert_eq!(
            at(towards, positive),
            Err(DriveAlarm::LimitSwitch { axis: 0, positive })
        );
        assert_eq!(at(-towards, positive), Ok(Presence::Operational));
    }
}

/// Homing evaluates the switch in the direction of its search itself.
#[test]
fn limit_expected_at_one_end_stops_at_the_other() {
    for positive in [true, false] {
        let mut bench = running();
        let towards = if positive { 1.0 } else { -1.0 };
        while bench.command().velocity[0] * towards < 50.0 {
            bench.run(1);
        }
        let both = |feedback: Feedback| {
            Some(Feedback {
                positive_limit_mask: 1,
                negative_limit_mask: 1,
                ..feedback
            })
        };
        bench.switches_expected[usize::from(positive)] = AxisMask::one(0);
        assert_eq!(bench.cycle(both), Ok(Presence::Operational));
        bench.switches_expected.swap(0, 1);
        assert_eq!(
            bench.cycle(both),
            Err(DriveAlarm::LimitSwitch { axis: 0, positive })
        );
    }
}

#[test]
fn axes_without_power_raise_no_alarm() {
    let mut bench = running();
    bench.power = PowerRequest::Off;
    bench.status = DriveState::Fault;
    bench.state = BridgeState::Off;
    for n in 0..100 {
        let presence = bench.cycle(|mut feedback| {
            feedback.position[0] += 100.0 * f64::from(n);
            feedback.instance = 9;
            Some(feedback)
        });
        assert_eq!(presence, Ok(Presence::Idle));
    }
    for _ in 0..2000 {
        assert!(bench.cycle(|_| None).is_ok());
    }
    assert_eq!(bench.cycle(|_| None), Ok(Presence::Absent));
    // A new bridge, and power again.
    bench.power = PowerRequest::On;
    bench.status = DriveState::OperationEnabled;
    bench.state = BridgeState::Following;
    bench.instance = 10;
    while Bench::position((bench.cycle as f64 - 50.0) * 1e-3)[1].abs() > 20.0 {
        bench.cycle += 1;
    }
    assert_eq!(bench.run(30), Presence::Operational);
}

#[test]
fn new_datum_is_no_jump_and_missed_one_is_detected() {
    let mut bench = running();
    // The core assigns a new coordinate; feedback with the old one still arrives for some cycles.
    for n in 0..100 {
        bench.datum = 1;
        bench.shift = 250.0;
        let sent_before = n < DELAY;
        let result = bench.cycle(|mut feedback| {
            if sent_before {
                feedback.datum = 0;
                feedback.position[0] -= 250.0;
            }
            Some(feedback)
        });
        assert_eq!(result, Ok(Presence::Operational), "{n}");
    }
    bench.datum = 2;
    let (alarm, _) = bench.alarm(100, |feedback| Some(Feedback { datum: 1, ..feedback }));
    assert_eq!(
        alarm,
        DriveAlarm::Datum {
            expected: 2,
            found: 1
        }
    );
}

#[test]
fn every_alarm_has_unique_number_and_remedy() {
    let alarms = [
        DriveAlarm::Missing { waited_ns: 1 },
        DriveAlarm::Stale {
            age_ns: 25_400_000,
            limit_ns: 20_000_000,
            sequence: 7,
        },
        DriveAlarm::Frozen {
            age_ns: 1,
            sequence: 7,
        },
        DriveAlarm::FrozenAxis {
            axis: 0,
            commanded: 1.0,
            position: 2.0,
        },
        DriveAlarm::NotFinite { axis: 99 },
        DriveAlarm::AxisMissing { axis: 1 },
        DriveAlarm::DriveFault {
            axis: 2,
            status_word: 8,
            error_code: 0x7500,
        },
        DriveAlarm::DriveOff {
            axis: 2,
            status_word: 8,
        },
        DriveAlarm::NotEnabled {
            axis: 2,
            status_word: 8,
            waited_ns: 1,
        },
        DriveAlarm::Jump {
            axis: 0,
            step: 1.0,
            bound: 0.5,
            interval_ns: 1,
        },
        DriveAlarm::FollowingError {
            axis: 0,
            error: 1.0,
            bound: 0.5,
            velocity: 0.0,
        },
        DriveAlarm::LimitSwitch {
            axis: 0,
            positive: true,
        },
        DriveAlarm::BridgeRestarted,
        DriveAlarm::BridgeStopped { state: 4, note: 2 },
        DriveAlarm::Implausible { sequence: 1, sent: 0 },
        DriveAlarm::Datum {
            expected: 1,
            found: 0,
        },
        DriveAlarm::AheadOfTime { ahead_ns: 2_500_000 },
        DriveAlarm::Unbelievable {
            field: "position",
            axis: Some(1),
            value: 1e308,
            bound: 800.0,
        },
    ];
    for (i, alarm) in alarms.iter().enumerate() {
        assert_eq!(alarm.number() as usize, 400 + i);
        let text = alarm.to_string();
        assert!(text.contains(": ") && text.len() < 220, "{text}");
        // Drives that never came up, have lost power, stopped by themselves or were restarted cannot follow a
        // path.
        let is_led = ![400, 405, 406, 407, 408, 412, 413].contains(&alarm.number());
        assert_eq!(alarm.drives_follow(), is_led, "{text}");
    }
    assert!(alarms[5].to_string().contains("axis Y"), "{}", alarms[5]);
    assert!(alarms[17].to_string().contains("`zero`"), "{}", alarms[17]);
    assert!(alarms[4].to_string().contains("axis ?"), "{}", alarms[4]);
    assert!(
        alarms[1].to_string().contains("25.4 ms old, 20.0 ms"),
        "{}",
        alarms[1]
    );
}

/// A bridge whose clock is ahead, killed in motion: its last sample must not count as new until that time.
#[test]
fn bridge_death_is_detected_whatever_its_clock() {
    for ahead_ns in [0, 1_000_000, 15_000_000, 20_400_000, 60_000_000_000, u64::MAX / 2] {
        let mut bench = running();
        let mut found = None;
        let mut silent = 0;
        while found.is_none() && silent < 100 {
            // Ten messages with the wrong clock, then none.
            let lives = bench.cycle < 210;
            silent += u64::from(!lives);
            let result = bench.cycle(|mut feedback| {
                feedback.time_ns = feedback.time_ns.saturating_add(ahead_ns);
                lives.then_some(feedback)
            });
            found = result.err();
        }
        let Some(alarm) = found else {
            unreachable!("{ahead_ns}: silent for 100 ms and no alarm");
        };
        // 20 ms from its arrival, as for any bridge.
        assert!(silent <= 21, "{ahead_ns}: {alarm} after {silent} ms");
        let is_ahead = matches!(alarm, DriveAlarm::AheadOfTime { .. });
        assert_eq!(is_ahead, ahead_ns > 20_500_000, "{ahead_ns}: {alarm}");
    }
}

#[test]
fn a_clock_that_goes_backwards_is_frozen_feedback() {
    let mut bench = running();
    let mut back_ns = 0;
    let mut found = None;
    for _ in 0..100 {
        back_ns += 2 * PERIOD_NS;
        let result = bench.cycle(|mut feedback| {
            feedback.time_ns -= back_ns;
            Some(feedback)
        });
        found = found.or(result.err());
    }
    assert!(matches!(found, Some(DriveAlarm::Frozen { .. })), "{found:?}");
}

/// The mask of references lost in this many good cycles.
fn lost(bench: &mut Bench, cycles: u64) -> u32 {
    for _ in 0..cycles {
        let _alarm = bench.cycle(Some);
    }
    bench.watch.take_reference_lost().bits()
}

#[test]
fn link_loss_loses_reference_unless_absolute() {
    for power in [PowerRequest::Off, PowerRequest::On] {
        for absolute_mask in [0, 0b010] {
            let mut bench = Bench::new(settings());
            bench.power = power;
            bench.absolute_mask = absolute_mask;
            assert_eq!(lost(&mut bench, 200), 0);
            bench.instance = 2;
            assert_eq!(lost(&mut bench, 2), 0b111 & !absolute_mask, "restarted");
            assert_eq!(lost(&mut bench, 200), 0, "told once");
            bench.power = PowerRequest::Off;
            for _ in 0..900 {
                let _alarm = bench.cycle(|_| None);
            }
            assert_eq!(bench.watch.take_reference_lost().bits(), 0, "not gone yet");
            for _ in 0..200 {
                let _alarm = bench.cycle(|_| None);
            }
            assert_eq!(
                bench.watch.take_reference_lost().bits(),
                0b111 & !absolute_mask,
                "gone"
            );
            // An axis reported as absolute only afterwards may have lost its reference before.
            let mut bench = Bench::new(settings());
            bench.power = power;
            assert_eq!(lost(&mut bench, 200), 0);
            (bench.instance, bench.absolute_mask) = (2, 0b111);
            assert_eq!(lost(&mut bench, 2), 0b111);
        }
    }
}

#[test]
fn encoder_jump_without_power_loses_reference() {
    let mut bounds = settings();
    bounds.bounds.set_axis(1, [0.0, 800.0], 500.0);
    let mut bench = Bench::new(bounds);
    bench.power = PowerRequest::Off;
    assert_eq!(lost(&mut bench, 100), 0);
    // Moved by hand, at the maximum velocity of the axis: 0.5 mm per cycle.
    for n in 0..100 {
        let moved = bench.cycle(|mut feedback| {
            feedback.position[1] += 0.5 * f64::from(n);
            Some(feedback)
        });
        assert!(moved.is_ok());
    }
    assert_eq!(bench.watch.take_reference_lost().bits(), 0);
    let jumped = bench.cycle(|mut feedback| {
        feedback.position[1] += 60.0;
        Some(feedback)
    });
    assert!(jumped.is_ok());
    assert_eq!(bench.watch.take_reference_lost().bits(), 0b010);
}
