//! The operator's desk: what the machine is, and how commands and events change it.

use crate::alarm::{Alarm, AlarmKind};
use crate::code::CommandCode;
use crate::command::Command;
use crate::decode::RawCommand;
use crate::refusal::Refusal;
use crate::rules::judge;
use crate::serials::Serials;
use crate::situation::{Activity, MachineState, Mode, Situation};

/// Alarms that are listed; of more the newest are only counted.
const MOST_ALARMS: usize = 16;
/// How long drives may take until they are enabled, ns.
const ENABLE_NS: u64 = 5_000_000_000;

/// What an answer says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Verdict {
    /// It takes effect.
    Accepted = 0,
    /// It has no effect, and the alarm tells why.
    Rejected = 1,
    /// It is not newer than an earlier one of the same client.
    Stale = 2,
}

/// How a job ended. The numbers are those on the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum JobResult {
    /// It runs, or there has been none.
    #[default]
    None = 0,
    /// At its end.
    Done = 1,
    /// By a stop, or because the client that jogged has gone.
    Stopped = 2,
    /// At an error of the program.
    Failed = 3,
    /// By a fault.
    Fault = 4,
}

/// What the desk cannot know by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Facts {
    /// Bit i set: the machine has axis i.
    pub present: u32,
    /// The feed is held, or a program stop is waited at.
    pub is_held: bool,
    /// The process is about to end.
    pub is_ending: bool,
}

/// An alarm in force.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Raised {
    alarm: Alarm,
    text: String,
}

/// The desk of one machine.
#[derive(Clone, Debug)]
pub struct Desk {
    serials: Serials,
    machine: MachineState,
    mode: Mode,
    activity: Activity,
    /// When the drives were asked to enable, while they are not.
    enabling_since_ns: Option<u64>,
    homed: u32,
    program: Option<String>,
    feed_override: f64,
    rapid_override: f64,
    spindle_override: f64,
    single_step: bool,
    optional_stop: bool,
    block_delete: bool,
    job: u64,
    result: JobResult,
    alarms: Vec<Raised>,
    more_alarms: u32,
    accepted: u64,
    rejected: u64,
}

impl Default for Desk {
    /// As after power-up: in emergency stop, manual, nothing homed.
    fn default() -> Self {
        Self {
            serials: Serials::default(),
            machine: MachineState::Estop,
            mode: Mode::Manual,
            activity: Activity::None,
            enabling_since_ns: None,
            homed: 0,
            program: None,
            feed_override: 1.0,
            rapid_override: 1.0,
            spindle_override: 1.0,
            single_step: false,
            optional_stop: false,
            block_delete: false,
            job: 0,
            result: JobResult::None,
            alarms: Vec::new(),
            more_alarms: 0,
            accepted: 0,
            rejected: 0,
        }
    }
}

impl Desk {
    /// Judges a request: its serial number, its numbers, the interlocks. Nothing is changed but the count of serials;
    /// who carries the command out calls [`Desk::commit`] then.
    ///
    /// # Errors
    /// Verdict and refusal for the answer; it is counted.
    pub fn consider(
        &mut self,
        client: u64,
        serial: u64,
        raw: &RawCommand<'_>,
        facts: &Facts,
    ) -> Result<Command, (Verdict, Refusal)> {
        if client == 0 || serial == 0 {
            let text = "a command needs the number of its client and its own, both above 0";
            return Err(self.refuse(Refusal::new(Alarm::Malformed, text)));
        }
        if !self.serials.admit(client, serial) {
            self.rejected += 1;
            return Err((Verdict::Stale, Alarm::Stale.into()));
        }
        if facts.is_ending {
            return Err(self.refuse(Alarm::Ending.into()));
        }
        let (code, command) = match Command::decode(raw, facts.present) {
            Ok(decoded) => decoded,
            Err(refusal) => return Err(self.refuse(refusal)),
        };
        if let Err(alarm) = judge(code, &self.situation(facts)) {
            let mut refusal = Refusal::by_rule(alarm, code);
            if alarm == Alarm::Latched
                && let Some(first) = self.alarms.iter().find(|raised| raised.alarm.is_latched())
            {
                refusal.text = format!("alarm {} is latched: {}", first.alarm.number(), first.text);
            }
            return Err(self.refuse(refusal));
        }
        // A step of a running program makes sense only where it waits.
        if code == CommandCode::Step && self.activity == Activity::Program && !facts.is_held {
            return Err(self.refuse(Alarm::NotHeld.into()));
        }
        Ok(command)
    }

