//! Tests whose threads must run in time, through `in_real_time_beside_others`.

mod gateway_access;
mod gateway_on_the_wire;
mod io_gateway;
