//! The operator's state under commands and events.

use evolvent_path::AxisMask;

use evolvent_path::AXES;

use super::*;

const INPUTS: OperatorInputs = OperatorInputs {
    is_chain_open: false,
    present: AxisMask::from_bits(0b111),
    is_held: false,
    is_ending: false,
    is_away: false,
};

/// A client that numbers its commands.
struct Client(u64);

impl Client {
    fn sends(&mut self, state: &mut OperatorState, code: CommandCode, index: u32) -> Result<(), Alarm> {
        self.0 += 1;
        let raw = RawCommand {
            command: code as u32,
            axes_mask: 0,
            index,
            amount: 0.5,
            values: [0.0; AXES],
            text: Some("part.ngc"),
        };
        let command = state
            .authorize(7, self.0, &raw, &INPUTS)
            .map_err(|(_, refusal)| refusal.alarm)?;
        state.commit(&command, 0, false);
        Ok(())
    }
}

/// On, and waiting for its drives since 1000 ns.
fn waiting_for_drives() -> OperatorState {
    let mut state = OperatorState::default();
    state.commit(&OperatorCommand::EstopReset, 0, true);
    state.commit(&OperatorCommand::On, 1000, true);
    assert!(state.wants_power() && state.machine() == MachineState::Off);
    state
}

#[test]
fn drives_enabled_after_power_off_do_not_power_up() {
    type Action = fn(&mut OperatorState);
    let actions: [(Action, MachineState); 3] = [
        (
            |state| state.commit(&OperatorCommand::Estop, 2000, true),
            MachineState::Estop,
        ),
        (
            |state| state.commit(&OperatorCommand::Off, 2000, true),
            MachineState::Off,
        ),
        (OperatorState::drop_power, MachineState::Off),
    ];
    for (takes_back, expected) in actions {
        let mut state = waiting_for_drives();
        takes_back(&mut state);
        state.enable(true, 3000);
        assert_eq!((state.machine(), state.wants_power()), (expected, false));
    }
}

#[test]
fn repeated_power_requests_do_not_extend_the_timeout() {
    let mut state = waiting_for_drives();
    state.commit(&OperatorCommand::On, 1000 + ENABLE_NS, true);
    state.enable(false, 1000 + ENABLE_NS);
    assert!(!state.has_latched_alarm());
    state.enable(false, 1001 + ENABLE_NS);
    let alarms: Vec<Alarm> = state.alarms().map(|(alarm, _)| alarm).collect();
    assert_eq!(alarms, [Alarm::NotEnabled]);
}

#[test]
fn drives_have_the_time_that_was_set_and_no_more() {
    for timeout_ns in [1, 300_000_000, 2_000_000_000, 60_000_000_000] {
        let mut state = OperatorState::default();
        state.set_enable_timeout_ns(timeout_ns);
        state.commit(&OperatorCommand::EstopReset, 0, true);
        state.commit(&OperatorCommand::On, 1000, true);
        state.enable(false, 1000 + timeout_ns);
        assert!(!state.has_latched_alarm(), "{timeout_ns}");
        state.enable(false, 1001 + timeout_ns);
        assert!(state.has_latched_alarm() && !state.wants_power(), "{timeout_ns}");
    }
}

/// Sends a command that names its object; returns the reply.
fn says(
    state: &mut OperatorState,
    serial: u64,
    code: CommandCode,
    text: &str,
    is_good: bool,
) -> Result<(), Rejection> {
    let raw = RawCommand {
        command: code as u32,
        axes_mask: 0,
        index: 0,
        amount: 0.0,
        values: [0.0; AXES],
        text: Some(text),
    };
    let command = state
        .authorize(7, serial, &raw, &INPUTS)
        .map_err(|(_, refusal)| refusal)?;
    if is_good {
        state.commit(&command, 0, false);
    }
    Ok(())
}

