//! A served mill that homes by the index pulses of its encoders, through the hardware bridges and their
//! simulators: every process as in use, over real sockets. The reference is the shaft of the simulator, which
//! no bridge sees.
//!
//! The EtherCAT ring needs the right to create a network namespace.
#![expect(clippy::expect_used, clippy::panic, reason = "tests fail as tests do")]

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::time::Duration;

use evolvent_bus::{ControlRequest, Status};
use evolvent_ethercat_ring::{
    DriveSettings, FaultKind as RingFault, MAIN_INTERFACE, SharedRing, SubDevice, TerminalKind, monotonic_ns,
    on_bench,
};
use evolvent_mesa_board::{Board, BoardModel, BoardServer, FaultKind as BoardFault, now_ns};
use evolvent_tests::{
    Domain, HardwareBridge, Operator, Random, Served, Workshop, command, where_undisturbed,
};

/// A bridge that is suspended for ten periods brakes on its own (`note` 2, alarm 413), as it must: a pause of
/// three quarters of that explains it.
const SUSPENDED: Duration = Duration::from_millis(30);

/// Machine coordinates of the pulses of X and Y, mm.
const PULSES: [f64; 2] = [-60.0, 15.0];
const X: u32 = 0b01;
const Y: u32 = 0b10;

/// X by the first pulse after its switch, Y by the next pulse from its position. The distance is one turn
/// plus the motion during one lead: setpoints are that far ahead, and the axis must be at rest by their end.
fn homing(edge: &str, latch_mm_s: [f64; 2]) -> String {
    format!(
        "\n[[homing]]\naxis = \"X\"\nmethod = \"switch-index\"\nindex_edge = \"{edge}\"\n\
         towards = \"negative\"\nsearch_mm_s = 100\nlatch_mm_s = {}\nindex_mm = {}\nindex_within_mm = 8\n\
         [[homing]]\naxis = \"Y\"\nmethod = \"index\"\ntowards = \"positive\"\norder = 1\nlatch_mm_s = {}\n\
         index_mm = {}\nindex_within_mm = 8\n",
        latch_mm_s[0], PULSES[0], latch_mm_s[1], PULSES[1]
    )
}

/// What the simulator knows and the bridge does not.
trait Hardware {
    /// Arguments of the bridge after `evolvent bridge`.
    fn bridge(&self, workshop: &Workshop) -> Vec<String>;
    /// Increments of the shaft of X or Y since a pulse, in the direction of the axis, and increments per mm
    /// and per turn.
    fn beyond_pulse(&self, axis: usize) -> (f64, f64, f64);
    /// Interrupts the link for a time.
    fn lose_link(&self, duration_ns: u64);
    /// Interrupts the supply of a drive for a moment, or trips the watchdog of the board: the session ends,
    /// and the counts are those of a new one.
    fn lose_session(&self);
    /// Removes the pulses of the encoder of Y, or restores them.
    fn set_no_pulse(&self, is_missing: bool);
}

struct RingHardware {
    ring: SharedRing,
    phases: [f64; 2],
}

/// Increments per turn, and turns at which the home switch of X closes.
const RESOLUTION: f64 = 1_048_576.0;
const SWITCH_TURNS: f64 = -12.0;

impl RingHardware {
    fn devices(phases: [f64; 2], starts: [f64; 2]) -> Vec<SubDevice> {
        let mut devices = vec![SubDevice::terminal(TerminalKind::Coupler, 1)];
        for axis in 0..3 {
            let settings = DriveSettings {
                index_turns: phases.get(axis).copied().unwrap_or(0.0),
                start_turns: starts.get(axis).copied().unwrap_or(0.0),
                start_increments: 1_234_567 * axis as i32,
                home_switch_turns: SWITCH_TURNS,
                ..DriveSettings::default()
            };
            devices.push(SubDevice::drive(settings, axis as u32 + 2, 10.0));
        }
        devices.push(SubDevice::terminal(TerminalKind::DigitalInput, 5));
        devices
    }
}

