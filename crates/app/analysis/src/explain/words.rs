//! The explanation as sentences.

use std::fmt::{self, Display, Formatter};

use super::Explanation;
use super::surroundings::{Block, Corner, Neighbour, Surroundings};
use super::watch::{LineTiming, SlowPoint, Where};
use crate::limiting::{Limiting, Order};

/// Corners below this angle are ignored, degrees.
const SLIGHT_DEGREES: f64 = 0.5;
/// Moves shorter than this are mentioned, mm.
const SHORT_MM: f64 = 2.0;

/// Why the line is slow, and advice that cannot be measured here.
pub(super) fn reasons(program: &Surroundings, seen: &LineTiming) -> (Vec<String>, Vec<String>) {
    let (mut reasons, mut advice) = (Vec::new(), Vec::new());
    let fraction = |cause: Limiting| {
        seen.causes
            .iter()
            .find(|known| known.0 == cause)
            .map_or(0.0, |known| known.1)
    };
    if program.moves.is_empty() || seen.time_s <= 0.0 {
        return (reasons, advice);
    }
    if fraction(Limiting::Feed) > 0.5 {
        reasons.push("it runs at its programmed feed for most of its time".to_owned());
        advice.push("a higher feed word, if the cut permits it".to_owned());
    }
    for point in &seen.places {
        let side = match point.at {
            Where::Start => program.before.as_ref(),
            Where::End => program.after.as_ref(),
            Where::Within => None,
        };
        if let Some(reason) = reason(point, side, program) {
            reasons.push(reason);
        }
    }
    if let Some(corner) = exact_corner(program, seen) {
        advice.push(corner);
    }
    if program_tolerance(program) && !seen.places.is_empty() {
        advice.push("a larger P of G64 in the program, if the part permits it".to_owned());
    }
    if short_neighbours(program) {
        advice.push("fewer and longer moves, or arcs instead of short lines, from the CAM system".to_owned());
    }
    if fraction(Limiting::Nothing) > 0.5 {
        reasons.push(
            "for most of its time no limit is reached: the planner keeps a reserve between short or curved \
             moves"
                .to_owned(),
        );
    }
    if fraction(Limiting::Joint) > 0.05 {
        advice.push("G64 instead of G61, or a longer path.joint_time_ms".to_owned());
    }
    (reasons, advice)
}

fn reason(point: &SlowPoint, side: Option<&Neighbour>, program: &Surroundings) -> Option<String> {
    let (name, toward) = match point.at {
        Where::Start => ("start", "from"),
        Where::End => ("end", "to"),
        Where::Within => return within(point),
    };
    let speed = speed(point);
    let Some(side) = side else {
        let what = match point.at {
            Where::Start => "begins",
            _ => "ends",
        };
        return Some(format!(
            "its {name} is at rest: the motion of the program {what} there"
        ));
    };
    let line = side.block.line;
    if let Some((line, what)) = &side.rest {
        return Some(format!(
            "{speed} at its {name}: line {line} is {what}, during which the axes are at rest"
        ));
    }
    let joint = side.corner;
    let mut causes = Vec::new();
    match side.corner_degrees {
        Some(angle) if angle >= SLIGHT_DEGREES => {
            let taken = match joint {
                Corner::Exact => "kept exactly (G61)".to_owned(),
                Corner::Stop => "and a stop after every move (G61.1)".to_owned(),
                Corner::Within(p) => format!("rounded within {p} mm (G64 P)"),
                Corner::WithinDefault(p) => {
                    format!("rounded within {p} mm (the machine file's blend tolerance)")
                }
            };
            causes.push(format!(
                "a corner of {angle:.1} degrees {toward} line {line}, {taken}"
            ));
        }
        _ if joint == Corner::Stop => causes.push("G61.1 stops after every move".to_owned()),
        _ => {}
    }
    if let (Some(theirs), Some(own)) = (side.block.feed_mm_min, program.moves.first()?.feed_mm_min)
        && theirs < 0.97 * own
    {
        causes.push(format!("line {line} is programmed at {theirs:.0} mm/min only"));
    }
    if side.mean_length_mm < SHORT_MM && side.mean_length_mm > 0.0 {
        causes.push(format!(
            "the moves {} it are {} mm long on average",
            if point.at == Where::Start {
                "before"
            } else {
                "after"
            },
            short(side.mean_length_mm)
        ));
    }
    if causes.is_empty() {
        causes.push(format!("the speed that line {line} permits"));
    }
    Some(format!("{speed} at its {name}: {}", causes.join("; ")))
}

fn within(point: &SlowPoint) -> Option<String> {
    let bend = point.radius_mm.map_or_else(String::new, |radius| {
        format!(" where its radius is {} mm", short(radius))
    });
    Some(match point.used.first() {
        Some(first) => format!(
            "{} within it{bend}: {:.0} % of the {} limit is used there",
            speed(point),
            100.0 * first.share,
            first.limit
        ),
        None => format!(
            "{} within it{bend}, with every limit less than half used",
            speed(point)
        ),
    })
}

fn exact_corner(program: &Surroundings, seen: &LineTiming) -> Option<String> {
    let at = |at: Where| seen.places.iter().any(|point| point.at == at);
    let is_exact = |side: &Neighbour| {
        side.rest.is_none()
            && side.corner_degrees.is_some_and(|angle| angle >= SLIGHT_DEGREES)
            && matches!(side.corner, Corner::Exact | Corner::Stop)
    };
    let start = at(Where::Start) && program.before.as_ref().is_some_and(is_exact);
    let end = at(Where::End) && program.after.as_ref().is_some_and(is_exact);
    (start || end).then(|| "G64 P instead of G61, if the part permits rounded corners".to_owned())
}

