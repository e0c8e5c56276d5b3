//! The connection thread: opens lines for the cycle thread, and closes those that are done.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use crate::bus::BusPort;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::realtime::{now, sleep_until};
use pb3dp_hal_platform::transport::{ByteLink, Connector};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::admission::{Admission, Admitted, Peer};
use super::{BusOpener, HostSide, Shared};

/// Time between two attempts to open a line.
const AGAIN: Duration = Duration::from_millis(500);

/// Polling interval of the connection thread.
const LOOK: Duration = Duration::from_millis(50);

/// A host that has been silent for this long gives way to another one: a connected host sends something every 250 ms.
const GIVES_WAY: Duration = Duration::from_secs(1);

/// The ends of the cycle thread. None of them blocks.
pub(super) struct Lines {
    pub hosts: Receiver<Box<dyn ByteLink>>,
    pub buses: Receiver<Box<dyn BusPort>>,
    pub old_hosts: SyncSender<Box<dyn ByteLink>>,
    pub old_buses: SyncSender<Box<dyn BusPort>>,
}

/// The ends of the connection thread.
pub(super) struct LineEnds {
    hosts: SyncSender<Box<dyn ByteLink>>,
    buses: SyncSender<Box<dyn BusPort>>,
    old_hosts: Receiver<Box<dyn ByteLink>>,
    old_buses: Receiver<Box<dyn BusPort>>,
}

impl Lines {
    pub fn pairs() -> (Self, LineEnds) {
        let (hosts_in, hosts) = sync_channel(1);
        let (buses_in, buses) = sync_channel(1);
        // Room for a replaced line and for its replacement.
        let (old_hosts, hosts_out) = sync_channel(4);
        let (old_buses, buses_out) = sync_channel(4);
        let ends = LineEnds { hosts: hosts_in, buses: buses_in, old_hosts: hosts_out, old_buses: buses_out };
        (Self { hosts, buses, old_hosts, old_buses }, ends)
    }
}

/// The connection thread.
pub(super) struct Listener {
    pub shared: Arc<Shared>,
    pub lines: LineEnds,
    pub tell: SyncSender<String>,
    pub bus: BusOpener,
    pub host: HostSide,
}

/// Time of the next attempt, and the last message.
struct Patience {
    again: MonotonicTime,
    last_message: Option<String>,
}

impl Patience {
    fn new() -> Self {
        Self { again: MonotonicTime::ZERO, last_message: None }
    }

    fn is_over(&self) -> bool {
        now() >= self.again
    }

    /// Records an attempt. Returns the message, unless it equals the last one.
    fn note(&mut self, error: Option<&(dyn std::error::Error + 'static)>, what: &str) -> Option<String> {
        self.again = now() + AGAIN;
        let text = error.map(|error| format!("{what} cannot be opened: {}", chain(error)));
        if self.last_message == text {
            return None;
        }
        self.last_message.clone_from(&text);
        text
    }
}

/// An error with its causes.
fn chain(error: &(dyn std::error::Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text.push_str(": ");
        text.push_str(&cause.to_string());
        source = cause.source();
    }
    text
}

impl Listener {
    pub fn run(mut self) {
        let (mut host, mut bus) = (Patience::new(), Patience::new());
        let mut holder = None;
        while !self.shared.end.load(Ordering::SeqCst) {
            while self.lines.old_hosts.try_recv().is_ok() {}
            while self.lines.old_buses.try_recv().is_ok() {}
            if self.shared.wants_bus.load(Ordering::SeqCst) && bus.is_over() {
                self.open_bus(&mut bus);
            }
            match &mut self.host {
                HostSide::Admission(admission) => {
                    admit(admission, &mut holder, (&self.shared, &self.lines), &self.tell);
                }
                HostSide::Line(connector) => {
                    if !self.shared.has_host.load(Ordering::SeqCst) && host.is_over() {
                        let last_message = open_line(connector.as_mut(), &self.shared, &self.lines, &mut host);
                        last_message.into_iter().for_each(|text| say(&self.tell, text));
                    }
                    sleep_until(now() + LOOK);
                }
            }
        }
    }

