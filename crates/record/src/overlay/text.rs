//! Labels in a bitmap font of 8 by 8 pixels.

use font8x8::legacy::{BASIC_LEGACY, LATIN_LEGACY};
use image::{Rgb, RgbImage};

use super::blend;

const GLYPH_PX: u32 = 8;

/// Text style.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextStyle {
    /// Colour of the letters.
    pub color: Rgb<u8>,
    /// Colour of a translucent box behind them; `None` for no box.
    pub background: Option<Rgb<u8>>,
    /// Pixels per pixel of the font; 1 is a letter of 8 by 8, 2 of 16 by 16.
    pub scale: u32,
}

impl TextStyle {
    /// Letters of 8 pixels on a dark box, readable on any photograph.
    pub fn of(color: Rgb<u8>) -> Self {
        Self { color, background: Some(Rgb([0, 0, 0])), scale: 1 }
    }
}

/// Width and height of a text, pixels; lines are separated by `\n`.
pub fn text_size(label: &str, scale: u32) -> (u32, u32) {
    let columns = label.lines().map(|line| line.chars().count() as u32).max().unwrap_or(0);
    let lines = label.lines().count() as u32;
    (columns * GLYPH_PX * scale, lines * (GLYPH_PX + 2) * scale)
}

/// Draws a label with its top left corner at a point. Latin letters and the degree sign are supported, everything else is drawn
/// as a question mark; text is clipped at the image border.
pub fn text(image: &mut RgbImage, at_px: [f64; 2], label: &str, style: TextStyle) {
    let near = |x: f64| x.is_finite() && x.abs() < 1e6;
    if !near(at_px[0]) || !near(at_px[1]) || style.scale == 0 {
        return;
    }
    let (left, top) = (at_px[0].round() as i64, at_px[1].round() as i64);
    if let Some(color) = style.background {
        let (width, height) = text_size(label, style.scale);
        rectangle(image, [left - 2, top - 2], [width + 4, height + 2], color, 0.6);
    }
    let step = i64::from(GLYPH_PX * style.scale);
    for (row, line) in (0_i64..).zip(label.lines()) {
        let y = top + row * i64::from((GLYPH_PX + 2) * style.scale);
        for (column, character) in (0_i64..).zip(line.chars()) {
            draw_glyph(image, [left + column * step, y], &glyph(character), style);
        }
    }
}

/// Eight rows from the top; the lowest bit is the leftmost pixel.
fn glyph(character: char) -> [u8; 8] {
    let code = character as usize;
    let found = if code < 0x80 { BASIC_LEGACY.get(code) } else { LATIN_LEGACY.get(code.wrapping_sub(0xA0)) };
    found.copied().unwrap_or(BASIC_LEGACY[usize::from(b'?')])
}

fn draw_glyph(image: &mut RgbImage, [left, top]: [i64; 2], rows: &[u8; 8], style: TextStyle) {
    let scale = i64::from(style.scale);
    for (row, bits) in (0_i64..).zip(rows) {
        for column in (0_i64..8).filter(|column| bits >> column & 1 == 1) {
            let at = [left + column * scale, top + row * scale];
            rectangle(image, at, [style.scale, style.scale], style.color, 1.0);
        }
    }
}

fn rectangle(image: &mut RgbImage, at: [i64; 2], size: [u32; 2], color: Rgb<u8>, opacity: f64) {
    let range = |start: i64, length: u32, limit: u32| {
        let clip = |x: i64| x.clamp(0, i64::from(limit)) as u32;
        clip(start)..clip(start + i64::from(length))
    };
    for v in range(at[1], size[1], image.height()) {
        for u in range(at[0], size[0], image.width()) {
            blend(image, u, v, color, opacity);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_stand_upright_and_are_not_mirrored() {
        let style = TextStyle { color: Rgb([255, 0, 0]), background: None, scale: 1 };
        let mut image = RgbImage::new(8, 8);
        text(&mut image, [0.0, 0.0], "L", style);
        let share = |u: std::ops::Range<u32>, v: std::ops::Range<u32>| {
            v.flat_map(|v| u.clone().map(move |u| (u, v))).filter(|(u, v)| image.get_pixel(*u, *v).0[0] > 0).count()
        };
        assert!(share(0..4, 0..4) > share(4..8, 0..4), "the stem is on the left");
        assert!(share(0..8, 4..8) > share(0..8, 0..4), "the foot is below");
    }

    #[test]
    fn scale_and_lines_give_the_size() {
        assert_eq!(text_size("ab\nlonger", 2), (96, 40));
        assert_eq!(glyph('\u{4e2d}'), glyph('?'));
        assert_ne!(glyph('°'), glyph('?'));
        let mut image = RgbImage::new(20, 20);
        text(&mut image, [-4.0, 15.0], "cut at the edges", TextStyle::of(Rgb([255, 255, 255])));
        assert!(image.pixels().any(|p| p.0[0] == 255));
    }
}
