//! Camera faults, targets that are hidden for a while, and the recovery after them.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_camera_sim::{SimCameraConfig, SimStereoCamera};
use pb3dp_cell::experiment;
use pb3dp_cell::log::RunLog;
use pb3dp_cell::parts::Parts;
use pb3dp_cell::perception::VisionInput;
use pb3dp_cell::supervision::Supervision;
use pb3dp_estimation::estimator::Method;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, Clock, FramePair, StereoCamera, StereoCameraInfo};
use pb3dp_servo::supervisor::{Condition, Resume};
use pb3dp_setup::setup::{Leader, Setup};
use pb3dp_sim::camera_faults::{AffectedCameras, CameraFault, CameraFaultKind};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Scene, SceneConfig};
use pb3dp_sim::targets::TargetConfig;
use pb3dp_sim::trajectory::Channel;
use pb3dp_wiring::wire;

use crate::closed_loop::geometric::QUIET;
use crate::closed_loop::support::*;

fn fault(kind: CameraFaultKind, from_s: f64, until_s: f64) -> CameraFault {
    CameraFault { kind, from: Duration::from_secs_f64(from_s), until: Duration::from_secs_f64(until_s) }
}

/// A card that moves to the right from 1 s to 2 s, with this camera fault.
fn card(faults: Vec<CameraFault>) -> Setup {
    let mut setup = quick_setup(Method::Direct, Pixels::Few, &[Channel::X]);
    setup.world.as_mut().unwrap().scene.target = TargetConfig::card();
    setup.world.as_mut().unwrap().faults.list = faults;
    setup
}

/// Path length of the hand between two times, mm.
fn hand_went_mm(log: &RunLog, from_s: f64, to_s: f64) -> f64 {
    let mut hand = log.control.iter().filter(|sample| (from_s..to_s).contains(&sample.t_s));
    let first = hand.next().unwrap().world_from_hand.translation_m();
    hand.map(|sample| (sample.world_from_hand.translation_m() - first).norm() * 1e3).fold(0.0, f64::max)
}

/// The changes of state, without the start.
fn ways(supervision: &Supervision) -> Vec<(&'static str, &'static str)> {
    supervision.transitions.iter().map(|note| (note.from, note.to)).skip_while(|(_, to)| *to != "tracking").collect()
}

/// The hand tracks the target at the end, or is approaching it.
fn goes_on(supervision: &Supervision, what: &str) {
    let last = supervision.transitions.last().unwrap();
    assert!(matches!(last.to, "approaching" | "tracking"), "{what}: {}", last.why);
}

fn last_line(supervision: &Supervision) -> &str {
    &supervision.transitions.last().unwrap().why
}

#[test]
fn a_frozen_camera_is_recognised_although_its_stamps_go_on() {
    let setup = card(vec![fault(CameraFaultKind::Frozen, 1.2, 2.2)]);
    let log = run(&setup, Some(3.0)).log;
    assert!((28..32).contains(&log.pairs_lost), "{} pairs", log.pairs_lost);
    let supervision = log.supervision.summary();
    assert!(supervision.steps_found["frame_stale"] > 50, "{supervision:?}");
    assert!(hand_went_mm(&log, 1.2, 1.5) > 1.0, "the target moves, and the hand with it");
    assert!(hand_went_mm(&log, 1.9, 2.2) < 0.05, "{} mm", hand_went_mm(&log, 1.9, 2.2));
    let way = ways(&supervision);
    assert!(way.contains(&("tracking", "holding")) || way.contains(&("tracking", "lost")), "{way:?}");
    goes_on(&supervision, "frozen");
}

/// The effect of each fault on a run without images: the hand holds while nothing is visible, and continues afterwards.
#[test]
fn without_images_a_hand_that_is_blind_rests() {
    for kind in [
        CameraFaultKind::Frozen,
        CameraFaultKind::Dropped { share: 1.0 },
        CameraFaultKind::Repeated { share: 1.0, as_new: false },
        CameraFaultKind::Black { cameras: AffectedCameras::Both },
        CameraFaultKind::Saturated { cameras: AffectedCameras::Left },
        CameraFaultKind::Torn { share: 1.0 },
        CameraFaultKind::Occluder { width_share: 0.8, crosses: false },
        CameraFaultKind::Skewed { stamped_nanos: 9_000_000 },
        CameraFaultKind::Late { pairs: 12 },
    ] {
        let setup = Setup { leader: Leader::Geometric(QUIET), ..card(vec![fault(kind, 1.2, 2.4)]) };
        let log = run(&setup, Some(3.6)).log;
        let supervision = log.supervision.summary();
        assert!(hand_went_mm(&log, 2.1, 2.4) < 0.05, "{}: {} mm", kind.name(), hand_went_mm(&log, 2.1, 2.4));
        assert!(ways(&supervision).len() >= 2, "{}: {:?}", kind.name(), supervision.transitions);
        goes_on(&supervision, kind.name());
    }
}

