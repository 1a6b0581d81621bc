//! The path of a thread as a function of the spindle's angle.
//!
//! A thread is a polyline: each axis has a number of millimetres per turn, which changes at the corners. The
//! axes cannot change their speed at once, so each corner is rounded by a symmetric kernel: outside the
//! kernel the path is exactly the programmed straight line, at the same angle of the spindle and at any
//! speed. The first corner is the run-in, the last one the run-out: the axes start half a kernel before the
//! angle at which the line begins, and are in phase half a kernel after it.

use evolvent_machine::Limits;
use evolvent_path::{Axes, Jet};

/// Fraction of the acceleration that the kernels use; the rest is for changes of the spindle speed.
const ACCELERATION_FRACTION: f64 = 0.8;
/// Fraction of the jerk that the kernels use.
const JERK_FRACTION: f64 = 0.6;
/// Fraction of the permitted chord error that corners use; the rest is for an uneven spindle.
const CHORD_FRACTION: f64 = 0.8;
/// Factor by which the spindle speed may increase during a pass.
pub(crate) const SPEED_RESERVE: f64 = 1.05;

/// One straight piece of a thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThreadLeg {
    /// End position, machine coordinates (mm, degrees).
    pub end: Axes,
    /// Turns of the spindle along it.
    pub turns: f64,
    /// Line of the program.
    pub line: u32,
}

/// Why a thread cannot be cut at a speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ThreadObjection {
    /// An axis would have to exceed its velocity.
    TooFast {
        /// Index of the axis.
        axis: usize,
        /// Required speed, mm/s.
        needed: f64,
        /// Permitted speed, mm/s.
        permitted: f64,
    },
    /// A leg is too short for the run-in and run-out.
    TooShort {
        /// Line of the leg.
        line: u32,
        /// Length that the change of speed at its start takes, mm.
        run_in_mm: f64,
        /// Length that the change of speed at its end takes, mm.
        run_out_mm: f64,
        /// Length of the leg, mm.
        length_mm: f64,
    },
    /// An axis cannot follow the reversal of a tap's spindle.
    ReversalTooFast {
        /// Index of the axis.
        axis: usize,
        /// Required acceleration, mm/s2.
        needed: f64,
        /// Permitted acceleration, mm/s2.
        permitted: f64,
    },
    /// An axis lags behind the reversal of a tap's spindle, because of its jerk.
    ReversalTooSudden {
        /// Index of the axis.
        axis: usize,
        /// Minimum lag of any motion within its limits, mm.
        lag_mm: f64,
        /// Permitted lag, mm.
        permitted_mm: f64,
    },
    /// A tap has too little travel beyond its depth for the spindle to stop.
    NoOverrun {
        /// Index of the axis.
        axis: usize,
        /// Distance that the axis needs beyond the depth, mm.
        needed_mm: f64,
        /// Distance from the depth to the end of its travel, mm.
        available_mm: f64,
    },
}

/// Minimum lag, mm, of an axis behind a position that is accelerated without notice by this much, mm/s2, for this
/// time, s. The axis, as fast as the position before, raises its acceleration at its jerk, mm/s3, to its limit,
/// mm/s2, which is more, until it is as fast again.
fn reversal_lag(acceleration: f64, duration_s: f64, max_acceleration: f64, jerk: f64) -> f64 {
    let rise_s = max_acceleration / jerk;
    let risen_speed = max_acceleration * rise_s / 2.0;
    let during_s = if 2.0 * acceleration <= max_acceleration {
        2.0 * acceleration / jerk
    } else {
        risen_speed / (max_acceleration - acceleration)
    };
    let change = acceleration * duration_s;
    let time_s = if during_s <= duration_s {
        during_s
    } else if change <= risen_speed {
        (2.0 * change / jerk).sqrt()
    } else {
        rise_s + (change - risen_speed) / max_acceleration
    };
    let [rising_s, after_s] = [time_s.min(rise_s), (time_s - rise_s).max(0.0)];
    let driven = jerk * rising_s.powi(3) / 6.0 + after_s * (risen_speed + max_acceleration * after_s / 2.0);
    let accelerated_s = time_s.min(duration_s);
    acceleration * accelerated_s * (time_s - accelerated_s / 2.0) - driven
}

