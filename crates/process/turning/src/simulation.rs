//! The controller against the simulated workpiece, in closed loop.

use crate::controller::{TurningController, TurningInputs, TurningOutput};
use crate::fixed::FixedPasses;
use crate::sensor::{Sensor, SensorFault, SensorModel};
use crate::settings::{SettingsError, TurningSettings};
use crate::state::{Reason, Transition, TurningState};
use crate::workpiece::{CutState, Workpiece};
use crate::{Blank, CutLaw};

/// Maximum number of times that a feed is lowered to keep a load.
const MAX_TRIES: u32 = 6;
/// Permitted excess of a load over the set one, as a fraction: cells of the stock have a finite width.
const PEAK_NOISE: f64 = 0.02;

/// Figures of a simulated job.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Passes begun.
    pub passes: u32,
    /// From the start to the return of the tool, s.
    pub time_s: f64,
    /// Time of it at the feed without contact, s.
    pub air_s: f64,
    /// Time of it for return moves, s.
    pub return_s: f64,
    /// Number of times that the tool backed off.
    pub back_offs: u32,
    /// Largest true load.
    pub peak: f64,
    /// Time for which the true load was above 1.2 times the set one, s.
    pub over_120_s: f64,
    /// Longest unbroken time for which it was above 1.3 times, s.
    pub over_130_s: f64,
    /// Maximum remaining stock, mm.
    pub residual_mm: f64,
    /// Deepest cut below the final size, mm.
    pub undercut_mm: f64,
    /// Stock has hit the holder.
    pub hit_holder: bool,
    /// The job ended at size.
    pub done: bool,
}

/// A closed loop of controller, workpiece and sensor.
#[derive(Clone, Debug)]
pub struct Simulation {
    /// The controller.
    pub controller: TurningController,
    /// The workpiece.
    pub piece: Workpiece,
    /// The sensor.
    pub sensor: Sensor,
    /// Measured figures.
    pub figures: Figures,
    set_load: f64,
    period_s: f64,
    above: f64,
    /// Next load for the sensor.
    reading: f64,
}

impl Simulation {
    /// A job on a blank under the true law, which may differ from the law of the controller.
    ///
    /// # Errors
    /// Invalid settings.
    pub fn new(
        settings: TurningSettings,
        blank: Blank,
        law: CutLaw,
        sensor: SensorModel,
    ) -> Result<Self, SettingsError> {
        let controller = TurningController::new(settings)?;
        let steps = settings.turn_s() / settings.period_s;
        Ok(Self {
            controller,
            piece: Workpiece::of_cut(blank, &settings, law, steps),
            sensor: Sensor::new(sensor, settings.period_s),
            figures: Figures::default(),
            set_load: settings.regime.set_load,
            period_s: settings.period_s,
            above: 0.0,
            reading: settings.scale.idle,
        })
    }

    /// Advances by one control period: the sensor reads the load of the last one, or `fault`.
    pub fn step(
        &mut self,
        mut inputs: TurningInputs,
        fault: Option<SensorFault>,
    ) -> (TurningOutput, CutState) {
        inputs.load = self.sensor.read(self.reading, fault);
        let output = self.controller.step(&inputs);
        let cut = self.piece.step(output.along.position, output.out.position);
        let scale = self.controller.settings().scale;
        self.reading = scale.reading(
            cut.load,
            [output.along.position, output.out.position],
            cut.depth_mm,
        );
        self.figures
            .see(&output, &cut, self.set_load, self.period_s, &mut self.above);
        (output, cut)
    }

    /// Replaces the true load at the next reading, for a jam or a broken insert.
    pub fn jam(&mut self, load: f64) {
        self.reading = self.controller.settings().scale.reading(load, [0.0; 2], 0.0);
    }

    /// Runs to the end, or for at most `max_s` seconds; calls `observe` in every period.
    pub fn run(
        &mut self,
        max_s: f64,
        mut observe: impl FnMut(&TurningOutput, &CutState),
    ) -> (Figures, Option<Reason>) {
        let mut last = None;
        while self.figures.time_s < max_s {
            let (output, cut) = self.step(TurningInputs::default(), None);
            observe(&output, &cut);
            if let Some(transition) = output.transition {
                last = Some(transition.reason);
            }
            if self.controller.is_over() {
                break;
            }
        }
        self.figures.done = self.controller.state() == TurningState::Done;
        self.figures.residual_mm = self.piece.residual_mm();
        self.figures.undercut_mm = self.piece.undercut_mm();
        (self.figures, last)
    }
}

