//! Tests whose pages and control thread must answer in time: half a second of silence stops the arms.

mod access;
mod cameras;
mod commands;
mod encrypted;
mod heartbeats;
mod limits;
mod watching;
