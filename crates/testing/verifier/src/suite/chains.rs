//! Chains of short lines, as CAM systems write them.

use std::f64::consts::TAU;

use evolvent_random::Random;

use super::pen::Pen;

/// A circle of 25 mm radius in a number of chords.
pub(crate) fn circle(pen: &mut Pen, chords: usize) {
    pen.rapid([25.0, 0.0, 0.0]);
    pen.feed(12_000.0);
    for i in 1..=chords {
        let (sin, cos) = libm::sincos(TAU * i as f64 / chords as f64);
        pen.line([25.0 * cos, 25.0 * sin, 0.0]);
    }
}

/// Straight runs of 25 um segments, stairs of 25 um, and folds: out and back by 25 um to 1 mm.
pub(crate) fn folded(pen: &mut Pen) {
    pen.feed(24_000.0);
    pen.line([0.025, 0.0, 0.0]);
    for _ in 0..1000 {
        pen.by([0.025, 0.0, 0.0]);
    }
    for _ in 0..1000 {
        pen.by([0.0, 0.025, 0.0]);
    }
    for _ in 0..400 {
        pen.by([-0.025, 0.0, 0.0]);
        pen.by([0.0, -0.025, 0.0]);
    }
    for segments in [1, 4, 40] {
        for _ in 0..8 {
            for _ in 0..segments {
                pen.by([-0.025, 0.0, 0.0]);
            }
            for _ in 0..segments {
                pen.by([0.025, 0.0, 0.0]);
            }
        }
    }
}

/// A wandering line of 1 um steps with noise of its own size.
pub(crate) fn noise(pen: &mut Pen) {
    let mut random = Random::from_state(0x5eed_0001 | 1);
    pen.rapid([-2.5, 0.0, 0.0]);
    pen.feed(24_000.0);
    pen.line([0.0, 0.0, 0.0]);
    let mut angle: f64 = 0.0;
    let (mut x, mut y, mut z) = (0.0, 0.0, 0.0);
    for _ in 0..4000 {
        angle += random.between(-0.06, 0.06);
        let (sin, cos) = libm::sincos(angle);
        x += 0.001 * cos;
        y += 0.001 * sin;
        z += 0.0002 * random.between(-1.0, 1.0);
        let mut off = || 0.0007 * random.between(-1.0, 1.0);
        let point = [x + off(), y + off(), z + off()];
        pen.line(point);
    }
    pen.by([2.0, 1.0, 0.0]);
}

/// Raster over hills with a ripple, forth and back, chords of 0.05 to 0.2 mm.
pub(crate) fn relief(pen: &mut Pen) {
    let hills = [(8.0, 5.0, 3.0, 3.5), (21.0, 8.0, 2.0, 2.0), (15.0, 2.0, 1.2, 1.5)];
    let height = |x: f64, y: f64| {
        let ripple = 0.15 * libm::sin(1.9 * x) * libm::cos(1.1 * y);
        hills.iter().fold(ripple, |z, (cx, cy, top, width)| {
            let square = ((x - cx) * (x - cx) + (y - cy) * (y - cy)) / (width * width);
            z + top * libm::exp(-square)
        })
    };
    let mut random = Random::from_state(0x5eed_0002 | 1);
    pen.rapid([0.0, 0.0, height(0.0, 0.0)]);
    pen.feed(12_000.0);
    for pass in 0..21 {
        let y = 0.5 * f64::from(pass);
        let forth = pass % 2 == 0;
        let mut along = 0.0;
        while along < 30.0 {
            let x = if forth { along } else { 30.0 - along };
            pen.line([x, y, height(x, y)]);
            along += random.between(0.05, 0.2);
        }
        let x = if forth { 30.0 } else { 0.0 };
        pen.line([x, y, height(x, y)]);
    }
}
