//! Solving a transfer, and its result.

use evolvent_machine::Limits;
use evolvent_path::{AXES, Axes, AxisLetter};

use crate::check;
use crate::engine::{self, Units};
use crate::error::{Quantity, TransferEnd, TransferError};
use crate::fallback::{rest_to_rest, stop, stop_and_go};
use crate::landing::{Steps, land};
use crate::state::{AxesState, AxisLimits, AxisState, AxisTask, TransferPoint};
use crate::track::Track;

/// How the axes are synchronised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Sync {
    /// All arrive at the same time.
    #[default]
    Time,
    /// All follow the straight line between start and target (of all nine axes), so they arrive at the same
    /// time.
    Phase,
    /// Each arrives as soon as it can; all must end at rest.
    None,
}

/// How a transfer was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// By ruckig: the fastest move.
    Ruckig,
    /// To rest, in a straight line, and up to speed: if ruckig failed, or its move left the travel.
    StopAndGo,
}

/// A verified move from one state to another.
///
/// A plain value of about 10 kB without heap; copying and [`Transfer::at`] are real-time safe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transfer {
    tracks: [Track; AXES],
    duration_s: f64,
    method: Method,
}

/// Fraction of the jerk limit that is reserved for the landing.
const SPARE: f64 = 1e-7;
/// Maximum deviation of states from the straight line, as a fraction of the limit of the axis.
const STRAIGHT: f64 = 1e-9;

impl Transfer {
    /// The fastest move between two states within `limits` and the travel.
    ///
    /// Not for the real-time cycle: allocates, and takes some tens of microseconds per axis, milliseconds in
    /// the worst case. Limits are kept to 3e-6 of their values; the target is reached to 1e-9 (mm, degrees;
    /// velocity and acceleration: of their limits).
    ///
    /// # Errors
    /// A number that is not finite or not above zero, a state outside limits or travel, states that [`Sync`]
    /// does not permit, or a move that leaves the travel. The error contains the rejected numbers.
    pub fn solve(
        limits: &Limits,
        from: &AxesState,
        to: &AxesState,
        sync: Sync,
    ) -> Result<Self, TransferError> {
        check::entry(limits, from, to)?;
        let moving = check::moving(limits, from, to);
        let tasks: Vec<AxisTask> = moving
            .iter()
            .map(|&i| {
                let (from, to) = (AxisState::of(from, i), AxisState::of(to, i));
                AxisTask {
                    limits: check::limits_of(limits, i),
                    from,
                    to,
                }
            })
            .collect();
        let job = Job {
            limits,
            from,
            to,
            moving,
            tasks,
        };
        match sync {
            Sync::Time => job.solve(&[job.tasks.as_slice()], |steps| steps),
            Sync::None => {
                job.arrives_at_rest()?;
                let apart: Vec<&[AxisTask]> = job.tasks.chunks(1).collect();
                job.solve(&apart, |steps| steps)
            }
            Sync::Phase => {
                let StraightLine { task, distances } = job.line()?;
                job.solve(&[&[task]], |steps| spread(&steps, &distances))
            }
        }
    }

    /// A transfer of verified tracks.
    pub(crate) fn of_tracks(tracks: [Track; AXES], method: Method) -> Self {
        let duration_s = tracks.iter().map(Track::duration_s).fold(0.0, f64::max);
        Self {
            tracks,
            duration_s,
            method,
        }
    }

    /// State and jerk at `t` seconds: the start before 0, the target after the end. Real-time safe.
    #[must_use]
    pub fn at(&self, t: f64) -> TransferPoint {
        let mut point = TransferPoint {
            position: Axes::zeros(),
            velocity: Axes::zeros(),
            acceleration: Axes::zeros(),
            jerk: Axes::zeros(),
        };
        for (i, track) in self.tracks.iter().enumerate() {
            let (state, jerk) = track.at(t);
            point.position[i] = state.p;
            point.velocity[i] = state.v;
            point.acceleration[i] = state.a;
            point.jerk[i] = jerk;
        }
        point
    }

    /// Time at which the last axis arrives, s. Real-time safe.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// How it was found.
    #[must_use]
    pub fn method(&self) -> Method {
        self.method
    }

    /// The pieces of an axis. Real-time safe.
    #[must_use]
    pub fn track(&self, axis: AxisLetter) -> &Track {
        &self.tracks[axis.index()]
    }
}

/// A problem that has passed the checks of its input.
struct Job<'a> {
    limits: &'a Limits,
    from: &'a AxesState,
    to: &'a AxesState,
    /// Axes that move, and the task of each.
    moving: Vec<usize>,
    tasks: Vec<AxisTask>,
}

