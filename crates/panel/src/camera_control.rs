//! Controls of the cameras: when they may be changed, and requests to the cameras.

use std::sync::atomic::Ordering;
use std::time::Duration;

use pb3dp_cell::camera_controls::{ControlDesk, ControlRequest};
use tokio::sync::oneshot;

use crate::control_changes::Change;
use crate::hub::Hub;
use crate::messages::cameras::ControlsAnswer;
use crate::refusal::Refusal;

/// Time within which the cameras take a request; three periods of slow cameras, and a driver that is slow to answer. What is not taken
/// by then is not set.
const TAKEN_WITHIN: Duration = Duration::from_millis(1500);

/// Receives the result of a request to the cameras: why it failed, in words.
pub type CameraAnswer = oneshot::Receiver<Result<(), String>>;

impl Hub {
    /// The cameras with controls.
    ///
    /// # Errors
    /// If they have none: they are simulated, or the images are recorded.
    pub fn camera_desk(&self) -> Result<&ControlDesk, Refusal> {
        self.config
            .cameras
            .as_ref()
            .ok_or_else(|| Refusal::NotHere { what: "controls", why: self.no_controls().into() })
    }

    fn no_controls(&self) -> &'static str {
        if self.about.is_simulated {
            "the cameras are simulated and have no controls"
        } else {
            "the images are recorded; nothing can be set"
        }
    }

    /// Why no control may be changed now; `None` if it may. Another exposure or focus could cost the target, so no arm may move, and none
    /// may begin to by itself.
    pub fn controls_blocked(&self) -> Option<&'static str> {
        let link = &self.link;
        if self.config.cameras.is_none() {
            return Some(self.no_controls());
        }
        if !self.about.has_arms() {
            return None;
        }
        if link.is_over.load(Ordering::SeqCst) {
            Some("the run is over and its cameras are closed")
        } else if !link.has_begun.load(Ordering::SeqCst) {
            Some("both arms are being enabled; wait until they are")
        } else if link.may_begin_to_move.load(Ordering::SeqCst) || self.pending.has_start() {
            Some("an arm moves or may move by itself, and a change could cost the target; use hold first")
        } else {
            None
        }
    }

    /// Asks the cameras to set a control; the caller has checked the lease. While it waits, `start` and `resume` are refused.
    ///
    /// # Errors
    /// If there are no controls, or an arm may move, or too many requests wait.
    pub fn change_control(&self, side: usize, id: u32, value: i32) -> Result<CameraAnswer, Refusal> {
        let desk = self.camera_desk()?;
        if let Some(why) = self.controls_blocked() {
            return Err(Refusal::MayMove { why });
        }
        self.ask(desk, ControlRequest::Set { side, id, value }, Some(self.changes.begin()))
    }

    /// Asks the cameras to read their controls again; `None` if nobody must disturb them now.
    pub fn read_controls(&self) -> Option<CameraAnswer> {
        let desk = self.camera_desk().ok().filter(|_| self.controls_blocked().is_none())?;
        self.ask(desk, ControlRequest::Read, None).ok()
    }

    fn ask(
        &self,
        desk: &ControlDesk,
        request: ControlRequest,
        change: Option<Change>,
    ) -> Result<CameraAnswer, Refusal> {
        let (answer, answered) = oneshot::channel();
        let take = move |result| {
            // Who asked may be gone.
            let _ = answer.send(result);
            drop(change);
        };
        desk.ask(request, self.now() + TAKEN_WITHIN, Box::new(take)).map_err(|why| Refusal::Control { why })?;
        Ok(answered)
    }

    /// The controls as they are now.
    pub fn controls_answer(&self, line: Option<String>) -> ControlsAnswer {
        let why_not = self.controls_blocked();
        let shown = self.config.cameras.as_ref().map(ControlDesk::shown);
        let (cameras, problem) = shown.map_or((Vec::new(), None), |shown| (shown.cameras.into(), shown.problem));
        ControlsAnswer { may_change: why_not.is_none(), why_not, problem, cameras, line }
    }
}
