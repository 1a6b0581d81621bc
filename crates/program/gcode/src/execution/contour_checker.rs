//! Parts of a contour that are close to each other without being neighbours: a throat or slot narrower than
//! the tool, or an island too close to the wall.
//!
//! Like LinuxCNC's, compensation knows only the neighbours of a move: where the tool passes a narrow throat
//! along one wall, it cuts into the other one. So closed contours are stored together with the offset path
//! and compared when compensation ends. In an open contour it is unknown which moves are edges of the part
//! and which are entry and exit moves, which may be crossed: the first and last move of the compensation, and
//! arcs next to them, do not count as edges. A cut into an edge is found from either side, so one of two
//! close parts may be among those.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use evolvent_path::{Curve, Plane};
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};

use crate::execution::compensation::CutterState;
use crate::execution::offset_path::{Point, dot, length, sub};
use crate::{Action, CallChain, CanonicalCommand, Move, MoveKind};

/// Maximum number of programmed moves of a contour that are compared, with three times as many of the path:
/// 12 MB, and about 0.1 s. Longer contours are warned of.
const MAX_EDGES: usize = 20_000;

/// Maximum number of stored moves of earlier contours and their paths; the oldest contours are dropped.
const MAX_PIECES: usize = 4 * MAX_EDGES;

/// Depth of a cut that is tolerated, mm: rounding of programs and corners.
const CUT_TOLERANCE_MM: f64 = 0.01;

/// Fraction of the radius by which the tool comes closer at a corner that is passed straight: see
/// [`STRAIGHT_RAD`].
///
/// [`STRAIGHT_RAD`]: crate::execution::offset_path::STRAIGHT_RAD
const STRAIGHT_LOSS: f64 = 0.00125;

/// Maximum distance of the ends of a closed contour, mm.
const CLOSED_MM: f64 = 0.001;

/// A line or an arc in the plane, and its range of heights.
#[derive(Clone, Copy, Debug)]
struct Piece {
    line: u32,
    start: Point,
    end: Point,
    /// Centre, radius, start angle and swept angle of an arc.
    arc: Option<(Point, f64, f64, f64)>,
    low: Point,
    high: Point,
    heights: [f64; 2],
    is_feed: bool,
    /// Number of commands before it.
    command_index: u64,
}

impl Piece {
    /// `offset` is subtracted from every point.
    fn of(curve: &Curve, plane: Plane, offset: Point) -> Option<Self> {
        let (.., third) = plane.axes();
        let (from, to) = (curve.start(), curve.end());
        let (start, end) = (sub(plane.project(&from), offset), sub(plane.project(&to), offset));
        let heights = [from[third].min(to[third]), from[third].max(to[third])];
        let low = [start[0].min(end[0]), start[1].min(end[1])];
        let high = [start[0].max(end[0]), start[1].max(end[1])];
        let arc = match curve {
            Curve::Line(_) if length(sub(end, start)) > 0.0 => None,
            Curve::Arc(arc) if arc.plane() == plane => {
                let (centre, radius) = (sub(arc.centre_mm(), offset), arc.radius_mm());
                let ray = sub(start, centre);
                Some((centre, radius, libm::atan2(ray[1], ray[0]), arc.sweep_rad()))
            }
            _ => return None,
        };
        let mut piece = Self {
            start,
            end,
            arc,
            low,
            high,
            heights,
            line: 0,
            is_feed: true,
            command_index: 0,
        };
        piece.include_extremes();
        Some(piece)
    }

    /// Extends the box of an arc to the extreme points of its circle that it reaches.
    fn include_extremes(&mut self) {
        let Some((centre, radius, ..)) = self.arc else {
            return;
        };
        for axis in 0..2 {
            for signed in [-radius, radius] {
                let mut point = centre;
                point[axis] += signed;
                if self.contains_direction(point) {
                    self.low[axis] = self.low[axis].min(point[axis]);
                    self.high[axis] = self.high[axis].max(point[axis]);
                }
            }
        }
    }

