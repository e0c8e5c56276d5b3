//! The scalar code: what the vectors are compared with.

use super::{Coefficients, FRACTION_BITS};

/// `(a * b + 2^14) >> 15`.
fn product(a: i16, b: i16) -> i16 {
    ((i32::from(a) * i32::from(b) + (1 << 14)) >> 15) as i16
}

fn pixel(luma: u8, [red, green, blue]: [i16; 3], coefficients: &Coefficients) -> [u8; 3] {
    // At most 255 * 2^7: fits.
    let luma = product(((i32::from(luma) << 7) - i32::from(coefficients.black)) as i16, coefficients.luma);
    [red, green, blue].map(|of_colour| {
        let sum = i32::from(luma) + i32::from(of_colour) + (1 << (FRACTION_BITS - 1));
        (sum >> FRACTION_BITS).clamp(0, 255) as u8
    })
}

/// Converts one row.
pub(super) fn convert_row(source: &[u8], target: &mut [u8], coefficients: &Coefficients) {
    for (pixels, yuyv) in target.chunks_mut(6).zip(source.chunks_exact(4)) {
        let [u, v] = [yuyv[1], yuyv[3]].map(|colour| ((i32::from(colour) - 128) << 8) as i16);
        let colour = [
            product(v, coefficients.red_of_v),
            product(u, coefficients.green_of_u) + product(v, coefficients.green_of_v),
            product(u, coefficients.blue_of_u),
        ];
        for (target, luma) in pixels.chunks_exact_mut(3).zip([yuyv[0], yuyv[2]]) {
            target.copy_from_slice(&pixel(luma, colour, coefficients));
        }
    }
}
