//! Fault codes of drives as text.

mod vendors;

use vendors::VENDORS;

/// Codes of object 603Fh defined by CiA 402 and CiA 301, by their first and last number.
const CODES: [(u16, u16, &str); 26] = [
    (0x0000, 0x0000, "no error"),
    (0x1000, 0x10FF, "generic error"),
    (0x2110, 0x213F, "short circuit or earth leakage at the input"),
    (0x2211, 0x2213, "overcurrent inside the drive"),
    (0x2220, 0x2222, "continuous overcurrent inside the drive"),
    (0x2230, 0x2240, "short circuit or earth leakage inside the drive"),
    (
        0x2310,
        0x2312,
        "continuous overcurrent at the motor: load too high, axis blocked, or brake closed",
    ),
    (
        0x2320,
        0x2340,
        "short circuit or earth leakage at the motor: check cable and motor",
    ),
    (0x3110, 0x3119, "mains voltage too high"),
    (0x3120, 0x3129, "mains voltage too low"),
    (0x3130, 0x3139, "a mains phase is missing"),
    (
        0x3210,
        0x3219,
        "DC link voltage too high: braking resistor missing, or braking too hard",
    ),
    (
        0x3220,
        0x3229,
        "DC link voltage too low: power supply off or too weak",
    ),
    (0x4110, 0x4139, "ambient temperature out of range"),
    (
        0x4210,
        0x4239,
        "temperature of the drive out of range: check its cooling",
    ),
    (
        0x4310,
        0x4339,
        "temperature of the drive or motor too high: let it cool, lower the load",
    ),
    (0x5100, 0x51FF, "an internal supply of the drive has failed"),
    (0x5440, 0x5443, "contactor or safe torque off"),
    (0x5500, 0x55FF, "memory of the drive has failed"),
    (0x6300, 0x63FF, "parameters of the drive are wrong or lost"),
    (0x7110, 0x7113, "brake chopper"),
    (0x7120, 0x7123, "motor: blocked, or commutation lost"),
    (0x7300, 0x73FF, "encoder: check its cable"),
    (0x7500, 0x75FF, "the fieldbus was lost under power"),
    (
        0x8611,
        0x8611,
        "following error: axis blocked, limits of the machine file too high, or loops not tuned",
    ),
    (0x8612, 0x8612, "position limit of the drive"),
];

/// Meaning of an error code (object 603Fh) of a vendor's drive: from the vendor's manual for its own codes,
/// otherwise as [`fault_text`].
///
/// ```
/// assert!(evolvent_ethercat::fault_text_of(0x066F, 0xFF10).starts_with("Err16: overload"));
/// assert!(evolvent_ethercat::fault_text_of(0, 0x8611).starts_with("following error"));
/// ```
#[must_use]
pub fn fault_text_of(vendor: u32, code: u16) -> &'static str {
    let own = VENDORS
        .iter()
        .find(|(listed, _)| *listed == vendor)
        .and_then(|(_, codes)| in_range(codes, code));
    own.unwrap_or_else(|| fault_text(code))
}

/// Meaning of an error code (object 603Fh).
///
/// ```
/// assert!(evolvent_ethercat::fault_text(0x8611).starts_with("following error"));
/// ```
#[must_use]
pub fn fault_text(code: u16) -> &'static str {
    if code >= 0xFF00 {
        return "a code of the manufacturer: see the drive's manual";
    }
    in_range(&CODES, code).unwrap_or("a code that CiA 402 does not define: see the drive's manual")
}

