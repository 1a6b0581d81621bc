//! Network files: the shipped one, its schema, and what is refused where.

use evolvent_ethercat::{FitError, Network, check_fit, network_schema};
use evolvent_file_tests::{Edit, assert_refused, assert_schema, edit, shipped};
use evolvent_machine::Machine;

#[test]
fn the_schema_that_ships_is_the_one_of_the_code() {
    assert_schema("network.schema.json", &network_schema(), "evolvent-ethercat");
}

#[test]
fn each_error_names_its_place() {
    assert_refused(
        &shipped("networks/sim-mill.toml"),
        &[
            edit(
                "max_lost_cycles = 3 ",
                "max_lost_cycles = 0 ",
                "max_lost_cycles: 0 is out of range",
            ),
            edit(
                "distributed_clocks = true",
                "distributed_clock = true",
                "distributed_clock",
            ),
            edit(
                "name = \"x-drive\"",
                "name = \"coupler\"",
                "the name of another device",
            ),
            edit(
                "letter = \"Y\"",
                "letter = \"X\"",
                "another device drives this axis",
            ),
            edit("letter = \"Y\"", "letter = \"Q\"", "`Q` is no axis"),
            edit("inertia_kg_m2 = 0.0003", "inertia_kg_m2 = 0", "inertia_kg_m2"),
            Edit {
                from: "bytes = 4",
                to: "bytes = 3",
                line: "    { index",
                column: 23,
                key: "3 bytes is the size of no number",
            },
            Edit {
                from: "value = 1048576 }",
                to: "value = 5000000000 }",
                line: "    { index",
                column: 34,
                key: "out of range",
            },
        ],
        Network::parse,
    );
}

/// Whole sections: the place is the beginning of the section.
#[test]
fn an_axis_without_a_scale_is_refused() {
    let good = shipped("networks/sim-mill.toml");
    for (from, to, what) in [
        ("turn_mm = 5.08", "turn_deg = 5.08", "turn_mm alone"),
        ("turn_mm = 5.08", "turn_mm = -5", "make no scale"),
        ("gear = [3, 2]", "gear = [3, 0]", "make no scale"),
        ("rated_torque_n_m = 2.4\n", "", "rated torque"),
    ] {
        let error = Network::parse(&good.replacen(from, to, 1), "bad.toml")
            .expect_err(to)
            .to_string();
        assert!(error.starts_with("bad.toml:") && error.contains(what), "{error}");
    }
    for no_devices in ["device = []", ""] {
        assert!(Network::parse(no_devices, "bad.toml").is_err());
    }
}

/// 2^20 increments, 3 turns of the motor to 2 of a screw of 5.08 mm: 2^20 * 3 / (2 * 5.08) = 39321600 / 127 a mm.
#[test]
fn scales_are_exact_and_torque_follows_from_inertia() {
    let network = Network::parse(&shipped("networks/sim-mill.toml"), "good.toml").expect("a network");
    let axes: Vec<_> = network.devices.iter().filter_map(|device| device.axis).collect();
    assert_eq!(axes[2].scale.fraction(), (39_321_600, 127));
    // 1 mm/s2 is 2 pi / 5 rad/s2, times 3e-4 kg m2, over 2.4 N m, in thousandths.
    let expected = 2.0 * core::f64::consts::PI / 5.0 * 3e-4 / 2.4 * 1000.0;
    assert!((axes[1].torque_per_acceleration / expected - 1.0).abs() < 1e-12);
    assert_eq!(axes[0].torque_per_acceleration, 0.0);
}

#[test]
fn machine_and_network_are_compared() {
    let machine = Machine::parse(&shipped("machines/mill-3axis.toml"), "mill.toml").expect("a machine");
    let text = shipped("networks/sim-mill.toml");
    let check = |text: &str| {
        check_fit(
            &machine,
            &Network::parse(text, "network.toml").expect("a network"),
        )
    };
    assert_eq!(check(&text), Ok(()));
    assert_eq!(
        check(&text.replace("letter = \"Z\"", "letter = \"W\"")),
        Err(FitError::NoAxis { letter: 'W' })
    );
    let two = text
        .split("[[device]]\nname = \"z-drive\"")
        .next()
        .unwrap_or_default();
    assert_eq!(check(two), Err(FitError::NoDevice { letter: 'Z' }));
    let coarse = text.replacen("increments_per_turn = 1048576 ", "increments_per_turn = 1000 ", 1);
    assert!(matches!(
        check(&coarse),
        Err(FitError::Coarse { letter: 'X', .. })
    ));
    let fine = text.replacen("turn_mm = 5 ", "turn_mm = 0.1 ", 1);
    assert!(matches!(check(&fine), Err(FitError::Travel { letter: 'X', .. })));
}
