//! What touches the world: byte links, threads and clocks. The rest of the crate is told bytes and time.
//!
//! * [`arm`]: a real PA-10 behind a gateway.
//! * [`bus`]: the ARCNET bus of an arm, and a socket in its place.
//! * [`gateway`]: a gateway that runs, with a thread that keeps the cycle.
//! * [`mock_server`]: an emulated arm in real time.
//! * [`realtime`], [`signals`]: what the thread of a cycle needs, and how it is asked to end.
//! * [`witness`]: how late the machine itself is.
//! * [`transport`]: what all byte links have in common, and a pair of them in one process.
//! * [`serial`], [`tcp`]: the two ways to a gateway.
//! * [`pty`]: a pseudo-terminal, for a gateway or a controller without hardware.
//!
//! Linux only, as far as it waits: `ppoll`, `eventfd`.

pub mod arm;
pub mod bus;
pub mod gateway;
pub mod mock_server;
pub mod pty;
pub mod realtime;
pub mod serial;
pub mod signals;
pub mod tcp;
pub mod transport;
pub mod witness;
