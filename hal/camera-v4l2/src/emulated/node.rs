//! An open emulated device, and the images that its driver makes.

use std::collections::VecDeque;
use std::io;

use pb3dp_camera_settings::{Interval, PixelFormat, nanos};
use pb3dp_geometry::ImageSize;
use rustix::io::Errno;

use super::{Call, Device, EmulatedCamera, EmulatedSystem, Run, State};
use crate::video::{
    Capability, ControlEntry, Filled, Handle, IntervalEntry, RawFormat, Readiness, SizeEntry, VideoNode,
};

/// Driver state of an open node.
#[derive(Debug, Default)]
pub(super) struct NodeState {
    device: usize,
    /// Buffers to be filled.
    queued: VecDeque<u32>,
    /// Filled buffers, with the number of the image since the start, and the factor on its grey levels.
    filled: VecDeque<(Filled, u64, Option<f64>)>,
    streams: bool,
}

/// Lets the drivers make all images that are due.
pub(super) fn advance(state: &mut State, now_nanos: i64) {
    for node in &mut state.nodes {
        let Some(device) = state.devices.get_mut(node.device).filter(|_| node.streams) else { continue };
        if device.camera.faults.is_silent {
            device.skip_silently(now_nanos);
        }
        while device.next_at_nanos().is_some_and(|at| at <= now_nanos) {
            make_image(device, node);
        }
    }
}

fn make_image(device: &mut Device, node: &mut NodeState) {
    let Some(mut run) = device.stream.take() else { return };
    let stamp_nanos = device.stamp_nanos(&run, run.made);
    let image_bytes = device.format.image_bytes as usize;
    let brightness = device.camera.brightness();
    let EmulatedCamera { faults, source, .. } = &mut device.camera;
    let takes = |count: &mut u32| {
        let is_left = *count > 0;
        *count -= u32::from(is_left);
        is_left
    };
    let number = run.made;
    run.made += 1;
    if !takes(&mut faults.repeated) {
        run.sequence = run.sequence.wrapping_add(1);
    }
    let is_lost = takes(&mut faults.lost);
    let index = if is_lost { None } else { node.queued.pop_front() };
    if let Some(index) = index {
        let filled = Filled {
            index,
            bytes: image_bytes - usize::from(takes(&mut faults.short)),
            sequence: run.sequence,
            stamp_nanos: stamp_nanos + faults.stamps_late_nanos,
            source: *source,
            is_damaged: takes(&mut faults.damaged),
            is_last: faults.ends,
        };
        node.filled.push_back((filled, number, brightness));
    }
    device.stream = Some(run);
}

pub(super) fn next_at_nanos(state: &State, handle: Handle) -> Option<i64> {
    let node = state.nodes.get(usize::try_from(handle).ok()?)?;
    state.devices.get(node.device)?.next_at_nanos()
}

pub(super) fn readiness(state: &State, handle: Handle) -> Readiness {
    let node = usize::try_from(handle).ok().and_then(|handle| state.nodes.get(handle));
    let Some(node) = node else { return Readiness { has_buffer: false, has_failed: true } };
    let faults = &state.devices[node.device].camera.faults;
    let has_failed = faults.is_unplugged || faults.has_stopped || !node.streams;
    Readiness { has_buffer: !node.filled.is_empty() && !has_failed, has_failed }
}

/// An open device.
pub(super) struct EmulatedNode {
    system: EmulatedSystem,
    device: usize,
    handle: Handle,
    /// Memory of the buffers, and whether the driver owns them.
    buffers: Vec<(Vec<u8>, bool)>,
}

impl EmulatedNode {
    pub(super) fn new(system: EmulatedSystem, device: usize, handle: Handle) -> Self {
        system.lock().nodes[handle as usize].device = device;
        Self { system, device, handle, buffers: Vec::new() }
    }

    /// Runs a function on the driver state, unless the camera is disconnected or the call must fail.
    fn call<T>(
        &self,
        call: Option<Call>,
        work: impl FnOnce(&mut Device, &mut NodeState) -> io::Result<T>,
    ) -> io::Result<T> {
        let mut state = self.system.lock();
        let now_nanos = self.system.now_nanos();
        advance(&mut state, now_nanos);
        let State { devices, nodes, .. } = &mut *state;
        let device = &mut devices[self.device];
        if device.camera.faults.is_unplugged {
            return Err(Errno::NODEV.into());
        }
        if let Some(error) = call.and_then(|call| device.camera.faults.calls.get(&call)) {
            return Err((*error).into());
        }
        work(device, &mut nodes[self.handle as usize])
    }

    fn camera<T>(&self, work: impl FnOnce(&mut EmulatedCamera) -> io::Result<T>) -> io::Result<T> {
        self.call(None, |device, _| work(&mut device.camera))
    }
}

