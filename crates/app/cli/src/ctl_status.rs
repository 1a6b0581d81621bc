//! The status, as text and as JSON.

use std::io::{self, Write};

use evolvent_bus::{
    ACTIVITIES, JOB_RESULTS, MACHINE_STATES, MODES, STATES, SpindleReading, Status, switches,
};
use evolvent_control::Alarm;
use evolvent_path::{AxisLetter, AxisMask};
use serde_json::{Map, Value, json};

/// G7 in a status.
const G7: u32 = 70;

fn name(list: &[(&str, u32)], number: u32) -> String {
    list.iter()
        .find(|(_, known)| *known == number)
        .map_or_else(|| format!("unknown {number}"), |(name, _)| name.to_lowercase())
}

/// G codes in force, as programs write them.
fn modal_codes(status: &Status) -> Vec<String> {
    status
        .modal
        .iter()
        .filter(|code| **code > 0)
        .map(|code| match code % 10 {
            0 => format!("G{}", code / 10),
            tenth => format!("G{}.{tenth}", code / 10),
        })
        .collect()
}

/// Whether the program writes X as a diameter.
pub(crate) fn is_diameter(status: &Status) -> bool {
    status.modal.contains(&G7)
}

fn axis_letters(mask: u32, axes: &str) -> String {
    axes.chars()
        .filter(|letter| {
            AxisLetter::from_letter(*letter)
                .is_some_and(|axis| AxisMask::from_bits(mask).contains(axis.index()))
        })
        .collect()
}

/// State of the probe; `None` if it is unknown or there is no probe.
pub(crate) fn probe_state(status: &Status) -> Option<&'static str> {
    match status.switches & (switches::PROBE_OPEN | switches::PROBE_TRIPPED) {
        switches::PROBE_OPEN => Some("open"),
        switches::PROBE_TRIPPED => Some("tripped"),
        _ => None,
    }
}

/// Whether a tool change was interrupted, so that `tool` is the tool before it.
pub(crate) fn is_tool_unknown(status: &Status) -> bool {
    status.switches & switches::TOOL_UNKNOWN != 0
}

fn tool_change(status: &Status) -> &'static str {
    match status.tool_change {
        0 => "none",
        1 => "operator",
        _ => "program",
    }
}

