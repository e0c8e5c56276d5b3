//! Tests of the panel over real sockets, with a real supervisor in place of a run.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, missing_docs)]

mod support;

mod access;
mod cameras;
mod commands;
mod encrypted;
mod heartbeats;
mod limits;
mod messages;
mod parsing;
mod watching;
