//! Regions of the left image.

use std::borrow::Cow;

use anyhow::{Context, Result, anyhow, bail};
use image::GrayImage;
use nalgebra::Vector2;
use numpy::{PyArray2, PyArrayDyn, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pb3dp_estimation_core::region::Region as Marked;
use pb3dp_geometry::ImageSize;
use pb3dp_setup::region_spec::{RegionSpec, load_region, region_of_mask};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::{OrRaise, of_type};

/// The pixels of an object in the left image.
///
/// Pixel coordinates: u to the right, v down; (0, 0) is the centre of the first pixel.
#[pyclass(frozen, module = "pb3dp")]
pub struct Region {
    marked: Mark,
}

enum Mark {
    /// In the notation of the command line.
    Spec(RegionSpec),
    /// Final, for images of any size, or of the size of its mask.
    Region(Marked),
}

impl Region {
    /// A polygon of a recording, pixels.
    pub fn of_polygon(corners: &[[f64; 2]]) -> Self {
        let vertices_px = corners.iter().map(|&[u, v]| Vector2::new(u, v)).collect();
        Self { marked: Mark::Region(Marked::Polygon { vertices_px }) }
    }

    /// The region in images of this size.
    ///
    /// # Errors
    /// A mask file that cannot be used, a rectangle without area.
    pub fn in_images(&self, size: ImageSize) -> Result<Cow<'_, Marked>> {
        match &self.marked {
            Mark::Spec(spec) => load_region(spec, size).map(Cow::Owned),
            Mark::Region(region) => Ok(Cow::Borrowed(region)),
        }
    }

    /// A region argument.
    ///
    /// # Errors
    /// Something else.
    pub fn of<'a, 'py>(given: &'a Bound<'py, PyAny>) -> Result<&'a Bound<'py, Self>> {
        let region = given.cast::<Self>().ok();
        region.with_context(|| {
            format!("region is {}: give a pb3dp.Region, such as Region.rectangle(x, y, width, height)", of_type(given))
        })
    }

    fn parsed(py: Python<'_>, text: &str) -> PyResult<Self> {
        let spec: Result<RegionSpec, String> = text.parse();
        Ok(Self { marked: Mark::Spec(spec.map_err(|text| anyhow!(text)).or_raise(py)?) })
    }
}

#[pymethods]
impl Region {
    /// A region from a `text` in the notation of the program: `rect:X,Y,WIDTH,HEIGHT`, `poly:X1,Y1;X2,Y2;X3,Y3`, `mask:FILE` or `click:X,Y`,
    /// pixels. Raises `Error` for another text.
    #[staticmethod]
    fn parse(py: Python<'_>, text: &str) -> PyResult<Self> {
        Self::parsed(py, text)
    }

    /// A rectangle: its first column `x` and row `y`, its `width` and `height`, pixels. Raises `Error` if it has no area.
    #[staticmethod]
    fn rectangle(py: Python<'_>, x: f64, y: f64, width: f64, height: f64) -> PyResult<Self> {
        if width <= 0.0 || height <= 0.0 {
            let refused: Result<Self> =
                Err(anyhow!("width {width} and height {height} of a rectangle must be positive, pixels"));
            return refused.or_raise(py);
        }
        Self::parsed(py, &format!("rect:{x},{y},{width},{height}"))
    }

    /// A polygon: `corners` is an array of N x 2, column and row, pixels. Raises `Error` for less than three corners.
    #[staticmethod]
    fn polygon(py: Python<'_>, corners: Vec<[f64; 2]>) -> PyResult<Self> {
        let corners: Vec<String> = corners.iter().map(|[u, v]| format!("{u},{v}")).collect();
        Self::parsed(py, &format!("poly:{}", corners.join(";")))
    }

    /// A region grown from one pixel over its colour: column `x` and row `y`, pixels. Raises `Error` for numbers that are not finite.
    #[staticmethod]
    fn click(py: Python<'_>, x: f64, y: f64) -> PyResult<Self> {
        Self::parsed(py, &format!("click:{x},{y}"))
    }

    /// The pixels that are True, or not 0: `mask` is an array of height x width, bool or uint8, with the size of the left image. Raises `Error`
    /// for another type or shape, and for a mask without pixels.
    #[staticmethod]
    fn mask(py: Python<'_>, mask: &Bound<'_, PyAny>) -> PyResult<Self> {
        let image = mask_image(mask).and_then(|image| region_of_mask("mask", image));
        Ok(Self { marked: Mark::Region(image.or_raise(py)?) })
    }

    /// The corners of a rectangle or a polygon: N x 2, column and row, pixels; None for masks and clicks.
    #[getter]
    fn corners_px<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
        let corners = match &self.marked {
            Mark::Region(Marked::Polygon { vertices_px }) => vertices_px.iter().flat_map(|at| [at.x, at.y]).collect(),
            Mark::Spec(RegionSpec::Polygon(corners)) => corners.concat(),
            Mark::Spec(RegionSpec::Rectangle([x, y, width, height])) => {
                let (right, bottom) = (x + width, y + height);
                vec![*x, *y, right, *y, right, bottom, *x, bottom]
            }
            _ => return Ok(None),
        };
        arrays::matrix(py, 2, corners).map(Some)
    }

    fn __repr__(&self) -> String {
        match &self.marked {
            Mark::Spec(spec) => format!("Region({spec})"),
            Mark::Region(Marked::Polygon { vertices_px }) => format!("Region(poly, {} corners)", vertices_px.len()),
            Mark::Region(_) => "Region(mask)".to_owned(),
        }
    }
}

fn mask_image(given: &Bound<'_, PyAny>) -> Result<GrayImage> {
    let (shape, values): (Vec<usize>, Vec<u8>) = if let Ok(array) = given.cast::<PyArrayDyn<bool>>() {
        let read: PyReadonlyArray2<'_, bool> = two_axes(given, array.shape())?;
        (array.shape().to_vec(), read.as_array().iter().map(|&inside| u8::from(inside)).collect())
    } else if let Ok(array) = given.cast::<PyArrayDyn<u8>>() {
        let read: PyReadonlyArray2<'_, u8> = two_axes(given, array.shape())?;
        (array.shape().to_vec(), read.as_array().iter().copied().collect())
    } else {
        bail!("mask is a {}: give a numpy array of bool or uint8", given.get_type());
    };
    let size = |axis: usize| u32::try_from(shape[axis]).context("mask is too large");
    GrayImage::from_raw(size(1)?, size(0)?, values).context("mask is too large")
}

fn two_axes<'py, T: numpy::Element>(given: &Bound<'py, PyAny>, shape: &[usize]) -> Result<PyReadonlyArray2<'py, T>> {
    let array = given.cast::<numpy::PyArray2<T>>();
    let array = array.ok().with_context(|| format!("mask has the shape {shape:?}: give height x width"))?;
    array.try_readonly().context("mask is being written to")
}
