//! A core that stands or moves X, and the bridge of the shipped network around it.

#![expect(clippy::expect_used, clippy::print_stdout, reason = "a test")]
#![allow(dead_code, reason = "each test takes its part")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use evolvent_bus::{BusConfig, CoreBus, Feedback, MachineInputs, Setpoint, remove_private_domain};
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_ethercat::{BridgeReport, Network, RunSettings, run};
use evolvent_ethercat_ring::{
    DriveSettings, FaultKind, MAIN_INTERFACE, SharedRing, SubDevice, TerminalKind, monotonic_ns,
};
use evolvent_machine::Machine;

pub(crate) const PERIOD_NS: u64 = 2_000_000;
pub(crate) const LEAD: u64 = 50;

/// A core that stands, or moves X evenly.
pub(crate) struct Core {
    pub(crate) bus: CoreBus,
    pub(crate) sequence: u64,
    pub(crate) next_ns: u64,
    pub(crate) position: [f64; 9],
    pub(crate) velocity_x: f64,
    pub(crate) power: PowerRequest,
    pub(crate) fault_reset: u32,
    pub(crate) heard: Option<(Instant, Feedback)>,
    pub(crate) inputs: Option<MachineInputs>,
}

impl Core {
    pub(crate) fn open(prefix: &str) -> Self {
        let mut config = BusConfig::new("ethercat-faults", "XYZ", PERIOD_NS);
        config.prefix = Some(prefix.to_owned());
        Self {
            bus: CoreBus::open(&config).expect("a bus"),
            sequence: 0,
            next_ns: monotonic_ns(),
            position: [0.0; 9],
            velocity_x: 0.0,
            power: PowerRequest::Off,
            fault_reset: 0,
            heard: None,
            inputs: None,
        }
    }

    pub(crate) fn cycle(&mut self) {
        self.position[0] += self.velocity_x * PERIOD_NS as f64 * 1e-9;
        let mut setpoint = Setpoint {
            sequence: self.sequence,
            due_time_ns: self.next_ns + LEAD * PERIOD_NS,
            period_ns: PERIOD_NS,
            position: self.position,
            axes_mask: 0b111,
            state: 1,
            override_ratio: 1.0,
            power_request: self.power.number(),
            fault_reset: self.fault_reset,
            ..Setpoint::default()
        };
        setpoint.velocity[0] = self.velocity_x;
        self.sequence += 1;
        let _reached = self.bus.publish_setpoint(&setpoint);
        self.next_ns = (self.next_ns + PERIOD_NS).max(monotonic_ns().saturating_sub(LEAD * PERIOD_NS / 2));
        std::thread::sleep(Duration::from_nanos(self.next_ns.saturating_sub(monotonic_ns())));
        self.bus.admit_readers();
        while let Ok(Some(feedback)) = self.bus.unchecked_feedback() {
            self.heard = Some((Instant::now(), feedback));
        }
        while let Ok(Some(inputs)) = self.bus.unchecked_inputs() {
            self.inputs = Some(inputs);
        }
    }

    /// Cycles until fresh feedback shows something; how long that took.
    pub(crate) fn until(
        &mut self,
        what: &str,
        mut seen: impl FnMut(&Feedback) -> bool,
    ) -> (Duration, Feedback) {
        let begin = Instant::now();
        loop {
            self.cycle();
            if let Some((_, feedback)) = self
                .heard
                .filter(|(at, feedback)| at.elapsed() < Duration::from_millis(100) && seen(feedback))
            {
                return (begin.elapsed(), feedback);
            }
            assert!(
                begin.elapsed() < Duration::from_secs(30),
                "{what}: not within 30 s; {:?}",
                self.heard
            );
        }
    }