#[test]
fn after_a_rejected_load_start_requires_a_name() {
    let mut state = OperatorState::default();
    state.set_homed(AxisMask::from_bits(0b111));
    for command in [
        OperatorCommand::EstopReset,
        OperatorCommand::On,
        OperatorCommand::SetMode(Mode::Auto),
    ] {
        state.commit(&command, 0, false);
    }
    assert_eq!(says(&mut state, 1, CommandCode::Load, "a.ngc", true), Ok(()));
    assert_eq!(says(&mut state, 2, CommandCode::Start, "", true), Ok(()));
    assert_eq!(says(&mut state, 3, CommandCode::Start, "a.ngc", true), Ok(()));
    // The second program has errors that are found later, or cannot be read at all.
    assert_eq!(says(&mut state, 4, CommandCode::Load, "b.ngc", false), Ok(()));
    for (serial, code) in [(5, CommandCode::Start), (6, CommandCode::Step)] {
        let refusal = says(&mut state, serial, code, "", true).unwrap_err();
        assert_eq!(refusal.alarm, Alarm::OtherProgram);
        assert!(refusal.text.contains("a.ngc is still loaded"), "{refusal}");
    }
    let refusal = says(&mut state, 7, CommandCode::Start, "b.ngc", true).unwrap_err();
    assert!(refusal.text.contains("a.ngc is loaded, not b.ngc"), "{refusal}");
    assert_eq!(
        says(&mut state, 8, CommandCode::Start, "a.ngc", true),
        Ok(()),
        "confirmed"
    );
    assert_eq!(says(&mut state, 9, CommandCode::Start, "", true), Ok(()));
    assert_eq!(says(&mut state, 10, CommandCode::Load, "b.ngc", true), Ok(()));
    assert_eq!(says(&mut state, 11, CommandCode::Start, "", true), Ok(()));
    // One that comes while another job has the axes is rejected by the interlocks.
    state.job_begins(Activity::Program);
    let refusal = says(&mut state, 12, CommandCode::Load, "c.ngc", true).unwrap_err();
    assert_eq!(refusal.alarm, Alarm::Busy);
    state.job_ends(JobResult::Done);
    let refusal = says(&mut state, 13, CommandCode::Start, "", true).unwrap_err();
    assert_eq!(refusal.alarm, Alarm::OtherProgram);
}

#[test]
fn one_axis_not_homed_blocks_program_start() {
    let (mut state, mut client) = (OperatorState::default(), Client(0));
    for (code, index) in [
        (CommandCode::EstopReset, 0),
        (CommandCode::On, 0),
        (CommandCode::Load, 0),
        (CommandCode::Mode, 0),
    ] {
        assert_eq!(client.sends(&mut state, code, index), Ok(()));
    }
    state.set_homed(AxisMask::from_bits(0b101));
    assert_eq!(
        client.sends(&mut state, CommandCode::Start, 0),
        Err(Alarm::NotHomed)
    );
    state.set_homed(AxisMask::from_bits(0b111));
    assert_eq!(client.sends(&mut state, CommandCode::Start, 0), Ok(()));
}

#[test]
fn a_core_that_ends_takes_no_command() {
    let raw = RawCommand {
        command: CommandCode::Estop as u32,
        axes_mask: 0,
        index: 0,
        amount: 0.0,
        values: [0.0; AXES],
        text: None,
    };
    let inputs = OperatorInputs {
        is_ending: true,
        ..INPUTS
    };
    let refused = OperatorState::default().authorize(7, 1, &raw, &inputs);
    let (verdict, refusal) = refused.expect_err("it ends");
    assert_eq!(
        (verdict, refusal.alarm),
        (CommandVerdict::Rejected, Alarm::Ending)
    );
}

#[test]
fn losing_power_keeps_emergency_stop_and_off() {
    type Action = fn(&mut OperatorState);
    let actions: [Action; 2] = [
        |state| state.commit(&OperatorCommand::Off, 0, false),
        |state| state.drop_power(),
    ];
    for action in actions {
        let mut state = OperatorState::default();
        action(&mut state);
        assert_eq!(state.machine(), MachineState::Estop);
        state.commit(&OperatorCommand::On, 0, false);
        assert_eq!(state.machine(), MachineState::Estop, "it is reset first");
        state.commit(&OperatorCommand::EstopReset, 0, false);
        action(&mut state);
        assert_eq!(state.machine(), MachineState::Off);
        state.commit(&OperatorCommand::On, 0, false);
        assert_eq!(state.machine(), MachineState::On);
        action(&mut state);
        assert_eq!(state.machine(), MachineState::Off);
    }
}

