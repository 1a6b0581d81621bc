//! The cycle neither allocates nor frees once all devices are in OP: drives that move, terminals, a fault of
//! a drive.
//!
//! Needs the right to create a network namespace.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use evolvent_bus::{BusConfig, CoreBus, MachineOutputs, Setpoint, remove_private_domain};
use evolvent_counting::{CountingAllocator, calls};
use evolvent_disturbance::unless_disturbed;
use evolvent_drive::PowerRequest;
use evolvent_ethercat::{CycleTimes, Network, ProbeNumber, RunSettings, run_measured};
use evolvent_ethercat_ring::{
    DriveSettings, FaultKind, MAIN_INTERFACE, SubDevice, TerminalKind, monotonic_ns, on_bench,
};
use evolvent_machine::Machine;

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const PERIOD_NS: u64 = 1_000_000;
const CYCLES: usize = 3_000;

#[test]
fn cycles_neither_allocate_nor_free() {
    unless_disturbed(|| {
        let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
        devices.extend((2..5).map(|serial| SubDevice::drive(DriveSettings::default(), serial, 0.0)));
        devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
        devices.push(SubDevice::terminal(TerminalKind::DigitalOutput, 6));
        on_bench(devices, |ring| {
            ring.lock().expect("no panic").wire(5, 4);
            let machine = format!(
                "input = [{{ name = \"echo\", number = 0 }}]\noutput = [{{ name = \"lamp\", number = 0 }}]\n\
                 {}",
                evolvent_file_tests::shipped("machines/mill-ethercat.toml")
            );
            let network = format!(
                "{}input = [{{ name = \"echo\", bit = 0 }}]\n[[device]]\nname = \"outputs\"\n\
                 vendor = 0x4556534D\nproduct = 0x2008\noutput = [{{ name = \"lamp\", bit = 0 }}]\n",
                evolvent_file_tests::shipped("networks/sim-mill.toml")
            );
            let prefix = format!("ecal{}_", std::process::id());
            let mut settings = RunSettings {
                machine: Machine::parse(&machine, "machine.toml").expect("a machine"),
                machine_name: Some("allocation".to_owned()),
                network: Network::parse(&network, "network.toml").expect("a network"),
                interface: MAIN_INTERFACE.to_owned(),
                prefix: Some(prefix.clone()),
                duration: None,
                dump: None,
            };
            settings.network.max_lost_cycles = 50;
            if let Some(axis) = &mut settings.network.devices[2].axis {
                axis.index_probe = Some(ProbeNumber::Two);
            }
            let (stop, times) = (AtomicBool::new(false), CycleTimes::new(CYCLES, calls));
            let mut config = BusConfig::new("allocation", "XYZ", PERIOD_NS);
            config.prefix = Some(prefix.clone());
            let mut bus = CoreBus::open(&config).expect("a bus");
            let begin = Instant::now();
            std::thread::scope(|scope| {
                let bridge =
                    scope.spawn(|| run_measured(&settings, &stop, |text| println!("{text}"), Some(&times)));
                let mut pulses = 0;
                let (mut sequence, mut next_ns, mut faulted) = (0_u64, monotonic_ns(), false);
                while times.cycles().len() < CYCLES && begin.elapsed() < Duration::from_secs(30) {
                    while next_ns < monotonic_ns() {
                        let mut setpoint = Setpoint {
                            sequence,
                            due_time_ns: next_ns + 60 * PERIOD_NS,
                            period_ns: PERIOD_NS,
                            axes_mask: 0b111,
                            state: 1,
                            override_ratio: 1.0,
                            power_request: PowerRequest::On.number(),
                            ..Setpoint::default()
                        };
                        // Y passes its zero impulse near its start, and the impulse is requested repeatedly.
                        setpoint.position[1] = (sequence as f64 * 1e-2).sin() * 0.1;
                        (setpoint.index_request, setpoint.index_axis) = (sequence as u32 / 100, 1);
                        let _reached = bus.publish_setpoint(&setpoint);
                        let outputs = MachineOutputs {
                            sequence: sequence + 1,
                            due_time_ns: setpoint.due_time_ns,
                            digital_mask: 1,
                            digital: (sequence / 16) & 1,
                            ..MachineOutputs::default()
                        };
                        let _reached = bus.publish_outputs(&outputs);
                        (sequence, next_ns) = (sequence + 1, next_ns + PERIOD_NS);
                    }
                    bus.admit_readers();
                    while let Ok(Some(feedback)) = bus.unchecked_feedback() {
                        let has_pulse = feedback.index_request > 0 && !feedback.index_position.is_nan();
                        pulses = pulses.max(if has_pulse { feedback.index_request } else { 0 });
                    }
                    while let Ok(Some(_)) = bus.unchecked_inputs() {}
                    if !faulted && times.cycles().len() > CYCLES / 2 {
                        faulted = true;
                        ring.lock().expect("no panic").begin_fault(
                            monotonic_ns(),
                            FaultKind::Drive,
                            2,
                            Some(100_000_000),
                        );
                    }
                    std::thread::sleep(Duration::from_millis(2));
                }
                stop.store(true, Ordering::Relaxed);
                println!("{:?}", bridge.join().expect("no panic"));
                assert!(pulses > 1, "index pulses have been latched");
            });
            drop(bus);
            let _swept = remove_private_domain(&prefix);
            assert_eq!(times.cycles().len(), CYCLES, "cycles with all devices in OP");
            assert_eq!(times.counted(), 0, "allocations and frees");
        });
    });
}
