//! Lathes on hardware bridges, simulated over real sockets: two axes, and a spindle with an encoder. The
//! reference is the true angle and the true carriage position of the simulator, read at the same instant; no
//! bridge sees either.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex};

use evolvent_ethercat_ring::{
    DriveSettings, FaultKind as RingFault, MAIN_INTERFACE, Ring, SharedRing, SubDevice, TerminalKind,
    monotonic_ns, on_bench,
};
use evolvent_mesa_board::{Board, BoardModel, BoardServer, FaultKind, Spindle, SpindleCommand, now_ns};
use evolvent_random::Random;

use crate::{Workshop, repository};

/// Start positions of the axes, mm.
const HOME: [f64; 2] = [20.0, 10.0];

/// One observation of a machine.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// True turns of the spindle since an index pulse.
    pub turns: f64,
    /// True position of the carriage, mm.
    pub z: f64,
    /// Number of packets received from the bridge.
    pub packets: u64,
    /// Time of CLOCK_MONOTONIC.
    pub time_ns: u64,
}

/// Trouble that a simulator makes on demand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trouble {
    /// The encoder stops sending.
    EncoderOff,
    /// It loses counts.
    LostCounts,
    /// It sends no index pulse.
    IndexMissing,
    /// The spindle stalls under power.
    Stall,
    /// No packet arrives at the bridge.
    LinkLost,
    /// The spindle's drive is in fault.
    DriveFault,
}

/// A lathe on a bridge.
pub trait Lathe: Send + Sync {
    /// Its machine file with a given name and these spindles.
    fn machine(&self, workshop: &Workshop, name: &str, spindles: &str) -> PathBuf {
        workshop.lathe(name, spindles)
    }
    /// Positions of X and Z after its drives have homed on their own, which they do when power is first
    /// requested.
    fn homed_at(&self) -> Option<[f64; 2]> {
        None
    }
    /// Sets the coordinate of Z. A drive finds its zero some time after the edge of its switch, by an amount
    /// that no setting states.
    fn set_z(&self, _z: f64) {}
    /// Arguments of the bridge after `evolvent bridge`.
    fn bridge(&self, workshop: &Workshop) -> Vec<String>;
    /// The true state now.
    fn observe(&self) -> Sight;
    /// Starts the trouble.
    fn trouble(&self, trouble: Trouble);
    /// Turns of the spindle per count of its encoder.
    fn resolution(&self) -> f64;
    /// The smallest step of the carriage, mm.
    fn step_mm(&self) -> f64;
}

const COUNTS: i64 = 4096;
const INDEX: i64 = 1500;
const STEPS: [f64; 2] = [1000.0, 1400.0];
/// The last byte of the address of the next board.
static BOARDS: AtomicU8 = AtomicU8::new(1);

/// Two steppers, an inverter with contacts, and a spindle encoder on a 7I96S.
pub struct MesaLathe {
    server: BoardServer,
    address: std::net::IpAddr,
    max_lost_packets: u32,
}

impl MesaLathe {
    /// A board at its own address.
    ///
    /// # Panics
    /// If this computer has no free address.
    #[must_use]
    pub fn start() -> Self {
        let process = std::process::id();
        let number = BOARDS.fetch_add(1, Ordering::Relaxed);
        let address = std::net::IpAddr::from([127, 130 + (process >> 8) as u8 % 80, process as u8, number]);
        let server =
            BoardServer::start(Board::new(BoardModel::B7i96s, now_ns()), address).expect("an address");
        {
            let mut board = server.lock();
            board.set_spindle(Spindle {
                ripple: 0.01,
                ..Spindle::usual(
                    0,
                    SpindleCommand::Contacts {
                        unit: 0,
                        forward: 15,
                        reverse: 16,
                    },
                )
            });
            board.set_index(0, INDEX);
            board.turn_shaft(0, Random::new().between(-10_000.0, 10_000.0));
            for unit in 0..2 {
                board.set_motor(unit, 600_000.0, 600_000.0);
            }
        }
        Self {
            server,
            address,
            max_lost_packets: 40,
        }
    }