/// All fields; values per axis are keyed by axis.
pub(crate) fn status_to_json(status: &Status, axes: &str) -> Value {
    let by_axis = |values: &[f64]| {
        let pairs = axes.chars().filter_map(|letter| {
            let axis = AxisLetter::from_letter(letter)?;
            Some((letter.to_string(), json!(values.get(axis.index()))))
        });
        Value::Object(pairs.collect::<Map<_, _>>())
    };
    let has_feedback = status.has_feedback();
    let mut whole = json!({
        "machine": name(&MACHINE_STATES, status.machine_state),
        "mode": name(&MODES, status.mode),
        "activity": name(&ACTIVITIES, status.activity),
        "state": name(&STATES, status.state),
        "job": status.job,
        "job_result": name(&JOB_RESULTS, status.job_result),
        "program": status.program_name(),
        "line": status.line,
        "parts": status.parts,
        "program_time_s": status.program_time_s,
        "program_held_s": status.program_held_s,
        "homed": axis_letters(status.homed_mask, axes),
        "position_machine": by_axis(&status.position_machine),
        "position_work": by_axis(&status.position_work),
        "distance_to_go": by_axis(&status.distance_to_go),
        "velocity": by_axis(&status.velocity),
        "work_offset": by_axis(&status.work_offset),
        "tool_offset": by_axis(&status.tool_offset),
        "home_offset": by_axis(&status.home_offset),
        "position_actual": has_feedback.then(|| by_axis(&status.position_actual)),
        "following_error": has_feedback.then(|| by_axis(&status.following_error)),
        "feedback_age_ns": has_feedback.then_some(status.feedback_age_ns),
        "enabled": status.enabled_mask,
        "power": status.power,
        "tool_unknown": is_tool_unknown(status),
    });
    let follows_clock = status.phase_error_max_ns > 0.0;
    let rest = json!({
        "path_mm": status.path_mm,
        "path_to_go_mm": status.path_to_go_mm,
        "longest_stop_mm": (status.longest_stop_mm > 0.0).then_some(status.longest_stop_mm),
        "longest_stop_s": (status.longest_stop_mm > 0.0).then_some(status.longest_stop_s),
        "longest_stop_line": (status.longest_stop_mm > 0.0).then_some(status.longest_stop_line),
        "feed_mm_s": status.feed_mm_s,
        "feed_programmed_mm_s": status.feed_programmed_mm_s,
        "feed_override": status.override_ratio,
        "rapid_override": status.rapid_override_ratio,
        "spindle_override": status.spindle_override_ratio,
        "spindle_rpm": status.spindle_rpm,
        "coolant": status.coolant,
        "tool": status.tool,
        "tool_change": tool_change(status),
        "tool_wanted": (status.tool_change != 0).then_some(status.tool_wanted),
        "work_system": format!("G{}", f64::from(status.work_system) / 10.0),
        "modal": modal_codes(status),
        "single_step": status.switches & switches::SINGLE_STEP != 0,
        "optional_stop": status.switches & switches::OPTIONAL_STOP != 0,
        "block_delete": status.switches & switches::BLOCK_DELETE != 0,
        "hold": status.switches & switches::HOLD != 0,
        "chain_open": status.switches & switches::CHAIN_OPEN != 0,
        "input_wait": status.switches & switches::INPUT_WAIT != 0,
        "probe": probe_state(status),
        "alarms": status.listed_alarms(),
        "alarm_text": status.alarm_sentence(),
        "message": status.operator_message(),
        "cycles": status.cycles,
        "period_ns": status.period_ns,
        "late_cycles": status.late_cycles,
        "dropped_records": status.dropped_records,
        "dropped_setpoints": status.dropped_setpoints,
        "commands_accepted": status.commands_accepted,
        "commands_rejected": status.commands_rejected,
        "setpoint_subscribers": status.setpoint_subscribers,
        "wake_lateness_p50_ns": status.wake_lateness_p50_ns,
        "wake_lateness_p999_ns": status.wake_lateness_p999_ns,
        "wake_lateness_max_ns": status.wake_lateness_max_ns,
        "work_p50_ns": status.work_p50_ns,
        "work_p999_ns": status.work_p999_ns,
        "work_max_ns": status.work_max_ns,
    });
    let clock_and_away = json!({
        "clock_drift_ppm": follows_clock.then_some(status.clock_drift_ppm),
        "phase_error_max_ns": follows_clock.then_some(status.phase_error_max_ns),
        "spindles": spindles(status),
        "away": axis_letters(status.away_mask, axes),
        "away_parts": status.away_parts,
        "retraced": status.retraced != 0,
        "retrace_blocks": status.retrace_blocks,
        "handwheel": axis_letters(status.handwheel_mask, axes),
        "handwheel_enabled": status.handwheel_enabled != 0,
        "handwheel_step": status.handwheel_step,
    });
    for part in [rest, clock_and_away] {
        if let (Value::Object(whole), Value::Object(part)) = (&mut whole, part) {
            whole.extend(part);
        }
    }
    whole
}

/// A page of text.
pub(crate) fn write_status(
    out: &mut dyn Write,
    status: &Status,
    axes: &str,
    machine: &str,
) -> io::Result<()> {
    writeln!(
        out,
        "{machine}: {}, {}, {}",
        name(&MACHINE_STATES, status.machine_state),
        name(&MODES, status.mode),
        name(&STATES, status.state)
    )?;
    if status.job > 0 {
        let job = match status.activity {
            0 => format!("ended: {}", name(&JOB_RESULTS, status.job_result)),
            activity => format!("running: {}", name(&ACTIVITIES, activity)),
        };
        write!(out, "  job {} {job}", status.job)?;
        // Jogs, homing and motion after a program belong to no line.
        match status.line {
            0 => writeln!(out)?,
            line => writeln!(out, ", line {line}")?,
        }
    }
    if !status.program_name().is_empty() {
        writeln!(out, "  program {}", status.program_name())?;
    }
    write_axes(out, status, axes)?;
    write_motion(out, status)?;
    write_waits(out, status, axes)?;
    if status.has_feedback() {
        writeln!(
            out,
            "  drives replied {:.1} ms ago",
            status.feedback_age_ns as f64 * 1e-6
        )?;
    }
    writeln!(
        out,
        "  setpoints {}, late {}, lost {}; commands accepted {}, rejected {}",
        status.cycles,
        status.late_cycles,
        status.dropped_setpoints,
        status.commands_accepted,
        status.commands_rejected
    )?;
    write_messages(out, status)
}

