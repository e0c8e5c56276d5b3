//! Images as messages.

use axum::body::Bytes;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::FramePair;

use crate::messages::time_ms;

/// Kind of a JPEG image, and of an overlay as PNG.
pub const JPEG_IMAGE: u8 = 0;
pub const PNG_OVERLAY: u8 = 1;
/// Flag of a rectified image.
pub const RECTIFIED: u16 = 1;
/// Size of the head.
const HEAD_BYTES: usize = 32;

/// The images of one pair as messages; those that nobody wants are missing.
#[derive(Clone, Debug, Default)]
pub struct EncodedPair {
    /// Exposure time.
    pub at: MonotonicTime,
    /// By view (raw, rectified) and side (left, right).
    pub messages: [[Option<Bytes>; 2]; 2],
    /// Heat overlay of the raw left image.
    pub heat: Option<Bytes>,
}

/// Head of an image message.
pub struct ImageHead<'a> {
    /// The pair.
    pub pair: &'a FramePair,
    /// 0 left, 1 right.
    pub side: u8,
    /// Image or overlay.
    pub kind: u8,
    /// [`RECTIFIED`] or 0.
    pub flags: u16,
    /// Width and height, and the place of an overlay, pixels.
    pub place: [u32; 4],
}

impl ImageHead<'_> {
    /// The head, with space for a file of this size; `None` if a number is too large for it.
    pub fn to_bytes(&self, file_bytes: usize) -> Option<Vec<u8>> {
        let mut bytes = Vec::with_capacity(HEAD_BYTES + file_bytes);
        bytes.extend_from_slice(b"PBI1");
        bytes.extend_from_slice(&[self.side, self.kind]);
        bytes.extend_from_slice(&self.flags.to_le_bytes());
        bytes.extend_from_slice(&self.pair.sequence.to_le_bytes());
        bytes.extend_from_slice(&time_ms(self.pair.exposed_at).to_le_bytes());
        for number in self.place {
            bytes.extend_from_slice(&u16::try_from(number).ok()?.to_le_bytes());
        }
        Some(bytes)
    }
}
