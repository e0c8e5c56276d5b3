//! Stereo rigs.

use std::path::PathBuf;

use anyhow::anyhow;
use nalgebra::Point3;
use numpy::{PyArray2, PyReadonlyArray2};
use pb3dp_cell::calibration_share::{not_reported, term_of};
use pb3dp_cell::lens_reading::decide_lens;
use pb3dp_estimation::calibration_term::CalibrationTerm;
use pb3dp_geometry::{Camera, Distortion, ImageSize, StereoRig as Rig};
use pb3dp_record::calibration_files::{StereoCalibration, load_stated};
use pb3dp_wiring::CalibrationOptions;
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::OrRaise;
use crate::images::{GivenPair, with_views};
use crate::named_tuples::named_tuple;
use crate::wording::in_python;

/// A calibrated pair of cameras.
///
/// Frames: `cam_left` and `cam_right` have x to the right, y down, z forward, and their origin in the optical centre.
#[pyclass(frozen, module = "pb3dp")]
pub struct StereoRig {
    calibration: StereoCalibration,
    /// The covariance of the calibration, if its file states one that fits the rig.
    term: Option<CalibrationTerm>,
    notes: Vec<String>,
}

impl StereoRig {
    /// A calibration from a recording.
    pub fn new(calibration: StereoCalibration) -> Self {
        let mut notes = calibration.notes.clone();
        let term = term_of(&calibration).unwrap_or_else(|error| {
            notes.push(not_reported(&calibration.source, &error));
            None
        });
        Self { calibration, term, notes }
    }

    /// The rig.
    pub fn rig(&self) -> &Rig {
        &self.calibration.rig
    }

    /// Assumptions of the reader that can be wrong.
    pub fn doubts(&self) -> &[String] {
        &self.calibration.warnings
    }

    /// Propagates the covariance of the calibration into poses.
    pub fn term(&self) -> Option<&CalibrationTerm> {
        self.term.as_ref()
    }
}

/// What a caller states about a calibration.
///
/// # Errors
/// A word that is no unit or no lens model.
pub fn stated(
    unit: Option<&str>,
    size: Option<(u32, u32)>,
    lens: Option<&str>,
    rectified: bool,
) -> anyhow::Result<CalibrationOptions> {
    Ok(CalibrationOptions {
        calib_unit: unit.map(str::parse).transpose().map_err(|error| anyhow!("calibration_unit: {error}"))?,
        calib_size: size.map(|(width, height)| ImageSize { width, height }),
        calib_lens: lens.map(str::parse).transpose().map_err(|error| anyhow!("lens: {error}"))?,
        rectified,
    })
}

#[pymethods]
impl StereoRig {
    /// Loads a calibration from `paths`: the file of `pb3dp calibrate`, `calib.json`, a Kalibr camchain, an OpenCV stereo YAML or its two files,
    /// two ROS `camera_info` files (left, right), or a folder that contains them. The format is detected from the contents.
    ///
    /// For files that leave something unstated: `image_size` is (width, height) of the images in pixels; `calibration_unit` the unit of length of
    /// an OpenCV file, "mm", "cm" or "m"; `calibrated_size` the (width, height) that the calibration was made with, from which it is scaled to
    /// `image_size`; `lens` the model of four coefficients, "brown" or "equidistant". `rectified`: whether the images are rectified already.
    /// `images`: a left and a right image of these cameras, as in `Estimator.estimate`; they give `image_size`, and decide the lens model as in
    /// the program. Raises `Error` if a file cannot be read, or leaves something unstated that no argument states.
    #[staticmethod]
    #[pyo3(signature = (*paths, image_size=None, calibration_unit=None, calibrated_size=None, lens=None, rectified=false, images=None))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn load(
        py: Python<'_>,
        paths: Vec<PathBuf>,
        image_size: Option<(u32, u32)>,
        calibration_unit: Option<&str>,
        calibrated_size: Option<(u32, u32)>,
        lens: Option<&str>,
        rectified: bool,
        images: Option<[Bound<'_, PyAny>; 2]>,
    ) -> PyResult<Self> {
        let stated = stated(calibration_unit, calibrated_size, lens, rectified).or_raise(py)?.stated();
        let size = image_size.map(|(width, height)| ImageSize { width, height });
        let Some([left, right]) = images else {
            let loaded = py.detach(|| load_stated(&paths, size, &stated)?.decided());
            return Ok(Self::new(loaded.or_raise(py)?));
        };
        let given = GivenPair::of(&left, &right).or_raise(py)?;
        let pixels = given.pixels().or_raise(py)?;
        let loaded = py.detach(|| {
            with_views(pixels, &mut None, |left, right| {
                let size = size.unwrap_or(ImageSize { width: left.width(), height: left.height() });
                Ok(decide_lens(load_stated(&paths, Some(size), &stated)?, left, right)?)
            })
        });
        Ok(Self::new(loaded.or_raise(py)?))
    }

