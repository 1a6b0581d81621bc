//! Guarantees for core and clients, with both sides in one process.

mod common;

use common::{PERIOD_NS, PrivateDomain};
use evolvent_bus::{
    AXES, BusConfig, BusError, ClientBus, ClientConfig, ControlAnswer, ControlClient, ControlRequest,
    ControlServer, CoreBus, EventKind, Feedback, Load, MAX_SETPOINT_BUFFER, Setpoint, Status,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

fn setpoint(sequence: u64) -> Setpoint {
    Setpoint {
        sequence,
        position: [sequence as f64; AXES],
        ..Setpoint::default()
    }
}

#[test]
fn every_setpoint_arrives_once_and_in_order() {
    let domain = PrivateDomain::new();
    let mut core = CoreBus::open(&domain.core("mill")).expect("a core");
    let client = domain.client("mill");
    let mut reader = client.setpoints().expect("a reader");
    assert_eq!(core.wait_for_setpoint_subscribers(1, Duration::from_secs(60)), 1);
    for sequence in 0..5_000 {
        assert_eq!(core.publish_setpoint(&setpoint(sequence)), Ok(1));
        // A reader that lags behind, but by less than the buffer.
        if sequence % 500 == 499 {
            for expected in sequence - 499..=sequence {
                assert_eq!(reader.receive(), Ok(Some(setpoint(expected))));
            }
        }
    }
    assert_eq!(reader.receive(), Ok(None));
    assert_eq!(reader.lost(), 0);
}

#[test]
fn slow_reader_loses_oldest_and_never_blocks_core() {
    let domain = PrivateDomain::new();
    let config = BusConfig {
        setpoint_buffer: 100,
        ..domain.core("mill")
    };
    let mut core = CoreBus::open(&config).expect("a core");
    let client = domain.client("mill");
    let (mut sleeper, mut awake) = (client.setpoints().expect("one"), client.setpoints().expect("two"));
    core.publish_setpoint(&setpoint(0)).expect("sent");
    assert_eq!(sleeper.receive(), Ok(Some(setpoint(0))));
    for sequence in 1..=1_000 {
        core.publish_setpoint(&setpoint(sequence)).expect("sent");
        awake.receive().expect("received");
    }
    let mut kept = Vec::new();
    while let Some(setpoint) = sleeper.receive().expect("received") {
        kept.push(setpoint.sequence);
    }
    assert_eq!(kept, (901..=1_000).collect::<Vec<u64>>());
    assert_eq!((sleeper.lost(), awake.lost()), (900, 0));
}

#[test]
fn messages_stay_readable_after_core_has_closed() {
    let domain = PrivateDomain::new();
    let mut core = CoreBus::open(&domain.core("mill")).expect("a core");
    let client = domain.client("mill");
    let mut reader = client.setpoints().expect("a reader");
    for sequence in 0..300 {
        core.publish_setpoint(&setpoint(sequence)).expect("sent");
        if sequence == 0 {
            assert_eq!(reader.receive(), Ok(Some(setpoint(0))));
        }
    }
    drop(core);
    for sequence in 1..300 {
        assert_eq!(reader.receive(), Ok(Some(setpoint(sequence))));
    }
    assert_eq!(reader.receive(), Ok(None));
}

#[test]
fn status_is_the_latest_for_early_and_late_readers() {
    let domain = PrivateDomain::new();
    let mut core = CoreBus::open(&domain.core("mill")).expect("a core");
    let client = domain.client("mill");
    let mut early = client.status().expect("a reader");
    assert_eq!(early.latest(), Ok(None));
    let status = |sequence| {
        let mut status = Status {
            sequence,
            ..Status::default()
        };
        status.set_program("bore-200.ngc");
        status.push_alarm(4711);
        status
    };
    let mut every = client.every_status().expect("a reader");
    for sequence in 0..50 {
        core.publish_status(&status(sequence)).expect("sent");
    }
    assert_eq!(early.latest(), Ok(Some(status(49))));
    for sequence in 0..50 {
        assert_eq!(every.receive(), Ok(Some(status(sequence))));
    }
    assert_eq!(every.receive(), Ok(None));
    let mut late = client.status().expect("a reader");
    core.admit_readers();
    assert_eq!(late.latest(), Ok(Some(status(49))));
    core.publish_status(&status(50)).expect("sent");
    for reader in [&mut early, &mut late] {
        let latest = reader.latest().expect("received").expect("a status");
        assert_eq!((latest.sequence, latest.program_name()), (50, "bore-200.ngc"));
        assert_eq!(latest.listed_alarms(), [4711]);
    }
}

#[test]
fn oversized_texts_and_alarms_are_cut_and_counted() {
    let mut status = Status::default();
    // 127 bytes and a character of two: the cut must not fall into it.
    status.set_program(&format!("{}ä", "x".repeat(127)));
    assert_eq!(status.program_name(), "x".repeat(127));
    for number in 0..20 {
        status.push_alarm(number);
    }
    assert_eq!((status.alarm_count, status.listed_alarms().len()), (20, 16));
    // Sentences end after a word: G4 would be a dwell.
    for (padding, expected) in [(250, "..."), (249, " G49"), (252, "...")] {
        let words = format!("{} G49", "x".repeat(padding));
        status.set_message(&format!("{words}{}", " G49".repeat(3)));
        let shown = if expected == "..." { "..." } else { " G49..." };
        assert_eq!(
            status.operator_message(),
            format!("{}{shown}", "x".repeat(padding))
        );
    }
    status.set_message(&format!("{} G49", "x".repeat(252)));
    assert_eq!(
        status.operator_message(),
        format!("{} G49", "x".repeat(252)),
        "it fits"
    );
    status.set_message(&"ä".repeat(200));
    assert_eq!(
        status.operator_message(),
        format!("{}...", "ä".repeat(126)),
        "one word"
    );
    status.set_alarm_text(&"word ".repeat(60));
    assert!(status.alarm_sentence().ends_with("word..."));
    // Foreign senders may send anything.
    let broken = Status {
        program_length: u32::MAX,
        program: [0xff; 128],
        alarm_count: u32::MAX,
        ..status
    };
    assert_eq!((broken.program_name(), broken.listed_alarms().len()), ("", 16));
}

#[test]
fn events_wake_a_sleeping_client() {
    let domain = PrivateDomain::new();
    let mut core = CoreBus::open(&domain.core("mill")).expect("a core");
    let client = domain.client("mill");
    let mut events = client.events().expect("a listener");
    assert_eq!(events.wait(Duration::from_millis(1)), Ok(vec![]));
    // Without time nothing is waited for: a wait for ever would hang here.
    assert_eq!(events.wait(Duration::ZERO), Ok(vec![]));
    assert_eq!(events.wait(Duration::from_nanos(999)), Ok(vec![]));
    for kind in EventKind::ALL {
        core.notify(kind).expect("notified");
        assert_eq!(events.wait(Duration::from_secs(60)), Ok(vec![kind]));
    }
    drop(core);
    assert_eq!(
        events.wait(Duration::from_secs(60)),
        Ok(vec![EventKind::CoreClosed])
    );
}

#[test]
fn feedback_and_load_come_in_and_nonsense_is_dropped() {
    let domain = PrivateDomain::new();
    let mut core = CoreBus::open(&domain.core("mill")).expect("a core");
    let client = domain.client("mill");
    let (mut drives, mut sensor) = (
        client.feedback_sender().expect("a bridge"),
        client.load_sender().expect("a sensor"),
    );
    let good = Feedback {
        sequence: 7,
        position: [1.5; AXES],
        axes_mask: 0b111,
        ..Feedback::default()
    };
    let mut bad = good;
    bad.position[1] = f64::NAN;
    let mut unused = good;
    unused.velocity[8] = f64::INFINITY;
    for feedback in [good, bad, unused] {
        drives.send(&feedback).expect("sent");
    }
    assert_eq!(core.feedback(), Ok(Some(good)));
    assert_eq!(core.feedback().map(|f| f.map(|f| f.sequence)), Ok(Some(7)));
    assert_eq!(core.feedback(), Ok(None));

    let load = Load {
        kind: 1,
        value: 120.0,
        range_min: 0.0,
        range_max: 500.0,
        ..Load::default()
    };
    for wrong in [
        Load {
            value: f64::NAN,
            ..load
        },
        Load { value: 501.0, ..load },
        Load {
            range_max: f64::INFINITY,
            ..load
        },
        Load {
            range_min: 400.0,
            range_max: 100.0,
            ..load
        },
        Load { kind: 99, ..load },
    ] {
        sensor.send(&wrong).expect("sent");
    }
    sensor.send(&load).expect("sent");
    assert_eq!(core.load(), Ok(Some(load)));
    assert_eq!(core.load(), Ok(None));
    assert_eq!(core.rejected_inputs(), 6);
}

#[test]
fn a_message_of_another_version_is_refused_by_name() {
    let domain = PrivateDomain::new();
    let mut core = CoreBus::open(&domain.core("mill")).expect("a core");
    let client = domain.client("mill");
    let mut drives = client.feedback_sender().expect("a bridge");
    drives
        .send(&Feedback {
            interface_version: 99,
            ..Feedback::default()
        })
        .expect("sent");
    let error = core.feedback().expect_err("another version").to_string();
    assert!(
        error.contains("version 99") && error.contains("supports 1"),
        "{error}"
    );
    assert_eq!(core.feedback(), Ok(None));
}

#[test]
fn two_machines_run_side_by_side_by_name() {
    let domain = PrivateDomain::new();
    let mut mill = CoreBus::open(&domain.core("mill")).expect("a mill");
    let mut lathe = CoreBus::open(&domain.core("lathe")).expect("a lathe");
    let (at_mill, at_lathe) = (domain.client("mill"), domain.client("lathe"));
    let (mut from_mill, mut from_lathe) = (
        at_mill.setpoints().expect("one"),
        at_lathe.setpoints().expect("two"),
    );
    mill.publish_setpoint(&setpoint(1)).expect("sent");
    lathe.publish_setpoint(&setpoint(2)).expect("sent");
    assert_eq!(from_mill.receive(), Ok(Some(setpoint(1))));
    assert_eq!(from_lathe.receive(), Ok(Some(setpoint(2))));
    assert_eq!((from_mill.receive(), from_lathe.receive()), (Ok(None), Ok(None)));
}

#[test]
fn second_core_of_name_is_refused_with_pid_of_first() {
    let domain = PrivateDomain::new();
    let _first = CoreBus::open(&domain.core("mill")).expect("a core");
    let pid = i32::try_from(std::process::id()).ok();
    let refused = BusError::AlreadyRunning {
        machine_name: "mill".to_owned(),
        pid,
    };
    assert_eq!(CoreBus::open(&domain.core("mill")).err(), Some(refused.clone()));
    // Also if its settings would not match the existing services.
    let other = BusConfig {
        period_ns: 500_000,
        ..domain.core("mill")
    };
    assert_eq!(CoreBus::open(&other).err(), Some(refused.clone()));
    let text = refused.to_string();
    assert!(text.contains("machine mill is already running, pid "), "{text}");
}

#[test]
fn closed_core_reopens_even_with_other_settings() {
    let domain = PrivateDomain::new();
    for period_ns in [PERIOD_NS, 500_000, 28_571] {
        let config = BusConfig {
            period_ns,
            ..domain.core("mill")
        };
        drop(CoreBus::open(&config).expect("a core"));
    }
}

#[test]
fn a_core_starts_again_while_its_clients_stay() {
    let domain = PrivateDomain::new();
    let mut core = CoreBus::open(&domain.core("mill")).expect("a core");
    let client = domain.client("mill");
    let mut reader = client.setpoints().expect("a reader");
    core.publish_setpoint(&setpoint(10)).expect("sent");
    assert_eq!(reader.receive(), Ok(Some(setpoint(10))));
    drop(core);

    // With another period the client would misread the new core, so that one must not start.
    let other = BusConfig {
        period_ns: 500_000,
        ..domain.core("mill")
    };
    let error = CoreBus::open(&other).expect_err("held by a client").to_string();
    assert!(
        error.contains("evolvent.period_ns is 1000000 there and 500000 here"),
        "{error}"
    );
    assert!(error.contains("close them"), "{error}");

    let mut core = CoreBus::open(&domain.core("mill")).expect("the same core again");
    core.publish_setpoint(&setpoint(0)).expect("sent");
    assert_eq!(reader.receive(), Ok(Some(setpoint(0))));
    assert_eq!(reader.lost(), 0, "a new run is no loss");
}

#[test]
fn mismatched_client_fails_at_open_and_names_both() {
    let domain = PrivateDomain::new();
    let _core = CoreBus::open(&domain.core("mill")).expect("a core");
    let fits = ClientConfig {
        period_ns: Some(PERIOD_NS),
        axes: Some("XYZ".to_owned()),
        ..domain.client_config("mill")
    };
    let client = ClientBus::open(&fits).expect("a client");
    assert_eq!((client.period_ns(), client.axes()), (PERIOD_NS, "XYZ"));
    let wrong_period = ClientConfig {
        period_ns: Some(2_000_000),
        ..fits.clone()
    };
    let wrong_axes = ClientConfig {
        axes: Some("XYZC".to_owned()),
        ..fits
    };
    for (config, words) in [
        (
            wrong_period,
            "evolvent.period_ns is 1000000 there and 2000000 here",
        ),
        (wrong_axes, "evolvent.axes is XYZ there and XYZC here"),
    ] {
        let error = ClientBus::open(&config).expect_err("no fit").to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
fn a_client_waits_for_its_core_and_gives_up_in_time() {
    let domain = PrivateDomain::new();
    let config = ClientConfig {
        wait: Duration::from_millis(30),
        ..domain.client_config("mill")
    };
    assert!(matches!(
        ClientBus::open(&config),
        Err(BusError::NoCore { waited_ms: 30.., .. })
    ));

    let patient = domain.client_config("mill");
    std::thread::scope(|scope| {
        let client = scope.spawn(move || {
            let client = ClientBus::open(&patient).expect("a core");
            client.setpoints().expect("a reader");
            client.period_ns()
        });
        std::thread::sleep(Duration::from_millis(50));
        let core = CoreBus::open(&domain.core("mill")).expect("a core");
        assert_eq!(client.join().ok(), Some(PERIOD_NS));
        drop(core);
    });
}

#[test]
fn excess_subscriber_is_refused_until_another_leaves() {
    let domain = PrivateDomain::new();
    let config = BusConfig {
        max_setpoint_subscribers: 2,
        ..domain.core("mill")
    };
    let core = CoreBus::open(&config).expect("a core");
    let client = domain.client("mill");
    let (one, _two) = (client.setpoints().expect("one"), client.setpoints().expect("two"));
    assert!(matches!(
        client.setpoints(),
        Err(BusError::NoPlace {
            port: "subscriber",
            ..
        })
    ));
    drop(one);
    assert!(client.setpoints().is_ok());
    drop(core);
}

#[test]
fn invalid_settings_are_reported_before_opening() {
    let domain = PrivateDomain::new();
    let core = || domain.core("mill");
    for name in ["", "mill 1", "mühle", "a/b", "../x", "m\0", &"m".repeat(65)] {
        assert!(
            matches!(CoreBus::open(&domain.core(name)), Err(BusError::Name(_))),
            "{name:?}"
        );
        let client = domain.client_config(name);
        assert!(
            matches!(ClientBus::open(&client), Err(BusError::Name(_))),
            "{name:?}"
        );
    }
    for prefix in ["", "a/b", "..", "ä", &"p".repeat(33)] {
        let config = BusConfig {
            prefix: Some(prefix.to_owned()),
            ..core()
        };
        assert!(
            matches!(CoreBus::open(&config), Err(BusError::Prefix { .. })),
            "{prefix:?}"
        );
    }
    for period_ns in [0, 999, 1_000_000_001, u64::MAX] {
        let config = BusConfig { period_ns, ..core() };
        assert_eq!(CoreBus::open(&config).err(), Some(BusError::Period { period_ns }));
        // The default settings must be valid for every period.
        assert!((256..=16_384).contains(&BusConfig::new("mill", "XYZ", period_ns).setpoint_buffer));
    }
    for axes in ["", "XX", "xyz", "XYQ", "X Y"] {
        let config = BusConfig {
            axes: axes.to_owned(),
            ..core()
        };
        assert!(
            matches!(CoreBus::open(&config), Err(BusError::Axes { .. })),
            "{axes:?}"
        );
    }
    for setpoint_buffer in [0, MAX_SETPOINT_BUFFER + 1, usize::MAX] {
        let config = BusConfig {
            setpoint_buffer,
            ..core()
        };
        assert!(matches!(
            CoreBus::open(&config),
            Err(BusError::SetpointBuffer { .. })
        ));
    }
    for max_setpoint_subscribers in [0, 65, usize::MAX] {
        let config = BusConfig {
            max_setpoint_subscribers,
            ..core()
        };
        assert!(matches!(
            CoreBus::open(&config),
            Err(BusError::Subscribers { .. })
        ));
    }
    assert_eq!(domain.files(), Vec::<std::path::PathBuf>::new());
}

#[test]
fn replies_reach_their_sender_and_count_per_client() {
    let domain = PrivateDomain::new();
    let config = domain.core("mill");
    let _core = CoreBus::open(&config).expect("a core");
    let mut server = ControlServer::open(&config).expect("a server");
    let client_config = domain.client_config("mill");
    let asking = std::thread::spawn(move || {
        let mut one = ControlClient::open(&client_config).expect("one");
        let mut two = ControlClient::open(&client_config).expect("two");
        assert_ne!(one.number(), two.number());
        let mut answers = Vec::new();
        for k in 0..20_u32 {
            let client = if k % 2 == 0 { &mut one } else { &mut two };
            let request = ControlRequest {
                command: k,
                ..ControlRequest::default()
            };
            let answer = client
                .command(&request, Duration::from_secs(60))
                .expect("an answer");
            answers.push((answer.command, answer.serial, answer.client == client.number()));
        }
        answers
    });
    let mut served = 0;
    while served < 20 {
        let judge = |request: &ControlRequest| ControlAnswer {
            client: request.client,
            serial: request.serial,
            command: request.command,
            ..ControlAnswer::default()
        };
        if let Some(call) = server.receive().expect("a sound connection") {
            let answer = judge(call.request());
            call.answer(answer);
            served += 1;
        }
        std::thread::sleep(Duration::from_micros(200));
    }
    let answers = asking.join().expect("the clients");
    let expected: Vec<_> = (0..20_u32).map(|k| (k, u64::from(k / 2) + 1, true)).collect();
    assert_eq!(answers, expected);
}

#[test]
fn command_flood_blocks_neither_core_nor_clients() {
    let domain = PrivateDomain::new();
    let config = domain.core("mill");
    let _core = CoreBus::open(&config).expect("a core");
    let mut server = ControlServer::open(&config).expect("a server");
    let client_config = domain.client_config("mill");
    let asking = std::thread::spawn(move || {
        let mut flood = ControlClient::open(&client_config).expect("a flood");
        let mut polite = ControlClient::open(&client_config).expect("a polite one");
        for _ in 0..2_000 {
            // Too fast for the core: commands without an immediate answer are abandoned.
            let _unanswered = flood.command(&ControlRequest::default(), Duration::ZERO);
        }
        polite
            .command(&ControlRequest::default(), Duration::from_secs(60))
            .expect("an answer")
            .serial
    });
    while !asking.is_finished() {
        if let Some(call) = server.receive().expect("a sound connection") {
            let answer = ControlAnswer {
                client: call.request().client,
                serial: call.request().serial,
                ..ControlAnswer::default()
            };
            call.answer(answer);
        }
        std::thread::sleep(Duration::from_micros(100));
    }
    assert_eq!(asking.join().expect("the clients"), 1);
}

#[test]
fn texts_of_commands_keep_to_their_room() {
    let mut request = ControlRequest::default();
    assert!(request.set_text("G1 X1 (\u{00e4})"));
    assert_eq!(request.text(), Some("G1 X1 (\u{00e4})"));
    assert!(!request.set_text(&"x".repeat(evolvent_bus::COMMAND_TEXT_BYTES + 1)));
    request.text_length = u32::MAX;
    assert_eq!(request.text(), None);
    request.text_length = 2;
    request.text[0] = 0xff;
    assert_eq!(request.text(), None);
    let mut answer = ControlAnswer::default();
    answer.set_text(&"\u{00e4}".repeat(1000));
    // 512 bytes: 254 characters of two, and what says that it goes on.
    assert_eq!(answer.text(), format!("{}...", "\u{00e4}".repeat(254)));
}

/// The removal of a domain waits for processes that are ending in it.
#[test]
fn domain_is_removed_after_its_last_process_ends() {
    let domain = PrivateDomain::new();
    let (ends, config) = (Arc::new(AtomicBool::new(false)), domain.core("mill"));
    let (sender, receiver) = std::sync::mpsc::channel();
    let ending = std::thread::spawn({
        let ends = Arc::clone(&ends);
        move || {
            let core = CoreBus::open(&config).expect("a core");
            sender.send(()).expect("a listener");
            std::thread::sleep(Duration::from_millis(500));
            ends.store(true, Ordering::Relaxed);
            drop(core);
        }
    });
    receiver.recv().expect("a core");
    drop(domain);
    assert!(
        ends.load(Ordering::Relaxed),
        "its files were removed under a core that lives"
    );
    ending.join().expect("no panic");
}