fn write_axes(out: &mut dyn Write, status: &Status, axes: &str) -> io::Result<()> {
    writeln!(out)?;
    writeln!(
        out,
        "  axis        machine           work          to go         offset  homed"
    )?;
    for axis in axes.chars().filter_map(AxisLetter::from_letter) {
        let i = axis.index();
        // As on the screen, X is the value that programs use.
        let (mark, factor) = match axis {
            AxisLetter::X if is_diameter(status) => ('\u{2300}', 2.0),
            _ => (' ', 1.0),
        };
        writeln!(
            out,
            "  {} {mark}  {:>14.4} {:>14.4} {:>14.4} {:>14.4}  {}",
            axis.letter(),
            factor * status.position_machine[i],
            factor * status.position_work[i],
            factor * status.distance_to_go[i],
            factor * (status.work_offset[i] + status.tool_offset[i]),
            if AxisMask::from_bits(status.homed_mask).contains(i) {
                "yes"
            } else {
                "no"
            }
        )?;
    }
    Ok(())
}

/// The spindles as JSON.
pub(crate) fn spindles(status: &Status) -> Vec<Value> {
    let each = status.spindles().map(|spindle| {
        json!({
            "number": spindle.number,
            "command_rpm": spindle.command_rpm,
            "measured_rpm": spindle.measured_rpm,
            "override_counts": spindle.counts_override,
        })
    });
    each.collect()
}

/// The spindles as text. A single spindle without measurement shows only its command.
pub(crate) fn spindle_words(status: &Status, separator: &str) -> String {
    let readings: Vec<SpindleReading> = status.spindles().collect();
    let is_single = readings.len() == 1;
    let each = readings.iter().map(|spindle| {
        let name = if is_single {
            String::new()
        } else {
            format!(" {}", spindle.number)
        };
        let measured = spindle
            .measured_rpm
            .map_or_else(String::new, |rpm| format!(" (measured {rpm:.0})"));
        format!("spindle{name} {:.0} rpm{measured}", spindle.command_rpm)
    });
    each.collect::<Vec<_>>().join(separator)
}

/// The spindles for which the program has switched the override off.
pub(crate) fn uncounted_override(status: &Status) -> String {
    let readings: Vec<SpindleReading> = status.spindles().collect();
    let off: Vec<String> = readings
        .iter()
        .filter(|spindle| !spindle.counts_override)
        .map(|spindle| spindle.number.to_string())
        .collect();
    match off.len() {
        0 => String::new(),
        count if count == readings.len() => " (switched off by the program)".to_owned(),
        _ => format!(" (switched off by the program for spindle {})", off.join(", ")),
    }
}

fn write_motion(out: &mut dyn Write, status: &Status) -> io::Result<()> {
    writeln!(
        out,
        "\n  feed {:.1} of {:.1} mm/min; overrides: feed {:.0} %, rapid {:.0} %, spindle {:.0} %{}",
        60.0 * status.feed_mm_s,
        60.0 * status.feed_programmed_mm_s,
        100.0 * status.override_ratio,
        100.0 * status.rapid_override_ratio,
        100.0 * status.spindle_override_ratio,
        uncounted_override(status)
    )?;
    if status.longest_stop_mm > 0.0 {
        writeln!(
            out,
            "  a hold stops within {:.3} mm and {:.0} ms so far: longest on line {}",
            status.longest_stop_mm,
            1e3 * status.longest_stop_s,
            status.longest_stop_line
        )?;
    }
    if status.program_time_s > 0.0 {
        writeln!(
            out,
            "  parts {}, program {}, of which held {}",
            status.parts,
            clock_time(status.program_time_s),
            clock_time(status.program_held_s)
        )?;
    }
    writeln!(
        out,
        "  tool {}{}, {}, {}",
        status.tool,
        if is_tool_unknown(status) {
            ", or another, because a tool change was interrupted: set it by MDI, for example M61 Q3"
        } else {
            ""
        },
        spindle_words(status, ", "),
        modal_codes(status).join(" ")
    )
}

