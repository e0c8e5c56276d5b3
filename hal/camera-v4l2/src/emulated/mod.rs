//! Emulated cameras at the level of system calls: they behave like a driver, and fail on request.
//!
//! [`EmulatedSystem`] is a [`VideoSystem`] with any number of them. Their time is that of an injected clock: on a virtual clock a
//! test of minutes takes milliseconds. [`EmulatedSystem::with`] injects faults while they run.

mod node;

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use pb3dp_camera_settings::{Interval, StampSource, nanos};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::Clock;
use rustix::io::Errno;

use crate::controls::id;
use crate::video::{
    Capability, ControlEntry, ControlKind, FieldOrder, Handle, NodeEntry, RawFormat, Readiness, VideoNode, VideoSystem,
};
use node::EmulatedNode;

/// Timestamp clock at zero of the program clock: the two clocks have different origins.
const STAMP_ORIGIN_NANOS: i64 = 1_234_567_000_000;

/// A call that can be made to fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Call {
    /// Opening the device.
    Open,
    /// Setting a format.
    SetFormat,
    /// Requesting buffers.
    RequestBuffers,
    /// Starting the stream.
    Start,
    /// Giving a buffer to the driver.
    Queue,
    /// Taking a filled buffer.
    Dequeue,
    /// Waiting for any device; the setting of the first device counts.
    Wait,
    /// Setting a control.
    SetControl,
}

/// Faults of one camera.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    /// The cable is disconnected: every call fails with `ENODEV`.
    pub is_unplugged: bool,
    /// No more images come.
    pub is_silent: bool,
    /// The stream ends with a last image.
    pub ends: bool,
    /// The driver has stopped the stream without further information.
    pub has_stopped: bool,
    /// Number of next images that are marked as damaged.
    pub damaged: u32,
    /// Number of next images that are a byte too short.
    pub short: u32,
    /// Number of next images that are lost before they reach a buffer.
    pub lost: u32,
    /// Number of next images with the sequence number of the previous one.
    pub repeated: u32,
    /// Delay of the timestamps, nanoseconds.
    pub stamps_late_nanos: i64,
    /// Calls that fail, with the system error.
    pub calls: BTreeMap<Call, Errno>,
    /// Controls that accept a value and do not keep it.
    pub forgetful: Vec<u32>,
    /// Size returned instead of the requested one.
    pub other_size: Option<(u32, u32)>,
    /// Interval returned instead of the requested one.
    pub other_interval: Option<Interval>,
}

/// A size with its intervals.
pub type EmulatedSize = (ImageSize, Vec<Interval>);

/// One camera: its properties and its behaviour.
#[derive(Clone, Debug)]
pub struct EmulatedCamera {
    /// Entry in the device list.
    pub entry: NodeEntry,
    /// Capability reported by the device.
    pub capability: Capability,
    /// Formats, each with sizes and their intervals.
    pub formats: Vec<([u8; 4], Vec<EmulatedSize>)>,
    /// Padding bytes after each row.
    pub padding: u32,
    /// Rows of padding after the image.
    pub padding_rows: u32,
    /// Field order of an image.
    pub field: FieldOrder,
    /// Controls with their values.
    pub controls: Vec<(ControlEntry, i32)>,
    /// Meaning of the timestamps.
    pub source: StampSource,
    /// Time from the timestamp until the image is available.
    pub arrival: Duration,
    /// Additional delay of the image with this number, counted from the start of the stream; less than a period.
    pub lateness: fn(u64) -> Duration,
    /// Timestamp of the first image, relative to the start of the stream.
    pub phase: Duration,
    /// Drift of its clock: seconds per second that it is slow.
    pub slowness: f64,
    /// Number of the first image.
    pub first_sequence: u32,
    /// Content of the image with this number, counted from the start of the stream.
    pub paint: fn(u64, &mut [u8]),
    /// Factor of the light on the painted grey levels at an exposure of 10 ms and the gain 64; exposure and gain then change the images as
    /// those of a linear camera. `None`: they do not.
    pub light: Option<f64>,
    /// Faults of the camera.
    pub faults: Faults,
}

impl EmulatedCamera {
    /// Factor of light, exposure and gain on the painted grey levels.
    fn brightness(&self) -> Option<f64> {
        let value = |id| self.controls.iter().find(|(entry, _)| entry.id == id).map(|(_, value)| f64::from(*value));
        let [time, gain] = [value(id::EXPOSURE_ABSOLUTE).unwrap_or(100.0), value(id::GAIN).unwrap_or(64.0)];
        self.light.map(|light| light * time / 100.0 * (64.0 + gain) / 128.0)
    }

