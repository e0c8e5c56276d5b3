//! Images of numpy for the estimators, without copies where the memory allows it.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use image::RgbImage;
use numpy::{Element, PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods};
use pb3dp_estimation_core::image_view::{ImageView, Pixels};
use pb3dp_record::images::StoredImage;
use pb3dp_record::value_range::{ValueRange, measured_range};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyString;

use crate::errors::{OrRaise, of_type};

/// An image argument.
struct Given<'py> {
    shape: Shape,
    values: GivenValues<'py>,
}

enum GivenValues<'py> {
    Bytes(Memory<'py, u8>),
    Deep(Memory<'py, u16>),
}

/// The images of a pair.
pub struct GivenPair<'py>([Given<'py>; 2]);

impl<'py> GivenPair<'py> {
    /// The arguments `left` and `right`.
    ///
    /// # Errors
    /// Those of [`Given::of`].
    pub fn of(left: &Bound<'py, PyAny>, right: &Bound<'py, PyAny>) -> Result<Self> {
        Ok(Self([Given::of("left", left)?, Given::of("right", right)?]))
    }

    /// Their pixels.
    ///
    /// # Errors
    /// Never: the memory was checked.
    pub fn pixels(&self) -> Result<[GivenPixels<'_>; 2]> {
        Ok([self.0[0].pixels("left")?, self.0[1].pixels("right")?])
    }
}

/// An array without gaps, and the position of the first pixel of the image in it.
struct Memory<'py, T: Element> {
    array: PyReadonlyArrayDyn<'py, T>,
    first: usize,
}

#[derive(Clone, Copy)]
struct Shape {
    width: u32,
    height: u32,
    channels: usize,
    /// Values from one row to the next.
    stride: usize,
}

/// An image whose memory stays valid while the interpreter does other work.
#[derive(Clone, Copy)]
pub struct GivenPixels<'a> {
    shape: Shape,
    values: Values<'a>,
}

#[derive(Clone, Copy)]
enum Values<'a> {
    Bytes(&'a [u8]),
    Deep(&'a [u16]),
}

impl<'py> Given<'py> {
    /// An image of 8 or 16 bits: height x width (grey) or height x width x 3 (red, green, blue).
    ///
    /// # Errors
    /// Another type or shape, with the name of the argument.
    fn of(name: &str, given: &Bound<'py, PyAny>) -> Result<Self> {
        if let Ok(array) = given.cast::<PyArrayDyn<u8>>() {
            let (shape, memory) = memory(name, array)?;
            return Ok(Self { shape, values: GivenValues::Bytes(memory) });
        }
        if let Ok(array) = given.cast::<PyArrayDyn<u16>>() {
            let (shape, memory) = memory(name, array)?;
            return Ok(Self { shape, values: GivenValues::Deep(memory) });
        }
        let Ok(array) = given.cast::<PyUntypedArray>() else {
            let is_path = given.is_instance_of::<PyString>() || given.hasattr("__fspath__").unwrap_or(false);
            let remedy =
                if is_path { "read it by pb3dp.read_image(path)" } else { "give a numpy array of uint8 or uint16" };
            bail!("{name} is {}: {remedy}", of_type(given));
        };
        let remedy = "give uint8 or uint16; values from 0 to 1 become (255 * image).astype(numpy.uint8)";
        bail!("{name} is an array of {}: {remedy}", array.dtype())
    }

    fn pixels(&self, name: &str) -> Result<GivenPixels<'_>> {
        let values = match &self.values {
            GivenValues::Bytes(memory) => memory.values().map(Values::Bytes),
            GivenValues::Deep(memory) => memory.values().map(Values::Deep),
        };
        Ok(GivenPixels { shape: self.shape, values: values.with_context(|| wrong_number(name))? })
    }
}

/// The memory of an image with its shape: its own if the values of a row are beside each other, otherwise that of a copy.
fn memory<'py, T: Element>(name: &str, array: &Bound<'py, PyArrayDyn<T>>) -> Result<(Shape, Memory<'py, T>)> {
    static AS_STRIDED: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    static COPY: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let read = |array: &Bound<'py, PyArrayDyn<T>>, first| -> Result<Memory<'py, T>> {
        let array = array.try_readonly().with_context(|| format!("{name} is being written to"))?;
        Ok(Memory { array, first })
    };
    let shape = Shape::of(name, array.shape())?;
    if array.is_c_contiguous() {
        return Ok((shape, read(array, 0)?));
    }
    let py = array.py();
    let (stride, flat) = match row_stride::<T>(array) {
        Some(stride) => {
            let strided = Shape { stride, ..shape };
            if let Some((whole, first)) = owner(array) {
                return Ok((strided, read(&whole, first)?));
            }
            // The memory is of another library: one row after the other with the values between them.
            let as_strided = AS_STRIDED.import(py, "numpy.lib.stride_tricks", "as_strided")?;
            (stride, as_strided.call1((array, (strided.length(),), (size_of::<T>(),), false, false))?)
        }
        None => (shape.stride, COPY.import(py, "numpy", "ascontiguousarray")?.call1((array,))?),
    };
    let flat = flat.cast_into::<PyArrayDyn<T>>().ok().with_context(|| wrong_number(name))?;
    Ok((Shape { stride, ..shape }, read(&flat, 0)?))
}

