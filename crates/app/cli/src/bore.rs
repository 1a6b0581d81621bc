//! `evolvent bore`: a part program that mills a hole along involutes.
//!
//! Climb milling of a hole with clockwise spindle (M3) runs counter-clockwise (G3, G3.2); conventional
//! milling runs clockwise (G2, G2.2). All coordinates are those of the tool centre; cutter compensation is
//! not used.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use evolvent_analysis::{BoreError, BoreFinishing, BoreProgram, BoreRequest, BoreRoughing};
use evolvent_path::{HoleStart, Milling};

use crate::CommandError;

/// Write a part program that mills a hole to standard output.
#[derive(Args, Clone, Debug)]
pub(crate) struct BoreArgs {
    /// Diameter of the hole in mm.
    #[arg(long, value_name = "MM")]
    pub hole: f64,
    /// Diameter of the tool in mm.
    #[arg(long, value_name = "MM")]
    pub tool: f64,
    /// Maximum radial pitch of the roughing involute in mm per turn; required for roughing.
    #[arg(long, value_name = "MM", required_unless_present = "finish_only")]
    pub pitch: Option<f64>,
    /// Material that roughing leaves on the wall, in mm; for finishing at most the tool's diameter
    /// [default: 0].
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub allowance: Option<f64>,
    /// Finish the wall after roughing: involute approach, one turn, mirrored departure.
    #[arg(long)]
    pub finish: bool,
    /// Finish only: the hole is already roughed. Options of roughing are then rejected.
    #[arg(long)]
    pub finish_only: bool,
    /// Start of the finishing approach (without finishing: of roughing), in mm from the hole's centre. After
    /// roughing it must lie in the area that roughing has cleared for the tool.
    #[arg(long, value_name = "X,Y", value_parser = point, allow_hyphen_values = true)]
    pub start: Option<[f64; 2]>,
    /// Instead of --start: radius of curvature at the start of the finishing approach, in mm.
    #[arg(long, value_name = "MM", conflicts_with_all = ["start", "start_length"])]
    pub start_radius: Option<f64>,
    /// Instead of --start: length of the finishing approach in mm.
    #[arg(long, value_name = "MM", conflicts_with = "start")]
    pub start_length: Option<f64>,
    /// Start of roughing, in mm from the hole's centre, for instance in a pre-drilled hole [default: the
    /// centre].
    #[arg(long, value_name = "X,Y", value_parser = point, allow_hyphen_values = true)]
    pub rough_start: Option<[f64; 2]>,
    /// Turns of the complete finishing involute, usually 1 or 2 [default: 2].
    #[arg(long, value_name = "N")]
    pub turns: Option<u32>,
    /// Turns of the complete roughing involute, at least as many as the pitch requires
    /// [default: as the pitch requires].
    #[arg(long, value_name = "N")]
    pub rough_turns: Option<u32>,
    /// Climb milling: counter-clockwise with M3 (the default).
    #[arg(long, conflicts_with = "conventional")]
    pub climb: bool,
    /// Conventional milling: clockwise with M3.
    #[arg(long)]
    pub conventional: bool,
    /// Depth of the hole below its top in mm; 0 runs once at the top, as a trial.
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_negative_numbers = true)]
    pub depth: f64,
    /// Maximum step in depth in mm [default: the whole depth].
    #[arg(long, value_name = "MM", allow_negative_numbers = true)]
    pub step: Option<f64>,
    /// Z of the top of the hole in mm.
    #[arg(long, value_name = "MM", default_value_t = 0.0, allow_negative_numbers = true)]
    pub top: f64,
    /// Height above the top for rapid moves, in mm.
    #[arg(long, value_name = "MM", default_value_t = 5.0)]
    pub safe: f64,
    /// X and Y of the centre of the hole in mm.
    #[arg(long, visible_alias = "centre", value_name = "X,Y", value_parser = point, allow_hyphen_values = true,
          default_value = "0,0")]
    pub center: [f64; 2],
    /// Feed of the tool centre in mm/min.
    #[arg(long, value_name = "MM_MIN", default_value_t = 1000.0)]
    pub feed: f64,
    /// Feed for finishing in mm/min [default: the same].
    #[arg(long, value_name = "MM_MIN")]
    pub finish_feed: Option<f64>,
    /// Feed for plunging in mm/min.
    #[arg(long, value_name = "MM_MIN", default_value_t = 200.0)]
    pub plunge_feed: f64,
    /// Spindle speed in rev/min.
    #[arg(long, value_name = "RPM", default_value_t = 3000.0)]
    pub spindle: f64,
    /// Number of the tool to change to (T, M6) [default: no change].
    #[arg(long, value_name = "N")]
    pub tool_number: Option<u32>,
    /// Blend corners within this tolerance in mm (G64 P) [default: exact path, G61].
    #[arg(long, value_name = "MM")]
    pub tolerance: Option<f64>,
    /// Instead of the program, print one JSON object with the numbers of every block (phi0, psi, radii of
    /// curvature, length), visible turns, and the comparison of --compare.
    #[arg(long)]
    pub json: bool,
    /// Instead of the program, print length and time of the first pass along the involute, half circles, an
    /// Archimedean spiral and a helix.
    #[arg(long)]
    pub compare: bool,
    /// Machine file with the limits for the times of --compare; without it only lengths are printed.
    #[arg(long, value_name = "FILE", requires = "compare")]
    pub machine: Option<PathBuf>,
}