impl Hardware for RingHardware {
    fn bridge(&self, workshop: &Workshop) -> Vec<String> {
        let shipped = evolvent_tests::repository().join("config/networks/sim-mill.toml");
        let text = std::fs::read_to_string(shipped).expect("the shipped network");
        let mut changed = text;
        for (from, to) in [
            // X by touch probe 2 and with the switch, beside a probe; Y, which is inverted, by touch probe 1.
            (
                "gear = [1, 1] ",
                "index_probe = 2\ntouch_probe = true\nhome_switch_bit = 2 ",
            ),
            ("inverted = true", "inverted = true\nindex_probe = 1"),
            ("max_lost_cycles = 3 ", "max_lost_cycles = 40 "),
        ] {
            assert!(changed.contains(from), "{from}");
            changed = changed.replacen(from, to, 1);
        }
        let network = workshop.write("network.toml", changed);
        let network = network.to_str().expect("UTF-8").to_owned();
        ["ethercat", "--network", &network, "--interface", MAIN_INTERFACE]
            .map(str::to_owned)
            .to_vec()
    }

    fn beyond_pulse(&self, axis: usize) -> (f64, f64, f64) {
        let ring = self.ring.lock().expect("no panic");
        let drive = ring.devices()[axis + 1].as_drive().expect("a drive");
        let sign = if axis == 1 { -1.0 } else { 1.0 };
        // The drive reports whole increments; the impulse is one increment wide.
        let shown = (drive.motor_turns() * RESOLUTION).floor();
        let increments = sign * (shown - self.phases[axis] * RESOLUTION);
        (increments, RESOLUTION / 5.0, RESOLUTION)
    }

    fn lose_link(&self, duration_ns: u64) {
        let mut ring = self.ring.lock().expect("no panic");
        ring.begin_fault(monotonic_ns(), RingFault::Loss, 0, Some(duration_ns));
    }

    fn lose_session(&self) {
        let mut ring = self.ring.lock().expect("no panic");
        ring.begin_fault(monotonic_ns(), RingFault::Gone, 1, Some(1_000_000_000));
    }

    fn set_no_pulse(&self, is_missing: bool) {
        let mut ring = self.ring.lock().expect("no panic");
        if is_missing {
            ring.begin_fault(monotonic_ns(), RingFault::IndexMissing, 2, None);
        } else {
            ring.clear_faults();
        }
    }
}

struct BoardHardware {
    server: Arc<BoardServer>,
    address: std::net::IpAddr,
    stop: Arc<AtomicBool>,
    switch: Option<std::thread::JoinHandle<()>>,
}

/// Counts per turn, counts per mm, the counts of the pulses, and the count at which the home switch of X
/// closes.
const TURN: i64 = 4000;
const COUNTS: f64 = 1000.0;
const INDEX: [i64; 2] = [1700, 2300];
const SWITCH_COUNTS: f64 = -48_000.0;
/// The last byte of the address of the next board.
static BOARDS: AtomicU8 = AtomicU8::new(1);
/// A pin of the board that belongs to no module.
const SWITCH_PIN: usize = 50;

impl BoardHardware {
    fn new(starts: [f64; 2]) -> Self {
        let address = next_address();
        let server = Arc::new(
            BoardServer::start(Board::new(BoardModel::B7i97, now_ns()), address).expect("an address"),
        );
        for unit in 0..3 {
            let mut board = server.lock();
            board.set_drive(unit, TURN, 600_000.0);
            board.set_index(unit, INDEX.get(unit).copied().unwrap_or(0));
            board.turn_shaft(unit, starts.get(unit).copied().unwrap_or(0.0));
        }
        let stop = Arc::new(AtomicBool::new(false));
        let switch = std::thread::spawn({
            let (server, stop) = (Arc::clone(&server), Arc::clone(&stop));
            move || {
                while !stop.load(Ordering::Relaxed) {
                    let mut board = server.lock();
                    let is_on = board.shaft(0) <= SWITCH_COUNTS;
                    board.set_level(SWITCH_PIN, is_on);
                    drop(board);
                    std::thread::sleep(Duration::from_micros(500));
                }
            }
        });
        Self {
            server,
            address,
            stop,
            switch: Some(switch),
        }
    }
}

