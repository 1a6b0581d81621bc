//! Lines between true corners.

use evolvent_random::Random;

use super::pen::{Pen, Turn};

/// Corners of every angle between lines of 0.2 to 20 mm.
pub(crate) fn corners(pen: &mut Pen) {
    pen.feed(12_000.0);
    for length in [20.0, 5.0, 1.0, 0.2] {
        let mut heading: f64 = 0.0;
        for turn in [
            90.0, -90.0, 45.0, 135.0, -170.0, 5.0, 179.0, -30.0, 120.0, -150.0, 1.0, 180.0,
        ] {
            heading += turn;
            let (sin, cos) = libm::sincos(heading.to_radians());
            pen.by([length * cos, length * sin, 0.0]);
        }
    }
}

/// Squares of sides from 10 um to 10 mm, each twice round.
pub(crate) fn squares(pen: &mut Pen) {
    pen.feed(6_000.0);
    for side in [10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01] {
        for _ in 0..2 {
            pen.by([side, 0.0, 0.0]);
            pen.by([0.0, side, 0.0]);
            pen.by([-side, 0.0, 0.0]);
            pen.by([0.0, -side, 0.0]);
        }
        pen.by([1.0, 0.5, 0.0]);
    }
}

/// Letters engraved with lines and arcs, lifted between strokes.
pub(crate) fn letters(pen: &mut Pen) {
    let stroke = |pen: &mut Pen, points: &[[f64; 2]]| {
        pen.rapid([points[0][0], points[0][1], 2.0]);
        pen.feed(600.0);
        pen.line([points[0][0], points[0][1], -0.3]);
        pen.feed(2400.0);
        for point in &points[1..] {
            pen.line([point[0], point[1], -0.3]);
        }
        pen.rapid([pen.at[0], pen.at[1], 2.0]);
    };
    for line in 0..2 {
        let y = -14.0 * f64::from(line);
        stroke(
            pen,
            &[
                [0.0, y],
                [0.0, y + 10.0],
                [4.0, y + 4.0],
                [8.0, y + 10.0],
                [8.0, y],
            ],
        );
        stroke(pen, &[[11.0, y], [11.0, y + 10.0]]);
        stroke(pen, &[[14.0, y + 10.0], [14.0, y], [19.0, y]]);
        stroke(pen, &[[22.0, y], [22.0, y + 10.0]]);
        stroke(pen, &[[22.0, y + 5.0], [27.0, y + 10.0]]);
        stroke(pen, &[[23.5, y + 6.5], [27.0, y]]);
        // O and S.
        pen.rapid([34.0, y + 10.0, 2.0]);
        pen.feed(600.0);
        pen.line([34.0, y + 10.0, -0.3]);
        pen.feed(2400.0);
        pen.sweep(Turn::Left, [34.0, y + 6.0], 90.0);
        pen.line([30.0, y + 4.0, -0.3]);
        pen.sweep(Turn::Left, [34.0, y + 4.0], 180.0);
        pen.line([38.0, y + 6.0, -0.3]);
        pen.sweep(Turn::Left, [34.0, y + 6.0], 90.0);
        pen.rapid([34.0, y + 10.0, 2.0]);
        pen.rapid([47.0, y + 7.5, 2.0]);
        pen.feed(600.0);
        pen.line([47.0, y + 7.5, -0.3]);
        pen.feed(2400.0);
        pen.sweep(Turn::Left, [44.5, y + 7.5], 270.0);
        pen.sweep(Turn::Right, [44.5, y + 2.5], 270.0);
        pen.rapid([pen.at[0], pen.at[1], 2.0]);
    }
    pen.rapid([0.0, 0.0, 5.0]);
}

/// Moves from 1 um to 5 mm, lengths evenly spread over the decades, in every direction.
pub(crate) fn tiny(pen: &mut Pen) {
    let mut random = Random::from_state(0x5eed_0003 | 1);
    pen.feed(12_000.0);
    for _ in 0..600 {
        let length = libm::exp(random.between(libm::log(0.001), libm::log(5.0)));
        let up = random.between(-1.0, 1.0);
        let (sin, cos) = libm::sincos(random.between(0.0, std::f64::consts::TAU));
        let flat = (1.0 - up * up).sqrt();
        pen.by([length * flat * cos, length * flat * sin, length * up]);
    }
}

/// Rapids and plunges: a plate of holes.
pub(crate) fn rapids(pen: &mut Pen) {
    pen.rapid([0.0, 0.0, 5.0]);
    for row in 0..4 {
        for column in 0..6 {
            let column = if row % 2 == 0 { column } else { 5 - column };
            let (x, y) = (12.0 * f64::from(column), 12.0 * f64::from(row));
            pen.rapid([x, y, 5.0]);
            pen.rapid([x, y, 1.0]);
            pen.feed(3000.0);
            pen.line([x, y, -4.0]);
            pen.rapid([x, y, 5.0]);
        }
    }
    pen.rapid([0.0, 0.0, 20.0]);
}
