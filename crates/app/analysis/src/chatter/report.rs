//! The answer as text and as JSON.

use std::fmt::Write as _;

use evolvent_chatter::{
    AssessedCycle, Assessment, Case, ChatterKind, Cycle, DropReason, Fate, FoundBy, Measure, ScanEnd,
    StabilityVerdict,
};
use serde_json::{Value, json};

use super::answer::Answer;
use super::lobes::{ExactLimit, LobeAnswer, LobePoint};

pub(crate) fn text(case: &Case, oscillation: Option<&Answer>, lobes: &[LobeAnswer]) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = oscillation.map(|answer| oscillation_text(&mut text, case, answer));
    for answer in lobes {
        let _ = lobe_text(&mut text, case, answer);
    }
    text
}

fn rpm(answer: &Answer, speed_m_min: f64) -> Option<f64> {
    let diameter = answer.asked.diameter_mm?;
    Some(1000.0 * speed_m_min / (std::f64::consts::PI * diameter))
}

fn speed(answer: &Answer, speed_m_min: f64) -> String {
    match rpm(answer, speed_m_min) {
        Some(rpm) => format!("{speed_m_min:.1} m/min ({rpm:.0} rpm)"),
        None => format!("{speed_m_min:.1} m/min"),
    }
}

fn sentence(assessment: &Assessment) -> &'static str {
    let grows = assessment.equilibrium.growth_per_s() > 0.0;
    match (assessment.verdict, grows, assessment.can_leave()) {
        (StabilityVerdict::Stable, ..) => "stable: every disturbance within the model dies out",
        (StabilityVerdict::Bistable, _, false) => {
            "bistable: steady until an impulse beyond the unstable cycle sets it vibrating"
        }
        (StabilityVerdict::Bistable, _, true) => {
            "bistable: steady until an impulse sets it vibrating, and a large one leaves the model"
        }
        (StabilityVerdict::SelfExcited, _, false) => "vibrates by itself",
        (StabilityVerdict::SelfExcited, _, true) => {
            "vibrates by itself, and a large impulse leaves the model"
        }
        (StabilityVerdict::OutOfModel, true, _) => {
            "leaves the model by itself: vibration grows until the speed falls to the floor or contact is \
             lost"
        }
        (StabilityVerdict::OutOfModel, false, false) if assessment.is_in_doubt() => {
            "not known to be stable: the balance has a vibration that integration in time does not confirm; \
             an impulse may set it going"
        }
        (StabilityVerdict::OutOfModel, false, false) if assessment.has_untested_direction() => {
            "not known to be stable: in some direction even the smallest impulse stops the cutting speed or \
             lifts the edge off, so no disturbance could be followed"
        }
        (StabilityVerdict::OutOfModel, false, _) => {
            "leaves the model after an impulse: steady until then, but beyond the unstable cycle vibration \
             grows until the \
             speed falls to the floor or contact is lost"
        }
    }
}

