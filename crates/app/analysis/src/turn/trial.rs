//! The job run as a program of one cycle, as in any run, compared with fixed passes.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use evolvent_machine::MachineKind;
use evolvent_path::AxisLetter;
use evolvent_runtime::{Clock, Controls, Job as Run, Notice, RunObserver, RunOutcome, Setup, run_observed};
use evolvent_turning::{
    Blank, CutKind, CutState, Figures, ScalarLimits, Transition, TurningJob, TurningOutput, TurningSettings,
    TurningState, run_fixed_at_load,
};

use super::passes::cycle_program;
use crate::error::AnalysisError;
use crate::load_setup::load_setup;
use crate::process::install_process;
use crate::scratch::Folder;

/// Interval between samples of the report, s.
const SAMPLE_S: f64 = 0.01;

/// One sample of the report.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    pub(crate) time_s: f64,
    pub(crate) along_mm: f64,
    pub(crate) out_mm: f64,
    pub(crate) feed_mm_rev: f64,
    /// Maximum true load since the previous sample.
    pub(crate) load: f64,
    pub(crate) feeds: bool,
    pub(crate) pass: u32,
}

/// A straight section of the tool path.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretch {
    pub(crate) to_along_mm: f64,
    pub(crate) to_out_mm: f64,
    /// Revolutions during the section; `None` in rapid.
    pub(crate) turns: Option<f64>,
    /// On a cone: both axes move.
    pub(crate) climbs: bool,
}

/// The result of a job tried on its stock.
pub struct TurningTrial {
    pub(crate) job: TurningJob,
    pub(crate) blank: Blank,
    pub(crate) highest_mm: f64,
    pub(crate) figures: Figures,
    pub(crate) changes: Vec<Transition>,
    pub(crate) samples: Vec<Sample>,
    pub(crate) stretches: Vec<Stretch>,
    pub(crate) start: (f64, f64),
    pub(crate) fixed: Vec<(&'static str, Figures)>,
    pub(crate) notes: Vec<String>,
    /// The machine's name.
    pub(crate) machine: String,
    /// Whether the stock and the load are simulated.
    pub(crate) is_simulated: bool,
    /// Why the run was stopped.
    pub(crate) fault: Option<String>,
    /// Why the trace is incomplete.
    trace_error: Option<String>,
    /// Setpoints were late or lost while a reader was connected, or records were lost.
    has_lost: bool,
}

/// How a trial is run.
pub struct TurningRoute<'a> {
    /// Virtual clock with the stock of the job, or real time with the load on the bus.
    pub clock: Clock,
    /// File in which every cycle is recorded.
    pub trace: Option<PathBuf>,
    /// Whether setpoints are published.
    pub bus: bool,
    /// Prefix of the bus files.
    pub bus_prefix: Option<&'a str>,
    /// Called before a run in real time starts; receives the controls that can stop it.
    pub on_start: &'a dyn Fn(&Arc<Controls>) -> Result<(), AnalysisError>,
}

