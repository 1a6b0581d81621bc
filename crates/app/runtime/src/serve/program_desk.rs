//! What the operator's programs and blocks of MDI leave and find.

use std::sync::Arc;

use super::modes::Modes;
use super::program_tally::ProgramTally;
use super::track::Track;
use crate::switches::{SwitchState, Switches};

/// Modes, switches and counts from job to job.
pub(super) struct ProgramDesk {
    pub(super) modes: Modes,
    /// Lines that set the parameters that blocks of MDI have left.
    pub(super) parameters: String,
    /// Numbers of the next block and action.
    pub(super) numbers: (u32, u32),
    /// Of the job that runs, or of the next one.
    pub(super) switches: Arc<Switches>,
    pub(super) tally: ProgramTally,
    pub(super) track: Track,
}

impl ProgramDesk {
    pub(super) fn new(modes: Modes) -> Self {
        Self {
            modes,
            parameters: String::new(),
            numbers: (0, 0),
            switches: Arc::new(Switches::new(&SwitchState::default())),
            tally: ProgramTally::default(),
            track: Track::default(),
        }
    }
}
