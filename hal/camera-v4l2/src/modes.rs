//! Modes offered by a device, and mode negotiation: silent changes by the driver are refused.

use std::io;

use pb3dp_camera_settings::{Interval, ModeRequest};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::CameraError;
use rustix::io::Errno;

use crate::error::{failed, unusable};
use crate::video::{FieldOrder, IntervalEntry, RawFormat, SizeEntry, VideoNode};
use pb3dp_camera_pixels::{Layout, YuvMatrix, YuvRange};

/// Maximum length of a driver list; protects against a list that does not end.
const ENTRIES_MAX: u32 = 256;

/// Tolerance of the frame rate. 29.97 and 30 differ by 10^-3.
const RATE_TOLERANCE: f64 = 5e-4;

/// `V4L2_COLORSPACE_REC709`, which implies BT.709 unless an encoding is given.
const COLORSPACE_REC709: u32 = 3;
/// `V4L2_COLORSPACE_JPEG`, which implies full range unless another quantisation is given.
const COLORSPACE_JPEG: u32 = 7;
/// `V4L2_YCBCR_ENC_709` and `V4L2_YCBCR_ENC_XV709`.
const ENCODINGS_709: [u32; 2] = [2, 4];
/// `V4L2_YCBCR_ENC_601` and `V4L2_YCBCR_ENC_XV601`.
const ENCODINGS_601: [u32; 2] = [1, 3];
/// `V4L2_QUANTIZATION_FULL_RANGE`.
const FULL_RANGE: u32 = 1;

/// One format with its sizes and their rates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OfferedFormat {
    /// Four-character code.
    pub fourcc: [u8; 4],
    /// Sizes with their frame intervals; no intervals for a range of sizes.
    pub sizes: Vec<(SizeEntry, Vec<IntervalEntry>)>,
}

/// The modes offered by a device.
///
/// # Errors
/// Errors of the driver.
pub fn offered(node: &dyn VideoNode) -> io::Result<Vec<OfferedFormat>> {
    all(|index| node.format_at(index))?
        .into_iter()
        .map(|fourcc| {
            let sizes = all(|index| node.size_at(fourcc, index))?.into_iter().map(|size| {
                let intervals = match size {
                    SizeEntry::Discrete(size) => all(|index| node.interval_at(fourcc, size, index))?,
                    SizeEntry::Range { .. } => Vec::new(),
                };
                Ok((size, intervals))
            });
            Ok(OfferedFormat { fourcc, sizes: sizes.collect::<io::Result<_>>()? })
        })
        .collect()
}

fn all<T>(entry_at: impl Fn(u32) -> io::Result<Option<T>>) -> io::Result<Vec<T>> {
    let mut entries = Vec::new();
    for index in 0..ENTRIES_MAX {
        match entry_at(index)? {
            Some(entry) => entries.push(entry),
            None => break,
        }
    }
    Ok(entries)
}

/// The negotiated mode, as read back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Memory layout of the images.
    pub layout: Layout,
    /// Frame interval, seconds.
    pub period_s: f64,
}

/// Requests a mode and reads it back.
///
/// # Errors
/// Any property differs from the request, with both values; or an error of the driver.
pub fn negotiate(node: &mut dyn VideoNode, device: &str, request: &ModeRequest) -> Result<Mode, CameraError> {
    if let Some(input) = request.input {
        node.set_input(input).map_err(|error| failed(device, &format!("switching to input {input}"), error))?;
    }
    if let Some(standard) = request.standard {
        let doing = format!("setting the television standard {standard:#x}");
        node.set_standard(standard).map_err(|error| failed(device, &doing, error))?;
    }
    let ImageSize { width, height } = request.size;
    let wished = format!("{} of {width}x{height}", request.format);
    // Stride and length are left to the driver: drivers keep a requested stride even for another size.
    let format = RawFormat { fourcc: request.format.fourcc(), size: (width, height), ..RawFormat::default() };
    node.set_format(&format).map_err(|error| failed(device, &format!("asking for {wished}"), error))?;
    let found = node.format().map_err(|error| failed(device, "reading its format back", error))?;
    let period_s = set_rate(node, device, request)?;
    if (found.fourcc, found.size) != (format.fourcc, format.size) {
        let letters = String::from_utf8_lossy(&found.fourcc).into_owned();
        let what = format!(
            "requested {wished}, the driver selected {letters} of {}x{}; {}",
            found.size.0,
            found.size.1,
            offers(node)
        );
        return Err(unusable(device, what));
    }
    let is_taken = match found.field {
        FieldOrder::Progressive => true,
        FieldOrder::Interlaced => request.takes_interlaced,
        FieldOrder::Other(_) => false,
    };
    if !is_taken {
        let what =
            format!("the mode is interlaced ({:?}), which tears moving objects; choose another mode", found.field);
        return Err(unusable(device, what));
    }
    let (matrix, range) = colours(&found);
    let layout = Layout { format: request.format, size: request.size, stride: found.stride as usize, matrix, range };
    let row = request.format.row_bytes(width).unwrap_or(0);
    if layout.stride < row || (found.image_bytes as usize) < layout.bytes_min() {
        let (stride, bytes) = (layout.stride, found.image_bytes);
        let what = format!(
            "{wished} needs rows of {row} bytes, the driver reports {stride}, and buffers of {bytes}; the driver is faulty"
        );
        return Err(unusable(device, what));
    }
    Ok(Mode { layout, period_s })
}

