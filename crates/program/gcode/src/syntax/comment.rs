//! Active comments.
//!
//! RS274/NGC, 3.3.4: a comment whose first printing characters are `MSG,`, in either case and with spaces
//! anywhere, is a message. LinuxCNC adds more active comments, in which parameters are replaced by their
//! values.

use std::fmt::Write as _;

use crate::diagnostics::diagnostic::{Span, printable};
use crate::parameters::names::NormalizedName;
use crate::state::scope::Scope;

/// The meaning of a comment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum ActiveComment {
    None,
    Message(String),
    Debug(String),
    Print(String),
    Log(String),
    LogOpen(String),
    LogAppend(String),
    LogClose,
    ProbeOpen(String),
    ProbeClose,
    Abort(String),
}

/// The meaning of the comment at a position of a line.
pub(crate) fn active_comment(line: &[u8], inside: Span, scope: &Scope<'_>) -> ActiveComment {
    let text = &line[inside.start as usize..inside.end as usize];
    let plain = |rest: &[u8]| printable(String::from_utf8_lossy(rest).trim());
    if let Some(rest) = after_keyword(text, b"MSG,") {
        return ActiveComment::Message(plain(rest));
    }
    if let Some(rest) = after_keyword(text, b"DEBUG,") {
        return ActiveComment::Debug(expanded(rest, scope));
    }
    if let Some(rest) = after_keyword(text, b"PRINT,") {
        return ActiveComment::Print(expanded(rest, scope));
    }
    if let Some(rest) = after_keyword(text, b"LOG,") {
        return ActiveComment::Log(expanded(rest, scope));
    }
    if let Some(rest) = after_keyword(text, b"LOGOPEN,") {
        return ActiveComment::LogOpen(plain(rest));
    }
    if let Some(rest) = after_keyword(text, b"PROBEOPEN") {
        return ActiveComment::ProbeOpen(plain(rest));
    }
    if let Some(rest) = after_keyword(text, b"LOGAPPEND,") {
        return ActiveComment::LogAppend(plain(rest));
    }
    if after_keyword(text, b"LOGCLOSE").is_some() {
        return ActiveComment::LogClose;
    }
    if after_keyword(text, b"PROBECLOSE").is_some() {
        return ActiveComment::ProbeClose;
    }
    if let Some(rest) = after_keyword(text, b"ABORT,") {
        return ActiveComment::Abort(expanded(rest, scope));
    }
    ActiveComment::None
}

/// The text after a keyword.
fn after_keyword<'text>(text: &'text [u8], keyword: &[u8]) -> Option<&'text [u8]> {
    let mut expected = keyword.iter();
    let mut next = expected.next();
    for (index, byte) in text.iter().enumerate() {
        if matches!(byte, b' ' | b'\t') {
            continue;
        }
        if Some(&byte.to_ascii_uppercase()) != next {
            return None;
        }
        next = expected.next();
        if next.is_none() {
            return Some(&text[index + 1..]);
        }
    }
    None
}

/// Replaces `#5` and `#<name>` in the text by values. `%d`, `%f` and `%.3f` select the format of the
/// following ones; unknown values are shown as `######`.
fn expanded(text: &[u8], scope: &Scope<'_>) -> String {
    let text = printable(&String::from_utf8_lossy(text));
    let mut out = String::with_capacity(text.len());
    let mut decimals = 6_usize;
    let mut rest = text.as_str();
    while let Some(character) = rest.chars().next() {
        let after = &rest[character.len_utf8()..];
        if character == '%' {
            if let Some((digits, after)) = format_of(after) {
                decimals = digits;
                rest = after;
                continue;
            }
        } else if character == '#'
            && let Some((value, after)) = parameter_of(after, scope)
        {
            match value {
                // Writing to a string cannot fail.
                Some(value) => drop(write!(out, "{value:.decimals$}")),
                None => out.push_str("######"),
            }
            rest = after;
            continue;
        }
        out.push(character);
        rest = after;
    }
    out.trim().to_owned()
}

/// The number of decimals requested after `%`, and the remaining text.
fn format_of(text: &str) -> Option<(usize, &str)> {
    let text_lower = text.get(..1)?;
    match text_lower {
        "d" | "D" => Some((0, &text[1..])),
        "f" | "F" => Some((4, &text[1..])),
        "." => {
            let digits = text[1..].chars().next()?.to_digit(10)?;
            let after = text.get(2..)?;
            let after = after.strip_prefix(['f', 'F'])?;
            Some((digits as usize, after))
        }
        _ => None,
    }
}

/// The value of the parameter after `#`, `None` if it is not set, and the remaining text.
fn parameter_of<'text>(text: &'text str, scope: &Scope<'_>) -> Option<(Option<f64>, &'text str)> {
    if let Some(inside) = text.strip_prefix('<') {
        let end = inside.find('>')?;
        let value = NormalizedName::new(&inside.as_bytes()[..end]).and_then(|name| scope.named(&name));
        return Some((value, &inside[end + 1..]));
    }
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    let index = text[..digits].parse::<usize>().ok()?;
    Some((Some(scope.numbered(index)), &text[digits..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::scope::tests::with_scope;

    fn of(text: &[u8]) -> ActiveComment {
        with_scope(|scope| active_comment(text, Span::new(0, text.len()), scope))
    }

    #[test]
    fn messages_start_with_their_keyword() {
        assert_eq!(
            of(b"MSG, turn the part"),
            ActiveComment::Message("turn the part".into())
        );
        assert_eq!(of(b" m s\tG , Turn"), ActiveComment::Message("Turn".into()));
        assert_eq!(of(b"a MSG, no"), ActiveComment::None);
        assert_eq!(of(b"MSG no"), ActiveComment::None);
        assert_eq!(of(b""), ActiveComment::None);
    }

    #[test]
    fn messages_contain_no_control_characters() {
        assert_eq!(
            of(b"MSG,\x1b[2J\xff"),
            ActiveComment::Message("\u{fffd}[2J\u{fffd}".into())
        );
    }

    #[test]
    fn values_are_printed_in_the_requested_format() {
        // Formats as LinuxCNC 2.9 prints them.
        let shown = of(b"debug, #5598 %d#5598 %f#5598 %.2f#<_coord_system> #<none> 100% #");
        assert_eq!(
            shown,
            ActiveComment::Debug("0.000000 0 0.0000 540.00 ###### 100% #".into())
        );
        assert_eq!(of(b"PRINT,#1"), ActiveComment::Print("0.000000".into()));
    }

    #[test]
    fn log_and_abort_comments_are_recognized() {
        assert_eq!(of(b"LOGOPEN, a.txt"), ActiveComment::LogOpen("a.txt".into()));
        assert_eq!(of(b"probeopen a.txt"), ActiveComment::ProbeOpen("a.txt".into()));
        assert_eq!(of(b"LOGAPPEND,b"), ActiveComment::LogAppend("b".into()));
        assert_eq!(of(b"LOG,x"), ActiveComment::Log("x".into()));
        assert_eq!(of(b"LOGCLOSE"), ActiveComment::LogClose);
        assert_eq!(of(b"abort, now"), ActiveComment::Abort("now".into()));
    }
}
