//! Cubic B-splines on non-uniform knots.

/// Value and three derivatives, at the left knot of an interval, of the four basis functions that are
/// non-zero on it: `[function][order]`.
pub(crate) type Basis = [[f64; 4]; 4];

/// The basis on the interval from `t[2]` to `t[3]`, which must not be empty, from the six knots around it.
///
/// Computed by blossoming: each function is the spline whose control point is 1 for itself and 0 for the
/// others, and its derivatives are splines of lower degree over divided differences (de Boor, "A Practical
/// Guide to Splines", chapter X, equations (15) and (16)).
pub(crate) fn basis(t: &[f64; 6]) -> Basis {
    let [t0, t1, t2, t3, t4, t5] = *t;
    let whole = [1.0 / (t3 - t0), 1.0 / (t4 - t1), 1.0 / (t5 - t2)];
    let half = [1.0 / (t3 - t1), 1.0 / (t4 - t2)];
    let step = 1.0 / (t3 - t2);
    // Weights of a triple insertion of t2.
    let (near, far0, far1) = ((t2 - t1) * half[0], (t2 - t0) * whole[0], (t2 - t1) * whole[1]);
    let mut functions = [[0.0; 4]; 4];
    for (l, function) in functions.iter_mut().enumerate() {
        let mut p = [0.0; 4];
        p[l] = 1.0;
        let first: [f64; 3] = std::array::from_fn(|k| 3.0 * (p[k + 1] - p[k]) * whole[k]);
        let second: [f64; 2] = std::array::from_fn(|k| 2.0 * (first[k + 1] - first[k]) * half[k]);
        let (e0, e1) = (p[0] + far0 * (p[1] - p[0]), p[1] + far1 * (p[2] - p[1]));
        *function = [
            e0 + near * (e1 - e0),
            first[0] + near * (first[1] - first[0]),
            second[0],
            (second[1] - second[0]) * step,
        ];
    }
    functions
}

/// The values of the four functions at `x` from the left knot.
pub(crate) fn values(basis: &Basis, x: f64) -> [f64; 4] {
    basis.map(|[value, first, second, third]| value + x * (first + x * (0.5 * second + x * third / 6.0)))
}

/// Their second derivatives.
pub(crate) fn second_derivatives(basis: &Basis, x: f64) -> [f64; 4] {
    basis.map(|[_, _, second, third]| second + x * third)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The Cox-de Boor recursion by definition.
    fn recursion(t: &[f64], j: usize, degree: usize, x: f64) -> f64 {
        if degree == 0 {
            return f64::from(u8::from(t[j] <= x && x < t[j + 1]));
        }
        let part = |a: f64, b: f64, y: f64| if b > a { y * (x - a) / (b - a) } else { 0.0 };
        let rest = |a: f64, b: f64, y: f64| if b > a { y * (b - x) / (b - a) } else { 0.0 };
        part(t[j], t[j + degree], recursion(t, j, degree - 1, x))
            + rest(t[j + 1], t[j + degree + 1], recursion(t, j + 1, degree - 1, x))
    }

    #[test]
    fn values_agree_with_the_cox_de_boor_recursion() {
        for t in [
            [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0],
            [-4.0, -1.0, 0.3, 0.5, 0.6, 2.0, 9.0, 9.5],
            [0.0, 0.0, 0.0, 0.0, 0.1, 3.0, 4.0, 5.0],
            [-1.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0],
        ] {
            let i = 3;
            let six = [t[1], t[2], t[3], t[4], t[5], t[6]];
            let basis = basis(&six);
            for k in 0..8 {
                let x = (t[i + 1] - t[i]) * f64::from(k) / 8.0;
                for (l, value) in values(&basis, x).into_iter().enumerate() {
                    let expected = recursion(&t, l, 3, t[i] + x);
                    assert!(
                        (value - expected).abs() < 1e-14,
                        "{t:?} {l} {x}: {value} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn cubics_are_reproduced_by_blossoming() {
        // The control point of u^3 is the product of its three knots, of u^2 the mean of the pairs' products.
        let t = [-2.0, -0.5, 0.25, 1.0, 1.5, 4.0];
        let basis = basis(&t);
        for k in 0..=4 {
            let x = 0.75 * f64::from(k) / 4.0;
            let u = t[2] + x;
            let (mut cube, mut square) = (0.0, [0.0; 2]);
            for l in 0..4 {
                let (a, b, c) = if l < 3 {
                    (t[l], t[l + 1], t[l + 2])
                } else {
                    (t[3], t[4], t[5])
                };
                cube += values(&basis, x)[l] * a * b * c;
                let pairs = (a * b + b * c + c * a) / 3.0;
                square[0] += values(&basis, x)[l] * pairs;
                square[1] += second_derivatives(&basis, x)[l] * pairs;
            }
            assert!((cube - u * u * u).abs() < 1e-13);
            assert!((square[0] - u * u).abs() < 1e-14 && (square[1] - 2.0).abs() < 1e-13);
        }
    }
}
