//! Board files: reading, errors, and comparison with their machines.

use evolvent_mesa::{BoardSettings, FitError, board_schema, check_fit, fit_notes};

use crate::common::{machine, router};

fn text() -> String {
    evolvent_file_tests::shipped("boards/7i96s-router.toml")
}

#[test]
fn the_schema_is_that_of_the_code() {
    evolvent_file_tests::assert_schema("board.schema.json", &board_schema(), "evolvent-mesa");
}

#[test]
fn the_shipped_board_fits_its_machine() {
    let (machine, board) = (machine("router-3axis"), router([127, 0, 0, 1].into()));
    check_fit(&machine, &board).expect("a fit");
    let notes = fit_notes(&machine, &board);
    assert_eq!(notes.len(), 3, "steps are coarser than 1 um: {notes:?}");
}

#[test]
fn steps_that_are_too_fast_are_told_by_their_figures() {
    let mut machine = machine("router-3axis");
    let board = BoardSettings::parse(
        &text().replace("step_space_ns = 2500", "step_space_ns = 97500"),
        "b.toml",
    )
    .expect("a board file");
    machine.axes[0].max_velocity = 37.5;
    let error = check_fit(&machine, &board).expect_err("10 kHz are possible");
    assert!(
        error
            .to_string()
            .starts_with("X: 12000 steps/s needed, 10000 possible"),
        "{error}"
    );
}

#[test]
fn what_does_not_fit_is_named() {
    let machine = machine("router-3axis");
    let fit = |from: &str, to: &str| {
        let text = text();
        assert!(text.contains(from), "{from}");
        let board = BoardSettings::parse(&text.replacen(from, to, 1), "b.toml").expect("a board file");
        check_fit(&machine, &board).expect_err("no fit")
    };
    assert_eq!(
        fit("letter = \"X\"", "letter = \"A\""),
        FitError::NoAxis { letter: 'A' }
    );
    assert!(matches!(
        fit("door-closed", "door"),
        FitError::NoSignal {
            direction: "input",
            ..
        }
    ));
    assert!(matches!(
        fit("dust-extraction", "dust"),
        FitError::NoSignal {
            direction: "output",
            ..
        }
    ));
    assert_eq!(
        fit("[spindle]", "[spindle]\nnumber = 2"),
        FitError::NoSpindle { number: 2 }
    );
    let mut board = router([127, 0, 0, 1].into());
    board.axes.pop();
    assert_eq!(
        check_fit(&machine, &board),
        Err(FitError::NoEntry { letter: 'Z' })
    );
}

fn gantry_text() -> String {
    evolvent_file_tests::shipped("boards/7i96s-gantry.toml")
}

/// The text with an edit of the second entry of Y.
fn second(from: &str, to: &str) -> String {
    let text = gantry_text();
    let at = text.find("# the second motor of Y").expect("it");
    let (before, after) = text.split_at(at);
    assert!(after.contains(from), "{from}");
    format!("{before}{}", after.replacen(from, to, 1))
}

#[test]
fn the_shipped_gantry_fits_its_machine() {
    let machine = machine("router-3axis");
    let board = BoardSettings::parse(&gantry_text(), "b.toml").expect("a board file");
    assert_eq!(board.axes.len(), 4);
    assert_eq!(board.axes_mask().bits(), 0b111);
    check_fit(&machine, &board).expect("a fit");
}

#[test]
fn each_motor_of_a_gantry_has_to_be_fast_enough() {
    let machine = machine("router-3axis");
    let fit = |text: String| {
        let board = BoardSettings::parse(&text, "b.toml").expect("a board file");
        check_fit(&machine, &board).expect_err("no fit")
    };
    // 150 mm/s and 2 mm/s of squaring.
    let error = fit(second("step_space_ns = 2500", "step_space_ns = 97500"));
    assert_eq!(
        error,
        FitError::StepRate {
            letter: 'Y',
            needed: 152.0 * 320.0,
            possible: 10_000.0
        }
    );
    let error = fit(second("square_speed = 2", "square_speed = 31"));
    assert_eq!(
        error,
        FitError::SquareSpeed {
            letter: 'Y',
            speed: 31.0,
            most: 30.0
        }
    );
}

