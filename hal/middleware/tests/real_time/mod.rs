//! Tests whose threads must run in time, through `in_real_time`.

mod real_arms;