/// The straight line of all axes as one task.
struct StraightLine {
    task: AxisTask,
    /// Distance of each moving axis per unit of the line.
    distances: Vec<f64>,
}

impl Job<'_> {
    /// Calls ruckig for each group in several formulations and takes the first result that can be verified.
    /// If there is none, the axes stop first.
    fn solve(
        &self,
        groups: &[&[AxisTask]],
        spread: impl Fn(Vec<Steps>) -> Vec<Steps>,
    ) -> Result<Transfer, TransferError> {
        if self.tasks.is_empty() {
            return self.finish(Vec::new(), Method::Ruckig);
        }
        for (k, attempt) in ATTEMPTS.into_iter().enumerate() {
            let mut answer = Vec::with_capacity(self.tasks.len());
            for tasks in groups {
                match together(tasks, attempt) {
                    Some(steps) => answer.extend(steps),
                    None => break,
                }
            }
            let steps = spread(answer);
            if steps.len() == self.tasks.len()
                && let Ok(transfer) = self.finish(steps, Method::Ruckig)
            {
                // With reduced limits, stopping first may be faster.
                let other = if k < FULL {
                    None
                } else {
                    self.stopping(groups, &spread).ok()
                };
                let faster = other.filter(|other| other.duration_s < transfer.duration_s);
                return Ok(faster.unwrap_or(transfer));
            }
        }
        self.stopping(groups, &spread)
    }

    fn stopping(
        &self,
        groups: &[&[AxisTask]],
        spread: &impl Fn(Vec<Steps>) -> Vec<Steps>,
    ) -> Result<Transfer, TransferError> {
        let steps = groups.iter().flat_map(|tasks| stop_and_go(tasks)).collect();
        self.finish(spread(steps), Method::StopAndGo)
    }

    /// Lands the steps on the target and verifies them.
    fn finish(&self, steps: Vec<Steps>, method: Method) -> Result<Transfer, TransferError> {
        let mut tracks: [Track; AXES] = std::array::from_fn(|i| Track::resting(AxisState::of(self.to, i)));
        let mut duration_s: f64 = 0.0;
        for ((mut steps, task), &i) in steps.into_iter().zip(&self.tasks).zip(&self.moving) {
            land(&mut steps, task.from, task.to);
            let Some(track) = Track::through(task.from, task.to, &steps) else {
                return Err(TransferError::Unsolved {
                    axis: AxisLetter::ALL[i],
                    quantity: Quantity::Jerk,
                    value: f64::NAN,
                    limit: task.limits.j,
                });
            };
            duration_s = duration_s.max(track.duration_s());
            tracks[i] = track;
        }
        check::exit(self.limits, self.from, self.to, &tracks)?;
        Ok(Transfer {
            tracks,
            duration_s,
            method,
        })
    }

    fn arrives_at_rest(&self) -> Result<(), TransferError> {
        for (&i, task) in self.moving.iter().zip(&self.tasks) {
            if self.tasks.len() > 1 && !task.to.is_at_rest() {
                return Err(TransferError::ArrivesMoving {
                    axis: AxisLetter::ALL[i],
                    velocity: task.to.v,
                    acceleration: task.to.a,
                });
            }
        }
        Ok(())
    }

    /// The straight line, if all states move along it.
    fn line(&self) -> Result<StraightLine, TransferError> {
        let between = self.to.position - self.from.position;
        // A line of zero length takes its direction from the first of these vectors that is not zero.
        let mut direction = between;
        for vector in [
            self.from.velocity,
            self.to.velocity,
            self.from.acceleration,
            self.to.acceleration,
        ] {
            if check::largest(&direction, &self.moving) == 0.0 {
                direction = vector;
            }
        }
        let length = check::largest(&direction, &self.moving);
        let distances: Vec<f64> = self
            .moving
            .iter()
            .map(|&i| if length > 0.0 { direction[i] / length } else { 0.0 })
            .collect();
        let mut limits = AxisLimits {
            v: f64::INFINITY,
            a: f64::INFINITY,
            j: f64::INFINITY,
        };
        for (distance, task) in distances.iter().zip(&self.tasks) {
            if *distance != 0.0 {
                limits.v = limits.v.min(task.limits.v / distance.abs());
                limits.a = limits.a.min(task.limits.a / distance.abs());
                limits.j = limits.j.min(task.limits.j / distance.abs());
            }
        }
        let along = |vector: &Axes| {
            let (mut sum, mut norm) = (0.0, 0.0);
            for (distance, &i) in distances.iter().zip(&self.moving) {
                sum += distance * vector[i];
                norm += distance * distance;
            }
            if norm > 0.0 { sum / norm } else { 0.0 }
        };
        let state = |state: &AxesState| AxisState {
            p: 0.0,
            v: along(&state.velocity),
            a: along(&state.acceleration),
        };
        let (from, mut to) = (state(self.from), state(self.to));
        to.p = along(&between);
        for (distance, &i) in distances.iter().zip(&self.moving) {
            for (end, line, axis) in [
                (TransferEnd::Start, from, self.from),
                (TransferEnd::Target, to, self.to),
            ] {
                for (quantity, off, limit) in [
                    (
                        Quantity::Velocity,
                        axis.velocity[i] - distance * line.v,
                        self.limits.velocity[i],
                    ),
                    (
                        Quantity::Acceleration,
                        axis.acceleration[i] - distance * line.a,
                        self.limits.acceleration[i],
                    ),
                ] {
                    if off.abs() > STRAIGHT * limit {
                        return Err(TransferError::NotStraight {
                            axis: AxisLetter::ALL[i],
                            end,
                            quantity,
                            off,
                        });
                    }
                }
            }
        }
        Ok(StraightLine {
            task: AxisTask { limits, from, to },
            distances,
        })
    }
}

