//! The interlocks: one row per command.

use crate::alarm::Alarm;
use crate::command_code::CommandCode as Code;
use crate::interlock_state::{Activity, InterlockState, MachineState, Mode};

/// When a command is accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rule {
    /// The command.
    pub command: Code,
    /// Accepted in emergency stop, off, on.
    pub machine: [bool; 3],
    /// Accepted in automatic, manual, MDI.
    pub mode: [bool; 3],
    /// Accepted while nothing, a program, MDI, a jog, homing moves the axes.
    pub activity: [bool; 5],
    /// Needs every axis homed.
    pub homed: bool,
    /// Needs a program.
    pub loaded: bool,
    /// Needs that no alarm is latched.
    pub clear: bool,
    /// Needs a feed hold or a program stop.
    pub held: bool,
    /// Also accepted, in any mode, while a program or MDI is held.
    pub while_held: bool,
}

const YES: bool = true;
const NO: bool = false;

const ANY: [bool; 3] = [YES; 3];
const AWAKE: [bool; 3] = [NO, YES, YES];
const ON: [bool; 3] = [NO, NO, YES];
const ALWAYS: [bool; 5] = [YES; 5];
const IDLE: [bool; 5] = [YES, NO, NO, NO, NO];

const fn rule(command: Code, machine: [bool; 3], mode: [bool; 3], activity: [bool; 5]) -> Rule {
    Rule {
        command,
        machine,
        mode,
        activity,
        homed: false,
        loaded: false,
        clear: false,
        held: false,
        while_held: false,
    }
}

/// Every command, in order of its number.
pub const RULES: [Rule; 31] = [
    rule(Code::Estop, ANY, ANY, ALWAYS),
    rule(Code::EstopReset, [YES, NO, NO], ANY, IDLE),
    Rule {
        clear: true,
        ..rule(Code::On, AWAKE, ANY, ALWAYS)
    },
    rule(Code::Off, ANY, ANY, IDLE),
    rule(Code::Mode, ANY, ANY, IDLE),
    rule(Code::Load, ANY, ANY, IDLE),
    Rule {
        homed: true,
        loaded: true,
        clear: true,
        ..rule(Code::Start, ON, [YES, NO, NO], IDLE)
    },
    rule(Code::Hold, ON, ANY, [NO, YES, YES, NO, NO]),
    Rule {
        clear: true,
        held: true,
        ..rule(Code::Resume, ON, ANY, [NO, YES, YES, NO, NO])
    },
    Rule {
        homed: true,
        loaded: true,
        clear: true,
        ..rule(Code::Step, ON, [YES, NO, NO], [YES, YES, NO, NO, NO])
    },
    rule(Code::Stop, ANY, ANY, ALWAYS),
    rule(Code::Reset, ANY, ANY, IDLE),
    rule(Code::SingleStep, ANY, ANY, ALWAYS),
    rule(Code::OptionalStop, ANY, ANY, ALWAYS),
    rule(Code::BlockDelete, ANY, ANY, ALWAYS),
    rule(Code::FeedOverride, ANY, ANY, ALWAYS),
    rule(Code::RapidOverride, ANY, ANY, ALWAYS),
    rule(Code::SpindleOverride, ANY, ANY, ALWAYS),
    Rule {
        homed: true,
        clear: true,
        ..rule(Code::Mdi, ON, [NO, NO, YES], IDLE)
    },
    Rule {
        clear: true,
        while_held: true,
        ..rule(Code::Jog, ON, [NO, YES, NO], [YES, NO, NO, YES, NO])
    },
    rule(Code::JogKeep, ANY, ANY, ALWAYS),
    rule(Code::JogStop, ANY, ANY, ALWAYS),
    Rule {
        clear: true,
        ..rule(Code::Home, ON, [NO, YES, NO], IDLE)
    },
    rule(Code::WorkOffset, ANY, ANY, IDLE),
    rule(Code::TouchOff, ANY, ANY, IDLE),
    rule(Code::Tool, ANY, ANY, IDLE),
    rule(Code::ClearAlarms, ANY, ANY, IDLE),
    // Only a program sets outputs while it runs.
    rule(Code::SetOutput, AWAKE, ANY, [YES, NO, NO, YES, NO]),
    // This only selects the axis: motion of the wheel is checked as a jog.
    rule(Code::Handwheel, ANY, ANY, ALWAYS),
    Rule {
        clear: true,
        held: true,
        ..rule(Code::Return, ON, ANY, [NO, YES, YES, NO, NO])
    },
    Rule {
        clear: true,
        held: true,
        ..rule(Code::Retrace, ON, ANY, [NO, YES, YES, NO, NO])
    },
];

