//! Axes and homing: `[KINS]`, `[TRAJ]`, `[AXIS_L]`, `[JOINT_n]`.

use evolvent_path::AxisLetter;

use crate::error::ImportError;
use crate::ini::Ini;
use crate::report::Report;
use crate::screws::{ScrewValues, screws};
use crate::settings::drop_entry;

/// LinuxCNC's limits beyond this mean "none"; its default is 1e99.
const NO_LIMIT: f64 = 1e8;
/// Travel of a linear axis without limits, mm, and of a rotary one, degrees.
const TRAVEL_WITHOUT_LIMITS: (f64, f64) = (10_000.0, 36_000.0);
/// Time to full acceleration if no jerk is given, s. Tuned: data sheets of machines without a jerk limit have
/// 0.02 to 0.1 s.
const JERK_TIME_S: f64 = 0.05;
/// LinuxCNC's default velocity in units/s and acceleration in units/s^2.
const DEFAULT_LIMIT: f64 = 1.0;
/// Distance within which the index pulse is searched, mm and degrees, because LinuxCNC has no bound: a turn
/// of a common screw, or of the axis.
const INDEX_WITHIN: (f64, f64) = (12.0, 365.0);
/// Maximum distance of a home switch, mm and degrees: the bound of machine files.
const MAX_COORDINATE: f64 = 1e9;
/// Maximum velocity and acceleration, in units and seconds.
const MAX_LIMIT: f64 = 1e5;

/// One axis, in mm or degrees and seconds.
#[derive(Debug)]
pub(crate) struct AxisValues {
    pub(crate) letter: AxisLetter,
    pub(crate) travel: (f64, f64),
    /// An unlimited rotary axis, which has no travel.
    pub(crate) is_unlimited: bool,
    pub(crate) velocity: f64,
    pub(crate) acceleration: f64,
    pub(crate) jerk: f64,
    pub(crate) home: f64,
    /// Permitted following error at rest, and permitted time in motion, ms.
    pub(crate) following: (Option<f64>, Option<f64>),
    pub(crate) homing: Option<HomingValues>,
    /// Degrees or mm per unit of the configuration.
    pub(crate) unit: f64,
    pub(crate) screws: ScrewValues,
}

/// How an axis finds machine zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HomingMethod {
    Switch,
    /// `when_opening`: the index pulse after the edge at which the switch opens.
    SwitchIndex {
        when_opening: bool,
    },
    Index,
    Absolute,
}

/// Homing of an axis, in mm or degrees and seconds.
#[derive(Debug)]
pub(crate) struct HomingValues {
    pub(crate) method: HomingMethod,
    pub(crate) is_negative: bool,
    pub(crate) order: u32,
    pub(crate) search: f64,
    pub(crate) latch: f64,
    /// Position at which the switch closes, or of the index pulse.
    pub(crate) reference: f64,
    /// Distance within which the index pulse is searched.
    pub(crate) within: f64,
}

/// Factors to mm and degrees.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Units {
    pub(crate) linear: f64,
    pub(crate) angular: f64,
}

impl Units {
    pub(crate) fn read(ini: &mut Ini, report: &mut Report) -> Result<Self, ImportError> {
        let linear = match ini.first("TRAJ", "LINEAR_UNITS") {
            None => {
                report.choose("units", "mm: [TRAJ] LINEAR_UNITS is missing");
                1.0
            }
            Some(entry) => match entry.word().to_ascii_lowercase().as_str() {
                "mm" | "metric" => 1.0,
                "in" | "inch" | "imperial" => 25.4,
                _ => match entry.number() {
                    Ok(units_per_mm) if units_per_mm > 0.0 => 1.0 / units_per_mm,
                    _ => {
                        let what = format!("LINEAR_UNITS = {:?} is not a unit of length", entry.value);
                        return Err(entry.error(what, "write mm or inch"));
                    }
                },
            },
        };
        let angular = match ini.first("TRAJ", "ANGULAR_UNITS") {
            None => 1.0,
            Some(entry) => match entry.word().to_ascii_lowercase().as_str() {
                "deg" | "degree" | "degrees" => 1.0,
                "rad" | "radian" => 1.0_f64.to_degrees(),
                "grad" | "gon" => 0.9,
                _ => match entry.number() {
                    Ok(units_per_degree) if units_per_degree > 0.0 => 1.0 / units_per_degree,
                    _ => {
                        let what = format!("ANGULAR_UNITS = {:?} is not a unit of angle", entry.value);
                        return Err(entry.error(what, "write degree"));
                    }
                },
            },
        };
        Ok(Self { linear, angular })
    }

    pub(crate) fn of(self, letter: AxisLetter) -> f64 {
        if letter.is_rotary() {
            self.angular
        } else {
            self.linear
        }
    }
}

