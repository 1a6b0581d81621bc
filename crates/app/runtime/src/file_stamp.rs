//! Times in file names.

use std::time::SystemTime;

use time::OffsetDateTime;

/// A time in UTC as `YYYYMMDDTHHMMSS.mmmZ`, for file names: alphabetical order is the order in time.
#[must_use]
pub fn file_stamp(at: SystemTime) -> String {
    let at = OffsetDateTime::from(at);
    format!(
        "{:04}{:02}{:02}T{:02}{:02}{:02}.{:03}Z",
        at.year(),
        u8::from(at.month()),
        at.day(),
        at.hour(),
        at.minute(),
        at.second(),
        at.millisecond()
    )
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, UNIX_EPOCH};

    use super::*;

    #[test]
    fn it_is_the_time_of_the_calendar() {
        // `date -u -d @N +%Y%m%dT%H%M%S`
        for (seconds, expected) in [
            (0, "19700101T000000.000Z"),
            (951_827_696, "20000229T123456.000Z"),
            (1_795_219_200, "20261121T000000.000Z"),
            (4_107_542_399, "21000228T235959.000Z"),
        ] {
            assert_eq!(file_stamp(UNIX_EPOCH + Duration::from_secs(seconds)), expected);
        }
    }
}
