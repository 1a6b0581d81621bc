//! A lathe that cuts threads, taps, and orients its spindle through the hardware bridges and their
//! simulators: every process as in use, over real sockets. The reference is the true angle and the true
//! carriage position of the simulator, read at the same instant; no bridge sees either.
#![expect(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use std::cell::Cell;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError, RwLock};
use std::thread::JoinHandle;
use std::time::Duration;

use evolvent_bus::{ControlRequest, Status};
use evolvent_tests::job_result::DONE;
use evolvent_tests::{
    Cycle, Domain, HardwareBridge, Lathe, MesaLathe, Operator, RingLathe, Served, ShippedLathe, Sight,
    Trouble, Workshop, command, cycles, verifies, where_undisturbed,
};

const SPINDLE_ALARM: u32 = 440;
const NAME: &str = "spun-lathe";
/// Lead of setpoints in periods: the angle is predicted over it, so a thread needs a short one; a busy host
/// needs a long one.
const SHORT_LEAD: u32 = 3;
/// With that lead a setpoint is late, and out of phase, after this pause.
const LATE: Duration = Duration::from_millis(3);
const LONG_LEAD: u32 = 120;
const SPINDLES: &str = "[[spindle]]\nmax_rpm = 3000\nfeedback = true\nacceleration_rpm_s = 2000\n";

/// Observes a lathe continuously, and starts trouble once its carriage has reached a position.
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
                    let sight = lathe.observe();
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

/// The result of a program.
struct Cut {
    status: Status,
    trace: PathBuf,
    /// Unix time minus CLOCK_MONOTONIC.
    unix_ns: u64,
    /// The true states of the machine.
    sights: Vec<Sight>,
}

impl Cut {
    fn is_done(&self) {
        let sentence = self.status.alarm_sentence();
        assert_eq!(self.status.job_result, DONE, "{sentence}");
    }
}

/// One lathe at a time if setpoints are due soon: core, bridge and simulator each need a processor.
static TURN: RwLock<()> = RwLock::new(());

/// As in docs/ethercat.md: power, on which the drives home; off and on again; HOME takes over their
/// positions; jogs from the switches into the travel.
fn homes_by_drives(operator: &mut Operator, positions: [f64; 2]) {
    const AXES: [usize; 2] = [0, 2];
    operator.says("ESTOP_RESET");
    operator.says("ON");
    operator.waits("machine zero of the drives", |status| {
        let near = |(axis, position): (usize, f64)| (status.position_actual[axis] - position).abs() < 0.05;
        AXES.into_iter().zip(positions).all(near)
    });
    operator.says("OFF");
    operator.says("ON");
    operator.waits("power", |status| status.machine_state == 2);
    let homed = operator.homes();
    let mask = AXES.iter().fold(0, |mask, axis| mask | 1 << axis);
    assert_eq!(homed.homed_mask & mask, mask, "{}", homed.alarm_sentence());
    for axis in AXES {
        let mut jog = ControlRequest {
            axes_mask: 1 << axis,
            index: 1,
            amount: 10.0,
            ..command("JOG")
        };
        jog.values[axis] = -10.0;
        let job = operator.does(&jog).job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
    }
}

/// Runs a program on a served lathe.
fn cut(
    lathe: &Arc<dyn Lathe>,
    workshop: &Workshop,
    program: &str,
    lead_cycles: u32,
    trouble: Option<(Trouble, f64)>,
) -> Cut {
    let is_alone = lead_cycles == SHORT_LEAD;
    let _alone = is_alone.then(|| TURN.write().unwrap_or_else(PoisonError::into_inner));
    let _beside = (!is_alone).then(|| TURN.read().unwrap_or_else(PoisonError::into_inner));
    let domain = Domain::new();
    let machine = lathe.machine(workshop, NAME, SPINDLES);
    let text = std::fs::read_to_string(&machine).expect("a machine file");
    // A bridge on a busy host may be slow.
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
    let bridge = HardwareBridge::start(&lathe.bridge(workshop), &machine, &domain);
    operator.waits("drives", |status| status.feedback_age_ns < 100_000_000);
    if let Some(positions) = lathe.homed_at() {
        homes_by_drives(&mut operator, positions);
        std::thread::sleep(Duration::from_millis(200));
        lathe.set_z(operator.now().position_actual[2]);
    } else {
        operator.brings_up();
    }
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
    let unix = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let unix_ns = unix.expect("after 1970").as_nanos() as u64 - evolvent_mesa_board::now_ns();
    Cut {
        status,
        trace,
        unix_ns,
        sights,
    }
}

