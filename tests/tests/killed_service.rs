//! A served machine and its clients, killed at random moments; and users without the right to command.
#![expect(
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests fail as tests do"
)]

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;

use evolvent_bus::{ClientBus, ClientConfig, ControlRequest, Feedback};
use evolvent_tests::{
    Domain, Drives, Operator, Random, Served, Workshop, command, evolvent, unless_disturbed,
};

fn cases(usual: usize) -> usize {
    std::env::var("EVOLVENT_CASES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(usual)
}

/// The machine of a campaign.
struct Machine<'a> {
    name: &'static str,
    file: &'a Path,
    state: &'a Path,
    domain: &'a Domain,
}

impl Machine<'_> {
    fn core(&self) -> Served {
        Served::start(self.file, self.name, self.domain, self.state, &[])
    }

    fn drives(&self) -> Drives {
        Drives::start(self.file, self.domain, &[])
    }

    /// A client that jogs, if permitted.
    fn client(&self) -> Process {
        let mut command = evolvent();
        command
            .args([
                "ctl",
                "--bus-prefix",
                &self.domain.prefix,
                "--machine-name",
                self.name,
            ])
            .args(["--patience", "120", "jog", "X+", "--speed", "600"]);
        Process::start(&mut command)
    }
}

/// A process that is killed on drop.
struct Process(Child);

impl Process {
    fn start(command: &mut Command) -> Self {
        let command = command.stdout(Stdio::null()).stderr(Stdio::null());
        Self(command.spawn().expect("the binary to start"))
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}

/// Maximum values reported by the drives, as fractions of their limits, and whether they are at rest at the
/// end.
#[derive(Clone, Copy, Debug, Default)]
struct Driven {
    velocity: f64,
    acceleration: f64,
    /// The state of the bridge then: an index into the list of its states.
    worst_in_state: u32,
    samples: u64,
    /// Times at which the host suspended the process of the drives, so that simulated time was skipped.
    skips: u64,
    /// Maximum acceleration within [`AFTER_SKIP_NS`] of a skip.
    after_skips: f64,
}

/// Settling time of the position loops after a skip.
const AFTER_SKIP_NS: u64 = 1_000_000_000;

impl Driven {
    fn include(&mut self, other: &Self) {
        self.velocity = self.velocity.max(other.velocity);
        if other.acceleration > self.acceleration {
            self.worst_in_state = other.worst_in_state;
        }
        self.acceleration = self.acceleration.max(other.acceleration);
        self.after_skips = self.after_skips.max(other.after_skips);
        self.samples += other.samples;
        self.skips += other.skips;
    }
}

/// Reads the feedback of the drives.
struct Onlooker {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Driven>,
}

impl Onlooker {
    fn start(machine: &Machine<'_>) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (is_over, bus_of) = (Arc::clone(&stop), (machine.name, machine.domain.prefix.clone()));
        let limits = evolvent_machine::Machine::load(machine.file)
            .expect("a machine file")
            .limits();
        let (ready_sender, ready) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            let config = ClientConfig {
                prefix: Some(bus_of.1),
                wait: Duration::from_secs(120),
                ..ClientConfig::new(bus_of.0)
            };
            let bus = ClientBus::open(&config).expect("a core");
            let mut reader = bus.feedback().expect("the feedback");
            ready_sender.send(()).expect("somebody who waits");
            let mut driven = Driven::default();
            let mut last: Option<Feedback> = None;
            let (mut skipped_ns, mut worst_in_state) = (0, 0);
            while !is_over.load(Ordering::Relaxed) {
                while let Some(now) = reader.receive().expect("feedback") {
                    driven.samples += 1;
                    let step_ns = last.map_or(0, |last| now.time_ns.saturating_sub(last.time_ns));
                    if 2 * step_ns > 3 * bus.period_ns() {
                        driven.skips += 1;
                        skipped_ns = now.time_ns;
                    }
                    for axis in 0..3 {
                        let velocity = now.velocity[axis].abs() / limits.velocity[axis];
                        driven.velocity = driven.velocity.max(velocity);
                        // For one set of drives, from one period to the next.
                        if let Some(last) = last.filter(|last| last.instance == now.instance)
                            && now.time_ns > last.time_ns
                        {
                            let seconds = (now.time_ns - last.time_ns) as f64 * 1e-9;
                            let change = (now.velocity[axis] - last.velocity[axis]) / seconds;
                            let fraction = change.abs() / limits.acceleration[axis];
                            let is_settled = now.time_ns > skipped_ns + AFTER_SKIP_NS;
                            let max = if is_settled {
                                &mut driven.acceleration
                            } else {
                                &mut driven.after_skips
                            };
                            if is_settled && fraction > *max {
                                worst_in_state = now.bridge_state;
                            }
                            *max = max.max(fraction);
                        }
                    }
                    last = Some(now);
                }
                std::thread::sleep(Duration::from_millis(1));
            }
            driven.worst_in_state = worst_in_state;
            driven
        });
        ready.recv_timeout(Duration::from_secs(120)).expect("an onlooker");
        Self { stop, thread }
    }

    /// Ends the observation half a second later.
    fn end(self) -> Driven {
        std::thread::sleep(Duration::from_millis(500));
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().expect("an onlooker")
    }
}

