//! Angles of unlimited rotary axes, whose coordinates continue beyond one turn.

/// Degrees of a turn.
pub const TURN_DEG: f64 = 360.0;

/// Rounding error of an angle, degrees, below which an axis counts as being at the angle and does not turn
/// once more.
const ROUNDING_DEG: f64 = 1e-6;

/// The angle as it is displayed, 0 to below 360 degrees. NaN stays NaN.
///
/// ```
/// assert_eq!(evolvent_path::angle_within_turn(-90.0), 270.0);
/// assert_eq!(evolvent_path::angle_within_turn(720.5), 0.5);
/// ```
#[must_use]
pub fn angle_within_turn(angle_deg: f64) -> f64 {
    let within = angle_deg.rem_euclid(TURN_DEG);
    // A tiny negative angle is rounded up to a whole turn.
    // A negative whole number of turns leaves -0.0.
    if within >= TURN_DEG { 0.0 } else { within + 0.0 }
}

/// The whole turns nearest to a coordinate, degrees.
///
/// ```
/// assert_eq!(evolvent_path::whole_turns(36_100.0), 36_000.0);
/// ```
#[must_use]
pub fn whole_turns(coordinate_deg: f64) -> f64 {
    TURN_DEG * (coordinate_deg / TURN_DEG).round()
}

/// The coordinate of an angle that is nearest to `from_deg`; of two the one in the positive direction.
///
/// ```
/// assert_eq!(evolvent_path::turn_shorter(350.0, 10.0), 370.0);
/// ```
#[must_use]
pub fn turn_shorter(from_deg: f64, angle_deg: f64) -> f64 {
    let near_deg = angle_deg + whole_turns(from_deg - angle_deg);
    if from_deg - near_deg >= 0.5 * TURN_DEG - ROUNDING_DEG {
        near_deg + TURN_DEG
    } else {
        near_deg
    }
}

/// The next coordinate of an angle from `from_deg` on, in the negative or the positive direction.
///
/// ```
/// assert_eq!(evolvent_path::turn_onward(350.0, 10.0, true), 10.0);
/// ```
#[must_use]
pub fn turn_onward(from_deg: f64, angle_deg: f64, is_negative: bool) -> f64 {
    let turns = (from_deg - angle_deg) / TURN_DEG;
    let turns = if is_negative {
        (turns + ROUNDING_DEG / TURN_DEG).floor()
    } else {
        (turns - ROUNDING_DEG / TURN_DEG).ceil()
    };
    angle_deg + TURN_DEG * turns
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shorter_direction_turns_half_a_turn_at_most() {
        for turns in [0.0, 1.0, -1.0, 100.0, -99.0, 100_000.0] {
            for here in 0..72 {
                for angle in 0..72 {
                    let from = 5.0 * f64::from(here) + TURN_DEG * turns;
                    let to = 5.0 * f64::from(angle);
                    let end = turn_shorter(from, to);
                    let turned = end - from;
                    assert!(turned > -180.0 && turned <= 180.0, "{from} {to}: {turned}");
                    assert_eq!((end - to).rem_euclid(TURN_DEG), 0.0);
                }
            }
        }
        // Rounding does not reverse half a turn.
        assert_eq!(turn_shorter(0.1 + 0.2, 180.3), 180.3);
        assert_eq!(turn_shorter(180.0 + 1e-12, 0.0), 360.0);
    }

    #[test]
    fn one_direction_turns_less_than_a_full_turn() {
        for from in [0.0, 90.0, 359.0, 725.0, -10.0, 36_090.0] {
            for angle in [0.0, 45.0, 90.0, 359.5] {
                let positive = turn_onward(from, angle, false) - from;
                let negative = turn_onward(from, angle, true) - from;
                assert!((0.0..TURN_DEG).contains(&positive), "{from} {angle}: {positive}");
                assert!(
                    negative > -TURN_DEG && negative <= 0.0,
                    "{from} {angle}: {negative}"
                );
                let whole = positive - negative;
                assert!((whole - TURN_DEG).abs() < 1e-9 || (positive == 0.0 && negative == 0.0));
            }
        }
        assert!(turn_onward(90.0 + 1e-9, 90.0, false) < 91.0);
        assert!(turn_onward(90.0 - 1e-9, 90.0, true) > 89.0);
    }

    #[test]
    fn displayed_angles_are_within_a_turn() {
        for (angle, shown) in [
            (0.0, 0.0),
            (360.0, 0.0),
            (-90.0, 270.0),
            (725.5, 5.5),
            (-1e-20, 0.0),
        ] {
            assert_eq!(angle_within_turn(angle), shown);
        }
        for turns in [-1000.0, -1.0, -0.0, 0.0, 1.0] {
            let shown = angle_within_turn(TURN_DEG * turns);
            assert!(shown == 0.0 && shown.is_sign_positive(), "{turns}: {shown:?}");
        }
    }
}
