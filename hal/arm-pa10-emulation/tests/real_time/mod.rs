//! Tests whose threads must run in time, through `in_real_time_beside_others`.

mod io_mock_server;
