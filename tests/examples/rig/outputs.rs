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

/// Number of buffers: one image is shown while the next one waits; more buffers would add delay.
const BUFFERS: u32 = 2;

/// An open output.
pub struct Stream {
    file: File,
    buffers: Vec<Mapping>,
    /// Buffers that the driver does not hold.
    free: Vec<u32>,
    is_running: bool,
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
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).open(path)?;
        let mut stream = Self { file, buffers: Vec::new(), free: (0..BUFFERS).collect(), is_running: false };
        // SAFETY: plain structures of C, for which all bits zero is a value.
        let empty: sys::v4l2_requestbuffers = unsafe { zeroed() };
        let mut request = sys::v4l2_requestbuffers { count: BUFFERS, type_: OUTPUT, memory: MAPPED, ..empty };
        stream.call(vidioc::VIDIOC_REQBUFS, &mut request)?;
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
            self.call(vidioc::VIDIOC_DQBUF, &mut buffer)?;
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
        filled.field = sys::v4l2_field_V4L2_FIELD_INTERLACED;
        self.call(vidioc::VIDIOC_QBUF, &mut filled)?;
        if self.free.is_empty() && !self.is_running {
            self.call(vidioc::VIDIOC_STREAMON, &mut { OUTPUT })?;
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
        self.call(vidioc::VIDIOC_QUERYBUF, &mut buffer)?;
        let length = buffer.length as usize;
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: for mapped memory the offset is what the driver has filled in; a new mapping wherever the system likes.
        let start = unsafe {
            mmap(std::ptr::null_mut(), length, protection, MapFlags::SHARED, &self.file, u64::from(buffer.m.offset))
        }?;
        Ok(Mapping { start: start.cast(), length })
    }

    fn call<T>(&self, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
        // SAFETY: the file is open, and the argument is the structure that the request takes.
        unsafe { ioctl(self.file.as_raw_fd(), request, std::ptr::from_mut(argument).cast()) }
    }
}
