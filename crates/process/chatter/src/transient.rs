//! The fate of a disturbance: the motion followed in time.
//!
//! The classical Runge-Kutta method with 32 steps per period of the faster axis: it damps the amplitude by
//! 1e-5 per period, far less than the damping of any tool. Beyond the model the motion continues with the
//! force at the floor of the speed, and without force out of contact, so that every motion has an end: it
//! dies out, settles at a cycle, continues within the model without one, or stays beyond the model.

use crate::adams::{Adams, AdamsMotion, forces_n};
use crate::error::ChatterError;
use crate::floquet::{Closed, Verified, report, shoot_near};
use crate::model::{Equilibrium, Model, State};
use crate::scan::MAX_FREE_PART;

/// Steps per period of the faster axis.
const STEPS: f64 = 32.0;
/// Periods of the slower axis in a window.
const PERIODS: f64 = 8.0;
/// Size relative to the largest disturbance within the model from which a disturbance has died out: the law
/// is linear there.
const DEAD_PART: f64 = 0.01;
/// ... for quick results.
const HASTY_DEAD_PART: f64 = 0.3;
/// ... of an impulse the opposite of which died out: after half a period that one was nearly this one, so only
/// the first periods are new.
const OPPOSITE_DEAD_PART: f64 = 0.5;
/// Windows beyond the model, none smaller than the first, after which a motion has left it.
const WINDOWS_OUTSIDE: usize = 4;
/// ... and windows after which it has left in any case.
const MAX_WINDOWS_OUTSIDE: usize = 60;

/// The fate of a disturbance.
#[derive(Clone, Debug, PartialEq)]
pub enum Fate {
    /// The motion returns to the steady cut.
    DiesOut,
    /// It settles at a stable cycle.
    Settles(Box<Verified>),
    /// It continues within the model without a cycle: a beat of two frequencies.
    GoesOn,
    /// It was still growing, within the model, at the end of the time limit.
    StillGrows,
    /// It grows out of the model.
    Leaves,
    /// It begins beyond the model.
    BeginsOutside,
}

/// Follows disturbances of a steady cut.
#[derive(Clone, Debug)]
pub struct TransientFollower<'a> {
    /// Known stable cycles, with their maximum and minimum size, m/s.
    known: Vec<(Verified, [f64; 2])>,
    model: Model<'a>,
    rest: State,
    is_steady: bool,
    step_s: f64,
    window: usize,
    longest_s: f64,
    two_periods_s: f64,
    windows_outside: usize,
    /// Velocity at which the cutting speed would reach the floor, m/s.
    reach: f64,
    /// Fraction of it, or of the first size if that is smaller, that counts as rest.
    dead: f64,
    /// The method with one force per step, for quick results.
    adams: Option<Adams>,
}

/// A window of a motion.
struct Window {
    /// Maximum and minimum size, m/s.
    peak: f64,
    min: f64,
    outside: bool,
}

/// The end of a motion in a window.
enum Ended {
    /// Outside the model in the first steps.
    AtOnce,
    /// The end of the force law.
    Later,
}

/// A motion near a cycle, which may be unstable.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lingering {
    pub(crate) state: State,
    pub(crate) change: f64,
}

impl<'a> TransientFollower<'a> {
    /// Creates a follower for a steady cut, for 375 to 1000 periods of the slower axis: longer if small
    /// vibrations change slowly.
    #[must_use]
    pub fn new(model: Model<'a>, rest: &Equilibrium) -> Self {
        let frequencies = model.axes().map(|axis| axis.frequency_hz());
        let (slow, fast) = (
            frequencies[0].min(frequencies[1]),
            frequencies[0].max(frequencies[1]),
        );
        let tool = model.tool();
        let growth = rest.growth_per_s();
        let [v1, v2] = rest.deflection_m;
        Self {
            known: Vec::new(),
            rest: State::new(v1, v2, 0.0, 0.0),
            is_steady: growth < 0.0,
            step_s: 1.0 / (STEPS * fast),
            window: (PERIODS * STEPS * fast / slow) as usize,
            longest_s: (8.0 * slow / growth.abs()).clamp(375.0, 1000.0) / slow,
            dead: DEAD_PART,
            windows_outside: WINDOWS_OUTSIDE,
            two_periods_s: 2.0 / slow,
            adams: None,
            reach: (tool.speed_m_min - tool.floor_m_min) / 60.0,
            model,
        }
    }

