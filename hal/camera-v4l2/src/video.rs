//! What this crate needs from the operating system: few calls, each one ioctl of V4L2, so that everything above is tested without a
//! device.
//!
//! [`Linux`](crate::linux::Linux) is the real one, [`emulated`](crate::emulated) one that fails on request. All errors are those of
//! the system, with their `errno`.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use pb3dp_camera_settings::{Interval, StampSource};
use pb3dp_geometry::ImageSize;

/// A video device as the system lists it, before it is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeEntry {
    /// `/dev/video0`: changes from boot to boot.
    pub path: PathBuf,
    /// Which of the nodes of one device it is, from 0; `None` if the system does not tell.
    pub index: Option<u32>,
    /// Serial number of the USB device behind it.
    pub serial: Option<String>,
}

/// What a device says of itself (`VIDIOC_QUERYCAP`).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Capability {
    /// Name of the driver: `uvcvideo`.
    pub driver: String,
    /// Name of the device for people.
    pub card: String,
    /// Where it is plugged in: `usb-0000:00:14.0-1.2`.
    pub bus: String,
    /// Whether this very node captures images (and not their metadata, for example).
    pub captures: bool,
    /// Whether it has buffers for memory mapping.
    pub streams: bool,
}

/// Which lines of an image were exposed together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FieldOrder {
    /// All of them.
    #[default]
    Progressive,
    /// Even and odd lines one after the other, woven together in one image.
    Interlaced,
    /// Anything else: half images, one after the other; by its number in V4L2.
    Other(u32),
}

/// A format as it is asked for and answered (`v4l2_pix_format`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RawFormat {
    /// Four letters of the pixel format.
    pub fourcc: [u8; 4],
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Which lines belong together.
    pub field: FieldOrder,
    /// Bytes from row to row; 0 in a question leaves it to the driver.
    pub stride: u32,
    /// Bytes of a buffer.
    pub image_bytes: u32,
    /// `V4L2_COLORSPACE_*`, 0 for the driver's own.
    pub colorspace: u32,
    /// `V4L2_YCBCR_ENC_*`, 0 for what follows from the colour space.
    pub encoding: u32,
    /// `V4L2_QUANTIZATION_*`, 0 for what follows from the colour space.
    pub quantization: u32,
}

/// One entry of a list of sizes: one size, or a range of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SizeEntry {
    /// One size.
    Discrete(ImageSize),
    /// Every size from the first to the second, by steps.
    Range {
        /// The smallest.
        from: ImageSize,
        /// The largest.
        to: ImageSize,
        /// Steps of width and height.
        step: (u32, u32),
    },
}

/// One entry of a list of rates: one, or a range of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IntervalEntry {
    /// One.
    Discrete(Interval),
    /// From the shortest to the longest.
    Range(Interval, Interval),
}

/// What kind of value a control has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlKind {
    /// A whole number.
    Integer,
    /// 0 or 1.
    Boolean,
    /// The number of a line in a menu.
    Menu,
    /// Bits.
    Bitmask,
    /// Something that is done when it is written to.
    Button,
    /// Headings, texts, and what has no single number.
    Other,
}

/// One control (`VIDIOC_QUERYCTRL`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ControlEntry {
    /// `V4L2_CID_*`.
    pub id: u32,
    /// As the driver calls it.
    pub name: String,
    /// What kind of value it has.
    pub kind: ControlKind,
    /// Smallest value.
    pub min: i32,
    /// Largest value.
    pub max: i32,
    /// Values are `min` plus a multiple of it.
    pub step: i32,
    /// Value after power-on.
    pub default: i32,
    /// The value can be read only, or another control decides on it now.
    pub is_locked: bool,
}

/// A buffer that the driver has filled (`VIDIOC_DQBUF`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filled {
    /// Which buffer.
    pub index: u32,
    /// Bytes of the image in it.
    pub bytes: usize,
    /// Counts images, in theory.
    pub sequence: u32,
    /// Nanoseconds; see `source`.
    pub stamp_nanos: i64,
    /// What the stamp means.
    pub source: StampSource,
    /// The driver knows that the content is damaged (`V4L2_BUF_FLAG_ERROR`).
    pub is_damaged: bool,
    /// No image comes after it (`V4L2_BUF_FLAG_LAST`).
    pub is_last: bool,
}