/// An address of this computer that no other board has.
fn next_address() -> std::net::IpAddr {
    // Unique per process: tests of one process run concurrently.
    let process = std::process::id();
    let number = BOARDS.fetch_add(1, Ordering::Relaxed);
    std::net::IpAddr::from([127, 40 + (process >> 8) as u8 % 80, process as u8, number])
}

impl Drop for BoardHardware {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(switch) = self.switch.take() {
            let _ended = switch.join();
        }
    }
}

impl Hardware for BoardHardware {
    fn bridge(&self, workshop: &Workshop) -> Vec<String> {
        let mut text = format!(
            "address = \"{}\"\nname = \"7I97\"\nmax_lost_packets = 40\nwatchdog_ms = 400\n",
            self.address
        );
        for (unit, letter) in ["X", "Y", "Z"].iter().enumerate() {
            let switch = if unit == 0 {
                format!("home_switch = {{ pin = {SWITCH_PIN} }}\n")
            } else {
                String::new()
            };
            text += &format!(
                "[[axis]]\nletter = \"{letter}\"\nencoder = {unit}\npwm = {unit}\n\
                 counts_per_unit = {COUNTS}\nfull_velocity = 600\np_gain = 60\ni_gain = 200\ninverted = {}\n\
                 {switch}",
                unit == 1
            );
        }
        let board = workshop.write("board.toml", text);
        let board = board.to_str().expect("UTF-8").to_owned();
        ["mesa", "--board", &board].map(str::to_owned).to_vec()
    }

    fn beyond_pulse(&self, axis: usize) -> (f64, f64, f64) {
        let shaft = self.server.lock().shaft(axis).floor();
        let sign = if axis == 1 { -1.0 } else { 1.0 };
        (sign * (shaft - INDEX[axis] as f64), COUNTS, TURN as f64)
    }

    fn lose_link(&self, duration_ns: u64) {
        self.server
            .lock()
            .fault_now(BoardFault::LossIn, Some(duration_ns));
    }

    fn lose_session(&self) {
        self.server.lock().fault_now(BoardFault::Bite, Some(300_000_000));
    }

    fn set_no_pulse(&self, is_missing: bool) {
        let mut board = self.server.lock();
        if is_missing {
            board.fault_now(BoardFault::IndexMissing, None);
        } else {
            board.clear_faults();
        }
    }
}

/// Core, bridge and hardware.
struct Mill<'a> {
    hardware: &'a dyn Hardware,
    workshop: Workshop,
    machine: PathBuf,
    bridge: Option<HardwareBridge>,
    operator: Option<Operator>,
    served: Option<Served>,
    domain: Domain,
}

