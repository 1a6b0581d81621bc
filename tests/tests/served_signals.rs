//! Outputs, inputs and the emergency-stop chain of a served machine, with an independent bridge on the bus.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use evolvent_bus::{ControlRequest, MachineInputs, MachineOutputs, switches};
use evolvent_replay::verify;
use evolvent_runtime::MonotonicClock;
use evolvent_tests::job_result::{DONE, FAULT};
use evolvent_tests::{
    Domain, Finished, Operator, Served, Workshop, command, evolvent, python, speed, unless_disturbed, wait,
};
use evolvent_trace::{EventKind, TraceFile};

const ESTOP: u32 = 0;
const CHAIN: u64 = 1 << 5;
const READY: u64 = 1 << 2;

/// A bridge on a busy host may be silent for a second.
const SIGNALS: &str = "
[signals]
input_timeout_ms = 1000
[[input]]
name = \"chain\"
number = 5
[[input]]
name = \"ready\"
number = 2
[[output]]
name = \"clamp\"
number = 0
safe_on = true
on_end = \"safe\"
[[output]]
name = \"lamp\"
number = 1
on_end = \"keep\"
on_stop = \"keep\"
[[output]]
name = \"laser\"
kind = \"analog\"
number = 3
min = 0
max = 10
on_end = \"keep\"
[[spindle]]
number = 0
max_rpm = 8000
reverse = true
[estop]
input = \"chain\"
";

/// What the bridge reads and writes while it lives.
struct Bridge {
    inputs: Arc<AtomicU64>,
    is_silent: Arc<AtomicBool>,
    over: Arc<AtomicBool>,
    outputs: Arc<Mutex<Vec<MachineOutputs>>>,
    thread: Option<JoinHandle<()>>,
}

impl Bridge {
    /// Joins the bus, with the chain closed or open.
    fn start(domain: &Domain, name: &str, inputs: u64) -> Self {
        let client = domain.client(name);
        let inputs = Arc::new(AtomicU64::new(inputs));
        let (is_silent, over) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
        let received = Arc::new(Mutex::new(Vec::new()));
        let (its_inputs, its_silence, its_end, its_received) = (
            Arc::clone(&inputs),
            Arc::clone(&is_silent),
            Arc::clone(&over),
            Arc::clone(&received),
        );
        let thread = std::thread::spawn(move || {
            let mut outputs = client.outputs().expect("outputs");
            let mut sender = client.input_sender().expect("inputs");
            let mut sequence = 0;
            while !its_end.load(Ordering::Acquire) {
                while let Ok(Some(message)) = outputs.receive() {
                    its_received.lock().expect("nobody panicked").push(message);
                }
                if !its_silence.load(Ordering::Acquire) {
                    sequence += 1;
                    let message = MachineInputs {
                        sequence,
                        instance: 77,
                        time_ns: MonotonicClock::now_ns(),
                        digital_mask: CHAIN | READY,
                        digital: its_inputs.load(Ordering::Acquire),
                        ..MachineInputs::default()
                    };
                    // A core that has ended receives none.
                    let _gone = sender.send(&message);
                }
                std::thread::sleep(Duration::from_millis(2));
            }
        });
        Self {
            inputs,
            is_silent,
            over,
            outputs: received,
            thread: Some(thread),
        }
    }

    fn reads(&self, inputs: u64) {
        self.inputs.store(inputs, Ordering::Release);
    }

    /// Every message of outputs so far.
    fn received(&self) -> Vec<MachineOutputs> {
        self.outputs.lock().expect("nobody panicked").clone()
    }

