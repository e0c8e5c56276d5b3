//! The estimator for single pairs.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result};
use nalgebra::{Matrix6, Vector2};
use numpy::PyArray1;
use pb3dp_cell::calibration_share::of_first;
use pb3dp_estimation::calibration_term::CalibrationTerm;
use pb3dp_estimation::estimator::{Estimator as Inner, Method};
use pb3dp_estimation::pair_check::check_pair;
use pb3dp_estimation_core::estimate::PlaneEstimate;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region as Marked, RegionConfig};
use pb3dp_geometry::{ImageSize, StereoRig as Rig};
use pb3dp_hal_platform::cpu_time::{timed, within};
use pb3dp_record::value_range::ValueRange;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;
use crate::estimate::Estimate;
use crate::images::{GivenPair, with_views};
use crate::named_tuples::named_tuple;
use crate::region::Region;
use crate::rig::StereoRig;
use crate::settings::{Asked, Settings};

/// What to do with images that the check against the calibration refuses.
pub const SWAP: &str = "swap left and right";

/// Estimates the pose of a region in single stereo pairs.
///
/// `rig`: the calibrated cameras. `method`: `direct` or `published`. `z_range_m`: the nearest and the farthest depth to search, metres; by
/// default those with disparities of 35 to 5 % of the width. `tilt_max_rad`: the largest tilt to search, radians; default 60 degrees. `config`:
/// a TOML file with all parameters of the methods. `seed`: of the search of the published method. `value_range`: the values that become black
/// and white in images of uint16, such as (0, 4095) for 12 bits; measured on the first pair by default. Raises `Error` if an argument is out of
/// its range.
///
/// Every pair is compared with the calibration, as in the program: a vertical misalignment of its rows is corrected, and if the rows contradict
/// the calibration, the status is `miscalibrated`.
/// An estimator can be used by several threads; its calls wait for each other.
#[pyclass(frozen, module = "pb3dp")]
pub struct Estimator {
    rig: Rig,
    term: Option<CalibrationTerm>,
    /// Assumptions about the calibration.
    doubts: Vec<String>,
    regions: RegionConfig,
    method: Method,
    range: SearchRange,
    state: Mutex<State>,
}

struct State {
    inner: Inner,
    value_range: Option<ValueRange>,
    is_checked: bool,
}

impl State {
    /// Compares a pair with the calibration; returns a doubt about the first one.
    fn prepare(&mut self, rig: &Rig, left: ImageView<'_>, right: ImageView<'_>) -> Result<Option<String>> {
        let mut doubt = None;
        if !self.is_checked {
            doubt = check_pair(rig, left, right).accepted().context(SWAP)?;
        }
        self.is_checked = true;
        Ok(doubt)
    }
}