/// Steps of the line as steps of the axes.
fn spread(steps: &[Steps], distances: &[f64]) -> Vec<Steps> {
    let Some(line) = steps.first() else {
        return Vec::new();
    };
    distances
        .iter()
        .map(|distance| line.iter().map(|step| (step.0, step.1 * distance)).collect())
        .collect()
}

/// Steps of all tasks, which arrive together.
///
/// Axes at rest at both ends need no solver: their fastest move is closed form, and a move slower by a factor
/// `k` has `1/k^3` of the jerk. Only the slowest of them is passed to ruckig, because it may determine the
/// duration. This avoids the problems that ruckig solves worst: one axis moves a micrometre while another
/// moves a metre.
fn together(tasks: &[AxisTask], attempt: Attempt) -> Option<Vec<Steps>> {
    let resting = |task: &AxisTask| task.from.is_at_rest() && task.to.is_at_rest();
    let fastest = |task: &AxisTask| {
        let limits = task.usable(attempt.fraction);
        let distance = task.to.p - task.from.p;
        rest_to_rest(distance.abs(), &limits).map(|step| (step.0, step.1 * distance.signum()))
    };
    let mut slowest = None;
    let mut slowest_s = -1.0;
    for (k, task) in tasks.iter().enumerate().filter(|(_, task)| resting(task)) {
        let lasting = lasting(&fastest(task));
        if lasting > slowest_s {
            (slowest, slowest_s) = (Some(k), lasting);
        }
    }
    let pending: Vec<usize> = (0..tasks.len())
        .filter(|&k| slowest == Some(k) || !resting(&tasks[k]))
        .collect();
    let questions: Vec<AxisTask> = pending.iter().map(|&k| tasks[k]).collect();
    let answers = engine::fastest(&questions, &attempt.units(&questions), attempt.fraction)?;
    let duration = answers.iter().map(|steps| lasting(steps)).fold(0.0, f64::max);
    let mut all: Vec<Steps> = vec![Steps::new(); tasks.len()];
    for (k, steps) in pending.iter().zip(answers) {
        all[*k] = steps;
    }
    for (k, task) in tasks.iter().enumerate() {
        if resting(task) && slowest != Some(k) {
            let quick = fastest(task);
            let slower = (duration / lasting(&quick)).max(1.0);
            all[k] = quick
                .iter()
                .map(|step| (step.0 * slower, step.1 / (slower * slower * slower)))
                .collect();
        }
    }
    Some(all)
}

fn lasting(steps: &[(f64, f64)]) -> f64 {
    steps.iter().map(|step| step.0).sum()
}

/// One formulation of a problem for ruckig.
#[derive(Clone, Copy)]
struct Attempt {
    /// In units of the move itself, so that its numbers are about 1; otherwise in seconds and in the distance
    /// that an axis travels in one second at its speed limit.
    natural: bool,
    /// Fraction of the limits to use. Other digits lead the solver through other branches.
    fraction: f64,
}

/// Number of attempts that use the limits in full.
const FULL: usize = 2;
/// The first attempt solves nearly all problems.
const ATTEMPTS: [Attempt; 4] = [
    Attempt {
        natural: true,
        fraction: 1.0 - SPARE,
    },
    Attempt {
        natural: false,
        fraction: 1.0 - SPARE,
    },
    Attempt {
        natural: true,
        fraction: 1.0 - 1e-5,
    },
    Attempt {
        natural: false,
        fraction: 1.0 - 1e-3,
    },
];

