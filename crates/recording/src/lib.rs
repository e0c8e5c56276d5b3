//! Runs in one file: recorded with all their inputs, replayed to the bit, and compared.
//!
//! * [`run`]: what a run writes, for other programs and for a replay;
//! * [`pairs`]: stereo pairs only;
//! * [`stops`]: the visit of an arm, for a calibration;
//! * [`replay`]: the run again, from its recorded inputs;
//! * [`compare`]: what differs between two recorded runs.
//!
//! The messages are those of `pb3dp-bag` (ADR 18).

pub mod compare;
mod estimates;
mod exact;
mod head;
pub mod pairs;
pub mod replay;
pub mod run;
pub mod series;
mod steps;
pub mod stops;
mod tap;
