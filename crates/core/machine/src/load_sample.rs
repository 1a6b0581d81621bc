//! Readings of the cutting load.

/// A reading of a sensor of the cutting load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadSample {
    /// Grows by one from reading to reading. A repeated number is not a new reading.
    pub sequence: u64,
    /// The load in the unit of the force law.
    pub value: f64,
    /// Maximum reading of the sensor. A reading at or above it only shows that the load is too high.
    pub range_max: f64,
}
