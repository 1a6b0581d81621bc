use evolvent_drive::{DriveEvents, DriveMachine, QuickStopOption};

use super::*;
use crate::homing::{HOMING_MODE, HomingOnDrive};
use crate::network::NetworkAxis;

const PERIOD_NS: u64 = 1_000_000;

/// The shipped mill and its network, with more in the machine file.
fn mill_with(more: &str) -> (Machine, Network) {
    let shipped = evolvent_file_tests::shipped;
    let text = format!("{}{more}", shipped("machines/mill-ethercat.toml"));
    let machine = Machine::parse(&text, "mill.toml").expect("a machine");
    let network = Network::parse(&shipped("networks/sim-mill.toml"), "mill.toml").expect("a network");
    (machine, network)
}

/// The axes of a network.
fn axes_of(network: &mut Network) -> impl Iterator<Item = &mut NetworkAxis> {
    let devices = network.devices.iter_mut();
    devices.filter_map(|device| device.axis.as_mut())
}

/// Homing by the drive, with this order in the sequence.
fn homing_on_drive(order: u32) -> Option<HomingOnDrive> {
    Some(HomingOnDrive {
        method: 18,
        search: 10_000_000,
        latch: 1_000_000,
        acceleration: None,
        position: -5.0,
        order,
        timeout_s: 10.0,
    })
}

/// A session of these drives.
fn drives_of(machine: &Machine, network: &Network, starts: &Starts) -> DriveSet {
    DriveSet::new(machine, network, PERIOD_NS, 1, starts).expect("settings")
}

/// At 300 mm/s, with a sample in each period, after four lost frames, and after a suspension of the bridge
/// for ten periods.
#[test]
fn velocity_after_lost_frames_uses_time_of_samples() {
    let (machine, network) = mill_with("");
    let mut drives = drives_of(&machine, &network, &Starts::default());
    let mut period = 0;
    for periods in [1, 1, 5, 1, 10, 1] {
        period += periods;
        // 2^20 increments a turn of 5 mm; frames are not exactly a period apart.
        let position = (0.3 * period as f64 * 1_048_576.0 / 5.0) as i32;
        let inputs = DriveInputs {
            position,
            ..DriveInputs::default()
        };
        let jitter_ns = 300_000 * (period % 2);
        drives.take(period * PERIOD_NS + jitter_ns, 0, inputs);
        let velocity = drives.axes()[0].velocity();
        assert!(
            period == 1 || (velocity - 300.0).abs() < 0.01,
            "{periods}: {velocity} mm/s"
        );
    }
}

/// A multi-turn counter without `absolute`, 500 turns from its zero.
#[test]
fn homed_drive_starts_at_zero_and_survives_sessions() {
    let homing = "\n[[homing]]\naxis = \"X\"\ntowards = \"negative\"\nsearch_mm_s = 50\nlatch_mm_s = 5\n\
                  switch_mm = -5\n";
    // 2^20 increments a turn of 5 mm.
    let turns = |turns: f64| DriveInputs {
        position: (turns * 1_048_576.0) as i32,
        status_word: DriveState::SwitchOnDisabled.code(),
        ..DriveInputs::default()
    };
    for (homing, begins, comes_back, after_reset) in [
        (homing, 0.0, 10.0, 0.0),
        // Nothing shows that its counter is not valid.
        ("", 2500.0, 2510.0, 5.0),
    ] {
        let (machine, network) = mill_with(homing);
        let starts = Starts::default();
        let session = || drives_of(&machine, &network, &starts);
        let mut first = session();
        // The drive has not filled its process data yet.
        first.take(1_000_000, 0, DriveInputs::default());
        first.take(2_000_000, 0, turns(500.0));
        assert!((first.axes()[0].position() - begins).abs() < 1e-6);
        let mut second = session();
        second.take(8_000_000, 0, DriveInputs::default());
        second.take(9_000_000, 0, turns(502.0));
        assert!((second.axes()[0].position() - comes_back).abs() < 1e-6);
        // Without voltage meanwhile: the counter has restarted. Only a homed axis may begin at zero.
        let mut third = session();
        third.take(19_000_000, 0, turns(1.0));
        let position = third.axes()[0].position();
        assert!((position - after_reset).abs() < 1e-6, "{position}");
        // That is its coordinate from then on.
        let mut fourth = session();
        fourth.take(29_000_000, 0, turns(3.0));
        let position = fourth.axes()[0].position();
        assert!((position - after_reset - 10.0).abs() < 1e-6, "{position}");
    }
}

/// The drives of the shipped mill, of which the first two find their zero one after the other, and their
/// core.
struct Bench {
    drives: DriveSet,
    machines: Vec<DriveMachine>,
    now_ns: u64,
    setpoint: Setpoint,
    fault: Option<u16>,
    /// Increments of the drives, and whether they are ready.
    position: [i32; 3],
    ready: [bool; 3],
}