impl<'a> Mill<'a> {
    fn new(hardware: &'a dyn Hardware, name: &str, homing: &str) -> Self {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let shipped = workshop.mill(
            name,
            &[
                ("rate = \"rational\"", "rate = 250"),
                ("# lead_ms = 2 ", "lead_cycles = 40 "),
                ("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 300 "),
                ("enable_timeout_ms = 2000 ", "enable_timeout_ms = 20000 "),
                (
                    "home_mm = 0",
                    "home_mm = 0\nfollowing_error_mm = 3\nfollowing_time_ms = 200",
                ),
            ],
        );
        // Slow enough that no 16-bit counter overflows while 40 packets are missing.
        let text = std::fs::read_to_string(shipped)
            .expect("a machine file")
            .replace("max_velocity_mm_min = 30000", "max_velocity_mm_min = 9000")
            .replace("max_velocity_mm_min = 20000", "max_velocity_mm_min = 9000");
        let machine = workshop.write(&format!("{name}.toml"), text + homing);
        let served = Served::start(&machine, name, &domain, &workshop.path("state"), &[]);
        let operator = Operator::join(name, &domain);
        let mut mill = Self {
            hardware,
            machine,
            workshop,
            bridge: None,
            operator: Some(operator),
            served: Some(served),
            domain,
        };
        mill.start_bridge();
        mill.operator().brings_up();
        mill.operator().says_number("MODE", 1);
        mill
    }

    fn operator(&mut self) -> &mut Operator {
        self.operator.as_mut().expect("an operator")
    }

    fn start_bridge(&mut self) {
        self.bridge = None;
        let arguments = self.hardware.bridge(&self.workshop);
        self.bridge = Some(HardwareBridge::start(&arguments, &self.machine, &self.domain));
        self.operator()
            .waits("drives", |status| status.feedback_age_ns < 100_000_000);
    }

    fn home(&mut self, mask: u32) -> Status {
        let request = ControlRequest {
            axes_mask: mask,
            ..command("HOME")
        };
        let job = self.operator().does(&request).job;
        self.operator().sees_end(job)
    }

    /// Starts HOME of Y and waits until its pulse is searched: the axis moves.
    fn begins_home_of_y(&mut self) -> u64 {
        let request = ControlRequest {
            axes_mask: Y,
            ..command("HOME")
        };
        let job = self.operator().does(&request).job;
        let from = self.operator().now().position_machine[1];
        self.operator().waits("Y moves", |status| {
            (status.position_machine[1] - from).abs() > 0.3
        });
        job
    }

    /// Clears the alarms and switches power on again. A drive that lost its fieldbus under power needs a
    /// reset that it can see, once its bridge is there: repeated if needed, as an operator would.
    fn recovers(&mut self) {
        for _ in 0..20 {
            self.operator()
                .waits("drives", |status| status.feedback_age_ns < 100_000_000);
            self.operator().says("CLEAR_ALARMS");
            std::thread::sleep(Duration::from_millis(300));
            let _accepted = self.operator().request(&command("ON"));
            for _ in 0..40 {
                if self.operator().now().machine_state == 2 {
                    return;
                }
                std::thread::sleep(Duration::from_millis(50));
            }
        }
        panic!("no power: {}", self.operator().now().alarm_sentence());
    }

    /// Error of the coordinate of an axis at rest, in increments: its pulse must be at the coordinate of the
    /// machine file. If the axis was on a pulse, any pulse is correct.
    fn wrong(&mut self, axis: usize) -> f64 {
        let mut min = f64::INFINITY;
        for _ in 0..100 {
            let shown = self.operator().now().position_actual[axis];
            let (beyond, per_mm, per_turn) = self.hardware.beyond_pulse(axis);
            let off = (shown - PULSES[axis]) * per_mm - beyond;
            // There is one pulse per turn.
            let off = off - (off / per_turn).round() * per_turn;
            // Feedback and shaft are read at slightly different times, while the servo may hunt.
            min = if off.abs() < min.abs() { off } else { min };
        }
        min
    }

    fn check(&mut self, mask: u32, status: &Status) {
        let sentence = status.alarm_sentence();
        assert_eq!(
            (status.job_result, status.homed_mask & mask),
            (1, mask),
            "{sentence}"
        );
        for axis in (0..2).filter(|axis| mask >> axis & 1 == 1) {
            let wrong = self.wrong(axis);
            assert!(wrong.abs() <= 1.01, "axis {axis}: {wrong} increments");
        }
    }

    fn end(mut self) {
        // A drive that loses its fieldbus without torque has no fault for the next test.
        self.operator().says("OFF");
        self.operator().waits("off", |status| status.machine_state != 2);
        std::thread::sleep(Duration::from_millis(300));
        self.operator = None;
        let served = self.served.take().expect("a service");
        served.end().expect_code(&[0, 3]);
        self.bridge = None;
    }
}