/// Times at which the host suspended core, bridge or observer. A setpoint or a packet that is late by more
/// than [`PAUSE`] affects the phase until all loops have caught up.
struct Pauses(Vec<(u64, u64)>);

const PAUSE_NS: u64 = 1_500_000;
const SETTLING_NS: u64 = 60_000_000;

impl Pauses {
    fn of(cut: &Cut) -> Self {
        let mut pauses = Vec::new();
        let mut last = (0, 0);
        for sight in &cut.sights {
            // The observations are 0.7 ms apart, and the packets 1 ms.
            if sight.packets != last.0 {
                if sight.time_ns - last.1 > 1_700_000 + PAUSE_NS {
                    pauses.push((last.1, sight.time_ns + SETTLING_NS));
                }
                last = (sight.packets, sight.time_ns);
            }
        }
        let late = |cycle: &&Cycle| cycle.wake_lateness_ns > PAUSE_NS.cast_signed();
        for cycle in cycles(&cut.trace).iter().filter(late) {
            let due_ns = cycle.due_time_ns - cut.unix_ns;
            // It wakes some periods before the setpoint is due.
            let from = due_ns.saturating_sub(u64::from(SHORT_LEAD) * 1_000_000);
            pauses.push((
                from,
                due_ns + cycle.wake_lateness_ns.cast_unsigned() + SETTLING_NS,
            ));
        }
        Self(pauses)
    }

    fn contain(&self, time_ns: u64) -> bool {
        self.0.iter().any(|(from, to)| (*from..*to).contains(&time_ns))
    }
}

/// Phase error of each pass away from a start, mm: the median, the 99th percentile and the maximum of the
/// observations without pauses, and the number of observations. A pass begins at `start` with a whole turn.
fn passes(cut: &Cut, pitch: f64, start: f64, z_range: std::ops::Range<f64>) -> Vec<([f64; 3], usize)> {
    let pauses = Pauses::of(cut);
    let mut passes: Vec<Vec<f64>> = Vec::new();
    let mut last_ns = 0;
    for pair in cut.sights.windows(2) {
        let [before, here] = [pair[0], pair[1]];
        let seconds = (here.time_ns - before.time_ns) as f64 * 1e-9;
        let (v, speed) = (
            (here.z - before.z) / seconds,
            (here.turns - before.turns) / seconds,
        );
        // A rapid does not have the speed of a pass with this spindle speed.
        if !z_range.contains(&here.z) || v >= -1.0 || (v.abs() / (speed.abs() * pitch) - 1.0).abs() > 0.3 {
            continue;
        }
        if here.time_ns > last_ns + 50_000_000 {
            passes.push(Vec::new());
        }
        last_ns = here.time_ns;
        let turned = here.turns - (start - here.z) / pitch;
        if let Some(pass) = passes.last_mut().filter(|_| !pauses.contain(here.time_ns)) {
            pass.push((turned - turned.round()) * pitch);
        }
    }
    passes
        .into_iter()
        .filter(|pass| pass.len() > 30)
        .map(|mut pass| {
            pass.sort_unstable_by(|a, b| a.abs().total_cmp(&b.abs()));
            (
                [0.5, 0.99, 1.0].map(|fraction| quantile(&pass, fraction)),
                pass.len(),
            )
        })
        .collect()
}

/// A quantile of errors sorted by size.
fn quantile(sorted: &[f64], fraction: f64) -> f64 {
    sorted[((sorted.len() - 1) as f64 * fraction) as usize].abs()
}

/// 2 um, a count of the encoder and a step of the carriage, mm.
fn phase_bound(pitch: f64, lathe: &dyn Lathe) -> f64 {
    0.002 + lathe.resolution() * pitch + lathe.step_mm()
}

/// Phase errors that occur in every attempt are not caused by pauses of the host: they fail the test even if
/// the host pauses in each. A single attempt proves nothing.
struct ConstantError {
    /// The minimum over the attempts, relative to the bound.
    min_ratio: Cell<f64>,
    attempts: Cell<u32>,
}

impl ConstantError {
    const fn new() -> Self {
        Self {
            min_ratio: Cell::new(f64::INFINITY),
            attempts: Cell::new(0),
        }
    }