/// The target is hidden for this period.
fn hidden(from_s: f64, until_s: f64) -> CameraFault {
    fault(CameraFaultKind::Occluder { width_share: 0.75, crosses: false }, from_s, until_s)
}

#[test]
fn a_hidden_target_is_followed_again_by_the_policy() {
    let log = run(&card(vec![hidden(1.5, 3.5)]), Some(4.2)).log;
    let supervision = log.supervision.summary();
    assert!(hand_went_mm(&log, 2.3, 3.5) < 0.05, "{} mm", hand_went_mm(&log, 2.3, 3.5));
    let way = ways(&supervision);
    assert!(way.iter().any(|(_, to)| *to == "lost"), "{way:?}");
    goes_on(&supervision, "hidden");
}

#[test]
fn a_hidden_target_waits_for_the_operator_if_the_policy_says_so() {
    let mut setup = card(vec![hidden(1.5, 3.5)]);
    for condition in [Condition::TargetLost, Condition::EstimateStale] {
        setup.supervisor.policies.get_mut(condition).resume = Resume::ByOperator;
    }
    let log = run(&setup, Some(4.6)).log;
    let supervision = log.supervision.summary();
    assert_eq!(supervision.transitions.last().unwrap().to, "lost", "{}", last_line(&supervision));
    assert!(last_line(&supervision).starts_with("lost: "), "{}", last_line(&supervision));
    assert!(hand_went_mm(&log, 2.3, 4.6) < 0.05, "{} mm", hand_went_mm(&log, 2.3, 4.6));
}

/// A camera that shows another scene from some time on.
struct Swapped {
    cameras: [SimStereoCamera; 2],
    clock: Arc<dyn Clock>,
    at: MonotonicTime,
}

impl StereoCamera for Swapped {
    fn info(&self) -> &StereoCameraInfo {
        self.cameras[0].info()
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        let now = usize::from(self.clock.now() >= self.at);
        self.cameras[now].next_pair_into(pair, timeout)
    }
}

/// A run in which another target replaces the card at 1.8 s, while a bar hides it.
fn swapped_for(other: SceneConfig) -> RunLog {
    let setup = card(Vec::new());
    let parts = wire(&setup).unwrap();
    let Parts { clock, cell, .. } = &parts;
    let cameras = [setup.world.as_ref().unwrap().scene.clone(), other].map(|scene| {
        let renderer = StereoRenderer::new(
            Scene::build(&scene).unwrap(),
            setup.rig.stereo,
            &setup.world.as_ref().unwrap().sensor,
            5,
        )
        .unwrap();
        SimStereoCamera::new(renderer, Box::new(cell.clone()), clock.clone(), SimCameraConfig::default()).unwrap()
    });
    let at = clock.now() + Duration::from_secs_f64(1.8);
    let swapped = Swapped { cameras, clock: clock.clone(), at };
    let faults = card(vec![hidden(1.2, 2.3)]).world.as_ref().unwrap().faults.clone();
    let camera = pb3dp_camera_sim::FaultyCamera::new(swapped, faults, clock.now()).unwrap();
    let parts = Parts { camera: VisionInput::Images(Box::new(camera)), ..parts };
    experiment::run(&setup, parts, Some(3.7), None).unwrap().log
}

#[test]
fn another_target_in_the_same_place_is_not_followed() {
    let card = card(Vec::new()).world.as_ref().unwrap().scene.clone();
    let same = swapped_for(card.clone());
    goes_on(&same.supervision.summary(), "the same card is recognised");
    for (what, other) in [
        ("a crab", SceneConfig { target: TargetConfig::crab(0.01), ..card.clone() }),
        ("a card with another image", SceneConfig { seed: card.seed + 1, ..card.clone() }),
    ] {
        let log = swapped_for(other);
        let supervision = log.supervision.summary();
        let last = supervision.transitions.last().unwrap();
        assert_eq!(last.to, "lost", "{what}: {}", last.why);
        assert!(hand_went_mm(&log, 2.0, 3.7) < 0.05, "{what}: {} mm", hand_went_mm(&log, 2.0, 3.7));
    }
}
