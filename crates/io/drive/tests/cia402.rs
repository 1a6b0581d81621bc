//! CiA 402 compared with the tables of the standard, written here as the standard prints them.

use evolvent_drive::{
    Braking, CYCLIC_SYNCHRONOUS_POSITION, Cia402, DriveEvents, DriveMachine, DriveState, PowerRequest,
    QuickStopOption, control,
};

/// The table of status words: bit 15 to bit 0, `x` for bits that do not depend on the state.
const STATUS_WORDS: [(DriveState, &str); 8] = [
    (DriveState::NotReadyToSwitchOn, "xxxx xxxx x0xx 0000"),
    (DriveState::SwitchOnDisabled, "xxxx xxxx x1xx 0000"),
    (DriveState::ReadyToSwitchOn, "xxxx xxxx x01x 0001"),
    (DriveState::SwitchedOn, "xxxx xxxx x01x 0011"),
    (DriveState::OperationEnabled, "xxxx xxxx x01x 0111"),
    (DriveState::QuickStopActive, "xxxx xxxx x00x 0111"),
    (DriveState::FaultReactionActive, "xxxx xxxx x0xx 1111"),
    (DriveState::Fault, "xxxx xxxx x0xx 1000"),
];

fn matches(word: u16, pattern: &str) -> bool {
    let bits = pattern.chars().filter(|c| *c != ' ');
    bits.enumerate().all(|(i, bit)| match bit {
        'x' => true,
        bit => (word >> (15 - i) & 1 == 1) == (bit == '1'),
    })
}

#[test]
fn every_status_word_decodes_to_one_state_of_table() {
    for word in 0..=u16::MAX {
        let rows: Vec<DriveState> = STATUS_WORDS
            .iter()
            .filter(|(_, pattern)| matches(word, pattern))
            .map(|(state, _)| *state)
            .collect();
        assert!(rows.len() <= 1, "{word:#06x} {rows:?}");
        assert_eq!(DriveState::decode(word), rows.first().copied(), "{word:#06x}");
    }
}

#[test]
fn drive_reports_status_word_of_its_state() {
    let mut drive = DriveMachine::new(QuickStopOption::ThenDisabled);
    for word in [0, 0x06, 0x07, 0x0F, 0x02] {
        let state = drive.step(
            word,
            DriveEvents {
                ready: true,
                ..DriveEvents::default()
            },
        );
        assert_eq!(DriveState::decode(drive.status_word()), Some(state));
        assert_eq!(DriveState::decode(state.code()), Some(state));
    }
}

/// The commands of the control word, bit 7 to bit 0, as the standard's table prints them.
const COMMANDS: [(&str, &str); 7] = [
    ("shutdown", "0xxx x110"),
    ("switch on", "0xxx 0111"),
    ("switch on and enable", "0xxx 1111"),
    ("disable voltage", "0xxx xx0x"),
    ("quick stop", "0xxx x01x"),
    ("disable operation", "0xxx 0111"),
    ("enable operation", "0xxx 1111"),
];

/// The transitions: number, initial state, command, final state.
const TRANSITIONS: [(u8, DriveState, &str, DriveState); 15] = {
    use DriveState::{
        OperationEnabled as OE, QuickStopActive as QSA, ReadyToSwitchOn as RTSO, SwitchOnDisabled as SOD,
        SwitchedOn as SO,
    };
    [
        (2, SOD, "shutdown", RTSO),
        (3, RTSO, "switch on", SO),
        (3, RTSO, "switch on and enable", SO),
        (4, SO, "enable operation", OE),
        (5, OE, "disable operation", SO),
        (6, SO, "shutdown", RTSO),
        (7, RTSO, "disable voltage", SOD),
        (7, RTSO, "quick stop", SOD),
        (8, OE, "shutdown", RTSO),
        (9, OE, "disable voltage", SOD),
        (10, SO, "disable voltage", SOD),
        (10, SO, "quick stop", SOD),
        (11, OE, "quick stop", QSA),
        (12, QSA, "disable voltage", SOD),
        (16, QSA, "enable operation", OE),
    ]
};