/// A change of slope.
#[derive(Clone, Copy, Debug, Default)]
struct Corner {
    at: f64,
    /// Change of slope, mm per turn.
    change: Axes,
    /// Widths of the two boxes whose convolution is the kernel, turns; the first is the wider one.
    widths: (f64, f64),
    /// Maximum acceleration across the path, mm/s2: infinite at the ends of the thread, where the path is
    /// straight.
    max_across: f64,
    /// Maximum spindle speed for which it is wide enough, turns/s.
    shaped_for: f64,
}

impl Corner {
    fn half(&self) -> f64 {
        0.5 * (self.widths.0 + self.widths.1)
    }
}

/// Positions of the axes as a function of the turns of the spindle since the thread begins.
#[derive(Clone, Debug)]
pub(crate) struct ThreadCam {
    start: Axes,
    legs: Box<[ThreadLeg]>,
    corners: Box<[Corner]>,
    /// The spindle does not pass the end: it turns back there.
    is_tap: bool,
    /// Permitted distance between the chord of two setpoints and the path, mm.
    chord_error_mm: f64,
}

impl ThreadCam {
    /// A cam without rounded corners. Allocates; the other methods do not. `is_tap`: the last leg has no end,
    /// since the spindle turns back.
    pub(crate) fn new(start: Axes, legs: Box<[ThreadLeg]>, is_tap: bool, chord_error_mm: f64) -> Self {
        let corners = vec![Corner::default(); legs.len() + usize::from(!is_tap)];
        Self {
            start,
            legs,
            corners: corners.into(),
            is_tap,
            chord_error_mm,
        }
    }

    /// Rounds the corners for a spindle of this speed, turns/s.
    pub(crate) fn shape(
        &mut self,
        turns_per_s: f64,
        limits: &Limits,
        period_s: f64,
    ) -> Result<(), ThreadObjection> {
        let speed = SPEED_RESERVE * turns_per_s;
        let mut from = self.start;
        let (mut at, mut slope) = (0.0, Axes::zeros());
        // Between three setpoints the path deviates from the chord by an eighth of the second difference.
        let mut max_across = f64::INFINITY;
        let of_corners = CHORD_FRACTION * 8.0 * self.chord_error_mm / (period_s * period_s);
        for (corner, leg) in self.corners.iter_mut().zip(&self.legs) {
            let next = (leg.end - from) / leg.turns;
            for axis in 0..next.len() {
                let (needed, permitted) = (speed * next[axis].abs(), limits.velocity[axis]);
                if needed > permitted {
                    return Err(ThreadObjection::TooFast {
                        axis,
                        needed,
                        permitted,
                    });
                }
            }
            *corner = Corner {
                at,
                change: next - slope,
                widths: widths(&(next - slope), speed, limits, max_across, period_s),
                max_across,
                shaped_for: speed,
            };
            max_across = of_corners;
            (from, at, slope) = (leg.end, at + leg.turns, next);
        }
        if !self.is_tap
            && let Some(last) = self.corners.last_mut()
        {
            *last = Corner {
                at,
                change: -slope,
                widths: widths(&slope, speed, limits, f64::INFINITY, period_s),
                max_across: f64::INFINITY,
                shaped_for: speed,
            };
        }
        self.check_run_in()
    }

    /// Rounds corners ahead again if the spindle has become faster than the speed for which they were
    /// rounded. Real-time safe.
    pub(crate) fn reshape(&mut self, turns: f64, turns_per_s: f64, limits: &Limits, period_s: f64) {
        for corner in &mut self.corners {
            if turns_per_s <= corner.shaped_for || turns >= corner.at - corner.half() {
                continue;
            }
            let speed = SPEED_RESERVE * turns_per_s;
            let wider = Corner {
                widths: widths(&corner.change, speed, limits, corner.max_across, period_s),
                shaped_for: speed,
                ..*corner
            };
            // A corner that would have begun already stays as it is.
            if turns < wider.at - wider.half() {
                *corner = wider;
            }
        }
    }