/// What waiting for a device has come to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Readiness {
    /// There is a filled buffer.
    pub has_buffer: bool,
    /// The device is gone, does not stream any more, or has no buffer to fill.
    pub has_failed: bool,
}

/// What `wait` takes: how the system knows an open device.
pub type Handle = i32;

/// The system: which devices there are, waiting, the time.
#[cfg_attr(test, mockall::automock)]
pub trait VideoSystem: Send + Sync {
    /// All video devices, of whatever use, sorted by path.
    ///
    /// # Errors
    /// If the system cannot be asked.
    fn entries(&self) -> io::Result<Vec<NodeEntry>>;

    /// Opens a device; calls on it never wait.
    ///
    /// # Errors
    /// As `open(2)`.
    fn open(&self, path: &Path) -> io::Result<Box<dyn VideoNode>>;

    /// The file that a path leads to, through all links; `None` if nothing is there.
    fn resolve(&self, path: &Path) -> Option<PathBuf>;

    /// `CLOCK_MONOTONIC` in nanoseconds: what drivers stamp by.
    fn monotonic_nanos(&self) -> i64;

    /// Waits until one of two devices has something, or for `timeout`.
    ///
    /// # Errors
    /// As `poll(2)`, but not for an interruption: that is an answer without anything.
    fn wait(&self, handles: [Handle; 2], timeout: Duration) -> io::Result<[Readiness; 2]>;
}

/// An open device. Each call is the ioctl that its name says; errors have its `errno`.
#[cfg_attr(test, mockall::automock)]
#[allow(clippy::missing_errors_doc, reason = "the errors of all are told once, above")]
pub trait VideoNode: Send {
    /// How [`VideoSystem::wait`] knows it.
    fn handle(&self) -> Handle;
    /// What the device says of itself.
    fn capability(&self) -> io::Result<Capability>;
    /// Switches to another connector (`VIDIOC_S_INPUT`).
    fn set_input(&mut self, input: u32) -> io::Result<()>;
    /// Switches to a television standard (`VIDIOC_S_STD`).
    fn set_standard(&mut self, standard: u64) -> io::Result<()>;
    /// The format at that place of the list; `None` behind its end.
    fn format_at(&self, index: u32) -> io::Result<Option<[u8; 4]>>;
    /// The size at that place of the list; `None` behind its end.
    fn size_at(&self, fourcc: [u8; 4], index: u32) -> io::Result<Option<SizeEntry>>;
    /// The interval at that place of the list; `None` behind its end.
    fn interval_at(&self, fourcc: [u8; 4], size: ImageSize, index: u32) -> io::Result<Option<IntervalEntry>>;
    /// Asks for a format; the answer is what the driver has made of it.
    fn set_format(&mut self, format: &RawFormat) -> io::Result<RawFormat>;
    /// The format that holds now.
    fn format(&self) -> io::Result<RawFormat>;
    /// Asks for a time from image to image; the answer is what the driver has made of it.
    fn set_interval(&mut self, interval: Interval) -> io::Result<Interval>;
    /// The time from image to image that holds now.
    fn interval(&self) -> io::Result<Interval>;
    /// The control with the smallest number above `id`; `None` behind the last one.
    fn control_after(&self, id: u32) -> io::Result<Option<ControlEntry>>;
    /// The text of a line of a menu; `None` if there is no such line.
    fn menu_line(&self, id: u32, line: u32) -> io::Result<Option<String>>;
    /// Value of a control.
    fn control(&self, id: u32) -> io::Result<i32>;
    /// Sets a control.
    fn set_control(&mut self, id: u32, value: i32) -> io::Result<()>;
    /// Asks for buffers, returns how many there are; 0 gives them back.
    fn request_buffers(&mut self, count: u32) -> io::Result<u32>;
    /// Maps a buffer into memory, returns its length.
    fn map(&mut self, index: u32) -> io::Result<usize>;
    /// The memory of a mapped buffer; empty while the driver has it.
    fn memory(&self, index: u32) -> &[u8];
    /// Gives a buffer to the driver to be filled.
    fn queue(&mut self, index: u32) -> io::Result<()>;
    /// Takes a filled buffer; `None` if there is none.
    fn dequeue(&mut self) -> io::Result<Option<Filled>>;
    /// Starts the stream.
    fn start(&mut self) -> io::Result<()>;
    /// Stops the stream and takes all buffers from the driver.
    fn stop(&mut self) -> io::Result<()>;
}
