//! Fault codes of vendors, where they say more than CiA 402 or something else.
//!
//! Those of Omron, Elmo, Delta and Inovance come from public transcriptions of the manuals that are named, not
//! from the manuals themselves. Other series of a vendor have its vendor ID as well: a text begins with the name
//! of the series where that can mislead.

/// Codes from the first to the second number.
type Codes = &'static [(u16, u16, &'static str)];

/// The codes of each vendor, by its EtherCAT vendor ID.
pub(super) const VENDORS: [(u32, Codes); 8] = [
    (0x0000_0002, &BECKHOFF),
    (0x0000_0083, &OMRON),
    (0x0000_009A, &ELMO),
    (0x0000_00FB, &MAXON),
    (0x0000_01DD, &DELTA),
    (0x0000_0539, &YASKAWA),
    (0x0000_066F, &PANASONIC),
    (0x0010_0000, &INOVANCE),
];

/// Beckhoff AX8000, whose 603Fh is the text ID of the last error message: "AX8xxx, axis module, object
/// dictionary" and "diagnostic messages" (information system), "AX8000, diagnostic messages" 1.1 of 2019.
const BECKHOFF: [(u16, u16, &str); 6] = [
    (
        0x2390,
        0x2390,
        "power stage overloaded: load too high, axis blocked, or brake closed",
    ),
    (0x3181, 0x3181, "output frequency above 600 Hz: speed too high"),
    (0x3182, 0x3182, "speed above what the axis module accepts"),
    (0x5190, 0x5190, "5 V supply of the drive has failed its test"),
    (
        0x5580,
        0x5585,
        "EEPROM of the drive cannot be read, or its data are wrong",
    ),
    (0x789A, 0x789A, "encoder (EnDat 3): check its cable"),
];

/// Omron G5 with EtherCAT: the low byte is the main number as it is displayed. User's manual I576, object
/// 603Fh and errors.
const OMRON: [(u16, u16, &str); 32] = [
    (0xFF11, 0xFF11, "G5 error 11: control supply too low"),
    (
        0xFF12,
        0xFF12,
        "G5 error 12: supply voltage too high: braking resistor missing, or braking too hard",
    ),
    (0xFF13, 0xFF13, "G5 error 13: main supply too low or off"),
    (0xFF14, 0xFF14, "G5 error 14: overcurrent: check motor and cable"),
    (0xFF15, 0xFF15, "G5 error 15: the drive is too hot"),
    (
        0xFF16,
        0xFF16,
        "G5 error 16: overload: load too high, axis blocked, or brake closed",
    ),
    (0xFF18, 0xFF18, "G5 error 18: braking resistor overloaded"),
    (
        0xFF21,
        0xFF21,
        "G5 error 21: no communication with the encoder: check its cable",
    ),
    (
        0xFF23,
        0xFF23,
        "G5 error 23: communication with the encoder disturbed: check cable and shield",
    ),
    (
        0xFF24,
        0xFF24,
        "G5 error 24: following error: axis blocked, limits of the machine file too high, or loops not tuned",
    ),
    (
        0xFF25,
        0xFF25,
        "G5 error 25: motor and external encoder differ too much",
    ),
    (0xFF26, 0xFF26, "G5 error 26: speed too high"),
    (
        0xFF27,
        0xFF27,
        "G5 error 27: command not possible, or absolute position cleared",
    ),
    (
        0xFF29,
        0xFF29,
        "G5 error 29: counter of the following error has overflowed",
    ),
    (0xFF30, 0xFF30, "G5 error 30: safety input (safe torque off)"),
    (0xFF33, 0xFF33, "G5 error 33: assignment of inputs or outputs"),
    (
        0xFF34,
        0xFF34,
        "G5 error 34: motor position beyond its working range",
    ),
    (
        0xFF36,
        0xFF37,
        "errors 36 and 37: stored objects of the drive are wrong",
    ),
    (0xFF38, 0xFF38, "G5 error 38: limit switches, or their wiring"),
    (
        0xFF40,
        0xFF40,
        "G5 error 40: absolute encoder without supply: replace its battery, home again",
    ),
    (
        0xFF41,
        0xFF41,
        "G5 error 41: turns of the absolute encoder have overflowed",
    ),
    (0xFF42, 0xFF42, "G5 error 42: absolute encoder too fast"),
    (0xFF43, 0xFF49, "errors 43 to 49: encoder: check its cable"),
    (
        0xFF50,
        0xFF51,
        "errors 50 and 51: external encoder: check its cable",
    ),
    (
        0xFF55,
        0xFF55,
        "G5 error 55: a phase of the external encoder: check its cable",
    ),
    (
        0xFF83,
        0xFF83,
        "G5 error 83: EtherCAT: state, synchronization or watchdog",
    ),
    (0xFF87, 0xFF87, "G5 error 87: immediate stop input"),
    (0xFF88, 0xFF88, "G5 error 88: EtherCAT controller of the drive"),
    (0xFF90, 0xFF90, "G5 error 90: settings of EtherCAT"),
    (0xFF91, 0xFF91, "G5 error 91: command not possible in this state"),
    (
        0xFF92,
        0xFF93,
        "errors 92 and 93: encoder data or objects of the drive",
    ),
    (0xFF95, 0xFF95, "G5 error 95: the motor does not fit the drive"),
];

