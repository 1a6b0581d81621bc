//! A served machine and its clients, killed at random moments; and users who may not command.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::process::{Command, Stdio};
use std::time::Duration;

use evolvent_bus::ControlRequest;
use evolvent_tests::{Domain, Operator, Random, Served, Workshop, command, evolvent};

fn cases(usual: usize) -> usize {
    std::env::var("EVOLVENT_CASES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(usual)
}

/// The core in one case, a client in the next, is killed while it starts, moves or ends; whoever is left, or comes
/// next, goes on. At the end nothing is left in shared memory: the domain checks that.
#[test]
fn cores_and_clients_that_are_killed_at_any_moment_leave_nothing_behind() {
    let (workshop, domain, mut random) = (Workshop::new(), Domain::new(), Random::new());
    let name = "op-kill";
    let machine = workshop.mill(name, &[]);
    let state = workshop.path("state");
    let program = workshop.long_program(30);
    let mut served = Served::start(&machine, name, &domain, &state, &[]);
    let mut restarts = 0;
    for case in 0..cases(4) {
        // One that the core survives, or that survives the core, or both are killed.
        let mut client = evolvent()
            .args([
                "ctl",
                "--bus-prefix",
                &domain.prefix,
                "--machine-name",
                name,
                "--patience",
                "20",
            ])
            .args(["jog", "X+", "--speed", "600"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the binary to start");
        let moment = Duration::from_micros(random.below(400_000) as u64);
        if case % 2 == 0 {
            // Sometimes before it is up, sometimes in motion.
            if random.below(2) == 0 {
                let mut operator = Operator::join(name, &domain);
                if operator.now().machine_state == 0 {
                    operator.brings_up();
                }
                operator.says("STOP");
                operator.waits("rest", |status| status.activity == 0);
                operator.says_number("MODE", 0);
                operator.says_text("LOAD", program.to_str().expect("UTF-8"));
                operator.says("START");
            }
            std::thread::sleep(moment);
            served.kill();
            restarts += 1;
            served = Served::start(&machine, name, &domain, &state, &[]);
        } else {
            std::thread::sleep(moment);
        }
        client.kill().expect("killed");
        client.wait().expect("a process that ends");
        // It answers, and can be operated.
        let mut operator = Operator::join(name, &domain);
        let status = operator.now();
        if status.machine_state == 0 {
            operator.brings_up();
        }
        operator.says("STOP");
        let status = operator.waits("rest", |status| status.activity == 0);
        assert_eq!(status.velocity, [0.0; 9]);
        assert_eq!(status.alarm_count, 0, "{}", status.alarm_sentence());
        operator.says_number("MODE", 1);
    }
    println!("{restarts} restarts of the core");
    served.end().expect_code(&[0, 3]);
}

#[test]
fn nobody_but_the_owner_can_open_the_channels() {
    let (workshop, domain) = (Workshop::new(), Domain::new());
    let name = "op-owner";
    let machine = workshop.mill(name, &[]);
    let served = Served::start(&machine, name, &domain, &workshop.path("state"), &[]);
    let mut operator = Operator::join(name, &domain);
    operator.brings_up();
    let own = rustix::process::getuid().as_raw();
    let mut seen = 0;
    for file in domain.files() {
        let Ok(facts) = file.metadata() else { continue };
        assert_eq!(facts.uid(), own, "{}", file.display());
        // iceoryx2's counter of nodes, 16 bytes that everybody shares; nothing of the machine goes through it.
        let is_counter = file.to_string_lossy().ends_with(".global_mgmt");
        if facts.is_file() && !is_counter {
            seen += 1;
            let mode = facts.permissions().mode() & 0o077;
            assert_eq!(mode, 0, "{} may be used by others: {mode:o}", file.display());
        }
    }
    assert!(seen >= 10, "{seen} files prove nothing");

    let before = operator.now();
    // Only root may become somebody else.
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
            let told = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(1), "{told}");
            println!("a stranger is told: {told}");
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
}