    fn check_run_in(&self) -> Result<(), ThreadObjection> {
        let mut from = self.start;
        for (index, leg) in self.legs.iter().enumerate() {
            let before = self.corners[index].half();
            let behind = self.corners.get(index + 1).map_or(0.0, Corner::half);
            if before + behind > leg.turns {
                let length_mm = (leg.end - from).norm();
                let a_turn = length_mm / leg.turns;
                return Err(ThreadObjection::TooShort {
                    line: leg.line,
                    run_in_mm: before * a_turn,
                    run_out_mm: behind * a_turn,
                    length_mm,
                });
            }
            from = leg.end;
        }
        Ok(())
    }

    /// Turns before the beginning of the thread at which the axes start.
    pub(crate) fn run_in_turns(&self) -> f64 {
        self.corners.first().map_or(0.0, Corner::half)
    }

    /// Turns from the start of the thread to its end.
    pub(crate) fn turns(&self) -> f64 {
        self.legs.iter().map(|leg| leg.turns).sum()
    }

    /// The last leg, and its mm per turn.
    fn last_leg(&self) -> Option<(&ThreadLeg, Axes)> {
        let last = self.legs.last()?;
        let from = self.legs.iter().rev().nth(1).map_or(self.start, |leg| leg.end);
        Some((last, (last.end - from) / last.turns))
    }

    /// Whether the axes can follow a spindle that turns back at the end with a permitted lag in mm: at this rate,
    /// turns/s2, until its speed has changed by `change`, turns/s.
    pub(crate) fn check_reversal(
        &self,
        rate: f64,
        change: f64,
        permitted_mm: f64,
        limits: &Limits,
    ) -> Result<(), ThreadObjection> {
        let Some((_, slope)) = self.last_leg() else {
            return Ok(());
        };
        for axis in 0..slope.len() {
            let (needed, permitted) = (rate * slope[axis].abs(), limits.acceleration[axis]);
            if limits.present[axis] && needed > permitted {
                return Err(ThreadObjection::ReversalTooFast {
                    axis,
                    needed,
                    permitted,
                });
            }
            let lag_mm = reversal_lag(needed, change / rate, permitted, limits.jerk[axis]);
            if limits.present[axis] && lag_mm > permitted_mm {
                return Err(ThreadObjection::ReversalTooSudden {
                    axis,
                    lag_mm,
                    permitted_mm,
                });
            }
        }
        Ok(())
    }

    /// Whether a spindle can turn this far beyond the end.
    pub(crate) fn check_overrun(&self, turns: f64, limits: &Limits) -> Result<(), ThreadObjection> {
        let Some((last, slope)) = self.last_leg() else {
            return Ok(());
        };
        for axis in 0..slope.len() {
            let needed_mm = turns * slope[axis].abs();
            let available_mm = if slope[axis] < 0.0 {
                last.end[axis] - limits.travel_min[axis]
            } else {
                limits.travel_max[axis] - last.end[axis]
            };
            if limits.present[axis] && needed_mm > available_mm && needed_mm > 0.0 {
                return Err(ThreadObjection::NoOverrun {
                    axis,
                    needed_mm,
                    available_mm,
                });
            }
        }
        Ok(())
    }

    /// The turns at which the axes begin to stop, and at which they are at rest. Infinite if the spindle
    /// turns back.
    pub(crate) fn run_out(&self) -> (f64, f64) {
        match self.corners.last() {
            Some(last) if !self.is_tap => (last.at - last.half(), last.at + last.half()),
            _ => (f64::INFINITY, f64::INFINITY),
        }
    }

    /// End position of the thread.
    pub(crate) fn end(&self) -> Axes {
        self.legs.last().map_or(self.start, |leg| leg.end)
    }

    /// Start position of the thread.
    pub(crate) fn start(&self) -> Axes {
        self.start
    }

    /// Line of the program after this number of turns.
    pub(crate) fn line(&self, turns: f64) -> u32 {
        let mut left = turns;
        for leg in &self.legs {
            left -= leg.turns;
            if left < 0.0 {
                return leg.line;
            }
        }
        self.legs.last().map_or(0, |leg| leg.line)
    }