/// Elmo: "CANopen DS 301 Implementation Guide" MAN-CAN301IG, emergencies and motor faults.
const ELMO: [(u16, u16, &str); 21] = [
    (0x3120, 0x3120, "supply voltage too low, or its source too weak"),
    (
        0x3310,
        0x3310,
        "supply voltage too high: braking too hard, or no shunt resistor",
    ),
    (0x5280, 0x5280, "table of the electronic cam"),
    (0x5281, 0x5281, "timing of the drive"),
    (0x5400, 0x5400, "the motor cannot be switched on"),
    (0x5441, 0x5441, "limit switch"),
    (0x6180, 0x6181, "processor of the drive has failed"),
    (
        0x6200,
        0x6200,
        "program of the user in the drive has ended with an error",
    ),
    (
        0x6300,
        0x6300,
        "an object of the process data was refused, or a motion could not be executed",
    ),
    (0x6320, 0x6320, "parameters of the drive contradict each other"),
    (
        0x7121,
        0x7121,
        "the motor has current and does not move: axis blocked, or brake closed",
    ),
    (0x7300, 0x7300, "resolver or analog encoder: check its cable"),
    (0x7380, 0x7380, "encoder lost: check its cable"),
    (
        0x7381,
        0x7381,
        "Hall sensors: two changed at once: check their cable",
    ),
    (
        0x8311,
        0x8311,
        "peak current exceeded: current loop not tuned, or the drive is defective",
    ),
    (0x8380, 0x8380, "electrical zero of the motor not found"),
    (0x8381, 0x8381, "offsets of the current measurement"),
    (
        0x8480,
        0x8480,
        "speed error: loop not tuned, supply too low, or motor too weak",
    ),
    (0x8481, 0x8481, "speed too high"),
    (0x8680, 0x8680, "position limit of the drive"),
    (0xFF10, 0xFF10, "the motor cannot be switched on"),
];

/// Codes of maxon EPOS4 beyond CiA 402.
const MAXON: [(u16, u16, &str); 12] = [
    (0x1080, 0x1083, "initialization of the drive failed"),
    (0x5113, 0x5113, "logic supply too low"),
    (0x5280, 0x5281, "hardware of the drive defective"),
    (0x6320, 0x6320, "invalid parameter of the drive"),
    (0x7320, 0x7320, "encoder: check its cable"),
    (
        0x7380,
        0x738F,
        "encoder or Hall sensors: check cable and configuration",
    ),
    (0x8280, 0x8281, "the fieldbus was disturbed under power"),
    (0x8A80, 0x8A80, "negative limit switch"),
    (0x8A81, 0x8A81, "positive limit switch"),
    (0x8A82, 0x8A82, "software position limit of the drive"),
    (0x8A88, 0x8A88, "safe torque off"),
    (0xFF01, 0xFF02, "the drive's processor is overloaded"),
];

