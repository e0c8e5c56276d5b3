//! Control laws: from the error of the hand to its velocity.

pub mod pose_based;
