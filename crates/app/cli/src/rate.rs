//! `evolvent rate`: the control rate that a machine needs.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use evolvent_analysis::{ChordQuestion, ChordQuestionError, RateReport};
use evolvent_config::{check_outputs, write_whole};
use evolvent_machine::{DEFAULT_MIN_RADIUS_MM, GRAVITY_MM_S2, Machine, RateInput};
use serde_json::json;

use crate::CommandError;

/// Compute the rational control rate: the rate at which, under the machine's limits, no chord between two
/// setpoints deviates from a curve by more than the permitted error.
///
/// Give a machine file, or at least one of --acceleration-g, --jerk and --feed; values that are not given do
/// not limit. With --at-rate, --at-feed and --at-radius: step and chord error of one point, or the one of the
/// three that is omitted.
#[derive(Args, Debug, Default)]
pub(crate) struct RateArgs {
    /// Machine file; the largest limits over its linear axes apply
    #[arg(long, value_name = "FILE", conflicts_with_all = ["acceleration_g", "jerk", "feed"])]
    pub(crate) machine: Option<PathBuf>,
    /// Maximum acceleration of an axis, in g (9.81 m/s2)
    #[arg(long, value_name = "N")]
    pub(crate) acceleration_g: Option<f64>,
    /// Maximum jerk of an axis, in m/s3
    #[arg(long, value_name = "M_S3")]
    pub(crate) jerk: Option<f64>,
    /// Maximum feed, in mm/min
    #[arg(long, value_name = "MM_MIN")]
    pub(crate) feed: Option<f64>,
    /// Increments per millimetre (1000 is a grid of 1 um); default: the machine file's
    #[arg(long, value_name = "K", required_unless_present = "machine")]
    pub(crate) increments_per_mm: Option<f64>,
    /// Permitted chord error, in increments; default: the machine file's, or 1
    #[arg(long, value_name = "INCREMENTS")]
    pub(crate) permitted_error: Option<f64>,
    /// Smallest radius of curvature to consider, in mm; default: the machine file's, or 0.25
    #[arg(long, value_name = "MM")]
    pub(crate) min_radius: Option<f64>,
    #[command(flatten)]
    pub(crate) point: PointArgs,
    /// Print one JSON object on standard output
    #[arg(long)]
    pub(crate) json: bool,
    /// Write permitted feed over radius (per axis), rate over feed and rate over acceleration into one SVG
    /// file
    #[arg(long, value_name = "FILE.svg")]
    pub(crate) plot: Option<PathBuf>,
}

/// One point of the paper's diagrams: any two of the three give the third at the permitted error, all three
/// give the error.
#[derive(Args, Clone, Copy, Debug, Default)]
pub(crate) struct PointArgs {
    /// Control rate, in Hz: with --at-feed and --at-radius the chord error, with one of them the limit of the
    /// other
    #[arg(long, value_name = "HZ")]
    pub(crate) at_rate: Option<f64>,
    /// Feed, in mm/min, as above
    #[arg(long, value_name = "MM_MIN")]
    pub(crate) at_feed: Option<f64>,
    /// Radius of curvature of the path, in mm, as above
    #[arg(long, value_name = "MM")]
    pub(crate) at_radius: Option<f64>,
}

impl PointArgs {
    fn question(self) -> ChordQuestion {
        ChordQuestion {
            rate_hz: self.at_rate,
            feed_mm_min: self.at_feed,
            radius_mm: self.at_radius,
        }
    }
}

