//! The drives' last feedback.

use evolvent_bus::Feedback;
use evolvent_control::HomingSample;
use evolvent_drive::FeedbackBounds;
use evolvent_path::{Axes, AxisMask};

use super::orders::CycleView;

/// New coordinates of axes at rest.
pub(super) struct Renaming {
    pub(super) datum: u64,
    /// Axes that this homes.
    pub(super) zeroed: AxisMask,
    /// Position of the axes in the new coordinates.
    pub(super) stand: Axes,
    /// [`DriveView::home_offset`] after it.
    pub(super) home_offset: Axes,
}

/// The newest plausible feedback, and the coordinates that the drives use.
pub(super) struct DriveView {
    pub(super) feedback: Option<Feedback>,
    bounds: FeedbackBounds,
    /// The datum of the last renaming.
    pub(super) datum: u64,
    /// Axes whose machine zero that renaming sets. They are homed once the drives report the new coordinates.
    pub(super) zeroed: AxisMask,
    /// Position of the axes in the new coordinates.
    stand: Axes,
    /// The order to rename; `None` once the cycle has taken it.
    order: Option<u64>,
    /// `home_offset` before that order.
    before: Axes,
    /// What a pending order adds to the axes' coordinates; zero once the cycle has applied it.
    pub(super) renaming: Axes,
    /// Machine coordinates of the drives' first datum minus the present ones.
    pub(super) home_offset: Axes,
    /// Number of the next request for an index pulse, and the axis of the last request.
    pub(super) next_index: u32,
    pub(super) index_axis: Option<usize>,
}

impl DriveView {
    pub(super) fn new(bounds: FeedbackBounds) -> Self {
        Self {
            feedback: None,
            bounds,
            datum: 0,
            zeroed: AxisMask::NONE,
            stand: Axes::zeros(),
            order: None,
            before: Axes::zeros(),
            renaming: Axes::zeros(),
            home_offset: Axes::zeros(),
            next_index: 1,
            index_axis: None,
        }
    }

    /// Takes feedback and converts it to ideal coordinates. Returns `None` if it is implausible.
    pub(super) fn take(&mut self, mut feedback: Feedback, view: &CycleView, now_ns: u64) -> Option<Feedback> {
        // Implausible feedback is neither shown nor used for homing. The cycle's watch reports it.
        if self.bounds.check(now_ns, &feedback).is_err() {
            return None;
        }
        if let Some(shift) = &view.shift {
            feedback.index_position -= self.index_axis.map_or(0.0, |axis| shift[axis]);
            // The shift is that of the newest setpoint, a few periods later than the feedback. The correction
            // changes in that time by a fraction of the distance moved, as small as the machine's errors
            // relative to its travel.
            for (position, shift) in feedback.position.iter_mut().zip(shift.iter()) {
                *position -= shift;
            }
        }
        self.feedback = Some(feedback);
        Some(feedback)
    }

    /// Notes an order for new coordinates, which change `home_offset`.
    pub(super) fn renames(&mut self, order: u64, renaming: &Renaming) {
        (self.order, self.datum) = (Some(order), renaming.datum);
        (self.zeroed, self.stand) = (renaming.zeroed, renaming.stand);
        self.before = std::mem::replace(&mut self.home_offset, renaming.home_offset);
    }

    /// The cycle, at this datum, has taken an order or will never take it. Returns `true` if the order was to
    /// rename and had no effect, because something stopped the axes at that moment or the queue was full; the
    /// coordinates are then unchanged.
    pub(super) fn is_refused(&mut self, order: u64, datum: u64) -> bool {
        if self.order.take_if(|renaming| *renaming == order).is_none() || datum >= self.datum {
            return false;
        }
        (self.datum, self.zeroed, self.renaming) = (datum, AxisMask::NONE, Axes::zeros());
        self.home_offset = self.before;
        true
    }

    /// Axes whose new zero the drives report; each is returned once.
    pub(super) fn take_zeroed(&mut self, feedback: &Feedback, tolerance: impl Fn(usize) -> f64) -> AxisMask {
        // Compares with the ordered position, not with the core's: without power the core follows the drives.
        let is_shown = |axis: usize| (feedback.position[axis] - self.stand[axis]).abs() <= tolerance(axis);
        if self.zeroed.axes().all(is_shown) {
            std::mem::replace(&mut self.zeroed, AxisMask::NONE)
        } else {
            AxisMask::NONE
        }
    }

    /// Whether the drives use the core's coordinates.
    pub(super) fn counts_as(&self, view: &CycleView, feedback: &Feedback) -> bool {
        view.datum == feedback.datum && view.datum >= self.datum
    }
}

/// The feedback as homing needs it.
pub(super) fn homing_sample(feedback: &Feedback) -> HomingSample {
    HomingSample {
        time_ns: feedback.time_ns,
        position: Axes::from(feedback.position),
        switches: AxisMask::from_bits(feedback.home_switch_mask),
        limits: [feedback.negative_limit_mask, feedback.positive_limit_mask].map(AxisMask::from_bits),
        absolute: AxisMask::from_bits(feedback.absolute_mask),
        index_request: feedback.index_request,
        index_position: (!feedback.index_position.is_nan()).then_some(feedback.index_position),
    }
}
