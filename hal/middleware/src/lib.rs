//! Wrappers around hardware backends; each implements the trait that it wraps.
//!
//! [`Limiter`] is between every controller and every arm. No velocity reaches the arm that is not finite, exceeds a speed,
//! acceleration or jerk limit, or is too high for the remaining distance to a joint limit (docs/arm-limits.md). [`Guard`] comes
//! after it and monitors the motion of the arm: a joint that jumps, is too fast or does not follow its command stops the arm until
//! an operator resets it. [`Coupled`] arms stop together, and get no command that could bring them too close. [`Recorded`] wraps
//! the arm itself and keeps the last exchanges.

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
pub use recorder::{FlightEntry, FlightLog, Recorded, RecordedRequest, SampleListener};
