//! The operator's state under commands and events.

use evolvent_path::AxisMask;

use evolvent_path::AXES;

use super::*;

const FACTS: OperatorInputs = OperatorInputs {
    is_chain_open: false,
    present: AxisMask::from_bits(0b111),
    is_held: false,
    is_ending: false,
    is_away: false,
};

/// A client that numbers its commands.
struct Client(u64);

impl Client {
    fn sends(&mut self, desk: &mut OperatorState, code: CommandCode, index: u32) -> Result<(), Alarm> {
        self.0 += 1;
        let raw = RawCommand {
            command: code as u32,
            axes_mask: 0,
            index,
            amount: 0.5,
            values: [0.0; AXES],
            text: Some("part.ngc"),
        };
        let command = desk
            .authorize(7, self.0, &raw, &FACTS)
            .map_err(|(_, refusal)| refusal.alarm)?;
        desk.commit(&command, 0, false);
        Ok(())
    }
}

/// On, and waiting for its drives since 1000 ns.
fn waiting_for_drives() -> OperatorState {
    let mut desk = OperatorState::default();
    desk.commit(&OperatorCommand::EstopReset, 0, true);
    desk.commit(&OperatorCommand::On, 1000, true);
    assert!(desk.wants_power() && desk.machine() == MachineState::Off);
    desk
}

#[test]
fn drives_enabled_after_power_off_do_not_power_up() {
    type Way = fn(&mut OperatorState);
    let ways: [(Way, MachineState); 3] = [
        (
            |desk| desk.commit(&OperatorCommand::Estop, 2000, true),
            MachineState::Estop,
        ),
        (
            |desk| desk.commit(&OperatorCommand::Off, 2000, true),
            MachineState::Off,
        ),
        (OperatorState::drop_power, MachineState::Off),
    ];
    for (takes_back, state) in ways {
        let mut desk = waiting_for_drives();
        takes_back(&mut desk);
        desk.enable(true, 3000);
        assert_eq!((desk.machine(), desk.wants_power()), (state, false));
    }
}

#[test]
fn repeated_power_requests_do_not_extend_the_timeout() {
    let mut desk = waiting_for_drives();
    desk.commit(&OperatorCommand::On, 1000 + ENABLE_NS, true);
    desk.enable(false, 1000 + ENABLE_NS);
    assert!(!desk.has_latched_alarm());
    desk.enable(false, 1001 + ENABLE_NS);
    let alarms: Vec<Alarm> = desk.alarms().map(|(alarm, _)| alarm).collect();
    assert_eq!(alarms, [Alarm::NotEnabled]);
}

#[test]
fn drives_have_the_time_that_was_set_and_no_more() {
    for timeout_ns in [1, 300_000_000, 2_000_000_000, 60_000_000_000] {
        let mut desk = OperatorState::default();
        desk.set_enable_timeout_ns(timeout_ns);
        desk.commit(&OperatorCommand::EstopReset, 0, true);
        desk.commit(&OperatorCommand::On, 1000, true);
        desk.enable(false, 1000 + timeout_ns);
        assert!(!desk.has_latched_alarm(), "{timeout_ns}");
        desk.enable(false, 1001 + timeout_ns);
        assert!(desk.has_latched_alarm() && !desk.wants_power(), "{timeout_ns}");
    }
}

/// Sends a command that names its object; returns the reply.
fn says(
    desk: &mut OperatorState,
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
    let command = desk
        .authorize(7, serial, &raw, &FACTS)
        .map_err(|(_, refusal)| refusal)?;
    if is_good {
        desk.commit(&command, 0, false);
    }
    Ok(())
}

