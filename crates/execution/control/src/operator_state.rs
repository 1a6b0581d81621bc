//! The state of the machine for its operator, and how commands and events change it.

use evolvent_path::AxisMask;

use crate::alarm::{Alarm, AlarmKind};
use crate::command::OperatorCommand;
use crate::command_code::CommandCode;
use crate::decode::RawCommand;
use crate::interlock_state::{Activity, InterlockState, MachineState, Mode};
use crate::interlocks::judge;
use crate::rejection::Rejection;
use crate::serials::Serials;

/// Maximum number of alarms that are listed. Further ones are counted; those that latch replace others.
const MAX_ALARMS: usize = 16;
/// Default time until drives have to be enabled, ns.
const ENABLE_NS: u64 = 2_000_000_000;

/// The result of a command, as in the reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum CommandVerdict {
    /// It takes effect.
    Accepted = 0,
    /// It has no effect; the alarm contains the reason.
    Rejected = 1,
    /// Its serial number is not above that of an earlier command of the same client.
    Stale = 2,
}

/// How a job ended. The numbers are those on the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum JobResult {
    /// The job runs, or there has been none.
    #[default]
    None = 0,
    /// The job ran to its end.
    Done = 1,
    /// By a stop, or because the client that jogged has gone.
    Stopped = 2,
    /// At an error of the program.
    Failed = 3,
    /// By a fault.
    Fault = 4,
}

/// Facts from outside on which the state depends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OperatorInputs {
    /// Bit i set: the machine has axis i.
    pub present: AxisMask,
    /// The feed is held, or a program stop is waited at.
    pub is_held: bool,
    /// The process is about to end.
    pub is_ending: bool,
    /// The axes are away from the held program.
    pub is_away: bool,
    /// The emergency-stop chain of the machine is open or unknown.
    pub is_chain_open: bool,
}

/// An alarm in force.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Raised {
    alarm: Alarm,
    text: String,
}

/// Factors, 1 at 100 %.
#[derive(Clone, Copy, Debug)]
struct Overrides {
    feed: f64,
    rapid: f64,
    spindle: f64,
}

impl Default for Overrides {
    fn default() -> Self {
        Self {
            feed: 1.0,
            rapid: 1.0,
            spindle: 1.0,
        }
    }
}

/// Switches for the next program.
#[derive(Clone, Copy, Debug, Default)]
struct ProgramSwitches {
    single_step: bool,
    optional_stop: bool,
    block_delete: bool,
}

/// The operator's state of one machine.
#[derive(Clone, Debug)]
pub struct OperatorState {
    serials: Serials,
    machine: MachineState,
    mode: Mode,
    activity: Activity,
    /// Time at which enabling of the drives was requested, while they are not enabled.
    enabling_since_ns: Option<u64>,
    enable_timeout_ns: u64,
    homed: AxisMask,
    program: Option<String>,
    /// A load has failed since the last successful one: a start without a name may mean the program that
    /// failed.
    load_failed: bool,
    overrides: Overrides,
    switches: ProgramSwitches,
    job: u64,
    result: JobResult,
    alarms: Vec<Raised>,
    more_alarms: u32,
    accepted: u64,
    rejected: u64,
}

impl Default for OperatorState {
    /// The state after power-up: in emergency stop, manual, nothing homed.
    fn default() -> Self {
        Self {
            serials: Serials::default(),
            machine: MachineState::Estop,
            mode: Mode::Manual,
            activity: Activity::None,
            enabling_since_ns: None,
            enable_timeout_ns: ENABLE_NS,
            homed: AxisMask::NONE,
            program: None,
            load_failed: false,
            overrides: Overrides::default(),
            switches: ProgramSwitches::default(),
            job: 0,
            result: JobResult::None,
            alarms: Vec::new(),
            more_alarms: 0,
            accepted: 0,
            rejected: 0,
        }
    }
}

