//! Where something wrong stands in a file, and how it is told.

use std::ops::Range;

use evolvent_sheet::{Found, find_toml, line_and_column, shortened};

use super::Check;
use crate::error::MachineError;

impl Check<'_> {
    pub(super) fn error(&self, key: &str, what: String, advice: impl Into<String>) -> MachineError {
        self.error_at(key, None, what, advice.into())
    }

    /// `span` is used where the key itself is not in the file.
    pub(super) fn error_at(
        &self,
        key: &str,
        span: Option<Range<usize>>,
        what: String,
        advice: String,
    ) -> MachineError {
        let found = find_toml(self.table, self.whole.start, key);
        let place = match (found, span) {
            (Found::Key(place), _) | (Found::Parent(place), None) => place,
            (_, Some(span)) => span.start,
        };
        let (line, column) = line_and_column(self.text, place);
        let key = if key.is_empty() || key == "." {
            "the file".to_owned()
        } else {
            shortened(key)
        };
        MachineError::Key {
            file: self.file.to_owned(),
            line,
            column,
            key,
            what,
            advice,
        }
    }
}

/// What to do about something that serde refused.
pub(super) fn advice_for(key: &str, what: &str) -> String {
    let last = key.rsplit('.').next().unwrap_or(key);
    if what.starts_with("unknown field") {
        let unit = match last {
            "max_velocity" => "max_velocity_mm_min or max_velocity_mm_s (rotary: _deg_min or _deg_s)",
            "max_acceleration" => {
                "max_acceleration_mm_s2, max_acceleration_m_s2 or max_acceleration_g (rotary: _deg_s2)"
            }
            "max_jerk" => "max_jerk_mm_s3 or max_jerk_m_s3 (rotary: _deg_s3)",
            "travel_min" => "travel_min_mm (rotary: travel_min_deg)",
            "travel_max" => "travel_max_mm (rotary: travel_max_deg)",
            "home" => "home_mm (rotary: home_deg)",
            "following_error" => "following_error_mm (rotary: following_error_deg)",
            "following_time" => "following_time_ms",
            "feedback_timeout" => "feedback_timeout_ms",
            "enable_timeout" => "enable_timeout_ms",
            "blend_tolerance" => "blend_tolerance_mm",
            "joint_time" => "joint_time_ms",
            "max_feed" => "max_feed_mm_min or max_feed_mm_s",
            _ => return "correct the spelling, or remove the key".to_owned(),
        };
        return format!("the unit is missing: write {unit}");
    }
    if what.starts_with("missing field") {
        return "add this key".to_owned();
    }
    "correct the value".to_owned()
}
