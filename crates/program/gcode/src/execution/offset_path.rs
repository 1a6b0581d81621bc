//! Geometry of cutter compensation in the plane: the path of the tool's centre beside a programmed line or arc, and
//! how two such paths meet at a corner of the programmed path.
//!
//! Every corner is decided once, when the move after it is known. What a corner takes from the beginning of a move is
//! no longer there for the corner at its end ([`Element::room`]): otherwise a move that is too short for both would be
//! run backwards, and an arc all the way round.

/// Corners that turn by less than this, in radians, are passed straight, as in LinuxCNC, unless that brings the tool
/// nearer to the contour by more than `1 - cos(0.05)` = 0.125 % of its radius.
pub(crate) const STRAIGHT: f64 = 0.05;

/// What a length on the path may be short by, in mm: roundings of coordinates in double precision, with margin.
pub(crate) const ROUNDING_MM: f64 = 1e-6;

/// Where a path leads back beside itself: how deep between the two ways the tool may cut, in mm. Programs round to
/// 0.01 mm, so two ways that are meant as one may lie that far apart.
const FOLD_MM: f64 = 0.005;

pub(crate) type Point = [f64; 2];

/// A path of the tool's centre without its ends.
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

/// The path of the tool's centre beside one programmed move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Element {
    pub(crate) shape: Shape,
    pub(crate) begin: Point,
    /// Direction at the beginning.
    pub(crate) begin_tangent: Point,
    pub(crate) end: Point,
    /// Direction at the end.
    pub(crate) end_tangent: Point,
    /// Length in the plane that corners have left of it, in mm.
    pub(crate) room: f64,
    /// Of the straight move that leads to the contour: where the tool stands before. It goes straight from there to
    /// wherever the first corner lets it, so its length is no bound.
    pub(crate) entry: Option<Point>,
}

/// How two elements meet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Corner {
    /// The second begins where the first ends; `after` of the second is lost, which is below 0 where it grows.
    Straight { after: f64 },
    /// An arc about the corner leads from the end of the first to the beginning of the second.
    Outer,
    /// Both are cut off at a point where they cross.
    Inner { point: Point, before: f64, after: f64 },
}

/// Why the tool cannot follow both elements. Lengths in mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Misfit {
    /// The paths of its centre do not cross.
    Apart,
    /// The corner takes more of the first than is left of it.
    Before { needed: f64, left: f64 },
    /// The corner takes more of the second than there is.
    After { needed: f64, left: f64 },
}

pub(crate) fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

pub(crate) fn add(a: Point, b: Point) -> Point {
    [a[0] + b[0], a[1] + b[1]]
}

/// The point at a distance from another one.
pub(crate) fn along(a: Point, direction: Point, distance: f64) -> Point {
    [a[0] + distance * direction[0], a[1] + distance * direction[1]]
}

pub(crate) fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// A quarter turn to the left.
pub(crate) fn left(a: Point) -> Point {
    [-a[1], a[0]]
}

pub(crate) fn length(a: Point) -> f64 {
    libm::hypot(a[0], a[1])
}

impl Shape {
    /// The points that two paths have in common, at most two.
    fn crossings(&self, other: &Self) -> impl Iterator<Item = Point> {
        let known = |point: Point| point.iter().all(|value| value.is_finite()).then_some(point);
        // Two points on either side of the middle of a chord.
        let pair = |middle: Point, direction: Point, square: f64| {
            if square >= 0.0 {
                let half = square.sqrt();
                [
                    known(along(middle, direction, half)),
                    known(along(middle, direction, -half)),
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
                    direction: way,
                },
            ) => {
                let distance = cross(sub(second, point), way) / cross(direction, way);
                [known(along(point, direction, distance)), None]
            }
            (Self::Line { point, direction }, Self::Circle { centre, radius, .. })
            | (Self::Circle { centre, radius, .. }, Self::Line { point, direction }) => {
                let foot = along(point, direction, dot(sub(centre, point), direction));
                let apart = length(sub(foot, centre));
                pair(foot, direction, (radius - apart) * (radius + apart))
            }
            (
                Self::Circle { centre, radius, .. },
                Self::Circle {
                    centre: second,
                    radius: other,
                    ..
                },
            ) => {
                let between = sub(second, centre);
                let apart = length(between);
                let unit = [between[0] / apart, between[1] / apart];
                let foot = (apart * apart + (radius - other) * (radius + other)) / (2.0 * apart);
                pair(
                    along(centre, unit, foot),
                    left(unit),
                    (radius - foot) * (radius + foot),
                )
            }
        };
        points.into_iter().flatten()
    }

    /// The length of path between two of its points, below 0 where `to` comes before `from`; of a circle the shorter
    /// way.
    fn between(&self, from: Point, to: Point) -> f64 {
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
                left(sub(point, centre)).map(|value| value * sign / radius)
            }
        }
    }

    /// Curvature of the programmed path beside which a tool of this radius runs, in 1/mm, above 0 where it bends to
    /// the tool's side.
    fn bend(&self, tool_radius: f64, side: f64) -> f64 {
        match *self {
            Self::Line { .. } => 0.0,
            Self::Circle { radius, sign, .. } => side * sign / (radius + side * sign * tool_radius),
        }
    }

    /// Whether a straight way between two points keeps to the tool's side of this path.
    fn is_clear(&self, from: Point, to: Point, side: f64) -> bool {
        match *self {
            Self::Line { point, direction } => {
                let aside = |place: Point| side * cross(direction, sub(place, point));
                aside(from).min(aside(to)) >= -ROUNDING_MM
            }
            Self::Circle { centre, radius, sign } => {
                let (a, b) = (sub(from, centre), sub(to, centre));
                if sign * side > 0.0 {
                    return length(a).max(length(b)) <= radius + ROUNDING_MM;
                }
                let way = sub(b, a);
                let foot = (-dot(a, way) / dot(way, way)).clamp(0.0, 1.0);
                length(along(a, way, foot)) >= radius - ROUNDING_MM
            }
        }
    }
}

