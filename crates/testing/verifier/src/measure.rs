//! Distances between positions of nine axes.

use evolvent_path::Axes;

/// The greater of the distances in XYZ and in UVW, mm.
pub(crate) fn linear(gap: &Axes) -> f64 {
    norm(gap[0], gap[1], gap[2]).max(norm(gap[6], gap[7], gap[8]))
}

/// The greatest difference of a rotary axis, degrees.
pub(crate) fn rotary(gap: &Axes) -> f64 {
    gap[3].abs().max(gap[4].abs()).max(gap[5].abs())
}

/// The distance that is compared with tolerances: the greatest of mm in XYZ, mm in UVW and degrees of each
/// rotary axis.
pub(crate) fn distance(a: &Axes, b: &Axes) -> f64 {
    let gap = a - b;
    linear(&gap).max(rotary(&gap))
}

/// Distance of a point from a line segment.
pub(crate) fn from_stretch(point: &Axes, from: &Axes, to: &Axes) -> f64 {
    let along = to - from;
    let square = along.dot(&along);
    let fraction = if square > 0.0 {
        ((point - from).dot(&along) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    distance(point, &(from + along * fraction))
}

fn norm(x: f64, y: f64, z: f64) -> f64 {
    (x * x + y * y + z * z).sqrt()
}
