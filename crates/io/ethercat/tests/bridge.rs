//! The bridge on the simulated ring, over real sockets: what every bridge must do.
//!
//! Needs the right to make a network namespace.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a test")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use evolvent_bridge_test::{BridgeUnderTest, CASES, Stage, StartError, run_case};
use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat::{Network, RunSettings, run};
use evolvent_ethercat_ring::{DriveSettings, MAIN_INTERFACE, SubDevice, TerminalKind, on_bench};
use evolvent_machine::Machine;

const NETWORK: &str = include_str!("../../../../config/networks/sim-mill.toml");

fn devices() -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    for serial in 2..5 {
        devices.push(SubDevice::drive(
            DriveSettings::default(),
            serial,
            15.0 * f64::from(serial),
        ));
    }
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices.push(SubDevice::terminal(TerminalKind::DigitalOutput, 6));
    devices
}

/// Bit 2 of the outputs is output 0, bit 2 of the inputs input 0; the ring wires them.
const SIGNALS: &str = r#"
input = [{ name = "echo", bit = 2 }]

[[device]]
name = "outputs"
vendor = 0x4556534D
product = 0x2008
output = [{ name = "lamp", bit = 2 }]
"#;
const MACHINE_SIGNALS: &str = r#"
input = [{ name = "echo", number = 0 }]
output = [{ name = "lamp", number = 0 }]
"#;

/// The bridge on a thread of this process.
struct EthercatBridge {
    machine: Machine,
    running: Option<(Arc<AtomicBool>, JoinHandle<()>)>,
}

impl BridgeUnderTest for EthercatBridge {
    fn start(&mut self, machine_name: &str, prefix: &str) -> Result<(), StartError> {
        self.end();
        let mut network = Network::parse(&format!("{NETWORK}{SIGNALS}"), "sim-mill.toml").expect("a network");
        // The suite's period is 2 ms, the devices' watchdog 100 ms; a host that is busy may be late for so long.
        network.max_lost_cycles = 40;
        let settings = RunSettings {
            machine: self.machine.clone(),
            machine_name: Some(machine_name.to_owned()),
            network,
            interface: MAIN_INTERFACE.to_owned(),
            prefix: Some(prefix.to_owned()),
            duration: None,
            dump: None,
        };
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let report = run(&settings, &flag, |text| println!("{text}"));
            println!("{report:?}");
        });
        self.running = Some((stop, thread));
        Ok(())
    }

    fn end(&mut self) {
        if let Some((stop, thread)) = self.running.take() {
            stop.store(true, Ordering::Relaxed);
            thread.join().expect("no panic");
        }
    }

    fn kill(&mut self) {
        self.end();
    }

    fn can_be_killed(&self) -> bool {
        false
    }

    fn is_running(&mut self) -> bool {
        self.running
            .as_ref()
            .is_some_and(|(_, thread)| !thread.is_finished())
    }
}

#[test]
fn it_does_what_every_bridge_must() {
    let wanted = std::env::var("EVOLVENT_CASE").ok();
    unless_disturbed(|| {
        let wanted = wanted.clone();
        on_bench(devices(), move |ring| {
            ring.lock().expect("no panic").wire(5, 4);
            let text = evolvent_file_tests::shipped("machines/mill-3axis.toml");
            let mut bridge = EthercatBridge {
                machine: Machine::parse(&format!("{MACHINE_SIGNALS}{text}"), "mill-3axis.toml")
                    .expect("a machine"),
                running: None,
            };
            let mut failures = Vec::new();
            for case in CASES
                .iter()
                .filter(|case| wanted.as_ref().is_none_or(|wanted| case.name == wanted))
            {
                let mut stage = Stage {
                    bridge: &mut bridge,
                    machine_name: "bridge-test".to_owned(),
                    prefix: format!("ecbt{}_", std::process::id()),
                    core_program: None,
                    seed: 1,
                    moments: 2,
                    has_signals: true,
                };
                let result = run_case(case, &mut stage);
                println!("{}: {result:?}", case.name);
                failures.extend(result.err().map(|error| format!("{}: {error}", case.name)));
                bridge.end();
            }
            assert!(failures.is_empty(), "{failures:#?}");
        });
    });
}
