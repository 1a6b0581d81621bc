//! Warnings about cuts of a turning program that are predicted to vibrate.

use std::cmp::Ordering;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead as _, BufReader};
use std::path::Path;

use evolvent_chatter::{CuttingTool, MapCell, Mapper, OscillationCase, StabilityVerdict, nearest_stable};
use evolvent_gcode::{Action, CanonicalCommand, Move, MoveKind, SPINDLES, SpindleDirection};
use evolvent_machine::MachineKind;
use evolvent_path::{AxisLetter, SurfaceSpeed};
use evolvent_runtime::{CheckBound, CheckBounds, Commands, Setup, Unchecked};
use serde::Serialize;

use super::{CaseLaws, laws, read_chatter_case};
use crate::error::AnalysisError;

/// Points of a move at which the cut is evaluated: facing changes the speed.
const PLACES: usize = 5;
/// Maximum number of different cuts computed; other cuts are not evaluated.
const MAX_CUTS: usize = 20_000;
/// Maximum number of warnings; further lines are counted.
const MAX_WARNINGS: usize = 1000;

/// A cut that is predicted to be unstable.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChatterWarning {
    /// Line of the program.
    pub line: u32,
    /// `bistable`, `self-excited` or `out-of-model`.
    pub verdict: &'static str,
    /// Cutting speed, m/min.
    pub speed_m_min: f64,
    /// Number of the spindle.
    pub spindle: u32,
    /// Its speed, rpm.
    pub speed_rpm: f64,
    /// Diameter of the cut, mm.
    pub diameter_mm: f64,
    /// Feed, mm/rev.
    pub feed_mm_rev: f64,
    /// Depth of cut, mm.
    pub depth_mm: f64,
    /// Source of the depth.
    pub depth_from: &'static str,
    /// Amplitude of V2 on the largest stable cycle, mm; 0 if the model has none.
    pub amplitude_mm: f64,
    /// Nearest stable spindle speeds below and above, rpm.
    pub stable_rpm: [Option<f64>; 2],
}

impl ChatterWarning {
    /// As one line of text.
    pub fn text(&self, file_name: &str) -> String {
        let what = match self.verdict {
            "bistable" => "may be set vibrating by an impulse",
            "self-excited" => "is predicted to vibrate by itself",
            _ => "is predicted to vibrate, beyond the range of the model",
        };
        let stable: Vec<String> = self
            .stable_rpm
            .into_iter()
            .flatten()
            .map(|rpm| format!("{rpm:.0}"))
            .collect();
        let advice = if stable.is_empty() {
            "no stable speed was found: change depth, feed or tool".to_owned()
        } else {
            format!("nearest stable spindle speeds: {} rpm", stable.join(" and "))
        };
        let spindle = match self.spindle {
            0 => String::new(),
            number => format!(" of spindle {number}"),
        };
        format!(
            "{file_name}:{}: warning: this cut {what} at {:.0} rpm{spindle} ({:.1} m/min on a diameter of \
             {:.2} mm), {:.3} mm deep ({}), {:.3} mm/rev; {advice}",
            self.line,
            self.speed_rpm,
            self.speed_m_min,
            self.diameter_mm,
            self.depth_mm,
            self.depth_from,
            self.feed_mm_rev
        )
    }
}

/// The warnings and their assumptions.
pub struct ChatterWarnings {
    found: Vec<ChatterWarning>,
    omissions: Vec<String>,
    assumptions: String,
}

impl ChatterWarnings {
    /// The warnings, ordered by line.
    #[must_use]
    pub fn found(&self) -> &[ChatterWarning] {
        &self.found
    }

    /// What was not evaluated or is not listed, and why.
    #[must_use]
    pub fn omissions(&self) -> &[String] {
        &self.omissions
    }

    /// One line of text per warning and omission, and one with the assumptions.
    #[must_use]
    pub fn text(&self, file_name: &str) -> String {
        let mut text = String::new();
        for warning in &self.found {
            text.push_str(&warning.text(file_name));
            text.push('\n');
        }
        for omission in &self.omissions {
            text.push_str(&format!("{file_name}: {omission}\n"));
        }
        text.push_str(&format!("{file_name}: {}\n", self.assumptions));
        text
    }
}

