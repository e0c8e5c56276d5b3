//! The rows that stand for a long series.

/// The rows that stand for all rows of lines with the same x: all of them, or the first, the first gap, the lowest and the highest of
/// each line in equal spans, so that no peak is lost. About `most` rows at most.
pub(super) fn kept_rows(lines: &[&[[f64; 2]]], most: usize) -> Vec<usize> {
    let rows = lines.first().map_or(0, |line| line.len());
    if rows <= most {
        return (0..rows).collect();
    }
    let span = (rows * 2 * lines.len()).div_ceil(most.max(1));
    let mut kept = vec![rows - 1];
    for begin in (0..rows).step_by(span) {
        kept.push(begin);
        for line in lines {
            let (finite, gaps): (Vec<_>, Vec<_>) =
                (begin..rows.min(begin + span)).partition(|row| line[*row][1].is_finite());
            let by_value = |a: &&usize, b: &&usize| line[**a][1].total_cmp(&line[**b][1]);
            kept.extend(
                [finite.iter().min_by(by_value), finite.iter().max_by(by_value), gaps.first()].into_iter().flatten(),
            );
        }
    }
    kept.sort_unstable();
    kept.dedup();
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_tables_keep_their_peaks_and_gaps() {
        let mut lines = [0.01, 0.02]
            .map(|rate| (0..200_000).map(|i| [f64::from(i), (f64::from(i) * rate).sin()]).collect::<Vec<_>>());
        lines[0][123_456][1] = 40.0;
        lines[0][123_460][1] = -30.0;
        lines[1][77_777][1] = f64::NAN;
        let rows = kept_rows(&[&lines[0], &lines[1]], 20_000);
        assert!(rows.len() < 25_000, "{} rows", rows.len());
        assert!([0, 77_777, 123_456, 123_460, 199_999].iter().all(|row| rows.contains(row)));
        assert_eq!(kept_rows(&[&lines[0][..50]], 50).len(), 50);
        assert_eq!(kept_rows(&[], 50).len(), 0);
    }
}
