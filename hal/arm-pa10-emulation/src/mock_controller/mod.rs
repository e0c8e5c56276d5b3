//! The servo controller of a PA-10 with its arm, emulated byte by byte at the far end of the ARCNET bus. Without I/O and clock.
//!
//! [`MockController`] takes frames ([`pb3dp_arm_pa10_protocol::arcnet`]) and returns the replies when they are due. It emulates:
//! * both wire formats, the letters S, C, E, A and R, and T in builds that have it; M, W and P are refused and counted;
//! * power-up in the adjustment mode with brakes on, the control mode between S and E, its own watchdog, power off and on;
//! * brakes and servos of each axis with their times, joints that fall when neither holds them, software limits;
//! * alarms, switches and status words.
//!
//! The joints are a [`pb3dp_sim::joint_dynamics::JointPlant`] that may be shared with simulated cameras; any owner may advance it
//! up to the present.
//!
//! [`Fault`]s come from a [`Script`], by chance, or from a line that an operator types; `docs/mock-arm.md` lists them.
//!
//! Behaviour that no source states is chosen as follows. The watchdog, an alarm of the controller and the letter E stop the arm
//! with its servos before these switch off. The emergency stop and a power loss switch the servos off at once. An axis that raises
//! an alarm loses its own servo, and the others continue unless commands request otherwise. In format A the status words have the
//! bits of format B, on which no program may rely.

mod axis;
mod command;
mod config;
mod controller;
mod fault;
mod line;
mod messages;
mod outbox;
mod panel;
mod random;
mod schedule;
mod script;
mod words;

pub use config::{MockControllerConfig, MockControllerError, pa10_joints};
pub use controller::{ControlMode, MockController, MockCounters};
pub use fault::{Fault, LineFault, ReplyFault, Side};
pub use script::{Script, ScriptError, ScriptLine, When};
pub use words::{LineError, parse_time};
