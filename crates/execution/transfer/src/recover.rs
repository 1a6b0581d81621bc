//! Recovers pieces of constant jerk from samples of a motion.
//!
//! Acceleration is continuous and piecewise linear in time. An interval is one piece if velocity and position
//! at its end, and acceleration inside, follow from its start with constant jerk, to rounding. It is two
//! pieces if the same holds with one break where the straight lines from both ends meet. Every other interval
//! is halved. A deviation that this test misses is below rounding, and the verification afterwards detects
//! any error made here.

use std::collections::BTreeMap;

use crate::landing::Steps;
use crate::state::AxisState;

/// Maximum number of halvings of the whole. An interval of this depth is taken as one piece.
const DEEPEST: u32 = 36;
/// Maximum number of intervals; a few hundred are usual.
const MAX_INTERVALS: usize = 2000;
/// Rounding of a sample, in units of the last place of its largest summand.
const ROUNDING: f64 = 16.0 * f64::EPSILON;
/// Points of an interval at which accelerations are compared.
const PROBES: [f64; 4] = [0.19, 0.382, 0.618, 0.83];

/// Samples of all axes, each instant computed once.
pub(crate) struct Recorded<F> {
    source: F,
    known: BTreeMap<u64, Vec<AxisState>>,
    axes: usize,
}

impl<F: FnMut(f64) -> Vec<AxisState>> Recorded<F> {
    pub(crate) fn new(axes: usize, source: F) -> Self {
        Self {
            source,
            known: BTreeMap::new(),
            axes,
        }
    }

    fn at(&mut self, axis: usize, time: f64) -> AxisState {
        // Times are not negative, so their bits are in the same order.
        let source = &mut self.source;
        let states = self.known.entry(time.to_bits()).or_insert_with(|| source(time));
        states.get(axis).copied().unwrap_or(AxisState {
            p: f64::NAN,
            v: f64::NAN,
            a: f64::NAN,
        })
    }
}

/// Bounds of the rounding of the samples of one axis.
#[derive(Clone, Copy)]
struct Noise {
    p: f64,
    v: f64,
    a: f64,
}

/// The steps `(duration, jerk)` of one axis over `0..duration`, with jerks up to `jerk`; `None` if the
/// samples are not finite or not such a motion.
pub(crate) fn recover<F: FnMut(f64) -> Vec<AxisState>>(
    recorded: &mut Recorded<F>,
    axis: usize,
    duration: f64,
    jerk: f64,
) -> Option<Steps> {
    if axis >= recorded.axes {
        return None;
    }
    if duration == 0.0 {
        return Some(Steps::new());
    }
    let mut largest = Noise {
        p: 0.0,
        v: 0.0,
        a: 0.0,
    };
    for k in 0..=32 {
        // At its very end ruckig switches to the motion after it, so the last sample is just before.
        let state = recorded.at(axis, duration * f64::from(k) / 32.0 * (1.0 - f64::EPSILON));
        if !(state.p.is_finite() && state.v.is_finite() && state.a.is_finite()) {
            return None;
        }
        largest.p = largest.p.max(state.p.abs());
        largest.v = largest.v.max(state.v.abs());
        largest.a = largest.a.max(state.a.abs());
    }
    // The time itself is rounded: this changes the acceleration in proportion to the jerk, and so on.
    let a = largest.a + jerk * duration;
    let v = largest.v + a * duration;
    let noise = Noise {
        a: ROUNDING * a,
        v: ROUNDING * v,
        p: ROUNDING * (largest.p + v * duration),
    };
    let mut steps = Steps::with_capacity(16);
    let end = duration * (1.0 - f64::EPSILON);
    let mut open = vec![(0.0, end, 0_u32)];
    let mut looked_at = 0;
    while let Some((left, right, depth)) = open.pop() {
        looked_at += 1;
        if looked_at > MAX_INTERVALS {
            return None;
        }
        let width = right - left;
        let (l, r) = (recorded.at(axis, left), recorded.at(axis, right));
        let slope = (r.a - l.a) / width;
        let one = [(width, slope), (0.0, 0.0)];
        if fits(recorded, axis, left, l, r, one, noise) {
            steps.push((width, slope));
            continue;
        }
        let edge = 0.125 * width;
        let (first, last) = (recorded.at(axis, left + edge), recorded.at(axis, right - edge));
        let (before, after) = ((first.a - l.a) / edge, (r.a - last.a) / edge);
        let turn = (r.a - l.a - after * width) / (before - after);
        if turn > 0.0 && turn < width {
            let two = [(turn, before), (width - turn, after)];
            if fits(recorded, axis, left, l, r, two, noise) {
                steps.extend(two);
                continue;
            }
        }
        if depth >= DEEPEST {
            steps.push((width, slope));
            continue;
        }
        let middle = left + 0.5 * width;
        open.push((middle, right, depth + 1));
        open.push((left, middle, depth + 1));
    }
    Some(join(&steps, noise))
}

