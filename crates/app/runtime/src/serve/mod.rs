//! A served machine: one long-lived cycle, and jobs that start and end.

#[cfg(test)]
mod bench;
mod calls;
mod change_mark;
mod checking;
mod commands;
mod config;
mod control_loop;
mod drive_view;
mod events;
mod file_work;
mod files;
mod handwheel;
mod homing;
#[cfg(test)]
mod homing_trials;
mod jobs;
mod jog;
mod jog_intent;
#[cfg(test)]
mod jog_trials;
mod leaving;
mod modes;
mod notify;
mod operator;
mod operator_message;
mod order_book;
mod orders;
mod outputs;
mod periphery_state;
mod program_context;
mod program_tally;
mod programs;
mod reading;
mod recorded;
mod series;
mod served_cycle;
mod served_status;
mod server;
mod session_trace;
mod snapshot;
mod state_lock;
mod state_store;
mod status_writer;
#[cfg(test)]
mod stop_trials;
mod summary;
mod turns;
mod urgent;

pub use config::{ServeConfig, ServeNews, TraceTo};
pub(crate) use jobs::{Planning, ProgramJob};
pub(crate) use orders::Following;
pub use programs::BEFORE_LINE;
pub(crate) use series::{FileProgress, TraceSeries};
pub use server::serve;
pub use state_store::state_folder;
pub use summary::ServeSummary;

#[cfg(test)]
mod tests {
    use evolvent_bus::{ACTIVITIES, COMMANDS, JOB_RESULTS, MACHINE_STATES, MODES, VERDICTS};
    use evolvent_control::{Activity, Alarm, CommandCode, CommandVerdict, JobResult, MachineState, Mode};
    use evolvent_drive::DriveAlarm;

    #[test]
    fn numbers_and_names_of_desk_and_bus_are_the_same() {
        let commands: Vec<(&str, u32)> = CommandCode::ALL
            .iter()
            .map(|code| (code.name(), *code as u32))
            .collect();
        assert_eq!(commands, COMMANDS);
        let spelled = |name: &dyn std::fmt::Debug| format!("{name:?}").to_uppercase();
        let numbered = |list: &[(&str, u32)], name: &dyn std::fmt::Debug, number: u32| {
            assert!(list.contains(&(spelled(name).as_str(), number)), "{name:?}");
        };
        for state in [MachineState::Estop, MachineState::Off, MachineState::On] {
            numbered(&MACHINE_STATES, &state, state as u32);
        }
        for mode in [Mode::Auto, Mode::Manual, Mode::Mdi] {
            numbered(&MODES, &mode, mode as u32);
        }
        for activity in [
            Activity::None,
            Activity::Program,
            Activity::Mdi,
            Activity::Jog,
            Activity::Homing,
        ] {
            numbered(&ACTIVITIES, &activity, activity as u32);
        }
        for result in [
            JobResult::None,
            JobResult::Done,
            JobResult::Stopped,
            JobResult::Failed,
            JobResult::Fault,
        ] {
            numbered(&JOB_RESULTS, &result, result as u32);
        }
        for verdict in [
            CommandVerdict::Accepted,
            CommandVerdict::Rejected,
            CommandVerdict::Stale,
        ] {
            numbered(&VERDICTS, &verdict, verdict as u32);
        }
    }

    #[test]
    fn every_drive_alarm_is_a_latched_operator_alarm() {
        let first = DriveAlarm::Missing { waited_ns: 0 }.number();
        let last = DriveAlarm::Datum {
            expected: 0,
            found: 0,
        }
        .number();
        for number in first..=last {
            let alarm = Alarm::from_number(number).expect("an alarm of this number");
            assert!(alarm.is_latched(), "{alarm:?}");
        }
        assert_eq!(Alarm::from_number(406), Some(Alarm::DriveFault));
    }
}
