//! Wrappers around hardware backends; each implements the trait that it wraps.
//!
//! [`Limiter`] stands between every controller and every arm: no velocity reaches the arm that is not finite, too fast, too
//! sudden, or too fast for the way that is left to a joint's limit (docs/arm-limits.md). [`Guard`] stands behind it and watches what the arm makes
//! of it: a joint that jumps, is too fast or does not follow its command stops the arm until an operator resets it. [`Coupled`] arms
//! stop with each other, and get no command that could bring them too near to each other. [`Recorded`] stands around the arm
//! itself and keeps the last exchanges.

mod coupling;
mod expectation;
mod guard;
mod last_command;
mod limiter;
mod power;
mod recorder;
mod shaping;
mod stopping;

pub use coupling::{Coupled, CoupledArmConfig, CoupledError, CoupledStatistics, couple};
pub use guard::{Guard, GuardConfig, GuardError, PA10_MECHANICAL_RANGE_DEG};
pub use last_command::CommandFade;
pub use limiter::{Limiter, LimiterConfig, LimiterError, LimiterStatistics, StartPose};
pub use recorder::{FlightEntry, FlightLog, Recorded, RecordedRequest};