/// Whether two steps match the interval, including its interior.
fn fits<F: FnMut(f64) -> Vec<AxisState>>(
    recorded: &mut Recorded<F>,
    axis: usize,
    left: f64,
    l: AxisState,
    r: AxisState,
    steps: [(f64, f64); 2],
    noise: Noise,
) -> bool {
    let turn = l.after(steps[0].0, steps[0].1);
    let end = turn.after(steps[1].0, steps[1].1);
    let near = |x: AxisState, y: AxisState| {
        (x.a - y.a).abs() <= noise.a && (x.v - y.v).abs() <= noise.v && (x.p - y.p).abs() <= noise.p
    };
    let width = steps[0].0 + steps[1].0;
    near(end, r)
        && PROBES.iter().all(|fraction| {
            let at = fraction * width;
            let state = if at <= steps[0].0 {
                l.after(at, steps[0].1)
            } else {
                turn.after(at - steps[0].0, steps[1].1)
            };
            near(state, recorded.at(axis, left + at))
        })
}

/// Joins adjacent steps of equal jerk.
fn join(steps: &[(f64, f64)], noise: Noise) -> Steps {
    let mut joined = Steps::with_capacity(steps.len());
    for &(duration, jerk) in steps {
        match joined.last_mut() {
            Some(last) if (last.1 - jerk).abs() * last.0.min(duration) <= 4.0 * noise.a => {
                let whole = last.0 + duration;
                last.1 = (last.1 * last.0 + jerk * duration) / whole;
                last.0 = whole;
            }
            _ => joined.push((duration, jerk)),
        }
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::tests::Random;

    fn at(start: AxisState, steps: &Steps, time: f64) -> AxisState {
        let (mut state, mut left) = (start, time);
        for &(duration, jerk) in steps {
            let t = left.min(duration);
            state = state.after(t, jerk);
            left -= t;
        }
        state
    }

    fn recovered(start: AxisState, steps: &Steps, jerk: f64) -> Steps {
        let duration = steps.iter().map(|step| step.0).sum();
        let mut recorded = Recorded::new(1, |time| vec![at(start, steps, time)]);
        recover(&mut recorded, 0, duration, jerk).unwrap()
    }

    #[test]
    fn planted_pieces_are_recovered_with_times_and_jerks() {
        let mut random = Random::from_state(0x4e_0001);
        for case in 0..500 {
            // As a solver returns them: full jerk, none, full jerk of the other sign; short and long steps
            // next to each other.
            let planted: Steps = (0..7)
                .map(|k| {
                    (
                        random.log(1e-3, 1.0),
                        [1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0][k] * 30.0,
                    )
                })
                .collect();
            let found = recovered(AxisState::default(), &planted, 30.0);
            assert_eq!(
                found.len(),
                planted.len(),
                "case {case}: {found:?} for {planted:?}"
            );
            for (found, planted) in found.iter().zip(&planted) {
                assert!(
                    (found.0 - planted.0).abs() < 1e-9 && (found.1 - planted.1).abs() < 1e-6 * 30.0,
                    "case {case}: {found:?} for {planted:?}"
                );
            }
        }
    }

    #[test]
    fn an_excursion_between_equal_end_states_is_recovered() {
        // Third differences: acceleration, velocity and position at the end do not show them.
        let planted: Steps = vec![
            (1.0, 0.0),
            (0.1, 8.0),
            (0.1, -24.0),
            (0.1, 24.0),
            (0.1, -8.0),
            (1.6, 0.0),
        ];
        let end = at(AxisState::default(), &planted, 3.0);
        assert!(end.a.abs() < 1e-12 && end.v.abs() < 1e-12 && end.p.abs() < 1e-12);
        let found = recovered(AxisState::default(), &planted, 24.0);
        let max = found.iter().map(|step| step.1).fold(0.0, f64::max);
        assert!((max - 24.0).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn invalid_or_noisy_samples_are_rejected() {
        let mut nan = Recorded::new(1, |_| {
            vec![AxisState {
                p: f64::NAN,
                v: 0.0,
                a: 0.0,
            }]
        });
        assert_eq!(recover(&mut nan, 0, 1.0, 1.0), None);
        // Noise is not a motion of few pieces: the search ends and returns nothing.
        let mut random = Random::from_state(0x4e_0002);
        let mut noise = Recorded::new(1, |_| {
            vec![AxisState {
                p: random.unit(),
                v: random.unit(),
                a: random.unit(),
            }]
        });
        assert_eq!(recover(&mut noise, 0, 1.0, 1.0), None);
        assert_eq!(recover(&mut noise, 1, 1.0, 1.0), None, "no such axis");
    }
}
