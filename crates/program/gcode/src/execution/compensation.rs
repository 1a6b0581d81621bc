//! Cutter compensation: G40 to G42.1, in G17 and G18.
//!
//! The tool centre moves beside the programmed path, one radius to the left (G41) or right. The end of a move
//! is known only with the next one: at an outer corner an arc about the corner joins both ends, at an inner
//! corner both moves are trimmed at the intersection of the offset paths. So the last move is held in the
//! command queue, together with everything after it, until the next move in the plane arrives.

use evolvent_path::{Arc, Axes, Curve, Line, MIN_RADIUS_MM, Plane, Sense};

use crate::codes::modal_groups::{Compensation, Group};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::execution::offset_path::{Corner, Element, Misfit, Point, ROUNDING_MM, Shape};
use crate::execution::offset_path::{add, along, dot, length, perpendicular, sub};
use crate::tables::tools::MAX_ORIENTATION;
use crate::{Action, CanonicalCommand, Code, Move, MoveKind};

/// A command of an earlier line, as it was before the present line trimmed it.
#[derive(Clone, Debug)]
pub(crate) struct ChangedCommand {
    pub(crate) index: usize,
    pub(crate) command: CanonicalCommand,
    /// It has been removed from the commands.
    pub(crate) removed: bool,
}

/// State of compensation between lines.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CutterState {
    pub(crate) code: Compensation,
    /// The programmed position, while the tool centre is elsewhere.
    pub(crate) programmed: Option<Axes>,
    /// After G40 other axes have moved alone, and the next move in the plane still leads to the programmed
    /// position.
    pub(crate) return_pending: bool,
    radius: f64,
    /// +1 for the left side.
    side: f64,
    /// From the centre of the tool nose to the controlled point, in the plane; not zero for turning tools.
    nose: Point,
    /// The last move in the plane, which may still be trimmed.
    last: Option<Element>,
    /// Index of the last move among the held commands.
    pub(crate) held: Option<usize>,
}

impl Default for CutterState {
    fn default() -> Self {
        Self {
            code: Compensation::Off,
            programmed: None,
            return_pending: false,
            radius: 0.0,
            side: 1.0,
            nose: [0.0; 2],
            last: None,
            held: None,
        }
    }
}

impl CutterState {
    pub(crate) fn is_on(&self) -> bool {
        self.code != Compensation::Off
    }

    /// Radius, side and nose.
    pub(crate) fn tool(&self) -> (f64, f64, Point) {
        (self.radius, self.side, self.nose)
    }
}

/// The vector from the centre of a nose to the controlled point of a turning tool, in Z and X: the
/// intersection of the lines along Z and X that touch the nose, or the end of the nose itself.
///
/// Orientations are those of LinuxCNC's tool table, 1 to 9; 0 is a mill and, like 9, has its point at the
/// centre.
fn nose(orientation: u32, radius: f64) -> Point {
    let z = match orientation {
        2 | 3 | 7 => -radius,
        1 | 4 | 5 => radius,
        _ => 0.0,
    };
    let x = match orientation {
        1 | 2 | 6 => -radius,
        3 | 4 | 8 => radius,
        _ => 0.0,
    };
    [z, x]
}

/// Length in XYZ.
fn curve_length(from: &Axes, to: &Axes) -> f64 {
    let delta = to - from;
    libm::sqrt(delta[0] * delta[0] + delta[1] * delta[1] + delta[2] * delta[2])
}

/// An arc with approximately this swept angle; `None` if nothing remains of it.
///
/// The angle distinguishes a full turn from none, which start and end alone do not.
fn arc(
    plane: Plane,
    (start, end): (Axes, Axes),
    centre: Point,
    sense: Sense,
    sweep_rad: f64,
) -> Result<Option<Curve>, evolvent_path::CurveError> {
    let arc = Arc::new(plane, start, end, centre, sense, 0)?;
    let turns = ((sweep_rad - arc.sweep_rad().abs()) / std::f64::consts::TAU).round();
    Ok(if turns < 0.0 {
        None
    } else if turns == 0.0 {
        Some(Curve::Arc(arc))
    } else {
        Some(Curve::Arc(Arc::new(
            plane,
            start,
            end,
            centre,
            sense,
            turns as u32,
        )?))
    })
}

