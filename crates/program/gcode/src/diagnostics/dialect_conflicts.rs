//! Lines that are valid here but have another meaning in other dialects, so that they would run with the
//! wrong meaning.

use crate::codes::modal_groups::{FeedMode, GCode, Group, MCode, Motion, NonModal};
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::state::machine_state::State;
use crate::syntax::expression::Target;
use crate::syntax::statement::Statement;
use crate::{Code, ToolTable};

/// T words of four digits: tool and offset, as lathes of other dialects write them.
const FOUR_DIGITS: std::ops::RangeInclusive<u32> = 100..=9999;

/// Maximum feed after G99 that is taken for a feed per revolution, mm/min: lathes feed 0.01 to 2 mm per
/// revolution, and hardly ever that little per minute.
const LOW_FEED_MM_MIN: f64 = 5.0;

/// The parameters with which macro programs of other dialects stop the machine.
const ALARM: usize = 3000;
const STOP: usize = 3006;

/// Warns of a line that sets a system variable of other dialects, which is an ordinary parameter here.
#[cold]
pub(crate) fn assignment(assignments: &[(Target, f64)], has_comment: bool) -> Option<String> {
    assignments.iter().find_map(|(target, value)| match *target {
        Target::Numbered(ALARM) if has_comment || (1.0..=999.0).contains(value) && value.fract() == 0.0 => Some(
            "#3000 is an ordinary parameter in this dialect, and the program continues; write (ABORT, text) \
             to end it with a message"
                .to_owned(),
        ),
        Target::Numbered(STOP) if has_comment || *value == 1.0 => Some(
            "#3006 is an ordinary parameter in this dialect, and the program continues; write (MSG, text) \
             and M0 on the next line to stop with a message"
                .to_owned(),
        ),
        _ => None,
    })
}

/// Warns of F on a line that changes the unit: F counts in the unit before.
pub(crate) fn feed_before_unit(line: &Statement, state: &State) -> Option<String> {
    let Some(GCode::Inches(inches)) = line.g(Group::Units) else {
        return None;
    };
    let feed = line
        .word(b'F')
        .filter(|_| state.modes.feed_mode != FeedMode::InverseTime)?;
    let was_inches = state.unit_mm() > 1.0;
    (inches != was_inches && feed > 0.0).then(|| {
        let [unit, code] = if inches { ["mm", "G20"] } else { ["inches", "G21"] };
        format!(
            "F{feed} counts in {unit}, because {code} on the same line applies after F; write {code} on a line \
             before"
        )
    })
}

/// Checks a line of a lathe that has another meaning on other lathes: an error if the motion would be clearly
/// wrong, a warning if it may be intended.
pub(crate) fn on_lathe(
    line: &Statement,
    state: &mut State,
    tools: Option<&ToolTable>,
) -> Result<Option<String>, Fault> {
    if let Some(warning) = tool_and_offset(line, tools, state.modes.diameter) {
        return Ok(Some(warning));
    }
    if line.non_modal() == Some(NonModal::SetOffset) && line.has(b'F') {
        let message = "G92 with F is the threading cycle of other lathes; here G92 sets an offset, and no \
                       thread is cut";
        return Err(Fault::new(Code::UnusedWord, line.span(b'F'), message).help(
            "fanuc_threads = true in [program] of the machine file reads G32 and G92 as Fanuc's lathes do; \
             G76 is the threading cycle of this dialect; to set an offset, leave F out",
        ));
    }
    if let Some((name, span)) = turning_cycle(line) {
        let is_rapid = line.motion() == Some(Motion::Rapid);
        let help = "write each pass as G0 X.., G1 Z.. F.., G0 X.. and G0 Z..";
        if is_rapid && line.has(b'F') {
            let message = format!(
                "{name} with X, Z and F is a turning cycle on other lathes; here the line moves at rapid to \
                 X Z, because G0 is active"
            );
            return Err(Fault::new(Code::UnusedWord, span, message).help(format!(
                "{help}; for one straight move, write G0 or G1 on this line"
            )));
        }
        if is_rapid || line.has(b'F') {
            let manner = if is_rapid { "at rapid" } else { "straight" };
            return Ok(Some(format!(
                "{name} with X and Z is a turning cycle on other lathes; here the line moves {manner} to X \
                 Z; {help}, or the motion code on this line if that is meant"
            )));
        }
    }
    Ok(retract(line, state))
}