/// Runs a trial on both simulators, from random positions.
fn on_ring(trial: impl Fn(&dyn Hardware, &str) + Send + Clone + 'static) {
    where_undisturbed(SUSPENDED, || {
        let mut random = Random::new();
        let phases = [random.between(0.3, 0.7), random.between(0.0, 1.0)];
        let starts = [random.between(SWITCH_TURNS - 2.0, 0.0), random.between(-5.0, 5.0)];
        let trial = trial.clone();
        on_bench(RingHardware::devices(phases, starts), move |ring| {
            let ring = Arc::clone(ring);
            trial(&RingHardware { ring, phases }, "index-ring");
        });
    });
}

fn on_board(trial: impl Fn(&dyn Hardware, &str)) {
    where_undisturbed(SUSPENDED, || {
        let mut random = Random::new();
        let starts = [
            random.between(SWITCH_COUNTS - 4000.0, 0.0),
            random.between(-30_000.0, 30_000.0),
        ];
        trial(&BoardHardware::new(starts), "index-board");
    });
}

/// From any start, at two speeds and by both edges of the switch, the pulse has its true coordinate, within
/// one increment. The distance between switch and pulse differs with the edge, and so may the pulse that is
/// found, but not its position within the turn.
fn at_two_speeds(hardware: &dyn Hardware, name: &str) {
    for (edge, latch_mm_s) in [("closing", [2.0, 12.0]), ("opening", [12.0, 2.0])] {
        let mut mill = Mill::new(hardware, name, &homing(edge, latch_mm_s));
        assert_eq!(mill.operator().now().homed_mask & (X | Y), 0);
        let status = mill.home(X | Y);
        mill.check(X | Y, &status);
        // Once more from the present position: the coordinate does not change.
        let status = mill.home(Y);
        mill.check(X | Y, &status);
        mill.end();
    }
}

/// No pulse within the distance: alarm 422 at rest; then the pulse is restored.
fn without_a_pulse(hardware: &dyn Hardware, name: &str) {
    let mut mill = Mill::new(hardware, name, &homing("closing", [5.0, 5.0]));
    hardware.set_no_pulse(true);
    let status = mill.home(Y);
    assert_eq!(status.listed_alarms(), [422], "{}", status.alarm_sentence());
    let sentence = status.alarm_sentence().to_owned();
    assert!(
        sentence.contains("axis Y") && sentence.contains("no index pulse came"),
        "{sentence}"
    );
    assert_eq!(status.homed_mask & Y, 0);
    hardware.set_no_pulse(false);
    mill.recovers();
    let status = mill.home(Y);
    mill.check(Y, &status);
    mill.end();
}

/// The link is lost, then the bridge is killed, while a pulse is awaited: it yields no zero, and the next
/// HOME finds the pulse.
fn broken_off(hardware: &dyn Hardware, name: &str) {
    let mut mill = Mill::new(hardware, name, &homing("closing", [5.0, 1.0]));
    hardware.set_no_pulse(true);
    for is_link in [true, false] {
        let job = mill.begins_home_of_y();
        if is_link {
            hardware.lose_link(1_500_000_000);
        } else {
            mill.bridge = None;
        }
        let status = mill.operator().sees_end(job);
        assert_ne!(status.job_result, 1, "it did not home");
        assert_eq!(status.homed_mask & Y, 0);
        let alarms = status.listed_alarms().to_vec();
        assert!(
            !alarms.is_empty() && alarms.iter().all(|alarm| *alarm != 422),
            "{alarms:?}"
        );
        if is_link {
            std::thread::sleep(Duration::from_millis(2500));
        } else {
            mill.start_bridge();
        }
        mill.recovers();
    }
    hardware.set_no_pulse(false);
    let status = mill.home(Y);
    mill.check(Y, &status);
    mill.end();
}

