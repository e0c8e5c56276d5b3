//! Configuration files: reading, checks, and conversion to the parameters of the other crates.

mod arm_backend;
mod codes;
pub mod direct;
mod error;
pub mod estimator;
#[cfg(test)]
mod every_key_tests;
pub mod explain;
pub mod layers;
pub mod load;
pub mod names;
pub mod recorded_settings;
pub mod region_spec;
pub mod setup;
mod table;
mod units;

pub use load::ConfigError;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}
