//! AL status codes (ETG.1020) of devices: what to check.

/// What to check; `None` for self-explanatory codes and those of vendors.
pub(crate) const fn what_to_check(code: u16) -> Option<&'static str> {
    Some(match code {
        0x0014 => "load its firmware with the vendor's tool",
        0x0015 | 0x0016 => {
            "its mailbox is set up as its EEPROM specifies: check that its firmware and its EEPROM are of \
             one revision"
        }
        0x0017 | 0x001C..=0x001E | 0x0024..=0x0026 => {
            "compare its process data, which `--scan` lists, with those of the network file; `map = false` \
             leaves the drive its own mapping"
        }
        0x0018 => "its inputs are not ready: check sensors, encoder and main supply",
        0x0019 | 0x001B => {
            "frames did not reach it in time: check the cable before it, the card and its driver (`evolvent \
             doctor --network`)"
        }
        0x001F => "its watchdog does not accept the configured time: check its manual",
        0x0020..=0x0023 => "switch its supply off and on",
        0x0027 | 0x0028 => {
            "it needs another synchronisation: set `distributed_clocks` in the network file as its manual \
             specifies"
        }
        0x001A | 0x002C | 0x002D | 0x0030..=0x0034 => {
            "SYNC0 does not arrive as it requires: check `distributed_clocks` in the network file, and the \
             jitter of frames (`evolvent doctor --network`)"
        }
        0x0035..=0x0037 => {
            "it does not support this period: set `rate` in the machine file to one that its manual lists"
        }
        0x0050 | 0x0051 => "its EEPROM cannot be read: load it with the vendor's tool",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn setup_codes_have_a_remedy_vendor_codes_none() {
        for (code, part) in [
            (0x1D, "--scan"),
            (0x1E, "--scan"),
            (0x24, "--scan"),
            (0x2D, "distributed_clocks"),
            (0x35, "rate"),
            (0x36, "rate"),
            (0x1B, "cable"),
        ] {
            assert!(
                what_to_check(code).is_some_and(|text| text.contains(part)),
                "{code:04X}h"
            );
        }
        for code in [0, 0x8000, 0xFFFF] {
            assert_eq!(what_to_check(code), None);
        }
    }
}