fn set_rate(node: &mut dyn VideoNode, device: &str, request: &ModeRequest) -> Result<f64, CameraError> {
    let asked = request
        .interval
        .seconds()
        .ok_or_else(|| unusable(device, format!("invalid frame interval {:?}", request.interval)))?;
    match node.set_interval(request.interval) {
        Ok(_) => {}
        // For a device without this call the rate follows from its input.
        Err(error) if Errno::from_io_error(&error) == Some(Errno::NOTTY) => {}
        Err(error) => return Err(failed(device, "setting its rate", error)),
    }
    let found = node.interval().map_err(|error| failed(device, "reading its rate back", error))?;
    let found_s = found.seconds().unwrap_or(f64::INFINITY);
    let is_as_asked = (found_s - asked).abs() <= RATE_TOLERANCE * asked;
    if !is_as_asked {
        let ImageSize { width, height } = request.size;
        let what = format!(
            "requested {:.3} images per second of {} {width}x{height}, the driver selected {:.3}; {}",
            1.0 / asked,
            request.format,
            1.0 / found_s,
            offers(node)
        );
        return Err(unusable(device, what));
    }
    Ok(found_s)
}

/// Meaning of the bytes of `YUYV` and `NV12`: kernel documentation, "Defining Colorspaces in V4L2", including its defaults for unspecified
/// fields.
fn colours(format: &RawFormat) -> (YuvMatrix, YuvRange) {
    let is_709 = ENCODINGS_709.contains(&format.encoding)
        || (!ENCODINGS_601.contains(&format.encoding) && format.colorspace == COLORSPACE_REC709);
    let is_full =
        format.quantization == FULL_RANGE || (format.quantization == 0 && format.colorspace == COLORSPACE_JPEG);
    let matrix = if is_709 { YuvMatrix::Bt709 } else { YuvMatrix::Bt601 };
    (matrix, if is_full { YuvRange::Full } else { YuvRange::Limited })
}

/// The offered alternatives, for messages.
fn offers(node: &dyn VideoNode) -> String {
    let Ok(formats) = offered(node) else { return "`pb3dp cameras list` shows what it offers".to_owned() };
    let formats: Vec<String> = formats.iter().map(OfferedFormat::to_string).collect();
    format!("it offers {}", formats.join("; "))
}

