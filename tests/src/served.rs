//! A served machine and its operators.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use evolvent_bus::{
    COMMANDS, ClientBus, ControlAnswer, ControlClient, ControlRequest, Setpoint, SetpointReader, Status,
    StatusReader,
};
use evolvent_runtime::MonotonicClock;
use rustix::process::{Pid, Signal, kill_process};

use crate::{Domain, Finished, evolvent};
use evolvent_disturbance::report_pause;

/// Time limit of every wait, for hosts that are busy or pause for seconds.
pub(crate) const PATIENCE: Duration = Duration::from_secs(120);

/// Duration that the queue of a subscriber holds.
const QUEUE_NS: u64 = 1_000_000_000;

/// A running `evolvent serve`. Ended, if necessary killed, on drop.
#[derive(Debug)]
pub struct Served {
    child: Option<Child>,
    /// The machine's name.
    pub name: String,
}

impl Served {
    /// Starts it; its state is kept in `state`. It records nothing unless an option names a file.
    ///
    /// # Panics
    /// If it cannot be started.
    #[must_use]
    pub fn start(machine: &Path, name: &str, domain: &Domain, state: &Path, options: &[&str]) -> Self {
        let records = options.iter().any(|option| option.starts_with("--trace"));
        let quiet: &[&str] = if records { &[] } else { &["--no-trace"] };
        let child = evolvent()
            .arg("serve")
            .arg("--machine")
            .arg(machine)
            .args(["--bus-prefix", &domain.prefix, "--json", "--state"])
            .arg(state)
            .args(options)
            .args(quiet)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary to start");
        Self {
            child: Some(child),
            name: name.to_owned(),
        }
    }

    /// Ends it as a service manager does, and waits.
    ///
    /// # Panics
    /// If it does not end.
    #[must_use]
    pub fn end(self) -> Finished {
        self.signal(Signal::TERM);
        self.wait()
    }

    /// Waits for its end.
    ///
    /// # Panics
    /// If waiting fails.
    #[must_use]
    pub fn wait(mut self) -> Finished {
        crate::wait(self.child.take().expect("a child"))
    }

    /// Kills it.
    ///
    /// # Panics
    /// If waiting fails.
    pub fn kill(mut self) {
        let mut child = self.child.take().expect("a child");
        child.kill().expect("killed");
        child.wait().expect("a process that ends");
    }

    /// The addresses of its screen: for commands and for viewing. Later output is read and dropped.
    ///
    /// # Panics
    /// If it ends before it prints them.
    #[must_use]
    pub fn screen(&mut self) -> [String; 2] {
        let child = self.child.as_mut().expect("a child");
        let mut lines = BufReader::new(child.stderr.take().expect("its notes"))
            .lines()
            .map_while(Result::ok);
        let mut word = |heading: &str| {
            let line = lines.find_map(|line| Some(line.trim().strip_prefix(heading)?.to_owned()));
            let line = line.expect("an address");
            line.split(' ').next().unwrap_or_default().to_owned()
        };
        let found = [word("screen: "), word("")];
        std::thread::spawn(move || lines.for_each(drop));
        found
    }

    /// Its process id.
    ///
    /// # Panics
    /// If it has ended.
    #[must_use]
    pub fn process(&self) -> u32 {
        self.child.as_ref().expect("a child").id()
    }

    /// Sends a signal.
    ///
    /// # Panics
    /// If it has ended.
    pub fn signal(&self, signal: Signal) {
        let child = self.child.as_ref().expect("a child");
        let pid = Pid::from_raw(child.id().cast_signed()).expect("a process");
        kill_process(pid, signal).expect("a living process");
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            let _gone = child.kill();
            let _gone = child.wait();
        }
    }
}

/// A client that commands and observes.
#[derive(Debug)]
pub struct Operator {
    /// The control service.
    pub control: ControlClient,
    status: StatusReader,
    /// Every setpoint since it joined.
    pub setpoints: SetpointReader,
    _bus: ClientBus,
}

/// A request for the command with this name on the bus.
///
/// # Panics
/// If there is no such command.
#[must_use]
pub fn command(name: &str) -> ControlRequest {
    let found = COMMANDS.iter().find(|(known, _)| *known == name);
    ControlRequest {
        command: found.expect("a command of the bus").1,
        ..ControlRequest::default()
    }
}

impl Operator {
    /// Joins; waits for the core.
    ///
    /// # Panics
    /// If the core does not start.
    #[must_use]
    pub fn join(name: &str, domain: &Domain) -> Self {
        let bus = domain.client(name);
        let config = evolvent_bus::ClientConfig {
            prefix: Some(domain.prefix.clone()),
            wait: PATIENCE,
            ..evolvent_bus::ClientConfig::new(name)
        };
        Self {
            control: ControlClient::open(&config).expect("the control service"),
            status: bus.status().expect("the status"),
            setpoints: bus.setpoints().expect("the setpoints"),
            _bus: bus,
        }
    }