/// A length in mm as in a drawing: to 0.1 um, without trailing zeros.
fn length(mm: f64) -> String {
    let text = format!("{mm:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn end_word(end: ScanEnd) -> &'static str {
    match end {
        ScanEnd::SpeedFloor => "speed-floor",
        ScanEnd::ContactLost => "contact-lost",
        ScanEnd::Rest => "rest",
        ScanEnd::NotFound => "not-found",
        ScanEnd::TooLong => "too-long",
        ScanEnd::NoBranch => "no-branch",
    }
}

fn oscillation_text(text: &mut String, case: &Case, answer: &Answer) -> std::fmt::Result {
    let tool = &answer.tool;
    writeln!(text, "{}: {}", case.name, sentence(&answer.assessment))?;
    writeln!(
        text,
        "  cut             {}, {} mm deep, {} mm/rev",
        speed(answer, tool.speed_m_min),
        length(tool.depth_mm),
        length(tool.feed_mm_rev)
    )?;
    let rest = &answer.assessment.equilibrium;
    let [v1, v2] = rest.deflection_m.map(|deflection| 1e3 * deflection);
    writeln!(
        text,
        "  steady cut      force {:.1} N, deflections V1 {v1:.4} mm, V2 {v2:.4} mm",
        rest.force_n
    )?;
    for mode in &rest.modes {
        let word = if mode.growth_per_s > 0.0 {
            "grows"
        } else {
            "dies out"
        };
        writeln!(
            text,
            "  small vibration at {:.2} Hz {word} with {:+.2} 1/s",
            mode.frequency_hz, mode.growth_per_s
        )?;
    }
    for (k, known) in answer.assessment.cycles.iter().enumerate() {
        cycle_text(text, k + 1, known)?;
    }
    evidence_text(text, &answer.assessment)?;
    if let Some(transient) = &answer.transient {
        text.push_str(&transient.text());
    }
    if answer.assessment.verdict != StabilityVerdict::Stable {
        // Rounded away from the stability limit, so that the printed value is stable.
        let rounded = |at: f64, round: fn(f64) -> f64| {
            let rpm = rpm(answer, at).map_or(String::new(), |rpm| format!(" ({:.0} rpm)", round(rpm)));
            format!("{:.1} m/min{rpm}", 0.1 * round(10.0 * at))
        };
        let [slower, faster] = answer.stable_m_min;
        let slower = slower.map(|at| rounded(at, f64::floor));
        let found: Vec<String> = slower
            .into_iter()
            .chain(faster.map(|at| rounded(at, f64::ceil)))
            .collect();
        if found.is_empty() {
            writeln!(
                text,
                "  nearest stable speed: none found; change depth, feed or tool"
            )?;
        } else {
            writeln!(text, "  nearest stable speeds: {}", found.join(" and "))?;
        }
    }
    if let Some(fits) = &answer.fits {
        fits_text(text, answer, fits)?;
    }
    assumptions_text(text, &answer.assumptions)
}

/// Appends the range examined and what remains unknown.
fn evidence_text(text: &mut String, assessment: &Assessment) -> std::fmt::Result {
    for dropped in &assessment.dropped {
        let why = match &dropped.reason {
            // The identical cycle is already reported.
            DropReason::Duplicate => continue,
            DropReason::Landed => "in time it is another one".to_owned(),
            DropReason::Outside => "in time it lies beyond the model".to_owned(),
            DropReason::Rest => "in time it leads back to the steady cut".to_owned(),
            DropReason::Refused(error) => format!("it does not close in time: {error}"),
        };
        writeln!(
            text,
            "  dropped: a cycle of the balance at {:.2} Hz, V2 {} mm: {why}",
            dropped.cycle.frequency_hz,
            length(1e3 * dropped.cycle.amplitude_m(1))
        )?;
    }
    for branch in assessment.branches.iter().filter(|branch| !branch.end.is_known()) {
        writeln!(
            text,
            "  not known: the branch at {:.2} Hz was followed to {} mm only ({}); larger cycles on it may \
             be missing",
            branch.mode.frequency_hz,
            branch
                .points
                .last()
                .map_or("0".to_owned(), |point| length(1e3 * point.amplitude_m)),
            end_word(branch.end)
        )?;
    }
    let count = |is: fn(&Fate) -> bool| {
        assessment
            .disturbances
            .iter()
            .filter(|kick| is(&kick.fate))
            .count()
    };
    let each = [
        (count(|fate| *fate == Fate::DiesOut), "die out"),
        (
            count(|fate| matches!(fate, Fate::Settles(_))),
            "settle on a cycle",
        ),
        (count(|fate| *fate == Fate::GoesOn), "continue without a cycle"),
        (count(|fate| *fate == Fate::StillGrows), "still grow"),
        (count(|fate| *fate == Fate::Leaves), "leave the model"),
        (
            count(|fate| *fate == Fate::BeginsOutside),
            "begin outside the model at any size",
        ),
    ];
    let said: Vec<String> = each
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{count} {what}"))
        .collect();
    if said.is_empty() {
        return Ok(());
    }
    writeln!(text, "  disturbances followed in time: {}", said.join(", "))
}

fn cycle_text(text: &mut String, number: usize, known: &AssessedCycle) -> std::fmt::Result {
    let (cycle, exact) = (&known.cycle, &known.verified);
    writeln!(
        text,
        "  cycle {number}, {}: {:.4} Hz, amplitudes V1 {:.6} mm, V2 {:.6} mm{}",
        if exact.stable() { "stable" } else { "unstable" },
        cycle.frequency_hz,
        1e3 * cycle.amplitude_m(0),
        1e3 * cycle.amplitude_m(1),
        match known.found_by {
            FoundBy::Scan => "",
            FoundBy::Neighbour => " (continued from a neighbouring cut)",
            FoundBy::Disturbance => " (found by following disturbances)",
        }
    )?;
    writeln!(
        text,
        "    speed {:.1} to {:.1} m/min, depth {:.3} to {:.3} mm{}",
        cycle.speed_m_min[0],
        cycle.speed_m_min[1],
        cycle.depth_mm[0],
        cycle.depth_mm[1],
        if cycle.free_part > 0.0 {
            format!(", out of contact {:.0} % of the time", 100.0 * cycle.free_part)
        } else {
            String::new()
        }
    )?;
    writeln!(
        text,
        "    in time: {:.4} Hz, V2 {:.6} mm (off by {:.1e} and {:.1e}); largest multiplier {:.4}",
        exact.frequency_hz,
        1e3 * exact.amplitude_m[1],
        exact.frequency_error.abs(),
        exact.amplitude_error.abs(),
        exact.multipliers[0].norm()
    )
}

fn fits_text(
    text: &mut String,
    answer: &Answer,
    fits: &[(Measure, Vec<evolvent_chatter::Fit>)],
) -> std::fmt::Result {
    for (measure, fits) in fits {
        let what = match measure {
            Measure::Residual => "squared residual",
            Measure::Normalised => "normalised residual",
        };
        let count = answer.asked.harmonics.min(16);
        writeln!(
            text,
            "  least squares in three stages, {what}, {count} harmonics:"
        )?;
        if fits.is_empty() {
            writeln!(text, "    no minimum but rest")?;
        }
        for fit in fits {
            let word = match fit.normalised {
                _ if fit.reaches_floor => "beyond the model",
                size if size < 1e-5 => "a cycle",
                size if size < 1e-4 => "not clear",
                _ => "false",
            };
            writeln!(
                text,
                "    {:.4} Hz, V1 {:.6} mm, V2 {:.6} mm, residual {:.2e}: {word}",
                fit.frequency_hz,
                1e3 * fit.amplitude_m[0],
                1e3 * fit.amplitude_m[1],
                fit.normalised
            )?;
        }
    }
    writeln!(
        text,
        "    (five harmonics or more tell cycles, below 1e-5, from false minima, above 1e-4)"
    )
}

fn assumptions_text(text: &mut String, assumptions: &[String]) -> std::fmt::Result {
    writeln!(text, "  assumed:")?;
    for line in assumptions {
        writeln!(text, "    - {line}")?;
    }
    Ok(())
}

fn lobe_text(text: &mut String, case: &Case, answer: &LobeAnswer) -> std::fmt::Result {
    writeln!(text, "{}: stability lobes, {}", case.name, answer.kind)?;
    // The zero-order solution is optimistic; of several modes the first has the lowest limit.
    let (first, next) = if answer.kind == "milling" {
        (
            "zero order: minimum limit",
            "zero order: minimum limit of another lobe",
        )
    } else {
        ("stable at every speed below", "minimum limit of another mode")
    };
    for (k, limit) in answer.minima.iter().enumerate() {
        let lobes: Vec<String> = (0..4)
            .map(|waves| format!("{:.0}", limit.speed_rpm(waves, answer.cuts_per_rev)))
            .collect();
        writeln!(
            text,
            "  {} {:.4} mm, at {:.3} Hz; worst at {} rpm and so on",
            if k == 0 { first } else { next },
            1e3 * limit.depth_m,
            limit.frequency_hz,
            lobes.join(", ")
        )?;
    }
    let order = |a: &&LobePoint, b: &&LobePoint| {
        let depth = |point: &LobePoint| point.limit_m().unwrap_or(answer.most_m);
        depth(a).total_cmp(&depth(b))
    };
    let ends = [
        ("minimum limit", answer.points.iter().min_by(order)),
        ("deepest stable cut", answer.points.iter().max_by(order)),
    ];
    for (what, point) in ends {
        let Some(point) = point else { continue };
        let [from, to] = case.lobes.speed_rpm;
        let depth = match point.limit_m() {
            Some(depth) if depth < answer.most_m => format!("{:.3} mm", 1e3 * depth),
            _ => format!("more than {:.3} mm", 1e3 * answer.most_m),
        };
        writeln!(
            text,
            "  {what} from {from:.0} to {to:.0} rpm: {depth} at {:.0} rpm{} ({})",
            point.speed_rpm,
            match point.chatter() {
                Some((ChatterKind::Flip, frequency)) =>
                    format!(", beyond it period doubling (flip) at {frequency:.1} Hz"),
                Some((_, frequency)) => format!(", beyond it chatter (Hopf) at {frequency:.1} Hz"),
                None => String::new(),
            },
            method(answer, point)
        )?;
    }
    for note in &answer.notes {
        writeln!(text, "  note: {note}")?;
    }
    assumptions_text(text, &answer.assumptions)
}

/// The method of a decisive limit.
fn method(answer: &LobeAnswer, point: &LobePoint) -> &'static str {
    match (point.is_exact(), answer.exact) {
        (true, _) => "delay equation",
        (false, true) => "zero order",
        (false, false) => "frequency domain",
    }
}

