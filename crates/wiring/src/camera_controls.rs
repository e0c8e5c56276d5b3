//! Controls of real cameras for a page: read when the cameras are opened and on request, set between two pairs.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_camera_v4l2::controls::{Control, is_automatic, moves_the_lens, unit_of};
use pb3dp_camera_v4l2::video::ControlKind as DriverKind;
use pb3dp_camera_v4l2::{ExposureEvent, ReopeningCamera, Side, StreamCounters};
use pb3dp_cell::camera_controls::{
    CameraControl, ControlDesk, ControlEnd, ControlKind, ControlMode, ControlRequest, ControlUnit, ImageLosses,
    MenuItem, PendingControl, control_desk,
};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, Clock, FramePair, StereoCamera, StereoCameraInfo};

/// Time between two readings: a camera in an automatic mode changes its values by itself, and several pages may ask.
const READ_EVERY: Duration = Duration::from_secs(1);
/// Requests between two pairs; each takes some calls of the driver.
const REQUESTS_AT_ONCE: usize = 4;

/// Controls with all that a page shows of them. Controls of a type that this program cannot set are left out.
pub fn described(controls: &[Control]) -> Vec<CameraControl> {
    controls.iter().map(|control| describe(control, is_automatic(controls, control.entry.id))).collect()
}

fn describe(control: &Control, is_automatic: Option<bool>) -> CameraControl {
    let entry = &control.entry;
    CameraControl {
        id: entry.id,
        name: entry.name.clone(),
        kind: match entry.kind {
            DriverKind::Integer => ControlKind::Integer,
            DriverKind::Boolean => ControlKind::Boolean,
            DriverKind::Menu => ControlKind::Menu,
            DriverKind::Bitmask => ControlKind::Bitmask,
            DriverKind::Button => ControlKind::Button,
            DriverKind::Other => ControlKind::Other,
        },
        min: entry.min,
        max: entry.max,
        step: entry.step,
        default: entry.default,
        value: control.value,
        unit: unit_of(entry.id).map(|(name, factor)| ControlUnit { name, factor }),
        mode: is_automatic.map(|is_automatic| if is_automatic { ControlMode::Auto } else { ControlMode::Manual }),
        is_locked: entry.is_locked,
        moves_the_lens: moves_the_lens(entry.id),
        menu: control.menu.iter().map(|(value, text)| MenuItem { value: *value, text: text.clone() }).collect(),
    }
}

/// The controls of a pair of cameras, as their owner serves them.
pub(super) struct ControlService {
    end: ControlEnd,
    clock: Arc<dyn Clock>,
    /// How often the cameras were reopened before the controls were read last; `None` before the first time.
    read_after: Option<u64>,
    read_at: MonotonicTime,
}

impl ControlService {
    /// The service for cameras with these names, and the desk for its users.
    pub(super) fn new(clock: Arc<dyn Clock>, names: [String; 2]) -> (Self, ControlDesk) {
        let (desk, end) = control_desk();
        end.show(|shown| {
            for (camera, name) in shown.cameras.iter_mut().zip(names) {
                camera.name = name;
            }
        });
        (Self { end, clock, read_after: None, read_at: MonotonicTime::ZERO }, desk)
    }

    /// Answers the requests that wait, and states what is followed; to be called between two pairs.
    pub(super) fn serve(&mut self, camera: &mut ReopeningCamera) {
        camera.set_following(self.end.target());
        if self.read_after.replace(camera.reopened()) != Some(camera.reopened()) {
            // Who asks for the controls reads them again and gets the error; here no pair waits for a driver twice.
            let _ = self.read(camera);
        }
        for _ in 0..REQUESTS_AT_ONCE {
            let Some(PendingControl { request, answer, .. }) = self.end.next(self.clock.now()) else { break };
            answer(self.answered(camera, request).map_err(|error| error.with_causes()));
        }
    }

    /// Shows what became of a pair.
    pub(super) fn note(&mut self, camera: &ReopeningCamera, outcome: &Result<(), CameraError>) {
        let counters = camera.counters();
        self.end.show(|shown| {
            shown.problem = outcome.as_ref().err().map(CameraError::with_causes);
            for (camera, counters) in shown.cameras.iter_mut().zip([&counters.left, &counters.right]) {
                camera.losses = losses_in(counters);
            }
        });
    }

    fn answered(&mut self, camera: &mut ReopeningCamera, request: ControlRequest) -> Result<(), CameraError> {
        match request {
            ControlRequest::Read if self.clock.now().saturating_since(self.read_at) < READ_EVERY => Ok(()),
            ControlRequest::Read => self.read(camera),
            ControlRequest::Set { side, id, value } => {
                let side = if side == 0 { Side::Left } else { Side::Right };
                let set = camera.set_control(side, id, value);
                // Also after a failure: the driver may have kept another value.
                self.read_side(camera, side)?;
                set
            }
        }
    }

    fn read(&mut self, camera: &mut ReopeningCamera) -> Result<(), CameraError> {
        self.read_side(camera, Side::Left)?;
        self.read_side(camera, Side::Right)?;
        self.read_at = self.clock.now();
        Ok(())
    }

    fn read_side(&mut self, camera: &mut ReopeningCamera, side: Side) -> Result<(), CameraError> {
        let controls = described(&camera.controls(side)?);
        self.end.show(|shown| shown.cameras[side as usize].controls = controls);
        Ok(())
    }
}

/// Logs what became of the exposure that the program controls, until `next` has no more; to be called after each pair.
pub fn log_exposure(next: impl FnMut() -> Option<ExposureEvent>) {
    for event in std::iter::from_fn(next) {
        if event.is_warning() {
            tracing::warn!("cameras: {event}");
        } else {
            tracing::info!("cameras: {event}");
        }
    }
}

fn losses_in(counters: &StreamCounters) -> ImageLosses {
    ImageLosses {
        lost: counters.lost,
        damaged: counters.damaged,
        short: counters.short,
        late: counters.stale + counters.superseded,
        unpaired: counters.unpaired,
        wrongly_stamped: counters.not_newer + counters.future + counters.unstamped,
    }
}

/// Bare cameras, whose controls can be changed at any time: nothing carries them.
pub(super) struct BareCameras {
    pub(super) camera: ReopeningCamera,
    pub(super) service: ControlService,
}

impl StereoCamera for BareCameras {
    fn info(&self) -> &StereoCameraInfo {
        self.camera.info()
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        self.service.serve(&mut self.camera);
        let outcome = self.camera.next_pair_into(pair, timeout);
        log_exposure(|| self.camera.take_exposure_event());
        self.service.note(&self.camera, &outcome);
        outcome
    }
}
