//! The operator panel: a web page and an HTTP interface, to watch a run, choose targets and command the arms.
//!
//! [`Panel::start`] serves the page on threads of its own, and returns the two ends that a run needs: a [`PanelOperator`] for the control
//! thread, which never waits, locks or allocates, and a [`PanelSpectator`] that copies what the page shows. The protocol is described in
//! `docs/reference/panel-api.md`, decisions and threats in `docs/adr/0017-panel.md`.
//!
//! The panel cannot raise limits, waive gates, or speak to a gateway: all it has are the commands of [`pb3dp_cell::operator::Operator`],
//! the selection of targets, a share of the velocity of at most 1, and the controls of the cameras while no arm may move.

mod camera_control;
mod commanding;
pub mod config;
mod control_changes;
mod control_link;
mod drawing;
mod encoded_pair;
pub mod facts;
mod heat;
mod hub;
mod image_check;
mod image_check_jobs;
mod images;
pub mod lease;
mod leasing;
pub mod log_lines;
pub mod messages;
mod moving;
mod operator;
mod pairs;
mod panel;
mod pending;
mod preview;
mod preview_job;
pub mod refusal;
pub mod region;
mod reporting;
pub mod secrets;
mod server;
mod spectator;
pub mod staleness;
mod state_message;
mod target_state;
mod viewers;

pub use config::{Certificate, PanelAddress, PanelConfig, Protection, TlsFiles};
pub use facts::About;
pub use log_lines::LogLines;
pub use operator::{PanelOperator, SILENT_AFTER};
pub use panel::Panel;
pub use refusal::Refusal;
pub use spectator::PanelSpectator;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}
