//! Arcs, helices and involutes.

use super::pen::{Pen, Turn};

/// 999 arcs in a spiral, each an eighth of a turn and a little larger than the last.
pub(crate) fn spiral(pen: &mut Pen) {
    pen.rapid([2.0, 0.0, 0.0]);
    pen.feed(24_000.0);
    let mut centre = [0.0, 0.0];
    for _ in 0..999 {
        // The next centre is on the line to the present point: the arcs are tangent, and their radii grow in
        // steps of 0.25 %.
        let arm = [pen.at[0] - centre[0], pen.at[1] - centre[1]];
        centre = [centre[0] - 0.0025 * arm[0], centre[1] - 0.0025 * arm[1]];
        pen.sweep(Turn::Left, centre, 45.0);
    }
}

/// Nested loops with rounded corners.
pub(crate) fn pocket(pen: &mut Pen) {
    pen.rapid([0.0, -0.5, 2.0]);
    pen.feed(900.0);
    pen.line([0.0, -0.5, -1.0]);
    pen.feed(6_000.0);
    for ring in 1..=10 {
        let (x, y) = (10.0 + 2.0 * f64::from(ring), 2.0 * f64::from(ring));
        let r = 0.5 * f64::from(ring);
        let z = -1.0;
        pen.line([0.0, -y, z]);
        pen.line([x - r, -y, z]);
        pen.sweep(Turn::Left, [x - r, -y + r], 90.0);
        pen.line([x, y - r, z]);
        pen.sweep(Turn::Left, [x - r, y - r], 90.0);
        pen.line([-x + r, y, z]);
        pen.sweep(Turn::Left, [-x + r, y - r], 90.0);
        pen.line([-x, -y + r, z]);
        pen.sweep(Turn::Left, [-x + r, -y + r], 90.0);
        pen.line([0.0, -y, z]);
    }
    pen.rapid([0.0, 0.0, 2.0]);
}

/// Slots with round ends from 0.25 to 10 mm radius: line, arc, line, arc, every joint tangent.
pub(crate) fn slots(pen: &mut Pen) {
    pen.feed(12_000.0);
    let mut y = 0.0;
    for radius in [0.25, 0.5, 1.0, 2.5, 5.0, 10.0] {
        pen.rapid([0.0, y, 0.0]);
        for _ in 0..2 {
            pen.line([15.0, y, 0.0]);
            pen.sweep(Turn::Left, [15.0, y + radius], 180.0);
            pen.line([0.0, y + 2.0 * radius, 0.0]);
            pen.sweep(Turn::Left, [0.0, y + radius], 180.0);
        }
        y += 2.0 * radius + 1.0;
    }
}

/// Full circles of 0.25 to 50 mm radius, reached over tangent lines.
pub(crate) fn circles(pen: &mut Pen) {
    pen.feed(12_000.0);
    for radius in [0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 25.0, 50.0] {
        pen.rapid([0.0, 0.0, 0.0]);
        pen.line([5.0, 0.0, 0.0]);
        pen.arc(Turn::Left, [5.0, 0.0, 0.0], [5.0, radius]);
        pen.line([10.0, 0.0, 0.0]);
    }
}

/// Helices of many turns in all three planes, and one that tapers.
pub(crate) fn helices(pen: &mut Pen) {
    pen.feed(9_000.0);
    pen.rapid([6.0, 0.0, 0.0]);
    pen.raw("G3 X6 Y0 Z-10 I-6 J0 P10", [6.0, 0.0, -10.0]);
    pen.line([6.0, 3.0, -10.0]);
    pen.raw("G18 G2 X6 Y11 Z-10 I-4 K0 P8", [6.0, 11.0, -10.0]);
    pen.line([8.0, 11.0, -10.0]);
    pen.raw("G19 G3 X16 Y11 Z-10 J0 K3 P8", [16.0, 11.0, -10.0]);
    pen.raw("G17", [16.0, 11.0, -10.0]);
    for turn in 0..12 {
        // Half turns, each a little smaller and deeper.
        let radius = 5.0 - 0.3 * f64::from(turn);
        let sign = if turn % 2 == 0 { -1.0 } else { 1.0 };
        let [x, y, z] = pen.at;
        let next = [x + sign * 2.0 * radius, y, z - 0.4];
        pen.arc(Turn::Left, next, [x + sign * radius, y]);
    }
    pen.rapid([0.0, 0.0, 5.0]);
}

/// A hole milled like that of `evolvent bore`: out along an involute from its base circle, one full turn, and
/// in again.
pub(crate) fn bore(pen: &mut Pen) {
    pen.feed(12_000.0);
    for (base, turns) in [(0.5, 6.0), (0.15, 10.25), (2.0, 1.5)] {
        let roll = std::f64::consts::TAU * turns;
        let (sin, cos) = libm::sincos(roll);
        // The end of the unwound thread, relative to the centre.
        let out = [base * (cos + roll * sin), base * (sin - roll * cos)];
        pen.rapid([base, 0.0, 0.0]);
        pen.involute(Turn::Left, out, [0.0, 0.0], base);
        pen.raw(
            &format!(
                "G3 X{:.12} Y{:.12} I{:.12} J{:.12}",
                out[0], out[1], -out[0], -out[1]
            ),
            [out[0], out[1], 0.0],
        );
        // In along the mirrored involute, so that the rotation continues.
        let angle = libm::atan2(out[1], out[0]) + roll - libm::atan(roll);
        let (sin, cos) = libm::sincos(angle);
        pen.involute(Turn::Left, [base * cos, base * sin], [0.0, 0.0], base);
    }
}
