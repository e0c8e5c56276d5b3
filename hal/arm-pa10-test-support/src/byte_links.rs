//! Helpers for tests of byte links.

use std::time::Duration;

use pb3dp_hal_platform::transport::{ByteLink, wait};

pub const LONG: Duration = Duration::from_secs(5);

/// Reads this number of bytes, in the pieces in which they arrive.
pub fn read_exactly(link: &mut dyn ByteLink, count: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut buffer = [0; 64];
    while bytes.len() < count {
        assert!(wait(Some(&*link), false, None, LONG).readable, "{} of {count}", bytes.len());
        let got = link.try_read(&mut buffer).unwrap();
        bytes.extend_from_slice(&buffer[..got]);
    }
    bytes
}
