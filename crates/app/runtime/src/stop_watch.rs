//! The longest stop of the present job, for the status: the longest that a hold at any moment so far would
//! have needed.
//!
//! A hold is simulated over the path that was driven after it. Its stop is therefore known when enough path
//! has been driven, a fraction of a second later. Each computation takes up to 30 ms, so a separate thread
//! with the normal scheduler does it.

use std::io;
use std::thread;
use std::time::Duration;

use evolvent_bus::Status;
use evolvent_machine::{Limits, PlannerKind};
use evolvent_motion::{LongestStop, Setpoint, StoppingDistance};
use evolvent_path::Axes;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::due_setpoint::DueSetpoint;
use crate::job::{Clock, Setup};

/// Capacity of the queue to the thread: this time in setpoints, but at least this number. The thread works
/// for up to 30 ms without reading it.
const QUEUE_SECONDS: f64 = 0.25;
const MIN_QUEUE: usize = 1024;
/// Capacity of the queue of results to the publisher. The thread keeps results that do not fit.
const FOUND: usize = 16;
/// Poll interval of the thread.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// The longest stop of a job so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct JobStop {
    job: u64,
    stop: LongestStop,
}

/// The publisher's end: passes setpoints to the thread and writes its results into the status.
#[derive(Debug)]
pub(crate) struct StopWatch {
    driven: Producer<(u64, Setpoint)>,
    found: Consumer<JobStop>,
    newest: JobStop,
    moved: bool,
}

impl StopWatch {
    /// Starts the thread, which ends with this object. `None` if holds are not simulated: those of the
    /// classic planner are separate profiles, and with the virtual clock setpoints come too fast.
    pub(crate) fn start(setup: &Setup, clock: Clock) -> io::Result<Option<Self>> {
        if clock != Clock::Realtime || setup.machine.path.planner == PlannerKind::Classic {
            return Ok(None);
        }
        let length = ((setup.rate_hz() * QUEUE_SECONDS) as usize).max(MIN_QUEUE);
        let (driven, queue) = RingBuffer::new(length);
        let (to_publisher, found) = RingBuffer::new(FOUND);
        let follower = Follower::new(setup.machine.limits(), setup.period_ns as f64 * 1e-9);
        let _detached = thread::Builder::new()
            .name("stops".into())
            .spawn(move || follower.run(queue, to_publisher))?;
        Ok(Some(Self {
            driven,
            found,
            newest: JobStop::default(),
            moved: false,
        }))
    }

    /// Adds a published setpoint. Does not wait: a setpoint that does not fit is a gap, and motion across a
    /// gap is not simulated.
    pub(crate) fn follow(&mut self, due: &DueSetpoint) {
        let moves = due.setpoint.line > 0 && !is_at_rest(&due.setpoint);
        if moves || self.moved {
            let _full = self.driven.push((due.job, due.setpoint));
        }
        self.moved = moves;
    }

    /// Writes the longest stop of the status's job, if known. `lines_before`: lines of the job that do not
    /// count.
    pub(crate) fn fill(&mut self, status: &mut Status, lines_before: u32) {
        while let Ok(found) = self.found.pop() {
            self.newest = found;
        }
        let stop = if self.newest.job == status.job {
            self.newest.stop
        } else {
            LongestStop::default()
        };
        status.longest_stop_mm = stop.path_mm;
        status.longest_stop_s = stop.duration_s;
        status.longest_stop_line = stop.line.saturating_sub(lines_before);
    }
}

fn is_at_rest(setpoint: &Setpoint) -> bool {
    setpoint.velocity == Axes::zeros() && setpoint.acceleration == Axes::zeros()
}

/// The thread's end.
struct Follower {
    limits: Limits,
    period_s: f64,
    stops: StoppingDistance,
    last: u64,
    longest: JobStop,
}

impl Follower {
    fn new(limits: Limits, period_s: f64) -> Self {
        Self {
            limits,
            period_s,
            stops: StoppingDistance::new(limits, period_s),
            last: 0,
            longest: JobStop::default(),
        }
    }

