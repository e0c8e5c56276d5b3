//! Recordings as arrays.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Result, bail};
use numpy::{PyArray1, PyArray3, PyArrayMethods};
use pb3dp_cell::search_range::range_of_dataset;
use pb3dp_hal_api::{FramePair, StereoCamera};
use pb3dp_wiring::{
    CalibrationOptions, PairsPerSecond, Recording as Inner, RecordingOptions, ReplayPace, SkewMillis, Topics,
    wire_replay,
};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::{OrRaise, of_type};
use crate::images::array_of;
use crate::region::Region;
use crate::rig::{StereoRig, stated};
use crate::settings::{skew_of, value_range_of};
use crate::wording::in_python;

/// A replay does not wait for images: this time-out should never expire.
const PAIR_TIMEOUT: Duration = Duration::from_secs(10);

/// A recording of stereo pairs: an MCAP file or rosbag2 folder, a sequence or case folder, a EuRoC folder, or a folder of images.
///
/// `recording[i]` is the pair with number i, from 0; a damaged one raises `Error`. A loop gives all pairs in order, leaves out the damaged
/// ones, and adds the reason to `warnings`.
///
/// `path`: the file or folder. `calibration`: a calibration file or a list of files, as in `StereoRig.load`, instead of that of the recording.
/// `topics`: those of the left and the right images in an MCAP file; by default two that differ only in left and right. `pair_within_s`: the
/// longest time between the images of a pair, seconds. `value_range`: the values that become black and white in images with 16 bits; measured on
/// the first pair by default. `segment`: the part of an MCAP file whose `camera_info` changes, from 1 on. `skew_s`: middle of the right exposure
/// minus middle of the left one in every pair, seconds. `rate_hz`: pairs per second, if the recording has no times. `calibration_unit`,
/// `calibrated_size`, `lens` and `rectified` are those of `StereoRig.load`. Raises `Error` if the recording cannot be read.
#[pyclass(frozen, module = "pb3dp")]
pub struct Recording {
    state: Mutex<State>,
    rig: Py<StereoRig>,
    times_s: Vec<f64>,
    region_px: Option<Vec<[f64; 2]>>,
    z_range_m: Option<(f64, f64)>,
    tilt_max_rad: Option<f64>,
    /// Homogeneous matrices, one after the other.
    truth: Option<Vec<f64>>,
}

struct State {
    recording: Inner,
    notes: Vec<String>,
    warnings: Vec<String>,
}

/// Calibration files: one, or several in a list.
#[derive(FromPyObject)]
enum Calibration {
    One(PathBuf),
    Several(Vec<PathBuf>),
}

impl Calibration {
    /// # Errors
    /// Something else than paths.
    fn files(given: Option<&Bound<'_, PyAny>>) -> Result<Vec<PathBuf>> {
        let Some(given) = given else { return Ok(Vec::new()) };
        match given.extract() {
            Ok(Self::One(file)) => Ok(vec![file]),
            Ok(Self::Several(files)) => Ok(files),
            Err(_) => bail!("calibration is {}: give the path of a file, or a list of paths", of_type(given)),
        }
    }
}

impl State {
    fn pair(&mut self, number: usize) -> Result<FramePair> {
        let camera = &mut self.recording.camera;
        camera.skip_to(number as u64);
        let mut pair = FramePair::black(camera.rig().left().size());
        let played = camera.next_pair_into(&mut pair, PAIR_TIMEOUT);
        self.notes.extend(camera.take_notes());
        Ok(played.map(|()| pair)?)
    }

    /// `None` if the pair is damaged.
    fn pair_or_warn(&mut self, number: usize) -> Option<FramePair> {
        match self.pair(number) {
            Ok(pair) => Some(pair),
            Err(why) => {
                let warning = format!("{why:#}");
                if !self.warnings.contains(&warning) {
                    self.warnings.push(warning);
                }
                None
            }
        }
    }
}

