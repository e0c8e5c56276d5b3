//! Whether a serial line is quick enough.

use std::time::Duration;

use super::frame::OVERHEAD;
use super::host_message::COMMAND_LENGTH;
use super::state::STATE_LENGTH;

/// Bits on the line per byte: start, 8 of data, stop.
const BITS_PER_BYTE: u64 = 10;

/// A line is too slow for a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{baud} baud take {exchange:?} for a command and its answer ({EXCHANGE_BYTES} bytes), more than half of a cycle of {cycle:?}, which needs at \
     least {least} baud: choose a higher rate, or a longer cycle of up to 10 ms"
)]
pub struct LineTooSlow {
    baud: u32,
    least: u64,
    exchange: Duration,
    cycle: Duration,
}

/// Bytes of a cyclic command and its answer.
pub const EXCHANGE_BYTES: usize = 2 * OVERHEAD + COMMAND_LENGTH + STATE_LENGTH;

/// How long a command and its answer take on a serial line with 8 data bits, no parity and 1 stop bit.
pub fn exchange_time(baud: u32) -> Duration {
    let bits = EXCHANGE_BYTES as u64 * BITS_PER_BYTE;
    Duration::from_nanos((bits * 1_000_000_000).checked_div(u64::from(baud)).unwrap_or(u64::MAX))
}

/// Whether a line carries a command and its answer within half of a cycle.
///
/// # Errors
/// If it does not; the text says how long they take.
pub fn check_line(baud: u32, cycle: Duration) -> Result<(), LineTooSlow> {
    let exchange = exchange_time(baud);
    if exchange <= cycle / 2 {
        return Ok(());
    }
    let least = (EXCHANGE_BYTES as f64 * BITS_PER_BYTE as f64 / (cycle / 2).as_secs_f64()).ceil() as u64;
    Err(LineTooSlow { baud, least, exchange, cycle })
}
