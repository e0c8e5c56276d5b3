//! Real cameras: opened, checked before an arm is enabled, and monitored while they run.

use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_camera_settings::{SKEW_MAX, StereoConfig};
use pb3dp_camera_v4l2::pairing::Drift;
use pb3dp_camera_v4l2::video::VideoSystem;
use pb3dp_camera_v4l2::{ReopeningCamera, Side};
use pb3dp_cell::camera_controls::ControlDesk;
use pb3dp_estimation::pair_check::{PairCheck, PairVerdict, check_pair};
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FramePair, StereoCamera, StereoCameraInfo};
use pb3dp_record::calibration_files::CameraIdentity;
use pb3dp_setup::setup::{CAMERAS, CalibrationInUse, RealCameras, Setup, Synchronisation};

use super::calibration::identity;
use super::camera_controls::{ControlService, log_exposure};

/// Longest wait for the first pair: some cameras need a second or two to start.
const FIRST_PAIR_WITHIN: Duration = Duration::from_secs(10);

/// Number of pairs between two drift checks: 9 s at 30 per second.
const DRIFT_EVERY: u64 = 256;
/// Drift limit for triggered cameras, seconds per second: they do not drift, but drift estimates vary by this much.
const DRIFT_MAX: f64 = 20e-6;
/// Drift limit relative to the scatter of single pairs: five standard deviations of a line fit to 512 pairs, in 17 s.
const DRIFT_PER_SCATTER: f64 = 0.05;
/// Warning time before the skew limit is reached, seconds.
const LIMIT_NEAR_S: f64 = 30.0;

/// Cameras that have delivered their first pair.
pub(super) struct WiredCameras {
    pub(super) camera: Box<dyn StereoCamera>,
    /// Identity of the left and the right camera.
    pub(super) identities: [CameraIdentity; 2],
    /// Their controls.
    pub(super) controls: ControlDesk,
}

/// Opens both cameras and waits for the first pair.
///
/// # Errors
/// As [`ReopeningCamera::open`]; cameras that do not match the setup's calibrations; no pair; left and right exchanged.
pub(super) fn wire_real(
    real: &RealCameras,
    setup: &Setup,
    (system, clock): (Arc<dyn VideoSystem>, Arc<dyn Clock>),
) -> Result<WiredCameras> {
    let camera = ReopeningCamera::open(system, Arc::clone(&clock), real.stereo.clone(), real.reopen_for);
    let camera = camera.context("table [camera]")?;
    let names = [&real.stereo.left, &real.stereo.right].map(|camera| camera.name.to_string());
    let (service, controls) = ControlService::new(Arc::clone(&clock), names);
    let mut camera = WatchedCamera::new(camera, real.clone(), setup.rig.stereo);
    camera.service = Some(service);
    // A target is initialised in the first pair of the run, so the exposure settles before.
    camera.camera.settle_exposure().context("table [camera]")?;
    let first = first_pair(&mut camera, &*clock)?;
    if !real.stereo.layout.is_one_device() {
        match skew_line(real, &first, setup.camera_skew_max()) {
            (true, line) => tracing::warn!("cameras: {line}"),
            (false, line) => tracing::info!("cameras: {line}"),
        }
    }
    let mut identity_of = |side| camera.camera.identity(side).map(identity).context("table [camera]");
    let identities = [identity_of(Side::Left)?, identity_of(Side::Right)?];
    look_at_cameras(&setup.rig.calibrations, &identities)?;
    let check = check_pair(&setup.rig.stereo, &first.left, &first.right);
    let advice = if real.stereo.layout.is_one_device() {
        "table [camera]: the device delivers its right view in the place of the left one; check camera.layout and the calibration"
    } else {
        "table [camera]: exchange left.device and right.device"
    };
    if let Some(doubt) = check.accepted().context(advice)? {
        tracing::warn!("cameras: {doubt}");
    }
    Ok(WiredCameras { camera: Box::new(camera), identities, controls })
}

