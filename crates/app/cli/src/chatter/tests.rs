//! Tests of the command with the shipped cases.

use std::path::{Path, PathBuf};

use evolvent_analysis::{AnalysisError, ChatterWarning, ChatterWarnings, chatter_warnings};
use evolvent_machine::Machine;
use evolvent_runtime::{CheckBounds, Setup};
use serde_json::Value;

use super::*;

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../../config/{name}.toml"))
}

fn ran(args: &ChatterArgs) -> (Result<Ending, CommandError>, String) {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let result = run(args, &mut out, &mut err);
    (result, String::from_utf8(out).unwrap())
}

fn json(name: &str) -> Value {
    let args = ChatterArgs {
        case: shipped(name),
        json: true,
        ..ChatterArgs::default()
    };
    let (result, out) = ran(&args);
    assert_eq!(result, Ok(Ending::Clean));
    serde_json::from_str(&out).unwrap()
}

fn refusal(text: &str, file: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let case = folder.path().join(file);
    std::fs::write(&case, text).unwrap();
    let args = ChatterArgs {
        case,
        ..ChatterArgs::default()
    };
    match ran(&args).0 {
        Err(CommandError::Usage(message)) => message,
        other => panic!("{other:?}"),
    }
}

#[track_caller]
fn near(value: &Value, expected: f64, relative: f64) {
    let value = value.as_f64().unwrap();
    assert!(
        (value / expected - 1.0).abs() <= relative,
        "{value} for {expected}"
    );
}

#[test]
fn worked_example_has_its_figures_and_assumptions() {
    let answer = &json("processes/chatter-40x")["oscillation"];
    assert_eq!(answer["verdict"], "self-excited");
    let cycle = &answer["cycles"][0];
    near(&cycle["frequency_hz"], 255.328_567, 1e-4);
    near(&cycle["amplitude_mm"][1], 0.421_526_4, 1e-3);
    near(&cycle["verified"]["amplitude_mm"][1], 0.421_526_4, 1e-6);
    near(&answer["speed_rpm"], 190.986, 1e-4);
    // Self-oscillation from about 40.5 m/min on.
    near(&answer["stable_speeds_m_min"][0], 40.4, 5e-3);
    let assumed = answer["assumptions"].to_string();
    for word in [
        "40X-R1",
        "reconstructed",
        "radial force is 0.4",
        "no regeneration",
        "extrapolated",
    ] {
        assert!(assumed.contains(word), "{word} is not in {assumed}");
    }
    // The text states them too.
    let args = ChatterArgs {
        case: shipped("processes/chatter-40x"),
        ..ChatterArgs::default()
    };
    let (_, text) = ran(&args);
    assert!(
        text.contains("vibrates by itself") && text.contains("no regeneration"),
        "{text}"
    );
    assert!(
        text.contains("nearest stable speeds: 40.") && text.contains("(128 rpm)"),
        "{text}"
    );
}

#[test]
fn bistable_example_has_two_cycles_and_hysteresis() {
    let answer = &json("processes/chatter-40x-bistable")["oscillation"];
    assert_eq!(answer["verdict"], "bistable");
    assert_eq!(answer["cycles"][0]["stable"], false);
    assert_eq!(answer["cycles"][1]["stable"], true);
    near(&answer["cycles"][0]["amplitude_mm"][1], 0.417_721_6, 1e-3);
    near(&answer["cycles"][1]["amplitude_mm"][1], 1.021_942_5, 1e-3);
    let sweep = answer["sweep"].as_array().unwrap();
    let with = |verdict: &str| sweep.iter().filter(|point| point["verdict"] == verdict).count();
    assert!(with("bistable") > 10 && with("self-excited") > 10 && with("stable") > 10);
}

#[test]
fn the_lobes_have_their_figures() {
    let turning = json("processes/lobes-turning");
    near(&turning["lobes"][0]["minima"][0]["depth_mm"], 7.184_976_9, 1e-7);
    near(&turning["lobes"][0]["minima"][1]["frequency_hz"], 151.491, 1e-6);
    assert!(turning["oscillation"].is_null());
}

