//! Geometry of cutter compensation in the plane: the path of the tool centre beside a programmed line or arc,
//! and the corners between two such paths.
//!
//! Every corner is decided once, when the move after it is known. The length that a corner takes from the
//! start of a move is not available to the corner at its end ([`Element::remaining`]): otherwise a move that
//! is too short for both would be reversed, and an arc would wrap around.

/// Corners that turn by less than this, in radians, are passed straight, as in LinuxCNC, unless the tool
/// would come closer to the contour by more than `1 - cos(0.05)` = 0.125 % of its radius.
pub(crate) const STRAIGHT_RAD: f64 = 0.05;

/// Tolerance for missing length on the path, mm: rounding of coordinates in double precision, with a margin.
pub(crate) const ROUNDING_MM: f64 = 1e-6;

/// Where a path returns beside itself: permitted depth of a cut between the two parts, mm. Programs are
/// rounded to 0.01 mm, so two parts that are meant to coincide may be that far apart.
const FOLD_MM: f64 = 0.005;

pub(crate) type Point = [f64; 2];

/// A path of the tool centre without its ends.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    Line {
        point: Point,
        direction: Point,
    },
    /// `sign` is +1 counter-clockwise.
    Circle {
        centre: Point,
        radius: f64,
        sign: f64,
    },
}

/// The path of the tool centre beside one programmed move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Element {
    pub(crate) shape: Shape,
    pub(crate) begin: Point,
    /// Direction at the start.
    pub(crate) begin_tangent: Point,
    pub(crate) end: Point,
    /// Direction at the end.
    pub(crate) end_tangent: Point,
    /// Length in the plane that remains after its corners, mm.
    pub(crate) remaining: f64,
    /// For the straight move to the contour: its start. It ends wherever the first corner permits, so its
    /// length is not a limit.
    pub(crate) entry: Option<Point>,
}

/// The corner between two elements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Corner {
    /// The second starts where the first ends; it loses `after`, which is negative if it grows.
    Straight { after: f64 },
    /// An arc about the corner joins the end of the first and the start of the second.
    Outer,
    /// Both are trimmed at an intersection.
    Inner { point: Point, before: f64, after: f64 },
}

/// The reason why the tool cannot follow both elements. Lengths in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Misfit {
    /// The paths of its centre do not intersect.
    NoIntersection,
    /// The corner takes more of the first element than remains.
    Before { needed: f64, available: f64 },
    /// The corner takes more of the second element than its length.
    After { needed: f64, available: f64 },
}

pub(crate) fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

pub(crate) fn add(a: Point, b: Point) -> Point {
    [a[0] + b[0], a[1] + b[1]]
}

/// The point at a distance from another point.
pub(crate) fn along(a: Point, direction: Point, distance: f64) -> Point {
    [a[0] + distance * direction[0], a[1] + distance * direction[1]]
}

pub(crate) fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// Rotated by +90 degrees.
pub(crate) fn perpendicular(a: Point) -> Point {
    [-a[1], a[0]]
}

pub(crate) fn length(a: Point) -> f64 {
    libm::hypot(a[0], a[1])
}

impl Shape {
    /// The common points of two paths, at most two.
    fn crossings(&self, other: &Self) -> impl Iterator<Item = Point> {
        let finite = |point: Point| point.iter().all(|value| value.is_finite()).then_some(point);
        // Two points on either side of the middle of a chord.
        let chord_ends = |middle: Point, direction: Point, square: f64| {
            if square >= 0.0 {
                let half = square.sqrt();
                [
                    finite(along(middle, direction, half)),
                    finite(along(middle, direction, -half)),
                ]
            } else {
                [None; 2]
            }
        };
        let points = match (*self, *other) {
            (
                Self::Line { point, direction },
                Self::Line {
                    point: second,
                    direction: second_direction,
                },
            ) => {
                let distance =
                    cross(sub(second, point), second_direction) / cross(direction, second_direction);
                [finite(along(point, direction, distance)), None]
            }
            (Self::Line { point, direction }, Self::Circle { centre, radius, .. })
            | (Self::Circle { centre, radius, .. }, Self::Line { point, direction }) => {
                let foot = along(point, direction, dot(sub(centre, point), direction));
                let distance = length(sub(foot, centre));
                chord_ends(foot, direction, (radius - distance) * (radius + distance))
            }
            (
                Self::Circle { centre, radius, .. },
                Self::Circle {
                    centre: second,
                    radius: second_radius,
                    ..
                },
            ) => {
                let between_centres = sub(second, centre);
                let distance = length(between_centres);
                let unit = [between_centres[0] / distance, between_centres[1] / distance];
                let foot = (distance * distance + (radius - second_radius) * (radius + second_radius))
                    / (2.0 * distance);
                chord_ends(
                    along(centre, unit, foot),
                    perpendicular(unit),
                    (radius - foot) * (radius + foot),
                )
            }
        };
        points.into_iter().flatten()
    }

