//! Messages of a program that take effect at one stop: one text.

use evolvent_bus::SENTENCE_BYTES;
use evolvent_motion::Setpoint;

/// Between two messages.
const BETWEEN: &str = "; ";
/// Below this difference the axes are where they were, mm or degrees: evaluated from another segment, the same
/// position differs by rounding.
const ROUNDING: f64 = 1e-6;

/// Both texts as one, if it fits into the status.
pub(crate) fn joined(before: &str, text: &str) -> Option<String> {
    if before.is_empty() {
        return Some(text.to_owned());
    }
    let length = before.len() + BETWEEN.len() + text.len();
    (length <= SENTENCE_BYTES).then(|| format!("{before}{BETWEEN}{text}"))
}

/// Whether no motion lies between two setpoints of one job.
pub(crate) fn is_same_stop(before: &Setpoint, now: &Setpoint) -> bool {
    let moved = before.position.iter().zip(now.position.iter());
    (before.path_mm - now.path_mm).abs() < ROUNDING
        && moved
            .into_iter()
            .all(|(before, now)| (before - now).abs() < ROUNDING)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_messages_are_one_text_while_it_fits() {
        assert_eq!(joined("", "a").as_deref(), Some("a"));
        assert_eq!(joined("a", "b").as_deref(), Some("a; b"));
        let long = "x".repeat(SENTENCE_BYTES - 3);
        assert_eq!(joined(&long, "b").map(|text| text.len()), Some(SENTENCE_BYTES));
        assert_eq!(joined(&long, "bc"), None);
    }
}
