//! The profile of a turned part: lines and arcs in a plane, offset by an allowance, and intersected with the
//! levels of passes.
//!
//! Coordinates `[u, w]`: passes run towards increasing `u`, depths towards decreasing `w`; the stock is above
//! the profile.

/// Points closer than this are equal, mm.
pub(crate) const NEAR: f64 = 1e-7;

/// Corners that turn by less than this, rad, are joined as they are if their sides do not intersect.
const ALL_BUT_TANGENT: f64 = 0.02;

/// Ends of offset pieces no farther apart than this are joined, mm: programs are rounded to 0.01 or 0.001 mm.
const JOIN_MM: f64 = 2e-3;

pub(crate) type Point = [f64; 2];

/// A line, or an arc about `centre` that turns left (`turn` +1) or right (-1), by less than a full turn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Piece {
    Line {
        a: Point,
        b: Point,
    },
    Arc {
        a: Point,
        b: Point,
        centre: Point,
        turn: f64,
    },
}

/// The reason why a profile cannot be turned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ProfileFault {
    Empty,
    /// It reverses along the direction of the passes.
    NotMonotonic,
    /// The allowance leaves nothing of it.
    Allowance,
    /// A fillet or chamfer that does not fit.
    Corner,
}

pub(crate) fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

pub(crate) fn plus(a: Point, direction: Point, distance: f64) -> Point {
    [a[0] + distance * direction[0], a[1] + distance * direction[1]]
}

pub(crate) fn distance(a: Point, b: Point) -> f64 {
    libm::hypot(a[0] - b[0], a[1] - b[1])
}

