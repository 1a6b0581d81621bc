//! Random and deeply nested text as machine files.

use evolvent_machine::Machine;
use proptest::prelude::*;

use crate::common::GOOD;

#[test]
fn deep_nesting_and_long_text_give_an_error() {
    for text in [
        "[".repeat(100_000),
        format!("a = {}", "[".repeat(100_000)),
        "a.".repeat(100_000),
        "{".repeat(1000),
    ] {
        let message = Machine::parse(&text, "m").unwrap_err().to_string();
        assert!(message.len() < 1000, "{} characters", message.len());
    }
    let long = "x".repeat(100_000);
    let texts = [
        format!("name = \"{long}\""),
        format!("{long} = 1"),
        GOOD.replacen("\"m\"", &format!("\"{long}\""), 1),
    ];
    for text in texts {
        let message = Machine::parse(&text, "m").unwrap_err().to_string();
        assert!(message.len() < 1000, "{} characters", message.len());
    }
}

/// Either rejected with a message of one line, or a machine whose numbers are all valid.
fn valid_or_rejected(text: &str) -> Result<(), TestCaseError> {
    match Machine::parse(text, "m") {
        Err(error) => {
            let message = error.to_string();
            prop_assert!(message.starts_with("m:") && !message.contains('\n'), "{message}");
        }
        Ok(machine) => {
            for axis in &machine.axes {
                prop_assert!(axis.travel_min < axis.travel_max && axis.travel_max - axis.travel_min < 1e10);
                for limit in [axis.max_velocity, axis.max_acceleration, axis.max_jerk] {
                    prop_assert!(limit > 0.0 && limit <= 1.001e9);
                }
            }
            prop_assert!(machine.period_ns(machine.rate).is_ok());
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_never_panic(
        cut in any::<prop::sample::Index>(),
        at in any::<prop::sample::Index>(),
        put in prop_oneof![
            "[ -~\\n\"=\\[\\]{}.#é\u{0}]{0,6}",
            prop::sample::select(vec!["nan", "inf", "1e308", "-0", "1e-308", "0x", "9223372036854775807", "\"", "'''", "]", "[[axis]]\n", "=", "null", "1979-05-27"])
                .prop_map(str::to_owned),
        ],
        drop in 0_usize..12,
        truncate in any::<bool>(),
    ) {
        let bytes: Vec<char> = GOOD.chars().collect();
        let at = at.index(bytes.len());
        let mut text: String = bytes[..at].iter().collect();
        text.push_str(&put);
        text.extend(&bytes[(at + drop).min(bytes.len())..]);
        if truncate {
            let keep = cut.index(text.chars().count().max(1));
            text = text.chars().take(keep).collect();
        }
        valid_or_rejected(&text)?;
    }

    #[test]
    fn any_value_of_any_key_is_rejected_or_valid(
        line in 0_usize..40,
        value in prop_oneof![
            any::<f64>().prop_map(|x| format!("{x:e}")),
            any::<i64>().prop_map(|x| x.to_string()),
            prop::sample::select(vec!["true", "[]", "{}", "\"\"", "[1]", "\"X\"", "nan", "+inf", "1e400", "00:00:00"]).prop_map(str::to_owned),
        ],
    ) {
        let lines: Vec<_> = GOOD.lines().enumerate().map(|(i, old)| match old.split_once(" = ") {
            Some((key, _)) if i == line % GOOD.lines().count() => format!("{key} = {value}"),
            _ => old.to_owned(),
        }).collect();
        valid_or_rejected(&lines.join("\n"))?;
    }
}