/// The array without gaps of which this one is a part, and the position of its first value in it.
fn owner<'py, T: Element>(part: &Bound<'py, PyArrayDyn<T>>) -> Option<(Bound<'py, PyArrayDyn<T>>, usize)> {
    let whole = part.getattr("base").ok()?.cast_into::<PyArrayDyn<T>>().ok()?;
    let bytes = part.data().addr().checked_sub(whole.data().addr())?;
    let is_inside = bytes % size_of::<T>() == 0 && whole.is_c_contiguous();
    is_inside.then_some((whole, bytes / size_of::<T>()))
}

/// Values from one row of an image to the next one, if the values of a row are beside each other and rows do not overlap.
fn row_stride<T>(array: &Bound<'_, PyArrayDyn<T>>) -> Option<usize> {
    let (shape, strides) = (array.shape(), array.strides());
    let mut beside = isize::try_from(size_of::<T>()).ok()?;
    for (length, stride) in shape.iter().zip(strides).skip(1).rev() {
        if *length > 1 && *stride != beside {
            return None;
        }
        beside = beside.checked_mul(isize::try_from(*length).ok()?)?;
    }
    let stride = if shape[0] > 1 { strides[0] } else { beside };
    let is_aligned = stride % isize::try_from(size_of::<T>()).ok()? == 0;
    (stride >= beside && is_aligned).then_some(stride.unsigned_abs() / size_of::<T>())
}

impl<T: Element> Memory<'_, T> {
    fn values(&self) -> Option<&[T]> {
        self.array.as_slice().ok()?.get(self.first..)
    }
}

fn wrong_number(name: &str) -> String {
    format!("{name}: bug: its memory does not have the size of its shape, report it")
}

impl Shape {
    /// That of an image without gaps.
    fn of(name: &str, shape: &[usize]) -> Result<Self> {
        let (height, width, channels) = match *shape {
            [height, width] => (height, width, 1),
            [height, width, 3] => (height, width, 3),
            _ => {
                bail!(
                    "{name} has the shape {shape:?}: give height x width (grey) or height x width x 3 (red, green, blue)"
                )
            }
        };
        match (u32::try_from(width), u32::try_from(height)) {
            (Ok(width @ 1..), Ok(height @ 1..)) => {
                Ok(Self { width, height, channels, stride: width as usize * channels })
            }
            _ => bail!("{name} has the shape {shape:?}: an image has pixels, and at most 4294967295 in a row"),
        }
    }

    /// Values from the first pixel to the last one.
    fn length(&self) -> usize {
        (self.height as usize - 1) * self.stride + self.row()
    }

    /// Values of a row.
    fn row(&self) -> usize {
        self.width as usize * self.channels
    }
}

impl<'a> GivenPixels<'a> {
    fn view(&self, range: ValueRange) -> Result<ImageView<'a>> {
        let Shape { width, height, channels, stride } = self.shape;
        let pixels = match (self.values, channels) {
            (Values::Bytes(bytes), 1) => Pixels::Grey(bytes),
            (Values::Bytes(bytes), _) => Pixels::Rgb(bytes),
            (Values::Deep(values), 1) => Pixels::DeepGrey(values, range),
            (Values::Deep(values), _) => Pixels::DeepRgb(values, range),
        };
        ImageView::new(width, height, stride, pixels).with_context(|| wrong_number("image"))
    }

    /// The rows of an image of 16 bits.
    fn deep_rows(&self) -> impl Iterator<Item = &'a [u16]> + use<'a> {
        let values = if let Values::Deep(values) = self.values { values } else { &[] };
        let row = self.shape.row();
        let rows = values.chunks(self.shape.stride).take(self.shape.height as usize);
        rows.map(move |values| &values[..row.min(values.len())])
    }
}

/// Does `work` with both images; images with more than 8 bits need a range: without one it is measured on this pair and kept.
///
/// # Errors
/// Those of `work`.
pub fn with_views<T>(
    pair: [GivenPixels<'_>; 2],
    range: &mut Option<ValueRange>,
    work: impl FnOnce(ImageView<'_>, ImageView<'_>) -> Result<T>,
) -> Result<T> {
    let is_deep = pair.iter().any(|pixels| matches!(pixels.values, Values::Deep(_)));
    if is_deep && range.is_none() {
        *range = Some(measured_range(pair.iter().flat_map(GivenPixels::deep_rows).flatten()));
    }
    let range = range.unwrap_or(ValueRange::FULL);
    work(pair[0].view(range)?, pair[1].view(range)?)
}

/// An image as an array that owns its memory.
pub fn array_of(py: Python<'_>, image: RgbImage) -> PyResult<Bound<'_, PyAny>> {
    let (width, height) = image.dimensions();
    let flat = PyArray1::from_vec(py, image.into_raw());
    Ok(flat.reshape([height as usize, width as usize, 3])?.into_any())
}

/// Reads an image file as the program does: PNG, JPEG, TIFF, BMP, PGM, PPM or WebP.
///
/// Returns an array of height x width x 3, uint8, in the order red, green, blue. A file with 16 bits per channel gives uint16; a grey one of
/// 16 bits gives height x width. Raises `Error` if the file at `path` cannot be read.
#[pyfunction]
pub fn read_image(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyAny>> {
    match py.detach(|| StoredImage::load(&path)).or_raise(py)? {
        StoredImage::Rgb(image) => array_of(py, image),
        StoredImage::Deep(image) => {
            let (size, channels) = (image.size(), if image.is_grey() { 1 } else { 3 });
            let flat = PyArray1::from_slice(py, image.values());
            let (height, width) = (size.height as usize, size.width as usize);
            match channels {
                1 => Ok(flat.reshape([height, width])?.into_any()),
                _ => Ok(flat.reshape([height, width, channels])?.into_any()),
            }
        }
    }
}
