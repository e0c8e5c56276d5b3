//! Video outputs by V4L2, with memory shared with the driver: the kernels of Debian 12 (6.1) reject `write` to an output,
//! because they lose the length of the data.

use std::fs::{File, OpenOptions};
use std::io;
use std::mem::zeroed;
use std::os::fd::AsRawFd;
use std::path::Path;

use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use v4l::v4l_sys as sys;
use v4l::v4l2::{ioctl, vidioc};

const OUTPUT: u32 = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_OUTPUT;
const MAPPED: u32 = sys::v4l2_memory_V4L2_MEMORY_MMAP;

/// `VIDIOC_S_DV_TIMINGS` (videodev2.h): number 87, read and written, a structure of 132 bytes.
const SET_TIMINGS: vidioc::_IOC_TYPE = 0xC084_5657;

/// `struct v4l2_dv_timings` of 1280x720 with 25 images per second (`V4L2_DV_BT_CEA_1280X720P25` of v4l2-dv-timings.h): type, width, height,
/// not interlaced, both polarities positive, pixel clock in Hz (64 bits), then porches and synchronisation, horizontal and vertical.
const HDMI_TIMINGS: [u32; 13] = [0, 1280, 720, 0, 3, 74_250_000, 0, 2420, 40, 220, 5, 5, 20];

/// Colours of the painted images: ITU-R BT.601 (`V4L2_COLORSPACE_SMPTE170M`).
const COLOURS: u32 = 1;

/// Order of the lines of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scan {
    Interlaced,
    Progressive,
}

/// Number of buffers: one image is shown while the next one waits; more buffers would add delay.
const BUFFERS: u32 = 2;

/// An open output.
pub struct Stream {
    file: File,
    buffers: Vec<Mapping>,
    /// Buffers that the driver does not hold.
    free: Vec<u32>,
    is_running: bool,
    scan: Scan,
}

/// Memory of a buffer, shared with the driver.
struct Mapping {
    start: *mut u8,
    length: usize,
}

// SAFETY: memory of a mapping belongs to the process, not to a thread; it is reached through its owner only.
unsafe impl Send for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: mapped in `Stream::map` with this start and length, and unmapped here only. Nothing can be done about a failure.
        let _ = unsafe { munmap(self.start.cast(), self.length) };
    }
}

impl Stream {
    /// # Errors
    /// Errors of the driver.
    pub fn open(path: &Path, scan: Scan) -> io::Result<Self> {
        let file = open(path)?;
        let mut stream = Self { file, buffers: Vec::new(), free: (0..BUFFERS).collect(), is_running: false, scan };
        // SAFETY: plain structures of C, for which all bits zero is a value.
        let empty: sys::v4l2_requestbuffers = unsafe { zeroed() };
        let mut request = sys::v4l2_requestbuffers { count: BUFFERS, type_: OUTPUT, memory: MAPPED, ..empty };
        call(&stream.file, vidioc::VIDIOC_REQBUFS, &mut request)?;
        if request.count != BUFFERS {
            return Err(io::Error::other(format!("the driver gave {} buffers, {BUFFERS} are needed", request.count)));
        }
        for index in 0..BUFFERS {
            let buffer = stream.map(index)?;
            stream.buffers.push(buffer);
        }
        Ok(stream)
    }

    /// Waits until an image can be queued: until the image before the last was shown for its period.
    ///
    /// # Errors
    /// Errors of the driver.
    pub fn wait(&mut self) -> io::Result<()> {
        if self.free.is_empty() {
            let mut buffer = Self::buffer(0);
            call(&self.file, vidioc::VIDIOC_DQBUF, &mut buffer)?;
            self.free.push(buffer.index);
        }
        Ok(())
    }

    /// Queues an image, which is shown next; waits first if necessary.
    ///
    /// # Errors
    /// Errors of the driver; an image of another size.
    pub fn give(&mut self, image: &[u8]) -> io::Result<()> {
        self.wait()?;
        let index = self.free.pop().ok_or_else(|| io::Error::other("no buffer is free"))?;
        let mapping = &self.buffers[index as usize];
        if mapping.length < image.len() {
            return Err(io::Error::other(format!(
                "the image has {} bytes, the buffer {}",
                image.len(),
                mapping.length
            )));
        }
        // SAFETY: mapped with at least that length, and the driver's only while it is queued.
        unsafe { std::ptr::copy_nonoverlapping(image.as_ptr(), mapping.start, image.len()) };
        let mut filled = Self::buffer(index);
        filled.bytesused = u32::try_from(image.len()).map_err(io::Error::other)?;
        filled.field = match self.scan {
            Scan::Interlaced => sys::v4l2_field_V4L2_FIELD_INTERLACED,
            Scan::Progressive => sys::v4l2_field_V4L2_FIELD_NONE,
        };
        call(&self.file, vidioc::VIDIOC_QBUF, &mut filled)?;
        if self.free.is_empty() && !self.is_running {
            call(&self.file, vidioc::VIDIOC_STREAMON, &mut { OUTPUT })?;
            self.is_running = true;
        }
        Ok(())
    }

    fn buffer(index: u32) -> sys::v4l2_buffer {
        // SAFETY: as in `open`.
        let empty: sys::v4l2_buffer = unsafe { zeroed() };
        sys::v4l2_buffer { index, type_: OUTPUT, memory: MAPPED, ..empty }
    }

    fn map(&self, index: u32) -> io::Result<Mapping> {
        let mut buffer = Self::buffer(index);
        call(&self.file, vidioc::VIDIOC_QUERYBUF, &mut buffer)?;
        let length = buffer.length as usize;
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: for mapped memory the offset is what the driver has filled in; a new mapping wherever the system likes.
        let start = unsafe {
            mmap(std::ptr::null_mut(), length, protection, MapFlags::SHARED, &self.file, u64::from(buffer.m.offset))
        }?;
        Ok(Mapping { start: start.cast(), length })
    }
}

/// Sets the HDMI mode of an input and of the output that is looped to it, and the colours of the output.
///
/// # Errors
/// Errors of the driver.
pub fn set_hdmi(input: &Path, output: &Path) -> io::Result<()> {
    let mut timings = [0_u32; 33];
    timings[..HDMI_TIMINGS.len()].copy_from_slice(&HDMI_TIMINGS);
    let output = open(output)?;
    for file in [&open(input)?, &output] {
        call(file, SET_TIMINGS, &mut { timings })?;
    }
    // SAFETY: as in `Stream::open`.
    let empty: sys::v4l2_format = unsafe { zeroed() };
    let mut format = sys::v4l2_format { type_: OUTPUT, ..empty };
    call(&output, vidioc::VIDIOC_G_FMT, &mut format)?;
    format.fmt.pix.colorspace = COLOURS;
    call(&output, vidioc::VIDIOC_S_FMT, &mut format)
}

fn open(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).open(path)
}

fn call<T>(file: &File, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
    // SAFETY: the file is open, and the argument is the structure that the request takes.
    unsafe { ioctl(file.as_raw_fd(), request, std::ptr::from_mut(argument).cast()) }
}
