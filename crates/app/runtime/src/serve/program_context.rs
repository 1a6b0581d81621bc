//! State that programs and blocks of MDI pass to the next one.

use std::sync::Arc;

use super::modes::Modes;
use super::program_tally::ProgramTally;
use crate::block_track::BlockTrack;
use crate::switches::{SwitchState, Switches};

/// Modes, switches and counts that continue from job to job.
pub(super) struct ProgramContext {
    pub(super) modes: Modes,
    /// Lines that restore the parameters set by blocks of MDI.
    pub(super) parameters: String,
    /// Numbers of the next block and action.
    pub(super) numbers: (u32, u32),
    /// Lines of the last job before those of the operator: the preamble of a block of MDI.
    pub(super) lines_before: u32,
    /// Of the running job, or of the next one.
    pub(super) switches: Arc<Switches>,
    pub(super) tally: ProgramTally,
    pub(super) track: BlockTrack,
}

impl ProgramContext {
    pub(super) fn new(modes: Modes) -> Self {
        Self {
            modes,
            parameters: String::new(),
            numbers: (0, 0),
            lines_before: 0,
            switches: Arc::new(Switches::new(&SwitchState::default())),
            tally: ProgramTally::default(),
            track: BlockTrack::default(),
        }
    }
}