    /// Counts a disturbance as dead if it has fallen to [`HASTY_DEAD_PART`] of its size, in windows of half the
    /// length, by the exponential Adams method. Use it if no smaller cycle is known.
    pub(crate) fn hasty(self) -> Self {
        Self {
            dead: HASTY_DEAD_PART,
            adams: Adams::new(self.model.axes(), self.step_s),
            window: self.window / 2,
            windows_outside: 2 * WINDOWS_OUTSIDE,
            ..self
        }
    }

    /// Counts it as dead at [`OPPOSITE_DEAD_PART`] already.
    pub(crate) fn hastier(self) -> Self {
        Self {
            dead: OPPOSITE_DEAD_PART,
            ..self
        }
    }

    /// Adds a known stable cycle: a motion that reaches it is followed no further.
    pub(crate) fn add_stable_cycle(&mut self, cycle: &Verified) {
        let (mut state, mut sizes) = (cycle.state, [f64::INFINITY, 0.0_f64]);
        let count = (1.0 / (cycle.frequency_hz * self.step_s)).ceil() as usize;
        for _ in 0..=count {
            let size = self.size_m_s(&state);
            sizes = [sizes[0].min(size), sizes[1].max(size)];
            let Ok(next) = self.step(&state) else { return };
            state = next;
        }
        self.known.push((cycle.clone(), sizes));
    }

    /// Velocity along the cutting speed at which the speed would reach the floor, m/s.
    #[must_use]
    pub fn reach_m_s(&self) -> f64 {
        self.reach
    }

    /// Whether small vibrations die out.
    pub(crate) fn is_steady(&self) -> bool {
        self.is_steady
    }

    /// The state of the steady cut.
    #[must_use]
    pub fn rest(&self) -> State {
        self.rest
    }

    /// Size of a disturbance, m/s: the velocity of the total mass with the same energy.
    #[must_use]
    pub fn size_m_s(&self, state: &State) -> f64 {
        libm::sqrt(self.square_size(state))
    }

    fn square_size(&self, state: &State) -> f64 {
        let axes = self.model.axes();
        let energy: f64 = (0..2)
            .map(|i| {
                let stretch = state[i] - self.rest[i];
                axes[i].mass_kg * state[i + 2] * state[i + 2] + axes[i].stiffness_n_m * stretch * stretch
            })
            .sum();
        2.0 * energy / (axes[0].mass_kg + axes[1].mass_kg)
    }

    /// One step of the motion.
    fn step(&self, state: &State) -> Result<State, ChatterError> {
        let h = self.step_s;
        let first = self.model.derivative(state)?;
        let second = self.model.derivative(&(state + first * (0.5 * h)))?;
        let third = self.model.derivative(&(state + second * (0.5 * h)))?;
        let fourth = self.model.derivative(&(state + third * h))?;
        Ok(state + (first + (second + third) * 2.0 + fourth) * (h / 6.0))
    }

    /// Maximum number of steps of [`TransientFollower::samples`].
    pub const MAX_STEPS: usize = 1_000_000;

    /// Samples of the motion from a state, time in s and state, until `duration_s` or the end of the force
    /// law, with at most [`Self::MAX_STEPS`] steps.
    #[must_use]
    pub fn samples(&self, start: State, duration_s: f64) -> Vec<(f64, State)> {
        let count = (duration_s / self.step_s).clamp(0.0, Self::MAX_STEPS as f64) as usize;
        let mut all = Vec::with_capacity(count + 1);
        let mut state = start;
        all.push((0.0, state));
        for k in 1..=count {
            match self.step(&state) {
                Ok(next) if next.iter().all(|value| value.is_finite()) => state = next,
                _ => break,
            }
            all.push((k as f64 * self.step_s, state));
        }
        all
    }

