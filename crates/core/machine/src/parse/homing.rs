//! Checks the homing of the axes of a machine file.

use evolvent_config::shortened;
use evolvent_path::{AxisLetter, TURN_DEG};

use super::{Check, MAX_NUMBER, MIN_NUMBER};
use crate::error::MachineError;
use crate::homing::{EdgeFile, EndFile, HomingFile, HomingMethod, HomingSettings, MethodFile};
use crate::machine::Axis;

impl Check<'_> {
    pub(super) fn homing(
        &self,
        raw: &[HomingFile],
        axes: &[Axis],
    ) -> Result<Vec<HomingSettings>, MachineError> {
        let mut homing: Vec<HomingSettings> = Vec::new();
        for (index, one) in raw.iter().enumerate() {
            let at = format!("homing[{index}]");
            let mut letters = one.axis.chars();
            let letter = letters.next().and_then(AxisLetter::from_letter);
            let axis = axes
                .iter()
                .find(|axis| Some(axis.letter) == letter && letters.as_str().is_empty());
            let Some(axis) = axis else {
                return Err(self.error(
                    &format!("{at}.axis"),
                    format!("{:?} is not an axis of this machine", shortened(&one.axis)),
                    "name an axis that has an [[axis]] table",
                ));
            };
            if homing.iter().any(|known| known.axis == axis.letter) {
                return Err(self.error(
                    &format!("{at}.axis"),
                    format!("axis {} is homed twice", axis.letter.letter()),
                    "keep one of the tables",
                ));
            }
            homing.push(
                HomingKeys {
                    check: self,
                    at,
                    file: one,
                    axis,
                }
                .settings()?,
            );
        }
        Ok(homing)
    }
}

/// The table of one axis.
struct HomingKeys<'a> {
    check: &'a Check<'a>,
    at: String,
    file: &'a HomingFile,
    axis: &'a Axis,
}

