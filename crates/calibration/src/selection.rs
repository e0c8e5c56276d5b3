//! Selects views from a recording: sharp images of a stationary board, each of which adds information.

use pb3dp_geometry::ImageSize;

use crate::board::Chessboard;
use crate::fit::View;
use crate::stand::{Cells, Judge, Stand};

/// Requirements for a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// Maximum number of views.
    pub views_max: usize,
    /// Maximum blur of the board edges, px ([`crate::sharpness::blur_px`]).
    pub blur_max_px: f64,
    /// Maximum speed of the corners in the image, px per second.
    pub speed_max_px_per_s: f64,
    /// Minimum contribution of a view: its difference from all other views, measured by [`Stand::apart`], plus a tenth for each
    /// cell that a camera has not covered yet.
    pub worth_min: f64,
}

impl Default for Wanted {
    fn default() -> Self {
        Self { views_max: 25, blur_max_px: 2.0, speed_max_px_per_s: 15.0, worth_min: 0.25 }
    }
}

/// Contribution of one newly covered cell.
const CELL_WORTH: f64 = 0.1;

/// A pair in which both cameras see the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate<const N: usize> {
    /// The detected corners.
    pub view: View<N>,
    /// Blur of the blurrier image, px; `None` if it cannot be measured.
    pub blur_px: Option<f64>,
}

/// The selected views, and why the others were left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// Indices of the views, in the order of the candidates.
    pub chosen: Vec<usize>,
    /// Left out because the board edges are blurred.
    pub blurred: usize,
    /// Left out because the board moves.
    pub moving: usize,
    /// Left out because they are similar to other views.
    pub nothing_new: usize,
    /// Left out because the corners fit no camera model.
    pub unexplained: usize,
}

/// Selects views, the one with the largest contribution first. `speed_px_per_s` measures the speed of the board in a candidate;
/// `None` means that it cannot be determined. It needs more images, so it is called only for candidates that would be selected.
///
/// # Errors
/// An error of `speed_px_per_s`.
pub fn select<const N: usize, E>(
    candidates: &[Candidate<N>],
    board: &Chessboard,
    size: ImageSize,
    wanted: &Wanted,
    mut speed_px_per_s: impl FnMut(usize) -> Result<Option<f64>, E>,
) -> Result<Selection, E> {
    let is_sharp = |candidate: &Candidate<N>| candidate.blur_px.is_some_and(|blur_px| blur_px <= wanted.blur_max_px);
    let mut selection =
        Selection { blurred: candidates.iter().filter(|c| !is_sharp(c)).count(), ..Selection::default() };
    let sharp: Vec<(usize, &Candidate<N>)> = candidates.iter().enumerate().filter(|(_, c)| is_sharp(c)).collect();
    let views: Vec<View<N>> = sharp.iter().map(|(_, candidate)| candidate.view.clone()).collect();
    let Some(judge) = Judge::new(&views, board, size) else {
        selection.unexplained = sharp.len();
        return Ok(selection);
    };
    let stands = sharp.iter().zip(&views).map(|((index, _), view)| Some((*index, judge.stand(view, board)?)));
    let mut left: Vec<(usize, Stand)> = stands.flatten().collect();
    selection.unexplained = sharp.len() - left.len();
    let mut chosen: Vec<(usize, Stand)> = Vec::new();
    while chosen.len() < wanted.views_max {
        let others = || chosen.iter().map(|(_, stand)| stand);
        let worths = left.iter().map(|(_, stand)| worth(stand, others(), wanted));
        let best = worths.enumerate().filter_map(|(at, worth)| Some((at, worth?))).max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((at, _)) = best else { break };
        let (index, stand) = left.swap_remove(at);
        if speed_px_per_s(index)?.is_some_and(|speed| speed <= wanted.speed_max_px_per_s) {
            chosen.push((index, stand));
        } else {
            selection.moving += 1;
        }
    }
    selection.nothing_new = left.len();
    selection.chosen = chosen.into_iter().map(|(index, _)| index).collect();
    selection.chosen.sort_unstable();
    Ok(selection)
}

/// Whether a view adds enough to the others.
pub fn adds(stand: &Stand, others: &[Stand], wanted: &Wanted) -> bool {
    worth(stand, others.iter(), wanted).is_some()
}

/// The contribution of a view; `None` if it is too small.
fn worth<'a>(stand: &Stand, others: impl Iterator<Item = &'a Stand> + Clone, wanted: &Wanted) -> Option<f64> {
    let apart = others.clone().map(|other| stand.apart(other)).fold(f64::INFINITY, f64::min);
    // The first view is the one that fills most of the image: the board is near and well resolved.
    let apart = if apart.is_finite() { apart } else { stand.size };
    let new =
        stand.cells.iter().enumerate().map(|(camera, cells)| cells.without(covered(others.clone(), camera)).count());
    let worth = apart + CELL_WORTH * f64::from(new.sum::<u32>());
    (worth >= wanted.worth_min).then_some(worth)
}

/// The image cells of a camera that contain corners.
pub fn covered<'a>(stands: impl Iterator<Item = &'a Stand>, camera: usize) -> Cells {
    stands.filter_map(|stand| stand.cells.get(camera)).fold(Cells::default(), |all, cells| all.with(*cells))
}