/// What a recording does not state itself.
fn options(
    topics: Option<[String; 2]>,
    pair_within_s: f64,
    (value_range, segment): (Option<(u16, u16)>, Option<usize>),
    (skew_s, rate_hz): (Option<f64>, Option<f64>),
    calibration: CalibrationOptions,
) -> Result<RecordingOptions> {
    if let Some(rate_hz) = rate_hz.filter(|rate_hz| !(0.01..=10_000.0).contains(rate_hz)) {
        bail!("rate_hz is {rate_hz}: must be between 0.01 and 10000 pairs per second");
    }
    if !(0.0..=1.0).contains(&pair_within_s) {
        bail!("pair_within_s is {pair_within_s}: must be between 0 and 1 second");
    }
    if segment == Some(0) {
        bail!("segment is 0: must be a number from 1 on");
    }
    Ok(RecordingOptions {
        topics: topics.map(Topics),
        pair_within: Duration::from_secs_f64(pair_within_s),
        range: value_range_of(value_range)?,
        segment,
        layout: None,
        skew: skew_of(skew_s)?.map(|seconds| SkewMillis(seconds * 1e3)),
        rate: rate_hz.map(PairsPerSecond),
        calibration,
    })
}

impl Recording {
    fn read(&self, py: Python<'_>, number: usize) -> PyResult<Pair> {
        let read = py.detach(|| self.state.lock().unwrap_or_else(PoisonError::into_inner).pair(number));
        Pair::of(py, number, self.times_s[number], read.or_raise(py)?)
    }
}

#[pymethods]
impl Recording {
    #[new]
    #[pyo3(signature = (path, *, calibration=None, topics=None, pair_within_s=0.003, value_range=None, segment=None, skew_s=None, rate_hz=None, calibration_unit=None, calibrated_size=None, lens=None, rectified=false))]
    #[expect(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        py: Python<'_>,
        path: PathBuf,
        calibration: Option<&Bound<'_, PyAny>>,
        topics: Option<[String; 2]>,
        pair_within_s: f64,
        value_range: Option<(u16, u16)>,
        segment: Option<usize>,
        skew_s: Option<f64>,
        rate_hz: Option<f64>,
        calibration_unit: Option<&str>,
        calibrated_size: Option<(u32, u32)>,
        lens: Option<&str>,
        rectified: bool,
    ) -> PyResult<Self> {
        let calibration = Calibration::files(calibration).or_raise(py)?;
        let stated = stated(calibration_unit, calibrated_size, lens, rectified).or_raise(py)?;
        let options = options(topics, pair_within_s, (value_range, segment), (skew_s, rate_hz), stated).or_raise(py)?;
        let opened = py.detach(|| wire_replay(&path, &calibration, &options, ReplayPace::Fast)).or_raise(py)?;
        let calibration = opened.camera.calibration().clone();
        let range = opened.search.as_ref().map(range_of_dataset);
        let notes = opened.notes.iter().chain(&calibration.notes).cloned().collect();
        Ok(Self {
            rig: Py::new(py, StereoRig::new(calibration))?,
            times_s: opened.times_s.clone(),
            region_px: opened.region_polygon_left_px.clone(),
            z_range_m: range.map(|range| (range.z_min_m, range.z_max_m)),
            tilt_max_rad: range.map(|range| range.tilt_max_rad),
            truth: opened
                .cam_left_from_model
                .as_ref()
                .map(|poses| poses.iter().flat_map(arrays::homogeneous).collect()),
            state: Mutex::new(State { warnings: opened.warnings.clone(), recording: opened, notes }),
        })
    }

    /// The calibration of its cameras.
    #[getter]
    fn rig(&self, py: Python<'_>) -> Py<StereoRig> {
        self.rig.clone_ref(py)
    }

    /// Middle of the left exposure of each of the N pairs, seconds on the clock of the recording.
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::vector(py, &self.times_s)
    }

    /// The target in the left image of the first pair, or None.
    #[getter]
    fn region(&self) -> Option<Region> {
        self.region_px.as_deref().map(Region::of_polygon)
    }

    /// The nearest and the farthest depth to search that the recording states, metres, or None.
    #[getter]
    fn z_range_m(&self) -> Option<(f64, f64)> {
        self.z_range_m
    }

    /// The largest tilt to search that the recording states, radians, or None.
    #[getter]
    fn tilt_max_rad(&self) -> Option<f64> {
        self.tilt_max_rad
    }

    /// The true pose of the target in each pair, N x 4 x 4, translation in metres, or None.
    #[getter]
    fn cam_left_from_model<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray3<f64>>>> {
        let truth = self.truth.as_ref();
        truth.map(|numbers| PyArray1::from_slice(py, numbers).reshape([numbers.len() / 16, 4, 4])).transpose()
    }

    /// What the user should know of the recording, from the pairs that were read so far.
    #[getter]
    fn notes(&self, py: Python<'_>) -> Vec<String> {
        let notes = py.detach(|| self.state.lock().unwrap_or_else(PoisonError::into_inner).notes.clone());
        notes.iter().map(|note| in_python(note)).collect()
    }

    /// What is missing or not as it should be, and the damaged pairs that loops have left out so far.
    #[getter]
    fn warnings(&self, py: Python<'_>) -> Vec<String> {
        let warnings = py.detach(|| self.state.lock().unwrap_or_else(PoisonError::into_inner).warnings.clone());
        warnings.iter().map(|warning| in_python(warning)).collect()
    }

    fn __len__(&self) -> usize {
        self.times_s.len()
    }

    fn __getitem__(&self, py: Python<'_>, index: isize) -> PyResult<Pair> {
        let pairs = self.times_s.len();
        let number = if index < 0 { index.checked_add_unsigned(pairs) } else { Some(index) };
        let number = number.and_then(|number| usize::try_from(number).ok()).filter(|number| *number < pairs);
        let Some(number) = number else {
            return Err(PyIndexError::new_err(format!("pair {index}: the recording has {pairs} pairs, from 0")));
        };
        self.read(py, number)
    }

    fn __iter__(this: Py<Self>) -> Pairs {
        Pairs { recording: this, next: Mutex::new(0) }
    }

    fn __repr__(&self) -> String {
        format!("Recording({} pairs)", self.times_s.len())
    }
}

