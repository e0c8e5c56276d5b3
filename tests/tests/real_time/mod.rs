//! Tests whose threads must run in real time: through `programs_in_real_time_beside_others`.

mod live;
mod real_cameras;
mod threads;
