//! A machine file as text.

use std::fmt::Write as _;

use evolvent_path::AxisLetter;

use crate::axes::{AxisValues, HomingMethod, tidy};
use crate::settings::{PathMode, Settings};

/// Names of an import's other files.
#[derive(Debug, Default)]
pub(crate) struct Names {
    pub(crate) tool_table: Option<String>,
    pub(crate) parameters: Option<String>,
    /// Tables of screw errors.
    pub(crate) screws: Vec<(AxisLetter, String)>,
}

pub(crate) fn machine(source: &str, settings: &Settings, axes: &[AxisValues], names: &Names) -> String {
    let mut out = String::new();
    let mut line = |text: String| {
        out.push_str(&text);
        out.push('\n');
    };
    let has_rotary = axes.iter().any(|axis| axis.letter.is_rotary());
    line(format!(
        "# From {} of LinuxCNC, by evolvent import.",
        one_line(source)
    ));
    line("# Check travels, limits and homing at low speed before the machine works.".to_owned());
    line(String::new());
    line(format!("name = {}", quoted(&settings.name)));
    if !settings.description.is_empty() {
        line(format!("description = {}", quoted(&settings.description)));
    }
    line(format!(
        "kind = {}",
        quoted(if settings.is_lathe { "lathe" } else { "mill" })
    ));
    line("increments_per_mm = 1000".to_owned());
    if has_rotary {
        line("increments_per_degree = 1000".to_owned());
    }
    match settings.rate_hz {
        Some(rate) => line(format!("rate = {}", tidy(rate))),
        None => line("rate = \"rational\"".to_owned()),
    }
    for axis in axes {
        line(String::new());
        axis_table(axis).into_iter().for_each(&mut line);
        let table = names.screws.iter().find(|(letter, _)| *letter == axis.letter);
        match (table, axis.screws.backlash) {
            (Some((_, name)), _) => line(format!("screw_table = {}", quoted(name))),
            (None, Some(backlash)) => {
                let unit = if axis.letter.is_rotary() { "deg" } else { "mm" };
                line(format!("backlash_{unit} = {}", tidy(backlash)));
            }
            (None, None) => {}
        }
    }
    for axis in axes {
        if let Some(table) = homing_table(axis) {
            line(String::new());
            table.into_iter().for_each(&mut line);
        }
    }
    for spindle in &settings.spindles {
        line(format!(
            "\n[[spindle]]\nnumber = {}\nmax_rpm = {}",
            spindle.number,
            tidy(spindle.max_rpm)
        ));
        if !spindle.reverse {
            line("reverse = false".to_owned());
        }
        if spindle.feedback {
            line("feedback = true".to_owned());
        }
    }
    if let Some(feed) = settings.max_feed_mm_s {
        line("\n[limits]".to_owned());
        line(format!("max_feed_mm_s = {}", tidy(feed)));
    }
    match settings.path {
        PathMode::Unknown => {}
        PathMode::Exact => line("\n[path]\nmode = \"exact\"".to_owned()),
        PathMode::Tolerance(mm) => line(format!(
            "\n[path]\nblend_tolerance_mm = {}",
            tidy(mm.clamp(1e-6, 100.0))
        )),
    }
    program_table(settings, names).into_iter().for_each(&mut line);
    out
}

fn axis_table(axis: &AxisValues) -> Vec<String> {
    let unit = if axis.letter.is_rotary() { "deg" } else { "mm" };
    let mut lines = vec![
        "[[axis]]".to_owned(),
        format!("letter = \"{}\"", axis.letter.letter()),
        if axis.is_unlimited {
            // LinuxCNC uses the sign of the word as the direction.
            "unlimited = \"sign\"".to_owned()
        } else {
            format!(
                "travel_min_{unit} = {}\ntravel_max_{unit} = {}",
                tidy(axis.travel.0),
                tidy(axis.travel.1)
            )
        },
        format!("max_velocity_{unit}_s = {}", tidy(axis.velocity)),
        format!("max_acceleration_{unit}_s2 = {}", tidy(axis.acceleration)),
        format!("max_jerk_{unit}_s3 = {}", tidy(axis.jerk)),
        format!("home_{unit} = {}", tidy(axis.home)),
    ];
    if let Some(error) = axis.following.0 {
        lines.push(format!("following_error_{unit} = {}", tidy(error)));
    }
    if let Some(time_ms) = axis.following.1 {
        lines.push(format!("following_time_ms = {}", tidy(time_ms)));
    }
    lines
}

