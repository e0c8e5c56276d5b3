//! Integration tests of recordings.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests")]

use pb3dp_bag::cdr::Bytes;
use pb3dp_bag::messages::{Header, Image};
use pb3dp_geometry::MonotonicTime;

mod files;
mod live;
mod recent;
mod rotation;

/// A time, milliseconds from the begin of a run in 2023.
fn at(millis: u64) -> MonotonicTime {
    MonotonicTime::from_nanos(1_700_000_000_000_000_000 + millis * 1_000_000)
}

/// A grey image of one row.
fn image_of(width: u32, value: u8) -> Image {
    let header = Header { stamp: at(0).into(), frame_id: "cam".to_owned() };
    let (encoding, data) = ("mono8".to_owned(), Bytes(vec![value; width as usize]));
    Image { header, height: 1, width, encoding, is_bigendian: 0, step: width, data }
}