/// The axes of the machine in the order XYZABCUVW, each with the joints that drive it.
fn joints(ini: &mut Ini) -> Result<Vec<(AxisLetter, Vec<usize>)>, ImportError> {
    let Some(kinematics) = ini.first("KINS", "KINEMATICS") else {
        if ini.has("AXIS_0") {
            return Err(ini.missing(
                "a configuration of LinuxCNC 2.7 or older, without joints",
                "convert it with LinuxCNC's update_ini first",
            ));
        }
        return Err(ini.missing(
            "[KINS] KINEMATICS is missing",
            "give the INI file of a LinuxCNC configuration (2.8 or later)",
        ));
    };
    let mut words = kinematics.value.split_whitespace();
    let module = words.next().unwrap_or_default();
    if module != "trivkins" {
        return Err(kinematics.error(
            format!("kinematics {module:?}: only trivkins can be carried over"),
            "Evolvent drives machines in which each letter is a separate axis",
        ));
    }
    let parse = |text: &str| -> Result<Vec<AxisLetter>, ImportError> {
        let letters = text.chars().filter(|c| !c.is_whitespace() && *c != '"');
        letters
            .map(|c| {
                AxisLetter::from_letter(c.to_ascii_uppercase())
                    .ok_or_else(|| kinematics.error(format!("{c:?} is not an axis"), "use X Y Z A B C U V W"))
            })
            .collect()
    };
    let driven = match words.find_map(|word| word.strip_prefix("coordinates=")) {
        Some(text) => parse(text)?,
        None => parse("XYZABCUVW")?,
    };
    let count = match ini.number("KINS", "JOINTS")? {
        Some(count) if (1.0..=16.0).contains(&count) => count as usize,
        Some(_) => return Err(ini.missing("[KINS] JOINTS is not 1 to 16", "correct the number")),
        None => driven.len(),
    };
    let used = match ini.first("TRAJ", "COORDINATES") {
        Some(entry) => parse(&entry.value)?,
        None => driven.iter().copied().take(count).collect(),
    };
    let mut axes = Vec::new();
    for letter in parse("XYZABCUVW")? {
        let of_letter = |(_, other): &(usize, &AxisLetter)| **other == letter;
        let joints = driven.iter().enumerate().take(count).filter(of_letter);
        let joints: Vec<usize> = joints.map(|(joint, _)| joint).collect();
        if used.contains(&letter) {
            axes.push((letter, joints));
        }
    }
    if axes.is_empty() {
        return Err(ini.missing(
            "[TRAJ] COORDINATES names no axis",
            "name the axes, for example X Y Z",
        ));
    }
    Ok(axes)
}

pub(crate) fn axes(ini: &mut Ini, units: Units, report: &mut Report) -> Result<Vec<AxisValues>, ImportError> {
    let axes = joints(ini)?;
    axes.iter()
        .map(|(letter, joints)| axis(ini, *letter, joints, units.of(*letter), report))
        .collect()
}

/// The values of one key in the sections of an axis and of its joints.
fn values(ini: &mut Ini, sections: &[String], key: &str) -> Result<Vec<f64>, ImportError> {
    let mut values = Vec::new();
    for section in sections {
        values.extend(ini.number(section, key)?);
    }
    Ok(values)
}

/// Drops the travel of an axis that turns without limits.
fn drop_travel(ini: &mut Ini, sections: &[String], report: &mut Report) {
    for section in sections {
        for key in ["MIN_LIMIT", "MAX_LIMIT"] {
            let entry = ini.first(section, key);
            if let Some(entry) =
                entry.filter(|entry| entry.number().is_ok_and(|limit| limit.abs() < NO_LIMIT))
            {
                drop_entry(report, &entry, "an axis with WRAPPED_ROTARY has no travel");
            }
        }
    }
}

fn choose_jerk(acceleration: f64, name: char, report: &mut Report) -> f64 {
    let jerk = acceleration / JERK_TIME_S;
    report.choose(
        format!("max_jerk of {name}"),
        format!(
            "{} = max_acceleration / {JERK_TIME_S} s: LinuxCNC has no jerk limit there",
            tidy(jerk)
        ),
    );
    jerk
}