#[test]
fn after_a_rejected_load_start_requires_a_name() {
    let mut desk = OperatorState::default();
    desk.set_homed(AxisMask::from_bits(0b111));
    for command in [
        OperatorCommand::EstopReset,
        OperatorCommand::On,
        OperatorCommand::SetMode(Mode::Auto),
    ] {
        desk.commit(&command, 0, false);
    }
    assert_eq!(says(&mut desk, 1, CommandCode::Load, "a.ngc", true), Ok(()));
    assert_eq!(says(&mut desk, 2, CommandCode::Start, "", true), Ok(()));
    assert_eq!(says(&mut desk, 3, CommandCode::Start, "a.ngc", true), Ok(()));
    // The second program has errors that are found later, or cannot be read at all.
    assert_eq!(says(&mut desk, 4, CommandCode::Load, "b.ngc", false), Ok(()));
    for (serial, code) in [(5, CommandCode::Start), (6, CommandCode::Step)] {
        let refusal = says(&mut desk, serial, code, "", true).unwrap_err();
        assert_eq!(refusal.alarm, Alarm::OtherProgram);
        assert!(refusal.text.contains("a.ngc is still loaded"), "{refusal}");
    }
    let refusal = says(&mut desk, 7, CommandCode::Start, "b.ngc", true).unwrap_err();
    assert!(refusal.text.contains("a.ngc is loaded, not b.ngc"), "{refusal}");
    assert_eq!(
        says(&mut desk, 8, CommandCode::Start, "a.ngc", true),
        Ok(()),
        "confirmed"
    );
    assert_eq!(says(&mut desk, 9, CommandCode::Start, "", true), Ok(()));
    assert_eq!(says(&mut desk, 10, CommandCode::Load, "b.ngc", true), Ok(()));
    assert_eq!(says(&mut desk, 11, CommandCode::Start, "", true), Ok(()));
    // One that comes while another job has the axes is rejected by the interlocks.
    desk.job_begins(Activity::Program);
    let refusal = says(&mut desk, 12, CommandCode::Load, "c.ngc", true).unwrap_err();
    assert_eq!(refusal.alarm, Alarm::Busy);
    desk.job_ends(JobResult::Done);
    let refusal = says(&mut desk, 13, CommandCode::Start, "", true).unwrap_err();
    assert_eq!(refusal.alarm, Alarm::OtherProgram);
}

#[test]
fn one_axis_not_homed_blocks_program_start() {
    let (mut desk, mut client) = (OperatorState::default(), Client(0));
    for (code, index) in [
        (CommandCode::EstopReset, 0),
        (CommandCode::On, 0),
        (CommandCode::Load, 0),
        (CommandCode::Mode, 0),
    ] {
        assert_eq!(client.sends(&mut desk, code, index), Ok(()));
    }
    desk.set_homed(AxisMask::from_bits(0b101));
    assert_eq!(
        client.sends(&mut desk, CommandCode::Start, 0),
        Err(Alarm::NotHomed)
    );
    desk.set_homed(AxisMask::from_bits(0b111));
    assert_eq!(client.sends(&mut desk, CommandCode::Start, 0), Ok(()));
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
    let facts = OperatorInputs {
        is_ending: true,
        ..FACTS
    };
    let refused = OperatorState::default().authorize(7, 1, &raw, &facts);
    let (verdict, refusal) = refused.expect_err("it ends");
    assert_eq!(
        (verdict, refusal.alarm),
        (CommandVerdict::Rejected, Alarm::Ending)
    );
}

#[test]
fn losing_power_keeps_emergency_stop_and_off() {
    type Way = fn(&mut OperatorState);
    let ways: [Way; 2] = [
        |desk| desk.commit(&OperatorCommand::Off, 0, false),
        |desk| desk.drop_power(),
    ];
    for way in ways {
        let mut desk = OperatorState::default();
        way(&mut desk);
        assert_eq!(desk.machine(), MachineState::Estop);
        desk.commit(&OperatorCommand::On, 0, false);
        assert_eq!(desk.machine(), MachineState::Estop, "it is reset first");
        desk.commit(&OperatorCommand::EstopReset, 0, false);
        way(&mut desk);
        assert_eq!(desk.machine(), MachineState::Off);
        desk.commit(&OperatorCommand::On, 0, false);
        assert_eq!(desk.machine(), MachineState::On);
        way(&mut desk);
        assert_eq!(desk.machine(), MachineState::Off);
    }
}

