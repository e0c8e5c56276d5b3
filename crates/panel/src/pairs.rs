//! The stereo pairs that are kept: an operator draws on an image that is some time old.
//!
//! Kept are the newest pairs, and those on which somebody has asked for a preview (drawing begins with one). All together use at most
//! [`MEMORY_MAX`]: 34 pairs of 640x480, of which [`PINNED_MAX`] may be pinned. A request for a pair that is gone is refused.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use pb3dp_cell::handover::Newest;
use pb3dp_hal_api::FramePair;

use crate::refusal::Refusal;

/// Memory of all kept pairs, bytes. At half of it drawing must be quicker than half a second before its first preview.
pub const MEMORY_MAX: usize = 64_000_000;
/// Pairs that a preview has pinned.
pub const PINNED_MAX: usize = 8;
/// Pairs by number, whatever their size.
const NEWEST_MAX: usize = 90;

/// The kept pairs.
#[derive(Default)]
pub struct Pairs {
    kept: Mutex<Kept>,
    /// The newest pair, for the encoder.
    to_encode: Newest<Arc<FramePair>>,
}

#[derive(Default)]
struct Kept {
    /// Newest last.
    newest: VecDeque<Arc<FramePair>>,
    pinned: VecDeque<Arc<FramePair>>,
    /// Pairs so far, and pairs missing between them.
    count: u64,
    lost: u64,
}

/// Counts of the pairs so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PairCounts {
    /// Sequence number of the newest pair.
    pub sequence: Option<u64>,
    /// Number of pairs.
    pub count: u64,
    /// Missing pairs.
    pub lost: u64,
}

impl Pairs {
    /// Adds the newest pair.
    pub fn push(&self, pair: &Arc<FramePair>) {
        {
            let mut kept = self.kept();
            let before = kept.newest.back().map(|before| before.sequence);
            kept.count += 1;
            kept.lost += before.and_then(|before| pair.sequence.checked_sub(before + 1)).unwrap_or(0);
            kept.newest.push_back(Arc::clone(pair));
            let most = (MEMORY_MAX / size_of_pair(pair).max(1)).saturating_sub(PINNED_MAX).clamp(2, NEWEST_MAX);
            while kept.newest.len() > most {
                kept.newest.pop_front();
            }
        }
        self.to_encode.give(Arc::clone(pair));
    }

    /// Waits for a pair that was not encoded yet.
    pub fn wait(&self, timeout: Duration) -> Option<Arc<FramePair>> {
        self.to_encode.wait(timeout)
    }

    /// Counts so far.
    pub fn counts(&self) -> PairCounts {
        let kept = self.kept();
        PairCounts { sequence: kept.newest.back().map(|pair| pair.sequence), count: kept.count, lost: kept.lost }
    }

    /// Skew of the kept pair whose exposures are furthest apart, nanoseconds; 0 without pairs.
    pub fn worst_skew_nanos(&self) -> i64 {
        let kept = self.kept();
        let skews = kept.newest.iter().map(|pair| pair.skew_nanos);
        skews.max_by_key(|nanos| nanos.unsigned_abs()).unwrap_or_default()
    }

    /// The newest pair, or the one with this number.
    ///
    /// # Errors
    /// If there is no pair yet, or that pair is no longer kept.
    pub fn get(&self, sequence: Option<u64>) -> Result<Arc<FramePair>, Refusal> {
        let kept = self.kept();
        let newest = kept.newest.back().ok_or(Refusal::NoImages)?;
        let Some(sequence) = sequence else { return Ok(Arc::clone(newest)) };
        let found = kept.newest.iter().chain(&kept.pinned).find(|pair| pair.sequence == sequence);
        found.map(Arc::clone).ok_or(Refusal::PairGone { sequence, newest: newest.sequence })
    }

    /// Keeps a pair until [`PINNED_MAX`] others are pinned.
    pub fn pin(&self, pair: &Arc<FramePair>) {
        let mut kept = self.kept();
        kept.pinned.retain(|pinned| pinned.sequence != pair.sequence);
        kept.pinned.push_back(Arc::clone(pair));
        if kept.pinned.len() > PINNED_MAX {
            kept.pinned.pop_front();
        }
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn size_of_pair(pair: &FramePair) -> usize {
    pair.left.as_raw().len()
        + pair.right.as_raw().len()
        + pair.delivered.iter().map(|image| image.bytes.len()).sum::<usize>()
}

#[cfg(test)]
mod tests {
    use pb3dp_geometry::ImageSize;

    use super::*;

    fn pair(sequence: u64) -> Arc<FramePair> {
        Arc::new(FramePair { sequence, ..FramePair::black(ImageSize { width: 640, height: 480 }) })
    }

    #[test]
    fn the_newest_pairs_and_the_pinned_ones_are_kept_within_the_memory() {
        let pairs = Pairs::default();
        assert_eq!(pairs.get(None).unwrap_err(), Refusal::NoImages);
        pairs.push(&pair(0));
        pairs.pin(&pair(0));
        for sequence in 1..100 {
            pairs.push(&pair(sequence));
        }
        assert_eq!(pairs.get(None).unwrap().sequence, 99);
        assert_eq!(pairs.get(Some(0)).unwrap().sequence, 0, "pinned");
        assert_eq!(pairs.get(Some(1)).unwrap_err(), Refusal::PairGone { sequence: 1, newest: 99 });
        assert_eq!(pairs.get(Some(74)).unwrap().sequence, 74);
        let kept = pairs.kept();
        assert!((kept.newest.len() + PINNED_MAX) * size_of_pair(&pair(0)) <= MEMORY_MAX);
    }

    #[test]
    fn missing_pairs_are_counted() {
        let pairs = Pairs::default();
        for sequence in [3, 4, 7] {
            pairs.push(&pair(sequence));
        }
        assert_eq!(pairs.counts(), PairCounts { sequence: Some(7), count: 3, lost: 2 });
    }
}