#[test]
fn a_rejection_for_an_alarm_names_the_alarm() {
    let refusal = |state: &mut OperatorState, serial: u64| {
        let raw = RawCommand {
            command: CommandCode::Home as u32,
            axes_mask: 0,
            index: 0,
            amount: 0.0,
            values: [0.0; AXES],
            text: None,
        };
        state.authorize(7, serial, &raw, &INPUTS).unwrap_err().1
    };
    let mut state = OperatorState::default();
    state.raise(Alarm::DriveFault, "axis X");
    // In emergency stop that is the reason, whichever alarms are latched.
    let first = refusal(&mut state, 1);
    assert_eq!(first, Rejection::by_rule(Alarm::InEstop, CommandCode::Home));
    state.commit(&OperatorCommand::EstopReset, 0, false);
    state.commit(&OperatorCommand::On, 0, false);
    let number = Alarm::DriveFault.number();
    assert_eq!(
        refusal(&mut state, 2).text,
        format!("alarm {number} is latched: axis X")
    );
}

#[test]
fn each_switch_and_override_is_one_of_its_own() {
    let mut state = OperatorState::default();
    let switches_and_overrides = |state: &OperatorState| {
        let switches = [
            state.is_single_step(),
            state.is_optional_stop(),
            state.is_block_delete(),
        ];
        (switches, state.overrides())
    };
    assert_eq!(switches_and_overrides(&state), ([false; 3], [1.0; 3]));
    state.commit(&OperatorCommand::BlockDelete(true), 0, false);
    assert_eq!(switches_and_overrides(&state).0, [false, false, true]);
    state.commit(&OperatorCommand::OptionalStop(true), 0, false);
    assert_eq!(switches_and_overrides(&state).0, [false, true, true]);
    state.commit(&OperatorCommand::SingleStep(true), 0, false);
    state.commit(&OperatorCommand::BlockDelete(false), 0, false);
    assert_eq!(switches_and_overrides(&state).0, [true, true, false]);
    state.commit(&OperatorCommand::SingleStep(false), 0, false);
    state.commit(&OperatorCommand::Step, 0, false);
    assert_eq!(
        switches_and_overrides(&state).0,
        [true, true, false],
        "a step switches it on"
    );
    assert_eq!(state.program(), None);
    state.commit(&OperatorCommand::Load("part.ngc".to_owned()), 0, false);
    assert_eq!(state.program(), Some("part.ngc"));
    state.commit(&OperatorCommand::FeedOverride(0.5), 0, false);
    state.commit(&OperatorCommand::RapidOverride(0.25), 0, false);
    state.commit(&OperatorCommand::SpindleOverride(0.75), 0, false);
    assert_eq!(switches_and_overrides(&state).1, [0.5, 0.25, 0.75]);
}

#[test]
fn a_job_ends_once() {
    let mut state = OperatorState::default();
    assert_eq!(
        (state.job(), state.job_begins(Activity::Jog), state.job()),
        (0, 1, 1)
    );
    state.job_ends(JobResult::Done);
    assert_eq!((state.job_begins(Activity::Jog), state.job()), (2, 2));
    state.job_ends(JobResult::Stopped);
    state.job_ends(JobResult::Fault);
    assert_eq!(state.result(), JobResult::Stopped);
}

