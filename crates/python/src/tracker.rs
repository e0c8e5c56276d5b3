//! The tracker for sequences.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use anyhow::Context;
use numpy::PyReadonlyArray2;
use pb3dp_cell::follower::Follower;
use pb3dp_estimation::estimator::{FramePrior, Method, Tracker as Inner};
use pb3dp_estimation::pair_check::check_pair;
use pb3dp_geometry::{ImageSize, MonotonicTime, StereoRig as Rig};
use pb3dp_hal_platform::cpu_time::{timed, within};
use pb3dp_record::value_range::ValueRange;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;
use crate::estimator::SWAP;
use crate::images::{GivenPair, with_views};
use crate::named_tuples::named_tuple;
use crate::region::Region;
use crate::rig::StereoRig;
use crate::settings::{Asked, Settings, skew_of};
use crate::track::TrackEstimate;

/// Tracks one target through a sequence of stereo pairs.
///
/// The arguments `rig`, `method`, `z_range_m` (metres), `tilt_max_rad` (radians), `config`, `seed` and `value_range` are those of `Estimator`.
/// Raises `Error` if one of them is out of its range.
/// A tracker can be used by several threads; its calls wait for each other.
#[pyclass(frozen, module = "pb3dp")]
pub struct Tracker {
    rig: Rig,
    method: Method,
    state: Mutex<State>,
}

struct State {
    follower: Follower,
    value_range: Option<ValueRange>,
    is_checked: bool,
    /// Assumptions about the calibration, for the first estimate.
    doubts: Vec<String>,
    last_at: Option<MonotonicTime>,
}

#[pymethods]
impl Tracker {
    #[new]
    #[pyo3(signature = (rig, method="direct", *, z_range_m=None, tilt_max_rad=None, config=None, seed=None, value_range=None))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn new(
        py: Python<'_>,
        rig: &StereoRig,
        method: &str,
        z_range_m: Option<(f64, f64)>,
        tilt_max_rad: Option<f64>,
        config: Option<PathBuf>,
        seed: Option<u64>,
        value_range: Option<(u16, u16)>,
    ) -> PyResult<Self> {
        let asked = Asked { method, z_range_m, tilt_max_rad, config, seed, value_range };
        let made = Settings::of(asked, rig.rig()).and_then(|settings| {
            let tracker =
                Inner::new(settings.method, rig.rig(), &settings.config)?.with_calibration(rig.term().cloned());
            let mut follower = Follower::new(tracker, settings.range);
            follower.watch_skew(true)?;
            let state = State {
                follower,
                value_range: settings.value_range,
                is_checked: false,
                doubts: rig.doubts().to_vec(),
                last_at: None,
            };
            Ok(Self { rig: *rig.rig(), method: settings.method, state: Mutex::new(state) })
        });
        made.or_raise(py)
    }

    /// Tracks the target in the next pair.
    ///
    /// `left` and `right`: as in `Estimator.estimate`. `region`: marks the target; needed with the first pair, later it marks another target.
    /// `time_ns`: the middle of the left exposure, whole nanoseconds on any clock, as in `Pair.time_ns`; without it the pairs are taken as equally
    /// spaced. `deadline_s`: after this CPU time, seconds, the best estimate so far is returned. `cam_left_prev_from_cam_left_now`: the motion of
    /// the left camera since the previous pair, 4x4, metres, if an arm knows it. `skew_s`: middle of the right exposure minus middle of the left
    /// one, seconds; the tracker takes out the target's motion in it (needs `time_ns`). 0: both at once. None: not known; the tracker looks for it
    /// in the motion, and warns of the skew that it finds, or of the error that an unknown one may cause.
    ///
    /// A pose that cannot be determined is a status of the result. Raises `Error` if the images, the region, the motion or the skew cannot be used.
    #[pyo3(signature = (left, right, region=None, *, time_ns=None, deadline_s=None, cam_left_prev_from_cam_left_now=None, skew_s=None))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn track(
        &self,
        py: Python<'_>,
        left: &Bound<'_, PyAny>,
        right: &Bound<'_, PyAny>,
        region: Option<&Bound<'_, PyAny>>,
        time_ns: Option<u64>,
        deadline_s: Option<f64>,
        cam_left_prev_from_cam_left_now: Option<PyReadonlyArray2<'_, f64>>,
        skew_s: Option<f64>,
    ) -> PyResult<TrackEstimate> {
        let region = region.map(Region::of).transpose().or_raise(py)?.map(Bound::get);
        let skew_s = skew_of(skew_s).or_raise(py)?;
        let given = GivenPair::of(left, right).or_raise(py)?;
        let pixels = given.pixels().or_raise(py)?;
        let motion = cam_left_prev_from_cam_left_now
            .map(|given| arrays::pose_of("cam_left_prev_from_cam_left_now", &given))
            .transpose()
            .or_raise(py)?;
        let tracked = py.detach(|| {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            let mut range = state.value_range;
            let found = with_views(pixels, &mut range, |left, right| {
                let mut warning = None;
                if skew_s.is_some() {
                    state.follower.watch_skew(false)?;
                }
                if !state.is_checked {
                    warning = check_pair(&self.rig, left, right).accepted().context(SWAP)?;
                    state.is_checked = true;
                }
                let size = ImageSize { width: left.width(), height: left.height() };
                let region = region.map(|region| region.in_images(size)).transpose()?;
                let at = time_ns.map(MonotonicTime::from_nanos);
                let before = std::mem::replace(&mut state.last_at, at);
                let prior = FramePrior {
                    dt_s: at.zip(before).map(|(at, before)| at.seconds_since(before)),
                    skew_s: skew_s.unwrap_or(0.0),
                    ..FramePrior::of_motion(motion.as_ref())
                };
                let (estimate, millis) = timed(|| {
                    let mut may_continue = within(deadline_s.map(|seconds| seconds * 1e3));
                    state.follower.look(left, right, region.as_deref(), &prior, &mut may_continue)
                });
                let estimate = estimate?;
                let warnings = warning.into_iter().chain(std::mem::take(&mut state.doubts)).collect();
                Ok(TrackEstimate::new(estimate, millis).with(warnings))
            });
            state.value_range = range;
            found
        });
        tracked.or_raise(py)
    }

    /// Whether a region was marked and accepted.
    #[getter]
    fn is_started(&self, py: Python<'_>) -> bool {
        py.detach(|| self.state.lock().unwrap_or_else(PoisonError::into_inner).follower.is_started())
    }

    /// The method: `direct` or `published`.
    #[getter]
    fn method(&self) -> &'static str {
        self.method.name()
    }

    /// The recovered surface: a `Surface` of N points in `model`, metres. Empty before a target was found, and for the published method.
    fn surface<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let points =
            py.detach(|| self.state.lock().unwrap_or_else(PoisonError::into_inner).follower.tracker().surface());
        let positions = points.iter().flat_map(|point| <[f64; 3]>::from(point.position_in_model_m.coords));
        let normals = points.iter().flat_map(|point| <[f64; 3]>::from(point.normal_in_model));
        let sigmas: Vec<f64> = points.iter().map(|point| point.sigma_m).collect();
        let fields = (
            arrays::matrix(py, 3, positions.collect())?,
            arrays::matrix(py, 3, normals.collect())?,
            arrays::vector(py, &sigmas),
            arrays::colours(py, points.iter().map(|point| point.rgb))?,
        );
        named_tuple(py, "Surface", fields)
    }

    fn __repr__(&self) -> String {
        format!("Tracker({})", self.method)
    }
}
