//! Tests of the panel over real sockets, with a real supervisor in place of a run.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, missing_docs)]

mod support;

mod parsing;
mod real_time;
