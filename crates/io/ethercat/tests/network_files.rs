//! Network files: the shipped one, its schema, and errors with their positions.

use evolvent_ethercat::{FitError, Network, check_fit, fit_notes, network_schema};
use evolvent_file_tests::{Edit, assert_refused, assert_schema, edit, shipped};
use evolvent_machine::{Machine, RotaryDirection};

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
            edit("letter = \"Y\"", "letter = \"Q\"", "`Q` is not an axis"),
            edit("inertia_kg_m2 = 0.0003", "inertia_kg_m2 = 0", "inertia_kg_m2"),
            edit("gear = [1, 1] ", "index_probe = 3 ", "3 is not a touch probe"),
            edit(
                "gear = [1, 1] ",
                "index_probe = 1\ntouch_probe = true ",
                "touch probe 1 already latches the probe input",
            ),
            edit(
                "gear = [1, 1] ",
                "index_probe = 2\nabsolute = true ",
                "is not homed by its index pulse",
            ),
            edit("gear = [3, 2]", "index_probe = \"two\"", "index_probe"),
            Edit {
                from: "bytes = 4",
                to: "bytes = 3",
                line: "    { index",
                column: 23,
                key: "3 bytes is not the size of a number",
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

#[test]
fn the_shipped_lathe_fits_its_network() {
    let machine = Machine::parse(&shipped("machines/lathe-ethercat.toml"), "lathe.toml").expect("a machine");
    let network = Network::parse(&shipped("networks/sim-lathe.toml"), "sim-lathe.toml").expect("a network");
    assert_eq!(check_fit(&machine, &network), Ok(()));
    assert!(network.has_signals());
    // Its drives home, and the core accepts their positions.
    let notes = fit_notes(&machine, &network).join("\n");
    assert!(!notes.contains("homed by its drive"), "{notes}");
    let mut bare = machine;
    bare.homing.clear();
    let notes = fit_notes(&bare, &network).join("\n");
    assert!(
        notes.contains("X is homed by its drive") && notes.contains("Z is homed"),
        "{notes}"
    );
}

#[test]
fn a_probe_that_no_drive_latches_or_reports_is_noted() {
    let text = shipped("machines/mill-ethercat.toml");
    let network = shipped("networks/sim-mill.toml");
    let notes = |machine: &str, network: &str| {
        let machine = Machine::parse(machine, "mill.toml").expect("a machine");
        let network = Network::parse(network, "sim-mill.toml").expect("a network");
        fit_notes(&machine, &network).join("\n")
    };
    let has_probe = match text.find("[probe]") {
        Some(_) => text.clone(),
        None => format!("{text}\n[probe]\novertravel_mm = 2\n"),
    };
    assert!(notes(&has_probe, &network).contains("no drive of the network file has touch_probe"));
    let latched = network.replacen("velocity_offset = true", "touch_probe = true", 1);
    assert_ne!(latched, network);
    assert!(notes(&has_probe, &latched).contains("no drive of the network file has probe_input_bit"));
    let reported = latched.replacen(
        "touch_probe = true",
        "touch_probe = true\nprobe_input_bit = 16",
        1,
    );
    assert!(!notes(&has_probe, &reported).contains("probe"));
}

/// A drive no longer sets the brake that the network file names.
#[test]
fn a_brake_that_is_named_is_noted() {
    let text = shipped("networks/sim-mill.toml");
    let machine = format!(
        "output = [{{ name = \"brake\", number = 0 }}]\n{}",
        shipped("machines/mill-ethercat.toml")
    );
    let machine = Machine::parse(&machine, "mill.toml").expect("a machine");
    let notes = |output: &str| {
        let text = text.replacen("velocity_offset = true", output, 1);
        let network = Network::parse(&text, "sim-mill.toml").expect("a network");
        assert_eq!(check_fit(&machine, &network), Ok(()));
        fit_notes(&machine, &network).join("\n")
    };
    let named = notes("[[device.output]]\nname = \"brake\"\nbit = 0\n#");
    assert!(
        named.contains("device `x-drive`: the output `brake` is bit 0 of 60FEh")
            && named.contains("holding brake"),
        "{named}"
    );
    let other = notes("[[device.output]]\nname = \"brake\"\nbit = 16\n#");
    assert!(!other.contains("60FEh"), "{other}");
}

/// Missing sections: the position of the error is the beginning of the section.
#[test]
fn an_axis_without_a_scale_is_refused() {
    let good = shipped("networks/sim-mill.toml");
    for (from, to, what) in [
        ("turn_mm = 5.08", "turn_deg = 5.08", "turn_mm alone"),
        ("turn_mm = 5.08", "turn_mm = -5", "give no valid scale"),
        ("gear = [3, 2]", "gear = [3, 0]", "give no valid scale"),
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

/// 2^20 increments, 3 turns of the motor to 2 of a screw of 5.08 mm: 2^20 * 3 / (2 * 5.08) = 39321600 / 127 a
/// mm.
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
    let machine = Machine::parse(&shipped("machines/mill-ethercat.toml"), "mill.toml").expect("a machine");
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
    // 500 mm/s at 2 621 440 increments per mm, whose travel fits into 32 bits.
    let fast = text.replacen("turn_mm = 5 ", "turn_mm = 0.4 ", 1);
    let error = check(&fast).expect_err("too fast");
    assert_eq!(
        error,
        FitError::Velocity {
            letter: 'X',
            increments: 500.0 * 2_621_440.0
        }
    );
    assert!(
        error.to_string().contains("1310720000 increments per second"),
        "{error}"
    );
    // The counts of an unlimited axis may wrap around.
    let mut unlimited = machine.clone();
    (unlimited.axes[0].unlimited, unlimited.axes[0].max_velocity) = (Some(RotaryDirection::Shorter), 50.0);
    let network = Network::parse(&fine, "network.toml").expect("a network");
    assert_eq!(check_fit(&unlimited, &network), Ok(()));
}

/// The drives interpolate over the time that object 60C2h gives them.
#[test]
fn period_impossible_for_the_drives_is_refused() {
    let text = shipped("machines/mill-ethercat.toml");
    let network = Network::parse(&shipped("networks/sim-mill.toml"), "network.toml").expect("a network");
    let check = |rate: &str| {
        let changed = text.replacen("rate = 1000 ", &format!("rate = {rate} "), 1);
        check_fit(&Machine::parse(&changed, "mill.toml").expect(rate), &network)
    };
    for rate in ["250", "500", "800", "1000", "2000", "4000"] {
        assert_eq!(check(rate), Ok(()), "{rate}");
    }
    for (rate, expected_ns, usual_hz) in [
        ("\"rational\"", 1_264_809, 1000),
        ("300", 3_333_333, 500),
        ("1003", 997_008, 2000),
        ("7000", 142_857, 4000),
    ] {
        let found = match check(rate) {
            Err(FitError::Period {
                period_ns, usual_hz, ..
            }) => (period_ns, usual_hz),
            other => panic!("{rate}: {other:?}"),
        };
        assert_eq!(found, (expected_ns, usual_hz), "{rate}");
    }
    let message = check("\"rational\"").expect_err("no such period").to_string();
    assert!(
        message.contains("(rate = \"rational\")") && message.contains("write rate = 1000 there"),
        "{message}"
    );
}

/// Inputs and outputs after the shipped file's last device.
const SIGNALS: &str = r#"
input = [
    { name = "door", bit = 0 },
    { name = "level", bit = 8, values = [0, 10] },
]
output = [
    { name = "clamp", bit = 0 },
    { function = "spindle-speed", bit = 8, values = [0, 6000] },
]
"#;

#[test]
fn signals_are_refused_where_they_are_wrong() {
    let good = format!("{}{SIGNALS}", shipped("networks/sim-mill.toml"));
    assert!(Network::parse(&good, "good.toml").is_ok());
    for (from, to, what) in [
        (
            "name = \"level\"",
            "name = \"door\"",
            "`door` is also a signal of another entry",
        ),
        (
            "bit = 8, values = [0, 10]",
            "bit = 0",
            "bit 0 also belongs to another signal",
        ),
        (
            "bit = 0 },\n    { name = \"level\"",
            "bit = 15 },\n    { name = \"level\"",
            "bit 8 also belongs",
        ),
        ("bit = 8, values = [0, 10]", "bit = 8192", "out of range"),
        (
            "bit = 8, values = [0, 10]",
            "bit = 8, bits = 12",
            "a key of analog signals",
        ),
        ("values = [0, 10]", "values = [1, 1]", "two different values"),
        ("values = [0, 10]", "values = [nan, 1]", "two different values"),
        (
            "values = [0, 10]",
            "values = [0, 10], raw = [0, 32768]",
            "numbers of 16 bits",
        ),
        (
            "values = [0, 10]",
            "values = [0, 10], bits = 12",
            "numbers of 12 bits",
        ),
        ("values = [0, 10]", "values = [0, 10], bits = 33", "out of range"),
        (
            "values = [0, 10]",
            "values = [0, 10], inverted = true",
            "exchange the two numbers",
        ),
        (
            "name = \"clamp\", bit = 0",
            "bit = 0",
            "needs `name` or `function`",
        ),
        (
            "name = \"clamp\", bit",
            "name = \"clamp\", function = \"flood\", bit",
            "and not both",
        ),
        (
            "name = \"clamp\", bit",
            "name = \"clamp\", spindle = 0, bit",
            "not belong to a spindle",
        ),
        (
            "name = \"clamp\", bit",
            "function = \"spindle-on\", spindle = 4, bit",
            "out of range",
        ),
        (
            "name = \"clamp\", bit",
            "function = \"air\", bit",
            "unknown variant",
        ),
        (
            "name = \"clamp\", bit",
            "function = \"spindle-speed\", bit",
            "give `values`, in rpm",
        ),
        (", values = [0, 6000]", "", "give `values`, in rpm"),
        (
            "turn_mm = 5.08\n",
            "turn_mm = 5.08\n[[device.output]]\nname = \"x\"\nbit = 32\n",
            "outputs of a drive are bits of its digital outputs (60FEh)",
        ),
        (
            "turn_mm = 5.08\n",
            "turn_mm = 5.08\n[[device.output]]\nname = \"x\"\nbit = 16\nvalues = [0, 1]\n",
            "without values",
        ),
        (
            "turn_mm = 5.08\n",
            "turn_mm = 5.08\n[[device.input]]\nname = \"x\"\nbit = 32\n",
            "digital inputs (60FDh)",
        ),
    ] {
        // `limit_switches` of the shipped file follows the lead.
        let text = good.replace("limit_switches = true ", "#");
        assert!(text.contains(from), "{from}");
        let error = Network::parse(&text.replacen(from, to, 1), "bad.toml")
            .expect_err(to)
            .to_string();
        assert!(
            error.starts_with("bad.toml:") && error.contains(what),
            "{to}: {error}"
        );
    }
}

#[test]
fn signals_are_compared_with_the_machine_file() {
    let network = Network::parse(
        &format!("{}{SIGNALS}", shipped("networks/sim-mill.toml")),
        "network.toml",
    )
    .expect("a network");
    let check = |signals: &str| {
        let text = format!("{signals}\n{}", shipped("machines/mill-ethercat.toml"));
        check_fit(&Machine::parse(&text, "mill.toml").expect(signals), &network)
    };
    let good = r#"
        input = [{ name = "door", number = 1 }, { name = "level", number = 2, kind = "analog" }]
        output = [{ name = "clamp", number = 0 }]
        spindle = [{ max_rpm = 6000 }]
    "#;
    assert_eq!(check(good), Ok(()));
    for (from, to, what) in [
        (
            "\"door\"",
            "\"gate\"",
            "has the input `door`, which the machine file does not have",
        ),
        ("\"clamp\"", "\"vice\"", "has the output `clamp`"),
        (
            ", kind = \"analog\"",
            "",
            "the input `level` is digital in the machine file",
        ),
        (
            "number = 0",
            "number = 0, kind = \"analog\"",
            "the output `clamp` is analog",
        ),
        ("spindle = [{ max_rpm = 6000 }]", "", "has the output `spindle 0`"),
        (
            "6000",
            "6001",
            "may be 6001 in the machine file, but its channel supports 0 to 6000",
        ),
    ] {
        assert!(good.contains(from), "{from}");
        let error = check(&good.replacen(from, to, 1)).expect_err(to).to_string();
        assert!(error.contains(what), "{to}: {error}");
    }
}

#[test]
fn homing_on_the_drive_is_checked_and_never_twice() {
    let homing = "\n[device.axis.homing]\nmethod = 17\nsearch_mm_s = 20\nlatch_mm_s = 0.5\norder = 1\n";
    let good = shipped("networks/sim-mill.toml").replacen(
        "[[device]]\nname = \"y-drive\"",
        &format!("{homing}\n[[device]]\nname = \"y-drive\""),
        1,
    );
    let network = Network::parse(&good, "good.toml").expect("a network");
    let found = network.devices[1]
        .axis
        .and_then(|axis| axis.homing)
        .expect("homing");
    // 2^20 increments are 5 mm.
    assert_eq!((found.search, found.latch), (4 << 20, 104_858));
    for (from, to, what) in [
        (
            "search_mm_s = 20",
            "search_deg_s = 20",
            "another unit than the axis",
        ),
        ("search_mm_s = 20\n", "", "needs the speed of the search"),
        ("latch_mm_s = 0.5", "latch_mm_s = 0", "not within 1 to 4294967295"),
        (
            "latch_mm_s = 0.5",
            "latch_mm_s = nan",
            "not within 1 to 4294967295",
        ),
        ("order = 1", "timeout_s = 0", "out of range"),
        ("order = 1", "order = 101", "out of range"),
        (
            "letter = \"X\"",
            "letter = \"X\"\nabsolute = true",
            "needs no homing",
        ),
        (
            "letter = \"X\"",
            "letter = \"X\"\nprobe_input_bit = 32",
            "out of range",
        ),
    ] {
        assert!(good.contains(from), "{from}");
        let error = Network::parse(&good.replacen(from, to, 1), "bad.toml")
            .expect_err(to)
            .to_string();
        assert!(
            error.starts_with("bad.toml:") && error.contains(what),
            "{to}: {error}"
        );
    }
    let machine = format!(
        "{}\n[[homing]]\naxis = \"X\"\ntowards = \"negative\"\nsearch_mm_s = 20\nlatch_mm_s = 1\nswitch_mm \
         = -399\n",
        shipped("machines/mill-ethercat.toml")
    );
    let machine = Machine::parse(&machine, "mill.toml").expect("a machine");
    assert_eq!(
        check_fit(&machine, &network),
        Err(FitError::HomedTwice { letter: 'X' })
    );
}

/// A machine file that homes by the index pulse needs a drive that latches it.
#[test]
fn homing_by_index_needs_a_latch() {
    let text = shipped("machines/mill-ethercat.toml")
        + "\n[[homing]]\naxis = \"X\"\nmethod = \"index\"\ntowards = \"negative\"\nlatch_mm_s = 5\n\
           index_mm = 0\nindex_within_mm = 6\n";
    let machine = Machine::parse(&text, "machine.toml").expect("a machine");
    let network = shipped("networks/sim-mill.toml");
    let fit = |text: &str| {
        check_fit(
            &machine,
            &Network::parse(text, "network.toml").expect("a network"),
        )
    };
    assert_eq!(fit(&network), Err(FitError::NoIndex { letter: 'X' }));
    let latching = network.replacen("gear = [1, 1]", "index_probe = 2 ", 1);
    assert_eq!(fit(&latching), Ok(()));
    // Of the two drives of an axis, the first one counts.
    let second = "\n[[device]]\nname = \"x2\"\nvendor = 1\nproduct = 1\n[device.axis]\nletter = \"X\"\n\
                  increments_per_turn = 1048576\nturn_mm = 5\n[device.axis.gantry]\nmax_difference = 1\n";
    assert_eq!(fit(&(latching.clone() + second)), Ok(()));
    let twice = latching + &second.replacen("turn_mm = 5", "turn_mm = 5\nindex_probe = 2", 1);
    let error = Network::parse(&twice, "network.toml").map_err(|error| error.to_string());
    assert!(
        error
            .as_ref()
            .is_err_and(|error| error.contains("that of the first one counts")),
        "{error:?}"
    );
}

const SPINDLE: &str = "
[[device]]
name = \"spindle\"
vendor = 1
product = 2

[device.spindle]
increments_per_turn = 1048576
gear = [1, 1]
index_probe = 2
orientation = { gain = 8 }
";

#[test]
fn spindle_drive_is_read_and_checked_and_refused() {
    let text = shipped("networks/sim-mill.toml") + SPINDLE;
    let network = Network::parse(&text, "network.toml").expect("a network");
    let spindle = network.devices.iter().find_map(|device| device.spindle);
    let spindle = spindle.expect("a spindle");
    // Increments per second at one turn in a minute.
    assert!((spindle.velocity_per_rpm - 1_048_576.0 / 60.0).abs() < 1e-9);
    assert!(spindle.knows_angle() && network.has_signals());
    let mill = shipped("machines/mill-ethercat.toml");
    let with = |spindle: &str| Machine::parse(&(mill.clone() + spindle), "mill.toml").expect("a machine");
    let measured = with("\n[[spindle]]\nmax_rpm = 3000\nfeedback = true\n");
    assert_eq!(check_fit(&measured, &network), Ok(()));
    assert_eq!(fit_notes(&measured, &network), Vec::<String>::new());
    let deaf = with("\n[[spindle]]\nmax_rpm = 3000\n");
    assert!(fit_notes(&deaf, &network)[0].contains("is not used"));
    let alone = Network::parse(&shipped("networks/sim-mill.toml"), "network.toml").expect("a network");
    assert!(fit_notes(&measured, &alone)[0].contains("no [device.spindle]"));
    let other = with("\n[[spindle]]\nnumber = 1\nmax_rpm = 3000\n");
    assert!(matches!(
        check_fit(&other, &network),
        Err(FitError::NoSignal { .. })
    ));
    for (from, to, expected) in [
        ("index_probe = 2", "index_probe = 3", "3 is not a touch probe"),
        (
            "index_probe = 2",
            "index = \"encoder\"\nindex_probe = 2",
            "as fast as the spindle",
        ),
        (
            "index_probe = 2",
            "index = \"spindle\"",
            "touch probe that latches it",
        ),
        (
            "index_probe = 2",
            "index_probe = 2\nabsolute_zero = 5",
            "exclude each other",
        ),
        ("index_probe = 2\n", "", "no angle to turn to"),
        ("gain = 8", "gain = 0", "gain"),
        (
            "increments_per_turn = 1048576\ngear = [1, 1]\nindex",
            "increments_per_turn = 0\nindex",
            "increments_per_turn",
        ),
        (
            "[device.spindle]",
            "[device.axis]\nletter = \"A\"\nincrements_per_turn = 1\nturn_deg = 1\n[device.spindle]",
            "an axis or turns a spindle",
        ),
    ] {
        assert!(SPINDLE.contains(from), "{from}");
        let text = shipped("networks/sim-mill.toml") + &SPINDLE.replacen(from, to, 1);
        let error = Network::parse(&text, "network.toml").expect_err(to).to_string();
        assert!(
            error.starts_with("network.toml:") && error.contains(expected),
            "{to}: {error}"
        );
    }
    let absolute =
        shipped("networks/sim-mill.toml") + &SPINDLE.replace("index_probe = 2", "absolute_zero = 77");
    let network = Network::parse(&absolute, "network.toml").expect("a network");
    assert!(
        network
            .devices
            .iter()
            .find_map(|device| device.spindle)
            .expect("it")
            .knows_angle()
    );
}
