//! Recordings: continuous recordings, from which views are selected, or arm stops, each of which is a view.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::PoisonError;

use crate::board::{Chessboard, Sighting};
use crate::detection::find_board;
use crate::fit::{View, sides};
use crate::selection::{Candidate, Selection, Wanted, select};
use crate::sharpness::{blur_px, moved_px};
use anyhow::{Context, Result, bail};
use image::GrayImage;
use pb3dp_camera_recordings::RecordingOptions;
use pb3dp_geometry::ImageSize;
use pb3dp_record::images::{load_rgb, load_rgb_of_size, size_of};

use super::DetectedBoards;
use super::images::{Images, agreed};
use super::source::{PairFiles, StopFiles, written};

/// Maximum number of pairs checked, and the minimum time between them.
const LOOKS_MAX: u64 = 400;
const LOOK_EVERY_S: f64 = 0.2;
/// Longest time between neighbouring pairs from which board motion is measured.
const NEIGHBOUR_MAX_S: f64 = 0.6;
/// Threads used for board detection.
const THREADS_MAX: usize = 4;

/// Number of detection failures listed by reason.
const REASONS_LISTED: usize = 5;

/// A checked pair, by its number in the recording.
struct Look {
    frame: u64,
    found: Result<Candidate<2>, String>,
}

/// Detects the boards and selects the views of a recording.
pub(super) fn sightings(path: &Path, asked: &RecordingOptions, board: &Chessboard) -> Result<DetectedBoards<2>> {
    if StopFiles::is_one(path) {
        return Images::of_stops(StopFiles::open(path)?, board);
    }
    let pairs = PairFiles::open(path, asked, frames_to_look_at)?;
    if pairs.times_s.is_none() {
        return Images::of_pairs(pairs, board);
    }
    let recording = Recording::new(&pairs, board)?;
    let size = recording.size;
    let looks = recording.looks()?;
    let frames: Vec<u64> = looks.iter().filter(|look| look.found.is_ok()).map(|look| look.frame).collect();
    let mut without: BTreeMap<&str, usize> = BTreeMap::new();
    for reason in looks.iter().filter_map(|look| look.found.as_ref().err()) {
        *without.entry(reason).or_default() += 1;
    }
    let candidates: Vec<Candidate<2>> = looks.iter().filter_map(|look| look.found.clone().ok()).collect();
    let speed = |index: usize| recording.speed_px_per_s(frames[index], &candidates[index]);
    let wanted = Wanted::default();
    let selection = select(&candidates, board, size, &wanted, speed)?;
    let notes = notes(&pairs, looks.len(), &selection, &without, &wanted);
    if selection.chosen.is_empty() {
        bail!("{}: no usable pair\n{notes}", path.display());
    }
    let files: Vec<[PathBuf; 2]> = selection.chosen.iter().map(|index| recording.files(frames[*index])).collect();
    let views = selection.chosen.iter().map(|index| candidates[*index].view.clone()).collect();
    let newest = pairs.date.clone().map_or_else(|| written(files.iter().flatten()), Ok)?;
    let folder = pairs.folder().to_path_buf();
    Ok(DetectedBoards { views, size, newest, notes, files, folder, stops: None, _unpacked: pairs.unpacked })
}

/// Summary of the checked pairs, and why pairs were left out.
fn notes(
    pairs: &PairFiles,
    looks: usize,
    selection: &Selection,
    without: &BTreeMap<&str, usize>,
    wanted: &Wanted,
) -> String {
    let mut lines = vec![format!(
        "{}: checked {looks} of {} pairs, selected {} as views",
        pairs.path.display(),
        pairs.files.len(),
        selection.chosen.len()
    )];
    lines.extend(pairs.notes.iter().cloned());
    let mut reasons: Vec<(usize, String)> =
        without.iter().map(|(reason, count)| (*count, (*reason).to_owned())).collect();
    reasons.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
    let more = [
        (selection.moving, format!("the board moves faster than {} px per second", wanted.speed_max_px_per_s)),
        (selection.blurred, format!("edge blur above {} px", wanted.blur_max_px)),
        (selection.nothing_new, "similar to other views".to_owned()),
        (selection.unexplained, "the corners fit no camera model".to_owned()),
    ];
    let rare: usize = reasons.iter().skip(REASONS_LISTED).map(|(count, _)| count).sum();
    reasons.truncate(REASONS_LISTED);
    reasons.push((rare, "for other reasons".to_owned()));
    let all = more.into_iter().chain(reasons).filter(|(count, _)| *count > 0);
    lines.extend(all.map(|(count, reason)| format!("left out {count}: {reason}")));
    lines.join("\n")
}

