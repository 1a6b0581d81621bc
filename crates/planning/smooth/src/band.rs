//! Symmetric banded linear systems.

/// Solves `A x = b` for a symmetric positive definite matrix by an `L D L'` factorisation. The lower half of
/// the matrix is stored by columns, entry `(r, c)` at `c * band + r - c`. `vector` holds `b` on entry and `x`
/// on return. Matrix and vector have `band` additional columns of zeros after `size`.
///
/// A pivot that is not positive, as rounding leaves it for an undetermined unknown, sets that unknown to
/// zero.
pub(crate) fn solve(matrix: &mut [f64], vector: &mut [f64], size: usize, band: usize) {
    for x in &mut vector[size..] {
        *x = 0.0;
    }
    for r in 0..size {
        let (head, tail) = matrix.split_at_mut((r + 1) * band);
        let pivot = &mut head[r * band..];
        let inverse = if pivot[0] > 1e-200 { 1.0 / pivot[0] } else { 0.0 };
        pivot[0] = inverse;
        let value = vector[r];
        for j in 1..band {
            let factor = pivot[j] * inverse;
            if factor == 0.0 {
                continue;
            }
            let column = &mut tail[(j - 1) * band..(j - 1) * band + band - j];
            for (entry, p) in column.iter_mut().zip(&pivot[j..band]) {
                *entry -= factor * p;
            }
            vector[r + j] -= factor * value;
        }
    }
    for r in (0..size).rev() {
        let pivot = &matrix[r * band..(r + 1) * band];
        let known = &vector[r + 1..r + band];
        let sum: f64 = pivot[1..].iter().zip(known).map(|(p, x)| p * x).sum();
        vector[r] = (vector[r] - sum) * pivot[0];
    }
    for x in &mut vector[size..] {
        *x = 0.0;
    }
}
