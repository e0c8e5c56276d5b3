//! The required safety tests. `cargo xtask ci` fails if one of them was not checked; `cargo xtask test --prove-red` breaks the
//! property behind each test, and checks that the test fails.

use std::collections::BTreeSet;

use anyhow::bail;

use crate::test::{Report, Selection};

/// A safety property and the test that shows it.
#[derive(Clone, Copy, Debug)]
pub struct Required {
    /// The property.
    pub what: &'static str,
    /// The package of the test.
    pub package: &'static str,
    /// The test program.
    pub program: &'static str,
    /// Name of the test in the program.
    pub test: &'static str,
    /// The patch that breaks the property, in tests/red.
    pub patch: &'static str,
}

const ARM: &str = "pb3dp-arm-pa10";

/// One test per property.
pub const REQUIRED: [Required; 10] = [
    Required {
        what: "an arm whose program is killed is braked",
        package: ARM,
        program: "alone",
        test: "killed::braked_after_kill_9",
        patch: "kill-9.patch",
    },
    Required {
        what: "an arm whose cable is unplugged stops",
        package: ARM,
        program: "integration",
        test: "real_time::io_arm_link::unplugging_in_motion_is_noticed_within_20_ms_and_needs_a_reset",
        patch: "unplug.patch",
    },
    Required {
        what: "the emergency stop of either arm stops both",
        package: "pb3dp-servo",
        program: "integration",
        test: "supervisor::conditions::each_condition_does_what_its_policy_says_when_it_has_lasted",
        patch: "emergency-stop.patch",
    },
    Required {
        what: "a stale command fades and stops the arm",
        package: ARM,
        program: "integration",
        test: "driver::a_velocity_whose_successor_stays_away_fades_and_stops",
        patch: "stale-command.patch",
    },
    Required {
        what: "three lost replies stop the arm",
        package: ARM,
        program: "integration",
        test: "real_time::io_arm_link::a_lost_answer_is_borne_and_three_are_a_fault",
        patch: "lost-replies.patch",
    },
    Required {
        what: "control allocates nothing",
        package: ARM,
        program: "alone",
        test: "no_allocation::exchanges",
        patch: "allocation.patch",
    },
    Required {
        what: "the second arm stops with the first",
        package: "pb3dp-hal-middleware",
        program: "integration",
        test: "coupling::what_stops_one_arm_stops_the_other_within_a_cycle_until_both_are_reset",
        patch: "second-arm.patch",
    },
    Required {
        what: "the gateway stops the arm of a silent host",
        package: "pb3dp-arm-pa10-gateway",
        program: "integration",
        test: "gateway_watchdogs::a_command_whose_successor_stays_away_fades_and_stops",
        patch: "gateway-watchdog.patch",
    },
    Required {
        what: "a stopped arm does not start before a reset",
        package: ARM,
        program: "integration",
        test: "host_fault::the_next_program_waits_for_a_reset_whatever_this_one_has_found",
        patch: "reset.patch",
    },
    Required {
        what: "a stop order that the controller has not acknowledged is repeated",
        package: ARM,
        program: "integration",
        test: "unheard_gateway::an_outage_that_ends_at_any_step_of_the_stop_order_leaves_no_arm_moving",
        patch: "stop-order.patch",
    },
];

/// Largest share of the tests in real time that a machine may leave unchecked.
const UNCHECKED_MAX: f64 = 0.03;

/// # Errors
/// If a required test of a selected package did not pass, or too many tests in real time were not checked.
pub fn check(report: &Report, packages: &Selection) -> anyhow::Result<()> {
    let unchecked: BTreeSet<&str> = report.not_checked().map(|line| line.split(": ").next().unwrap_or(line)).collect();
    for required in REQUIRED.iter().filter(|required| packages.has(required.package)) {
        if unchecked.contains(required.test) || !report.has_passed(required.package, required.test) {
            bail!("not checked, but required: {} ({}: {})", required.what, required.package, required.test);
        }
    }
    let [left_out, all] = report.real_time_counts();
    println!("tests in real time: {all}, of them not checked: {left_out}");
    if left_out as f64 > UNCHECKED_MAX * all as f64 {
        bail!("{left_out} of {all} tests in real time were not checked, the limit is {:.0} %", 100.0 * UNCHECKED_MAX);
    }
    Ok(())
}