/// Here the limits of the delay equation are below the minimum of the zero-order solution, so that minimum
/// must not be reported.
#[test]
fn minimum_milling_depth_comes_from_delay_equation() {
    let lobes = &json("processes/lobes-milling")["lobes"][0];
    let zero = lobes["minima"][0]["depth_mm"].as_f64().unwrap();
    let text = ran(&ChatterArgs {
        case: shipped("processes/lobes-milling"),
        ..ChatterArgs::default()
    })
    .1;
    let said = text
        .lines()
        .find(|line| line.contains("minimum limit from"))
        .unwrap();
    let depth: f64 = said
        .split(": ")
        .nth(1)
        .unwrap()
        .split(' ')
        .next()
        .unwrap()
        .parse()
        .unwrap();
    assert!(depth < zero && said.contains("delay equation"), "{text}");
    assert!(said.contains("Hopf") || said.contains("flip"), "{text}");
    assert!(said.contains(" Hz"), "{text}");
    assert!(!text.contains("stable at every speed"), "{text}");
}

/// Verdicts of the report for cuts whose vibration grows beyond the model after every impulse, according to
/// an independent program.
#[test]
fn cuts_beyond_the_model_are_reported() {
    let text = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let text = text
        .replace("depth_mm = 4.0", "depth_mm = 2.6080000000000001")
        .replace("speed_m_min = 60.0", "speed_m_min = 51.05")
        .replace("feed_mm_rev = 0.49", "feed_mm_rev = 0.2")
        .replace("beta_deg = 35.0", "beta_deg = 60.0")
        .replace("mass_kg = 6.0", "mass_kg = 1.2")
        .replace("30020020.401035063", "3300000.0")
        .replace("14994509.394629354", "3000000.0")
        .replace("damping_ratio = 0.03", "damping_ns_m = 103.47869345908848")
        .replace("damping_ratio = 0.02", "damping_ns_m = 98.66306299725343");
    let folder = tempfile::tempdir().unwrap();
    let case = folder.path().join("case.toml");
    std::fs::write(&case, text).unwrap();
    let spiral = folder.path().join("spiral.svg");
    let (result, out) = ran(&ChatterArgs {
        case,
        transient: Some(spiral.clone()),
        kick: Some(0.2),
        ..ChatterArgs::default()
    });
    assert_eq!(result, Ok(Ending::Clean));
    assert!(out.contains("leaves the model after an impulse"), "{out}");
    assert!(
        out.contains("2.608 mm deep, 0.2 mm/rev") && out.contains("leave the model"),
        "{out}"
    );
    assert!(
        out.contains("kick of 0.200 m/s along the cutting speed: dies out"),
        "{out}"
    );
    let svg = std::fs::read_to_string(spiral).unwrap();
    assert!(svg.contains("Phase plane") && svg.trim_end().ends_with("</svg>") && !svg.contains("NaN"));
}

#[test]
fn a_radial_law_of_its_own_is_read_and_named() {
    let text = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let given = "radial_ratio = 0.4              # Py / Pz: assumed, not measured";
    let folder = tempfile::tempdir().unwrap();
    let case = folder.path().join("case.toml");
    std::fs::write(&case, text.replace(given, "radial_law = \"py.toml\"")).unwrap();
    let law = "name = \"py-power\"\ndescription = \"measured\"\nkind = \"power\"\n[power]\n\
               coefficient_n = 900.0\nspeed_exponent = -0.3\ndepth_exponent = 0.7\nfeed_exponent = 0.6\n";
    let args = ChatterArgs {
        case,
        ..ChatterArgs::default()
    };
    let missing = ran(&args).0;
    assert!(matches!(missing, Err(CommandError::Usage(message)) if message.contains("py.toml")));
    std::fs::write(folder.path().join("py.toml"), law).unwrap();
    let (result, out) = ran(&args);
    assert_eq!(result, Ok(Ending::Clean));
    assert!(out.contains("radial force by law py-power: measured"), "{out}");
    assert!(!out.contains("of the tangential force"), "{out}");
    let both = text.replace(given, "radial_ratio = 0.4\nradial_law = \"py.toml\"");
    assert!(refusal(&both, "case.toml").contains("force.radial_law: given beside radial_ratio"));
}

#[test]
fn the_transient_of_a_kick_ends_where_the_cycle_is() {
    let folder = tempfile::tempdir().unwrap();
    let args = |kick: Option<f64>| ChatterArgs {
        case: shipped("processes/chatter-40x-bistable"),
        transient: Some(folder.path().join("kick.svg")),
        kick,
        ..ChatterArgs::default()
    };
    assert!(ran(&args(Some(0.3))).1.contains("dies out"));
    assert!(ran(&args(Some(1.1))).1.contains("settles on the cycle"));
    assert!(
        matches!(ran(&args(Some(f64::NAN))).0, Err(CommandError::Usage(message)) if message.contains("--kick"))
    );
}

