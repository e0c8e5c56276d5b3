//! Pairs of an MCAP recording by their position.

use std::fmt;

use image::RgbImage;
use pb3dp_bag::BagError;
use pb3dp_bag::pairs::{BagPairs, StereoBag};
use pb3dp_geometry::MonotonicTime;

/// Reads pairs; quickest in their order.
pub(crate) struct BagImages {
    bag: StereoBag,
    pairs: BagPairs,
    /// Number of the next pair of `pairs`.
    next: u64,
}

impl fmt::Debug for BagImages {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("BagImages").field("bag", &self.bag).field("next", &self.next).finish_non_exhaustive()
    }
}

impl BagImages {
    pub(crate) fn new(bag: StereoBag) -> Self {
        Self { pairs: bag.pairs(), bag, next: 0 }
    }

    /// Times of all pairs, and the number of images without a partner.
    pub(crate) fn times(bag: &StereoBag) -> Result<(Vec<(MonotonicTime, i64)>, u64), BagError> {
        let mut pairs = bag.pairs();
        let mut times: Vec<(MonotonicTime, i64)> = Vec::new();
        while let Some(time) = pairs.skip_pair()? {
            times.push(time);
        }
        Ok((times, pairs.unpaired()))
    }

    /// The images of the pair with this number in the recording.
    pub(crate) fn images(&mut self, number: u64) -> Result<([RgbImage; 2], Vec<String>), BagError> {
        if number < self.next {
            *self = Self::new(self.bag.clone());
        }
        while self.next < number {
            self.pairs.skip_pair()?;
            self.next += 1;
        }
        self.next += 1;
        let images = match self.pairs.next() {
            Some(pair) => pair?.images?,
            None => {
                let (file, why) = (self.bag.bag().path().to_path_buf(), "it has become shorter".to_owned());
                return Err(BagError::Damaged { file, messages: number, why });
            }
        };
        Ok((images, self.pairs.take_notes()))
    }
}