impl Executor<'_> {
    /// G40, G41, G42, G41.1, G42.1.
    pub(crate) fn compensation(&mut self, code: Compensation) -> Result<(), Fault> {
        let line = self.line;
        let Compensation::On { left, dynamic } = code else {
            self.end_compensation();
            return Ok(());
        };
        let span = line.group_span(Group::CutterCompensation);
        if self.state.cutter.is_on() {
            let message = "cutter compensation is already on";
            return Err(Fault::new(Code::CompensationActive, span, message).help("write G40 first"));
        }
        if !matches!(self.state.plane(), Some(Plane::Xy | Plane::Zx)) {
            let message = "cutter compensation is available in G17 and G18 only";
            return Err(Fault::new(Code::WrongPlane, span, message));
        }
        let (diameter, orientation) = if dynamic {
            self.dynamic_cutter()?
        } else {
            self.table_cutter()?
        };
        // A tool of negative diameter moves on the other side.
        let side = if left { 1.0 } else { -1.0 };
        let radius = 0.5 * diameter.abs();
        self.state.cutter = CutterState {
            code,
            programmed: None,
            return_pending: false,
            radius,
            side: if diameter < 0.0 { -side } else { side },
            nose: nose(orientation, radius),
            last: None,
            held: None,
        };
        if let Some(plane) = self.state.plane() {
            self.contour_checker
                .begin(&self.state.cutter, plane, self.state.unit_mm());
        }
        Ok(())
    }

    /// Diameter in mm and orientation from D and L of G41.1 and G42.1.
    fn dynamic_cutter(&self) -> Result<(f64, u32), Fault> {
        let line = self.line;
        let Some(diameter) = line.word(b'D') else {
            let span = line.group_span(Group::CutterCompensation);
            let message = "G41.1 and G42.1 need D, the diameter of the tool";
            return Err(Fault::new(Code::WordMissing, span, message));
        };
        let orientation = line.integer(b'L')?;
        if let Some(orientation) = orientation {
            let span = line.span(b'L');
            if orientation > MAX_ORIENTATION {
                let message = format!("L{orientation}: the orientation of a turning tool is 0 to 9");
                return Err(Fault::new(Code::OutOfRange, span, message).help(
                    "the orientations are those of Q in the tool table; 0 and 9 are the centre of the nose",
                ));
            }
            if self.state.plane() != Some(Plane::Zx) {
                let message = "L, the orientation of a turning tool, with cutter compensation outside of G18";
                return Err(
                    Fault::new(Code::WrongPlane, span, message).help("write G18, or remove L for a mill")
                );
            }
        }
        Ok((diameter * self.state.unit_mm(), orientation.unwrap_or(0)))
    }

    /// Diameter in mm and orientation of the tool named by D, or of the tool in the spindle.
    fn table_cutter(&mut self) -> Result<(f64, u32), Fault> {
        let number = self.tool_number(b'D')?;
        let tool = self.tool(number, b'D', Group::CutterCompensation)?;
        if number == 0 {
            self.emit(Action::Warning(
                "no tool is in the spindle, so cutter compensation has diameter 0 and has no effect: load a \
                 tool by T.. M6, name one by D.., or write the diameter with G41.1 D.. or G42.1 D.."
                    .to_owned(),
            ));
        }
        let present = self.state.tool;
        let present_tool = self.tools.as_ref().and_then(|tools| tools.get(present));
        if present != 0
            && number != present
            && present_tool.is_some_and(|present_tool| present_tool.diameter_mm != tool.diameter_mm)
        {
            self.emit(Action::Warning(format!(
                "D{number} takes the diameter of tool {number}, but tool {present} is in the spindle: write \
                 D{present}, or leave D out for the tool in the spindle"
            )));
        }
        let is_turning_tool = !matches!(tool.orientation, 0 | 9);
        if is_turning_tool && self.state.plane() != Some(Plane::Zx) {
            let span = self.line.group_span(Group::CutterCompensation);
            let message = format!(
                "tool {} is a turning tool (orientation {} in the tool table), and the plane is not G18",
                tool.number, tool.orientation
            );
            return Err(Fault::new(Code::WrongPlane, span, message)
                .help("write G18; Q of a mill in the tool table is 0 or absent"));
        }
        Ok((tool.diameter_mm, tool.orientation))
    }

    /// G40: the last move remains unchanged; the next one leads to the programmed position.
    pub(crate) fn end_compensation(&mut self) {
        self.contour_checker.end(self.commands.len());
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
        let length_in_plane = length(path);
        let cutter = self.state.cutter;
        if length_in_plane <= 1e-9 {
            // No motion in the plane: up or down beside the path.
            let mut end_beside_path = target;
            (end_beside_path[first], end_beside_path[second]) =
                (self.state.position[first], self.state.position[second]);
            self.emit_line(end_beside_path, kind)?;
            self.state.cutter.programmed = cutter.programmed.map(|_| target);
            return Ok(());
        }
        if let Ok(programmed) = Line::new(from, target) {
            let programmed = Curve::Line(programmed);
            self.contour_checker
                .programmed(&programmed, kind, self.number, self.commands.len());
        }
        let direction = [path[0] / length_in_plane, path[1] / length_in_plane];
        let offset = cutter.side * cutter.radius;
        let begin = along(start, perpendicular(direction), offset);
        let mut next = Element {
            shape: Shape::Line {
                point: begin,
                direction,
            },
            begin,
            begin_tangent: direction,
            end: along(end, perpendicular(direction), offset),
            end_tangent: direction,
            remaining: length_in_plane,
            entry: cutter.last.is_none().then_some(start),
        };
        let length_mm = curve_length(&from, &target);
        if let Some(last) = cutter.last {
            let corner_feed = self.speed(length_mm, false);
            next.remaining -= self.join_moves(&last, &next, start, corner_feed)?;
        } else if length_in_plane <= cutter.radius {
            let message = format!(
                "the first move with cutter compensation is {:.4} long, not longer than the radius of {:.4}",
                length_in_plane / self.state.unit_mm(),
                cutter.radius / self.state.unit_mm()
            );
            return Err(
                Fault::new(Code::CompensationEntry, self.line.motion_span(), message)
                    .help("start farther away from the contour"),
            );
        }
        let mut end_position = target;
        // A remainder within rounding, or negative, is dropped.
        let end_in_plane = if next.remaining > ROUNDING_MM || cutter.last.is_none() {
            add(next.end, cutter.nose)
        } else {
            [self.state.position[first], self.state.position[second]]
        };
        (end_position[first], end_position[second]) = (end_in_plane[0], end_in_plane[1]);
        self.hold_move(next);
        if end_position == self.state.position {
            self.state.cutter.held = None;
        } else {
            // In inverse time mode the length of the programmed path applies.
            let feed = match kind {
                MoveKind::Rapid => f64::INFINITY,
                MoveKind::Feed => self.speed(length_mm, false),
            };
            let curve = self.line_to(end_position)?;
            let path_mode = self.state.modes.path_mode;
            self.emit_curve(curve, kind, feed, path_mode)?;
        }
        self.state.cutter.programmed = Some(target);
        Ok(())
    }

    /// G2 and G3; `curve` is the programmed arc.
    pub(crate) fn compensated_arc(&mut self, curve: Curve) -> Result<(), Fault> {
        let (plane, first, second) = self.cutter_axes()?;
        let Curve::Arc(programmed) = curve else {
            return Ok(());
        };
        if programmed.plane() != plane {
            return Err(self.wrong_plane("cutter compensation"));
        }
        let cutter = self.state.cutter;
        let (from, target) = (curve.start(), curve.end());
        let start = [from[first], from[second]];
        let mut next = self.offset_arc(&programmed, start, [target[first], target[second]])?;
        self.contour_checker
            .programmed(&curve, MoveKind::Feed, self.number, self.commands.len());
        let feed = self.speed(curve.length(), false);
        let path_mode = self.state.modes.path_mode;
        if let Some(last) = cutter.last {
            next.remaining -= self.join_moves(&last, &next, start, feed)?;
        } else {
            next = self.entry_arc(&next, [target[first], target[second]])?;
            // The arc starts at the centre of the nose: the controlled point moves there first.
            let mut entry_position = self.state.position;
            (entry_position[first], entry_position[second]) = (
                entry_position[first] + cutter.nose[0],
                entry_position[second] + cutter.nose[1],
            );
            self.emit_line(entry_position, MoveKind::Feed)?;
        }
        let Shape::Circle { centre, radius, .. } = next.shape else {
            return Ok(());
        };
        let end_in_plane = add(next.end, cutter.nose);
        let mut end_position = target;
        (end_position[first], end_position[second]) = (end_in_plane[0], end_in_plane[1]);
        let trimmed = if next.remaining > ROUNDING_MM {
            let ends = (self.state.position, end_position);
            let sweep = next.remaining / radius;
            arc(plane, ends, add(centre, cutter.nose), curve.sense(), sweep)
                .map_err(|error| Fault::new(Code::ArcRefused, self.line.motion_span(), error.to_string()))?
        } else {
            // The corner has consumed the whole move in the plane.
            (end_position[first], end_position[second]) =
                (self.state.position[first], self.state.position[second]);
            Line::new(self.state.position, end_position).ok().map(Curve::Line)
        };
        self.hold_move(next);
        match trimmed {
            Some(trimmed) => self.emit_curve(trimmed, MoveKind::Feed, feed, path_mode)?,
            None => self.state.cutter.held = None,
        }
        self.state.cutter.programmed = Some(target);
        Ok(())
    }

    /// The path of the tool centre beside an arc.
    fn offset_arc(&self, arc: &Arc, start: Point, end: Point) -> Result<Element, Fault> {
        let cutter = self.state.cutter;
        let centre = arc.centre_mm();
        let sign = arc.sweep_rad().signum();
        let is_inside = sign * cutter.side > 0.0;
        let offset_point = |point: Point| {
            let from_centre = sub(point, centre);
            let distance = length(from_centre);
            let outward = [from_centre[0] / distance, from_centre[1] / distance];
            let radius = if is_inside {
                distance - cutter.radius
            } else {
                distance + cutter.radius
            };
            let tangent = perpendicular(outward).map(|value| sign * value);
            (radius >= MIN_RADIUS_MM).then(|| (along(centre, outward, radius), tangent, radius))
        };
        let (Some((begin, begin_tangent, _)), Some((end, end_tangent, radius))) =
            (offset_point(start), offset_point(end))
        else {
            let unit = self.state.unit_mm();
            let message = format!(
                "the tool of radius {:.4} does not fit into the arc of radius {:.4}",
                cutter.radius / unit,
                arc.radius_mm() / unit
            );
            return Err(
                Fault::new(Code::CompensationGouge, self.line.motion_span(), message)
                    .help("use a smaller tool or a larger radius"),
            );
        };
        Ok(Element {
            shape: Shape::Circle { centre, radius, sign },
            begin,
            begin_tangent,
            end,
            end_tangent,
            remaining: arc.sweep_rad().abs() * radius,
            entry: None,
        })
    }

    /// An arc as the first move: from the present position to the end of the offset arc, with its direction
    /// there.
    fn entry_arc(&self, offset: &Element, target: Point) -> Result<Element, Fault> {
        let cutter = self.state.cutter;
        let (_, first, second) = self.cutter_axes()?;
        let Shape::Circle { centre, sign, .. } = offset.shape else {
            return Ok(*offset);
        };
        let position = [self.state.position[first], self.state.position[second]];
        let rejected = |message: &str| {
            Fault::new(Code::CompensationEntry, self.line.motion_span(), message)
                .help("start farther away from the contour, or with a straight move")
        };
        if length(sub(position, target)) <= cutter.radius {
            return Err(rejected(
                "the first move with cutter compensation is too short for the tool",
            ));
        }
        // Beyond a right angle at the end, the arc would arrive from the other side.
        let ray = sub(centre, offset.end);
        let distance = length(ray);
        let inward = [ray[0] / distance, ray[1] / distance];
        let chord = sub(position, offset.end);
        let radius = dot(chord, chord) / (2.0 * dot(chord, inward));
        if !(radius.is_finite() && radius >= MIN_RADIUS_MM) {
            return Err(rejected(
                "no arc from the present position ends in the direction of the programmed one",
            ));
        }
        let centre = along(offset.end, inward, radius);
        let (a, b) = (sub(position, centre), sub(offset.end, centre));
        let swept = sign * libm::atan2(a[0] * b[1] - a[1] * b[0], dot(a, b));
        let sweep = if swept > 0.0 {
            swept
        } else {
            swept + std::f64::consts::TAU
        };
        Ok(Element {
            shape: Shape::Circle { centre, radius, sign },
            begin: position,
            remaining: sweep * radius,
            ..*offset
        })
    }

    /// Holds the next command until the following move.
    fn hold_move(&mut self, element: Element) {
        self.state.cutter.last = Some(element);
        self.state.cutter.held = Some(self.commands.len());
    }

    /// Joins the held move and the next one at a corner of the programmed path. Returns the length in mm that
    /// the next one loses.
    fn join_moves(&mut self, last: &Element, next: &Element, corner: Point, feed: f64) -> Result<f64, Fault> {
        let cutter = self.state.cutter;
        let (plane, first, second) = self.cutter_axes()?;
        match last.corner_with(next, cutter.radius, cutter.side) {
            Err(misfit) => Err(self.misfit_fault(misfit)),
            Ok(Corner::Straight { after }) => Ok(after),
            Ok(Corner::Inner { point, before, after }) => {
                let remaining_mm = if last.entry.is_some() {
                    f64::INFINITY
                } else {
                    last.remaining - before
                };
                self.trim_held(plane, point, remaining_mm)?;
                Ok(after)
            }
            Ok(Corner::Outer) => {
                let mut arc_end = self.state.position;
                let arc_start = add(next.begin, cutter.nose);
                (arc_end[first], arc_end[second]) = (arc_start[0], arc_start[1]);
                self.check_feed("the arc about an outer corner")?;
                let sense = if cutter.side > 0.0 {
                    Sense::Clockwise
                } else {
                    Sense::CounterClockwise
                };
                let centre = add(corner, cutter.nose);
                let arc = Arc::new(plane, self.state.position, arc_end, centre, sense, 0)
                    .map(Curve::Arc)
                    .map_err(|error| {
                        Fault::new(Code::ArcRefused, self.line.motion_span(), error.to_string())
                    })?;
                let path_mode = self.state.modes.path_mode;
                self.emit_curve(arc, MoveKind::Feed, feed, path_mode)?;
                Ok(0.0)
            }
        }
    }

    fn misfit_fault(&self, misfit: Misfit) -> Fault {
        let unit = self.state.unit_mm();
        let radius = self.state.cutter.radius / unit;
        let too_short = |which: &str, needed: f64, available: f64| {
            let (needed, available) = (needed / unit, available.max(0.0) / unit);
            format!(
                "the move {which} this inner corner is too short for the tool of radius {radius:.4}: the \
                 corner needs {needed:.4}, but only {available:.4} are left"
            )
        };
        let message = match misfit {
            Misfit::NoIntersection => {
                format!("at this inner corner the tool of radius {radius:.4} cannot follow both moves")
            }
            Misfit::Before { needed, available } => too_short("before", needed, available),
            Misfit::After { needed, available } => too_short("after", needed, available),
        };
        Fault::new(Code::CompensationGouge, self.line.motion_span(), message)
            .help("the tool does not fit into the inner corner: use a smaller tool or longer moves")
    }

    /// Ends the held move at a point of the plane, and starts what follows there. `remaining_mm` of its path
    /// remains.
    fn trim_held(&mut self, plane: Plane, point: Point, remaining_mm: f64) -> Result<(), Fault> {
        let (first, second, _) = plane.axes();
        let Some(held) = self.state.cutter.held else {
            // The last move had no length: there is nothing to trim, and the next one starts at the same
            // position.
            return Ok(());
        };
        let is_consumed = remaining_mm <= ROUNDING_MM;
        let point = match self.commands.get(held).map(|command| &command.action) {
            Some(Action::Move(step)) if is_consumed => plane.project(&step.curve.start()),
            _ => add(point, self.state.cutter.nose),
        };
        let moved_to_point = |mut axes: Axes| {
            (axes[first], axes[second]) = (point[0], point[1]);
            axes
        };
        let mut changed = Vec::new();
        for (index, command) in self.commands.iter().enumerate().skip(held) {
            let Action::Move(step) = &command.action else {
                continue;
            };
            let (start, end) = (step.curve.start(), moved_to_point(step.curve.end()));
            let start = if index == held {
                start
            } else {
                moved_to_point(start)
            };
            let curve = match step.curve {
                Curve::Arc(held_arc) if !is_consumed => {
                    let sweep = remaining_mm / held_arc.radius_mm();
                    arc(
                        plane,
                        (start, end),
                        held_arc.centre_mm(),
                        step.curve.sense(),
                        sweep,
                    )
                    .map_err(|error| {
                        Fault::new(Code::ArcRefused, self.line.motion_span(), error.to_string())
                    })?
                }
                _ => Line::new(start, end).ok().map(Curve::Line),
            };
            changed.push((index, curve.map(|curve| Move { curve, ..*step })));
        }
        for (index, step) in changed.into_iter().rev() {
            let original = match step {
                Some(step) => self.commands.get_mut(index).map(|command| {
                    let original = command.clone();
                    command.action = Action::Move(step);
                    (original, false)
                }),
                // It is consumed completely.
                None => self.commands.remove(index).map(|original| (original, true)),
            };
            if let Some((command, removed)) = original {
                self.changed.push(ChangedCommand {
                    index,
                    command,
                    removed,
                });
            }
        }
        self.state.position = moved_to_point(self.state.position);
        Ok(())
    }
}