    /// Maximum distance of the axes per turn, mm.
    pub(crate) fn steepest(&self) -> f64 {
        let mut from = self.start;
        let mut max: f64 = 0.0;
        for leg in &self.legs {
            max = max.max(((leg.end - from) / leg.turns).abs().max());
            from = leg.end;
        }
        max
    }

    /// Weight of a straight part and its derivatives by turns: 0 in the rounding of corners, 1 from
    /// `change_turns` away from it. Continuous, with three derivatives, unless [`reshape`](Self::reshape)
    /// widens a corner ahead that is nearer than that. Real-time safe.
    pub(crate) fn straightness(&self, turns: f64, change_turns: f64) -> [f64; 4] {
        for (index, corner) in self.corners.iter().take(self.legs.len()).enumerate() {
            let begins = corner.at + corner.half();
            let ends = self
                .corners
                .get(index + 1)
                .map_or(f64::INFINITY, |next| next.at - next.half());
            if turns > begins && turns < ends {
                let [from, to] = [turns - begins, ends - turns].map(|away| away / change_turns);
                let scales = [1.0, change_turns, change_turns.powi(2), change_turns.powi(3)];
                let (mut from, mut to) = (smooth_step(from), smooth_step(to));
                for (order, scale) in scales.into_iter().enumerate() {
                    from[order] /= scale;
                    to[order] /= if order % 2 == 0 { scale } else { -scale };
                }
                return product(&from, &to);
            }
        }
        [0.0; 4]
    }

    /// Position and derivatives by turns. Real-time safe.
    pub(crate) fn at(&self, turns: f64) -> Jet {
        let mut jet = Jet::at_rest(self.start);
        for corner in &self.corners {
            let [value, first, second, third] = ramp(turns - corner.at, corner.widths);
            jet.position += corner.change * value;
            jet.first += corner.change * first;
            jet.second += corner.change * second;
            jet.third += corner.change * third;
        }
        jet
    }
}

/// Widths of the boxes, turns, that keep every axis within its acceleration and jerk, and all together within
/// an acceleration across the path, at this speed, turns/s.
fn widths(change: &Axes, speed: f64, limits: &Limits, max_across: f64, period_s: f64) -> (f64, f64) {
    let across = libm::hypot(libm::hypot(change[0], change[1]), change[2]);
    let (mut by_acceleration, mut by_jerk) = (speed * across / max_across, 0.0_f64);
    for axis in 0..change.len() {
        if change[axis] != 0.0 {
            let step = speed * change[axis].abs();
            by_acceleration = by_acceleration.max(step / (ACCELERATION_FRACTION * limits.acceleration[axis]));
            by_jerk = by_jerk.max(step / (JERK_FRACTION * limits.jerk[axis]));
        }
    }
    // The acceleration is the step divided by the wider box, the jerk by both. Each part is at least two
    // setpoints long.
    let min_s = 2.0 * period_s;
    let wide = by_acceleration.max(by_jerk.sqrt()).max(min_s);
    let narrow = (by_jerk / wide).max(min_s).min(wide);
    (speed * wide, speed * narrow)
}

/// A ramp of slope 1 from 0 on, rounded by two boxes, and its derivatives.
fn ramp(x: f64, (wide, narrow): (f64, f64)) -> [f64; 4] {
    // The part after the corner mirrors the part before it.
    let y = 0.5 * (wide + narrow) - x.abs();
    let before = if y <= 0.0 {
        [0.0; 4]
    } else if y < narrow {
        let third = 1.0 / (wide * narrow);
        [third * y * y * y / 6.0, third * y * y / 2.0, third * y, third]
    } else {
        let z = y - narrow;
        let second = 1.0 / wide;
        let first = 0.5 * narrow * second;
        let value = narrow * narrow * second / 6.0 + first * z + 0.5 * second * z * z;
        [value, first + second * z, second, 0.0]
    };
    let [value, first, second, third] = before;
    if x <= 0.0 {
        before
    } else {
        [x + value, 1.0 - first, second, -third]
    }
}