/// What the start of a run says about the skew, and whether it is a warning: cameras without a trigger, or a limit above the default one.
/// `hold_at`: the skew from which the policy `camera_skew` acts.
fn skew_line(real: &RealCameras, first: &FramePair, hold_at: Duration) -> (bool, String) {
    let StereoConfig { skew_max, skew_cost, .. } = real.stereo;
    let millis = |time: Duration| time.as_secs_f64() * 1e3;
    let is_free = real.synchronisation == Synchronisation::FreeRunning;
    let kind = if is_free { "free-running" } else { "triggered" };
    let mut line = format!(
        "{kind}; right was exposed {:+.2} ms after left in the first pair; camera.skew_max_millis accepts {:.1} ms: {}",
        first.skew_nanos as f64 * 1e-6,
        millis(skew_max),
        skew_cost.text(skew_max)
    );
    if is_free {
        line += "; the skew drifts through the whole period, and pairs above the limit are refused";
    }
    if skew_max > hold_at {
        line += &format!(
            "; the policy camera_skew acts from {:.1} ms on, so that the hand does not use all of this",
            millis(hold_at)
        );
    }
    (is_free || skew_max > SKEW_MAX, line)
}

/// Checks whether the calibrations belong to the connected cameras.
///
/// # Errors
/// The first calibration, not waived, of other cameras, of exchanged cameras, or of another focus.
fn look_at_cameras(calibrations: &[CalibrationInUse], there: &[CameraIdentity; 2]) -> Result<()> {
    for calibration in calibrations {
        let Some(judgement) = &calibration.judgement else { continue };
        let (table, source) = (calibration.table, &calibration.source);
        if judgement.cameras.iter().all(CameraIdentity::is_empty) {
            tracing::warn!(
                "{source} does not name its cameras, so they are not compared with the connected ones (docs/calibration.md, --cameras)"
            );
            continue;
        }
        let Some(other) = other_than(&judgement.cameras, there) else { continue };
        if !calibration.waives(CAMERAS) {
            bail!(
                "{source} is not the calibration of these cameras: {other}; calibrate these, set the right file, or waive it with \
                 {table}.waived_gates = [\"{CAMERAS} until YYYY-MM-DD\"]"
            );
        }
        tracing::warn!("{source} is not the calibration of these cameras: {other}: waived by {table}.waived_gates");
    }
    Ok(())
}

/// First difference among the properties known for both. A camera with a serial number may use another port.
fn other_than(calibrated: &[CameraIdentity; 2], there: &[CameraIdentity; 2]) -> Option<String> {
    let mut sides = ["left", "right"].into_iter().zip(calibrated.iter().zip(there));
    sides.find_map(|(side, (was, is))| {
        let differs = |what: &str, was: &Option<String>, is: &Option<String>| match (was, is) {
            (Some(was), Some(is)) if was != is => {
                Some(format!("the {side} camera has {what} {is}, calibrated was {was}"))
            }
            _ => None,
        };
        let serial = differs("serial number", &was.serial, &is.serial);
        let is_known_by_number = was.serial.is_some() && is.serial.is_some();
        let place = if is_known_by_number { None } else { differs("port", &was.place, &is.place) };
        let focus = || differs("focus", &was.focus.map(|v| v.to_string()), &is.focus.map(|v| v.to_string()));
        serial.or(place).or_else(focus)
    })
}

/// Precondition for enabling an arm: the cameras deliver pairs.
fn first_pair(camera: &mut WatchedCamera, clock: &dyn Clock) -> Result<FramePair> {
    let deadline = clock.now() + FIRST_PAIR_WITHIN;
    loop {
        match camera.next_pair(Duration::from_secs(1)) {
            Ok(pair) => return Ok(pair),
            Err(error) if matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair) => {
                if clock.now() >= deadline {
                    bail!("cameras: no first pair within {FIRST_PAIR_WITHIN:?}: {error}");
                }
            }
            Err(error) => return Err(error).context("cameras: no first pair"),
        }
    }
}

/// Accepts the first pairs of cameras that were disconnected: their cables may be exchanged. `are_distinguished`: serial numbers have shown
/// that they are not, and images with too little texture for a verdict are accepted.
///
/// # Errors
/// Unless the images show, or the serial numbers do, that left and right are as before.
fn check_reopened(check: &PairCheck, are_distinguished: bool) -> Result<()> {
    match check.accepted().context("connect each camera to its previous port")? {
        Some(doubt) if are_distinguished => tracing::warn!("cameras: {doubt}"),
        Some(doubt) => bail!("the cameras may be exchanged: {doubt}"),
        None if are_distinguished || check.verdict == PairVerdict::Consistent => {}
        None => bail!(
            "too little texture to tell left from right: {} patches, {} of them match; turn the cameras to a textured scene, or use \
             cameras with serial numbers",
            check.patches,
            check.agreeing
        ),
    }
    Ok(())
}