impl BoreArgs {
    /// Rejects options of a part of the work that is omitted, since they would have no effect.
    fn check(&self) -> Result<(), CommandError> {
        let roughing = [
            ("--pitch", self.pitch.is_some()),
            ("--allowance", self.allowance.is_some()),
            ("--rough-turns", self.rough_turns.is_some()),
            ("--rough-start", self.rough_start.is_some()),
        ];
        let finishing = [
            ("--turns", self.turns.is_some()),
            ("--start-radius", self.start_radius.is_some()),
            ("--start-length", self.start_length.is_some()),
            ("--finish-feed", self.finish_feed.is_some()),
        ];
        let given = |options: &[(&'static str, bool)]| {
            options
                .iter()
                .find(|(_, is_given)| *is_given)
                .map(|(name, _)| *name)
        };
        if self.finish_only
            && let Some(name) = given(&roughing)
        {
            return Err(CommandError::Usage(format!(
                "{name} is an option of roughing, which --finish-only omits: remove one of the two, or \
                 use --finish"
            )));
        }
        if !(self.finish || self.finish_only)
            && let Some(name) = given(&finishing)
        {
            return Err(CommandError::Usage(format!(
                "{name} is an option of finishing: add --finish or --finish-only, or remove it"
            )));
        }
        Ok(())
    }

    fn request(&self) -> BoreRequest {
        let roughing = (!self.finish_only).then(|| BoreRoughing {
            pitch_mm: self.pitch.unwrap_or(f64::NAN),
            turns: self.rough_turns,
            allowance_mm: self.allowance.unwrap_or(0.0),
            start: match (self.rough_start, self.start, self.finish) {
                (Some(point), _, _) | (None, Some(point), false) => HoleStart::Point(point),
                _ => HoleStart::Centre,
            },
        });
        let finishing = (self.finish || self.finish_only).then(|| BoreFinishing {
            turns: self.turns.unwrap_or(2),
            start: self
                .start
                .map(HoleStart::Point)
                .or(self.start_radius.map(HoleStart::CurvatureRadius))
                .or(self.start_length.map(HoleStart::Length)),
        });
        BoreRequest {
            hole_mm: self.hole,
            tool_mm: self.tool,
            milling: if self.conventional {
                Milling::Conventional
            } else {
                Milling::Climb
            },
            centre_mm: self.center,
            top_mm: self.top,
            depth_mm: self.depth,
            step_mm: self.step,
            safe_mm: self.safe,
            roughing,
            finishing,
            feed_mm_min: self.feed,
            finish_feed_mm_min: self.finish_feed,
            plunge_feed_mm_min: self.plunge_feed,
            spindle_rpm: self.spindle,
            tool_number: self.tool_number,
            tolerance_mm: self.tolerance,
        }
    }
}

/// Writes the part program for `args`, or its numbers.
///
/// Nothing is written unless the whole program is possible.
///
/// # Errors
/// `Usage` for an impossible hole, with its numbers; `Failed` if writing or planning fails.
pub(crate) fn run(args: &BoreArgs, out: &mut dyn Write) -> Result<(), CommandError> {
    args.check()?;
    let program = BoreProgram::new(args.request()).map_err(|error| {
        CommandError::Usage(match error {
            BoreError::Number { .. }
            | BoreError::FewTurns { .. }
            | BoreError::Ring { .. }
            | BoreError::FinishStart { .. } => format!("--{error}"),
            BoreError::Hole(_) | BoreError::Circle { .. } => error.to_string(),
        })
    })?;
    let comparison = if args.compare {
        Some(program.compare(args.machine.as_deref())?)
    } else {
        None
    };
    let text = if args.json {
        format!("{:#}\n", program.json(comparison.as_ref()))
    } else if let Some(comparison) = &comparison {
        comparison.text()
    } else {
        program.text()
    };
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(|error| CommandError::Failed(format!("the program could not be written: {error}")))
}

/// Two numbers separated by a comma.
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
        _ => Err("give two finite numbers separated by a comma, as in -40,40".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use evolvent_path::{Arc, Axes, Curve, Involute, Plane, Sense};
    use serde_json::Value;

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
        run(&args, &mut out).map_err(|error| match error {
            CommandError::Usage(text) | CommandError::Failed(text) => text,
        })?;
        Ok(String::from_utf8(out).unwrap())
    }

