//! `evolvent bore`: a part program that mills a hole along involutes.
//!
//! Climb milling of a hole with a spindle that turns clockwise (M3) goes round counter-clockwise (G3, G3.2);
//! conventional milling goes round clockwise (G2, G2.2). All coordinates are those of the tool's centre; tool
//! compensation is not used.

use std::fmt;
use std::io::{self, Write};
use std::path::PathBuf;

use clap::Args;
use evolvent_path::{
    Axes, Curve, Hole, HoleBlock, HoleError, HolePass, HoleStart, Milling, Plane, Role, Sense, depths_mm,
};
use serde_json::json;

use crate::CommandError;
use crate::bore_report::{Comparison, comparison_json, comparison_text, pass_json};

/// Clearance above material, in mm, down to which the tool is lowered in rapid.
const CLEARANCE_MM: f64 = 1.0;

/// Mill a hole: write a part program to standard output.
#[derive(Args, Clone, Debug)]
pub(crate) struct BoreArgs {
    /// Diameter of the hole in mm.
    #[arg(long, value_name = "MM")]
    pub hole: f64,
    /// Diameter of the tool in mm.
    #[arg(long, value_name = "MM")]
    pub tool: f64,
    /// Largest radial pitch of the roughing involute in mm per turn; needed unless --finish-only.
    #[arg(long, value_name = "MM", required_unless_present = "finish_only")]
    pub pitch: Option<f64>,
    /// Material that roughing leaves on the wall, in mm.
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_negative_numbers = true)]
    pub allowance: f64,
    /// Finish the wall after roughing: involute approach, one turn, mirrored departure.
    #[arg(long)]
    pub finish: bool,
    /// Finish only: the hole has been roughed before.
    #[arg(long)]
    pub finish_only: bool,
    /// Where the finishing approach sets off (without finishing: the roughing), in mm from the hole's centre.
    #[arg(long, value_name = "X,Y", value_parser = point, allow_hyphen_values = true)]
    pub start: Option<[f64; 2]>,
    /// Instead of --start: radius of curvature where the finishing approach sets off, in mm.
    #[arg(long, value_name = "MM", conflicts_with_all = ["start", "start_length"])]
    pub start_radius: Option<f64>,
    /// Instead of --start: length of the finishing approach in mm.
    #[arg(long, value_name = "MM", conflicts_with = "start")]
    pub start_length: Option<f64>,
    /// Where roughing sets off, in mm from the hole's centre, for instance in a pre-drilled hole [default: the
    /// centre].
    #[arg(long, value_name = "X,Y", value_parser = point, allow_hyphen_values = true)]
    pub rough_start: Option<[f64; 2]>,
    /// Turns of the whole finishing involute: 1 or 2 are usual.
    #[arg(long, value_name = "N", default_value_t = 2)]
    pub turns: u32,
    /// Turns of the whole roughing involute [default: as many as the pitch asks for].
    #[arg(long, value_name = "N")]
    pub rough_turns: Option<u32>,
    /// Climb milling: counter-clockwise with M3 (the default).
    #[arg(long, conflicts_with = "conventional")]
    pub climb: bool,
    /// Conventional milling: clockwise with M3.
    #[arg(long)]
    pub conventional: bool,
    /// Depth of the hole below its top in mm; 0 runs once at the top, for a trial.
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_negative_numbers = true)]
    pub depth: f64,
    /// Largest step in depth in mm [default: the whole depth].
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub step: Option<f64>,
    /// Z of the hole's top in mm.
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_negative_numbers = true)]
    pub top: f64,
    /// Height above the top for moves in rapid, in mm.
    #[arg(long, value_name = "MM", default_value_t = 5.0)]
    pub safe: f64,
    /// X and Y of the hole's centre in mm.
    #[arg(long, visible_alias = "centre", value_name = "X,Y", value_parser = point, allow_hyphen_values = true,
          default_value = "0,0")]
    pub center: [f64; 2],
    /// Feed of the tool's centre in mm/min.
    #[arg(long, value_name = "MM_MIN", default_value_t = 1000.0)]
    pub feed: f64,
    /// Feed of finishing in mm/min [default: the same].
    #[arg(long, value_name = "MM_MIN")]
    pub finish_feed: Option<f64>,
    /// Feed of plunging in mm/min.
    #[arg(long, value_name = "MM_MIN", default_value_t = 200.0)]
    pub plunge_feed: f64,
    /// Speed of the spindle in rev/min.
    #[arg(long, value_name = "RPM", default_value_t = 3000.0)]
    pub spindle: f64,
    /// Number of the tool to change to (T, M6) [default: no change].
    #[arg(long, value_name = "N")]
    pub tool_number: Option<u32>,
    /// Blend corners within this tolerance in mm (G64 P) [default: exact path, G61].
    #[arg(long, value_name = "MM")]
    pub tolerance: Option<f64>,
    /// Instead of the program: one JSON object with the numbers of every block (phi0, psi, radii of curvature, length),
    /// visible turns, and the comparison of --compare.
    #[arg(long)]
    pub json: bool,
    /// Instead of the program: length and time of the first pass along the involute, half circles, an Archimedean spiral
    /// and a helix.
    #[arg(long)]
    pub compare: bool,
    /// Machine file whose limits tell the times of --compare; without it there are lengths only.
    #[arg(long, value_name = "FILE", requires = "compare")]
    pub machine: Option<PathBuf>,
}

