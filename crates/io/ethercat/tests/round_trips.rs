//! Round trips and the settings of a network card, as `evolvent doctor --network` measures them.
//!
//! Needs the right to create a network namespace.

use core::time::Duration;
use std::process::Command;

use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat::{CardFinding, examine_card, round_trips};
use evolvent_ethercat_ring::{FaultKind, MAIN_INTERFACE, SubDevice, TerminalKind, monotonic_ns, on_bench};

fn devices() -> Vec<SubDevice> {
    (1..4)
        .map(|serial| SubDevice::terminal(TerminalKind::DigitalInput, serial))
        .collect()
}

fn value<'a>(findings: &'a [CardFinding], name: &str) -> &'a str {
    let found = findings.iter().find(|finding| finding.name == name);
    found.map_or("", |finding| finding.value.as_str())
}

#[test]
fn frames_come_back_and_devices_are_counted() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            let measure = |period_ms: u64| {
                let (period, duration) = (Duration::from_millis(period_ms), Duration::from_millis(720));
                round_trips(MAIN_INTERFACE, period, duration).expect("an interface")
            };
            // Longer than any pause that the host is allowed without a repetition.
            let (trips, devices) = measure(60);
            println!("{trips:?}");
            assert_eq!((trips.sent, trips.lost, devices), (12, 0, 3));
            assert!(0 < trips.p50_ns && trips.p50_ns <= trips.p999_ns && trips.p999_ns <= trips.max_ns);
            // A ring that is slower by 5 ms on purpose: every reply is later than the period.
            let mut locked = ring.lock().expect("no panic");
            locked.begin_fault(monotonic_ns(), FaultKind::Delay, 0, None);
            drop(locked);
            let (late, _) = measure(4);
            println!("{late:?}");
            assert_eq!(late.lost, late.sent, "5 ms are more than a period of 4");
        });
    });
}

/// `ethtool` sets what is then read, where it is installed.
#[test]
fn a_card_is_described_as_ethtool_sets_it() {
    on_bench(devices(), |_| {
        assert!(examine_card("no-such-card").is_err());
        assert!(examine_card("../lo").is_err());
        let findings = examine_card(MAIN_INTERFACE).expect("an interface");
        println!("{findings:?}");
        assert_eq!(value(&findings, "link"), "up");
        for on in [true, false, true] {
            let word = if on { "on" } else { "off" };
            let ran = Command::new("ethtool")
                .args(["-K", MAIN_INTERFACE, "gro", word, "tso", word])
                .output();
            let Ok(output) = ran else {
                println!("not measured: ethtool is not installed");
                return;
            };
            assert!(
                output.status.success(),
                "{}",
                String::from_utf8_lossy(&output.stderr)
            );
            let findings = examine_card(MAIN_INTERFACE).expect("an interface");
            let offloads = value(&findings, "offloads");
            assert_eq!(offloads.contains("gro"), on, "{offloads}");
            assert_eq!(offloads.contains("tso"), on, "{offloads}");
            let advice = findings.iter().find(|finding| finding.name == "offloads");
            let advice = advice
                .and_then(|finding| finding.advice.as_deref())
                .unwrap_or_default();
            assert_eq!(advice.contains("ethtool -K ec0 gro off"), on, "{advice}");
        }
    });
}
