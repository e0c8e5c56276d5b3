//! What the handlers share.

use std::sync::Arc;

use super::rate::{Rates, RefusalLog};
use crate::hub::Hub;

/// What the handlers share.
#[derive(Clone)]
pub struct App {
    /// The panel.
    pub hub: Arc<Hub>,
    /// Rates of requests.
    pub rates: Arc<Rates>,
    /// Limit of the log lines about refused requests.
    pub refusals: Arc<RefusalLog>,
}
