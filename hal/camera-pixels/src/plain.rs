//! Formats that need only a reordering of channels.

/// Converts luminance to equal red, green and blue.
pub(super) fn grey(source: &[u8], target: &mut [u8]) {
    for (pixel, value) in target.chunks_exact_mut(3).zip(source) {
        pixel.fill(*value);
    }
}

/// Blue, green, red to red, green, blue.
pub(super) fn bgr(source: &[u8], target: &mut [u8]) {
    for (pixel, bgr) in target.chunks_exact_mut(3).zip(source.chunks_exact(3)) {
        pixel.copy_from_slice(&[bgr[2], bgr[1], bgr[0]]);
    }
}
