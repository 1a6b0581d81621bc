//! Outputs, inputs and waits in the cycle: which output changes at which setpoint.
//!
//! The planner's thread schedules [`OutputChange`]s and [`InputWait`]s through a [`Scheduler`]; the cycle executes
//! them through [`Signals`], once per setpoint. Programs come and go; outputs, inputs and their rules stay.
//!
//! ```
//! use evolvent_machine::SignalSettings;
//! use evolvent_signals::{OutputChange, SignalMoment, Phase, Progress, Signals, schedule};
//!
//! let mut signals = Signals::new(&SignalSettings::default(), 2, 1_000_000);
//! let (mut scheduler, consumer) = schedule();
//! signals.begin_program(consumer);
//! let mut change = OutputChange::at(SignalMoment::Block(3));
//! change.set_digital(0, true);
//! assert!(scheduler.change(change));
//! let before = Progress { actions: 0, blocks: 3, phase: Phase::Runs, x_mm: 0.0 };
//! assert_eq!(signals.step(&before).digital, 0);
//! // Block 3 is the fourth to begin.
//! assert_eq!(signals.step(&Progress { blocks: 4, ..before }).digital, 1);
//! ```
//!
//! A change takes effect from a *moment* on: with the first setpoint of a block (M62, M63, M67), or at rest
//! with an action (M64, M65, M68). The setpoint carries the numbers of both, so nothing is timed: at any
//! rate, with any override and holds, a change takes effect with the setpoint that begins the block. A wait
//! (M66) begins when the setpoint at which the axes are at rest is due, one lead after its computation,
//! because outputs that the program has switched before take effect only then.
//!
//! Real-time safety: [`Signals`] neither allocates nor frees. Executed entries return to the scheduler, which
//! drops them. The same schedule, progress and inputs give the same outputs, cycle by cycle.

mod encoder_step;
mod feed_law;
mod image;
mod override_switches;
mod probe_image;
mod schedule;
mod signals;
mod spindle_input;
mod spindle_state;
mod spindle_tracker;
mod virtual_spindle;
mod wait;

pub use feed_law::FeedLaw;
pub use image::{InputImage, OutputImage};
pub use override_switches::OverrideSwitches;
pub use probe_image::{ProbeImage, ProbeInput, ProbeState, probe_numbers};
pub use schedule::{OutputChange, ScheduleConsumer, Scheduler, SignalMoment, schedule};
pub use signals::{Phase, Progress, Signals};
pub use spindle_input::{SpindleInput, SpindleKnowledge};
pub use spindle_state::SpindleState;
pub use spindle_tracker::{AngleJet, HARMONICS, SpindleAngle, SpindleMotion, SpindleTracker};
pub use virtual_spindle::SpindleTarget;
pub use wait::{Awaited, InputWait, WaitMode, WaitResult};
