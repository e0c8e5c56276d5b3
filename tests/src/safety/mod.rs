//! Conditions that hold in every run, with any fault: the truth of a simulated run as plain numbers, and its invariants.
//!
//! This module uses no crate of this workspace. It restates the arm, its limits and its shape from their sources, and
//! computes distances in another way, so that a mistake in limiter, guard, coupling, supervisor or kinematics cannot hide
//! itself.

pub mod invariants;
pub mod pa10;
pub mod rules;
pub mod shape;
pub mod truth;
pub mod ur5e;
pub mod who_may_move;
