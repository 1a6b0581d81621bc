//! A switch in the travel of a motor.

use core::str::FromStr;

/// An input that is low (on a 7I76: off) while the motor of a step generator is at or beyond a position,
/// relative to its position when the board was supplied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switch {
    /// The pin, or the field input of a 7I76.
    pub input: usize,
    /// The step generator.
    pub unit: usize,
    /// Position, steps; a negative one is passed in the negative direction.
    pub steps: f64,
}

impl Switch {
    /// Whether a motor at a position actuates it.
    #[must_use]
    pub fn is_actuated(&self, motor_steps: f64) -> bool {
        if self.steps < 0.0 {
            motor_steps <= self.steps
        } else {
            motor_steps >= self.steps
        }
    }
}

impl FromStr for Switch {
    type Err = String;

    /// As in `0:1:-640`: input, step generator, steps.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts = text.split(':');
        let mut next = || parts.next();
        let found = (|| {
            let switch = Self {
                input: next()?.parse().ok()?,
                unit: next()?.parse().ok()?,
                steps: next()?.parse().ok().filter(|steps: &f64| steps.is_finite())?,
            };
            next().is_none().then_some(switch)
        })();
        found.ok_or_else(|| {
            format!("`{text}` is no switch: expected INPUT:STEPGEN:STEPS, for example 0:0:-640")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_switch_is_actuated_beyond_its_place() {
        let low: Switch = "0:1:-640".parse().expect("a switch");
        assert_eq!((low.input, low.unit), (0, 1));
        assert_eq!(
            [-641.0, -640.0, -639.0].map(|at| low.is_actuated(at)),
            [true, true, false]
        );
        let high: Switch = "2:2:1600".parse().expect("a switch");
        assert_eq!([1599.0, 1600.0].map(|at| high.is_actuated(at)), [false, true]);
        for text in ["", "1:2", "1:2:3:4", "a:2:3", "1:2:nan"] {
            assert!(text.parse::<Switch>().is_err(), "{text}");
        }
    }
}
