//! Results of a run's cycle, and the figures computed from them.

use evolvent_control::Alarm;
use evolvent_motion::PathExecutor;
use evolvent_turning::{AdaptiveStop, SimulatedProcess};

use crate::core_loop::CycleCounts;
use crate::feeder::FeedReport;
use crate::job::Job;
use crate::program_cycle::{ProgramCycle, ProgramState, drive_alarm, turning_alarm};
use crate::summary::{Outcome, Summary, TimingSummary, axis_summaries};
use crate::turning_motion::turning_fault;

/// Results of the cycle's thread.
pub(crate) struct RunReport {
    pub counts: CycleCounts,
    pub now: ProgramState,
    pub motion: PathExecutor,
    /// The simulated workpiece after the run.
    pub process: Option<SimulatedProcess>,
}

impl RunReport {
    /// Drops everything else that the cycle had; the ends of its queues notify the other threads.
    pub(crate) fn of<F>(mut counts: CycleCounts, source: ProgramCycle<F>) -> Self {
        counts.dropped_records += source.signals.as_ref().map_or(0, |signals| signals.lost);
        Self {
            counts,
            now: source.now,
            motion: source.motion,
            process: source.process,
        }
    }

    /// The alarm that stopped the machine, if any.
    pub(crate) fn fault(&self) -> Option<(Alarm, String)> {
        let motion = &self.motion;
        if let Some(violation) = motion.fault() {
            let text = format!(
                "the guard rejected a setpoint: {violation}; the machine was stopped. This is a fault of the \
                 planner: please report it with the trace"
            );
            return Some((Alarm::Guard, text));
        }
        if self.now.planner_died {
            let text = "the planner ended without completing its plan; the machine stopped on the path";
            return Some((Alarm::Planner, text.to_owned()));
        }
        if let Some(alarm) = &self.now.drive_stop {
            let text = format!("{alarm}; the drives no longer followed, so the run was ended");
            return Some((drive_alarm(alarm), text));
        }
        if let Some(reason) = turning_fault(motion) {
            return Some((turning_alarm(&reason), reason.text()));
        }
        if let Some(stop) = &self.now.adaptive_stop {
            let alarm = match stop {
                AdaptiveStop::Sensor(_) => Alarm::LoadSensor,
                _ => Alarm::CuttingLoad,
            };
            return Some((alarm, stop.text()));
        }
        if self.now.estopped {
            return Some((
                Alarm::EmergencyStopChain,
                Alarm::EmergencyStopChain.sentence().to_owned(),
            ));
        }
        if let Some(spindle) = self.now.spindle_trouble {
            let text = format!("spindle {spindle}: {}", Alarm::Spindle.sentence());
            return Some((Alarm::Spindle, text));
        }
        if let Some(why) = self.now.not_begun {
            return Some((Alarm::LoadSensor, why.text()));
        }
        self.now.stopped_for_lateness.then(|| {
            let text = "too many consecutive setpoints were published late; the machine was stopped on the \
                        path. Run `evolvent doctor`, lower the rate, or raise realtime.max_late_cycles";
            (Alarm::Lateness, text.to_owned())
        })
    }

    /// The figures of the run, without trace and readers of the bus.
    pub(crate) fn summarise(&self, job: &Job, feed: &FeedReport, late: u64, notes: Vec<String>) -> Summary {
        let setup = &job.setup;
        let machine = &setup.machine;
        let extremes = self.motion.extremes();
        let per_axis = axis_summaries(machine, extremes);
        let position = self.now.last.map_or(machine.limits().home, |last| last.position);
        let list = |of: fn(&crate::summary::AxisSummary) -> f64| per_axis.iter().map(of).collect::<Vec<_>>();
        Summary {
            program: job.program.display().to_string(),
            machine: machine.name.clone(),
            clock: job.clock.name(),
            outcome: if self.now.stopped_for_lateness || self.now.planner_died {
                Outcome::Fault
            } else if self.now.program_failed {
                Outcome::Failed
            } else {
                Outcome::of(self.motion.state())
            },
            axes: machine.axes.iter().map(|axis| axis.letter.letter()).collect(),
            cycles: self.counts.cycles,
            rate_hz: setup.rate_hz(),
            period_ns: setup.period_ns,
            duration_s: self.counts.cycles as f64 * setup.period_ns as f64 * 1e-9,
            planned_duration_s: feed.planned_s,
            moves: feed.moves,
            path_length_mm: self.now.last.map_or(0.0, |last| last.path_mm),
            late_cycles: late,
            listeners: 0,
            dropped_records: self.counts.dropped_records,
            dropped_setpoints: self.counts.dropped_setpoints,
            starved_cycles: self.now.starved_cycles,
            max_chord_error_mm: extremes.chord_error_mm,
            permitted_chord_error_mm: machine.path.chord_error_increments / machine.increments_per_mm,
            max_path_error_mm: feed.deviation_mm,
            end_position: machine
                .axes
                .iter()
                .map(|axis| position[axis.letter.index()])
                .collect(),
            max_velocity_mm_s: list(|axis| axis.max_velocity_mm_s),
            max_acceleration_mm_s2: list(|axis| axis.max_acceleration_mm_s2),
            max_jerk_mm_s3: list(|axis| axis.max_jerk_mm_s3),
            velocity_ratio: list(|axis| axis.velocity_ratio),
            acceleration_ratio: list(|axis| axis.acceleration_ratio),
            jerk_ratio: list(|axis| axis.jerk_ratio),
            per_axis,
            wake_lateness: TimingSummary::of(&self.counts.lateness),
            work: TimingSummary::of(&self.counts.work),
            turning: self.now.turning.summary(),
            trace: None,
            alarm: None,
            error: None,
            notes,
        }
    }
}