/// Brings the machine up again, whatever is latched; returns the previous alarm.
fn brings_up_again(operator: &mut Operator) -> Option<u32> {
    operator.waits("drives", |status| status.feedback_age_ns < 200_000_000);
    let mut met = None;
    for _ in 0..200 {
        let status = operator.waits("rest", |status| {
            status.activity == 0 && status.velocity == [0.0; 9]
        });
        met = met.or(status.listed_alarms().first().copied());
        let _cleared = operator.request(&command("CLEAR_ALARMS"));
        if status.machine_state == 0 {
            let _off = operator.request(&command("ESTOP_RESET"));
        }
        // Drives that a busy host delays count as absent.
        if operator.request(&command("ON")).verdict != 0 {
            std::thread::sleep(Duration::from_millis(50));
            continue;
        }
        let status = operator.waits("power or an alarm", |status| {
            status.machine_state == 2 || status.alarm_count > 0
        });
        if status.machine_state == 2 && status.alarm_count == 0 {
            // New drives without absolute encoders: the operator has to declare the positions.
            if status.homed_mask & 0b111 != 0b111 {
                operator.homes();
            }
            return met;
        }
    }
    panic!(
        "the machine does not come up: {}",
        operator.now().alarm_sentence()
    );
}

/// The core, the drives or a client is killed while the machine starts, moves or ends. The others, or their
/// successors, continue, and the drives keep their limits. At the end nothing remains in shared memory: the
/// domain checks that.
#[test]
fn killed_cores_bridges_and_clients_leave_nothing() {
    unless_disturbed(|| {
        let (workshop, domain, mut random) = (Workshop::new(), Domain::new(), Random::new());
        let name = "op-kill";
        // Busy hosts delay bridges; the time until that is noticed is not tested here.
        let file = workshop.mill(
            name,
            &[("feedback_timeout_ms = 20 ", "feedback_timeout_ms = 400 ")],
        );
        let state = workshop.path("state");
        let program = workshop.long_program(30);
        let machine = Machine {
            name,
            file: &file,
            state: &state,
            domain: &domain,
        };
        let mut served = machine.core();
        let mut drives = Some(machine.drives());
        let (mut killed, mut disturbed, mut worst) = ([0; 3], 0, Driven::default());
        for case in 0..cases(6) {
            let mut operator = Operator::join(name, &domain);
            brings_up_again(&mut operator);
            let onlooker = Onlooker::start(&machine);
            // Sometimes a program, sometimes a jog.
            let client = if random.below(2) == 0 {
                operator.says_number("MODE", 0);
                operator.says_text("LOAD", program.to_str().expect("UTF-8"));
                operator.says("START");
                None
            } else {
                operator.says_number("MODE", 1);
                Some(machine.client())
            };
            std::thread::sleep(Duration::from_micros(random.below(400_000) as u64));
            let victim = case % 3;
            killed[victim] += 1;
            match victim {
                0 => {
                    drop(operator);
                    served.kill();
                    // The drives stop on their own.
                    let driven = onlooker.end();
                    worst.include(&driven);
                    drop(client);
                    served = machine.core();
                    operator = Operator::join(name, &domain);
                }
                1 => {
                    drop(drives.take());
                    let status = operator.waits("rest without drives", |status| {
                        status.activity == 0 && status.machine_state < 2 && status.velocity == [0.0; 9]
                    });
                    // It stopped by one of the alarms of the watch.
                    let alarm = status.listed_alarms().first().copied().unwrap_or(0);
                    assert!((400..420).contains(&alarm), "case {case}: alarm {alarm}");
                    let _driven = onlooker.end();
                    drop(client);
                    drives = Some(machine.drives());
                }
                _ => {
                    drop(client);
                    let _stopped = operator.request(&command("STOP"));
                    operator.waits("rest", |status| {
                        status.activity == 0 && status.velocity == [0.0; 9]
                    });
                    let driven = onlooker.end();
                    worst.include(&driven);
                }
            }
            // It replies and can be operated.
            let met = brings_up_again(&mut operator);
            // A busy host may stop the drives for so long that the core notices.
            disturbed += usize::from(victim == 2 && met.is_some());
            let _stopped = operator.request(&command("STOP"));
            operator.waits("rest", |status| status.activity == 0);
            operator.says_number("MODE", 1);
        }
        let [cores, bridges, clients] = killed;
        println!(
            "{cores} cores, {bridges} bridges, {clients} clients killed; {disturbed} cases disturbed by the \
             host"
        );
        println!("drives, as shares of what they may have: {worst:?}");
        // The position loop overshoots the braking ramp by a few percent.
        assert!(worst.velocity < 1.05 && worst.acceleration < 1.15, "{worst:?}");
        assert!(disturbed * 5 <= cases(6), "{disturbed} cases disturbed");
        drop(drives);
        served.end().expect_code(&[0, 3]);
    });
}

