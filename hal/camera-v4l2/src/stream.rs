//! The stream of one camera: buffer handling, validation of images, and counters of dropped images.

use std::time::Duration;

use image::RgbImage;
use pb3dp_camera_settings::{StampModel, ValueRange, nanos};
use pb3dp_hal_api::{CameraError, CameraErrorKind, DeliveredImage};

use crate::error::{failed, unusable};
use crate::modes::Mode;
use crate::video::{Filled, Handle, VideoNode};
use pb3dp_camera_pixels::{PixelError, View, ViewsConverter};

/// Maximum number of buffers taken at once; protects against a driver that fills buffers faster than they are taken.
const BUFFERS_AT_ONCE_MAX: u32 = 64;

/// Tolerance for timestamps in the future: two clocks are read one after the other, and some drivers (`vivid`) stamp the nominal
/// time of an image, up to a kernel tick (4 ms at 250 Hz) before or after.
const FUTURE_NANOS_MAX: i64 = 4_000_000;

/// Left or right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The left camera.
    Left,
    /// The right camera.
    Right,
}

/// Image counters of one camera since it was opened, by result.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamCounters {
    /// Complete and new.
    pub good: u64,
    /// Good, but a newer image was available as well.
    pub superseded: u64,
    /// Good, but without a matching image of the other side.
    pub unpaired: u64,
    /// Marked as damaged by the driver, or a JPEG that cannot be decoded.
    pub damaged: u64,
    /// Fewer bytes than an image needs.
    pub short: u64,
    /// Sequence numbers skipped by the driver.
    pub lost: u64,
    /// Sequence numbers that the driver repeated, or that went back.
    pub repeated: u64,
    /// Timestamps that are not later than the previous one.
    pub not_newer: u64,
    /// Timestamps in the future.
    pub future: u64,
    /// Too old when taken from the driver.
    pub stale: u64,
    /// Timestamps of an unknown clock.
    pub unstamped: u64,
}

/// An image waiting for its partner.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Held {
    index: u32,
    bytes: usize,
    /// Middle of the exposure on the timestamp clock.
    pub(crate) mid_nanos: i64,
}

/// The result of taking images from the driver.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Drained {
    /// Number of buffers, with images of any quality.
    pub(crate) taken: u32,
    /// There was a good image among them, or one that was good when it was made.
    pub(crate) has_life: bool,
}

const STALE: &str = "images are too old when they are taken from the driver";

/// Constant parameters of a stream.
#[derive(Clone, Debug)]
pub(crate) struct StreamConfig {
    pub(crate) device: String,
    pub(crate) mode: Mode,
    pub(crate) exposure: Duration,
    pub(crate) stamps: StampModel,
    /// Maximum age of an exposure; older images are dropped.
    pub(crate) age_max: Duration,
}

/// An open, streaming device.
pub(crate) struct Stream {
    pub(crate) config: StreamConfig,
    node: Box<dyn VideoNode>,
    converter: ViewsConverter,
    held: Option<Held>,
    pub(crate) counters: StreamCounters,
    last_sequence: Option<u32>,
    last_stamp_nanos: Option<i64>,
    /// Why the last image was dropped, for messages.
    complaint: Option<&'static str>,
}

impl Stream {
    /// Maps buffers and gives them to the driver; the stream is not started. `views` are those in its images; `values` become black and
    /// white in formats with more than 8 bits.
    pub(crate) fn new(
        mut node: Box<dyn VideoNode>,
        config: StreamConfig,
        (views, values): (&[View], Option<ValueRange>),
        buffers: u32,
    ) -> Result<Self, CameraError> {
        let device = &config.device;
        let converter = ViewsConverter::new(config.mode.layout, views, values);
        let converter = converter.map_err(|error| unusable(device, error))?;
        let given = node.request_buffers(buffers).map_err(|error| failed(device, "asking for buffers", error))?;
        // One is held, one is being filled, one waits to be filled.
        if given < 3 {
            return Err(unusable(device, format!("the driver provides {given} buffers, at least 3 are needed")));
        }
        for index in 0..given {
            let length = node.map(index).map_err(|error| failed(device, "mapping its buffers", error))?;
            let expected = converter.layout().bytes_min();
            if length < expected {
                return Err(unusable(
                    device,
                    format!("buffer {index} has {length} bytes, an image needs at least {expected}"),
                ));
            }
            node.queue(index).map_err(|error| failed(device, "queueing its buffers", error))?;
        }
        let counters = StreamCounters::default();
        Ok(Self {
            config,
            node,
            converter,
            held: None,
            counters,
            last_sequence: None,
            last_stamp_nanos: None,
            complaint: None,
        })
    }

    pub(crate) fn start(&mut self) -> Result<(), CameraError> {
        self.node.start().map_err(|error| failed(&self.config.device, "starting its stream", error))
    }

    pub(crate) fn handle(&self) -> Handle {
        self.node.handle()
    }

    pub(crate) fn node(&mut self) -> &mut dyn VideoNode {
        self.node.as_mut()
    }

    pub(crate) fn held(&self) -> Option<Held> {
        self.held
    }

