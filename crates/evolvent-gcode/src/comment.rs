//! Comments that do something.
//!
//! RS274/NGC, 3.3.4: a comment whose first printing characters are `MSG,`, in either case and with blanks
//! anywhere, is a message. LinuxCNC adds more of that kind.

use crate::Code;
use crate::diagnostic::{Fault, Span, printable};

/// The text of a message; `None` for a comment that is only one.
pub(crate) fn message(line: &[u8], inside: Span) -> Result<Option<String>, Fault> {
    let text = &line[inside.start as usize..inside.end as usize];
    if let Some(rest) = after_keyword(text, b"MSG") {
        return Ok(Some(printable(String::from_utf8_lossy(rest).trim())));
    }
    if after_keyword(text, b"ABORT").is_some() {
        return Err(
            Fault::new(Code::ActiveComment, inside, "ABORT is not available yet")
                .help("M0 or M2 stop a program"),
        );
    }
    Ok(None)
}

/// What follows `KEYWORD,`.
fn after_keyword<'text>(text: &'text [u8], keyword: &[u8]) -> Option<&'text [u8]> {
    let mut wanted = keyword.iter().chain(b",");
    let mut next = wanted.next();
    for (place, byte) in text.iter().enumerate() {
        if matches!(byte, b' ' | b'\t') {
            continue;
        }
        if Some(&byte.to_ascii_uppercase()) != next {
            return None;
        }
        next = wanted.next();
        if next.is_none() {
            return Some(&text[place + 1..]);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &[u8]) -> Result<Option<String>, Code> {
        message(text, Span::new(0, text.len())).map_err(|fault| fault.code)
    }

    #[test]
    fn messages_are_known_by_their_first_printing_characters() {
        assert_eq!(of(b"MSG, turn the part"), Ok(Some("turn the part".into())));
        assert_eq!(of(b" m s\tG , Turn"), Ok(Some("Turn".into())));
        assert_eq!(of(b"a MSG, no"), Ok(None));
        assert_eq!(of(b"MSG no"), Ok(None));
        assert_eq!(of(b""), Ok(None));
    }

    #[test]
    fn messages_cannot_steer_a_terminal() {
        assert_eq!(of(b"MSG,\x1b[2J\xff"), Ok(Some("\u{fffd}[2J\u{fffd}".into())));
    }

    #[test]
    fn what_would_stop_the_machine_is_not_ignored() {
        assert_eq!(of(b"abort, now"), Err(Code::ActiveComment));
    }
}