/// Without `[[homing]]` axes are homed from the start, until a session is lost: after it the drives count
/// from another zero. HOME declares their positions without motion.
fn without_homing_tables(hardware: &dyn Hardware, name: &str) {
    let mut mill = Mill::new(hardware, name, "");
    let moves = |mill: &mut Mill<'_>, block: &str| {
        mill.operator().says_number("MODE", 2);
        let mut mdi = command("MDI");
        assert!(mdi.set_text(block));
        mill.operator().request(&mdi)
    };
    assert_eq!(mill.operator().now().homed_mask, 0b111, "as at every first start");
    let job = moves(&mut mill, "G91 G1 X12 Y-7 F1500").job;
    let status = mill.operator().sees_end(job);
    assert_eq!(status.job_result, 1, "{}", status.alarm_sentence());
    hardware.lose_session();
    let status = mill.operator().waits("machine zero lost", |status| {
        status.homed_mask == 0 && status.listed_alarms().contains(&418)
    });
    let message = status.operator_message().to_owned();
    assert!(
        message.contains("home XYZ again")
            && message.contains("jog to X0 Y0 Z0 first (without [[homing]], HOME only declares it)"),
        "{message}"
    );
    mill.recovers();
    let status = mill.operator().now();
    assert!(
        status.position_machine[0].abs() < 0.1,
        "the drives count from zero again: {status:?}"
    );
    assert_eq!(
        moves(&mut mill, "G90 G1 X100 F900").alarm,
        916,
        "soft limits would be 12 mm off"
    );
    mill.operator().says_number("MODE", 1);
    // An axis of another name than that of the drive: its position becomes home.
    let before = [0, 1].map(|axis| hardware.beyond_pulse(axis));
    let status = mill.home(0);
    assert_eq!(
        (status.job_result, status.homed_mask),
        (1, 0b111),
        "{}",
        status.alarm_sentence()
    );
    for axis in 0..3 {
        assert_eq!(status.position_machine[axis], 0.0);
    }
    mill.operator().waits("the drives at home", |status| {
        (0..3).all(|axis| status.position_actual[axis].abs() < 0.05)
    });
    for (axis, before) in before.into_iter().enumerate() {
        let (beyond, per_mm, _) = hardware.beyond_pulse(axis);
        assert!((beyond - before.0).abs() < 0.05 * per_mm, "axis {axis} moved");
    }
    // Homed axes keep their coordinates.
    let job = moves(&mut mill, "G90 G1 X5 F1500").job;
    assert_eq!(mill.operator().sees_end(job).job_result, 1);
    mill.operator().says_number("MODE", 1);
    let status = mill.home(0);
    assert_eq!((status.job_result, status.position_machine[0]), (1, 5.0));
    mill.end();
}

#[test]
fn a_lost_session_ends_homed_state_on_ethercat() {
    on_ring(without_homing_tables);
}

#[test]
fn a_lost_session_ends_homed_state_on_mesa() {
    on_board(without_homing_tables);
}

#[test]
fn a_mill_on_ethercat_homes_by_its_index_pulses() {
    on_ring(at_two_speeds);
}

#[test]
fn a_mill_on_a_mesa_board_homes_by_its_index_pulses() {
    on_board(at_two_speeds);
}

#[test]
fn a_missing_pulse_is_alarm_422_on_ethercat() {
    on_ring(without_a_pulse);
}

#[test]
fn a_pulse_that_does_not_come_is_alarm_422_on_mesa() {
    on_board(without_a_pulse);
}

#[test]
fn a_link_lost_while_armed_leaves_no_zero_on_ethercat() {
    on_ring(broken_off);
}

#[test]
fn a_link_lost_while_armed_leaves_no_zero_on_mesa() {
    on_board(broken_off);
}

/// A machine file and a board file that are shipped as a pair.
struct ShippedPair {
    model: BoardModel,
    machine: &'static str,
    board: &'static str,
    /// As for `mesa-board --switch`: 2 mm from the initial positions of the motors, which are home.
    switches: &'static [&'static str],
    /// Axis of each motor, and its steps per mm.
    motors: &'static [(usize, f64)],
}

