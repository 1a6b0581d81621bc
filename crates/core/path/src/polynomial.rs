//! Ranges and curvature bounds of polynomials of degree five over an interval.

use nalgebra::Vector3;

use crate::plane::Interval;

/// Coefficients of the powers 0 to 5.
pub(crate) type Quintic = [f64; 6];

pub(crate) fn evaluate(c: &Quintic, x: f64) -> f64 {
    c.iter()
        .rev()
        .fold(0.0, |sum, &coefficient| sum * x + coefficient)
}

pub(crate) fn derivative(c: &Quintic) -> Quintic {
    [c[1], 2.0 * c[2], 3.0 * c[3], 4.0 * c[4], 5.0 * c[5], 0.0]
}

/// Exact range over `a..=b`, to rounding.
///
/// Between neighbouring roots of the next higher derivative each derivative is monotone, so its roots are
/// isolated one by one, from the fourth derivative down to the first.
pub(crate) fn range(c: &Quintic, a: f64, b: f64) -> Interval {
    let mut derivatives = [*c; 5];
    for order in 1..5 {
        derivatives[order] = derivative(&derivatives[order - 1]);
    }
    // Two ends and at most 1 + 2 + 3 + 4 roots.
    let mut points = [a; 12];
    points[1] = b;
    let mut count = 2;
    for curve in derivatives[1..].iter().rev() {
        let known = count;
        for i in 0..known - 1 {
            if let Some(root) = root(curve, points[i], points[i + 1])
                && count < points.len()
            {
                points[count] = root;
                count += 1;
            }
        }
        points[..count].sort_unstable_by(f64::total_cmp);
    }
    points[..count].iter().map(|&x| evaluate(c, x)).fold(
        Interval {
            low: f64::INFINITY,
            high: f64::NEG_INFINITY,
        },
        |range, value| range.hull(Interval::new(value, value)),
    )
}

/// The root in the open interval if the signs at its ends differ, by at most 60 bisections.
fn root(c: &Quintic, a: f64, b: f64) -> Option<f64> {
    let (mut low, mut high) = (a, b);
    let rising = evaluate(c, high) > 0.0;
    let ends = evaluate(c, low) * evaluate(c, high);
    if !(ends < 0.0) {
        return None;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if (evaluate(c, middle) > 0.0) == rising {
            high = middle;
        } else {
            low = middle;
        }
    }
    Some(0.5 * (low + high))
}

/// Bernstein coefficients of degree 5 over `a..=b`; the values are in their convex hull.
fn bernstein(c: &Quintic, a: f64, b: f64) -> Quintic {
    // Taylor coefficients at a, in units of b - a.
    let mut taylor = [0.0; 6];
    let mut curve = *c;
    let mut factor = 1.0;
    for (order, value) in taylor.iter_mut().enumerate() {
        *value = evaluate(&curve, a) * factor;
        curve = derivative(&curve);
        factor *= (b - a) / (order + 1) as f64;
    }
    let mut hull = [0.0; 6];
    for (i, value) in hull.iter_mut().enumerate() {
        *value = (0..=i).map(|k| taylor[k] * BINOMIAL[i][k] / BINOMIAL[5][k]).sum();
    }
    hull
}

const BINOMIAL: [[f64; 6]; 6] = [
    [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 1.0, 0.0, 0.0, 0.0, 0.0],
    [1.0, 2.0, 1.0, 0.0, 0.0, 0.0],
    [1.0, 3.0, 3.0, 1.0, 0.0, 0.0],
    [1.0, 4.0, 6.0, 4.0, 1.0, 0.0],
    [1.0, 5.0, 10.0, 10.0, 5.0, 1.0],
];

/// Upper bound over `a..=b` of the curvature of a curve given by three polynomials: the hull of |q' x q''|
/// divided by the cube of the minimum speed in the direction `along`; infinite if that speed may vanish.
pub(crate) fn curvature_bound(curve: &[Quintic; 3], along: Vector3<f64>, a: f64, b: f64) -> f64 {
    let speed = along.norm();
    if !(speed > 0.0) {
        return f64::INFINITY;
    }
    let along = along / speed;
    let columns = |axes: [Quintic; 3]| -> [Vector3<f64>; 6] {
        std::array::from_fn(|i| Vector3::new(axes[0][i], axes[1][i], axes[2][i]))
    };
    let first = columns(curve.map(|c| bernstein(&derivative(&c), a, b)));
    let second = columns(curve.map(|c| bernstein(&derivative(&derivative(&c)), a, b)));
    let min = first
        .iter()
        .map(|point| point.dot(&along))
        .fold(f64::INFINITY, f64::min);
    if !(min > 0.0) {
        return f64::INFINITY;
    }
    // The product of two Bernstein polynomials of degree 5 has degree 10 and the hull property too.
    let mut products = [Vector3::zeros(); 11];
    let mut weights = [0.0; 11];
    for (i, p) in first.iter().enumerate() {
        for (j, q) in second.iter().enumerate() {
            let weight = BINOMIAL[5][i] * BINOMIAL[5][j];
            products[i + j] += p.cross(q) * weight;
            weights[i + j] += weight;
        }
    }
    let bend = products
        .iter()
        .zip(weights)
        .map(|(sum, weight)| sum.norm() / weight)
        .fold(0.0, f64::max);
    bend / (min * min * min)
}
