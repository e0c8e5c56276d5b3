//! Corners of AprilGrids. Where black squares in the gaps touch the corners of tags, squares meet as on a chessboard. The
//! chessboard detector therefore finds the corners; combinations of four are then tested for a readable tag.

use calib_targets_aruco::{MarkerCell, Matcher, ScanDecodeConfig, decode_marker_in_cell, resolve_dictionary};
use calib_targets_chessboard::{GrayImageView, detect_corners};
use image::GrayImage;
use nalgebra::{Point2, Vector2};
use std::collections::BTreeMap;

use super::refine::refined;
use super::{Localizer, NoBoard, enough, gray_view};
use crate::board::{APRIL_TAGS, Board, BoardCorner, Sighting};

/// Neighbours of a corner tested as the next corner of its tag; tags also contain corners inside.
const NEIGHBOURS: usize = 60;
/// Sampling distance on both sides of a tag edge (black inside, white outside), as a share of the edge length.
const BESIDE_SHARE: f64 = 0.06;
/// Minimum sampling distance, px.
const BESIDE_MIN_PX: f64 = 1.5;
/// Minimum contrast between black and white at an edge, grey levels.
const CONTRAST_MIN: f64 = 20.0;
/// Maximum ratio of the side lengths of a tag in an image.
const SIDES_RATIO_MAX: f64 = 2.5;
/// Minimum sine of the angle between two sides.
const SINE_MIN: f64 = 0.35;
/// Minimum readable side: at least ten cells.
const SIDE_MIN_PX: f64 = 14.0;
/// Tolerated wrong bits; tags differ by eleven.
const WRONG_BITS_MAX: u8 = 2;
/// Width of a tag's black border, in bits: Kalibr's, and that of other programs.
const BORDERS_BITS: [usize; 2] = [2, 1];
/// Side of the resampled tag image, px.
const SAMPLED_PX: f32 = 80.0;

/// A tag: indices of its corners, clockwise from the upper left, and the number of wrong bits.
#[derive(Clone, Copy)]
struct Tag {
    corners: [usize; 4],
    wrong_bits: u8,
}

/// Finds the corners of all readable tags; a part of the board is enough.
pub(super) fn find(image: &GrayImage, board: &Board, localizer: Localizer) -> Result<Sighting, NoBoard> {
    let view = gray_view(image);
    let pixels: Vec<Vector2<f64>> = detect_corners(&view, &localizer.detector())
        .iter()
        .map(|corner| Vector2::new(f64::from(corner.position.x), f64::from(corner.position.y)))
        .collect();
    let quads = quads(image, &pixels);
    let tags = BORDERS_BITS.map(|border_bits| read(&view, &pixels, &quads, border_bits));
    let tags = tags.into_iter().max_by_key(BTreeMap::len).unwrap_or_default();
    let mut corners = Vec::new();
    for (id, tag) in tags.iter().filter_map(|(id, tag)| Some((*id, tag.as_ref()?))) {
        // Tags are counted from the lower left, along the rows.
        let (across, up) = (id % (board.columns() / 2), id / (board.columns() / 2));
        let Some(down) = (board.rows() / 2).checked_sub(1 + up) else { continue };
        let places = [(0, 0), (1, 0), (1, 1), (0, 1)];
        corners.extend(places.into_iter().zip(tag.corners).map(|((column, row), index)| BoardCorner {
            column: 2 * across + column,
            row: 2 * down + row,
            pixel: refined(image, &pixels[index]),
        }));
    }
    if corners.is_empty() {
        return Err(NoBoard::Markers);
    }
    enough(corners, board)
}

/// All sets of four corners, clockwise in the image, that may form a tag; each set once.
fn quads(image: &GrayImage, pixels: &[Vector2<f64>]) -> Vec<[usize; 4]> {
    let next: Vec<Vec<usize>> = (0..pixels.len()).map(|first| next_corners(image, pixels, first)).collect();
    let meet = |a: usize, b: usize, c: usize| sides_fit(&(pixels[b] - pixels[a]), &(pixels[c] - pixels[b]));
    let mut quads = Vec::new();
    for (a, of_a) in next.iter().enumerate() {
        // Each quad is found from all its corners; the corner with the lowest index represents it.
        for b in of_a.iter().copied().filter(|b| *b > a) {
            for c in next[b].iter().copied().filter(|c| *c > a && meet(a, b, *c)) {
                let fourth = next[c].iter().copied().filter(|d| *d > a && meet(b, c, *d) && meet(c, *d, a));
                quads.extend(fourth.filter(|d| next[*d].contains(&a) && meet(*d, a, b)).map(|d| [a, b, c, d]));
            }
        }
    }
    quads
}