fn sizes_of(camera: &EmulatedCamera, fourcc: [u8; 4]) -> &[(ImageSize, Vec<Interval>)] {
    camera.formats.iter().find(|(format, _)| *format == fourcc).map_or(&[], |(_, sizes)| sizes)
}

/// Like real drivers: silently returns the nearest available format.
fn nearest_format(camera: &EmulatedCamera, asked: &RawFormat) -> Option<RawFormat> {
    let has = |fourcc: [u8; 4]| camera.formats.iter().any(|(format, _)| *format == fourcc);
    let fourcc =
        Some(asked.fourcc).filter(|fourcc| has(*fourcc)).or(camera.formats.first().map(|(format, _)| *format))?;
    let distance = |size: &ImageSize| size.width.abs_diff(asked.size.0) + size.height.abs_diff(asked.size.1);
    let size = sizes_of(camera, fourcc).iter().map(|(size, _)| *size).min_by_key(distance)?;
    let (width, height) = camera.faults.other_size.unwrap_or((size.width, size.height));
    let format = PixelFormat::of_fourcc(fourcc);
    let row = format.and_then(|format| format.row_bytes(width)).unwrap_or(0) as u32;
    let rows = format.map_or(height as usize, |format| format.memory_rows(height)) as u32;
    // A pitfall of real drivers: a requested stride is kept, although it belongs to another size.
    let stride = asked.stride.max(row + camera.padding);
    Some(RawFormat {
        fourcc,
        size: (width, height),
        field: camera.field,
        stride,
        image_bytes: stride * (rows + camera.padding_rows),
        ..*asked
    })
}

impl VideoNode for EmulatedNode {
    fn handle(&self) -> Handle {
        self.handle
    }

    fn capability(&self) -> io::Result<Capability> {
        self.camera(|camera| Ok(camera.capability.clone()))
    }

    fn set_input(&mut self, input: u32) -> io::Result<()> {
        self.camera(|_| if input == 0 { Ok(()) } else { Err(Errno::INVAL.into()) })
    }

    fn set_standard(&mut self, _: u64) -> io::Result<()> {
        self.camera(|_| Err(Errno::NOTTY.into()))
    }

    fn format_at(&self, index: u32) -> io::Result<Option<[u8; 4]>> {
        self.camera(|camera| Ok(camera.formats.get(index as usize).map(|(fourcc, _)| *fourcc)))
    }

    fn size_at(&self, fourcc: [u8; 4], index: u32) -> io::Result<Option<SizeEntry>> {
        self.camera(|camera| {
            Ok(sizes_of(camera, fourcc).get(index as usize).map(|(size, _)| SizeEntry::Discrete(*size)))
        })
    }

    fn interval_at(&self, fourcc: [u8; 4], size: ImageSize, index: u32) -> io::Result<Option<IntervalEntry>> {
        self.camera(|camera| {
            let intervals = sizes_of(camera, fourcc).iter().find(|(offered, _)| *offered == size);
            let interval = intervals.and_then(|(_, intervals)| intervals.get(index as usize));
            Ok(interval.map(|interval| IntervalEntry::Discrete(*interval)))
        })
    }

    fn set_format(&mut self, format: &RawFormat) -> io::Result<RawFormat> {
        let handle = self.handle;
        self.call(Some(Call::SetFormat), |device, _| {
            if device.owner.is_some_and(|owner| owner != handle) {
                return Err(Errno::BUSY.into());
            }
            device.format = nearest_format(&device.camera, format).ok_or(Errno::INVAL)?;
            Ok(device.format)
        })
    }

    fn format(&self) -> io::Result<RawFormat> {
        self.call(None, |device, _| Ok(device.format))
    }

    fn set_interval(&mut self, interval: Interval) -> io::Result<Interval> {
        self.call(None, |device, _| {
            let size = ImageSize { width: device.format.size.0, height: device.format.size.1 };
            let sizes = sizes_of(&device.camera, device.format.fourcc);
            let offered = sizes.iter().find(|(offered, _)| *offered == size).map(|(_, intervals)| intervals.as_slice());
            let offered = offered.unwrap_or_default();
            let nearest = offered.iter().find(|one| **one == interval).or(offered.first()).copied();
            device.interval = device.camera.faults.other_interval.or(nearest).unwrap_or(interval);
            Ok(device.interval)
        })
    }

    fn interval(&self) -> io::Result<Interval> {
        self.call(None, |device, _| Ok(device.interval))
    }