fn program_tolerance(program: &Surroundings) -> bool {
    program
        .corners()
        .any(|corner| matches!(corner, Corner::Within(_)))
}

fn short_neighbours(program: &Surroundings) -> bool {
    [&program.before, &program.after]
        .into_iter()
        .flatten()
        .any(|side| side.mean_length_mm > 0.0 && side.mean_length_mm < SHORT_MM)
}

fn speed(point: &SlowPoint) -> String {
    if point.feed_mm_min < 1.0 {
        "at rest".to_owned()
    } else {
        format!("{:.0} mm/min", point.feed_mm_min)
    }
}

fn short(mm: f64) -> String {
    if mm < 0.1 {
        format!("{mm:.4}")
    } else {
        format!("{mm:.2}")
    }
}

impl Display for Explanation {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        writeln!(f, "line {}: {}", self.line, self.program.text)?;
        if self.program.moves.is_empty() || self.seen.time_s <= 0.0 {
            return self.no_motion(f);
        }
        for block in self.program.moves.iter().take(4) {
            writeln!(f, "  {}", described(block))?;
        }
        if self.program.moves.len() > 4 {
            writeln!(f, "  and {} more moves", self.program.moves.len() - 4)?;
        }
        let seen = &self.seen;
        let passes = if seen.passes > 1 {
            format!(" in {} passes", seen.passes)
        } else {
            String::new()
        };
        writeln!(
            f,
            "  speed {:.0} to {:.0} mm/min, mean {:.0}; {:.3} s{passes}, {:.1} % of the program's time",
            seen.least_feed_mm_min,
            seen.most_feed_mm_min,
            seen.mean_feed_mm_min,
            seen.time_s,
            100.0 * seen.share_of_program
        )?;
        let causes: Vec<String> = seen
            .causes
            .iter()
            .filter(|(_, fraction)| *fraction >= 0.005)
            .map(|(cause, fraction)| format!("{} {:.0} %", cause.name(), 100.0 * fraction))
            .collect();
        writeln!(f, "  limited by: {}", causes.join(", "))?;
        if seen.places.is_empty() {
            writeln!(f, "  nowhere below 97 % of its feed")?;
        }
        for point in &seen.places {
            self.write_point(f, point)?;
        }
        for reason in &self.reasons {
            writeln!(f, "  because: {reason}")?;
        }
        for remedy in &self.remedies {
            writeln!(
                f,
                "  with {}: {:.3} s instead of {:.3} s on this line, {:.3} s in all",
                remedy.change, remedy.time_s, seen.time_s, remedy.program_s
            )?;
        }
        for advice in &self.advice {
            writeln!(f, "  may help: {advice}")?;
        }
        Ok(())
    }
}

impl Explanation {
    fn no_motion(&self, f: &mut Formatter<'_>) -> fmt::Result {
        if !self.program.moves.is_empty() {
            return writeln!(f, "  its motion is shorter than one control period");
        }
        match self.program.nearest {
            (None, None) => writeln!(f, "  nothing in this program moves the axes"),
            (Some(line), None) | (None, Some(line)) => {
                writeln!(f, "  has no motion; the nearest line with motion is {line}")
            }
            (Some(below), Some(above)) => {
                writeln!(
                    f,
                    "  has no motion; the nearest lines with motion are {below} and {above}"
                )
            }
        }
    }

    fn write_point(&self, f: &mut Formatter<'_>, point: &SlowPoint) -> fmt::Result {
        let name = match point.at {
            Where::Start => "at its start",
            Where::Within => "within it",
            Where::End => "at its end",
        };
        let position: Vec<String> = point.position.iter().map(|value| format!("{value:.4}")).collect();
        write!(
            f,
            "  slow {name}: {:.0} mm/min at {:.3} s, position {}",
            point.feed_mm_min,
            point.time_s,
            position.join(" ")
        )?;
        if let Some(radius) = point.radius_mm {
            write!(f, ", radius {} mm", short(radius))?;
        }
        writeln!(f)?;
        for used in point.used.iter().take(3) {
            let digits = match used.cause {
                Limiting::Axis(_, Order::Jerk | Order::Acceleration) => 0,
                _ => 2,
            };
            writeln!(
                f,
                "    {}: {:.0} % of {:.digits$} {}",
                used.limit,
                100.0 * used.share,
                used.value,
                used.unit
            )?;
        }
        Ok(())
    }
}

fn described(block: &Block) -> String {
    let feed = block.feed_mm_min.map_or_else(
        || "as fast as the axes can".to_owned(),
        |feed| format!("programmed at {feed:.0} mm/min"),
    );
    let corner = match block.corner_after {
        Corner::Exact => "exact path (G61)".to_owned(),
        Corner::Stop => "exact stop (G61.1)".to_owned(),
        Corner::Within(p) => format!("blended within {p} mm (G64 P)"),
        Corner::WithinDefault(p) => format!("blended within {p} mm (G64, machine file)"),
    };
    format!(
        "{} of {} mm, {feed}, {corner}",
        block.kind,
        short(block.length_mm)
    )
}
