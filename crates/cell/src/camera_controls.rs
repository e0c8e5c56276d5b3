//! Controls of real cameras: what they are at present, and requests to the thread that owns the cameras.
//!
//! A page has the [`ControlDesk`], the owner of the cameras the [`ControlEnd`]. The cameras answer between two pairs.

use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::FollowedTarget;
use serde::Serialize;

/// Requests that wait for the cameras; one page has one at a time.
const REQUESTS_MAX: usize = 16;

/// Kind of a control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControlKind {
    /// A number.
    Integer,
    /// 0 or 1.
    Boolean,
    /// One of the items of `menu`.
    Menu,
    /// A sum of bits.
    Bitmask,
    /// Has no value; setting it does something.
    Button,
    /// Of a type that this program cannot set.
    Other,
}

impl ControlKind {
    /// Name in tables and JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Integer => "integer",
            Self::Boolean => "boolean",
            Self::Menu => "menu",
            Self::Bitmask => "bitmask",
            Self::Button => "button",
            Self::Other => "other",
        }
    }
}

/// An item of a menu.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MenuItem {
    /// Its value.
    pub value: i32,
    /// Its name.
    pub text: String,
}

/// Unit of a control.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ControlUnit {
    /// Name of the unit.
    pub name: &'static str,
    /// Size of the value 1 in this unit.
    pub factor: f64,
}

/// Who sets a control that has an automatic mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ControlMode {
    /// The camera.
    Auto,
    /// The user.
    Manual,
}

/// A control with its present value. Values are in units of the driver.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraControl {
    /// Number of the control.
    pub id: u32,
    /// Name by the driver.
    pub name: String,
    /// Kind.
    pub kind: ControlKind,
    /// Smallest value.
    pub min: i32,
    /// Largest value.
    pub max: i32,
    /// Step between two values.
    pub step: i32,
    /// Value after power-on.
    pub default: i32,
    /// Present value; `None` if it has none or cannot be read.
    pub value: Option<i32>,
    /// Unit, if it is known.
    pub unit: Option<ControlUnit>,
    /// Who sets it; `None` without an automatic mode.
    pub mode: Option<ControlMode>,
    /// Whether the driver accepts no value now, usually because an automatic mode is on.
    pub is_locked: bool,
    /// Whether it moves the lens, so that the calibration no longer holds.
    pub moves_the_lens: bool,
    /// Items of a menu.
    pub menu: Vec<MenuItem>,
}

/// Images of one camera that were not delivered, by their cause.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ImageLosses {
    /// Lost on the way from the camera.
    pub lost: u64,
    /// Marked as damaged by the driver, or not decodable.
    pub damaged: u64,
    /// Too short.
    pub short: u64,
    /// Too old, or replaced by a newer one.
    pub late: u64,
    /// Without a partner from the other camera.
    pub unpaired: u64,
    /// With a time stamp that cannot be true.
    pub wrongly_stamped: u64,
}

/// One camera.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ShownCamera {
    /// Name in configurations.
    pub name: String,
    /// Controls, in the order of the driver.
    pub controls: Vec<CameraControl>,
    /// Images that were not delivered since the camera was opened.
    pub losses: ImageLosses,
}

/// Both cameras as they were last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ShownCameras {
    /// Left and right.
    pub cameras: [ShownCamera; 2],
    /// Why no pairs come, or why the controls cannot be read; `None` if all is well.
    pub problem: Option<String>,
}

/// A request to the cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControlRequest {
    /// Reads all controls again.
    Read,
    /// Sets a control, then reads all controls of this camera.
    Set {
        /// 0: left, 1: right.
        side: usize,
        /// Number of the control.
        id: u32,
        /// New value.
        value: i32,
    },
}

/// A [`FollowedTarget`] for two threads.
#[derive(Clone, Debug, Default)]
struct SharedTarget(Arc<AtomicU8>);

impl SharedTarget {
    fn set(&self, target: FollowedTarget) {
        self.0.store(target as u8, Ordering::Relaxed);
    }

    fn get(&self) -> FollowedTarget {
        let all = [FollowedTarget::Nothing, FollowedTarget::Confident, FollowedTarget::Doubtful];
        all.into_iter().find(|target| *target as u8 == self.0.load(Ordering::Relaxed)).unwrap_or_default()
    }
}

/// Receives the result of a request: why it failed, in words. It is dropped if the cameras are closed before.
pub type ControlAnswer = Box<dyn FnOnce(Result<(), String>) + Send>;