    /// Why images are dropped, for messages.
    pub(crate) fn complaint(&self) -> Option<&'static str> {
        self.complaint
    }

    /// Takes all filled buffers from the driver and keeps the newest good image.
    pub(crate) fn drain(&mut self, now_nanos: i64) -> Result<Drained, CameraError> {
        let mut drained = Drained::default();
        while drained.taken < BUFFERS_AT_ONCE_MAX {
            let taken = self.node.dequeue().map_err(|error| failed(&self.config.device, "taking an image", error))?;
            let Some(filled) = taken else { break };
            drained.taken += 1;
            self.count_sequence(filled.sequence);
            match self.judge(&filled, now_nanos) {
                Ok(held) => {
                    drained.has_life = true;
                    self.counters.good += 1;
                    self.complaint = None;
                    self.counters.superseded += u64::from(self.held.is_some());
                    self.give_back()?;
                    self.held = Some(held);
                }
                Err(complaint) => {
                    // A late caller finds old images; this is not a fault of the camera.
                    drained.has_life |= complaint == STALE;
                    self.complaint = Some(complaint);
                    self.queue(filled.index)?;
                }
            }
            if filled.is_last {
                let message = format!("{}: the camera has ended the stream; open the camera again", self.config.device);
                return Err(CameraError::new(CameraErrorKind::Disconnected, message));
            }
        }
        Ok(drained)
    }

    /// Counts gaps and repetitions of sequence numbers. They have 32 bits, wrap around, and are repeated by some drivers.
    fn count_sequence(&mut self, sequence: u32) {
        if let Some(last) = self.last_sequence {
            match sequence.wrapping_sub(last).cast_signed() {
                step @ 1.. => self.counters.lost += u64::from(step.cast_unsigned() - 1),
                _ => self.counters.repeated += 1,
            }
        }
        self.last_sequence = Some(sequence);
    }

    fn judge(&mut self, filled: &Filled, now_nanos: i64) -> Result<Held, &'static str> {
        let StreamConfig { exposure, stamps, age_max, .. } = self.config;
        let counters = &mut self.counters;
        if filled.is_damaged {
            counters.damaged += 1;
            return Err("the driver marks images as damaged");
        }
        if filled.bytes < self.converter.layout().bytes_min() || filled.bytes > self.node.memory(filled.index).len() {
            counters.short += 1;
            return Err("images are not complete");
        }
        let Some(mid_nanos) = stamps.mid_exposure_nanos(filled.stamp_nanos, filled.source, exposure) else {
            counters.unstamped += 1;
            return Err("its driver does not use CLOCK_MONOTONIC timestamps, so the exposure times are unknown");
        };
        if filled.stamp_nanos.saturating_sub(now_nanos) > FUTURE_NANOS_MAX {
            counters.future += 1;
            return Err("its timestamps lie in the future; the driver stamps images in advance");
        }
        if self.last_stamp_nanos.is_some_and(|last| filled.stamp_nanos <= last) {
            counters.not_newer += 1;
            // After the clock was set back, times continue from its new value.
            self.last_stamp_nanos = Some(filled.stamp_nanos);
            return Err("its timestamps go back");
        }
        self.last_stamp_nanos = Some(filled.stamp_nanos);
        if now_nanos.saturating_sub(mid_nanos) > nanos(age_max) {
            counters.stale += 1;
            return Err(STALE);
        }
        Ok(Held { index: filled.index, bytes: filled.bytes, mid_nanos })
    }

    /// Converts each view of the held image, and copies the view as it was delivered.
    pub(crate) fn convert(
        &mut self,
        targets: &mut [&mut RgbImage],
        delivered: &mut [&mut DeliveredImage],
    ) -> Result<(), PixelError> {
        let Some(held) = self.held else { return Ok(()) };
        let memory = self.node.memory(held.index);
        let bytes = &memory[..held.bytes.min(memory.len())];
        let converted = self.converter.convert(bytes, targets);
        delivered.iter_mut().for_each(|delivered| delivered.clear());
        if converted.is_err() {
            // It passed all checks until now.
            self.counters.good -= 1;
            self.counters.damaged += 1;
            return converted;
        }
        for (view, delivered) in delivered.iter_mut().enumerate() {
            delivered.encoding = self.converter.copy_delivered(view, bytes, &mut delivered.bytes);
        }
        Ok(())
    }

    /// Returns the held image to the driver.
    pub(crate) fn give_back(&mut self) -> Result<(), CameraError> {
        match self.held.take() {
            Some(held) => self.queue(held.index),
            None => Ok(()),
        }
    }

    /// As [`Self::give_back`], for an image without a partner.
    pub(crate) fn drop_unpaired(&mut self) -> Result<(), CameraError> {
        self.counters.unpaired += 1;
        self.give_back()
    }

    fn queue(&mut self, index: u32) -> Result<(), CameraError> {
        self.node.queue(index).map_err(|error| failed(&self.config.device, "returning a buffer", error))
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        // Closing the device has the same effect; a disconnected device returns an error.
        let _ = self.node.stop();
    }
}

/// The open devices: one per view, or one with both views.
pub(crate) enum Streams {
    /// Left and right.
    Two(Box<[Stream; 2]>),
    /// Both views.
    One(Box<Stream>),
}

impl Streams {
    /// Every device once.
    pub(crate) fn all(&self) -> &[Stream] {
        match self {
            Self::Two(streams) => &**streams,
            Self::One(stream) => std::slice::from_ref(stream),
        }
    }

    /// As [`Self::all`].
    pub(crate) fn all_mut(&mut self) -> &mut [Stream] {
        match self {
            Self::Two(streams) => &mut **streams,
            Self::One(stream) => std::slice::from_mut(stream),
        }
    }

    /// The device of a view.
    pub(crate) fn of(&self, side: Side) -> &Stream {
        match self {
            Self::Two(streams) => &streams[side as usize],
            Self::One(stream) => stream,
        }
    }

    /// As [`Self::of`].
    pub(crate) fn of_mut(&mut self, side: Side) -> &mut Stream {
        match self {
            Self::Two(streams) => &mut streams[side as usize],
            Self::One(stream) => stream,
        }
    }
}
