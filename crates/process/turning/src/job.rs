//! A job of self-programmed turning, read from its file and checked.

use evolvent_config::{ConfigDocument, ConfigError};
use evolvent_cutting::{Cut, ForceLaw, LawDefinition};
use evolvent_timing::ScalarLimits;

use crate::blank::Blank;
use crate::cone::Cone;
use crate::job_file::{CutEnd, CutFile, CutKind, JobFile, SensorKind, StrategyName};
use crate::law::CutLaw;
use crate::regime::{BackOff, PERMITTED_LOAD, Regime, RegimeError, RegimeInput, SET_LOAD, SMALLEST_FEED};
use crate::scale::{Lever, LoadScale, MIN_LEVER_FRACTION};
use crate::sensor::SensorModel;
use crate::settings::{Strategy, TurningSettings};
use crate::tool::CuttingEdge;
use crate::wear::Wear;

/// Maximum relative difference between the law and its power law over the feeds and depths of the job.
const MAX_MISFIT: f64 = 0.1;

/// A job that can be run.
#[derive(Clone, Debug)]
pub struct TurningJob {
    /// Its name.
    pub name: String,
    /// The cut.
    pub cut: CutFile,
    /// Settings with the usual motion limits. [`TurningJob::drive_with`] replaces them by the machine's.
    pub settings: TurningSettings,
    /// Stock for trials.
    pub blank: Option<Blank>,
    /// Sensor for trials.
    pub sensor: SensorModel,
    /// Maximum relative difference between the force law and the power law of the controller.
    pub law_misfit: f64,
    /// The file's name and text.
    source: (String, String),
}

impl TurningJob {
    /// Reads a job file; `file` names it in errors.
    ///
    /// # Errors
    /// Keys that are unknown, missing or out of range, and invalid regimes, with position and key.
    pub fn parse(text: &str, file: &str) -> Result<Self, ConfigError> {
        let sheet = ConfigDocument::parse(text, file)?;
        let job = sheet.read::<JobFile>()?.job(&sheet)?;
        job.check_stock(&sheet)?;
        Ok(job)
    }

    /// The stock must not be higher than the passes reach. It does not apply to another cut
    /// ([`TurningJob::for_cut`]).
    fn check_stock(&self, sheet: &ConfigDocument<'_>) -> Result<(), ConfigError> {
        let Some(blank) = &self.blank else {
            return Ok(());
        };
        let height_mm = blank.highest_mm(self.cut.length_mm) + blank.runout_mm;
        let allowance_mm = self.cut.allowance_max_mm;
        if height_mm <= allowance_mm + 1e-9 {
            return Ok(());
        }
        let with_runout = if blank.runout_mm > 0.0 {
            " with its runout"
        } else {
            ""
        };
        Err(sheet.error(
            "stock.outline_mm",
            format!(
                "stands {height_mm:.3} mm above the final size{with_runout}, above \
                     cut.allowance_max_mm, {allowance_mm} mm"
            ),
            "raise cut.allowance_max_mm, or correct the stock",
        ))
    }

    /// The same tool, law, load, feed and strategy for another cut.
    ///
    /// # Errors
    /// Values that do not fit that cut, with the file's position and key.
    pub fn for_cut(&self, cut: CutFile) -> Result<Self, ConfigError> {
        let (file, text) = &self.source;
        let sheet = ConfigDocument::parse(text, file)?;
        let mut job: JobFile = sheet.read()?;
        job.cut = cut;
        job.job(&sheet)
    }

    /// The file's text.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.source.1
    }

    /// Sets the machine's limits and its control period. Moves that do not cut go as fast as the axes allow.
    pub fn drive_with(&mut self, along: ScalarLimits, out: ScalarLimits, period_s: f64) {
        let settings = &mut self.settings;
        (settings.along_limits, settings.out_limits) = (along, out);
        settings.rapid_mm_s = along.velocity;
        settings.out_speed_mm_s = out.velocity;
        settings.period_s = period_s;
    }
}

/// The key that causes an error of the regime, and what to do.
fn key_of(error: &RegimeError) -> (&'static str, &'static str) {
    match error {
        RegimeError::Law { .. } => ("law", "correct the force law"),
        RegimeError::Number { name, .. } => match *name {
            SET_LOAD => ("load.set_n", "give the load in N"),
            PERMITTED_LOAD => ("load.permitted_n", "give the load in N"),
            SMALLEST_FEED => ("feed.min_mm_rev", "give the feed in mm/rev"),
            _ => ("feed.max_mm_rev", "give the feed in mm/rev"),
        },
        RegimeError::Feeds { .. } => ("feed.min_mm_rev", "lower it, or raise feed.max_mm_rev"),
        RegimeError::Narrow { .. } => ("feed.min_mm_rev", "or set feed.back_off_mm_rev"),
        RegimeError::BackOffFeed { .. } => ("feed.back_off_mm_rev", "choose one between, or leave it out"),
        RegimeError::Overload { .. } => (
            "load.set_n",
            "or raise load.permitted_n, if machine and insert bear it",
        ),
        RegimeError::Edge { .. } => ("feed.min_mm_rev", "or give the length of the edge, tool.edge_mm"),
    }
}