    /// Waits for outputs that meet a condition; returns the first message that does, from number `from` on.
    #[track_caller]
    fn waits(&self, what: &str, from: usize, until: impl Fn(&MachineOutputs) -> bool) -> MachineOutputs {
        let begin = Instant::now();
        loop {
            let received = self.received();
            if let Some(found) = received.iter().skip(from).find(|message| until(message)) {
                return *found;
            }
            assert!(
                begin.elapsed() < Duration::from_secs(60),
                "{what} does not come: {:?}",
                received.last()
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for Bridge {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _panicked = thread.join();
        }
    }
}

struct Shop {
    workshop: Workshop,
    domain: Domain,
    machine: PathBuf,
    name: &'static str,
}

impl Shop {
    fn new(name: &'static str) -> Self {
        let workshop = Workshop::new();
        let text = std::fs::read_to_string(workshop.mill(name, &[])).expect("a machine file");
        let machine = workshop.write(&format!("{name}.toml"), format!("{text}{SIGNALS}"));
        Self {
            workshop,
            domain: Domain::new(),
            machine,
            name,
        }
    }

    fn serves(&self, options: &[&str]) -> Served {
        Served::start(
            &self.machine,
            self.name,
            &self.domain,
            &self.workshop.path("state"),
            options,
        )
    }

    /// `evolvent ctl`, as typed by a person.
    fn ctl(&self, words: &[&str]) -> Finished {
        let child = evolvent()
            .args([
                "ctl",
                "--machine-name",
                self.name,
                "--bus-prefix",
                &self.domain.prefix,
            ])
            .args(words)
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .expect("the binary to start");
        wait(child)
    }

    fn loads(&self, operator: &mut Operator, program: &str) {
        let file = self.workshop.write("part.ngc", program);
        operator.says_number("MODE", 0);
        operator.says_text("LOAD", file.to_str().expect("UTF-8"));
    }
}

fn set(output: &str, amount: f64) -> ControlRequest {
    let mut request = ControlRequest {
        amount,
        ..command("SET_OUTPUT")
    };
    assert!(request.set_text(output));
    request
}

#[test]
fn a_served_program_switches_waits_and_is_recomputed() {
    unless_disturbed(|| {
        let shop = Shop::new("ss-program");
        let trace = shop.workshop.path("session.mcap");
        let served = shop.serves(&["--trace", trace.to_str().expect("UTF-8")]);
        let mut operator = Operator::join(shop.name, &shop.domain);
        let bridge = Bridge::start(&shop.domain, shop.name, CHAIN);
        operator.waits("a closed chain", |status| {
            status.switches & switches::CHAIN_OPEN == 0
        });
        operator.brings_up();
        // Twice: the numbers of blocks and actions continue from job to job.
        for round in 0..2 {
            bridge.reads(CHAIN);
            let from = bridge.received().len();
            shop.loads(
                &mut operator,
                "G21 G90 F3000\nG1 X0\nM3 S1200\nM63 P0\nM67 E3 Q2.5\nG1 X5\nM5\nM66 P2 L3 Q60\nM64 P1\n\
                 G1 X[10 + #5399]\nM66 P2 L4 Q0.2\nG1 Y[7 + #5399]\nM65 P1\nM2\n",
            );
            let job = operator.says("START").job;
            let waiting = operator.waits("the wait", |status| status.switches & switches::INPUT_WAIT != 0);
            assert_eq!(waiting.position_machine[0], 5.0);
            // Only the input continues from here.
            assert_eq!(operator.request(&command("RESUME")).alarm, 920);
            assert_eq!(
                operator.request(&set("lamp", 1.0)).alarm,
                914,
                "the program's own"
            );
            bridge.reads(CHAIN | READY);
            let ended = operator.sees_end(job);
            assert_eq!(ended.job_result, DONE, "{}", ended.alarm_sentence());
            assert_eq!(ended.position_machine[0], 11.0, "round {round}: the input was on");
            assert_eq!(
                ended.position_machine[1], 6.0,
                "round {round}: its fall did not come"
            );
            bridge.waits("the end", from, |message| {
                message.digital & 3 == 1 && message.cycle > 0 && message.analog[3] == 2.5
            });
            // The setpoint from which each output takes effect, according to the setpoints themselves.
            let mut begins = None;
            let mut before: Option<evolvent_bus::Setpoint> = None;
            while let Ok(Some(setpoint)) = operator.setpoints.receive() {
                if let Some(before) = before
                    && before.position[0] == 0.0
                    && setpoint.position[0] > 0.0
                {
                    begins = Some(setpoint.sequence);
                }
                before = Some(setpoint);
            }
            let received = bridge.received();
            let opened = received[from..].iter().find(|message| message.digital & 1 == 0);
            let opened = opened.expect("the clamp was opened");
            assert_eq!(
                (Some(opened.cycle), opened.analog[3]),
                (begins, 2.5),
                "round {round}"
            );
            let on = received[from..]
                .iter()
                .find(|message| message.spindle_rpm[0] == 1200.0 && message.spindle_direction[0] == 1);
            let off = received[from..]
                .iter()
                .rfind(|message| message.spindle_direction[0] == 0)
                .expect("off");
            assert!(on.expect("the spindle").cycle <= opened.cycle && off.cycle > opened.cycle);
            let lamp = received[from..]
                .iter()
                .find(|message| message.digital & 2 != 0)
                .expect("the lamp");
            assert!(lamp.cycle > off.cycle.min(lamp.cycle - 1), "after the wait");
            operator.says_number("MODE", 2);
            let job = operator.says_text("MDI", "G0 X0 Y0").job;
            assert_eq!(operator.sees_end(job).job_result, DONE);
        }
        drop(operator);
        served.end().expect_code(&[0, 3]);
        let mut file = TraceFile::open(&trace).expect("a complete trace");
        let texts: Vec<String> = (file.events())
            .map(|event| event.expect("a readable event"))
            .filter(|event| matches!(event.kind, EventKind::Input | EventKind::Output))
            .map(|event| event.text)
            .collect();
        for text in [
            "input ready on",
            "output clamp off",
            "output clamp on",
            "output lamp on",
        ] {
            assert!(
                texts.iter().filter(|found| *found == text).count() >= 2,
                "{text}: {texts:?}"
            );
        }
        let verified = verify(&trace).expect("a trace that can be verified");
        assert!(verified.holds() && !verified.lacks_data(), "{verified:?}");
        assert_eq!(verified.jobs, 4);
    });
}

#[test]
fn an_open_chain_stops_everything_until_a_reset() {
    unless_disturbed(|| {
        let shop = Shop::new("ss-chain");
        let served = shop.serves(&[]);
        let mut operator = Operator::join(shop.name, &shop.domain);
        let bridge = Bridge::start(&shop.domain, shop.name, 0);
        operator.waits("an open chain", |status| {
            status.switches & switches::CHAIN_OPEN != 0
        });
        assert_eq!(operator.request(&command("ESTOP_RESET")).alarm, 928);
        let status = shop.ctl(&["status"]).expect_code(&[0]);
        assert!(
            status.out.contains("emergency-stop chain is open"),
            "{}",
            status.out
        );
        for is_silent in [false, true] {
            bridge.reads(CHAIN);
            bridge.is_silent.store(false, Ordering::Release);
            operator.waits("a closed chain", |status| {
                status.switches & switches::CHAIN_OPEN == 0
            });
            operator.brings_up();
            shop.loads(
                &mut operator,
                "G21 G90 F3000\nG1 X0\nM3 S900\nM63 P0\nM67 E3 Q9\nG1 X300\nM2\n",
            );
            let from = bridge.received().len();
            let job = operator.says("START").job;
            operator.waits("the way", |status| status.position_machine[0] > 20.0);
            bridge.waits("the spindle", from, |message| {
                message.spindle_rpm[0] == 900.0 && message.digital & 1 == 0 && message.analog[3] == 9.0
            });
            let from = bridge.received().len();
            if is_silent {
                bridge.is_silent.store(true, Ordering::Release);
            } else {
                bridge.reads(0);
            }
            let ended = operator.sees_end(job);
            assert_eq!((ended.job_result, ended.machine_state), (FAULT, ESTOP));
            assert_eq!(ended.listed_alarms(), [430], "{}", ended.alarm_sentence());
            let safe = bridge.waits("safe outputs", from, |message| {
                message.digital & 1 == 1 && message.analog[3] == 0.0
            });
            bridge.waits("the spindle's end", from, |message| {
                message.spindle_direction[0] == 0
            });
            operator.follows(
                |_| {},
                |setpoint| {
                    setpoint.power_request == 0 && setpoint.sequence > safe.cycle && speed(setpoint) == 0.0
                },
            );
            let status = operator.now();
            assert!(
                status.position_machine[0] < 200.0,
                "{}",
                status.position_machine[0]
            );
            // Closing the chain alone continues nothing.
            bridge.is_silent.store(false, Ordering::Release);
            bridge.reads(CHAIN);
            operator.waits("a closed chain", |status| {
                status.switches & switches::CHAIN_OPEN == 0
            });
            assert_eq!(operator.request(&command("ON")).alarm, 910);
            operator.says("CLEAR_ALARMS");
            operator.brings_up();
            operator.says_number("MODE", 2);
            let job = operator.says_text("MDI", "G0 X0").job;
            assert_eq!(operator.sees_end(job).job_result, DONE);
            operator.says("OFF");
            operator.says("ESTOP");
        }
        drop(operator);
        served.end().expect_code(&[0, 3]);
    });
}

#[test]
fn outputs_are_set_by_hand_where_permitted() {
    unless_disturbed(|| {
        let shop = Shop::new("ss-hand");
        let served = shop.serves(&[]);
        let mut operator = Operator::join(shop.name, &shop.domain);
        let bridge = Bridge::start(&shop.domain, shop.name, CHAIN);
        operator.waits("a closed chain", |status| {
            status.switches & switches::CHAIN_OPEN == 0
        });
        assert_eq!(
            operator.request(&set("lamp", 1.0)).alarm,
            910,
            "in emergency stop"
        );
        operator.brings_up();
        for (name, value, alarm, expected) in [
            ("door", 1.0, 929, "it has clamp, lamp, laser"),
            ("lamp", 0.5, 902, "0 (off) or 1 (on), not 0.5"),
            ("laser", 10.5, 902, "takes 0 to 10, not 10.5"),
            ("laser", f64::NAN, 902, "not finite"),
        ] {
            let answer = operator.request(&set(name, value));
            assert_eq!(answer.alarm, alarm, "{}", answer.text());
            assert!(answer.text().contains(expected), "{}", answer.text());
        }
        shop.ctl(&["set", "lamp", "on"]).expect_code(&[0]);
        shop.ctl(&["set", "laser", "4.5"]).expect_code(&[0]);
        bridge.waits("both", 0, |message| {
            message.digital & 2 != 0 && message.analog[3] == 4.5
        });
        // A jog and its end do not change outputs or the spindle; nor does a program that keeps them.
        operator.says_number("MODE", 2);
        let job = operator.says_text("MDI", "M3 S700").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        let is_turning =
            |message: &MachineOutputs| message.spindle_rpm[0] == 700.0 && message.spindle_direction[0] == 1;
        bridge.waits("the spindle", 0, is_turning);
        operator.says_number("MODE", 1);
        let mut long = ControlRequest {
            axes_mask: 1,
            index: 1,
            amount: 20.0,
            ..command("JOG")
        };
        long.values[0] = -100.0;
        let job = operator.does(&long).job;
        operator.waits("a jog", |status| {
            status.feed_mm_s > 1.0 || status.velocity[0] < -1.0
        });
        operator.says("JOG_STOP");
        operator.sees_end(job);
        let from = bridge.received().len();
        assert!(is_turning(&bridge.waits("outputs behind it", from + 1, |_| true)));
        let mut jog = ControlRequest {
            axes_mask: 1,
            index: 1,
            amount: 50.0,
            ..command("JOG")
        };
        jog.values[0] = 3.0;
        let job = operator.does(&jog).job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        shop.loads(&mut operator, "G21 F3000\nG1 X5\nM2\n");
        let job = operator.says("START").job;
        assert_eq!(operator.sees_end(job).job_result, DONE);
        let last = bridge.received().pop().expect("outputs");
        assert_eq!((last.digital & 2, last.analog[3]), (2, 4.5));
        // An emergency stop makes all of them safe, and they stay safe.
        let from = bridge.received().len();
        operator.says("ESTOP");
        bridge.waits("safe outputs", from, |message| {
            message.digital & 3 == 1 && message.analog[3] == 0.0
        });
        operator.brings_up();
        let from = bridge.received().len();
        let after = bridge.waits("outputs after it", from, |_| true);
        assert_eq!((after.digital & 3, after.analog[3]), (1, 0.0));
        let refused = shop.ctl(&["set", "lamp", "perhaps"]).expect_code(&[2]);
        assert!(refused.err.contains("on, off or a number"), "{}", refused.err);
        drop(operator);
        served.end().expect_code(&[0, 3]);
    });
}

/// The shipped example, with a wire from the lamp to the input `ready`.
#[test]
fn a_python_bridge_sets_outputs_and_sends_inputs() {
    unless_disturbed(|| {
        let Some(mut bridge) = python("../../tools/python/examples/signals.py") else {
            return;
        };
        let shop = Shop::new("ss-python");
        let served = shop.serves(&[]);
        let mut operator = Operator::join(shop.name, &shop.domain);
        let mut bridge = bridge
            .args([shop.name, &shop.domain.prefix, "--wire", "1:2", "--closed", "5"])
            .spawn()
            .expect("Python to start");
        operator.waits("a closed chain", |status| {
            status.switches & switches::CHAIN_OPEN == 0
        });
        operator.brings_up();
        shop.loads(
            &mut operator,
            "G21 G90 F3000\nG1 X1\nM64 P1\nM66 P2 L3 Q60\nG1 X[10 + #5399]\nM65 P1\nM66 P2 L4 Q60\n\
             G1 X[20 + #5399]\nM2\n",
        );
        let job = operator.says("START").job;
        let ended = operator.sees_end(job);
        assert_eq!(ended.job_result, DONE, "{}", ended.alarm_sentence());
        assert_eq!(ended.position_machine[0], 20.0, "its fall came");
        // Once it is killed, the chain is unknown.
        bridge.kill().expect("killed");
        bridge.wait().expect("its end");
        let status = operator.waits("an emergency stop", |status| status.machine_state == ESTOP);
        assert_eq!(status.listed_alarms(), [430]);
        drop(operator);
        served.end().expect_code(&[0, 3]);
    });
}