impl Element {
    /// How this element and the next meet; `radius` is the tool's, `side` is +1 where it runs on the left.
    ///
    /// # Errors
    /// The tool cannot follow both without cutting into the contour.
    pub(crate) fn meet(&self, next: &Self, radius: f64, side: f64) -> Result<Corner, Misfit> {
        let turn = side
            * libm::atan2(
                cross(self.end_tangent, next.begin_tangent),
                dot(self.end_tangent, next.begin_tangent),
            );
        // Onto a hollow arc little wider than the tool even a small corner would lead the tool far beside its path.
        let gives = radius * (1.0 - libm::cos(STRAIGHT)) + ROUNDING_MM;
        let small = turn.abs() <= STRAIGHT;
        if small && next.aside(self.end) <= gives || radius < ROUNDING_MM {
            return next.straight_from(self.end);
        }
        if std::f64::consts::PI - turn.abs() <= STRAIGHT {
            return self.turn_back(next, turn, radius, side, gives);
        }
        if turn < 0.0 {
            return Ok(Corner::Outer);
        }
        // Of the two points where a line and a circle cross only one has the second path lead inwards.
        let inward =
            |point: &Point| side * cross(self.shape.tangent(*point), next.shape.tangent(*point)) >= 0.0;
        let crossings = self.shape.crossings(&next.shape).filter(inward);
        let nearest = crossings.map(|point| (self.lost(next, point), point));
        let Some(((before, after), point)) =
            nearest.min_by(|a, b| (a.0.0.abs() + a.0.1.abs()).total_cmp(&(b.0.0.abs() + b.0.1.abs())))
        else {
            // Arcs whose ends are rounded may miss each other by as much.
            return if small {
                next.straight_from(self.end)
            } else {
                Err(Misfit::Apart)
            };
        };
        if !self.enters(next, before, point, side) {
            self.fits_before(before)?;
        }
        next.fits_after(after)?;
        Ok(Corner::Inner { point, before, after })
    }

    /// Straight back. On a line the tool goes round the end. Where arcs bend so that the second path lies on the tool's
    /// side of the first, as between the legs of an `h`, the corner is an inner one.
    fn turn_back(
        &self,
        next: &Self,
        turn: f64,
        radius: f64,
        side: f64,
        gives: f64,
    ) -> Result<Corner, Misfit> {
        let crossings = self.shape.crossings(&next.shape);
        let cuts = crossings.map(|point| (self.lost(next, point), point));
        let fitting = cuts.filter(|((before, after), point)| {
            let first = self.fits_before(*before).is_ok() || self.enters(next, *before, *point, side);
            first && next.fits_after(*after).is_ok()
        });
        if let Some(((before, after), point)) = fitting.min_by(|a, b| a.0.0.total_cmp(&b.0.0)) {
            return Ok(Corner::Inner { point, before, after });
        }
        // How wide the second path is of the first: by its angle, and by how much both bend to the tool's side.
        let angle = turn.signum() * (std::f64::consts::PI - turn.abs());
        let bend = self.shape.bend(radius, side) + next.shape.bend(radius, side);
        let far = self.room.min(next.room);
        let far = if bend > 0.0 {
            far.min(angle.max(0.0) / bend)
        } else {
            far
        };
        let wide = angle.max(0.0) * far - 0.5 * bend * far * far;
        if wide > gives.max(FOLD_MM) || bend < -f64::EPSILON {
            return Err(Misfit::Apart);
        }
        Ok(Corner::Outer)
    }

    /// How far a point is beside the path where it begins. The radius of an arc is that of its beginning, since that of
    /// its end may differ by what programs round.
    fn aside(&self, place: Point) -> f64 {
        match self.shape {
            Shape::Line { point, direction } => cross(direction, sub(place, point)).abs(),
            Shape::Circle { centre, .. } => {
                (length(sub(place, centre)) - length(sub(self.begin, centre))).abs()
            }
        }
    }

    /// This element begun where the one before it ends.
    fn straight_from(&self, place: Point) -> Result<Corner, Misfit> {
        let after = self.shape.between(self.begin, place);
        self.fits_after(after.max(0.0))
            .map(|()| Corner::Straight { after })
    }

    /// How much of this element and of the next is lost where the tool changes over at a point.
    fn lost(&self, next: &Self, point: Point) -> (f64, f64) {
        (
            self.shape.between(point, self.end),
            next.shape.between(next.begin, point),
        )
    }

    /// Whether this is the move to the contour, and leads to a point of the next element without touching that one.
    fn enters(&self, next: &Self, before: f64, point: Point, side: f64) -> bool {
        let clear = |from: Point| before >= 0.0 && next.shape.is_clear(from, point, side);
        self.entry.is_some_and(clear)
    }

    fn fits_before(&self, needed: f64) -> Result<(), Misfit> {
        let left = self.room;
        if (-ROUNDING_MM..=left + ROUNDING_MM).contains(&needed) {
            return Ok(());
        }
        Err(if needed < 0.0 {
            Misfit::Apart
        } else {
            Misfit::Before { needed, left }
        })
    }

    fn fits_after(&self, needed: f64) -> Result<(), Misfit> {
        let left = self.room;
        if (-ROUNDING_MM..=left + ROUNDING_MM).contains(&needed) {
            return Ok(());
        }
        Err(if needed < 0.0 {
            Misfit::Apart
        } else {
            Misfit::After { needed, left }
        })
    }
}
