//! How far apart two places of nine axes are.

use evolvent_path::Axes;

/// Distance in XYZ and distance in UVW, whichever is greater, in mm.
pub(crate) fn linear(gap: &Axes) -> f64 {
    norm(gap[0], gap[1], gap[2]).max(norm(gap[6], gap[7], gap[8]))
}

/// The greatest angle by which a rotary axis is off, in degrees.
pub(crate) fn rotary(gap: &Axes) -> f64 {
    gap[3].abs().max(gap[4].abs()).max(gap[5].abs())
}

/// What a tolerance is compared with: mm of XYZ, mm of UVW and degrees of each rotary axis alike.
pub(crate) fn distance(a: &Axes, b: &Axes) -> f64 {
    let gap = a - b;
    linear(&gap).max(rotary(&gap))
}

/// Distance of a point from a straight stretch.
pub(crate) fn from_stretch(point: &Axes, from: &Axes, to: &Axes) -> f64 {
    let along = to - from;
    let square = along.dot(&along);
    let share = if square > 0.0 {
        ((point - from).dot(&along) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    distance(point, &(from + along * share))
}

fn norm(x: f64, y: f64, z: f64) -> f64 {
    (x * x + y * y + z * z).sqrt()
}