impl Estimator {
    /// Works on a pair without the lock of the interpreter, with a doubt about the calibration as the last argument.
    fn on_pair<T: Send>(
        &self,
        py: Python<'_>,
        images: [&Bound<'_, PyAny>; 2],
        region: &Bound<'_, PyAny>,
        work: impl FnOnce(&mut State, ImageView<'_>, ImageView<'_>, &Marked, Option<String>) -> Result<T> + Send,
    ) -> PyResult<T> {
        let region = Region::of(region).or_raise(py)?.get();
        let [left, right] = images;
        let given = GivenPair::of(left, right).or_raise(py)?;
        let pixels = given.pixels().or_raise(py)?;
        let done = py.detach(|| {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            let mut range = state.value_range;
            let done = with_views(pixels, &mut range, |left, right| {
                let warning = state.prepare(&self.rig, left, right)?;
                let region = region.in_images(ImageSize { width: left.width(), height: left.height() })?;
                work(&mut state, left, right, &region, warning)
            });
            state.value_range = range;
            done
        });
        done.or_raise(py)
    }

    /// The share of the calibration in the covariance of the model frame at a point of the left image.
    fn calibration_share(
        &self,
        estimate: &PlaneEstimate,
        at_px: &Vector2<f64>,
        (region, left): (&Marked, ImageView<'_>),
    ) -> Result<Option<Matrix6<f64>>> {
        let (Some(term), Some(frame)) = (&self.term, estimate.model_frame(at_px)) else { return Ok(None) };
        let outline_px = region.outline_px(&region.rasterize(left, &self.regions)?);
        Ok(of_first(term, &self.rig, &frame.cam_left_from_model, &outline_px))
    }
}

#[pymethods]
impl Estimator {
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
            let inner = Inner::new(settings.method, rig.rig(), &settings.config)?;
            let state = State { inner, value_range: settings.value_range, is_checked: false };
            Ok(Self {
                rig: *rig.rig(),
                term: rig.term().cloned(),
                doubts: rig.doubts().to_vec(),
                regions: settings.config.published.region,
                method: settings.method,
                range: settings.range,
                state: Mutex::new(state),
            })
        });
        made.or_raise(py)
    }

    /// Estimates the pose of a region.
    ///
    /// `left` and `right`: the raw images, as the cameras delivered them; height x width x 3 in the order red, green, blue, or height x width,
    /// of uint8 or uint16. Images are used where they are, also parts of larger images, if the values of a row are beside each other; others
    /// are copied. Do not write to them before the call returns. `region`: the object in the left image. `centroid_px`: the point of the left
    /// image on whose ray the depth is given, pixels; by default the centroid of the region. `deadline_s`: after this CPU time, seconds, the
    /// best estimate so far is returned, with a warning.
    ///
    /// A pose that cannot be determined is a status of the result. Raises `Error` if the images or the region cannot be used.
    #[pyo3(signature = (left, right, region, *, centroid_px=None, deadline_s=None))]
    fn estimate(
        &self,
        py: Python<'_>,
        left: &Bound<'_, PyAny>,
        right: &Bound<'_, PyAny>,
        region: &Bound<'_, PyAny>,
        centroid_px: Option<[f64; 2]>,
        deadline_s: Option<f64>,
    ) -> PyResult<Estimate> {
        self.on_pair(py, [left, right], region, |state, left, right, region, warning| {
            let (estimate, millis) = timed(|| {
                let mut may_continue = within(deadline_s.map(|seconds| seconds * 1e3));
                let request = EstimateRequest::new_target(left, right, region, &self.range);
                state.inner.estimate(request.until(&mut may_continue))
            });
            let estimate = estimate?;
            let place = estimate.point_at(centroid_px.map(Vector2::from));
            let share = self.calibration_share(&estimate, &place.0, (region, left))?;
            let warnings = warning.into_iter().chain(self.doubts.iter().cloned()).collect();
            Ok(Estimate::new(self.method, (estimate, millis), place, (share, warnings)))
        })
    }

    /// The visible surface of a region, pixel by pixel, for objects that are no plane: a `VisibleSurface` of N points in `cam_left`, metres.
    ///
    /// `left`, `right` and `region` as for `estimate`. Errors of neighbours are not independent. Empty for the published method. Raises `Error`
    /// as `estimate` does, with the code `PB3DP-EST-012` if too few pixels have a match: the depth range or the calibration is wrong.
    fn visible_surface<'py>(
        &self,
        py: Python<'py>,
        left: &Bound<'py, PyAny>,
        right: &Bound<'py, PyAny>,
        region: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let points = self.on_pair(py, [left, right], region, |state, left, right, region, _| {
            Ok(state.inner.visible_surface(&EstimateRequest::new_target(left, right, region, &self.range))?)
        })?;
        let positions = points.iter().flat_map(|point| <[f64; 3]>::from(point.position_in_cam_left_m.coords));
        let sigmas: Vec<f64> = points.iter().map(|point| point.sigma_m).collect();
        let fields = (
            arrays::matrix(py, 3, positions.collect())?,
            arrays::vector(py, &sigmas),
            arrays::colours(py, points.iter().map(|point| point.rgb))?,
            PyArray1::from_iter(py, points.iter().map(|point| point.is_measured)),
        );
        named_tuple(py, "VisibleSurface", fields)
    }

    /// The method: `direct` or `published`.
    #[getter]
    fn method(&self) -> &'static str {
        self.method.name()
    }

    /// The nearest and the farthest depth that are searched, metres.
    #[getter]
    fn z_range_m(&self) -> (f64, f64) {
        (self.range.z_min_m, self.range.z_max_m)
    }

    /// The largest tilt that is searched, radians.
    #[getter]
    fn tilt_max_rad(&self) -> f64 {
        self.range.tilt_max_rad
    }

    fn __repr__(&self) -> String {
        format!("Estimator({}, {} to {} m)", self.method, self.range.z_min_m, self.range.z_max_m)
    }
}
