//! Small dense symmetric systems, solved in place, row-major.

/// Replaces the lower triangle of a symmetric positive definite matrix by its Cholesky factor; `false` if it is not positive
/// definite.
pub(super) fn cholesky(matrix: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        let (above, row) = matrix.split_at_mut(i * n);
        let row = &mut row[..n];
        for j in 0..i {
            let other = &above[j * n..j * n + j + 1];
            row[j] = (row[j] - dot(&row[..j], &other[..j])) / other[j];
        }
        let square = row[i] - dot(&row[..i], &row[..i]);
        if !(square > 0.0 && square.is_finite()) {
            return false;
        }
        row[i] = square.sqrt();
    }
    true
}

/// Logarithm of the determinant of a factored matrix.
pub(super) fn log_determinant(factor: &[f64], n: usize) -> f64 {
    2.0 * (0..n).map(|i| factor[i * n + i].ln()).sum::<f64>()
}

/// Replaces `b` by the solution of `L x = b`.
pub(super) fn solve_lower(factor: &[f64], n: usize, b: &mut [f64]) {
    for i in 0..n {
        let row = &factor[i * n..i * n + i + 1];
        b[i] = (b[i] - dot(&row[..i], &b[..i])) / row[i];
    }
}

/// Replaces `b` by the solution of `L^T x = b`.
pub(super) fn solve_upper(factor: &[f64], n: usize, b: &mut [f64]) {
    for i in (0..n).rev() {
        let row = &factor[i * n..i * n + i + 1];
        b[i] /= row[i];
        let x = b[i];
        b[..i].iter_mut().zip(row).for_each(|(b, factor)| *b -= x * factor);
    }
}

/// Four partial sums, which fit a vector register.
#[inline(always)]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (left, right) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = left.remainder().iter().zip(right.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in left.zip(right) {
        for k in 0..4 {
            sums[k] += a[k] * b[k];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;

    #[test]
    fn systems_are_solved_as_by_nalgebra() {
        let n = 11;
        let half = DMatrix::from_fn(n, n, |i, j| ((i * 7 + j * 3) as f64).sin() + f64::from(u8::from(i == j)));
        let matrix = &half * half.transpose() + DMatrix::identity(n, n);
        let b = DVector::from_fn(n, |i, _| (i as f64).cos());
        let expected = matrix.clone().cholesky().map(|c| c.solve(&b)).unwrap_or_else(|| DVector::zeros(n));
        // Symmetric, so rows are columns.
        let mut factor: Vec<f64> = matrix.as_slice().to_vec();
        assert!(cholesky(&mut factor, n));
        let mut x = b.as_slice().to_vec();
        solve_lower(&factor, n, &mut x);
        solve_upper(&factor, n, &mut x);
        for (x, expected) in x.iter().zip(expected.iter()) {
            assert!((x - expected).abs() < 1e-10, "{x} {expected}");
        }
        assert!((log_determinant(&factor, n) - matrix.determinant().ln()).abs() < 1e-9);
        let mut negative = vec![1.0, 2.0, 2.0, 1.0];
        assert!(!cholesky(&mut negative, 2));
    }
}
