//! The pairs of a recording and their times.

use std::ops::Range;
use std::path::PathBuf;
use std::time::Duration;

use pb3dp_bag::matching::LeftOut;
use pb3dp_camera_settings::ImageLayout;
use pb3dp_geometry::MonotonicTime;
use pb3dp_record::dataset::Sequence;

/// Where the images of a pair are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// A left and a right file.
    Files(PathBuf, PathBuf),
    /// One file with both.
    Both(PathBuf, ImageLayout),
    /// The pair with this number in an MCAP recording.
    Bag(u64),
}

/// Pairs of a recording with times.
pub(crate) struct TimedPairs {
    /// Each with the middle of the left exposure and the skew in nanoseconds, in the order of these times.
    pub(crate) pairs: Vec<(Place, MonotonicTime, i64)>,
    /// Images without a partner.
    pub(crate) left_out: LeftOut,
}

/// The images of a pair and their times.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RecordedPair {
    pub(crate) place: Place,
    /// Time since the first pair of the recording.
    pub(crate) since_first: Duration,
    pub(crate) skew_nanos: i64,
}

/// A recording: at least one pair, times strictly increasing.
#[derive(Clone, Debug)]
pub(crate) struct Source {
    pairs: Vec<RecordedPair>,
    first_at: MonotonicTime,
    period: Option<Duration>,
    /// Time between the first pairs of consecutive rounds.
    round: Duration,
}

impl Source {
    /// Images without times, one pair per `period`.
    pub(crate) fn of_images(places: Vec<Place>, period: Duration) -> Self {
        let pairs: Vec<_> = (0..)
            .zip(places)
            .map(|(i, place)| RecordedPair { place, since_first: period * i, skew_nanos: 0 })
            .collect();
        let round = period * pairs.len().max(1) as u32;
        Self { pairs, first_at: MonotonicTime::ZERO, period: Some(period), round }
    }

    /// A sequence; if it has one frame only, `period` is the time to the next round.
    pub(crate) fn of_sequence(sequence: &Sequence, period: Duration) -> Self {
        let first_s = sequence.times_s.first().copied().unwrap_or(0.0);
        let since_first = |at_s: f64| Duration::from_nanos(((at_s - first_s) * 1e9).round().max(0.0) as u64);
        let skew_nanos = |i: usize| sequence.skew_s.get(i).map_or(0, |skew_s| (skew_s * 1e9).round() as i64);
        let pairs = sequence.times_s.iter().enumerate().map(|(i, at_s)| {
            let (left, right) = sequence.image_files(i as u64);
            RecordedPair {
                place: Place::Files(left, right),
                since_first: since_first(*at_s),
                skew_nanos: skew_nanos(i),
            }
        });
        Self::timed(pairs.collect(), MonotonicTime::from_secs_f64(first_s), period)
    }

    /// Pairs with the middle of the left exposure and the skew in nanoseconds, in the order of these times.
    pub(crate) fn of_times(pairs: Vec<(Place, MonotonicTime, i64)>, period: Duration) -> Self {
        let first_at = pairs.first().map_or(MonotonicTime::ZERO, |(_, at, _)| *at);
        let pairs = pairs.into_iter().map(|(place, at, skew_nanos)| RecordedPair {
            place,
            since_first: at.saturating_since(first_at),
            skew_nanos,
        });
        Self::timed(pairs.collect(), first_at, period)
    }

    /// The same without the pairs before a time, and how many these are; none is left out if all are before it.
    pub(crate) fn since(self, from: MonotonicTime, period: Duration) -> (Self, u64) {
        let at = |pair: &RecordedPair| self.first_at + pair.since_first;
        let before = self.pairs.iter().take_while(|pair| at(pair) < from).count();
        let left_out = if before < self.pairs.len() { before } else { 0 };
        (self.part(left_out..self.pairs.len(), period), left_out as u64)
    }

