//! Where images are read from: files in place, or files that are unpacked from a recording until the command ends.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use anyhow::{Context, Result, bail};
use pb3dp_bag::reader::Bag;
use pb3dp_bag::stops::{RecordedStop, files, has_stops, stops};
use pb3dp_camera_recordings::{RecordedPairs, RecordingOptions};
use pb3dp_geometry::MonotonicTime;
use pb3dp_record::calibration_files::CAMERAS_FILE;
use pb3dp_record::dataset::Sequence;
use pb3dp_record::images::{StoredFormat, save};
use pb3dp_record::stops::{Stop, Stops, load_stops};
use tempfile::TempDir;

/// Times on a clock that counts since 1970 are later than this: the year 2000.
const CALENDAR_FROM: Duration = Duration::from_secs(946_684_800);

/// Longest time between both images of a stop.
const PAIR_OF_STOP_WITHIN: Duration = Duration::from_millis(100);

/// The pairs of a recording as files.
pub(super) struct PairFiles {
    /// The recording, as the user has named it.
    pub(super) path: PathBuf,
    /// The files of each pair. Of those that are unpacked only the wanted ones exist, with their neighbours.
    pub(super) files: Vec<[PathBuf; 2]>,
    /// Middle of the left exposure of each pair, s; `None` if the recording states no times.
    pub(super) times_s: Option<Vec<f64>>,
    /// What the user should know.
    pub(super) notes: Vec<String>,
    /// When the newest image was taken, if the recording states it.
    pub(super) date: Option<String>,
    pub(super) unpacked: Option<TempDir>,
}

impl PairFiles {
    /// Opens a recording of any kind that `pb3dp track` reads. `wanted` gives the numbers of the pairs that are needed, from the times of all.
    pub(super) fn open(path: &Path, asked: &RecordingOptions, wanted: impl Fn(&[f64]) -> Vec<u64>) -> Result<Self> {
        let mut pairs = RecordedPairs::open(path, asked)?;
        let notes = pairs.take_warnings();
        let times_s = pairs.has_times().then(|| pairs.times_s());
        let path = path.to_path_buf();
        if let Some(files) = pairs.files() {
            return Ok(Self { path, files, times_s, notes, date: None, unpacked: None });
        }
        let folder = temporary_folder()?;
        let name = |number: u64| ["left", "right"].map(|side| folder.path().join(format!("{side}_{number:06}.png")));
        let numbers: BTreeSet<u64> = match &times_s {
            Some(times_s) => wanted(times_s).into_iter().flat_map(|one| one.saturating_sub(1)..=one + 1).collect(),
            None => (0..pairs.count()).collect(),
        };
        let progress = super::progress(numbers.len());
        for number in numbers.range(..pairs.count()) {
            // A damaged pair has no files; it is reported where it is used.
            if let Ok(images) = pairs.images(*number, None) {
                for (image, file) in images.iter().zip(name(*number)) {
                    save(image, &file, StoredFormat::Png)?;
                }
            }
            progress.inc(1);
        }
        let is_bag = Bag::is_one(&path);
        if is_bag {
            unpack_identities(&path, folder.path())?;
        }
        let date = is_bag.then(|| date_of(pairs.exposed_at(pairs.count() - 1))).flatten();
        let files = (0..pairs.count()).map(name).collect();
        Ok(Self { path, files, times_s, notes: [notes, pairs.take_notes()].concat(), date, unpacked: Some(folder) })
    }

    /// The files of a sequence folder, also of one that is being written.
    pub(super) fn of_sequence(sequence: &Sequence) -> Self {
        let files = (0..sequence.frames()).map(|frame| <[PathBuf; 2]>::from(sequence.image_files(frame))).collect();
        let (path, times_s) = (sequence.folder.clone(), Some(sequence.times_s.clone()));
        Self { path, files, times_s, notes: Vec::new(), date: None, unpacked: None }
    }

    /// The folder to search for the identities of the cameras.
    pub(super) fn folder(&self) -> &Path {
        let unpacked = self.unpacked.as_ref().map(TempDir::path);
        unpacked.filter(|folder| folder.join(CAMERAS_FILE).is_file()).unwrap_or(&self.path)
    }
}

