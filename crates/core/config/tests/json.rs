//! JSON texts: errors name line, column and key.

use evolvent_config::ConfigDocument;

#[test]
fn json_errors_name_their_position() {
    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Case {
        #[expect(dead_code, reason = "only its presence matters")]
        mode: Vec<Mode>,
    }
    #[derive(Debug, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Mode {
        #[expect(dead_code, reason = "only its presence matters")]
        f_hz: f64,
    }
    let text =
        "{\n \"a\\\"b\": [1, {\"x\": \"}\"}],\n \"mode\": [\n  {\"f_hz\": 1},\n  {\"f_hz\": -2}\n ]\n}";
    let sheet = ConfigDocument::parse(text, "case.json").unwrap();
    let error = sheet
        .number("mode[1].f_hz", -2.0, 0.0, 1.0)
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("case.json:5:4: mode[1].f_hz: -2 is out of range"),
        "{error}"
    );
    assert!(
        sheet
            .read::<Case>()
            .unwrap_err()
            .to_string()
            .contains("unknown field")
    );
    let text = "{\n \"mode\": [\n  {\"f_hz\": 1},\n  {}\n ]\n}";
    let error = ConfigDocument::parse(text, "case.json")
        .unwrap()
        .read::<Case>()
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("case.json:4:") && error.contains("mode[1].f_hz: missing field"),
        "{error}"
    );
    let error = ConfigDocument::parse("{\n \"mode\": [,\n", "case.json")
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("case.json:2:") && error.contains("not valid JSON"),
        "{error}"
    );
}
