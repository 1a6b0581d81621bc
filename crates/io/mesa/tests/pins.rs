//! Pins that the bridge drives and reads: it never drives an input, and no pin twice.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use evolvent_bus::{BusConfig, CoreBus, remove_private_domain};
use evolvent_file_tests::shipped;
use evolvent_mesa::{BoardSettings, RunSettings, run};
use evolvent_mesa_board::BoardModel;

use crate::common::{machine, serve};

/// The shipped router with one edit and additional text.
fn router_text(from: &str, to: &str, more: &str) -> String {
    let text = shipped("boards/7i96s-router.toml");
    assert!(text.contains(from), "{from}");
    text.replacen(from, to, 1) + more
}

/// Messages of the bridge about a board file until it rejects it or sets the board up, and the driven pins of
/// the board.
fn reported_and_driven(text: &str, name: &str) -> (String, Vec<usize>) {
    let (server, address) = serve(BoardModel::B7i96s);
    let mut board = BoardSettings::parse(text, "b.toml").expect("a board file");
    board.address = address;
    let prefix = format!("mesapin_{name}{}_", std::process::id());
    let mut config = BusConfig::new("mesa-pins", "XYZ", 2_000_000);
    config.prefix = Some(prefix.clone());
    let core = CoreBus::open(&config).expect("a bus");
    let settings = RunSettings {
        machine: machine("router-3axis"),
        machine_name: Some("mesa-pins".to_owned()),
        board,
        prefix: Some(prefix.clone()),
        duration: Some(Duration::from_secs(20)),
    };
    // The thread of a bridge gives up its rights to files, which the next text needs.
    let bridge = std::thread::spawn(move || {
        let (stop, mut reported, mut driven) = (AtomicBool::new(false), String::new(), Vec::new());
        run(&settings, &stop, |message| {
            if message.starts_with("board") {
                reported = message.to_owned();
                driven = (0..51).filter(|pin| server.lock().is_driven(*pin)).collect();
                stop.store(true, Ordering::Relaxed);
            }
        })
        .expect("a bridge that runs");
        (reported, driven)
    });
    let found = bridge.join().expect("no panic");
    drop(core);
    let _swept = remove_private_domain(&prefix);
    found
}