#[test]
fn options_of_self_oscillation_are_refused_for_lobes() {
    let args = ChatterArgs {
        case: shipped("processes/lobes-turning"),
        ..ChatterArgs::default()
    };
    let refused = |args: &ChatterArgs| match ran(args).0 {
        Err(CommandError::Usage(message)) => message,
        other => panic!("{other:?}"),
    };
    let harmonics = ChatterArgs {
        harmonics: Some(7),
        case: args.case.clone(),
        ..ChatterArgs::default()
    };
    assert!(refused(&harmonics).contains("--harmonics"));
    let least_squares = ChatterArgs {
        least_squares: true,
        ..args
    };
    assert!(refused(&least_squares).contains("--least-squares"));
}

#[test]
fn json_cases_say_the_same_as_toml() {
    let folder = tempfile::tempdir().unwrap();
    let case = folder.path().join("case.json");
    let text = r#"{"name": "j", "turning": {"coefficient_n_mm2": 1000, "mode": [
        {"frequency_hz": 250, "damping_ratio": 0.012, "stiffness_n_m": 2.26e8, "direction_deg": 30}]},
        "lobes": {"speed_rpm": [2000, 9000], "points": 5}}"#;
    std::fs::write(&case, text).unwrap();
    let args = ChatterArgs {
        case,
        json: true,
        ..ChatterArgs::default()
    };
    let answer: Value = serde_json::from_str(&ran(&args).1).unwrap();
    near(&answer["lobes"][0]["minima"][0]["depth_mm"], 7.318_784, 1e-6);
}

#[test]
fn pictures_are_whole_and_belong_to_their_case() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| Some(folder.path().join(name));
    let small = folder.path().join("small.toml");
    let text = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let text = text
        .replace("points = 101", "points = 9")
        .replace("[0.3, 0.49]", "[0.49]\ncolumns = 6\nrows = 5");
    std::fs::write(&small, text).unwrap();
    let args = ChatterArgs {
        case: small.clone(),
        plot: file("plot.svg"),
        map: file("map.svg"),
        ..ChatterArgs::default()
    };
    assert_eq!(ran(&args).0, Ok(Ending::Clean));
    for name in ["plot.svg", "map.svg"] {
        let svg = std::fs::read_to_string(folder.path().join(name)).unwrap();
        assert!(
            svg.trim_end().ends_with("</svg>") && svg.contains("no regeneration"),
            "{name}"
        );
        assert!(!svg.contains("NaN"));
    }
    let wrong = ChatterArgs {
        case: small,
        lobes: file("lobes.svg"),
        ..ChatterArgs::default()
    };
    assert!(
        matches!(ran(&wrong).0, Err(CommandError::Usage(message)) if message.contains("[turning] or [milling]"))
    );
}

#[test]
fn bad_cases_are_refused_with_file_line_and_key() {
    let good = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let line_of = |part: &str| good.lines().position(|line| line.contains(part)).unwrap() + 1;
    for (from, to, key) in [
        ("depth_mm = 4.0", "depth_mm = -4.0", "cut.depth_mm"),
        ("depth_mm = 4.0", "depth_mm = nan", "cut.depth_mm"),
        ("depth_mm = 4.0", "depth = 4.0", "cut.depth"),
        ("law = \"40X-R1\"", "law = \"50X\"", "force.law"),
        ("beta_deg = 35.0", "beta_deg = \"x\"", "tool.beta_deg"),
        (
            "damping_ratio = 0.02",
            "damping_ratio = 2.0",
            "tool.axis[1].damping_ratio",
        ),
        ("speed_m_min = 60.0", "speed_m_min = 1.5", "cut.speed_m_min"),
    ] {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good, "{from}");
        let message = refusal(&text, "case.toml");
        let location = format!("case.toml:{}:", line_of(from));
        assert!(
            message.contains(&location) && message.contains(&format!(" {key}: ")),
            "{message}"
        );
    }
    assert!(refusal("name = \"x\"", "case.toml").contains("nothing to compute"));
    assert!(refusal("name = = 1", "case.toml").contains("not valid TOML"));
    let no_law = good.replacen("40X-R1", "missing.toml", 1);
    assert!(refusal(&no_law, "case.toml").contains("missing.toml: cannot read the law file"));
    // A rake angle at which the law has a pole.
    let pole = good.replacen("rake_deg = 10.0", "rake_deg = 35.0", 1);
    assert!(refusal(&pole, "case.toml").contains("pole"));
}

