//! What every estimation method shares: the [region] of the target, the [plane hypothesis](plane_hypothesis) that is searched,
//! the [request](method) and the trait that every method implements, the [answer](estimate) with its [status], and vector kernels from one source ([`mod@wide`]).
//!
//! No method lives here, and no file, clock, thread or environment.

pub mod error;
pub mod estimate;
pub mod method;
pub mod model_frame;
pub mod plane_hypothesis;
pub mod region;
pub mod row_offset;
pub mod status;
pub mod trig;
pub mod wide;

pub use pb3dp_computing::{cpu, rng};
