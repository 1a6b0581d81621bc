//! The simulated process for runs without metal: positions in, load out.

use evolvent_machine::LoadSample;

use crate::job::TurningJob;
use crate::job_file::CutFile;
use crate::scale::LoadScale;
use crate::sensor::Sensor;
use crate::workpiece::{CutState, Workpiece};

/// The stock and the sensor of a job file under moving axes. Equal positions give equal loads.
#[derive(Clone, Debug)]
pub struct SimulatedProcess {
    cut: CutFile,
    piece: Workpiece,
    sensor: Sensor,
    range_max: f64,
    scale: LoadScale,
}

impl SimulatedProcess {
    /// The stock of a job, sampled every `period_s` seconds; `None` if the file has no `[stock]`.
    #[must_use]
    pub fn new(job: &TurningJob, period_s: f64) -> Option<Self> {
        let blank = job.blank.clone()?;
        let settings = &job.settings;
        let steps_per_turn = settings.turn_s() / period_s;
        Some(Self {
            cut: job.cut,
            piece: Workpiece::of_cut(blank, settings, settings.regime.law, steps_per_turn),
            sensor: Sensor::new(job.sensor, period_s),
            range_max: job.sensor.range_max,
            scale: settings.scale,
        })
    }

    /// Moves the tip to a radius and Z, machine coordinates in mm. Returns the cut and the sensor's reading
    /// of it, rounded to single precision as the cutting load is everywhere. Does not allocate.
    pub fn step(&mut self, x_mm: f64, z_mm: f64) -> (CutState, Option<LoadSample>) {
        let (along, out) = self.cut.along_and_out_mm(x_mm, z_mm);
        let now = self.piece.step(along, out);
        let reading = self.scale.reading(now.load, [along, out], now.depth_mm);
        let sample = self.sensor.read(reading, None).map(|sample| LoadSample {
            value: f64::from(sample.value as f32),
            ..sample
        });
        (now, sample)
    }

    /// Maximum reading of the sensor.
    #[must_use]
    pub fn range_max(&self) -> f64 {
        self.range_max
    }

    /// The workpiece.
    #[must_use]
    pub fn workpiece(&self) -> &Workpiece {
        &self.piece
    }
}
