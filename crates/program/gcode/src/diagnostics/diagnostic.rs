//! Error reports: what is wrong, where, and what to do.

use std::borrow::Cow;
use std::ops::Range;

use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};

use crate::Code;

/// Bytes of the source line that a diagnostic keeps on either side of the error. A program may be a single
/// line of many kilobytes.
const CONTEXT_BYTES: usize = 100;

/// An error in a program with its position. All fields are plain data, for editors (`check --json`).
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Diagnostic {
    /// Stable number, such as `G0103`.
    pub code: Code,
    /// The file, if it is a subroutine file instead of the program.
    pub file: Option<Box<str>>,
    /// Physical line in the file, from 1.
    pub line: u32,
    /// Column of the first character concerned, from 1, in characters.
    pub column: u32,
    /// Number of characters concerned; may be 0 at the end of a line.
    pub length: u32,
    /// The error in one sentence, with its numbers.
    pub message: String,
    /// What is expected, or what to write instead.
    pub help: Option<Box<str>>,
    /// The source line, or the part of a long line around the error.
    pub source: Box<str>,
    /// Byte range in `source`.
    pub span: Range<usize>,
    /// The calls that led to the line, innermost first; empty in the program itself.
    pub calls: Box<[Call]>,
}

/// A line that calls a subroutine.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Call {
    /// The file, if it is not the program itself.
    pub file: Option<Box<str>>,
    /// Physical line, from 1.
    pub line: u32,
}

impl serde::Serialize for Code {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

impl Diagnostic {
    /// A diagnostic about a whole line, or about the first word with this letter on it, for callers that know
    /// commands but not words. `text` is the line as in the file.
    #[must_use]
    pub fn about_line(code: Code, line: u32, text: &[u8], letter: Option<char>, message: String) -> Self {
        let is_letter =
            |byte: u8| letter.is_some_and(|letter| char::from(byte).eq_ignore_ascii_case(&letter));
        let mut in_comment = false;
        let start = text.iter().take_while(|byte| **byte != b';').position(|&byte| {
            in_comment = byte == b'(' || in_comment && byte != b')';
            !in_comment && is_letter(byte)
        });
        let span = match start {
            Some(start) => {
                let is_end = |byte: &u8| {
                    byte.is_ascii_alphabetic() || byte.is_ascii_whitespace() || matches!(byte, b'(' | b';')
                };
                let length = text[start + 1..].iter().position(is_end);
                Span::new(start, length.map_or(text.len(), |length| start + 1 + length))
            }
            None => Span::new(0, text.trim_ascii_end().len()),
        };
        Fault::new(code, span, message).locate(line, text.trim_ascii_end())
    }

    /// The diagnostic in the style of compilers: several lines of plain text, without a trailing newline.
    #[must_use]
    pub fn render(&self, file_name: &str) -> String {
        self.render_with(file_name, &Renderer::plain())
    }

    /// The same with terminal colours.
    #[must_use]
    pub fn render_styled(&self, file_name: &str) -> String {
        self.render_with(file_name, &Renderer::styled())
    }

