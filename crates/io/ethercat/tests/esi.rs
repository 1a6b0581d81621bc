//! ESI files: the data that a scan uses, and rejected files.
//!
//! The first test needs the right to create a network namespace.

use evolvent_ethercat::{EsiLibrary, scan, scan_json, scan_text};
use evolvent_ethercat_ring::{DriveSettings, MAIN_INTERFACE, SubDevice, TerminalKind, on_bench};
use evolvent_random::{Random, cases};

/// A drive and a terminal of the simulator, as a vendor would describe them (ETG.2000).
const ESI: &str = r##"<?xml version="1.0" encoding="utf-8"?>
<EtherCATInfo xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" Version="1.6">
  <Vendor><Id>#x4556534D</Id><Name>Simulators &amp; Sons</Name></Vendor>
  <Descriptions>
    <Groups><Group><Type>Drives</Type></Group></Groups>
    <Devices>
      <Device Physics="YY">
        <Type ProductCode="#x402" RevisionNo="#x10000">SIM-DRIVE</Type>
        <Name LcId="1031">Antrieb</Name>
        <Name LcId="1033">Drive</Name>
        <Profile>
          <ProfileNo>402</ProfileNo>
          <Dictionary>
            <Objects>
              <Object>
                <Index>#x607A</Index><Name>Target position</Name><Type>DINT</Type><BitSize>32</BitSize>
                <Info><Unit>#x00B50000</Unit></Info>
              </Object>
              <Object>
                <Index>#x6064</Index><Name>Position actual value</Name><Type>DINT</Type><BitSize>32</BitSize>
                <Info><Unit>#xFD010000</Unit></Info>
              </Object>
            </Objects>
          </Dictionary>
        </Profile>
        <RxPdo Sm="2"><Index>#x1600</Index><Name>Outputs</Name>
          <Entry><Index>#x607A</Index><SubIndex>0</SubIndex><BitLen>32</BitLen><Name>Target position</Name><DataType>DINT</DataType></Entry>
        </RxPdo>
        <TxPdo><Index>#x1AFF</Index><Name>Not assigned</Name></TxPdo>
      </Device>
      <Device Physics="KK">
        <Type ProductCode="4104" RevisionNo="#x1">SIM-EL1008</Type>
        <Name LcId="1033">8 inputs</Name>
        <TxPdo Sm="0"><Index>#x1A00</Index><Name>Channel 1</Name>
          <Entry><Index>#x6000</Index><SubIndex>1</SubIndex><BitLen>1</BitLen><Name>Input</Name><DataType>BOOL</DataType></Entry>
        </TxPdo>
      </Device>
    </Devices>
  </Descriptions>
</EtherCATInfo>
"##;

#[test]
fn a_scan_has_the_names_and_units_of_the_vendor() {
    on_bench(
        vec![
            SubDevice::drive(DriveSettings::default(), 1, 0.0),
            SubDevice::terminal(TerminalKind::DigitalInput, 2),
            SubDevice::terminal(TerminalKind::DigitalOutput, 3),
        ],
        |_| {
            let folder = tempfile::tempdir().expect("a folder");
            std::fs::write(folder.path().join("sim.XML"), format!("\u{FEFF}{ESI}")).expect("a file");
            std::fs::write(folder.path().join("readme.txt"), "no ESI").expect("a file");
            let mut library = EsiLibrary::default();
            library.add(folder.path()).expect("a folder of ESI files");
            assert_eq!(library.len(), 2);
            let mut found = scan(MAIN_INTERFACE).expect("a ring");
            let before = scan_json(&found);
            library.complete(&mut found);
            println!("{}", scan_text(&found));
            let entries = |device: usize| {
                let pdos = found[device].outputs().iter().chain(found[device].inputs());
                pdos.flat_map(|pdo| &pdo.entries)
            };
            let unit = |device, index| {
                let found = entries(device).find(|entry| entry.index == index);
                found.map(|entry| entry.unit.as_str())
            };
            assert_eq!(unit(0, 0x607A), Some("inc"));
            assert_eq!(unit(0, 0x6064), Some("mm"));
            assert_eq!(unit(0, 0x6041), Some(""));
            // Data of the devices have priority.
            let after = scan_json(&found);
            for device in 0..3 {
                for key in ["vendor", "product", "revision", "serial", "clock", "drive"] {
                    assert_eq!(before["devices"][device][key], after["devices"][device][key]);
                }
            }
            let has_problem = |device: usize, what: &str| {
                found[device]
                    .problems
                    .iter()
                    .any(|problem| problem.contains(what))
            };
            assert!(
                has_problem(2, "none of the given files describes this device"),
                "{found:#?}"
            );
            assert!(!has_problem(0, "ESI"), "{:?}", found[0].problems);
            assert!(
                has_problem(1, "revision 0x1 was used") || found[1].sii.revision == 1,
                "{:?}",
                found[1].problems
            );
        },
    );
}

/// Truncated, changed or partly duplicated files give devices or an error with its position, never a panic.
#[test]
fn damaged_files_are_refused_or_read() {
    let mut random = Random::seeded(17);
    let mut refused = 0;
    for _ in 0..cases(2000) {
        let mut bytes = ESI.as_bytes().to_vec();
        for _ in 0..1 + random.below(4) {
            let at = random.below(bytes.len());
            match random.below(4) {
                0 => bytes.truncate(at.max(1)),
                1 => bytes[at] = random.below(256) as u8,
                2 => drop(bytes.remove(at)),
                _ => {
                    let end = (at + 40).min(bytes.len());
                    let part = bytes[at..end].to_vec();
                    bytes.splice(at..at, part);
                }
            }
        }
        let text = String::from_utf8_lossy(&bytes);
        let mut library = EsiLibrary::default();
        if let Err(error) = library.add_text(&text, "bad.xml") {
            refused += 1;
            assert!(error.to_string().starts_with("bad.xml:"), "{error}");
        }
    }
    assert!(refused > 100, "{refused}");
}

/// Very deep files, and those with very many devices, take bounded time and memory.
#[test]
fn huge_files_are_bounded() {
    let begin = std::time::Instant::now();
    let mut library = EsiLibrary::default();
    let deep = format!("<EtherCATInfo>{}", "<a>".repeat(100_000));
    assert!(library.add_text(&deep, "deep.xml").is_err());
    let closed = format!("{deep}{}</EtherCATInfo>", "</a>".repeat(100_000));
    let _any = library.add_text(&closed, "closed.xml");
    assert!(library.is_empty());
    let device = "<Device><Type ProductCode=\"1\">x</Type></Device>";
    let many = format!(
        "<EtherCATInfo><Vendor><Id>1</Id></Vendor><Descriptions><Devices>{}</Devices></Descriptions></EtherCATInfo>",
        device.repeat(20_000)
    );
    library.add_text(&many, "many.xml").expect("devices");
    assert_eq!(library.len(), 20_000);
    assert!(begin.elapsed() < std::time::Duration::from_secs(60));
}