/// A drive in a state that it has reached by control words alone.
fn drive_in(state: DriveState, option: QuickStopOption) -> DriveMachine {
    let ready = DriveEvents {
        ready: true,
        ..DriveEvents::default()
    };
    let fault = DriveEvents {
        fault: Some(0x8611),
        ..ready
    };
    let mut drive = DriveMachine::new(option);
    let transitions: &[(u16, DriveEvents)] = match state {
        DriveState::NotReadyToSwitchOn => &[],
        DriveState::SwitchOnDisabled => &[(0, ready)],
        DriveState::ReadyToSwitchOn => &[(0, ready), (0x06, ready)],
        DriveState::SwitchedOn => &[(0, ready), (0x06, ready), (0x07, ready)],
        DriveState::OperationEnabled => &[(0, ready), (0x06, ready), (0x07, ready), (0x0F, ready)],
        DriveState::QuickStopActive => &[
            (0, ready),
            (0x06, ready),
            (0x07, ready),
            (0x0F, ready),
            (0x02, ready),
        ],
        DriveState::FaultReactionActive => &[(0, ready), (0, fault)],
        DriveState::Fault => &[
            (0, ready),
            (0, fault),
            (
                0,
                DriveEvents {
                    at_rest: true,
                    ..ready
                },
            ),
        ],
    };
    for (word, events) in transitions {
        drive.step(*word, *events);
    }
    assert_eq!(drive.state(), state);
    drive
}

#[test]
fn transitions_follow_table_for_every_control_word() {
    let moving = DriveEvents {
        ready: true,
        ..DriveEvents::default()
    };
    for (state, _) in STATUS_WORDS {
        if state == DriveState::NotReadyToSwitchOn {
            continue;
        }
        // Bits 4 to 6 belong to the mode, 8 to 15 to other things: they change nothing.
        for word in (0..0x80_u16).chain((0..0x80).map(|word| word | 0xFF00)) {
            let mut drive = drive_in(state, QuickStopOption::ThenStay);
            let low = word & 0xFF;
            let wanted = TRANSITIONS
                .iter()
                .filter(|(_, from, _, _)| *from == state)
                .find(|(_, _, command, _)| {
                    COMMANDS
                        .iter()
                        .any(|(name, pattern)| name == command && matches(low, &format!("xxxxxxxx{pattern}")))
                })
                .map_or(state, |(_, _, _, to)| *to);
            assert_eq!(drive.step(word, moving), wanted, "{state:?} {word:#06x}");
        }
    }
}

#[test]
fn quick_stop_ends_disabled_or_stays_by_option() {
    let rest = DriveEvents {
        ready: true,
        at_rest: true,
        fault: None,
    };
    let mut drive = drive_in(DriveState::QuickStopActive, QuickStopOption::ThenDisabled);
    assert_eq!(
        drive.step(
            control::QUICK_STOP,
            DriveEvents {
                at_rest: false,
                ..rest
            }
        ),
        DriveState::QuickStopActive
    );
    assert!(drive.has_torque());
    assert_eq!(
        drive.step(control::QUICK_STOP, rest),
        DriveState::SwitchOnDisabled
    );
    let mut drive = drive_in(DriveState::QuickStopActive, QuickStopOption::ThenStay);
    assert_eq!(drive.step(control::QUICK_STOP, rest), DriveState::QuickStopActive);
    assert_eq!(
        drive.step(control::ENABLE_OPERATION, rest),
        DriveState::OperationEnabled
    );
}

#[test]
fn fault_brakes_first_and_reset_needs_edge_and_cause() {
    for (state, _) in STATUS_WORDS {
        if state.is_fault() || state == DriveState::NotReadyToSwitchOn {
            continue;
        }
        let mut drive = drive_in(state, QuickStopOption::ThenDisabled);
        let there = DriveEvents {
            ready: true,
            at_rest: false,
            fault: Some(0x7500),
        };
        assert_eq!(drive.step(0x0F, there), DriveState::FaultReactionActive);
        assert_eq!(drive.error_code(), 0x7500);
        assert_eq!(
            drive.step(0x8F, there),
            DriveState::FaultReactionActive,
            "braking"
        );
        assert_eq!(
            drive.step(
                0x0F,
                DriveEvents {
                    at_rest: true,
                    ..there
                }
            ),
            DriveState::Fault
        );
        let rest = DriveEvents {
            at_rest: true,
            ..there
        };
        assert_eq!(
            drive.step(0x80, rest),
            DriveState::Fault,
            "the cause is still there"
        );
        let gone = DriveEvents { fault: None, ..rest };
        assert_eq!(drive.step(0x80, gone), DriveState::Fault, "no edge");
        assert_eq!(drive.step(0x00, gone), DriveState::Fault);
        assert_eq!(drive.step(0x80, gone), DriveState::SwitchOnDisabled);
        assert_eq!(drive.error_code(), 0);
    }
}

/// Controller and drive together, one period each.
struct Pair {
    controller: Cia402,
    drive: DriveMachine,
    events: DriveEvents,
    /// `None` without a core.
    resets: Option<u32>,
    braking: Braking,
}