/// A step from 0 to 1 between x = 0 and 1, and its derivatives, which are continuous up to the third.
fn smooth_step(x: f64) -> [f64; 4] {
    let x = x.clamp(0.0, 1.0);
    let both = x * (1.0 - x);
    [
        x.powi(4) * (35.0 - 84.0 * x + 70.0 * x * x - 20.0 * x * x * x),
        140.0 * both.powi(3),
        420.0 * both * both * (1.0 - 2.0 * x),
        840.0 * both * (1.0 - 5.0 * both),
    ]
}

/// The derivatives of a product.
pub(crate) fn product(a: &[f64; 4], b: &[f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0],
        a[1] * b[0] + a[0] * b[1],
        a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2],
        a[3] * b[0] + 3.0 * a[2] * b[1] + 3.0 * a[1] * b[2] + a[0] * b[3],
    ]
}

#[cfg(test)]
mod tests {
    use evolvent_path::AXES;

    use super::*;

    fn limits() -> Limits {
        Limits {
            present: [true; AXES],
            velocity: Axes::repeat(200.0),
            acceleration: Axes::repeat(2000.0),
            jerk: Axes::repeat(50_000.0),
            travel_min: Axes::repeat(-500.0),
            travel_max: Axes::repeat(500.0),
            home: Axes::zeros(),
        }
    }

    fn leg(x: f64, z: f64, turns: f64) -> ThreadLeg {
        let mut end = Axes::zeros();
        (end[0], end[2]) = (x, z);
        ThreadLeg { end, turns, line: 7 }
    }

    /// The lag in small steps of time.
    fn integrated_lag(acceleration: f64, duration_s: f64, max_acceleration: f64, jerk: f64) -> f64 {
        let step = 1e-6;
        let (mut time, mut lag, mut slower) = (0.0, 0.0, 0.0);
        while slower > 0.0 || time == 0.0 {
            let wanted = if time < duration_s { acceleration } else { 0.0 };
            slower += step * (wanted - max_acceleration.min(jerk * time));
            lag += step * slower;
            time += step;
        }
        lag
    }

    #[test]
    fn the_lag_of_a_reversal_is_that_of_an_integration() {
        for [acceleration, duration_s, max_acceleration, jerk] in [
            // Caught up during the reversal, and after it: with the acceleration rising, and at its limit.
            [500.0, 0.2, 2000.0, 50_000.0],
            [1500.0, 0.3, 2000.0, 50_000.0],
            [1500.0, 0.02, 2000.0, 10_000.0],
            [1990.0, 0.3, 2000.0, 50_000.0],
            [2000.0, 0.1, 2000.0, 50_000.0],
        ] {
            let found = reversal_lag(acceleration, duration_s, max_acceleration, jerk);
            let expected = integrated_lag(acceleration, duration_s, max_acceleration, jerk);
            assert!((found / expected - 1.0).abs() < 1e-3, "{found}, {expected}");
        }
    }

    #[test]
    fn derivatives_match_the_position_and_both_ends() {
        // A taper in, the thread, a taper out.
        let legs = [leg(-1.0, -6.0, 4.0), leg(-1.0, -30.0, 16.0), leg(0.0, -36.0, 4.0)];
        let mut cam = ThreadCam::new(Axes::zeros(), legs.into(), false, 0.001);
        cam.shape(10.0, &limits(), 1e-3).unwrap();
        let step = 1e-5;
        for at in 0..30_000 {
            let turns = -3.0 + 1e-3 * f64::from(at);
            let [low, here, high] = [turns - step, turns, turns + step].map(|turns| cam.at(turns));
            for axis in [0, 2] {
                let first = (high.position[axis] - low.position[axis]) / (2.0 * step);
                let second = (high.first[axis] - low.first[axis]) / (2.0 * step);
                assert!((first - here.first[axis]).abs() < 1e-5, "{turns}");
                assert!((second - here.second[axis]).abs() < 1e-2, "{turns}");
            }
        }
        assert_eq!(cam.at(-cam.run_in_turns()).position, Axes::zeros());
        assert!((cam.at(cam.run_out().1).position - cam.end()).norm() < 1e-12);
        // Straight in the middle: 1.5 mm per turn, independent of the corners.
        let middle = cam.at(12.0);
        assert!((middle.position[2] + 18.0).abs() < 1e-12 && (middle.first[2] + 1.5).abs() < 1e-12);
    }

