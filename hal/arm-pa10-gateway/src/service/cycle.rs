//! The thread that runs the cycle.

use std::os::fd::AsFd;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::bus::{BusDown, BusPort, FRAME_ROOM};
use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{ArmCommand, AxisCommand, ControlMessage, ControlPacket};
use pb3dp_arm_pa10_protocol::gateway_protocol::{FrameBytes, GatewayState};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::realtime::{now, sleep_until};
use pb3dp_hal_platform::transport::{ByteLink, Symptom, Unplugged};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::Shared;
use super::events::{EventQueue, Happened};
use super::listener::Lines;
use crate::gateway::{Gateway, GatewayStatus};

/// The last part of a cycle is spent in a precise sleep: `poll` returns a little late.
const LAST_PART: Duration = Duration::from_micros(150);

/// Frames of the bus and pieces of the host's bytes that are handled before the cycle is checked again.
const PIECES_MAX: usize = 8;

/// Frames per second of a host: the fastest one sends 500 commands and some heartbeats, and may have been held up for a second.
const FRAMES_PER_SECOND_MAX: u64 = 2000;

/// The core has room for the answers to a piece of this size.
const PIECE_BYTES: usize = 512;

/// Time limit of the final stop order, besides the brake time.
const END_MAX: Duration = Duration::from_millis(500);

/// How often E is sent without the core: its answer is not read.
const END_TRIES: u32 = 3;

/// Sequence numbers of messages without the core: within the modulus of both kinds of controller.
const SEQUENCES: u8 = 128;

/// The line to a host, with the output that is not yet written.
struct HostLine {
    link: Box<dyn ByteLink>,
    pending: FrameBytes,
    written: usize,
    /// Sound frames since the beginning of this second.
    frames: u64,
    second: MonotonicTime,
}

/// The last reported status, to detect changes.
#[derive(Clone, Copy)]
struct Logged {
    state: GatewayState,
    has_host: bool,
    overruns: u64,
    stop_unacknowledged: bool,
}

/// The core with its lines.
pub(super) struct Cycle {
    core: Gateway,
    bus: Option<Box<dyn BusPort>>,
    host: Option<HostLine>,
    shared: Arc<Shared>,
    lines: Lines,
    queue: EventQueue,
    logged: Logged,
    /// Deadline of the final stop order.
    ends: Option<MonotonicTime>,
    brake_time: Duration,
}

impl Cycle {
    pub fn new(core: Gateway, bus: Box<dyn BusPort>, shared: Arc<Shared>, lines: Lines, queue: EventQueue) -> Self {
        let brake_time = core.config().brake_time;
        let logged = Logged { state: core.status().state, has_host: false, overruns: 0, stop_unacknowledged: false };
        Self { core, bus: Some(bus), host: None, shared, lines, queue, logged, ends: None, brake_time }
    }

    /// Runs until the end is requested and the arm is stopped. Returns the final status, or `None` after a panic.
    pub fn run(mut self) -> Option<GatewayStatus> {
        // After a panic the arm must not go on moving: the core, or code without the core, stops it.
        if catch_unwind(AssertUnwindSafe(|| self.serve())).is_ok() {
            return Some(self.core.status());
        }
        let rest = catch_unwind(AssertUnwindSafe(|| self.stop_after_failure()));
        if rest.is_err() || !self.core.is_at_rest() {
            let _ = catch_unwind(AssertUnwindSafe(|| self.stop_past_core()));
        }
        None
    }

    /// The stop order of the core without the host, whose connection is closed.
    fn stop_after_failure(&mut self) {
        self.shared.end.store(true, Ordering::SeqCst);
        self.ends = None;
        self.host = None;
        self.core.handle_host_gone(now());
        self.serve();
    }