/// Whether a command is accepted in a state.
///
/// ```
/// use evolvent_control::{Activity, Alarm, CommandCode, InterlockState, MachineState, Mode, judge};
///
/// let mut state = InterlockState {
///     machine: MachineState::On,
///     mode: Mode::Auto,
///     activity: Activity::None,
///     is_loaded: true,
///     is_homed: false,
///     has_alarm: false,
///     is_held: false,
/// };
/// assert_eq!(judge(CommandCode::Start, &state), Err(Alarm::NotHomed));
/// state.is_homed = true;
/// assert_eq!(judge(CommandCode::Start, &state), Ok(()));
/// ```
///
/// # Errors
/// The first reason for a rejection, in the order machine, alarm, mode, activity, program, homing, hold.
pub fn judge(command: Code, situation: &InterlockState) -> Result<(), Alarm> {
    let rule = &RULES[command as usize - 1];
    if !rule.machine[situation.machine as usize] {
        return Err(match situation.machine {
            MachineState::Estop => Alarm::InEstop,
            _ if rule.machine == [YES, NO, NO] => Alarm::NotInEstop,
            MachineState::Off => Alarm::IsOff,
            MachineState::On => Alarm::IsOn,
        });
    }
    if rule.clear && situation.has_alarm {
        return Err(Alarm::Latched);
    }
    let is_job = matches!(situation.activity, Activity::Program | Activity::Mdi);
    if rule.while_held && is_job {
        // The missing condition is a hold: another mode would not help.
        return if situation.is_held {
            Ok(())
        } else {
            Err(Alarm::Busy)
        };
    }
    if !rule.mode[situation.mode as usize] {
        // While a job moves the axes the mode cannot be changed: the job is the reason.
        let is_blocking = situation.activity != Activity::None && !rule.activity[situation.activity as usize];
        return Err(if is_blocking && rule.activity[Activity::None as usize] {
            Alarm::Busy
        } else {
            Alarm::WrongMode
        });
    }
    if !rule.activity[situation.activity as usize] {
        // Only motion along a path can be held; a jog or a homing sequence is stopped.
        return Err(if rule.activity[Activity::None as usize] {
            Alarm::Busy
        } else {
            Alarm::NothingRuns
        });
    }
    if rule.loaded && !situation.is_loaded {
        return Err(Alarm::NoProgram);
    }
    if rule.homed && !situation.is_homed {
        return Err(Alarm::NotHomed);
    }
    if rule.held && !situation.is_held {
        return Err(Alarm::NotHeld);
    }
    Ok(())
}