impl HomingKeys<'_> {
    fn settings(&self) -> Result<HomingSettings, MachineError> {
        let (file, method) = (self.file, self.file.method);
        self.refuse_other_keys()?;
        let moves = method != MethodFile::Absolute;
        let negative = match file.towards {
            Some(end) => end == EndFile::Negative,
            None if moves => return Err(self.missing("towards")),
            None => false,
        };
        let latch_speed = match self.value("latch", file.latch_mm_s, file.latch_deg_s, "_s")? {
            Some(speed) => speed,
            None if moves => return Err(self.missing(&self.key("latch", "_s"))),
            None => 0.0,
        };
        let search_speed = match self.value("search", file.search_mm_s, file.search_deg_s, "_s")? {
            Some(speed) => speed,
            None if method.has_switch() => return Err(self.missing(&self.key("search", "_s"))),
            None => latch_speed,
        };
        if moves {
            self.number(
                &self.key("search", "_s"),
                search_speed,
                MIN_NUMBER,
                self.axis.max_velocity,
            )?;
            self.number(&self.key("latch", "_s"), latch_speed, MIN_NUMBER, search_speed)?;
        }
        let within = self.value("index_within", file.index_within_mm, file.index_within_deg, "")?;
        let within = match within {
            Some(within) => within,
            None if method.has_index() => return Err(self.missing(&self.key("index_within", ""))),
            None => 0.0,
        };
        if method.has_index() {
            let longest = match self.axis.unlimited {
                Some(_) => 1.1 * TURN_DEG,
                None => (self.axis.travel_max - self.axis.travel_min).max(MIN_NUMBER),
            };
            self.number(&self.key("index_within", ""), within, MIN_NUMBER, longest)?;
        }
        Ok(HomingSettings {
            axis: self.axis.letter,
            method: match method {
                MethodFile::Switch => HomingMethod::Switch,
                MethodFile::SwitchIndex => HomingMethod::SwitchThenIndex {
                    when_opening: file.index_edge == Some(EdgeFile::Opening),
                    within,
                },
                MethodFile::Index => HomingMethod::Index { within },
                MethodFile::Absolute => HomingMethod::Absolute,
            },
            order: self
                .check
                .whole_number(&format!("{}.order", self.at), file.order, 0, 100)?,
            negative,
            search_velocity: search_speed,
            latch_velocity: latch_speed,
            reference: self.reference()?,
        })
    }

    /// Machine coordinate of the reference.
    fn reference(&self) -> Result<f64, MachineError> {
        let file = self.file;
        let (name, value) = match file.method {
            MethodFile::Absolute => return Ok(0.0),
            MethodFile::Switch => (
                "switch",
                self.value("switch", file.switch_mm, file.switch_deg, "")?,
            ),
            MethodFile::SwitchIndex | MethodFile::Index => {
                ("index", self.value("index", file.index_mm, file.index_deg, "")?)
            }
        };
        let key = self.key(name, "");
        let value = value.ok_or_else(|| self.missing(&key))?;
        self.number(&key, value, -MAX_NUMBER, MAX_NUMBER)?;
        Ok(value)
    }

    /// Rejects keys that have no meaning with this method.
    fn refuse_other_keys(&self) -> Result<(), MachineError> {
        let (file, method) = (self.file, self.file.method);
        let given = |mm: Option<f64>, deg: Option<f64>| mm.is_some() || deg.is_some();
        let moves = method != MethodFile::Absolute;
        let keys = [
            ("towards".to_owned(), file.towards.is_some(), moves),
            (
                self.key("search", "_s"),
                given(file.search_mm_s, file.search_deg_s),
                moves,
            ),
            (
                self.key("latch", "_s"),
                given(file.latch_mm_s, file.latch_deg_s),
                moves,
            ),
            (
                self.key("switch", ""),
                given(file.switch_mm, file.switch_deg),
                method == MethodFile::Switch,
            ),
            (
                self.key("index", ""),
                given(file.index_mm, file.index_deg),
                method.has_index(),
            ),
            (
                self.key("index_within", ""),
                given(file.index_within_mm, file.index_within_deg),
                method.has_index(),
            ),
            (
                "index_edge".to_owned(),
                file.index_edge.is_some(),
                method == MethodFile::SwitchIndex,
            ),
        ];
        for (key, is_given, fits) in keys {
            if is_given && !fits {
                let what = format!("homing by \"{}\" does not use it", method.name());
                let advice = format!("remove {key}, or choose another method");
                return Err(self.check.error(&format!("{}.{key}", self.at), what, advice));
            }
        }
        Ok(())
    }

    fn unit(&self) -> &'static str {
        if self.axis.letter.is_rotary() { "deg" } else { "mm" }
    }

    fn key(&self, name: &str, suffix: &str) -> String {
        format!("{name}_{}{suffix}", self.unit())
    }

    fn number(&self, key: &str, value: f64, min: f64, max: f64) -> Result<(), MachineError> {
        self.check.number(&format!("{}.{key}", self.at), value, min, max)
    }

    fn missing(&self, key: &str) -> MachineError {
        let advice = format!("add this key: homing by \"{}\" needs it", self.file.method.name());
        self.check
            .error(&format!("{}.{key}", self.at), "missing".to_owned(), advice)
    }

    /// The value in the axis's unit.
    fn value(
        &self,
        key: &str,
        mm: Option<f64>,
        deg: Option<f64>,
        suffix: &str,
    ) -> Result<Option<f64>, MachineError> {
        let is_rotary = self.axis.letter.is_rotary();
        let (mine, other) = if is_rotary { (deg, mm) } else { (mm, deg) };
        if other.is_some() {
            return Err(self.check.error(
                &self.at,
                format!(
                    "axis {} takes {key} in {}",
                    self.axis.letter.letter(),
                    self.unit()
                ),
                format!("write {}", self.key(key, suffix)),
            ));
        }
        Ok(mine)
    }
}
