//! Tests whose threads must run in time, through `in_real_time_beside_others`.

mod gateway_access;
mod gateway_on_the_wire;
mod io_arm;
mod io_arm_cell;
mod io_arm_conformance;
mod io_arm_link;
mod io_arm_on_bus;
mod io_gateway;
mod io_mock_server;
mod io_unplugged;
