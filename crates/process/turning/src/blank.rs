//! The stock before the first cut: its height above the final size.

use evolvent_config::plain;

/// A blank along the cut. Heights are measured outwards from the final size, positions from the face at which
/// the tool enters, both in mm.
#[derive(Clone, Debug, PartialEq)]
pub struct Blank {
    /// Points of position and height, joined by straight lines; two points at one position are a step. Before
    /// the first and after the last point the height is constant; after the length of the cut there is no
    /// stock.
    pub outline_mm: Vec<(f64, f64)>,
    /// Gaps in the stock: from, to, height that remains.
    pub grooves_mm: Vec<(f64, f64, f64)>,
    /// Harder or softer sections: from, to, factor of the load.
    pub hard_spots: Vec<(f64, f64, f64)>,
    /// Distance of the centre of the blank from the spindle's axis, mm.
    pub runout_mm: f64,
    /// Sectors without stock (keyways, a hexagon's flats): from and to, in turns from 0 to 1.
    pub slots: Vec<(f64, f64)>,
}

/// Why a blank is invalid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BlankError {
    /// No outline.
    #[error("the outline of the stock needs one point at least, and at most 10000")]
    Points,
    /// A number out of range.
    #[error("{name} of the stock is {}; it must lie from {min} to {max}", plain(*.value))]
    Number {
        /// Name.
        name: &'static str,
        /// Value.
        value: f64,
        /// Minimum.
        min: f64,
        /// Maximum.
        max: f64,
    },
    /// Positions that do not increase.
    #[error("the outline's places must not fall back: {after} mm comes after {before} mm")]
    Order {
        /// A position.
        before: f64,
        /// The next one.
        after: f64,
    },
}

impl Blank {
    /// A blank of constant height.
    #[must_use]
    pub fn uniform(height_mm: f64) -> Self {
        Self {
            outline_mm: vec![(0.0, height_mm)],
            grooves_mm: Vec::new(),
            hard_spots: Vec::new(),
            runout_mm: 0.0,
            slots: Vec::new(),
        }
    }

    /// An outline of points (position, height) in mm.
    #[must_use]
    pub fn outline(points: &[(f64, f64)]) -> Self {
        Self {
            outline_mm: points.to_vec(),
            ..Self::uniform(0.0)
        }
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// The first one that is invalid.
    pub fn check(&self) -> Result<(), BlankError> {
        if self.outline_mm.is_empty() || self.outline_mm.len() > 10_000 {
            return Err(BlankError::Points);
        }
        let within = |name, value: f64, min: f64, max: f64| {
            if (min..=max).contains(&value) {
                Ok(())
            } else {
                Err(BlankError::Number {
                    name,
                    value,
                    min,
                    max,
                })
            }
        };
        for &(position, height) in &self.outline_mm {
            within("a position", position, -1e4, 1e5)?;
            within("a height", height, 0.0, 1e3)?;
        }
        for pair in self.outline_mm.windows(2) {
            if pair[1].0 < pair[0].0 {
                return Err(BlankError::Order {
                    before: pair[0].0,
                    after: pair[1].0,
                });
            }
        }
        for &(from, to, height) in &self.grooves_mm {
            within("the start of a groove", from, -1e4, 1e5)?;
            within("the end of a groove", to, from, 1e5)?;
            within("the height in a groove", height, 0.0, 1e3)?;
        }
        for &(from, to, factor) in &self.hard_spots {
            within("the start of a hard spot", from, -1e4, 1e5)?;
            within("the end of a hard spot", to, from, 1e5)?;
            within("the factor of a hard spot", factor, 0.1, 10.0)?;
        }
        for &(from, to) in &self.slots {
            within("the start of a slot", from, 0.0, 1.0)?;
            within("the end of a slot", to, from, 1.0)?;
        }
        within("the run-out", self.runout_mm, 0.0, 100.0)
    }

    /// Mean height at a position, mm.
    #[must_use]
    pub fn height_mm(&self, position_mm: f64) -> f64 {
        for &(from, to, height) in &self.grooves_mm {
            if position_mm >= from && position_mm <= to {
                return height;
            }
        }
        let points = &self.outline_mm;
        let after = points.partition_point(|point| point.0 <= position_mm);
        match (
            after.checked_sub(1).and_then(|i| points.get(i)),
            points.get(after),
        ) {
            (Some(&(u0, h0)), Some(&(u1, h1))) => h0 + (h1 - h0) * (position_mm - u0) / (u1 - u0),
            (Some(&(_, height)), None) | (None, Some(&(_, height))) => height,
            (None, None) => 0.0,
        }
    }

    /// Factor of the load at a position.
    #[must_use]
    pub fn hardness(&self, position_mm: f64) -> f64 {
        self.hard_spots
            .iter()
            .find(|spot| position_mm >= spot.0 && position_mm <= spot.1)
            .map_or(1.0, |spot| spot.2)
    }

    /// Height to add at an angle (in turns), mm; `None` in a slot.
    #[must_use]
    pub fn at_turn(&self, turn: f64) -> Option<f64> {
        let inside = |&(from, to): &(f64, f64)| turn >= from && turn < to;
        (!self.slots.iter().any(inside)).then(|| self.runout_mm * libm::cos(std::f64::consts::TAU * turn))
    }

    /// Maximum of the mean height over a length, mm.
    #[must_use]
    pub fn highest_mm(&self, length_mm: f64) -> f64 {
        (0..=2000)
            .map(|i| self.height_mm(length_mm * f64::from(i) / 2000.0))
            .fold(0.0, f64::max)
    }

    /// Whether the load is constant over a revolution.
    #[must_use]
    pub fn is_round(&self) -> bool {
        self.runout_mm == 0.0 && self.slots.is_empty()
    }
}
