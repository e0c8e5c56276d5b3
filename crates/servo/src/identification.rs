//! Delays of a rig, from a record of the hand moving a few millimetres before a target that rests.
//!
//! * [`exposure_offset`]: how much later than their stamps say the images were exposed, on the clock of the joints. The pose of
//!   a target at rest must not depend on how fast the hand moves; where it does, the joints were taken at the wrong time.
//! * [`arm_response`]: what lies between a commanded velocity and the motion: a dead time and a first-order lag.
//! * [`Excitation`]: the motion that shows both.
//!
//! Each answer is an [`Interval`]: the record is cut into [`BATCHES`] pieces that are evaluated apart, and the spread of their
//! answers is that of the whole times the root of their number (batch means), so noise that hangs together over some samples
//! is counted as what it is. This is not for the control path: it allocates.

mod arm_response;
mod excitation;
mod exposure_offset;

pub use arm_response::{ArmResponseEstimate, GivenVelocity, arm_response};
pub use excitation::{Excitation, ExcitationError};
pub use exposure_offset::{CameraOnHand, exposure_offset};

/// Into how many pieces a record is cut.
pub const BATCHES: usize = 6;

/// Student's t of 97.5 % with `BATCHES - 1` degrees of freedom.
const T_975: f64 = 2.571;

/// An estimate with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// The estimate.
    pub value: f64,
    /// Half of the width of the interval.
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

/// Why a record does not tell a delay.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NotIdentified {
    /// Too little was recorded.
    #[error("{count} {what} in the record, at least {needed} are needed: record for longer")]
    TooFew {
        /// Of what.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there should be.
        needed: usize,
    },
    /// The motion does not show it, or is not there.
    #[error("{what} is not told by this record: the hand must move, and in more than one way while it does")]
    NotExcited {
        /// What was asked for.
        what: &'static str,
    },
    /// The best answer lies at the end of what is looked at.
    #[error(
        "{what} is {value_s:.3} s or beyond: more than {most_s} s is not looked for; check the clock that stamps the images and \
         the link of the arm"
    )]
    TooLong {
        /// What was asked for.
        what: &'static str,
        /// Where the search ended, seconds.
        value_s: f64,
        /// How far is looked, seconds.
        most_s: f64,
    },
}

/// Which piece of the record from `begin_s` to `end_s` the time `at_s` belongs to.
fn batch_of(at_s: f64, (begin_s, end_s): (f64, f64)) -> usize {
    let share = (at_s - begin_s) / (end_s - begin_s);
    // Casts of floats saturate: before the beginning is 0.
    ((share * BATCHES as f64) as usize).min(BATCHES - 1)
}