    /// Counts a rejection and makes the answer of it.
    pub fn refuse(&mut self, refusal: Refusal) -> (Verdict, Refusal) {
        self.rejected += 1;
        (Verdict::Rejected, refusal)
    }

    /// A command that was considered is being carried out. `needs_drives`: whether switching on has to wait for drives.
    pub fn commit(&mut self, command: &Command, now_ns: u64, needs_drives: bool) {
        self.accepted += 1;
        match command {
            Command::Estop => {
                self.machine = MachineState::Estop;
                self.enabling_since_ns = None;
            }
            Command::EstopReset => self.machine = MachineState::Off,
            Command::On if self.machine == MachineState::Off => {
                if needs_drives {
                    self.enabling_since_ns.get_or_insert(now_ns);
                } else {
                    self.machine = MachineState::On;
                }
            }
            Command::Off => {
                self.enabling_since_ns = None;
                if self.machine == MachineState::On {
                    self.machine = MachineState::Off;
                }
            }
            Command::SetMode(mode) => self.mode = *mode,
            Command::Load(file) => self.program = Some(file.clone()),
            Command::Step => self.single_step = true,
            Command::SingleStep(on) => self.single_step = *on,
            Command::OptionalStop(on) => self.optional_stop = *on,
            Command::BlockDelete(on) => self.block_delete = *on,
            Command::FeedOverride(ratio) => self.feed_override = *ratio,
            Command::RapidOverride(ratio) => self.rapid_override = *ratio,
            Command::SpindleOverride(ratio) => self.spindle_override = *ratio,
            Command::Reset | Command::ClearAlarms => self.clear_alarms(),
            _ => {}
        }
    }

    /// A job has the axes from now on. Returns its number.
    pub fn job_begins(&mut self, activity: Activity) -> u64 {
        self.activity = activity;
        self.job += 1;
        self.result = JobResult::None;
        // What is told of an earlier job is told of this one no more.
        self.alarms.retain(|raised| raised.alarm.kind() != AlarmKind::Job);
        self.job
    }

    /// The axes are at rest and free again.
    pub fn job_ends(&mut self, result: JobResult) {
        if self.activity != Activity::None {
            self.activity = Activity::None;
            self.result = result;
        }
    }

    /// Something went wrong. A fault of the drives or the emergency of the guard also takes the machine off.
    pub fn raise(&mut self, alarm: Alarm, text: impl Into<String>) {
        if self.alarms.iter().any(|raised| raised.alarm == alarm) {
            return;
        }
        if self.alarms.len() >= MOST_ALARMS {
            self.more_alarms = self.more_alarms.saturating_add(1);
            if !alarm.is_latched() {
                return;
            }
            // What keeps the machine from moving is listed rather than what does not, and the newest rather than the last.
            let unlatched = self.alarms.iter().position(|raised| !raised.alarm.is_latched());
            self.alarms.remove(unlatched.unwrap_or(MOST_ALARMS - 1));
        }
        let text = text.into();
        self.alarms.push(Raised { alarm, text });
    }

    /// The drives have lost power by a fault.
    pub fn drop_power(&mut self) {
        self.enabling_since_ns = None;
        if self.machine == MachineState::On {
            self.machine = MachineState::Off;
        }
    }

    fn clear_alarms(&mut self) {
        self.alarms.clear();
        self.more_alarms = 0;
    }

    /// While the drives are being enabled: whether they are. Raises an alarm where it takes too long.
    pub fn enable(&mut self, are_enabled: bool, now_ns: u64) {
        let Some(since) = self.enabling_since_ns else {
            return;
        };
        if are_enabled {
            self.enabling_since_ns = None;
            self.machine = MachineState::On;
        } else if now_ns.saturating_sub(since) > ENABLE_NS {
            self.enabling_since_ns = None;
            self.raise(Alarm::NotEnabled, Alarm::NotEnabled.sentence());
        }
    }

