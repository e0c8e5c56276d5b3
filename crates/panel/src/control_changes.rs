//! Changes of camera controls that are not finished.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Changes of controls that the cameras have not finished; no motion begins before.
#[derive(Clone, Default)]
pub struct Changes(Arc<AtomicUsize>);

impl Changes {
    /// Begins a change.
    pub fn begin(&self) -> Change {
        self.0.fetch_add(1, Ordering::SeqCst);
        Change(Arc::clone(&self.0))
    }

    /// Whether the cameras are being changed.
    pub fn are_pending(&self) -> bool {
        self.0.load(Ordering::SeqCst) > 0
    }
}

/// A change of a control; ends when it is dropped, also if no camera ever takes it.
pub struct Change(Arc<AtomicUsize>);

impl Drop for Change {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}
