//! Cutter compensation: G40 to G42.1, in G17 and G18.
//!
//! The tool's centre runs beside the programmed path, one radius to the left (G41) or to the right. How a move
//! ends is known only when the next one is: at an outer corner both ends are joined by an arc about the corner, at
//! an inner corner both are cut off where the offset paths cross. So the last move waits among the commands, and
//! whatever follows it waits too, until the next move in the plane has come.

use evolvent_path::{Arc, Axes, Curve, Line, Plane, Sense};

use crate::codes::{Compensation, Group};
use crate::diagnostic::Fault;
use crate::execute::Executor;
use crate::{Action, Code, Command, Move, MoveKind};

/// Corners that turn by less than this, in radians, are none: as in LinuxCNC.
const STRAIGHT: f64 = 0.05;

type Point = [f64; 2];

/// The path of the tool's centre that a move belongs to, in the plane.
#[derive(Clone, Copy, Debug)]
enum Shape {
    Line { point: Point, direction: Point },
    Circle { centre: Point, radius: f64, sign: f64 },
}

/// The last move of the tool's centre, which may still be cut off.
#[derive(Clone, Copy, Debug)]
struct Element {
    shape: Shape,
    /// Direction at its end.
    tangent: Point,
    /// How far it can be cut off: length of a line in mm, angle of an arc.
    room: f64,
}

/// A command of an earlier line as it was before this line cut it off.
#[derive(Clone, Debug)]
pub(crate) struct Changed {
    pub(crate) index: usize,
    pub(crate) command: Command,
    /// It is no longer among the commands.
    pub(crate) removed: bool,
}

/// What compensation keeps between lines.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CutterState {
    pub(crate) code: Compensation,
    /// Where the program is, while the tool's centre is elsewhere.
    pub(crate) programmed: Option<Axes>,
    radius: f64,
    /// +1 to the left.
    side: f64,
    last: Option<Element>,
    /// Where among the commands the last move waits.
    pub(crate) held: Option<usize>,
}

impl Default for CutterState {
    fn default() -> Self {
        Self {
            code: Compensation::Off,
            programmed: None,
            radius: 0.0,
            side: 1.0,
            last: None,
            held: None,
        }
    }
}

impl CutterState {
    pub(crate) fn is_on(&self) -> bool {
        self.code != Compensation::Off
    }
}

