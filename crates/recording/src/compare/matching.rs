//! Which pair or control step of one run belongs to which of the other.

use std::collections::BTreeMap;

/// Half a period of 30 Hz, nanoseconds: the tolerance if neither run has two entries, from which a period would follow.
const HALF_PERIOD_NANOS: u64 = 16_666_667;

/// Number and time of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// Number of the pair or control step.
    pub number: u64,
    /// Time since the begin of the run, nanoseconds; negative for an exposure before the first control step.
    pub nanos: i64,
}

impl Stamp {
    /// Time since the begin of the run, seconds.
    pub fn t_s(self) -> f64 {
        self.nanos as f64 * 1e-9
    }
}

/// Partners in two runs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Matching {
    /// Index in A and index in B, in the order of A.
    pub partners: Vec<[usize; 2]>,
    /// Entries of A and of B without a partner.
    pub alone: [usize; 2],
    /// Whether one run has all numbers and times of the other: then partners have the same number.
    pub by_number: bool,
}

impl Matching {
    /// Matches entries that are sorted by time: by their number if one run has all numbers and times of the other, as a replay has those
    /// of its recording; else each with the nearest in time, within half a period, if both are the nearest to each other.
    pub fn new(stamps: [&[Stamp]; 2]) -> Self {
        let by_number = by_number(stamps);
        let is_by_number = by_number.is_some();
        let partners = by_number.unwrap_or_else(|| by_time(stamps));
        let alone = stamps.map(|stamps| stamps.len() - partners.len());
        Self { partners, alone, by_number: is_by_number }
    }
}

fn by_number([a, b]: [&[Stamp]; 2]) -> Option<Vec<[usize; 2]>> {
    let index_in_b: BTreeMap<u64, usize> = b.iter().enumerate().map(|(index, stamp)| (stamp.number, index)).collect();
    let partner = |(in_a, stamp): (usize, &Stamp)| {
        let in_b = index_in_b.get(&stamp.number).copied()?;
        (b[in_b] == *stamp).then_some([in_a, in_b])
    };
    let partners: Vec<_> = a.iter().enumerate().filter_map(partner).collect();
    let shorter = a.len().min(b.len());
    (shorter > 0 && partners.len() == shorter).then_some(partners)
}

fn by_time([a, b]: [&[Stamp]; 2]) -> Vec<[usize; 2]> {
    let periods = [a, b].into_iter().filter_map(period_nanos);
    let within = periods.min().map_or(HALF_PERIOD_NANOS, |period| period / 2);
    let partner = |(in_a, stamp): (usize, &Stamp)| {
        let in_b = nearest(b, stamp.nanos)?;
        let is_mutual = nearest(a, b[in_b].nanos) == Some(in_a);
        (is_mutual && b[in_b].nanos.abs_diff(stamp.nanos) <= within).then_some([in_a, in_b])
    };
    a.iter().enumerate().filter_map(partner).collect()
}

/// The median of the times between neighbours.
fn period_nanos(stamps: &[Stamp]) -> Option<u64> {
    let mut periods: Vec<u64> = stamps.windows(2).map(|two| two[1].nanos.abs_diff(two[0].nanos)).collect();
    periods.sort_unstable();
    periods.get(periods.len() / 2).copied()
}

/// The entry that is nearest in time; the earlier of two.
fn nearest(stamps: &[Stamp], nanos: i64) -> Option<usize> {
    let after = stamps.partition_point(|stamp| stamp.nanos < nanos);
    let around = [after.checked_sub(1), (after < stamps.len()).then_some(after)];
    around.into_iter().flatten().min_by_key(|index| stamps[*index].nanos.abs_diff(nanos))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamps(entries: &[(u64, i64)]) -> Vec<Stamp> {
        entries.iter().map(|&(number, millis)| Stamp { number, nanos: millis * 1_000_000 }).collect()
    }

    fn check(a: &[(u64, i64)], b: &[(u64, i64)], by_number: bool, partners: &[[usize; 2]], alone: [usize; 2]) {
        let (a, b) = (stamps(a), stamps(b));
        let expected = Matching { partners: partners.to_vec(), alone, by_number };
        assert_eq!(Matching::new([&a, &b]), expected, "{a:?} {b:?}");
    }

    #[test]
    fn runs_with_the_same_numbers_and_times_match_by_number() {
        check(&[(4, 0), (5, 33), (6, 66)], &[(4, 0), (5, 33), (6, 66)], true, &[[0, 0], [1, 1], [2, 2]], [0, 0]);
        // A replay that ended early.
        check(&[(4, 0), (5, 33), (6, 66)], &[(5, 33)], true, &[[1, 0]], [2, 0]);
    }

    #[test]
    fn other_runs_match_by_the_nearest_time_within_half_a_period() {
        // Period 33 ms: 16 ms are near enough, 17 ms are not.
        check(&[(0, 0), (1, 33), (2, 66)], &[(7, 16), (8, 49), (9, 83)], false, &[[0, 0], [1, 1]], [1, 1]);
        // Twice as many in B: half of its period of 10 ms counts.
        check(&[(0, 0), (1, 20)], &[(0, -1), (1, 9), (2, 19), (3, 29)], false, &[[0, 0], [1, 2]], [0, 2]);
    }

    #[test]
    fn no_entry_has_two_partners() {
        check(&[(0, 0), (1, 10), (2, 20)], &[(0, 4), (1, 104)], false, &[[0, 0]], [2, 1]);
    }

    #[test]
    fn single_entries_match_within_half_a_period_of_30_hz() {
        check(&[(0, 0)], &[(1, 16)], false, &[[0, 0]], [0, 0]);
        check(&[(0, 0)], &[(1, 17)], false, &[], [1, 1]);
        check(&[], &[(1, 17)], false, &[], [0, 1]);
    }
}
