//! Terminals on the simulated ring as inputs and outputs of the machine, over real sockets.
//!
//! Needs the right to create a network namespace.

#![expect(clippy::expect_used, reason = "a test")]

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use evolvent_bridge_trial::{Messages, with_bridge as with_bridge_and_core};
use evolvent_bus::{BusConfig, CoreBus, MachineInputs, MachineOutputs, Setpoint};
use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat::{Network, RunSettings, check_fit, run};
use evolvent_ethercat_ring::{
    DriveSettings, FaultKind, MAIN_INTERFACE, SharedRing, SubDevice, TerminalKind, monotonic_ns, on_bench,
};
use evolvent_machine::Machine;

const PERIOD_NS: u64 = 2_000_000;
const LEAD_NS: u64 = 40_000_000;

const MACHINE: &str = r#"
input = [
    { name = "door", number = 3 },
    { name = "pressure", number = 2, kind = "analog", min = 0, max = 16 },
    { name = "z-reference", number = 9 },
]
output = [
    { name = "clamp", number = 4, safe_on = true },
    { name = "valve", number = 1, kind = "analog", min = -5, max = 5, safe_value = -2 },
]
spindle = [{ max_rpm = 6000 }]
"#;

/// After the devices of the mill: digital outputs, analog inputs, analog outputs.
const TERMINALS: &str = r#"
input = [{ name = "door", bit = 7, inverted = true }]

[[device]]
name = "outputs"
vendor = 0x4556534D
product = 0x2008
output = [
    { name = "clamp", bit = 5 },
    { function = "flood", bit = 0 },
    { function = "spindle-clockwise", bit = 1, inverted = true },
]

[[device]]
name = "analog-in"
vendor = 0x4556534D
product = 0x3102
input = [{ name = "pressure", bit = 48, values = [0, 16], error_bit = 38 }]

[[device]]
name = "analog-out"
vendor = 0x4556534D
product = 0x4102
output = [
    { function = "spindle-speed", bit = 0, values = [0, 6000] },
    { name = "valve", bit = 16, raw = [-32767, 32767], values = [-10, 10] },
]
"#;
const INPUTS: usize = 4;
const OUTPUTS: usize = 5;
const ANALOG_IN: usize = 6;
const ANALOG_OUT: usize = 7;

fn devices() -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    devices.extend((2..5).map(|serial| SubDevice::drive(DriveSettings::default(), serial, 0.0)));
    for (kind, serial) in [
        (TerminalKind::DigitalInput, 5),
        (TerminalKind::DigitalOutput, 6),
        (TerminalKind::AnalogInput, 7),
        (TerminalKind::AnalogOutput, 8),
    ] {
        devices.push(SubDevice::terminal(kind, serial));
    }
    devices
}

fn network() -> Network {
    let mill = evolvent_file_tests::shipped("networks/sim-mill.toml");
    // The home switch of Z as an input of the machine: bit 1 of 60FDh is its upper limit switch.
    let mill = mill.replacen(
        "limit_switches = true               # bits 0 and 1 of 60FDh\n",
        "limit_switches = true\n\n[[device.input]]\nname = \"z-reference\"\nbit = 1\n",
        1,
    );
    Network::parse(&format!("{mill}{TERMINALS}"), "terminals.toml").expect("a network")
}

fn machine() -> Machine {
    let mill = evolvent_file_tests::shipped("machines/mill-ethercat.toml");
    Machine::parse(&format!("{MACHINE}{mill}"), "mill.toml").expect("a machine")
}

/// A core at rest without power, with outputs.
pub(crate) struct Core {
    bus: CoreBus,
    sequence: u64,
    next_ns: u64,
    pub(crate) outputs: MachineOutputs,
    inputs: Option<MachineInputs>,
}

impl Core {
    fn open(prefix: &str) -> Self {
        let mut config = BusConfig::new("ethercat-signals", "XYZ", PERIOD_NS);
        config.prefix = Some(prefix.to_owned());
        let mut outputs = MachineOutputs {
            digital_mask: 1 << 4,
            digital: 1 << 4,
            safe_digital: 1 << 4,
            analog_mask: 1 << 1,
            spindle_mask: 1,
            ..MachineOutputs::default()
        };
        (outputs.analog[1], outputs.safe_analog[1]) = (-2.0, -2.0);
        Self {
            bus: CoreBus::open(&config).expect("a bus"),
            sequence: 0,
            next_ns: monotonic_ns(),
            outputs,
            inputs: None,
        }
    }

