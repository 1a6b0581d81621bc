//! Splines in the XY plane: G5, G5.1, and the NURBS of G5.2 and G5.3.
//!
//! A Bezier curve of degree two or three is exactly one polynomial of the path. A rational curve becomes a
//! chain of quintics that match position and first two derivatives at each joint, each within
//! [`TOLERANCE_MM`] of the curve at the same parameter.

use evolvent_path::{Axes, Blend, Curve, Jet, Line, Plane};

use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::{Code, MoveKind};

/// Maximum deviation of a quintic from a rational curve, in mm.
const TOLERANCE_MM: f64 = 1e-4;

/// Maximum number of control points of one NURBS.
const MAX_POINTS: usize = 100_000;

/// Maximum order: degree nine.
const MAX_ORDER: u32 = 10;

/// Maximum number of bisections of a span of a NURBS.
const MAX_BISECTIONS: u32 = 16;

type Point = [f64; 2];

impl Executor<'_> {
    fn begin_spline(&self, name: &str) -> Result<(), Fault> {
        if self.state.plane() != Some(Plane::Xy) {
            return Err(self.wrong_plane(name));
        }
        self.check_uncompensated(name)?;
        self.allow_only_axes(b"XY@^", name)?;
        self.check_feed(name)
    }

    /// Two words such as I and J as a vector in program coordinates, mm.
    fn pair(&self, first: u8, second: u8) -> Option<Point> {
        let unit = self.state.unit_mm();
        Some([self.line.word(first)? * unit, self.line.word(second)? * unit])
    }

    fn word_missing(&self, message: &str) -> Fault {
        Fault::new(Code::WordMissing, self.line.motion_span(), message.to_owned())
    }

    /// Start and end in program coordinates.
    fn ends(&self) -> Result<(Axes, Axes), Fault> {
        let target = self.target()?;
        Ok((
            self.state.machine_to_program(self.state.position),
            self.state.machine_to_program(target),
        ))
    }

    /// G5: I, J from the start to the first control point, P, Q from the end to the second.
    pub(crate) fn cubic_spline(&mut self) -> Result<(), Fault> {
        self.begin_spline("G5")?;
        if !self.line.has_axes() {
            return Err(self.word_missing("G5 needs its end: X, Y or both"));
        }
        let Some([p, q]) = self.pair(b'P', b'Q') else {
            return Err(self.word_missing("G5 needs P and Q, from the end to the second control point"));
        };
        let line = self.line;
        let first = match (self.pair(b'I', b'J'), self.state.spline_end) {
            (Some(first), _) => first,
            (None, _) if line.has(b'I') || line.has(b'J') => {
                return Err(self.word_missing("G5 needs both I and J, or neither"));
            }
            // Continues with the tangent of the last one.
            (None, Some([p, q])) => [-p, -q],
            (None, None) => [0.0, 0.0],
        };
        let (start, end) = self.ends()?;
        let points = [
            [start[0], start[1]],
            [start[0] + first[0], start[1] + first[1]],
            [end[0] + p, end[1] + q],
            [end[0], end[1]],
        ];
        self.bezier(points)?;
        self.state.spline_end = Some([p, q]);
        Ok(())
    }

    /// G5.1: I, J from the start to the one control point.
    pub(crate) fn quadratic_spline(&mut self) -> Result<(), Fault> {
        self.begin_spline("G5.1")?;
        let Some([i, j]) = self.pair(b'I', b'J') else {
            return Err(self.word_missing("G5.1 needs I and J, from the start to the control point"));
        };
        if i == 0.0 && j == 0.0 {
            return Err(self.word_missing("G5.1 needs I and J that are not both 0"));
        }
        let (start, end) = self.ends()?;
        let middle = [start[0] + i, start[1] + j];
        let elevate = |a: Point, b: f64, c: f64| [(b + 2.0 * a[0]) / 3.0, (c + 2.0 * a[1]) / 3.0];
        self.bezier([
            [start[0], start[1]],
            elevate(middle, start[0], start[1]),
            elevate(middle, end[0], end[1]),
            [end[0], end[1]],
        ])
    }

    /// A cubic Bezier curve, control points in program coordinates.
    fn bezier(&mut self, points: [Point; 4]) -> Result<(), Fault> {
        let distance = |a: Point, b: Point| libm::hypot(b[0] - a[0], b[1] - a[1]);
        let polygon: f64 = points.windows(2).map(|pair| distance(pair[0], pair[1])).sum();
        if polygon <= 0.0 {
            return Ok(());
        }
        let at = |t: f64| -> [Point; 3] {
            let s = 1.0 - t;
            let mut derivatives = [[0.0; 2]; 3];
            for k in 0..2 {
                let [a, b, c, d] = points.map(|point| point[k]);
                derivatives[0][k] = s * s * s * a + 3.0 * s * s * t * b + 3.0 * s * t * t * c + t * t * t * d;
                derivatives[1][k] = 3.0 * (s * s * (b - a) + 2.0 * s * t * (c - b) + t * t * (d - c));
                derivatives[2][k] = 6.0 * (s * (c - 2.0 * b + a) + t * (d - 2.0 * c + b));
            }
            derivatives
        };
        // A polynomial of degree three is its own quintic; it is divided only where it is stationary.
        let mut pieces = Vec::new();
        self.approximate(&at, 0.0, 1.0, 0, &mut pieces)?;
        self.emit_pieces(&pieces)
    }

    /// G5.2: a control point with its weight P; the first one with the order L.
    pub(crate) fn control_point(&mut self) -> Result<(), Fault> {
        self.begin_spline("G5.2")?;
        let line = self.line;
        if line.has_polar() {
            let letter = if line.has(b'@') { b'@' } else { b'^' };
            let message = "@ and ^ have no meaning for G5.2";
            return Err(Fault::new(Code::PolarCoordinates, line.span(letter), message)
                .help("write the control points of a NURBS with X and Y"));
        }
        if self.state.nurbs_order.is_none() {
            let order = line.integer(b'L')?.unwrap_or(3);
            if !(2..=MAX_ORDER).contains(&order) {
                let message = format!("L{order}: the order of a NURBS is 2 to {MAX_ORDER}");
                return Err(Fault::new(Code::OutOfRange, line.span(b'L'), message));
            }
            self.state.nurbs_order = Some(order as usize);
            let position = self.state.machine_to_program(self.state.position);
            let weight = self.weight()?;
            self.control_points.clear();
            self.control_points.push([position[0], position[1], weight]);
        } else if line.has(b'L') {
            let message = "L must be on the first line of a NURBS";
            return Err(Fault::new(Code::UnusedWord, line.span(b'L'), message));
        }
        if line.has_axes() {
            let weight = self.weight()?;
            // Missing words keep the last control point; increments are from the start, as in LinuxCNC.
            let start = self.state.machine_to_program(self.state.position);
            let mut point = match self.control_points.last() {
                Some(last) => [last[0], last[1]],
                None => [start[0], start[1]],
            };
            let unit = self.state.unit_mm();
            for (axis, value) in point.iter_mut().enumerate() {
                if let Some(word) = line.axis(axis) {
                    let word = word * self.state.word_unit(axis).min(unit);
                    *value = if self.state.modes.incremental {
                        start[axis] + word
                    } else {
                        word
                    };
                }
            }
            if self.control_points.len() >= MAX_POINTS {
                let message = format!("a NURBS of more than {MAX_POINTS} control points");
                return Err(Fault::new(Code::OutOfRange, line.motion_span(), message));
            }
            self.control_points.push([point[0], point[1], weight]);
        }
        Ok(())
    }

    fn weight(&self) -> Result<f64, Fault> {
        match self.line.word(b'P') {
            Some(weight) if (1e-6..=1e6).contains(&weight) => Ok(weight),
            Some(weight) => {
                let message =
                    format!("P{weight}: the weight of a control point must be above 0 and not extreme");
                Err(Fault::new(Code::OutOfRange, self.line.span(b'P'), message))
            }
            None => Err(self.word_missing("every control point of a NURBS needs P, its weight")),
        }
    }

    /// G5.3: executes the NURBS.
    pub(crate) fn nurbs(&mut self) -> Result<(), Fault> {
        let Some(order) = self.state.nurbs_order.take() else {
            let message = "G5.3 without G5.2 before it";
            return Err(Fault::new(Code::SplineOpen, self.line.motion_span(), message));
        };
        self.state.motion = crate::codes::modal_groups::Motion::None;
        let points = std::mem::take(self.control_points);
        if points.len() < order {
            let message = format!(
                "a NURBS of order {order} needs as many control points; there are {}",
                points.len()
            );
            return Err(Fault::new(Code::SplineOpen, self.line.motion_span(), message));
        }
        self.check_feed("G5.3")?;
        let spans = points.len() - order + 1;
        let knot = |index: usize| (index.saturating_sub(order - 1).min(spans)) as f64;
        let at = |u: f64| rational(&points, order, &knot, u);
        let mut pieces = Vec::new();
        for span in 0..spans {
            self.approximate(&at, span as f64, (span + 1) as f64, 0, &mut pieces)?;
        }
        self.emit_pieces(&pieces)?;
        // The memory is reused by the next NURBS.
        *self.control_points = points;
        self.control_points.clear();
        Ok(())
    }

    /// Divides a curve into quintics. `at` returns position, first and second derivative in program
    /// coordinates.
    fn approximate(
        &self,
        at: &impl Fn(f64) -> [Point; 3],
        from: f64,
        to: f64,
        bisections: u32,
        pieces: &mut Vec<Curve>,
    ) -> Result<(), Fault> {
        let (start_derivatives, end_derivatives) = (at(from), at(to));
        let middle = at(0.5 * (from + to));
        let distance = |a: Point, b: Point| libm::hypot(b[0] - a[0], b[1] - a[1]);
        let mut size = distance(start_derivatives[0], middle[0]) + distance(middle[0], end_derivatives[0]);
        if bisections == 0 && size <= TOLERANCE_MM {
            // A curve may pass its start in the middle. One of degree nine at most whose samples are all
            // equal is a single point.
            let sample = |part: u32| at(from + (to - from) * f64::from(part) / 16.0)[0];
            size = (0..16).map(|part| distance(sample(part), sample(part + 1))).sum();
        }
        if size <= 0.0 {
            return Ok(());
        }
        let start = pieces.last().map_or(self.state.position, Curve::end);
        let width = to - from;
        let speed = |jet: &[Point; 3]| libm::hypot(jet[1][0], jet[1][1]) * width;
        // A curve that is almost stationary at an end has no direction there for the planner.
        let is_stationary = speed(&start_derivatives).min(speed(&end_derivatives)) < 1e-3 * size;
        let is_within_tolerance = |blend: &Blend| {
            [0.125, 0.25, 0.5, 0.75, 0.875].iter().all(|x| {
                let expected = self.machine_point(at(from + x * width)[0], &start);
                let actual = Curve::Blend(*blend).position(x * size);
                (actual - expected).norm() <= TOLERANCE_MM
            })
        };
        let blend = (!is_stationary)
            .then(|| {
                Blend::hermite(
                    &self.jet(&start_derivatives, &start, width / size, Some(start)),
                    &self.jet(&end_derivatives, &start, width / size, None),
                    size,
                )
                .ok()
            })
            .flatten()
            .filter(is_within_tolerance);
        if let Some(blend) = blend {
            pieces.push(Curve::Blend(blend));
            return Ok(());
        }
        if bisections >= MAX_BISECTIONS || size <= TOLERANCE_MM {
            // So short that a line is equivalent.
            let line = Line::new(start, self.machine_point(end_derivatives[0], &start));
            pieces.extend(line.ok().map(Curve::Line));
            return Ok(());
        }
        let middle_parameter = 0.5 * (from + to);
        self.approximate(at, from, middle_parameter, bisections + 1, pieces)?;
        self.approximate(at, middle_parameter, to, bisections + 1, pieces)
    }

    /// A point of the plane in machine coordinates; the other axes do not move.
    fn machine_point(&self, point: Point, other_axes: &Axes) -> Axes {
        let mut program = self.state.machine_to_program(*other_axes);
        (program[0], program[1]) = (point[0], point[1]);
        let mut machine = self.state.program_to_machine(program);
        for axis in 2..machine.len() {
            machine[axis] = other_axes[axis];
        }
        machine
    }

    fn jet(&self, jet: &[Point; 3], other_axes: &Axes, scale: f64, exact_position: Option<Axes>) -> Jet {
        let vector = |value: Point, scale: f64| {
            let mut axes = Axes::zeros();
            (axes[0], axes[1]) = (value[0] * scale, value[1] * scale);
            self.state.rotate(axes)
        };
        Jet {
            position: exact_position.unwrap_or_else(|| self.machine_point(jet[0], other_axes)),
            first: vector(jet[1], scale),
            second: vector(jet[2], scale * scale),
            third: Axes::zeros(),
        }
    }

    pub(crate) fn emit_pieces(&mut self, pieces: &[Curve]) -> Result<(), Fault> {
        let length: f64 = pieces.iter().map(Curve::length).sum();
        let feed = self.speed(length, false);
        let path_mode = self.state.modes.path_mode;
        for piece in pieces {
            for axis in evolvent_path::AxisLetter::ALL {
                crate::execution::offsets::check_coordinate(piece.end()[axis.index()], axis, self.line)?;
            }
            self.emit_curve(*piece, MoveKind::Feed, feed, path_mode)?;
        }
        Ok(())
    }
}

