//! Two drives of one axis: squaring, and the limit of their difference.

/// The second drive of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GantrySettings {
    /// Its coordinate minus that of the first drive when the beam is square.
    pub squaring_offset: f64,
    /// Maximum additional difference.
    pub max_difference: f64,
    /// Speed of squaring.
    pub square_velocity: f64,
}

/// The intended difference of the second drive from the first, until the beam is square.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Squaring {
    apart: f64,
    begun: bool,
}

impl Squaring {
    /// One period. `difference` of the positions; returns the addition to the target of the second drive.
    pub(crate) fn step(&mut self, enabled: bool, difference: f64, most: f64) -> f64 {
        if !enabled {
            *self = Self::default();
            return difference;
        }
        if self.begun {
            self.apart -= self.apart.clamp(-most, most);
        } else {
            *self = Self {
                apart: difference,
                begun: true,
            };
        }
        self.apart
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_begins_where_the_drive_stands_and_goes_to_zero_evenly() {
        let mut squaring = Squaring::default();
        assert_eq!(squaring.step(false, 0.3, 0.1), 0.3);
        let path: Vec<f64> = (0..6).map(|_| squaring.step(true, 0.25, 0.1)).collect();
        for (found, expected) in path.iter().zip([0.25, 0.15, 0.05, 0.0, 0.0, 0.0]) {
            assert!((found - expected).abs() < 1e-12, "{path:?}");
        }
        assert_eq!(
            squaring.step(false, -1.0, 0.1),
            -1.0,
            "without power it is where it is"
        );
    }
}
