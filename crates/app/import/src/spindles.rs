//! The spindles of a configuration: `[TRAJ] SPINDLES`, `[SPINDLE_n]`, and their connections in HAL files.

use crate::error::ImportError;
use crate::hal::connected_spindles;
use crate::ini::{Entry, Ini, resolve};
use crate::report::Report;
use crate::settings::drop_entry;

/// Spindles that a machine file can have.
const MAX_SPINDLES: u32 = 4;
/// Speeds that a machine file permits, rpm. The maximum is used if nothing limits a spindle, as in LinuxCNC.
const SPEEDS_RPM: std::ops::RangeInclusive<f64> = 1e-3..=1e6;

/// A `[[spindle]]` of a machine file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SpindleValues {
    pub(crate) number: u32,
    pub(crate) max_rpm: f64,
    pub(crate) reverse: bool,
    pub(crate) feedback: bool,
}

/// The spindles. Empty for a single spindle without limits and encoder, since a machine file without spindles
/// has spindle 0.
pub(crate) fn spindles(ini: &mut Ini, report: &mut Report) -> Result<Vec<SpindleValues>, ImportError> {
    let count = count(ini, report)?;
    let encoders = encoders(ini);
    let mut found = Vec::new();
    for number in 0..count {
        let encoder = encoders.iter().find(|(spindle, _)| *spindle == number);
        let limits = Limits::read(ini, number, report)?;
        if count == 1 && encoder.is_none() && limits.is_unlimited() {
            continue;
        }
        let key = |key: &str| format!("spindle[{number}].{key}");
        if let Some((_, file)) = encoder {
            report.choose(
                key("feedback"),
                format!(
                    "true: {file} connects an encoder to spindle {number}; without a bridge that sends its \
                     angle and speed, a program that turns the spindle is stopped by alarm 440"
                ),
            );
        }
        let (max_rpm, why) = limits.max_rpm();
        if let Some(why) = why {
            report.choose(key("max_rpm"), format!("{max_rpm}: {why}"));
        }
        found.push(SpindleValues {
            number,
            max_rpm,
            reverse: limits.reverse != Some(0.0),
            feedback: encoder.is_some(),
        });
    }
    Ok(found)
}

/// Number of spindles. Those beyond the four of a machine file are reported.
fn count(ini: &mut Ini, report: &mut Report) -> Result<u32, ImportError> {
    let Some(entry) = ini.first("TRAJ", "SPINDLES") else {
        return Ok(1);
    };
    let count = entry.number()?;
    if count.fract() != 0.0 || count < 0.0 {
        return Err(entry.error(
            format!("[TRAJ] SPINDLES = {:?} is not a number of spindles", entry.value),
            "give a whole number",
        ));
    }
    if count > f64::from(MAX_SPINDLES) {
        drop_entry(
            report,
            &entry,
            "a machine has at most four spindles: the first four are carried over",
        );
    }
    // LinuxCNC treats 0 as 1.
    Ok((count as u32).clamp(1, MAX_SPINDLES))
}

/// The spindles whose encoder a HAL file connects, each with the first such file.
fn encoders(ini: &Ini) -> Vec<(u32, String)> {
    let mut found: Vec<(u32, String)> = Vec::new();
    for entry in ini.peek("HAL", "HALFILE") {
        let name = entry.value.split_whitespace().next().unwrap_or_default();
        for number in connected_spindles(&resolve(Some(ini.folder()), name)) {
            if found.iter().all(|(known, _)| *known != number) {
                found.push((number, name.to_owned()));
            }
        }
    }
    found
}

/// The limits of one spindle, rpm, if given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Limits {
    forward: Option<f64>,
    reverse: Option<f64>,
}

impl Limits {
    fn read(ini: &mut Ini, number: u32, report: &mut Report) -> Result<Self, ImportError> {
        let section = format!("SPINDLE_{number}");
        let forward = match ini.first(&section, "MAX_FORWARD_VELOCITY") {
            Some(entry) => forward(&entry, report)?,
            None => None,
        };
        // LinuxCNC uses the magnitude.
        let reverse = ini.number(&section, "MAX_REVERSE_VELOCITY")?.map(f64::abs);
        Ok(Self { forward, reverse })
    }

    fn is_unlimited(&self) -> bool {
        self.forward.is_none() && self.reverse.is_none()
    }

    /// One limit for both directions, and the reason for it if the configuration has none.
    fn max_rpm(&self) -> (f64, Option<String>) {
        let max = *SPEEDS_RPM.end();
        let reverse = self.reverse.filter(|rpm| *rpm > 0.0);
        let (rpm, why) = match (self.forward, reverse) {
            (None, None) => (
                max,
                Some("LinuxCNC does not limit it; write its maximum speed".to_owned()),
            ),
            (Some(forward), Some(reverse)) if forward != reverse => (
                forward.min(reverse),
                Some(format!(
                    "one limit holds for both directions: the smaller of MAX_FORWARD_VELOCITY {forward} and \
                     MAX_REVERSE_VELOCITY {reverse}"
                )),
            ),
            (Some(rpm), _) => (rpm, None),
            (None, Some(rpm)) => (
                rpm,
                Some("MAX_FORWARD_VELOCITY is missing: the value of MAX_REVERSE_VELOCITY".to_owned()),
            ),
        };
        let within = rpm.clamp(*SPEEDS_RPM.start(), max);
        if within == rpm {
            return (rpm, why);
        }
        (
            within,
            Some(format!("{rpm} rpm is outside the range of a machine file")),
        )
    }
}

