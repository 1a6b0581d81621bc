//! The suite for all bridges, on the simulated board over real sockets.

use core::ops::Range;
use std::time::{Duration, Instant};

use evolvent_bridge_test::{BridgeUnderTest, CASES};
use evolvent_bridge_trial::{failed_cases, failed_spindle_cases};
use evolvent_bus::{BusConfig, CoreBus, remove_private_domain};
use evolvent_disturbance::unless_disturbed;
use evolvent_machine::Machine;
use evolvent_mesa::{BoardSettings, InputPin, InputSource, OutputTarget};
use evolvent_mesa_board::{BoardModel, Spindle, SpindleCommand};

use crate::common::{field_router, machine, mesa_bridge, router, serve};

/// Cases of the suite of all bridges, on a board with the axes X, Y and Z.
fn suite(cases: Range<usize>, board: impl Fn(std::net::IpAddr) -> BoardSettings, model: BoardModel) {
    unless_disturbed(|| {
        let (server, address) = serve(model);
        let mut settings = board(address);
        // The suite's period is 2 ms; a busy host may be late for that long.
        (settings.max_lost_packets, settings.watchdog_s) = (40, 0.5);
        for axis in &settings.axes {
            if let Some(pin) = axis.switches[0] {
                server.lock().set_level(pin.pin, true);
                server.lock().set_field_input(pin.pin as u32, true);
            }
        }
        server.lock().wire(14, 3);
        server.lock().wire_field(3, 3);
        let mut bridge = mesa_bridge(machine("router-3axis"), settings);
        // Suites run at the same time.
        let prefix = format!("mesabt{}_{}{}", std::process::id(), model as u8, cases.start);
        // A board has no drives that come into fault.
        let failures = failed_cases(&mut bridge, &prefix, &CASES[cases.clone()], &["new_core_reset"]);
        let board = server.lock();
        println!("{:?}", board.traffic());
        assert_eq!(board.traffic().refused, 0, "every command makes sense");
        assert!(
            (0..3).all(|unit| board.motor_stalls(unit) == 0),
            "no motor fell out of step"
        );
        drop(board);
        assert!(failures.is_empty(), "{failures:#?}");
    });
}

/// Two halves run at the same time, because each waits most of the time.
const HALF: usize = CASES.len() / 2;

#[test]
fn it_does_what_every_bridge_must() {
    suite(0..HALF, router, BoardModel::B7i96s);
}

#[test]
fn it_does_the_rest_of_what_every_bridge_must() {
    suite(HALF..CASES.len(), router, BoardModel::B7i96s);
}

// The suite with enables, switches, input and output on the field I/O of a 7I76E.
#[test]
fn it_does_so_by_smart_serial() {
    suite(0..HALF, field_router, BoardModel::B7i76e);
}

#[test]
fn it_does_the_rest_by_smart_serial() {
    suite(HALF..CASES.len(), field_router, BoardModel::B7i76e);
}

#[test]
fn its_spindle_does_what_every_spindle_must() {
    unless_disturbed(|| {
        let (server, address) = serve(BoardModel::B7i96s);
        let contacts = SpindleCommand::Contacts {
            unit: 0,
            forward: 15,
            reverse: 16,
        };
        server.lock().set_spindle(Spindle::usual(0, contacts));
        let text = evolvent_file_tests::shipped("machines/router-3axis.toml");
        let text = text.replacen("[[spindle]]\n", "[[spindle]]\nfeedback = true\n", 1);
        let machine = Machine::parse(&text, "router-3axis.toml").expect("a machine");
        let text = evolvent_file_tests::shipped("boards/7i96s-router.toml");
        let begin = text.find("[spindle]").expect("a spindle");
        let spindle = "[[spindle]]\npwm = 0\nfull_rpm = 3000\nforward = { pin = 15 }\n\
                       reverse = { pin = 16 }\nencoder = 0\ncounts_per_rev = 4096\n";
        let mut board =
            BoardSettings::parse(&format!("{}{spindle}", &text[..begin]), "b.toml").expect("a board");
        // The suite's period is 2 ms; a busy host may be late for that long.
        (board.address, board.max_lost_packets, board.watchdog_s) = (address, 40, 0.5);
        let mut bridge = mesa_bridge(machine, board);
        let failures = failed_spindle_cases(&mut bridge, &format!("mesabs{}_", std::process::id()));
        assert!(failures.is_empty(), "{failures:#?}");
    });
}

#[test]
fn outputs_go_to_pins() {
    let board = router(std::net::IpAddr::from([127, 0, 0, 1]));
    assert!(matches!(board.outputs[0].target, OutputTarget::Pin(pin) if pin.pin == 14));
    assert!(matches!(board.inputs[0].source, InputSource::Pin(pin) if pin.pin == 3));
}

/// The register has only 16 bits, but a wheel may be turned for years.
#[test]
fn analog_input_counts_handwheel_encoder() {
    unless_disturbed(|| {
        let (server, address) = serve(BoardModel::B7i96s);
        let text = evolvent_file_tests::shipped("machines/router-3axis.toml")
            + "\n[[input]]\nname = \"wheel\"\nkind = \"analog\"\nnumber = 4\n";
        let machine = Machine::parse(&text, "router").expect("a machine");
        let prefix = format!("mesawh{}_", std::process::id());
        for (inverted, sign) in [(false, 1.0), (true, -1.0)] {
            let unit = 0;
            let mut board = router(address);
            board.max_lost_packets = 40;
            board.watchdog_s = 0.5;
            board.inputs.push(InputPin {
                name: "wheel".to_owned(),
                source: InputSource::Encoder { unit, inverted },
            });
            let mut config = BusConfig::new("mesa-wheel", "XYZ", 1_000_000);
            config.prefix = Some(prefix.clone());
            let mut core = CoreBus::open(&config).expect("a bus");
            let mut bridge = mesa_bridge(machine.clone(), board);
            bridge.start("mesa-wheel", &prefix).expect("a bridge");
            let mut counts = |expected: f64| {
                let begin = Instant::now();
                loop {
                    if let Ok(Some(message)) = core.unchecked_inputs()
                        && message.analog_mask == 1 << 4
                        && message.analog[4] == expected
                    {
                        return;
                    }
                    assert!(
                        begin.elapsed() < Duration::from_secs(20),
                        "{expected} does not come"
                    );
                    std::thread::sleep(Duration::from_micros(500));
                }
            };
            counts(0.0);
            let mut total = 0.0;
            // Three times the range of the register, there and back.
            for turned in [
                7.0, -20.0, 30_000.0, 30_000.0, 30_000.0, 30_000.0, 30_000.0, 30_000.0, 30_000.0, -30_000.0,
            ] {
                server.lock().turn_shaft(unit, turned);
                total += turned;
                counts(sign * total);
            }
            bridge.end();
        }
        remove_private_domain(&prefix).expect("the domain to be swept");
    });
}
