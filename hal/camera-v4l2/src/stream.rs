//! The stream of one camera: its buffers, what is taken from them, and what is left out and counted.

use std::time::Duration;

use image::RgbImage;
use pb3dp_camera_settings::{StampModel, nanos};
use pb3dp_hal_api::{CameraError, CameraErrorKind};

use crate::error::{failed, unusable};
use crate::modes::Mode;
use crate::pixels::{Converter, PixelError};
use crate::video::{Filled, Handle, VideoNode};

/// A driver that fills buffers faster than they can be taken must not keep us.
const BUFFERS_AT_ONCE_MAX: u32 = 64;

/// How far a stamp may lie in the future: two clocks are read one after the other, and some drivers (`vivid`) stamp by when an image
/// should have come, which is up to a tick of the kernel (4 ms at 250 Hz) before or after.
const FUTURE_NANOS_MAX: i64 = 4_000_000;

/// Images of one camera since it was opened: what came, and what was left out for which reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StreamCounters {
    /// Whole and new.
    pub good: u64,
    /// Good, but a newer one was there as well.
    pub superseded: u64,
    /// Good, but without a partner on the other side.
    pub unpaired: u64,
    /// The driver knows that they are damaged, or a JPEG cannot be decoded.
    pub damaged: u64,
    /// Fewer bytes than an image has.
    pub short: u64,
    /// Numbers that the driver has left out.
    pub lost: u64,
    /// Numbers that the driver has given twice, or that have gone back.
    pub repeated: u64,
    /// Stamps that are not later than the one before.
    pub not_newer: u64,
    /// Stamps that lie in the future.
    pub future: u64,
    /// Too old when they were taken.
    pub stale: u64,
    /// Stamps of an unknown clock.
    pub unstamped: u64,
}

/// An image that waits for its partner.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Held {
    index: u32,
    bytes: usize,
    /// Middle of the exposure on the clock of stamps.
    pub(crate) mid_nanos: i64,
}

/// What taking images from the driver has come to.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Drained {
    /// Buffers, with images of whatever quality.
    pub(crate) taken: u32,
    /// There was a good image among them, or one that was good when it was made.
    pub(crate) has_life: bool,
}

const STALE: &str = "images are too old when they are taken";

/// What is fixed for a stream.
#[derive(Clone, Debug)]
pub(crate) struct StreamConfig {
    pub(crate) device: String,
    pub(crate) mode: Mode,
    pub(crate) exposure: Duration,
    pub(crate) stamps: StampModel,
    /// Images whose exposure was longer ago are left out.
    pub(crate) age_max: Duration,
}

/// An open device that streams.
pub(crate) struct Stream {
    pub(crate) config: StreamConfig,
    node: Box<dyn VideoNode>,
    converter: Converter,
    held: Option<Held>,
    pub(crate) counters: StreamCounters,
    last_sequence: Option<u32>,
    last_stamp_nanos: Option<i64>,
    /// Why the last image was left out, for messages.
    complaint: Option<&'static str>,
}

impl Stream {
    /// Maps buffers and gives them to the driver; the stream is not started.
    pub(crate) fn new(mut node: Box<dyn VideoNode>, config: StreamConfig, buffers: u32) -> Result<Self, CameraError> {
        let device = &config.device;
        let converter = Converter::new(config.mode.layout).map_err(|error| unusable(device, error))?;
        let given = node.request_buffers(buffers).map_err(|error| failed(device, "asking for buffers", error))?;
        // One is held, one is being filled, one waits to be filled.
        if given < 3 {
            return Err(unusable(device, format!("the driver gives {given} buffers, at least 3 are needed")));
        }
        for index in 0..given {
            let length = node.map(index).map_err(|error| failed(device, "mapping its buffers", error))?;
            let expected = converter.layout().bytes_min();
            if length < expected {
                return Err(unusable(
                    device,
                    format!("buffer {index} has {length} bytes, an image has {expected} or more"),
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

    /// Why images are left out, for messages.
    pub(crate) fn complaint(&self) -> Option<&'static str> {
        self.complaint
    }

    /// Takes all that the driver has filled and keeps the newest good image.
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
                    // Who comes late finds old images; that is no fault of the camera.
                    drained.has_life |= complaint == STALE;
                    self.complaint = Some(complaint);
                    self.queue(filled.index)?;
                }
            }
            if filled.is_last {
                let message = format!("{}: the camera has ended its stream; open it again", self.config.device);
                return Err(CameraError::new(CameraErrorKind::Disconnected, message));
            }
        }
        Ok(drained)
    }

    /// Counts what a driver's numbers tell. They are 32 bits, begin again, and are given twice by some drivers.
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
            return Err("its driver does not stamp by CLOCK_MONOTONIC, so it is not known when images were taken");
        };
        if filled.stamp_nanos.saturating_sub(now_nanos) > FUTURE_NANOS_MAX {
            counters.future += 1;
            return Err("its stamps lie in the future: its driver stamps what is still to come");
        }
        if self.last_stamp_nanos.is_some_and(|last| filled.stamp_nanos <= last) {
            counters.not_newer += 1;
            // A clock that was set back goes on from where it is.
            self.last_stamp_nanos = Some(filled.stamp_nanos);
            return Err("its stamps go back");
        }
        self.last_stamp_nanos = Some(filled.stamp_nanos);
        if now_nanos.saturating_sub(mid_nanos) > nanos(age_max) {
            counters.stale += 1;
            return Err(STALE);
        }
        Ok(Held { index: filled.index, bytes: filled.bytes, mid_nanos })
    }

    /// Converts the image that is held.
    pub(crate) fn convert(&mut self, target: &mut RgbImage) -> Result<(), PixelError> {
        let Some(held) = self.held else { return Ok(()) };
        let memory = self.node.memory(held.index);
        let converted = self.converter.convert(&memory[..held.bytes.min(memory.len())], target);
        if converted.is_err() {
            // It has looked good until now.
            self.counters.good -= 1;
            self.counters.damaged += 1;
        }
        converted
    }

    /// Gives the image that is held back to the driver.
    pub(crate) fn give_back(&mut self) -> Result<(), CameraError> {
        match self.held.take() {
            Some(held) => self.queue(held.index),
            None => Ok(()),
        }
    }

    /// As [`Self::give_back`], for one without a partner.
    pub(crate) fn drop_unpaired(&mut self) -> Result<(), CameraError> {
        self.counters.unpaired += 1;
        self.give_back()
    }

    fn queue(&mut self, index: u32) -> Result<(), CameraError> {
        self.node.queue(index).map_err(|error| failed(&self.config.device, "giving a buffer back", error))
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        // Closing the device does the same; one that is gone refuses.
        let _ = self.node.stop();
    }
}