/// Why no program was written.
#[derive(Debug)]
pub(crate) enum BoreError {
    /// The hole cannot be milled as asked.
    Hole(HoleError),
    /// An option has a value that makes no sense.
    Option {
        /// The option.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// The comparison failed.
    Compare(CommandError),
    /// Writing failed.
    Write(io::Error),
}

impl fmt::Display for BoreError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hole(error) => error.fmt(f),
            Self::Option { name, value } => {
                write!(f, "{name} {value} is impossible: give a positive, finite number")
            }
            Self::Compare(CommandError::Usage(text) | CommandError::Failed(text)) => text.fmt(f),
            Self::Write(error) => write!(f, "the program could not be written: {error}"),
        }
    }
}

impl std::error::Error for BoreError {}

impl From<HoleError> for BoreError {
    fn from(error: HoleError) -> Self {
        Self::Hole(error)
    }
}

impl From<io::Error> for BoreError {
    fn from(error: io::Error) -> Self {
        Self::Write(error)
    }
}

/// Writes the part program that `args` ask for.
///
/// Nothing is written unless the whole program is possible.
///
/// # Errors
/// [`BoreError`]: what is impossible, with its numbers, or that writing failed.
pub(crate) fn run(args: &BoreArgs, out: &mut dyn Write) -> Result<(), BoreError> {
    let plan = Plan::new(args)?;
    let mut text = Vec::new();
    if args.json || args.compare {
        let report = plan.report()?;
        text.extend_from_slice(report.as_bytes());
    } else {
        plan.write(&mut text)?;
    }
    out.write_all(&text)?;
    out.flush()?;
    Ok(())
}

/// One pass at one depth.
struct Level {
    pass: HolePass,
    z: f64,
    /// Down to where the tool may go in rapid.
    clear_z: f64,
    feed: f64,
    title: &'static str,
}

struct Plan<'a> {
    args: &'a BoreArgs,
    levels: Vec<Level>,
    safe_z: f64,
}