impl TurningTrial {
    /// Runs the job as a program of one turning cycle, as `evolvent run` does.
    ///
    /// # Errors
    /// A machine that is not a lathe, a job that does not suit it, or a run that cannot start.
    pub fn run(mut job: TurningJob, machine: &Path, route: &TurningRoute<'_>) -> Result<Self, AnalysisError> {
        let usage = |text: String| AnalysisError::Input(text);
        let mut setup = load_setup(machine, None)?;
        let limits = setup.machine.limits();
        let (along, out) = match job.cut.kind {
            CutKind::Longitudinal => (AxisLetter::Z, AxisLetter::X),
            CutKind::Facing => (AxisLetter::X, AxisLetter::Z),
        };
        if setup.machine.kind != MachineKind::Lathe
            || !limits.present[along.index()]
            || !limits.present[out.index()]
        {
            return Err(usage(format!(
                "{}: turning needs a lathe with the axes X and Z",
                setup.machine.name
            )));
        }
        let of = |axis: AxisLetter| ScalarLimits {
            velocity: limits.velocity[axis.index()],
            acceleration: limits.acceleration[axis.index()],
            jerk: limits.jerk[axis.index()],
        };
        job.drive_with(of(along), of(out), setup.period_ns as f64 * 1e-9);
        job.settings.check().map_err(|error| usage(error.to_string()))?;
        install_process(&mut setup, job.clone(), &job.name, route.clock)?;
        let blank = job.blank.clone();
        let mut trial = Self {
            highest_mm: blank.as_ref().map_or(0.0, |blank| {
                blank.highest_mm(job.settings.length_mm + job.settings.shoulder_mm())
            }),
            machine: setup.machine.name.clone(),
            is_simulated: route.clock == Clock::Virtual,
            blank: blank.unwrap_or_else(|| Blank::uniform(0.0)),
            figures: Figures::default(),
            changes: Vec::new(),
            samples: Vec::new(),
            stretches: Vec::new(),
            start: (0.0, 0.0),
            fixed: Vec::new(),
            notes: Vec::new(),
            fault: None,
            trace_error: None,
            has_lost: false,
            job,
        };
        trial.drive(setup, route)?;
        if trial.is_simulated {
            trial.compare();
        }
        trial.note();
        Ok(trial)
    }

    fn drive(&mut self, setup: Setup, route: &TurningRoute<'_>) -> Result<(), AnalysisError> {
        let failed = |error: &dyn std::fmt::Display| AnalysisError::Failed(error.to_string());
        let folder = Folder::new("evolvent-turn").map_err(|error| failed(&error))?;
        let program = folder.path().join("turn.ngc");
        let text = cycle_program(&self.job, setup.machine.program.turning_cycles);
        std::fs::write(&program, text).map_err(|error| failed(&error))?;
        // The temporary file no longer exists when the user reads the message.
        let file = program.display().to_string();
        let cycle = format!("the cycle of {}", self.job.name);
        let of_cycle = |text: String| text.replace(&file, &cycle);
        let controls = Arc::new(Controls::new(1.0));
        if route.clock == Clock::Realtime {
            (route.on_start)(&controls)?;
        }
        let mut recorder = CycleRecorder::new(self.job.settings);
        let mut notes = std::mem::take(&mut self.notes);
        let job = run_of(program, setup, route);
        let outcome = run_observed(&job, &controls, &mut Silent(&mut notes), |observed| {
            if let Some(output) = observed.turning {
                recorder.see(output, observed.cut, self);
            }
        });
        self.notes = notes;
        let outcome = outcome.map_err(|error| AnalysisError::Failed(of_cycle(error.to_string())))?;
        recorder.writer.finish(&mut self.stretches);
        self.take_outcome(outcome, recorder.is_done, &of_cycle)
    }

    fn take_outcome(
        &mut self,
        outcome: RunOutcome,
        is_done: bool,
        of_cycle: &impl Fn(String) -> String,
    ) -> Result<(), AnalysisError> {
        outcome
            .program
            .map_err(|error| AnalysisError::Input(of_cycle(error.to_string())))?;
        self.figures.done = is_done && outcome.fault.is_none();
        self.fault = outcome.fault.map(of_cycle);
        if let Some(process) = outcome.process {
            self.figures.residual_mm = process.workpiece().residual_mm();
            self.figures.undercut_mm = process.workpiece().undercut_mm();
        }
        self.has_lost = outcome.summary.is_lossy();
        if self.has_lost {
            let summary = &outcome.summary;
            self.notes.push(format!(
                "late setpoints {}, lost setpoints {}, lost records {}",
                summary.late_cycles, summary.dropped_setpoints, summary.dropped_records
            ));
        }
        self.trace_error = outcome.trace_error.map(|error| error.to_string());
        for note in &mut self.notes {
            *note = of_cycle(std::mem::take(note));
        }
        // The error is reported separately with its position, so it is not a note.
        self.notes.retain(|note| Some(note) != self.trace_error.as_ref());
        if let Some(trace) = outcome.summary.trace {
            self.notes.push(format!("trace {trace}"));
        }
        Ok(())
    }