#[test]
fn a_machine_is_brought_up_in_order_and_in_no_other() {
    let (mut state, mut client) = (OperatorState::default(), Client(0));
    assert_eq!(client.sends(&mut state, CommandCode::On, 0), Err(Alarm::InEstop));
    assert_eq!(client.sends(&mut state, CommandCode::EstopReset, 0), Ok(()));
    assert_eq!(client.sends(&mut state, CommandCode::Home, 0), Err(Alarm::IsOff));
    assert_eq!(client.sends(&mut state, CommandCode::On, 0), Ok(()));
    assert_eq!(client.sends(&mut state, CommandCode::Home, 0), Ok(()));
    assert_eq!(
        client.sends(&mut state, CommandCode::Mode, Mode::Auto as u32),
        Ok(())
    );
    assert_eq!(
        client.sends(&mut state, CommandCode::Start, 0),
        Err(Alarm::NoProgram)
    );
    assert_eq!(client.sends(&mut state, CommandCode::Load, 0), Ok(()));
    assert_eq!(
        client.sends(&mut state, CommandCode::Start, 0),
        Err(Alarm::NotHomed)
    );
    state.set_homed(AxisMask::from_bits(0b111));
    assert_eq!(state.homed().bits(), 0b111);
    assert_eq!(client.sends(&mut state, CommandCode::Start, 0), Ok(()));
    assert_eq!(state.job_begins(Activity::Program), 1);
    assert_eq!(client.sends(&mut state, CommandCode::Start, 0), Err(Alarm::Busy));
    assert_eq!(
        client.sends(&mut state, CommandCode::Step, 0),
        Err(Alarm::NotHeld)
    );
    assert_eq!(client.sends(&mut state, CommandCode::Off, 0), Err(Alarm::Busy));
    assert_eq!(client.sends(&mut state, CommandCode::Estop, 0), Ok(()));
    state.job_ends(JobResult::Stopped);
    assert_eq!(
        (state.machine(), state.result()),
        (MachineState::Estop, JobResult::Stopped)
    );
}

#[test]
fn whatever_is_refused_changes_nothing_but_the_counts() {
    let (mut state, mut client) = (OperatorState::default(), Client(0));
    client.sends(&mut state, CommandCode::EstopReset, 0).unwrap();
    client.sends(&mut state, CommandCode::FeedOverride, 0).unwrap();
    let before = (
        state.machine(),
        state.mode(),
        state.overrides(),
        state.program().map(str::to_owned),
    );
    let good = RawCommand {
        command: CommandCode::FeedOverride as u32,
        axes_mask: 0,
        index: 0,
        amount: 2.0,
        values: [0.0; AXES],
        text: None,
    };
    let nan = RawCommand {
        amount: f64::NAN,
        ..good
    };
    for (client, serial, raw, verdict) in [
        (0, 99, good, CommandVerdict::Rejected),
        (7, 0, good, CommandVerdict::Rejected),
        (7, 2, good, CommandVerdict::Stale),
        (7, 1, good, CommandVerdict::Stale),
        (7, 99, nan, CommandVerdict::Rejected),
        (7, 99, good, CommandVerdict::Stale),
    ] {
        let refused = state.authorize(client, serial, &raw, &INPUTS).unwrap_err();
        assert_eq!(refused.0, verdict, "{client} {serial}");
    }
    assert_eq!(
        before,
        (
            state.machine(),
            state.mode(),
            state.overrides(),
            state.program().map(str::to_owned)
        )
    );
    assert_eq!(state.counts(), (2, 6));
}

#[test]
fn faults_latch_and_alarms_of_a_job_end_with_the_next() {
    let (mut state, mut client) = (OperatorState::default(), Client(0));
    client.sends(&mut state, CommandCode::EstopReset, 0).unwrap();
    client.sends(&mut state, CommandCode::On, 0).unwrap();
    state.raise(Alarm::Program, "line 7 ...");
    assert!(!state.has_latched_alarm());
    state.job_begins(Activity::Program);
    assert_eq!(state.alarms().count(), 0);
    state.raise(Alarm::DriveFault, "axis X");
    state.raise(Alarm::DriveFault, "axis Y");
    state.job_ends(JobResult::Fault);
    assert_eq!(
        state.alarms().collect::<Vec<_>>(),
        [(Alarm::DriveFault, "axis X")]
    );
    assert_eq!(
        client.sends(&mut state, CommandCode::Home, 0),
        Err(Alarm::Latched)
    );
    state.job_begins(Activity::Jog);
    state.job_ends(JobResult::Done);
    assert!(state.has_latched_alarm());
    client.sends(&mut state, CommandCode::ClearAlarms, 0).unwrap();
    assert_eq!(client.sends(&mut state, CommandCode::Home, 0), Ok(()));
}