    /// With another maximum number of consecutive lost packets: at a low rate a step generator overflows
    /// before the usual number is reached.
    #[must_use]
    pub fn with_lost_packets(mut self, max_lost_packets: u32) -> Self {
        self.max_lost_packets = max_lost_packets;
        self
    }
}

impl Lathe for MesaLathe {
    fn bridge(&self, workshop: &Workshop) -> Vec<String> {
        let mut text = format!(
            "address = \"{}\"\nname = \"7I96S\"\nmax_lost_packets = {}\nwatchdog_ms = 400\n",
            self.address, self.max_lost_packets
        );
        for (unit, letter) in ["X", "Z"].iter().enumerate() {
            text += &format!(
                "[[axis]]\nletter = \"{letter}\"\nstepgen = {unit}\nsteps_per_unit = {}\n\
                 step_length_ns = 1000\nstep_space_ns = 1000\ndirection_setup_ns = 200\n\
                 direction_hold_ns = 200\nzero = {}\n",
                STEPS[unit], HOME[unit]
            );
        }
        text += "[[spindle]]\npwm = 0\nfull_rpm = 3000\nforward = { pin = 15 }\nreverse = { pin = 16 }\n\
            encoder = 0\ncounts_per_rev = 4096\n\
            orientation = { gain = 8, i_gain = 10, rpm = 60, tolerance_deg = 0.5 }\n";
        let board = workshop.write("board.toml", text);
        let board = board.to_str().expect("UTF-8").to_owned();
        ["mesa", "--board", &board].map(str::to_owned).to_vec()
    }

    fn observe(&self) -> Sight {
        let mut board = self.server.lock();
        let time_ns = now_ns();
        board.advance(time_ns);
        Sight {
            packets: board.traffic().packets,
            turns: (board.shaft(0) - INDEX as f64) / COUNTS as f64,
            z: HOME[1] + board.motor_steps(1) / STEPS[1],
            time_ns,
        }
    }

    fn trouble(&self, trouble: Trouble) {
        let mut board = self.server.lock();
        let kind = match trouble {
            Trouble::EncoderOff => FaultKind::EncoderOff,
            Trouble::LostCounts => FaultKind::LostCounts,
            Trouble::IndexMissing => FaultKind::IndexMissing,
            Trouble::Stall => FaultKind::SpindleStall,
            Trouble::LinkLost => FaultKind::LossIn,
            // An inverter without a fault contact.
            Trouble::DriveFault => FaultKind::SpindleStall,
        };
        board.fault_now(kind, None);
    }

    fn resolution(&self) -> f64 {
        1.0 / COUNTS as f64
    }

    fn step_mm(&self) -> f64 {
        1.0 / STEPS[1]
    }
}

/// Increments per turn of the drives, and the position of the spindle's zero impulse within a turn.
const RESOLUTION: u32 = 1 << 20;
const IMPULSE: f64 = 0.3;
const LEAD_MM: f64 = 5.0;
/// Bus positions of Z and of the spindle.
const Z_DRIVE: usize = 2;
const SPINDLE_DRIVE: usize = 3;

/// Two servo drives and a spindle drive on EtherCAT.
pub struct RingLathe {
    ring: SharedRing,
}

impl RingLathe {
    /// Runs a trial with lathes on a simulated ring, one after the other. Each call creates new devices,
    /// because a drive that has lost its fieldbus under power is in fault.
    pub fn on_ring(trial: impl FnOnce(&dyn Fn() -> Arc<dyn Lathe>) + Send + 'static) {
        on_bench(Self::devices(), move |ring| {
            trial(&|| {
                let mut present = ring.lock().expect("no panic");
                *present = Ring::new(Self::devices(), monotonic_ns());
                drop(present);
                let ring = Arc::clone(ring);
                Arc::new(Self { ring })
            });
        });
    }