    /// The path length between two of its points, negative if `to` comes before `from`; on a circle
    /// along the shorter arc.
    fn path_length(&self, from: Point, to: Point) -> f64 {
        match *self {
            Self::Line { direction, .. } => dot(sub(to, from), direction),
            Self::Circle { centre, radius, sign } => {
                let (a, b) = (sub(from, centre), sub(to, centre));
                sign * radius * libm::atan2(cross(a, b), dot(a, b))
            }
        }
    }

    /// Direction of motion at one of its points.
    fn tangent(&self, point: Point) -> Point {
        match *self {
            Self::Line { direction, .. } => direction,
            Self::Circle { centre, radius, sign } => {
                perpendicular(sub(point, centre)).map(|value| value * sign / radius)
            }
        }
    }

    /// Curvature of the programmed path beside which a tool of this radius moves, in 1/mm, positive if it
    /// curves towards the tool.
    fn curvature(&self, tool_radius: f64, side: f64) -> f64 {
        match *self {
            Self::Line { .. } => 0.0,
            Self::Circle { radius, sign, .. } => side * sign / (radius + side * sign * tool_radius),
        }
    }

    /// Whether the straight line between two points stays on the tool's side of this path.
    fn is_clear(&self, from: Point, to: Point, side: f64) -> bool {
        match *self {
            Self::Line { point, direction } => {
                let signed_distance = |end: Point| side * cross(direction, sub(end, point));
                signed_distance(from).min(signed_distance(to)) >= -ROUNDING_MM
            }
            Self::Circle { centre, radius, sign } => {
                let (a, b) = (sub(from, centre), sub(to, centre));
                if sign * side > 0.0 {
                    return length(a).max(length(b)) <= radius + ROUNDING_MM;
                }
                let chord = sub(b, a);
                let foot = (-dot(a, chord) / dot(chord, chord)).clamp(0.0, 1.0);
                length(along(a, chord, foot)) >= radius - ROUNDING_MM
            }
        }
    }
}

impl Element {
    /// The corner between this element and the next; `radius` is the tool's, `side` is +1 if it moves on the
    /// left.
    ///
    /// # Errors
    /// [`Misfit`] if the tool cannot follow both without cutting into the contour.
    pub(crate) fn corner_with(&self, next: &Self, radius: f64, side: f64) -> Result<Corner, Misfit> {
        let turn = side
            * libm::atan2(
                cross(self.end_tangent, next.begin_tangent),
                dot(self.end_tangent, next.begin_tangent),
            );
        // On a concave arc only slightly wider than the tool even a small corner would lead the tool far from
        // its path.
        let tolerance = radius * (1.0 - libm::cos(STRAIGHT_RAD)) + ROUNDING_MM;
        let is_small = turn.abs() <= STRAIGHT_RAD;
        if is_small && next.start_distance(self.end) <= tolerance || radius < ROUNDING_MM {
            return next.continue_from(self.end);
        }
        if std::f64::consts::PI - turn.abs() <= STRAIGHT_RAD {
            return self.reversal(next, turn, radius, side, tolerance);
        }
        if turn < 0.0 {
            return Ok(Corner::Outer);
        }
        // Of the two intersections of a line and a circle the second path leads inwards at only one.
        let inward =
            |point: &Point| side * cross(self.shape.tangent(*point), next.shape.tangent(*point)) >= 0.0;
        let crossings = self.shape.crossings(&next.shape).filter(inward);
        let nearest = crossings.map(|point| (self.trimmed_lengths(next, point), point));
        let Some(((before, after), point)) =
            nearest.min_by(|a, b| (a.0.0.abs() + a.0.1.abs()).total_cmp(&(b.0.0.abs() + b.0.1.abs())))
        else {
            // Arcs with rounded ends may miss each other by that much.
            return if is_small {
                next.continue_from(self.end)
            } else {
                Err(Misfit::NoIntersection)
            };
        };
        if !self.enters(next, before, point, side) {
            self.fits_before(before)?;
        }
        next.fits_after(after)?;
        Ok(Corner::Inner { point, before, after })
    }