#[test]
fn a_rejection_for_an_alarm_names_the_alarm() {
    let refusal = |desk: &mut OperatorState, serial: u64| {
        let raw = RawCommand {
            command: CommandCode::Home as u32,
            axes_mask: 0,
            index: 0,
            amount: 0.0,
            values: [0.0; AXES],
            text: None,
        };
        desk.authorize(7, serial, &raw, &FACTS).unwrap_err().1
    };
    let mut desk = OperatorState::default();
    desk.raise(Alarm::DriveFault, "axis X");
    // In emergency stop that is the reason, whichever alarms are latched.
    let first = refusal(&mut desk, 1);
    assert_eq!(first, Rejection::by_rule(Alarm::InEstop, CommandCode::Home));
    desk.commit(&OperatorCommand::EstopReset, 0, false);
    desk.commit(&OperatorCommand::On, 0, false);
    let number = Alarm::DriveFault.number();
    assert_eq!(
        refusal(&mut desk, 2).text,
        format!("alarm {number} is latched: axis X")
    );
}

#[test]
fn each_switch_and_override_is_one_of_its_own() {
    let mut desk = OperatorState::default();
    let seen = |desk: &OperatorState| {
        let switches = [
            desk.is_single_step(),
            desk.is_optional_stop(),
            desk.is_block_delete(),
        ];
        (switches, desk.overrides())
    };
    assert_eq!(seen(&desk), ([false; 3], [1.0; 3]));
    desk.commit(&OperatorCommand::BlockDelete(true), 0, false);
    assert_eq!(seen(&desk).0, [false, false, true]);
    desk.commit(&OperatorCommand::OptionalStop(true), 0, false);
    assert_eq!(seen(&desk).0, [false, true, true]);
    desk.commit(&OperatorCommand::SingleStep(true), 0, false);
    desk.commit(&OperatorCommand::BlockDelete(false), 0, false);
    assert_eq!(seen(&desk).0, [true, true, false]);
    desk.commit(&OperatorCommand::SingleStep(false), 0, false);
    desk.commit(&OperatorCommand::Step, 0, false);
    assert_eq!(seen(&desk).0, [true, true, false], "a step switches it on");
    assert_eq!(desk.program(), None);
    desk.commit(&OperatorCommand::Load("part.ngc".to_owned()), 0, false);
    assert_eq!(desk.program(), Some("part.ngc"));
    desk.commit(&OperatorCommand::FeedOverride(0.5), 0, false);
    desk.commit(&OperatorCommand::RapidOverride(0.25), 0, false);
    desk.commit(&OperatorCommand::SpindleOverride(0.75), 0, false);
    assert_eq!(seen(&desk).1, [0.5, 0.25, 0.75]);
}

#[test]
fn a_job_ends_once() {
    let mut desk = OperatorState::default();
    assert_eq!(
        (desk.job(), desk.job_begins(Activity::Jog), desk.job()),
        (0, 1, 1)
    );
    desk.job_ends(JobResult::Done);
    assert_eq!((desk.job_begins(Activity::Jog), desk.job()), (2, 2));
    desk.job_ends(JobResult::Stopped);
    desk.job_ends(JobResult::Fault);
    assert_eq!(desk.result(), JobResult::Stopped);
}