#[test]
fn nobody_but_the_owner_can_open_the_channels() {
    unless_disturbed(|| {
        let (workshop, domain) = (Workshop::new(), Domain::new());
        let name = "op-owner";
        let machine = workshop.mill(name, &[]);
        let served = Served::start(&machine, name, &domain, &workshop.path("state"), &[]);
        let mut operator = Operator::join(name, &domain);
        operator.brings_up();
        let own = rustix::process::getuid().as_raw();
        let mut count = 0;
        for file in domain.files() {
            let Ok(facts) = file.metadata() else { continue };
            assert_eq!(facts.uid(), own, "{}", file.display());
            if facts.is_file() {
                count += 1;
                let mode = facts.permissions().mode() & 0o077;
                assert_eq!(mode, 0, "{} may be used by others: {mode:o}", file.display());
            }
        }
        assert!(count >= 10, "{count} files prove nothing");

        let before = operator.now();
        // Only root can become another user.
        let binary = workshop.path("evolvent");
        std::fs::copy(evolvent().get_program(), &binary).expect("a copy of the binary");
        std::fs::set_permissions(&binary, PermissionsExt::from_mode(0o755)).expect("permissions");
        std::fs::set_permissions(workshop.folder(), PermissionsExt::from_mode(0o755)).expect("permissions");
        let stranger = Command::new("runuser")
            .args(["-u", "nobody", "--"])
            .arg(&binary)
            .args([
                "ctl",
                "--bus-prefix",
                &domain.prefix,
                "--machine-name",
                name,
                "override",
                "10",
            ])
            .current_dir("/")
            .output();
        match stranger {
            Ok(output) if own == 0 => {
                let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
                assert_eq!(output.status.code(), Some(1), "{stderr}");
                println!("another user reads: {stderr}");
                let after = operator.now();
                assert_eq!(after.override_ratio, 1.0);
                assert_eq!(after.commands_accepted, before.commands_accepted);
            }
            _ => println!("not measured: becoming another user needs root and runuser"),
        }
        operator.does(&ControlRequest {
            amount: 0.9,
            ..command("FEED_OVERRIDE")
        });
        drop(operator);
        served.end().expect_code(&[0, 3]);
    });
}
