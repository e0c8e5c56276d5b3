//! Tests whose threads must run in time: through `programs_in_real_time_beside_others`.

pub mod arm;
pub mod arm_test;
pub mod attended;
pub mod behind_gateway;
pub mod gateway;
pub mod operator;
pub mod signals;