/// The files fit together: HOME finds the switches that the board file connects, and the axes move home.
fn homes_by_its_switches(pair: &ShippedPair) {
    let (name, file) = (pair.machine, pair.board);
    where_undisturbed(SUSPENDED, || {
        let (workshop, domain, address) = (Workshop::new(), Domain::new(), next_address());
        let mut board = Board::new(pair.model, now_ns());
        for switch in pair.switches {
            board.add_switch(switch.parse().expect("a switch"));
        }
        let server = BoardServer::start(board, address).expect("an address");
        let shipped = |path: &str| {
            let path = evolvent_tests::repository().join("config").join(path);
            std::fs::read_to_string(path).expect("a shipped file")
        };
        let drives = "\n[drives]\nfeedback_timeout_ms = 300\nenable_timeout_ms = 20000\n";
        let text = shipped(&format!("machines/{name}.toml"))
            .replace("rate = 1000 ", "lead_cycles = 40\nrate = 250 ")
            .replace(
                "travel_min_mm",
                "following_error_mm = 3\nfollowing_time_ms = 200\ntravel_min_mm",
            )
            .replace("\n[drives]\nfeedback = \"required\"\n", "");
        let machine = workshop.write("machine.toml", text + drives);
        let text = shipped(&format!("boards/{file}.toml"))
            .replace("10.10.10.10\"", &format!("{address}\""))
            // With more, a step generator could overflow unseen.
            .replace("max_lost_packets = 5 ", "max_lost_packets = 19 ")
            .replace("watchdog_ms = 50 ", "watchdog_ms = 400 ");
        let board_file = workshop.write("board.toml", text);
        let served = Served::start(&machine, name, &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join(name, &domain);
        let arguments = ["mesa", "--board", board_file.to_str().expect("UTF-8")].map(str::to_owned);
        let bridge = HardwareBridge::start(&arguments, &machine, &domain);
        operator.waits("drives", |status| status.feedback_age_ns < 100_000_000);
        operator.brings_up();
        operator.says_number("MODE", 1);
        let before = operator.now();
        assert_eq!(before.homed_mask, 0);
        let job = operator.says("HOME").job;
        let status = operator.sees_end(job);
        let all = pair.motors.iter().fold(0, |mask, (axis, _)| mask | 1 << axis);
        assert_eq!(
            (status.job_result, status.homed_mask),
            (1, all),
            "{file}: {}",
            status.alarm_sentence()
        );
        operator.waits("the motors at home", |status| {
            let away = |axis: usize| status.position_actual[axis] - before.position_actual[axis];
            pair.motors.iter().all(|(axis, _)| away(*axis).abs() < 0.05)
        });
        // Within the distance of one sample and the bus delay at 4 mm/s.
        for (unit, (_, per_mm)) in pair.motors.iter().enumerate() {
            let off = server.lock().motor_steps(unit) / per_mm;
            assert!(off.abs() < 0.15, "{file}: motor {unit} is {off} mm off");
        }
        drop((operator, bridge));
        served.end().expect_code(&[0, 3]);
    });
}

#[test]
fn the_shipped_router_homes_by_its_switches() {
    for (model, board) in [
        (BoardModel::B7i96s, "7i96s-router"),
        (BoardModel::B7i76e, "7i76e-router"),
    ] {
        homes_by_its_switches(&ShippedPair {
            model,
            machine: "router-3axis",
            board,
            switches: &["0:0:-640", "1:1:640", "2:2:1600"],
            motors: &[(0, 320.0), (1, 320.0), (2, 800.0)],
        });
    }
}

#[test]
fn the_shipped_mesa_lathe_homes_by_its_switches() {
    homes_by_its_switches(&ShippedPair {
        model: BoardModel::B7i96s,
        machine: "lathe-mesa",
        board: "7i96s-lathe",
        switches: &["0:0:3200", "1:1:2560"],
        motors: &[(0, 1600.0), (2, 1280.0)],
    });
}
