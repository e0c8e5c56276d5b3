//! The scalar code: reference for the vector kernels, and fallback for processors without them.

use super::{Coefficients, FRACTION_BITS};

/// Lookup tables of the products of each byte, with [`FRACTION_BITS`] fractional bits.
#[derive(Clone, Debug)]
pub(super) struct Tables {
    /// Includes half a step, so that truncated sums are rounded.
    luma: [i16; 256],
    red_of_v: [i16; 256],
    green_of_u: [i16; 256],
    green_of_v: [i16; 256],
    blue_of_u: [i16; 256],
}

impl Tables {
    pub(super) fn of(coefficients: &Coefficients) -> Self {
        let of_colour = |coefficient| of_each_byte(|byte| product((byte - 128) << 8, coefficient));
        Self {
            // At most 255 * 2^7 enters the product: fits.
            luma: of_each_byte(|byte| {
                product((byte << 7) - coefficients.black, coefficients.luma) + (1 << (FRACTION_BITS - 1))
            }),
            red_of_v: of_colour(coefficients.red_of_v),
            green_of_u: of_colour(coefficients.green_of_u),
            green_of_v: of_colour(coefficients.green_of_v),
            blue_of_u: of_colour(coefficients.blue_of_u),
        }
    }
}

fn of_each_byte(value: impl Fn(i16) -> i16) -> [i16; 256] {
    let mut table = [0; 256];
    for (entry, byte) in table.iter_mut().zip(0..) {
        *entry = value(byte);
    }
    table
}

/// `(a * b + 2^14) >> 15`.
fn product(a: i16, b: i16) -> i16 {
    ((i32::from(a) * i32::from(b) + (1 << 14)) >> 15) as i16
}

/// Converts one row.
pub(super) fn convert_row(source: &[u8], target: &mut [u8], tables: &Tables) {
    let (pairs, odd) = target.as_chunks_mut::<6>();
    let (sources, _) = source.as_chunks::<4>();
    for (pixels, yuyv) in pairs.iter_mut().zip(sources) {
        *pixels = two_pixels(*yuyv, tables);
    }
    if let Some(last) = sources.get(pairs.len()) {
        let length = odd.len();
        odd.copy_from_slice(&two_pixels(*last, tables)[..length]);
    }
}

#[inline]
fn two_pixels([first, u, second, v]: [u8; 4], tables: &Tables) -> [u8; 6] {
    let [first, second] = [first, second].map(|luma| i32::from(tables.luma[usize::from(luma)]));
    let (u, v) = (usize::from(u), usize::from(v));
    let red = i32::from(tables.red_of_v[v]);
    let green = i32::from(tables.green_of_u[u]) + i32::from(tables.green_of_v[v]);
    let blue = i32::from(tables.blue_of_u[u]);
    [first + red, first + green, first + blue, second + red, second + green, second + blue]
        .map(|sum| (sum >> FRACTION_BITS).clamp(0, 255) as u8)
}
