//! The bridge's reports of the distributed clocks, compared with clocks of known drifts on the simulated
//! ring, over real sockets.
//!
//! Needs the right to create a network namespace.
#![expect(clippy::expect_used, reason = "a test")]

use std::time::{Duration, Instant};

use evolvent_bridge_trial::PERIOD_NS;
use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat::ClockFigures;
use evolvent_ethercat_ring::{
    DriveSettings, FaultKind, Ring, SubDevice, TerminalKind, monotonic_ns, on_bench,
};

use crate::support::*;

const Y_DRIVE: usize = 2;

/// The shipped mill with a reference clock (the coupler's) that is faster than this computer's by
/// `reference_ppm`, and drives that are slower than the reference by 0, 50 and 100 ppm.
fn drifting(reference_ppm: f64) -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1).with_drift_ppm(reference_ppm)];
    devices.extend((2..5).map(|serial| {
        let slower = 50.0 * f64::from(serial - 2);
        SubDevice::drive(DriveSettings::default(), serial, reference_ppm - slower)
    }));
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices
}

/// The system time of a device minus that of the reference, at one instant in the ring, ns.
fn true_difference_ns(ring: &Ring, device: usize) -> f64 {
    let now_ns = monotonic_ns();
    let [own, reference] = [device, 0].map(|device| {
        let time = ring.devices()[device].system_time_ns(now_ns);
        time.expect("a clock").cast_signed()
    });
    own.wrapping_sub(reference) as f64
}

#[test]
fn shift_jitter_and_drift_are_those_of_the_clocks() {
    // Clocks of 32 bits begin again each 4.3 s.
    for (reference_ppm, has_short_clocks) in [(400.0, false), (-250.0, true)] {
        unless_disturbed(|| {
            let mut devices = drifting(reference_ppm);
            if has_short_clocks {
                devices = devices
                    .into_iter()
                    .map(SubDevice::with_clock_of_32_bits)
                    .collect();
            }
            on_bench(devices, move |ring| {
                let report = with_bridge(
                    |_| {},
                    ring,
                    |core, _, _| {
                        core.bring_up();
                        let since = Instant::now();
                        while since.elapsed() < Duration::from_secs(5) {
                            core.cycle();
                        }
                    },
                );
                println!("{report:?}");
                let clocks = report.clocks.expect("distributed clocks");
                let drift_ppm = clocks.drift_ppm.expect("a drift after five seconds");
                // A computer whose reference gains is slow.
                assert!((drift_ppm + reference_ppm).abs() < 10.0, "{drift_ppm} ppm");
                // The loop shortens each period by a sixteenth of the phase: on average that equals the gain
                // of the reference per period.
                let shift_ns = 16.0 * reference_ppm * 1e-6 * PERIOD_NS as f64;
                let off = clocks.shift_ns as f64 - shift_ns;
                assert!(off.abs() < 3_000.0, "{} of {shift_ns} ns", clocks.shift_ns);
                let half_ns = PERIOD_NS / 2;
                let ClockFigures {
                    jitter_p50_ns,
                    jitter_p999_ns,
                    jitter_max_ns,
                    ..
                } = clocks;
                assert!(
                    jitter_p50_ns > 0 && jitter_p50_ns <= jitter_p999_ns && jitter_p999_ns <= jitter_max_ns
                );
                assert!(jitter_p50_ns < half_ns / 4, "{clocks:?}");
                // Five seconds of a reading each 20 ms.
                assert!((100..=400).contains(&clocks.readings), "{clocks:?}");
            });
        });
    }
}

/// 32-bit and 64-bit clocks on one ring: each drive receives its outputs in the middle between two of its
/// SYNC0. Without SYNC0 it does not reach OP. Outputs that meet a SYNC0 at another remainder of 2^32 ns would
/// be off by almost half a period.
#[test]
fn drives_with_any_clock_follow_32_bit_reference() {
    for short_drives in [&[][..], &[Y_DRIVE]] {
        unless_disturbed(|| {
            let with_short = |(position, device): (usize, SubDevice)| {
                if position == 0 || short_drives.contains(&position) {
                    device.with_clock_of_32_bits()
                } else {
                    device
                }
            };
            let devices = drifting(50.0).into_iter().enumerate().map(with_short).collect();
            on_bench(devices, |ring| {
                let mut phases_ns = [const { Vec::new() }; 3];
                let report = with_bridge(
                    |_| {},
                    ring,
                    |core, ring, _| {
                        core.bring_up();
                        // Over more than one end of 32 bits.
                        let since = Instant::now();
                        while since.elapsed() < Duration::from_secs(6) {
                            core.cycle();
                            let ring = ring.lock().expect("no panic");
                            for (phases_ns, drive) in phases_ns.iter_mut().zip(&ring.devices()[1..4]) {
                                phases_ns.push(drive.outputs_after_sync0_ns().expect("outputs and SYNC0"));
                            }
                        }
                    },
                );
                assert!(report.ready == 1 && report.clocks.is_some(), "{report:?}");
                for mut phases_ns in phases_ns {
                    phases_ns.sort_unstable();
                    let median_ns = phases_ns[phases_ns.len() / 2];
                    println!("outputs {median_ns} ns after SYNC0");
                    assert!(
                        median_ns.abs_diff(PERIOD_NS / 2) < PERIOD_NS / 8,
                        "{median_ns} ns"
                    );
                }
            });
        });
    }
}

#[test]
fn device_with_diverging_clock_is_named_with_offset() {
    unless_disturbed(|| {
        on_bench(drifting(0.0), |ring| {
            let mut truth_ns = (0.0, 0.0);
            let report = with_bridge(
                |_| {},
                ring,
                |core, ring, _| {
                    core.bring_up();
                    for _ in 0..500 {
                        core.cycle();
                    }
                    truth_ns.0 = true_difference_ns(&ring.lock().expect("no panic"), Y_DRIVE);
                    begin(ring, FaultKind::ClockFree, Y_DRIVE, None);
                    let since = Instant::now();
                    while since.elapsed() < Duration::from_secs(2) {
                        core.cycle();
                    }
                    truth_ns.1 = true_difference_ns(&ring.lock().expect("no panic"), Y_DRIVE);
                },
            );
            println!("{truth_ns:?} {report:?}");
            let clocks = report.clocks.expect("distributed clocks");
            assert_eq!(clocks.max_difference_device, Some(Y_DRIVE));
            // 50 ppm for two seconds: 100 us late, which sets bit 31 of the register.
            assert!(
                (truth_ns.1 - truth_ns.0 + 100_000.0).abs() < 2_000.0,
                "{truth_ns:?}"
            );
            // The last reading is up to three readings and a half old, and the filter of the register four
            // periods.
            let found_ns = f64::from(clocks.max_difference_ns);
            assert!(
                (found_ns - truth_ns.1).abs() < 8_000.0,
                "{found_ns} of {truth_ns:?}"
            );
            assert_eq!(clocks.last_difference_ns, clocks.max_difference_ns);
        });
    });
}

#[test]
fn without_distributed_clocks_there_are_no_figures() {
    unless_disturbed(|| {
        on_bench(drifting(0.0), |ring| {
            let report = with_bridge(
                |network| network.distributed_clocks = false,
                ring,
                |core, _, _| {
                    let _up = core.bring_up();
                },
            );
            assert!(report.ready > 0 && report.clocks.is_none(), "{report:?}");
        });
    });
}
