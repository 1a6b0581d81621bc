//! Filtered inputs, isolated outputs, and smart-serial devices.

use std::time::{Duration, Instant};

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bridge_trial::{Messages, with_bridge as with_bridge_and_core};
use evolvent_bus::{BusConfig, CoreBus, MachineInputs, MachineOutputs};
use evolvent_disturbance::unless_disturbed;
use evolvent_machine::Machine;
use evolvent_mesa::{BoardSettings, RunSettings, run};
use evolvent_mesa_board::{BoardModel, BoardServer, FaultKind};

use crate::common::{field_router, machine, router, serve};

/// A core that sends only outputs.
struct Core {
    bus: CoreBus,
    outputs: MachineOutputs,
    inputs: Option<MachineInputs>,
}

impl Core {
    fn send(&mut self, change: impl FnOnce(&mut MachineOutputs)) {
        change(&mut self.outputs);
        self.repeat();
    }

    fn repeat(&mut self) {
        self.outputs.sequence += 1;
        self.outputs.due_time_ns = monotonic_ns();
        let _reached = self.bus.publish_outputs(&self.outputs);
        self.bus.admit_readers();
        while let Ok(Some(message)) = self.bus.unchecked_inputs() {
            self.inputs = Some(message);
        }
    }

    /// Repeats the outputs until a condition is met.
    fn until(&mut self, what: &str, mut condition: impl FnMut(Option<&MachineInputs>) -> bool) {
        let begin = Instant::now();
        while !condition(self.inputs.as_ref()) {
            self.repeat();
            assert!(
                begin.elapsed() < Duration::from_secs(20),
                "{what}: not within 20 s; {:?}",
                self.inputs
            );
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// Runs a test with a board, its bridge, and a core.
fn with_bridge(
    name: &str,
    model: BoardModel,
    board: impl Fn(std::net::IpAddr) -> BoardSettings,
    machine: &Machine,
    test: impl Fn(&mut Core, &BoardServer, &Messages),
) {
    unless_disturbed(|| {
        let (server, address) = serve(model);
        let mut board = board(address);
        (board.max_lost_packets, board.watchdog_s) = (40, 0.5);
        let prefix = format!("mesafi_{name}{}_", std::process::id());
        let mut config = BusConfig::new("mesa-field", "XYZ", 1_000_000);
        config.prefix = Some(prefix.clone());
        let core = Core {
            bus: CoreBus::open(&config).expect("a bus"),
            outputs: MachineOutputs {
                digital_mask: 1,
                ..MachineOutputs::default()
            },
            inputs: None,
        };
        let settings = RunSettings {
            machine: machine.clone(),
            machine_name: Some("mesa-field".to_owned()),
            board,
            prefix: Some(prefix.clone()),
            duration: None,
        };
        with_bridge_and_core(
            &prefix,
            |stop, messages| run(&settings, stop, |text| messages.push(text)),
            core,
            |core, messages| test(core, &server, messages),
        );
        assert_eq!(server.lock().traffic().refused, 0, "every command makes sense");
    });
}

#[test]
fn isolated_outputs_close_filtered_inputs_are_read() {
    // Both kinds of outputs: SSR at pin 14, OutM at 15.
    with_bridge(
        "ssr",
        BoardModel::B7i96s,
        router,
        &machine("router-3axis"),
        |core, server, _| {
            core.until("inputs", |inputs| inputs.is_some());
            assert!(!server.lock().level(14) && !server.lock().level(15));
            core.send(|outputs| (outputs.digital, outputs.spindle_direction[0]) = (1, 1));
            core.until("both closed", |_| {
                server.lock().level(14) && server.lock().level(15)
            });
            // Low while current flows, so a broken wire reads as an open door.
            server.lock().set_level(3, true);
            core.until("an open door", |inputs| {
                inputs.is_some_and(|inputs| inputs.digital & 1 == 0)
            });
            server.lock().set_level(3, false);
            core.until("a closed door", |inputs| {
                inputs.is_some_and(|inputs| inputs.digital & 1 == 1)
            });
            core.send(|outputs| (outputs.digital, outputs.spindle_direction[0]) = (0, 0));
            core.until("both open", |_| {
                !server.lock().level(14) && !server.lock().level(15)
            });
        },
    );
}

/// Pin 14 with a machine file whose safe value is on, and with one whose safe value is off.
#[test]
fn outputs_are_safe_until_core_sets_them_per_session() {
    for is_safe_on in [true, false] {
        let text = evolvent_file_tests::shipped("machines/router-3axis.toml").replace(
            "name = \"dust-extraction\"\n",
            &format!("name = \"dust-extraction\"\nsafe_on = {is_safe_on}\n"),
        );
        let machine = Machine::parse(&text, "router-3axis.toml").expect("a machine");
        let name = if is_safe_on { "safeon" } else { "safeoff" };
        with_bridge(
            name,
            BoardModel::B7i96s,
            router,
            &machine,
            |core, server, messages| {
                let is_on = || server.lock().level(14);
                let sessions = |count: usize| {
                    let begin = Instant::now();
                    while messages.count(": set up") < count {
                        assert!(begin.elapsed() < Duration::from_secs(20), "no session {count}");
                        std::thread::sleep(Duration::from_millis(1));
                    }
                };
                let stays_safe = |what: &str| {
                    for _ in 0..100 {
                        std::thread::sleep(Duration::from_millis(3));
                        assert_eq!(is_on(), is_safe_on, "{what}");
                    }
                };
                sessions(1);
                std::thread::sleep(Duration::from_millis(20));
                stays_safe("before the first message");
                core.send(|outputs| {
                    (outputs.digital, outputs.safe_digital) = (u64::from(!is_safe_on), u64::from(is_safe_on));
                });
                core.until("what the core says", |_| is_on() != is_safe_on);
                // The board is lost while the core sends more than the queue holds, and then the core ends
                // too.
                server.lock().fault_now(FaultKind::LossIn, None);
                core.until("the end of the session", |_| {
                    messages.contain("did not return in time")
                });
                for _ in 0..2000 {
                    core.repeat();
                    core.repeat();
                    core.repeat();
                    std::thread::sleep(Duration::from_micros(200));
                }
                std::thread::sleep(Duration::from_millis(300));
                server.lock().clear_faults();
                sessions(2);
                std::thread::sleep(Duration::from_millis(20));
                stays_safe("in the next session, without a core");
            },
        );
    }
}

#[test]
fn a_slow_input_does_not_see_a_bounce() {
    let board = |address| {
        let text = evolvent_file_tests::shipped("boards/7i96s-router.toml");
        let text = text.replace("pin = 3\n", "pin = 3\nslow = true\n");
        let mut board = BoardSettings::parse(&text, "7i96s-router.toml").expect("a board file");
        board.address = address;
        board
    };
    with_bridge(
        "slow",
        BoardModel::B7i96s,
        board,
        &machine("router-3axis"),
        |core, server, _| {
            let level = |on: bool| {
                move |inputs: Option<&MachineInputs>| {
                    inputs.is_some_and(|inputs| (inputs.digital & 1 == 1) == on)
                }
            };
            server.lock().set_level(3, false);
            core.until("a closed door", level(true));
            // Six times 3 ms: 18 ms in total, shorter than the 25 ms of the filter. The board's clock
            // advances with its packets.
            for _ in 0..6 {
                for on in [false, true] {
                    server.lock().set_level(3, !on);
                    let until = Instant::now() + Duration::from_millis(3);
                    while Instant::now() < until {
                        core.repeat();
                        std::thread::sleep(Duration::from_micros(300));
                    }
                    assert!(level(true)(core.inputs.as_ref()), "a bounce was seen");
                }
            }
            // The filter counts up and down: it is full again, and then takes its full time.
            let until = Instant::now() + Duration::from_millis(100);
            while Instant::now() < until {
                core.repeat();
                std::thread::sleep(Duration::from_micros(300));
            }
            let begin = Instant::now();
            server.lock().set_level(3, true);
            core.until("an open door", level(false));
            assert!(
                begin.elapsed() >= Duration::from_millis(20),
                "{:?}",
                begin.elapsed()
            );
        },
    );
}

#[test]
fn field_inputs_outputs_and_the_spindle_of_a_7i76() {
    with_bridge(
        "field",
        BoardModel::B7i76e,
        field_router,
        &machine("router-3axis"),
        |core, server, messages| {
            core.until("inputs", |inputs| inputs.is_some());
            for on in [true, false, true] {
                server.lock().set_field_input(3, on);
                core.until("the door", |inputs| {
                    inputs.is_some_and(|inputs| (inputs.digital & 1 == 1) == on)
                });
                core.send(|outputs| outputs.digital = u64::from(on));
                core.until("the dust extraction", |_| {
                    server.lock().field_output_is_on(3) == on
                });
            }
            core.send(|outputs| (outputs.spindle_direction[0], outputs.spindle_rpm[0]) = (1, 6000.0));
            core.until("a quarter of the speed", |_| {
                let (duty, reverse, enabled) = server.lock().field_spindle();
                (duty - 0.25).abs() < 3e-4 && !reverse && enabled
            });
            // Without the core the bridge switches everything off; the device would do so too.
            core.send(|outputs| outputs.digital = 1);
            core.until("the dust extraction again", |_| {
                server.lock().field_output_is_on(3)
            });
            std::thread::sleep(Duration::from_millis(600));
            assert_eq!(server.lock().field_spindle(), (0.0, false, false));
            assert!(!server.lock().field_output_is_on(3));
            // Without its supply the device does not reply. The bridge reports its name, and uses it again
            // when the supply is back.
            server.lock().fault_now(FaultKind::FieldOff, None);
            core.until("the failure", |_| {
                messages.contain("7I76 10004711 on smart serial: no reply")
            });
            core.until("why it cannot begin", |_| {
                messages.contain("no device replies at channel 0 of smart serial port 0")
            });
            server.lock().clear_faults();
            core.inputs = None;
            core.until("inputs again", |inputs| inputs.is_some());
            assert!(server.lock().field_exchanges() > 100);
        },
    );
}

#[test]
fn what_a_device_does_not_have_is_told() {
    for (from, to, wanted) in [
        (
            "name = \"7I76\"",
            "name = \"7I77\"",
            "has the name 7I76, the board file has 7I77",
        ),
        ("name = \"7I76\"", "channel = 1", "no device replies at channel 1"),
        ("name = \"7I76\"", "port = 1", "the firmware of this board has 1"),
        (
            "pin = 3\n\n[[output]]",
            "pin = 32\n\n[[output]]",
            "has no field input 32; it has 32, from 0",
        ),
    ] {
        let board = |address| {
            let text = evolvent_file_tests::shipped("boards/7i76e-router.toml");
            assert!(text.contains(from), "{from}");
            let mut board =
                BoardSettings::parse(&text.replacen(from, to, 1), "b.toml").expect("a board file");
            board.address = address;
            board
        };
        with_bridge(
            "bad",
            BoardModel::B7i76e,
            board,
            &machine("router-3axis"),
            |core, _, messages| {
                core.until(wanted, |_| messages.contain(wanted));
            },
        );
    }
}
