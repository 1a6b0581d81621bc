//! The process that closes the loop where no metal is cut: positions in, load out.

use evolvent_machine::LoadSample;

use crate::job::Job;
use crate::job_file::CutFile;
use crate::scale::LoadScale;
use crate::sensor::Sensor;
use crate::workpiece::{CutNow, Workpiece};

/// The stock and the sensor of a job file, under an axis that moves. The same positions give the same loads.
#[derive(Clone, Debug)]
pub struct SimulatedProcess {
    cut: CutFile,
    piece: Workpiece,
    sensor: Sensor,
    range_max: f64,
    scale: LoadScale,
}

impl SimulatedProcess {
    /// The stock of a job, looked at every `period_s` seconds; none where the file has no `[stock]`.
    #[must_use]
    pub fn new(job: &Job, period_s: f64) -> Option<Self> {
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

    /// The tip is now at this radius and Z, machine coordinates in mm. What is cut, and what the sensor shows
    /// of it: a value of single precision, as the cutting load is kept everywhere. Allocates nothing.
    pub fn step(&mut self, x_mm: f64, z_mm: f64) -> (CutNow, Option<LoadSample>) {
        let (along, out) = self.cut.place_mm(x_mm, z_mm);
        let now = self.piece.step(along, out);
        let reading = self.scale.reading(now.load, [along, out], now.depth_mm);
        let sample = self.sensor.read(reading, None).map(|sample| LoadSample {
            value: f64::from(sample.value as f32),
            ..sample
        });
        (now, sample)
    }

    /// Highest value that the sensor can show.
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