impl std::fmt::Display for OfferedFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(String::from_utf8_lossy(&self.fourcc).trim_end())?;
        for (size, intervals) in &self.sizes {
            match size {
                SizeEntry::Discrete(ImageSize { width, height }) => write!(f, " {width}x{height}")?,
                SizeEntry::Range { from, to, .. } => {
                    write!(f, " {}x{} to {}x{}", from.width, from.height, to.width, to.height)?;
                }
            }
            let rate = |interval: &Interval| interval.per_second().unwrap_or(0.0);
            for (k, interval) in intervals.iter().enumerate() {
                f.write_str(if k == 0 { " at " } else { ", " })?;
                match interval {
                    IntervalEntry::Discrete(one) => write!(f, "{:.4}", rate(one))?,
                    IntervalEntry::Range(shortest, longest) => {
                        write!(f, "{:.4} to {:.4}", rate(longest), rate(shortest))?
                    }
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_camera_settings::PixelFormat;

    use super::*;
    use crate::video::MockVideoNode;
    use pb3dp_hal_api::CameraErrorKind;

    fn request() -> ModeRequest {
        ModeRequest {
            format: PixelFormat::Yuyv,
            size: ImageSize { width: 640, height: 480 },
            interval: Interval { numerator: 1001, denominator: 30000 },
            input: Some(2),
            standard: Some(0x1000),
            takes_interlaced: true,
        }
    }

    fn answer() -> RawFormat {
        let (fourcc, size, field) = (*b"YUYV", (640, 480), FieldOrder::Interlaced);
        RawFormat { fourcc, size, field, stride: 1280, image_bytes: 614_400, ..RawFormat::default() }
    }

    /// A television device: it has inputs and standards, and no call for its frame rate.
    fn television(answer: RawFormat) -> MockVideoNode {
        let mut node = MockVideoNode::new();
        node.expect_set_input().withf(|input| *input == 2).times(1).returning(|_| Ok(()));
        node.expect_set_standard().withf(|standard| *standard == 0x1000).times(1).returning(|_| Ok(()));
        // Whatever was set before, stride and length are left to the driver.
        let is_free = |format: &RawFormat| format.stride == 0 && format.image_bytes == 0 && format.size == (640, 480);
        node.expect_set_format().withf(is_free).times(1).returning(move |_| Ok(answer));
        node.expect_format().returning(move || Ok(answer));
        node.expect_set_interval().returning(|_| Err(Errno::NOTTY.into()));
        node.expect_interval().returning(|| Ok(Interval { numerator: 1001, denominator: 30000 }));
        node.expect_format_at().returning(|_| Ok(None));
        node
    }

    #[test]
    fn a_television_device_is_asked_by_input_and_standard() {
        let mode = negotiate(&mut television(answer()), "grabber", &request()).unwrap();
        assert_eq!(mode.layout.stride, 1280);
        assert!((mode.period_s - 0.033_366_7).abs() < 1e-6);
        assert_eq!((mode.layout.matrix, mode.layout.range), (YuvMatrix::Bt601, YuvRange::Limited));
    }

    #[test]
    fn colours_are_those_that_the_driver_states() {
        for (colorspace, encoding, quantization, expected) in [
            (8, 0, 0, (YuvMatrix::Bt601, YuvRange::Limited)),
            (3, 0, 0, (YuvMatrix::Bt709, YuvRange::Limited)),
            (3, 1, 0, (YuvMatrix::Bt601, YuvRange::Limited)),
            (8, 2, 1, (YuvMatrix::Bt709, YuvRange::Full)),
            (7, 0, 0, (YuvMatrix::Bt601, YuvRange::Full)),
            (7, 0, 2, (YuvMatrix::Bt601, YuvRange::Limited)),
        ] {
            let answer = RawFormat { colorspace, encoding, quantization, ..answer() };
            let mode = negotiate(&mut television(answer), "grabber", &request()).unwrap();
            assert_eq!((mode.layout.matrix, mode.layout.range), expected, "{colorspace} {encoding} {quantization}");
        }
    }

    #[test]
    fn faulty_answers_are_refused() {
        for (answer, reason) in [
            (RawFormat { stride: 960, ..answer() }, "needs rows of 1280 bytes, the driver reports 960"),
            (RawFormat { image_bytes: 614_399, ..answer() }, "and buffers of 614399"),
            (RawFormat { field: FieldOrder::Other(7), ..answer() }, "interlaced (Other(7))"),
            (RawFormat { size: (640, 240), ..answer() }, "the driver selected YUYV of 640x240"),
        ] {
            let error = negotiate(&mut television(answer), "grabber", &request()).unwrap_err();
            assert!(error.to_string().contains(reason), "{error}");
            assert_eq!(error.kind(), CameraErrorKind::Unusable);
        }
    }

    #[test]
    fn a_list_without_an_end_does_not_keep_us() {
        let mut node = MockVideoNode::new();
        node.expect_format_at().returning(|_| Ok(Some(*b"YUYV")));
        node.expect_size_at().returning(|_, _| Ok(None));
        assert_eq!(offered(&node).unwrap().len(), ENTRIES_MAX as usize);
    }
}