    fn cycle(&mut self) {
        let due_time_ns = self.next_ns + LEAD_NS;
        let setpoint = Setpoint {
            sequence: self.sequence,
            due_time_ns,
            period_ns: PERIOD_NS,
            axes_mask: 0b111,
            override_ratio: 1.0,
            ..Setpoint::default()
        };
        let _reached = self.bus.publish_setpoint(&setpoint);
        if self.sequence.is_multiple_of(25) {
            self.publish(due_time_ns);
        }
        self.sequence += 1;
        self.listen();
        self.next_ns = (self.next_ns + PERIOD_NS).max(monotonic_ns().saturating_sub(LEAD_NS / 2));
        std::thread::sleep(Duration::from_nanos(self.next_ns.saturating_sub(monotonic_ns())));
    }

    fn publish(&mut self, due_time_ns: u64) {
        (self.outputs.sequence, self.outputs.due_time_ns) = (self.outputs.sequence + 1, due_time_ns);
        let _reached = self.bus.publish_outputs(&self.outputs);
    }

    fn listen(&mut self) {
        self.bus.admit_readers();
        while let Ok(Some(_)) = self.bus.unchecked_feedback() {}
        while let Ok(Some(inputs)) = self.bus.unchecked_inputs() {
            self.inputs = Some(inputs);
        }
    }

    pub(crate) fn until(&mut self, what: &str, mut condition: impl FnMut(Option<&MachineInputs>) -> bool) {
        let begin = Instant::now();
        while !condition(self.inputs.as_ref()) {
            self.cycle();
            assert!(
                begin.elapsed() < Duration::from_secs(20),
                "{what}: {:?}",
                self.inputs
            );
        }
    }
}

/// Digital outputs, and both analog ones.
fn driven(ring: &SharedRing) -> (u8, [i16; 2]) {
    let ring = ring.lock().expect("no panic");
    let terminal = |at: usize| ring.devices()[at].as_terminal().expect("a terminal");
    (terminal(OUTPUTS).bits(), terminal(ANALOG_OUT).analog())
}

fn with_bridge(ring: &SharedRing, test: impl FnOnce(&mut Core, &SharedRing)) {
    with_files(machine(), network(), ring, |core, ring, _| test(core, ring));
}

/// Runs the bridge with these files beside a core.
pub(crate) fn with_files(
    machine: Machine,
    mut network: Network,
    ring: &SharedRing,
    test: impl FnOnce(&mut Core, &SharedRing, &Messages),
) {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let prefix = format!("ecst{}-{number}_", std::process::id());
    network.max_lost_cycles = 20;
    let settings = RunSettings {
        machine,
        machine_name: Some("ethercat-signals".to_owned()),
        network,
        interface: MAIN_INTERFACE.to_owned(),
        prefix: Some(prefix.clone()),
        duration: None,
        dump: None,
    };
    with_bridge_and_core(
        &prefix,
        |stop, messages| run(&settings, stop, |text| messages.push(text)),
        Core::open(&prefix),
        |core, messages| test(core, ring, messages),
    );
}

/// Clamp on and spindle not clockwise (inverted): bits 5 and 1. -2 of -10 to 10 is -6553.4.
const SAFE: (u8, [i16; 2]) = (0b10_0010, [0, -6553]);

#[test]
fn outputs_follow_the_core_and_are_safe_without_it() {
    assert_eq!(check_fit(&machine(), &network()), Ok(()));
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(ring, |core, ring| {
                core.until("inputs, with safe outputs", |inputs| {
                    inputs.is_some() && driven(ring) == SAFE
                });
                // Clamp off, flood on, clockwise at 1500 of 6000 rpm, valve at 2.5 of 10.
                core.outputs.digital = 0;
                core.outputs.coolant = 0b10;
                (core.outputs.spindle_direction[0], core.outputs.spindle_rpm[0]) = (1, 1500.0);
                core.outputs.analog[1] = 2.5;
                let wanted = (0b00_0001, [8192, 8192]);
                core.until("outputs as the core says", |_| driven(ring) == wanted);
                let set = core.outputs.sequence;
                core.until("their number", |inputs| {
                    inputs.is_some_and(|inputs| inputs.outputs_sequence >= set)
                });
                // The core becomes silent.
                let begin = Instant::now();
                while driven(ring) != SAFE {
                    assert!(begin.elapsed() < Duration::from_secs(2), "{:?}", driven(ring));
                    std::thread::sleep(Duration::from_millis(2));
                }
                let after = begin.elapsed();
                // 200 ms of silence, less the time that the core sent ahead: none of those messages may be
                // lost.
                assert!(after >= Duration::from_millis(150), "safe after {after:?}");
                core.next_ns = monotonic_ns();
                core.until("outputs of the core again", |_| driven(ring) == wanted);
            });
            // The bridge has ended: safe values first, then the terminals' watchdogs.
            let (bits, analog) = driven(ring);
            assert!(
                matches!((bits, analog), SAFE | (0, [0, 0])),
                "{bits:#b} {analog:?}"
            );
        });
    });
}