impl Bench {
    fn new(homes: bool) -> Self {
        let (machine, mut network) = mill_with("");
        for (axis, order) in axes_of(&mut network).zip(0..2).filter(|_| homes) {
            axis.homing = homing_on_drive(order);
        }
        let mut bench = Self {
            drives: drives_of(&machine, &network, &Starts::default()),
            machines: vec![DriveMachine::new(QuickStopOption::ThenDisabled); 3],
            now_ns: 1_000_000_000,
            setpoint: Setpoint {
                period_ns: PERIOD_NS,
                axes_mask: 0b111,
                ..Setpoint::default()
            },
            fault: None,
            position: [0; 3],
            ready: [true; 3],
        };
        bench.request(PowerRequest::Off);
        bench
    }

    fn request(&mut self, power: PowerRequest) {
        self.setpoint.power_request = power.number();
    }

    /// Runs periods with or without a core. Returns the outputs of the last.
    fn run(&mut self, periods: u32, has_core: bool) -> Vec<DriveOutputs> {
        let mut outputs = Vec::new();
        for _ in 0..periods {
            if has_core {
                self.setpoint.sequence += 1;
                self.setpoint.due_time_ns = self.now_ns + PERIOD_NS;
                self.drives.offer(self.now_ns, &self.setpoint);
            }
            self.now_ns += PERIOD_NS;
            self.drives.step(self.now_ns);
            outputs = (0..3).map(|axis| self.drives.outputs(axis)).collect();
            for (axis, machine) in self.machines.iter_mut().enumerate() {
                let events = DriveEvents {
                    ready: self.ready[axis],
                    at_rest: true,
                    fault: self.fault,
                };
                machine.step(outputs[axis].control_word & 0x8F, events);
                let inputs = DriveInputs {
                    status_word: machine.status_word(),
                    mode: outputs[axis].mode,
                    position: self.position[axis],
                    ..DriveInputs::default()
                };
                self.drives.take(self.now_ns, axis, inputs);
            }
        }
        outputs
    }
}

#[test]
fn faults_are_reset_only_for_core_that_requests_it() {
    let mut bench = Bench::new(false);
    // Drives that are in fault before the session, whose core has reset three faults.
    bench.fault = Some(0x2310);
    bench.run(5, false);
    bench.fault = None;
    bench.setpoint.fault_reset = 3;
    bench.run(50, true);
    let is_in_fault = |bench: &Bench| {
        let mut machines = bench.machines.iter();
        machines.all(|machine| machine.state() == DriveState::Fault)
    };
    assert!(is_in_fault(&bench), "a new session");
    // Another core, which begins to count, once after a silence and once at once.
    for silence in [500, 0] {
        bench.run(silence, false);
        (bench.setpoint.sequence, bench.setpoint.fault_reset) = (0, 4 - bench.setpoint.fault_reset);
        bench.run(50, true);
        assert!(
            is_in_fault(&bench),
            "a core that counts from {}",
            bench.setpoint.fault_reset
        );
    }
    bench.setpoint.fault_reset += 1;
    bench.run(50, true);
    let feedback = bench.drives.feedback(bench.now_ns).expect("feedback");
    assert_eq!(feedback.fault_reset_done, bench.setpoint.fault_reset);
    assert!(!is_in_fault(&bench));
}

/// A vertical axis, held by its position loop: it sinks by one increment per period if its target follows it.
#[test]
fn a_drive_that_waits_for_the_others_holds_its_place() {
    let mut bench = Bench::new(false);
    bench.ready[1] = false;
    bench.run(20, true);
    bench.position[0] = 1000;
    bench.request(PowerRequest::On);
    bench.run(10, true);
    assert_eq!(bench.machines[0].state(), DriveState::OperationEnabled);
    for _ in 0..500 {
        bench.position[0] -= 1;
        assert_eq!(bench.run(1, true)[0].target, 1000);
    }
    // The others come into operation, and the core's setpoints are at its position: no step.
    bench.ready[1] = true;
    bench.setpoint.position = bench.drives.feedback(bench.now_ns).expect("feedback").position;
    bench.setpoint.position[0] += 500.0 * 5.0 / 1_048_576.0;
    for _ in 0..50 {
        assert_eq!(bench.run(1, true)[0].target, 1000);
    }
    assert_eq!(bench.machines[1].state(), DriveState::OperationEnabled);
    // Moved by hand without power: it holds where it comes into operation again.
    bench.request(PowerRequest::Off);
    bench.run(20, true);
    bench.position[0] = 7000;
    bench.run(20, true);
    bench.setpoint.position = bench.drives.feedback(bench.now_ns).expect("feedback").position;
    bench.request(PowerRequest::On);
    for _ in 0..10 {
        assert_eq!(bench.run(1, true)[0].target, 7000);
    }
}