/// The pairs of a recording in order, without damaged ones.
#[pyclass(frozen, module = "pb3dp")]
pub struct Pairs {
    recording: Py<Recording>,
    next: Mutex<usize>,
}

#[pymethods]
impl Pairs {
    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Pair>> {
        let recording = self.recording.get();
        loop {
            let number = {
                let mut next = self.next.lock().unwrap_or_else(PoisonError::into_inner);
                *next += 1;
                *next - 1
            };
            let Some(&t_s) = recording.times_s.get(number) else { return Ok(None) };
            let read =
                py.detach(|| recording.state.lock().unwrap_or_else(PoisonError::into_inner).pair_or_warn(number));
            if let Some(pair) = read {
                return Pair::of(py, number, t_s, pair).map(Some);
            }
        }
    }
}

/// A stereo pair of a recording.
#[pyclass(frozen, module = "pb3dp")]
pub struct Pair {
    index: usize,
    t_s: f64,
    time_ns: u64,
    skew_s: f64,
    left: Py<PyAny>,
    right: Py<PyAny>,
}

impl Pair {
    fn of(py: Python<'_>, index: usize, t_s: f64, pair: FramePair) -> PyResult<Self> {
        Ok(Self {
            index,
            t_s,
            time_ns: pair.exposed_at.as_nanos(),
            skew_s: pair.skew_nanos as f64 * 1e-9,
            left: array_of(py, pair.left)?.unbind(),
            right: array_of(py, pair.right)?.unbind(),
        })
    }
}

#[pymethods]
impl Pair {
    /// Number of the pair, from 0.
    #[getter]
    fn index(&self) -> usize {
        self.index
    }

    /// Middle of the left exposure, seconds on the clock of the recording.
    #[getter]
    fn t_s(&self) -> f64 {
        self.t_s
    }

    /// Middle of the left exposure, whole nanoseconds on the clock of the recording, for `Tracker.track`: exact, as seconds in a float are not.
    #[getter]
    fn time_ns(&self) -> u64 {
        self.time_ns
    }

    /// Middle of the right exposure minus middle of the left one, seconds.
    #[getter]
    fn skew_s(&self) -> f64 {
        self.skew_s
    }

    /// The raw left image, height x width x 3, uint8, in the order red, green, blue.
    #[getter]
    fn left(&self, py: Python<'_>) -> Py<PyAny> {
        self.left.clone_ref(py)
    }

    /// The raw right image, as `left`.
    #[getter]
    fn right(&self, py: Python<'_>) -> Py<PyAny> {
        self.right.clone_ref(py)
    }

    fn __repr__(&self) -> String {
        format!("Pair({}, {:.3} s)", self.index, self.t_s)
    }
}
