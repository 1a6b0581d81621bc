//! The exit codes of the hardware bridges: 1 means that another attempt may succeed, 2 that it cannot. The
//! systemd units use them.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use evolvent_bus::{BusConfig, CoreBus};
use evolvent_ethercat_ring::{MAIN_INTERFACE, on_bench};
use evolvent_tests::{Domain, Workshop, evolvent, repository};

/// Exit code and messages of a bridge that ends on its own with these options.
fn ended(bridge: &str, options: &[&str]) -> (Option<i32>, String) {
    let output = evolvent()
        .args(["bridge", bridge, "--seconds", "5"])
        .args(options)
        .output()
        .expect("the binary to start");
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
    )
}

fn expect(found: &(Option<i32>, String), code: i32, texts: &[&str]) {
    let (exit, printed) = found;
    assert_eq!(*exit, Some(code), "{printed}");
    for text in texts {
        assert!(printed.contains(text), "no {text:?} in: {printed}");
    }
}

fn config(file: &str) -> String {
    repository().join("config").join(file).display().to_string()
}

/// A core of the machine with different axes.
fn lathe_core(name: &str, domain: &Domain) -> CoreBus {
    let mut config = BusConfig::new(name, "XZ", 2_000_000);
    config.prefix = Some(domain.prefix.clone());
    CoreBus::open(&config).expect("a bus")
}

/// Needs the right to create a network namespace.
#[test]
fn the_ethercat_bridge_exit_code_says_when_to_retry() {
    let workshop = Workshop::new();
    let (machine, network) = (
        config("machines/mill-ethercat.toml"),
        config("networks/sim-mill.toml"),
    );
    let text = std::fs::read_to_string(&network).expect("a network");
    let misspelt = workshop.write(
        "misspelt.toml",
        text.replacen("max_lost_cycles", "max_lost_cycle", 1),
    );
    let without_z = workshop.write(
        "without-z.toml",
        text.rsplit_once("\n[device.axis]")
            .map_or_else(String::new, |(before, _)| before.to_owned()),
    );
    let unwritable = workshop
        .folder()
        .join("nowhere/wire.pcapng")
        .display()
        .to_string();
    let folder = workshop.folder().display().to_string();
    let written = workshop.folder().join("wire.pcapng");
    on_bench(Vec::new(), move |_ring| {
        let domain = Domain::new();
        let with = |network: &str, interface: &str, more: &[&str]| {
            let mut options = vec![
                "--machine",
                &machine,
                "--network",
                network,
                "--interface",
                interface,
            ];
            options.extend(["--machine-name", "mill-3axis", "--bus-prefix", &domain.prefix]);
            options.extend(more);
            ended("ethercat", &options)
        };
        // The ring may come up later, as may the core with the right axes. The recording that shows the cause
        // is kept until then.
        let recorded = workshop.write("recorded.pcapng", "of the last run");
        let found = with(&network, "absent0", &["--dump", &recorded.display().to_string()]);
        expect(&found, 1, &["the network interface absent0 cannot be opened"]);
        // It waits for nothing.
        assert!(!found.1.contains("waiting for its core"), "{}", found.1);
        let kept = std::fs::read_to_string(&recorded).expect("the recording");
        assert_eq!(kept, "of the last run");
        {
            let _core = lathe_core("mill-3axis", &domain);
            let found = with(&network, MAIN_INTERFACE, &[]);
            expect(
                &found,
                1,
                &["the core drives the axes XZ, the network file has XYZ"],
            );
        }
        // Files do not change.
        let found = with(&misspelt.display().to_string(), MAIN_INTERFACE, &[]);
        expect(
            &found,
            2,
            &["misspelt.toml:", "max_lost_cycle", "max_lost_cycles"],
        );
        let found = with(&without_z.display().to_string(), MAIN_INTERFACE, &[]);
        expect(&found, 2, &["without-z.toml", "Z"]);
        // Whatever else is wrong.
        for interface in [MAIN_INTERFACE, "absent0"] {
            for (path, why) in [
                (&unwritable, "the wire cannot be recorded"),
                (&folder, "is a folder"),
            ] {
                let found = with(&network, interface, &["--dump", path]);
                expect(&found, 2, &[path, why]);
            }
        }
        let found = with(&network, "absent0", &["--dump", &network]);
        expect(&found, 2, &["sim-mill.toml"]);
        assert_eq!(std::fs::read_to_string(&network).expect("the network"), text);
        let found = with(
            &network,
            MAIN_INTERFACE,
            &["--dump", &written.display().to_string()],
        );
        expect(&found, 1, &["no core was running"]);
        assert!(written.exists());
    });
}

#[test]
fn the_bridge_to_mesa_boards_does_so_too() {
    let workshop = Workshop::new();
    let domain = Domain::new();
    let (machine, board) = (
        config("machines/router-3axis.toml"),
        config("boards/7i96s-router.toml"),
    );
    let text = std::fs::read_to_string(&board).expect("a board");
    // No board is there.
    let with = |board: &str, more: &[&str]| {
        let mut options = vec![
            "--machine",
            &machine,
            "--board",
            board,
            "--address",
            "127.27.99.1",
        ];
        options.extend(["--machine-name", "router-3axis", "--bus-prefix", &domain.prefix]);
        options.extend(more);
        ended("mesa", &options)
    };
    let found = with(&board, &[]);
    expect(
        &found,
        1,
        &["the board did not come up within 5 s: no core was running"],
    );
    {
        let _core = lathe_core("router-3axis", &domain);
        let found = with(&board, &[]);
        expect(
            &found,
            1,
            &["the core drives the axes XZ, the board file has XYZ"],
        );
    }
    let misspelt = workshop.write("misspelt.toml", text.replacen("pwm_hz", "pwm_hertz", 1));
    let found = with(&misspelt.display().to_string(), &[]);
    expect(&found, 2, &["misspelt.toml:", "pwm_hertz"]);
    let absent = workshop.folder().join("absent.toml").display().to_string();
    expect(&with(&absent, &[]), 2, &["absent.toml"]);
    let found = ended(
        "mesa",
        &["--machine", &machine, "--board", &board, "--bus-prefix", "a/b"],
    );
    expect(&found, 2, &["a/b"]);
}
