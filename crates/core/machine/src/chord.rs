//! Chord error: what a setpoint cycle of a given length costs on a curved path.
//!
//! Between two setpoints a drive moves (nearly) along a chord, so on radius `R` the path is missed by the sagitta of
//! the chord. Source: V. V. Kombarov, V. F. Sorokin, "Determination of rational CNC control cycle frequency considering
//! limitations of kinematic parameters at high-speed machining", equations (1) to (4); there the feed is per minute,
//! here everything is in millimetres and seconds. Nothing here allocates: planner and cycle may call all of it.

/// Error of the chord on a circle of `radius_mm`, in increments: equation (1).
///
/// With `h` half the chord and `r` the radius, both in increments, (1) is `r - sqrt(r^2 - h^2)`. That form loses all
/// digits when the grid is fine, so it is computed as `h^2 / (r + sqrt(r^2 - h^2))`. A step that is longer than the
/// diameter has no chord; the error is then bounded by the diameter, which is what is returned. An infinite radius (a
/// straight line) has no error. NaN in gives NaN out.
#[must_use]
pub fn chord_error_increments(feed_mm_s: f64, rate_hz: f64, radius_mm: f64, increments_per_mm: f64) -> f64 {
    let half_chord = feed_mm_s * increments_per_mm / (2.0 * rate_hz);
    let radius = radius_mm * increments_per_mm;
    if half_chord.is_nan() || radius.is_nan() {
        return f64::NAN;
    }
    if radius.is_infinite() {
        return 0.0;
    }
    if half_chord > radius {
        return 2.0 * radius;
    }
    // (r - h)(r + h) keeps its digits where h is close to r.
    half_chord * half_chord / (radius + ((radius - half_chord) * (radius + half_chord)).sqrt())
}

/// The longest step, in millimetres, whose chord misses a circle of `radius_mm` by no more than the permitted error.
///
/// From equation (4): `2 sqrt(D (2 R k - D)) / k` for `R k >= D`, with `D` the permitted error in increments and `k`
/// the increments per millimetre. At `R k = D` that chord is the diameter. Below, the printed root shrinks again,
/// because it belongs to the arc that is longer than half a turn; the shorter arc misses by less than its radius, hence
/// by less than `D`, for any chord up to the diameter `2 R`: that is the bound here, continuous with the other.
/// At `2 R k <= D` the whole circle lies within the permitted error and the step is not limited (infinite).
/// ```
/// // On a radius of 20 mm a step of 0.4 mm misses the circle by 1 um: 0.4^2 / (8 20).
/// let chord_mm = evolvent_machine::longest_chord_mm(20.0, 1000.0, 1.0);
/// assert!((chord_mm - 0.4).abs() < 1e-4);
/// ```
#[must_use]
pub fn longest_chord_mm(radius_mm: f64, increments_per_mm: f64, permitted_error_increments: f64) -> f64 {
    let radius = radius_mm * increments_per_mm;
    let permitted = permitted_error_increments;
    if radius.is_nan() || permitted.is_nan() {
        // A limit that cannot be computed must not read as "no limit".
        return 0.0;
    }
    if 2.0 * radius <= permitted {
        f64::INFINITY
    } else if radius <= permitted {
        2.0 * radius_mm
    } else {
        2.0 * (permitted * (2.0 * radius - permitted)).sqrt() / increments_per_mm
    }
}

/// The feed, in mm/s, at which the chord error at `rate_hz` reaches the permitted error on a path of the given
/// curvature: equation (4) solved for the feed.
///
/// `curvature_1_mm` may have either sign. The limit is infinite on a straight path and where the circle of curvature
/// lies within the permitted error altogether (`R k <= D / 2`). NaN anywhere gives zero: the safe side. See
/// [`longest_chord_mm`] for radii below the permitted error.
#[must_use]
pub fn chord_feed_limit_mm_s(
    rate_hz: f64,
    curvature_1_mm: f64,
    increments_per_mm: f64,
    permitted_error_increments: f64,
) -> f64 {
    let curvature = curvature_1_mm.abs();
    if curvature.is_nan() || rate_hz.is_nan() {
        return 0.0;
    }
    // The radius overflows to infinity for curvature zero and for subnormal ones: straight, both.
    let radius_mm = 1.0 / curvature;
    if radius_mm.is_infinite() {
        return f64::INFINITY;
    }
    rate_hz * longest_chord_mm(radius_mm, increments_per_mm, permitted_error_increments)
}

/// The smallest radius, in mm, on which a step of `chord_mm` misses the path by no more than the permitted error:
/// [`longest_chord_mm`] solved for the radius.
///
/// Zero where the step fits on every radius: a chord of at most the permitted error. NaN in gives infinity: no radius is
/// large enough for a step that is not known.
#[must_use]
pub fn smallest_radius_mm(chord_mm: f64, increments_per_mm: f64, permitted_error_increments: f64) -> f64 {
    let half_chord = 0.5 * chord_mm * increments_per_mm;
    let permitted = permitted_error_increments;
    if half_chord.is_nan() || permitted.is_nan() {
        return f64::INFINITY;
    }
    if half_chord >= permitted {
        0.5 * (half_chord * half_chord / permitted + permitted) / increments_per_mm
    } else if half_chord > 0.5 * permitted {
        half_chord / increments_per_mm
    } else {
        0.0
    }
}

/// The control rate, in Hz, that keeps the chord error at `feed_mm_s` on `radius_mm` within the permitted error:
/// equation (4).
///
/// Zero on a straight path (infinite radius) and where the circle lies within the permitted error altogether.
/// NaN in gives NaN or infinity out, never a rate that looks sufficient.
#[must_use]
pub fn rate_for(
    feed_mm_s: f64,
    radius_mm: f64,
    increments_per_mm: f64,
    permitted_error_increments: f64,
) -> f64 {
    feed_mm_s / longest_chord_mm(radius_mm, increments_per_mm, permitted_error_increments)
}

/// The rate, in Hz, towards which acceleration alone drives a machine, whatever the radius, for `R k >> D`:
/// `1/2 sqrt(A k / (2 D))`, from (4) and (9).
#[must_use]
pub fn acceleration_rate_hz(
    acceleration_mm_s2: f64,
    increments_per_mm: f64,
    permitted_error_increments: f64,
) -> f64 {
    0.5 * (acceleration_mm_s2 * increments_per_mm / (2.0 * permitted_error_increments)).sqrt()
}

/// Feed, in mm/s, at which a circle of `radius_mm` takes the whole acceleration: `sqrt(R A)`, from (7) and (9).
#[must_use]
pub fn acceleration_feed_mm_s(radius_mm: f64, acceleration_mm_s2: f64) -> f64 {
    (radius_mm * acceleration_mm_s2).sqrt()
}

/// Feed, in mm/s, at which a circle of `radius_mm` takes the whole jerk: `cbrt(J R^2)`, from (10) and (11).
#[must_use]
pub fn jerk_feed_mm_s(radius_mm: f64, jerk_mm_s3: f64) -> f64 {
    libm::cbrt(jerk_mm_s3 * radius_mm * radius_mm)
}
