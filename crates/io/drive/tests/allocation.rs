//! Counts the allocations of all functions that the cycle and a bridge call once per period: there are none.

use evolvent_counting::calls;
use evolvent_drive::{
    Braking, Cia402, DriveEvents, DriveMachine, DriveSetpoint, FeedbackWatch, Follower, FollowerSettings,
    Gantry, GantryInputs, GantrySettings, OrientationSettings, PhaseLock, PhaseSettings, PowerRequest,
    QuickStopOption, SpindleConditions, SpindleEncoder, SpindleEncoderSettings, SpindleIndex,
    SpindleOrientation, WatchSettings,
};
use evolvent_path::AxisMask;
use evolvent_wire::{AXES, Feedback, Setpoint};

#[test]
fn drive_period_allocates_nothing() {
    let period_ns = 1_000_000;
    let mut watch = FeedbackWatch::new(WatchSettings::new(period_ns, AxisMask::from_bits(0b111)));
    let mut lock = PhaseLock::new(PhaseSettings {
        period_ns,
        delay_cycles: 4,
        target_ns: 0,
    });
    let settings = FollowerSettings {
        period_ns,
        bridge_cycles: 3,
        axes: AxisMask::from_bits(0b111),
        max_velocity: [500.0; AXES],
        max_acceleration: [5000.0; AXES],
        max_jerk: [2e5; AXES],
        sync_tolerance: [0.5; AXES],
    };
    let mut follower = Follower::new(settings).expect("limits");
    let mut controller = Cia402::new();
    let mut drive = DriveMachine::new(QuickStopOption::ThenDisabled);
    let mut gantry = Gantry::new(GantrySettings {
        squaring_offset: 0.1,
        max_difference: 0.5,
        square_velocity: 1.0,
    });
    let (mut squared, mut apart) = (0, 0);
    let events = DriveEvents {
        ready: true,
        at_rest: true,
        fault: None,
    };
    let mut alarms = 0;
    let before = calls();
    drop(std::hint::black_box(vec![1_u8; 100]));
    assert_eq!(calls(), before + 2, "the allocator counts");
    let before = calls();
    for cycle in 0..20_000_u64 {
        let now_ns = (cycle + 10) * period_ns;
        let setpoint = Setpoint {
            sequence: cycle,
            due_time_ns: now_ns + 2 * period_ns,
            power_request: PowerRequest::On.number(),
            ..Setpoint::default()
        };
        // Gaps, silence, and their consequences.
        if cycle % 3000 < 2500 {
            let _refused = follower.offer(now_ns, &setpoint);
        }
        let target = follower.step(now_ns, cycle > 50, &[0.0; AXES]);
        let order = controller.step(
            drive.status_word(),
            target.power,
            target.fault_reset,
            target.position[0],
            0.0,
            Braking::default(),
        );
        drive.step(order.control_word, events);
        // The beam passes both switches, is homed, and finally exceeds the permitted difference.
        let height = 1.0 - (cycle % 4000) as f64 * 1e-3;
        gantry.step(&GantryInputs {
            is_enabled: cycle > 50,
            power: target.power,
            position: [height, height + if cycle > 15_000 { 2.0 } else { 0.2 }],
            velocity: -1.0,
            switches: Some([height < 0.0, height < -0.1]),
            strain: None,
            period_s: 1e-3,
        });
        if cycle % 4000 == 3000 {
            std::hint::black_box(gantry.rename(0.5, true));
        }
        squared += u32::from(gantry.take_squared().is_some());
        apart += u32::from(gantry.fault().is_some());
        let feedback = Feedback {
            sequence: target.sequence,
            time_ns: now_ns,
            axes_mask: 0b111,
            status_word: [u32::from(drive.status_word()); AXES],
            bridge_state: target.state.number(),
            ..Feedback::default()
        };
        let result = watch.step(
            now_ns,
            &DriveSetpoint::of(&setpoint),
            (cycle % 7 != 0).then_some(&feedback),
        );
        alarms += u32::from(result.is_err());
        std::hint::black_box(lock.step(Some(target.phase_error_ns)));
    }
    assert_eq!(calls(), before);
    assert!(alarms > 0, "the paths of alarms were taken");
    assert!(
        squared > 0 && apart > 0,
        "{squared} times squared, {apart} periods apart"
    );
}

#[test]
fn a_period_of_a_spindle_allocates_nothing() {
    let mut encoder = SpindleEncoder::new(SpindleEncoderSettings {
        counter_bits: 16,
        counts_per_turn: 4096,
        gear: [3, 2],
        inverted: true,
        index: SpindleIndex::PerSpindleTurn,
        index_tolerance: 8,
        at_speed_fraction: 0.02,
    });
    let mut orientation = SpindleOrientation::new(OrientationSettings {
        gain: 8.0,
        integral_gain: 10.0,
        max_rpm: 60.0,
        tolerance_deg: 0.5,
    });
    let (mut faults, mut messages) = (0, 0);
    let before = calls();
    for period in 0..20_000_u32 {
        let now_ns = u64::from(period + 1) * 1_000_000;
        let raw = period.wrapping_mul(47);
        encoder.read(raw, now_ns);
        match period % 100 {
            10 => encoder.set_armed(),
            // Pulses at wrong positions.
            60 => encoder.latch(raw.wrapping_sub(5)),
            90 => encoder.reset(),
            _ => {}
        }
        faults += u32::from(encoder.fault().is_some());
        std::hint::black_box(orientation.step(90.0, 0, &encoder, now_ns));
        let message = encoder.feedback(&SpindleConditions {
            direction: 3,
            is_oriented: orientation.is_oriented(),
            ..SpindleConditions::default()
        });
        messages += u32::from(message.is_valid());
    }
    assert_eq!(calls(), before);
    assert!(faults > 0 && messages == 20_000, "{faults} {messages}");
}