    fn devices() -> Vec<SubDevice> {
        let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
        for axis in 0..2 {
            devices.push(SubDevice::drive(DriveSettings::default(), axis + 2, 10.0));
        }
        let spindle = DriveSettings {
            resolution: RESOLUTION,
            start_turns: Random::new().between(-20.0, 20.0),
            start_increments: 123_456,
            limits_turns: [f64::NEG_INFINITY, f64::INFINITY],
            probe_turns: f64::INFINITY,
            index_turns: IMPULSE,
            ..DriveSettings::default()
        };
        devices.push(SubDevice::drive(spindle, 9, -15.0));
        devices
    }
}

/// The state of a lathe on a ring, with Z computed from the turns of its motor.
fn ring_sight(ring: &SharedRing, z_of_turns: impl Fn(f64) -> f64) -> Sight {
    let mut ring = ring.lock().expect("no panic");
    let time_ns = monotonic_ns();
    ring.advance(time_ns);
    let turns = |device: usize| {
        let drive = ring.devices()[device].as_drive().expect("a drive");
        drive.motor_turns()
    };
    Sight {
        packets: ring.frames(),
        turns: turns(SPINDLE_DRIVE) - IMPULSE,
        z: z_of_turns(turns(Z_DRIVE)),
        time_ns,
    }
}

impl Lathe for RingLathe {
    fn bridge(&self, workshop: &Workshop) -> Vec<String> {
        let device = |name: &str, product: u32| {
            format!("[[device]]\nname = \"{name}\"\nvendor = 0x4556534D\nproduct = {product}\n")
        };
        let mut text = "max_lost_cycles = 40\n".to_owned() + &device("coupler", 0x1100);
        for (letter, home) in [("X", HOME[0]), ("Z", HOME[1])] {
            text += &device(letter, 0x402);
            text += &format!(
                "[device.axis]\nletter = \"{letter}\"\nincrements_per_turn = {RESOLUTION}\n\
                 turn_mm = {LEAD_MM}\nzero = {home}\nvelocity_offset = true\ninertia_kg_m2 = 0.0003\n\
                 rated_torque_n_m = 2.4\n"
            );
        }
        text += &device("spindle", 0x402);
        text += &format!(
            "[device.spindle]\nincrements_per_turn = {RESOLUTION}\nindex_probe = 2\n\
             orientation = {{ gain = 8, rpm = 60, tolerance_deg = 0.5 }}\n"
        );
        let network = workshop.write("network.toml", text);
        let network = network.to_str().expect("UTF-8").to_owned();
        ["ethercat", "--network", &network, "--interface", MAIN_INTERFACE]
            .map(str::to_owned)
            .to_vec()
    }

    fn observe(&self) -> Sight {
        ring_sight(&self.ring, |turns| HOME[1] + turns * LEAD_MM)
    }

    fn trouble(&self, trouble: Trouble) {
        let mut ring = self.ring.lock().expect("no panic");
        let kind = match trouble {
            Trouble::IndexMissing => RingFault::IndexMissing,
            Trouble::Stall => RingFault::Blocked,
            Trouble::LinkLost => RingFault::Loss,
            Trouble::DriveFault | Trouble::EncoderOff | Trouble::LostCounts => RingFault::Drive,
        };
        ring.begin_fault(monotonic_ns(), kind, SPINDLE_DRIVE, None);
    }

    fn resolution(&self) -> f64 {
        1.0 / f64::from(RESOLUTION)
    }

    fn step_mm(&self) -> f64 {
        LEAD_MM / f64::from(RESOLUTION)
    }
}

/// The shipped lathe, `config/machines/lathe-ethercat.toml` with `config/networks/sim-lathe.toml`, on the
/// ring that the network file names. Only values for busy hosts are changed.
pub struct ShippedLathe {
    ring: SharedRing,
    /// The coordinate of Z where its motor is at 0, mm.
    zero: Mutex<f64>,
}

/// Turns from the start of each axis to its limit switches, the machine coordinates of these switches, and mm
/// per turn of Z.
const LIMITS: [f64; 2] = [-90.0, 10.0];
const SWITCHES: [f64; 2] = [205.0, 605.0];
const SHIPPED_LEAD_MM: f64 = 10.0;