impl JobFile {
    fn job(&self, sheet: &ConfigDocument<'_>) -> Result<TurningJob, ConfigError> {
        let refuse = |key: &str, what: String, advice: &str| sheet.error(key, what, advice);
        for (key, value, min, max) in [
            ("cut.diameter_mm", self.cut.diameter_mm, 0.1, 1e4),
            ("cut.z_mm", self.cut.z_mm, -1e4, 1e4),
            ("cut.length_mm", self.cut.length_mm, 0.1, 1e4),
            ("cut.allowance_max_mm", self.cut.allowance_max_mm, 0.01, 1e3),
            ("cut.spindle_rpm", self.cut.spindle_rpm, 0.1, 1e5),
            ("tool.rake_deg", self.tool.rake_deg, -45.0, 45.0),
            ("sensor.lag_ms", self.sensor.lag_ms, 0.0, 1000.0),
            ("sensor.stale_ms", self.sensor.stale_ms, 0.1, 1000.0),
            ("sensor.noise", self.sensor.noise, 0.0, 0.5),
            ("sensor.idle", self.sensor.idle, 0.0, 1e9),
            ("sensor.idle_per_rpm", self.sensor.idle_per_rpm, 0.0, 1e6),
            ("sensor.efficiency", self.sensor.efficiency, 0.05, 1.0),
        ] {
            sheet.number(key, value, min, max)?;
        }
        if let Some(diameter) = self.cut.speed_diameter_mm {
            sheet.number("cut.speed_diameter_mm", diameter, 0.1, 1e4)?;
        }
        if self.cut.kind == CutKind::Facing && self.cut.length_mm > 0.5 * self.cut.diameter_mm {
            return Err(refuse(
                "cut.length_mm",
                "goes beyond the axis".into(),
                "give at most half of the diameter",
            ));
        }
        let tool = CuttingEdge::new(self.tool.lead_deg, self.tool.edge_mm)
            .map_err(|error| refuse("tool", error.to_string(), "correct the tool"))?;
        let (law, law_misfit) = self.law(sheet)?;
        let input = RegimeInput {
            law,
            set_load: self.load.set_n,
            permitted_load: self.load.permitted_n,
            feed_min_mm_rev: self.feed.min_mm_rev,
            feed_max_mm_rev: self.feed.max_mm_rev,
            back_off: match (self.feed.back_off_mm_rev, self.strategy.name) {
                (Some(feed), _) => BackOff::Feed(feed),
                (None, StrategyName::Fast) => BackOff::LeastTime,
                (None, _) => BackOff::Balanced,
            },
        };
        let mut regime = Regime::new(&input, &tool).map_err(|error| {
            let (key, advice) = key_of(&error);
            refuse(key, error.to_string(), advice)
        })?;
        regime.wear = self.wear(sheet)?;
        let usual = TurningSettings::usual(regime, tool, self.cut.spindle_rpm, self.cut.length_mm);
        let literal = self.strategy.name == StrategyName::Literal;
        let scale = self.scale(sheet, &regime, &tool)?;
        let settings = TurningSettings {
            strategy: match self.strategy.name {
                StrategyName::Literal => Strategy::literal(&regime),
                StrategyName::Safe => Strategy::safe(&regime),
                StrategyName::Fast => Strategy::fast(&regime, self.strategy.face_is_known),
            },
            cone: self.cone(sheet, &tool)?,
            beyond_mm: self.cut.beyond_mm(),
            allowance_max_mm: self.cut.allowance_max_mm,
            // The literal strategy causes overloads by itself.
            overload_n: self
                .load
                .overload_n
                .unwrap_or(if literal { 2.5 } else { 1.5 } * regime.set_load),
            overload_s: self.load.overload_ms.map_or(usual.overload_s, |ms| ms * 1e-3),
            contact_load_n: self.load.contact_n.unwrap_or(usual.contact_load_n),
            scale,
            sensor_lag_s: self.sensor.lag_ms * 1e-3,
            sensor_stale_s: self.sensor.stale_ms * 1e-3,
            ..usual
        };
        Ok(TurningJob {
            name: self.name.clone(),
            cut: self.cut,
            settings,
            blank: self.blank(sheet)?,
            sensor: SensorModel {
                lag_s: self.sensor.lag_ms * 1e-3,
                noise: self.sensor.noise,
                range_max: scale.reading(
                    self.sensor.range_n.unwrap_or(4.0 * regime.set_load),
                    [0.0; 2],
                    0.0,
                ),
                seed: self.sensor.seed,
            },
            law_misfit,
            source: (sheet.file().to_owned(), sheet.text().to_owned()),
        })
    }

