//! Setups that run quickly, and figures of their results.

use nalgebra::Vector3;
use pb3dp_cell::experiment;
use pb3dp_cell::figures::TrackingError;
use pb3dp_cell::journal::Outcome;
use pb3dp_cell::log::{ControlSample, RunLog};
use pb3dp_estimation::estimator::Method;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, StereoRig};
use pb3dp_setup::setup::{Leader, Setup, read_setup};
use pb3dp_sim::trajectory::{Channel, StepExperimentConfig};
use pb3dp_wiring::wire;
use system_tests::repository;

/// The setup of the repository with this method in the control loop; no method runs beside it.
pub fn whole_setup(method: Method) -> Setup {
    let file = match method {
        Method::Published => "configs/published.toml",
        _ => "configs/sim.toml",
    };
    let setup = read_setup(&repository().join(file)).unwrap();
    assert_eq!(setup.leader, Leader::Images(method), "{file}");
    Setup { compared: Vec::new(), ..setup }
}

/// configs/sim.toml with these lines changed, each of which occurs in it once.
pub fn changed_setup(changes: &[(&str, &str)]) -> Setup {
    let dir = tempfile::tempdir().unwrap();
    let configs = repository().join("configs").canonicalize().unwrap();
    let mut text = std::fs::read_to_string(configs.join("sim.toml")).unwrap();
    for (from, to) in changes {
        assert_eq!(text.matches(from).count(), 1, "{from}");
        text = text.replace(from, to);
    }
    // The files that a setup names are next to it.
    for folder in ["robots", "arms"] {
        std::os::unix::fs::symlink(configs.join(folder), dir.path().join(folder)).unwrap();
    }
    let file = dir.path().join("setup.toml");
    std::fs::write(&file, text).unwrap();
    read_setup(&file).unwrap()
}

/// Camera resolution of a quick setup; fewer pixels are quicker and less accurate.
#[derive(Clone, Copy)]
pub enum Pixels {
    /// 320 x 240.
    Few,
    /// 480 x 360.
    More,
}

/// The same with fewer pixels in the same field of view, and moves and holds of one second.
pub fn quick_setup(method: Method, pixels: Pixels, channels: &[Channel]) -> Setup {
    let mut setup = whole_setup(method);
    let share = match pixels {
        Pixels::Few => 0.5,
        Pixels::More => 0.75,
    };
    let whole = *setup.rig.stereo.left();
    let scaled = |count: u32| (f64::from(count) * share) as u32;
    let size = ImageSize { width: scaled(whole.size().width), height: scaled(whole.size().height) };
    let centre = |count: u32| (f64::from(count) - 1.0) / 2.0;
    let fx = whole.pinhole().fx * share;
    let pinhole = Pinhole { fx, fy: fx, cx: centre(size.width), cy: centre(size.height) };
    let camera = Camera::new(size, pinhole, Distortion::None).unwrap();
    setup.rig.stereo = StereoRig::new(camera, camera, *setup.rig.stereo.cam_right_from_cam_left()).unwrap();
    let steps = steps_of(&mut setup);
    (steps.channels, steps.move_s, steps.hold_s, steps.lead_in_s) = (channels.to_vec(), 1.0, 1.0, 1.0);
    setup
}

/// The moves of a setup's experiment.
pub fn steps_of(setup: &mut Setup) -> &mut StepExperimentConfig {
    setup.experiment.steps_mut().unwrap()
}

/// Builds and runs a setup.
pub fn run(setup: &Setup, stop_after_s: Option<f64>) -> Outcome {
    experiment::run(setup, wire(setup).unwrap(), stop_after_s, None).unwrap()
}

/// Distance of the hand (mm) and angle between the camera axes (degrees) from the desired pose between two times.
pub struct Errors {
    pub rms_mm: f64,
    pub max_mm: f64,
    pub rms_deg: f64,
    pub max_deg: f64,
}

/// The errors between two times.
pub fn errors(log: &RunLog, from_s: f64, to_s: f64) -> Errors {
    let inside = log.control.iter().filter(|sample| (from_s..to_s).contains(&sample.t_s));
    let errors: Vec<TrackingError> = inside.map(TrackingError::of).collect();
    assert!(errors.len() > 10, "the run reached {from_s} to {to_s} s");
    let largest = |of: fn(&TrackingError) -> f64| errors.iter().map(of).fold(0.0, f64::max);
    let rms = |of: fn(&TrackingError) -> f64| {
        (errors.iter().map(|e| of(e).powi(2)).sum::<f64>() / errors.len() as f64).sqrt()
    };
    Errors {
        rms_mm: rms(|e| e.position_m) * 1e3,
        max_mm: largest(|e| e.position_m) * 1e3,
        rms_deg: rms(|e| e.tilt_rad).to_degrees(),
        max_deg: largest(|e| e.tilt_rad).to_degrees(),
    }
}

/// The sample at a time.
pub fn at(log: &RunLog, t_s: f64) -> &ControlSample {
    log.control.iter().find(|sample| sample.t_s >= t_s).unwrap()
}

/// Displacement of the hand, and of its desired position, between two times, mm in `world`.
pub fn ways_mm(log: &RunLog, from_s: f64, to_s: f64) -> (Vector3<f64>, Vector3<f64>) {
    let (from, to) = (at(log, from_s), at(log, to_s));
    let hand = to.world_from_hand.translation_m() - from.world_from_hand.translation_m();
    let wanted = to.world_from_hand_wanted.translation_m() - from.world_from_hand_wanted.translation_m();
    (hand * 1e3, wanted * 1e3)
}
