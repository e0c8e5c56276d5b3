//! What must hold in every run, whatever goes wrong: the truth of a simulated run as plain numbers, and the invariants on it.
//!
//! Nothing in here uses a crate of this workspace. The arm, its limits and its shape are written down once more, from their
//! sources, and distances are computed in another way; a mistake in limiter, guard, coupling, supervisor or kinematics cannot
//! hide itself.

pub mod invariants;
pub mod pa10;
pub mod rules;
pub mod shape;
pub mod truth;