    /// Whether the bounding boxes of two pieces are farther apart than a distance.
    fn is_farther_than(&self, other: &Self, distance: f64) -> bool {
        (0..2).any(|axis| {
            self.low[axis] - other.high[axis] > distance || other.low[axis] - self.high[axis] > distance
        }) || self.heights[0] > other.heights[1] + CLOSED_MM
            || other.heights[0] > self.heights[1] + CLOSED_MM
    }

    /// Whether an arc contains the direction of a point from its centre.
    fn contains_direction(&self, point: Point) -> bool {
        let Some((centre, _, first, sweep)) = self.arc else {
            return false;
        };
        let ray = sub(point, centre);
        let turned = (libm::atan2(ray[1], ray[0]) - first) * sweep.signum();
        turned.rem_euclid(TAU) <= sweep.abs()
    }

    /// The point nearest to another point.
    fn nearest(&self, point: Point) -> Point {
        let Some((centre, radius, ..)) = self.arc else {
            let chord = sub(self.end, self.start);
            let fraction = (dot(sub(point, self.start), chord) / dot(chord, chord)).clamp(0.0, 1.0);
            return [
                self.start[0] + fraction * chord[0],
                self.start[1] + fraction * chord[1],
            ];
        };
        let ray = sub(point, centre);
        let size = length(ray);
        if size > 0.0 && self.contains_direction(point) {
            return [
                centre[0] + ray[0] / size * radius,
                centre[1] + ray[1] / size * radius,
            ];
        }
        let distance = |end: Point| length(sub(end, point));
        if distance(self.start) <= distance(self.end) {
            self.start
        } else {
            self.end
        }
    }

    /// Whether two pieces have a common point.
    fn crosses(&self, other: &Self) -> bool {
        let (first, second) = match (self.arc, other.arc) {
            (None, None) => {
                let signed_side = |line: &Self, point: Point| {
                    let (chord, to) = (sub(line.end, line.start), sub(point, line.start));
                    chord[0] * to[1] - chord[1] * to[0]
                };
                return signed_side(self, other.start) * signed_side(self, other.end) < 0.0
                    && signed_side(other, self.start) * signed_side(other, self.end) < 0.0;
            }
            (Some(_), _) => (self, other),
            (None, Some(_)) => (other, self),
        };
        let Some((centre, radius, ..)) = first.arc else {
            return false;
        };
        // The intersections of the circle with the other line or circle: both ends of a chord about its
        // midpoint.
        let (chord_middle, direction, square) = match second.arc {
            None => {
                let chord = sub(second.end, second.start);
                let size = length(chord);
                let direction = [chord[0] / size, chord[1] / size];
                let distance = dot(sub(centre, second.start), direction);
                let foot = [
                    second.start[0] + distance * direction[0],
                    second.start[1] + distance * direction[1],
                ];
                let normal = sub(centre, foot);
                (foot, direction, radius * radius - dot(normal, normal))
            }
            Some((second_centre, second_radius, ..)) => {
                let chord = sub(second_centre, centre);
                let size = length(chord);
                if size <= 0.0 {
                    return false;
                }
                let axial = (size * size + radius * radius - second_radius * second_radius) / (2.0 * size);
                let ray = [chord[0] / size, chord[1] / size];
                let chord_middle = [centre[0] + axial * ray[0], centre[1] + axial * ray[1]];
                (chord_middle, [-ray[1], ray[0]], radius * radius - axial * axial)
            }
        };
        if square < 0.0 {
            return false;
        }
        [square.sqrt(), -square.sqrt()].iter().any(|half_chord| {
            let point = [
                chord_middle[0] + half_chord * direction[0],
                chord_middle[1] + half_chord * direction[1],
            ];
            let is_on_second = match second.arc {
                Some(_) => second.contains_direction(point),
                None => (0.0..=1.0).contains(
                    &(dot(sub(point, second.start), direction) / length(sub(second.end, second.start))),
                ),
            };
            first.contains_direction(point) && is_on_second
        })
    }