    /// Adds the median error of each pass of one attempt, and the bound: a constant error is also in the best
    /// pass.
    fn add(&self, errors: impl IntoIterator<Item = [f64; 3]>, bound: f64) {
        // An attempt without measurements proves nothing.
        let Some(best) = errors
            .into_iter()
            .map(|[median, ..]| median / bound)
            .reduce(f64::min)
        else {
            return;
        };
        self.min_ratio.set(self.min_ratio.get().min(best));
        self.attempts.set(self.attempts.get() + 1);
    }

    fn assert_none(&self) {
        let (min_ratio, attempts) = (self.min_ratio.get(), self.attempts.get());
        assert!(
            attempts < 2 || min_ratio <= 1.0,
            "half of the observations are off by {min_ratio} times the bound in all of {attempts} attempts"
        );
    }
}

/// Within the bound, and within twice the bound for one observation in a hundred.
fn assert_in_phase(what: &str, [median, p99, max]: [f64; 3], pitch: f64, lathe: &dyn Lathe) {
    let bound = phase_bound(pitch, lathe);
    assert!(
        p99 <= bound && max <= 2.0 * bound,
        "{what}: {median}, {p99}, {max} mm of {bound} mm"
    );
}

fn threads_in_phase(lathe: impl Fn() -> Arc<dyn Lathe>) {
    for (rpm, pitch) in [(200, 2.0), (1200, 1.5)] {
        let constant = ConstantError::new();
        where_undisturbed(LATE, || {
            let (lathe, workshop) = (lathe(), Workshop::new());
            let program = format!(
                "G21 G18 G90 G8\nS{rpm} M3\nG0 X15 Z5\nG76 P{pitch} Z-20 I-1 J0.4 K0.8 R1 H1\nG0 X20\nM5\n\
                 M2\n"
            );
            let cut = cut(&lathe, &workshop, &program, SHORT_LEAD, None);
            cut.is_done();
            let passes = passes(&cut, pitch, 5.0, -17.0..2.0);
            println!("{rpm} rpm, {pitch} mm: median, 99 % and maximum error, mm: {passes:?}");
            constant.add(
                passes.iter().map(|(errors, _)| *errors),
                phase_bound(pitch, &*lathe),
            );
            // Two depths and a spring pass.
            assert_eq!(passes.len(), 3, "{passes:?}");
            for (errors, _) in &passes {
                assert_in_phase(&format!("{rpm} rpm"), *errors, pitch, &*lathe);
            }
            verifies(&cut.trace);
        });
        constant.assert_none();
    }
}

/// A tap goes in and out along the same path, and its turns fall as they rose.
fn taps_in_phase(lathe: impl Fn() -> Arc<dyn Lathe>) {
    for code in ["G33.1 Z-10 K1", "G98 G84 Z-10 R5 F500"] {
        let constant = ConstantError::new();
        where_undisturbed(LATE, || {
            let (lathe, workshop) = (lathe(), Workshop::new());
            let program = format!("G21 G17 G90 G94 G8\nS500 M3\nG0 X0 Z5\n{code}\nG80\nG0 X20\nM5\nM2\n");
            let cut = cut(&lathe, &workshop, &program, SHORT_LEAD, None);
            cut.is_done();
            let pauses = Pauses::of(&cut);
            let (trace, sights) = (cut.trace, cut.sights);
            let deepest = (sights.iter().map(|sight| sight.z)).fold(f64::INFINITY, f64::min);
            // The bridge receives the reversal with its setpoint, and acts within a few milliseconds: 8 turns
            // per second.
            assert!((deepest + 10.0).abs() < 0.15, "{code}: {deepest}");
            let (mut errors, mut counts) = (Vec::new(), [0, 0]);
            for pair in sights.windows(2) {
                let [before, here] = [pair[0], pair[1]];
                let (dz, turned) = (here.z - before.z, here.turns - before.turns);
                // Where both run evenly.
                let is_even = turned.abs() > 1e-3 && (dz / -turned - 1.0).abs() < 0.2;
                if is_even && (-7.0..3.0).contains(&here.z) && !pauses.contain(here.time_ns) {
                    counts[usize::from(dz > 0.0)] += 1;
                    let off = here.turns - (5.0 - here.z);
                    errors.push(off - off.round());
                }
            }
            errors.sort_unstable_by(|a, b| a.abs().total_cmp(&b.abs()));
            let found = [0.5, 0.99, 1.0].map(|fraction| quantile(&errors, fraction));
            println!("{code}: {deepest} mm deep, errors {found:?} mm, observations in and out {counts:?}");
            assert!(counts.iter().all(|count| *count > 100), "{counts:?}");
            constant.add([found], phase_bound(1.0, &*lathe));
            assert_in_phase(code, found, 1.0, &*lathe);
            assert!(sights.last().expect("observations").z > 4.9, "out of the hole");
            verifies(&trace);
        });
        constant.assert_none();
    }
}