impl ShippedLathe {
    /// Runs a trial with such lathes, as for [`RingLathe::on_ring`].
    pub fn on_ring(trial: impl FnOnce(&dyn Fn() -> Arc<dyn Lathe>) + Send + 'static) {
        on_bench(Self::devices(), move |ring| {
            trial(&|| {
                *ring.lock().expect("no panic") = Ring::new(Self::devices(), monotonic_ns());
                let ring = Arc::clone(ring);
                let zero = Mutex::new(SWITCHES[1] - LIMITS[1] * SHIPPED_LEAD_MM);
                Arc::new(Self { ring, zero })
            });
        });
    }

    fn devices() -> Vec<SubDevice> {
        let axis = DriveSettings {
            limits_turns: LIMITS,
            ..DriveSettings::default()
        };
        let spindle = DriveSettings {
            limits_turns: [f64::NEG_INFINITY, f64::INFINITY],
            probe_turns: f64::INFINITY,
            index_turns: IMPULSE,
            ..DriveSettings::default()
        };
        vec![
            SubDevice::terminal(TerminalKind::Coupler, 1),
            SubDevice::drive(axis, 2, 10.0),
            SubDevice::drive(axis, 3, 20.0),
            SubDevice::drive(spindle, 4, -15.0),
            SubDevice::terminal(TerminalKind::DigitalInput, 5),
            SubDevice::terminal(TerminalKind::DigitalOutput, 6),
            SubDevice::terminal(TerminalKind::AnalogInput, 7),
        ]
    }

    /// A shipped file with pieces of its text replaced.
    fn changed(name: &str, changes: &[(&str, &str)]) -> String {
        let shipped = repository().join("config").join(name);
        let mut text = std::fs::read_to_string(shipped).expect("a file that ships");
        for (from, to) in changes {
            assert!(text.contains(from), "{from} is not in {name}");
            text = text.replacen(from, to, 1);
        }
        text
    }
}

impl Lathe for ShippedLathe {
    fn machine(&self, workshop: &Workshop, name: &str, _spindles: &str) -> PathBuf {
        let own_name = format!("name = {name:?}");
        let changes = [
            ("name = \"lathe-ethercat\"", own_name.as_str()),
            ("rate = 1000 ", "rate = 1000\n"),
            ("[drives]\n", "[signals]\ninput_timeout_ms = 500\n[drives]\n"),
            (
                "feedback = \"required\"",
                "feedback = \"required\"\nfeedback_timeout_ms = 1000",
            ),
            ("enable_timeout_ms = 30000 ", ""),
        ];
        workshop.write(
            "lathe.toml",
            Self::changed("machines/lathe-ethercat.toml", &changes),
        )
    }

    fn homed_at(&self) -> Option<[f64; 2]> {
        Some(SWITCHES)
    }

    fn set_z(&self, z: f64) {
        let shown = self.observe().z;
        *self.zero.lock().expect("no panic") += z - shown;
    }

    fn bridge(&self, workshop: &Workshop) -> Vec<String> {
        let changes = [("interface = \"ec0\"", "max_lost_cycles = 40")];
        let network = workshop.write("network.toml", Self::changed("networks/sim-lathe.toml", &changes));
        let network = network.to_str().expect("UTF-8").to_owned();
        ["ethercat", "--network", &network, "--interface", MAIN_INTERFACE]
            .map(str::to_owned)
            .to_vec()
    }

    fn observe(&self) -> Sight {
        let zero = *self.zero.lock().expect("no panic");
        ring_sight(&self.ring, |turns| zero + turns * SHIPPED_LEAD_MM)
    }

    fn trouble(&self, _trouble: Trouble) {
        let mut ring = self.ring.lock().expect("no panic");
        ring.begin_fault(monotonic_ns(), RingFault::Drive, SPINDLE_DRIVE, None);
    }

    fn resolution(&self) -> f64 {
        1.0 / f64::from(RESOLUTION)
    }

    fn step_mm(&self) -> f64 {
        SHIPPED_LEAD_MM / f64::from(RESOLUTION)
    }
}