    /// The minimum distance between two pieces.
    fn distance(&self, other: &Self) -> f64 {
        if self.crosses(other) {
            return 0.0;
        }
        let end_distance = |piece: &Self, point: Point| length(sub(piece.nearest(point), point));
        let mut min = end_distance(self, other.start)
            .min(end_distance(self, other.end))
            .min(end_distance(other, self.start))
            .min(end_distance(other, self.end));
        // Between the ends of both: on the line through the centre of an arc that is perpendicular to the
        // other piece.
        for (arc, other) in [(self, other), (other, self)] {
            let Some((centre, radius, ..)) = arc.arc else {
                continue;
            };
            let feet = match other.arc {
                None => [other.nearest(centre); 2],
                Some((second_centre, second_radius, ..)) => {
                    let ray = sub(centre, second_centre);
                    let size = length(ray).max(f64::MIN_POSITIVE);
                    let on_circle = |sign: f64| {
                        [
                            second_centre[0] + sign * second_radius * ray[0] / size,
                            second_centre[1] + sign * second_radius * ray[1] / size,
                        ]
                    };
                    [on_circle(1.0), on_circle(-1.0)]
                }
            };
            for foot in feet {
                if other.arc.is_some() && !other.contains_direction(foot) {
                    continue;
                }
                let ray = sub(foot, centre);
                let size = length(ray);
                if size <= 0.0 {
                    continue;
                }
                for sign in [1.0, -1.0] {
                    let point = [
                        centre[0] + sign * radius * ray[0] / size,
                        centre[1] + sign * radius * ray[1] / size,
                    ];
                    if arc.contains_direction(point) {
                        min = min.min(length(sub(point, foot)));
                    }
                }
            }
        }
        min
    }

    /// Points along it, so dense that the piece is approximately straight in between.
    fn points(&self) -> impl Iterator<Item = Point> + '_ {
        let steps = self.arc.map_or(1, |(.., sweep)| 1 + (sweep.abs() / 0.1) as u32);
        (0..steps).map(move |step| match self.arc {
            None => self.start,
            Some((centre, radius, first, sweep)) => {
                let angle = first + sweep * f64::from(step) / f64::from(steps);
                [
                    centre[0] + radius * libm::cos(angle),
                    centre[1] + radius * libm::sin(angle),
                ]
            }
        })
    }
}

/// Pieces by their extent, so that only those near a piece are compared with it.
#[derive(Debug)]
struct EdgeTree(RTree<GeomWithData<Rectangle<Point>, usize>>);

impl EdgeTree {
    fn new(pieces: &[Piece]) -> Self {
        let extents = pieces
            .iter()
            .enumerate()
            .map(|(index, piece)| GeomWithData::new(Rectangle::from_corners(piece.low, piece.high), index));
        Self(RTree::bulk_load(extents.collect()))
    }

    /// Indices of the pieces whose extent comes as near to `piece` as `distance`, in the order of the
    /// contour.
    fn to(&self, piece: &Piece, distance: f64) -> Vec<usize> {
        let low = piece.low.map(|value| value - distance);
        let high = piece.high.map(|value| value + distance);
        let within = AABB::from_corners(low, high);
        let mut found: Vec<usize> = self
            .0
            .locate_in_envelope_intersecting(&within)
            .map(|extent| extent.data)
            .collect();
        found.sort_unstable();
        found
    }
}

/// The tool of a compensated contour.
#[derive(Clone, Copy, Debug)]
struct Tool {
    radius: f64,
    /// +1 for the left side.
    side: f64,
    nose: Point,
    plane: Plane,
    /// Millimetres per program unit.
    unit: f64,
}

/// A closed contour with the path of the tool beside it, including entry and exit.
#[derive(Debug)]
struct ClosedContour {
    tool: Tool,
    edges: Vec<Piece>,
    edge_tree: EdgeTree,
    path: Vec<Piece>,
    outline: Vec<Point>,
    /// Whether the tool is inside.
    is_pocket: bool,
}