/// G90 or G94 with X and Z and no motion code.
fn turning_cycle(line: &Statement) -> Option<(&'static str, Span)> {
    let is_move = matches!(line.motion(), Some(Motion::Rapid | Motion::Linear)) && line.non_modal().is_none();
    if !is_move || line.motion_code().is_some() || !line.has(b'X') || !line.has(b'Z') {
        return None;
    }
    if line.g(Group::Distance) == Some(GCode::Incremental(false)) {
        return Some(("G90", line.group_span(Group::Distance)));
    }
    (line.g(Group::FeedMode) == Some(GCode::FeedMode(FeedMode::PerMinute)))
        .then(|| ("G94", line.group_span(Group::FeedMode)))
}

/// G98 and G99 as the feed modes of other lathes.
fn retract(line: &Statement, state: &mut State) -> Option<String> {
    let is_cycle = matches!(line.motion_code(), Some(Motion::Cycle(_)));
    if let Some(GCode::RetractToInitial(to_initial)) = line.g(Group::Retract) {
        state.is_g99_alone = !to_initial && !is_cycle;
    }
    // A cycle uses it as this dialect does.
    state.is_g99_alone &= !is_cycle;
    let mode = match line.g(Group::FeedMode) {
        Some(GCode::FeedMode(mode)) => mode,
        _ => state.modes.feed_mode,
    };
    if line.g(Group::Retract) == Some(GCode::RetractToInitial(true))
        && !is_cycle
        && mode == FeedMode::PerRevolution
    {
        return Some(
            "G98 is feed per minute on other lathes; here it is the retract of drilling cycles, and F \
             remains per revolution; write G94 for feed per minute"
                .to_owned(),
        );
    }
    let feed = line.word(b'F')?;
    let is_low = feed > 0.0 && feed * state.unit_mm() <= LOW_FEED_MM_MIN;
    if !state.is_g99_alone || !is_low || mode != FeedMode::PerMinute {
        return None;
    }
    // Warns once.
    state.is_g99_alone = false;
    Some(format!(
        "F{feed} is {feed} per minute: G99 is feed per revolution on other lathes, but here it is the \
         retract of drilling cycles; write G95 for feed per revolution"
    ))
}

/// T with four digits that no M6 uses.
fn tool_and_offset(line: &Statement, tools: Option<&ToolTable>, is_diameter: bool) -> Option<String> {
    let number = line.word(b'T')? as u32;
    let is_known = tools.is_some_and(|tools| tools.get(number).is_some());
    if is_known || !FOUR_DIGITS.contains(&number) || line.m(Group::ToolChange) == Some(MCode::ToolChange) {
        return None;
    }
    let (tool, offset) = (number / 100, number % 100);
    Some(format!(
        "T{number:04} is tool {tool} with offset {offset} on other lathes; here it only selects tool \
         {number} for the next M6, and no offset changes; write {}",
        tool_word_equivalent(number, is_diameter)
    ))
}

/// Meaning of the T word of four digits here, and of X, which is a diameter on lathes with such words.
pub(crate) fn tool_word_equivalent(number: u32, is_diameter: bool) -> String {
    let words = match (number / 100, number % 100) {
        (tool, 0) => format!("T{tool} M6 G49"),
        (tool, offset) => format!("T{tool} M6 G43 H{offset}"),
    };
    if is_diameter {
        words
    } else {
        format!("{words}; X is a radius (G8) now: if the program has diameters, write G7 on its first line")
    }
}