#[test]
fn mismatched_gantry_motors_are_refused() {
    let servo = "encoder = 0\ncounts_per_unit = 1000\npwm = 0\nfull_velocity = 200\np_gain = 60\n";
    let steps = "stepgen = 3\nsteps_per_unit = 320\nstep_length_ns = 2500\nstep_space_ns = 2500\n\
                 direction_setup_ns = 5000\ndirection_hold_ns = 5000\n";
    let switch = "home_switch = { pin = 4, inverted = true }";
    for (from, to, wanted) in [
        (
            "letter = \"Y\"",
            "letter = \"A\"",
            "no other entry moves this axis",
        ),
        (
            "[axis.gantry]\nmax_difference = 1.5",
            "#",
            "another entry moves this axis",
        ),
        (
            steps,
            servo,
            "one motor has a step generator, the other an encoder",
        ),
        (
            "inverted = true\n",
            "zero = 3\n",
            "start at different coordinates",
        ),
        (
            switch,
            "",
            "one motor of a gantry has a home switch, the other has none",
        ),
        (
            switch,
            "home_switch = { pin = 4, slow = true }",
            "different filters",
        ),
        (
            switch,
            "home_switch = { pin = 1, inverted = true }",
            "both motors of a gantry have this home switch",
        ),
        ("max_difference = 1.5", "max_difference = 0", "max_difference"),
        ("max_difference = 1.5", "", "max_difference"),
        ("square_speed = 2", "square_speed = -2", "square_speed"),
        ("square_speed = 2", "square_velocity = 2", "square_velocity"),
    ] {
        let mut text = second(from, to);
        if to == "#" {
            // Its other keys go with the table.
            text = text.replacen("squaring_offset", "# squaring_offset", 1).replacen(
                "square_speed",
                "# square_speed",
                1,
            );
        }
        let error = BoardSettings::parse(&text, "b.toml")
            .expect_err(wanted)
            .to_string();
        assert!(
            error.starts_with("b.toml:") && error.contains(wanted),
            "{wanted}: {error}"
        );
    }
    // The first has no switch: the error names the second, which has one.
    let text = gantry_text().replacen("home_switch = { pin = 1, inverted = true }", "", 1);
    let error = BoardSettings::parse(&text, "b.toml")
        .expect_err("no switch")
        .to_string();
    let line = 1 + text
        .lines()
        .position(|line| line.contains("pin = 4"))
        .expect("a line");
    assert!(error.starts_with(&format!("b.toml:{line}:")), "{error}");
}

#[test]
fn what_makes_no_sense_is_refused_with_its_place() {
    for (from, to, wanted) in [
        (
            "address = \"10.10.10.10\"",
            "address = \"mesa\"",
            "is not an address",
        ),
        (
            "stepgen = 0",
            "stepgen = 0\nencoder = 0",
            "either `stepgen` or `encoder`",
        ),
        ("steps_per_unit = 320 ", "steps_per_unit = -1 ", "steps_per_unit"),
        ("step_length_ns = 2500", "step_length_ns = 1", "step_length_ns"),
        (
            "letter = \"Y\"",
            "letter = \"X\"",
            "another entry moves this axis",
        ),
        ("letter = \"Y\"", "letter = \"Q\"", "is not an axis"),
        ("direction_hold_ns = 5000", "", "direction_hold_ns"),
        (
            "stepgen = 0",
            "stepgen = 0\nindex_inverted = true",
            "a step generator has no index pulse",
        ),
        ("pin = 14", "pin = 14\npwm = 0", "an output needs"),
        ("pin = 3\n", "pin = 3\nencoder = 1\n", "either `pin` or `encoder`"),
        ("pin = 3\n", "encoder = 16\n", "encoder"),
        ("full_rpm = 24000", "", "belong together"),
        ("watchdog_ms", "watchdog_s", "watchdog_s"),
        ("max_lost_packets = 5", "max_lost_packets = 0", "max_lost_packets"),
    ] {
        let text = text();
        assert!(text.contains(from), "{from}");
        let error = BoardSettings::parse(&text.replacen(from, to, 1), "b.toml").expect_err(to);
        let message = error.to_string();
        assert!(
            message.contains(wanted) && message.contains("b.toml"),
            "{to}: {message}"
        );
    }
}

fn lathe_text() -> String {
    evolvent_file_tests::shipped("boards/7i96s-lathe.toml")
}

#[test]
fn shipped_lathe_fits_machine_and_measures_spindle() {
    let machine = machine("lathe-mesa");
    let board = BoardSettings::parse(&lathe_text(), "b.toml").expect("a board file");
    check_fit(&machine, &board).expect("a fit");
    let notes = fit_notes(&machine, &board);
    assert!(notes.iter().all(|note| !note.contains("spindle")), "{notes:?}");
    let angle = board.spindles[0].angle.expect("an encoder");
    assert_eq!((angle.encoder, angle.settings.counts_per_turn), (0, 4096));
    assert!(board.spindles[0].knows_angle());
}