impl Figures {
    /// Counts one period of a load-adaptive job. `above` is kept between calls: the time for which the load
    /// has been above 1.3 times the set one.
    pub fn see(
        &mut self,
        output: &TurningOutput,
        cut: &CutState,
        set_load: f64,
        period_s: f64,
        above: &mut f64,
    ) {
        self.count(cut, set_load, period_s, above);
        self.passes = output.pass;
        match output.state {
            TurningState::Return | TurningState::ReEnter => self.return_s += period_s,
            TurningState::Approach | TurningState::Engage | TurningState::Cut | TurningState::Climb
                if cut.load == 0.0 =>
            {
                self.air_s += period_s;
            }
            _ => {}
        }
        if let Some(Transition {
            to: TurningState::BackOff,
            ..
        }) = output.transition
        {
            self.back_offs += 1;
        }
    }

    /// Counts one period of a job: its time and its loads. `above` is the time for which the load has been
    /// above 1.3 times the set one.
    fn count(&mut self, cut: &CutState, set_load: f64, period_s: f64, above: &mut f64) {
        self.time_s += period_s;
        self.peak = self.peak.max(cut.load);
        if cut.load > 1.2 * set_load {
            self.over_120_s += period_s;
        }
        *above = if cut.load > 1.3 * set_load {
            *above + period_s
        } else {
            0.0
        };
        self.over_130_s = self.over_130_s.max(*above);
        self.hit_holder |= cut.hits_holder;
    }
}

/// Turns the same workpiece in fixed passes.
#[must_use]
pub fn run_fixed(mut passes: FixedPasses, mut piece: Workpiece, set_load: f64) -> Figures {
    let (mut figures, mut above) = (Figures::default(), 0.0);
    let period = passes.period_s();
    while let Some((along, out, feeds)) = passes.step() {
        let cut = piece.step(along, out);
        figures.count(&cut, set_load, period, &mut above);
        if feeds && cut.load == 0.0 {
            figures.air_s += period;
        }
    }
    figures.passes = passes.passes();
    figures.residual_mm = piece.residual_mm();
    figures.undercut_mm = piece.undercut_mm();
    figures.done = true;
    figures
}

/// Fixed passes on a blank whose largest load is `set_load`, for a comparison at the same load: at
/// `feed_mm_rev` and `depth_mm` if these keep it, otherwise at a lower feed. They begin at the maximum height
/// of the stock, including its run-out. With the nominal depth and feed, a hard spot or a run-out would
/// overload the passes, and they would only seem faster.
///
/// If even the smallest feed exceeds the load, the passes are also shallower.
#[must_use]
pub fn run_fixed_at_load(
    settings: &TurningSettings,
    blank: &Blank,
    law: CutLaw,
    (depth_mm, feed_mm_rev): (f64, f64),
    set_load: f64,
) -> Figures {
    let height = blank.highest_mm(settings.length_mm + settings.shoulder_mm()) + blank.runout_mm;
    let steps = settings.turn_s() / settings.period_s;
    let min = settings.regime.feed_min_mm_rev;
    let (mut depth, mut feed) = (depth_mm, feed_mm_rev);
    let mut figures = Figures::default();
    for _ in 0..MAX_TRIES {
        let piece = Workpiece::of_cut(blank.clone(), settings, law, steps);
        figures = run_fixed(FixedPasses::new(settings, height, depth, feed), piece, set_load);
        let over = figures.peak / set_load;
        if over <= 1.0 + PEAK_NOISE {
            break;
        }
        let slower = feed * libm::pow(over, -1.0 / law.feed_exponent);
        if slower < min {
            depth *= libm::pow(slower / min, law.feed_exponent / law.depth_exponent);
        }
        feed = slower.max(min);
    }
    figures
}