/// Delta ASDA-A2-E, with the alarms on its display: user manual of ASDA-A2, alarms with their 16-bit error
/// codes.
const DELTA: [(u16, u16, &str); 28] = [
    (0x2310, 0x2310, "AL001: overcurrent: check motor and cable"),
    (0x3110, 0x3110, "AL002: supply voltage too high"),
    (0x3120, 0x3120, "AL003: supply voltage too low or off"),
    (0x3130, 0x3130, "AL022: a mains phase is missing"),
    (
        0x3210,
        0x3210,
        "AL005: regeneration: braking resistor missing, too small, or braking too hard",
    ),
    (
        0x3230,
        0x3230,
        "AL006: overload: load too high, axis blocked, or brake closed",
    ),
    (0x3231, 0x3231, "AL023: overload is near"),
    (0x3300, 0x3300, "AL031: wiring of the motor's phases"),
    (0x4210, 0x4210, "AL016: the drive is too hot"),
    (0x5330, 0x5330, "AL017: memory of the drive"),
    (0x5441, 0x5441, "AL013: emergency stop input"),
    (0x5442, 0x5442, "AL015: positive limit switch"),
    (0x5443, 0x5443, "AL014: negative limit switch"),
    (0x5444, 0x5444, "AL283: positive position limit of the drive"),
    (0x5445, 0x5445, "AL285: negative position limit of the drive"),
    (
        0x6200,
        0x6200,
        "AL3E1 to AL3E5: synchronization with the fieldbus: check distributed clocks and period",
    ),
    (0x6310, 0x6310, "AL201: stored objects of the fieldbus are wrong"),
    (0x6320, 0x6320, "AL012: adjustment of the drive"),
    (0x7121, 0x7121, "AL030: motor blocked"),
    (0x7122, 0x7122, "AL004: the motor does not fit the drive"),
    (0x7305, 0x7305, "AL011, AL024 to AL027: encoder: check its cable"),
    (0x7306, 0x7306, "AL018: encoder output of the drive"),
    (0x8120, 0x8130, "AL185, AL180: the fieldbus was lost"),
    (
        0x8200,
        0x8200,
        "AL122 to AL132: an object of the process data cannot be used",
    ),
    (0x8400, 0x8400, "AL007: speed too high"),
    (0x8610, 0x8610, "AL040: motor and second encoder differ too much"),
    (
        0x8611,
        0x8611,
        "AL009: following error: axis blocked, limits of the machine file too high, or loops not tuned",
    ),
    (0x9000, 0x9000, "AL500 to AL503: safe torque off"),
];

/// Inovance IS620N, with the faults and warnings on its display: user guide, tables 9.2.1 and 9.2.2.
const INOVANCE: [(u16, u16, &str); 26] = [
    (0x0E12, 0x0E12, "Er.E12: the network could not be initialized"),
    (0x0E13, 0x0E13, "Er.E13: the drive does not support this period"),
    (
        0x0E15,
        0x0E15,
        "Er.E15: the period varies too much: check distributed clocks",
    ),
    (
        0x0FFF,
        0x0FFF,
        "Er.207, 208, 220, 234, 510, 602, B01, E07, E08 or E11: see the drive's display",
    ),
    (
        0x2311,
        0x2312,
        "Er.200, Er.201: overcurrent: check motor and cable",
    ),
    (
        0x2330,
        0x2330,
        "Er.210: earth leakage at the motor: check cable and motor",
    ),
    (0x3120, 0x3120, "Er.430: control supply too low"),
    (0x3130, 0x3130, "Er.420, Er.990: a mains phase is missing"),
    (
        0x3210,
        0x3210,
        "Er.400, Er.920: DC link voltage too high: braking resistor missing or overloaded, or braking too hard",
    ),
    (
        0x3220,
        0x3220,
        "Er.410: DC link voltage too low: power supply off or too weak",
    ),
    (
        0x3230,
        0x3230,
        "Er.610, 620, 909: overload: load too high, axis blocked, or brake closed",
    ),
    (
        0x3331,
        0x3331,
        "Er.939: a phase of the motor is open: check its cable",
    ),
    (0x4210, 0x4210, "Er.650: the drive is too hot"),
    (0x5441, 0x5441, "Er.121: invalid command to enable the drive"),
    (0x5442, 0x5442, "Er.900: emergency braking by an input"),
    (0x5443, 0x5443, "Er.950: positive limit switch"),
    (0x5444, 0x5444, "Er.952: negative limit switch"),
    (0x5530, 0x5530, "Er.108: memory of the drive's parameters"),
    (
        0x6320,
        0x6320,
        "Er.101, 105, 110, 111, 130, 131, 922, 941, B03, B04, D09 or D10: a parameter of the drive",
    ),
    (0x7121, 0x7121, "Er.630: motor blocked"),
    (
        0x7122,
        0x7122,
        "Er.120, Er.122: motor or encoder does not fit the drive",
    ),
    (
        0x7305,
        0x7305,
        "Er.136, 730 to 740, 770, 980, A33 to A35: encoder: check its cable and battery",
    ),
    (0x7500, 0x7500, "Er.102 to Er.104: logic of the drive has failed"),
    (0x7600, 0x7600, "Er.942: parameters are stored too often"),
    (0x8400, 0x8400, "Er.500: speed too high"),
    (
        0x8611,
        0x8611,
        "Er.B00, Er.B02: following error: axis blocked, limits of the machine file too high, or loops not tuned",
    ),
];

