//! Closes links that are gone.
//!
//! The kernel may take its time for that, and the thread of an arm has none: it still has to tell its owner and the other arms.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use pb3dp_hal_platform::transport::{ByteLink, ConnectError};

/// Links that wait to be closed. There is one more only if somebody resets an arm again and again whose system closes nothing.
const WAITING_MAX: usize = 4;

/// Who opens a link again waits for so long until the old one is closed.
const CLOSED_IN: Duration = Duration::from_millis(1500);

/// Closes links: by a thread that ends with this, or at once.
pub(super) struct Closer {
    thread: Option<Closing>,
    under_way: usize,
}

/// A thread that closes.
struct Closing {
    links: SyncSender<Box<dyn ByteLink>>,
    closed: Receiver<()>,
}

/// The system has not closed the link that is gone.
#[derive(Debug, thiserror::Error)]
#[error("the system is still closing the link that is gone; try again")]
struct StillClosing;

impl Closer {
    /// # Errors
    /// If the system gives no thread.
    pub fn start() -> std::io::Result<Self> {
        let (links, to_close) = sync_channel::<Box<dyn ByteLink>>(WAITING_MAX);
        let (tell, closed) = sync_channel(WAITING_MAX + 1);
        let work = move || {
            for link in to_close {
                drop(link);
                // Nobody waits where nobody opens it again.
                let _ = tell.try_send(());
            }
        };
        std::thread::Builder::new().name("arm closer".to_owned()).spawn(work)?;
        Ok(Self { thread: Some(Closing { links, closed }), under_way: 0 })
    }

    /// For links that no kernel knows.
    pub fn at_once() -> Self {
        Self { thread: None, under_way: 0 }
    }

    /// Has a link closed, without waiting.
    pub fn close(&mut self, link: Box<dyn ByteLink>) {
        let Some(thread) = &self.thread else { return };
        match thread.links.try_send(link) {
            Ok(()) => self.under_way += 1,
            Err(TrySendError::Full(link) | TrySendError::Disconnected(link)) => drop(link),
        }
    }

    /// Waits until all are closed.
    ///
    /// # Errors
    /// If the system takes too long for that.
    pub fn wait(&mut self) -> Result<(), ConnectError> {
        let Some(thread) = &self.thread else { return Ok(()) };
        while self.under_way > 0 {
            thread.closed.recv_timeout(CLOSED_IN).map_err(|_| StillClosing)?;
            self.under_way -= 1;
        }
        Ok(())
    }
}
