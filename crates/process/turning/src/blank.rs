//! The stock as it comes: what stands above the final size before anything is cut.

use evolvent_config::plain;

/// A blank along the cut. Heights are measured outwards from the final size, places from the face at which
/// the tool comes in, both in mm.
#[derive(Clone, Debug, PartialEq)]
pub struct Blank {
    /// Height over place, straight between the points; two points at one place are a step. Beyond the ends
    /// the height is that of the end point, beyond the length of the cut nothing stands.
    pub outline_mm: Vec<(f64, f64)>,
    /// Places without stock: from, to, height that is left there.
    pub grooves_mm: Vec<(f64, f64, f64)>,
    /// Harder or softer places: from, to, factor of the load.
    pub hard_spots: Vec<(f64, f64, f64)>,
    /// How far the middle of the blank lies off the spindle's axis, mm.
    pub runout_mm: f64,
    /// Sectors without stock (keyways, a hexagon's flats): from and to, in turns from 0 to 1.
    pub slots: Vec<(f64, f64)>,
}

/// Why a blank is none.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BlankError {
    /// No outline.
    #[error("the outline of the stock needs one point at least, and at most 10000")]
    Points,
    /// A number outside what makes sense.
    #[error("{name} of the stock is {}; it must lie from {least} to {most}", plain(*.value))]
    Number {
        /// Which.
        name: &'static str,
        /// What it is.
        value: f64,
        /// Lowest.
        least: f64,
        /// Highest.
        most: f64,
    },
    /// Places that do not rise.
    #[error("the outline's places must not fall back: {after} mm comes after {before} mm")]
    Order {
        /// A place.
        before: f64,
        /// The one after it.
        after: f64,
    },
}

impl Blank {
    /// The same height everywhere.
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

    /// An outline of points (place, height) in mm.
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
    /// The first that makes no sense.
    pub fn check(&self) -> Result<(), BlankError> {
        if self.outline_mm.is_empty() || self.outline_mm.len() > 10_000 {
            return Err(BlankError::Points);
        }
        let within = |name, value: f64, least: f64, most: f64| {
            if (least..=most).contains(&value) {
                Ok(())
            } else {
                Err(BlankError::Number {
                    name,
                    value,
                    least,
                    most,
                })
            }
        };
        for &(place, height) in &self.outline_mm {
            within("a place", place, -1e4, 1e5)?;
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

    /// Mean height at a place, mm.
    #[must_use]
    pub fn height_mm(&self, place_mm: f64) -> f64 {
        for &(from, to, height) in &self.grooves_mm {
            if place_mm >= from && place_mm <= to {
                return height;
            }
        }
        let points = &self.outline_mm;
        let after = points.partition_point(|point| point.0 <= place_mm);
        match (
            after.checked_sub(1).and_then(|i| points.get(i)),
            points.get(after),
        ) {
            (Some(&(u0, h0)), Some(&(u1, h1))) => h0 + (h1 - h0) * (place_mm - u0) / (u1 - u0),
            (Some(&(_, height)), None) | (None, Some(&(_, height))) => height,
            (None, None) => 0.0,
        }
    }

    /// Factor of the load at a place.
    #[must_use]
    pub fn hardness(&self, place_mm: f64) -> f64 {
        self.hard_spots
            .iter()
            .find(|spot| place_mm >= spot.0 && place_mm <= spot.1)
            .map_or(1.0, |spot| spot.2)
    }

    /// What the height is to be raised by at an angle (in turns), or none where a slot is.
    #[must_use]
    pub fn at_turn(&self, turn: f64) -> Option<f64> {
        let inside = |&(from, to): &(f64, f64)| turn >= from && turn < to;
        (!self.slots.iter().any(inside)).then(|| self.runout_mm * libm::cos(std::f64::consts::TAU * turn))
    }

    /// Largest mean height over a length, mm.
    #[must_use]
    pub fn highest_mm(&self, length_mm: f64) -> f64 {
        (0..=2000)
            .map(|i| self.height_mm(length_mm * f64::from(i) / 2000.0))
            .fold(0.0, f64::max)
    }

    /// Whether the load of a turn is the same all round.
    #[must_use]
    pub fn is_round(&self) -> bool {
        self.runout_mm == 0.0 && self.slots.is_empty()
    }
}