pub(crate) fn json(case: &Case, oscillation: Option<&Answer>, lobes: &[LobeAnswer]) -> Value {
    json!({
        "case": case.name,
        "description": case.description,
        "oscillation": oscillation.map(oscillation_json),
        "lobes": lobes.iter().map(lobe_json).collect::<Vec<_>>(),
    })
}

fn cycle_json(known: &AssessedCycle) -> Value {
    let (cycle, exact): (&Cycle, _) = (&known.cycle, &known.verified);
    let relative = |coordinate: usize| {
        let harmonics = &cycle.harmonics_m[coordinate];
        let first = cycle.amplitude_m(coordinate);
        harmonics
            .iter()
            .skip(1)
            .map(|value| value.norm() / first)
            .collect::<Vec<_>>()
    };
    let verified = json!({
        "frequency_hz": exact.frequency_hz,
        "amplitude_mm": exact.amplitude_m.map(|value| 1e3 * value),
        "mean_mm": exact.mean_m.map(|value| 1e3 * value),
        "half_peak_to_peak_mm": exact.half_peak_to_peak_m.map(|value| 1e3 * value),
        "multipliers": exact.multipliers.map(|value| [value.re, value.im]),
        "trivial_multiplier_error": exact.trivial_error,
        "closure": exact.closure,
        "amplitude_error": exact.amplitude_error,
        "frequency_error": exact.frequency_error,
    });
    json!({
        "stable": exact.stable(),
        "found_by": match known.found_by {
            FoundBy::Scan => "scan",
            FoundBy::Neighbour => "neighbour",
            FoundBy::Disturbance => "disturbance",
        },
        "frequency_hz": cycle.frequency_hz,
        "amplitude_mm": [1e3 * cycle.amplitude_m(0), 1e3 * cycle.amplitude_m(1)],
        "mean_mm": [1e3 * cycle.mean_m(0), 1e3 * cycle.mean_m(1)],
        "phase_deg": cycle.phase_rad().to_degrees(),
        "harmonics_v1": relative(0),
        "harmonics_v2": relative(1),
        "speed_m_min": cycle.speed_m_min,
        "depth_mm": cycle.depth_mm,
        "free_part": cycle.free_part,
        "verified": verified,
    })
}

