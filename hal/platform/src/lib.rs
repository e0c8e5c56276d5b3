//! Operating-system services for backends. Waiting is Linux only: `ppoll`, `eventfd`.
//!
//! * [`transport`]: what all byte links have in common, and a pair of them in one process; [`tcp`] and [`pty`] are two.
//! * [`realtime`], [`signals`]: what the thread of a cycle needs, and how it is asked to end.
//! * [`jitter`], [`witness`]: how late a cycle is, and how late the machine itself.
//! * [`cpu_time`]: what a computation cost a thread.

pub mod cpu_time;
pub mod jitter;
pub mod pty;
pub mod realtime;
pub mod signals;
pub mod tcp;
pub mod transport;
pub mod witness;