    #[test]
    fn straight_parts_are_between_corners_and_their_derivatives_match() {
        // The second leg is shorter than two changes.
        let legs = [leg(-1.0, -9.0, 6.0), leg(-1.0, -13.5, 3.0), leg(0.0, -30.0, 11.0)];
        let mut cam = ThreadCam::new(Axes::zeros(), legs.into(), false, 0.001);
        cam.shape(10.0, &limits(), 1e-3).unwrap();
        let step = 1e-4;
        for at in 0..23_000 {
            let turns = -1.5 + 1e-3 * f64::from(at);
            let [low, here, high] =
                [turns - step, turns, turns + step].map(|turns| cam.straightness(turns, 2.0));
            for order in 1..4 {
                let slope = (high[order - 1] - low[order - 1]) / (2.0 * step);
                assert!(
                    (slope - here[order]).abs() < 2e-3,
                    "{turns} {order}: {slope} {}",
                    here[order]
                );
            }
            let is_corner = cam
                .corners
                .iter()
                .any(|corner| (turns - corner.at).abs() <= corner.half());
            assert!(here[0] == 0.0 || !is_corner, "{turns}");
        }
        assert_eq!(cam.straightness(3.0, 2.0), [1.0, 0.0, 0.0, 0.0]);
        let tap = {
            let mut tap = ThreadCam::new(Axes::zeros(), [leg(0.0, -9.0, 6.0)].into(), true, 0.001);
            tap.shape(10.0, &limits(), 1e-3).unwrap();
            tap
        };
        assert_eq!(
            tap.straightness(8.0, 2.0),
            [1.0, 0.0, 0.0, 0.0],
            "beyond the depth"
        );
    }

    #[test]
    fn limits_hold_and_the_path_is_the_same_at_any_speed() {
        let limits = limits();
        for turns_per_s in [1.0, 10.0, 60.0] {
            let legs = [leg(0.0, -60.0, 40.0)];
            let mut cam = ThreadCam::new(Axes::zeros(), legs.into(), false, 0.001);
            cam.shape(turns_per_s, &limits, 1e-3).unwrap();
            for at in 0..50_000 {
                let jet = cam.at(-4.0 + 1e-3 * f64::from(at));
                let speed = jet.first[2].abs() * turns_per_s;
                let acceleration = jet.second[2].abs() * turns_per_s.powi(2);
                let jerk = jet.third[2].abs() * turns_per_s.powi(3);
                assert!(speed <= 200.0 && acceleration <= 1600.0 && jerk <= 30_000.0);
            }
            assert!((cam.at(20.0).position[2] + 30.0).abs() < 1e-12);
        }
    }

    #[test]
    fn what_cannot_be_kept_is_told_with_its_numbers() {
        let mut cam = ThreadCam::new(Axes::zeros(), [leg(0.0, -3.0, 1.5)].into(), false, 0.001);
        let Err(ThreadObjection::TooShort {
            line,
            run_in_mm,
            run_out_mm,
            length_mm,
        }) = cam.shape(20.0, &limits(), 1e-3)
        else {
            unreachable!("it is too short")
        };
        // 42 mm/s: by the jerk, sqrt(42 / 30000) = 37.4 ms for each box, of which half lies before the
        // corner, and half after it.
        assert_eq!((line, length_mm), (7, 3.0));
        let expected = 42.0 * (42.0_f64 / 30_000.0).sqrt();
        assert!((run_in_mm - expected).abs() < 1e-9, "{run_in_mm} {expected}");
        assert_eq!(run_in_mm, run_out_mm);
        let mut cam = ThreadCam::new(Axes::zeros(), [leg(0.0, -400.0, 100.0)].into(), false, 0.001);
        let objection = cam.shape(50.0, &limits(), 1e-3);
        assert!(matches!(objection, Err(ThreadObjection::TooFast { axis: 2, .. })));
    }
}
