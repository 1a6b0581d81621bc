//! `evolvent import linuxcnc`: the result is a machine that runs, and everything that is lost is reported.
#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::path::Path;

use evolvent_tests::{Finished, Workshop, cycles, run};

const INI: &str = "[EMC]
MACHINE = Gantry router
[DISPLAY]
DISPLAY = axis
[KINS]
KINEMATICS = trivkins coordinates=XYYZ
JOINTS = 4
[TRAJ]
COORDINATES = X Y Y Z
LINEAR_UNITS = inch
MAX_LINEAR_VELOCITY = 4
[EMCMOT]
SERVO_PERIOD = 1000000
[EMCIO]
TOOL_TABLE = tools.tbl
[RS274NGC]
PARAMETER_FILE = router.var
RS274NGC_STARTUP_CODE = G20 G64 P0.001
REMAP = M6 modalgroup=6 ngc=change
#INCLUDE axes.inc
[HAL]
HALFILE = wiring.hal
";

const AXES: &str = "[AXIS_X]
MIN_LIMIT = -1
MAX_LIMIT = 40
MAX_VELOCITY = 6
MAX_ACCELERATION = 30
[AXIS_Y]
MIN_LIMIT = 0
MAX_LIMIT = 30
MAX_VELOCITY = 6
MAX_ACCELERATION = 30
[AXIS_Z]
MIN_LIMIT = -4
MAX_LIMIT = 0.5
MAX_VELOCITY = 3
MAX_ACCELERATION = 20
MAX_JERK = 400
[JOINT_0]
HOME_SEARCH_VEL = -1.5
HOME_LATCH_VEL = 0.1
HOME_OFFSET = -0.5
HOME = 1
HOME_SEQUENCE = 1
FERROR = 0.06
MIN_FERROR = 0.01
[JOINT_1]
MAX_VELOCITY = 5
[JOINT_2]
BACKLASH = 0.002
MAX_LIMIT = 29
[JOINT_3]
HOME_SEARCH_VEL = 1
HOME_LATCH_VEL = 2
HOME_SEQUENCE = 0
";

/// A touch probe on a Mesa board.
const WIRING: &str = "loadrt hm2_eth board_ip=10.10.10.10
net touch hm2_7i96s.0.inm.10.input => motion.probe-input
";

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

fn import(ini: &Path, output: &Path) -> Finished {
    run([
        "import",
        "linuxcnc",
        text(ini),
        "--output",
        text(output),
        "--json",
    ])
}

#[test]
fn a_gantry_router_in_inches_is_imported_and_runs() {
    let workshop = Workshop::new();
    let ini = workshop.write("router.ini", INI);
    let _file = workshop.write("axes.inc", AXES);
    let _file = workshop.write("tools.tbl", "T1 P1 D0.25 Z-1 ;quarter inch\n");
    let _file = workshop.write("router.var", "5221 1.5\n5223 -2\n5210 1\n");
    let _file = workshop.write("wiring.hal", WIRING);
    let machine = workshop.folder().join("gantry.toml");
    let report = import(&ini, &machine).expect_code(&[0]).json();
    let file = std::fs::read_to_string(&machine).expect("a machine file");
    for line in [
        "name = \"gantry-router\"",
        "rate = 1000",
        "travel_max_mm = 1016",
        // The tightest limit of the axis and of both joints.
        "travel_max_mm = 736.6",
        "max_velocity_mm_s = 127",
        "max_jerk_mm_s3 = 10160",
        "home_mm = 25.4",
        "following_error_mm = 0.254",
        "following_time_ms = 10",
        "search_mm_s = 38.1",
        "latch_mm_s = 2.54",
        "switch_mm = -12.7",
        "max_feed_mm_s = 101.6",
        "blend_tolerance_mm = 0.0254",
        "start_unit = \"inch\"",
        "parameter_unit = \"inch\"",
    ] {
        assert!(
            file.lines().any(|found| found == line),
            "{line} is missing in\n{file}"
        );
    }
    let dropped = report["dropped"].to_string();
    for reason in [
        "joints 1 and 2 both drive Y",
        "different backlash",
        "hm2_eth (a Mesa Ethernet board)",
        "it connects a touch probe (motion.probe-input): G38 is rejected until the machine file has [probe]",
        "Mesa bridge has no probe input",
        "not remapped",
    ] {
        assert!(dropped.contains(reason), "{reason} is missing in {dropped}");
    }
    assert!(report["chosen"].to_string().contains("max_jerk of X"), "{report}");

    // Tool and offset are in millimetres in the imported machine.
    let program = workshop.write("p.ngc", "G21 G90 G54\nG43 H1\nG0 X10\nG0 Z-20\nM2\n");
    run(["check", text(&program), "--machine", text(&machine)]).expect_code(&[0]);
    let trace = workshop.folder().join("p.mcap");
    let words = [
        "run",
        text(&program),
        "--machine",
        text(&machine),
        "--clock",
        "virtual",
        "--no-bus",
        "--trace",
    ];
    run(words.iter().chain(&[text(&trace)])).expect_code(&[0]);
    // X10 is at 10 mm + 1.5 in, Z-20 at -20 mm - 2 in - 1 in.
    let end = cycles(&trace).pop().expect("a cycle").position;
    assert!(
        (end[0] - 48.1).abs() < 1e-6 && (end[2] + 96.2).abs() < 1e-6,
        "{end:?}"
    );

    // Without G20 or G21 a program starts in the inches of the machine, and so do its parameters.
    let program = workshop.write("inch.ngc", "G90 G54\nG0 X[#5221]\nM2\n");
    let words = words.map(|word| {
        if word.ends_with("p.ngc") {
            text(&program)
        } else {
            word
        }
    });
    run(words.iter().chain(&[text(&trace)])).expect_code(&[0]);
    let end = cycles(&trace).pop().expect("a cycle").position;
    assert!((end[0] - 3.0 * 25.4).abs() < 1e-6, "{end:?}");

    assert!(
        import(&ini, &machine)
            .expect_code(&[2])
            .err
            .contains("exists already")
    );
}