/// Without this check the error would only show within a program.
#[test]
fn a_probe_that_no_board_can_report_is_noted() {
    let board = BoardSettings::parse(&text(), "b.toml").expect("a board file");
    let shipped = evolvent_file_tests::shipped("machines/router-3axis.toml");
    let notes = |text: &str| {
        let machine = evolvent_machine::Machine::parse(text, "router.toml").expect("a machine");
        check_fit(&machine, &board).expect("a fit");
        fit_notes(&machine, &board).join("\n")
    };
    assert!(!notes(&shipped).contains("probe"));
    let found = notes(&format!("{shipped}\n[probe]\novertravel_mm = 2\n"));
    assert!(
        found.contains("has no probe input: G38 ends with an error") && found.contains("remove [probe]"),
        "{found}"
    );
}

/// `[spindle]` of older files is read as before; several have numbers of their own.
#[test]
fn one_spindle_or_several_are_read() {
    let board = BoardSettings::parse(&text(), "b.toml").expect("the old table");
    assert_eq!(board.spindles.len(), 1);
    let more = lathe_text() + "\n[[spindle]]\nnumber = 2\nforward = { pin = 13 }\n";
    let board = BoardSettings::parse(&more, "b.toml").expect("two");
    assert_eq!(
        board
            .spindles
            .iter()
            .map(|spindle| spindle.number)
            .collect::<Vec<_>>(),
        [0, 2]
    );
}

#[test]
fn invalid_spindle_entries_are_refused_with_position() {
    use evolvent_file_tests::{Edit, assert_refused, edit};
    let at = |from, to, key, line| Edit {
        line,
        ..edit(from, to, key)
    };
    let refused = [
        edit("counts_per_rev = 4096", "counts_per_rev = 2", "counts_per_rev"),
        at("counts_per_rev = 4096", "", "counts_per_rev", "[[spindle]]"),
        at("encoder = 0", "", "encoder", "counts_per_rev"),
        edit(
            "index = \"spindle\"",
            "index = \"encoder\"",
            "as fast as the spindle",
        ),
        edit(
            "at_speed_tolerance = 0.02",
            "at_speed_tolerance = 2",
            "at_speed_tolerance",
        ),
        at("reverse = { pin = 16 }", "", "either way", "orientation"),
        edit("pwm = 0", "pwm = 0\nsigned = true\nremote = 0", "belong together"),
        edit(
            "orientation = { gain = 8, i_gain = 10, rpm = 60, tolerance_deg = 1 }",
            "orientation = { gain = 8, i_gain = 10, rpm = 60, tolerance_deg = 1 }\norient = { pin = 13 }",
            "orientation",
        ),
        Edit {
            column: 9,
            ..edit("gear = [1, 1]", "gear = [0, 1]", "gear")
        },
    ];
    for refused in refused {
        // If a key is missing, or two keys conflict, the error has the position of the table.
        let line = if refused.key == "belong together" {
            "[[spindle]]"
        } else {
            refused.line
        };
        assert_refused(&lathe_text(), &[Edit { line, ..refused }], BoardSettings::parse);
    }
    let twice = lathe_text() + "\n[[spindle]]\nnumber = 1\nencoder = 0\ncounts_per_rev = 400\n";
    let error = BoardSettings::parse(&twice, "b.toml").expect_err("one encoder twice");
    assert!(error.to_string().contains("another entry"), "{error}");
}

#[test]
fn a_spindle_that_only_one_file_measures_is_noted() {
    let machine = machine("lathe-mesa");
    let notes = |machine: &evolvent_machine::Machine, text: &str| {
        let board = BoardSettings::parse(text, "b.toml").expect("a board file");
        check_fit(machine, &board).expect("a fit");
        fit_notes(machine, &board).join("\n")
    };
    let begin = lathe_text().find("fault = ").expect("it");
    let without = lathe_text()[..begin].to_owned();
    assert!(notes(&machine, &without).contains("feedback = true in the machine file and no encoder"));
    let mut deaf = machine.clone();
    deaf.signals.spindles[0].at_speed = evolvent_machine::AtSpeed::Unknown;
    assert!(notes(&deaf, &lathe_text()).contains("is not used"));
    let no_index = lathe_text()
        .replace("index = \"spindle\"", "index = \"none\"")
        .replace("orientation = ", "# ");
    assert!(notes(&machine, &no_index).contains("index = \"none\""));
    let no_m19 = lathe_text().replace("orientation = ", "# ");
    assert!(notes(&machine, &no_m19).contains("M19 is not possible"));
    let mut slow = machine;
    slow.signals.spindles[0].max_rpm = 6000.0;
    let board = BoardSettings::parse(&lathe_text(), "b.toml").expect("a board file");
    assert!(matches!(
        check_fit(&slow, &board),
        Err(FitError::FullSpeed { .. })
    ));
}
