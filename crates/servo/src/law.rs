//! Control laws: from the error of the hand to its velocity.

pub mod feed_forward;
pub mod pose_based;
