//! Tests of the whole system.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod camera_faults;
mod closed_loop;
mod configs;
mod control_no_allocation;
mod disturbed;
mod effective_limits;
mod late_images;
mod mutated_inputs;
mod rates;
mod real_pairs;
mod real_time;
mod realigned;
mod safety_numbers;
mod selected;
mod stalls;
mod start_and_resume;
mod start_and_resume_page;
mod supervised;
