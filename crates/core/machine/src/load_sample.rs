//! Readings of the cutting load.

/// A reading as it comes from a sensor of the cutting load.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoadSample {
    /// Grows by one from reading to reading. The same number again is no new reading.
    pub sequence: u64,
    /// The load in the unit of the force law.
    pub value: f64,
    /// Highest value that the sensor can show; a reading at or above it says only "too much".
    pub range_max: f64,
}