#[test]
fn inputs_are_scaled_inverted_and_unknown_if_unread() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            with_bridge(ring, |core, ring| {
                let set = |device: usize, change: &dyn Fn(&mut evolvent_ethercat_ring::Terminal)| {
                    let mut ring = ring.lock().expect("no panic");
                    change(
                        ring.device_mut(device)
                            .and_then(SubDevice::as_terminal_mut)
                            .expect("a terminal"),
                    );
                };
                let digital = |door: bool, reference: bool| u64::from(door) << 3 | u64::from(reference) << 9;
                core.until("open inputs", |inputs| {
                    inputs.is_some_and(|inputs| {
                        (inputs.digital_mask, inputs.digital) == (digital(true, true), digital(true, false))
                            && (inputs.analog_mask, inputs.analog[2]) == (0b100, 0.0)
                    })
                });
                set(INPUTS, &|terminal| terminal.set_inputs(0x80));
                set(ANALOG_IN, &|terminal| terminal.set_analog(1, 20_000));
                let expected = 20_000.0 / 32_767.0 * 16.0;
                core.until("door and pressure", |inputs| {
                    inputs.is_some_and(|inputs| {
                        inputs.digital == digital(false, false) && (inputs.analog[2] - expected).abs() < 1e-9
                    })
                });
                ring.lock().expect("no panic").begin_fault(
                    monotonic_ns(),
                    FaultKind::Limit,
                    3,
                    Some(300_000_000),
                );
                core.until("the switch at the drive of Z", |inputs| {
                    inputs.is_some_and(|inputs| inputs.digital == digital(false, true))
                });
                set(ANALOG_IN, &|terminal| terminal.set_broken(true));
                core.until("a broken wire", |inputs| {
                    inputs.is_some_and(|inputs| inputs.analog_mask == 0 && inputs.digital_mask != 0)
                });
                // A value below the machine file's range: this one alone is unknown.
                set(ANALOG_IN, &|terminal| terminal.set_broken(false));
                set(ANALOG_IN, &|terminal| terminal.set_analog(1, -5));
                core.until("a value out of range", |inputs| {
                    inputs.is_some_and(|inputs| {
                        inputs.analog_mask == 0 && inputs.digital_mask == digital(true, true)
                    })
                });
                // The cable before the digital inputs opens: everything after it is unknown.
                ring.lock().expect("no panic").begin_fault(
                    monotonic_ns(),
                    FaultKind::Break,
                    4,
                    Some(10_000_000_000),
                );
                core.until("the break", |inputs| {
                    inputs.is_some_and(|inputs| inputs.digital_mask & digital(true, false) == 0)
                });
            });
        });
    });
}

#[test]
fn a_signal_beyond_the_process_data_is_told() {
    unless_disturbed(|| {
        on_bench(devices(), |_| {
            let text = format!(
                "{}{}",
                evolvent_file_tests::shipped("networks/sim-mill.toml"),
                TERMINALS
            );
            let network =
                Network::parse(&text.replace("bit = 7,", "bit = 8,"), "bad.toml").expect("a network");
            let prefix = format!("ecsb{}_", std::process::id());
            let settings = RunSettings {
                machine: machine(),
                machine_name: Some("ethercat-signals".to_owned()),
                network,
                interface: MAIN_INTERFACE.to_owned(),
                prefix: Some(prefix.clone()),
                duration: None,
                dump: None,
            };
            let expected =
                "`inputs`: the network file has a signal up to bit 8 of its inputs, of which there are 8";
            with_bridge_and_core(
                &prefix,
                |stop, messages| {
                    let _report = run(&settings, stop, |text| messages.push(text));
                    Ok::<_, ()>(())
                },
                Core::open(&prefix),
                |core, messages| {
                    let begin = Instant::now();
                    while !messages.contain(expected) && begin.elapsed() < Duration::from_secs(15) {
                        core.cycle();
                    }
                    assert!(messages.contain(expected), "{messages:#?}");
                },
            );
        });
    });
}