/// A recording of stops with its images as files.
#[derive(Debug)]
pub(super) struct StopFiles {
    /// The folder of its images.
    pub(super) folder: PathBuf,
    /// The stops, with names of files in the folder.
    pub(super) stops: Stops,
    _unpacked: Option<TempDir>,
}

impl StopFiles {
    /// Whether a recording is one of stops.
    pub(super) fn is_one(path: &Path) -> bool {
        path.join(pb3dp_record::stops::STOPS_FILE).is_file()
            || (Bag::is_one(path) && Bag::open(path).is_ok_and(|bag| has_stops(&bag)))
    }

    /// Opens a folder or an MCAP file of `pb3dp arm visit`.
    pub(super) fn open(path: &Path) -> Result<Self> {
        if !Bag::is_one(path) {
            let stops = load_stops(path)?;
            return Ok(Self { folder: path.to_path_buf(), stops, _unpacked: None });
        }
        let recorded = stops(&Bag::open(path)?)?;
        if recorded.is_empty() {
            bail!("{}: no stops of an arm in it; `pb3dp arm visit --record FILE.mcap` records them", path.display());
        }
        // Stops are seconds apart: also images of cameras without a common trigger belong together.
        let asked = RecordingOptions { pair_within: PAIR_OF_STOP_WITHIN, ..RecordingOptions::default() };
        let mut pairs = RecordedPairs::open(path, &asked)?;
        let folder = temporary_folder()?;
        unpack_identities(path, folder.path())?;
        let mut unpacked = Vec::with_capacity(recorded.len());
        for (number, RecordedStop { at, vs, tc }) in recorded.iter().enumerate() {
            let of_stop = (0..pairs.count()).find(|pair| pairs.exposed_at(*pair) == *at);
            let of_stop =
                of_stop.with_context(|| format!("{}: the images of stop {number} are missing", path.display()))?;
            let images = pairs.images(of_stop, None)?;
            let [left, right] = ["left", "right"].map(|side| format!("{side}_{number:06}.png"));
            for (image, name) in images.iter().zip([&left, &right]) {
                save(image, &folder.path().join(name), StoredFormat::Png)?;
            }
            unpacked.push(Stop { left, right, vs: *vs, tc: *tc });
        }
        let date = recorded
            .first()
            .and_then(|stop| date_of(stop.at))
            .map_or_else(|| written([path.to_path_buf()].iter()), Ok)?;
        let stops = Stops { date, stops: unpacked };
        Ok(Self { folder: folder.path().to_path_buf(), stops, _unpacked: Some(folder) })
    }
}

fn temporary_folder() -> Result<TempDir> {
    let folder = tempfile::Builder::new().prefix("pb3dp-calibrate-").tempdir();
    folder.context("no temporary folder for the images of the recording; set TMPDIR to a folder with free space")
}

/// Writes the identities of the cameras in an MCAP recording, if it has them.
fn unpack_identities(path: &Path, folder: &Path) -> Result<()> {
    let found = files(&Bag::open(path)?)?.into_iter().find(|file| file.path == CAMERAS_FILE);
    let Some(found) = found else { return Ok(()) };
    let file = folder.join(CAMERAS_FILE);
    std::fs::write(&file, &found.data.0).with_context(|| format!("{}: cannot write file", file.display()))
}

/// The date of a stamp, RFC 3339; `None` if its clock does not count since 1970.
fn date_of(at: MonotonicTime) -> Option<String> {
    let since_1970 = Duration::from_nanos(at.as_nanos());
    (since_1970 > CALENDAR_FROM).then(|| humantime::format_rfc3339_seconds(UNIX_EPOCH + since_1970).to_string())
}

/// Modification time of the newest image, RFC 3339; it dates the calibration.
pub(super) fn written<'a>(files: impl Iterator<Item = &'a PathBuf>) -> Result<String> {
    let mut times = Vec::new();
    for file in files {
        let time = std::fs::metadata(file).and_then(|metadata| metadata.modified());
        times.push(time.with_context(|| format!("{}: cannot read modification time", file.display()))?);
    }
    let newest = times.into_iter().max().context("no images")?;
    Ok(humantime::format_rfc3339_seconds(newest).to_string())
}
