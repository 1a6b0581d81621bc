//! Board files: what is read, what is refused, and whether they fit their machines.

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
        let said = error.to_string();
        assert!(said.contains(wanted) && said.contains("b.toml"), "{to}: {said}");
    }
}