    /// A window of a motion. In the first steps, of this number, the motion must stay within the model.
    fn window(&self, motion: &mut AdamsMotion, first: usize) -> Result<Window, Ended> {
        // Squares of sizes.
        let (mut peak, mut min) = (0.0_f64, f64::INFINITY);
        let (mut free, mut slowest) = (0, f64::INFINITY);
        let most_free = MAX_FREE_PART * first as f64;
        for k in 0..self.window {
            let ended = || if k < first { Ended::AtOnce } else { Ended::Later };
            let (speed, depth) = self.advance(motion).ok_or_else(ended)?;
            let square = self.square_size(&motion.state);
            slowest = slowest.min(speed);
            free += usize::from(depth <= 0.0);
            peak = peak.max(square);
            min = min.min(square);
            if k < first && (speed <= self.model.tool().floor_m_min || free as f64 > most_free) {
                return Err(Ended::AtOnce);
            }
        }
        if !peak.is_finite() {
            return Err(Ended::Later);
        }
        let free = free as f64 / self.window as f64;
        Ok(Window {
            peak: libm::sqrt(peak),
            min: libm::sqrt(min),
            outside: slowest <= self.model.tool().floor_m_min || free > MAX_FREE_PART,
        })
    }

    /// One step of a motion; the speed and the depth after it. `None` at the end of the force law.
    fn advance(&self, motion: &mut AdamsMotion) -> Option<(f64, f64)> {
        let Some(adams) = &self.adams else {
            motion.state = self.step(&motion.state).ok()?;
            return Some(self.model.cut_at(&motion.state));
        };
        if motion.is_new() {
            motion.push(forces_n(&self.model, &motion.state).ok()?.0);
        }
        if motion.is_ripe() {
            adams.step(motion);
        } else {
            motion.state = self.step(&motion.state).ok()?;
        }
        let (forces, speed, depth) = forces_n(&self.model, &motion.state).ok()?;
        motion.push(forces);
        Some((speed, depth))
    }

    /// The fate of a motion that begins at a state.
    #[must_use]
    pub fn fate(&self, start: State) -> Fate {
        self.follow(start).0
    }

