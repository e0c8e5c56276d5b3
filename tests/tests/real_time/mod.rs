//! Tests whose threads must run in real time: through `programs_in_real_time`.

mod live;
mod real_cameras;
mod threads;
