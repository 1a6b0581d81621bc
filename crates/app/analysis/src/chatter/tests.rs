//! Omitted and truncated results are reported.

use std::path::Path;

use evolvent_chatter::Case;

use super::{ChatterAnswer, ChatterKick, ChatterRequest};

fn answer(file: &str, changes: &[(&str, &str)], request: &ChatterRequest) -> ChatterAnswer {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../../config/processes/{file}.toml"));
    let mut text = std::fs::read_to_string(&path).unwrap();
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let case = Case::parse(&text, "case.toml").unwrap();
    ChatterAnswer::new(&path, case, request).unwrap()
}

/// 138 to 69 waves in a cut: a simulation gives 0.60 to 0.62 mm at 100 rpm and 0.624 to 0.643 mm at 200 rpm.
#[test]
fn limits_at_low_speed_are_right_or_left_out() {
    let at = |speed_rpm: &str| {
        let changes = [("[5000.0, 25000.0]", speed_rpm), ("points = 201", "points = 5")];
        let answer = answer("lobes-milling", &changes, &ChatterRequest::default());
        (
            answer.json()["lobes"][0].clone(),
            answer.text(),
            answer.lobes_svg(),
        )
    };
    let (lobes, text, _) = at("[100.0, 200.0]");
    for point in lobes["points"].as_array().unwrap() {
        assert_eq!(point["method"], "delay-equation");
        let limit = point["exact_limit_mm"].as_f64().unwrap();
        assert!((0.595..0.643).contains(&limit), "{point}");
    }
    assert!(
        text.contains("keep a margin") && text.contains("(delay equation)"),
        "{text}"
    );

    let (lobes, text, svg) = at("[1.0, 10.0]");
    for point in lobes["points"].as_array().unwrap() {
        assert_eq!(point["method"], "zero-order");
        assert!(
            point["exact_limit_mm"].is_null() && point["limit_mm"].is_f64(),
            "{point}"
        );
    }
    for text in [&text, &svg] {
        let note = "no limit of the delay equation at 5 speeds from 1 to 10 rpm";
        assert!(text.contains(note), "{text}");
    }
    assert!(text.contains("(zero order)"), "{text}");
}

/// 100 s are more than a million steps of this tool.
#[test]
fn a_response_that_is_cut_off_is_said_to_be() {
    let text = |seconds: f64| {
        let kick = Some(ChatterKick {
            velocity_m_s: None,
            seconds: Some(seconds),
        });
        let request = ChatterRequest {
            kick,
            ..ChatterRequest::default()
        };
        answer("chatter-40x", &[], &request).text()
    };
    let long = text(100.0);
    assert!(
        long.contains("of 100 s shown") && long.contains("1000000 steps"),
        "{long}"
    );
    assert!(!text(1.0).contains("shown"));
}
