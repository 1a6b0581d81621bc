//! Small dense linear systems, solved in place.

/// Solves `matrix x = rhs` by Gaussian elimination with partial pivoting, for `columns` right hand sides stored row by
/// row behind each other; both are overwritten, `rhs` with the solution. False where the matrix is singular.
pub(crate) fn solve(matrix: &mut [f64], rhs: &mut [f64], size: usize, columns: usize) -> bool {
    debug_assert!(matrix.len() == size * size && rhs.len() == size * columns);
    for step in 0..size {
        let mut pivot = step;
        for row in step + 1..size {
            if matrix[row * size + step].abs() > matrix[pivot * size + step].abs() {
                pivot = row;
            }
        }
        let value = matrix[pivot * size + step];
        if !(value.is_finite() && value != 0.0) {
            return false;
        }
        if pivot != step {
            for k in step..size {
                matrix.swap(step * size + k, pivot * size + k);
            }
            for k in 0..columns {
                rhs.swap(step * columns + k, pivot * columns + k);
            }
        }
        for row in step + 1..size {
            let factor = matrix[row * size + step] / value;
            if factor == 0.0 {
                continue;
            }
            let (above, below) = matrix.split_at_mut(row * size);
            let source = &above[step * size..(step + 1) * size];
            for (target, source) in below[..size].iter_mut().zip(source).skip(step + 1) {
                *target -= factor * source;
            }
            for k in 0..columns {
                rhs[row * columns + k] -= factor * rhs[step * columns + k];
            }
        }
    }
    for row in (0..size).rev() {
        for k in 0..columns {
            let mut value = rhs[row * columns + k];
            for column in row + 1..size {
                value -= matrix[row * size + column] * rhs[column * columns + k];
            }
            rhs[row * columns + k] = value / matrix[row * size + row];
        }
    }
    rhs.iter().all(|value| value.is_finite())
}