    /// A camera with `YUYV` 640x480 and 64x48 at 30 per second and `GREY` 64x48, with the controls of a typical USB camera, all
    /// automatic.
    pub fn usual(number: u32) -> Self {
        let sizes = |sizes: &[(u32, u32)]| -> Vec<EmulatedSize> {
            let interval = Interval { numerator: 1, denominator: 30 };
            let slow = Interval { numerator: 1, denominator: 15 };
            sizes
                .iter()
                .map(|(width, height)| (ImageSize { width: *width, height: *height }, vec![interval, slow]))
                .collect()
        };
        let control = |id, name: &str, kind, min, max, value| {
            let entry =
                ControlEntry { id, name: name.to_owned(), kind, min, max, step: 1, default: value, is_locked: false };
            (entry, value)
        };
        Self {
            entry: NodeEntry {
                path: format!("/dev/video{number}").into(),
                index: Some(0),
                serial: Some(format!("SN{number:04}")),
            },
            capability: Capability {
                driver: "emulated".to_owned(),
                card: format!("Emulated camera {number}"),
                bus: format!("usb-emulated-{number}"),
                captures: true,
                streams: true,
            },
            formats: vec![(*b"YUYV", sizes(&[(640, 480), (64, 48)])), (*b"GREY", sizes(&[(64, 48)]))],
            padding: 0,
            padding_rows: 0,
            field: FieldOrder::Progressive,
            controls: vec![
                control(id::AUTO_WHITE_BALANCE, "White Balance, Automatic", ControlKind::Boolean, 0, 1, 1),
                control(id::GAIN, "Gain", ControlKind::Integer, 0, 255, 64),
                control(
                    id::WHITE_BALANCE_TEMPERATURE,
                    "White Balance Temperature",
                    ControlKind::Integer,
                    2800,
                    6500,
                    4600,
                ),
                control(id::EXPOSURE_AUTO, "Auto Exposure", ControlKind::Menu, 0, 3, 3),
                control(id::EXPOSURE_ABSOLUTE, "Exposure Time, Absolute", ControlKind::Integer, 1, 5000, 100),
                control(id::EXPOSURE_AUTO_PRIORITY, "Exposure, Dynamic Framerate", ControlKind::Boolean, 0, 1, 1),
                control(id::FOCUS_ABSOLUTE, "Focus, Absolute", ControlKind::Integer, 0, 250, 0),
                control(id::FOCUS_AUTO, "Focus, Automatic Continuous", ControlKind::Boolean, 0, 1, 1),
            ],
            source: StampSource::StartOfExposure,
            arrival: Duration::from_millis(12),
            lateness: |_| Duration::ZERO,
            phase: Duration::from_millis(40),
            slowness: 0.0,
            first_sequence: 0,
            paint: |number, memory| {
                for pixel in memory.chunks_exact_mut(2) {
                    pixel.copy_from_slice(&[16 + (number % 200) as u8, 128]);
                }
            },
            light: None,
            faults: Faults::default(),
        }
    }

    /// Menu items: the exposure modes of a typical USB camera.
    fn menu_line(id: u32, line: u32) -> Option<String> {
        let text = match (id, line) {
            (id::EXPOSURE_AUTO, 1) => "Manual Mode",
            (id::EXPOSURE_AUTO, 3) => "Aperture Priority Mode",
            _ => return None,
        };
        Some(text.to_owned())
    }
}

/// Driver state of a camera.
#[derive(Clone, Debug)]
struct Device {
    camera: EmulatedCamera,
    format: RawFormat,
    interval: Interval,
    /// The node that owns its buffers.
    owner: Option<Handle>,
    stream: Option<Run>,
}

/// A running stream.
#[derive(Clone, Debug)]
struct Run {
    /// Timestamp of the first image.
    first_nanos: i64,
    /// Number of images made.
    made: u64,
    /// Sequence number of the last image.
    sequence: u32,
}

impl Device {
    fn new(camera: EmulatedCamera) -> Self {
        let interval = Interval { numerator: 1, denominator: 30 };
        Self { camera, format: RawFormat::default(), interval, owner: None, stream: None }
    }

    /// Timestamp of the image with this number since the start.
    fn stamp_nanos(&self, run: &Run, number: u64) -> i64 {
        let period = self.interval.seconds().unwrap_or(1.0) * 1e9 * (1.0 + self.camera.slowness);
        run.first_nanos + (number as f64 * period).round() as i64
    }

    /// When the image with this number is available.
    fn arrival_nanos(&self, run: &Run, number: u64) -> i64 {
        self.stamp_nanos(run, number) + nanos(self.camera.arrival + (self.camera.lateness)(number))
    }

