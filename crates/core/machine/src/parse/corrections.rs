//! Checks backlash, screw tables, squareness and thermal growth in a machine file.

use std::io;
use std::path::{Path, PathBuf};

use evolvent_compensation::{AxisErrors, MachineErrors, ScrewTable, Squareness, ThermalSettings};
use evolvent_config::shortened;
use evolvent_path::AXES;

use super::Check;
use crate::corrections::{CorrectionSettings, ScrewFile, TableFormat, axis_of};
use crate::error::MachineError;
use crate::file::{AxisFile, MachineFile};
use crate::machine::Axis;
use crate::screw_file::{TableKind, read};
use crate::signals::{SignalKind, SignalSettings};

/// Minimum hysteresis of a reversal, mm or degrees: smaller motion is noise. Coarser grids use one increment.
const MIN_REVERSAL: f64 = 5e-4;
/// Default maximum of the thermal offset, and of its rate: 1 um/s.
const THERMAL_MAX_MM: f64 = 0.1;
const THERMAL_RATE_MM_S: f64 = 0.001;

/// Reads a file named by the machine file.
pub(crate) type ReadFile<'a> = &'a mut dyn FnMut(&Path) -> io::Result<Vec<u8>>;

impl Check<'_> {
    pub(super) fn corrections(
        &self,
        raw: &MachineFile,
        axes: &[Axis],
        signals: &SignalSettings,
        read_file: ReadFile<'_>,
    ) -> Result<CorrectionSettings, MachineError> {
        let mut errors = MachineErrors::default();
        let mut inputs = [None; AXES];
        let mut files: Vec<ScrewFile> = Vec::new();
        for (index, (file, axis)) in raw.axis.iter().zip(axes).enumerate() {
            let at = format!("axis[{index}]");
            let i = axis.letter.index();
            let increments = if axis.letter.is_rotary() {
                raw.increments_per_degree.unwrap_or(raw.increments_per_mm)
            } else {
                raw.increments_per_mm
            };
            let backlash = self.backlash(&at, file)?;
            let table = self.screw_table(&at, file, axis, &mut files, read_file)?;
            let thermal = self.thermal(&at, file, axis, signals)?;
            if let (Some((_, true)), Some((key, _))) = (&table, backlash) {
                return Err(self.error(
                    &format!("{at}.{key}"),
                    "a table for both directions includes the backlash".to_owned(),
                    format!("remove {key}, or supply a table for one direction"),
                ));
            }
            inputs[i] = thermal.map(|(input, _)| input);
            errors.axes[i] = AxisErrors {
                backlash: backlash.map_or(0.0, |(_, backlash)| backlash),
                table: table.map(|(table, _)| table),
                hysteresis: (1.0 / increments).max(MIN_REVERSAL),
                thermal: thermal.map(|(_, thermal)| thermal),
            };
        }
        errors.squareness = self.squareness(raw)?;
        CorrectionSettings::new(&errors, axes, inputs, files).map_err(|problem| {
            let index =
                axis_of(&problem).and_then(|letter| axes.iter().position(|axis| axis.letter == letter));
            let key = match index {
                Some(index) if raw.axis[index].screw_table.is_some() => format!("axis[{index}].screw_table"),
                Some(index) => format!("axis[{index}].letter"),
                None => "squareness".to_owned(),
            };
            let advice = "smooth the table there or give fewer points, allow more acceleration and jerk, \
                          or lower the velocity of the axis";
            self.error(&key, problem.to_string(), advice)
        })
    }

    fn backlash(&self, at: &str, raw: &AxisFile) -> Result<Option<(&'static str, f64)>, MachineError> {
        for (key, value) in [
            ("backlash_mm", raw.backlash_mm),
            ("backlash_deg", raw.backlash_deg),
        ] {
            if let Some(value) = value {
                self.number(&format!("{at}.{key}"), value, 0.0, 10.0)?;
                return Ok((value > 0.0).then_some((key, value)));
            }
        }
        Ok(None)
    }

    fn screw_table(
        &self,
        at: &str,
        raw: &AxisFile,
        axis: &Axis,
        files: &mut Vec<ScrewFile>,
        read_file: ReadFile<'_>,
    ) -> Result<Option<(ScrewTable, bool)>, MachineError> {
        let Some(name) = &raw.screw_table else {
            for (key, is_given) in [
                ("screw_table_format", raw.screw_table_format.is_some()),
                ("screw_table_unit", raw.screw_table_unit.is_some()),
            ] {
                if is_given {
                    let what = "there is no screw_table".to_owned();
                    return Err(self.error(
                        &format!("{at}.{key}"),
                        what,
                        "add screw_table, or remove the key",
                    ));
                }
            }
            return Ok(None);
        };
        let key = format!("{at}.screw_table");
        if name.is_empty() || name.contains('\0') {
            let advice = "name a file, or remove the key";
            return Err(self.error(&key, "this is not a valid path".to_owned(), advice));
        }
        let by_name = |ending: &str| name.to_ascii_lowercase().ends_with(ending);
        let format = match raw.screw_table_format {
            Some(format) => format,
            None if by_name(".csv") => TableFormat::Csv,
            None if by_name(".json") => TableFormat::Json,
            None => {
                return Err(self.error(
                    &key,
                    format!("the format of {:?} is unknown", shortened(name)),
                    "add screw_table_format = \"csv\", \"json\", \"linuxcnc-0\" or \"linuxcnc-1\" \
                     (the number is COMP_FILE_TYPE)",
                ));
            }
        };
        let is_linuxcnc = matches!(format, TableFormat::LinuxCnc0 | TableFormat::LinuxCnc1);
        if raw.screw_table_unit.is_some() && !is_linuxcnc {
            return Err(self.error(
                &format!("{at}.screw_table_unit"),
                "the columns of CSV and JSON tables name their units".to_owned(),
                "remove the key",
            ));
        }
        let path = PathBuf::from(name);
        let bytes = read_file(&path).map_err(|problem| {
            let what = format!("cannot read {:?}: {problem}", shortened(name));
            self.error(
                &key,
                what,
                "check the path, which is relative to the machine file's folder",
            )
        })?;
        let text = std::str::from_utf8(&bytes).map_err(|problem| {
            let what = format!(
                "{:?} is not UTF-8 text at byte {}",
                shortened(name),
                problem.valid_up_to()
            );
            self.error(&key, what, "save the table as UTF-8")
        })?;
        let beside = Path::new(self.document.file()).parent().unwrap_or(Path::new(""));
        let kind = TableKind {
            format,
            unit: raw.screw_table_unit.unwrap_or_default(),
            is_rotary: axis.letter.is_rotary(),
        };
        let table = read(text, &beside.join(&path).display().to_string(), kind)?;
        if !files.iter().any(|file| file.name == path) {
            files.push(ScrewFile { name: path, bytes });
        }
        Ok(Some(table))
    }

    fn thermal(
        &self,
        at: &str,
        raw: &AxisFile,
        axis: &Axis,
        signals: &SignalSettings,
    ) -> Result<Option<(u32, ThermalSettings)>, MachineError> {
        let Some(name) = &raw.thermal_input else {
            for (key, is_given) in [
                ("thermal_max_mm", raw.thermal_max_mm.is_some()),
                ("thermal_rate_um_s", raw.thermal_rate_um_s.is_some()),
            ] {
                if is_given {
                    let what = "there is no thermal_input".to_owned();
                    return Err(self.error(
                        &format!("{at}.{key}"),
                        what,
                        "add thermal_input, or remove the key",
                    ));
                }
            }
            return Ok(None);
        };
        let key = format!("{at}.thermal_input");
        if axis.letter.is_rotary() {
            let what = "only linear axes have a thermal offset".to_owned();
            return Err(self.error(&key, what, "remove the key"));
        }
        let input = signals
            .inputs
            .iter()
            .find(|input| input.name == *name && input.kind == SignalKind::Analog);
        let Some(input) = input else {
            return Err(self.error(
                &key,
                format!("this machine has no analog input {:?}", shortened(name)),
                "add [[input]] with this name and kind = \"analog\"",
            ));
        };
        let max_key = format!("{at}.thermal_max_mm");
        let rate_key = format!("{at}.thermal_rate_um_s");
        let max_offset = self.or_default(&max_key, raw.thermal_max_mm, THERMAL_MAX_MM, [0.0, 10.0])?;
        let rate = self.or_default(
            &rate_key,
            raw.thermal_rate_um_s,
            1e3 * THERMAL_RATE_MM_S,
            [0.001, 1000.0],
        )?;
        let thermal = ThermalSettings {
            max_offset,
            max_offset_velocity: rate * 1e-3,
        };
        Ok(Some((input.number, thermal)))
    }

    fn squareness(&self, raw: &MachineFile) -> Result<Squareness, MachineError> {
        let mut ratios = [0.0; 3];
        let file = &raw.squareness;
        let pairs = [
            ("xy_um_m", file.xy_um_m, [0, 1]),
            ("xz_um_m", file.xz_um_m, [0, 2]),
            ("yz_um_m", file.yz_um_m, [1, 2]),
        ];
        for (ratio, (key, value, pair)) in ratios.iter_mut().zip(pairs) {
            let key = format!("squareness.{key}");
            self.number(&key, value, -10_000.0, 10_000.0)?;
            let letters = ["x", "y", "z"];
            let is_there =
                |i: usize| (raw.axis.iter()).any(|axis| axis.letter.eq_ignore_ascii_case(letters[i]));
            if value != 0.0 && !pair.into_iter().all(is_there) {
                let what = "the machine does not have both axes".to_owned();
                return Err(self.error(&key, what, "remove the key"));
            }
            *ratio = value * 1e-6;
        }
        let [xy, xz, yz] = ratios;
        Ok(Squareness { xy, xz, yz })
    }
}
