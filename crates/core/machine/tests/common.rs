//! A valid machine file, and edits of it that are rejected.

#![expect(
    clippy::panic,
    reason = "clippy does not recognise the helpers of these tests as test code"
)]

use evolvent_machine::{FeedbackMode, Machine};

pub(crate) const GOOD: &str = r#"name = "m"
kind = "mill"
increments_per_mm = 1000
increments_per_degree = 100
rate = 1000.5

[limits]
max_feed_mm_min = 6000

[path]
mode = "exact"
joint_time_ms = 2

[realtime]
priority = 70
core = 1

[trace]
cycles = "columns"
on_full = "stop"
[[axis]]
letter = "x"
travel_min_mm = -1
travel_max_mm = 2
max_velocity_mm_min = 30000
max_acceleration_g = 0.5
max_jerk_m_s3 = 50
home_mm = 1.5

[[axis]]
letter = "A"
kind = "rotary"
travel_min_deg = -90
travel_max_deg = 90
max_velocity_deg_min = 3600
max_acceleration_deg_s2 = 100
max_jerk_deg_s3 = 1000
"#;

#[test]
pub(crate) fn drive_monitoring_is_read_and_has_defaults() {
    let machine = Machine::parse(GOOD, "full.toml").unwrap();
    assert_eq!(machine.drives.feedback, FeedbackMode::IfPresent);
    assert_eq!(
        (machine.drives.feedback_timeout_s, machine.drives.enable_timeout_s),
        (0.02, 2.0)
    );
    assert!(machine.drives.follow_clock);
    assert_eq!(
        (machine.axes[0].following_error, machine.axes[0].following_time_s),
        (0.5, 0.02)
    );
    let text = GOOD.replace(
        "home_mm = 1.5",
        "home_mm = 1.5\nfollowing_error_mm = 0.1\nfollowing_time_ms = 5",
    ) + "following_error_deg = 2\n[drives]\nfeedback = \"required\"\nfeedback_timeout_ms = 8\n\
         follow_clock = false\n";
    let machine = Machine::parse(&text, "full.toml").unwrap();
    assert_eq!(machine.drives.feedback, FeedbackMode::Required);
    assert_eq!(machine.drives.feedback_timeout_s, 0.008);
    assert!(!machine.drives.follow_clock);
    assert_eq!(
        (machine.axes[0].following_error, machine.axes[0].following_time_s),
        (0.1, 0.005)
    );
    assert_eq!(machine.axes[1].following_error, 2.0);
}

/// Asserts that an edit of `GOOD` is rejected with these parts of the message.
pub(crate) fn rejected(edits: &[(&str, &str)], parts: &[&str]) {
    let mut text = GOOD.to_owned();
    for (from, to) in edits {
        assert!(text.contains(from), "no {from:?} in the good file");
        text = text.replacen(from, to, 1);
    }
    let message = match Machine::parse(&text, "bad.toml") {
        Ok(_) => panic!("accepted: {edits:?}"),
        Err(error) => error.to_string(),
    };
    for part in parts {
        assert!(
            message.contains(part),
            "{edits:?}\n  gives   {message}\n  without {part}"
        );
    }
}