fn unit(a: Point) -> Point {
    let length = libm::hypot(a[0], a[1]);
    [a[0] / length, a[1] / length]
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

fn left(a: Point) -> Point {
    [-a[1], a[0]]
}

/// Rotation of the direction from the centre from `a` to `b` in the sense of `turn`, 0 to a full turn.
fn sweep(centre: Point, a: Point, b: Point, turn: f64) -> f64 {
    let (a, b) = (minus(a, centre), minus(b, centre));
    let angle = turn * libm::atan2(cross(a, b), a[0] * b[0] + a[1] * b[1]);
    if angle < 0.0 {
        angle + std::f64::consts::TAU
    } else {
        angle
    }
}

impl Piece {
    pub(crate) fn start(&self) -> Point {
        match *self {
            Self::Line { a, .. } | Self::Arc { a, .. } => a,
        }
    }

    pub(crate) fn end(&self) -> Point {
        match *self {
            Self::Line { b, .. } | Self::Arc { b, .. } => b,
        }
    }

    fn with_start(mut self, point: Point) -> Self {
        match &mut self {
            Self::Line { a, .. } | Self::Arc { a, .. } => *a = point,
        }
        self
    }

    fn with_end(mut self, point: Point) -> Self {
        match &mut self {
            Self::Line { b, .. } | Self::Arc { b, .. } => *b = point,
        }
        self
    }

    /// The two parts of the piece on either side of a point on it.
    pub(crate) fn split(self, at: Point) -> (Self, Self) {
        (self.with_end(at), self.with_start(at))
    }

    pub(crate) fn is_degenerate(&self) -> bool {
        distance(self.start(), self.end()) < NEAR
    }

    /// Direction at the start or end.
    fn direction(&self, at_end: bool) -> Point {
        match *self {
            Self::Line { a, b } => unit(minus(b, a)),
            Self::Arc { a, b, centre, turn } => {
                let outwards = unit(minus(if at_end { b } else { a }, centre));
                let ahead = left(outwards);
                [turn * ahead[0], turn * ahead[1]]
            }
        }
    }

    /// Whether a point of its line or circle is on the piece.
    fn holds(&self, point: Point) -> bool {
        if distance(point, self.start()) < NEAR || distance(point, self.end()) < NEAR {
            return true;
        }
        match *self {
            Self::Line { a, b } => {
                let (along, whole) = (minus(point, a), minus(b, a));
                let share = along[0] * whole[0] + along[1] * whole[1];
                share >= 0.0 && share <= whole[0] * whole[0] + whole[1] * whole[1]
            }
            Self::Arc { a, b, centre, turn } => sweep(centre, a, point, turn) <= sweep(centre, a, b, turn),
        }
    }

    /// Intersections of the lines or circles of both pieces.
    fn crossings(&self, other: &Self) -> [Option<Point>; 2] {
        let pair = |middle: Point, direction: Point, square: f64| {
            // Rounding may turn a tangent into a miss.
            if square < -NEAR * NEAR {
                return [None; 2];
            }
            let half = square.max(0.0).sqrt();
            [
                Some(plus(middle, direction, half)),
                Some(plus(middle, direction, -half)),
            ]
        };
        let line_and_circle = |a: Point, b: Point, centre: Point, radius: f64| {
            let direction = unit(minus(b, a));
            let along = minus(centre, a);
            let foot = plus(a, direction, along[0] * direction[0] + along[1] * direction[1]);
            let apart = distance(foot, centre);
            pair(foot, direction, (radius - apart) * (radius + apart))
        };
        match (*self, *other) {
            (Self::Line { a, b }, Self::Line { a: c, b: d }) => {
                let (way, other) = (minus(b, a), minus(d, c));
                let share = cross(minus(c, a), other) / cross(way, other);
                [share.is_finite().then(|| plus(a, way, share)), None]
            }
            (Self::Line { a, b }, Self::Arc { a: on, centre, .. })
            | (Self::Arc { a: on, centre, .. }, Self::Line { a, b }) => {
                line_and_circle(a, b, centre, distance(on, centre))
            }
            (
                Self::Arc { a, centre, .. },
                Self::Arc {
                    a: c, centre: second, ..
                },
            ) => {
                let (radius, other) = (distance(a, centre), distance(c, second));
                let apart = distance(centre, second);
                if apart < NEAR {
                    return [None; 2];
                }
                let direction = unit(minus(second, centre));
                let foot = (apart * apart + (radius - other) * (radius + other)) / (2.0 * apart);
                let middle = plus(centre, direction, foot);
                pair(middle, left(direction), (radius - foot) * (radius + foot))
            }
        }
    }

    /// The piece offset to its left; `None` for an arc that vanishes.
    fn aside(&self, allowance: f64) -> Option<Self> {
        match *self {
            Self::Line { a, b } => {
                let normal = left(self.direction(false));
                Some(Self::Line {
                    a: plus(a, normal, allowance),
                    b: plus(b, normal, allowance),
                })
            }
            Self::Arc { a, b, centre, turn } => {
                let radius = distance(a, centre);
                let wanted = radius - turn * allowance;
                let moved = |point: Point| plus(centre, minus(point, centre), wanted / radius);
                (wanted > NEAR).then(|| Self::Arc {
                    a: moved(a),
                    b: moved(b),
                    centre,
                    turn,
                })
            }
        }
    }

    /// The lowest or highest point of an arc, if it is inside.
    fn extreme(&self) -> Option<Point> {
        let Self::Arc { a, b, centre, turn } = *self else {
            return None;
        };
        // With increasing u an arc that turns left has a minimum, one that turns right a maximum.
        let point = [centre[0], centre[1] - turn * distance(a, centre)];
        let inside = sweep(centre, a, point, turn) < sweep(centre, a, b, turn);
        (inside && distance(point, a) > NEAR && distance(point, b) > NEAR).then_some(point)
    }

    /// The point of a monotonic piece at a height.
    pub(crate) fn at_height(&self, w: f64) -> Option<Point> {
        let (a, b) = (self.start(), self.end());
        if (w - a[1]).abs() < NEAR {
            return Some(a);
        }
        if (w - b[1]).abs() < NEAR {
            return Some(b);
        }
        if (w - a[1]) * (w - b[1]) > 0.0 {
            return None;
        }
        let level = Self::Line {
            a: [0.0, w],
            b: [1.0, w],
        };
        let found = self.crossings(&level).into_iter().flatten();
        found.map(|point| [point[0], w]).find(|point| self.holds(*point))
    }
}

/// Checks that the passes never have to reverse.
pub(crate) fn check_monotonic(pieces: &[Piece]) -> Result<(), ProfileFault> {
    if pieces.is_empty() {
        return Err(ProfileFault::Empty);
    }
    let forward = |piece: &Piece| match *piece {
        Piece::Line { a, b } => b[0] >= a[0] - NEAR,
        Piece::Arc { a, b, centre, turn } => {
            let ahead = |at_end| piece.direction(at_end)[0] >= -1e-6;
            b[0] >= a[0] - NEAR
                && ahead(false)
                && ahead(true)
                && sweep(centre, a, b, turn) < std::f64::consts::PI + 1e-6
        }
    };
    if pieces.iter().all(forward) {
        Ok(())
    } else {
        Err(ProfileFault::NotMonotonic)
    }
}

/// The point at which a line and a nearly tangent arc touch.
fn touch(before: &Piece, after: &Piece) -> Option<Point> {
    let (a, b, centre) = match (*before, *after) {
        (Piece::Line { a, b }, Piece::Arc { centre, .. })
        | (Piece::Arc { centre, .. }, Piece::Line { a, b }) => (a, b, centre),
        _ => return None,
    };
    let direction = unit(minus(b, a));
    let along = minus(centre, a);
    let foot = plus(a, direction, along[0] * direction[0] + along[1] * direction[1]);
    (distance(foot, before.end()) < 10.0 * JOIN_MM).then_some(foot)
}

/// The profile offset by `allowance` to the left. Convex corners get an arc about the corner, concave ones
/// are trimmed at the intersection of both sides, and pieces that do not fit between their neighbours are
/// removed.
pub(crate) fn aside(pieces: &[Piece], allowance: f64) -> Result<Vec<Piece>, ProfileFault> {
    if allowance == 0.0 {
        return Ok(pieces.to_vec());
    }
    let mut out: Vec<Piece> = Vec::with_capacity(2 * pieces.len());
    let mut gap = false;
    let mut before: Option<Piece> = None;
    for (index, piece) in pieces.iter().enumerate() {
        let Some(moved) = piece.aside(allowance) else {
            gap = true;
            before = None;
            continue;
        };
        let turn = match index {
            0 => 1.0,
            _ => cross(pieces[index - 1].direction(true), piece.direction(false)),
        };
        let joined = before.filter(|before| {
            let near = distance(before.end(), moved.start()) < JOIN_MM;
            near || turn.abs() < ALL_BUT_TANGENT && touch(before, &moved).is_some()
        });
        let around = before
            .filter(|_| joined.is_none() && turn < 0.0)
            .map(|before| Piece::Arc {
                a: before.end(),
                b: moved.start(),
                centre: piece.start(),
                turn: -1.0,
            });
        before = Some(moved);
        if let (Some(joined), false, Some(last)) = (joined, gap, out.last_mut()) {
            let meeting = touch(&joined, &moved).unwrap_or_else(|| last.end());
            *last = last.with_end(meeting);
            out.push(moved.with_start(meeting));
            continue;
        }
        for candidate in around.into_iter().chain([moved]) {
            append(&mut out, candidate, piece.start(), allowance, &mut gap);
        }
    }
    if gap || out.is_empty() {
        return Err(ProfileFault::Allowance);
    }
    out.retain(|piece| !piece.is_degenerate());
    Ok(out)
}

/// Appends a piece after those before it if it continues or intersects them; otherwise there is a gap.
fn append(out: &mut Vec<Piece>, piece: Piece, corner: Point, allowance: f64, gap: &mut bool) {
    let Some(last) = out.last().copied() else {
        out.push(piece);
        *gap = false;
        return;
    };
    if !*gap && distance(last.end(), piece.start()) < NEAR {
        out.push(piece.with_start(last.end()));
        return;
    }
    // The latest of the previous pieces that it intersects.
    let crossing = (0..out.len()).rev().take(64).find_map(|place| {
        let points = out[place].crossings(&piece).into_iter().flatten();
        points
            .filter(|point| out[place].holds(*point) && piece.holds(*point))
            .min_by(|a, b| distance(*a, corner).total_cmp(&distance(*b, corner)))
            .map(|point| (place, point))
    });
    if let Some((place, point)) = crossing {
        out.truncate(place + 1);
        if let Some(last) = out.last_mut() {
            *last = last.with_end(point);
        }
        out.push(piece.with_start(point));
        *gap = false;
    } else if !*gap && distance(last.end(), piece.start()) < ALL_BUT_TANGENT * allowance {
        // Pieces that are tangent up to the decimals of the program need not intersect.
        out.push(Piece::Line {
            a: last.end(),
            b: piece.start(),
        });
        out.push(piece);
    } else {
        *gap = true;
    }
}

/// Divides arcs at their lowest and highest points, so that every piece is monotonic.
pub(crate) fn split_at_extremes(pieces: &[Piece]) -> Vec<Piece> {
    let mut out = Vec::with_capacity(pieces.len() + 8);
    for piece in pieces {
        match piece.extreme() {
            Some(point) => {
                let (before, after) = piece.split(point);
                out.extend([before, after]);
            }
            None => out.push(*piece),
        }
    }
    out
}

/// The shape of the end of a piece of the profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Corner {
    /// A fillet of this radius.
    Fillet(f64),
    /// A chamfer that starts at this distance from the corner on both sides.
    Chamfer(f64),
}