/// What the machine waits for, and the probe.
fn write_waits(out: &mut dyn Write, status: &Status, axes: &str) -> io::Result<()> {
    if status.switches & switches::CHAIN_OPEN != 0 {
        writeln!(out, "  the emergency-stop chain is open, or no bridge reads it")?;
    }
    if status.switches & switches::INPUT_WAIT != 0 {
        writeln!(
            out,
            "  waits for an input or a spindle, and continues automatically"
        )?;
    }
    if status.away_parts > 0 {
        writeln!(
            out,
            "  away from the held program: {} part(s) of the way back; `evolvent ctl return` moves the \
             axes back",
            status.away_parts
        )?;
    }
    if status.handwheel_mask != 0 {
        writeln!(
            out,
            "  the handwheel moves {} by {} per detent{}",
            axis_letters(status.handwheel_mask, axes),
            status.handwheel_step,
            if status.handwheel_enabled == 0 {
                ", while its button is pressed"
            } else {
                ""
            }
        )?;
    }
    if let Some(state) = probe_state(status) {
        writeln!(out, "  probe {state}")?;
    }
    match (status.tool_change, status.tool_wanted) {
        (0, _) => {}
        (1, 0) => writeln!(
            out,
            "  waits for the operator: take the tool out of the spindle, then `evolvent ctl loaded`"
        )?,
        (1, tool) => writeln!(
            out,
            "  waits for the operator: put tool {tool} into the spindle, then `evolvent ctl loaded`"
        )?,
        (_, tool) => writeln!(out, "  the changer puts tool {tool} into the spindle")?,
    }
    Ok(())
}

/// The program's message and the alarms.
fn write_messages(out: &mut dyn Write, status: &Status) -> io::Result<()> {
    if !status.operator_message().is_empty() {
        writeln!(out, "  message: {}", status.operator_message())?;
    }
    for &number in status.listed_alarms() {
        let known = Alarm::from_number(number).map_or("unknown", |alarm| alarm.sentence());
        // The status has the text of the cause, which is listed first.
        let text = if status.listed_alarms().first() == Some(&number) && !status.alarm_sentence().is_empty() {
            status.alarm_sentence()
        } else {
            known
        };
        writeln!(out, "  alarm {number}: {text}")?;
    }
    Ok(())
}

