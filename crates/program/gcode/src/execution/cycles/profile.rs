//! The profile of a turned part: lines and arcs in a plane, offset by an allowance, and intersected with the
//! levels of passes.
//!
//! Coordinates `[u, w]`: passes run towards increasing `u`, depths towards decreasing `w`; the stock is above
//! the profile.

/// Points closer than this are equal, mm.
pub(crate) const EQUAL_MM: f64 = 1e-7;

/// Corners that turn by less than this, rad, are joined as they are if their sides do not intersect.
const NEARLY_TANGENT_RAD: f64 = 0.02;

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
    /// It has more than 100 000 pieces.
    TooLong,
    /// It reverses along the direction of the passes.
    NotMonotonic,
    /// The allowance leaves nothing of it.
    Allowance,
    /// A fillet or chamfer that does not fit.
    Corner,
}

pub(crate) fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

pub(crate) fn along(a: Point, direction: Point, distance: f64) -> Point {
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
    let (a, b) = (sub(a, centre), sub(b, centre));
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
        distance(self.start(), self.end()) < EQUAL_MM
    }

    /// Direction at the start or end.
    fn direction(&self, at_end: bool) -> Point {
        match *self {
            Self::Line { a, b } => unit(sub(b, a)),
            Self::Arc { a, b, centre, turn } => {
                let outwards = unit(sub(if at_end { b } else { a }, centre));
                let ahead = left(outwards);
                [turn * ahead[0], turn * ahead[1]]
            }
        }
    }

    /// Whether a point of its line or circle is on the piece.
    fn contains(&self, point: Point) -> bool {
        if distance(point, self.start()) < EQUAL_MM || distance(point, self.end()) < EQUAL_MM {
            return true;
        }
        match *self {
            Self::Line { a, b } => {
                let (to_point, chord) = (sub(point, a), sub(b, a));
                let projection = to_point[0] * chord[0] + to_point[1] * chord[1];
                projection >= 0.0 && projection <= chord[0] * chord[0] + chord[1] * chord[1]
            }
            Self::Arc { a, b, centre, turn } => sweep(centre, a, point, turn) <= sweep(centre, a, b, turn),
        }
    }

    /// Intersections of the lines or circles of both pieces.
    fn crossings(&self, other: &Self) -> [Option<Point>; 2] {
        let chord_ends = |middle: Point, direction: Point, square: f64| {
            // Rounding may turn a tangent into a miss.
            if square < -EQUAL_MM * EQUAL_MM {
                return [None; 2];
            }
            let half = square.max(0.0).sqrt();
            [
                Some(along(middle, direction, half)),
                Some(along(middle, direction, -half)),
            ]
        };
        let line_and_circle = |a: Point, b: Point, centre: Point, radius: f64| {
            let direction = unit(sub(b, a));
            let to_centre = sub(centre, a);
            let foot = along(
                a,
                direction,
                to_centre[0] * direction[0] + to_centre[1] * direction[1],
            );
            let separation = distance(foot, centre);
            chord_ends(foot, direction, (radius - separation) * (radius + separation))
        };
        match (*self, *other) {
            (Self::Line { a, b }, Self::Line { a: c, b: d }) => {
                let (direction, other_direction) = (sub(b, a), sub(d, c));
                let fraction = cross(sub(c, a), other_direction) / cross(direction, other_direction);
                [fraction.is_finite().then(|| along(a, direction, fraction)), None]
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
                let (radius, second_radius) = (distance(a, centre), distance(c, second));
                let separation = distance(centre, second);
                if separation < EQUAL_MM {
                    return [None; 2];
                }
                let direction = unit(sub(second, centre));
                let foot = (separation * separation + (radius - second_radius) * (radius + second_radius))
                    / (2.0 * separation);
                let middle = along(centre, direction, foot);
                chord_ends(middle, left(direction), (radius - foot) * (radius + foot))
            }
        }
    }

    /// The piece offset to its left; `None` for an arc that vanishes.
    fn offset(&self, allowance: f64) -> Option<Self> {
        match *self {
            Self::Line { a, b } => {
                let normal = left(self.direction(false));
                Some(Self::Line {
                    a: along(a, normal, allowance),
                    b: along(b, normal, allowance),
                })
            }
            Self::Arc { a, b, centre, turn } => {
                let radius = distance(a, centre);
                let offset_radius = radius - turn * allowance;
                let moved = |point: Point| along(centre, sub(point, centre), offset_radius / radius);
                (offset_radius > EQUAL_MM).then(|| Self::Arc {
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
        (inside && distance(point, a) > EQUAL_MM && distance(point, b) > EQUAL_MM).then_some(point)
    }

    /// The point of a monotonic piece at a height.
    pub(crate) fn at_height(&self, w: f64) -> Option<Point> {
        let (a, b) = (self.start(), self.end());
        if (w - a[1]).abs() < EQUAL_MM {
            return Some(a);
        }
        if (w - b[1]).abs() < EQUAL_MM {
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
        found
            .map(|point| [point[0], w])
            .find(|point| self.contains(*point))
    }
}

/// Checks that the passes never have to reverse.
pub(crate) fn check_monotonic(pieces: &[Piece]) -> Result<(), ProfileFault> {
    if pieces.is_empty() {
        return Err(ProfileFault::Empty);
    }
    let forward = |piece: &Piece| match *piece {
        Piece::Line { a, b } => b[0] >= a[0] - EQUAL_MM,
        Piece::Arc { a, b, centre, turn } => {
            let ahead = |at_end| piece.direction(at_end)[0] >= -1e-6;
            b[0] >= a[0] - EQUAL_MM
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
fn tangent_point(before: &Piece, after: &Piece) -> Option<Point> {
    let (a, b, centre) = match (*before, *after) {
        (Piece::Line { a, b }, Piece::Arc { centre, .. })
        | (Piece::Arc { centre, .. }, Piece::Line { a, b }) => (a, b, centre),
        _ => return None,
    };
    let direction = unit(sub(b, a));
    let to_centre = sub(centre, a);
    let foot = along(
        a,
        direction,
        to_centre[0] * direction[0] + to_centre[1] * direction[1],
    );
    (distance(foot, before.end()) < 10.0 * JOIN_MM).then_some(foot)
}

/// The profile offset by `allowance` to the left. Convex corners get an arc about the corner, concave ones
/// are trimmed at the intersection of both sides, and pieces that do not fit between their neighbours are
/// removed.
pub(crate) fn offset(pieces: &[Piece], allowance: f64) -> Result<Vec<Piece>, ProfileFault> {
    if allowance == 0.0 {
        return Ok(pieces.to_vec());
    }
    let mut out: Vec<Piece> = Vec::with_capacity(2 * pieces.len());
    let mut gap = false;
    let mut before: Option<Piece> = None;
    for (index, piece) in pieces.iter().enumerate() {
        let Some(moved) = piece.offset(allowance) else {
            gap = true;
            before = None;
            continue;
        };
        let turn = match index {
            0 => 1.0,
            _ => cross(pieces[index - 1].direction(true), piece.direction(false)),
        };
        let joined = before.filter(|before| {
            let is_near = distance(before.end(), moved.start()) < JOIN_MM;
            is_near || turn.abs() < NEARLY_TANGENT_RAD && tangent_point(before, &moved).is_some()
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
            let meeting = tangent_point(&joined, &moved).unwrap_or_else(|| last.end());
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
    if !*gap && distance(last.end(), piece.start()) < EQUAL_MM {
        out.push(piece.with_start(last.end()));
        return;
    }
    // The latest of the previous pieces that it intersects.
    let crossing = (0..out.len()).rev().take(64).find_map(|index| {
        let points = out[index].crossings(&piece).into_iter().flatten();
        points
            .filter(|point| out[index].contains(*point) && piece.contains(*point))
            .min_by(|a, b| distance(*a, corner).total_cmp(&distance(*b, corner)))
            .map(|point| (index, point))
    });
    if let Some((index, point)) = crossing {
        out.truncate(index + 1);
        if let Some(last) = out.last_mut() {
            *last = last.with_end(point);
        }
        out.push(piece.with_start(point));
        *gap = false;
    } else if !*gap && distance(last.end(), piece.start()) < NEARLY_TANGENT_RAD * allowance {
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
    let (back, ahead) = (unit(sub(a, at)), unit(sub(b, at)));
    let turn = cross(back, ahead);
    let cosine = (back[0] * ahead[0] + back[1] * ahead[1]).clamp(-1.0, 1.0);
    // Half of the angle between the two legs.
    let half = 0.5 * libm::acos(cosine);
    let length = match kind {
        Corner::Fillet(radius) => radius / libm::tan(half),
        Corner::Chamfer(length) => length,
    };
    let available = distance(a, at).min(distance(at, b));
    if !(length > 0.0 && length <= available + EQUAL_MM) || turn.abs() < 1e-9 {
        return Err(ProfileFault::Corner);
    }
    let (start, end) = (along(at, back, length), along(at, ahead, length));
    let corner_piece = match kind {
        Corner::Chamfer(_) => Piece::Line { a: start, b: end },
        Corner::Fillet(radius) => {
            // The path turns left where the two legs seen from the corner turn right.
            let turn = -turn.signum();
            Piece::Arc {
                a: start,
                b: end,
                centre: along(start, left(unit(sub(at, a))), turn * radius),
                turn,
            }
        }
    };
    Ok([
        Piece::Line { a, b: start },
        corner_piece,
        Piece::Line { a: end, b },
    ])
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
        let moved = offset(&profile, 1.0).unwrap();
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
        let moved = offset(&groove, 1.0).unwrap();
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
        assert_eq!(offset(&[dip], 1.0), Err(ProfileFault::Allowance));
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