/// The mode that a command requires, if any.
pub(crate) fn mode_needed(command: Code) -> Option<Mode> {
    let modes = RULES[command as usize - 1].mode;
    let found = [Mode::Auto, Mode::Manual, Mode::Mdi]
        .into_iter()
        .filter(|&mode| modes[mode as usize]);
    let mut found: Vec<Mode> = found.collect();
    if found.len() == 1 { found.pop() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Written by hand, independently of [`RULES`]: the machine states, modes and activities in which each
    /// command is accepted, and its other conditions. E e-stop, F off, N on; a auto, m manual, i MDI; -
    /// nothing, p program, b MDI block, j jog, h homing; H homed, L loaded, C clear of alarms, W waiting
    /// (held).
    const TABLE: &str = "
        ESTOP            EFN ami -pbjh
        ESTOP_RESET      E   ami -
        ON               FN  ami -pbjh C
        OFF              EFN ami -
        MODE             EFN ami -
        LOAD             EFN ami -
        START            N   a   -     HLC
        HOLD             N   ami pb
        RESUME           N   ami pb    CW
        STEP             N   a   -p    HLC
        STOP             EFN ami -pbjh
        RESET            EFN ami -
        SINGLE_STEP      EFN ami -pbjh
        OPTIONAL_STOP    EFN ami -pbjh
        BLOCK_DELETE     EFN ami -pbjh
        FEED_OVERRIDE    EFN ami -pbjh
        RAPID_OVERRIDE   EFN ami -pbjh
        SPINDLE_OVERRIDE EFN ami -pbjh
        MDI              N   i   -     HC
        JOG              N   m   -j    CA
        JOG_KEEP         EFN ami -pbjh
        JOG_STOP         EFN ami -pbjh
        HOME             N   m   -     C
        WORK_OFFSET      EFN ami -
        TOUCH_OFF        EFN ami -
        TOOL             EFN ami -
        CLEAR_ALARMS     EFN ami -
        SET_OUTPUT       FN  ami -j
        HANDWHEEL        EFN ami -pbjh
        RETURN           N   ami pb    CW
        RETRACE          N   ami pb    CW";

    fn situations() -> impl Iterator<Item = InterlockState> {
        let machines = [MachineState::Estop, MachineState::Off, MachineState::On];
        let modes = [Mode::Auto, Mode::Manual, Mode::Mdi];
        let activities = [
            Activity::None,
            Activity::Program,
            Activity::Mdi,
            Activity::Jog,
            Activity::Homing,
        ];
        (0..3 * 3 * 5 * 16).map(move |n| InterlockState {
            machine: machines[n % 3],
            mode: modes[n / 3 % 3],
            activity: activities[n / 9 % 5],
            is_loaded: (n / 45) & 1 == 1,
            is_homed: (n / 45) & 2 == 2,
            has_alarm: (n / 45) & 4 == 4,
            is_held: (n / 45) & 8 == 8,
        })
    }

    #[test]
    fn interlocks_match_the_table_in_every_state() {
        let mut rows = 0;
        for row in TABLE.lines().filter(|row| !row.trim().is_empty()) {
            let words: Vec<&str> = row.split_whitespace().collect();
            let [name, machines, modes, activities, needs @ ..] = words.as_slice() else {
                panic!("{row}");
            };
            let needs = needs.first().copied().unwrap_or("");
            let command = Code::ALL[rows];
            assert_eq!(command.name(), *name);
            rows += 1;
            for situation in situations() {
                let machine = ['E', 'F', 'N'][situation.machine as usize];
                let mode = ['a', 'm', 'i'][situation.mode as usize];
                let activity = ['-', 'p', 'b', 'j', 'h'][situation.activity as usize];
                // In any mode while a program or MDI is held.
                let while_held = needs.contains('A')
                    && machines.contains(machine)
                    && !situation.has_alarm
                    && situation.is_held
                    && "pb".contains(activity);
                let accepted = while_held
                    || machines.contains(machine)
                        && modes.contains(mode)
                        && activities.contains(activity)
                        && (situation.is_homed || !needs.contains('H'))
                        && (situation.is_loaded || !needs.contains('L'))
                        && (!situation.has_alarm || !needs.contains('C'))
                        && (situation.is_held || !needs.contains('W'));
                let judged = judge(command, &situation);
                assert_eq!(judged.is_ok(), accepted, "{name} in {situation:?}: {judged:?}");
            }
        }
        assert_eq!(rows, Code::ALL.len());
    }

    #[test]
    fn a_rejection_names_the_reason_to_act_on_first() {
        let idle = InterlockState {
            machine: MachineState::On,
            mode: Mode::Auto,
            activity: Activity::None,
            is_loaded: true,
            is_homed: true,
            has_alarm: false,
            is_held: false,
        };
        let cases = [
            (
                Code::Start,
                InterlockState {
                    machine: MachineState::Estop,
                    has_alarm: true,
                    ..idle
                },
                Alarm::InEstop,
            ),
            (
                Code::Start,
                InterlockState {
                    machine: MachineState::Off,
                    ..idle
                },
                Alarm::IsOff,
            ),
            (Code::EstopReset, idle, Alarm::NotInEstop),
            (
                Code::Start,
                InterlockState {
                    has_alarm: true,
                    ..idle
                },
                Alarm::Latched,
            ),
            (
                Code::Start,
                InterlockState {
                    mode: Mode::Mdi,
                    ..idle
                },
                Alarm::WrongMode,
            ),
            (
                Code::Start,
                InterlockState {
                    activity: Activity::Program,
                    ..idle
                },
                Alarm::Busy,
            ),
            (
                Code::Mdi,
                InterlockState {
                    mode: Mode::Manual,
                    activity: Activity::Jog,
                    ..idle
                },
                Alarm::Busy,
            ),
            (
                Code::Mdi,
                InterlockState {
                    mode: Mode::Manual,
                    ..idle
                },
                Alarm::WrongMode,
            ),
            (
                Code::Start,
                InterlockState {
                    is_loaded: false,
                    is_homed: false,
                    ..idle
                },
                Alarm::NoProgram,
            ),
            (
                Code::Start,
                InterlockState {
                    is_homed: false,
                    ..idle
                },
                Alarm::NotHomed,
            ),
            (Code::Hold, idle, Alarm::NothingRuns),
            (
                Code::Hold,
                InterlockState {
                    activity: Activity::Jog,
                    ..idle
                },
                Alarm::NothingRuns,
            ),
            (
                Code::Resume,
                InterlockState {
                    activity: Activity::Program,
                    ..idle
                },
                Alarm::NotHeld,
            ),
        ];
        for (command, situation, expected) in cases {
            assert_eq!(
                judge(command, &situation),
                Err(expected),
                "{command:?} in {situation:?}"
            );
        }
    }

    #[test]
    fn rows_stand_in_the_order_of_the_numbers() {
        for (index, rule) in RULES.iter().enumerate() {
            assert_eq!(rule.command as usize, index + 1);
        }
        assert_eq!(mode_needed(Code::Jog), Some(Mode::Manual));
        assert_eq!(mode_needed(Code::Stop), None);
    }
}