fn homing_table(axis: &AxisValues) -> Option<Vec<String>> {
    let homing = axis.homing.as_ref()?;
    let unit = if axis.letter.is_rotary() { "deg" } else { "mm" };
    let mut lines = vec![
        "[[homing]]".to_owned(),
        format!("axis = \"{}\"", axis.letter.letter()),
        format!("order = {}", homing.order),
    ];
    let method = match homing.method {
        HomingMethod::Switch => None,
        HomingMethod::SwitchIndex { .. } => Some("switch-index"),
        HomingMethod::Index => Some("index"),
        HomingMethod::Absolute => Some("absolute"),
    };
    lines.extend(method.map(|method| format!("method = {}", quoted(method))));
    if homing.method == HomingMethod::Absolute {
        return Some(lines);
    }
    let towards = if homing.is_negative {
        "negative"
    } else {
        "positive"
    };
    lines.extend([
        format!("towards = {}", quoted(towards)),
        format!("search_{unit}_s = {}", tidy(homing.search)),
        format!("latch_{unit}_s = {}", tidy(homing.latch)),
    ]);
    if homing.method == HomingMethod::Switch {
        lines.push(format!("switch_{unit} = {}", tidy(homing.reference)));
        return Some(lines);
    }
    lines.extend([
        format!("index_{unit} = {}", tidy(homing.reference)),
        format!("index_within_{unit} = {}", tidy(homing.within)),
    ]);
    if (homing.method == HomingMethod::SwitchIndex { when_opening: true }) {
        lines.push("index_edge = \"opening\"".to_owned());
    }
    Some(lines)
}

fn program_table(settings: &Settings, names: &Names) -> Vec<String> {
    let mut lines = Vec::new();
    for (key, is_inch) in [
        ("start_unit", settings.starts_in_inches),
        ("parameter_unit", settings.is_in_inches),
    ] {
        lines.extend(is_inch.then(|| format!("{key} = \"inch\"")));
    }
    lines.extend((settings.start_plane.iter()).map(|plane| format!("start_plane = {}", quoted(plane))));
    if settings.starts_in_diameters {
        lines.push("start_x = \"diameter\"".to_owned());
    }
    for (key, name) in [
        ("tool_table", &names.tool_table),
        ("parameters", &names.parameters),
    ] {
        lines.extend(name.iter().map(|name| format!("{key} = {}", quoted(name))));
    }
    if !settings.subroutines.is_empty() {
        let folders = settings
            .subroutines
            .iter()
            .map(|folder| quoted(&folder.to_string_lossy()));
        lines.push(format!(
            "subroutines = [{}]",
            folders.collect::<Vec<_>>().join(", ")
        ));
    }
    if let Some((folder, codes)) = &settings.user_codes {
        let codes: Vec<String> = codes.iter().map(u32::to_string).collect();
        lines.push(format!("user_codes = [{}]", codes.join(", ")));
        lines.push(format!(
            "user_code_folder = {}",
            quoted(&folder.to_string_lossy())
        ));
    }
    if !lines.is_empty() {
        lines.insert(0, "\n[program]".to_owned());
    }
    lines
}

/// A basic string of TOML.
fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' | '\\' => out.extend(['\\', c]),
            c if c.is_control() => {
                let _infallible = write!(out, "\\u{:04X}", u32::from(c));
            }
            c => out.push(c),
        }
    }
    out.push('"');
    out
}

/// A text that cannot end a comment.
fn one_line(text: &str) -> String {
    text.chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect()
}
