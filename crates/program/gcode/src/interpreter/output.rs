//! Commands between a line and the consumer.

use std::collections::VecDeque;

use crate::CanonicalCommand;
use crate::execution::compensation::ChangedCommand;
use crate::execution::contour_checker::ContourChecker;
use crate::interpreter::surface_feed::SurfaceFeed;

/// The queue of commands from a line to the consumer.
#[derive(Default)]
pub(crate) struct Output {
    /// Commands of the last line that have not been requested yet.
    pub(crate) pending: VecDeque<CanonicalCommand>,
    /// Commands of earlier lines that the present line has changed.
    pub(crate) changed: Vec<ChangedCommand>,
    /// Contours whose parts may be too close to each other.
    pub(super) contour_checker: ContourChecker,
    /// Moves whose feed follows the spindle speed.
    pub(crate) surface_feed: SurfaceFeed,
    /// Number of lines since the last command.
    pub(super) lines_without_command: u64,
}
