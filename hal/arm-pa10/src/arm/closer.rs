//! Closes lost links.
//!
//! The kernel may take time to close a link, and the thread of an arm has none: it still has to report to its owner and to the
//! other arms.

use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use pb3dp_hal_platform::transport::{ByteLink, ConnectError};

/// Capacity for links that wait to be closed. More arise only if somebody resets an arm repeatedly on a system that closes nothing.
const WAITING_MAX: usize = 4;

/// Longest wait for the old link before it is opened again.
const CLOSED_IN: Duration = Duration::from_millis(1500);

/// Closes links: in a thread that ends with this, or at once.
pub(super) struct Closer {
    thread: Option<Closing>,
    under_way: usize,
}

/// The closing thread.
struct Closing {
    links: SyncSender<Box<dyn ByteLink>>,
    closed: Receiver<()>,
}

/// The system has not closed the lost link.
#[derive(Debug, thiserror::Error)]
#[error("the operating system is still closing the lost link; try again")]
struct StillClosing;

impl Closer {
    /// # Errors
    /// If the system provides no thread.
    pub fn start() -> std::io::Result<Self> {
        let (links, to_close) = sync_channel::<Box<dyn ByteLink>>(WAITING_MAX);
        let (tell, closed) = sync_channel(WAITING_MAX + 1);
        let work = move || {
            for link in to_close {
                drop(link);
                // Without a new link nobody waits.
                let _ = tell.try_send(());
            }
        };
        std::thread::Builder::new().name("arm closer".to_owned()).spawn(work)?;
        Ok(Self { thread: Some(Closing { links, closed }), under_way: 0 })
    }

    /// For links that the kernel does not know.
    pub fn at_once() -> Self {
        Self { thread: None, under_way: 0 }
    }

    /// Closes a link without blocking.
    pub fn close(&mut self, link: Box<dyn ByteLink>) {
        let Some(thread) = &self.thread else { return };
        match thread.links.try_send(link) {
            Ok(()) => self.under_way += 1,
            Err(TrySendError::Full(link) | TrySendError::Disconnected(link)) => drop(link),
        }
    }

    /// Waits until all links are closed.
    ///
    /// # Errors
    /// If the system takes too long.
    pub fn wait(&mut self) -> Result<(), ConnectError> {
        let Some(thread) = &self.thread else { return Ok(()) };
        while self.under_way > 0 {
            thread.closed.recv_timeout(CLOSED_IN).map_err(|_| StillClosing)?;
            self.under_way -= 1;
        }
        Ok(())
    }
}
