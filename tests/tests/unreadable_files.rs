//! Files that never end or never open: pipes, and files that another program holds, like a hanging network
//! drive.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use evolvent_bus::ControlRequest;
use evolvent_tests::{Operator, Scene, Workshop, command, repository, unless_disturbed};

const FILE: u32 = 922;
const BAD_PROGRAM: u32 = 923;
/// Maximum time of a command that reads no file, on a host that lets the core run.
const AT_ONCE: Duration = Duration::from_secs(2);
/// Maximum time of any command: the core's own limit is 8 s.
const IN_TIME: Duration = Duration::from_secs(20);

/// Takes a lease on a file: whoever opens it waits until the lease is released, or for 45 s.
const HOLDER: &str = "
import fcntl, os, signal, sys, time
signal.signal(signal.SIGIO, signal.SIG_IGN)
file = os.open(sys.argv[1], os.O_RDWR)
fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_WRLCK)
print('held', flush=True)
time.sleep(600)
";

/// A file that cannot be opened during the life of this value.
struct Held(Child);

impl Held {
    fn new(file: &Path) -> Self {
        let mut child = Command::new("python3")
            .args(["-c", HOLDER])
            .arg(file)
            .stdout(Stdio::piped())
            .spawn()
            .expect("Python 3");
        let mut line = String::new();
        let output = child.stdout.take().expect("its output");
        BufReader::new(output).read_line(&mut line).expect("a line");
        assert_eq!(line, "held\n", "no lease on {}", file.display());
        Self(child)
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        let _gone = self.0.kill();
        let _gone = self.0.wait();
    }
}

fn pipe(path: &Path) {
    let made = Command::new("mkfifo").arg(path).status().expect("mkfifo");
    assert!(made.success());
}

fn with_text(name: &str, text: &str) -> ControlRequest {
    let mut request = command(name);
    assert!(request.set_text(text));
    request
}

/// Seconds until the reply to a command; fails if there is no reply.
fn seconds(operator: &mut Operator, request: &ControlRequest) -> (u32, f64, String) {
    let begin = Instant::now();
    let answer = operator.control.command(request, IN_TIME).expect("an answer");
    (
        answer.alarm,
        begin.elapsed().as_secs_f64(),
        answer.text().to_owned(),
    )
}