impl<'a> Plan<'a> {
    fn new(args: &'a BoreArgs) -> Result<Self, BoreError> {
        let positive = [
            ("--feed", Some(args.feed)),
            ("--finish-feed", args.finish_feed),
            ("--plunge-feed", Some(args.plunge_feed)),
            ("--spindle", Some(args.spindle)),
            ("--safe", Some(args.safe)),
            ("--tolerance", args.tolerance),
        ];
        for (name, value) in positive {
            if let Some(value) = value
                && !(value > 0.0 && value.is_finite())
            {
                return Err(BoreError::Option { name, value });
            }
        }
        if !args.top.is_finite() {
            return Err(BoreError::Option {
                name: "--top",
                value: args.top,
            });
        }
        let hole = Hole {
            plane: Plane::Xy,
            centre_mm: args.center,
            diameter_mm: args.hole,
            tool_diameter_mm: args.tool,
            milling: if args.conventional {
                Milling::Conventional
            } else {
                Milling::Climb
            },
        };
        let depths = if args.depth == 0.0 && args.step.is_none() {
            vec![args.top]
        } else {
            depths_mm(args.top, args.top - args.depth, args.step.unwrap_or(args.depth))?
        };
        let safe_z = args.top + args.safe;
        let rough = !args.finish_only;
        let mut levels = Vec::new();
        let mut roughed_mm = None;
        if rough {
            let start = match (args.rough_start, args.start, args.finish) {
                (Some(point), _, _) | (None, Some(point), false) => HoleStart::Point(point),
                _ => HoleStart::Centre,
            };
            let mut above = args.top;
            for &z in &depths {
                let pass = hole.rough(
                    args.pitch.unwrap_or(f64::NAN),
                    args.rough_turns,
                    args.allowance,
                    start,
                    &resting(z),
                )?;
                roughed_mm = Some(pass.radius_mm);
                let clear_z = (above + CLEARANCE_MM).min(safe_z);
                levels.push(Level {
                    pass,
                    z,
                    clear_z,
                    feed: args.feed,
                    title: "roughing",
                });
                above = z;
            }
        }
        if args.finish || args.finish_only {
            let start = match (args.start, args.start_radius, args.start_length) {
                (Some(point), _, _) => HoleStart::Point(point),
                (None, Some(radius), _) => HoleStart::CurvatureRadius(radius),
                (None, None, Some(length)) => HoleStart::Length(length),
                // Half way out: clear of the wall, with more than a quarter turn to build the force up.
                (None, None, None) => HoleStart::CurvatureRadius(0.5 * hole.path_radius_mm(0.0)?),
            };
            let feed = args.finish_feed.unwrap_or(args.feed);
            for &z in &depths {
                let pass = hole.finish(args.turns, 0.0, start, &resting(z))?;
                // In what roughing has cleared the tool may come down in rapid, elsewhere it plunges.
                let cleared = pass.blocks.first().zip(roughed_mm).is_some_and(|(block, limit)| {
                    let [x, y] = block.figures.start_mm;
                    x.hypot(y) <= limit
                });
                let clear_z = (if cleared { z } else { args.top } + CLEARANCE_MM).min(safe_z);
                levels.push(Level {
                    pass,
                    z,
                    clear_z,
                    feed,
                    title: "finishing",
                });
            }
        }
        Ok(Self { args, levels, safe_z })
    }

    /// Numbers instead of the program.
    fn report(&self) -> Result<String, BoreError> {
        let args = self.args;
        let compared = match self.levels.first().filter(|_| args.compare) {
            None => None,
            Some(first) => {
                let comparison = Comparison {
                    pass: &first.pass,
                    hole_mm: args.hole,
                    tool_mm: args.tool,
                    depth_mm: args.depth,
                    feed_mm_min: first.feed,
                    tolerance_mm: args.tolerance,
                };
                let list = comparison.alternatives(args.machine.as_deref());
                Some((list.map_err(BoreError::Compare)?, first.feed))
            }
        };
        if args.json {
            let levels = self.levels.iter();
            let passes: Vec<_> = levels
                .map(|level| pass_json(level.title, level.z, level.feed, &level.pass))
                .collect();
            let object = json!({
                "hole_mm": args.hole,
                "tool_mm": args.tool,
                "centre_mm": args.center,
                "milling": if args.conventional { "conventional" } else { "climb" },
                "length_mm": self.levels.iter().map(|level| level.pass.length_mm()).sum::<f64>(),
                "passes": passes,
                "comparison": compared.map(|(list, feed)| comparison_json(&list, feed)),
            });
            return Ok(format!("{object:#}\n"));
        }
        Ok(compared.map_or_else(String::new, |(list, feed)| comparison_text(&list, feed)))
    }

    fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        self.header(out)?;
        let args = self.args;
        writeln!(out, "G17 G21 G40 G49 G90 G94")?;
        match args.tolerance {
            Some(tolerance) => writeln!(out, "G64 P{}", word(tolerance))?,
            None => writeln!(out, "G61")?,
        }
        if let Some(number) = args.tool_number {
            writeln!(out, "T{number} M6")?;
        }
        writeln!(out, "S{} M3", word(args.spindle))?;
        writeln!(out, "G0 Z{}", word(self.safe_z))?;
        for level in &self.levels {
            self.level(level, out)?;
        }
        writeln!(out, "\nM5\nM30")
    }

    fn header(&self, out: &mut dyn Write) -> io::Result<()> {
        let args = self.args;
        let sense = if args.conventional {
            "conventional, clockwise"
        } else {
            "climb, counter-clockwise"
        };
        writeln!(
            out,
            "(hole of {} mm, tool of {} mm, {sense} with M3)",
            args.hole, args.tool
        )?;
        let [x, y] = args.center;
        writeln!(
            out,
            "(centre X{} Y{}, top Z{}, path of the tool centre, mm)",
            word(x),
            word(y),
            word(args.top)
        )?;
        let mut last = "";
        let mut total = 0.0;
        for level in &self.levels {
            let pass = &level.pass;
            total += pass.length_mm();
            if level.title == last {
                continue;
            }
            last = level.title;
            writeln!(
                out,
                "({}: R {} mm, n {} turns, H {:.6} mm per turn, r {:.9} mm, {:.3} turns visible, {:.6} mm long at each depth)",
                level.title,
                pass.radius_mm,
                pass.turns,
                pass.pitch_mm,
                pass.base_radius_mm,
                pass.visible_turns(),
                pass.length_mm()
            )?;
        }
        let depths = self.levels.iter().filter(|level| level.title == last).count();
        writeln!(out, "(depths: {depths}, cutting path in all {total:.3} mm)")?;
        writeln!(
            out,
            "(G2.2 and G3.2: involute, I J to the centre of its base circle, R its radius)"
        )
    }

    fn level(&self, level: &Level, out: &mut dyn Write) -> io::Result<()> {
        let Some(first) = level.pass.blocks.first() else {
            return Ok(());
        };
        let start = first.curve.start();
        writeln!(out, "\n({} at Z{})", level.title, word(level.z))?;
        writeln!(out, "G0 X{} Y{}", word(start[0]), word(start[1]))?;
        writeln!(out, "G0 Z{}", word(level.clear_z))?;
        writeln!(out, "G1 Z{} F{}", word(level.z), word(self.args.plunge_feed))?;
        for block in &level.pass.blocks {
            writeln!(out, "({}, {:.6} mm)", title(block.role), block.figures.length_mm)?;
            writeln!(out, "{}", line(block, level.feed))?;
        }
        writeln!(out, "G0 Z{}", word(self.safe_z))
    }
}

fn resting(z: f64) -> Axes {
    let mut axes = Axes::zeros();
    axes[2] = z;
    axes
}

fn title(role: Role) -> &'static str {
    match role {
        Role::Rough => "out along the involute",
        Role::RoughCircle => "once round",
        Role::Approach => "approach",
        Role::FinishCircle => "once round on the wall",
        Role::Departure => "departure",
    }
}

/// One block as a line of the program.
pub(crate) fn line(block: &HoleBlock, feed: f64) -> String {
    let (start, end) = (block.curve.start(), block.curve.end());
    let involute = matches!(block.curve, Curve::Involute(_));
    let code = match (block.curve.sense(), involute) {
        (Sense::Clockwise, true) => "G2.2",
        (_, true) => "G3.2",
        (Sense::Clockwise, false) => "G2",
        (_, false) => "G3",
    };
    let [i, j] = [0, 1].map(|axis| word(block.centre_mm[axis] - start[axis]));
    let radius = if involute {
        format!(" R{}", word(block.radius_mm))
    } else {
        String::new()
    };
    format!(
        "{code} X{} Y{} I{i} J{j}{radius} F{}",
        word(end[0]),
        word(end[1]),
        word(feed)
    )
}

/// A number as the shortest decimal that reads back as the same bits, never with an exponent; what is below
/// 1e-15 is a rounding and reads as zero.
fn word(value: f64) -> String {
    if value.abs() < 1e-15 {
        "0".to_owned()
    } else {
        value.to_string()
    }
}

