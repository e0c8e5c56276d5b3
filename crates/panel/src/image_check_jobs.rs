//! Requests for checks of the images, and their answers.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_cell::handover::Newest;
use tokio::sync::watch;

use crate::messages::cameras::CameraCheck;

/// Requests for a check, and its newest result.
pub struct ImageCheckJobs {
    asked: Newest<()>,
    newest: watch::Sender<Option<Arc<CameraCheck>>>,
}

impl Default for ImageCheckJobs {
    fn default() -> Self {
        Self { asked: Newest::default(), newest: watch::Sender::new(None) }
    }
}

impl ImageCheckJobs {
    /// Asks for a check, which all who ask share.
    pub fn ask(&self) -> watch::Receiver<Option<Arc<CameraCheck>>> {
        let mut newest = self.newest.subscribe();
        newest.mark_unchanged();
        self.asked.give(());
        newest
    }

    /// Waits until somebody asks; returns whether anybody has.
    pub fn wait(&self, timeout: Duration) -> bool {
        self.asked.wait(timeout).is_some()
    }

    /// Answers all who have asked, without a new check with the previous one.
    pub fn answer(&self, check: Option<CameraCheck>) {
        self.newest.send_modify(|newest| *newest = check.map(Arc::new).or_else(|| newest.take()));
    }
}