impl Pair {
    fn new() -> Self {
        Self {
            controller: Cia402::new(),
            drive: DriveMachine::new(QuickStopOption::ThenDisabled),
            events: DriveEvents {
                ready: true,
                at_rest: true,
                fault: None,
            },
            resets: Some(0),
            braking: Braking {
                period_s: 1e-3,
                is_standing: None,
            },
        }
    }

    fn run(&mut self, request: PowerRequest, periods: usize) -> DriveState {
        for _ in 0..periods {
            let order = self.controller.step(
                self.drive.status_word(),
                request,
                self.resets,
                7.0,
                3.0,
                self.braking,
            );
            assert_eq!(order.mode_of_operation, CYCLIC_SYNCHRONOUS_POSITION);
            let enabled = self.drive.state() == DriveState::OperationEnabled;
            assert!(!order.follows || enabled);
            assert_eq!(order.target_position, if order.follows { 7.0 } else { 3.0 });
            self.drive.step(order.control_word, self.events);
        }
        self.drive.state()
    }
}

#[test]
fn fresh_drive_enables_in_four_periods_without_motion() {
    let mut pair = Pair::new();
    assert_eq!(pair.run(PowerRequest::On, 4), DriveState::OperationEnabled);
    // The target is checked in each period by `run`: actual position before, setpoint from here on.
    assert_eq!(pair.run(PowerRequest::On, 1), DriveState::OperationEnabled);
    assert_eq!(pair.run(PowerRequest::Off, 4), DriveState::SwitchOnDisabled);
}

#[test]
fn power_after_fault_needs_reset_and_new_request() {
    let mut pair = Pair::new();
    pair.run(PowerRequest::On, 5);
    pair.events.fault = Some(0x8611);
    assert_eq!(pair.run(PowerRequest::On, 3), DriveState::Fault);
    pair.events.fault = None;
    assert_eq!(
        pair.run(PowerRequest::On, 50),
        DriveState::Fault,
        "no reset was asked for"
    );
    pair.resets = pair.resets.map(|count| count + 1);
    assert_eq!(pair.run(PowerRequest::On, 1), DriveState::SwitchOnDisabled);
    assert_eq!(pair.controller.resets_done(), 1);
    assert_eq!(
        pair.run(PowerRequest::On, 50),
        DriveState::SwitchOnDisabled,
        "the request was there before the fault"
    );
    assert!(pair.controller.is_locked_out());
    pair.run(PowerRequest::Off, 1);
    assert_eq!(pair.run(PowerRequest::On, 5), DriveState::OperationEnabled);
}

#[test]
fn one_growth_of_the_counter_is_one_edge() {
    let mut controller = Cia402::new();
    let fault = DriveState::Fault.code();
    let words: Vec<u16> = [0, 1, 1, 1, 2, 2, 3, 4, 4, 4]
        .into_iter()
        .map(|resets| {
            controller
                .step(
                    fault,
                    PowerRequest::Off,
                    Some(resets),
                    0.0,
                    0.0,
                    Braking::default(),
                )
                .control_word
        })
        .collect();
    assert_eq!(words, [0, 0x80, 0, 0, 0x80, 0, 0x80, 0, 0x80, 0]);
    // A reset requested without a fault does not reset a later fault.
    controller.step(
        DriveState::SwitchOnDisabled.code(),
        PowerRequest::Off,
        Some(9),
        0.0,
        0.0,
        Braking::default(),
    );
    assert_eq!(
        controller
            .step(fault, PowerRequest::Off, Some(9), 0.0, 0.0, Braking::default())
            .control_word,
        0
    );
}

#[test]
fn the_counter_of_another_core_is_no_request() {
    let mut controller = Cia402::new();
    let fault = DriveState::Fault.code();
    // A core with an earlier count, a restart from 0, and one without a period in between; then an overflow.
    let counts = [
        None,
        Some(3),
        Some(3),
        None,
        Some(0),
        Some(0),
        None,
        Some(7),
        Some(2),
    ];
    for count in counts.into_iter().chain([None, Some(u32::MAX)]) {
        let order = controller.step(fault, PowerRequest::Off, count, 0.0, 0.0, Braking::default());
        assert_eq!(order.control_word, 0, "{count:?}");
    }
    let order = controller.step(fault, PowerRequest::Off, Some(0), 0.0, 0.0, Braking::default());
    assert_eq!((order.control_word, controller.resets_done()), (0x80, 0));
}