fn warned(program: &str, machine: &str, case: &str) -> Result<Vec<ChatterWarning>, AnalysisError> {
    warned_within(program, machine, case, CheckBounds::whole(1)).map(|warnings| warnings.found().to_vec())
}

fn warned_within(
    program: &str,
    machine: &str,
    case: &str,
    bounds: CheckBounds,
) -> Result<ChatterWarnings, AnalysisError> {
    let folder = tempfile::tempdir().unwrap();
    let (file, case_file) = (folder.path().join("shaft.ngc"), folder.path().join("case.toml"));
    std::fs::write(&file, program).unwrap();
    std::fs::write(&case_file, case).unwrap();
    let machine_file = shipped(machine);
    let mut text = std::fs::read_to_string(&machine_file).unwrap();
    if program.contains('$') {
        text += "\n[[spindle]]\nmax_rpm = 4000\n[[spindle]]\nnumber = 1\nmax_rpm = 3000\n";
    }
    let machine = Machine::parse(&text, "lathe.toml").unwrap();
    let setup = Setup::new(machine, machine_file, text, None).unwrap();
    chatter_warnings(&file, &setup, &case_file, bounds)
}

const SHAFT: &str = "G21 G18 G90 G94\nM3 S191\nG0 X60 Z410\nG1 X50 F93.6\nG1 Z300\nG0 X60 Z410\nS128\n\
                     G1 X50 F62.72\nG1 Z300\nM2\n";

#[test]
fn lines_with_chatter_name_the_nearest_stable_speed() {
    let case = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let found = warned(SHAFT, "machines/lathe-2axis", &case).unwrap();
    // 191 rpm on a diameter of 100 mm are 60 m/min; 129 rpm are 40.5 and just beyond the border.
    let longitudinal = found.iter().find(|warning| warning.line == 5).unwrap();
    assert_eq!(longitudinal.verdict, "self-excited");
    assert!((longitudinal.speed_m_min - 60.0).abs() < 0.01 && (longitudinal.feed_mm_rev - 0.49).abs() < 1e-4);
    assert_eq!(longitudinal.depth_mm, 4.0);
    let slower = longitudinal.stable_rpm[0].unwrap();
    assert_eq!(slower, 128.0);
    assert!(found.iter().all(|warning| warning.line < 7), "{found:?}");
    let text = longitudinal.text("shaft.ngc");
    assert!(
        text.starts_with("shaft.ngc:5: warning:") && text.contains("of the process file"),
        "{text}"
    );
    // Rapids and stopped spindles do not cut; if the case has no diameter, X gives it.
    let without = case.replacen("diameter_mm = 100.0", "", 1);
    let stopped = SHAFT.replace("M3 S191", "M5").replace("S128\n", "");
    assert!(
        warned(&stopped, "machines/lathe-2axis", &case)
            .unwrap()
            .is_empty()
    );
    let by_x = warned(SHAFT, "machines/lathe-2axis", &without).unwrap();
    let line = by_x.iter().find(|warning| warning.line == 5).unwrap();
    assert!((line.diameter_mm - 100.0).abs() < 1e-9, "{line:?}");
}

#[test]
fn a_cut_uses_the_feed_spindle_or_the_last_started() {
    let case = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let of_line_5 = |program: &str| {
        let found = warned(program, "machines/lathe-2axis", &case).unwrap();
        let warning = found.into_iter().find(|warning| warning.line == 5);
        warning.map(|warning| (warning.spindle, warning.speed_rpm, warning.feed_mm_rev))
    };
    let near = |found: Option<(u32, f64, f64)>, spindle: u32| {
        let Some((number, rpm, feed)) = found else {
            return false;
        };
        number == spindle && (rpm - 191.0).abs() < 1e-9 && (feed - 0.49).abs() < 1e-3
    };
    // Spindle 0 turns at a stable speed.
    let begin = "G21 G18 G90 G94 S60 M3\nM3 S191 $1\nG0 X60 Z410\n";
    let by_time = format!("{begin}G1 X50 F93.6\nG1 Z300\nM2\n");
    assert!(near(of_line_5(&by_time), 1));
    let by_turn = format!("{begin}G95 $1 F0.49 G1 X50\nG1 Z300\nM2\n");
    assert!(near(of_line_5(&by_turn), 1));
    let of_other = format!("{begin}G95 F0.49 G1 X50\nG1 Z300\nM2\n");
    assert!(!near(of_line_5(&of_other), 1));
    let stopped = by_time.replace("G1 X50 F93.6", "M5 $1 G1 X50 F93.6");
    assert!(of_line_5(&stopped).is_none_or(|(spindle, ..)| spindle == 0));
    let found = warned(&by_time, "machines/lathe-2axis", &case).unwrap();
    assert!(
        found[0].text("a.ngc").contains("191 rpm of spindle 1"),
        "{}",
        found[0].text("a.ngc")
    );
}