#[test]
fn a_machine_is_brought_up_in_order_and_in_no_other() {
    let (mut desk, mut client) = (OperatorState::default(), Client(0));
    assert_eq!(client.sends(&mut desk, CommandCode::On, 0), Err(Alarm::InEstop));
    assert_eq!(client.sends(&mut desk, CommandCode::EstopReset, 0), Ok(()));
    assert_eq!(client.sends(&mut desk, CommandCode::Home, 0), Err(Alarm::IsOff));
    assert_eq!(client.sends(&mut desk, CommandCode::On, 0), Ok(()));
    assert_eq!(client.sends(&mut desk, CommandCode::Home, 0), Ok(()));
    assert_eq!(
        client.sends(&mut desk, CommandCode::Mode, Mode::Auto as u32),
        Ok(())
    );
    assert_eq!(
        client.sends(&mut desk, CommandCode::Start, 0),
        Err(Alarm::NoProgram)
    );
    assert_eq!(client.sends(&mut desk, CommandCode::Load, 0), Ok(()));
    assert_eq!(
        client.sends(&mut desk, CommandCode::Start, 0),
        Err(Alarm::NotHomed)
    );
    desk.set_homed(AxisMask::from_bits(0b111));
    assert_eq!(desk.homed().bits(), 0b111);
    assert_eq!(client.sends(&mut desk, CommandCode::Start, 0), Ok(()));
    assert_eq!(desk.job_begins(Activity::Program), 1);
    assert_eq!(client.sends(&mut desk, CommandCode::Start, 0), Err(Alarm::Busy));
    assert_eq!(client.sends(&mut desk, CommandCode::Step, 0), Err(Alarm::NotHeld));
    assert_eq!(client.sends(&mut desk, CommandCode::Off, 0), Err(Alarm::Busy));
    assert_eq!(client.sends(&mut desk, CommandCode::Estop, 0), Ok(()));
    desk.job_ends(JobResult::Stopped);
    assert_eq!(
        (desk.machine(), desk.result()),
        (MachineState::Estop, JobResult::Stopped)
    );
}

#[test]
fn whatever_is_refused_changes_nothing_but_the_counts() {
    let (mut desk, mut client) = (OperatorState::default(), Client(0));
    client.sends(&mut desk, CommandCode::EstopReset, 0).unwrap();
    client.sends(&mut desk, CommandCode::FeedOverride, 0).unwrap();
    let before = (
        desk.machine(),
        desk.mode(),
        desk.overrides(),
        desk.program().map(str::to_owned),
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
        let refused = desk.authorize(client, serial, &raw, &FACTS).unwrap_err();
        assert_eq!(refused.0, verdict, "{client} {serial}");
    }
    assert_eq!(
        before,
        (
            desk.machine(),
            desk.mode(),
            desk.overrides(),
            desk.program().map(str::to_owned)
        )
    );
    assert_eq!(desk.counts(), (2, 6));
}

#[test]
fn faults_latch_and_alarms_of_a_job_end_with_the_next() {
    let (mut desk, mut client) = (OperatorState::default(), Client(0));
    client.sends(&mut desk, CommandCode::EstopReset, 0).unwrap();
    client.sends(&mut desk, CommandCode::On, 0).unwrap();
    desk.raise(Alarm::Program, "line 7 ...");
    assert!(!desk.has_latched_alarm());
    desk.job_begins(Activity::Program);
    assert_eq!(desk.alarms().count(), 0);
    desk.raise(Alarm::DriveFault, "axis X");
    desk.raise(Alarm::DriveFault, "axis Y");
    desk.job_ends(JobResult::Fault);
    assert_eq!(desk.alarms().collect::<Vec<_>>(), [(Alarm::DriveFault, "axis X")]);
    assert_eq!(client.sends(&mut desk, CommandCode::Home, 0), Err(Alarm::Latched));
    desk.job_begins(Activity::Jog);
    desk.job_ends(JobResult::Done);
    assert!(desk.has_latched_alarm());
    client.sends(&mut desk, CommandCode::ClearAlarms, 0).unwrap();
    assert_eq!(client.sends(&mut desk, CommandCode::Home, 0), Ok(()));
}

