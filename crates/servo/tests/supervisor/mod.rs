//! The supervisor: permissions and messages.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

pub mod bench;
mod conditions;
mod holding;
mod policies;
mod properties;
mod searching;
mod settling;
mod stalls;
mod starting;
mod table;
mod wording;