/// A cut of the tool into an edge.
#[derive(Clone, Copy, Debug)]
struct Cut {
    path: u32,
    edge: u32,
    depth: f64,
}

impl ClosedContour {
    fn new(tool: Tool, edges: Vec<Piece>, path: Vec<Piece>) -> Self {
        let outline: Vec<Point> = edges.iter().flat_map(Piece::points).collect();
        let next = outline.iter().cycle().skip(1);
        let area: f64 = outline
            .iter()
            .zip(next)
            .map(|(a, b)| a[0] * b[1] - a[1] * b[0])
            .sum();
        Self {
            tool,
            edge_tree: EdgeTree::new(&edges),
            edges,
            path,
            outline,
            is_pocket: area * tool.side > 0.0,
        }
    }

    fn size(&self) -> usize {
        self.edges.len() + self.path.len()
    }

    /// Whether a point is inside, by the number of crossings of a ray with the outline.
    fn contains(&self, point: Point) -> bool {
        let next = self.outline.iter().cycle().skip(1);
        let crossings = self.outline.iter().zip(next).filter(|(a, b)| {
            (a[1] > point[1]) != (b[1] > point[1])
                && point[0] < a[0] + (point[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        });
        crossings.count() % 2 == 1
    }

    /// Whether this is an island in a pocket. Contours that intersect count as pockets of each other.
    fn is_island_in(&self, pocket: &Self) -> bool {
        let is_candidate = !self.is_pocket && pocket.is_pocket && self.tool.plane == pocket.tool.plane;
        is_candidate
            && pocket.contains(self.edges[0].start)
            && !self.contains(pocket.edges[0].start)
            && !self.edges.iter().any(|edge| {
                let nearby = pocket.edge_tree.to(edge, 0.0);
                let mut nearby = nearby.iter().map(|index| &pocket.edges[*index]);
                nearby.any(|other| !edge.is_farther_than(other, 0.0) && edge.crosses(other))
            })
    }

    /// The deepest cut of this path into the edges of a contour.
    fn cut(&self, other: &Self) -> Option<Cut> {
        let mut deepest: Option<Cut> = None;
        for piece in &self.path {
            for edge in other.edge_tree.to(piece, self.tool.radius) {
                let edge = &other.edges[edge];
                if piece.is_farther_than(edge, self.tool.radius) {
                    continue;
                }
                let depth = self.tool.radius - piece.distance(edge);
                if depth > CUT_TOLERANCE_MM + STRAIGHT_LOSS * self.tool.radius
                    && deepest.is_none_or(|cut| depth > cut.depth)
                {
                    deepest = Some(Cut {
                        path: piece.line,
                        edge: edge.line,
                        depth,
                    });
                }
            }
        }
        deepest
    }

    /// `are_edges_certain`: all edges are edges of the part.
    fn warning(&self, cut: Cut, are_edges_certain: bool) -> CanonicalCommand {
        let unit = self.tool.unit;
        let note = if are_edges_certain {
            ""
        } else {
            " (ignore this if that line only leads to or from the part)"
        };
        let text = format!(
            "the tool of radius {:.4} beside this move cuts {:.4} deep into the contour of line {}, which is \
             near but not next to it; use a smaller tool, or leave out the part that it cannot reach{note}",
            self.tool.radius / unit,
            cut.depth / unit,
            cut.edge
        );
        warning(cut.path, text)
    }
}

fn warning(line: u32, text: String) -> CanonicalCommand {
    CanonicalCommand {
        line,
        action: Action::Warning(text),
        origin: None,
        calls: CallChain::default(),
        feed_mm_rev: None,
        feed_spindle: 0,
        continues: false,
    }
}

/// The contours with cutter compensation of one program.
#[derive(Debug, Default)]
pub(crate) struct ContourChecker {
    /// Number of commands that have been output.
    output_count: u64,
    /// The tool of the present compensation.
    tool: Option<Tool>,
    /// Number of commands after which its compensation ends.
    end: Option<u64>,
    /// Programmed moves, and the final part of the path.
    edges: Vec<Piece>,
    path: Vec<Piece>,
    /// Whether the move to the contour has been output.
    has_entered: bool,
    /// Earlier contours.
    contours: VecDeque<ClosedContour>,
    findings: VecDeque<CanonicalCommand>,
}

impl ContourChecker {
    /// Starts compensation.
    pub(crate) fn begin(&mut self, cutter: &CutterState, plane: Plane, unit: f64) {
        self.reset();
        let (radius, side, nose) = cutter.tool();
        self.tool = Some(Tool {
            radius,
            side,
            nose,
            plane,
            unit,
        });
    }

    /// Ends compensation after the commands that are held now.
    pub(crate) fn end(&mut self, pending_count: usize) {
        if self.tool.is_some() && self.end.is_none() {
            self.end = Some(self.output_count + pending_count as u64);
        }
    }

    /// Adds a programmed move with compensation.
    pub(crate) fn programmed(&mut self, curve: &Curve, kind: MoveKind, line: u32, pending_count: usize) {
        let Some(tool) = self.tool else { return };
        // One more than the maximum marks the excess.
        if self.edges.len() <= MAX_EDGES {
            let piece = Piece::of(curve, tool.plane, [0.0; 2]);
            self.edges.extend(piece.map(|piece| Piece {
                line,
                is_feed: kind == MoveKind::Feed,
                command_index: self.output_count + pending_count as u64,
                ..piece
            }));
        }
    }

    /// The number of programmed moves, for rolling back a line with an error.
    pub(crate) fn mark(&self) -> usize {
        self.edges.len()
    }

    pub(crate) fn roll_back(&mut self, mark: usize) {
        self.edges.truncate(mark);
    }

    /// Commands were discarded.
    pub(crate) fn discard(&mut self) {
        self.reset();
    }

    fn reset(&mut self) {
        self.edges.clear();
        self.path.clear();
        (self.tool, self.end, self.has_entered) = (None, None, false);
    }

    /// A command is output and final.
    #[inline]
    pub(crate) fn output(&mut self, command: &CanonicalCommand) {
        if self.tool.is_some() {
            self.record_path(command);
        }
        self.output_count += 1;
    }

    fn record_path(&mut self, command: &CanonicalCommand) {
        let (Some(tool), Action::Move(Move { curve, .. })) = (self.tool, &command.action) else {
            return;
        };
        if self.end.is_some_and(|end| self.output_count >= end) || self.path.len() > 3 * MAX_EDGES {
            return;
        }
        // From the position of the tool without compensation.
        if !std::mem::replace(&mut self.has_entered, true) {
            return;
        }
        let piece = Piece::of(curve, tool.plane, tool.nose);
        self.path.extend(piece.map(|piece| Piece {
            line: command.line,
            command_index: self.output_count,
            ..piece
        }));
    }

    /// The findings on the contours of a finished compensation, one per call.
    #[inline]
    pub(crate) fn finding(&mut self) -> Option<CanonicalCommand> {
        if self.end.is_some_and(|end| self.output_count >= end) {
            self.compare();
        }
        self.findings.pop_front()
    }

    /// The commands after a closed contour that do not lead away from it: a second lap, which need not be an
    /// edge of the same part. It may cut a corner of the first lap.
    fn second_lap(&self, last: usize, is_last_contour: bool) -> std::ops::Range<u64> {
        let remaining = self.edges.get(last + 1..).unwrap_or(&[]);
        let lead_out = lead_move_count(remaining.iter().rev());
        match (
            remaining.first(),
            remaining.get(remaining.len().saturating_sub(lead_out)),
        ) {
            (Some(first), Some(lead_out_start)) if is_last_contour => {
                first.command_index..lead_out_start.command_index
            }
            _ => 0..0,
        }
    }

    #[cold]
    fn compare(&mut self) {
        let mut found = Vec::new();
        let is_long = self.edges.len() > MAX_EDGES || self.path.len() > 3 * MAX_EDGES;
        if let Some(edge) = self.edges.first().filter(|_| is_long) {
            found.push(warning(
                edge.line,
                format!(
                    "cutter compensation of more than {MAX_EDGES} moves, corners included: parts that are narrower \
                     than the tool are not searched; end it with G40 between contours, or program the path of \
                     the tool"
                ),
            ));
        }
        if let Some(tool) = self.tool.filter(|_| !is_long) {
            let contours = closed_contours(&self.edges);
            for (index, &(first, last)) in contours.iter().enumerate() {
                // Including entry and exit moves.
                let edge = |index: usize| self.edges.get(index).map(|edge| edge.command_index);
                let begin = index
                    .checked_sub(1)
                    .and_then(|previous| edge(contours[previous].1 + 1));
                let end = contours.get(index + 1).and_then(|next| edge(next.0));
                let (begin, end) = (begin.unwrap_or(0), end.unwrap_or(u64::MAX));
                let edges = self.edges[first..=last].iter().filter(|edge| edge.is_feed);
                let second_lap = self.second_lap(last, index + 1 == contours.len());
                let path = self.path.iter().filter(|piece| {
                    (begin..end).contains(&piece.command_index) && !second_lap.contains(&piece.command_index)
                });
                let contour = ClosedContour::new(tool, edges.copied().collect(), path.copied().collect());
                if contour.edges.is_empty() {
                    continue;
                }
                found.extend(contour.cut(&contour).map(|cut| contour.warning(cut, true)));
                for other in &self.contours {
                    if contour.is_island_in(other) || other.is_island_in(&contour) {
                        found.extend(contour.cut(other).map(|cut| contour.warning(cut, true)));
                        found.extend(other.cut(&contour).map(|cut| other.warning(cut, true)));
                    }
                }
                self.contours.push_back(contour);
                while self.contours.iter().map(ClosedContour::size).sum::<usize>() > MAX_PIECES {
                    self.contours.pop_front();
                }
            }
            if contours.is_empty() {
                let edges = open_contour_edges(&self.edges).iter().filter(|edge| edge.is_feed);
                let contour = ClosedContour::new(tool, edges.copied().collect(), self.path.clone());
                found.extend(contour.cut(&contour).map(|cut| contour.warning(cut, false)));
            }
        }
        self.reset();
        self.findings.extend(found);
    }
}

/// Number of moves that may lead to a contour or away from it: the first move and the arcs next to it.
fn lead_move_count<'a>(mut moves: impl Iterator<Item = &'a Piece>) -> usize {
    let first = usize::from(moves.next().is_some());
    first + moves.take_while(|piece| piece.arc.is_some()).count()
}

/// The moves of an open contour without possible entry and exit moves.
fn open_contour_edges(edges: &[Piece]) -> &[Piece] {
    let (lead_in, lead_out) = (lead_move_count(edges.iter()), lead_move_count(edges.iter().rev()));
    edges
        .get(lead_in..edges.len().saturating_sub(lead_out))
        .unwrap_or(&[])
}

/// First and last edge of each closed contour.
fn closed_contours(edges: &[Piece]) -> Vec<(usize, usize)> {
    let starts = edges.iter().enumerate();
    let starts = RTree::bulk_load(
        starts
            .map(|(index, edge)| GeomWithData::new(edge.start, index))
            .collect(),
    );
    let mut found = Vec::new();
    let mut next_free = 0;
    for last in 0..edges.len() {
        let candidates = starts.locate_within_distance(edges[last].end, CLOSED_MM * CLOSED_MM);
        let candidates = candidates
            .map(|start| start.data)
            .filter(|first| (next_free..=last).contains(first));
        // The latest first: back at the start of the contour, before the entry path is retraced.
        if let Some(first) = candidates.max() {
            found.push((first, last));
            next_free = last + 1;
        }
    }
    found
}