/// A request with its answer.
pub struct PendingControl {
    /// The request.
    pub request: ControlRequest,
    /// Receives the result.
    pub answer: ControlAnswer,
    until: MonotonicTime,
}

/// The end of those who show and change controls.
#[derive(Clone)]
pub struct ControlDesk {
    requests: SyncSender<PendingControl>,
    shown: Arc<Mutex<ShownCameras>>,
    target: SharedTarget,
}

/// The end of the cameras.
pub struct ControlEnd {
    requests: Receiver<PendingControl>,
    shown: Arc<Mutex<ShownCameras>>,
    target: SharedTarget,
}

/// Both ends.
pub fn control_desk() -> (ControlDesk, ControlEnd) {
    let (give, requests) = sync_channel(REQUESTS_MAX);
    let shown = Arc::<Mutex<ShownCameras>>::default();
    let target = SharedTarget::default();
    (
        ControlDesk { requests: give, shown: Arc::clone(&shown), target: target.clone() },
        ControlEnd { requests, shown, target },
    )
}

impl ControlDesk {
    /// Both cameras as they were last.
    pub fn shown(&self) -> ShownCameras {
        lock(&self.shown).clone()
    }

    /// States what the run follows: cameras with a shared exposure change it slowly then, or not at all.
    pub fn note_target(&self, target: FollowedTarget) {
        self.target.set(target);
    }

    /// Asks the cameras. A request that no camera has taken at the time `until` is refused, so that nothing is set late.
    /// What a request changes is in [`Self::shown`] before its answer comes.
    ///
    /// # Errors
    /// In words: the cameras are closed, or too many requests wait.
    pub fn ask(&self, request: ControlRequest, until: MonotonicTime, answer: ControlAnswer) -> Result<(), String> {
        self.requests.try_send(PendingControl { request, answer, until }).map_err(|error| match error {
            std::sync::mpsc::TrySendError::Full(_) => {
                format!("{REQUESTS_MAX} requests to the cameras are waiting; repeat it")
            }
            std::sync::mpsc::TrySendError::Disconnected(_) => "the cameras are closed".to_owned(),
        })
    }
}

impl ControlEnd {
    /// The next request that is not too old.
    pub fn next(&self, now: MonotonicTime) -> Option<PendingControl> {
        while let Ok(pending) = self.requests.try_recv() {
            if now <= pending.until {
                return Some(pending);
            }
            (pending.answer)(Err("the cameras were busy for too long, and nothing was set; repeat it".to_owned()));
        }
        None
    }

    /// What the run follows.
    pub fn target(&self) -> FollowedTarget {
        self.target.get()
    }

    /// Changes what is shown.
    pub fn show(&self, change: impl FnOnce(&mut ShownCameras)) {
        change(&mut lock(&self.shown));
    }
}

fn lock(shown: &Mutex<ShownCameras>) -> MutexGuard<'_, ShownCameras> {
    shown.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> MonotonicTime {
        MonotonicTime::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn the_cameras_know_what_is_followed() {
        let (desk, end) = control_desk();
        assert_eq!(end.target(), FollowedTarget::Nothing);
        for target in [FollowedTarget::Confident, FollowedTarget::Doubtful, FollowedTarget::Nothing] {
            desk.note_target(target);
            assert_eq!(end.target(), target);
        }
    }

    #[test]
    fn a_request_that_waited_too_long_is_refused_and_sets_nothing() {
        let (desk, end) = control_desk();
        let (tell, outcomes) = std::sync::mpsc::channel();
        let ask = |value: i32, until: MonotonicTime| {
            let tell = tell.clone();
            let answer = Box::new(move |result| tell.send((value, result)).unwrap());
            desk.ask(ControlRequest::Set { side: 0, id: 1, value }, until, answer)
        };
        ask(1, at(10)).unwrap();
        ask(2, at(30)).unwrap();
        let taken = end.next(at(20)).unwrap();
        assert_eq!(taken.request, ControlRequest::Set { side: 0, id: 1, value: 2 });
        let (value, result) = outcomes.try_recv().unwrap();
        assert!(value == 1 && result.is_err_and(|error| error.contains("nothing was set")));
        (taken.answer)(Ok(()));
        assert_eq!(outcomes.try_recv().unwrap(), (2, Ok(())));
        for number in 0..REQUESTS_MAX {
            ask(number as i32, at(99)).unwrap();
        }
        assert!(ask(0, at(99)).unwrap_err().contains("are waiting"));
        drop(end);
        assert_eq!(ask(0, at(99)), Err("the cameras are closed".to_owned()));
    }
}
