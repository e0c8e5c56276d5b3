//! What the program itself writes, line by line, with simulated times: its log, and what it reports to the operator.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use system_tests::safety::truth::LogLine;
use tracing::field::{Field, Visit};
use tracing::level_filters::LevelFilter;
use tracing::span::{Attributes, Id, Record};
use tracing::{Event, Level, Metadata, Subscriber};

/// Lines of the log with their times.
#[derive(Clone)]
pub struct ProgramLog {
    clock: Arc<dyn Clock>,
    lines: Arc<Mutex<Vec<(MonotonicTime, String)>>>,
    /// The process that writes it has died.
    is_closed: Arc<AtomicBool>,
}

impl ProgramLog {
    /// An empty log.
    pub fn new(clock: Arc<dyn Clock>) -> Self {
        Self { clock, lines: Arc::default(), is_closed: Arc::default() }
    }

    /// Adds a line that the program prints now.
    pub fn push(&self, line: String) {
        if self.is_closed.load(Ordering::SeqCst) {
            return;
        }
        self.lines.lock().unwrap_or_else(PoisonError::into_inner).push((self.clock.now(), line));
    }

    /// The process that writes the log has died, or a new one writes it.
    pub fn set_closed(&self, is_closed: bool) {
        self.is_closed.store(is_closed, Ordering::SeqCst);
    }

    /// The lines, with times since `begin`; earlier ones have the time 0.
    pub fn take(&self, begin: MonotonicTime) -> Vec<LogLine> {
        let lines = std::mem::take(&mut *self.lines.lock().unwrap_or_else(PoisonError::into_inner));
        let millis = |at: MonotonicTime| at.saturating_since(begin).as_millis() as u64;
        lines.into_iter().map(|(at, text)| LogLine { t_millis: millis(at), text }).collect()
    }
}

/// The message of an event.
#[derive(Default)]
struct Message(String);

impl Visit for Message {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        if field.name() == "message" {
            self.0 = format!("{value:?}");
        }
    }
}

impl Subscriber for ProgramLog {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.is_event() && *metadata.level() <= Level::INFO && metadata.target().starts_with("pb3dp")
    }

    fn max_level_hint(&self) -> Option<LevelFilter> {
        Some(LevelFilter::INFO)
    }

    fn event(&self, event: &Event<'_>) {
        let mut message = Message::default();
        event.record(&mut message);
        self.push(message.0);
    }

    fn new_span(&self, _: &Attributes<'_>) -> Id {
        Id::from_u64(1)
    }

    fn record(&self, _: &Id, _: &Record<'_>) {}

    fn record_follows_from(&self, _: &Id, _: &Id) {}

    fn enter(&self, _: &Id) {}

    fn exit(&self, _: &Id) {}
}