fn oscillation_json(answer: &Answer) -> Value {
    let tool = &answer.tool;
    let rest = &answer.assessment.equilibrium;
    let branches = answer.assessment.branches.iter().map(|branch| {
        json!({
            "growth_per_s": branch.mode.growth_per_s,
            "frequency_hz": branch.mode.frequency_hz,
            "driver": if branch.driver == 0 { "V1" } else { "V2" },
            "end": end_word(branch.end),
            "end_is_known": branch.end.is_known(),
            "largest_amplitude_mm": branch.points.last().map(|point| 1e3 * point.amplitude_m),
        })
    });
    json!({
        "verdict": answer.assessment.verdict.as_str(),
        "speed_m_min": tool.speed_m_min,
        "speed_rpm": rpm(answer, tool.speed_m_min),
        "depth_mm": tool.depth_mm,
        "feed_mm_rev": tool.feed_mm_rev,
        "law": answer.laws.definition.name,
        "radial_law": answer.laws.radial.as_ref().map(|(_, radial)| &radial.name),
        "harmonics": answer.asked.harmonics,
        "force_n": rest.force_n,
        "deflection_mm": rest.deflection_m.map(|value| 1e3 * value),
        "growth_per_s": rest.growth_per_s(),
        "branches": branches.collect::<Vec<_>>(),
        "cycles": answer.assessment.cycles.iter().map(cycle_json).collect::<Vec<_>>(),
        "dropped": dropped_json(answer),
        "disturbances": disturbances_json(answer),
        "can_leave_model": answer.assessment.can_leave(),
        "stable_speeds_m_min": answer.stable_m_min,
        "least_squares": fits_json(answer),
        "transient": answer.transient.as_ref().map(super::transient::Transient::json),
        "sweep": sweep_json(answer),
        "maps": maps_json(answer),
        "assumptions": answer.assumptions,
    })
}