impl OperatorState {
    /// Checks the serial number, the numbers and the interlocks of a request. Only the record of serial
    /// numbers and the counts change; the caller that executes the command then calls
    /// [`OperatorState::commit`].
    ///
    /// # Errors
    /// Verdict and rejection for the reply; the rejection is counted.
    pub fn authorize(
        &mut self,
        client: u64,
        serial: u64,
        raw: &RawCommand<'_>,
        inputs: &OperatorInputs,
    ) -> Result<OperatorCommand, (CommandVerdict, Rejection)> {
        if client == 0 || serial == 0 {
            let text = "a command needs a client number and a serial number, both above 0";
            return Err(self.refuse(Rejection::new(Alarm::Malformed, text)));
        }
        if !self.serials.admit(client, serial) {
            self.rejected += 1;
            return Err((CommandVerdict::Stale, Alarm::Stale.into()));
        }
        if inputs.is_ending {
            return Err(self.refuse(Alarm::Ending.into()));
        }
        // Set until the load succeeds: if anything prevents it, the loaded program is not the one that was
        // requested.
        self.load_failed |= raw.command == CommandCode::Load as u32;
        let (code, command) = match OperatorCommand::decode(raw, inputs.present) {
            Ok(decoded) => decoded,
            Err(refusal) => return Err(self.refuse(refusal)),
        };
        if let Err(refusal) = self.permit(code, inputs) {
            return Err(self.refuse(refusal));
        }
        let starts =
            matches!(code, CommandCode::Start | CommandCode::Step) && self.activity == Activity::None;
        if starts {
            let meant = raw.text.unwrap_or_default();
            if let Some(objection) = self.other_program(meant) {
                return Err(self.refuse(Rejection::new(Alarm::OtherProgram, objection)));
            }
            // A start that names the loaded program means that one.
            self.load_failed &= meant.is_empty();
        }
        Ok(command)
    }

    /// Checks a command against the interlocks as they are now. [`OperatorState::authorize`] has checked them
    /// already; the caller that executes the command later checks again.
    ///
    /// # Errors
    /// The reason why it is not permitted; it is not counted.
    pub fn permit(&self, code: CommandCode, inputs: &OperatorInputs) -> Result<(), Rejection> {
        if inputs.is_ending {
            return Err(Alarm::Ending.into());
        }
        if let Err(alarm) = judge(code, &self.situation(inputs)) {
            let mut refusal = Rejection::by_rule(alarm, code);
            if alarm == Alarm::Latched
                && let Some(first) = self.alarms.iter().find(|raised| raised.alarm.is_latched())
            {
                refusal.text = format!("alarm {} is latched: {}", first.alarm.number(), first.text);
            }
            return Err(refusal);
        }
        let goes_on = matches!(code, CommandCode::Resume | CommandCode::Step);
        if goes_on && inputs.is_away {
            return Err(Alarm::OffPath.into());
        }
        if code == CommandCode::EstopReset && inputs.is_chain_open {
            return Err(Alarm::ChainOpen.into());
        }
        // A step of a running program is valid only while the program waits.
        if code == CommandCode::Step && self.activity == Activity::Program && !inputs.is_held {
            return Err(Alarm::NotHeld.into());
        }
        Ok(())
    }

    /// Why the loaded program may not be the one that the client means; the client names `meant` or nothing.
    fn other_program(&self, meant: &str) -> Option<String> {
        let loaded = self.program.as_deref()?;
        if meant.is_empty() && self.load_failed {
            return Some(format!(
                "the last LOAD was rejected, and {loaded} is still loaded: load again, or name {loaded} to \
                 start it"
            ));
        }
        (!meant.is_empty() && meant != loaded)
            .then(|| format!("{loaded} is loaded, not {meant}: load {meant} first, or start {loaded}"))
    }

    /// Counts a rejection and returns the reply.
    pub fn refuse(&mut self, refusal: Rejection) -> (CommandVerdict, Rejection) {
        self.rejected += 1;
        (CommandVerdict::Rejected, refusal)
    }

    /// An authorized command is being executed. `needs_drives`: switching on has to wait for drives.
    pub fn commit(&mut self, command: &OperatorCommand, now_ns: u64, needs_drives: bool) {
        self.accepted += 1;
        match command {
            OperatorCommand::Estop => self.fall_into_estop(),
            OperatorCommand::EstopReset => self.machine = MachineState::Off,
            OperatorCommand::On if self.machine == MachineState::Off => {
                if needs_drives {
                    self.enabling_since_ns.get_or_insert(now_ns);
                } else {
                    self.machine = MachineState::On;
                }
            }
            OperatorCommand::Off => {
                self.enabling_since_ns = None;
                if self.machine == MachineState::On {
                    self.machine = MachineState::Off;
                }
            }
            OperatorCommand::SetMode(mode) => self.mode = *mode,
            OperatorCommand::Load(file) => {
                self.program = Some(file.clone());
                self.load_failed = false;
            }
            OperatorCommand::Step => self.switches.single_step = true,
            OperatorCommand::SingleStep(on) => self.switches.single_step = *on,
            OperatorCommand::OptionalStop(on) => self.switches.optional_stop = *on,
            OperatorCommand::BlockDelete(on) => self.switches.block_delete = *on,
            OperatorCommand::FeedOverride(ratio) => self.overrides.feed = *ratio,
            OperatorCommand::RapidOverride(ratio) => self.overrides.rapid = *ratio,
            OperatorCommand::SpindleOverride(ratio) => self.overrides.spindle = *ratio,
            OperatorCommand::Reset | OperatorCommand::ClearAlarms => self.clear_alarms(),
            _ => {}
        }
    }

