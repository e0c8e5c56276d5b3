//! Image folders: pairing of the images, and board detection.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::board::{Chessboard, Sighting};
use crate::detection::{NoBoard, agree, find_board};
use crate::fit::{View, sides};
use anyhow::{Context, Result, bail};
use pb3dp_geometry::ImageSize;
use pb3dp_record::images::{EXTENSIONS, load_rgb, load_rgb_of_size, size_of};
use pb3dp_record::stops::{Stop, Stops};

use super::DetectedBoards;
use super::source::{PairFiles, StopFiles, written};

/// The images of each view, by view name.
pub(super) struct Images<const N: usize> {
    views: Vec<(String, [PathBuf; N])>,
    /// Images without a partner.
    alone: Vec<PathBuf>,
    /// When the images were taken, if recorded.
    date: Option<String>,
}

impl<const N: usize> Images<N> {
    /// Lists one folder per camera and groups the images into views.
    pub(super) fn find(folders: &[&Path; N]) -> Result<Self> {
        let shared = N > 1 && folders.iter().all(|folder| folder == &folders[0]);
        let mut by_name: BTreeMap<String, [Option<PathBuf>; N]> = BTreeMap::new();
        for (index, folder) in folders.iter().enumerate() {
            for file in images_in(folder)? {
                let stem = file.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
                if shared && !stem.contains(sides::<N>()[index]) {
                    continue;
                }
                let name = if N > 1 { stem.replace("left", "").replace("right", "") } else { stem };
                let name = name.trim_matches(['_', '-', '.', ' ']).to_owned();
                let slots = by_name.entry(name.clone()).or_insert_with(|| std::array::from_fn(|_| None));
                if let Some(other) = slots[index].replace(file.clone()) {
                    bail!(
                        "{} and {} both give the view name {name:?} for the {} camera; rename one",
                        other.display(),
                        file.display(),
                        sides::<N>()[index]
                    );
                }
            }
        }
        let (mut views, mut alone) = (Vec::new(), Vec::new());
        for (name, files) in by_name {
            match files.iter().cloned().collect::<Option<Vec<_>>>().and_then(|list| <[PathBuf; N]>::try_from(list).ok())
            {
                Some(files) => views.push((name, files)),
                None => alone.extend(files.into_iter().flatten()),
            }
        }
        if views.is_empty() {
            let folders = folders.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(" and ");
            bail!(
                "{folders}: no matching images of {N} camera(s); needed are PNG or JPEG files whose names differ only in the words left and right"
            );
        }
        Ok(Self { views, alone, date: None })
    }

    /// Detects the board in all views. Reports and leaves out views in which one camera does not see it.
    pub(super) fn sightings(&self, board: &Chessboard) -> Result<DetectedBoards<N>> {
        let mut notes: Vec<String> = self
            .alone
            .iter()
            .map(|file| format!("left out {}: no matching image of the other camera", file.display()))
            .collect();
        let first = &self.views[0].1[0];
        let size = size_of(&load_rgb(first)?);
        let (mut views, mut used) = (Vec::new(), Vec::new());
        let progress = super::progress(self.views.len());
        for (name, files) in &self.views {
            progress.inc(1);
            match view(name, files, board, size, &first.display().to_string())? {
                Ok(view) => {
                    views.push(view);
                    used.push(files.clone());
                }
                Err((file, reason)) => notes.push(format!("left out {}: {reason}", file.display())),
            }
        }
        if views.is_empty() {
            bail!("the board was detected in none of {} views:\n{}", self.views.len(), notes.join("\n"));
        }
        let newest = match &self.date {
            Some(date) => date.clone(),
            None => written(self.views.iter().flat_map(|(_, files)| files))?,
        };
        let folder = first.parent().unwrap_or(Path::new(".")).to_path_buf();
        let notes = notes.join("\n");
        Ok(DetectedBoards { views, size, newest, notes, files: used, folder, stops: None, _unpacked: None })
    }
}

