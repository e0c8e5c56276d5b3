//! State shared by the threads of the panel. None of its locks is ever taken by a control thread.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::extract::ws::Utf8Bytes;
use pb3dp_cell::selection::{Selection, Selections};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use tokio::sync::{broadcast, watch};

use crate::config::PanelConfig;
use crate::control_changes::Changes;
use crate::control_link::ControlLink;
use crate::encoded_pair::EncodedPair;
use crate::facts::About;
use crate::image_check_jobs::ImageCheckJobs;
use crate::lease::Lease;
use crate::log_lines::LogLines;
use crate::messages::info::PanelFacts;
use crate::messages::socket::LogLine;
use crate::messages::state::JogState;
use crate::operator::SILENT_AFTER;
use crate::pending::PendingCommands;
use crate::preview_job::PreviewJobs;
use crate::refusal::Refusal;
use crate::spectator::Watched;
use crate::staleness::{Present, ShownState};
use crate::viewers::Viewers;

/// Targets that can be chosen again by name; each keeps its pair.
pub const SAVED_MAX: usize = 8;
/// Lines of the log that a new client gets.
const LOG_KEPT: usize = 100;
/// Batches of log lines that a slow client may be behind.
const LOG_BATCHES: usize = 64;

/// Everything that the threads of the panel share.
pub struct Hub {
    /// The run's clock.
    pub clock: Arc<dyn Clock>,
    /// The setup.
    pub about: About,
    /// The configuration.
    pub config: PanelConfig,
    /// Commands to the control thread.
    pub link: Arc<ControlLink>,
    /// What the spectator saw.
    pub watched: Arc<Watched>,
    /// Selections for the estimation.
    pub selections: Selections,
    /// Commands without a result.
    pub pending: PendingCommands,
    /// Who wants which images.
    pub viewers: Viewers,
    /// Whether the button of hold-to-run was pressed at the last heartbeat.
    pub is_pressed: AtomicBool,
    /// Requests for previews.
    pub previews: PreviewJobs,
    /// Requests for checks of the images.
    pub image_checks: ImageCheckJobs,
    /// Changes of camera controls that are not finished.
    pub changes: Changes,
    /// The newest state, as text.
    pub states: watch::Sender<Utf8Bytes>,
    /// The newest images.
    pub images: watch::Sender<Option<Arc<EncodedPair>>>,
    /// Lines of the log.
    pub log_feed: broadcast::Sender<Arc<Vec<LogLine>>>,
    lease: Mutex<Lease>,
    commander: Mutex<Option<u64>>,
    targets: Mutex<Targets>,
    jog: Mutex<JogState>,
    log: Mutex<VecDeque<LogLine>>,
    connections: AtomicU64,
    is_over: AtomicBool,
}

/// Targets that were chosen.
#[derive(Default)]
pub struct Targets {
    /// Oldest first.
    pub saved: VecDeque<(String, Selection)>,
    /// Name of the present target.
    pub name: Option<String>,
    /// A selection that the estimation has not taken yet: number of marked targets before it, and its time.
    pub awaited: Option<(u64, MonotonicTime)>,
}

impl Hub {
    pub(crate) fn new(
        (config, about): (PanelConfig, About),
        clock: Arc<dyn Clock>,
        link: Arc<ControlLink>,
        watched: Arc<Watched>,
    ) -> Self {
        Self {
            clock,
            about,
            config,
            link,
            watched,
            selections: Selections::default(),
            pending: PendingCommands::default(),
            viewers: Viewers::default(),
            is_pressed: AtomicBool::new(false),
            previews: PreviewJobs::default(),
            image_checks: ImageCheckJobs::default(),
            changes: Changes::default(),
            states: watch::Sender::new(Utf8Bytes::from_static("{}")),
            images: watch::Sender::new(None),
            log_feed: broadcast::Sender::new(LOG_BATCHES),
            lease: Mutex::default(),
            commander: Mutex::default(),
            targets: Mutex::default(),
            jog: Mutex::default(),
            log: Mutex::default(),
            connections: AtomicU64::new(0),
            is_over: AtomicBool::new(false),
        }
    }

    /// Present time of the run.
    pub fn now(&self) -> MonotonicTime {
        self.clock.now()
    }

    /// Present state number, target and time.
    pub fn present(&self) -> Present {
        Present {
            state: self.link.number.load(Ordering::SeqCst),
            target: self.watched.target(),
            now: self.now(),
            acted_on_ms: self.lease().acted_on_ms(),
        }
    }

    /// Checks what the holder saw when giving a command, and notes it: a later command must not be overtaken by an earlier one.
    ///
    /// # Errors
    /// As [`ShownState::check`].
    pub fn check_shown(&self, command: &'static str, shown: &ShownState) -> Result<(), Refusal> {
        shown.check(command, &self.present())?;
        self.note_shown(shown);
        Ok(())
    }

    /// Notes what the holder saw when giving a command that is safe on every state.
    pub fn note_shown(&self, shown: &ShownState) {
        if (0.0..=self.now().as_secs_f64() * 1e3).contains(&shown.time_ms) {
            self.lease().note_acted_on(shown.time_ms);
        }
    }

    /// The lease.
    pub fn lease(&self) -> MutexGuard<'_, Lease> {
        self.lease.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of the connection that answers the heartbeats of the holder.
    pub fn commander(&self) -> MutexGuard<'_, Option<u64>> {
        self.commander.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The chosen targets.
    pub fn targets(&self) -> MutexGuard<'_, Targets> {
        self.targets.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The jog.
    pub fn jog(&self) -> MutexGuard<'_, JogState> {
        self.jog.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A new number of a connection.
    pub fn next_connection(&self) -> u64 {
        self.connections.fetch_add(1, Ordering::SeqCst) + 1
    }

    /// The last lines of the log.
    pub fn last_log_lines(&self) -> Vec<LogLine> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned().collect()
    }

    /// Passes new log lines on to all clients.
    pub fn pass_on_log_lines(&self, lines: &LogLines) {
        let lines = lines.take(self.now());
        if lines.is_empty() {
            return;
        }
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        log.extend(lines.iter().cloned());
        let old = log.len().saturating_sub(LOG_KEPT);
        log.drain(..old);
        drop(log);
        // Without clients there is nobody to tell.
        let _ = self.log_feed.send(Arc::new(lines));
    }

    /// Facts of the panel for `/api/info`.
    pub fn facts(&self) -> PanelFacts {
        PanelFacts {
            playground: self.config.push.is_some(),
            hold_to_run: self.config.hold_to_run,
            silent_after_ms: u64::try_from(SILENT_AFTER.as_millis()).unwrap_or(u64::MAX),
        }
    }

    /// Whether the panel ends.
    pub fn is_over(&self) -> bool {
        self.is_over.load(Ordering::SeqCst)
    }

    /// Ends all threads.
    pub fn end(&self) {
        self.is_over.store(true, Ordering::SeqCst);
    }
}
