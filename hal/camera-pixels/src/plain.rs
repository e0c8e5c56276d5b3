//! Formats that need only a reordering of channels, or a table of values.

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

/// One of two interleaved images of luminance: every second byte, beginning with the first one.
pub(super) fn grey_of_two(source: &[u8], target: &mut [u8]) {
    for (pixel, value) in target.as_chunks_mut::<3>().0.iter_mut().zip(source.iter().step_by(2)) {
        *pixel = [*value; 3];
    }
}

/// Luminance of 16 bits, low byte first; `shades` has the 8-bit value of each.
pub(super) fn deep_grey(source: &[u8], target: &mut [u8], shades: &[u8]) {
    for (pixel, value) in target.as_chunks_mut::<3>().0.iter_mut().zip(source.as_chunks::<2>().0) {
        *pixel = [shades[usize::from(u16::from_le_bytes(*value))]; 3];
    }
}
