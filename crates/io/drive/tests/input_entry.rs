//! Inputs at entry: invalid messages are refused with their fault, and old inputs are unknown.

use evolvent_drive::{InputEntry, InputFault, KnownInputs};
use evolvent_wire::MachineInputs;

const NOW: u64 = 1_000_000_000;
const TIMEOUT: u64 = 100_000_000;

/// Digital inputs 0, 3 and 63, analog input 2 from 0 to 10.
fn entry() -> InputEntry {
    InputEntry::new(1 | 1 << 3 | 1 << 63, TIMEOUT).with_analog(2, [0.0, 10.0])
}

fn message() -> MachineInputs {
    let mut message = MachineInputs {
        sequence: 1,
        time_ns: NOW,
        instance: 7,
        digital_mask: 1 | 1 << 3,
        digital: 1 << 3,
        analog_mask: 1 << 2,
        ..MachineInputs::default()
    };
    message.analog[2] = 5.0;
    message
}

#[test]
fn a_good_message_is_known_until_it_is_too_old() {
    let mut entry = entry();
    assert_eq!(entry.known(NOW), KnownInputs::default());
    entry.take(&message(), NOW).expect("a good message");
    let known = entry.known(NOW + TIMEOUT);
    assert_eq!((known.digital_known, known.digital), (0b1001, 0b1000));
    assert_eq!((known.analog_known, known.analog[2]), (1 << 2, 5.0));
    assert_eq!(entry.known(NOW + TIMEOUT + 1), KnownInputs::default());
    assert_eq!(entry.refused(), (0, None));
}

#[test]
fn impossible_inputs_are_refused_and_last_good_kept() {
    type Spoil = fn(&mut MachineInputs);
    let cases: [(Spoil, InputFault); 9] = [
        (|m| m.analog[2] = f64::NAN, InputFault::NotFinite),
        (|m| m.analog[2] = f64::INFINITY, InputFault::NotFinite),
        (|m| m.time_ns = NOW + TIMEOUT + 2, InputFault::Ahead(TIMEOUT + 2)),
        (|m| m.time_ns = NOW - TIMEOUT - 2, InputFault::Past(TIMEOUT + 2)),
        (|m| m.digital_mask |= 1 << 4, InputFault::NoDigital(4)),
        (|m| m.analog_mask |= 1, InputFault::NoAnalog(0)),
        (
            |m| m.analog[2] = 10.1,
            InputFault::OutOfRange {
                number: 2,
                value: 10.1,
            },
        ),
        (|m| m.probe = 3, InputFault::Probe(3)),
        (|m| m.sequence = 1, InputFault::Repeated),
    ];
    for (spoil, fault) in cases {
        let mut entry = entry();
        entry.take(&message(), NOW).expect("a good message");
        let before = entry.known(NOW);
        let mut bad = MachineInputs {
            sequence: 2,
            digital: 1,
            ..message()
        };
        spoil(&mut bad);
        assert_eq!(entry.take(&bad, NOW), Err(fault));
        assert_eq!(entry.known(NOW), before, "{fault}");
        assert_eq!(entry.refused(), (1, Some(fault)));
    }
}

#[test]
fn a_value_that_was_not_read_may_be_anything() {
    let mut entry = entry();
    let mut message = message();
    message.analog[0] = f64::NAN;
    entry.take(&message, NOW).expect("nobody reads analog input 0");
}

#[test]
fn message_ahead_of_clock_ages_from_its_arrival() {
    let mut entry = entry();
    let message = MachineInputs {
        time_ns: NOW + TIMEOUT,
        ..message()
    };
    entry.take(&message, NOW).expect("within the tolerance");
    assert_eq!(entry.known(NOW + TIMEOUT + 1), KnownInputs::default());
}

#[test]
fn two_bridges_send_different_inputs_never_same_ones() {
    let mut entry = entry();
    let other = MachineInputs {
        instance: 8,
        digital_mask: 1 << 63,
        digital: 1 << 63,
        analog_mask: 0,
        ..message()
    };
    entry.take(&message(), NOW).expect("one");
    entry.take(&other, NOW).expect("another");
    assert_eq!(entry.known(NOW).digital, 1 << 63 | 1 << 3);
    let thief = MachineInputs {
        instance: 9,
        ..message()
    };
    assert_eq!(entry.take(&thief, NOW), Err(InputFault::Claimed));
    // A bridge that was started again takes over once the old one is silent.
    let later = NOW + TIMEOUT + 1;
    let again = MachineInputs {
        time_ns: later,
        ..thief
    };
    entry.take(&again, later).expect("the first bridge is silent");
}