#[test]
fn quick_stop_ends_without_torque_until_new_request() {
    let mut pair = Pair::new();
    pair.run(PowerRequest::On, 5);
    pair.events.at_rest = false;
    assert_eq!(pair.run(PowerRequest::QuickStop, 3), DriveState::QuickStopActive);
    // Power requested while it brakes: first the stop, then off.
    assert_eq!(pair.run(PowerRequest::On, 200), DriveState::QuickStopActive);
    pair.events.at_rest = true;
    assert_eq!(pair.run(PowerRequest::On, 2), DriveState::SwitchOnDisabled);
    assert_eq!(pair.run(PowerRequest::On, 50), DriveState::SwitchOnDisabled);
}

/// A core that is silent briefly while the drives come into operation has not requested *off*.
#[test]
fn power_that_is_off_without_a_core_unlocks_nothing() {
    let mut pair = Pair::new();
    pair.run(PowerRequest::On, 5);
    pair.run(PowerRequest::QuickStop, 1);
    assert_eq!(pair.run(PowerRequest::On, 5), DriveState::SwitchOnDisabled);
    pair.resets = None;
    pair.run(PowerRequest::Off, 5);
    pair.resets = Some(0);
    assert_eq!(pair.run(PowerRequest::On, 50), DriveState::SwitchOnDisabled);
    pair.run(PowerRequest::Off, 1);
    assert_eq!(pair.run(PowerRequest::On, 5), DriveState::OperationEnabled);
}

/// The core commands rest long before a drive with a longer ramp (object 6085h) has stopped.
#[test]
fn power_off_does_not_cut_ramp_of_braking_drive() {
    for end in [
        |pair: &mut Pair| pair.events.at_rest = true,
        // For a drive that stays in quick stop active (605Ah 5 to 8), standstill is detected by its position.
        |pair: &mut Pair| pair.braking.is_standing = Some(true),
    ] {
        let mut pair = Pair::new();
        pair.run(PowerRequest::On, 5);
        pair.events.at_rest = false;
        pair.braking.is_standing = Some(false);
        pair.run(PowerRequest::QuickStop, 50);
        assert_eq!(pair.run(PowerRequest::Off, 1500), DriveState::QuickStopActive);
        end(&mut pair);
        assert_eq!(pair.run(PowerRequest::Off, 2), DriveState::SwitchOnDisabled);
        pair.events.at_rest = true;
        assert_eq!(pair.run(PowerRequest::On, 5), DriveState::OperationEnabled);
    }
}

/// A drive that does not stop, or whose speed is unknown, finally loses its voltage.
#[test]
fn drive_that_never_stops_is_disabled_after_2_s() {
    for is_standing in [None, Some(false)] {
        let mut pair = Pair::new();
        pair.run(PowerRequest::On, 5);
        pair.events.at_rest = false;
        pair.braking.is_standing = is_standing;
        // The request itself has no time limit.
        assert_eq!(
            pair.run(PowerRequest::QuickStop, 5000),
            DriveState::QuickStopActive
        );
        assert_eq!(pair.run(PowerRequest::Off, 1999), DriveState::QuickStopActive);
        assert_eq!(pair.run(PowerRequest::Off, 3), DriveState::SwitchOnDisabled);
    }
}

#[test]
fn a_fault_reaction_keeps_its_voltage_as_long() {
    let mut controller = Cia402::new();
    let mut word = |request, is_standing, periods: usize| {
        let braking = Braking {
            period_s: 1e-3,
            is_standing,
        };
        let status = DriveState::FaultReactionActive.code();
        (0..periods)
            .map(|_| {
                controller
                    .step(status, request, None, 0.0, 0.0, braking)
                    .control_word
            })
            .last()
    };
    assert_eq!(word(PowerRequest::Off, None, 1999), Some(control::QUICK_STOP));
    assert_eq!(word(PowerRequest::Off, None, 10), Some(control::DISABLE_VOLTAGE));
    let mut controller = Cia402::new();
    let braking = Braking {
        period_s: 1e-3,
        is_standing: Some(true),
    };
    let order = controller.step(
        DriveState::FaultReactionActive.code(),
        PowerRequest::On,
        None,
        0.0,
        0.0,
        braking,
    );
    assert_eq!(order.control_word, control::DISABLE_VOLTAGE);
}

#[test]
fn unknown_status_word_or_nan_setpoint_moves_nothing() {
    let mut controller = Cia402::new();
    let order = controller.step(0x6F, PowerRequest::On, None, 1.0, 2.0, Braking::default());
    assert_eq!(
        (order.control_word, order.target_position),
        (control::DISABLE_VOLTAGE, 2.0)
    );
    let order = controller.step(0x27, PowerRequest::On, None, f64::NAN, 2.0, Braking::default());
    assert!(!order.follows);
    assert_eq!(order.target_position, 2.0);
}