    /// A silent camera skips the images that are due.
    fn skip_silently(&mut self, now_nanos: i64) {
        let Some(mut run) = self.stream.take() else { return };
        while self.arrival_nanos(&run, run.made) <= now_nanos {
            run.made += 1;
        }
        self.stream = Some(run);
    }

    /// When the next image is available.
    fn next_at_nanos(&self) -> Option<i64> {
        let run = self.stream.as_ref().filter(|_| !self.camera.faults.is_silent)?;
        Some(self.arrival_nanos(run, run.made))
    }
}

struct Inner {
    clock: Arc<dyn Clock>,
    devices: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    devices: Vec<Device>,
    nodes: Vec<node::NodeState>,
    /// Additional file names and their targets.
    links: Vec<(PathBuf, PathBuf)>,
}

/// A system with emulated cameras.
#[derive(Clone)]
pub struct EmulatedSystem(Arc<Inner>);

impl EmulatedSystem {
    /// A system with these cameras, using this clock.
    pub fn new(clock: Arc<dyn Clock>, cameras: Vec<EmulatedCamera>) -> Self {
        let devices = cameras.into_iter().map(Device::new).collect();
        Self(Arc::new(Inner { clock, devices: Mutex::new(State { devices, ..State::default() }) }))
    }

    /// Adds another name for a file, like a `udev` link.
    pub fn link(&self, link: impl Into<PathBuf>, file: impl Into<PathBuf>) {
        self.lock().links.push((link.into(), file.into()));
    }

    /// Inspects or modifies a camera; does nothing if it does not exist.
    pub fn with<T>(&self, number: usize, change: impl FnOnce(&mut EmulatedCamera) -> T) -> Option<T> {
        self.lock().devices.get_mut(number).map(|device| change(&mut device.camera))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.devices.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now_nanos(&self) -> i64 {
        STAMP_ORIGIN_NANOS.saturating_add(i64::try_from(self.0.clock.now().as_nanos()).unwrap_or(i64::MAX))
    }
}

impl VideoSystem for EmulatedSystem {
    fn entries(&self) -> io::Result<Vec<NodeEntry>> {
        let state = self.lock();
        let there = state.devices.iter().filter(|device| !device.camera.faults.is_unplugged);
        let mut entries: Vec<NodeEntry> = there.map(|device| device.camera.entry.clone()).collect();
        entries.sort_by(|a, b| a.path.cmp(&b.path));
        Ok(entries)
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn VideoNode>> {
        let mut state = self.lock();
        let is_there = |device: &Device| device.camera.entry.path == path && !device.camera.faults.is_unplugged;
        let device = state.devices.iter().position(is_there).ok_or(Errno::NOENT)?;
        if let Some(error) = state.devices[device].camera.faults.calls.get(&Call::Open) {
            return Err((*error).into());
        }
        state.nodes.push(node::NodeState::default());
        let handle = state.nodes.len() as Handle - 1;
        drop(state);
        Ok(Box::new(EmulatedNode::new(self.clone(), device, handle)))
    }

    fn resolve(&self, path: &Path) -> Option<PathBuf> {
        let state = self.lock();
        if let Some((_, node)) = state.links.iter().find(|(link, _)| link == path) {
            return Some(node.clone());
        }
        let is_there = |device: &Device| device.camera.entry.path == path && !device.camera.faults.is_unplugged;
        let is_there = state.devices.iter().any(is_there);
        is_there.then(|| path.to_owned())
    }

    fn monotonic_nanos(&self) -> i64 {
        self.now_nanos()
    }

    fn wait(&self, handles: [Handle; 2], timeout: Duration) -> io::Result<[Readiness; 2]> {
        let deadline = self.now_nanos().saturating_add(nanos(timeout));
        if let Some(error) = self.lock().devices.first().and_then(|device| device.camera.faults.calls.get(&Call::Wait))
        {
            return Err((*error).into());
        }
        loop {
            let (ready, next) = {
                let mut state = self.lock();
                node::advance(&mut state, self.now_nanos());
                let next = handles.iter().filter_map(|handle| node::next_at_nanos(&state, *handle)).min();
                (handles.map(|handle| node::readiness(&state, handle)), next)
            };
            let now = self.now_nanos();
            if now >= deadline || ready.iter().any(|ready| ready.has_buffer || ready.has_failed) {
                return Ok(ready);
            }
            let until = next.map_or(deadline, |next| next.min(deadline)).max(now);
            self.0.clock.sleep_until(self.0.clock.now() + Duration::from_nanos((until - now).unsigned_abs()));
        }
    }
}