/// M19 turns the spindle to each angle, from speed and from rest, and holds it there.
fn turned_to_angles(lathe: impl Fn() -> Arc<dyn Lathe>, tolerance_deg: f64) {
    where_undisturbed(LATE, || {
        let (lathe, workshop) = (lathe(), Workshop::new());
        let program = "G21 G18 G90 G8\nS800 M3\nG4 P1.5\nM19 R90\nG4 P0.6\nM19 R250 P2\nG4 P0.6\nM4\nG4 P1\n\
                       M19 R10\nG4 P0.6\nM5\nM2\n";
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

/// G95: feed per true turn.
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

/// Every fault during a pass stops the axes before the end of the pass and raises an alarm.
fn troubles_end_the_pass(lathe: impl Fn() -> Arc<dyn Lathe>, troubles: &[Trouble]) {
    for trouble in troubles.iter().copied() {
        where_undisturbed(LATE, || {
            let (lathe, workshop) = (lathe(), Workshop::new());
            let program = "G21 G18 G90 G8\nS300 M3\nG0 X15 Z5\nG33 Z-60 K1\nG0 X20\nM5\nM2\n";
            let Cut {
                status,
                trace,
                sights,
                ..
            } = cut(&lathe, &workshop, program, LONG_LEAD, Some((trouble, -5.0)));
            let sentence = status.alarm_sentence().to_owned();
            println!("{trouble:?}: {:?} {sentence}", status.listed_alarms());
            assert_ne!(status.job_result, DONE, "{trouble:?}");
            let alarms = status.listed_alarms();
            // The bridge that has lost its board reports the axes first.
            let is_reported = alarms.contains(&SPINDLE_ALARM)
                || sentence.contains("spindle")
                || trouble == Trouble::LinkLost && !alarms.is_empty();
            assert!(is_reported, "{trouble:?}: {alarms:?} {sentence}");
            let end = sights.last().expect("observations");
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
    Arc::new(MesaLathe::start())
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

#[test]
fn threads_on_an_ethercat_drive_are_in_phase() {
    RingLathe::on_ring(|lathe| threads_in_phase(lathe));
}

#[test]
fn taps_on_an_ethercat_drive_are_in_phase() {
    RingLathe::on_ring(|lathe| taps_in_phase(lathe));
}

#[test]
fn m19_on_an_ethercat_drive_turns_to_its_angles() {
    RingLathe::on_ring(|lathe| turned_to_angles(lathe, 1.0));
}

#[test]
fn g95_on_ethercat_follows_the_measured_speed() {
    RingLathe::on_ring(|lathe| feed_per_turn(lathe));
}

#[test]
fn troubles_of_an_ethercat_spindle_end_the_pass() {
    RingLathe::on_ring(|lathe| {
        troubles_end_the_pass(
            lathe,
            &[
                Trouble::DriveFault,
                Trouble::IndexMissing,
                Trouble::Stall,
                Trouble::LinkLost,
            ],
        );
    });
}

/// The shipped pair of files: its drives home, and a thread of two depths and a spring pass is in phase.
#[test]
fn the_shipped_ethercat_lathe_homes_and_threads() {
    ShippedLathe::on_ring(|lathe| {
        let constant = ConstantError::new();
        where_undisturbed(LATE, || {
            let (lathe, workshop) = (lathe(), Workshop::new());
            let program =
                "G21 G18 G90 G8\nS600 M3\nG0 X15 Z55\nG76 P1.5 Z30 I-1 J0.4 K0.8 R1 H1\nG0 X20\nM5\nM2\n";
            let cut = cut(&lathe, &workshop, program, SHORT_LEAD, None);
            cut.is_done();
            let passes = passes(&cut, 1.5, 55.0, 33.0..52.0);
            println!("median, 99 % and maximum error, mm: {passes:?}");
            constant.add(
                passes.iter().map(|(errors, _)| *errors),
                phase_bound(1.5, &*lathe),
            );
            assert_eq!(passes.len(), 3, "{passes:?}");
            for (errors, _) in &passes {
                assert_in_phase("the shipped lathe", *errors, 1.5, &*lathe);
            }
            verifies(&cut.trace);
        });
        constant.assert_none();
    });
}
