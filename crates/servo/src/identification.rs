//! Identification of delays, from a record of the hand moving a few millimetres in front of a stationary target.
//!
//! * [`exposure_offset`]: delay between the timestamps of images and their exposure, on the clock of the joints. The pose of a
//!   stationary target must not depend on the velocity of the hand; if it does, the joints are those of another time.
//! * [`arm_response`]: dead time and first-order lag from a commanded velocity to the motion.
//! * [`Excitation`]: the motion that makes both observable.
//!
//! Each result is an [`Interval`]: the record is split into [`BATCHES`] pieces that are evaluated separately, and the spread of
//! their results gives the interval of the whole (batch means). Noise that is correlated over some samples is therefore counted
//! correctly. Not for the control path: it allocates.

mod arm_response;
mod excitation;
mod exposure_offset;

pub use arm_response::{ArmResponseEstimate, GivenVelocity, arm_response};
pub use excitation::{Excitation, ExcitationError};
pub use exposure_offset::{CameraOnHand, exposure_offset};

/// Number of pieces of a record.
pub const BATCHES: usize = 6;

/// Student's t of 97.5 % with `BATCHES - 1` degrees of freedom.
const T_975: f64 = 2.571;

/// An estimate with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// The estimate.
    pub value: f64,
    /// Half width of the interval.
    pub half_width_95: f64,
}

impl Interval {
    /// The estimate of a whole record, with the estimates of its pieces.
    fn of_batches(value: f64, batches: &[f64; BATCHES]) -> Self {
        let count = BATCHES as f64;
        let mean = batches.iter().sum::<f64>() / count;
        let variance = batches.iter().map(|batch| (batch - mean).powi(2)).sum::<f64>() / (count - 1.0);
        Self { value, half_width_95: T_975 * (variance / count).sqrt() }
    }

    /// Whether `value` lies in the interval.
    pub fn contains(&self, value: f64) -> bool {
        (value - self.value).abs() <= self.half_width_95
    }
}

/// Why a delay cannot be identified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotIdentified {
    /// The record is too short.
    #[error("{count} {what} in the record, at least {needed} are needed: record for longer")]
    TooFew {
        /// Kind of data.
        what: &'static str,
        /// Number available.
        count: usize,
        /// Number needed.
        needed: usize,
    },
    /// The motion does not make the delay observable, or there is no motion.
    #[error("{what} cannot be identified from this record: the hand must move, with varying velocity")]
    NotExcited {
        /// The requested delay.
        what: &'static str,
    },
    /// The best solution is at the end of the search range.
    #[error(
        "{what} is out of the search range: {value_s:.3} s, limit {most_s} s; check the clock that stamps the images and \
         the link of the arm"
    )]
    TooLong {
        /// The requested delay.
        what: &'static str,
        /// End of the search, seconds.
        value_s: f64,
        /// Limit of the search, seconds.
        most_s: f64,
    },
}

/// Index of the piece of the record from `begin_s` to `end_s` that contains the time `at_s`.
fn batch_of(at_s: f64, (begin_s, end_s): (f64, f64)) -> usize {
    let share = (at_s - begin_s) / (end_s - begin_s);
    // Casts of floats saturate: a time before the beginning gives 0.
    ((share * BATCHES as f64) as usize).min(BATCHES - 1)
}