    fn render_with(&self, file_name: &str, renderer: &Renderer) -> String {
        // Only a part of a long line is kept. Spaces replace what precedes it, so that columns count as in
        // the file; the renderer truncates the line on both sides.
        let shown_before = self.source[..self.span.start].chars().count();
        let hidden = (self.column as usize).saturating_sub(1 + shown_before);
        let source = format!("{}{}", " ".repeat(hidden), self.source);
        let span = self.span.start + hidden..self.span.end + hidden;
        let path = self.file.as_deref().unwrap_or(file_name);
        let snippet = Snippet::source(source.as_str())
            .path(path)
            .line_start(self.line as usize)
            .annotation(AnnotationKind::Primary.span(span));
        let mut group = Level::ERROR
            .primary_title(self.message.as_str())
            .id(self.code.as_str())
            .element(snippet);
        // Recursion is shown as one line.
        let calls: Vec<String> = (self.calls)
            .chunk_by(|a, b| a == b)
            .map(|same| same[0].description(file_name, same.len()))
            .collect();
        for call in &calls {
            group = group.element(Level::NOTE.message(call.as_str()));
        }
        if let Some(help) = &self.help {
            group = group.element(Level::HELP.message(&**help));
        }
        renderer.render(&[group])
    }
}

impl Call {
    fn description(&self, program: &str, count: usize) -> String {
        let file = self.file.as_deref().unwrap_or(program);
        let count = match count {
            1 => String::new(),
            count => format!(", {count} calls deep"),
        };
        format!("called from {file}:{}{count}", self.line)
    }
}

impl std::fmt::Display for Diagnostic {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            formatter,
            "{}:{}: {}: {}",
            self.line, self.column, self.code, self.message
        )
    }
}

impl std::error::Error for Diagnostic {}

/// Byte range of a line, end exclusive. Lines are short, so 32 bits suffice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Span {
    pub(crate) start: u32,
    pub(crate) end: u32,
}

impl Span {
    pub(crate) fn new(start: usize, end: usize) -> Self {
        let narrow = |position: usize| u32::try_from(position).unwrap_or(u32::MAX);
        Self {
            start: narrow(start),
            end: narrow(end),
        }
    }

    /// A single byte.
    pub(crate) fn at(position: usize) -> Self {
        Self::new(position, position + 1)
    }
}

/// An error whose line is not known yet, as returned inside this crate. Boxed, because every number and every
/// expression returns a result.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Fault(Box<FaultData>);

/// The contents of a [`Fault`].
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct FaultData {
    pub(crate) code: Code,
    pub(crate) span: Span,
    pub(crate) message: String,
    pub(crate) help: Option<Cow<'static, str>>,
}

impl std::ops::Deref for Fault {
    type Target = FaultData;

    fn deref(&self) -> &FaultData {
        &self.0
    }
}

impl std::ops::DerefMut for Fault {
    fn deref_mut(&mut self) -> &mut FaultData {
        &mut self.0
    }
}

impl Fault {
    #[cold]
    pub(crate) fn new(code: Code, span: Span, message: impl Into<String>) -> Self {
        Self(Box::new(FaultData {
            code,
            span,
            message: message.into(),
            help: None,
        }))
    }

