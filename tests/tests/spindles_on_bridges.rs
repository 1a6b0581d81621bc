//! A lathe that cuts threads, taps, and turns its spindle to an angle through the bridges to hardware and their simulators: every
//! process as in use, over real sockets. The truth is the simulator's own angle and its own carriage, read at the same instant; no
//! bridge sees either.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use evolvent_bus::Status;
use evolvent_ethercat_ring::{
    DriveSettings, FaultKind as RingFault, MAIN_INTERFACE, SharedRing, SubDevice, TerminalKind, monotonic_ns,
    on_bench,
};
use evolvent_mesa_board::{Board, BoardModel, BoardServer, FaultKind, Spindle, SpindleCommand, now_ns};
use evolvent_tests::{Domain, Operator, Random, Served, Workshop, evolvent, verifies, where_undisturbed};

const SPINDLE_ALARM: u32 = 440;
const DONE: u32 = 1;
const NAME: &str = "spun-lathe";
/// Periods that setpoints are ahead: the angle is predicted for as long, so a thread needs few; a busy host needs many.
const SHORT_LEAD: u32 = 3;
/// A setpoint with that lead is late after this pause, and out of phase.
const LATE: Duration = Duration::from_millis(3);
const LONG_LEAD: u32 = 120;
/// Start positions of the axes, mm.
const HOME: [f64; 2] = [20.0, 10.0];
const SPINDLES: &str = "[[spindle]]\nmax_rpm = 3000\nfeedback = true\nacceleration_rpm_s = 2000\n";

/// One look at a machine.
#[derive(Clone, Copy, Debug)]
struct Sight {
    /// True turns of the spindle from an index pulse.
    turns: f64,
    /// True position of the carriage, mm.
    z: f64,
    time_ns: u64,
}

/// What a simulator does on demand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Trouble {
    EncoderOff,
    LostCounts,
    IndexMissing,
    Stall,
    LinkLost,
    DriveFault,
}

/// A lathe behind a bridge.
trait Lathe: Send + Sync {
    /// Arguments of the bridge behind `evolvent bridge`.
    fn bridge(&self, workshop: &Workshop) -> Vec<String>;
    /// How it truly is now.
    fn look(&self) -> Sight;
    /// Something goes wrong from now on.
    fn trouble(&self, trouble: Trouble);
    /// Turns of the spindle per count of its encoder.
    fn resolution(&self) -> f64;
    /// The smallest step of the carriage, mm.
    fn step_mm(&self) -> f64;
}

const COUNTS: i64 = 4096;
const INDEX: i64 = 1500;
const STEPS: [f64; 2] = [1000.0, 1400.0];
/// The last number of the next board's address.
static BOARDS: AtomicU8 = AtomicU8::new(1);

/// Two steppers, an inverter with contacts, and an encoder on the spindle, at a 7I96S.
struct MesaLathe {
    server: BoardServer,
    address: std::net::IpAddr,
}

impl MesaLathe {
    fn new() -> Self {
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
        Self { server, address }
    }
}

impl Lathe for MesaLathe {
    fn bridge(&self, workshop: &Workshop) -> Vec<String> {
        let mut text = format!(
            "address = \"{}\"\nname = \"7I96S\"\nmax_lost_packets = 40\nwatchdog_ms = 400\n",
            self.address
        );
        for (unit, letter) in ["X", "Z"].iter().enumerate() {
            text += &format!(
                "[[axis]]\nletter = \"{letter}\"\nstepgen = {unit}\nsteps_per_unit = {}\nstep_length_ns = 1000\n\
                 step_space_ns = 1000\ndirection_setup_ns = 200\ndirection_hold_ns = 200\nzero = {}\n",
                STEPS[unit], HOME[unit]
            );
        }
        text += "[[spindle]]\npwm = 0\nfull_rpm = 3000\nforward = { pin = 15 }\nreverse = { pin = 16 }\nencoder = 0\n\
            counts_per_rev = 4096\norientation = { gain = 8, i_gain = 10, rpm = 60, tolerance_deg = 0.5 }\n";
        let board = workshop.write("board.toml", text);
        let board = board.to_str().expect("UTF-8").to_owned();
        ["mesa", "--board", &board].map(str::to_owned).to_vec()
    }