fn dropped_json(answer: &Answer) -> Vec<Value> {
    let dropped = answer.assessment.dropped.iter().map(|dropped| {
        json!({
            "frequency_hz": dropped.cycle.frequency_hz,
            "amplitude_mm": [1e3 * dropped.cycle.amplitude_m(0), 1e3 * dropped.cycle.amplitude_m(1)],
            "reason": match &dropped.reason {
                DropReason::Landed => "landed-on-another".to_owned(),
                DropReason::Duplicate => "duplicate".to_owned(),
                DropReason::Outside => "out-of-model".to_owned(),
                DropReason::Rest => "steady-cut".to_owned(),
                DropReason::Refused(error) => error.to_string(),
            },
        })
    });
    dropped.collect()
}

fn disturbances_json(answer: &Answer) -> Vec<Value> {
    let disturbances = answer.assessment.disturbances.iter().map(|kick| {
        json!({
            "size_m_s": kick.size_m_s,
            "velocity_m_s": [kick.start[2], kick.start[3]],
            "deflection_mm": [1e3 * kick.start[0], 1e3 * kick.start[1]],
            "fate": match &kick.fate {
                Fate::DiesOut => "dies-out",
                Fate::Settles(_) => "settles",
                Fate::GoesOn => "goes-on",
                Fate::StillGrows => "still-grows",
                Fate::Leaves => "leaves-model",
                Fate::BeginsOutside => "begins-out-of-model",
            },
            "settles_on_mm": match &kick.fate {
                Fate::Settles(cycle) => Some(cycle.amplitude_m.map(|value| 1e3 * value)),
                _ => None,
            },
        })
    });
    disturbances.collect()
}