    /// The last resort: brakes on for the brake time, then E, whatever the state of the core.
    fn stop_past_core(&mut self) {
        let (cycle, format) = (self.core.config().cycle, self.core.config().format);
        let Some(bus) = &mut self.bus else { return };
        let braked = ControlMessage::Cyclic(ArmCommand::uniform(AxisCommand::Braked, self.core.config().supervision));
        let closed = now() + self.brake_time;
        let mut sequence = 0;
        let mut ends_left = END_TRIES;
        while ends_left > 0 {
            let message = if now() < closed { braked } else { ControlMessage::End };
            ends_left -= u32::from(message == ControlMessage::End);
            if let Ok(packet) = (ControlPacket { sequence, message }).encode(format)
                && let Ok(frame) = arcnet::encode(Route::TO_CONTROLLER, &packet)
            {
                let _ = bus.try_send(&frame);
            }
            sequence = (sequence + 1) % SEQUENCES;
            sleep_until(now() + cycle);
        }
    }

    fn serve(&mut self) {
        while !self.is_over() {
            self.core.set_local(now(), self.shared.is_local.load(Ordering::SeqCst));
            self.receive_from_bus();
            self.receive_from_host();
            self.begin_cycle();
            self.send_to_host();
            self.note_changes();
            self.take_lines();
            self.wait();
        }
    }

    fn is_over(&mut self) -> bool {
        if !self.shared.end.load(Ordering::SeqCst) {
            return false;
        }
        let at = now();
        let ends = *self.ends.get_or_insert_with(|| {
            self.core.stop(at);
            at + self.brake_time + END_MAX
        });
        self.core.is_at_rest() || at >= ends
    }

    fn receive_from_bus(&mut self) {
        let Some(bus) = &mut self.bus else { return };
        let mut buffer = [0; FRAME_ROOM];
        for _ in 0..PIECES_MAX {
            match bus.try_receive(&mut buffer) {
                Ok(Some(length)) => self.core.handle_bus_frame(now(), &buffer[..length]),
                Ok(None) => return,
                Err(down) => return self.lose_bus(down),
            }
        }
    }

    fn receive_from_host(&mut self) {
        let mut buffer = [0; PIECE_BYTES];
        for _ in 0..PIECES_MAX {
            let Some(host) = &mut self.host else { return };
            match host.link.try_read(&mut buffer) {
                Ok(0) => return,
                Ok(length) => {
                    let at = now();
                    let frames = self.core.status().bytes.frames;
                    self.core.handle_host_bytes(at, &buffer[..length]);
                    // Only sound frames are a sign of life: a peer that sends other bytes must not keep others out.
                    let sound = self.core.status().bytes.frames - frames;
                    if sound > 0 {
                        self.shared.last_received_nanos.store(at.as_nanos(), Ordering::SeqCst);
                    }
                    if host.floods(at, sound) {
                        return self.lose_host(Unplugged { symptom: Symptom::Flood });
                    }
                    self.send_to_host();
                }
                Err(gone) => return self.lose_host(gone),
            }
        }
    }

    fn begin_cycle(&mut self) {
        let due = self.core.next_deadline();
        let at = now();
        let Some(frame) = self.core.poll_bus_frame(at) else { return self.note_lateness(at, due) };
        // A frame that cannot be sent counts as one that the controller does not answer.
        if let Some(bus) = &mut self.bus
            && let Err(down) = bus.try_send(&frame)
        {
            self.lose_bus(down);
        }
        self.note_lateness(at, due);
    }

    fn note_lateness(&mut self, at: MonotonicTime, due: MonotonicTime) {
        let overruns = self.core.status().cycle.overruns;
        if overruns != self.logged.overruns {
            self.logged.overruns = overruns;
            self.queue.tell(at, Happened::Overrun { late: at.saturating_since(due) });
        }
    }

    fn send_to_host(&mut self) {
        let Some(host) = &mut self.host else { return };
        if let Err(gone) = host.flush(&mut self.core) {
            self.lose_host(gone);
        }
    }

    fn note_changes(&mut self) {
        let GatewayStatus { state, cause, found, has_host, stop_unacknowledged, .. } = self.core.status();
        let at = now();
        if state != self.logged.state {
            self.queue.tell(at, Happened::State { from: self.logged.state, to: state, cause, found });
        }
        if has_host && !self.logged.has_host {
            self.queue.tell(at, Happened::HostGreeted);
        }
        if stop_unacknowledged != self.logged.stop_unacknowledged {
            self.queue
                .tell(at, if stop_unacknowledged { Happened::StopUnacknowledged } else { Happened::StopAcknowledged });
        }
        (self.logged.state, self.logged.has_host, self.logged.stop_unacknowledged) =
            (state, has_host, stop_unacknowledged);
    }

