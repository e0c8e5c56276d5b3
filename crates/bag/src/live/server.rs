//! The thread that serves all viewers: it waits for none of them.

use std::io::{ErrorKind, Read};
use std::net::TcpListener;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::Shared;
use super::client::{Client, Offer, Ready};
use super::protocol;
use crate::encoded::Encoded;
use crate::queue::Receiver;

/// Viewers at a time; further ones are disconnected at once.
const CLIENTS_MAX: usize = 16;
/// Messages that are taken in a turn, before the clients have theirs.
const TAKEN_PER_TURN: usize = 1024;
/// Longest wait: limits of time are checked as often.
const WAIT_MAX: Duration = Duration::from_millis(500);
/// Rest after connections cannot be accepted, such as for lack of files.
const REST: Duration = Duration::from_millis(200);
/// Time at the end in which viewers still get what waits for them.
const LAST_MAX: Duration = Duration::from_millis(300);

pub(super) struct Server {
    pub(super) listener: TcpListener,
    pub(super) waking: UnixStream,
    pub(super) queue: Receiver<Arc<Encoded>>,
    pub(super) shared: Arc<Shared>,
    pub(super) offer: Offer,
    pub(super) clients: Vec<Client>,
    /// Until when no connection is accepted.
    pub(super) rests_until: Option<Instant>,
}

impl Server {
    pub(super) fn run(mut self) {
        let mut ends_at: Option<Instant> = None;
        loop {
            self.shared.is_asleep.store(true, Ordering::SeqCst);
            let has_taken = self.take_messages();
            if self.shared.is_over.load(Ordering::SeqCst) {
                let ends_at = *ends_at.get_or_insert_with(|| Instant::now() + LAST_MAX);
                if Instant::now() >= ends_at || (!has_taken && self.clients.iter().all(Client::is_idle)) {
                    break;
                }
            }
            let is_busy = has_taken || self.clients.iter().any(Client::has_more);
            let Some((ready, is_called)) = self.wait(if is_busy { Duration::ZERO } else { WAIT_MAX }) else { break };
            self.shared.is_asleep.store(false, Ordering::SeqCst);
            let now = Instant::now();
            let Self { clients, offer, .. } = &mut self;
            let mut ready = ready.into_iter();
            clients.retain_mut(|client| ready.next().is_some_and(|ready| client.turn(ready, offer, now)));
            if is_called {
                self.accept(now);
            }
            self.shared.viewers.store(self.clients.len(), Ordering::SeqCst);
        }
        self.clients.iter_mut().for_each(Client::close);
        self.shared.viewers.store(0, Ordering::SeqCst);
    }

    /// Hands the messages of the run to the clients; whether there were any.
    fn take_messages(&mut self) -> bool {
        for taken in 0..TAKEN_PER_TURN {
            let Some(message) = self.queue.try_recv() else { return taken > 0 };
            let offer = &mut self.offer;
            offer.description.update(&message);
            let channel = match offer.by_topic.get(message.topic) {
                Some(channel) => *channel,
                None => {
                    let id = u32::try_from(offer.topics.len()).unwrap_or(u32::MAX);
                    offer.channels.push(protocol::channel(id, &message));
                    offer.topics.push(message.topic);
                    offer.by_topic.insert(message.topic, id);
                    let new = &offer.channels[offer.channels.len() - 1..];
                    self.clients.iter_mut().for_each(|client| client.announce(new));
                    id
                }
            };
            self.clients.iter_mut().for_each(|client| client.offer(channel, &message));
        }
        true
    }

    /// Waits for the run, the clients and new ones; `None` if the system refuses that.
    fn wait(&mut self, wait_max: Duration) -> Option<(Vec<Ready>, bool)> {
        let flags = |needs: Ready| {
            let read = if needs.to_read { PollFlags::IN } else { PollFlags::empty() };
            read | if needs.to_write { PollFlags::OUT } else { PollFlags::empty() }
        };
        let is_resting = self.rests_until.is_some_and(|until| Instant::now() < until);
        let accepts = if is_resting { PollFlags::empty() } else { PollFlags::IN };
        let mut polled = vec![PollFd::new(&self.waking, PollFlags::IN), PollFd::new(&self.listener, accepts)];
        for client in &self.clients {
            polled
                .push(PollFd::from_borrowed_fd(client.socket().unwrap_or(self.waking.as_fd()), flags(client.needs())));
        }
        let nanos = wait_max.subsec_nanos().into();
        let wait_max = Timespec { tv_sec: wait_max.as_secs().try_into().unwrap_or(0), tv_nsec: nanos };
        match poll(&mut polled, Some(&wait_max)) {
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            Err(_) => return None,
        }
        // A connection that failed is read, which gives its error.
        let ready = |polled: &PollFd<'_>| Ready {
            to_read: polled.revents().intersects(PollFlags::IN | PollFlags::ERR | PollFlags::HUP),
            to_write: polled.revents().intersects(PollFlags::OUT | PollFlags::ERR | PollFlags::HUP),
        };
        let is_called = polled[1].revents().contains(PollFlags::IN);
        let is_woken = ready(&polled[0]).to_read;
        let ready = polled[2..].iter().map(ready).collect();
        if is_woken {
            let _ = (&self.waking).read(&mut [0; 64]);
        }
        Some((ready, is_called))
    }

    fn accept(&mut self, now: Instant) {
        for _ in 0..CLIENTS_MAX {
            match self.listener.accept() {
                // A connection too many is closed here.
                Ok(_) if self.clients.len() >= CLIENTS_MAX => {}
                Ok((stream, _)) => self.clients.extend(Client::new(stream, now).ok()),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                Err(_) => {
                    self.rests_until = Some(now + REST);
                    return;
                }
            }
        }
    }
}
