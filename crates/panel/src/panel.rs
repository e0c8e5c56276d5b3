//! The running panel.

use std::net::SocketAddr;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};

use pb3dp_cell::handover::latest;
use pb3dp_cell::selection::Selections;
use pb3dp_hal_api::Clock;

use crate::config::PanelConfig;
use crate::control_link::ControlLink;
use crate::facts::About;
use crate::hub::Hub;
use crate::operator::PanelOperator;
use crate::refusal::Refusal;
use crate::server::Server;
use crate::spectator::{PanelSpectator, Watched};
use crate::{image_check, images, preview, reporting};

/// Niceness of all threads but the one that answers clients: a thread that wakes up with the usual niceness is preferred.
/// Chosen by hand, not varied.
const BEHIND_CONTROL: i32 = 10;
/// Niceness of previews, for which somebody waits: on a busy computer three to four times the share of the others. Chosen by hand, not varied.
const PREVIEWS: i32 = 4;

/// A running panel; dropping it ends its threads.
pub struct Panel {
    hub: Arc<Hub>,
    /// Dropped before the other threads are joined.
    server: Option<Server>,
    threads: Vec<JoinHandle<()>>,
}

impl Panel {
    /// Starts the panel. `clock` must be the clock of the run: ages of commands and heartbeats are measured with it.
    ///
    /// # Errors
    /// If the address can be reached from other computers without protection, or is in use, or the system provides no thread.
    pub fn start(
        config: PanelConfig,
        clock: Arc<dyn Clock>,
        about: About,
    ) -> Result<(Self, PanelOperator, PanelSpectator), Refusal> {
        let (link, control_ends, reporting_ends) = ControlLink::new();
        let (link, watched) = (Arc::new(link), Arc::new(Watched::default()));
        let (give_steps, steps) = latest();
        let hub = Arc::new(Hub::new((config, about), clock, Arc::clone(&link), Arc::clone(&watched)));
        let mut panel = Self { server: Some(Server::start(&hub)?), hub, threads: Vec::new() };
        panel.spawn("panel-state", BEHIND_CONTROL, move |hub| reporting::run(hub, reporting_ends, steps))?;
        panel.spawn("panel-images", BEHIND_CONTROL, |hub| images::run(hub))?;
        panel.spawn("panel-preview", PREVIEWS, |hub| preview::run(hub))?;
        panel.spawn("panel-check", BEHIND_CONTROL, |hub| image_check::run(hub))?;
        Ok((panel, PanelOperator::new(link, control_ends), PanelSpectator::new(watched, give_steps)))
    }

    fn spawn(
        &mut self,
        name: &str,
        niceness: i32,
        work: impl FnOnce(&Arc<Hub>) + Send + 'static,
    ) -> Result<(), Refusal> {
        let hub = Arc::clone(&self.hub);
        let thread = Builder::new().name(name.to_owned()).spawn(move || {
            // Encoding an image takes milliseconds, which a control thread must not wait for. On Linux this concerns the calling thread
            // alone; where it is refused, the panel works all the same.
            let _ = rustix::process::setpriority_process(None, niceness);
            work(&hub);
        });
        self.threads.push(thread.map_err(|error| Refusal::Thread { cause: error.to_string() })?);
        Ok(())
    }

    /// Targets that the operator selects, for [`pb3dp_cell::parts::Parts::selections`].
    pub fn selections(&self) -> Selections {
        self.hub.selections.clone()
    }

    /// The address of the page, with the port that was taken.
    pub fn address(&self) -> SocketAddr {
        self.server.as_ref().map_or(self.hub.config.address, Server::address)
    }

    /// SHA-256 of the certificate of a protected panel, as browsers show it: the operator compares it.
    pub fn fingerprint(&self) -> Option<String> {
        self.server.as_ref()?.certificate().map(|certificate| certificate.fingerprint.clone())
    }

    /// The certificate of a protected panel as PEM, for clients that are to trust it.
    pub fn certificate_pem(&self) -> Option<String> {
        self.server.as_ref()?.certificate().map(|certificate| certificate.pem.clone())
    }

    /// What a browser opens.
    pub fn url(&self) -> String {
        let scheme = if self.hub.config.protection.is_some() { "https" } else { "http" };
        format!("{scheme}://{}/", self.address())
    }
}

impl Drop for Panel {
    fn drop(&mut self) {
        self.hub.end();
        drop(self.server.take());
        for thread in self.threads.drain(..) {
            // A panic was reported already.
            let _ = thread.join();
        }
    }
}
