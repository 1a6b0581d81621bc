//! Writes programs, rotated about Z.

use std::fmt::Write as _;

/// A sense of turning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turn {
    Left,
    Right,
}

impl Turn {
    pub(crate) const fn sign(self) -> f64 {
        match self {
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }

    const fn word(self) -> &'static str {
        match self {
            Self::Left => "G3",
            Self::Right => "G2",
        }
    }
}

/// Moves in mm, coordinates before the rotation.
#[derive(Clone, Debug)]
pub(crate) struct Pen {
    text: String,
    sin: f64,
    cos: f64,
    /// Present position, before the rotation.
    pub(crate) at: [f64; 3],
}

impl Pen {
    /// Returns the text of what `draw` draws, rotated by `degrees`.
    pub(crate) fn draw(degrees: f64, draw: impl FnOnce(&mut Self)) -> String {
        let (sin, cos) = libm::sincos(degrees.to_radians());
        let mut pen = Self {
            text: "G17 G21 G40 G49 G90 G91.1 G94\nG64 P0.02 Q0\n".to_owned(),
            sin,
            cos,
            at: [0.0; 3],
        };
        draw(&mut pen);
        pen.text.push_str("M2\n");
        pen.text
    }

    fn turned(&self, x: f64, y: f64) -> (f64, f64) {
        let turned = (self.cos * x - self.sin * y, self.sin * x + self.cos * y);
        // No "-0.00000".
        (turned.0 + 0.0, turned.1 + 0.0)
    }

    fn write(&mut self, line: std::fmt::Arguments<'_>) {
        // Writing to a string cannot fail.
        let _infallible = self.text.write_fmt(line);
        self.text.push('\n');
    }

    fn to(&mut self, word: &str, [x, y, z]: [f64; 3]) {
        let (tx, ty) = self.turned(x, y);
        self.write(format_args!("{word} X{tx:.5} Y{ty:.5} Z{z:.5}"));
        self.at = [x, y, z];
    }

    /// Feed in mm/min.
    pub(crate) fn feed(&mut self, mm_min: f64) {
        self.write(format_args!("F{mm_min}"));
    }

    /// A comment.
    pub(crate) fn say(&mut self, text: &str) {
        self.write(format_args!("({text})"));
    }

    /// G0.
    pub(crate) fn rapid(&mut self, to: [f64; 3]) {
        self.to("G0", to);
    }

    /// G1.
    pub(crate) fn line(&mut self, to: [f64; 3]) {
        self.to("G1", to);
    }

    /// G1 by a relative step.
    pub(crate) fn by(&mut self, step: [f64; 3]) {
        let [x, y, z] = self.at;
        self.line([x + step[0], y + step[1], z + step[2]]);
    }

    /// G2 or G3 in the XY plane; a full circle if the end equals the start.
    pub(crate) fn arc(&mut self, turn: Turn, to: [f64; 3], centre: [f64; 2]) {
        let [x, y, z] = to;
        let (tx, ty) = self.turned(x, y);
        let (i, j) = self.turned(centre[0] - self.at[0], centre[1] - self.at[1]);
        self.write(format_args!(
            "{} X{tx:.6} Y{ty:.6} Z{z:.6} I{i:.6} J{j:.6}",
            turn.word()
        ));
        self.at = to;
    }

    /// An arc by any angle from the present position, about a centre.
    pub(crate) fn sweep(&mut self, turn: Turn, centre: [f64; 2], degrees: f64) {
        let (sin, cos) = libm::sincos(turn.sign() * degrees.to_radians());
        let arm = [self.at[0] - centre[0], self.at[1] - centre[1]];
        let to = [
            centre[0] + cos * arm[0] - sin * arm[1],
            centre[1] + sin * arm[0] + cos * arm[1],
            self.at[2],
        ];
        self.arc(turn, to, centre);
    }

    /// G2.2 or G3.2 in the XY plane, with more digits: an involute is checked against its end.
    pub(crate) fn involute(&mut self, turn: Turn, to: [f64; 2], centre: [f64; 2], base: f64) {
        let (x, y) = self.turned(to[0], to[1]);
        let (i, j) = self.turned(centre[0] - self.at[0], centre[1] - self.at[1]);
        self.write(format_args!(
            "{}.2 X{x:.12} Y{y:.12} I{i:.12} J{j:.12} R{base}",
            turn.word()
        ));
        self.at = [to[0], to[1], self.at[2]];
    }

    /// Writes a line unchanged, for words that the pen does not have; it is not rotated and ends at `to`.
    pub(crate) fn raw(&mut self, line: &str, to: [f64; 3]) {
        self.write(format_args!("{line}"));
        self.at = to;
    }
}