    /// The axes whose machine zero is known.
    pub fn set_homed(&mut self, mask: u32) {
        self.homed = mask;
    }

    fn situation(&self, facts: &Facts) -> Situation {
        Situation {
            machine: self.machine,
            mode: self.mode,
            activity: self.activity,
            is_loaded: self.program.is_some(),
            is_homed: self.homed & facts.present == facts.present,
            has_alarm: self.has_latched_alarm(),
            is_held: facts.is_held,
        }
    }

    /// Emergency stop, off or on.
    #[must_use]
    pub fn machine(&self) -> MachineState {
        self.machine
    }

    /// Whether power is wanted: on, or being enabled.
    #[must_use]
    pub fn wants_power(&self) -> bool {
        self.machine == MachineState::On || self.enabling_since_ns.is_some()
    }

    /// Automatic, manual or MDI.
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// What has the axes.
    #[must_use]
    pub fn activity(&self) -> Activity {
        self.activity
    }

    /// The axes whose machine zero is known.
    #[must_use]
    pub fn homed(&self) -> u32 {
        self.homed
    }

    /// The loaded program.
    #[must_use]
    pub fn program(&self) -> Option<&str> {
        self.program.as_deref()
    }

    /// Feed, rapid and spindle override.
    #[must_use]
    pub fn overrides(&self) -> [f64; 3] {
        [self.feed_override, self.rapid_override, self.spindle_override]
    }

    /// Whether the program stops after each block.
    #[must_use]
    pub fn is_single_step(&self) -> bool {
        self.single_step
    }

    /// Whether M1 stops.
    #[must_use]
    pub fn is_optional_stop(&self) -> bool {
        self.optional_stop
    }

    /// Whether lines that begin with `/` are left out.
    #[must_use]
    pub fn is_block_delete(&self) -> bool {
        self.block_delete
    }

    /// Number of the job that runs or ran last.
    #[must_use]
    pub fn job(&self) -> u64 {
        self.job
    }

    /// How the last job ended.
    #[must_use]
    pub fn result(&self) -> JobResult {
        self.result
    }

    /// Whether nothing may move until the alarms are cleared.
    #[must_use]
    pub fn has_latched_alarm(&self) -> bool {
        self.alarms.iter().any(|raised| raised.alarm.is_latched())
    }

    /// The alarms in force with their sentences, the oldest first.
    pub fn alarms(&self) -> impl Iterator<Item = (Alarm, &str)> {
        self.alarms
            .iter()
            .map(|raised| (raised.alarm, raised.text.as_str()))
    }

    /// Alarms in force that are not listed.
    #[must_use]
    pub fn unlisted_alarms(&self) -> u32 {
        self.more_alarms
    }

    /// Commands accepted and rejected so far.
    #[must_use]
    pub fn counts(&self) -> (u64, u64) {
        (self.accepted, self.rejected)
    }
}

#[cfg(test)]
mod tests {
    use evolvent_path::AXES;

    use super::*;

    const FACTS: Facts = Facts {
        present: 0b111,
        is_held: false,
        is_ending: false,
    };

    /// A client that counts.
    struct Client(u64);

    impl Client {
        fn sends(&mut self, desk: &mut Desk, code: CommandCode, index: u32) -> Result<(), Alarm> {
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
                .consider(7, self.0, &raw, &FACTS)
                .map_err(|(_, refusal)| refusal.alarm)?;
            desk.commit(&command, 0, false);
            Ok(())
        }
    }

    /// On, and waiting for its drives since 1000 ns.
    fn waiting_for_drives() -> Desk {
        let mut desk = Desk::default();
        desk.commit(&Command::EstopReset, 0, true);
        desk.commit(&Command::On, 1000, true);
        assert!(desk.wants_power() && desk.machine() == MachineState::Off);
        desk
    }