/// Real cameras that warn when their exposures drift apart, deliver nothing after a loss until left and right are as before, and
/// log their counts at the end.
struct WatchedCamera {
    camera: ReopeningCamera,
    cameras: RealCameras,
    rig: StereoRig,
    pairs: u64,
    is_drift_reported: bool,
    /// How often the cameras were reopened before the images were checked last.
    checked: u64,
    /// Their controls for a page, if there may be one.
    service: Option<ControlService>,
}

impl WatchedCamera {
    fn new(camera: ReopeningCamera, cameras: RealCameras, rig: StereoRig) -> Self {
        Self { camera, cameras, rig, pairs: 0, is_drift_reported: false, checked: 0, service: None }
    }

    /// Checks the images of reopened cameras, until one pair shows that left and right are as before.
    fn check_order(&mut self, pair: &FramePair) -> Result<(), CameraError> {
        let reopened = self.camera.reopened();
        if reopened != self.checked {
            let are_distinguished = self.camera.are_distinguished();
            check_reopened(&check_pair(&self.rig, &pair.left, &pair.right), are_distinguished).map_err(|error| {
                let message = format!("{}: after reopening: {error:#}; no pairs until then", self.info().name);
                CameraError::new(CameraErrorKind::BadPair, message)
            })?;
            self.checked = reopened;
        }
        Ok(())
    }

    /// A warning about skew drift; each one only once until the cause is gone.
    fn look_at_drift(&mut self) -> Option<String> {
        let what = self.trouble(&self.camera.counters().drift?);
        let was_reported = std::mem::replace(&mut self.is_drift_reported, what.is_some());
        what.filter(|_| !was_reported)
    }

    fn trouble(&self, drift: &Drift) -> Option<String> {
        let StereoConfig { skew_max, .. } = self.cameras.stereo;
        let (skew_millis, ppm) = (drift.skew_s * 1e3, drift.rate * 1e6);
        match self.cameras.synchronisation {
            Synchronisation::HardwareTrigger if drift.rate.abs() > DRIFT_MAX + DRIFT_PER_SCATTER * drift.scatter_s => {
                Some(format!(
                    "the skew of {skew_millis:.2} ms drifts by {ppm:.0} us per second: the cameras are not triggered by one signal, contrary to \
                     camera.synchronisation; check the wiring and the trigger mode of the cameras"
                ))
            }
            Synchronisation::FreeRunning => drift.seconds_until(skew_max).filter(|s| *s < LIMIT_NEAR_S).map(|seconds| {
                format!(
                    "the skew of {skew_millis:.2} ms drifts by {ppm:.0} us per second and passes camera.skew_max_millis in {seconds:.0} s: \
                     pairs are then refused until the skew is within the limit again"
                )
            }),
            Synchronisation::HardwareTrigger => None,
        }
    }
}

impl StereoCamera for WatchedCamera {
    fn info(&self) -> &StereoCameraInfo {
        self.camera.info()
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        if let Some(service) = &mut self.service {
            service.serve(&mut self.camera);
        }
        let outcome = self.camera.next_pair_into(pair, timeout).and_then(|()| self.check_order(pair));
        log_exposure(|| self.camera.take_exposure_event());
        if let Some(service) = &mut self.service {
            service.note(&self.camera, &outcome);
        }
        outcome?;
        self.pairs += 1;
        if self.pairs.is_multiple_of(DRIFT_EVERY)
            && let Some(what) = self.look_at_drift()
        {
            tracing::warn!("cameras: {what}");
        }
        Ok(())
    }
}

