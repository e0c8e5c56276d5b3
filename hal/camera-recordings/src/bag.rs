//! Pairs of an MCAP recording by their position.

use std::fmt;

use image::RgbImage;
use pb3dp_bag::BagError;
use pb3dp_bag::matching::LeftOut;
use pb3dp_bag::pairs::{BagPairs, StereoBag};
use pb3dp_bag::segments::{PairTimes, Segment};

/// Reads pairs; quickest in their order.
pub(crate) struct BagImages {
    bag: StereoBag,
    pairs: BagPairs,
    /// Number of the next pair of `pairs`.
    next: u64,
}

/// Times of the pairs of a recording.
pub(crate) struct BagTimes {
    /// Middle of the left exposure and skew in nanoseconds of each pair.
    pub(crate) times: Vec<PairTimes>,
    pub(crate) left_out: LeftOut,
    pub(crate) segments: Vec<Segment>,
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

    /// Times of all pairs, the images without a partner, and the parts with one calibration.
    pub(crate) fn times(bag: &StereoBag) -> Result<BagTimes, BagError> {
        let mut pairs = bag.pairs();
        let times = pairs.skip_all()?;
        Ok(BagTimes { left_out: pairs.left_out(), segments: pairs.segments(&times), times })
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