/// Computes the rate and writes it to `out`, as a table or as one JSON object; notes go to `err`.
///
/// # Errors
/// `Usage` for a bad machine file or bad numbers, `Failed` if output or picture cannot be written.
pub(crate) fn run(args: &RateArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<(), CommandError> {
    let machine = match &args.machine {
        Some(file) => Some(Machine::load(file).map_err(|error| CommandError::Usage(error.to_string()))?),
        None => None,
    };
    if let Some(file) = &args.plot {
        check_svg_name(file)?;
        let machine = args.machine.as_deref().map(|file| (file, "the machine file"));
        check_outputs([file.as_path()], machine)?;
    }
    let input = input(args, machine.as_ref())?;
    let question = args.point.question();
    let point = if question.is_given() {
        Some(question.point(&input).map_err(refusal)?)
    } else {
        None
    };
    let limits = [args.acceleration_g, args.jerk, args.feed];
    if let Some(point) = point
        && machine.is_none()
        && limits.iter().all(Option::is_none)
    {
        if args.plot.is_some() {
            return Err(CommandError::Usage(
                "--plot draws the limits of a machine: give --machine, or at least one of --acceleration-g, \
                 --jerk and --feed"
                    .to_owned(),
            ));
        }
        let report = if args.json {
            format!("{:#}\n", json!({ "point": point.json() }))
        } else {
            point.text()
        };
        return written(out, &report);
    }
    let rate = RateReport::new(machine.as_ref(), &input)?;
    if let Some(file) = &args.plot {
        write_whole(file, rate.svg()?.as_bytes())
            .map_err(|error| CommandError::Failed(format!("{}: cannot write: {error}", file.display())))?;
        let _ = writeln!(err, "figures written to {}", file.display());
    }
    let report = if args.json {
        let mut object = rate.json();
        if let Some(point) = point {
            object["point"] = point.json();
        }
        format!("{object:#}\n")
    } else {
        let one = point.map_or_else(String::new, |point| point.text());
        rate.text() + &one
    };
    written(out, &report)
}

/// An error of a point, with the names of the options.
fn refusal(error: ChordQuestionError) -> CommandError {
    CommandError::Usage(match error {
        ChordQuestionError::Impossible { name, .. } => {
            let at = if matches!(name, "rate" | "feed" | "radius") {
                "at-"
            } else {
                ""
            };
            let text = error.to_string();
            let rest = text.strip_prefix(name).unwrap_or(&text);
            format!("--{at}{}{rest}", name.replace(' ', "-"))
        }
        ChordQuestionError::TooFew => {
            "give two of --at-rate, --at-feed and --at-radius for the third, or all three for the chord error"
                .to_owned()
        }
    })
}

fn written(out: &mut dyn Write, report: &str) -> Result<(), CommandError> {
    out.write_all(report.as_bytes())
        .and_then(|()| out.flush())
        .map_err(|error| CommandError::Failed(format!("cannot write the result: {error}")))
}

fn input(args: &RateArgs, machine: Option<&Machine>) -> Result<RateInput, CommandError> {
    let mut input = match machine {
        Some(machine) => machine.rate_input(),
        None => RateInput {
            max_feed_mm_s: args.feed.map_or(f64::INFINITY, |feed| feed / 60.0),
            acceleration_mm_s2: args.acceleration_g.map_or(f64::INFINITY, |n| n * GRAVITY_MM_S2),
            jerk_mm_s3: args.jerk.map_or(f64::INFINITY, |jerk| jerk * 1000.0),
            increments_per_mm: args.increments_per_mm.ok_or_else(|| {
                CommandError::Usage("give --increments-per-mm, or a machine file with --machine".to_owned())
            })?,
            permitted_error_increments: 1.0,
            min_radius_mm: DEFAULT_MIN_RADIUS_MM,
        },
    };
    input.increments_per_mm = args.increments_per_mm.unwrap_or(input.increments_per_mm);
    input.permitted_error_increments = args.permitted_error.unwrap_or(input.permitted_error_increments);
    input.min_radius_mm = args.min_radius.unwrap_or(input.min_radius_mm);
    Ok(input)
}

pub(crate) fn check_svg_name(file: &Path) -> Result<(), CommandError> {
    if file
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("svg"))
    {
        return Ok(());
    }
    Err(CommandError::Usage(format!(
        "{}: figures are SVG: use the extension .svg",
        file.display()
    )))
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;

    fn ran(args: &RateArgs) -> (Result<(), CommandError>, String, String) {
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let result = run(args, &mut out, &mut err);
        (
            result,
            String::from_utf8(out).unwrap(),
            String::from_utf8(err).unwrap(),
        )
    }

    fn usage(args: &RateArgs) -> String {
        match ran(args).0 {
            Err(CommandError::Usage(message)) => message,
            _ => panic!("accepted: {args:?}"),
        }
    }

    fn paper() -> RateArgs {
        RateArgs {
            acceleration_g: Some(1.0),
            jerk: Some(50.0),
            feed: Some(100_000.0),
            increments_per_mm: Some(1000.0),
            json: true,
            ..RateArgs::default()
        }
    }

    fn shipped(stem: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../../config/machines/{stem}.toml"))
    }

    #[test]
    fn json_is_one_object_with_the_papers_figures() {
        let (result, out, err) = ran(&paper());
        assert!(result.is_ok() && err.is_empty());
        let value: Value = serde_json::from_str(&out).unwrap();
        let number = |key: &str| value[key].as_f64().unwrap();
        assert!((number("rate_hz") - 1068.2).abs() < 0.05);
        assert!((number("radius_mm") - 304.3).abs() < 0.05);
        assert!((number("feed_mm_min") - 100_000.0).abs() < 1e-6);
        assert_eq!(number("period_ns"), (1e9 / number("rate_hz")).floor());
        assert_eq!(value["limited_by"], "feed");
        assert_eq!(value["and_by"], "jerk");
    }

    #[test]
    fn what_is_not_given_does_not_limit() {
        let (_, out, _) = ran(&RateArgs {
            feed: None,
            ..paper()
        });
        let value: Value = serde_json::from_str(&out).unwrap();
        assert!((value["rate_hz"].as_f64().unwrap() - 1107.36).abs() < 0.01);
        assert!(value["max_feed_mm_min"].is_null());
    }

    #[test]
    fn options_override_the_machine_file() {
        let args = RateArgs {
            machine: Some(shipped("6r13gn1")),
            json: true,
            ..RateArgs::default()
        };
        let rate = |args: &RateArgs| {
            let value: Value = serde_json::from_str(&ran(args).1).unwrap();
            value["rate_hz"].as_f64().unwrap()
        };
        assert!((rate(&args) - 110.85).abs() < 0.01);
        assert!(
            (rate(&RateArgs {
                increments_per_mm: Some(1e5),
                ..args
            }) - 1107.37)
                .abs()
                < 0.01
        );
    }

    #[test]
    fn text_names_the_axes_and_the_bounds_of_the_loop() {
        let (_, out, _) = ran(&RateArgs {
            machine: Some(shipped("ucp-710")),
            ..RateArgs::default()
        });
        // Axis rates of X and Z from the paper's table.
        assert!(out.contains("axis X alone         444.57 Hz"), "{out}");
        assert!(out.contains("axis Z alone         512.38 Hz"), "{out}");
        let (_, out, _) = ran(&RateArgs {
            machine: Some(shipped("fp7m")),
            ..RateArgs::default()
        });
        assert!(
            out.contains("121.43 Hz") && out.contains("minimum rate of the loop is 250 Hz"),
            "{out}"
        );
    }

    #[test]
    fn bad_numbers_and_files_are_usage_errors() {
        for bad in [f64::NAN, -1.0, 0.0, f64::INFINITY, 1e300] {
            assert!(
                usage(&RateArgs {
                    increments_per_mm: Some(bad),
                    ..paper()
                })
                .contains("increments")
            );
            assert!(
                usage(&RateArgs {
                    permitted_error: Some(bad),
                    ..paper()
                })
                .contains("permitted")
            );
            assert!(
                usage(&RateArgs {
                    min_radius: Some(bad),
                    ..paper()
                })
                .contains("radius")
            );
        }
        assert!(
            usage(&RateArgs {
                jerk: Some(-1.0),
                ..paper()
            })
            .contains("jerk")
        );
        assert!(
            usage(&RateArgs {
                increments_per_mm: None,
                ..paper()
            })
            .contains("--increments-per-mm")
        );
        let missing = RateArgs {
            machine: Some("no/such.toml".into()),
            ..RateArgs::default()
        };
        assert!(usage(&missing).contains("no/such.toml"));
        let nothing = RateArgs {
            increments_per_mm: Some(1000.0),
            ..RateArgs::default()
        };
        assert!(usage(&nothing).contains("at least one"));
        assert!(
            usage(&RateArgs {
                plot: Some("figures.png".into()),
                ..paper()
            })
            .contains(".svg")
        );
    }

    #[test]
    fn refusals_of_a_point_name_the_options() {
        let point = |at_feed, permitted_error| RateArgs {
            point: PointArgs {
                at_feed,
                ..PointArgs::default()
            },
            permitted_error,
            ..paper()
        };
        assert!(
            usage(&point(Some(1000.0), None)).starts_with("give two of --at-rate, --at-feed and --at-radius")
        );
        assert_eq!(
            usage(&point(Some(-1.0), None)),
            "--at-feed -1 is impossible: give a number above 0 and up to 1e9"
        );
        assert!(usage(&point(Some(1.0), Some(-1.0))).starts_with("--permitted-error -1 is impossible"));
    }

    #[test]
    fn a_picture_of_no_limits_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rate.svg");
        let args = RateArgs {
            increments_per_mm: Some(1000.0),
            plot: Some(file.clone()),
            point: PointArgs {
                at_rate: Some(1000.0),
                at_radius: Some(10.0),
                ..PointArgs::default()
            },
            ..RateArgs::default()
        };
        assert!(usage(&args).starts_with("--plot draws the limits of a machine: give --machine"));
        assert!(!file.exists());
    }

    #[test]
    fn a_picture_is_written_whole_or_not_at_all() {
        let folder = std::env::temp_dir().join(format!("evolvent-rate-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("rate.svg");
        let (result, _, err) = ran(&RateArgs {
            plot: Some(file.clone()),
            ..paper()
        });
        assert!(result.is_ok() && err.contains("rate.svg"));
        assert!(
            std::fs::read_to_string(&file)
                .unwrap()
                .trim_end()
                .ends_with("</svg>")
        );
        assert_eq!(
            std::fs::read_dir(&folder).unwrap().count(),
            1,
            "nothing else is left behind"
        );
        let nowhere = RateArgs {
            plot: Some(folder.join("no/such/rate.svg")),
            ..paper()
        };
        assert!(matches!(ran(&nowhere).0, Err(CommandError::Failed(_))));
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
