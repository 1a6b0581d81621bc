//! Fault codes of drives as text.

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
    CODES
        .iter()
        .find(|(first, last, _)| (*first..=*last).contains(&code))
        .map_or(
            "a code that CiA 402 does not define: see the drive's manual",
            |(.., text)| text,
        )
}