#[test]
fn a_pipe_as_program_or_subroutine_is_refused_at_once() {
    unless_disturbed(|| {
        let scene = Scene::new("pipes");
        let mut operator = scene.operator();
        operator.brings_up();
        let program = scene.workshop.path("pipe.ngc");
        pipe(&program);
        let text = program.to_str().expect("UTF-8");
        let (alarm, took, reply) = seconds(&mut operator, &with_text("LOAD", text));
        assert_eq!(alarm, FILE, "{reply}");
        assert!(reply.contains("pipe"), "{reply}");
        assert!(took < AT_ONCE.as_secs_f64(), "{took} s");
        // A program that becomes a pipe once it is loaded.
        let text = scene.workshop.write("part.ngc", "G0 X1\nM2\n");
        operator.says_text("LOAD", text.to_str().expect("UTF-8"));
        operator.says_number("MODE", 0);
        std::fs::remove_file(&text).expect("removed");
        pipe(&text);
        let (alarm, took, reply) = seconds(&mut operator, &command("START"));
        assert_eq!(alarm, FILE, "{reply}");
        assert!(took < AT_ONCE.as_secs_f64(), "{took} s");
        // A subroutine in the program's own folder.
        pipe(&scene.workshop.path("hangs.ngc"));
        let calls = scene.workshop.write("calls.ngc", "o<hangs> call\nM2\n");
        let text = calls.to_str().expect("UTF-8");
        let (alarm, took, reply) = seconds(&mut operator, &with_text("LOAD", text));
        assert_eq!(alarm, BAD_PROGRAM, "{reply}");
        assert!(reply.contains("hangs.ngc") && reply.contains("pipe"), "{reply}");
        assert!(took < AT_ONCE.as_secs_f64(), "{took} s");
        // And the tool table.
        std::fs::create_dir_all(scene.workshop.path("state")).expect("a folder");
        let table = scene.workshop.path("state/tools.tbl");
        let _none = std::fs::remove_file(&table);
        pipe(&table);
        let (alarm, _, reply) = seconds(&mut operator, &command("TOOL"));
        assert_eq!(alarm, FILE, "{reply}");
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_stop_is_answered_while_a_program_file_hangs() {
    unless_disturbed(|| {
        let scene = Scene::new("hung-file");
        let program = scene.workshop.write("part.ngc", "G0 X1\nM2\n");
        let mut operator = scene.operator();
        operator.brings_up();
        let held = Held::new(&program);
        let text = program.to_str().expect("UTF-8").to_owned();
        let (name, domain) = (scene.name().to_owned(), &scene.domain);
        std::thread::scope(|scope| {
            let loads = scope.spawn(|| {
                let mut other = Operator::join(&name, domain);
                seconds(&mut other, &with_text("LOAD", &text))
            });
            let waits = scope.spawn(|| {
                let mut other = Operator::join(&name, domain);
                // After the LOAD.
                std::thread::sleep(Duration::from_secs(1));
                seconds(
                    &mut other,
                    &ControlRequest {
                        index: 0,
                        ..command("MODE")
                    },
                )
            });
            std::thread::sleep(Duration::from_secs(2));
            assert!(!loads.is_finished() && !waits.is_finished(), "nothing hangs");
            for name in ["FEED_OVERRIDE", "STOP", "JOG_STOP", "ESTOP"] {
                let (alarm, took, reply) = seconds(&mut operator, &command(name));
                assert_eq!(alarm, 0, "{name}: {reply}");
                assert!(took < 1.0, "{name}: {took} s");
            }
            operator.waits("emergency stop", |status| status.machine_state == 0);
            assert!(!loads.is_finished(), "the file did not hang so long");
            let (alarm, took, reply) = loads.join().expect("a client");
            assert_eq!(alarm, FILE, "{reply}");
            assert!(reply.contains("no reply"), "{reply}");
            assert!((4.0..15.0).contains(&took), "{took} s");
            // The command that had to wait is executed then.
            assert_eq!(waits.join().expect("a client").0, 0);
        });
        assert_eq!(operator.now().mode, 0);
        drop(held);
        let (alarm, took, reply) = seconds(&mut operator, &with_text("LOAD", &text));
        assert_eq!(alarm, 0, "{reply}");
        assert!(took < AT_ONCE.as_secs_f64(), "{took} s");
        drop(operator);
        scene.end();
    });
}

#[test]
fn a_stop_cancels_the_start_of_a_program_that_hangs() {
    unless_disturbed(|| {
        let scene = Scene::new("hung-start");
        let program = scene.workshop.write("part.ngc", "G0 X1\nM2\n");
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_text("LOAD", program.to_str().expect("UTF-8"));
        operator.says_number("MODE", 0);
        let held = Held::new(&program);
        let (name, domain) = (scene.name().to_owned(), &scene.domain);
        std::thread::scope(|scope| {
            let starts = scope.spawn(|| {
                let mut other = Operator::join(&name, domain);
                seconds(&mut other, &command("START"))
            });
            std::thread::sleep(Duration::from_secs(2));
            assert!(!starts.is_finished(), "nothing hangs");
            operator.says("STOP");
            // It does not begin any more, although its file can be read again.
            drop(held);
            let (alarm, took, reply) = starts.join().expect("a client");
            assert_eq!(alarm, FILE, "{reply}");
            assert!(reply.contains("a stop came"), "{reply}");
            assert!(took < 4.5, "{took} s");
        });
        assert_eq!(operator.now().position_machine[0], 0.0);
        drop(operator);
        scene.end();
    });
}

#[test]
fn settings_that_are_pipes_or_hang_are_wrong_usage() {
    let workshop = Workshop::new();
    let program = workshop.write("part.ngc", "G0 X1\nM2\n");
    let machine = workshop.mill("plain", &[]);
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let (program, machine) = (text(&program), text(&machine));
    let wrong = workshop.path("pipe.toml");
    pipe(&wrong);
    let slow = workshop.write("slow.toml", "name = \"slow\"\n");
    // A case whose force law is a pipe.
    let case = repository().join("config/processes/chatter-40x.toml");
    let case = std::fs::read_to_string(case).expect("a case");
    let case = workshop.write("case.toml", case.replace("\"40X-R1\"", "\"pipe.toml\""));
    let commands = |file: &str| {
        [
            &[
                "run",
                &program,
                "--machine",
                &machine,
                "--no-bus",
                "--process",
                file,
            ][..],
            &[
                "run",
                &program,
                "--machine",
                &machine,
                "--bus-prefix",
                "unread_",
                "--adaptive",
                file,
            ],
            &["run", file, "--machine", &machine, "--no-bus"],
            &["serve", "--machine", &machine, "--process", file],
            &["serve", "--machine", file],
            &["plan", &program, "--machine", &machine, "--process", file],
            &["plan", &program, "--machine", file],
            &["check", &program, "--machine", &machine, "--process", file],
            &["turn", file, "--machine", &machine],
            &["bridge", "sim", "--machine", &machine, "--process", file],
            &["chatter", file],
        ]
        .map(|words| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>())
    };
    let fails = |words: &[String], reason: &str, at_most: Duration| {
        let binary = evolvent_tests::evolvent();
        unless_disturbed(|| {
            let begin = Instant::now();
            let output = Command::new("timeout")
                .arg("30")
                .arg(binary.get_program())
                .args(words)
                .output()
                .expect("timeout");
            let took = begin.elapsed();
            let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{words:?}: {stderr}");
            assert!(stderr.contains(reason), "{words:?}: {stderr}");
            assert!(took < at_most, "{words:?}: {took:?}");
        });
    };
    for words in commands(&text(&wrong)) {
        fails(&words, "pipe", AT_ONCE);
    }
    fails(&["chatter".to_owned(), text(&case)], "pipe", AT_ONCE);
    let held = Held::new(&slow);
    std::thread::scope(|scope| {
        for words in commands(&text(&slow)) {
            scope.spawn(move || fails(&words, "no reply within 5 s", Duration::from_secs(12)));
        }
    });
    drop(held);
}

#[test]
fn pipes_as_machine_file_or_tool_table_are_rejected() {
    let workshop = Workshop::new();
    let program = workshop.write("part.ngc", "G0 X1\nM2\n");
    let machine = workshop.mill("plain", &[]);
    let hangs = workshop.path("pipe");
    pipe(&hangs);
    for (options, machine) in [
        (&["--tools"][..], &machine),
        (&["--parameters"], &machine),
        (&[], &hangs),
    ] {
        // Killed by `timeout` if it waits for a writer.
        let binary = evolvent_tests::evolvent();
        let mut command = Command::new("timeout");
        command
            .arg("20")
            .arg(binary.get_program())
            .arg("check")
            .arg(&program);
        command.arg("--machine").arg(machine).args(options);
        if !options.is_empty() {
            command.arg(&hangs);
        }
        let output = command.output().expect("timeout");
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{options:?}: {stderr}");
        assert!(stderr.contains("pipe"), "{options:?}: {stderr}");
    }
}