/// Every n-th pair, with n small enough to catch a board that is held still only for a moment.
fn frames_to_look_at(times_s: &[f64]) -> Vec<u64> {
    let frames = times_s.len() as u64;
    let lasts_s = times_s.last().zip(times_s.first()).map_or(0.0, |(last, first)| last - first);
    let of_time = (lasts_s / LOOK_EVERY_S).ceil().max(1.0) as u64;
    let every = frames.div_ceil(of_time.min(LOOKS_MAX)).max(1);
    (0..frames).step_by(usize::try_from(every).unwrap_or(1)).collect()
}

/// Context for checking pairs of a recording.
pub(super) struct Recording<'a> {
    files: &'a [[PathBuf; 2]],
    times_s: &'a [f64],
    board: &'a Chessboard,
    /// Size of its images.
    pub(super) size: ImageSize,
    because_of: String,
}

impl<'a> Recording<'a> {
    /// A recording; the first image gives the size of all.
    pub(super) fn new(pairs: &'a PairFiles, board: &'a Chessboard) -> Result<Self> {
        let first = pairs.files.iter().map(|[left, _]| left).find(|file| file.is_file());
        let first =
            first.with_context(|| format!("{}: all images of the recording are missing", pairs.path.display()))?;
        let (size, because_of) = (size_of(&load_rgb(first)?), first.display().to_string());
        Ok(Self { files: &pairs.files, times_s: pairs.times_s.as_deref().unwrap_or(&[]), board, size, because_of })
    }

    fn files(&self, frame: u64) -> [PathBuf; 2] {
        self.files[frame as usize].clone()
    }

    /// Checks every n-th pair, on all processors.
    fn looks(&self) -> Result<Vec<Look>> {
        let frames = frames_to_look_at(self.times_s);
        let threads = std::thread::available_parallelism().map_or(1, usize::from).min(THREADS_MAX);
        let (next, looks) = (Mutex::new(frames.iter()), Mutex::new(Vec::with_capacity(frames.len())));
        let progress = super::progress(frames.len());
        let work = || {
            loop {
                let frame = next.lock().unwrap_or_else(PoisonError::into_inner).next();
                let Some(frame) = frame else { return };
                let look = Look { frame: *frame, found: self.look(*frame) };
                looks.lock().unwrap_or_else(PoisonError::into_inner).push(look);
                progress.inc(1);
            }
        };
        std::thread::scope(|scope| {
            for _ in 1..threads {
                // If the system gives no thread, the current thread does all the work.
                let _ = std::thread::Builder::new().spawn_scoped(scope, work);
            }
            work();
        });
        let mut looks = looks.into_inner().unwrap_or_else(PoisonError::into_inner);
        looks.sort_by_key(|look| look.frame);
        Ok(looks)
    }

    /// Board detection in one pair, or why the pair cannot be used.
    pub(super) fn look(&self, frame: u64) -> Result<Candidate<2>, String> {
        let mut sightings: [Sighting; 2] = Default::default();
        let mut blur: Option<f64> = Some(0.0);
        for ((sighting, file), side) in sightings.iter_mut().zip(self.files(frame)).zip(sides::<2>()) {
            let image =
                self.image(&file).map_err(|_| format!("the {side} image is missing, damaged or of another size"))?;
            *sighting = find_board(&image, self.board).map_err(|reason| format!("{side}: {reason}"))?;
            blur = blur.zip(blur_px(&image, sighting)).map(|(one, other)| one.max(other));
        }
        let name = format!("{frame:04}");
        Ok(Candidate { view: View { name, sightings: agreed(sightings, self.board) }, blur_px: blur })
    }

    fn image(&self, file: &Path) -> Result<GrayImage> {
        let image = load_rgb_of_size(file, self.size, &self.because_of)?;
        Ok(image::DynamicImage::from(image).into_luma8())
    }

    /// Speed of the board in the left image, from the previous pair to the next, px per second; `None` if it cannot be
    /// determined. Pairs far apart in time were taken one by one, so their speed is not checked.
    pub(super) fn speed_px_per_s(&self, frame: u64, candidate: &Candidate<2>) -> Result<Option<f64>> {
        let mut fastest: Option<f64> = None;
        let time_s = |frame: u64| usize::try_from(frame).ok().and_then(|at| self.times_s.get(at)).copied();
        for other in [frame.checked_sub(1), Some(frame + 1)].into_iter().flatten() {
            let Some(apart_s) = time_s(other).zip(time_s(frame)).map(|(a, b)| (a - b).abs()) else { continue };
            if apart_s > NEIGHBOUR_MAX_S {
                fastest = fastest.or(Some(0.0));
                continue;
            }
            let Ok(image) = self.image(&self.files(other)[0]) else { continue };
            let Ok(sighting) = find_board(&image, self.board) else { return Ok(None) };
            let [here, there] = agreed([candidate.view.sightings[0].clone(), sighting], self.board);
            let Some(moved_px) = moved_px(&here, &there) else { return Ok(None) };
            fastest = Some(fastest.unwrap_or(0.0).max(moved_px / apart_s));
        }
        Ok(fastest)
    }
}
