//! Small dense linear systems, solved in place.

/// Solves `matrix x = rhs` by Gaussian elimination with partial pivoting, for `COLUMNS` right-hand sides
/// stored by rows. Both are overwritten, `rhs` with the solution. False if the matrix is singular.
///
/// Maps of chatter spend much of their time here: the loops run over slices, so that they are vectorized.
pub(crate) fn solve<const COLUMNS: usize>(matrix: &mut [f64], rhs: &mut [f64], size: usize) -> bool {
    debug_assert!(matrix.len() == size * size && rhs.len() == size * COLUMNS);
    for step in 0..size {
        let mut pivot = step;
        let mut largest = matrix[step * size + step].abs();
        for row in step + 1..size {
            let here = matrix[row * size + step].abs();
            if here > largest {
                (pivot, largest) = (row, here);
            }
        }
        let value = matrix[pivot * size + step];
        if !(value.is_finite() && value != 0.0) {
            return false;
        }
        if pivot != step {
            let (above, below) = matrix.split_at_mut(pivot * size);
            above[step * size + step..(step + 1) * size].swap_with_slice(&mut below[step..size]);
            for k in 0..COLUMNS {
                rhs.swap(step * COLUMNS + k, pivot * COLUMNS + k);
            }
        }
        let (above, below) = matrix.split_at_mut((step + 1) * size);
        let source = &above[step * size + step + 1..];
        let (rhs_above, rhs_below) = rhs.split_at_mut((step + 1) * COLUMNS);
        let rhs_source = &rhs_above[step * COLUMNS..];
        for (row, rhs_row) in below
            .chunks_exact_mut(size)
            .zip(rhs_below.chunks_exact_mut(COLUMNS))
        {
            let (first, rest) = row[step..].split_at_mut(1);
            let factor = first[0] / value;
            if factor == 0.0 {
                continue;
            }
            for (target, source) in rest.iter_mut().zip(source) {
                *target -= factor * source;
            }
            for (target, source) in rhs_row.iter_mut().zip(rhs_source) {
                *target -= factor * source;
            }
        }
    }
    for row in (0..size).rev() {
        let (known, solved) = rhs.split_at_mut((row + 1) * COLUMNS);
        let target = &mut known[row * COLUMNS..];
        let (diagonal, right) = matrix[row * size + row..(row + 1) * size].split_at(1);
        for (factor, solution) in right.iter().zip(solved.chunks_exact(COLUMNS)) {
            for (target, solution) in target.iter_mut().zip(solution) {
                *target -= factor * solution;
            }
        }
        for target in target {
            *target /= diagonal[0];
        }
    }
    rhs.iter().all(|value| value.is_finite())
}