    /// Width and height of the images, pixels.
    #[getter]
    fn image_size(&self) -> (u32, u32) {
        let size = self.rig().left().size();
        (size.width, size.height)
    }

    /// Distance between the optical centres, metres.
    #[getter]
    fn baseline_m(&self) -> f64 {
        self.rig().baseline_m()
    }

    /// Camera matrix of the left camera, 3x3, pixels.
    #[getter]
    fn left_matrix<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        camera_matrix(py, self.rig().left())
    }

    /// Camera matrix of the right camera, 3x3, pixels.
    #[getter]
    fn right_matrix<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        camera_matrix(py, self.rig().right())
    }

    /// Lens of the left camera: a `Distortion`, its model and its coefficients.
    #[getter]
    fn left_distortion<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        distortion(py, self.rig().left())
    }

    /// Lens of the right camera, as `left_distortion`.
    #[getter]
    fn right_distortion<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        distortion(py, self.rig().right())
    }

    /// Pose of the left camera in the right one: 4x4, maps coordinates in `cam_left` to `cam_right`, translation in metres.
    #[getter]
    fn cam_right_from_cam_left<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        arrays::pose(py, self.rig().cam_right_from_cam_left())
    }

    /// Projects points into the raw left image, with the distortion of the lens: `points_in_cam_left`, N x 3, metres, to N x 2, pixels. Points
    /// that the camera cannot see give NaN. Raises `Error` for another shape.
    fn project_left<'py>(
        &self,
        py: Python<'py>,
        points_in_cam_left: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points = points_in_cam_left.as_array();
        if points.ncols() != 3 {
            let shape = points.shape();
            let refused: Result<(), _> = Err(anyhow!("points_in_cam_left has the shape {shape:?}: give N x 3, metres"));
            refused.or_raise(py)?;
        }
        let camera = self.rig().left();
        let projected = points.rows().into_iter().flat_map(|point| {
            let pixel = camera.project(&Point3::new(point[0], point[1], point[2]));
            pixel.map_or([f64::NAN; 2], Into::into)
        });
        arrays::matrix(py, 2, projected.collect())
    }

    /// Covariance of the N numbers of the calibration with their names, a `NamedCovariance`, or None: `left.fx` (pixels), `right.k1`, and
    /// `cam_right_from_cam_left.x_m` to `rz_rad`. TOML files of `pb3dp calibrate stereo` state it; estimates then have
    /// `calibration_covariance`.
    #[getter]
    fn calibration_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let Some(known) = self.calibration.judgement.as_ref().and_then(|judgement| judgement.covariance.as_ref())
        else {
            return Ok(None);
        };
        let matrix = arrays::matrix(py, known.names.len().max(1), known.rows.concat())?;
        named_tuple(py, "NamedCovariance", (known.names.clone(), matrix)).map(Some)
    }

    /// The format of the file, in words.
    #[getter]
    fn format(&self) -> String {
        self.calibration.format.to_string()
    }

    /// The file or files.
    #[getter]
    fn source(&self) -> &str {
        &self.calibration.source
    }

    /// Assumptions about what the file leaves unstated that can be wrong; they also stand in `warnings` of the estimates.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.doubts().iter().map(|warning| in_python(warning)).collect()
    }

    /// What the reader assumed or left out.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.clone()
    }

    fn __repr__(&self) -> String {
        let (width, height) = self.image_size();
        let (baseline_mm, source) = (self.baseline_m() * 1e3, self.source());
        format!("StereoRig({width}x{height} px, baseline {baseline_mm:.1} mm, from {source})")
    }
}

fn camera_matrix<'py>(py: Python<'py>, camera: &Camera) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let m = camera.pinhole().matrix();
    arrays::matrix(py, 3, (0..9).map(|k| m[(k / 3, k % 3)]).collect())
}

fn distortion<'py>(py: Python<'py>, camera: &Camera) -> PyResult<Bound<'py, PyAny>> {
    let lens = camera.distortion();
    let name = match lens {
        Distortion::None => "none",
        Distortion::BrownConrady5 { .. } => "plumb_bob",
        Distortion::BrownConrady8 { .. } => "rational_polynomial",
        Distortion::Equidistant { .. } => "equidistant",
    };
    named_tuple(py, "Distortion", (name, arrays::vector(py, lens.coefficients())))
}