/// Evaluates every cut of a turning program within `bounds`. Errors of the program are reported by the run,
/// not here.
///
/// # Errors
/// `Usage` for a machine that is not a lathe, or a case file without self-oscillation.
pub fn chatter_warnings(
    program: &Path,
    setup: &Setup,
    case_file: &Path,
    bounds: CheckBounds,
) -> Result<ChatterWarnings, AnalysisError> {
    let usage = |what: &str| AnalysisError::Input(format!("{}: {what}", case_file.display()));
    if setup.machine.kind != MachineKind::Lathe {
        return Err(usage(
            "predictions of --process are for turning, and this machine is not a lathe",
        ));
    }
    let case = read_chatter_case(case_file)?;
    let Some(asked) = &case.oscillation else {
        return Err(usage(
            "has no [cut], [force] and [tool], so nothing can be predicted with it",
        ));
    };
    let case_laws = laws(case_file, asked)?;
    let depths = cycle_depths(program);
    let mut look = Look {
        asked,
        laws: &case_laws,
        mapper: Mapper::new(asked.harmonics),
        known: BTreeMap::new(),
        found: BTreeMap::new(),
        unlisted: BTreeSet::new(),
        unevaluated_from: None,
    };
    let mut reading = Reading::new(bounds);
    let mut spindles = Spindles::default();
    let commands =
        Commands::open(program, setup).map_err(|error| AnalysisError::Failed(error.to_string()))?;
    for command in commands.map_while(Result::ok) {
        let line = command.line;
        if reading.is_over(line) {
            break;
        }
        match &command.action {
            Action::Spindle {
                spindle,
                direction,
                speed_rpm,
            } => spindles.set(*spindle, *direction, Spindle::Turns(*speed_rpm)),
            Action::SurfaceSpeed {
                spindle,
                direction,
                surface,
            } => spindles.set(*spindle, *direction, Spindle::Surface(*surface)),
            Action::Move(motion) if motion.kind == MoveKind::Feed => {
                look.at(
                    line,
                    motion,
                    spindles.of_cut(&command),
                    depths.get(&line).copied(),
                );
            }
            _ => {}
        }
    }
    let mut omissions: Vec<String> = reading
        .over
        .iter()
        .map(|over| format!("chatter was {over}"))
        .collect();
    if let Some(line) = look.unevaluated_from {
        omissions.push(format!(
            "more than {MAX_CUTS} different cuts: from line {line} on, only cuts like the earlier ones were \
             evaluated"
        ));
    }
    if !look.unlisted.is_empty() {
        omissions.push(format!(
            "{} more lines with cuts that are predicted to vibrate are not listed",
            look.unlisted.len()
        ));
    }
    let found = look.finish();
    Ok(ChatterWarnings {
        omissions,
        assumptions: format!(
            "{} lines with cuts that are predicted to vibrate; assumed: {}force law {} ({}), {}, no \
             regeneration, depth from G82 D \
             or G75 K where there is one and else {} mm, diameter {}",
            found.len(),
            spindles.assumption(),
            case_laws.definition.name,
            case_laws.definition.description,
            case_laws.radial_text(asked),
            asked.tool.depth_mm,
            match asked.diameter_mm {
                Some(diameter) => format!("{diameter} mm everywhere (process file)"),
                None => "twice X in machine coordinates".to_owned(),
            }
        ),
        found,
    })
}

#[derive(Clone, Copy, Debug)]
enum Spindle {
    Still,
    Turns(f64),
    Surface(SurfaceSpeed),
}

/// Commands of a program to the spindles.
#[derive(Debug)]
struct Spindles {
    now: [Spindle; SPINDLES],
    /// The spindle that was started last.
    last: u32,
    /// A spindle other than number 0 was commanded.
    are_several: bool,
}

impl Default for Spindles {
    fn default() -> Self {
        Self {
            now: [Spindle::Still; SPINDLES],
            last: 0,
            are_several: false,
        }
    }
}

impl Spindles {
    fn set(&mut self, number: u32, direction: SpindleDirection, turning: Spindle) {
        let Some(now) = self.now.get_mut(number as usize) else {
            return;
        };
        self.are_several |= number != 0;
        if direction == SpindleDirection::Stopped {
            *now = Spindle::Still;
        } else {
            (*now, self.last) = (turning, number);
        }
    }

    /// The spindle of a cut: that of G95; otherwise, of the turning spindles, the one that was started last.
    fn of_cut(&self, command: &CanonicalCommand) -> (u32, Spindle) {
        let of = |number: u32| self.now.get(number as usize).copied().unwrap_or(Spindle::Still);
        if command.feed_mm_rev.is_some() {
            return (command.feed_spindle, of(command.feed_spindle));
        }
        if !matches!(of(self.last), Spindle::Still) {
            return (self.last, of(self.last));
        }
        let turning = (0..SPINDLES as u32).find(|number| !matches!(of(*number), Spindle::Still));
        turning.map_or((self.last, Spindle::Still), |number| (number, of(number)))
    }

    /// Which spindle was assumed, if it is ambiguous.
    fn assumption(&self) -> &'static str {
        if self.are_several {
            "cuts with the spindle of G95, in G94 with the one started last, "
        } else {
            ""
        }
    }
}

