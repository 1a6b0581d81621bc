//! Exact curves of a program in the XY plane, by independent formulas.
//!
//! Nothing here comes from the crates under test. An involute of a circle of radius r has, at the roll angle
//! `p`, the distance `sqrt(1 + p^2) r` from the centre of the circle and the polar angle `start + s (p - atan
//! p)`, where s is 1 if it winds counter-clockwise outwards and -1 if not. Its normals are the tangents of
//! the circle, so the distance of a point from it, measured along the tangent of length t that ends in the
//! point, is `t - r p`.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// A point or vector, mm.
type Point = [f64; 3];

/// One motion of a program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece {
    /// From point to point.
    Line {
        /// Its start, mm.
        from: Point,
        /// Its end, mm.
        to: Point,
    },
    /// Part of a circle, or all of it.
    Arc {
        /// The circle's centre, mm.
        centre: [f64; 2],
        /// Its radius, mm.
        radius: f64,
        /// The angle that it covers, rad.
        angle: f64,
    },
    /// Part of an involute.
    Involute {
        /// Centre of the base circle, mm.
        centre: [f64; 2],
        /// Its radius, mm.
        radius: f64,
        /// Polar angle at which the involute leaves its base circle, rad.
        start: f64,
        /// 1 if it winds counter-clockwise outwards, else -1.
        sense: f64,
        /// Roll angles at the start and end, rad.
        roll: [f64; 2],
    },
}

impl Piece {
    /// Its length, mm.
    #[must_use]
    pub fn length(&self) -> f64 {
        match self {
            Self::Line { from, to } => (0..3)
                .map(|i| (to[i] - from[i]) * (to[i] - from[i]))
                .sum::<f64>()
                .sqrt(),
            Self::Arc { radius, angle, .. } => radius * angle,
            Self::Involute {
                radius, roll: [a, b], ..
            } => 0.5 * radius * (b * b - a * a).abs(),
        }
    }

    /// Radius of the base circle of an involute that begins or ends on it, mm; 0 otherwise.
    #[must_use]
    pub fn base_radius_touched(&self) -> f64 {
        match self {
            Self::Involute {
                radius, roll: [a, b], ..
            } if a.min(*b) < 1e-3 => *radius,
            _ => 0.0,
        }
    }

    /// Whether it is curved.
    #[must_use]
    pub const fn is_curved(&self) -> bool {
        !matches!(self, Self::Line { .. })
    }

    /// The distance of a point of the XY plane from the whole line, circle or involute, mm.
    #[must_use]
    pub fn distance(&self, [x, y]: [f64; 2]) -> f64 {
        match *self {
            Self::Line { from, to } => {
                let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
                let length = dx.hypot(dy);
                let (px, py) = (x - from[0], y - from[1]);
                if length > 0.0 {
                    ((px * dy - py * dx) / length).abs()
                } else {
                    px.hypot(py)
                }
            }
            Self::Arc { centre, radius, .. } => ((x - centre[0]).hypot(y - centre[1]) - radius).abs(),
            Self::Involute {
                centre,
                radius,
                start,
                sense,
                ..
            } => {
                let (px, py) = (x - centre[0], y - centre[1]);
                let tangent = (px * px + py * py - radius * radius).max(0.0).sqrt();
                let roll = sense * (py.atan2(px) - start) + tangent.atan2(radius);
                // The angle is known up to whole turns: the nearest branch is taken.
                let turns = ((tangent / radius - roll) / TAU).round();
                (tangent - radius * (roll + TAU * turns)).abs()
            }
        }
    }

    /// The maximum distance of the piece from the chord between two points, mm, at 31 points of the piece.
    #[must_use]
    pub fn chord_error(&self, a: [f64; 2], b: [f64; 2]) -> f64 {
        let at = |fraction: f64| [a[0] + fraction * (b[0] - a[0]), a[1] + fraction * (b[1] - a[1])];
        (1..32)
            .map(|i| self.distance(at(f64::from(i) / 32.0)))
            .fold(0.0, f64::max)
    }
}

/// The motions of a program by line, and its end.
#[derive(Clone, Debug)]
pub struct Hole {
    /// The motions by line, counted from 1.
    pub pieces: BTreeMap<u32, Piece>,
    /// End of the last motion, mm.
    pub end: Point,
}