impl Drop for WatchedCamera {
    fn drop(&mut self) {
        let counters = self.camera.counters();
        tracing::info!(
            "cameras: {} pairs, reopened {} times; since then skew at most {:.2} ms ({}), {} pairs refused for it, left {:?}, right {:?}",
            self.pairs,
            self.camera.reopened(),
            counters.skew_max_nanos as f64 * 1e-6,
            self.cameras.stereo.skew_cost.text(Duration::from_nanos(counters.skew_max_nanos)),
            counters.skew_refused,
            counters.left,
            counters.right
        );
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::LazyLock;
    use std::sync::mpsc::channel;

    use pb3dp_camera_v4l2::controls::id;
    use pb3dp_camera_v4l2::emulated::{EmulatedCamera, EmulatedSystem};
    use pb3dp_cell::camera_controls::ControlRequest;
    use pb3dp_geometry::{Camera, ImageSize, Pinhole};
    use pb3dp_hal_clock::VirtualClock;
    use pb3dp_setup::layers::SetupArgs;
    use pb3dp_setup::setup::{read_cameras, read_setup};

    use super::*;
    use crate::calibration::tests::{camera, cameras as both, in_use};

    /// Cameras and calibration of `configs/rig.toml`.
    fn of_the_rig() -> (RealCameras, StereoRig) {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/rig.toml");
        (read_cameras(&SetupArgs::of_file(&file)).unwrap().0, read_setup(&file).unwrap().rig.stereo)
    }

    /// Drift warnings of two cameras, the right one slower by `slowness`, with the pair number of each warning.
    fn warnings(synchronisation: Synchronisation, slowness: f64, pairs: u64) -> Vec<(u64, String)> {
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::default());
        let (mut cameras, rig) = of_the_rig();
        cameras.synchronisation = synchronisation;
        for (number, side) in [&mut cameras.stereo.left, &mut cameras.stereo.right].into_iter().enumerate() {
            side.name = format!("bus:usb-emulated-{number}").parse().unwrap();
            side.mode.size = ImageSize { width: 64, height: 48 };
        }
        let emulated = (0..2).map(|number| {
            let slowness = slowness * f64::from(number);
            EmulatedCamera { slowness, ..EmulatedCamera::usual(number) }
        });
        let system = Arc::new(EmulatedSystem::new(clock.clone(), emulated.collect()));
        let camera = ReopeningCamera::open(system, clock, cameras.stereo.clone(), cameras.reopen_for).unwrap();
        let mut camera = WatchedCamera::new(camera, cameras, rig);
        let mut pair = FramePair::black(camera.info().size);
        let mut warnings = Vec::new();
        for number in 1..=pairs {
            camera.camera.next_pair_into(&mut pair, Duration::from_secs(1)).unwrap();
            if number % DRIFT_EVERY == 0 {
                warnings.extend(camera.look_at_drift().map(|what| (number, what)));
            }
        }
        warnings
    }

    #[test]
    fn free_running_cameras_are_reported_once_before_their_pairs_are_refused() {
        // 0.1 ms per second: 5 ms are reached after 50 s, at pair 1500; 30 s earlier is pair 600.
        let free = warnings(Synchronisation::FreeRunning, 1e-4, 1400);
        let [(number, what)] = free.as_slice() else { panic!("{free:?}") };
        assert!((600..=600 + 2 * DRIFT_EVERY).contains(number), "{free:?}");
        assert!(what.contains("drifts by 100 us per second and passes camera.skew_max_millis in"), "{what}");
        assert_eq!(warnings(Synchronisation::FreeRunning, 1e-6, 1400), []);
    }

    #[test]
    fn cameras_that_are_not_triggered_as_stated_are_reported() {
        let apart = warnings(Synchronisation::HardwareTrigger, 1e-4, 1400);
        assert!(
            matches!(apart.as_slice(), [(_, what)] if what.contains("the cameras are not triggered by one signal")),
            "{apart:?}"
        );
        assert_eq!(warnings(Synchronisation::HardwareTrigger, 0.0, 1400), []);
    }

    /// A plane at 500 mm: 370 px times 100 mm over 500 mm.
    const DISPARITY_PX: usize = 74;

    /// Blocks of 5 pixels, from a column on.
    fn scene(from: usize) -> Vec<u8> {
        let pixel = |at: usize| {
            let (u, v) = (from + at % 320, at / 320);
            let mixed = (u / 5).wrapping_mul(0x9E37_79B1).wrapping_add((v / 5).wrapping_mul(0x85EB_CA77));
            let brightness = 60 + (mixed ^ (mixed >> 13)).wrapping_mul(0xC2B2_AE35) / 65_536 % 130;
            [brightness as u8, 128]
        };
        (0..320 * 240).flat_map(pixel).collect()
    }

    fn paint_left(_: u64, memory: &mut [u8]) {
        static SCENE: LazyLock<Vec<u8>> = LazyLock::new(|| scene(0));
        memory.copy_from_slice(&SCENE);
    }

    fn paint_right(_: u64, memory: &mut [u8]) {
        static SCENE: LazyLock<Vec<u8>> = LazyLock::new(|| scene(DISPARITY_PX));
        memory.copy_from_slice(&SCENE);
    }