struct Look<'a> {
    asked: &'a OscillationCase,
    laws: &'a CaseLaws,
    mapper: Mapper,
    /// Cuts already computed.
    known: BTreeMap<Cut, MapCell>,
    /// The worst cut of each line.
    found: BTreeMap<u32, Finding>,
    /// Lines beyond the maximum number of warnings.
    unlisted: BTreeSet<u32>,
    /// The first line with a cut that was not evaluated.
    unevaluated_from: Option<u32>,
}

/// Speed, depth and feed of a cut, in parts per thousand.
type Cut = [i64; 3];

fn cut_of(tool: &CuttingTool) -> Cut {
    [tool.speed_m_min, tool.depth_mm, tool.feed_mm_rev].map(|value| (1000.0 * value.ln()).round() as i64)
}

/// The worst cut of a line; its stable speeds are searched at the end.
struct Finding {
    warning: ChatterWarning,
    verdict: StabilityVerdict,
    tool: CuttingTool,
    /// Circumference of the cut, m.
    around: f64,
}

/// How severe a verdict is: a vibration that leaves the model is large, and has no amplitude.
fn severity(verdict: StabilityVerdict) -> u8 {
    match verdict {
        StabilityVerdict::Stable => 0,
        StabilityVerdict::Bistable => 1,
        StabilityVerdict::SelfExcited => 2,
        StabilityVerdict::OutOfModel => 3,
    }
}

/// How far a program is read, within the bounds of a check.
struct Reading {
    bounds: CheckBounds,
    /// Number of commands in total, and since a new line was reached.
    commands: u64,
    round: u64,
    /// The last line reached.
    farthest: u32,
    over: Option<Unchecked>,
}

impl Reading {
    fn new(bounds: CheckBounds) -> Self {
        Self {
            bounds,
            commands: 0,
            round: 0,
            farthest: 0,
            over: None,
        }
    }

    /// Whether the next command, of this line, is beyond a bound.
    fn is_over(&mut self, line: u32) -> bool {
        self.commands += 1;
        self.round += 1;
        if line > self.farthest {
            (self.farthest, self.round) = (line, 0);
        }
        let bound = if self.round > self.bounds.round {
            CheckBound::Line {
                line: self.farthest,
                commands: self.bounds.round,
            }
        } else if self.commands > self.bounds.commands {
            CheckBound::Commands {
                commands: self.bounds.commands,
            }
        } else {
            return false;
        };
        self.over = Some(Unchecked {
            up_to: self.farthest,
            bound,
        });
        true
    }
}