    fn control_after(&self, id: u32) -> io::Result<Option<ControlEntry>> {
        self.camera(|camera| {
            let entries = camera.controls.iter().map(|(entry, _)| entry);
            Ok(entries.filter(|entry| entry.id > id).min_by_key(|entry| entry.id).cloned())
        })
    }

    fn menu_line(&self, id: u32, line: u32) -> io::Result<Option<String>> {
        Ok(EmulatedCamera::menu_line(id, line))
    }

    fn control(&self, id: u32) -> io::Result<i32> {
        self.camera(|camera| {
            let control = camera.controls.iter().find(|(entry, _)| entry.id == id);
            control.map(|(_, value)| *value).ok_or_else(|| Errno::INVAL.into())
        })
    }

    fn set_control(&mut self, id: u32, value: i32) -> io::Result<()> {
        self.call(Some(Call::SetControl), |Device { camera, .. }, _| {
            let is_kept = !camera.faults.forgetful.contains(&id);
            let (entry, place) = camera.controls.iter_mut().find(|(entry, _)| entry.id == id).ok_or(Errno::INVAL)?;
            if value < entry.min || value > entry.max {
                return Err(Errno::RANGE.into());
            }
            if is_kept {
                *place = value;
            }
            Ok(())
        })
    }

    fn request_buffers(&mut self, count: u32) -> io::Result<u32> {
        let handle = self.handle;
        let bytes = self.call(Some(Call::RequestBuffers), |device, node| {
            if device.owner.is_some_and(|owner| owner != handle) {
                return Err(Errno::BUSY.into());
            }
            device.owner = (count > 0).then_some(handle);
            node.queued.clear();
            node.filled.clear();
            Ok(device.format.image_bytes as usize)
        })?;
        self.buffers = (0..count).map(|_| (vec![0; bytes], false)).collect();
        Ok(count)
    }

    fn map(&mut self, index: u32) -> io::Result<usize> {
        self.camera(|_| Ok(()))?;
        self.buffers.get(index as usize).map(|(memory, _)| memory.len()).ok_or_else(|| Errno::INVAL.into())
    }

    fn memory(&self, index: u32) -> &[u8] {
        match self.buffers.get(index as usize) {
            Some((memory, false)) => memory,
            _ => &[],
        }
    }

    fn queue(&mut self, index: u32) -> io::Result<()> {
        // A buffer cannot be queued twice.
        let is_ours = self.buffers.get(index as usize).is_some_and(|(_, is_drivers)| !is_drivers);
        self.call(Some(Call::Queue), |_, node| {
            if !is_ours {
                return Err(Errno::INVAL.into());
            }
            node.queued.push_back(index);
            Ok(())
        })?;
        self.buffers[index as usize].1 = true;
        Ok(())
    }

    fn dequeue(&mut self) -> io::Result<Option<Filled>> {
        let taken = self.call(Some(Call::Dequeue), |device, node| {
            if !node.streams {
                return Err(Errno::INVAL.into());
            }
            let taken = if device.camera.faults.has_stopped { None } else { node.filled.pop_front() };
            let luma_step = if &device.format.fourcc == b"YUYV" { 2 } else { 1 };
            Ok(taken.map(|taken| (taken, device.camera.paint, luma_step)))
        })?;
        let Some(((filled, number, brightness), paint, luma_step)) = taken else { return Ok(None) };
        let (memory, is_drivers) = &mut self.buffers[filled.index as usize];
        *is_drivers = false;
        paint(number, memory);
        if let Some(factor) = brightness {
            memory.iter_mut().step_by(luma_step).for_each(|grey| *grey = (f64::from(*grey) * factor) as u8);
        }
        Ok(Some(filled))
    }

    fn start(&mut self) -> io::Result<()> {
        let now_nanos = self.system.now_nanos();
        self.call(Some(Call::Start), |device, node| {
            node.streams = true;
            let first_nanos = now_nanos + nanos(device.camera.phase);
            let sequence = device.camera.first_sequence.wrapping_sub(1);
            device.stream = Some(Run { first_nanos, made: 0, sequence });
            Ok(())
        })
    }

    fn stop(&mut self) -> io::Result<()> {
        self.call(None, |device, node| {
            node.streams = false;
            device.stream = None;
            node.queued.clear();
            node.filled.clear();
            Ok(())
        })?;
        for (_, is_drivers) in &mut self.buffers {
            *is_drivers = false;
        }
        Ok(())
    }
}

impl Drop for EmulatedNode {
    fn drop(&mut self) {
        let mut state = self.system.lock();
        let State { devices, nodes, .. } = &mut *state;
        nodes[self.handle as usize] = NodeState { device: self.device, ..NodeState::default() };
        let device = &mut devices[self.device];
        if device.owner == Some(self.handle) {
            device.owner = None;
            device.stream = None;
        }
    }
}
