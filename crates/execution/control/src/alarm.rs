//! Alarms by number: what went wrong, and what to do.

/// Category of an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlarmKind {
    /// A command was rejected. Nothing has changed, nothing is latched.
    Rejection,
    /// A job ended early. Reported until the next job starts or the alarms are cleared.
    Job,
    /// The machine was stopped. Latched: nothing moves until the alarms are cleared.
    Fault,
    /// Something is degraded; the machine continues.
    Warning,
}

macro_rules! alarms {
    ($($(#[doc = $doc:literal])* $name:ident = $number:literal, $kind:ident, $advice:literal;)*) => {
        /// Stable number of an alarm: in replies, in the status and in the events of the trace.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u32)]
        pub enum Alarm {
            $($(#[doc = $doc])* $name = $number,)*
        }

        impl Alarm {
            /// All alarms in order of their numbers.
            pub const ALL: &[Self] = &[$(Self::$name,)*];

            /// The category.
            #[must_use]
            pub const fn kind(self) -> AlarmKind {
                match self {
                    $(Self::$name => AlarmKind::$kind,)*
                }
            }

            /// The default sentence: what it means and what to do.
            #[must_use]
            pub const fn sentence(self) -> &'static str {
                match self {
                    $(Self::$name => $advice,)*
                }
            }
        }
    };
}

alarms! {
    /// The program cannot be read, or has an error in it; it was run up to there.
    Program = 100, Job, "the program has an error and was run up to it; check it with `evolvent check`";
    /// A block of MDI cannot be executed.
    Mdi = 101, Job, "the MDI block has an error; nothing has moved";
    /// A user-defined M code has failed.
    UserCommand = 102, Fault, "a user-defined M code (M100 to M199) has failed; read its message, then clear \
                               the alarms";
    /// A tool change was not finished.
    ToolChange = 103, Fault, "a tool change was interrupted and the tool in the spindle is unknown; check \
                              the spindle, clear the alarms, and set the tool with M61";
    /// The guard rejected a setpoint that would have broken a limit.
    Guard = 200, Fault, "the guard rejected a setpoint beyond a limit and the machine was stopped; please \
                         report it with the trace";
    /// The planner ended without completing its plan.
    Planner = 201, Fault, "the planner ended without completing its plan; the machine stopped on the path";
    /// A job did not begin at the position of the axes.
    Handover = 202, Fault, "a job did not begin where the axes are and was not started; please report it \
                            with the trace";
    /// The queue of orders to the cycle was full.
    OrdersLost = 203, Fault, "more commands arrived than the cycle could execute, so the emergency stop was \
                              set; find the client that sends too many commands, and run `evolvent doctor`";
    /// Too many consecutive setpoints were published after their due time.
    Lateness = 300, Fault, "too many consecutive setpoints were published late; run `evolvent doctor`, or \
                            lower the rate";
    /// No feedback has ever come.
    NoFeedback = 400, Fault, "no feedback was received; start the drive bridge, or find out why it does not \
                              reply";
    /// Feedback has stopped.
    FeedbackStale = 401, Fault, "feedback has stopped; check that the bridge runs, then clear the alarms";
    /// Messages arrive, but their samples do not get newer.
    FeedbackFrozen = 402, Fault, "the bridge repeats its feedback; it runs without its drives: check the \
                                  fieldbus";
    /// An axis moves and its encoder keeps the same value.
    EncoderFrozen = 403, Fault, "an encoder value does not change although its axis moves; check the encoder \
                                 and its cable";
    /// A value is not a number.
    FeedbackBad = 404, Fault, "the feedback contains a value that is not a number; check encoder and bridge";
    /// The feedback does not contain an axis.
    AxisMissing = 405, Fault, "the bridge sends no feedback for an axis; configure it for all axes of the \
                               machine";
    /// A drive is in fault.
    DriveFault = 406, Fault, "a drive is in fault; read its fault message, then clear the alarms and switch \
                              on";
    /// A drive left operation on its own.
    DriveOff = 407, Fault, "a drive has switched off by itself; check its enable input and its supply, or \
                            switch on again after homing by the drive";
    /// The drives were not enabled in time.
    NotEnabled = 408, Fault, "the drives were not enabled in time; check supply, safety circuit and bridge, \
                              and whether the drives home by themselves";
    /// The actual position jumped.
    PositionJump = 409, Fault, "the actual position jumped; check encoder and cable, and home again";
    /// The following error is too large.
    FollowingError = 410, Fault, "the following error of an axis is too large; look for a blocked axis or a \
                                  weak drive";
    /// A limit switch was run onto.
    LimitSwitch = 411, Fault, "an axis ran onto a limit switch; clear the alarms, then jog off the switch in \
                               the other direction";
    /// The bridge was started again under power.
    BridgeRestarted = 412, Fault, "the bridge was restarted under power; switch on again, and home if \
                                   positions are lost";
    /// The bridge stopped following.
    BridgeStopped = 413, Fault, "the bridge has stopped the axes by itself; it received no usable setpoints";
    /// Replies without a request.
    Implausible = 414, Fault, "the bridge replies to setpoints that were never sent; restart it";
    /// Positions refer to another datum.
    Datum = 415, Fault, "the bridge reports positions relative to another datum; home again";
    /// A sample is from the future.
    FeedbackAhead = 416, Fault, "the feedback's time is ahead of this computer's clock; correct the bridge's \
                                 clock";
    /// Feedback has an impossible value.
    FeedbackUnbelievable = 417, Fault, "the feedback has an impossible value; check encoder and bridge";
    /// Axes are no longer homed.
    ReferenceLost = 418, Warning, "the link to the drives was lost, and machine zero with it; home again";
    /// The home switch was not found.
    HomeSwitchMissing = 420, Fault, "the home switch was not found within the travel; check its wiring";
    /// The home switch does not release.
    HomeSwitchStuck = 421, Fault, "the home switch does not release; check its wiring";
    /// The index pulse did not come within its distance.
    IndexMissing = 422, Fault, "the index pulse of an encoder was not found within its distance; check its \
                                wiring and the bridge";
    /// The encoder does not know machine zero.
    NotAbsolute = 423, Fault, "an encoder does not report that it counts from machine zero; check its \
                               battery and its drive";
    /// The emergency-stop chain is open or unknown.
    EmergencyStopChain = 430, Fault, "the emergency-stop chain is open or unknown; close it, check that its \
                                      bridge runs, then reset";
    /// A spindle's drive is in fault, or its feedback is missing.
    Spindle = 440, Fault, "a spindle is in fault, or its feedback is missing; check its drive and its \
                           bridge, then start again";
    /// The cutting load was above its limit.
    CuttingLoad = 500, Fault, "the cutting load was too high; check tool and stock, then start again";
    /// The load sensor is implausible.
    LoadSensor = 501, Fault, "the readings of the load sensor are missing or not plausible; check the sensor \
                              and its cable, then start again";
    /// State cannot be saved.
    NotKept = 600, Warning, "offsets, tools or parameters cannot be saved; check the state folder";
    /// Saved state cannot be read.
    NotRead = 601, Warning, "saved offsets, tools or parameters cannot be read; their file is set aside";
    /// The trace failed.
    Trace = 602, Warning, "the trace can no longer be written; check the disk";
    /// The request has another version or size, no client number, or invalid UTF-8.
    Malformed = 900, Rejection, "the request is damaged or of another version; update the client";
    /// No command has this number.
    UnknownCommand = 901, Rejection, "no command has this number; update the core or the client";
    /// A number is not finite or out of its range.
    BadNumber = 902, Rejection, "a number is not finite or out of its range";
    /// The serial number of the command is not above the last of its client.
    Stale = 903, Rejection, "the command is not newer than the client's last one and has no effect";
    /// The axis does not exist, or none was named.
    NoAxis = 904, Rejection, "the machine has no such axis";
    /// The machine is in emergency stop.
    InEstop = 910, Rejection, "the machine is in emergency stop; reset it first";
    /// The machine is not in emergency stop.
    NotInEstop = 911, Rejection, "the machine is not in emergency stop";
    /// The machine is off.
    IsOff = 912, Rejection, "the machine is off; switch it on first";
    /// Another mode is needed.
    WrongMode = 913, Rejection, "this command needs another mode";
    /// Something else moves the axes.
    Busy = 914, Rejection, "another job moves the axes; stop it or wait until it ends";
    /// Nothing runs to which the command could apply.
    NothingRuns = 915, Rejection, "nothing is running to which this command could apply";
    /// Axes have not been homed.
    NotHomed = 916, Rejection, "not all axes are homed; home them first";
    /// No program is loaded.
    NoProgram = 917, Rejection, "no program is loaded; load one first";
    /// An alarm is latched.
    Latched = 918, Rejection, "an alarm is latched; check the status, then clear the alarms";
    /// The move would leave the travel.
    SoftLimit = 919, Rejection, "the move would leave the travel of an axis";
    /// Neither held nor at a program stop.
    NotHeld = 920, Rejection, "the program is neither held nor at a program stop";
    /// The axes still move.
    Moving = 921, Rejection, "the axes still move; wait until they are at rest";
    /// A file cannot be read or written.
    File = 922, Rejection, "a file cannot be read or written";
    /// The program has errors.
    BadProgram = 923, Rejection, "the program has errors; check it with `evolvent check`";
    /// The core is about to end.
    Ending = 924, Rejection, "the core is shutting down and accepts no more commands";
    /// The machine is on.
    IsOn = 925, Rejection, "the machine is on; switch it off first";
    /// The program is still being checked.
    Checking = 926, Rejection, "the program is still being checked; start it when the check is complete";
    /// The loaded program may not be the one that the client means.
    OtherProgram = 927, Rejection, "the loaded program is not the one named in the command; load that one, \
                                    or name the loaded one";
    /// The emergency-stop chain is open.
    ChainOpen = 928, Rejection, "the emergency-stop chain is open or unknown; close it, and check that its \
                                 bridge runs";
    /// The machine file has no such output.
    NoSignal = 929, Rejection, "the machine file has no output of this name";
    /// The tool in the spindle is not known.
    ToolUnknown = 930, Rejection, "a tool change was interrupted and the tool in the spindle is unknown; \
                                   check the spindle, and set the tool with M61";
    /// HANDWHEEL on a machine without one, or whose wheel has switches.
    NoHandwheel = 931, Rejection, "the machine file has no [handwheel]; add it, or jog by command";
    /// RESUME or STEP while the axes are away from the program.
    OffPath = 932, Rejection, "the axes are away from the program; drive back with `return`, then resume";
    /// The program is not at a point at which it can be left.
    CannotLeave = 933, Rejection, "the program cannot be left at this point; hold it, and wait until the \
                                   axes are at rest";
    /// The path does not reach so far back, or cannot be retraced from here.
    CannotRetrace = 934, Rejection, "the path cannot be retraced that far";
}

impl Alarm {
    /// The number on the bus and in the trace.
    #[must_use]
    pub const fn number(self) -> u32 {
        self as u32
    }

    /// The alarm with this number.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.iter().copied().find(|alarm| alarm.number() == number)
    }

    /// Whether nothing may move until the alarm is cleared.
    #[must_use]
    pub const fn is_latched(self) -> bool {
        matches!(self.kind(), AlarmKind::Fault)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_that_clients_rely_on() {
        let numbers = [Alarm::Program, Alarm::Guard, Alarm::Planner, Alarm::Lateness].map(Alarm::number);
        assert_eq!(numbers, [100, 200, 201, 300]);
    }

    #[test]
    fn every_alarm_has_a_number_and_a_sentence() {
        for pair in Alarm::ALL.windows(2) {
            assert!(pair[0].number() < pair[1].number(), "{pair:?}");
        }
        for &alarm in Alarm::ALL {
            assert_eq!(Alarm::from_number(alarm.number()), Some(alarm));
            assert!(alarm.sentence().len() > 20, "{alarm:?}");
        }
        assert_eq!(Alarm::from_number(0), None);
    }

    #[test]
    fn only_faults_are_latched() {
        for &alarm in Alarm::ALL {
            let rejection = (900..1000).contains(&alarm.number());
            assert_eq!(alarm.kind() == AlarmKind::Rejection, rejection, "{alarm:?}");
        }
        assert!(Alarm::DriveFault.is_latched() && !Alarm::Program.is_latched() && !Alarm::Trace.is_latched());
    }
}