    /// A reversal. On a line the tool goes around the end. If arcs curve so that the second path is on the
    /// tool's side of the first, as between the legs of an `h`, the corner is an inner one.
    fn reversal(
        &self,
        next: &Self,
        turn: f64,
        radius: f64,
        side: f64,
        tolerance: f64,
    ) -> Result<Corner, Misfit> {
        let crossings = self.shape.crossings(&next.shape);
        let candidates = crossings.map(|point| (self.trimmed_lengths(next, point), point));
        let fitting = candidates.filter(|((before, after), point)| {
            let fits_first = self.fits_before(*before).is_ok() || self.enters(next, *before, *point, side);
            fits_first && next.fits_after(*after).is_ok()
        });
        if let Some(((before, after), point)) = fitting.min_by(|a, b| a.0.0.total_cmp(&b.0.0)) {
            return Ok(Corner::Inner { point, before, after });
        }
        // Opening between the two paths: from their angle, and from the curvature of both towards the tool.
        let angle = turn.signum() * (std::f64::consts::PI - turn.abs());
        let curvature = self.shape.curvature(radius, side) + next.shape.curvature(radius, side);
        let available = self.remaining.min(next.remaining);
        let available = if curvature > 0.0 {
            available.min(angle.max(0.0) / curvature)
        } else {
            available
        };
        let opening = angle.max(0.0) * available - 0.5 * curvature * available * available;
        if opening > tolerance.max(FOLD_MM) || curvature < -f64::EPSILON {
            return Err(Misfit::NoIntersection);
        }
        Ok(Corner::Outer)
    }

    /// Distance of a point from the path at its start. The radius of an arc is that at its start, since the
    /// radius at its end may differ by rounding in the program.
    fn start_distance(&self, target: Point) -> f64 {
        match self.shape {
            Shape::Line { point, direction } => cross(direction, sub(target, point)).abs(),
            Shape::Circle { centre, .. } => {
                (length(sub(target, centre)) - length(sub(self.begin, centre))).abs()
            }
        }
    }

    /// The corner if this element starts at the end of the previous one.
    fn continue_from(&self, target: Point) -> Result<Corner, Misfit> {
        let after = self.shape.path_length(self.begin, target);
        self.fits_after(after.max(0.0))
            .map(|()| Corner::Straight { after })
    }

    /// Lengths by which this element and the next are trimmed if they meet at a point.
    fn trimmed_lengths(&self, next: &Self, point: Point) -> (f64, f64) {
        (
            self.shape.path_length(point, self.end),
            next.shape.path_length(next.begin, point),
        )
    }

    /// Whether this is the move to the contour and reaches a point of the next element without touching that
    /// element.
    fn enters(&self, next: &Self, before: f64, point: Point, side: f64) -> bool {
        let is_clear = |from: Point| before >= 0.0 && next.shape.is_clear(from, point, side);
        self.entry.is_some_and(is_clear)
    }

    fn fits_before(&self, needed: f64) -> Result<(), Misfit> {
        let available = self.remaining;
        if (-ROUNDING_MM..=available + ROUNDING_MM).contains(&needed) {
            return Ok(());
        }
        Err(if needed < 0.0 {
            Misfit::NoIntersection
        } else {
            Misfit::Before { needed, available }
        })
    }

    fn fits_after(&self, needed: f64) -> Result<(), Misfit> {
        let available = self.remaining;
        if (-ROUNDING_MM..=available + ROUNDING_MM).contains(&needed) {
            return Ok(());
        }
        Err(if needed < 0.0 {
            Misfit::NoIntersection
        } else {
            Misfit::After { needed, available }
        })
    }
}
