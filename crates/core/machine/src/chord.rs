//! Chord error of a setpoint cycle on a curved path.
//!
//! Between two setpoints a drive moves approximately along a chord, so on radius `R` it deviates from the
//! path by the sagitta of the chord. Source: V. V. Kombarov, V. F. Sorokin, "Determination of rational CNC
//! control cycle frequency considering limitations of kinematic parameters at high-speed machining",
//! equations (1) to (4), with feed per second instead of per minute. All functions are real-time safe.

/// Error of the chord on a circle of `radius_mm`, in increments: equation (1).
///
/// With `h` half the chord and `r` the radius in increments, (1) is `r - sqrt(r^2 - h^2)`. That form cancels
/// on a fine grid, so it is computed as `h^2 / (r + sqrt(r^2 - h^2))`. A step longer than the diameter has no
/// chord; the function then returns the diameter, an upper bound of the error. An infinite radius (a straight
/// line) has no error. NaN gives NaN.
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
    // (r - h)(r + h) does not cancel where h is close to r.
    half_chord * half_chord / (radius + ((radius - half_chord) * (radius + half_chord)).sqrt())
}

/// The longest step in mm whose chord deviates from a circle of `radius_mm` by at most the permitted error.
///
/// From equation (4): `2 sqrt(D (2 R k - D)) / k` for `R k >= D`, with the permitted error `D` in increments
/// and `k` increments per millimetre. At `R k = D` this chord is the diameter. Below, the root decreases
/// again because it belongs to the major arc; the minor arc deviates by less than its radius, hence by less
/// than `D`, for any chord up to the diameter `2 R`, which is the bound used there (it is continuous at
/// `R k = D`). At `2 R k <= D` the whole circle is within the permitted error and the step is unlimited
/// (infinite).
/// ```
/// // On a radius of 20 mm a step of 0.4 mm deviates from the circle by 1 um: 0.4^2 / (8 20).
/// let chord_mm = evolvent_machine::max_chord_mm(20.0, 1000.0, 1.0);
/// assert!((chord_mm - 0.4).abs() < 1e-4);
/// ```
#[must_use]
pub fn max_chord_mm(radius_mm: f64, increments_per_mm: f64, permitted_error_increments: f64) -> f64 {
    let radius = radius_mm * increments_per_mm;
    let permitted = permitted_error_increments;
    if radius.is_nan() || permitted.is_nan() {
        // NaN must not mean "no limit".
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

/// The feed in mm/s at which the chord error at `rate_hz` reaches the permitted error on a path of the given
/// curvature: equation (4) solved for the feed.
///
/// `curvature_1_mm` may have either sign. The limit is infinite on a straight path and where the circle of
/// curvature is entirely within the permitted error (`R k <= D / 2`). NaN gives 0, the safe value. For radii
/// below the permitted error see [`max_chord_mm`].
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
    // The radius is infinite for zero and subnormal curvature; both count as straight.
    let radius_mm = 1.0 / curvature;
    if radius_mm.is_infinite() {
        return f64::INFINITY;
    }
    rate_hz * max_chord_mm(radius_mm, increments_per_mm, permitted_error_increments)
}

/// The minimum radius in mm on which a step of `chord_mm` deviates from the path by at most the permitted
/// error: [`max_chord_mm`] solved for the radius.
///
/// Zero if the step is admissible on every radius: a chord of at most the permitted error. NaN gives
/// infinity, the safe value.
#[must_use]
pub fn min_radius_for_chord_mm(
    chord_mm: f64,
    increments_per_mm: f64,
    permitted_error_increments: f64,
) -> f64 {
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

/// The control rate in Hz that keeps the chord error at `feed_mm_s` on `radius_mm` within the permitted
/// error: equation (4).
///
/// Zero on a straight path (infinite radius) and where the circle is entirely within the permitted error. NaN
/// gives NaN or infinity, never a rate that looks sufficient.
#[must_use]
pub fn rate_for(
    feed_mm_s: f64,
    radius_mm: f64,
    increments_per_mm: f64,
    permitted_error_increments: f64,
) -> f64 {
    feed_mm_s / max_chord_mm(radius_mm, increments_per_mm, permitted_error_increments)
}

/// The rate in Hz that acceleration alone requires in the limit of large radii (`R k >> D`):
/// `1/2 sqrt(A k / (2 D))`, from (4) and (9).
#[must_use]
pub fn acceleration_rate_hz(
    acceleration_mm_s2: f64,
    increments_per_mm: f64,
    permitted_error_increments: f64,
) -> f64 {
    0.5 * (acceleration_mm_s2 * increments_per_mm / (2.0 * permitted_error_increments)).sqrt()
}

/// Feed in mm/s at which a circle of `radius_mm` needs the entire acceleration limit: `sqrt(R A)`, from (7)
/// and (9).
#[must_use]
pub fn acceleration_feed_mm_s(radius_mm: f64, acceleration_mm_s2: f64) -> f64 {
    (radius_mm * acceleration_mm_s2).sqrt()
}

/// Feed in mm/s at which a circle of `radius_mm` needs the entire jerk limit: `cbrt(J R^2)`, from (10) and
/// (11).
#[must_use]
pub fn jerk_feed_mm_s(radius_mm: f64, jerk_mm_s3: f64) -> f64 {
    libm::cbrt(jerk_mm_s3 * radius_mm * radius_mm)
}
