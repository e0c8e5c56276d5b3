//! Images of two cameras by their times: each belongs to the nearest of the other camera.

use std::collections::VecDeque;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_record::images::PIXELS_MAX;

/// Images of one camera that wait for the other one, at most.
const WAITING_MAX: usize = 64;
/// Bytes of all waiting images, at most. Derived: to find the nearest image takes three, of [`PIXELS_MAX`] pixels in 8-bit colour.
const WAITING_BYTES_MAX: usize = 9 * PIXELS_MAX as usize;

/// Images of two cameras in the order in which they came. A recording in which one camera has stopped takes no more memory.
#[derive(Debug)]
pub struct Waiting<T> {
    images: [VecDeque<WaitingImage<T>>; 2],
    bytes: [usize; 2],
}

#[derive(Debug)]
struct WaitingImage<T> {
    at: MonotonicTime,
    bytes: usize,
    image: T,
}

/// Images without a partner.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LeftOut {
    /// All of them.
    pub images: u64,
    /// Those of them that no longer waited for a partner, because too many images, or too large ones, waited.
    pub no_longer_waiting: u64,
}

impl LeftOut {
    /// A line for the user; none if no image was left out. `within_ms`: longest time between the images of a pair, milliseconds.
    pub fn warning(&self, within_ms: f64) -> Option<String> {
        let why = format!("because the other camera has none within {within_ms} ms (--pair-within)");
        let early = self.early_end().map(|early| format!(" ({early})")).unwrap_or_default();
        (self.images > 0).then(|| format!("images left out, {why}: {}{early}", self.images))
    }

    /// That the search for partners ended early for some images; none if it did for no image.
    pub fn early_end(&self) -> Option<String> {
        let limit = WAITING_BYTES_MAX / 1_000_000;
        (self.no_longer_waiting > 0).then(|| {
            format!(
                "for {} of them, the search ended early: at most {WAITING_MAX} images of a camera, and {limit} MB in all, wait for the other camera; record the images of both cameras in turn",
                self.no_longer_waiting
            )
        })
    }
}

impl<T> Default for Waiting<T> {
    fn default() -> Self {
        Self { images: [VecDeque::new(), VecDeque::new()], bytes: [0; 2] }
    }
}

impl<T> Waiting<T> {
    /// The next image of the left (0) or the right (1) camera, with its size in memory. Gives the number of older images that have to go
    /// for it; the newest one of each camera stays.
    pub fn push(&mut self, side: usize, at: MonotonicTime, (image, bytes): (T, usize)) -> u64 {
        self.images[side].push_back(WaitingImage { at, bytes, image });
        self.bytes[side] += bytes;
        let mut dropped = 0;
        while let Some(side) = self.overfull() {
            self.pop(side);
            dropped += 1;
        }
        dropped
    }

    /// The camera whose oldest image has to go.
    fn overfull(&self) -> Option<usize> {
        let is_over = self.bytes[0] + self.bytes[1] > WAITING_BYTES_MAX;
        let larger = usize::from(self.bytes[1] > self.bytes[0]);
        let several = |side: &usize| self.images[*side].len() > 1;
        (0..2)
            .find(|side| self.images[*side].len() > WAITING_MAX)
            .or_else(|| [larger, 1 - larger].into_iter().filter(|_| is_over).find(several))
    }

    /// Takes the oldest image of a camera.
    pub fn pop(&mut self, side: usize) -> Option<(MonotonicTime, T)> {
        let WaitingImage { at, bytes, image } = self.images[side].pop_front()?;
        self.bytes[side] -= bytes;
        Some((at, image))
    }

    /// Times of the images of a camera, oldest first.
    pub fn times(&self, side: usize) -> impl Iterator<Item = MonotonicTime> {
        self.images[side].iter().map(|image| image.at)
    }
}

/// Finds the pairs of two streams of images.
#[derive(Debug)]
pub struct Matching<T> {
    within: Duration,
    waiting: Waiting<T>,
    left_out: LeftOut,
    is_complete: bool,
}

impl<T> Matching<T> {
    /// Pairs whose images are at most `within` apart.
    pub fn new(within: Duration) -> Self {
        Self { within, waiting: Waiting::default(), left_out: LeftOut::default(), is_complete: false }
    }

    /// The next image of the left (0) or the right (1) camera, with its size in memory.
    pub fn push(&mut self, side: usize, at: MonotonicTime, image: (T, usize)) {
        let dropped = self.waiting.push(side, at, image);
        self.left_out.images += dropped;
        self.left_out.no_longer_waiting += dropped;
    }

    /// No more images come.
    pub fn complete(&mut self) {
        self.is_complete = true;
    }

    /// Whether [`Self::complete`] was called.
    pub fn is_complete(&self) -> bool {
        self.is_complete
    }

    /// Images without a partner so far.
    pub fn left_out(&self) -> LeftOut {
        self.left_out
    }

