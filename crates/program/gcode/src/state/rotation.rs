//! The rotation of a work coordinate system about Z.

use evolvent_path::Axes;

/// Angle in degrees, its cosine and sine. Exact where it is 0.
pub(crate) type Rotation = [f64; 3];

pub(crate) fn rotation_of(degrees: f64) -> Rotation {
    if degrees == 0.0 {
        return [degrees, 1.0, 0.0];
    }
    let angle = degrees.to_radians();
    [degrees, libm::cos(angle), libm::sin(angle)]
}

/// Converts a vector from program to machine coordinates.
pub(crate) fn rotate([degrees, cos, sin]: Rotation, mut vector: Axes) -> Axes {
    if degrees != 0.0 {
        (vector[0], vector[1]) = (
            cos * vector[0] - sin * vector[1],
            sin * vector[0] + cos * vector[1],
        );
    }
    vector
}

/// Converts a vector from machine to program coordinates.
pub(crate) fn rotate_back([degrees, cos, sin]: Rotation, mut vector: Axes) -> Axes {
    if degrees != 0.0 {
        (vector[0], vector[1]) = (
            cos * vector[0] + sin * vector[1],
            cos * vector[1] - sin * vector[0],
        );
    }
    vector
}