impl Images<1> {
    /// Refuses a folder whose file names indicate two cameras.
    pub(super) fn check_one_camera(&self, folder: &Path) -> Result<()> {
        let named = |side: &str| self.views.iter().filter(|(name, _)| name.contains(side)).count();
        let [left, right] = ["left", "right"].map(named);
        if left > 0 && right > 0 {
            bail!(
                "{}: {left} images are called left and {right} right; use a folder with the images of one camera, or calibrate both with \
                 `pb3dp calibrate stereo`",
                folder.display()
            );
        }
        Ok(())
    }
}

impl Images<2> {
    /// Detects the board at the stops of an arm, in their order.
    pub(super) fn of_stops(recorded: StopFiles, board: &Chessboard) -> Result<DetectedBoards<2>> {
        let Stops { date, stops } = &recorded.stops;
        if stops.is_empty() {
            bail!("{}: the recording has no stops", recorded.folder.display());
        }
        let view = |(number, stop): (usize, &Stop)| {
            (format!("stop {number:02}"), [&stop.left, &stop.right].map(|file| recorded.folder.join(file)))
        };
        let views = stops.iter().enumerate().map(view).collect();
        let detected = Self { views, alone: Vec::new(), date: Some(date.clone()) }.sightings(board)?;
        Ok(DetectedBoards { folder: recorded.folder.clone(), stops: Some(recorded), ..detected })
    }

    /// Detects the board in pairs that were taken one by one.
    pub(super) fn of_pairs(pairs: PairFiles, board: &Chessboard) -> Result<DetectedBoards<2>> {
        let name = |number: usize, [left, _]: &[PathBuf; 2]| match left.file_stem() {
            Some(stem) => stem.to_string_lossy().into_owned(),
            None => number.to_string(),
        };
        let views =
            pairs.files.iter().enumerate().map(|(number, files)| (name(number, files), files.clone())).collect();
        let detected = Self { views, alone: Vec::new(), date: pairs.date.clone() }.sightings(board)?;
        let notes = pairs.notes.iter().cloned().chain([detected.notes]).filter(|line| !line.is_empty());
        let notes = notes.collect::<Vec<_>>().join("\n");
        Ok(DetectedBoards { notes, folder: pairs.folder().to_path_buf(), _unpacked: pairs.unpacked, ..detected })
    }
}

/// One view, or the image in which the board was not detected and the reason.
pub(super) fn view<const N: usize>(
    name: &str,
    files: &[PathBuf; N],
    board: &Chessboard,
    size: ImageSize,
    first: &str,
) -> Result<Result<View<N>, (PathBuf, NoBoard)>> {
    let mut sightings: [Sighting; N] = std::array::from_fn(|_| Sighting::default());
    for (index, file) in files.iter().enumerate() {
        let image = load_rgb_of_size(file, size, first)?;
        match find_board(&image::DynamicImage::from(image).into_luma8(), board) {
            Ok(sighting) => sightings[index] = sighting,
            Err(reason) => return Ok(Err((file.clone(), reason))),
        }
    }
    Ok(Ok(View { name: name.to_owned(), sightings: agreed(sightings, board) }))
}

/// Detections with the same first corner in all cameras.
pub(super) fn agreed<const N: usize>(mut sightings: [Sighting; N], board: &Chessboard) -> [Sighting; N] {
    if let Some((first, others)) = sightings.split_first_mut() {
        for other in others.iter_mut().filter(|_| !board.has_unique_orientation()) {
            *other = agree(first, std::mem::take(other), board);
        }
    }
    sightings
}

/// The image files of a folder, by name.
fn images_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let what = || format!("{}: cannot read image folder", folder.display());
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(what)? {
        let file = entry.with_context(what)?.path();
        let extension = file.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if EXTENSIONS.contains(&extension.as_str()) && file.is_file() {
            files.push(file);
        }
    }
    files.sort();
    Ok(files)
}