fn sub(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

fn along(a: Point, direction: Point, distance: f64) -> Point {
    [a[0] + distance * direction[0], a[1] + distance * direction[1]]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn cross(a: Point, b: Point) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// A quarter turn to the left.
fn left(a: Point) -> Point {
    [-a[1], a[0]]
}

fn length(a: Point) -> f64 {
    libm::hypot(a[0], a[1])
}

impl Shape {
    /// Where two paths cross, once or twice.
    fn crossings(&self, other: &Self) -> [Option<Point>; 2] {
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
        match (*self, *other) {
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
        }
    }

    /// The crossing nearest to a point.
    fn crossing(&self, other: &Self, near: Point) -> Option<Point> {
        let distance = |point: &Point| length(sub(*point, near));
        let points = self.crossings(other).into_iter().flatten();
        points.min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    /// How much of the path is lost between two of its points, `to` farther on.
    fn lost(&self, from: Point, to: Point) -> f64 {
        match *self {
            Self::Line { direction, .. } => dot(sub(to, from), direction),
            Self::Circle { centre, sign, .. } => {
                let (a, b) = (sub(from, centre), sub(to, centre));
                sign * libm::atan2(cross(a, b), dot(a, b))
            }
        }
    }
}

/// Length in XYZ.
fn curve_length(from: &Axes, to: &Axes) -> f64 {
    let step = to - from;
    libm::sqrt(step[0] * step[0] + step[1] * step[1] + step[2] * step[2])
}

/// A move of the programmed path, ready to be offset.
struct Wanted {
    element: Element,
    /// Direction at its beginning.
    begin_tangent: Point,
    /// Beginning and end of the offset path.
    begin: Point,
    end: Point,
}

impl Executor<'_> {
    /// G40, G41, G42, G41.1, G42.1.
    pub(crate) fn compensation(&mut self, code: Compensation) -> Result<(), Fault> {
        let line = self.line;
        let Compensation::On { left, given } = code else {
            self.leave_compensation();
            return Ok(());
        };
        let span = line.group_span(Group::CutterCompensation);
        if self.state.cutter.is_on() {
            let message = "cutter compensation is on already";
            return Err(Fault::new(Code::CompensationActive, span, message).help("write G40 first"));
        }
        if !matches!(self.state.plane(), Some(Plane::Xy | Plane::Zx)) {
            let message = "cutter compensation is available in G17 and G18 only";
            return Err(Fault::new(Code::WrongPlane, span, message));
        }
        let diameter = if given {
            let Some(diameter) = line.word(b'D') else {
                let message = "G41.1 and G42.1 need D, the diameter of the tool";
                return Err(Fault::new(Code::WordMissing, span, message));
            };
            diameter * self.state.unit_mm()
        } else {
            let number = self.tool_number(b'D')?;
            self.tool(number, b'D', Group::CutterCompensation)?.diameter_mm
        };
        // A tool of negative diameter runs on the other side.
        let side = if left { 1.0 } else { -1.0 };
        self.state.cutter = CutterState {
            code,
            programmed: None,
            radius: 0.5 * diameter.abs(),
            side: if diameter < 0.0 { -side } else { side },
            last: None,
            held: None,
        };
        Ok(())
    }

    /// G40: the last move stays as it is, the next one leads to where the program is.
    pub(crate) fn leave_compensation(&mut self) {
        let programmed = self.state.cutter.programmed;
        self.state.cutter = CutterState {
            programmed,
            ..CutterState::default()
        };
    }

    fn cutter_axes(&self) -> Result<(Plane, usize, usize), Fault> {
        let plane = self
            .state
            .plane()
            .ok_or_else(|| self.wrong_plane("cutter compensation"))?;
        let (first, second, _) = plane.axes();
        Ok((plane, first, second))
    }

    /// G0 and G1.
    pub(crate) fn compensated_line(&mut self, target: Axes, kind: MoveKind) -> Result<(), Fault> {
        let (_, first, second) = self.cutter_axes()?;
        let from = self.state.programmed();
        let (start, end) = ([from[first], from[second]], [target[first], target[second]]);
        let path = sub(end, start);
        let size = length(path);
        let cutter = self.state.cutter;
        if size <= 1e-9 {
            // Nothing in the plane: up or down beside the path.
            let mut beside = target;
            (beside[first], beside[second]) = (self.state.position[first], self.state.position[second]);
            self.put_line(beside, kind)?;
            self.state.cutter.programmed = cutter.programmed.map(|_| target);
            return Ok(());
        }
        let direction = [path[0] / size, path[1] / size];
        let aside = cutter.side * cutter.radius;
        let wanted = Wanted {
            element: Element {
                shape: Shape::Line {
                    point: along(start, left(direction), aside),
                    direction,
                },
                tangent: direction,
                room: size,
            },
            begin_tangent: direction,
            begin: along(start, left(direction), aside),
            end: along(end, left(direction), aside),
        };
        if cutter.last.is_none() {
            if size <= cutter.radius {
                let message = format!(
                    "the first move with cutter compensation is {:.4} long, not longer than the radius of {:.4}",
                    size / self.state.unit_mm(),
                    cutter.radius / self.state.unit_mm()
                );
                return Err(
                    Fault::new(Code::CompensationEntry, self.line.motion_span(), message)
                        .help("begin farther away from the contour"),
                );
            }
        } else {
            self.join(&wanted, start, self.speed(curve_length(&from, &target), false))?;
        }
        let mut place = target;
        (place[first], place[second]) = (wanted.end[0], wanted.end[1]);
        self.hold(wanted.element);
        if place == self.state.position {
            self.state.cutter.held = None;
        } else {
            // In inverse time the programmed path counts.
            let lifted = curve_length(&from, &target);
            let feed = match kind {
                MoveKind::Rapid => f64::INFINITY,
                MoveKind::Feed => self.speed(lifted, false),
            };
            let moved = self.line_to(place)?;
            let path_mode = self.state.modes.path_mode;
            self.put_curve(moved, kind, feed, path_mode)?;
        }
        self.state.cutter.programmed = Some(target);
        Ok(())
    }

    /// G2 and G3; `curve` is the programmed arc.
    pub(crate) fn compensated_arc(&mut self, curve: Curve) -> Result<(), Fault> {
        let (plane, first, second) = self.cutter_axes()?;
        let Curve::Arc(arc) = curve else { return Ok(()) };
        if arc.plane() != plane {
            return Err(self.wrong_plane("cutter compensation"));
        }
        let cutter = self.state.cutter;
        let target = curve.end();
        let from = curve.start();
        let (start, end) = ([from[first], from[second]], [target[first], target[second]]);
        let centre = arc.centre_mm();
        let sense = curve.sense();
        let sign = sense.sign();
        let inside = sign * cutter.side > 0.0;
        let unit = self.state.unit_mm();
        let offset = |point: Point| -> Option<(Point, Point, f64)> {
            let ray = sub(point, centre);
            let size = length(ray);
            let outward = [ray[0] / size, ray[1] / size];
            let radius = if inside {
                size - cutter.radius
            } else {
                size + cutter.radius
            };
            let tangent = left(outward).map(|value| sign * value);
            (radius > 1e-9).then(|| (along(centre, outward, radius), tangent, radius))
        };
        let (Some((begin, begin_tangent, _)), Some((stop, tangent, radius))) = (offset(start), offset(end))
        else {
            let message = format!(
                "the tool of radius {:.4} does not fit into the arc of radius {:.4}",
                cutter.radius / unit,
                arc.radius_mm() / unit
            );
            return Err(
                Fault::new(Code::CompensationGouge, self.line.motion_span(), message)
                    .help("take a smaller tool or a larger radius"),
            );
        };
        let wanted = Wanted {
            element: Element {
                shape: Shape::Circle { centre, radius, sign },
                tangent,
                room: arc.sweep_rad().abs(),
            },
            begin_tangent,
            begin,
            end: stop,
        };
        let mut about = centre;
        if cutter.last.is_none() {
            // The first move: an arc from where the tool stands that ends as the offset one does.
            let here = [self.state.position[first], self.state.position[second]];
            let ray = sub(centre, stop);
            let size = length(ray);
            let inward = [ray[0] / size, ray[1] / size];
            let chord = sub(here, stop);
            let distance = dot(chord, chord) / (2.0 * dot(chord, inward));
            if !(distance.is_finite() && length(chord) > cutter.radius) {
                let message = "the first move with cutter compensation is too short for the tool";
                return Err(
                    Fault::new(Code::CompensationEntry, self.line.motion_span(), message)
                        .help("begin farther away from the contour, or with a straight move"),
                );
            }
            about = along(stop, inward, distance);
        } else {
            self.join(&wanted, start, self.speed(curve.length(), false))?;
        }
        let mut place = target;
        (place[first], place[second]) = (stop[0], stop[1]);
        let turns = (arc.sweep_rad().abs() / std::f64::consts::TAU - 1e-9)
            .floor()
            .max(0.0) as u32;
        let moved = Arc::new(plane, self.state.position, place, about, sense, turns)
            .map(Curve::Arc)
            .map_err(|error| Fault::new(Code::ArcRefused, self.line.motion_span(), error.to_string()))?;
        let feed = self.speed(curve.length(), false);
        let path_mode = self.state.modes.path_mode;
        self.hold(wanted.element);
        self.put_curve(moved, MoveKind::Feed, feed, path_mode)?;
        self.state.cutter.programmed = Some(target);
        Ok(())
    }

    /// The next command waits for the move after it.
    fn hold(&mut self, element: Element) {
        self.state.cutter.last = Some(element);
        self.state.cutter.held = Some(self.out.len());
    }

    /// Joins the move that waits and the next one at a corner of the programmed path.
    fn join(&mut self, next: &Wanted, corner: Point, feed: f64) -> Result<(), Fault> {
        let Some(last) = self.state.cutter.last else {
            return Ok(());
        };
        let cutter = self.state.cutter;
        let turn = cutter.side
            * libm::atan2(
                cross(last.tangent, next.begin_tangent),
                dot(last.tangent, next.begin_tangent),
            );
        if turn.abs() <= STRAIGHT || cutter.radius < 1e-6 {
            return Ok(());
        }
        let (plane, first, second) = self.cutter_axes()?;
        let end = [self.state.position[first], self.state.position[second]];
        // How much of either move is lost if the tool turns where the paths of its centre cross.
        let lost = |point: Point| {
            (
                last.shape.lost(point, end),
                next.element.shape.lost(next.begin, point),
            )
        };
        if turn.abs() >= std::f64::consts::PI - STRAIGHT {
            // Straight back: an inner corner only where an arc bends so that the paths cross in what is run.
            let both = last.shape.crossings(&next.element.shape).into_iter().flatten();
            let inside = both
                .map(|point| (lost(point), point))
                .filter(|((before, after), _)| {
                    (0.0..=last.room).contains(before) && (0.0..=next.element.room).contains(after)
                });
            if let Some((_, point)) = inside.min_by(|a, b| a.0.0.total_cmp(&b.0.0)) {
                return self.cut_off(plane, point);
            }
        } else if turn > 0.0 {
            let gouge = |message: &str| {
                let fault = Fault::new(
                    Code::CompensationGouge,
                    self.line.motion_span(),
                    message.to_owned(),
                );
                Err(fault
                    .help("the tool does not fit into the inner corner: take a smaller tool or longer moves"))
            };
            let Some(point) = last.shape.crossing(&next.element.shape, corner) else {
                return gouge("at this inner corner the tool cannot follow both moves");
            };
            let (before, after) = lost(point);
            if before > last.room {
                return gouge("the move before this inner corner is too short for the tool");
            }
            if after > next.element.room {
                return gouge("the move after this inner corner is too short for the tool");
            }
            return self.cut_off(plane, point);
        }
        let mut place = self.state.position;
        (place[first], place[second]) = (next.begin[0], next.begin[1]);
        self.check_feed("the arc about an outer corner")?;
        let sense = if cutter.side > 0.0 {
            Sense::Clockwise
        } else {
            Sense::CounterClockwise
        };
        let arc = Arc::new(plane, self.state.position, place, corner, sense, 0)
            .map(Curve::Arc)
            .map_err(|error| Fault::new(Code::ArcRefused, self.line.motion_span(), error.to_string()))?;
        let path_mode = self.state.modes.path_mode;
        self.put_curve(arc, MoveKind::Feed, feed, path_mode)
    }

    /// Makes the waiting move end at a point of the plane, and what follows it begin there.
    fn cut_off(&mut self, plane: Plane, point: Point) -> Result<(), Fault> {
        let (first, second, _) = plane.axes();
        let Some(held) = self.state.cutter.held else {
            // The last move had no length: there is nothing to cut off, and the next begins where it does.
            return Ok(());
        };
        let place = |mut axes: Axes| {
            (axes[first], axes[second]) = (point[0], point[1]);
            axes
        };
        let mut changed = Vec::new();
        for (index, command) in self.out.iter().enumerate().skip(held) {
            let Action::Move(step) = &command.action else {
                continue;
            };
            let (start, end) = (step.curve.start(), place(step.curve.end()));
            let start = if index == held { start } else { place(start) };
            let curve = match step.curve {
                Curve::Arc(arc) => {
                    let turns = (arc.sweep_rad().abs() / std::f64::consts::TAU - 1e-9)
                        .floor()
                        .max(0.0) as u32;
                    let sense = step.curve.sense();
                    Arc::new(plane, start, end, arc.centre_mm(), sense, turns).map(Curve::Arc)
                }
                _ => Line::new(start, end).map(Curve::Line),
            };
            changed.push((index, curve.ok().map(|curve| Move { curve, ..*step })));
        }
        for (index, step) in changed.into_iter().rev() {
            let before = match step {
                Some(step) => self.out.get_mut(index).map(|command| {
                    let before = command.clone();
                    command.action = Action::Move(step);
                    (before, false)
                }),
                // Nothing is left of it.
                None => self.out.remove(index).map(|before| (before, true)),
            };
            if let Some((command, removed)) = before {
                self.changed.push(Changed {
                    index,
                    command,
                    removed,
                });
            }
        }
        self.state.position = place(self.state.position);
        Ok(())
    }
}