    /// A job moves the axes from now on. Returns its number.
    pub fn job_begins(&mut self, activity: Activity) -> u64 {
        self.activity = activity;
        self.job += 1;
        self.result = JobResult::None;
        // Reports of an earlier job do not apply to this one.
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

    /// Puts an alarm into force, unless it is in force already.
    pub fn raise(&mut self, alarm: Alarm, text: impl Into<String>) {
        if self.alarms.iter().any(|raised| raised.alarm == alarm) {
            return;
        }
        if self.alarms.len() >= MAX_ALARMS {
            self.more_alarms = self.more_alarms.saturating_add(1);
            if !alarm.is_latched() {
                return;
            }
            // A full list: a latching alarm replaces the oldest one that does not latch, or else the last in
            // the list.
            let unlatched = self.alarms.iter().position(|raised| !raised.alarm.is_latched());
            self.alarms.remove(unlatched.unwrap_or(MAX_ALARMS - 1));
        }
        let text = text.into();
        self.alarms.push(Raised { alarm, text });
    }

    /// A fault has removed power from the drives.
    pub fn drop_power(&mut self) {
        self.enabling_since_ns = None;
        if self.machine == MachineState::On {
            self.machine = MachineState::Off;
        }
    }

    /// The emergency-stop chain was opened.
    pub fn fall_into_estop(&mut self) {
        self.machine = MachineState::Estop;
        self.enabling_since_ns = None;
    }

    fn clear_alarms(&mut self) {
        self.alarms.clear();
        self.more_alarms = 0;
    }

    /// Tracks the enabling of the drives. Raises an alarm if it takes too long.
    pub fn enable(&mut self, are_enabled: bool, now_ns: u64) {
        let Some(since) = self.enabling_since_ns else {
            return;
        };
        if are_enabled {
            self.enabling_since_ns = None;
            self.machine = MachineState::On;
        } else if now_ns.saturating_sub(since) > self.enable_timeout_ns {
            self.enabling_since_ns = None;
            self.raise(Alarm::NotEnabled, Alarm::NotEnabled.sentence());
        }
    }

    /// Sets the time within which drives have to be enabled, ns.
    pub fn set_enable_timeout_ns(&mut self, timeout_ns: u64) {
        self.enable_timeout_ns = timeout_ns;
    }

    /// The axes whose machine zero is known.
    pub fn set_homed(&mut self, homed: AxisMask) {
        self.homed = homed;
    }

    fn situation(&self, inputs: &OperatorInputs) -> InterlockState {
        InterlockState {
            machine: self.machine,
            mode: self.mode,
            activity: self.activity,
            is_loaded: self.program.is_some(),
            is_homed: self.homed & inputs.present == inputs.present,
            has_alarm: self.has_latched_alarm(),
            is_held: inputs.is_held,
        }
    }

    /// Emergency stop, off or on.
    #[must_use]
    pub fn machine(&self) -> MachineState {
        self.machine
    }

    /// Whether power is requested: on, or being enabled.
    #[must_use]
    pub fn wants_power(&self) -> bool {
        self.machine == MachineState::On || self.enabling_since_ns.is_some()
    }

    /// Automatic, manual or MDI.
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// The kind of job that moves the axes.
    #[must_use]
    pub fn activity(&self) -> Activity {
        self.activity
    }

    /// The axes whose machine zero is known.
    #[must_use]
    pub fn homed(&self) -> AxisMask {
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
        [self.overrides.feed, self.overrides.rapid, self.overrides.spindle]
    }

    /// Whether the program stops after each block.
    #[must_use]
    pub fn is_single_step(&self) -> bool {
        self.switches.single_step
    }

    /// Whether M1 stops.
    #[must_use]
    pub fn is_optional_stop(&self) -> bool {
        self.switches.optional_stop
    }

    /// Whether lines that begin with `/` are skipped.
    #[must_use]
    pub fn is_block_delete(&self) -> bool {
        self.switches.block_delete
    }

    /// Number of the job that is running or was the last.
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

    /// The alarms in force with their sentences: the cause first, the others in the order in which they came.
    ///
    /// The cause is the first fault since the alarms were cleared: what follows it (a silent bridge, then
    /// axes that are no longer homed) is usually its consequence. Without a fault it is the alarm of the job,
    /// and without that the first warning.
    pub fn alarms(&self) -> impl Iterator<Item = (Alarm, &str)> {
        let first = |kind| self.alarms.iter().position(|raised| raised.alarm.kind() == kind);
        let cause = first(AlarmKind::Fault)
            .or_else(|| first(AlarmKind::Job))
            .unwrap_or(0);
        let (before, rest) = self.alarms.split_at(cause);
        let (cause, after) = rest.split_at(rest.len().min(1));
        cause
            .iter()
            .chain(before)
            .chain(after)
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
mod tests;