/// A probe at two drives, whose first contact bounces: one drive is armed again in time to count the bounce.
#[test]
fn bounce_counted_by_one_drive_leaves_next_touches() {
    let (machine, mut network) = mill_with("");
    axes_of(&mut network)
        .take(2)
        .for_each(|axis| axis.touch_probe = true);
    let mut drives = drives_of(&machine, &network, &Starts::default());
    // Edges by ms, of the first drive and of the second, which is slower by a period.
    let edges = [[10, 18, 500, 900], [11, 0, 501, 901]];
    let mut seen = Vec::new();
    for ms in 1..1000_i32 {
        for (drive, edges) in edges.iter().enumerate() {
            // Stored for two periods; then off, and armed again.
            let is_stored = edges.iter().any(|edge| (*edge..edge + 2).contains(&ms));
            let is_off = edges.iter().any(|edge| (edge + 2..edge + 4).contains(&ms));
            let inputs = DriveInputs {
                status_word: DriveState::OperationEnabled.code(),
                probe_status: u16::from(is_stored) << 1 | u16::from(!is_off && ms > 3),
                probe_position: ms,
                position: ms,
                ..DriveInputs::default()
            };
            drives.take(ms as u64 * PERIOD_NS, drive, inputs);
        }
        let reading = drives.probe();
        if [15, 30, 510, 910].contains(&ms) {
            let increments = reading.position[0] * 1_048_576.0 / 5.0;
            seen.push((reading.trips, reading.latched_mask, increments.round() as i32));
        }
    }
    // The second of these drives is Y.
    assert_eq!(
        seen,
        [(1, 0b11, 10), (1, 0b11, 10), (2, 0b11, 500), (3, 0b11, 900)]
    );
}

#[test]
fn homing_drives_stop_without_core_and_none_starts() {
    let mut bench = Bench::new(true);
    bench.run(20, true);
    bench.request(PowerRequest::On);
    let outputs = bench.run(50, true);
    let modes: Vec<i8> = outputs.iter().map(|outputs| outputs.mode).collect();
    assert_eq!(modes, [HOMING_MODE, 8, 8]);
    assert_eq!(bench.machines[0].state(), DriveState::OperationEnabled);
    // Setpoints are late for a few periods, then there are none.
    bench.run(8, false);
    assert_eq!(bench.machines[0].state(), DriveState::OperationEnabled);
    bench.run(5, false);
    for _ in 0..2000 {
        let outputs = bench.run(1, false);
        assert!(outputs.iter().all(|outputs| outputs.mode != HOMING_MODE));
        assert!(bench.machines.iter().all(|machine| !machine.has_torque()));
    }
    // The same core was only late: power returns after off.
    let outputs = bench.run(50, true);
    assert!(outputs.iter().all(|outputs| outputs.mode != HOMING_MODE));
    bench.request(PowerRequest::Off);
    bench.run(20, true);
    bench.request(PowerRequest::On);
    assert_eq!(bench.run(50, true)[0].mode, HOMING_MODE);
}

/// A counter without `absolute` 500 turns from its zero, which the drive's own homing sets to 0.
#[test]
fn homed_drive_counts_from_zero_in_next_session() {
    let (machine, mut network) = mill_with("");
    let axis = axes_of(&mut network).next().expect("an axis");
    axis.homing = homing_on_drive(0);
    let starts = Starts::default();
    let session = || drives_of(&machine, &network, &starts);
    let mut first = session();
    let at = |position: i32, status_word: u16| DriveInputs {
        position,
        status_word,
        mode: HOMING_MODE,
        ..DriveInputs::default()
    };
    let enabled = DriveState::OperationEnabled.code();
    let attained = 1 << 10 | 1 << 12;
    for period in 0..40_u64 {
        let inputs = if period < 20 {
            at(500 << 20, enabled)
        } else {
            at(0, enabled | attained)
        };
        first.take((period + 1) * 1_000_000, 0, inputs);
        let _outputs = first.axes[0].outputs(None, PowerRequest::On, Some(0), 1e-3);
    }
    assert_eq!(first.axes()[0].homing(), HomingProgress::Done);
    assert!((first.axes()[0].position() + 5.0).abs() < 1e-9);
    let mut second = session();
    // A turn of 5 mm from its homed position.
    second.take(90_000_000, 0, at(1 << 20, DriveState::SwitchOnDisabled.code()));
    let position = second.axes()[0].position();
    assert!(position.abs() < 1e-9, "{position}");
}
