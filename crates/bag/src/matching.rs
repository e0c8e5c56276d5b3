//! Images of two cameras by their times: each belongs to the nearest of the other camera.

use std::collections::VecDeque;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;

/// Images of one side that wait for the other side. A recording in which one camera has stopped takes no more memory.
const WAITING_MAX: usize = 64;

/// Finds the pairs of two streams of images.
#[derive(Debug)]
pub struct Matching<T> {
    within: Duration,
    waiting: [VecDeque<(MonotonicTime, T)>; 2],
    unpaired: u64,
    is_complete: bool,
}

impl<T> Matching<T> {
    /// Pairs whose images are at most `within` apart.
    pub fn new(within: Duration) -> Self {
        Self { within, waiting: [VecDeque::new(), VecDeque::new()], unpaired: 0, is_complete: false }
    }

    /// The next image of the left (0) or the right (1) camera.
    pub fn push(&mut self, side: usize, at: MonotonicTime, image: T) {
        self.waiting[side].push_back((at, image));
        if self.waiting[side].len() > WAITING_MAX {
            self.waiting[side].pop_front();
            self.unpaired += 1;
        }
    }

    /// No more images come.
    pub fn complete(&mut self) {
        self.is_complete = true;
    }

    /// Whether [`Self::complete`] was called.
    pub fn is_complete(&self) -> bool {
        self.is_complete
    }

    /// Number of images without a partner so far.
    pub fn unpaired(&self) -> u64 {
        self.unpaired
    }

    /// The next pair; `None` if more images are needed.
    pub fn next_pair(&mut self) -> Option<[(MonotonicTime, T); 2]> {
        let [left, right] = &mut self.waiting;
        while let (Some(&(left_at, _)), Some(&(right_at, _))) = (left.front(), right.front()) {
            let (earlier, first_at, later_at) = match left_at <= right_at {
                true => (&mut *left, left_at, right_at),
                false => (&mut *right, right_at, left_at),
            };
            let apart = |at: MonotonicTime| at.as_nanos().abs_diff(later_at.as_nanos());
            let is_nearest = match earlier.get(1) {
                Some((next_at, _)) => apart(first_at) <= apart(*next_at),
                None if first_at < later_at && !self.is_complete => return None,
                None => true,
            };
            if is_nearest && Duration::from_nanos(apart(first_at)) <= self.within {
                return Some([left.pop_front()?, right.pop_front()?]);
            }
            earlier.pop_front();
            self.unpaired += 1;
        }
        if self.is_complete {
            self.unpaired += self.waiting.iter_mut().map(|waiting| waiting.drain(..).len() as u64).sum::<u64>();
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
            matching.push(side, MonotonicTime::from_nanos(millis * 1_000_000), millis);
            take(&mut matching);
        }
        matching.complete();
        take(&mut matching);
        (found, matching.unpaired())
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
        let mut matching = Matching::new(Duration::from_millis(1));
        (0..1000).for_each(|i| matching.push(0, MonotonicTime::from_nanos(i), ()));
        assert_eq!((matching.waiting[0].len(), matching.unpaired()), (WAITING_MAX, 1000 - WAITING_MAX as u64));
    }
}
