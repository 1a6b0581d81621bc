//! The job on its simulated stock, under the machine's limits and guard, and fixed passes beside it.

use evolvent_machine::{Limits, Machine};
use evolvent_motion::Guard;
use evolvent_path::{Axes, AxisLetter};
use evolvent_process::{
    Blank, CutKind, Figures, FixedPasses, Job, ScalarLimits, Simulation, Transition, TurningInputs,
    TurningOutput, TurningState, Workpiece, run_fixed,
};

use crate::CommandError;

/// Longest simulated job, s.
const MOST_S: f64 = 20_000.0;
/// Samples of the report, one in so many seconds.
const SAMPLE_S: f64 = 0.01;

/// One instant of the report.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub(crate) time_s: f64,
    pub(crate) along_mm: f64,
    pub(crate) out_mm: f64,
    pub(crate) feed_mm_rev: f64,
    /// Largest true load since the sample before.
    pub(crate) load: f64,
    pub(crate) feeds: bool,
    pub(crate) pass: u32,
}

/// A straight part of the tool's way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretch {
    pub(crate) to_along_mm: f64,
    pub(crate) to_out_mm: f64,
    /// Revolutions that it takes; none in rapid.
    pub(crate) turns: Option<f64>,
}

/// What came out.
pub(crate) struct Trial {
    pub(crate) job: Job,
    pub(crate) blank: Blank,
    pub(crate) highest_mm: f64,
    pub(crate) figures: Figures,
    pub(crate) changes: Vec<Transition>,
    pub(crate) samples: Vec<Sample>,
    pub(crate) stretches: Vec<Stretch>,
    pub(crate) start: (f64, f64),
    pub(crate) fixed: Vec<(&'static str, Figures)>,
    pub(crate) notes: Vec<String>,
}

impl Trial {
    pub(crate) fn run(mut job: Job, machine: &Machine) -> Result<Self, CommandError> {
        let usage = |text: String| CommandError::Usage(text);
        let Some(blank) = job.blank.clone() else {
            return Err(usage(
                "the job has no [stock]: a trial needs one; on a machine the load sensor takes its place"
                    .into(),
            ));
        };
        let limits = machine.limits();
        let (along, out) = match job.cut.kind {
            CutKind::Longitudinal => (AxisLetter::Z, AxisLetter::X),
            CutKind::Facing => (AxisLetter::X, AxisLetter::Z),
        };
        if !limits.present[along.index()] || !limits.present[out.index()] {
            return Err(usage(format!("{}: turning needs the axes X and Z", machine.name)));
        }
        let of = |axis: AxisLetter| ScalarLimits {
            velocity: limits.velocity[axis.index()],
            acceleration: limits.acceleration[axis.index()],
            jerk: limits.jerk[axis.index()],
        };
        let settings = &mut job.settings;
        (settings.along_limits, settings.out_limits) = (of(along), of(out));
        settings.rapid_mm_s = settings.along_limits.velocity;
        settings.out_speed_mm_s = settings.out_limits.velocity;
        let period_ns = machine
            .period_ns(machine.rate)
            .map_err(|error| usage(error.to_string()))?;
        settings.period_s = period_ns as f64 * 1e-9;
        let settings = *settings;
        let mut simulation = Simulation::new(settings, blank.clone(), settings.regime.law, job.sensor)
            .map_err(|error| usage(error.to_string()))?;
        let mut trial = Self {
            highest_mm: blank.highest_mm(settings.length_mm),
            blank,
            figures: Figures::default(),
            changes: Vec::new(),
            samples: Vec::new(),
            stretches: Vec::new(),
            start: (0.0, 0.0),
            fixed: Vec::new(),
            notes: Vec::new(),
            job,
        };
        trial.drive(&mut simulation, &limits)?;
        trial.compare();
        trial.note(machine);
        Ok(trial)
    }

    fn drive(&mut self, simulation: &mut Simulation, limits: &Limits) -> Result<(), CommandError> {
        let settings = self.job.settings;
        let cut = self.job.cut;
        let place = |output: &TurningOutput| {
            let (x, z) = cut.position_mm(output.along.position, output.out.position);
            let mut axes: Axes = limits.home;
            (axes[AxisLetter::X.index()], axes[AxisLetter::Z.index()]) = (x, z);
            axes
        };
        let mut guard: Option<Guard> = None;
        let every = (SAMPLE_S / settings.period_s).round().max(1.0) as u64;
        let (mut cycle, mut peak, mut writer) = (0_u64, 0.0, StretchWriter::default());
        while simulation.figures.time_s < MOST_S {
            let (output, now) = simulation.step(TurningInputs::default(), None);
            let position = place(&output);
            let guard = guard.get_or_insert_with(|| {
                self.start = (output.along.position, output.out.position);
                Guard::new(*limits, settings.period_s, position)
            });
            guard.check(&position, false, false).map_err(|violation| {
                CommandError::Failed(format!(
                    "at {:.3} s: {violation}; see whether the cut lies in the machine's travel",
                    simulation.figures.time_s
                ))
            })?;
            guard.publish(&position, false);
            peak = f64::max(peak, now.load);
            let feeds = matches!(
                output.state,
                TurningState::Approach | TurningState::Engage | TurningState::Cut
            );
            if let Some(change) = output.transition {
                self.changes.push(change);
            }
            writer.see(&output, feeds, &settings, &mut self.stretches);
            if cycle.is_multiple_of(every) {
                self.samples.push(Sample {
                    time_s: simulation.figures.time_s,
                    along_mm: output.along.position,
                    out_mm: output.out.position,
                    feed_mm_rev: output.along.velocity * settings.turn_s(),
                    load: peak,
                    feeds,
                    pass: output.pass,
                });
                peak = 0.0;
            }
            cycle += 1;
            if simulation.controller.is_over() {
                break;
            }
        }
        writer.finish(&mut self.stretches);
        self.figures = simulation.run(0.0, |_, _| {}).0;
        Ok(())
    }