    /// The cone after the cylinder.
    fn cone(&self, sheet: &ConfigDocument<'_>, tool: &CuttingEdge) -> Result<Option<Cone>, ConfigError> {
        let cut = &self.cut;
        let (from_mm, angle_deg) = match (cut.cone_from_mm, cut.cone_deg) {
            (Some(from), Some(angle)) => (from, angle),
            (None, None) => return Ok(None),
            (has, _) => {
                let (key, lacks) = if has.is_some() {
                    ("cut.cone_from_mm", "cone_deg")
                } else {
                    ("cut.cone_deg", "cone_from_mm")
                };
                let advice = "a cone has both: where it begins, and its angle";
                return Err(sheet.error(key, format!("is given without {lacks}"), advice));
            }
        };
        sheet.number("cut.cone_from_mm", from_mm, 0.0, cut.length_mm)?;
        sheet.number("cut.cone_deg", angle_deg, 0.1, 88.0)?;
        if cut.kind == CutKind::Facing {
            let advice = "leave cone_from_mm and cone_deg out, or turn along Z";
            return Err(sheet.error("cut.cone_deg", "belongs to longitudinal turning".into(), advice));
        }
        let cone = Cone::new(from_mm, angle_deg);
        cone.check(tool)
            .map_err(|error| sheet.error("cut.cone_deg", error.to_string(), "or a flatter cone"))?;
        let top_mm = cone.height_mm(cut.length_mm);
        if top_mm > cut.allowance_max_mm + 1e-9 {
            let what = format!(
                "makes the cone end {top_mm:.3} mm above the final size, and the stock stands at most {} mm \
                 above it",
                cut.allowance_max_mm
            );
            return Err(sheet.error(
                "cut.length_mm",
                what,
                "end the cut where the cone leaves the stock",
            ));
        }
        Ok(Some(cone))
    }

    /// The price of wear relative to that of machine time.
    fn wear(&self, sheet: &ConfigDocument<'_>) -> Result<Wear, ConfigError> {
        let Some(cost) = &self.cost else {
            return Ok(Wear::default());
        };
        for (key, value, min, max) in [
            ("cost.machine_per_h", cost.machine_per_h, 1e-6, 1e9),
            ("cost.edge", cost.edge, 0.0, 1e9),
            ("cost.life_min", cost.life_min, 1e-3, 1e6),
            ("cost.life_feed_mm_rev", cost.life_feed_mm_rev, 1e-3, 10.0),
            ("cost.life_depth_mm", cost.life_depth_mm, 1e-3, 100.0),
            ("cost.life_feed_exponent", cost.life_feed_exponent, 0.0, 5.0),
            ("cost.life_depth_exponent", cost.life_depth_exponent, 0.0, 5.0),
        ] {
            sheet.number(key, value, min, max)?;
        }
        Ok(Wear {
            ratio: cost.edge / (cost.machine_per_h / 60.0 * cost.life_min),
            feed_mm_rev: cost.life_feed_mm_rev,
            depth_mm: cost.life_depth_mm,
            feed_exponent: cost.life_feed_exponent,
            depth_exponent: cost.life_depth_exponent,
        })
    }

    /// What the sensor shows of the force.
    fn scale(
        &self,
        sheet: &ConfigDocument<'_>,
        regime: &Regime,
        tool: &CuttingEdge,
    ) -> Result<LoadScale, ConfigError> {
        let sensor = &self.sensor;
        let idle = sensor.idle + sensor.idle_per_rpm * self.cut.spindle_rpm;
        if sensor.kind == SensorKind::Force {
            return Ok(LoadScale {
                idle,
                ..LoadScale::FORCE
            });
        }
        let lever = self.lever(sheet, regime, tool)?;
        // Torque in N m of 1 N at a diameter of 1 mm.
        let torque = 0.5e-3;
        let per_n = match sensor.kind {
            SensorKind::Force | SensorKind::Torque => torque,
            SensorKind::Power => {
                torque * std::f64::consts::TAU * self.cut.spindle_rpm / 60.0 / sensor.efficiency
            }
            SensorKind::Current => match sensor.amps_per_nm {
                Some(amps) => {
                    sheet.number("sensor.amps_per_nm", amps, 1e-6, 1e6)?;
                    torque * amps
                }
                None => {
                    return Err(sheet.error(
                        "sensor.amps_per_nm",
                        "is missing: a current tells nothing without it".into(),
                        "give the A for 1 N m at the spindle, from the drive's data or two known cuts",
                    ));
                }
            },
        };
        Ok(LoadScale { idle, per_n, lever })
    }