    pub(crate) fn help(mut self, help: impl Into<Cow<'static, str>>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// Adds the line number. `text` is the line, in any bytes.
    pub(crate) fn locate(self, line: u32, text: &[u8]) -> Diagnostic {
        let data = *self.0;
        data.locate(line, text)
    }
}

impl FaultData {
    fn locate(self, line: u32, text: &[u8]) -> Diagnostic {
        let end = (self.span.end as usize).min(text.len());
        let start = (self.span.start as usize).min(end);
        let before = String::from_utf8_lossy(&text[..start]);
        let marked = printable(&String::from_utf8_lossy(&text[start..end]));
        let narrow = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        let column = narrow(before.chars().count() + 1);
        let length = narrow(marked.chars().count());

        let mut source = printable(tail(&before, CONTEXT_BYTES));
        let span_start = source.len();
        let marked = head(&marked, CONTEXT_BYTES);
        source.push_str(marked);
        let span = span_start..source.len();
        // Only a bounded part: `from_utf8_lossy` on all of a long line would be wasted work.
        let rest = &text[end..text.len().min(end + CONTEXT_BYTES)];
        source.push_str(&printable(&String::from_utf8_lossy(rest)));
        Diagnostic {
            code: self.code,
            file: None,
            line,
            column,
            length,
            message: printable(&self.message),
            help: Some(
                self.help
                    .map_or_else(|| self.code.hint().into(), |help| help.into_owned().into()),
            ),
            source: source.into(),
            span,
            calls: Box::default(),
        }
    }
}

/// Replaces control characters one by one, so that a program cannot control the terminal. Tabs become spaces.
pub(crate) fn printable(text: &str) -> String {
    text.chars()
        .map(|character| match character {
            '\t' => ' ',
            _ if character.is_control() => char::REPLACEMENT_CHARACTER,
            _ => character,
        })
        .collect()
}

/// The last `bytes` bytes at most, cut at a character boundary.
fn tail(text: &str, bytes: usize) -> &str {
    let mut start = text.len().saturating_sub(bytes);
    while !text.is_char_boundary(start) {
        start += 1;
    }
    &text[start..]
}

/// The first `bytes` bytes at most, cut at a character boundary.
fn head(text: &str, bytes: usize) -> &str {
    let mut end = text.len().min(bytes);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    &text[..end]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_count_characters_and_spans_count_bytes() {
        let text = "(\u{e9}\u{e9}) G1 X?".as_bytes();
        let position = text.len() - 1;
        let found = Fault::new(Code::UnexpectedCharacter, Span::at(position), "what").locate(3, text);
        assert_eq!((found.line, found.column, found.length), (3, 10, 1));
        assert_eq!(&found.source[found.span], "?");
    }

    #[test]
    fn a_line_is_marked_at_its_word_outside_comments() {
        for (text, word) in [
            ("(X) G1 X5(X6) Y3", "X5"),
            ("g1 x 7 ; X", "x"),
            ("G1 Y2 (X5) ; X", "G1 Y2 (X5) ; X"),
        ] {
            let about = Diagnostic::about_line(
                Code::UnexpectedCharacter,
                1,
                text.as_bytes(),
                Some('X'),
                "what".to_owned(),
            );
            assert_eq!(&about.source[about.span], word, "{text}");
        }
    }

    #[test]
    fn invalid_utf8_does_not_shift_the_marker() {
        let text = b"(\xff\xfe) G1 X?";
        let found = Fault::new(Code::UnexpectedCharacter, Span::at(text.len() - 1), "what").locate(1, text);
        assert_eq!(found.column, 10);
        assert_eq!(&found.source[found.span], "?");
    }

    #[test]
    fn a_long_line_is_truncated_around_the_error() {
        let mut text = vec![b' '; 50_000];
        text[30_000] = b'?';
        let found = Fault::new(Code::UnexpectedCharacter, Span::at(30_000), "what").locate(1, &text);
        assert_eq!(found.column, 30_001);
        assert!(found.source.len() <= 3 * CONTEXT_BYTES);
        assert!(
            found.render("a.ngc").contains("a.ngc:1:30001"),
            "{}",
            found.render("a.ngc")
        );
        assert_eq!(&found.source[found.span], "?");
    }

    #[test]
    fn rendering_shows_code_position_line_marker_and_help() {
        let fault = Fault::new(Code::UnknownG, Span::new(3, 6), "there is no G77").help("write G1");
        let shown = fault.locate(12, b"N1 G77 X3").render("part.ngc");
        for expected in [
            "G0301",
            "there is no G77",
            "part.ngc:12:4",
            "N1 G77 X3",
            "^^^",
            "write G1",
        ] {
            assert!(shown.contains(expected), "{expected:?} is not in\n{shown}");
        }
    }

    #[test]
    fn escape_sequences_do_not_reach_the_terminal() {
        let fault = Fault::new(Code::UnexpectedCharacter, Span::at(0), "what");
        assert!(
            !fault
                .locate(1, b"\x1b[2J (\x1b[2J\x07)")
                .render("a")
                .contains('\x1b')
        );
    }

    #[test]
    fn codes_are_unique() {
        let mut texts: Vec<_> = Code::ALL.iter().map(|code| code.as_str()).collect();
        texts.sort_unstable();
        texts.dedup();
        assert_eq!(texts.len(), Code::ALL.len());
    }
}