/// Yaskawa Sigma-7, by the first two digits of its alarms: A.71x is 071xh. Below 1000h CiA 402 has no codes.
const YASKAWA: [(u16, u16, &str); 18] = [
    (0x0100, 0x010F, "A.10x: overcurrent: check motor and cable"),
    (0x0300, 0x030F, "A.30x: regeneration"),
    (0x0320, 0x032F, "A.32x: braking resistor overloaded"),
    (
        0x0400,
        0x040F,
        "A.40x: supply voltage too high: braking resistor missing, or braking too hard",
    ),
    (0x0410, 0x041F, "A.41x: supply voltage too low"),
    (0x0510, 0x051F, "A.51x: speed too high"),
    (0x0710, 0x071F, "A.71x: overload: axis blocked, or brake closed"),
    (0x0720, 0x072F, "A.72x: continuous overload: load too high"),
    (0x07A0, 0x07AF, "A.7Ax: the drive is too hot"),
    (
        0x0810,
        0x081F,
        "A.81x: absolute encoder has lost its position: replace its battery, home again",
    ),
    (0x0830, 0x083F, "A.83x: battery of the encoder low"),
    (0x0860, 0x086F, "A.86x: the encoder is too hot"),
    (0x0A10, 0x0A1F, "A.A1x: the fieldbus was lost under power"),
    (
        0x0C10,
        0x0C1F,
        "A.C1x: the motor runs away: check its phases and the encoder's cable",
    ),
    (
        0x0C90,
        0x0C9F,
        "A.C9x: no communication with the encoder: check its cable",
    ),
    (
        0x0D00,
        0x0D0F,
        "A.D0x: following error: axis blocked, limits of the machine file too high, or loops not tuned",
    ),
    (0x0EB0, 0x0EBF, "A.EBx: safety inputs (safe torque off)"),
    (0x0F10, 0x0F1F, "A.F1x: a mains phase is missing"),
];

/// Panasonic MINAS A5B and A6B, by the main number of its alarms, in the low byte.
const PANASONIC: [(u16, u16, &str); 20] = [
    (0xFF0B, 0xFF0B, "Err11: control supply too low"),
    (
        0xFF0C,
        0xFF0C,
        "Err12: supply voltage too high: braking resistor missing, or braking too hard",
    ),
    (0xFF0D, 0xFF0D, "Err13: main supply too low or off"),
    (0xFF0E, 0xFF0E, "Err14: overcurrent: check motor and cable"),
    (0xFF0F, 0xFF0F, "Err15: the drive is too hot"),
    (
        0xFF10,
        0xFF10,
        "Err16: overload: load too high, axis blocked, or brake closed",
    ),
    (0xFF12, 0xFF12, "Err18: braking resistor overloaded"),
    (
        0xFF15,
        0xFF15,
        "Err21: no communication with the encoder: check its cable",
    ),
    (
        0xFF17,
        0xFF17,
        "Err23: communication with the encoder disturbed: check cable and shield",
    ),
    (
        0xFF18,
        0xFF18,
        "Err24: following error: axis blocked, limits of the machine file too high, or loops not tuned",
    ),
    (0xFF1A, 0xFF1A, "Err26: speed too high"),
    (0xFF1B, 0xFF1B, "Err27: position command changes too fast"),
    (0xFF1E, 0xFF1E, "Err30: safety input (safe torque off)"),
    (0xFF22, 0xFF22, "Err34: motor position beyond its working range"),
    (0xFF26, 0xFF26, "Err38: both limit switches, or their wiring"),
    (
        0xFF28,
        0xFF28,
        "Err40: absolute encoder without supply: replace its battery, home again",
    ),
    (0xFF50, 0xFF50, "Err80: the fieldbus was lost under power"),
    (0xFF53, 0xFF53, "Err83: the fieldbus was lost under power"),
    (0xFF57, 0xFF57, "Err87: forced alarm input"),
    (0xFF58, 0xFF58, "Err88: main supply lost, or wrong control mode"),
];
