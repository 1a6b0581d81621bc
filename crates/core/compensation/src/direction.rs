//! In which direction an axis has moved last.

/// The direction of an axis, with hysteresis: it changes when the position has come back by more than the width from the
/// farthest point. Unknown until the axis has moved by that much.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    width: f64,
    /// The farthest point in the present direction; where it began, while that is unknown.
    farthest: f64,
    /// -1, 0 where unknown, or 1.
    sign: i64,
}

impl Direction {
    /// Unknown, at `position`; `width` in the unit of positions.
    #[must_use]
    pub fn new(width: f64, position: f64) -> Self {
        Self {
            width,
            farthest: position,
            sign: 0,
        }
    }

    /// 1 forwards, -1 backwards, 0 where unknown. Real-time safe.
    pub fn see(&mut self, position: f64) -> i64 {
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

    /// The same place has another coordinate; the direction stays.
    pub fn relocate(&mut self, position: f64) {
        self.farthest = position;
    }
}