/// Hours, minutes and the nearest second, as on the screen.
fn clock_time(time_s: f64) -> String {
    let seconds = time_s.max(0.0).round() as u64;
    format!("{}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_spindle_shows_command_speed_and_override() {
        let mut status = Status {
            spindle_rpm: 250.0,
            ..Status::default()
        };
        // A core that does not report each spindle.
        assert_eq!(spindle_words(&status, ", "), "spindle 250 rpm");
        status.spindle_mask = 1;
        status.spindle_command_rpm[0] = -300.0;
        status.spindle_measured_rpm = [f32::NAN; 4];
        assert_eq!(spindle_words(&status, ", "), "spindle -300 rpm");
        status.spindle_override_off_mask = 1;
        assert_eq!(uncounted_override(&status), " (switched off by the program)");
        status.spindle_mask = 0b101;
        status.spindle_measured_rpm[2] = 599.6;
        status.spindle_command_rpm[2] = 600.0;
        assert_eq!(
            spindle_words(&status, ", "),
            "spindle 0 -300 rpm, spindle 2 600 rpm (measured 600)"
        );
        assert_eq!(
            uncounted_override(&status),
            " (switched off by the program for spindle 0)"
        );
        let listed = spindles(&status);
        assert_eq!(
            (&listed[0]["measured_rpm"], &listed[1]["number"]),
            (&Value::Null, &json!(2))
        );
        assert_eq!(listed[0]["override_counts"], false);
    }

    #[test]
    fn g7_shows_x_as_diameter_in_text_and_radius_in_json() {
        let mut status = Status::default();
        status.position_machine[0] = -12.5;
        status.position_work[0] = 20.25;
        status.distance_to_go[0] = 1.5;
        (status.work_offset[0], status.tool_offset[0]) = (3.0, 0.5);
        status.position_work[2] = 7.0;
        let row = |status: &Status, letter: char| {
            let mut page = Vec::new();
            write_status(&mut page, status, "XZ", "lathe").unwrap();
            let page = String::from_utf8(page).unwrap();
            let row = page.lines().find(|line| line.trim_start().starts_with(letter));
            let words: Vec<String> = row.unwrap().split_whitespace().map(str::to_owned).collect();
            words.join(" ")
        };
        status.modal[..2].copy_from_slice(&[180, 80]);
        assert_eq!(row(&status, 'X'), "X -12.5000 20.2500 1.5000 3.5000 no");
        status.modal[1] = 70;
        assert_eq!(row(&status, 'X'), "X \u{2300} -25.0000 40.5000 3.0000 7.0000 no");
        assert_eq!(row(&status, 'Z'), "Z 0.0000 7.0000 0.0000 0.0000 no");
        assert_eq!(status_to_json(&status, "XZ")["position_work"]["X"], json!(20.25));
    }

    #[test]
    fn a_status_is_complete_and_keyed_by_axis_letter() {
        let mut status = Status {
            machine_state: 2,
            mode: 1,
            homed_mask: 0b101,
            work_system: 591,
            ..Status::default()
        };
        status.position_machine[2] = -7.5;
        (status.tool_change, status.tool_wanted) = (1, 4);
        assert_eq!(status_to_json(&status, "XZ")["longest_stop_mm"], Value::Null);
        (
            status.longest_stop_mm,
            status.longest_stop_s,
            status.longest_stop_line,
        ) = (3.25, 0.045, 17);
        (status.parts, status.program_time_s, status.program_held_s) = (12, 3725.6, 9.9);
        status.modal[..2].copy_from_slice(&[170, 591]);
        status.feedback_age_ns = u64::MAX;
        status.push_alarm(406);
        status.push_alarm(418);
        status.set_alarm_text("axis X");
        let value = status_to_json(&status, "XZ");
        assert_eq!(value["machine"], "on");
        assert_eq!(value["mode"], "manual");
        assert_eq!(value["homed"], "XZ");
        assert_eq!(value["position_machine"], json!({"X": 0.0, "Z": -7.5}));
        assert_eq!(value["modal"], json!(["G17", "G59.1"]));
        assert_eq!(value["work_system"], "G59.1");
        assert_eq!(
            (&value["tool_change"], &value["tool_wanted"]),
            (&json!("operator"), &json!(4))
        );
        assert_eq!(value["feedback_age_ns"], Value::Null);
        assert_eq!(
            (&value["longest_stop_mm"], &value["longest_stop_line"]),
            (&json!(3.25), &json!(17))
        );
        let mut page = Vec::new();
        write_status(&mut page, &status, "XZ", "mill").unwrap();
        let page = String::from_utf8(page).unwrap();
        assert!(
            page.contains("-7.5000")
                && page.contains("alarm 406: axis X")
                && !page.contains("alarm 418: axis X"),
            "{page}"
        );
        assert!(page.contains("a hold stops within 3.250 mm and 45 ms so far: longest on line 17"));
        assert!(page.contains("put tool 4 into the spindle"), "{page}");
        assert!(
            page.contains("parts 12, program 1:02:06, of which held 0:00:10"),
            "{page}"
        );
        assert!(page.contains("tool 0, spindle"), "{page}");
        assert_eq!(value["tool_unknown"], false);
    }

    #[test]
    fn a_tool_that_is_not_known_is_told_so() {
        let status = Status {
            tool: 7,
            switches: switches::TOOL_UNKNOWN,
            ..Status::default()
        };
        assert_eq!(status_to_json(&status, "XZ")["tool_unknown"], true);
        let mut page = Vec::new();
        write_status(&mut page, &status, "XZ", "mill").unwrap();
        let page = String::from_utf8(page).unwrap();
        assert!(
            page.contains("tool 7, or another, because a tool change was interrupted: set it by MDI"),
            "{page}"
        );
    }
}
