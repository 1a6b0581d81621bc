//! Values that are possible but implausible.
#![expect(
    clippy::unwrap_used,
    reason = "clippy does not recognise the helpers of these tests as test code"
)]

use evolvent_machine::Machine;

const FILE: &str = "name = \"m\"
kind = \"mill\"
kinematics = \"trivial\"
increments_per_mm = 1000
increments_per_degree = 1000
rate = 1000
[[axis]]
letter = \"X\"
travel_min_mm = 0
travel_max_mm = 400
max_velocity_mm_min = 30000
max_acceleration_m_s2 = 5
max_jerk_m_s3 = 200
[[axis]]
letter = \"A\"
travel_min_deg = -90
travel_max_deg = 90
max_velocity_deg_s = 300
max_acceleration_deg_s2 = 1000
max_jerk_deg_s3 = 20000
";

fn warnings(text: &str) -> Vec<String> {
    Machine::parse(text, "m.toml").unwrap().warnings
}

#[test]
fn limits_of_no_machine_are_warned_of_at_their_key() {
    assert_eq!(warnings(FILE), [""; 0]);
    for (from, to, line, words) in [
        (
            "max_jerk_m_s3 = 200",
            "max_jerk_m_s3 = 0.0001",
            13,
            "50000 s to reach its maximum acceleration",
        ),
        (
            "max_jerk_deg_s3 = 20000",
            "max_jerk_deg_s3 = 20",
            20,
            "axis A takes 50 s",
        ),
        (
            "max_acceleration_m_s2 = 5",
            "max_acceleration_m_s2 = 0.005",
            12,
            "100 s to reach its maximum velocity",
        ),
        (
            "max_acceleration_m_s2 = 5",
            "max_acceleration_m_s2 = 4000",
            12,
            "408 g",
        ),
        (
            "max_velocity_mm_min = 30000",
            "max_velocity_mm_min = 3",
            11,
            "slower than any machine",
        ),
        (
            "max_velocity_mm_min = 30000",
            "max_velocity_mm_s = 30000",
            11,
            "faster than any machine",
        ),
    ] {
        let text = FILE.replace(from, to);
        let found = warnings(&text);
        let key = to.split(' ').next().unwrap();
        let has = |text: &String| {
            text.starts_with(&format!("m.toml:{line}:")) && text.contains(key) && text.contains(words)
        };
        assert!(found.iter().any(has), "{to}: {found:?}");
    }
    // Slow planers, linear motors and soft machines are plausible.
    for (from, to) in [
        ("max_acceleration_m_s2 = 5", "max_acceleration_g = 0.01"),
        ("max_acceleration_m_s2 = 5", "max_acceleration_m_s2 = 300"),
        ("max_velocity_mm_min = 30000", "max_velocity_mm_min = 600000"),
        ("max_jerk_m_s3 = 200", "max_jerk_m_s3 = 1000000"),
        ("max_jerk_m_s3 = 200", "max_jerk_mm_s3 = 2500"),
    ] {
        assert_eq!(warnings(&FILE.replace(from, to)), [""; 0], "{to}");
    }
}

#[test]
fn a_home_switch_out_of_search_range_is_a_warning() {
    let homed = |keys: &str| {
        format!(
            "{FILE}[[homing]]\naxis = \"X\"\ntowards = \"negative\"\nsearch_mm_s = 20\nlatch_mm_s = 2\n\
             {keys}\n"
        )
    };
    for keys in ["switch_mm = -5", "switch_mm = 439", "switch_mm = -40"] {
        assert_eq!(warnings(&homed(keys)), [""; 0], "{keys}");
    }
    for keys in ["switch_mm = -41", "switch_mm = 5000"] {
        let found = warnings(&homed(keys));
        assert!(
            matches!(&found[..], [text] if text.starts_with("m.toml:26:") && text.contains("homing[0].switch_mm")),
            "{found:?}"
        );
    }
    // The pulse is up to `index_within_mm` after the edge of the switch, or after the start.
    for (method, words) in [
        (
            "switch-index",
            "1.1 times the travel, and index_within_mm after the switch",
        ),
        ("index", "index_within_mm from the position of the axis"),
    ] {
        for (index, is_reached) in [
            (-50, true),
            (450, true),
            (-51, false),
            (451, false),
            (4000, false),
        ] {
            let keys = format!("method = \"{method}\"\nindex_mm = {index}\nindex_within_mm = 10");
            let found = warnings(&homed(&keys));
            assert_eq!(found.is_empty(), is_reached, "{method} {index}: {found:?}");
            let is_named = |text: &String| text.contains("homing[0].index_mm: ") && text.contains(words);
            assert!(found.iter().all(is_named), "{found:?}");
        }
    }
}

#[test]
fn converted_bounds_print_without_float_noise() {
    let text = FILE.replace("max_jerk_m_s3 = 200", "max_jerk_m_s3 = 1e-10");
    let error = Machine::parse(&text, "m.toml").unwrap_err().to_string();
    assert!(
        error.contains("from 1e-9 to ") || error.contains("from 0.000000001 to "),
        "{error}"
    );
    let text = FILE.replace("max_jerk_m_s3 = 200", "max_jerk_m_s3 = 1e-9");
    assert!(Machine::parse(&text, "m.toml").is_ok());
}