/// Two numbers with a comma between.
fn point(text: &str) -> Result<[f64; 2], String> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|part| {
            part.trim()
                .parse::<f64>()
                .map_err(|error| format!("{part:?}: {error}"))
        })
        .collect::<Result<_, _>>()?;
    match numbers[..] {
        [x, y] if x.is_finite() && y.is_finite() => Ok([x, y]),
        _ => Err("give two finite numbers with a comma between, as in -40,40".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use evolvent_path::{Arc, Involute};

    use super::*;

    #[derive(Parser)]
    struct Command {
        #[command(flatten)]
        bore: BoreArgs,
    }

    fn parse(options: &str) -> Result<BoreArgs, clap::Error> {
        Command::try_parse_from(std::iter::once("bore").chain(options.split_whitespace())).map(|c| c.bore)
    }

    fn program(options: &str) -> Result<String, String> {
        let args = parse(options).map_err(|error| error.to_string())?;
        let mut out = Vec::new();
        run(&args, &mut out).map_err(|error| error.to_string())?;
        Ok(String::from_utf8(out).unwrap())
    }

    const BORE_200: &str = "--hole 200 --tool 40 --pitch 4 --allowance 1 --finish --start -40,40";

    /// Runs a program's moves: the curves of its G2, G3, G2.2 and G3.2, by a reader of words of its own.
    fn curves(text: &str) -> Vec<Curve> {
        let mut at = Axes::zeros();
        let mut curves = Vec::new();
        for line in text.lines().filter(|line| !line.starts_with('(')) {
            let words: Vec<(char, f64)> = line
                .split_whitespace()
                .map(|word| (word.chars().next().unwrap(), word[1..].parse().unwrap()))
                .collect();
            let get = |letter| words.iter().find(|word| word.0 == letter).map(|word| word.1);
            let start = at;
            for (axis, letter) in ['X', 'Y', 'Z'].into_iter().enumerate() {
                at[axis] = get(letter).unwrap_or(at[axis]);
            }
            let (Some(i), Some(j), Some(code)) = (get('I'), get('J'), get('G')) else {
                continue;
            };
            let centre = [start[0] + i, start[1] + j];
            let sense = if code >= 3.0 {
                Sense::CounterClockwise
            } else {
                Sense::Clockwise
            };
            curves.push(match get('R') {
                Some(r) => Involute::new(Plane::Xy, start, at, centre, r, sense, 1e-9)
                    .unwrap()
                    .into(),
                None => Arc::new(Plane::Xy, start, at, centre, sense, 0).unwrap().into(),
            });
        }
        curves
    }

    #[test]
    fn the_program_read_back_gives_the_planned_path_to_a_nanometre_and_less() {
        for options in [
            "",
            "--conventional",
            "--center 123.456,-78.9 --depth 10 --step 4",
            "--turns 1 --top 3",
        ] {
            let options = format!("{BORE_200} {options}");
            let args = parse(&options).unwrap();
            let plan = Plan::new(&args).unwrap();
            let planned = plan.levels.iter().flat_map(|level| &level.pass.blocks);
            let read = curves(&program(&options).unwrap());
            assert_eq!(read.len(), planned.clone().count());
            for (block, read) in planned.zip(&read) {
                let length = block.curve.length();
                assert!((read.length() - length).abs() <= 1e-9);
                for i in 0..=200 {
                    let s = length * f64::from(i) / 200.0;
                    let error = (read.at(s).position - block.curve.at(s).position).amax();
                    assert!(error <= 1e-10, "{options}: {error:e}");
                }
            }
        }
    }

    #[test]
    fn climb_milling_writes_g3_and_conventional_g2() {
        let climb = program(BORE_200).unwrap();
        assert!(climb.contains("\nG3.2 ") && climb.contains("\nG3 ") && !climb.contains("\nG2"));
        let conventional = program(&format!("{BORE_200} --conventional")).unwrap();
        assert!(conventional.contains("\nG2.2 ") && conventional.contains("\nG2 "));
        assert!(!conventional.contains("\nG3"));
    }

    #[test]
    fn each_depth_is_roughed_before_any_is_finished() {
        let text = program(&format!("{BORE_200} --depth 9 --step 5")).unwrap();
        let places: Vec<_> = [
            "(roughing at Z-4.5)",
            "(roughing at Z-9)",
            "(finishing at Z-4.5)",
            "(finishing at Z-9)",
        ]
        .into_iter()
        .map(|title| text.find(title).unwrap())
        .collect();
        assert!(places.is_sorted());
    }

    #[test]
    fn comments_have_no_parentheses_inside_and_lines_stay_short() {
        for line in program(BORE_200).unwrap().lines() {
            assert!(line.len() <= 200 && line.is_ascii());
            assert_eq!(
                line.matches('(').count(),
                usize::from(line.starts_with('(')),
                "{line}"
            );
        }
    }

    #[test]
    fn the_impossible_is_refused_with_its_numbers_and_nothing_is_written() {
        for (options, expected) in [
            (
                "--hole 30 --tool 40 --pitch 4",
                "40 mm does not fit into the hole of 30 mm",
            ),
            ("--hole 200 --tool 40 --pitch 0", "pitch of 0 mm"),
            (
                "--hole 200 --tool 40 --pitch 4 --allowance 80",
                "allowance of 80 mm",
            ),
            (
                "--hole 200 --tool 40 --pitch 4 --start 90,0",
                "90 mm from the hole's centre",
            ),
            ("--hole 200 --tool 40 --pitch 4 --finish --turns 0", "0 turns"),
            ("--hole 200 --tool 40 --pitch 4 --feed nan", "--feed NaN"),
            (
                "--hole 200 --tool 40 --pitch 4 --depth -3",
                "bottom must lie below the top",
            ),
            ("--hole 200 --tool 40 --pitch 4 --start 1", "two finite numbers"),
            ("--hole 200 --tool 40", "--pitch"),
        ] {
            let error = program(options).unwrap_err();
            assert!(error.contains(expected), "{options}: {error}");
        }
    }
}