/// Rounds or chamfers the corner between two lines.
pub(crate) fn corner(before: Piece, after: Piece, kind: Corner) -> Result<[Piece; 3], ProfileFault> {
    let (Piece::Line { a, b: at }, Piece::Line { b, .. }) = (before, after) else {
        return Err(ProfileFault::Corner);
    };
    let (back, ahead) = (unit(minus(a, at)), unit(minus(b, at)));
    let turn = cross(back, ahead);
    let cosine = (back[0] * ahead[0] + back[1] * ahead[1]).clamp(-1.0, 1.0);
    // Half of the angle between the two legs.
    let half = 0.5 * libm::acos(cosine);
    let length = match kind {
        Corner::Fillet(radius) => radius / libm::tan(half),
        Corner::Chamfer(length) => length,
    };
    let available = distance(a, at).min(distance(at, b));
    if !(length > 0.0 && length <= available + NEAR) || turn.abs() < 1e-9 {
        return Err(ProfileFault::Corner);
    }
    let (begin, end) = (plus(at, back, length), plus(at, ahead, length));
    let between = match kind {
        Corner::Chamfer(_) => Piece::Line { a: begin, b: end },
        Corner::Fillet(radius) => {
            // The path turns left where the two legs seen from the corner turn right.
            let turn = -turn.signum();
            Piece::Arc {
                a: begin,
                b: end,
                centre: plus(begin, left(unit(minus(at, a))), turn * radius),
                turn,
            }
        }
    };
    Ok([Piece::Line { a, b: begin }, between, Piece::Line { a: end, b }])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(a: Point, b: Point) -> Piece {
        Piece::Line { a, b }
    }

    fn near(a: Point, b: Point) -> bool {
        distance(a, b) < 1e-9
    }

    #[test]
    fn an_allowance_offsets_every_piece() {
        // Down a wall, along, up a slope: both corners concave; then over a ridge: a convex one.
        let profile = [
            line([0.0, 0.0], [5.0, 0.0]),
            line([5.0, 0.0], [8.0, 3.0]),
            line([8.0, 3.0], [12.0, 3.0]),
        ];
        let moved = aside(&profile, 1.0).unwrap();
        assert_eq!(moved.len(), 4);
        assert!(near(moved[0].start(), [0.0, 1.0]));
        // The intersection of w = 1 with the slope offset by 1: 5 + 1 - sqrt(2).
        assert!(near(moved[0].end(), [6.0 - 2.0_f64.sqrt(), 1.0]));
        let Piece::Arc { centre, turn, .. } = moved[2] else {
            panic!("{moved:?}")
        };
        assert!(near(centre, [8.0, 3.0]) && turn == -1.0);
        for pair in moved.windows(2) {
            assert!(near(pair[0].end(), pair[1].start()), "{moved:?}");
        }
    }

    #[test]
    fn pieces_below_the_allowance_are_removed() {
        // A groove of width 1 closes at an allowance of 1.
        let groove = [
            line([0.0, 5.0], [5.0, 5.0]),
            line([5.0, 5.0], [5.0, 0.0]),
            line([5.0, 0.0], [6.0, 0.0]),
            line([6.0, 0.0], [6.0, 5.0]),
            line([6.0, 5.0], [9.0, 5.0]),
        ];
        let moved = aside(&groove, 1.0).unwrap();
        let lowest = moved
            .iter()
            .map(|piece| piece.end()[1])
            .fold(f64::INFINITY, f64::min);
        // The arcs about the two edges of the groove meet above its middle.
        assert!((lowest - (5.0 + 0.75_f64.sqrt())).abs() < 1e-9, "{moved:?}");
        let dip = Piece::Arc {
            a: [0.0, 0.0],
            b: [2.0, 0.0],
            centre: [1.0, 0.0],
            turn: 1.0,
        };
        assert_eq!(aside(&[dip], 1.0), Err(ProfileFault::Allowance));
    }

    #[test]
    fn arcs_are_divided_at_their_extrema() {
        let bump = Piece::Arc {
            a: [0.0, 0.0],
            b: [2.0, 0.0],
            centre: [1.0, 0.0],
            turn: -1.0,
        };
        let parts = split_at_extremes(&[bump]);
        assert_eq!(parts.len(), 2);
        assert!(near(parts[0].end(), [1.0, 1.0]));
        assert_eq!(parts[0].at_height(0.5), Some([1.0 - 0.75_f64.sqrt(), 0.5]));
        assert_eq!(parts[0].at_height(1.5), None);
    }

    #[test]
    fn reversing_profiles_are_rejected() {
        assert_eq!(check_monotonic(&[]), Err(ProfileFault::Empty));
        assert_eq!(
            check_monotonic(&[line([0.0, 0.0], [-1.0, 1.0])]),
            Err(ProfileFault::NotMonotonic)
        );
        let hook = Piece::Arc {
            a: [0.0, 0.0],
            b: [1.0, 1.0],
            centre: [1.0, 0.0],
            turn: 1.0,
        };
        assert_eq!(check_monotonic(&[hook]), Err(ProfileFault::NotMonotonic));
        assert_eq!(check_monotonic(&[line([0.0, 0.0], [0.0, 1.0])]), Ok(()));
    }

    #[test]
    fn fillets_and_chamfers_are_symmetric() {
        let (before, after) = (line([0.0, 0.0], [5.0, 0.0]), line([5.0, 0.0], [5.0, 5.0]));
        let [first, arc, second] = corner(before, after, Corner::Fillet(2.0)).unwrap();
        let Piece::Arc { centre, turn, .. } = arc else {
            panic!("{arc:?}")
        };
        assert!(near(centre, [3.0, 2.0]) && turn == 1.0);
        assert!(near(first.end(), [3.0, 0.0]) && near(second.start(), [5.0, 2.0]));
        let [_, chamfer, _] = corner(before, after, Corner::Chamfer(1.0)).unwrap();
        assert!(near(chamfer.start(), [4.0, 0.0]) && near(chamfer.end(), [5.0, 1.0]));
        assert_eq!(
            corner(before, after, Corner::Fillet(6.0)),
            Err(ProfileFault::Corner)
        );
    }
}