    /// Fixed passes on the same stock.
    fn compare(&mut self) {
        let (settings, regime) = (self.job.settings, self.job.settings.regime);
        let height = self.highest_mm;
        if height <= 0.0 {
            return;
        }
        let balanced = evolvent_process::Regime::new(
            &evolvent_process::RegimeInput {
                law: regime.law,
                set_load: regime.set_load,
                permitted_load: regime.set_load,
                feed_min_mm_rev: regime.feed_min_mm_rev,
                feed_max_mm_rev: regime.feed_max_mm_rev,
                back_off: evolvent_process::BackOff::Balanced,
            },
            &settings.tool,
        )
        .unwrap_or(regime);
        let run = |depth: f64, feed: f64| {
            let steps = settings.turn_s() / settings.period_s;
            let piece = Workpiece::new(
                self.blank.clone(),
                settings.length_mm,
                regime.law,
                settings.tool,
                steps,
            );
            run_fixed(
                FixedPasses::new(&settings, height, depth, feed),
                piece,
                regime.set_load,
            )
        };
        let (depth, feed) = (balanced.depth_back_off_mm, balanced.feed_back_off_mm_rev);
        let known = (1..=12)
            .map(|passes| height / f64::from(passes))
            .filter(|depth| *depth <= regime.depth_max_mm)
            .map(|depth| run(depth, regime.feed_mm_rev(depth)))
            .min_by(|a, b| a.time_s.total_cmp(&b.time_s));
        let same = run(depth, feed);
        let slow = run(depth, 0.7 * feed);
        self.fixed.push(("stock not known, same load", same));
        self.fixed
            .extend(known.map(|figures| ("stock known exactly", figures)));
        self.fixed.push(("stock not known, 70 % of the feed", slow));
    }

    fn note(&mut self, machine: &Machine) {
        self.notes.push(format!(
            "workpiece and sensor are simulated: a height field cut with a lag of one revolution, a sensor with {:.0} ms \
             of lag and {:.1} % of noise; the force law is taken to hold exactly",
            1e3 * self.job.sensor.lag_s,
            100.0 * self.job.sensor.noise
        ));
        if self.job.law_misfit > 0.0 {
            self.notes.push(format!(
                "the controller uses a power law that differs from the force law by up to {:.1} % over these feeds",
                100.0 * self.job.law_misfit
            ));
        }
        if !self.blank.is_round() {
            self.notes
                .push("the stock is not round: its deepest part is what is held at the set load".into());
        }
        if machine.kind != evolvent_machine::MachineKind::Lathe {
            self.notes.push(format!(
                "{} is not a lathe; X is taken as the radius",
                machine.name
            ));
        }
    }

    /// In a word.
    pub(crate) fn outcome(&self) -> String {
        if self.figures.done {
            return "done".into();
        }
        let last = self.changes.last();
        format!(
            "stopped: {}",
            last.map_or("it took too long".into(), |change| change.reason.text())
        )
    }
}

/// Makes straight stretches of the cycles.
#[derive(Default)]
struct StretchWriter {
    kind: Option<(u8, bool, bool)>,
    at: (f64, f64),
    from: (f64, f64),
    turns: f64,
    feed: f64,
}

impl StretchWriter {
    fn see(
        &mut self,
        output: &TurningOutput,
        feeds: bool,
        settings: &evolvent_process::TurningSettings,
        stretches: &mut Vec<Stretch>,
    ) {
        let (v, w) = (output.along.velocity, output.out.velocity);
        let axis = u8::from(v != 0.0) + 2 * u8::from(w != 0.0);
        let here = (output.along.position, output.out.position);
        let rapid = !feeds || v > 2.0 * settings.speed_mm_s(settings.regime.feed_max_mm_rev);
        let kind = (axis, rapid, v + w > 0.0);
        let feed = v * settings.turn_s();
        let changed = self.kind != Some(kind) && axis != 0;
        let drifted = !rapid && (feed - self.feed).abs() > 0.1 * self.feed;
        if changed || drifted {
            self.finish(stretches);
            (self.kind, self.from, self.turns, self.feed) = (Some(kind), self.at, 0.0, feed);
        }
        if axis != 0 {
            self.turns += settings.period_s / settings.turn_s();
            self.at = here;
        } else if self.kind.is_none() {
            self.at = here;
        }
    }

    fn finish(&mut self, stretches: &mut Vec<Stretch>) {
        let Some((_, rapid, _)) = self.kind.take() else {
            return;
        };
        let length = (self.at.0 - self.from.0).abs() + (self.at.1 - self.from.1).abs();
        if length < 1e-6 {
            return;
        }
        stretches.push(Stretch {
            to_along_mm: self.at.0,
            to_out_mm: self.at.1,
            turns: (!rapid && self.turns > 0.0).then_some(self.turns),
        });
    }
}
