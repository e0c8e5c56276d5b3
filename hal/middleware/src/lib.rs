//! Wrappers around hardware backends; each implements the trait that it wraps.
//!
//! [`Limiter`] stands between every controller and every arm: no velocity reaches the arm that is not finite, too fast, too
//! sudden, or too fast for the way that is left to a joint's limit.

mod limiter;
mod shaping;

pub use limiter::{Limiter, LimiterConfig, LimiterError, LimiterStatistics, PA10_OPERATING_RANGE_DEG};
