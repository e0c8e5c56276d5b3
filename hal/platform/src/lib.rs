//! Operating-system services for backends. Waiting is Linux only: `ppoll`, `eventfd`.
//!
//! * [`transport`]: interface of all byte links, and a pair of them in one process; [`tcp`], [`local_socket`] and [`pty`] implement it.
//! * [`realtime`], [`signals`]: real-time scheduling and termination signals for a cycle thread.
//! * [`jitter`], [`witness`]: lateness of a cycle, and of the computer itself.
//! * [`key_file`]: files of secret keys, and random bytes.
//! * [`certificate`]: self-signed certificates for TLS servers.
//! * [`only_program`]: what only one program of a computer may do.
//! * [`cpu_time`]: CPU time of a computation in one thread.

pub mod certificate;
pub mod cpu_time;
pub mod jitter;
pub mod key_file;
pub mod local_socket;
pub mod only_program;
pub mod pty;
pub mod realtime;
pub mod signals;
pub mod tcp;
pub mod transport;
pub mod witness;