    fn run(mut self, mut driven: Consumer<(u64, Setpoint)>, mut found: Producer<JobStop>) {
        let mut sent = self.longest;
        loop {
            let over = driven.is_abandoned();
            while let Ok((job, setpoint)) = driven.pop() {
                self.push(job, &setpoint);
                if self.longest != sent && found.push(self.longest).is_ok() {
                    sent = self.longest;
                }
            }
            if over {
                return;
            }
            thread::sleep(POLL_INTERVAL);
        }
    }

    fn push(&mut self, job: u64, setpoint: &Setpoint) {
        if job != self.longest.job {
            self.longest = JobStop {
                job,
                ..JobStop::default()
            };
            self.begin();
        } else if setpoint.sequence != self.last + 1 {
            // Setpoints were lost, or the axes were at rest or moved for something else in between.
            self.begin();
        }
        self.last = setpoint.sequence;
        self.stops.push(setpoint);
        if let Some(stop) = self.stops.longest()
            && stop.path_mm > self.longest.stop.path_mm
        {
            self.longest.stop = stop;
        }
    }

    fn begin(&mut self) {
        self.stops = StoppingDistance::new(self.limits, self.period_s);
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use evolvent_gcode::SPINDLES;
    use evolvent_motion::MotionState;
    use evolvent_path::AXES;

    const PERIOD_S: f64 = 0.001;
    const J: f64 = 50_000.0;
    const A: f64 = 2000.0;

    fn limits() -> Limits {
        let mut present = [false; AXES];
        present[0] = true;
        Limits {
            present,
            velocity: Axes::repeat(300.0),
            acceleration: Axes::repeat(A),
            jerk: Axes::repeat(J),
            travel_min: Axes::repeat(-1e4),
            travel_max: Axes::repeat(1e4),
            home: Axes::zeros(),
        }
    }

    /// X from rest to `v` and back to rest along a straight line, with constant jerk within each ms.
    fn line(v: f64, first: u64) -> Vec<Setpoint> {
        let ramp = |sign: f64| {
            let (up, level) = ((A / J / PERIOD_S) as usize, ((v / A - A / J) / PERIOD_S) as usize);
            [vec![sign * J; up], vec![0.0; level], vec![-sign * J; up]].concat()
        };
        let jerks = [ramp(1.0), vec![0.0; 400], ramp(-1.0), vec![0.0; 5]].concat();
        let (mut s, mut velocity, mut acceleration) = (0.0, 0.0_f64, 0.0_f64);
        let mut out = Vec::new();
        for (k, jerk) in jerks.iter().enumerate() {
            let t = PERIOD_S;
            s += t * (velocity + t * (acceleration / 2.0 + t * jerk / 6.0));
            velocity += t * (acceleration + t * jerk / 2.0);
            acceleration += t * jerk;
            // Sums of equal steps: a remainder at rest is a rounding error.
            let clean = |x: f64| if x.abs() < 1e-6 { 0.0 } else { x };
            (velocity, acceleration) = (clean(velocity), clean(acceleration));
            let x = |x: f64| Axes::from_fn(|i, _| if i == 0 { x } else { 0.0 });
            out.push(Setpoint {
                sequence: first + k as u64,
                position: x(s),
                velocity: x(velocity),
                acceleration: x(acceleration),
                jerk: x(*jerk),
                path_mm: s,
                feed_mm_s: velocity,
                feed_override: 1.0,
                line: 7,
                block: 0,
                state: MotionState::Running,
                flags: 0,
                actions: 0,
            });
        }
        out
    }

    /// Shortest path and time to rest along X from a speed and an acceleration, in steps of 5 us: at the jerk
    /// limit down to `-A`, and back to zero just when the speed is used up.
    fn least_stop(mut v: f64, mut a: f64) -> (f64, f64) {
        const STEP_S: f64 = 5e-6;
        let (mut path, mut seconds) = (0.0, 0.0);
        while v > 0.0 {
            let leaves_brake = a < 0.0 && v <= a * a / (2.0 * J);
            let jerk = if leaves_brake { J } else { -J };
            a = (a + STEP_S * jerk).max(-A);
            if leaves_brake && a >= 0.0 {
                break;
            }
            v += STEP_S * a;
            path += STEP_S * v;
            seconds += STEP_S;
        }
        (path, seconds)
    }

    /// The longest of the holds 10 ms apart is at most the longest at any moment, and at least the longest of
    /// such holds at the most unfavourable times. Reports have 20 % and 1 ms added at 1 kHz; the stop itself
    /// may take 3 % and two steps more.
    fn expect(found: LongestStop, v: f64) {
        let stops: Vec<(f64, f64)> = (line(v, 0).iter())
            .map(|setpoint| least_stop(setpoint.velocity[0], setpoint.acceleration[0]))
            .collect();
        let longest = |begin: usize, step: usize| {
            let holds = stops.iter().skip(begin).step_by(step);
            holds.fold((0.0_f64, 0.0_f64), |(path, seconds), stop| {
                (path.max(stop.0), seconds.max(stop.1))
            })
        };
        let most = longest(0, 1);
        let least = (0..10)
            .map(|begin| longest(begin, 10).0)
            .fold(f64::INFINITY, f64::min);
        let range = 1.2 * least..=1.2 * (1.03 * most.0 + 0.002 * v) + 0.001 * v;
        assert!(range.contains(&found.path_mm), "{found:?} of {range:?}");
        assert!(
            (0.9 * most.1..1.03 * most.1 + 0.002).contains(&found.duration_s),
            "{found:?} of {}",
            most.1
        );
        assert_eq!(found.line, 7);
    }

    #[test]
    fn longest_stop_is_per_job_without_gaps() {
        let mut follower = Follower::new(limits(), PERIOD_S);
        let (fast, slow) = (line(200.0, 0), line(120.0, 10_000));
        fast.iter().for_each(|setpoint| follower.push(1, setpoint));
        expect(follower.longest.stop, 200.0);
        // Slower motion of the same job changes nothing; another job starts again.
        slow.iter().for_each(|setpoint| follower.push(1, setpoint));
        expect(follower.longest.stop, 200.0);
        slow.iter().for_each(|setpoint| follower.push(2, setpoint));
        expect(follower.longest.stop, 120.0);
        // Motion before and after lost setpoints is not joined. The hold above is not over by then, but
        // others are: at least those from the cruise, in v/A + A/J and half of the path of that time.
        let gap = fast
            .iter()
            .filter(|setpoint| !(250..300).contains(&setpoint.sequence));
        gap.for_each(|setpoint| follower.push(3, setpoint));
        let path = follower.longest.stop.path_mm;
        assert!((16.8..25.0).contains(&path), "{path}");
    }

    #[test]
    fn the_status_has_the_stop_of_its_job() {
        let (driven, queue) = RingBuffer::new(MIN_QUEUE);
        let (to_publisher, found) = RingBuffer::new(FOUND);
        let follower = Follower::new(limits(), PERIOD_S);
        let thread = thread::spawn(move || follower.run(queue, to_publisher));
        let mut watch = StopWatch {
            driven,
            found,
            newest: JobStop::default(),
            moved: false,
        };
        let mut status = Status {
            job: 4,
            ..Status::default()
        };
        for setpoint in line(200.0, 0) {
            watch.follow(&DueSetpoint {
                setpoint,
                corrected: None,
                due_time_ns: 0,
                drive: crate::due_setpoint::DriveRequest::ON,
                job: 4,
                spindle_overrides: [1.0; SPINDLES],
                override_off_mask: 0,
                is_of_program: true,
            });
        }
        let begun = Instant::now();
        // The stops from the start of the motion are known first.
        while status.longest_stop_mm < 25.0 && begun.elapsed() < Duration::from_secs(20) {
            watch.fill(&mut status, 2);
            thread::sleep(POLL_INTERVAL);
        }
        let stop = LongestStop {
            path_mm: status.longest_stop_mm,
            duration_s: status.longest_stop_s,
            line: status.longest_stop_line + 2,
            sequence: 0,
        };
        expect(stop, 200.0);
        status.job = 5;
        watch.fill(&mut status, 0);
        assert_eq!((status.longest_stop_mm, status.longest_stop_line), (0.0, 0));
        drop(watch);
        assert!(thread.join().is_ok());
    }
}