impl Attempt {
    fn units(self, tasks: &[AxisTask]) -> Units {
        if !self.natural {
            let length = tasks.iter().map(|task| task.limits.v).collect();
            return Units { second: 1.0, length };
        }
        let second = natural_time(tasks);
        let length = tasks.iter().map(|task| natural_length(task, second)).collect();
        Units { second, length }
    }
}

/// Approximate duration of the move, at most the time to accelerate to the speed limit.
fn natural_time(tasks: &[AxisTask]) -> f64 {
    let mut longest = 1e-9_f64;
    for task in tasks {
        let limits = task.usable(1.0);
        let all = lasting(&rest_to_rest((task.to.p - task.from.p).abs(), &limits))
            + lasting(&stop(task.from, &limits))
            + lasting(&stop(task.to, &limits));
        let AxisLimits { v, a, j } = limits;
        longest = longest.max(all.min(v / a + a / j));
    }
    longest
}

fn natural_length(task: &AxisTask, second: f64) -> f64 {
    let AxisLimits { v, .. } = task.limits;
    let distance = (task.to.p - task.from.p).abs();
    let moving = (task.from.v.abs().max(task.to.v.abs())) * second
        + (task.from.a.abs().max(task.to.a.abs())) * second * second;
    (distance + moving).clamp(1e-9 * v * second, v * second)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::tests::{Random, task};

    /// Axes at rest together with one that moves.
    fn mixed(random: &mut Random) -> Vec<AxisTask> {
        let mut tasks: Vec<AxisTask> = (0..5).map(|_| task(random)).collect();
        for task in &mut tasks[1..] {
            for state in [&mut task.from, &mut task.to] {
                (state.v, state.a) = (0.0, 0.0);
            }
        }
        tasks
    }

    #[test]
    fn axes_at_rest_are_slowed_to_arrive_with_the_others() {
        let mut random = Random::from_state(0x74_0001);
        for case in 0..200 {
            let tasks = mixed(&mut random);
            let Some(all) = together(&tasks, ATTEMPTS[0]) else {
                continue;
            };
            let duration = lasting(&all[0]);
            let mut lengths = all.iter().map(|steps| lasting(steps) / duration - 1.0);
            assert!(lengths.all(|off| off.abs() < 1e-9), "case {case}");
            // All except the slowest are closed form: they arrive without landing.
            let arrived = all.iter().zip(&tasks).skip(1).filter(|(steps, task)| {
                let end = steps
                    .iter()
                    .fold(task.from, |state, &(t, jerk)| state.after(t, jerk));
                let distance = (task.to.p - task.from.p).abs();
                (end.p - task.to.p).abs() < 1e-9 * distance && end.v.abs() < 1e-9 * task.limits.v
            });
            assert!(arrived.count() >= 3, "case {case}");
        }
    }

    #[test]
    fn a_slower_move_after_a_solver_failure_is_verified() {
        let mut random = Random::from_state(0x74_0002);
        for case in 0..500 {
            let count = 1 + case % AXES;
            let tasks: Vec<AxisTask> = (0..count).map(|_| task(&mut random)).collect();
            let mut limits = Limits {
                present: [false; AXES],
                velocity: Axes::zeros(),
                acceleration: Axes::zeros(),
                jerk: Axes::zeros(),
                travel_min: Axes::repeat(-1e6),
                travel_max: Axes::repeat(1e6),
                home: Axes::zeros(),
            };
            let mut from = AxesState::at_rest(Axes::zeros());
            let mut to = from;
            for (i, task) in tasks.iter().enumerate() {
                limits.present[i] = true;
                (limits.velocity[i], limits.acceleration[i], limits.jerk[i]) =
                    (task.limits.v, task.limits.a, task.limits.j);
                (from.position[i], from.velocity[i], from.acceleration[i]) =
                    (task.from.p, task.from.v, task.from.a);
                (to.position[i], to.velocity[i], to.acceleration[i]) = (task.to.p, task.to.v, task.to.a);
            }
            let job = Job {
                limits: &limits,
                from: &from,
                to: &to,
                moving: (0..count).collect(),
                tasks: tasks.clone(),
            };
            let slow = job.finish(stop_and_go(&tasks), Method::StopAndGo);
            let slow = slow.unwrap_or_else(|error| panic!("case {case}: {error}"));
            let fast = Transfer::solve(&limits, &from, &to, Sync::Time);
            let fast = fast.unwrap_or_else(|error| panic!("case {case}: {error}"));
            assert!(
                fast.duration_s() <= slow.duration_s() * (1.0 + 1e-6),
                "case {case}: {} s, but {} s by stopping",
                fast.duration_s(),
                slow.duration_s()
            );
        }
    }
}
