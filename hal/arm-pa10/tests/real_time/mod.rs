//! Tests whose threads must run in time, through `in_real_time_beside_others`.

mod io_arm;
mod io_arm_cell;
mod io_arm_conformance;
mod io_arm_link;
mod io_unplugged;
