//! Images of numpy for the estimators, without copies where the memory allows it.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use image::RgbImage;
use numpy::{PyArray1, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArray, PyUntypedArrayMethods};
use pb3dp_estimation_core::rgb_view::RgbView;
use pb3dp_geometry::ImageSize;
use pb3dp_record::images::StoredImage;
use pb3dp_record::value_range::{DeepImage, ValueRange};
use pyo3::prelude::*;

use crate::errors::OrRaise;

/// An image argument.
pub enum Given<'py> {
    /// 8-bit RGB in one piece, in the memory of numpy.
    Borrowed { array: PyReadonlyArrayDyn<'py, u8>, width: u32, height: u32 },
    /// Everything else, as a copy.
    Copied(StoredImage),
}

/// An image whose memory stays valid while the interpreter does other work.
#[derive(Clone, Copy)]
pub enum Pixels<'a> {
    /// 8-bit RGB.
    View(RgbView<'a>),
    /// A copy.
    Stored(&'a StoredImage),
}

impl<'py> Given<'py> {
    /// An image of 8 or 16 bits: height x width (grey) or height x width x 3 (red, green, blue).
    ///
    /// # Errors
    /// Another type or shape, with the name of the argument.
    pub fn of(name: &str, given: &Bound<'py, PyAny>) -> Result<Self> {
        if let Ok(array) = given.cast::<PyArrayDyn<u8>>() {
            let (width, height, channels) = dimensions(name, array.shape())?;
            let array = array.try_readonly().with_context(|| format!("{name} is being written to"))?;
            if channels == 3 && array.is_c_contiguous() {
                return Ok(Self::Borrowed { array, width, height });
            }
            let mut image = RgbImage::new(width, height);
            let rows = image.chunks_exact_mut(3 * width as usize);
            for (out, row) in rows.zip(array.as_array().outer_iter()) {
                match (channels, row.as_slice()) {
                    (3, Some(row)) => out.copy_from_slice(row),
                    (3, None) => out.iter_mut().zip(row.iter()).for_each(|(out, value)| *out = *value),
                    (_, Some(row)) => spread(out, row.iter()),
                    (_, None) => spread(out, row.iter()),
                }
            }
            return Ok(Self::Copied(StoredImage::Rgb(image)));
        }
        if let Ok(array) = given.cast::<PyArrayDyn<u16>>() {
            let (width, height, channels) = dimensions(name, array.shape())?;
            let array = array.try_readonly().with_context(|| format!("{name} is being written to"))?;
            let values = array.as_array().iter().copied().collect();
            let image = DeepImage::new(ImageSize { width, height }, channels, values);
            return Ok(Self::Copied(StoredImage::Deep(image.with_context(|| wrong_number(name))?)));
        }
        let found = match given.cast::<PyUntypedArray>() {
            Ok(array) => format!("an array of {}", array.dtype()),
            Err(_) => format!("a {}", given.get_type()),
        };
        bail!("{name} is {found}: give a numpy array of uint8 or uint16, such as image.astype(numpy.uint8)")
    }

    /// Its pixels.
    ///
    /// # Errors
    /// Never: the memory was checked.
    pub fn pixels(&self, name: &str) -> Result<Pixels<'_>> {
        match self {
            Self::Borrowed { array, width, height } => {
                let bytes = array.as_slice().with_context(|| wrong_number(name))?;
                RgbView::new(*width, *height, bytes).map(Pixels::View).with_context(|| wrong_number(name))
            }
            Self::Copied(stored) => Ok(Pixels::Stored(stored)),
        }
    }
}

/// Grey values as pixels with three equal channels.
fn spread<'a>(out: &mut [u8], values: impl Iterator<Item = &'a u8>) {
    let (pixels, _) = out.as_chunks_mut::<3>();
    pixels.iter_mut().zip(values).for_each(|(pixel, &value)| *pixel = [value; 3]);
}

fn wrong_number(name: &str) -> String {
    format!("{name}: bug: its memory does not have the size of its shape, report it")
}

/// Width, height and channels of a shape.
fn dimensions(name: &str, shape: &[usize]) -> Result<(u32, u32, usize)> {
    let (height, width, channels) = match *shape {
        [height, width] => (height, width, 1),
        [height, width, 3] => (height, width, 3),
        _ => {
            bail!("{name} has the shape {shape:?}: give height x width (grey) or height x width x 3 (red, green, blue)")
        }
    };
    match (u32::try_from(width), u32::try_from(height)) {
        (Ok(width @ 1..), Ok(height @ 1..)) => Ok((width, height, channels)),
        _ => bail!("{name} has the shape {shape:?}: an image has pixels, and at most 4294967295 in a row"),
    }
}

impl Pixels<'_> {
    fn to_stored(self) -> Result<StoredImage> {
        Ok(match self {
            Self::View(view) => {
                let image = RgbImage::from_raw(view.width(), view.height(), view.as_raw().to_vec());
                StoredImage::Rgb(image.with_context(|| wrong_number("image"))?)
            }
            Self::Stored(stored) => stored.clone(),
        })
    }

    fn view(&self) -> Option<RgbView<'_>> {
        match self {
            Self::View(view) => Some(*view),
            Self::Stored(StoredImage::Rgb(image)) => Some(image.into()),
            Self::Stored(StoredImage::Deep(_)) => None,
        }
    }
}

/// Does `work` with both images in 8 bits; images with more bits need a range, as [`StoredImage::to_rgb_pair`].
///
/// # Errors
/// Those of `work`.
pub fn with_views<T>(
    pair: [Pixels<'_>; 2],
    range: &mut Option<ValueRange>,
    work: impl FnOnce(RgbView<'_>, RgbView<'_>) -> Result<T>,
) -> Result<T> {
    if let [Some(left), Some(right)] = [pair[0].view(), pair[1].view()] {
        return work(left, right);
    }
    let ([left, right], _) = StoredImage::to_rgb_pair([pair[0].to_stored()?, pair[1].to_stored()?], range);
    work((&left).into(), (&right).into())
}

/// An image as an array that owns its memory.
pub fn array_of(py: Python<'_>, image: RgbImage) -> PyResult<Bound<'_, PyAny>> {
    let (width, height) = image.dimensions();
    let flat = PyArray1::from_vec(py, image.into_raw());
    Ok(flat.reshape([height as usize, width as usize, 3])?.into_any())
}

/// Reads an image file as the program does: PNG, JPEG, TIFF, BMP, PGM, PPM or WebP.
///
/// Returns an array of height x width x 3, uint8, in the order red, green, blue. Files with 16 bits per channel give uint16, height x width
/// if they are grey.
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
