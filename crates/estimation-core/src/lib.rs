//! Types shared by all estimation methods: the [region] of the target, the [plane hypothesis](plane_hypothesis), the
//! [request](method) and the trait of a method, the [estimate] with its [status], and vector kernels ([`mod@wide`]).
//!
//! This crate contains no method and uses no file, clock, thread or environment.

mod codes;
pub mod error;
pub mod estimate;
pub mod image_view;
pub mod method;
pub mod model_frame;
pub mod plane_hypothesis;
pub mod region;
pub mod rig_errors;
pub mod row_offset;
pub mod status;
pub mod trig;
pub mod wide;

pub use pb3dp_computing::{cpu, rng};
pub use pb3dp_message_codes::Argument;
