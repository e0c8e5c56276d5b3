//! Implementation of [`video`](crate::video) on Linux, using the raw layer of the crate `v4l`.
//!
//! The stream type of `v4l` is not used: it queues a buffer twice after a time-out, delivers damaged buffers as good ones, and
//! panics if a stream cannot be stopped.

mod list;
mod node;

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::BorrowedFd;
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::time::{ClockId, clock_gettime};

use crate::video::{Handle, NodeEntry, Readiness, VideoNode, VideoSystem};

/// Video devices of this machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Linux;

impl VideoSystem for Linux {
    fn entries(&self) -> io::Result<Vec<NodeEntry>> {
        list::entries(Path::new(list::CLASS))
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn VideoNode>> {
        let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = rustix::fs::open(path, flags, Mode::empty())?;
        Ok(Box::new(node::Node::new(file)))
    }

    fn resolve(&self, path: &Path) -> Option<PathBuf> {
        std::fs::canonicalize(path).ok()
    }

    fn monotonic_nanos(&self) -> i64 {
        let now = clock_gettime(ClockId::Monotonic);
        now.tv_sec.saturating_mul(1_000_000_000).saturating_add(now.tv_nsec)
    }

    fn wait(&self, handles: [Handle; 2], timeout: Duration) -> io::Result<[Readiness; 2]> {
        // SAFETY: a handle is the file of an open node; the caller that waits holds that node.
        let mut polled =
            handles.map(|handle| PollFd::from_borrowed_fd(unsafe { BorrowedFd::borrow_raw(handle) }, PollFlags::IN));
        let timeout = Timespec { tv_sec: timeout.as_secs() as i64, tv_nsec: i64::from(timeout.subsec_nanos()) };
        match poll(&mut polled, Some(&timeout)) {
            Ok(_) => {}
            Err(Errno::INTR) => return Ok(Default::default()),
            Err(error) => return Err(error.into()),
        }
        let failed = PollFlags::ERR | PollFlags::HUP | PollFlags::NVAL;
        Ok([0, 1].map(|k| {
            let events = polled[k].revents();
            Readiness { has_buffer: events.contains(PollFlags::IN), has_failed: events.intersects(failed) }
        }))
    }
}
