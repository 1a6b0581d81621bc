//! Index pulses of encoders, on the bridge's side: the request, and the latched position.

use evolvent_wire::{AXES, Feedback};

/// The request in a setpoint: `index_request` and `index_axis`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IndexRequest {
    /// Number of the request; a different number other than 0 is a new request.
    pub number: u32,
    /// The axis, an index into X Y Z A B C U V W.
    pub axis: usize,
}

impl IndexRequest {
    /// Nothing is to be latched.
    pub const NONE: Self = Self { number: 0, axis: 0 };
}

/// The request that a bridge is carrying out. A plain value; may be used by a real-time cycle.
///
/// ```
/// use evolvent_drive::{IndexLatch, IndexRequest};
///
/// let mut latch = IndexLatch::default();
/// assert_eq!(latch.take(IndexRequest { number: 7, axis: 2 }), Some(2)); // arm the encoder of Z
/// assert_eq!(latch.take(IndexRequest { number: 7, axis: 2 }), None); // the same request
/// latch.latch(12.5);
/// let mut feedback = evolvent_wire::Feedback::default();
/// latch.describe(&mut feedback);
/// assert_eq!((feedback.index_request, feedback.index_position), (7, 12.5));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IndexLatch {
    request: IndexRequest,
    position: Option<f64>,
}

impl IndexLatch {
    /// Accepts the request of the setpoint in force. Returns the axis whose latch is to be armed in this
    /// period.
    pub fn take(&mut self, request: IndexRequest) -> Option<usize> {
        if request.number == self.request.number {
            return None;
        }
        *self = Self {
            request,
            position: None,
        };
        self.awaited()
    }

    /// The axis whose index pulse is still awaited.
    #[must_use]
    pub fn awaited(&self) -> Option<usize> {
        let is_open = self.request.number != 0 && self.request.axis < AXES && self.position.is_none();
        is_open.then_some(self.request.axis)
    }

    /// Stores the position of the index pulse on its axis, in the datum in force.
    pub fn latch(&mut self, position: f64) {
        if self.awaited().is_some() {
            self.position = Some(position);
        }
    }

    /// Shifts the stored position after a change of datum.
    pub fn rename(&mut self, shift: &[f64; AXES]) {
        if let Some(position) = &mut self.position {
            *position += shift[self.request.axis];
        }
    }

    /// Writes the result of the request into a message.
    pub fn describe(&self, feedback: &mut Feedback) {
        feedback.index_request = self.request.number;
        feedback.index_position = match self.position {
            Some(position) => position,
            None if self.request.number == 0 => 0.0,
            None => f64::NAN,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_counts_for_its_own_request_only() {
        let mut latch = IndexLatch::default();
        let mut feedback = Feedback::default();
        latch.latch(1.0);
        latch.describe(&mut feedback);
        assert_eq!((feedback.index_request, feedback.index_position), (0, 0.0));
        assert_eq!(latch.take(IndexRequest { number: 1, axis: 1 }), Some(1));
        latch.describe(&mut feedback);
        assert!(feedback.index_position.is_nan());
        latch.latch(2.0);
        latch.latch(3.0);
        let mut shift = [0.0; AXES];
        (shift[0], shift[1]) = (100.0, 10.0);
        latch.rename(&shift);
        latch.describe(&mut feedback);
        assert_eq!((feedback.index_request, feedback.index_position), (1, 12.0));
        assert_eq!(latch.take(IndexRequest { number: 2, axis: 0 }), Some(0));
        latch.describe(&mut feedback);
        assert!(feedback.index_position.is_nan());
    }

    #[test]
    fn an_axis_that_there_is_not_is_never_armed() {
        let mut latch = IndexLatch::default();
        assert_eq!(
            latch.take(IndexRequest {
                number: 3,
                axis: AXES
            }),
            None
        );
        latch.latch(1.0);
        latch.rename(&[1.0; AXES]);
        assert_eq!(latch.take(IndexRequest::NONE), None);
    }
}
