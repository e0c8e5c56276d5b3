//! Emulated arms at the far end of a line.
//!
//! * [`mock_server`]: in real time, behind a terminal or a socket.
//! * [`virtual_end`]: in virtual time.

pub mod mock_server;
pub mod virtual_end;
mod virtual_line;
