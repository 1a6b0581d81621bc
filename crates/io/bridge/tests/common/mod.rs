//! A bridge without hardware.

use evolvent_bridge::Hardware;
use evolvent_path::{AxisLetter, AxisMask};

/// Three axes and no signals; it opens a UDP socket if `UDP` is set.
pub(crate) struct Bench<const UDP: bool>;

impl<const UDP: bool> Hardware for Bench<UDP> {
    type Notice = String;
    type Failure = String;
    const NAME: &'static str = "bench";
    const ENTRY: &'static str = "a drive";
    const OPENS_UDP: bool = UDP;

    fn axes(&self) -> AxisMask {
        [AxisLetter::X, AxisLetter::Y, AxisLetter::Z]
            .into_iter()
            .collect()
    }
    fn has_signals(&self) -> bool {
        false
    }
    fn measures_spindles(&self) -> bool {
        false
    }
    fn text(&self, notice: String) -> String {
        notice
    }
}
