//! A core that moves the router's X axis over the bus, and the bridge of a simulated board under it.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::{BusConfig, CoreBus, Feedback, Setpoint};
use evolvent_disturbance::unless_disturbed;
use evolvent_drive::{DriveState, PowerRequest};
use evolvent_mesa::{BoardSettings, BridgeReport, RunSettings};
use evolvent_mesa_board::{BoardModel, BoardServer};

use super::{Told, machine, router, serve, with_running};

pub(crate) const PERIOD_NS: u64 = 2_000_000;
const LEAD: u64 = 50;
/// Steps a mm of X in the router's board file.
pub(crate) const STEPS: f64 = 320.0;

/// A core that stands, or moves X evenly.
pub(crate) struct Core {
    pub(crate) bus: CoreBus,
    sequence: u64,
    next_ns: u64,
    pub(crate) position: [f64; 9],
    pub(crate) velocity_x: f64,
    pub(crate) power: PowerRequest,
    pub(crate) fault_reset: u32,
    pub(crate) heard: Option<(Instant, Feedback)>,
    pub(crate) board: Option<std::net::IpAddr>,
}

impl Core {
    pub(crate) fn open(prefix: &str) -> Self {
        let mut config = BusConfig::new("mesa-faults", "XYZ", PERIOD_NS);
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
            board: None,
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
    }

    pub(crate) fn rest(&mut self, seconds: f64) {
        for _ in 0..(seconds * 1e9) as u64 / PERIOD_NS {
            self.cycle();
        }
    }

    /// Cycles until fresh feedback shows something.
    pub(crate) fn until(&mut self, what: &str, mut seen: impl FnMut(&Feedback) -> bool) -> Feedback {
        let begin = Instant::now();
        loop {
            self.cycle();
            if let Some((_, feedback)) = self
                .heard
                .filter(|(at, feedback)| at.elapsed() < Duration::from_millis(100) && seen(feedback))
            {
                return feedback;
            }
            assert!(
                begin.elapsed() < Duration::from_secs(20),
                "{what}: not within 20 s; {:?}",
                self.heard
            );
        }
    }

    /// Where the axes stand, with power.
    pub(crate) fn bring_up(&mut self) -> Feedback {
        (self.power, self.velocity_x) = (PowerRequest::Off, 0.0);
        let here = self.until("feedback with the drives off", |feedback| {
            states(feedback) == [Some(DriveState::SwitchOnDisabled); 3]
        });
        self.position = here.position;
        self.rest(0.2);
        self.power = PowerRequest::On;
        self.until("operation", |feedback| {
            states(feedback) == [Some(DriveState::OperationEnabled); 3] && feedback.bridge_state == 1
        })
    }
}

pub(crate) fn states(feedback: &Feedback) -> [Option<DriveState>; 3] {
    core::array::from_fn(|axis| DriveState::decode(feedback.status_word[axis] as u16))
}

/// Runs the bridge, with what it tells, around a test.
pub(crate) fn with_bridge(
    edit: impl Fn(&mut BoardSettings),
    test: impl Fn(&mut Core, &BoardServer, &Told),
) -> BridgeReport {
    with_bridge_to(BoardModel::B7i96s, edit, test)
}

pub(crate) fn with_bridge_to(
    model: BoardModel,
    edit: impl Fn(&mut BoardSettings),
    test: impl Fn(&mut Core, &BoardServer, &Told),
) -> BridgeReport {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    unless_disturbed(|| {
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let prefix = format!("mesaft{}-{number}_", std::process::id());
        let (server, address) = serve(model);
        let mut board = router(address);
        board.watchdog_s = 0.1;
        board.max_lost_packets = 20;
        edit(&mut board);
        let settings = RunSettings {
            machine: machine("router-3axis"),
            machine_name: Some("mesa-faults".to_owned()),
            board,
            prefix: Some(prefix.clone()),
            duration: None,
        };
        let mut core = Core::open(&prefix);
        core.board = Some(address);
        with_running(settings, core, |core, told| test(core, &server, told))
    })
}
