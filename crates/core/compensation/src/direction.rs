//! The direction of the last motion of an axis.

/// The direction of an axis with hysteresis: it changes when the position has moved back from its extreme by
/// more than the width. Unknown until the axis has moved by the width.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    width: f64,
    /// The extreme position in the present direction; the start position while the direction is unknown.
    farthest: f64,
    /// -1, 1, or 0 while unknown.
    sign: i64,
}

impl Direction {
    /// An unknown direction at `position`; `width` has the unit of positions.
    #[must_use]
    pub fn new(width: f64, position: f64) -> Self {
        Self {
            width,
            farthest: position,
            sign: 0,
        }
    }

    /// Updates the direction: 1 forwards, -1 backwards, 0 while unknown. Real-time safe.
    pub fn update(&mut self, position: f64) -> i64 {
        let ahead = position - self.farthest;
        match self.sign {
            0 if ahead.abs() <= self.width => {}
            0 => (self.sign, self.farthest) = (if ahead > 0.0 { 1 } else { -1 }, position),
            sign => {
                let ahead = ahead * sign as f64;
                if ahead >= 0.0 {
                    self.farthest = position;
                } else if ahead < -self.width {
                    (self.sign, self.farthest) = (-sign, position);
                }
            }
        }
        self.sign
    }

    /// Changes the coordinates of the present position to `position`; the direction is kept. Real-time safe.
    pub fn rebase_position(&mut self, position: f64) {
        self.farthest = position;
    }
}