    /// What came after both plugs were pulled, and plugged in again with these paintings: pairs in 0.7 s, and the last message.
    fn after_reopening(serials: [Option<&str>; 2], paints: [fn(u64, &mut [u8]); 2]) -> (u32, String) {
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::default());
        let (mut cameras, whole) = of_the_rig();
        let size = ImageSize { width: 320, height: 240 };
        for (number, side) in [&mut cameras.stereo.left, &mut cameras.stereo.right].into_iter().enumerate() {
            side.name = format!("bus:usb-emulated-{number}").parse().unwrap();
            side.mode.size = size;
        }
        let straight: [fn(u64, &mut [u8]); 2] = [paint_left, paint_right];
        let emulated = (0..2).map(|number| {
            let mut camera = EmulatedCamera::usual(number as u32);
            camera.entry.serial = serials[number].map(str::to_owned);
            camera.formats[0].1[0].0 = size;
            camera.paint = straight[number];
            camera
        });
        let system = EmulatedSystem::new(Arc::clone(&clock), emulated.collect());
        let pinhole = Pinhole { fx: 370.0, fy: 370.0, cx: 159.5, cy: 119.5 };
        let camera = Camera::new(size, pinhole, *whole.left().distortion()).unwrap();
        let rig = StereoRig::new(camera, camera, *whole.cam_right_from_cam_left()).unwrap();
        let video = Arc::new(system.clone());
        let camera =
            ReopeningCamera::open(video, Arc::clone(&clock), cameras.stereo.clone(), cameras.reopen_for).unwrap();
        let mut camera = WatchedCamera::new(camera, cameras, rig);
        let mut pair = FramePair::black(size);
        camera.next_pair_into(&mut pair, Duration::from_secs(1)).unwrap();
        for (number, paint) in paints.into_iter().enumerate() {
            system.with(number, |camera| camera.faults.is_unplugged = true).unwrap();
            assert!(camera.next_pair_into(&mut pair, Duration::from_millis(60)).is_err());
            system.with(number, |camera| (camera.faults.is_unplugged, camera.paint) = (false, paint)).unwrap();
        }
        let (end, mut came, mut error_text) = (clock.now() + Duration::from_millis(700), 0, String::new());
        while clock.now() < end {
            match camera.next_pair_into(&mut pair, Duration::from_millis(66)) {
                Ok(()) => came += 1,
                Err(error) => error_text = error.to_string(),
            }
        }
        assert!(camera.camera.reopened() > 0);
        (came, error_text)
    }

    /// Without serial numbers the ports are the names, and only the images show which camera is in which port.
    #[test]
    fn exchanged_cables_are_noticed_by_the_images() {
        let [left, right]: [fn(u64, &mut [u8]); 2] = [paint_left, paint_right];
        let grey: fn(u64, &mut [u8]) = |number, memory| memory.fill(100 + (number % 2) as u8);
        let numbered = [Some("A"), Some("B")];
        for (serials, paints, expected) in [
            ([None, None], [left, right], None),
            ([None, None], [right, left], Some("left and right look exchanged")),
            ([None, None], [grey, grey], Some("too little texture to tell left from right")),
            (numbered, [grey, grey], None),
            (numbered, [right, left], Some("left and right look exchanged")),
        ] {
            let (came, error_text) = after_reopening(serials, paints);
            match expected {
                None => assert!(came > 3, "{came} came: {error_text}"),
                Some(text) => assert!(came == 0 && error_text.contains(text), "{came} came: {error_text}"),
            }
        }
    }

    #[test]
    fn controls_are_set_between_two_pairs_and_lost_cameras_say_so() {
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::default());
        let (mut cameras, rig) = of_the_rig();
        for (number, side) in [&mut cameras.stereo.left, &mut cameras.stereo.right].into_iter().enumerate() {
            side.name = format!("bus:usb-emulated-{number}").parse().unwrap();
            side.mode.size = ImageSize { width: 64, height: 48 };
        }
        let system = EmulatedSystem::new(Arc::clone(&clock), vec![EmulatedCamera::usual(0), EmulatedCamera::usual(1)]);
        let camera = ReopeningCamera::open(
            Arc::new(system.clone()),
            Arc::clone(&clock),
            cameras.stereo.clone(),
            cameras.reopen_for,
        );
        let mut camera = WatchedCamera::new(camera.unwrap(), cameras, rig);
        let (service, desk) = ControlService::new(Arc::clone(&clock), ["left".to_owned(), "right".to_owned()]);
        camera.service = Some(service);
        let (tell, warnings) = channel();
        let set = |value: i32| {
            let tell = tell.clone();
            let request = ControlRequest::Set { side: 1, id: id::GAIN, value };
            let until = clock.now() + Duration::from_secs(1);
            desk.ask(request, until, Box::new(move |result| tell.send(result).unwrap())).unwrap();
        };
        let gain = || {
            let shown = desk.shown();
            shown.cameras[1].controls.iter().find(|control| control.id == id::GAIN).and_then(|control| control.value)
        };
        let mut pair = FramePair::black(camera.info().size);
        let mut next = || camera.next_pair_into(&mut pair, Duration::from_millis(66)).is_ok();
        set(77);
        assert!(warnings.try_recv().is_err(), "only the owner of the cameras sets a control");
        assert!(next());
        assert_eq!((warnings.try_recv().unwrap(), gain(), desk.shown().problem), (Ok(()), Some(77), None));
        system.with(0, |camera| camera.faults.is_unplugged = true).unwrap();
        assert!(!next());
        assert!(desk.shown().problem.is_some());
        set(78);
        assert!(!next());
        assert!(warnings.try_recv().unwrap().is_err());
        system.with(0, |camera| camera.faults.is_unplugged = false).unwrap();
        assert!((0..100).any(|_| next()));
        assert!(next());
        assert_eq!(desk.shown().problem, None);
        assert_ne!(gain(), Some(77), "a reopened camera has the value of the setup");
    }

    #[test]
    fn the_start_of_a_run_states_the_skew_and_its_cost() {
        let (mut cameras, rig) = of_the_rig();
        cameras.calibrate(&rig).unwrap();
        let mut first = FramePair::black(cameras.size());
        first.skew_nanos = -3_200_000;
        let five = Duration::from_millis(5);
        let (is_warning, line) = skew_line(&cameras, &first, five);
        assert!(!is_warning && line.starts_with("triggered; right was exposed -3.20 ms after left"), "{line}");
        cameras.synchronisation = Synchronisation::FreeRunning;
        cameras.stereo.skew_max = Duration::from_millis(15);
        let (is_warning, line) = skew_line(&cameras, &first, five);
        let cost = cameras.stereo.skew_cost;
        let error_mm = 1.5 * cost.distance_m / rig.baseline_m();
        for part in [
            "free-running",
            "camera.skew_max_millis accepts 15.0 ms",
            &format!(
                "at 100 mm/s and a distance of {:.0} mm this is a depth error of {error_mm:.2} mm",
                cost.distance_m * 1e3
            ),
            "the policy camera_skew acts from 5.0 ms on",
        ] {
            assert!(is_warning && line.contains(part), "{part} is not in {line}");
        }
    }

    #[test]
    fn cameras_that_are_others_are_named() {
        let other = |there: [CameraIdentity; 2], waived: &[&str]| {
            look_at_cameras(&[in_use(waived)], &there).err().map(|error| error.to_string())
        };
        assert_eq!(other(both(), &[]), None);
        let [left, right] = both();
        // A camera with a serial number may use another port; one without is identified by its port.
        assert_eq!(other([camera(Some("A0"), "usb-9", Some(30)), right.clone()], &[]), None);
        for (there, part) in [
            (
                [camera(Some("B7"), "usb-1", Some(30)), right.clone()],
                "the left camera has serial number B7, calibrated was A0",
            ),
            ([left.clone(), camera(None, "usb-3", None)], "the right camera has port usb-3, calibrated was usb-2"),
            ([camera(Some("A0"), "usb-1", Some(31)), right.clone()], "the left camera has focus 31, calibrated was 30"),
            ([right.clone(), left.clone()], "the left camera has port usb-2, calibrated was usb-1"),
        ] {
            let text = other(there.clone(), &[]).unwrap();
            assert!(text.contains(part) && text.contains("waived_gates = [\"cameras until"), "{text}");
            assert_eq!(other(there, &["cameras"]), None);
        }
        // Cameras without any known property cannot be compared.
        let mut unnamed = in_use(&[]);
        unnamed.judgement.as_mut().unwrap().cameras = Default::default();
        assert!(look_at_cameras(&[unnamed], &both()).is_ok());
    }
}