#[test]
fn a_latching_alarm_is_listed_among_many_others() {
    let kinds = |latched: bool| {
        Alarm::ALL
            .iter()
            .copied()
            .filter(move |alarm| alarm.is_latched() == latched)
    };
    let mut state = OperatorState::default();
    for alarm in kinds(false).take(MAX_ALARMS) {
        state.raise(alarm, "no fault");
    }
    assert!(!state.has_latched_alarm());
    state.raise(Alarm::DriveFault, "axis X");
    assert!(state.has_latched_alarm());
    assert_eq!((state.alarms().count(), state.unlisted_alarms()), (MAX_ALARMS, 1));
    assert_eq!(state.alarms().next(), Some((Alarm::DriveFault, "axis X")));
    // With latching alarms only: the cause, whose sentence the status shows, and the newest.
    for alarm in kinds(true) {
        state.raise(alarm, "a fault");
    }
    let newest = kinds(true).next_back().unwrap();
    assert_eq!(state.alarms().next(), Some((Alarm::DriveFault, "axis X")));
    assert_eq!(state.alarms().last(), Some((newest, "a fault")));
    assert!(state.alarms().all(|(alarm, _)| alarm.is_latched()));
    state.clear_alarms();
    assert_eq!((state.alarms().count(), state.unlisted_alarms()), (0, 0));
}

#[test]
fn the_first_of_the_alarms_is_their_cause() {
    let mut state = OperatorState::default();
    let listed = |state: &OperatorState| state.alarms().map(|(alarm, _)| alarm).collect::<Vec<_>>();
    state.raise(Alarm::Trace, "the disk is full");
    state.raise(Alarm::NotKept, "the disk is full");
    assert_eq!(listed(&state), [Alarm::Trace, Alarm::NotKept]);
    state.raise(Alarm::Mdi, "no such code");
    assert_eq!(listed(&state), [Alarm::Mdi, Alarm::Trace, Alarm::NotKept]);
    // A bridge that is silent, then the consequences.
    state.raise(Alarm::FeedbackStale, "the bridge is silent");
    state.raise(Alarm::ReferenceLost, "home X again");
    state.raise(Alarm::DriveFault, "axis X");
    let expected = [
        Alarm::FeedbackStale,
        Alarm::Trace,
        Alarm::NotKept,
        Alarm::Mdi,
        Alarm::ReferenceLost,
        Alarm::DriveFault,
    ];
    assert_eq!(listed(&state), expected);
    state.clear_alarms();
    state.raise(Alarm::ReferenceLost, "home X again");
    assert_eq!(listed(&state), [Alarm::ReferenceLost]);
}

#[test]
fn drives_not_enabled_in_time_raise_an_alarm() {
    let mut state = OperatorState::default();
    state.commit(&OperatorCommand::EstopReset, 0, true);
    state.commit(&OperatorCommand::On, 1_000, true);
    assert_eq!((state.machine(), state.wants_power()), (MachineState::Off, true));
    state.enable(false, 1_000 + ENABLE_NS);
    assert!(state.wants_power());
    state.enable(false, 1_001 + ENABLE_NS);
    assert!(!state.wants_power() && state.has_latched_alarm());
    state.commit(&OperatorCommand::ClearAlarms, 0, true);
    state.commit(&OperatorCommand::On, 0, true);
    state.enable(true, 10);
    assert_eq!(state.machine(), MachineState::On);
}

#[test]
fn an_open_chain_is_an_emergency_stop() {
    let open = OperatorInputs {
        is_chain_open: true,
        ..INPUTS
    };
    let raw = |code: CommandCode| RawCommand {
        command: code as u32,
        axes_mask: 0,
        index: 0,
        amount: 0.0,
        values: [0.0; AXES],
        text: Some(""),
    };
    let mut state = OperatorState::default();
    let (verdict, refusal) = state
        .authorize(7, 1, &raw(CommandCode::EstopReset), &open)
        .unwrap_err();
    assert_eq!(
        (verdict, refusal.alarm),
        (CommandVerdict::Rejected, Alarm::ChainOpen)
    );
    let reset = state
        .authorize(7, 2, &raw(CommandCode::EstopReset), &INPUTS)
        .unwrap();
    state.commit(&reset, 0, true);
    state.commit(&OperatorCommand::On, 1000, true);
    state.fall_into_estop();
    assert!(state.machine() == MachineState::Estop && !state.wants_power());
    state.enable(true, 2000);
    assert_eq!(state.machine(), MachineState::Estop);
}
