//! The one place that names backends: from a setup to running parts.

use std::sync::{Arc, Mutex};

use anyhow::{Context, Result};
use pb3dp_arm_pa10::mock::{MockArm, MockArmConfig};
use pb3dp_camera_sim::SimStereoCamera;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Model, Target};
use pb3dp_hal_api::{Arm, ArmPower, Clock, StereoCamera};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_middleware::Limiter;
use pb3dp_sim::joint_dynamics::JointPlant;
use pb3dp_sim::placement::{FlangePath, PathReport, PathRequirements, check_experiment};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::Scene;
use pb3dp_sim::trajectory::{StepExperiment, Trajectory};

use crate::config::setup::{ArmSetup, Pace, Setup, fold_seed};
use crate::run::cell::{ArmSite, SimulatedCell};
use crate::run::paced_clock::PacedClock;

/// An arm with its limiter: motion, power, and how often the limiter stepped in.
pub trait DrivenArm: Arm + ArmPower {
    /// Commands that the limiter changed or held back.
    fn limited_commands(&self) -> u64;
}

impl<A: Arm + ArmPower> DrivenArm for Limiter<A> {
    fn limited_commands(&self) -> u64 {
        let s = self.statistics();
        s.refused_not_finite + s.held_stale + s.speed_limited + s.position_limited + s.acceleration_limited
    }
}

/// Everything that a run steps.
pub struct Parts {
    /// The one clock.
    pub clock: Arc<dyn Clock>,
    /// The stereo pair.
    pub camera: Box<dyn StereoCamera>,
    /// The arm that carries the cameras.
    pub vs: Box<dyn DrivenArm>,
    /// The arm that carries the target.
    pub tc: Box<dyn DrivenArm>,
    /// The truth.
    pub cell: SimulatedCell,
    /// How the target moves.
    pub experiment: StepExperiment,
    /// Outline of the target, points in its own frame: what an operator would draw.
    pub target_outline_m: Vec<nalgebra::Point3<f64>>,
}

/// Wires the simulated cell.
///
/// # Errors
/// If a part refuses its parameters, or the arms can not follow the experiment (by how much is said).
pub fn wire(setup: &Setup) -> Result<Parts> {
    let clock: Arc<dyn Clock> = match setup.pace {
        Pace::Fast => Arc::new(VirtualClock::new()),
        Pace::RealTime => Arc::new(PacedClock::new()),
    };
    let (vs_site, vs) = wire_arm("vs-robot", &setup.vs, setup, &clock)?;
    let (tc_site, tc) = wire_arm("tc-robot", &setup.tc, setup, &clock)?;
    let cell = SimulatedCell {
        vs: vs_site,
        tc: tc_site,
        flange_from_hand: setup.controller.flange_from_hand,
        hand_from_cam_left: setup.controller.hand_from_cam_left,
        flange_from_target: setup.flange_from_target,
    };
    let start = cell.world_from_target_at(clock.now());
    let experiment = StepExperiment::new(setup.experiment.clone(), start)?;
    for (name, report) in check_paths(setup, &experiment)? {
        let (joint, speed) = report.fastest_joint();
        tracing::info!(
            "{name}: smallest singular value {:.3} at {:.1} s, fastest joint {joint} uses {:.0} % of its allowed speed",
            report.singular_value_min.value,
            report.singular_value_min.at_s,
            speed.value * 100.0
        );
    }
    let scene = Scene::build(&setup.scene).context("table [scene]")?;
    let target_outline_m = scene.target().outline_m.clone();
    let renderer =
        StereoRenderer::new(scene, setup.rig, &setup.sensor, fold_seed(setup.seed)).context("table [camera]")?;
    let camera = SimStereoCamera::new(renderer, Box::new(cell.clone()), Arc::clone(&clock), setup.camera.clone())?;
    Ok(Parts { clock, camera: Box::new(camera), vs, tc, cell, experiment, target_outline_m })
}

fn wire_arm(
    name: &str,
    arm: &ArmSetup,
    setup: &Setup,
    clock: &Arc<dyn Clock>,
) -> Result<(ArmSite, Box<dyn DrivenArm>)> {
    let plant =
        JointPlant::new(arm.plant.clone(), arm.start_rad, clock.now()).with_context(|| format!("{name}: start"))?;
    let plant = Arc::new(Mutex::new(plant));
    let config =
        MockArmConfig { name: name.to_owned(), cycle: setup.control_period, command_timeout: arm.command_timeout };
    let mock = MockArm::new(config, Arc::clone(&plant), Arc::clone(clock));
    let limiter =
        Limiter::new(mock, arm.limiter.clone(), Arc::clone(clock)).with_context(|| format!("{name}: limiter"))?;
    let site = ArmSite { chain: arm.chain.clone(), world_from_base: arm.world_from_base, plant };
    Ok((site, Box::new(limiter)))
}

/// Refuses an experiment that one of the arms can not follow within its limits.
///
/// # Errors
/// The arm, and by how much it falls short.
pub fn check_paths(setup: &Setup, experiment: &dyn Trajectory) -> Result<[(&'static str, PathReport); 2]> {
    let requirements = PathRequirements::at_speed_scale(setup.vs.limiter.speed_scale);
    let check = |name: &'static str, arm: &ArmSetup, path: &FlangePath<'_>| -> Result<(&'static str, PathReport)> {
        let limits = arm
            .limiter
            .hard_limits
            .with_position_range(arm.limiter.operating_min_rad, arm.limiter.operating_max_rad)?;
        let report = check_experiment(&arm.chain, &limits, &arm.start_rad, path, &requirements)
            .with_context(|| format!("the {name} can not follow the experiment"))?;
        Ok((name, report))
    };
    let follower = FlangePath::of_follower(
        experiment,
        &setup.vs.world_from_base,
        &Pose::<Target, Model>::coincident(),
        &setup.controller.model_from_hand_desired,
        &setup.controller.flange_from_hand,
    );
    let carrier = FlangePath::of_carrier(experiment, &setup.tc.world_from_base, &setup.flange_from_target);
    Ok([check("vs-robot", &setup.vs, &follower)?, check("tc-robot", &setup.tc, &carrier)?])
}