    fn open_bus(&mut self, patience: &mut Patience) {
        let last_message = match (self.bus)() {
            Ok(port) => {
                self.shared.wants_bus.store(false, Ordering::SeqCst);
                let _ = self.lines.buses.try_send(port);
                self.shared.wake();
                patience.note(None, "")
            }
            Err(error) => patience.note(Some(error.as_ref()), "the bus"),
        };
        last_message.into_iter().for_each(|text| say(&self.tell, text));
    }
}

/// Sends a message to the owner; it is dropped if the queue is full.
fn say(tell: &SyncSender<String>, text: String) {
    let _ = tell.try_send(text);
}

fn open_line(
    connector: &mut dyn Connector,
    shared: &Shared,
    lines: &LineEnds,
    patience: &mut Patience,
) -> Option<String> {
    let target = connector.target();
    match connector.connect() {
        Ok(link) => {
            let warning = link.warning();
            hand_over(link, shared, lines);
            patience.note(None, "");
            Some(match warning {
                Some(warning) => format!("{target} is open; {warning}"),
                None => format!("{target} is open"),
            })
        }
        Err(error) => patience.note(Some(error.as_ref()), &target),
    }
}

/// Waits briefly for a host, and hands it over unless another one is connected.
fn admit(
    admission: &mut Admission,
    holder: &mut Option<Peer>,
    (shared, lines): (&Shared, &LineEnds),
    tell: &SyncSender<String>,
) {
    wait_for_input(admission);
    let at = now();
    let silent = at.saturating_since(MonotonicTime::from_nanos(shared.last_received_nanos.load(Ordering::SeqCst)));
    let is_held = shared.has_host.load(Ordering::SeqCst) && silent < GIVES_WAY;
    let held_by = holder.filter(|_| is_held);
    if let Some(Admitted { link, peer }) = admission.poll(at, held_by, &mut |text| say(tell, text))
        && hand_over(link, shared, lines)
    {
        say(tell, format!("a host connected from {peer}"));
        *holder = Some(peer);
    }
}

/// Waits until a connection has something to examine, or for a short time.
fn wait_for_input(admission: &Admission) {
    let timeout = Timespec { tv_sec: 0, tv_nsec: i64::from(LOOK.subsec_nanos()) };
    let mut fds: Vec<_> =
        admission.fds(now()).into_iter().map(|fd| PollFd::from_borrowed_fd(fd, PollFlags::IN)).collect();
    // A signal ends the wait early.
    let _ = poll(&mut fds, Some(&timeout));
}

/// Hands a line to the cycle thread, unless that has not taken the one before. `has_host` is set before the line is handed over: the cycle thread may find the line closed at once, and must clear it last.
fn hand_over(link: Box<dyn ByteLink>, shared: &Shared, lines: &LineEnds) -> bool {
    shared.last_received_nanos.store(now().as_nanos(), Ordering::SeqCst);
    let had_host = shared.has_host.swap(true, Ordering::SeqCst);
    let is_taken = lines.hosts.try_send(link).is_ok();
    if is_taken {
        shared.wake();
    } else if !had_host {
        shared.has_host.store(false, Ordering::SeqCst);
    }
    is_taken
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "helpers of tests")]

    use std::sync::atomic::{AtomicBool, AtomicU64};

    use pb3dp_hal_platform::pty::Pty;
    use pb3dp_test_support::sweep;
    use rustix::event::{EventfdFlags, eventfd};

    use super::*;

    /// A line that closes as soon as it is taken does not block the next one.
    #[test]
    fn a_line_that_is_gone_at_once_is_not_taken_for_a_host() {
        let shared = Arc::new(Shared {
            end: AtomicBool::new(false),
            has_host: AtomicBool::new(false),
            is_local: AtomicBool::new(false),
            wants_bus: AtomicBool::new(false),
            last_received_nanos: AtomicU64::new(0),
            waker: eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC).unwrap(),
        });
        let (cycle, listener) = Lines::pairs();
        let (accepted, back) = sync_channel(0);
        let for_cycle = Arc::clone(&shared);
        let consumer = std::thread::spawn(move || {
            loop {
                match cycle.hosts.try_recv() {
                    Ok(link) => {
                        for_cycle.has_host.store(true, Ordering::SeqCst);
                        for_cycle.has_host.store(false, Ordering::SeqCst);
                        if accepted.send(link).is_err() {
                            return;
                        }
                    }
                    Err(std::sync::mpsc::TryRecvError::Empty) => std::thread::yield_now(),
                    Err(std::sync::mpsc::TryRecvError::Disconnected) => return,
                }
            }
        });
        let mut link: Box<dyn ByteLink> = Box::new(Pty::open().unwrap());
        for round in 0..sweep(2_000, 20_000) {
            hand_over(link, &shared, &listener);
            link = back.recv().unwrap();
            assert!(!shared.has_host.load(Ordering::SeqCst), "round {round}");
        }
        drop((listener, back));
        consumer.join().unwrap();
    }
}