    /// The next pair; `None` if more images are needed.
    pub fn next_pair(&mut self) -> Option<[(MonotonicTime, T); 2]> {
        let first = |waiting: &Waiting<T>, side| waiting.times(side).next();
        while let (Some(left_at), Some(right_at)) = (first(&self.waiting, 0), first(&self.waiting, 1)) {
            let (earlier, first_at, later_at) = match left_at <= right_at {
                true => (0, left_at, right_at),
                false => (1, right_at, left_at),
            };
            let apart = |at: MonotonicTime| at.as_nanos().abs_diff(later_at.as_nanos());
            let is_nearest = match self.waiting.times(earlier).nth(1) {
                Some(next_at) => apart(first_at) <= apart(next_at),
                None if first_at < later_at && !self.is_complete => return None,
                None => true,
            };
            if is_nearest && Duration::from_nanos(apart(first_at)) <= self.within {
                return Some([self.waiting.pop(0)?, self.waiting.pop(1)?]);
            }
            self.waiting.pop(earlier);
            self.left_out.images += 1;
        }
        if self.is_complete {
            self.left_out.images += (0..2).map(|side| self.waiting.times(side).count() as u64).sum::<u64>();
            self.waiting = Waiting::default();
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times of the pairs of these images, milliseconds, which come in the order of their times; images without a partner.
    fn pairs(left: &[u64], right: &[u64], within: u64) -> (Vec<(u64, u64)>, u64) {
        let mut matching = Matching::new(Duration::from_millis(within));
        let sides = [left, right].into_iter().enumerate();
        let mut images: Vec<_> = sides.flat_map(|(side, times)| times.iter().map(move |at| (*at, side))).collect();
        images.sort_by_key(|(at, _)| *at);
        let mut found = Vec::new();
        let mut take = |matching: &mut Matching<u64>| {
            while let Some([(_, left), (_, right)]) = matching.next_pair() {
                found.push((left, right));
            }
        };
        for (millis, side) in images {
            matching.push(side, MonotonicTime::from_nanos(millis * 1_000_000), (millis, 0));
            take(&mut matching);
        }
        matching.complete();
        take(&mut matching);
        (found, matching.left_out().images)
    }

    #[test]
    fn an_image_belongs_to_the_nearest_of_the_other_camera() {
        assert_eq!(pairs(&[0, 33, 66], &[18, 34, 66], 20), (vec![(33, 34), (66, 66)], 2));
        assert_eq!(pairs(&[18, 34, 66], &[0, 33, 66], 20), (vec![(34, 33), (66, 66)], 2));
        // A constant skew.
        assert_eq!(pairs(&[0, 33, 66], &[10, 43, 76], 20), (vec![(0, 10), (33, 43), (66, 76)], 0));
        assert_eq!(pairs(&[0, 33, 66], &[10, 43], 5), (vec![], 5));
        assert_eq!(pairs(&[5, 5, 5], &[5, 5], 3), (vec![(5, 5), (5, 5)], 1));
    }

    #[test]
    fn a_camera_that_has_stopped_takes_no_more_memory() {
        let push = |bytes: usize| {
            let mut matching = Matching::new(Duration::from_millis(1));
            matching.push(1, MonotonicTime::ZERO, ((), bytes));
            (0..1000).for_each(|i| matching.push(0, MonotonicTime::from_nanos(10_000_000 + i), ((), bytes)));
            (matching.waiting.bytes, matching.waiting.images.each_ref().map(VecDeque::len), matching.left_out())
        };
        let left_out = |images| LeftOut { images, no_longer_waiting: images };
        assert_eq!(push(1), ([64, 1], [64, 1], left_out(936)));
        let mb = 1_000_000;
        assert_eq!(push(128 * mb), ([768 * mb, 128 * mb], [6, 1], left_out(994)));
        // The newest image of each camera stays, whatever its size.
        assert_eq!(push(500 * mb), ([500 * mb, 500 * mb], [1, 1], left_out(999)));
        let warning = left_out(936).warning(3.0).unwrap();
        assert!(warning.contains("936 (for 936 of them") && warning.contains("64 images of a camera, and 900 MB"));
        assert_eq!(LeftOut::default().warning(3.0), None);
    }

    /// Three images of the largest size are enough, and fit.
    #[test]
    fn pairs_of_the_largest_images_are_found() {
        let mut matching = Matching::new(Duration::from_millis(5));
        let mut pairs = 0;
        for k in 0..20_u64 {
            for side in [0, 1] {
                let at = MonotonicTime::from_nanos((33 * k + side) * 1_000_000);
                matching.push(side as usize, at, (k, 3 * PIXELS_MAX as usize));
                if let Some([(_, left), (_, right)]) = matching.next_pair() {
                    assert_eq!((left, right), (pairs, pairs));
                    pairs += 1;
                }
            }
        }
        assert_eq!((pairs, matching.left_out()), (19, LeftOut::default()));
    }
}
