//! The butterfly: a rational cubic with small radii and near-cusps, known from papers on NURBS interpolation.

use super::pen::Pen;

const POINTS: [[f64; 2]; 51] = [
    [54.493, 52.139],
    [55.507, 52.139],
    [56.082, 49.615],
    [56.780, 44.971],
    [69.575, 51.358],
    [77.786, 58.573],
    [90.526, 67.081],
    [105.973, 63.801],
    [100.400, 47.326],
    [94.567, 39.913],
    [92.369, 30.485],
    [83.440, 33.757],
    [91.892, 28.509],
    [89.444, 20.393],
    [83.218, 15.446],
    [87.621, 4.830],
    [80.945, 9.267],
    [79.834, 14.535],
    [76.074, 8.522],
    [70.183, 12.550],
    [64.171, 16.865],
    [59.993, 22.122],
    [55.680, 36.359],
    [56.925, 24.995],
    [59.765, 19.828],
    [54.493, 14.940],
    [49.220, 19.828],
    [52.060, 24.994],
    [53.305, 36.359],
    [48.992, 22.122],
    [44.814, 16.865],
    [38.802, 12.551],
    [32.911, 8.521],
    [29.152, 14.535],
    [28.040, 9.267],
    [21.364, 4.830],
    [25.768, 15.447],
    [19.539, 20.391],
    [17.097, 28.512],
    [25.537, 33.750],
    [16.602, 30.496],
    [14.199, 39.803],
    [8.668, 47.408],
    [3.000, 63.794],
    [18.465, 67.084],
    [31.197, 58.572],
    [39.411, 51.358],
    [52.204, 44.971],
    [52.904, 49.614],
    [53.478, 52.139],
    [54.492, 52.139],
];

/// Between four zeros and four ones.
const KNOTS: [f64; 47] = [
    0.0083, 0.015, 0.0361, 0.0855, 0.1293, 0.1509, 0.1931, 0.2273, 0.2435, 0.2561, 0.2692, 0.2889, 0.3170,
    0.3316, 0.3482, 0.3553, 0.3649, 0.3837, 0.4005, 0.4269, 0.4510, 0.4660, 0.4891, 0.5, 0.5109, 0.5340,
    0.5489, 0.5731, 0.5994, 0.6163, 0.6351, 0.6447, 0.6518, 0.6683, 0.6830, 0.7111, 0.7307, 0.7439, 0.7565,
    0.7729, 0.8069, 0.8491, 0.8707, 0.9145, 0.9639, 0.9850, 0.9917,
];

/// Weights that are not 1.
const WEIGHTS: [(usize, f64); 9] = [
    (3, 1.2),
    (11, 2.0),
    (14, 5.0),
    (15, 3.0),
    (17, 1.1),
    (33, 1.1),
    (35, 3.0),
    (36, 5.0),
    (39, 2.0),
];

/// The last of them.
const LAST_WEIGHT: (usize, f64) = (47, 1.2);

fn knot(index: usize) -> f64 {
    match index {
        0..=3 => 0.0,
        _ => KNOTS.get(index - 4).copied().unwrap_or(1.0),
    }
}

fn weight(index: usize) -> f64 {
    WEIGHTS
        .iter()
        .chain(&[LAST_WEIGHT])
        .find(|(known, _)| *known == index)
        .map_or(1.0, |(_, weight)| *weight)
}

/// A point of the curve at the parameter `t` from 0 to 1, mm: de Boor's algorithm in homogeneous coordinates.
#[must_use]
pub fn butterfly_point(t: f64) -> [f64; 2] {
    let t = t.clamp(0.0, 1.0);
    // The knot interval: the last non-empty one that begins at or before t.
    let mut span = 3;
    while span < POINTS.len() - 1 && knot(span + 1) <= t {
        span += 1;
    }
    let mut points = [[0.0; 3]; 4];
    for (j, point) in points.iter_mut().enumerate() {
        let index = span - 3 + j;
        let w = weight(index);
        *point = [POINTS[index][0] * w, POINTS[index][1] * w, w];
    }
    for level in 1..=3 {
        for j in (level..=3).rev() {
            let index = span - 3 + j;
            let (low, high) = (knot(index), knot(index + 4 - level));
            let fraction = if high > low { (t - low) / (high - low) } else { 0.0 };
            for k in 0..3 {
                points[j][k] = points[j - 1][k] * (1.0 - fraction) + points[j][k] * fraction;
            }
        }
    }
    let [x, y, w] = points[3];
    [x / w, y / w]
}

/// Draws the curve in chords of equal parameter steps, at 12 000 mm/min, centred on the middle of the body.
pub(crate) fn butterfly(pen: &mut Pen, chords: usize) {
    pen.say(&format!("the butterfly in {chords} chords"));
    let point = |i: usize| {
        let [x, y] = butterfly_point(i as f64 / chords as f64);
        [x - 54.493, y - 36.0, 0.0]
    };
    pen.rapid(point(0));
    pen.feed(12_000.0);
    for i in 1..=chords {
        pen.line(point(i));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The Cox-de Boor recursion, literally.
    fn basis(index: usize, degree: usize, t: f64) -> f64 {
        if degree == 0 {
            let inside = knot(index) <= t && t < knot(index + 1);
            return f64::from(u8::from(inside));
        }
        let ratio = |from: f64, to: f64, value: f64| if to > from { value / (to - from) } else { 0.0 };
        ratio(knot(index), knot(index + degree), t - knot(index)) * basis(index, degree - 1, t)
            + ratio(
                knot(index + 1),
                knot(index + degree + 1),
                knot(index + degree + 1) - t,
            ) * basis(index + 1, degree - 1, t)
    }

    #[test]
    fn the_curve_is_the_rational_sum_over_its_basis() {
        for i in 0..1000 {
            let t = f64::from(i) / 1000.0;
            let (mut x, mut y, mut w) = (0.0, 0.0, 0.0);
            for (index, point) in POINTS.iter().enumerate() {
                let fraction = basis(index, 3, t) * weight(index);
                x += fraction * point[0];
                y += fraction * point[1];
                w += fraction;
            }
            let [met_x, met_y] = butterfly_point(t);
            assert!(
                (x / w - met_x).abs() < 1e-10 && (y / w - met_y).abs() < 1e-10,
                "{t}"
            );
        }
    }

    #[test]
    fn the_butterfly_is_symmetric() {
        assert_eq!(butterfly_point(0.0), POINTS[0]);
        assert_eq!(butterfly_point(1.0), POINTS[50]);
        // The published values have few digits, and the wings differ by as much.
        for i in 1..50 {
            let t = f64::from(i) / 100.0;
            let ([x, y], [mirror_x, mirror_y]) = (butterfly_point(t), butterfly_point(1.0 - t));
            assert!((x + mirror_x - 2.0 * 54.493).abs() < 1.5, "{t}: {x} {mirror_x}");
            assert!((y - mirror_y).abs() < 1.5, "{t}: {y} {mirror_y}");
        }
    }
}