/// The corners that a side of a tag may reach from a given corner, clockwise around the tag.
fn next_corners(image: &GrayImage, pixels: &[Vector2<f64>], first: usize) -> Vec<usize> {
    let from = pixels[first];
    let mut near: Vec<(f64, usize)> = pixels
        .iter()
        .enumerate()
        .map(|(n, pixel)| ((pixel - from).norm(), n))
        .filter(|(length, _)| *length >= SIDE_MIN_PX)
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(NEIGHBOURS);
    near.retain(|(_, n)| is_side(image, &from, &pixels[*n]));
    near.into_iter().map(|(_, n)| n).collect()
}

/// Whether the line from one point to the other has black on its right and white on its left (y is down).
fn is_side(image: &GrayImage, from: &Vector2<f64>, to: &Vector2<f64>) -> bool {
    let along = to - from;
    let beside = (BESIDE_SHARE * along.norm()).max(BESIDE_MIN_PX) / along.norm();
    let right = Vector2::new(-along.y, along.x) * beside;
    let value = |at: Vector2<f64>| {
        let (x, y) = (at.x.round(), at.y.round());
        let inside = x >= 0.0 && y >= 0.0;
        let pixel = inside.then(|| image.get_pixel_checked(x as u32, y as u32)).flatten();
        pixel.map(|pixel| f64::from(pixel.0[0]))
    };
    [0.2, 0.35, 0.5, 0.65, 0.8].into_iter().all(|share| {
        let middle = from + along * share;
        value(middle - right).zip(value(middle + right)).is_some_and(|(white, black)| white - black >= CONTRAST_MIN)
    })
}

/// Whether two sides may meet at a corner of a tag, the second one clockwise from the first one (y is down).
fn sides_fit(along: &Vector2<f64>, down: &Vector2<f64>) -> bool {
    let (a, b) = (along.norm(), down.norm());
    a.max(b) <= SIDES_RATIO_MAX * a.min(b) && along.perp(down) >= SINE_MIN * a * b
}

/// The readable tags, by number; `None` if one number was read at two positions.
fn read(
    view: &GrayImageView<'_>,
    pixels: &[Vector2<f64>],
    quads: &[[usize; 4]],
    border_bits: usize,
) -> BTreeMap<u32, Option<Tag>> {
    let Some(dictionary) = resolve_dictionary(APRIL_TAGS) else { return BTreeMap::new() };
    let matcher = Matcher::new(dictionary, WRONG_BITS_MAX);
    let config = ScanDecodeConfig::default().with_border_bits(border_bits).with_inset_frac(0.0);
    let mut tags: BTreeMap<u32, Option<Tag>> = BTreeMap::new();
    for quad in quads {
        let corners = quad.map(|index| Point2::new(pixels[index].x as f32, pixels[index].y as f32));
        let cell = MarkerCell::new(Default::default(), corners);
        let Some(found) = decode_marker_in_cell(view, &cell, SAMPLED_PX, &config, &matcher) else { continue };
        if found.inverted {
            continue;
        }
        let mut corners = *quad;
        // OpenCV's upright orientation is the tag turned by half a turn.
        corners.rotate_left((usize::from(found.rotation) + 2) % 4);
        let tag = Tag { corners, wrong_bits: found.hamming };
        tags.entry(found.id).and_modify(|other| *other = better(other.take(), tag)).or_insert(Some(tag));
    }
    tags
}

/// The tag with fewer wrong bits of two tags with the same number; none on a tie, because one of them is wrong.
fn better(one: Option<Tag>, other: Tag) -> Option<Tag> {
    match one {
        Some(one) if one.wrong_bits < other.wrong_bits => Some(one),
        Some(one) if one.wrong_bits > other.wrong_bits => Some(other),
        _ => None,
    }
}