#[test]
fn unsupported_configurations_are_rejected_by_line() {
    let workshop = Workshop::new();
    let cases = [
        (
            "[KINS]\nKINEMATICS = genhexkins\n",
            "bad.ini:2: kinematics \"genhexkins\"",
        ),
        ("[AXIS_0]\nTYPE = LINEAR\n", "update_ini"),
        (
            "[KINS]\nKINEMATICS = trivkins\n[TRAJ]\nCOORDINATES = X\n[AXIS_X]\nMIN_LIMIT = zero\n",
            "bad.ini:6: [AXIS_X] MIN_LIMIT = \"zero\" is not a number",
        ),
    ];
    for (text, expected) in cases {
        let ini = workshop.write("bad.ini", text);
        let output = workshop.folder().join("bad.toml");
        let finished = import(&ini, &output).expect_code(&[2]);
        assert!(finished.err.contains(expected), "{}", finished.err);
        assert!(!output.exists());
    }
}

#[test]
fn backlash_and_screw_errors_are_imported_and_applied() {
    let workshop = Workshop::new();
    let ini = workshop.write(
        "mill.ini",
        "[KINS]\nKINEMATICS = trivkins coordinates=XY\n[TRAJ]\nCOORDINATES = XY\nLINEAR_UNITS = inch\n\
         [AXIS_X]\nMIN_LIMIT = -5\nMAX_LIMIT = 5\nMAX_VELOCITY = 2\nMAX_ACCELERATION = 20\n\
         [AXIS_Y]\nMIN_LIMIT = -5\nMAX_LIMIT = 5\nMAX_VELOCITY = 2\nMAX_ACCELERATION = 20\n\
         [JOINT_0]\nBACKLASH = 0.001\n\
         [JOINT_1]\nBACKLASH = 0.002\nCOMP_FILE = y.comp\nCOMP_FILE_TYPE = 0\n",
    );
    let _file = workshop.write("y.comp", "-4 -4.0004 -3.9996\n0 0.0002 0.0008\n4 4.0001 4.0007\n");
    let machine = workshop.folder().join("mill.toml");
    let report = import(&ini, &machine).expect_code(&[0]).json();
    let dropped = report["dropped"].to_string();
    assert!(dropped.contains("no effect together with COMP_FILE"), "{dropped}");
    let file = std::fs::read_to_string(&machine).expect("a machine file");
    for line in ["backlash_mm = 0.0254", "screw_table = \"mill-y.csv\""] {
        assert!(
            file.lines().any(|found| found == line),
            "{line} is missing in\n{file}"
        );
    }
    let program = workshop.write("p.ngc", "G21 G90\nG0 X10 Y10\nG0 X0 Y0\nG4 P1\nM2\n");
    let trace = workshop.folder().join("p.mcap");
    let words = ["--clock", "virtual", "--trace", text(&trace)];
    run(["run", text(&program), "--machine", text(&machine)]
        .into_iter()
        .chain(words))
    .expect_code(&[0]);
    let last = *cycles(&trace).last().expect("cycles");
    // Backwards at 0: half of the backlash less, and LinuxCNC's correction, nominal minus reached.
    assert!(
        (last.drive_position[0] + 0.0127).abs() < 1e-12,
        "{}",
        last.drive_position[0]
    );
    assert!(
        (last.drive_position[1] + 0.0008 * 25.4).abs() < 1e-12,
        "{}",
        last.drive_position[1]
    );
}
