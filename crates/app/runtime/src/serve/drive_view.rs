//! What the drives reported last.

use evolvent_bus::Feedback;
use evolvent_control::HomingSample;
use evolvent_drive::FeedbackBounds;
use evolvent_path::{Axes, AxisMask};

use super::orders::CycleView;

/// New coordinates of axes at rest.
pub(super) struct Renaming {
    pub(super) datum: u64,
    /// Axes to which they give machine zero.
    pub(super) zeroed: AxisMask,
    /// Where the axes stand by them.
    pub(super) stand: Axes,
    /// [`DriveView::home_offset`] with them.
    pub(super) home_offset: Axes,
}

/// The newest feedback that can be true, and by which coordinates the drives count.
pub(super) struct DriveView {
    pub(super) feedback: Option<Feedback>,
    bounds: FeedbackBounds,
    /// The datum that the last renaming leads to.
    pub(super) datum: u64,
    /// Axes to which that renaming gives machine zero: they are homed once the drives show it.
    pub(super) zeroed: AxisMask,
    /// Where the axes stand by the new coordinates.
    stand: Axes,
    /// The order to rename, until the cycle has taken it.
    order: Option<u64>,
    /// `home_offset` before that order.
    before: Axes,
    /// What was ordered to be added to the axes' coordinates, until that has been done.
    pub(super) renaming: Axes,
    /// Machine coordinates of the drives' first datum, less those of now.
    pub(super) home_offset: Axes,
    /// Number of the next request for an index pulse, and the axis of the last.
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

    /// Takes feedback in, in ideal coordinates; none where it cannot be true.
    pub(super) fn take(&mut self, mut feedback: Feedback, view: &CycleView, now_ns: u64) -> Option<Feedback> {
        // What cannot be true is neither shown nor homed by. The cycle's watch reports it.
        if self.bounds.check(now_ns, &feedback).is_err() {
            return None;
        }
        if let Some(shift) = &view.shift {
            feedback.index_position -= self.index_axis.map_or(0.0, |axis| shift[axis]);
            // As of the newest setpoint, a few periods before the feedback: what the correction changes
            // meanwhile is as much smaller than that way as errors of a machine are than its travel.
            for (position, shift) in feedback.position.iter_mut().zip(shift.iter()) {
                *position -= shift;
            }
        }
        self.feedback = Some(feedback);
        Some(feedback)
    }

    /// New coordinates were ordered, which change `home_offset`.
    pub(super) fn renames(&mut self, order: u64, renaming: &Renaming) {
        (self.order, self.datum) = (Some(order), renaming.datum);
        (self.zeroed, self.stand) = (renaming.zeroed, renaming.stand);
        self.before = std::mem::replace(&mut self.home_offset, renaming.home_offset);
    }

    /// The cycle has taken an order or will never do so, and has this datum. Returns `true` if it was an
    /// order to rename that had no effect, because something stopped the axes at that moment or it did not
    /// fit into the queue: the coordinates are as before.
    pub(super) fn is_refused(&mut self, order: u64, datum: u64) -> bool {
        if self.order.take_if(|renaming| *renaming == order).is_none() || datum >= self.datum {
            return false;
        }
        (self.datum, self.zeroed, self.renaming) = (datum, AxisMask::NONE, Axes::zeros());
        self.home_offset = self.before;
        true
    }

    /// Axes whose new zero the drives show, once.
    pub(super) fn take_zeroed(&mut self, feedback: &Feedback, tolerance: impl Fn(usize) -> f64) -> AxisMask {
        // Not where the core is: without power it stands wherever the drives say.
        let is_shown = |axis: usize| (feedback.position[axis] - self.stand[axis]).abs() <= tolerance(axis);
        if self.zeroed.axes().all(is_shown) {
            std::mem::replace(&mut self.zeroed, AxisMask::NONE)
        } else {
            AxisMask::NONE
        }
    }

    /// Whether the drives count as the core does.
    pub(super) fn counts_as(&self, view: &CycleView, feedback: &Feedback) -> bool {
        view.datum == feedback.datum && view.datum >= self.datum
    }
}

/// What homing goes by.
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