fn fits_json(answer: &Answer) -> Option<Vec<Value>> {
    answer.fits.as_ref().map(|fits| {
        let each = fits.iter().flat_map(|(measure, fits)| {
            fits.iter().map(move |fit| {
                json!({
                    "measure": if *measure == Measure::Residual { "residual" } else { "normalised" },
                    "frequency_hz": fit.frequency_hz,
                    "amplitude_mm": fit.amplitude_m.map(|value| 1e3 * value),
                    "mean_mm": fit.mean_m.map(|value| 1e3 * value),
                    "residual_n2": fit.residual_n2,
                    "normalised": fit.normalised,
                    "beyond_the_model": fit.reaches_floor,
                })
            })
        });
        each.collect::<Vec<_>>()
    })
}

fn sweep_json(answer: &Answer) -> Vec<Value> {
    let sweep = answer.sweep.iter().map(|point| {
        json!({
            "speed_m_min": point.speed_m_min,
            "growth_per_s": point.growth_per_s,
            "verdict": point.verdict.map(StabilityVerdict::as_str),
            "cycles": point.cycles.iter().map(|cycle| json!({
                "amplitude_mm": 1e3 * cycle.0, "frequency_hz": cycle.1, "stable": cycle.2,
            })).collect::<Vec<_>>(),
        })
    });
    sweep.collect()
}

fn maps_json(answer: &Answer) -> Vec<Value> {
    let range = &answer.asked.map;
    let maps = answer.maps.iter().map(|(feed, cells)| {
        json!({
            "feed_mm_rev": feed,
            "speed_m_min": range.speed_m_min,
            "depth_mm": range.depth_mm,
            "columns": range.columns,
            "rows": range.rows,
            "verdict": cells.iter().map(|cell| cell.verdict.map(StabilityVerdict::as_str)).collect::<Vec<_>>(),
            "growth_per_s": cells.iter().map(|cell| cell.growth_per_s).collect::<Vec<_>>(),
            "amplitude_mm": cells.iter().map(|cell| 1e3 * cell.amplitude_m).collect::<Vec<_>>(),
            "frequency_hz": cells.iter().map(|cell| cell.frequency_hz).collect::<Vec<_>>(),
        })
    });
    maps.collect()
}

fn lobe_json(answer: &LobeAnswer) -> Value {
    let minima = answer.minima.iter().map(|limit| {
        json!({
            "depth_mm": 1e3 * limit.depth_m,
            "frequency_hz": limit.frequency_hz,
            "speeds_rpm": (0..8).map(|waves| limit.speed_rpm(waves, answer.cuts_per_rev)).collect::<Vec<_>>(),
        })
    });
    let points = answer.points.iter().map(|point| {
        let exact = match point.exact {
            ExactLimit::At(depth, chatter, growth) => Some((depth, chatter, growth)),
            ExactLimit::Unknown | ExactLimit::Beyond => None,
        };
        json!({
            "speed_rpm": point.speed_rpm,
            "limit_mm": point.quick.map(|limit| 1e3 * limit.depth_m),
            "frequency_hz": point.quick.map(|limit| limit.frequency_hz),
            "method": method(answer, point).replace(' ', "-"),
            "exact_limit_mm": exact.map(|(depth, ..)| 1e3 * depth),
            "exact_kind": exact.map(|(_, chatter, _)| chatter.kind.as_str()),
            "exact_frequency_hz": exact.map(|(_, chatter, _)| chatter.frequency_hz),
            "exact_growth": exact.map(|(.., growth)| growth),
        })
    });
    json!({
        "kind": answer.kind,
        "minima": minima.collect::<Vec<_>>(),
        "max_depth_mm": 1e3 * answer.most_m,
        "points": points.collect::<Vec<_>>(),
        "notes": answer.notes,
        "assumptions": answer.assumptions,
    })
}