    /// The pairs of an MCAP recording with these numbers; `None` if none is left.
    pub(crate) fn with_numbers(&self, numbers: Range<u64>, period: Duration) -> Option<Self> {
        let is_before = |pair: &RecordedPair, end: u64| matches!(pair.place, Place::Bag(number) if number < end);
        let [from, to] =
            [numbers.start, numbers.end].map(|end| self.pairs.partition_point(|pair| is_before(pair, end)));
        (from < to).then(|| self.part(from..to, period))
    }

    fn part(&self, range: Range<usize>, period: Duration) -> Self {
        let at = |pair: &RecordedPair| self.first_at + pair.since_first;
        let kept = self.pairs[range].iter().map(|pair| (pair.place.clone(), at(pair), pair.skew_nanos));
        Self::of_times(kept.collect(), period)
    }

    fn timed(pairs: Vec<RecordedPair>, first_at: MonotonicTime, period: Duration) -> Self {
        let steps: Vec<_> = pairs.windows(2).map(|w| w[1].since_first.saturating_sub(w[0].since_first)).collect();
        let typical = typical_step(&steps);
        let last = pairs.last().map_or(Duration::ZERO, |pair| pair.since_first);
        let round = last + typical.unwrap_or(period);
        let regular = typical.filter(|typical| steps.iter().all(|step| step.abs_diff(*typical) * 5 <= *typical));
        Self { pairs, first_at, period: regular, round }
    }

    /// Sets the skew of all pairs.
    pub(crate) fn set_skew(&mut self, skew_nanos: i64) {
        self.pairs.iter_mut().for_each(|pair| pair.skew_nanos = skew_nanos);
    }

    /// Whether the exposures of a pair differ.
    pub(crate) fn has_skew(&self) -> bool {
        self.pairs.iter().any(|pair| pair.skew_nanos != 0)
    }

    pub(crate) fn pairs(&self) -> u64 {
        self.pairs.len() as u64
    }

    /// Time between pairs, if it is constant (to a fifth).
    pub(crate) fn period(&self) -> Option<Duration> {
        self.period
    }

    /// Time of the first pair on the clock of the recording; zero if it was negative.
    pub(crate) fn first_at(&self) -> MonotonicTime {
        self.first_at
    }

    /// The pair at a position that counts over all rounds.
    pub(crate) fn pair(&self, position: u64) -> &RecordedPair {
        &self.pairs[(position % self.pairs()) as usize]
    }

    /// Times of the pairs on the clock of the recording, seconds.
    pub(crate) fn times_s(&self) -> Vec<f64> {
        let first_s = self.first_at.as_secs_f64();
        self.pairs.iter().map(|pair| first_s + pair.since_first.as_secs_f64()).collect()
    }

    /// Time from the very first pair to the one at a position that counts over all rounds.
    pub(crate) fn since_start(&self, position: u64) -> Duration {
        let rounds = u32::try_from(position / self.pairs()).unwrap_or(u32::MAX);
        self.round.saturating_mul(rounds).saturating_add(self.pair(position).since_first)
    }
}

/// Numbers of the most pairs whose times increase: the others have a time that went back, repeats or jumped.
pub(crate) fn in_order(times: &[MonotonicTime]) -> Vec<usize> {
    // Of each number of pairs the last pair with the earliest time, and of each pair the one before it.
    let mut last: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = Vec::with_capacity(times.len());
    for (number, at) in times.iter().enumerate() {
        let length = last.partition_point(|&other| times[other] < *at);
        before.push(length.checked_sub(1).map(|shorter| last[shorter]));
        match last.get_mut(length) {
            Some(other) => *other = number,
            None => last.push(number),
        }
    }
    let mut kept: Vec<_> = std::iter::successors(last.last().copied(), |&number| before[number]).collect();
    kept.reverse();
    kept
}

/// The median step, so that gaps of lost frames are ignored.
fn typical_step(steps: &[Duration]) -> Option<Duration> {
    let mut sorted = steps.to_vec();
    sorted.sort_unstable();
    sorted.get(sorted.len() / 2).copied()
}