    const BORE_200: &str = "--hole 200 --tool 40 --pitch 4 --allowance 1 --finish --start -40,40";

    /// The curves of a program's G2, G3, G2.2 and G3.2, read by an independent parser.
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
    fn written_program_matches_plan_within_a_nanometre() {
        for options in [
            "",
            "--conventional",
            "--center 123.456,-78.9 --depth 10 --step 4",
            "--turns 1 --top 3",
        ] {
            let options = format!("{BORE_200} {options}");
            let args = parse(&options).unwrap();
            let plan = BoreProgram::new(args.request()).unwrap();
            let planned = plan.blocks();
            let read = curves(&program(&options).unwrap());
            assert_eq!(read.len(), plan.blocks().count());
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
    fn documented_command_writes_the_shipped_program() {
        let options = format!("{BORE_200} --depth 8 --feed 9000 --plunge-feed 600 --spindle 8000");
        assert_eq!(
            program(&options).unwrap(),
            include_str!("../../../../tests/programs/bore-200.ngc")
        );
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
        let positions: Vec<_> = [
            "(roughing at Z-4.5)",
            "(roughing at Z-9)",
            "(finishing at Z-4.5)",
            "(finishing at Z-9)",
        ]
        .into_iter()
        .map(|title| text.find(title).unwrap())
        .collect();
        assert!(positions.is_sorted());
    }

    #[test]
    fn lines_are_short_and_comments_do_not_nest() {
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
    fn impossible_holes_are_refused_before_writing() {
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
                "bottom must be below the top",
            ),
            ("--hole 200 --tool 40 --pitch 4 --start 1", "two finite numbers"),
            ("--hole 200 --tool 40", "--pitch"),
            (
                "--hole 200 --tool 40 --finish-only --allowance 1",
                "--allowance is an option of roughing, which --finish-only omits",
            ),
            (
                "--hole 200 --tool 40 --finish-only --pitch 4",
                "--pitch is an option of roughing",
            ),
            (
                "--hole 200 --tool 40 --finish-only --rough-turns 20",
                "--rough-turns is an option of roughing",
            ),
            (
                "--hole 200 --tool 40 --finish-only --rough-start 1,1",
                "--rough-start is an option of roughing",
            ),
            (
                "--hole 200 --tool 40 --pitch 4 --turns 1",
                "--turns is an option of finishing: add --finish or --finish-only",
            ),
            (
                "--hole 200 --tool 40 --pitch 4 --start-radius 9",
                "--start-radius is an option of finishing",
            ),
            (
                "--hole 200 --tool 40 --pitch 4 --start-length 9",
                "--start-length is an option of finishing",
            ),
            (
                "--hole 200 --tool 40 --pitch 4 --finish-feed 9",
                "--finish-feed is an option of finishing",
            ),
            (
                "--hole 20 --tool 8 --pitch 1 --rough-turns 2",
                "--rough-turns 2 gives a pitch of 3 mm per turn, above the maximum of 1 mm: give at least 6 \
                 turns",
            ),
        ] {
            let error = program(options).unwrap_err();
            assert!(error.contains(expected), "{options}: {error}");
        }
    }

    const FAST_BORE_200: &str =
        "--hole 200 --tool 40 --pitch 4 --allowance 1 --finish --start -40,40 --feed 9000";

    #[test]
    fn json_holds_the_six_numbers_of_tables_2_and_3() {
        let object: Value =
            serde_json::from_str(&program(&format!("{FAST_BORE_200} --json")).unwrap()).unwrap();
        let number = |pointer: &str| object.pointer(pointer).and_then(Value::as_f64).unwrap();
        for (pointer, printed, tolerance) in [
            ("/passes/0/base_radius_mm", 0.628_662_025, 5e-10),
            ("/passes/0/visible_turns", 20.0, 1e-12),
            ("/passes/0/blocks/0/length_mm", 4_963.716_39, 5e-6),
            ("/passes/0/blocks/0/phi0_rad", 0.0, 1e-12),
            ("/passes/0/blocks/0/r_k_mm", 79.0, 1e-9),
            ("/passes/0/blocks/1/length_mm", 496.371_639, 5e-7),
            ("/passes/1/blocks/0/length_mm", 242.249_73, 5e-6),
            ("/passes/1/blocks/0/phi0_rad", 9.044_814_77, 5e-9),
            ("/passes/1/blocks/0/psi_rad", 0.946_567_32, 5e-9),
            ("/passes/1/blocks/0/r_n_mm", 57.5811, 5e-5),
            ("/passes/1/blocks/0/r_k_mm", 80.0, 1e-9),
            // From phi0 to 4 pi.
            (
                "/passes/1/visible_turns",
                2.0 - 9.044_814_77 / std::f64::consts::TAU,
                1e-8,
            ),
            ("/passes/1/blocks/1/start_mm/0", 64.913_119, 5e-7),
            ("/passes/1/blocks/1/start_mm/1", -46.757_748, 5e-7),
        ] {
            assert!(
                (number(pointer) - printed).abs() <= tolerance,
                "{pointer}: {}",
                number(pointer)
            );
        }
        // The paper's estimate of visible turns is close.
        let estimate = 2.0 * (1.0 - 40.0 * 2.0_f64.sqrt() / 80.0);
        assert!((number("/passes/1/visible_turns") - estimate).abs() < 0.05);
    }

    #[test]
    fn planned_times_keep_the_feed_and_rank_the_paths() {
        let machine = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../../config/machines/mill-3axis.toml"
        );
        let options = "--hole 60 --tool 20 --pitch 4 --feed 6000 --compare --json --machine";
        let object: Value = serde_json::from_str(&program(&format!("{options} {machine}")).unwrap()).unwrap();
        let list = object["comparison"].as_array().unwrap();
        let of = |name: &str| list.iter().find(|path| path["path"] == name).unwrap();
        for path in list.iter().filter(|path| path["path"] != "helix") {
            let (at_feed, planned) = (
                path["time_at_feed_s"].as_f64().unwrap(),
                path["planned_s"].as_f64().unwrap(),
            );
            assert!(planned > at_feed && planned < 1.6 * at_feed, "{path}");
        }
        // By hand: half circles of R/10, 2R/10, .. R, and one full circle, with a total length close to that
        // of the circles of their turns.
        let half = of("half circles")["length_mm"].as_f64().unwrap();
        assert!(
            (half - std::f64::consts::PI * (2.0 * 55.0 + 40.0)).abs() < 1e-9,
            "{half}"
        );
        let involute = of("involute")["length_mm"].as_f64().unwrap();
        assert!(
            (involute - std::f64::consts::PI * 20.0 * 7.0).abs() < 1e-6,
            "{involute}"
        );
        assert!(
            of("helix")["length_mm"].is_null()
                && of("helix")["remark"].as_str().unwrap().contains("30.000 mm")
        );
        // The hole's position on the machine does not change the times of paths that are within the travel.
        let moved: Value =
            serde_json::from_str(&program(&format!("{options} {machine} --center 20,-30")).unwrap()).unwrap();
        for (path, there) in list.iter().zip(moved["comparison"].as_array().unwrap()) {
            let (Some(here_s), Some(there_s)) = (path["planned_s"].as_f64(), there["planned_s"].as_f64())
            else {
                continue;
            };
            assert!((here_s / there_s - 1.0).abs() < 0.01, "{path} and {there}");
        }
        // If the hole is not within the travel, neither is any path.
        let beyond = program(&format!("{options} {machine} --center 9000,0")).unwrap_err();
        assert!(beyond.contains("involute"), "{beyond}");
        let deep = program("--hole 0.06 --tool 0.05 --pitch 0.001 --depth 400 --compare").unwrap();
        assert!(
            deep.contains("400000 turns of the pitch: too many to be planned"),
            "{deep}"
        );
        let wide = program("--hole 60 --tool 32 --pitch 4 --depth 10 --compare").unwrap();
        assert!(
            wide.contains("turns of the pitch down") && !wide.contains("NaN"),
            "{wide}"
        );
    }
}