    /// Fixed passes on the same stock.
    fn compare(&mut self) {
        let (settings, regime) = (self.job.settings, self.job.settings.regime);
        let height = self.highest_mm;
        if height <= 0.0 {
            return;
        }
        let balanced = evolvent_turning::Regime::new(
            &evolvent_turning::RegimeInput {
                law: regime.law,
                set_load: regime.set_load,
                permitted_load: regime.set_load,
                feed_min_mm_rev: regime.feed_min_mm_rev,
                feed_max_mm_rev: regime.feed_max_mm_rev,
                back_off: evolvent_turning::BackOff::Balanced,
            },
            &settings.tool,
        )
        .unwrap_or(regime);
        // On stock that is out of round or has hard sections, the nominal feed would overload.
        let run = |depth: f64, feed: f64| {
            let cut = (depth, feed);
            run_fixed_at_load(&settings, &self.blank, regime.law, cut, regime.set_load)
        };
        let height = height + self.blank.runout_mm;
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

    fn note(&mut self) {
        if self.is_simulated {
            self.notes.push(format!(
            "workpiece and sensor are simulated: a height field cut with a lag of one revolution, a sensor \
             with {:.0} ms \
             of lag and {:.1} % of noise; the force law is taken to hold exactly",
            1e3 * self.job.sensor.lag_s,
            100.0 * self.job.sensor.noise
        ));
        } else {
            self.notes
                .push("loads are those of the sensor; the stock left standing is not measured".into());
        }
        if self.job.law_misfit > 0.0 {
            self.notes.push(format!(
                "the controller uses a power law that differs from the force law by up to {:.1} % over \
                 these feeds",
                100.0 * self.job.law_misfit
            ));
        }
        self.notes.extend(steep_entry(&self.job.settings));
        if self.is_simulated && !self.blank.is_round() {
            self.notes
                .push("the stock is not round: its deepest part is what is held at the set load".into());
        }
    }

    /// Notes for the user.
    #[must_use]
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Why the trace is incomplete; the job continued nevertheless.
    #[must_use]
    pub fn trace_error(&self) -> Option<&str> {
        self.trace_error.as_deref()
    }

    /// Whether the trace is incomplete, or setpoints were late or lost.
    #[must_use]
    pub fn is_lossy(&self) -> bool {
        self.trace_error.is_some() || self.has_lost
    }

    /// Whether the job was completed: without fault, up to its last pass.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.figures.done
    }

    /// The computed passes as a part program for this stock; `None` if the job was not completed, since its
    /// last pass would end in the middle.
    #[must_use]
    pub fn program(&self) -> Option<String> {
        self.is_done().then(|| super::passes::program(self))
    }

    /// Passes, feed and load, and the comparison with fixed passes as one SVG.
    #[must_use]
    pub fn svg(&self) -> String {
        super::report::svg(self, &self.machine)
    }

    /// The same as a page with the figures.
    #[must_use]
    pub fn html(&self) -> String {
        super::report::html(self, &self.machine, &self.svg())
    }

    /// The outcome in a word.
    #[must_use]
    pub fn outcome(&self) -> String {
        if self.figures.done {
            return "done".into();
        }
        let why = self.fault.clone();
        format!("stopped: {}", why.unwrap_or_else(|| "before it was done".into()))
    }
}

/// Warns if a revolution at the entry feed adds so much depth that the load exceeds its limit before a sensor
/// can report it.
fn steep_entry(settings: &TurningSettings) -> Option<String> {
    /// Above this fraction of the deepest cut; measured on the worked example, docs/theory-turning.md.
    const MAX_FRACTION: f64 = 0.5;
    let regime = &settings.regime;
    let added_mm = regime.feed_back_off_mm_rev * settings.tool.slope();
    let fraction = added_mm / regime.depth_max_mm;
    (fraction > MAX_FRACTION).then(|| {
        format!(
            "a revolution at the entry feed adds {added_mm:.3} mm of depth, {:.0} % of the deepest cut: the \
             load may exceed 1.3 times the set load, and more passes than planned may be needed; raise the \
             set load, or reduce the feeds or the lead angle",
            100.0 * fraction
        )
    })
}