#[test]
fn a_latching_alarm_is_listed_among_many_others() {
    let kinds = |latched: bool| {
        Alarm::ALL
            .iter()
            .copied()
            .filter(move |alarm| alarm.is_latched() == latched)
    };
    let mut desk = OperatorState::default();
    for alarm in kinds(false).take(MAX_ALARMS) {
        desk.raise(alarm, "no fault");
    }
    assert!(!desk.has_latched_alarm());
    desk.raise(Alarm::DriveFault, "axis X");
    assert!(desk.has_latched_alarm());
    assert_eq!((desk.alarms().count(), desk.unlisted_alarms()), (MAX_ALARMS, 1));
    assert_eq!(desk.alarms().next(), Some((Alarm::DriveFault, "axis X")));
    // With latching alarms only: the cause, whose sentence the status shows, and the newest.
    for alarm in kinds(true) {
        desk.raise(alarm, "a fault");
    }
    let newest = kinds(true).next_back().unwrap();
    assert_eq!(desk.alarms().next(), Some((Alarm::DriveFault, "axis X")));
    assert_eq!(desk.alarms().last(), Some((newest, "a fault")));
    assert!(desk.alarms().all(|(alarm, _)| alarm.is_latched()));
    desk.clear_alarms();
    assert_eq!((desk.alarms().count(), desk.unlisted_alarms()), (0, 0));
}

#[test]
fn the_first_of_the_alarms_is_their_cause() {
    let mut desk = OperatorState::default();
    let listed = |desk: &OperatorState| desk.alarms().map(|(alarm, _)| alarm).collect::<Vec<_>>();
    desk.raise(Alarm::Trace, "the disk is full");
    desk.raise(Alarm::NotKept, "the disk is full");
    assert_eq!(listed(&desk), [Alarm::Trace, Alarm::NotKept]);
    desk.raise(Alarm::Mdi, "no such code");
    assert_eq!(listed(&desk), [Alarm::Mdi, Alarm::Trace, Alarm::NotKept]);
    // A bridge that is silent, then the consequences.
    desk.raise(Alarm::FeedbackStale, "the bridge is silent");
    desk.raise(Alarm::ReferenceLost, "home X again");
    desk.raise(Alarm::DriveFault, "axis X");
    let expected = [
        Alarm::FeedbackStale,
        Alarm::Trace,
        Alarm::NotKept,
        Alarm::Mdi,
        Alarm::ReferenceLost,
        Alarm::DriveFault,
    ];
    assert_eq!(listed(&desk), expected);
    desk.clear_alarms();
    desk.raise(Alarm::ReferenceLost, "home X again");
    assert_eq!(listed(&desk), [Alarm::ReferenceLost]);
}

#[test]
fn drives_not_enabled_in_time_raise_an_alarm() {
    let mut desk = OperatorState::default();
    desk.commit(&OperatorCommand::EstopReset, 0, true);
    desk.commit(&OperatorCommand::On, 1_000, true);
    assert_eq!((desk.machine(), desk.wants_power()), (MachineState::Off, true));
    desk.enable(false, 1_000 + ENABLE_NS);
    assert!(desk.wants_power());
    desk.enable(false, 1_001 + ENABLE_NS);
    assert!(!desk.wants_power() && desk.has_latched_alarm());
    desk.commit(&OperatorCommand::ClearAlarms, 0, true);
    desk.commit(&OperatorCommand::On, 0, true);
    desk.enable(true, 10);
    assert_eq!(desk.machine(), MachineState::On);
}

#[test]
fn an_open_chain_is_an_emergency_stop() {
    let open = OperatorInputs {
        is_chain_open: true,
        ..FACTS
    };
    let raw = |code: CommandCode| RawCommand {
        command: code as u32,
        axes_mask: 0,
        index: 0,
        amount: 0.0,
        values: [0.0; AXES],
        text: Some(""),
    };
    let mut desk = OperatorState::default();
    let (verdict, refusal) = desk
        .authorize(7, 1, &raw(CommandCode::EstopReset), &open)
        .unwrap_err();
    assert_eq!(
        (verdict, refusal.alarm),
        (CommandVerdict::Rejected, Alarm::ChainOpen)
    );
    let reset = desk
        .authorize(7, 2, &raw(CommandCode::EstopReset), &FACTS)
        .unwrap();
    desk.commit(&reset, 0, true);
    desk.commit(&OperatorCommand::On, 1000, true);
    desk.fall_into_estop();
    assert!(desk.machine() == MachineState::Estop && !desk.wants_power());
    desk.enable(true, 2000);
    assert_eq!(desk.machine(), MachineState::Estop);
}