fn axis(
    ini: &mut Ini,
    letter: AxisLetter,
    joints: &[usize],
    unit: f64,
    report: &mut Report,
) -> Result<AxisValues, ImportError> {
    let name = letter.letter();
    let mut sections = vec![format!("AXIS_{name}")];
    sections.extend(joints.iter().map(|joint| format!("JOINT_{joint}")));
    let low = values(ini, &sections, "MIN_LIMIT")?
        .into_iter()
        .fold(-f64::INFINITY, f64::max);
    let high = values(ini, &sections, "MAX_LIMIT")?
        .into_iter()
        .fold(f64::INFINITY, f64::min);
    let without = if letter.is_rotary() {
        TRAVEL_WITHOUT_LIMITS.1
    } else {
        TRAVEL_WITHOUT_LIMITS.0
    };
    let wrapped = ini.first(&sections[0], "WRAPPED_ROTARY");
    let is_unlimited = letter.is_rotary() && wrapped.is_some_and(|entry| entry.is_true());
    if is_unlimited {
        drop_travel(ini, &sections, report);
    }
    let mut end = |limit: f64, key: &str, instead: f64| {
        if is_unlimited {
            return instead;
        }
        if limit.abs() < NO_LIMIT {
            return limit * unit;
        }
        report.choose(
            format!("{key} of {name}"),
            format!("{instead}: the configuration has no limit there; enter the machine's travel"),
        );
        instead
    };
    let travel = (end(low, "travel_min", -without), end(high, "travel_max", without));
    if travel.0 >= travel.1 {
        return Err(ini.missing(
            format!("axis {name}: MIN_LIMIT {low} is not below MAX_LIMIT {high}"),
            "correct the limits of the axis and of its joints",
        ));
    }
    let velocity = limit(ini, &sections, "MAX_VELOCITY", name, report)? * unit;
    let acceleration = limit(ini, &sections, "MAX_ACCELERATION", name, report)? * unit;
    let jerk = values(ini, &sections, "MAX_JERK")?
        .into_iter()
        .filter(|jerk| *jerk > 0.0)
        .reduce(f64::min)
        .map_or_else(|| choose_jerk(acceleration, name, report), |jerk| jerk * unit);
    let joint = sections.get(1).cloned().unwrap_or_default();
    let programmed_home = ini.number(&joint, "HOME")?.unwrap_or(0.0) * unit;
    let home = if is_unlimited {
        programmed_home % 360.0
    } else {
        programmed_home.clamp(travel.0, travel.1)
    };
    if home != programmed_home && !is_unlimited {
        report.choose(
            format!("home of {name}"),
            format!("{}: HOME lies outside the travel", tidy(home)),
        );
    }
    let at_rest = ini.number(&joint, "MIN_FERROR")?;
    let in_motion = ini.number(&joint, "FERROR")?;
    let time_ms = in_motion.map(|error| (error * unit / velocity * 1000.0).clamp(0.0, 10_000.0));
    Ok(AxisValues {
        letter,
        travel,
        is_unlimited,
        velocity,
        acceleration,
        jerk,
        home,
        following: (
            at_rest
                .or(in_motion)
                .filter(|error| *error > 0.0)
                .map(|error| error * unit),
            time_ms,
        ),
        homing: homing(
            ini,
            &joint,
            (letter, unit, velocity),
            (travel.1 - travel.0, programmed_home),
            report,
        )?,
        unit,
        screws: screws(ini, joints, unit, report)?,
    })
}

fn limit(
    ini: &mut Ini,
    sections: &[String],
    key: &str,
    name: char,
    report: &mut Report,
) -> Result<f64, ImportError> {
    let Some(value) = values(ini, sections, key)?.into_iter().reduce(f64::min) else {
        let text =
            format!("{DEFAULT_LIMIT} unit: the configuration has no {key}, and that is LinuxCNC's default");
        report.choose(format!("{} of {name}", key.to_ascii_lowercase()), text);
        return Ok(DEFAULT_LIMIT);
    };
    if value > MAX_LIMIT {
        let text = format!("{MAX_LIMIT} units: {key} is not limited; enter the machine's limit");
        report.choose(format!("{} of {name}", key.to_ascii_lowercase()), text);
        return Ok(MAX_LIMIT);
    }
    if value > 0.0 {
        return Ok(value);
    }
    Err(ini.missing(
        format!("axis {name}: {key} is {value}"),
        "give a limit above 0 in the sections of the axis and of its joints",
    ))
}