impl Look<'_> {
    fn at(&mut self, line: u32, motion: &Move, (number, spindle): (u32, Spindle), cycle_depth: Option<f64>) {
        let (from, to) = (motion.curve.start(), motion.curve.end());
        let x = AxisLetter::X.index();
        for k in 0..PLACES {
            let radius = from[x] + (to[x] - from[x]) * k as f64 / (PLACES - 1) as f64;
            let diameter_mm = self.asked.diameter_mm.unwrap_or(2.0 * radius.abs());
            let around = std::f64::consts::PI * diameter_mm / 1000.0;
            let speed_rpm = match spindle {
                Spindle::Turns(rpm) => rpm,
                Spindle::Surface(surface) => (surface.speed_m_min / around.max(1e-9)).min(surface.max_rpm),
                Spindle::Still => return,
            };
            // Drilling on the axis or a crawl feed: outside the model.
            let speed_m_min = around * speed_rpm;
            let feed_mm_rev = 60.0 * motion.feed_mm_s / speed_rpm;
            if !(speed_m_min > self.asked.tool.floor_m_min && feed_mm_rev.is_finite() && feed_mm_rev > 1e-4) {
                continue;
            }
            let depth_mm = cycle_depth.unwrap_or(self.asked.tool.depth_mm);
            let tool = CuttingTool {
                speed_m_min,
                depth_mm,
                feed_mm_rev,
                radial_ratio: self
                    .asked
                    .radial_ratio
                    .unwrap_or_else(|| self.laws.law.radial_ratio()),
                ..self.asked.tool
            };
            let Some(cell) = self.cell(tool) else {
                self.unevaluated_from.get_or_insert(line);
                continue;
            };
            let verdict = match cell.verdict {
                Some(StabilityVerdict::Stable) | None => continue,
                Some(verdict) => verdict,
            };
            let is_worse = self.found.get(&line).is_none_or(|known| {
                match severity(verdict).cmp(&severity(known.verdict)) {
                    Ordering::Greater => true,
                    Ordering::Equal => 1e3 * cell.amplitude_m > known.warning.amplitude_mm * 1.001 + 1e-9,
                    Ordering::Less => false,
                }
            });
            if !is_worse {
                continue;
            }
            if self.found.len() >= MAX_WARNINGS && !self.found.contains_key(&line) {
                self.unlisted.insert(line);
                continue;
            }
            let finding = Finding {
                verdict,
                tool,
                around,
                warning: ChatterWarning {
                    line,
                    verdict: verdict.as_str(),
                    speed_m_min,
                    spindle: number,
                    speed_rpm,
                    diameter_mm,
                    feed_mm_rev,
                    depth_mm,
                    depth_from: if cycle_depth.is_some() {
                        "of the cycle"
                    } else {
                        "of the process file"
                    },
                    amplitude_mm: 1e3 * cell.amplitude_m,
                    stable_rpm: [None; 2],
                },
            };
            self.found.insert(line, finding);
        }
    }

    /// The warnings with their nearest stable speeds. One search serves all cuts that agree to a thousandth,
    /// because it computes hundreds of cuts.
    fn finish(self) -> Vec<ChatterWarning> {
        let mut mapper = self.mapper;
        let mut stable: BTreeMap<Cut, [Option<f64>; 2]> = BTreeMap::new();
        let mut warnings = Vec::with_capacity(self.found.len());
        for finding in self.found.into_values() {
            let (tool, around) = (finding.tool, finding.around);
            let speeds = *stable.entry(cut_of(&tool)).or_insert_with(|| {
                let range = [1.01 * tool.floor_m_min, 10.0 * tool.speed_m_min];
                nearest_stable(&mut mapper, tool, self.laws.laws(), range)
            });
            warnings.push(ChatterWarning {
                // Rounded away from the stability limit.
                stable_rpm: [
                    speeds[0].map(|speed| (speed / around).floor()),
                    speeds[1].map(|speed| (speed / around).ceil()),
                ],
                ..finding.warning
            });
        }
        warnings
    }

    /// The prediction for a cut, computed once for cuts that agree to a thousandth.
    fn cell(&mut self, tool: CuttingTool) -> Option<MapCell> {
        let room = self.known.len() < MAX_CUTS;
        match self.known.entry(cut_of(&tool)) {
            Entry::Occupied(known) => Some(*known.get()),
            Entry::Vacant(place) if room => Some(*place.insert(self.mapper.cell(tool, self.laws.laws()))),
            Entry::Vacant(_) => None,
        }
    }
}

/// Depths of cut, mm, given as plain numbers in lines with G82 D or G75 K; empty for programs that use
/// inches.
fn cycle_depths(program: &Path) -> BTreeMap<u32, f64> {
    let mut depths = BTreeMap::new();
    let Ok(file) = evolvent_config::open_regular(program) else {
        return depths;
    };
    let mut reader = BufReader::new(file);
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        if !matches!(reader.read_until(b'\n', &mut line), Ok(read) if read > 0) {
            break;
        }
        let words = words_of(&line);
        let has = |letter: char, value: f64| words.contains(&(letter, value));
        if has('G', 20.0) {
            return BTreeMap::new();
        }
        let letter = if has('G', 82.0) {
            'D'
        } else if has('G', 75.0) {
            'K'
        } else {
            continue;
        };
        let depth = words.iter().find(|word| word.0 == letter).map(|word| word.1);
        if let Some(depth) = depth.filter(|depth| (1e-4..1e3).contains(depth)) {
            depths.insert(number, depth);
        }
    }
    depths
}

/// Words of a line with plain numbers; skips comments and expressions.
fn words_of(line: &[u8]) -> Vec<(char, f64)> {
    let mut words = Vec::new();
    let mut in_comment = false;
    let mut at = 0;
    while let Some(&byte) = line.get(at) {
        at += 1;
        match byte {
            b';' if !in_comment => break,
            b'(' => in_comment = true,
            b')' => in_comment = false,
            _ if in_comment || !byte.is_ascii_alphabetic() => {}
            _ => {
                let digits: String = line[at..]
                    .iter()
                    .map(|byte| char::from(*byte))
                    .filter(|c| !c.is_whitespace())
                    .take_while(|c| c.is_ascii_digit() || matches!(c, '.' | '-' | '+'))
                    .collect();
                if let Ok(value) = digits.parse() {
                    words.push((char::from(byte.to_ascii_uppercase()), value));
                }
            }
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_read_without_comments_and_formulas() {
        assert_eq!(
            words_of(b"n10 g82 X40 (D9) z-.5 D 2.5 K[1+1] ; G20"),
            [('N', 10.0), ('G', 82.0), ('X', 40.0), ('Z', -0.5), ('D', 2.5)]
        );
        assert!(words_of(b"(unfinished G20").is_empty());
    }
}