/// Position and two derivatives of a NURBS (Piegl and Tiller, "The NURBS Book", algorithms A2.2, A3.1 and
/// equation (4.8)): the derivatives of a B-spline are B-splines of the differences.
fn rational(points: &[[f64; 3]], order: usize, knot: &impl Fn(usize) -> f64, u: f64) -> [Point; 3] {
    let degree = order - 1;
    let spans = points.len() - degree;
    let span = (u.floor().max(0.0) as usize).min(spans - 1) + degree;
    // The relevant control points in homogeneous coordinates.
    let mut local = [[0.0; 3]; MAX_ORDER as usize];
    for (slot, point) in local.iter_mut().zip(&points[span - degree..=span]) {
        *slot = [point[0] * point[2], point[1] * point[2], point[2]];
    }
    let mut values = [[0.0; 3]; 3];
    for (derivative, value) in values.iter_mut().enumerate() {
        if derivative > degree {
            break;
        }
        let remaining = degree - derivative;
        let mut triangle = local;
        // De Boor's triangle over the remaining points.
        for level in 1..=remaining {
            for row in (level..=remaining).rev() {
                let index = span - remaining + row;
                let (low, high) = (knot(index), knot(index + remaining - level + 1));
                let fraction = if high > low { (u - low) / (high - low) } else { 0.0 };
                for k in 0..3 {
                    triangle[row][k] = (1.0 - fraction) * triangle[row - 1][k] + fraction * triangle[row][k];
                }
            }
        }
        *value = triangle[remaining];
        // The differences for the next derivative.
        for row in 0..remaining {
            let index = span - remaining + row + 1;
            let (low, high) = (knot(index), knot(index + remaining));
            let factor = if high > low {
                remaining as f64 / (high - low)
            } else {
                0.0
            };
            for k in 0..3 {
                local[row][k] = factor * (local[row + 1][k] - local[row][k]);
            }
        }
    }
    let [a, b, c] = values;
    let mut out = [[0.0; 2]; 3];
    for k in 0..2 {
        out[0][k] = a[k] / a[2];
        out[1][k] = (b[k] - b[2] * out[0][k]) / a[2];
        out[2][k] = (c[k] - 2.0 * b[2] * out[1][k] - c[2] * out[0][k]) / a[2];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quarter circle is a rational quadratic with the middle weight cos 45 degrees.
    const QUARTER: [[f64; 3]; 3] = [
        [1.0, 0.0, 1.0],
        [1.0, 1.0, std::f64::consts::FRAC_1_SQRT_2],
        [0.0, 1.0, 1.0],
    ];

    fn knots(order: usize, spans: usize) -> impl Fn(usize) -> f64 {
        move |index| (index.saturating_sub(order - 1).min(spans)) as f64
    }

    #[test]
    fn a_rational_quadratic_reproduces_the_circle() {
        for step in 0..=20 {
            let u = f64::from(step) / 20.0;
            let [position, first, second] = rational(&QUARTER, 3, &knots(3, 1), u);
            assert!((libm::hypot(position[0], position[1]) - 1.0).abs() < 1e-14);
            // x x' + y y' = 0, and differentiated: x'^2 + y'^2 + x x'' + y y'' = 0.
            assert!((position[0] * first[0] + position[1] * first[1]).abs() < 1e-13);
            let speed = first[0] * first[0] + first[1] * first[1];
            assert!((speed + position[0] * second[0] + position[1] * second[1]).abs() < 1e-12);
        }
    }

    #[test]
    fn derivatives_agree_with_differences_on_many_spans() {
        let points: Vec<[f64; 3]> = (0..9)
            .map(|k| {
                let k = f64::from(k);
                [3.0 * k, (1.7 * k).sin() * 4.0, 1.0 + 0.5 * (k * 0.9).cos()]
            })
            .collect();
        for order in 3..=6 {
            let knot = knots(order, points.len() - order + 1);
            for step in 1..40 {
                let u = f64::from(step) * 0.0987 * (points.len() - order + 1) as f64 / 4.0;
                let at = |u: f64| rational(&points, order, &knot, u);
                let h = 1e-5;
                if (u + h).floor() != (u - h).floor() {
                    continue;
                }
                for k in 0..2 {
                    let first_derivative = (at(u + h)[0][k] - at(u - h)[0][k]) / (2.0 * h);
                    assert!(
                        (first_derivative - at(u)[1][k]).abs() < 1e-6 * (1.0 + first_derivative.abs()),
                        "order {order} u {u}"
                    );
                    let second_derivative = (at(u + h)[1][k] - at(u - h)[1][k]) / (2.0 * h);
                    assert!(
                        (second_derivative - at(u)[2][k]).abs() < 1e-5 * (1.0 + second_derivative.abs()),
                        "order {order} u {u}"
                    );
                }
            }
        }
    }
}
