//! One open device: its ioctls and its memory.

use std::ffi::c_void;
use std::io;
use std::mem::{size_of, zeroed};

use pb3dp_camera_settings::{Interval, StampSource};
use pb3dp_geometry::ImageSize;
use rustix::fd::{AsRawFd, OwnedFd};
use rustix::io::Errno;
use v4l::v4l_sys as sys;
use v4l::v4l2::{self, vidioc};

use crate::video::{
    Capability, ControlEntry, ControlKind, FieldOrder, Filled, Handle, IntervalEntry, RawFormat, SizeEntry, VideoNode,
};

const CAPTURE: u32 = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
const MAPPED: u32 = sys::v4l2_memory_V4L2_MEMORY_MMAP;

/// Indicates that the extended format fields are valid: drivers use the colour fields only if it is set.
const PRIVATE_IS_VALID: u32 = sys::V4L2_PIX_FMT_PRIV_MAGIC;

/// An open device.
pub(super) struct Node {
    file: OwnedFd,
    buffers: Vec<Mapping>,
}

/// Memory of a buffer, shared with the driver.
struct Mapping {
    start: *mut c_void,
    length: usize,
    /// Whether the driver may write to it now.
    is_drivers: bool,
}

// SAFETY: the memory of a mapping belongs to the process, not to a thread; it is accessed only through its owner.
unsafe impl Send for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: mapped in `Node::map` with this start and length, and unmapped only here. A failure cannot be handled.
        let _ = unsafe { v4l2::munmap(self.start, self.length) };
    }
}

/// Argument structures of V4L2: plain C structures for which all zero bits are a valid value.
///
/// # Safety
/// Only for structures that `ioctl(2)` of V4L2 accepts.
unsafe trait Argument: Sized {
    fn empty() -> Self {
        // SAFETY: guaranteed by the implementation of the trait.
        unsafe { zeroed() }
    }
}

macro_rules! arguments {
    ($($type:ty),* $(,)?) => {
        $(
            // SAFETY: a structure or number of videodev2.h.
            unsafe impl Argument for $type {}
        )*
    };
}
arguments!(
    sys::v4l2_capability,
    sys::v4l2_fmtdesc,
    sys::v4l2_frmsizeenum,
    sys::v4l2_frmivalenum,
    sys::v4l2_format,
    sys::v4l2_streamparm,
    sys::v4l2_queryctrl,
    sys::v4l2_querymenu,
    sys::v4l2_control,
    sys::v4l2_requestbuffers,
    sys::v4l2_buffer,
    u32,
    u64,
);

impl Node {
    pub(super) fn new(file: OwnedFd) -> Self {
        Self { file, buffers: Vec::new() }
    }

    /// One ioctl, repeated if it was interrupted by a signal.
    fn call<T: Argument>(&self, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
        // Bits 16 to 29 of a request contain the size of its argument.
        debug_assert_eq!((request >> 16) as usize & 0x3FFF, size_of::<T>());
        loop {
            // SAFETY: the file is open, and the argument is the structure that the request writes to.
            match unsafe { v4l2::ioctl(self.file.as_raw_fd(), request, std::ptr::from_mut(argument).cast()) } {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                result => return result,
            }
        }
    }