#[test]
fn a_pin_that_is_an_input_is_never_driven() {
    for (i, (from, to, wanted)) in [
        (
            "enable = { pin = 11 }",
            "enable = { pin = 27 }",
            "axis[0].enable: pin 27 is encoder 0 A: choose an output",
        ),
        (
            "enable = { pin = 12 }",
            "enable = { pin = 10 }",
            "axis[1].enable: pin 10 is input filter (InM) 0 bit 10: choose an output",
        ),
        (
            "pin = 14",
            "pin = 29",
            "output[0]: pin 29 is encoder 0 index: choose an output",
        ),
        (
            "forward = { pin = 15 }",
            "forward = { pin = 28 }",
            "spindle.forward: pin 28 is encoder 0 B: choose an output",
        ),
        (
            "forward = { pin = 15 }",
            "forward = { pin = 33 }",
            "spindle.forward: pin 33 is isolated output (SSR) 0 reference: choose an output",
        ),
        (
            "forward = { pin = 15 }",
            "forward = { pin = 17 }",
            "spindle.forward: pin 17 is driven by step generator 0",
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let (reported, driven) = reported_and_driven(&router_text(from, to, ""), &format!("out{i}_"));
        assert!(
            reported.starts_with("board: b.toml: ") && reported.contains(wanted),
            "{wanted}: {reported}"
        );
        assert!(driven.is_empty(), "{to}: nothing is driven before the file fits");
    }
}

#[test]
fn a_pin_that_something_drives_is_no_input() {
    for (i, (from, to, wanted)) in [
        // An output of the board that nothing uses, the step pin of X, and the reference of the outputs.
        (
            "pin = 3\n",
            "pin = 16\n",
            "input[0]: pin 16 is output (OutM) 0 bit 5: choose an input",
        ),
        (
            "home_switch = { pin = 0, inverted = true }",
            "home_switch = { pin = 18 }",
            "axis[0].home_switch: pin 18 is driven by step generator 0",
        ),
        (
            "pin = 3\n",
            "pin = 33\n",
            "input[0]: pin 33 is isolated output (SSR) 0 reference: choose an input",
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let (reported, driven) = reported_and_driven(&router_text(from, to, ""), &format!("in{i}_"));
        assert!(
            reported.starts_with("board: b.toml: ") && reported.contains(wanted),
            "{wanted}: {reported}"
        );
        assert!(driven.is_empty(), "{to}");
    }
}

#[test]
fn exactly_the_outputs_of_the_file_are_driven() {
    // Pins of the step generators of the axes and of the PWM generator, of outputs, and their reference. The
    // pins of generator 4 are free: one is an output, one an input.
    let more = "\n[flood]\npin = 25\n";
    let text = router_text("pin = 3\n", "pin = 26\n", more);
    let (reported, driven) = reported_and_driven(&text, "fit_");
    assert!(reported.contains("set up"), "{reported}");
    assert_eq!(
        driven,
        [11, 12, 13, 14, 15, 17, 18, 19, 20, 21, 22, 25, 30, 31, 32, 33]
    );
}

/// It would trip between two packets.
#[test]
fn a_watchdog_of_a_period_is_refused() {
    let (reported, driven) =
        reported_and_driven(&router_text("watchdog_ms = 50", "watchdog_ms = 2", ""), "wd_");
    assert!(
        reported.contains("watchdog_ms is 2, and packets come every 2.000 ms"),
        "{reported}"
    );
    assert!(driven.is_empty(), "{driven:?}");
}

/// Errors of the file alone: no board is needed.
#[test]
fn pin_or_unit_used_twice_is_reported_at_reading() {
    let servo = "\n[[axis]]\nletter = \"A\"\nencoder = 1\npwm = 0\ncounts_per_unit = 1000\n\
                 full_velocity = 200\np_gain = 60\n";
    let count = "\n[[input]]\nname = \"a\"\nencoder = 1\n[[input]]\nname = \"b\"\nencoder = 1\n";
    for (from, to, more, wanted) in [
        (
            "stepgen = 1",
            "stepgen = 0",
            "",
            "axis[1].stepgen: step generator 0 already belongs to axis[0].stepgen",
        ),
        (
            "pwm_hz",
            "pwm_hz",
            servo,
            "spindle.pwm: PWM generator 0 already belongs to axis[3].pwm",
        ),
        (
            "pwm_hz",
            "pwm_hz",
            count,
            "input[2].encoder: encoder 1 already belongs to input[1].encoder",
        ),
        (
            "enable = { pin = 12 }",
            "enable = { pin = 11 }",
            "",
            "axis[1].enable.pin: pin 11 already belongs to axis[0].enable",
        ),
        (
            "home_switch = { pin = 1,",
            "fault = { pin = 14 }\nhome_switch = { pin = 1,",
            "",
            "output[0].pin: pin 14 already belongs to axis[1].fault",
        ),
        (
            "forward = { pin = 15 }",
            "forward = { pin = 15 }\nreverse = { pin = 15 }",
            "",
            "spindle.reverse.pin: pin 15 already belongs to spindle.forward",
        ),
        (
            "pwm_hz",
            "pwm_hz",
            "\n[flood]\npin = 15\n",
            "flood.pin: pin 15 already belongs to spindle.forward",
        ),
        (
            "pin = 3\n",
            "pin = 2\nslow = true\n",
            "",
            "input[0].pin: pin 2 has another filter at axis[2].home_switch",
        ),
    ] {
        let error = BoardSettings::parse(&router_text(from, to, more), "b.toml")
            .expect_err(wanted)
            .to_string();
        assert!(
            error.starts_with("b.toml:") && error.contains(wanted),
            "{wanted}: {error}"
        );
    }
    let field = shipped("boards/7i76e-router.toml");
    let text = field.replacen(
        "enable = { remote = 0, pin = 1 }",
        "enable = { remote = 0, pin = 0 }",
        1,
    );
    let error = BoardSettings::parse(&text, "b.toml")
        .expect_err("one field output twice")
        .to_string();
    assert!(
        error.contains("axis[1].enable.pin: pin 0 already belongs to axis[0].enable"),
        "{error}"
    );
    // One switch may be home and limit, and one chain the fault of all drives.
    let shared = "negative_limit = { pin = 0, inverted = true }\nhome_switch = { pin = 0, inverted = true }";
    BoardSettings::parse(
        &router_text("home_switch = { pin = 0, inverted = true }", shared, ""),
        "b.toml",
    )
    .expect("a file");
}