    fn look(&self) -> Sight {
        let mut board = self.server.lock();
        let time_ns = now_ns();
        board.advance(time_ns);
        Sight {
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
            // An inverter without a contact for it.
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

/// Increments a turn of the drives, and where the zero impulse of the spindle is within a turn.
const RESOLUTION: u32 = 1 << 20;
const IMPULSE: f64 = 0.3;
const LEAD_MM: f64 = 5.0;
/// Positions of Z and of the spindle on the wire.
const Z_DRIVE: usize = 2;
const SPINDLE_DRIVE: usize = 3;

/// Two servo drives and a spindle drive on EtherCAT.
struct RingLathe {
    ring: SharedRing,
}

impl RingLathe {
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

impl Lathe for RingLathe {
    fn bridge(&self, workshop: &Workshop) -> Vec<String> {
        let device = |name: &str, product: u32| {
            format!("[[device]]\nname = \"{name}\"\nvendor = 0x4556534D\nproduct = {product}\n")
        };
        let mut text = "max_lost_cycles = 40\n".to_owned() + &device("coupler", 0x1100);
        for (letter, home) in [("X", HOME[0]), ("Z", HOME[1])] {
            text += &device(letter, 0x402);
            text += &format!(
                "[device.axis]\nletter = \"{letter}\"\nincrements_per_turn = {RESOLUTION}\nturn_mm = {LEAD_MM}\nzero = {home}\n\
                 velocity_offset = true\ninertia_kg_m2 = 0.0003\nrated_torque_n_m = 2.4\n"
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

    fn look(&self) -> Sight {
        let mut ring = self.ring.lock().expect("no panic");
        let time_ns = monotonic_ns();
        ring.advance(time_ns);
        let turns = |device: usize| {
            let drive = ring.devices()[device].as_drive().expect("a drive");
            drive.motor_turns()
        };
        Sight {
            turns: turns(SPINDLE_DRIVE) - IMPULSE,
            z: HOME[1] + turns(Z_DRIVE) * LEAD_MM,
            time_ns,
        }
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

/// A bridge in a process of its own, killed at the end.
struct Bridge(Child);

impl Bridge {
    fn start(lathe: &dyn Lathe, workshop: &Workshop, machine: &Path, domain: &Domain) -> Self {
        let child = evolvent()
            .arg("bridge")
            .args(lathe.bridge(workshop))
            .args(["--bus-prefix", &domain.prefix, "--machine"])
            .arg(machine)
            .stdout(Stdio::null())
            .stderr(Stdio::inherit())
            .spawn()
            .expect("the binary to start");
        Self(child)
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}

/// Looks at a lathe all the time, and makes trouble once its carriage has come to a place.
struct Watcher {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Vec<Sight>>,
}

impl Watcher {
    fn start(lathe: &Arc<dyn Lathe>, trouble: Option<(Trouble, f64)>) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let thread = std::thread::spawn({
            let (lathe, stop) = (Arc::clone(lathe), Arc::clone(&stop));
            move || {
                let (mut sights, mut pending) = (Vec::new(), trouble);
                while !stop.load(Ordering::Relaxed) {
                    let sight = lathe.look();
                    sights.push(sight);
                    if let Some((trouble, _)) = pending.filter(|(_, z)| sight.z < *z) {
                        lathe.trouble(trouble);
                        pending = None;
                    }
                    std::thread::sleep(Duration::from_micros(700));
                }
                sights
            }
        });
        Self { stop, thread }
    }

    fn end(self) -> Vec<Sight> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("no panic")
    }
}

/// What came of a program.
struct Cut {
    status: Status,
    trace: PathBuf,
    /// How the machine truly was.
    sights: Vec<Sight>,
}

impl Cut {
    fn is_done(&self) {
        let sentence = self.status.alarm_sentence();
        assert_eq!(self.status.job_result, DONE, "{sentence}");
    }
}

/// One lathe at a time: core, bridge and simulator of each want a processor of their own.
static TURN: Mutex<()> = Mutex::new(());

/// Runs a program on a served lathe.
fn cut(
    lathe: &Arc<dyn Lathe>,
    workshop: &Workshop,
    program: &str,
    lead_cycles: u32,
    trouble: Option<(Trouble, f64)>,
) -> Cut {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let domain = Domain::new();
    let machine = workshop.lathe(NAME, SPINDLES);
    let text = std::fs::read_to_string(&machine).expect("a machine file");
    // A bridge on a busy host may take its time.
    let text = text
        .replace(
            "rate = 1000\n",
            &format!("rate = 1000\nlead_cycles = {lead_cycles}\n"),
        )
        .replace("[drives]\n", "[drives]\nenable_timeout_ms = 20000\n");
    let machine = workshop.write("served-lathe.toml", text);
    let program = workshop.write("program.ngc", program);
    let trace = workshop.path("served.mcap");
    let to = trace.display().to_string();
    let served = Served::start(
        &machine,
        NAME,
        &domain,
        &workshop.path("state"),
        &["--trace", &to],
    );
    let mut operator = Operator::join(NAME, &domain);
    let bridge = Bridge::start(&**lathe, workshop, &machine, &domain);
    operator.waits("drives", |status| status.feedback_age_ns < 100_000_000);
    operator.brings_up();
    operator.says_number("MODE", 0);
    operator.says_text("LOAD", program.to_str().expect("a path"));
    let watcher = Watcher::start(lathe, trouble);
    let job = operator.says("START").job;
    let mut status = operator.sees_end(job);
    if status.job_result != DONE {
        // Time for the axes to stop and for the alarm to reach the status.
        std::thread::sleep(Duration::from_millis(1500));
        status = operator.now();
    }
    let sights = watcher.end();
    drop(operator);
    served.end().expect_code(&[0, 1, 3]);
    drop(bridge);
    Cut {
        status,
        trace,
        sights,
    }
}

/// By how much each pass away from a start was out of phase, mm: half and 99 of 100 looks, and all of them; a host that keeps bridge or
/// board from running for some milliseconds shows in the last. And the number of looks. A pass begins at `start` with a whole turn.
fn passes(sights: &[Sight], pitch: f64, start: f64, places: std::ops::Range<f64>) -> Vec<([f64; 3], usize)> {
    let mut passes: Vec<Vec<f64>> = Vec::new();
    let mut last_ns = 0;
    for pair in sights.windows(2) {
        let [before, here] = [pair[0], pair[1]];
        let seconds = (here.time_ns - before.time_ns) as f64 * 1e-9;
        let (v, speed) = (
            (here.z - before.z) / seconds,
            (here.turns - before.turns) / seconds,
        );
        // A rapid is not as fast as the spindle makes a pass.
        if !places.contains(&here.z) || v >= -1.0 || (v.abs() / (speed.abs() * pitch) - 1.0).abs() > 0.3 {
            continue;
        }
        if here.time_ns > last_ns + 50_000_000 {
            passes.push(Vec::new());
        }
        last_ns = here.time_ns;
        let turned = here.turns - (start - here.z) / pitch;
        if let Some(pass) = passes.last_mut() {
            pass.push((turned - turned.round()) * pitch);
        }
    }
    passes.retain(|pass| pass.len() > 30);
    passes
        .into_iter()
        .map(|mut pass| {
            pass.sort_unstable_by(|a, b| a.abs().total_cmp(&b.abs()));
            ([0.5, 0.99, 1.0].map(|share| quantile(&pass, share)), pass.len())
        })
        .collect()
}

/// Of errors that are sorted by their size.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * share) as usize].abs()
}

/// 2 um, a count of the encoder and a step of the carriage; and twice that of the one look in a hundred that a busy host has disturbed.
fn assert_in_phase(what: &str, [half, most, all]: [f64; 3], pitch: f64, lathe: &dyn Lathe) {
    let bound = 0.002 + lathe.resolution() * pitch + lathe.step_mm();
    assert!(
        most <= bound && all <= 2.0 * bound,
        "{what}: {half}, {most}, {all} mm of {bound} mm"
    );
}

fn threads_in_phase(lathe: impl Fn() -> Arc<dyn Lathe>) {
    for (rpm, pitch) in [(200, 2.0), (1200, 1.5)] {
        where_undisturbed(LATE, || {
            let (lathe, workshop) = (lathe(), Workshop::new());
            let program = format!(
                "G21 G18 G90 G8\nS{rpm} M3\nG0 X15 Z5\nG76 P{pitch} Z-20 I-1 J0.4 K0.8 R1 H1\nG0 X20\nM5\nM2\n"
            );
            let cut = cut(&lathe, &workshop, &program, SHORT_LEAD, None);
            cut.is_done();
            let (trace, sights) = (cut.trace, cut.sights);
            let passes = passes(&sights, pitch, 5.0, -17.0..2.0);
            println!("{rpm} rpm, {pitch} mm: error of half, 99 % and all looks, mm: {passes:?}");
            // Two depths and a spring pass.
            assert_eq!(passes.len(), 3, "{passes:?}");
            for (errors, _) in &passes {
                assert_in_phase(&format!("{rpm} rpm"), *errors, pitch, &*lathe);
            }
            verifies(&trace);
        });
    }
}

/// A tap goes in and out by the same way, and its turns fall as they rose.
fn taps_in_phase(lathe: impl Fn() -> Arc<dyn Lathe>) {
    for code in ["G33.1 Z-10 K1", "G98 G84 Z-10 R5 F500"] {
        where_undisturbed(LATE, || {
            let (lathe, workshop) = (lathe(), Workshop::new());
            let program = format!("G21 G17 G90 G94 G8\nS500 M3\nG0 X0 Z5\n{code}\nG80\nG0 X20\nM5\nM2\n");
            let cut = cut(&lathe, &workshop, &program, SHORT_LEAD, None);
            cut.is_done();
            let (trace, sights) = (cut.trace, cut.sights);
            let deepest = (sights.iter().map(|sight| sight.z)).fold(f64::INFINITY, f64::min);
            // The bridge hears of the reversal with its setpoint, and acts within some milliseconds of it: 8 turns a second.
            assert!((deepest + 10.0).abs() < 0.15, "{code}: {deepest}");
            let (mut errors, mut ways) = (Vec::new(), [0, 0]);
            for pair in sights.windows(2) {
                let [before, here] = [pair[0], pair[1]];
                let (dz, turned) = (here.z - before.z, here.turns - before.turns);
                // Where both run evenly.
                let is_even = turned.abs() > 1e-3 && (dz / -turned - 1.0).abs() < 0.2;
                if is_even && (-7.0..3.0).contains(&here.z) {
                    ways[usize::from(dz > 0.0)] += 1;
                    let off = here.turns - (5.0 - here.z);
                    errors.push(off - off.round());
                }
            }
            errors.sort_unstable_by(|a, b| a.abs().total_cmp(&b.abs()));
            let found = [0.5, 0.99, 1.0].map(|share| quantile(&errors, share));
            println!("{code}: {deepest} mm deep, errors {found:?} mm, looks in and out {ways:?}");
            assert!(ways.iter().all(|looks| *looks > 100), "{ways:?}");
            assert_in_phase(code, found, 1.0, &*lathe);
            assert!(sights.last().expect("looks").z > 4.9, "out of the hole");
            verifies(&trace);
        });
    }
}

/// M19 turns the spindle to each angle, from speed and from rest, and holds it there.
fn turned_to_angles(lathe: impl Fn() -> Arc<dyn Lathe>, tolerance_deg: f64) {
    where_undisturbed(LATE, || {
        let (lathe, workshop) = (lathe(), Workshop::new());
        let program = "G21 G18 G90 G8\nS800 M3\nG4 P1.5\nM19 R90\nG4 P0.6\nM19 R250 P2\nG4 P0.6\nM4\nG4 P1\nM19 R10\nG4 P0.6\nM5\nM2\n";
        let cut = cut(&lathe, &workshop, program, LONG_LEAD, None);
        cut.is_done();
        let (trace, sights) = (cut.trace, cut.sights);
        let mut held: Vec<f64> = Vec::new();
        let mut since: Option<Sight> = None;
        for sight in &sights {
            match since {
                Some(first) if (sight.turns - first.turns).abs() < 0.2 * tolerance_deg / 360.0 => {
                    if sight.time_ns - first.time_ns > 250_000_000 {
                        let degrees = sight.turns.rem_euclid(1.0) * 360.0;
                        // Its final angle.
                        match held.last_mut() {
                            Some(last) if (*last - degrees).abs() < 5.0 => *last = degrees,
                            _ => held.push(degrees),
                        }
                    }
                }
                _ => since = Some(*sight),
            }
        }
        println!("held at {held:?} degrees");
        for wanted in [90.0, 250.0, 10.0] {
            let near = held.iter().any(|held| (held - wanted).abs() <= tolerance_deg);
            assert!(near, "{wanted} of {held:?}");
        }
        verifies(&trace);
    });
}

/// G95: so much per true turn.
fn feed_per_turn(lathe: impl Fn() -> Arc<dyn Lathe>) {
    where_undisturbed(LATE, || {
        let (lathe, workshop) = (lathe(), Workshop::new());
        let program = "G21 G18 G90 G8\nS600 M3\nG0 X15 Z5\nG95 F0.5\nG1 Z-20\nG0 X20\nM5\nM2\n";
        let cut = cut(&lathe, &workshop, program, LONG_LEAD, None);
        cut.is_done();
        let (trace, sights) = (cut.trace, cut.sights);
        let at = |z: f64| sights.iter().find(|sight| sight.z < z).expect("a look");
        let (from, to) = (at(0.0), at(-15.0));
        let per_turn = (from.z - to.z) / (to.turns - from.turns);
        println!("{per_turn} mm per turn");
        assert!((per_turn - 0.5).abs() < 0.01, "{per_turn}");
        verifies(&trace);
    });
}

/// Every fault in the middle of a pass stops the axes before the end of the pass and raises an alarm.
fn troubles_end_the_pass(lathe: impl Fn() -> Arc<dyn Lathe>, troubles: &[Trouble]) {
    for trouble in troubles.iter().copied() {
        where_undisturbed(LATE, || {
            let (lathe, workshop) = (lathe(), Workshop::new());
            let program = "G21 G18 G90 G8\nS300 M3\nG0 X15 Z5\nG33 Z-60 K1\nG0 X20\nM5\nM2\n";
            let Cut {
                status,
                trace,
                sights,
            } = cut(&lathe, &workshop, program, LONG_LEAD, Some((trouble, -5.0)));
            let sentence = status.alarm_sentence().to_owned();
            println!("{trouble:?}: {:?} {sentence}", status.listed_alarms());
            assert_ne!(status.job_result, DONE, "{trouble:?}");
            let alarms = status.listed_alarms();
            // The bridge that has lost its board says so for the axes first.
            let is_told = alarms.contains(&SPINDLE_ALARM)
                || sentence.contains("spindle")
                || trouble == Trouble::LinkLost && !alarms.is_empty();
            assert!(is_told, "{trouble:?}: {alarms:?} {sentence}");
            let end = sights.last().expect("looks");
            assert!(end.z > -40.0 && end.z < 5.0, "{trouble:?}: {end:?}");
            let rest = sights
                .iter()
                .rev()
                .find(|sight| end.time_ns - sight.time_ns > 100_000_000);
            let moved = rest.map_or(0.0, |rest| end.z - rest.z);
            assert!(moved.abs() < 0.01, "{trouble:?}: still moves, {moved} mm");
            verifies(&trace);
        });
    }
}

fn on_board() -> Arc<dyn Lathe> {
    Arc::new(MesaLathe::new())
}

#[test]
fn threads_on_a_mesa_board_are_in_phase() {
    threads_in_phase(on_board);
}

#[test]
fn taps_on_a_mesa_board_are_in_phase() {
    taps_in_phase(on_board);
}

#[test]
fn m19_on_a_mesa_board_turns_to_its_angles() {
    turned_to_angles(on_board, 1.0);
}

#[test]
fn g95_on_a_mesa_board_follows_the_measured_speed() {
    feed_per_turn(on_board);
}

#[test]
fn troubles_of_a_spindle_on_a_mesa_board_end_the_pass() {
    troubles_end_the_pass(
        on_board,
        &[
            Trouble::EncoderOff,
            Trouble::LostCounts,
            Trouble::IndexMissing,
            Trouble::Stall,
            Trouble::LinkLost,
        ],
    );
}

/// Runs a trial on the simulated ring.
fn on_ring(trial: impl FnOnce(&dyn Fn() -> Arc<dyn Lathe>) + Send + 'static) {
    on_bench(RingLathe::devices(), move |ring| {
        let ring = Arc::clone(ring);
        trial(&move || {
            Arc::new(RingLathe {
                ring: Arc::clone(&ring),
            })
        });
    });
}

#[test]
fn threads_on_an_ethercat_drive_are_in_phase() {
    on_ring(|lathe| threads_in_phase(lathe));
}

#[test]
fn taps_on_an_ethercat_drive_are_in_phase() {
    on_ring(|lathe| taps_in_phase(lathe));
}

#[test]
fn m19_on_an_ethercat_drive_turns_to_its_angles() {
    on_ring(|lathe| turned_to_angles(lathe, 1.0));
}

#[test]
fn g95_on_an_ethercat_drive_follows_the_measured_speed() {
    on_ring(|lathe| feed_per_turn(lathe));
}

#[test]
fn troubles_of_an_ethercat_spindle_end_the_pass() {
    // A ring each: a drive that has lost its fieldbus under power is in fault.
    for trouble in [
        Trouble::DriveFault,
        Trouble::IndexMissing,
        Trouble::Stall,
        Trouble::LinkLost,
    ] {
        on_ring(move |lathe| troubles_end_the_pass(lathe, &[trouble]));
    }
}