fn homing(
    ini: &mut Ini,
    joint: &str,
    (letter, unit, velocity): (AxisLetter, f64, f64),
    (length, programmed_home): (f64, f64),
    report: &mut Report,
) -> Result<Option<HomingValues>, ImportError> {
    let name = letter.letter();
    let search = ini.number(joint, "HOME_SEARCH_VEL")?.unwrap_or(0.0) * unit;
    let latch = ini.number(joint, "HOME_LATCH_VEL")?.unwrap_or(0.0) * unit;
    let reference = ini.number(joint, "HOME_OFFSET")?.unwrap_or(0.0) * unit;
    let sequence = ini.number(joint, "HOME_SEQUENCE")?;
    if reference.abs() > MAX_COORDINATE {
        let what = format!("[{joint}] HOME_OFFSET of {name} is {}", reference / unit);
        return Err(ini.missing(
            what,
            "this is beyond the size of a machine: enter the position of its home switch or index pulse",
        ));
    }
    let method = homing_method(ini, joint, search, latch);
    if matches!(method, None | Some(HomingMethod::Absolute)) {
        drop_unused_homing(ini, joint, reference, programmed_home, report);
    }
    let Some(method) = method else {
        return Ok(None);
    };
    if method == HomingMethod::Switch
        && search * latch < 0.0
        && let Some(entry) = ini.first(joint, "HOME_LATCH_VEL")
    {
        let key = if letter.is_rotary() {
            "switch_deg"
        } else {
            "switch_mm"
        };
        let reason = format!(
            "its sign is not carried over: LinuxCNC uses the edge at which the switch opens, Evolvent the \
             edge at which it closes in a second approach; correct {key} by the distance between the two, \
             or touch off again"
        );
        drop_entry(report, &entry, &reason);
    }
    // Without a switch there is only one speed.
    let search = if method == HomingMethod::Index {
        latch
    } else {
        search
    };
    let is_negative = search < 0.0;
    let latch = latch.abs();
    let order = sequence.unwrap_or(0.0).abs();
    if order > 100.0 || order.fract() != 0.0 {
        return Err(ini.missing(
            format!("[{joint}] HOME_SEQUENCE is {order}"),
            "give a whole number from -100 to 100",
        ));
    }
    let speed = search.abs().min(velocity);
    // Without a search there are no speeds.
    let is_searched = method != HomingMethod::Absolute;
    if is_searched && speed < search.abs() {
        report.choose(
            format!("search of {name}"),
            format!("{}: HOME_SEARCH_VEL is above the axis's own limit", tidy(speed)),
        );
    }
    if is_searched && (latch == 0.0 || latch > speed) {
        report.choose(
            format!("latch of {name}"),
            format!("{}: HOME_LATCH_VEL is 0 or above the search speed", tidy(speed)),
        );
    }
    let has_index = matches!(method, HomingMethod::SwitchIndex { .. } | HomingMethod::Index);
    let within = if letter.is_rotary() {
        INDEX_WITHIN.1
    } else {
        INDEX_WITHIN.0
    };
    let within = within.min(length);
    if has_index {
        report.choose(
            format!("index_within of {name}"),
            format!(
                "{}: LinuxCNC has no limit; enter slightly more than the distance from one index pulse \
                 to the next",
                tidy(within)
            ),
        );
    }
    Ok(Some(HomingValues {
        method,
        is_negative,
        order: order as u32,
        search: speed,
        latch: if latch == 0.0 { speed } else { latch.min(speed) },
        reference,
        within,
    }))
}

/// Reports the homing keys of a joint that does not search.
fn drop_unused_homing(ini: &mut Ini, joint: &str, reference: f64, home: f64, report: &mut Report) {
    let offset = ini.first(joint, "HOME_OFFSET");
    if let Some(entry) = offset.filter(|_| reference != 0.0 && reference != home) {
        let reason = "without a search the axis is at its home position when LinuxCNC starts: shift the \
                      zero of its encoder or bridge by this value";
        drop_entry(report, &entry, reason);
    }
    let speeds = ["HOME_SEARCH_VEL", "HOME_LATCH_VEL"];
    for entry in speeds.into_iter().filter_map(|key| ini.first(joint, key)) {
        if entry.number().is_ok_and(|speed| speed != 0.0) {
            drop_entry(report, &entry, "the axis is homed without a search");
        }
    }
}

/// `None` for a joint that is homed at its present position, for which a machine file needs no table.
fn homing_method(ini: &mut Ini, joint: &str, search: f64, latch: f64) -> Option<HomingMethod> {
    let absolute = ini.first(joint, "HOME_ABSOLUTE_ENCODER");
    if absolute.is_some_and(|entry| entry.is_true() || entry.value.starts_with('2')) {
        return Some(HomingMethod::Absolute);
    }
    let has_index = ini
        .first(joint, "HOME_USE_INDEX")
        .is_some_and(|entry| entry.is_true());
    if search == 0.0 {
        return (has_index && latch != 0.0).then_some(HomingMethod::Index);
    }
    Some(if has_index {
        // With opposite signs LinuxCNC searches the index while it leaves the switch.
        HomingMethod::SwitchIndex {
            when_opening: search * latch < 0.0,
        }
    } else {
        HomingMethod::Switch
    })
}

/// A number without the rounding noise of a unit conversion.
pub(crate) fn tidy(value: f64) -> String {
    let text = format!("{value:.9}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" {
        "0".to_owned()
    } else {
        text.to_owned()
    }
}