    /// The diameters at which the force acts.
    fn lever(
        &self,
        sheet: &ConfigDocument<'_>,
        regime: &Regime,
        tool: &CuttingEdge,
    ) -> Result<Lever, ConfigError> {
        let diameter_mm = self.cut.diameter_mm;
        if self.cut.kind == CutKind::Longitudinal {
            return Ok(Lever::Longitudinal { diameter_mm });
        }
        let depth_max_mm = regime.depth_max_mm;
        let lead_per_depth = 1.0 / tool.slope();
        // The force acts nearest to the axis in the deepest cut of the last pass, or at the tip of the
        // highest pass, which ends at the shoulder.
        let shoulder_mm = (self.cut.allowance_max_mm * lead_per_depth).min(self.cut.beyond_mm());
        let nearer_mm = (depth_max_mm * lead_per_depth).max(2.0 * shoulder_mm);
        let end_mm = diameter_mm - 2.0 * self.cut.length_mm - nearer_mm;
        let min_mm = MIN_LEVER_FRACTION * diameter_mm;
        if end_mm < min_mm {
            return Err(sheet.error(
                "sensor.kind",
                format!(
                    "a sensor in the spindle's drive shows less of the force the nearer it is to the axis: \
                     the deepest cut would act at a diameter of {end_mm:.2} mm, and it shows enough down to \
                     {min_mm:.2} mm"
                ),
                "face less far, or measure the force at the tool",
            ));
        }
        Ok(Lever::Facing {
            diameter_mm,
            lead_per_depth,
            depth_max_mm,
        })
    }

    fn blank(&self, sheet: &ConfigDocument<'_>) -> Result<Option<Blank>, ConfigError> {
        let Some(stock) = &self.stock else {
            return Ok(None);
        };
        let triples = |list: &[[f64; 3]]| list.iter().map(|[a, b, c]| (*a, *b, *c)).collect();
        let blank = Blank {
            outline_mm: stock.outline_mm.iter().map(|[u, h]| (*u, *h)).collect(),
            grooves_mm: triples(&stock.grooves_mm),
            hard_spots: triples(&stock.hard_spots),
            runout_mm: stock.runout_mm,
            slots: stock.slots_turn.iter().map(|[a, b]| (*a, *b)).collect(),
        };
        match blank.check() {
            Ok(()) => Ok(Some(blank)),
            Err(error) => Err(sheet.error("stock", error.to_string(), "correct the stock")),
        }
    }

    /// The law at the cutting speed of the job as a power law, and its relative error.
    fn law(&self, sheet: &ConfigDocument<'_>) -> Result<(CutLaw, f64), ConfigError> {
        let law = &self.law;
        let diameter = self.cut.speed_diameter_mm.unwrap_or(self.cut.diameter_mm);
        let speed_m_min = std::f64::consts::PI * diameter * self.cut.spindle_rpm / 1000.0;
        let numbers = (
            law.coefficient_n,
            law.speed_exponent,
            law.depth_exponent,
            law.feed_exponent,
        );
        match (&law.name, numbers) {
            (None, (Some(coefficient), Some(speed), Some(depth), Some(feed))) => {
                sheet.number("law.coefficient_n", coefficient, 1e-3, 1e9)?;
                sheet.number("law.speed_exponent", speed, -3.0, 3.0)?;
                sheet.number("law.depth_exponent", depth, 0.05, 3.0)?;
                sheet.number("law.feed_exponent", feed, 0.05, 3.0)?;
                let law = CutLaw {
                    coefficient: coefficient * libm::pow(speed_m_min, speed),
                    depth_exponent: depth,
                    feed_exponent: feed,
                };
                Ok((law, 0.0))
            }
            (Some(name), (None, None, None, None)) => {
                let Some(definition) = LawDefinition::built_in(name) else {
                    let names = LawDefinition::built_in_names().join(", ");
                    return Err(sheet.error(
                        "law.name",
                        format!("\"{name}\" is no law"),
                        format!("there is {names}"),
                    ));
                };
                let tool = evolvent_cutting::ToolAngles {
                    rake_deg: self.tool.rake_deg,
                    lead_deg: self.tool.lead_deg,
                };
                let built = definition.law(tool).map_err(|error| {
                    sheet.error("law.name", error.to_string(), "choose another tool or law")
                })?;
                self.fit(sheet, &built, speed_m_min)
            }
            _ => Err(sheet.error(
                "law",
                "needs either a name, or coefficient_n and the exponents of speed, depth and feed".into(),
                "give one of the two",
            )),
        }
    }