impl Hole {
    /// Reads a program in the form that `evolvent bore` writes: absolute coordinates in mm, G0 to G3 and
    /// G2.2, G3.2 in the XY plane, I and J relative to the start.
    ///
    /// # Panics
    /// If it is not such a program.
    #[must_use]
    pub fn read(program: &str) -> Self {
        let mut at = [0.0; 3];
        let mut mode = "G0".to_owned();
        let mut pieces = BTreeMap::new();
        for (line, text) in (1..).zip(program.lines()) {
            let words = words(text);
            let value = |letter: char| words.iter().find(|word| word.0 == letter).map(|word| word.1);
            for (letter, number) in &words {
                if *letter == 'G' && [0.0, 1.0, 2.0, 3.0, 2.2, 3.2].contains(number) {
                    mode = format!("G{number}");
                }
            }
            let mut to = at;
            for (i, letter) in ['X', 'Y', 'Z'].into_iter().enumerate() {
                to[i] = value(letter).unwrap_or(at[i]);
            }
            if value('X')
                .or(value('Y'))
                .or(value('Z'))
                .or(value('I'))
                .or(value('J'))
                .is_none()
            {
                continue;
            }
            let centre = [
                at[0] + value('I').unwrap_or(0.0),
                at[1] + value('J').unwrap_or(0.0),
            ];
            let turn = if mode.starts_with("G3") { 1.0 } else { -1.0 };
            let piece = match mode.as_str() {
                "G0" | "G1" => Piece::Line { from: at, to },
                "G2" | "G3" => arc(at, to, centre, turn),
                _ => involute(at, to, centre, turn, value('R').expect("R")),
            };
            pieces.insert(line, piece);
            at = to;
        }
        Self { pieces, end: at }
    }

    /// Length of all motions, mm.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.pieces.values().map(Piece::length).sum()
    }
}

/// Letters and numbers of a line, without comments.
fn words(line: &str) -> Vec<(char, f64)> {
    let code = line.split('(').next().unwrap_or_default();
    let starts: Vec<usize> = code
        .char_indices()
        .filter(|(_, c)| c.is_ascii_alphabetic())
        .map(|(i, _)| i)
        .collect();
    let ends = starts.iter().skip(1).copied().chain([code.len()]);
    let word = |(start, end): (usize, usize)| {
        let number = code[start + 1..end].trim().parse().expect("a plain number");
        (code.as_bytes()[start] as char, number)
    };
    starts.iter().copied().zip(ends).map(word).collect()
}

fn polar(point: Point, centre: [f64; 2]) -> (f64, f64) {
    let (x, y) = (point[0] - centre[0], point[1] - centre[1]);
    (x.hypot(y), y.atan2(x))
}

fn arc(from: Point, to: Point, centre: [f64; 2], turn: f64) -> Piece {
    let ((radius, a), (_, b)) = (polar(from, centre), polar(to, centre));
    let angle = (turn * (b - a)).rem_euclid(TAU);
    let closed = from == to;
    Piece::Arc {
        centre,
        radius,
        angle: if closed { TAU } else { angle },
    }
}

fn involute(from: Point, to: Point, centre: [f64; 2], turn: f64, radius: f64) -> Piece {
    let roll = |point: Point| {
        let (x, y) = (point[0] - centre[0], point[1] - centre[1]);
        (x * x + y * y - radius * radius).max(0.0).sqrt() / radius
    };
    let roll = [roll(from), roll(to)];
    let sense = if roll[1] > roll[0] { turn } else { -turn };
    let start = polar(from, centre).1 - sense * (roll[0] - roll[0].atan());
    Piece::Involute {
        centre,
        radius,
        start,
        sense,
        roll,
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    #[test]
    fn a_point_off_an_involute_is_at_its_normal_distance() {
        // The involute of the unit circle at a quarter turn: (pi/2, 1), heading for +Y.
        let involute = Piece::Involute {
            centre: [0.0; 2],
            radius: 1.0,
            start: 0.0,
            sense: 1.0,
            roll: [0.0, PI],
        };
        for off in [-0.01, 0.0, 0.3] {
            let found = involute.distance([PI / 2.0 + off, 1.0]);
            assert!((found - f64::abs(off)).abs() < 1e-12, "{off}: {found}");
        }
    }
}
