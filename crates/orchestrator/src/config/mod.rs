//! Configuration files: read, checked, and turned into the parameters of the parts.

pub mod estimator;
pub mod load;
pub mod setup;

pub use load::ConfigError;