    /// One entry of a list; a driver signals the end by `EINVAL`. A device without such a list (`ENOTTY`) has an empty one.
    fn entry<T: Argument>(&self, request: vidioc::_IOC_TYPE, mut argument: T) -> io::Result<Option<T>> {
        match self.call(request, &mut argument) {
            Ok(()) => Ok(Some(argument)),
            Err(error) if matches!(Errno::from_io_error(&error), Some(Errno::INVAL | Errno::NOTTY)) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn buffer(index: u32) -> sys::v4l2_buffer {
        sys::v4l2_buffer { index, type_: CAPTURE, memory: MAPPED, ..Argument::empty() }
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        // The driver takes its buffers back when the file is closed; before that they must be unmapped.
        self.buffers.clear();
    }
}

impl VideoNode for Node {
    fn handle(&self) -> Handle {
        self.file.as_raw_fd()
    }

    fn capability(&self) -> io::Result<Capability> {
        let mut answer = sys::v4l2_capability::empty();
        self.call(vidioc::VIDIOC_QUERYCAP, &mut answer)?;
        // `capabilities` are those of the whole device, `device_caps` those of this node.
        let has_own = answer.capabilities & sys::V4L2_CAP_DEVICE_CAPS != 0;
        let own = if has_own { answer.device_caps } else { answer.capabilities };
        Ok(Capability {
            driver: text(&answer.driver),
            card: text(&answer.card),
            bus: text(&answer.bus_info),
            captures: own & sys::V4L2_CAP_VIDEO_CAPTURE != 0,
            streams: own & sys::V4L2_CAP_STREAMING != 0,
        })
    }

    fn set_input(&mut self, mut input: u32) -> io::Result<()> {
        self.call(vidioc::VIDIOC_S_INPUT, &mut input)
    }

    fn set_standard(&mut self, mut standard: u64) -> io::Result<()> {
        self.call(vidioc::VIDIOC_S_STD, &mut standard)
    }

    fn format_at(&self, index: u32) -> io::Result<Option<[u8; 4]>> {
        let question = sys::v4l2_fmtdesc { index, type_: CAPTURE, ..Argument::empty() };
        Ok(self.entry(vidioc::VIDIOC_ENUM_FMT, question)?.map(|answer| answer.pixelformat.to_le_bytes()))
    }

    fn size_at(&self, fourcc: [u8; 4], index: u32) -> io::Result<Option<SizeEntry>> {
        let pixel_format = u32::from_le_bytes(fourcc);
        let question = sys::v4l2_frmsizeenum { index, pixel_format, ..Argument::empty() };
        Ok(self.entry(vidioc::VIDIOC_ENUM_FRAMESIZES, question)?.map(|answer| size_entry(&answer)))
    }

    fn interval_at(&self, fourcc: [u8; 4], size: ImageSize, index: u32) -> io::Result<Option<IntervalEntry>> {
        let pixel_format = u32::from_le_bytes(fourcc);
        let ImageSize { width, height } = size;
        let question = sys::v4l2_frmivalenum { index, pixel_format, width, height, ..Argument::empty() };
        Ok(self.entry(vidioc::VIDIOC_ENUM_FRAMEINTERVALS, question)?.map(|answer| interval_entry(&answer)))
    }

    fn set_format(&mut self, format: &RawFormat) -> io::Result<RawFormat> {
        let mut argument = sys::v4l2_format { type_: CAPTURE, ..Argument::empty() };
        argument.fmt.pix = pixel_format(format);
        self.call(vidioc::VIDIOC_S_FMT, &mut argument)?;
        Ok(raw_format(&argument))
    }

    fn format(&self) -> io::Result<RawFormat> {
        let mut argument = sys::v4l2_format { type_: CAPTURE, ..Argument::empty() };
        self.call(vidioc::VIDIOC_G_FMT, &mut argument)?;
        Ok(raw_format(&argument))
    }

    fn set_interval(&mut self, interval: Interval) -> io::Result<Interval> {
        let mut argument = sys::v4l2_streamparm { type_: CAPTURE, ..Argument::empty() };
        let Interval { numerator, denominator } = interval;
        argument.parm.capture =
            sys::v4l2_captureparm { timeperframe: sys::v4l2_fract { numerator, denominator }, ..capture_parameters() };
        self.call(vidioc::VIDIOC_S_PARM, &mut argument)?;
        Ok(interval_of(&argument))
    }

    fn interval(&self) -> io::Result<Interval> {
        let mut argument = sys::v4l2_streamparm { type_: CAPTURE, ..Argument::empty() };
        self.call(vidioc::VIDIOC_G_PARM, &mut argument)?;
        Ok(interval_of(&argument))
    }

    fn control_after(&self, id: u32) -> io::Result<Option<ControlEntry>> {
        let question = sys::v4l2_queryctrl { id: id | sys::V4L2_CTRL_FLAG_NEXT_CTRL, ..Argument::empty() };
        Ok(self.entry(vidioc::VIDIOC_QUERYCTRL, question)?.map(|answer| control_entry(&answer)))
    }

    fn menu_line(&self, id: u32, line: u32) -> io::Result<Option<String>> {
        let question = sys::v4l2_querymenu { id, index: line, ..Argument::empty() };
        // SAFETY: text and number share their bytes; every byte is a byte of text.
        let text_of = |answer: sys::v4l2_querymenu| text(unsafe { &answer.__bindgen_anon_1.name });
        Ok(self.entry(vidioc::VIDIOC_QUERYMENU, question)?.map(text_of))
    }

    fn control(&self, id: u32) -> io::Result<i32> {
        let mut argument = sys::v4l2_control { id, value: 0 };
        self.call(vidioc::VIDIOC_G_CTRL, &mut argument)?;
        Ok(argument.value)
    }

    fn set_control(&mut self, id: u32, value: i32) -> io::Result<()> {
        self.call(vidioc::VIDIOC_S_CTRL, &mut sys::v4l2_control { id, value })
    }

    fn request_buffers(&mut self, count: u32) -> io::Result<u32> {
        self.buffers.clear();
        let mut argument = sys::v4l2_requestbuffers { count, type_: CAPTURE, memory: MAPPED, ..Argument::empty() };
        self.call(vidioc::VIDIOC_REQBUFS, &mut argument)?;
        Ok(argument.count)
    }

    fn map(&mut self, index: u32) -> io::Result<usize> {
        if index as usize != self.buffers.len() {
            return Err(Errno::INVAL.into());
        }
        let mut argument = Self::buffer(index);
        self.call(vidioc::VIDIOC_QUERYBUF, &mut argument)?;
        let length = argument.length as usize;
        // SAFETY: for mapped memory the driver has filled in the offset.
        let offset = i64::from(unsafe { argument.m.offset });
        let (protection, flags) =
            (rustix::mm::ProtFlags::READ | rustix::mm::ProtFlags::WRITE, rustix::mm::MapFlags::SHARED);
        let (protection, flags) = (protection.bits() as i32, flags.bits() as i32);
        let file = self.file.as_raw_fd();
        // SAFETY: a new mapping at an address chosen by the system, with the length reported by the driver.
        let start = unsafe { v4l2::mmap(std::ptr::null_mut(), length, protection, flags, file, offset) }?;
        self.buffers.push(Mapping { start, length, is_drivers: false });
        Ok(length)
    }

    fn memory(&self, index: u32) -> &[u8] {
        let Some(buffer) = self.buffers.get(index as usize).filter(|buffer| !buffer.is_drivers) else { return &[] };
        // SAFETY: mapped with that length for as long as `self` owns it; the driver does not write before the buffer is queued
        // again, which requires that `self` is not borrowed.
        unsafe { std::slice::from_raw_parts(buffer.start.cast(), buffer.length) }
    }

    fn queue(&mut self, index: u32) -> io::Result<()> {
        let Some(buffer) = self.buffers.get_mut(index as usize) else { return Err(Errno::INVAL.into()) };
        buffer.is_drivers = true;
        self.call(vidioc::VIDIOC_QBUF, &mut Self::buffer(index))
    }

    fn dequeue(&mut self) -> io::Result<Option<Filled>> {
        let mut argument = Self::buffer(0);
        match self.call(vidioc::VIDIOC_DQBUF, &mut argument) {
            Ok(()) => {}
            Err(error) if Errno::from_io_error(&error) == Some(Errno::AGAIN) => return Ok(None),
            Err(error) => return Err(error),
        }
        if let Some(buffer) = self.buffers.get_mut(argument.index as usize) {
            buffer.is_drivers = false;
        }
        Ok(Some(filled(&argument)))
    }

    fn start(&mut self) -> io::Result<()> {
        self.call(vidioc::VIDIOC_STREAMON, &mut { CAPTURE })
    }

    fn stop(&mut self) -> io::Result<()> {
        self.call(vidioc::VIDIOC_STREAMOFF, &mut { CAPTURE })?;
        for buffer in &mut self.buffers {
            buffer.is_drivers = false;
        }
        Ok(())
    }
}

/// Text of a fixed field, up to its end marker.
fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_owned()
}

fn size_entry(answer: &sys::v4l2_frmsizeenum) -> SizeEntry {
    let size = |width, height| ImageSize { width, height };
    // SAFETY: `type_` says which of the two it is; both are numbers.
    unsafe {
        if answer.type_ == sys::v4l2_frmsizetypes_V4L2_FRMSIZE_TYPE_DISCRETE {
            let one = answer.__bindgen_anon_1.discrete;
            return SizeEntry::Discrete(size(one.width, one.height));
        }
        let range = answer.__bindgen_anon_1.stepwise;
        SizeEntry::Range {
            from: size(range.min_width, range.min_height),
            to: size(range.max_width, range.max_height),
            step: (range.step_width.max(1), range.step_height.max(1)),
        }
    }
}

fn interval_entry(answer: &sys::v4l2_frmivalenum) -> IntervalEntry {
    let interval =
        |fraction: sys::v4l2_fract| Interval { numerator: fraction.numerator, denominator: fraction.denominator };
    // SAFETY: `type_` says which of the two it is; both are numbers.
    unsafe {
        if answer.type_ == sys::v4l2_frmivaltypes_V4L2_FRMIVAL_TYPE_DISCRETE {
            return IntervalEntry::Discrete(interval(answer.__bindgen_anon_1.discrete));
        }
        let range = answer.__bindgen_anon_1.stepwise;
        IntervalEntry::Range(interval(range.min), interval(range.max))
    }
}

fn field_number(field: FieldOrder) -> u32 {
    match field {
        FieldOrder::Progressive => sys::v4l2_field_V4L2_FIELD_NONE,
        FieldOrder::Interlaced => sys::v4l2_field_V4L2_FIELD_INTERLACED,
        FieldOrder::Other(number) => number,
    }
}

fn field_order(number: u32) -> FieldOrder {
    match number {
        sys::v4l2_field_V4L2_FIELD_NONE => FieldOrder::Progressive,
        sys::v4l2_field_V4L2_FIELD_INTERLACED
        | sys::v4l2_field_V4L2_FIELD_INTERLACED_TB
        | sys::v4l2_field_V4L2_FIELD_INTERLACED_BT => FieldOrder::Interlaced,
        number => FieldOrder::Other(number),
    }
}

fn pixel_format(format: &RawFormat) -> sys::v4l2_pix_format {
    // SAFETY: a structure of numbers.
    let empty: sys::v4l2_pix_format = unsafe { zeroed() };
    let mut pixels = sys::v4l2_pix_format {
        width: format.size.0,
        height: format.size.1,
        pixelformat: u32::from_le_bytes(format.fourcc),
        field: field_number(format.field),
        bytesperline: format.stride,
        sizeimage: format.image_bytes,
        colorspace: format.colorspace,
        priv_: PRIVATE_IS_VALID,
        quantization: format.quantization,
        ..empty
    };
    pixels.__bindgen_anon_1.ycbcr_enc = format.encoding;
    pixels
}

fn raw_format(answer: &sys::v4l2_format) -> RawFormat {
    // SAFETY: an answer for the buffer type that was asked for holds this part; encodings are numbers.
    let (pixels, encoding) = unsafe { (answer.fmt.pix, answer.fmt.pix.__bindgen_anon_1.ycbcr_enc) };
    let has_colour = pixels.priv_ == PRIVATE_IS_VALID;
    RawFormat {
        fourcc: pixels.pixelformat.to_le_bytes(),
        size: (pixels.width, pixels.height),
        field: field_order(pixels.field),
        stride: pixels.bytesperline,
        image_bytes: pixels.sizeimage,
        colorspace: pixels.colorspace,
        encoding: if has_colour { encoding } else { 0 },
        quantization: if has_colour { pixels.quantization } else { 0 },
    }
}

fn capture_parameters() -> sys::v4l2_captureparm {
    // SAFETY: a structure of numbers.
    unsafe { zeroed() }
}

fn interval_of(answer: &sys::v4l2_streamparm) -> Interval {
    // SAFETY: an answer for the buffer type that was asked for holds this part.
    let fraction = unsafe { answer.parm.capture.timeperframe };
    Interval { numerator: fraction.numerator, denominator: fraction.denominator }
}

fn control_entry(answer: &sys::v4l2_queryctrl) -> ControlEntry {
    let kind = match answer.type_ {
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER => ControlKind::Integer,
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_BOOLEAN => ControlKind::Boolean,
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_MENU | sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_INTEGER_MENU => ControlKind::Menu,
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_BITMASK => ControlKind::Bitmask,
        sys::v4l2_ctrl_type_V4L2_CTRL_TYPE_BUTTON => ControlKind::Button,
        _ => ControlKind::Other,
    };
    let locked = sys::V4L2_CTRL_FLAG_DISABLED
        | sys::V4L2_CTRL_FLAG_GRABBED
        | sys::V4L2_CTRL_FLAG_READ_ONLY
        | sys::V4L2_CTRL_FLAG_INACTIVE;
    ControlEntry {
        id: answer.id,
        name: text(&answer.name),
        kind,
        min: answer.minimum,
        max: answer.maximum,
        step: answer.step,
        default: answer.default_value,
        is_locked: answer.flags & locked != 0,
    }
}

fn filled(answer: &sys::v4l2_buffer) -> Filled {
    let has = |flag: u32| answer.flags & flag != 0;
    let source = match answer.flags & sys::V4L2_BUF_FLAG_TIMESTAMP_MASK {
        sys::V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC => match answer.flags & sys::V4L2_BUF_FLAG_TSTAMP_SRC_MASK {
            sys::V4L2_BUF_FLAG_TSTAMP_SRC_EOF => StampSource::EndOfFrame,
            sys::V4L2_BUF_FLAG_TSTAMP_SRC_SOE => StampSource::StartOfExposure,
            _ => StampSource::Unknown,
        },
        _ => StampSource::Unknown,
    };
    let seconds = answer.timestamp.tv_sec.saturating_mul(1_000_000_000);
    Filled {
        index: answer.index,
        bytes: answer.bytesused as usize,
        sequence: answer.sequence,
        stamp_nanos: seconds.saturating_add(answer.timestamp.tv_usec.saturating_mul(1000)),
        source,
        is_damaged: has(sys::V4L2_BUF_FLAG_ERROR),
        is_last: has(sys::V4L2_BUF_FLAG_LAST),
    }
}