    /// Sends a command and returns the reply.
    ///
    /// # Panics
    /// If there is none.
    pub fn request(&mut self, request: &ControlRequest) -> ControlAnswer {
        self.control
            .command(request, PATIENCE)
            .expect("an answer of the core")
    }

    /// Sends a command that must be accepted.
    ///
    /// # Panics
    /// If it is not.
    #[track_caller]
    pub fn does(&mut self, request: &ControlRequest) -> ControlAnswer {
        let answer = self.request(request);
        assert_eq!(answer.verdict, 0, "{}: {}", answer.alarm, answer.text());
        answer
    }

    /// As [`Operator::does`], by name and without arguments.
    #[track_caller]
    pub fn says(&mut self, name: &str) -> ControlAnswer {
        self.does(&command(name))
    }

    /// As [`Operator::says`], with a whole number.
    #[track_caller]
    pub fn says_number(&mut self, name: &str, index: u32) -> ControlAnswer {
        self.does(&ControlRequest {
            index,
            ..command(name)
        })
    }

    /// As [`Operator::says`], with a text.
    ///
    /// # Panics
    /// If the text is too long, or the command is not accepted.
    #[track_caller]
    pub fn says_text(&mut self, name: &str, text: &str) -> ControlAnswer {
        let mut request = command(name);
        assert!(request.set_text(text));
        self.does(&request)
    }

    /// Waits for a status that meets a condition.
    ///
    /// # Panics
    /// If there is none in time.
    #[track_caller]
    pub fn waits(&mut self, what: &str, mut until: impl FnMut(&Status) -> bool) -> Status {
        let begin = Instant::now();
        loop {
            let status = self.status.latest().expect("the status");
            if let Some(status) = &status {
                report_pause(status.wake_lateness_max_ns);
                // Without drives there is no feedback.
                if status.feedback_age_ns < u64::MAX {
                    report_pause(status.feedback_age_ns);
                }
            }
            if let Some(status) = status
                && until(&status)
            {
                return status;
            }
            assert!(
                begin.elapsed() < PATIENCE,
                "{what} does not come: {status:?} {}",
                status.map_or_else(String::new, |status| status.alarm_sentence().to_owned())
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// The status after all commands that have been replied to.
    #[track_caller]
    pub fn now(&mut self) -> Status {
        let requested_ns = MonotonicClock::now_ns();
        self.waits("a newer status", |status| status.time_ns > requested_ns)
    }

    /// Leaves the emergency stop and switches on.
    #[track_caller]
    pub fn brings_up(&mut self) {
        self.says("ESTOP_RESET");
        self.says("ON");
        self.waits("power", |status| status.machine_state == 2);
    }

    /// Homes all axes in manual mode; returns the status at the end.
    #[track_caller]
    pub fn homes(&mut self) -> Status {
        self.says_number("MODE", 1);
        let job = self.says("HOME").job;
        self.sees_end(job)
    }

    /// Reads setpoints until one meets a condition; passes every one to `observe`.
    ///
    /// # Panics
    /// If there is none in time.
    #[track_caller]
    pub fn follows(
        &mut self,
        mut observe: impl FnMut(&Setpoint),
        until: impl Fn(&Setpoint) -> bool,
    ) -> Setpoint {
        let begin = Instant::now();
        loop {
            match self.setpoints.receive().expect("setpoints") {
                Some(setpoint) => {
                    observe(&setpoint);
                    if until(&setpoint) {
                        return setpoint;
                    }
                }
                None => std::thread::sleep(Duration::from_micros(300)),
            }
            assert!(begin.elapsed() < PATIENCE, "it does not come");
        }
    }

    /// Waits for the end of a job; returns the status with its result.
    #[track_caller]
    pub fn sees_end(&mut self, job: u64) -> Status {
        self.waits("the job's end", |status| {
            status.job == job && status.job_result != 0
        })
    }
}

/// Whether a setpoint was received so late that earlier ones may be lost: the queue of a subscriber holds one
/// second.
#[must_use]
pub fn is_behind(setpoint: &Setpoint) -> bool {
    MonotonicClock::now_ns().saturating_sub(setpoint.due_time_ns) > QUEUE_NS / 2
}

/// Speed of all axes together.
#[must_use]
pub fn speed(setpoint: &Setpoint) -> f64 {
    setpoint.velocity.iter().map(|v| v * v).sum::<f64>().sqrt()
}
