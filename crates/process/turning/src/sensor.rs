//! A simulated load sensor: lag, noise, and faults on demand.

use evolvent_machine::LoadSample;

/// Properties of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorModel {
    /// Time constant of its first-order lag, s.
    pub lag_s: f64,
    /// Standard deviation of its noise as a fraction of the reading.
    pub noise: f64,
    /// Maximum reading.
    pub range_max: f64,
    /// Seed of its noise.
    pub seed: u64,
}

/// Failure of a sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SensorFault {
    /// The same reading forever, with the same sequence number.
    Stale,
    /// No reading at all.
    Lost,
    /// New readings that are not numbers.
    NotANumber,
    /// New readings at the end of the range.
    Saturated,
    /// New readings, all of the same value to the last bit.
    Frozen,
    /// New readings far below zero, as of a broken wire.
    Negative,
    /// New readings of zero, as of a sensor without supply: the same as in air.
    Zero,
}

impl SensorFault {
    /// Every kind.
    pub const ALL: [Self; 7] = [
        Self::Stale,
        Self::Lost,
        Self::NotANumber,
        Self::Saturated,
        Self::Frozen,
        Self::Negative,
        Self::Zero,
    ];
}

/// The sensor in operation.
#[derive(Clone, Copy, Debug)]
pub struct Sensor {
    model: SensorModel,
    fraction: f64,
    lagged: f64,
    random: u64,
    last: Option<LoadSample>,
    sequence: u64,
}

impl Sensor {
    /// A sensor that is read every `period_s` seconds.
    #[must_use]
    pub fn new(model: SensorModel, period_s: f64) -> Self {
        let fraction = if model.lag_s > 0.0 {
            1.0 - libm::exp(-period_s / model.lag_s)
        } else {
            1.0
        };
        Self {
            model,
            fraction,
            lagged: 0.0,
            random: model.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1,
            last: None,
            sequence: 0,
        }
    }

    /// Returns one reading of the true load, or of a fault.
    pub fn read(&mut self, load: f64, fault: Option<SensorFault>) -> Option<LoadSample> {
        self.lagged += self.fraction * (load - self.lagged);
        let noise = self.model.noise * self.gauss();
        let value = (self.lagged * (1.0 + noise)).min(self.model.range_max);
        let before = self.last;
        let reading = |value| {
            Some(LoadSample {
                sequence: self.sequence + 1,
                value,
                range_max: self.model.range_max,
            })
        };
        let sample = match fault {
            None => reading(value),
            Some(SensorFault::Stale) => return before,
            Some(SensorFault::Lost) => return None,
            Some(SensorFault::NotANumber) => reading(f64::NAN),
            Some(SensorFault::Saturated) => reading(self.model.range_max),
            Some(SensorFault::Frozen) => reading(before.map_or(0.0, |sample| sample.value)),
            Some(SensorFault::Negative) => reading(-self.model.range_max),
            Some(SensorFault::Zero) => reading(0.0),
        };
        self.sequence += 1;
        self.last = sample;
        sample
    }

    /// Approximately normal: the sum of twelve uniform numbers.
    fn gauss(&mut self) -> f64 {
        let mut sum = -6.0;
        for _ in 0..12 {
            self.random ^= self.random >> 12;
            self.random ^= self.random << 25;
            self.random ^= self.random >> 27;
            let bits = self.random.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11;
            sum += bits as f64 / (1_u64 << 53) as f64;
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODEL: SensorModel = SensorModel {
        lag_s: 0.01,
        noise: 0.02,
        range_max: 5000.0,
        seed: 1,
    };

    #[test]
    fn sensor_has_its_time_constant_and_noise() {
        let mut quiet = Sensor::new(SensorModel { noise: 0.0, ..MODEL }, 0.001);
        let after = (0..10).filter_map(|_| quiet.read(1000.0, None)).last().unwrap();
        assert!((after.value / 1000.0 - (1.0 - (-1.0_f64).exp())).abs() < 1e-9);
        let mut noisy = Sensor::new(MODEL, 0.001);
        let readings: Vec<f64> = (0..4000)
            .filter_map(|_| noisy.read(1000.0, None))
            .skip(200)
            .map(|sample| sample.value)
            .collect();
        let mean = readings.iter().sum::<f64>() / readings.len() as f64;
        let variance = readings.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / readings.len() as f64;
        assert!((mean - 1000.0).abs() < 2.0 && (variance.sqrt() - 20.0).abs() < 1.5);
    }

    #[test]
    fn each_fault_shows() {
        for fault in SensorFault::ALL {
            let mut sensor = Sensor::new(MODEL, 0.001);
            let good = (0..100).filter_map(|_| sensor.read(1000.0, None)).last().unwrap();
            let bad = sensor.read(1000.0, Some(fault));
            let shows = match fault {
                SensorFault::Stale => bad == Some(good),
                SensorFault::Lost => bad.is_none(),
                SensorFault::NotANumber => bad.unwrap().value.is_nan(),
                SensorFault::Saturated => bad.unwrap().value == 5000.0,
                SensorFault::Frozen => bad.unwrap().value == good.value,
                SensorFault::Negative => bad.unwrap().value < 0.0,
                SensorFault::Zero => bad.unwrap().value == 0.0,
            };
            assert!(shows, "{fault:?}");
        }
    }
}