#[test]
fn a_depth_that_the_cycle_gives_counts() {
    let case = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let program = "G21 G18 G90 G94\nM3 S191\nG0 X60 Z410\nF93.6\nG82 X50 Z300 D0.2\nM2\n";
    let found = warned(program, "machines/lathe-2axis", &case).unwrap();
    // At a depth of 0.2 mm the cut is stable at any speed.
    assert!(found.iter().all(|warning| warning.depth_mm != 0.2), "{found:?}");
    let deep = program.replace("D0.2", "D4");
    let found = warned(&deep, "machines/lathe-2axis", &case).unwrap();
    assert!(
        found
            .iter()
            .any(|warning| warning.depth_from == "of the cycle" && warning.depth_mm == 4.0),
        "{found:?}"
    );
}

#[test]
fn predictions_for_turning_are_refused_on_a_mill() {
    let case = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let refused = warned(SHAFT, "machines/mill-3axis", &case);
    assert!(matches!(refused, Err(AnalysisError::Input(message)) if message.contains("is not a lathe")));
}

#[test]
fn an_endless_loop_is_left_at_the_bound_of_the_check() {
    let case = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let program = "G21 G18 G90 G94\nM3 S191\nG0 X60 Z410\nG1 X50 F93.6\no1 while [1]\nG1 Z300\nG0 Z410\n\
                   o1 endwhile\nM2\n";
    let bounds = CheckBounds {
        round: 1000,
        ..CheckBounds::whole(1)
    };
    let warnings = warned_within(program, "machines/lathe-2axis", &case, bounds).unwrap();
    assert!(warnings.found().iter().any(|warning| warning.line == 6));
    let text = warnings.text("a.ngc");
    assert!(
        text.contains("a.ngc: chatter was checked up to line 7: line 7 has more than 1000 commands"),
        "{text}"
    );
}

#[test]
fn warnings_that_are_not_listed_are_counted() {
    use std::fmt::Write as _;
    let case = std::fs::read_to_string(shipped("processes/chatter-40x")).unwrap();
    let mut program = "G21 G18 G90 G94\nM3 S191\nG0 X50 Z410\nF93.6\n".to_owned();
    for line in 0..1010 {
        writeln!(program, "G1 Z{}", 300 + line % 2).unwrap();
    }
    program.push_str("M2\n");
    let begun = std::time::Instant::now();
    let warnings = warned_within(&program, "machines/lathe-2axis", &case, CheckBounds::whole(1)).unwrap();
    let took = begun.elapsed();
    assert_eq!(warnings.found().len(), 1000);
    let text = warnings.text("a.ngc");
    assert!(
        text.contains("a.ngc: 10 more lines with cuts that are predicted"),
        "{text}"
    );
    // One repeated cut: its stable speeds are searched once, not a thousand times.
    let begun = std::time::Instant::now();
    let few = program.lines().take(6).collect::<Vec<_>>().join("\n") + "\nM2\n";
    let first = warned_within(&few, "machines/lathe-2axis", &case, CheckBounds::whole(1)).unwrap();
    let one = begun.elapsed();
    assert_eq!(first.found().len(), 2);
    assert!(took < 100 * one, "{took:?} for 1000 lines, {one:?} for 2");
}

#[test]
fn two_pictures_in_one_file_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let args = ChatterArgs {
        case: shipped("processes/chatter-40x"),
        plot: Some(folder.path().join("a.svg")),
        transient: Some(folder.path().join("./a.svg")),
        ..ChatterArgs::default()
    };
    let refused = ran(&args).0;
    assert!(
        matches!(&refused, Err(CommandError::Usage(text)) if text.contains("named for two outputs")),
        "{refused:?}"
    );
    assert!(!folder.path().join("a.svg").exists());
}
