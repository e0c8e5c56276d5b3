//! Integration tests of the PA-10 driver, and of its chain with the gateway and the emulation.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod chain_injections;
mod chain_line;
mod chain_shown;
mod driver;
mod driver_connection;
mod driver_doubts;
mod driver_owner;
mod driver_properties;
mod driver_table;
mod driver_words;
mod host_fault;
mod io_links;
mod io_serial;
mod keyed_records;
mod known_driver_bugs;
mod link;
mod link_faults;
mod no_allocation;
mod old_measurements;
mod real_time;
mod unacknowledged_stop;
mod virtual_time;
