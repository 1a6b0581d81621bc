//! Threads and clocks: the real-time loop, planner feeding, publisher, recorder.
//!
//! [`run`] connects its threads by wait-free queues and joins them at the end:
//!
//! ```text
//!   planner ──► cycle ──► publisher (owns the ports of the bus)
//!   normal      FIFO  └─► recorder  (owns the trace file)
//! ```
//!
//! Publisher and recorder exist only with a bus and a trace. In real time there are two more: `carrier`,
//! which carries out user-defined M codes, and `stops`, which computes the longest stop for the status (with
//! the bus and the time-optimal planner). A trace adds `trace-sync`, a program that writes files adds `log`.
//! [`serve`] has further threads; the architecture page of the documentation lists them.
//!
//! The cycle owns nothing that can block it. [`Controls`] passes hold, override and stop to it, each as an
//! atomic that is read once per cycle. In real time an item that does not fit into a queue is dropped and
//! counted. With the virtual clock the cycle waits, because its time is not real.
//!
//! A program of one move with the virtual clock. `Silent` is a [`RunObserver`] that ignores every report.
//!
//! ```
//! use evolvent_runtime::{Controls, Job, Outcome, Setup, run};
//! # use evolvent_machine::Machine;
//! # use evolvent_runtime::{Notice, RunObserver};
//! # struct Silent;
//! # impl RunObserver for Silent {
//! #     fn progress(&mut self, _: &Controls) {}
//! #     fn notice(&mut self, _: &Notice) {}
//! #     fn note(&mut self, _: &str) {}
//! # }
//! # let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../config/machines/mill-3axis.toml");
//! # let file = std::path::PathBuf::from(file);
//!
//! let folder = tempfile::tempdir()?;
//! let program = folder.path().join("line.ngc");
//! std::fs::write(&program, "G21 G90\nG1 X10 F600\nM2\n")?;
//! let text = std::fs::read_to_string(&file)?;
//! let setup = Setup::new(Machine::load(&file)?, file, text, None)?;
//! let controls = std::sync::Arc::new(Controls::new(1.0));
//! let summary = run(&Job::new(program, setup), &controls, &mut Silent, |_| {})?.summary;
//! assert_eq!(summary.outcome, Outcome::Done);
//! // 600 mm/min
//! assert!((summary.max_velocity_mm_s[0] - 10.0).abs() < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`examine`] assesses the host for real-time use.

mod block_track;
mod check;
mod check_bounds;
mod core_loop;
mod corrections;
mod cycle_sample;
mod doctor;
mod drive_report;
mod drives;
mod due_setpoint;
mod feeder;
mod file_stamp;
mod handwheel_view;
mod host;
mod input_check;
mod input_script;
mod job;
mod job_start;
mod joined_messages;
mod leftovers;
mod load_cell;
mod log_file;
mod memory;
mod news;
mod observer;
mod pacing;
mod periphery;
mod periphery_track;
mod probe_locator;
mod probing;
mod program_copy;
mod program_cycle;
mod publish_report;
mod publisher;
mod publishing;
mod queues;
mod recompute;
mod recompute_served;
mod recording;
mod refusal;
mod rt;
mod run;
mod run_info;
mod run_report;

mod run_status;
mod run_threads;
mod serve;
mod shared;
mod signal_check;
mod signal_ends;
mod signal_loop;
mod signal_port;
mod signal_recorder;
mod signal_replay;
mod source;
mod spindle_command;
mod spindle_rundown;
mod spindle_speedometer;
mod spindle_stall;
mod spindle_status;
mod stages;
mod standby;
mod start_error;
mod status_source;
mod stop_watch;
mod summary;
mod switches;
mod tally;
mod threading;
mod turning;
mod turning_motion;
mod turning_tally;
mod unlikely_feed;
mod user_code;
mod user_code_runner;

pub use check::{Checked, Warning, check};
pub use check_bounds::{CheckBound, CheckBounds, Unchecked};
pub use corrections::Corrections;
pub use doctor::{BareLoopError, DoctorReport, Finding, LatenessReport, Verdict, bare_loop, examine};
pub use drives::{phase_settings, watch_settings};
pub use evolvent_control::Alarm;
pub use file_stamp::file_stamp;
pub use input_check::objection_to_inputs;
pub use input_script::{InputScript, InputScriptError};
pub use job::{Clock, Job, Setup};
pub use job_start::{JobStart, ProgramStart, SteeredStart};
pub use memory::ProgramMemory;
pub use news::Notice;
pub use observer::RunObserver;
pub use program_cycle::ObservedCycle;
pub use recompute::{Recomputed, RecordedInputs, platform, recompute};
pub use recompute_served::{Moved, ServedAgain, ServedError};
pub use refusal::ProgramError;
pub use rt::{LowLatencyHold, MonotonicClock, RealtimeGranted, RealtimeRequest, apply_to_this_thread};
pub use run::{RunOutcome, run, run_observed};
pub use run_info::TABLES;
pub use serve::{BEFORE_LINE, ServeConfig, ServeNews, ServeSummary, TraceTo, serve, state_folder};
pub use shared::{Controls, Progress};
pub use signal_loop::{SignalChange, SignalName};
pub use signal_replay::OutputDifference;
pub use source::{Commands, Start};
pub use start_error::StartError;
pub use summary::{AxisSummary, Outcome, Summary, TimingSummary};
pub use switches::{SwitchState, Switched};
pub use turning_tally::TurningSummary;