fn in_range(codes: &[(u16, u16, &'static str)], code: u16) -> Option<&'static str> {
    let found = codes
        .iter()
        .find(|(first, last, _)| (*first..=*last).contains(&code));
    found.map(|(.., text)| *text)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BECKHOFF: u32 = 0x0002;
    const OMRON: u32 = 0x0083;
    const ELMO: u32 = 0x009A;
    const MAXON: u32 = 0x00FB;
    const DELTA: u32 = 0x01DD;
    const YASKAWA: u32 = 0x0539;
    const PANASONIC: u32 = 0x066F;
    const INOVANCE: u32 = 0x0010_0000;

    #[test]
    fn vendor_codes_are_per_vendor_profile_codes_common() {
        assert!(fault_text_of(PANASONIC, 0xFF18).contains("following error"));
        assert!(fault_text_of(YASKAWA, 0x0D00).contains("following error"));
        assert!(fault_text_of(MAXON, 0x8A81).contains("positive limit"));
        for vendor in [
            PANASONIC, MAXON, YASKAWA, BECKHOFF, OMRON, ELMO, DELTA, INOVANCE, 0,
        ] {
            assert_eq!(fault_text_of(vendor, 0x4310), fault_text(0x4310));
        }
        // The low byte is the main number, 87, and the last digit of A.71x has no text of its own.
        assert!(fault_text_of(PANASONIC, 0xFF57).starts_with("Err87:"));
        for code in [0x0710, 0x071F] {
            assert!(fault_text_of(YASKAWA, code).starts_with("A.71x:"));
        }
        // FF18h of another vendor is not Panasonic's.
        assert!(fault_text_of(0, 0xFF18).contains("manufacturer"));
    }

    /// Values of programs of others that read the same manuals: display and meaning of single codes.
    #[test]
    fn codes_of_vendors_are_those_of_their_manuals() {
        for (vendor, code, parts) in [
            (BECKHOFF, 0x3182, ["speed", "axis module"]),
            (BECKHOFF, 0x5582, ["EEPROM", "data"]),
            // The low byte is the displayed number, not a binary one: 24 is Panasonic's FF18h.
            (OMRON, 0xFF24, ["error 24", "following error"]),
            (OMRON, 0xFF18, ["error 18", "braking resistor"]),
            (OMRON, 0xFF38, ["error 38", "limit switches"]),
            (OMRON, 0xFF83, ["error 83", "EtherCAT"]),
            (OMRON, 0xFF95, ["error 95", "motor"]),
            (ELMO, 0x5441, ["limit", "switch"]),
            (ELMO, 0x8481, ["speed", "high"]),
            (ELMO, 0x7381, ["Hall", "cable"]),
            (ELMO, 0x3310, ["voltage", "high"]),
            (DELTA, 0x7305, ["AL011", "encoder"]),
            (DELTA, 0x5443, ["AL014", "negative limit"]),
            (DELTA, 0x5442, ["AL015", "positive limit"]),
            (DELTA, 0x8611, ["AL009", "following error"]),
            (DELTA, 0x9000, ["AL500", "safe torque off"]),
            (DELTA, 0x8130, ["AL180", "fieldbus"]),
            (INOVANCE, 0x8611, ["Er.B00", "following error"]),
            (INOVANCE, 0x7121, ["Er.630", "blocked"]),
            (INOVANCE, 0x8400, ["Er.500", "speed"]),
            (INOVANCE, 0x5444, ["Er.952", "negative limit"]),
            (INOVANCE, 0x2312, ["Er.201", "overcurrent"]),
        ] {
            let text = fault_text_of(vendor, code);
            for part in parts {
                assert!(text.contains(part), "{vendor:X}h {code:X}h: {text}");
            }
        }
        // 7500h is the fieldbus in CiA 402, and not of Inovance.
        assert!(fault_text(0x7500).contains("fieldbus"));
        assert!(!fault_text_of(INOVANCE, 0x7500).contains("fieldbus"));
        // Other codes of these vendors are those of the profile, or their manuals'.
        assert_eq!(fault_text_of(ELMO, 0x2340), fault_text(0x2340));
        assert!(fault_text_of(OMRON, 0xFFA0).contains("manufacturer"));
    }

    /// An entry behind one with the same code would never be found.
    #[test]
    fn no_code_is_listed_twice() {
        for (vendor, codes) in VENDORS {
            for (i, (first, last, text)) in codes.iter().enumerate() {
                assert!(first <= last && !text.is_empty(), "{vendor:X}h {first:X}h");
                let mut others = codes[i + 1..].iter();
                assert!(
                    !others.any(|(other, end, _)| other <= last && first <= end),
                    "{vendor:X}h {first:X}h"
                );
            }
        }
    }
}