fn forward(entry: &Entry, report: &mut Report) -> Result<Option<f64>, ImportError> {
    let rpm = entry.number()?;
    if rpm > 0.0 {
        return Ok(Some(rpm));
    }
    drop_entry(
        report,
        entry,
        "a spindle that does not turn clockwise has no counterpart",
    );
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(ini: &str, hal: &str) -> Result<(Vec<SpindleValues>, Report), ImportError> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("m.hal"), hal).unwrap();
        let file = folder.path().join("m.ini");
        std::fs::write(&file, format!("[HAL]\nHALFILE = m.hal\n{ini}")).unwrap();
        let mut report = Report::default();
        let mut ini = Ini::read(&file, &mut report)?;
        let found = spindles(&mut ini, &mut report)?;
        Ok((found, report))
    }

    fn values(number: u32, max_rpm: f64, reverse: bool, feedback: bool) -> SpindleValues {
        SpindleValues {
            number,
            max_rpm,
            reverse,
            feedback,
        }
    }

    #[test]
    fn sections_become_spindles_of_both_limits() {
        let ini = "[TRAJ]\nSPINDLES = 3\n[SPINDLE_0]\nMAX_FORWARD_VELOCITY = 2000 # rpm\n\
                   [SPINDLE_1]\nMAX_FORWARD_VELOCITY = 3000\nMAX_REVERSE_VELOCITY = 0\n\
                   [SPINDLE_2]\nMAX_FORWARD_VELOCITY = 3000\nMAX_REVERSE_VELOCITY = -1500\n";
        let (found, report) = read(ini, "").unwrap();
        let wanted = [
            values(0, 2000.0, true, false),
            values(1, 3000.0, false, false),
            values(2, 1500.0, true, false),
        ];
        assert_eq!(found, wanted);
        assert_eq!((report.chosen.len(), report.dropped.len()), (1, 0));
        assert_eq!(report.chosen[0].key, "spindle[2].max_rpm");
    }

    #[test]
    fn what_says_nothing_of_a_single_spindle_gives_none() {
        for ini in ["", "[TRAJ]\nSPINDLES = 1\n", "[TRAJ]\nSPINDLES = 0\n"] {
            let (found, report) = read(ini, "net speed spindle.0.speed-out => pid.s.command\n").unwrap();
            assert_eq!(found, []);
            assert!(report.chosen.is_empty());
        }
        let (found, report) = read("[TRAJ]\nSPINDLES=2\n", "").unwrap();
        assert_eq!(found, [values(0, 1e6, true, false), values(1, 1e6, true, false)]);
        assert_eq!(report.chosen.len(), 2);
    }

    #[test]
    fn an_encoder_in_a_hal_file_is_feedback() {
        let hal = "# net a => spindle.0.revs\nnet pos encoder.1.position => spindle.1.revs # b\n\
                   net pos spindle.1.revs-other\nlinksp pos spindle.0.revs\n";
        let (found, _) = read("[SPINDLE_0]\nMAX_FORWARD_VELOCITY = 900\n", hal).unwrap();
        assert_eq!(found, [values(0, 900.0, true, true)]);
        let (found, report) = read("[TRAJ]\nSPINDLES = 2\n", "net pos spindle.1.revs\n").unwrap();
        assert_eq!(found, [values(0, 1e6, true, false), values(1, 1e6, true, true)]);
        assert!(
            report
                .chosen
                .iter()
                .any(|value| value.key == "spindle[1].feedback")
        );
    }

    #[test]
    fn what_cannot_be_is_told() {
        let (found, report) = read("[TRAJ]\nSPINDLES = 8\n", "").unwrap();
        assert_eq!((found.len(), report.dropped.len()), (4, 1));
        let (_, report) = read("[SPINDLE_0]\nMAX_FORWARD_VELOCITY = 0\n", "").unwrap();
        assert_eq!(report.dropped[0].key, "MAX_FORWARD_VELOCITY");
        let (found, report) = read("[SPINDLE_0]\nMAX_FORWARD_VELOCITY = 1e9\n", "").unwrap();
        assert_eq!((found[0].max_rpm, report.chosen.len()), (1e6, 1));
        for wrong in [
            "SPINDLES = 1.5",
            "SPINDLES = -1",
            "SPINDLES = two",
            "SPINDLES = nan",
        ] {
            let error = read(&format!("[TRAJ]\n{wrong}\n"), "").unwrap_err().to_string();
            assert!(error.contains(":4: ") && error.contains("SPINDLES"), "{error}");
        }
        let error = read("[SPINDLE_0]\nMAX_REVERSE_VELOCITY = fast\n", "").unwrap_err();
        assert!(error.to_string().contains("MAX_REVERSE_VELOCITY"), "{error}");
    }
}
