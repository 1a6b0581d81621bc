//! Hardware information in HAL files.

use std::path::Path;

use evolvent_config::read_regular;

/// Maximum size of a HAL file.
const MAX_BYTES: u64 = 4 << 20;

/// HAL components and their replacement.
const COMPONENTS: &[(&str, &str)] = &[
    ("hm2_eth", "a Mesa Ethernet board"),
    ("hm2_pci", "a Mesa PCI board"),
    ("hm2_rpspi", "a Mesa board on SPI"),
    ("lcec", "EtherCAT drives"),
    ("hal_parport", "a parallel port"),
    ("stepgen", "step pulses made in software"),
    ("opto_ac5", "an Opto 22 board"),
    ("mb2hal", "Modbus devices"),
    (
        "hal_manualtoolchange",
        "tool changes by hand: M6 asks the operator here too",
    ),
];

/// HAL commands that connect pins.
const CONNECTING: &[&str] = &["net", "linksp", "linkps", "linkpp"];

/// The pin of a touch probe.
const PROBE: &str = "motion.probe-input";

/// Spindles whose encoder a HAL file connects.
pub(crate) fn connected_spindles(file: &Path) -> Vec<u32> {
    let pins = connected(file);
    let numbers = pins.iter().filter_map(|pin| {
        let number = pin.strip_prefix("spindle.")?.strip_suffix(".revs")?;
        number.parse().ok()
    });
    numbers.collect()
}

/// Whether a HAL file connects a touch probe.
pub(crate) fn connects_probe(file: &Path) -> bool {
    connected(file).iter().any(|pin| pin == PROBE)
}

/// Names of signals and pins that a HAL file connects.
fn connected(file: &Path) -> Vec<String> {
    let Ok(bytes) = read_regular(file, MAX_BYTES) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    for line in String::from_utf8_lossy(&bytes).lines() {
        let line = line.split('#').next().unwrap_or_default();
        let mut words = line.split_whitespace();
        if !words.next().is_some_and(|word| CONNECTING.contains(&word)) {
            continue;
        }
        found.extend(words.map(str::to_owned));
    }
    found
}

/// Components of a HAL file that show how the machine is wired, with a description.
pub(crate) fn hardware(file: &Path) -> Vec<(&'static str, &'static str)> {
    let Ok(bytes) = read_regular(file, MAX_BYTES) else {
        return Vec::new();
    };
    let text = String::from_utf8_lossy(&bytes);
    let loads = text
        .lines()
        .map(str::trim)
        .filter(|line| line.starts_with("load"));
    let names: Vec<&str> = loads.flat_map(|line| line.split_whitespace().skip(1)).collect();
    COMPONENTS
        .iter()
        .copied()
        .filter(|(name, _)| names.contains(name))
        .collect()
}
