//! A terminal in full-screen mode, which is always restored.

use std::io::{self, IsTerminal, Read as _, Write};

use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcgetwinsize, tcsetattr};

/// Switches to the alternate screen and hides the cursor, and back.
const BEGIN: &str = "\x1b[?1049h\x1b[?25l";
const END: &str = "\x1b[?25h\x1b[?1049l";
/// Moves the cursor home, clears the rest of a line and of the screen.
const HOME: &str = "\x1b[H";
const CLEAR_LINE: &str = "\x1b[K";
const CLEAR_BELOW: &str = "\x1b[J";
const PLAIN: &str = "\x1b[0m";

/// The alternate screen of the terminal and its keyboard, until dropped, including when a panic unwinds.
pub(crate) struct Terminal<'a> {
    out: &'a mut dyn Write,
    keys: Keys,
}

impl<'a> Terminal<'a> {
    /// Takes the terminal of standard input and output, which is `out`.
    pub(crate) fn take(out: &'a mut dyn Write) -> io::Result<Self> {
        let keys = Keys::new();
        let terminal = Self { out, keys };
        terminal.out.write_all(BEGIN.as_bytes())?;
        Ok(terminal)
    }

    /// Draws as much of a text as fits over the previous one.
    pub(crate) fn draw(&mut self, text: &str) -> io::Result<()> {
        // A terminal that does not report its size receives everything.
        let size = tcgetwinsize(io::stdout()).ok().filter(|size| size.ws_col > 0);
        let (rows, columns) = size.map_or((usize::MAX, usize::MAX), |size| {
            (usize::from(size.ws_row), usize::from(size.ws_col))
        });
        self.out.write_all(frame(text, rows, columns).as_bytes())?;
        self.out.flush()
    }

    /// Whether q was pressed, or a key that ends programs or input.
    pub(crate) fn wants_to_end(&self) -> bool {
        self.keys.wants_to_end()
    }
}

impl Drop for Terminal<'_> {
    fn drop(&mut self) {
        // If the terminal is closed, there is nothing to restore.
        let _ = self.out.write_all(END.as_bytes()).and_then(|()| self.out.flush());
    }
}

/// Formats a text for this many rows and columns. Lines are cleared before they are drawn, because after the
/// last column a terminal would clear that column.
fn frame(text: &str, rows: usize, columns: usize) -> String {
    let mut frame = String::from(HOME);
    let mut drawn = 0;
    for line in text.lines().take(rows) {
        if drawn > 0 {
            frame.push_str("\r\n");
        }
        frame.push_str(CLEAR_LINE);
        frame.push_str(&clip(line, columns));
        drawn += 1;
    }
    if drawn < rows {
        frame.push_str("\r\n");
        frame.push_str(CLEAR_BELOW);
    }
    frame
}

/// The part of a line that fits. Colours have no width.
fn clip(line: &str, columns: usize) -> String {
    let (mut out, mut used, mut colour, mut cut) = (String::new(), 0, false, false);
    for c in line.chars() {
        colour |= c == '\x1b';
        if colour {
            out.push(c);
            colour = c != 'm';
        } else if used < columns {
            out.push(c);
            used += 1;
        } else {
            cut = true;
            break;
        }
    }
    if cut {
        out.push_str(PLAIN);
    }
    out
}

/// The keyboard, key by key and without echo, until it is dropped.
struct Keys(Option<Termios>);

impl Keys {
    fn new() -> Self {
        let stdin = io::stdin();
        if !stdin.is_terminal() {
            return Self(None);
        }
        let Ok(before) = tcgetattr(&stdin) else {
            return Self(None);
        };
        let mut raw = before.clone();
        raw.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        // A read returns the available keys, or none.
        raw.special_codes[rustix::termios::SpecialCodeIndex::VMIN] = 0;
        raw.special_codes[rustix::termios::SpecialCodeIndex::VTIME] = 0;
        Self(
            tcsetattr(&stdin, OptionalActions::Now, &raw)
                .is_ok()
                .then_some(before),
        )
    }

    fn wants_to_end(&self) -> bool {
        let mut keys = [0; 16];
        self.0.is_some()
            && io::stdin()
                .lock()
                .read(&mut keys)
                .is_ok_and(|count| keys[..count].iter().any(|key| matches!(key, b'q' | b'Q' | 3 | 4)))
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        if let Some(before) = &self.0 {
            // If the terminal is closed, there is nothing to restore.
            let _ = tcsetattr(io::stdin(), OptionalActions::Now, before);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_clipped_to_the_terminal_size() {
        let text = "\x1b[1mabcdef\x1b[0m\nsecond\nthird\n";
        assert_eq!(
            frame(text, 2, 4),
            "\x1b[H\x1b[K\x1b[1mabcd\x1b[0m\r\n\x1b[Kseco\x1b[0m"
        );
        // The whole text if it fits, with its colours.
        assert_eq!(
            frame(text, 9, 6),
            "\x1b[H\x1b[K\x1b[1mabcdef\x1b[0m\r\n\x1b[Ksecond\r\n\x1b[Kthird\r\n\x1b[J"
        );
        assert_eq!(clip("\u{e9}\u{e9}\u{e9}", 2), "\u{e9}\u{e9}\x1b[0m");
        assert_eq!(frame(text, 0, 0), "\x1b[H");
    }
}
