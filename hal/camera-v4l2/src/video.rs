//! The interface to the operating system: few calls, each one ioctl of V4L2, so that all other code can be tested without a
//! device.
//!
//! [`Linux`](crate::linux::Linux) is the real implementation, [`emulated`](crate::emulated) one that fails on request. All errors
//! are system errors with their `errno`.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use pb3dp_camera_settings::{Interval, StampSource};
use pb3dp_geometry::ImageSize;

/// A video device in the device list, before it is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeEntry {
    /// `/dev/video0`: changes from boot to boot.
    pub path: PathBuf,
    /// Index among the nodes of one device, from 0; `None` if the system does not report it.
    pub index: Option<u32>,
    /// Serial number of its USB device.
    pub serial: Option<String>,
}

/// Capabilities reported by a device (`VIDIOC_QUERYCAP`).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Capability {
    /// Name of the driver: `uvcvideo`.
    pub driver: String,
    /// Display name of the device.
    pub card: String,
    /// Port it is connected to: `usb-0000:00:14.0-1.2`.
    pub bus: String,
    /// Whether this node captures images (and not metadata, for example).
    pub captures: bool,
    /// Whether it supports memory-mapped buffers.
    pub streams: bool,
}

/// Field order: which lines of an image were exposed together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FieldOrder {
    /// All of them.
    #[default]
    Progressive,
    /// Even and odd lines are exposed one after the other and interleaved in one image.
    Interlaced,
    /// Any other field order, by its V4L2 number.
    Other(u32),
}

/// A requested or returned format (`v4l2_pix_format`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RawFormat {
    /// Four-character code of the pixel format.
    pub fourcc: [u8; 4],
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Field order.
    pub field: FieldOrder,
    /// Bytes from row to row; 0 in a request leaves it to the driver.
    pub stride: u32,
    /// Bytes of a buffer.
    pub image_bytes: u32,
    /// `V4L2_COLORSPACE_*`, 0 for the driver's default.
    pub colorspace: u32,
    /// `V4L2_YCBCR_ENC_*`, 0 for the default of the colour space.
    pub encoding: u32,
    /// `V4L2_QUANTIZATION_*`, 0 for the default of the colour space.
    pub quantization: u32,
}

/// One entry of a list of sizes: one size, or a range of sizes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SizeEntry {
    /// One size.
    Discrete(ImageSize),
    /// Every size from the first to the second, in steps.
    Range {
        /// The smallest.
        from: ImageSize,
        /// The largest.
        to: ImageSize,
        /// Steps of width and height.
        step: (u32, u32),
    },
}

/// One entry of a list of frame intervals: one, or a range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IntervalEntry {
    /// One.
    Discrete(Interval),
    /// From the shortest to the longest.
    Range(Interval, Interval),
}

/// Value type of a control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlKind {
    /// An integer.
    Integer,
    /// 0 or 1.
    Boolean,
    /// Index of a menu item.
    Menu,
    /// Bits.
    Bitmask,
    /// An action triggered by writing to it.
    Button,
    /// Headings, strings, and controls without a single number.
    Other,
}

/// One control (`VIDIOC_QUERYCTRL`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ControlEntry {
    /// `V4L2_CID_*`.
    pub id: u32,
    /// Name given by the driver.
    pub name: String,
    /// Value type.
    pub kind: ControlKind,
    /// Smallest value.
    pub min: i32,
    /// Largest value.
    pub max: i32,
    /// Step: values are `min` plus a multiple of it.
    pub step: i32,
    /// Value after power-on.
    pub default: i32,
    /// The value is read-only, or currently determined by another control.
    pub is_locked: bool,
}

/// A filled buffer (`VIDIOC_DQBUF`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filled {
    /// Buffer index.
    pub index: u32,
    /// Bytes used by the image.
    pub bytes: usize,
    /// Sequence number of the image; not reliable on all drivers.
    pub sequence: u32,
    /// Timestamp, nanoseconds; see `source`.
    pub stamp_nanos: i64,
    /// Meaning of the timestamp.
    pub source: StampSource,
    /// The driver marked the content as damaged (`V4L2_BUF_FLAG_ERROR`).
    pub is_damaged: bool,
    /// No image follows (`V4L2_BUF_FLAG_LAST`).
    pub is_last: bool,
}

