//! Limits of the steps of the checklist, with their reasons.

use std::time::Duration;

/// Number of messages that test the link.
pub const EXCHANGES: u32 = 300;
/// Largest share of lost messages, percent.
pub const LOST_PERCENT_MAX: f64 = 1.0;
/// Largest lateness of a command, ms: a later one counts as an overrun of the host.
pub const LATE_MAX_MS: f64 = 5.0;
/// Largest apparent motion of joints with closed brakes, degrees: 45 counts of the resolvers.
pub const BRAKED_MAX_DEG: f64 = 0.02;
/// Largest lag of a moving axis behind its plan, degrees.
pub const BEHIND_MAX_DEG: f64 = 0.5;
/// Largest motion of joints commanded to hold, degrees.
pub const OTHERS_MAX_DEG: f64 = 0.1;
/// Largest residual of an axis at the end of its move, degrees.
pub const END_MAX_DEG: f64 = 0.05;
/// Largest ratio of measured to allowed speed, for two consecutive samples (R13).
pub const OVER_SPEED: f64 = 1.1;
/// Rotation in the wrong direction that aborts the move, degrees.
pub const WRONG_WAY_DEG: f64 = 0.2;
/// Largest sag of a joint when brakes close or drives lose power, degrees.
pub const SAG_MAX_DEG: f64 = 2.0;
/// Largest joint speed after an emergency stop, rad/s: the speed limit of the slowest joints.
pub const FALL_MAX_RAD_PER_S: f64 = 1.0;
/// Speed of every joint below which an arm is stationary, rad/s: ten counts of a measured speed.
pub const REST_RAD_PER_S: f64 = 2e-3;
/// Longest time from an action to the stop of the program, ms; only if the program performs the action.
pub const NOTICED_MAX_MS: f64 = 30.0;
/// Control cycles from the last measurement to the fault of a silent link: three lost replies and the wait for the last one.
pub const SILENT_CYCLES_MAX: f64 = 5.0;
/// Largest travel in excess of the watchdog time, degrees: play of the brakes.
pub const PLAY_DEG: f64 = 0.5;
/// Margin on the braking time until an arm is stationary.
pub const REST_MARGIN: Duration = Duration::from_millis(50);
/// Margin on the brake time for an arm stopped by the other one, ms: R8 gives 100 ms.
pub const INTERLOCK_REST_MAX_MS: f64 = 100.0;
/// Wait before a stopped arm is checked: at 0.02 rad/s an arm that continues moves 2.3 degrees.
pub const LEFT_ALONE: Duration = Duration::from_secs(2);