/// The run of a program on a route, without an operator.
fn run_of(program: PathBuf, setup: Setup, route: &TurningRoute<'_>) -> Run {
    Run {
        program,
        setup,
        clock: route.clock,
        feed_override: 1.0,
        trace: route.trace.clone(),
        bus: route.bus,
        bus_prefix: route.bus_prefix.map(str::to_owned),
        wait_for_subscribers: 0,
        own_subscribers: 0,
        inputs: None,
        optional_stop: false,
        stop_at_program_stops: false,
    }
}

/// Collects figures, samples and stretches of the cycles of a trial.
struct CycleRecorder {
    settings: TurningSettings,
    /// Cycles so far, and those between two samples.
    cycle: u64,
    every: u64,
    /// Maximum load since the last sample.
    peak: f64,
    /// For [`Figures::see`].
    above: f64,
    writer: StretchWriter,
    is_done: bool,
}

impl CycleRecorder {
    fn new(settings: TurningSettings) -> Self {
        Self {
            settings,
            cycle: 0,
            every: (SAMPLE_S / settings.period_s).round().max(1.0) as u64,
            peak: 0.0,
            above: 0.0,
            writer: StretchWriter::default(),
            is_done: false,
        }
    }

    /// Records a cycle; `cut` is that of simulated stock.
    fn see(&mut self, output: &TurningOutput, cut: Option<CutState>, trial: &mut TurningTrial) {
        let settings = &self.settings;
        // Without simulated stock, the load is the measured one.
        let now = cut.unwrap_or(CutState {
            load: output.load,
            ..CutState::default()
        });
        trial.figures.see(
            output,
            &now,
            settings.regime.set_load,
            settings.period_s,
            &mut self.above,
        );
        let feeds = matches!(
            output.state,
            TurningState::Approach | TurningState::Engage | TurningState::Cut | TurningState::Climb
        );
        if let Some(change) = output.transition {
            trial.changes.push(change);
        }
        self.is_done = output.state == TurningState::Done;
        if self.cycle == 0 {
            trial.start = (output.along.position, output.out.position);
        }
        self.peak = f64::max(self.peak, now.load);
        self.writer.see(output, feeds, settings, &mut trial.stretches);
        if self.cycle.is_multiple_of(self.every) {
            trial.samples.push(Sample {
                time_s: trial.figures.time_s,
                along_mm: output.along.position,
                out_mm: output.out.position,
                feed_mm_rev: output.along.velocity * settings.turn_s(),
                load: self.peak,
                feeds,
                pass: output.pass,
            });
            self.peak = 0.0;
        }
        self.cycle += 1;
    }
}

/// Collects the notes for the user.
struct Silent<'a>(&'a mut Vec<String>);

impl RunObserver for Silent<'_> {
    fn progress(&mut self, _: &Controls) {}
    fn notice(&mut self, _: &Notice) {}
    fn note(&mut self, text: &str) {
        self.0.push(text.to_owned());
    }
}

/// Combines cycles into straight stretches.
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
        settings: &TurningSettings,
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
        let Some((axes, rapid, _)) = self.kind.take() else {
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
            climbs: !rapid && axes == 3,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::process::read_process;

    #[test]
    fn a_steep_entry_into_the_cut_is_noted() {
        let text = include_str!("../../../../../config/processes/turn-shaft.toml");
        let folder = tempfile::tempdir().unwrap();
        let note = |set_n: &str, lead_deg: &str| {
            let file = folder.path().join("job.toml");
            let text = text
                .replace("set_n = 2200.0", &format!("set_n = {set_n}"))
                .replace("lead_deg = 60.0", &format!("lead_deg = {lead_deg}"));
            std::fs::write(&file, text).unwrap();
            steep_entry(&read_process(&file).unwrap().settings)
        };
        assert_eq!(note("2200.0", "60.0"), None);
        assert_eq!(note("1500.0", "72.0"), None);
        // 0.3873 mm/rev at 72 degrees: 1.192 mm; the deepest cut is 1.140 mm.
        let text = note("500.0", "72.0").unwrap();
        assert!(text.contains("adds 1.192 mm of depth, 105 %"), "{text}");
    }
}