    #[test]
    fn drives_that_come_up_after_power_was_taken_back_do_not_switch_the_machine_on() {
        type Way = fn(&mut Desk);
        let ways: [(Way, MachineState); 3] = [
            (
                |desk| desk.commit(&Command::Estop, 2000, true),
                MachineState::Estop,
            ),
            (|desk| desk.commit(&Command::Off, 2000, true), MachineState::Off),
            (Desk::drop_power, MachineState::Off),
        ];
        for (takes_back, state) in ways {
            let mut desk = waiting_for_drives();
            takes_back(&mut desk);
            desk.enable(true, 3000);
            assert_eq!((desk.machine(), desk.wants_power()), (state, false));
        }
    }

    #[test]
    fn asking_for_power_again_gives_the_drives_no_more_time() {
        let mut desk = waiting_for_drives();
        desk.commit(&Command::On, 1000 + ENABLE_NS, true);
        desk.enable(false, 1000 + ENABLE_NS);
        assert!(!desk.has_latched_alarm());
        desk.enable(false, 1001 + ENABLE_NS);
        let alarms: Vec<Alarm> = desk.alarms().map(|(alarm, _)| alarm).collect();
        assert_eq!(alarms, [Alarm::NotEnabled]);
    }

    #[test]
    fn one_axis_that_is_not_homed_keeps_programs_from_starting() {
        let (mut desk, mut client) = (Desk::default(), Client(0));
        for (code, index) in [
            (CommandCode::EstopReset, 0),
            (CommandCode::On, 0),
            (CommandCode::Load, 0),
            (CommandCode::Mode, 0),
        ] {
            assert_eq!(client.sends(&mut desk, code, index), Ok(()));
        }
        desk.set_homed(0b101);
        assert_eq!(
            client.sends(&mut desk, CommandCode::Start, 0),
            Err(Alarm::NotHomed)
        );
        desk.set_homed(0b111);
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
        let facts = Facts {
            is_ending: true,
            ..FACTS
        };
        let refused = Desk::default().consider(7, 1, &raw, &facts);
        let (verdict, refusal) = refused.expect_err("it ends");
        assert_eq!((verdict, refusal.alarm), (Verdict::Rejected, Alarm::Ending));
    }

    #[test]
    fn losing_power_leaves_an_emergency_stop_and_a_machine_that_is_off_as_they_are() {
        type Way = fn(&mut Desk);
        let ways: [Way; 2] = [
            |desk| desk.commit(&Command::Off, 0, false),
            |desk| desk.drop_power(),
        ];
        for way in ways {
            let mut desk = Desk::default();
            way(&mut desk);
            assert_eq!(desk.machine(), MachineState::Estop);
            desk.commit(&Command::On, 0, false);
            assert_eq!(desk.machine(), MachineState::Estop, "it is reset first");
            desk.commit(&Command::EstopReset, 0, false);
            way(&mut desk);
            assert_eq!(desk.machine(), MachineState::Off);
            desk.commit(&Command::On, 0, false);
            assert_eq!(desk.machine(), MachineState::On);
            way(&mut desk);
            assert_eq!(desk.machine(), MachineState::Off);
        }
    }

    #[test]
    fn who_is_refused_for_a_latched_alarm_is_told_which_and_otherwise_what_the_rule_says() {
        let refusal = |desk: &mut Desk, serial: u64| {
            let raw = RawCommand {
                command: CommandCode::Home as u32,
                axes_mask: 0,
                index: 0,
                amount: 0.0,
                values: [0.0; AXES],
                text: None,
            };
            desk.consider(7, serial, &raw, &FACTS).unwrap_err().1
        };
        let mut desk = Desk::default();
        desk.raise(Alarm::DriveFault, "axis X");
        // In emergency stop that is the reason, whatever is latched.
        let first = refusal(&mut desk, 1);
        assert_eq!(first, Refusal::by_rule(Alarm::InEstop, CommandCode::Home));
        desk.commit(&Command::EstopReset, 0, false);
        desk.commit(&Command::On, 0, false);
        let number = Alarm::DriveFault.number();
        assert_eq!(
            refusal(&mut desk, 2).text,
            format!("alarm {number} is latched: axis X")
        );
    }