    /// Where the axes stand, with power.
    pub(crate) fn bring_up(&mut self) -> Feedback {
        (self.power, self.velocity_x) = (PowerRequest::Off, 0.0);
        let (_, here) = self.until("feedback with the drives off", |feedback| {
            states(feedback)
                .iter()
                .all(|state| *state == Some(DriveState::SwitchOnDisabled))
        });
        self.position = here.position;
        for _ in 0..2 * LEAD {
            self.cycle();
        }
        self.power = PowerRequest::On;
        self.until("operation", |feedback| {
            states(feedback) == [Some(DriveState::OperationEnabled); 3] && feedback.bridge_state == 1
        })
        .1
    }
}

pub(crate) fn states(feedback: &Feedback) -> [Option<DriveState>; 3] {
    core::array::from_fn(|axis| DriveState::decode(feedback.status_word[axis] as u16))
}

pub(crate) fn devices() -> Vec<SubDevice> {
    let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
    devices.extend(
        (2..5).map(|serial| SubDevice::drive(DriveSettings::default(), serial, 10.0 * f64::from(serial))),
    );
    devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
    devices
}

/// Runs the bridge, with what it tells, around a test.
pub(crate) fn with_bridge(
    edit: impl FnOnce(&mut Network),
    ring: &SharedRing,
    test: impl FnOnce(&mut Core, &SharedRing, &Mutex<Vec<String>>),
) -> BridgeReport {
    with_settings(|settings| edit(&mut settings.network), ring, test)
}

/// The same with other settings of the bridge.
pub(crate) fn with_settings(
    edit: impl FnOnce(&mut RunSettings),
    ring: &SharedRing,
    test: impl FnOnce(&mut Core, &SharedRing, &Mutex<Vec<String>>),
) -> BridgeReport {
    static NUMBER: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let prefix = format!("ecft{}-{number}_", std::process::id());
    let mut network = Network::parse(
        &evolvent_file_tests::shipped("networks/sim-mill.toml"),
        "sim-mill.toml",
    )
    .expect("a network");
    network.max_lost_cycles = 20;
    let mut settings = RunSettings {
        machine: Machine::parse(
            &evolvent_file_tests::shipped("machines/mill-3axis.toml"),
            "mill.toml",
        )
        .expect("a machine"),
        machine_name: Some("ethercat-faults".to_owned()),
        network,
        interface: MAIN_INTERFACE.to_owned(),
        prefix: Some(prefix.clone()),
        duration: None,
        dump: None,
    };
    edit(&mut settings);
    let (stop, told) = (Arc::new(AtomicBool::new(false)), Arc::new(Mutex::new(Vec::new())));
    let bridge = std::thread::spawn({
        let (stop, told) = (Arc::clone(&stop), Arc::clone(&told));
        move || {
            run(&settings, &stop, |text| {
                told.lock().expect("no panic").push(text.to_owned());
            })
        }
    });
    let mut core = Core::open(&prefix);
    let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| test(&mut core, ring, &told)));
    stop.store(true, Ordering::Relaxed);
    let report = bridge.join().expect("no panic");
    drop(core);
    let _swept = remove_private_domain(&prefix);
    println!("{told:#?} {report:?}");
    if let Err(panic) = result {
        std::panic::resume_unwind(panic);
    }
    report.expect("a bridge that fits")
}

pub(crate) fn begin(ring: &SharedRing, kind: FaultKind, device: usize, duration_ns: Option<u64>) {
    ring.lock()
        .expect("no panic")
        .begin_fault(monotonic_ns(), kind, device, duration_ns);
}

pub(crate) fn speeds(ring: &SharedRing) -> Vec<f64> {
    let ring = ring.lock().expect("no panic");
    ring.devices()
        .iter()
        .filter_map(|device| device.as_drive())
        .map(|drive| drive.speed_turns_s().abs())
        .collect()
}

pub(crate) fn was_told(told: &Mutex<Vec<String>>, what: &str) -> bool {
    told.lock()
        .expect("no panic")
        .iter()
        .any(|text| text.contains(what))
}
