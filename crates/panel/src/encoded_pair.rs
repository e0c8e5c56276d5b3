//! Images as messages.

use axum::body::Bytes;
use pb3dp_geometry::MonotonicTime;

/// The images of one pair as messages; those that nobody wants are missing.
#[derive(Clone, Debug, Default)]
pub struct EncodedPair {
    /// Exposure time.
    pub at: MonotonicTime,
    /// By view (raw, rectified) and side (left, right).
    pub messages: [[Option<Bytes>; 2]; 2],
}