    /// Takes the lines that the connection thread has opened.
    fn take_lines(&mut self) {
        if let Ok(link) = self.lines.hosts.try_recv() {
            let at = now();
            if let Some(old) = self.host.take() {
                self.core.handle_host_gone(at);
                let _ = self.lines.old_hosts.try_send(old.link);
                self.queue.tell(at, Happened::HostReplaced);
            }
            self.host = Some(HostLine::new(link, at));
            self.shared.has_host.store(true, Ordering::SeqCst);
            self.queue.tell(at, Happened::HostConnected);
        }
        if let Ok(port) = self.lines.buses.try_recv() {
            self.bus = Some(port);
            self.queue.tell(now(), Happened::BusUp);
        }
    }

    fn lose_host(&mut self, gone: Unplugged) {
        let Some(host) = self.host.take() else { return };
        let at = now();
        self.core.handle_host_gone(at);
        let _ = self.lines.old_hosts.try_send(host.link);
        self.shared.has_host.store(false, Ordering::SeqCst);
        self.queue.tell(at, Happened::HostGone(gone.symptom));
    }

    fn lose_bus(&mut self, down: BusDown) {
        let Some(port) = self.bus.take() else { return };
        let _ = self.lines.old_buses.try_send(port);
        self.shared.wants_bus.store(true, Ordering::SeqCst);
        self.queue.tell(now(), Happened::BusDown(down.symptom));
    }

    /// Waits until the next cycle or the next input.
    fn wait(&mut self) {
        let due = self.core.next_deadline();
        let left = due.saturating_since(now());
        if left <= LAST_PART {
            return sleep_until(due);
        }
        // No file descriptor reports what a link has already read.
        let has_unread = self.host.as_ref().is_some_and(|host| host.link.has_unread());
        let timeout = if has_unread { Duration::ZERO } else { left.saturating_sub(LAST_PART) };
        let timeout = Timespec {
            tv_sec: i64::try_from(timeout.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: i64::from(timeout.subsec_nanos()),
        };
        let waker = self.shared.waker.as_fd();
        let waiting = |fd, interest| PollFd::from_borrowed_fd(fd, interest);
        let for_host = match &self.host {
            Some(host) if host.is_full() => PollFlags::IN | PollFlags::OUT,
            _ => PollFlags::IN,
        };
        // A missing line is replaced by the waker.
        let mut fds = [
            waiting(waker, PollFlags::IN),
            waiting(self.bus.as_ref().map_or(waker, |bus| bus.fd()), PollFlags::IN),
            waiting(self.host.as_ref().and_then(|host| host.link.fd()).unwrap_or(waker), for_host),
        ];
        if matches!(poll(&mut fds, Some(&timeout)), Ok(1..)) && !fds[0].revents().is_empty() {
            let mut count = [0; 8];
            let _ = rustix::io::read(&self.shared.waker, &mut count);
        }
    }
}

impl HostLine {
    fn new(link: Box<dyn ByteLink>, now: MonotonicTime) -> Self {
        Self { link, pending: FrameBytes::EMPTY, written: 0, frames: 0, second: now }
    }

    /// Counts sound frames; whether there are more than any host sends.
    fn floods(&mut self, now: MonotonicTime, frames: u64) -> bool {
        if now.saturating_since(self.second) >= Duration::from_secs(1) {
            (self.second, self.frames) = (now, 0);
        }
        self.frames += frames;
        self.frames > FRAMES_PER_SECOND_MAX
    }

    fn is_full(&self) -> bool {
        self.written < self.pending.len()
    }

    /// Writes the pending output that fits.
    fn flush(&mut self, core: &mut Gateway) -> Result<(), Unplugged> {
        loop {
            while self.is_full() {
                match self.link.try_write(&self.pending[self.written..])? {
                    0 => return Ok(()),
                    count => self.written += count,
                }
            }
            let Some(next) = core.poll_host_output(now()) else { return Ok(()) };
            (self.pending, self.written) = (next, 0);
        }
    }
}