/// The result of waiting for a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Readiness {
    /// There is a filled buffer.
    pub has_buffer: bool,
    /// The device is disconnected, no longer streams, or has no queued buffer.
    pub has_failed: bool,
}

/// File descriptor of an open device, for `wait`.
pub type Handle = i32;

/// The system: device list, waiting, time.
#[cfg_attr(test, mockall::automock)]
pub trait VideoSystem: Send + Sync {
    /// All video devices, of any type, sorted by path.
    ///
    /// # Errors
    /// The system cannot list them.
    fn entries(&self) -> io::Result<Vec<NodeEntry>>;

    /// Opens a device; calls on it never block.
    ///
    /// # Errors
    /// As `open(2)`.
    fn open(&self, path: &Path) -> io::Result<Box<dyn VideoNode>>;

    /// The file that a path refers to, following all links; `None` if it does not exist.
    fn resolve(&self, path: &Path) -> Option<PathBuf>;

    /// `CLOCK_MONOTONIC` in nanoseconds: the clock of driver timestamps.
    fn monotonic_nanos(&self) -> i64;

    /// Waits until one of two devices is ready, or for `timeout`.
    ///
    /// # Errors
    /// As `poll(2)`, except for an interruption, which returns without a ready device.
    fn wait(&self, handles: [Handle; 2], timeout: Duration) -> io::Result<[Readiness; 2]>;
}

/// An open device. Each call is the corresponding ioctl; errors have its `errno`.
#[cfg_attr(test, mockall::automock)]
#[allow(clippy::missing_errors_doc, reason = "the errors of all calls are described once, above")]
pub trait VideoNode: Send {
    /// Handle for [`VideoSystem::wait`].
    fn handle(&self) -> Handle;
    /// Capabilities of the device.
    fn capability(&self) -> io::Result<Capability>;
    /// Selects an input (`VIDIOC_S_INPUT`).
    fn set_input(&mut self, input: u32) -> io::Result<()>;
    /// Selects a television standard (`VIDIOC_S_STD`).
    fn set_standard(&mut self, standard: u64) -> io::Result<()>;
    /// The format at this index; `None` after the end of the list.
    fn format_at(&self, index: u32) -> io::Result<Option<[u8; 4]>>;
    /// The size at this index; `None` after the end of the list.
    fn size_at(&self, fourcc: [u8; 4], index: u32) -> io::Result<Option<SizeEntry>>;
    /// The frame interval at this index; `None` after the end of the list.
    fn interval_at(&self, fourcc: [u8; 4], size: ImageSize, index: u32) -> io::Result<Option<IntervalEntry>>;
    /// Requests a format; returns the format set by the driver.
    fn set_format(&mut self, format: &RawFormat) -> io::Result<RawFormat>;
    /// The current format.
    fn format(&self) -> io::Result<RawFormat>;
    /// Requests a frame interval; returns the interval set by the driver.
    fn set_interval(&mut self, interval: Interval) -> io::Result<Interval>;
    /// The current frame interval.
    fn interval(&self) -> io::Result<Interval>;
    /// The control with the smallest ID above `id`; `None` after the last one.
    fn control_after(&self, id: u32) -> io::Result<Option<ControlEntry>>;
    /// The text of a menu item; `None` if there is no such item.
    fn menu_line(&self, id: u32, line: u32) -> io::Result<Option<String>>;
    /// Value of a control.
    fn control(&self, id: u32) -> io::Result<i32>;
    /// Sets a control.
    fn set_control(&mut self, id: u32, value: i32) -> io::Result<()>;
    /// Requests buffers, returns their number; 0 releases them.
    fn request_buffers(&mut self, count: u32) -> io::Result<u32>;
    /// Maps a buffer into memory, returns its length.
    fn map(&mut self, index: u32) -> io::Result<usize>;
    /// The memory of a mapped buffer; empty while the driver owns it.
    fn memory(&self, index: u32) -> &[u8];
    /// Queues a buffer to be filled by the driver.
    fn queue(&mut self, index: u32) -> io::Result<()>;
    /// Takes a filled buffer; `None` if there is none.
    fn dequeue(&mut self) -> io::Result<Option<Filled>>;
    /// Starts the stream.
    fn start(&mut self) -> io::Result<()>;
    /// Stops the stream and takes all buffers from the driver.
    fn stop(&mut self) -> io::Result<()>;
}