    #[test]
    fn each_switch_and_override_is_one_of_its_own() {
        let mut desk = Desk::default();
        let seen = |desk: &Desk| {
            let switches = [
                desk.is_single_step(),
                desk.is_optional_stop(),
                desk.is_block_delete(),
            ];
            (switches, desk.overrides())
        };
        assert_eq!(seen(&desk), ([false; 3], [1.0; 3]));
        desk.commit(&Command::BlockDelete(true), 0, false);
        assert_eq!(seen(&desk).0, [false, false, true]);
        desk.commit(&Command::OptionalStop(true), 0, false);
        assert_eq!(seen(&desk).0, [false, true, true]);
        desk.commit(&Command::SingleStep(true), 0, false);
        desk.commit(&Command::BlockDelete(false), 0, false);
        assert_eq!(seen(&desk).0, [true, true, false]);
        desk.commit(&Command::SingleStep(false), 0, false);
        desk.commit(&Command::Step, 0, false);
        assert_eq!(seen(&desk).0, [true, true, false], "a step switches it on");
        assert_eq!(desk.program(), None);
        desk.commit(&Command::Load("part.ngc".to_owned()), 0, false);
        assert_eq!(desk.program(), Some("part.ngc"));
        desk.commit(&Command::FeedOverride(0.5), 0, false);
        desk.commit(&Command::RapidOverride(0.25), 0, false);
        desk.commit(&Command::SpindleOverride(0.75), 0, false);
        assert_eq!(seen(&desk).1, [0.5, 0.25, 0.75]);
    }

    #[test]
    fn a_job_ends_once() {
        let mut desk = Desk::default();
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
        let (mut desk, mut client) = (Desk::default(), Client(0));
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
        desk.set_homed(0b111);
        assert_eq!(desk.homed(), 0b111);
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
        let (mut desk, mut client) = (Desk::default(), Client(0));
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
            (0, 99, good, Verdict::Rejected),
            (7, 0, good, Verdict::Rejected),
            (7, 2, good, Verdict::Stale),
            (7, 1, good, Verdict::Stale),
            (7, 99, nan, Verdict::Rejected),
            (7, 99, good, Verdict::Stale),
        ] {
            let refused = desk.consider(client, serial, &raw, &FACTS).unwrap_err();
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
    fn faults_are_latched_and_what_a_job_left_goes_with_the_next_one() {
        let (mut desk, mut client) = (Desk::default(), Client(0));
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
    fn an_alarm_that_latches_is_listed_however_many_others_are() {
        let kinds = |latched: bool| {
            Alarm::ALL
                .iter()
                .copied()
                .filter(move |alarm| alarm.is_latched() == latched)
        };
        let mut desk = Desk::default();
        for alarm in kinds(false).take(MOST_ALARMS) {
            desk.raise(alarm, "no fault");
        }
        assert!(!desk.has_latched_alarm());
        desk.raise(Alarm::DriveFault, "axis X");
        assert!(desk.has_latched_alarm());
        assert_eq!((desk.alarms().count(), desk.unlisted_alarms()), (MOST_ALARMS, 1));
        assert_eq!(desk.alarms().last(), Some((Alarm::DriveFault, "axis X")));
        // And where all of them are: the newest, whose sentence the status shows.
        for alarm in kinds(true) {
            desk.raise(alarm, "a fault");
        }
        let newest = kinds(true).next_back().unwrap();
        assert_eq!(desk.alarms().last(), Some((newest, "a fault")));
        assert!(desk.alarms().all(|(alarm, _)| alarm.is_latched()));
        desk.clear_alarms();
        assert_eq!((desk.alarms().count(), desk.unlisted_alarms()), (0, 0));
    }

    #[test]
    fn drives_that_are_not_enabled_in_time_raise_an_alarm_and_the_machine_stays_off() {
        let mut desk = Desk::default();
        desk.commit(&Command::EstopReset, 0, true);
        desk.commit(&Command::On, 1_000, true);
        assert_eq!((desk.machine(), desk.wants_power()), (MachineState::Off, true));
        desk.enable(false, 1_000 + ENABLE_NS);
        assert!(desk.wants_power());
        desk.enable(false, 1_001 + ENABLE_NS);
        assert!(!desk.wants_power() && desk.has_latched_alarm());
        desk.commit(&Command::ClearAlarms, 0, true);
        desk.commit(&Command::On, 0, true);
        desk.enable(true, 10);
        assert_eq!(desk.machine(), MachineState::On);
    }
}
