//! The reporting thread: results of commands, the state at 20 Hz, log lines, and the end of silent leases.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::ws::Utf8Bytes;
use pb3dp_cell::handover::LatestConsumer;
use pb3dp_cell::moving::StepRecord;

use crate::control_link::{ReportingEnds, TakenCommand};
use crate::hub::Hub;
use crate::state_message::StateBuilder;

/// Time between two looks for results of commands; an operator does not notice it.
const RESULTS_EVERY: Duration = Duration::from_millis(5);
/// Time between two states.
const STATES_EVERY: Duration = Duration::from_millis(50);
/// Time between two renewals of the followed target's kept view: a hand in motion sees another view after it.
const RENEWALS_EVERY: Duration = Duration::from_secs(1);

/// Reports until the panel ends.
pub fn run(hub: &Arc<Hub>, mut ends: ReportingEnds, mut steps: LatestConsumer<StepRecord>) {
    let mut builder = StateBuilder::new(Instant::now(), hub.now());
    let (mut due, mut renewal_due) = (Instant::now(), Instant::now());
    while !hub.is_over() {
        let taken: Vec<TakenCommand> = std::iter::from_fn(|| ends.results.pop().ok()).collect();
        if !taken.is_empty() {
            // The state that follows from a command is there before its answer.
            due = Instant::now();
        }
        while let Ok(trouble) = ends.troubles.pop() {
            builder.trouble = trouble;
        }
        if Instant::now() >= due {
            due += STATES_EVERY;
            // After a pause of this program no states are caught up on.
            due = due.max(Instant::now());
            hub.expire_lease();
            if let Some(shown) = ends.shown.take() {
                builder.shown = Some(shown);
            }
            if let Some(step) = steps.take() {
                builder.step = Some(step);
            }
            send_state(hub, &mut builder);
            hub.pass_on_log_lines(&hub.config.log_lines);
        }
        if Instant::now() >= renewal_due {
            renewal_due = Instant::now() + RENEWALS_EVERY;
            hub.renew_saved();
        }
        for taken in &taken {
            hub.resolve(taken);
        }
        std::thread::sleep(RESULTS_EVERY);
    }
}

fn send_state(hub: &Hub, builder: &mut StateBuilder) {
    let state = builder.build(hub, Instant::now());
    match serde_json::to_string(&state) {
        Ok(text) => {
            hub.states.send_replace(Utf8Bytes::from(text));
        }
        Err(error) => {
            tracing::error!("the state of the panel cannot be written: {error}; this is a bug, please report it")
        }
    }
}