    /// The fate of a motion, and where its size changed least.
    pub(crate) fn follow(&self, start: State) -> (Fate, Option<Lingering>) {
        let mut lingering: Option<Lingering> = None;
        let mut peaks: Vec<f64> = Vec::new();
        let (mut run, mut run_peak) = (0, 0.0);
        // Shooting is expensive: each further attempt waits twice as long.
        let (mut next_attempt, mut wait, mut settled, mut arrived) = (4, 8, 0, 0);
        let max = (self.longest_s / (self.step_s * self.window as f64)) as usize;
        // Two periods show whether it begins within the model: a motion that leaves later has grown.
        let two_periods = (self.two_periods_s / self.step_s) as usize;
        let mut motion = AdamsMotion::new(start);
        for k in 0..max {
            let first = if k == 0 { two_periods } else { 0 };
            let window = match self.window(&mut motion, first) {
                Ok(window) => window,
                Err(Ended::AtOnce) => return (Fate::BeginsOutside, lingering),
                Err(Ended::Later) => return (Fate::Leaves, lingering),
            };
            let state = motion.state;
            if window.outside {
                // Short windows cover less than a beat of two frequencies.
                if run < self.windows_outside / WINDOWS_OUTSIDE {
                    run_peak = if run == 0 {
                        window.peak
                    } else {
                        window.peak.max(run_peak)
                    };
                }
                run += 1;
                if (run >= self.windows_outside && window.peak > 0.98 * run_peak)
                    || run >= MAX_WINDOWS_OUTSIDE
                {
                    return (Fate::Leaves, lingering);
                }
            } else {
                run = 0;
            }
            let last = peaks.last().copied();
            peaks.push(window.peak);
            let falls = peaks.windows(2).rev().take(2).all(|two| two[1] < two[0]);
            let dead = self.dead * self.reach.min(peaks[0]);
            if self.is_steady && window.peak < dead && peaks.len() > 2 && falls {
                return (Fate::DiesOut, lingering);
            }
            let Some(last) = last else { continue };
            let change = (window.peak / last - 1.0).abs();
            if !window.outside && lingering.is_none_or(|calm| change < calm.change) {
                lingering = Some(Lingering { state, change });
            }
            let is_on = |sizes: &[f64; 2]| {
                (window.min / sizes[0] - 1.0).abs() < 0.01 && (window.peak / sizes[1] - 1.0).abs() < 0.01
            };
            arrived = if self.known.iter().any(|(_, sizes)| is_on(sizes)) {
                arrived + 1
            } else {
                0
            };
            if arrived >= 3
                && let Some((cycle, _)) = self.known.iter().find(|(_, sizes)| is_on(sizes))
            {
                return (Fate::Settles(Box::new(cycle.clone())), lingering);
            }
            settled = if change < 2e-3 && !window.outside {
                settled + 1
            } else {
                0
            };
            if settled >= 3 && k >= next_attempt {
                if let Some(found) = self.cycle_near(&state)
                    && found.stable()
                    && found.within_model(&self.model)
                {
                    return (Fate::Settles(Box::new(found)), lingering);
                }
                wait *= 2;
                next_attempt = k + wait;
            }
        }
        let half = peaks.len() / 2;
        let falls = peaks[half..].windows(2).all(|two| two[1] < two[0]);
        let fate = match peaks.last() {
            _ if run > 0 => Fate::Leaves,
            _ if peaks[half..].windows(2).all(|two| two[1] > two[0]) => Fate::StillGrows,
            // Slowly: to rest, or to a cycle.
            Some(_) if self.is_steady && falls => match self.cycle_near(&motion.state) {
                Some(found) if found.stable() && found.within_model(&self.model) => {
                    Fate::Settles(Box::new(found))
                }
                _ => Fate::DiesOut,
            },
            _ => Fate::GoesOn,
        };
        (fate, lingering)
    }

    /// The cycle that a motion is on, or close to.
    pub(crate) fn cycle_near(&self, state: &State) -> Option<Verified> {
        let closed = self.close(state)?;
        // Newton's method may jump to another cycle.
        let (here, there) = (self.size_m_s(state), self.size_m_s(&closed.state));
        if (there / here - 1.0).abs() > 0.1 {
            return None;
        }
        report(&self.model, &closed).ok()
    }

    fn close(&self, state: &State) -> Option<Closed> {
        // The period from the passages of the faster coordinate through its mean, in one direction.
        let coordinate = usize::from(state[3].abs() + 1e-9 > state[2].abs());
        let mut now = *state;
        let mut passages = Vec::new();
        let (mut mean, mut size) = (0.0, 0.0_f64);
        let mut sampled = Vec::with_capacity(self.window);
        for _ in 0..self.window {
            now = self.step(&now).ok()?;
            sampled.push(now[coordinate]);
            mean += now[coordinate] / self.window as f64;
        }
        for (k, two) in sampled.windows(2).enumerate() {
            size = size.max((two[0] - mean).abs());
            if two[0] < mean && two[1] >= mean {
                passages.push(k as f64 + (mean - two[0]) / (two[1] - two[0]));
            }
        }
        let [first, .., last] = passages.as_slice() else {
            return None;
        };
        let period = (last - first) / (passages.len() - 1) as f64 * self.step_s;
        // A return to rest, or to a distant motion, is a different motion.
        let here = self.size_m_s(state);
        let is_near = |state: &State| (0.5..=2.0).contains(&(self.size_m_s(state) / here));
        shoot_near(&self.model, *state, period, size, is_near)
            .ok()
            .flatten()
    }
}
