//! How a frame ended.

use std::fmt::{self, Display, Formatter};

use crate::judge::Misfit;

/// Result of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Ending {
    /// The pose was found and fits.
    Found,
    /// The alignment does not fit.
    Misfit(Misfit),
    /// Too little of the predicted target is inside the images.
    OutOfSight,
    /// The predicted target is inside the images, but nothing matches it.
    NothingAlike,
    /// A camera (0 left, 1 right) repeats its last image.
    Stuck(usize),
    /// A candidate is too far from the prediction, or matches too poorly at this distance.
    OutOfReach,
    /// A candidate is the target or another one that looks like it.
    OneOfSeveral,
}

impl Display for Ending {
    /// The reason; empty if the target was found.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Found => Ok(()),
            Self::Misfit(misfit) => write!(f, "{misfit}"),
            Self::Stuck(side) => {
                let (stuck, other) = if *side == 0 { ("left", "right") } else { ("right", "left") };
                write!(f, "the {stuck} image has not changed while the {other} image has: check the {stuck} camera")
            }
            Self::OutOfSight => f.write_str("the predicted target is outside the image of at least one camera"),
            Self::NothingAlike => f.write_str(
                "target not found, neither at the predicted pose nor elsewhere: it is occluded or its appearance has changed",
            ),
            Self::OutOfReach => f.write_str(
                "a candidate was found, but it is too far from the predicted pose, or matches too poorly there",
            ),
            Self::OneOfSeveral => f.write_str(
                "what is found may be the target or another one that looks the same and was seen beside it: mark the target again",
            ),
        }
    }
}
