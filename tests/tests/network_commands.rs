//! The commands for a new EtherCAT network, on the simulated ring: `bridge ethercat --scan` with `--write`, `--esi`
//! and `--json`, and `doctor --network`. They need the right to create a network namespace.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::Path;
use std::process::Output;

use evolvent_ethercat_ring::{DriveSettings, MAIN_INTERFACE, SubDevice, TerminalKind, on_bench};
use evolvent_tests::{Domain, Workshop, evolvent, repository};

/// A description of the simulated drive, as a vendor writes it (ETG.2000).
const ESI: &str = r##"<?xml version="1.0" encoding="utf-8"?>
<EtherCATInfo Version="1.6">
  <Vendor><Id>#x4556534D</Id><Name>Simulators</Name></Vendor>
  <Descriptions><Devices><Device Physics="YY">
    <Type ProductCode="#x402" RevisionNo="#x10000">SIM-DRIVE</Type>
    <Name LcId="1033">Drive</Name>
    <Profile><ProfileNo>402</ProfileNo><Dictionary><Objects><Object>
      <Index>#x607A</Index><Name>Target position</Name><Type>DINT</Type><BitSize>32</BitSize>
      <Info><Unit>#x00B50000</Unit></Info>
    </Object></Objects></Dictionary></Profile>
  </Device></Devices></Descriptions>
</EtherCATInfo>
"##;

/// A coupler, three drives and a terminal with inputs, as in the shipped network file.
fn devices() -> Vec<SubDevice> {
    let drive = |serial| SubDevice::drive(DriveSettings::default(), serial, 0.0);
    vec![
        SubDevice::terminal(TerminalKind::Coupler, 1),
        drive(2),
        drive(3),
        drive(4),
        SubDevice::terminal(TerminalKind::DigitalInput, 5),
    ]
}

fn run(arguments: &[&str]) -> Output {
    evolvent().args(arguments).output().expect("the binary to start")
}

/// Standard output, after the exit code was checked; the rest in the message if it is another.
fn expect_code(output: &Output, code: i32) -> (String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "{out}\n{err}");
    (out, err)
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

#[test]
fn a_scanned_network_starts_once_it_is_checked() {
    let workshop = Workshop::new();
    let machine = shown(&repository().join("config/machines/mill-ethercat.toml"));
    let network = shown(&workshop.folder().join("network.toml"));
    let esi = shown(&workshop.write("drive.xml", ESI));
    on_bench(devices(), move |_| {
        let scan = ["bridge", "ethercat", "--scan", "--interface", MAIN_INTERFACE];
        let with = |more: &[&str]| run(&[&scan[..], more].concat());
        let (listed, note) = expect_code(
            &with(&["--machine", &machine, "--write", &network, "--esi", &esi]),
            0,
        );
        // The unit is the vendor's; the drive does not report it.
        for part in [
            "0x4556534d",
            "607Ah",
            "Target position, inc",
            "6064h",
            "none of the given files describes",
        ] {
            assert!(listed.contains(part), "no {part} in {listed}");
        }
        assert!(note.contains("remove `unchecked`"), "{note}");
        let text = std::fs::read_to_string(&network).expect("the network file");
        for letter in ["X", "Y", "Z"] {
            assert!(text.contains(&format!("letter = \"{letter}\"")), "{text}");
        }
        // What exists is not replaced, and then nothing is scanned.
        let (_, refused) = expect_code(&with(&["--write", &network]), 2);
        assert!(
            refused.contains("exists") && refused.contains(&network),
            "{refused}"
        );
        assert_eq!(std::fs::read_to_string(&network).expect("the file"), text);
        let (json, _) = expect_code(&with(&["--json"]), 0);
        let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
        let found = json["devices"].as_array().expect("devices");
        let drives: Vec<_> = found.iter().map(|device| device["drive"] == true).collect();
        assert_eq!(drives, [false, true, true, true, false]);
        // With guesses no bridge runs; without the mark only a core is missing.
        let domain = Domain::new();
        let bridge = |seconds: &str| {
            run(&[
                "bridge",
                "ethercat",
                "--machine",
                &machine,
                "--network",
                &network,
                "--bus-prefix",
                &domain.prefix,
                "--seconds",
                seconds,
            ])
        };
        let (_, unchecked) = expect_code(&bridge("1"), 2);
        assert!(
            unchecked.contains("unchecked") && unchecked.contains(&network),
            "{unchecked}"
        );
        std::fs::write(&network, text.replacen("unchecked = true\n", "", 1)).expect("written");
        let (_, ended) = expect_code(&bridge("2"), 1);
        assert!(ended.contains("no core was running"), "{ended}");
    });
}

#[test]
fn a_scan_without_a_ring_says_why() {
    let workshop = Workshop::new();
    let unreadable = shown(&workshop.write("drive.xml", &ESI[..200]));
    on_bench(Vec::new(), move |_| {
        let scan = ["bridge", "ethercat", "--scan", "--interface"];
        let (_, absent) = expect_code(&run(&[&scan[..], &["absent0"]].concat()), 2);
        assert!(absent.contains("absent0"), "{absent}");
        let (_, silent) = expect_code(&run(&[&scan[..], &[MAIN_INTERFACE]].concat()), 1);
        assert!(silent.contains("no device replies"), "{silent}");
        let esi = [MAIN_INTERFACE, "--esi", &unreadable];
        let (_, broken) = expect_code(&run(&[&scan[..], &esi].concat()), 2);
        assert!(broken.contains("drive.xml"), "{broken}");
    });
}

#[test]
fn the_doctor_counts_devices_and_measures_round_trips() {
    on_bench(devices(), |_| {
        let doctor = |interface: &str| {
            run(&[
                "doctor",
                "--network",
                interface,
                "--rate",
                "500",
                "--seconds",
                "1",
                "--json",
            ])
        };
        let (json, _) = expect_code(&doctor(MAIN_INTERFACE), 0);
        let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
        let trips = &json["round_trips"];
        assert_eq!(trips["devices"], 5, "{json}");
        assert!(trips["sent"].as_u64() >= Some(400), "{json}");
        assert!(trips["p50_ns"].as_u64() > Some(0) && trips["p50_ns"].as_u64() <= trips["max_ns"].as_u64());
        let (_, absent) = expect_code(&doctor("absent0"), 2);
        assert!(absent.contains("absent0"), "{absent}");
    });
}