    /// A power law with the slopes of the force law at the geometric mean of the feeds and at the set load.
    fn fit(
        &self,
        sheet: &ConfigDocument<'_>,
        law: &ForceLaw,
        speed_m_min: f64,
    ) -> Result<(CutLaw, f64), ConfigError> {
        sheet.number("feed.min_mm_rev", self.feed.min_mm_rev, 1e-4, 10.0)?;
        sheet.number(
            "feed.max_mm_rev",
            self.feed.max_mm_rev,
            self.feed.min_mm_rev,
            10.0,
        )?;
        let refuse = |error: &dyn std::fmt::Display| {
            sheet.error(
                "law",
                error.to_string(),
                "change speed or feeds, or choose another law",
            )
        };
        let feeds = [
            self.feed.min_mm_rev,
            (self.feed.min_mm_rev * self.feed.max_mm_rev).sqrt(),
            self.feed.max_mm_rev,
        ];
        let force = |depth_mm: f64, feed_mm_rev: f64| {
            law.force(Cut {
                speed_m_min,
                depth_mm,
                feed_mm_rev,
            })
            .map_err(|error| refuse(&error))
        };
        // The depth at the set load, by bisection.
        let depth_at = |feed: f64| {
            let (mut low, mut high) = (1e-3, 100.0);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if force(middle, feed)?.tangential_n < self.load.set_n {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            Ok::<f64, ConfigError>(high)
        };
        let depth = depth_at(feeds[1])?;
        let at = force(depth, feeds[1])?;
        let fitted = CutLaw {
            coefficient: 1.0,
            depth_exponent: depth * at.per_depth / at.tangential_n,
            feed_exponent: feeds[1] * at.per_feed / at.tangential_n,
        };
        let fitted = CutLaw {
            coefficient: at.tangential_n / fitted.load(depth, feeds[1]),
            ..fitted
        };
        if !fitted.is_sound() {
            return Err(refuse(&format!(
                "is no rising power of depth ({:.3}) and feed ({:.3}) at {speed_m_min:.1} m/min",
                fitted.depth_exponent, fitted.feed_exponent
            )));
        }
        let mut misfit: f64 = 0.0;
        for feed in feeds {
            let depth = depth_at(feed)?;
            misfit = misfit.max((fitted.load(depth, feed) / self.load.set_n - 1.0).abs());
        }
        if misfit > MAX_MISFIT {
            return Err(refuse(&format!(
                "differs by {:.0} % from a power law over these feeds",
                100.0 * misfit
            )));
        }
        Ok((fitted, misfit))
    }
}

impl CutFile {
    /// Maximum length of stock after the end of the cut, mm: in facing at most up to the axis.
    #[must_use]
    pub fn beyond_mm(&self) -> f64 {
        match (self.end, self.kind) {
            (CutEnd::Open, _) => 0.0,
            (CutEnd::Shoulder, CutKind::Longitudinal) => f64::INFINITY,
            (CutEnd::Shoulder, CutKind::Facing) => (0.5 * self.diameter_mm - self.length_mm).max(0.0),
        }
    }

    /// Radius (X of the axis) and Z of a position along the cut and a height, all in mm.
    #[must_use]
    pub fn position_mm(&self, along_mm: f64, out_mm: f64) -> (f64, f64) {
        match self.kind {
            CutKind::Longitudinal => (0.5 * self.diameter_mm + out_mm, self.z_mm - along_mm),
            CutKind::Facing => (0.5 * self.diameter_mm - along_mm, self.z_mm + out_mm),
        }
    }

    /// Position along the cut and height of a radius and a Z, all in mm.
    #[must_use]
    pub fn along_and_out_mm(&self, x_mm: f64, z_mm: f64) -> (f64, f64) {
        match self.kind {
            CutKind::Longitudinal => (self.z_mm - z_mm, x_mm - 0.5 * self.diameter_mm),
            CutKind::Facing => (0.5 * self.diameter_mm - x_mm, z_mm - self.z_mm),
        }
    }
}
