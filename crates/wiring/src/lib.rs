//! The one place that names backends: from a setup to running parts.

pub mod arm;
mod at_once;
pub mod calibration;
mod cameras;
pub mod commissioning;
mod greeting;
mod nominal;

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use nalgebra::Point3;
use pb3dp_arm_pa10::arm::{ArmMonitor, VirtualTime, Way};
use pb3dp_arm_pa10_emulation::line::virtual_end::VirtualEnd;
use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_camera_replay::{Pacing, ReplayCamera, ReplayOptions};
use pb3dp_camera_sim::{FaultyCamera, GeometricCamera, SimCameraConfig, SimStereoCamera};
use pb3dp_camera_v4l2::linux::Linux;
use pb3dp_camera_v4l2::video::VideoSystem;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Model, Target, World};
use pb3dp_hal_api::{Clock, StereoCamera};
use pb3dp_hal_clock::{SystemClock, VirtualClock};
use pb3dp_hal_middleware::FlightLog;
use pb3dp_record::calibration_files::StereoCalibration;
use pb3dp_record::dataset::Sequence;
use pb3dp_sim::geometric::GeometricTracker;
use pb3dp_sim::placement::{
    FlangePath, PathRefusal, PathReport, PathRequirements, ToolSpeed, ToolSpeedMax, check_experiment,
};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::Scene;
use pb3dp_sim::targets;
use pb3dp_sim::trajectory::{AtRest, MotionConfig, Trajectory};

use self::arm::{EmulatedServer, MonitoredLink, WiredArms, wire_arms};
use self::at_once::at_once;
pub use greeting::{bus_doubts, geometry_doubt, watchdog_refusal};
pub use nominal::{MOCK_ARM, accept_nominal};

use pb3dp_cell::cell::{FreeTarget, SimulatedCell};
use pb3dp_cell::eyes::{Marking, NOT_MARKED, Sight};
use pb3dp_cell::flight::{self, ArmFault, Flight, LineCounts, Moment, RawLine};
use pb3dp_cell::operator::ByCommand;
use pb3dp_cell::paced_clock::PacedClock;
use pb3dp_cell::parts::{EmulatedArm, LinkMonitor, Parts};
use pb3dp_setup::region_spec::load_region;
use pb3dp_setup::setup::seeds::Stream;
use pb3dp_setup::setup::{ArmSetup, Cameras, Carrier, FrameTiming, Leader, Pace, Setup, SimulatedWorld, Truth};

/// When the frames of a recording are delivered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ReplayPace {
    /// As fast as they are worked on.
    Fast,
    /// At the times of the recording.
    Original,
}

/// A cell, and what only this module knows of its arms.
pub struct Wired {
    /// What a run steps.
    pub parts: Parts,
    /// What the links of the arms are like, by the names of the arms, as far as they have one.
    pub monitors: Vec<(&'static str, ArmMonitor)>,
    /// Far ends of arms that are emulated in simulated time, by the names of the arms.
    pub virtual_ends: Vec<(&'static str, VirtualEnd)>,
}

/// Wires the cell, and what its target does by the setup.
///
/// # Errors
/// If a part refuses its parameters, or the arms can not follow the experiment (by how much is said).
pub fn wire(setup: &Setup) -> Result<Parts> {
    Ok(wire_watched(setup)?.parts)
}

/// As [`wire`], with what only this module knows of the arms.
///
/// # Errors
/// As [`wire`].
pub fn wire_watched(setup: &Setup) -> Result<Wired> {
    wire_with(setup, Arc::new(Linux))
}

/// As [`wire`], with real cameras among the video devices of this system.
///
/// # Errors
/// As [`wire`].
pub fn wire_with(setup: &Setup, video: Arc<dyn VideoSystem>) -> Result<Wired> {
    check_marked(setup)?;
    wire_cell_with(setup, video, |cell, start| {
        let experiment = setup.experiment.motion.begin_at(start)?;
        let reports = match setup.experiment.carrier {
            Carrier::Arm => Vec::from(check_paths(setup, &*experiment)?),
            Carrier::Nothing => {
                cell.free_target = Some(FreeTarget::new(Arc::clone(&experiment)));
                look_at_free_path(setup, start)?
            }
        };
        for (name, report) in reports {
            let (joint, speed) = report.fastest_joint();
            tracing::info!(
                "{name}: smallest singular value {:.3} at {:.1} s, fastest axis {} uses {:.0} % of its allowed speed",
                report.singular_value_min.value,
                report.singular_value_min.at_s,
                joint + 1,
                speed.value * 100.0
            );
        }
        Ok(experiment)
    })
}

/// Wires the cell with a target that rests for so long on the arm that carries it, whatever the experiment of the setup is.
///
/// # Errors
/// If a part refuses its parameters.
pub fn wire_at_rest(setup: &Setup, duration: Duration) -> Result<Wired> {
    check_marked(setup)?;
    wire_to_look(setup, duration)
}

/// As [`wire_at_rest`], for who only takes pictures: nobody has to mark a target.
///
/// # Errors
/// If a part refuses its parameters.
pub fn wire_to_look(setup: &Setup, duration: Duration) -> Result<Wired> {
    let duration_s = duration.as_secs_f64();
    wire_cell(setup, |_, world_from_target| Ok(Arc::new(AtRest { world_from_target, duration_s })))
}

/// Wires the cell with a target that does what `begin` says, told where it is; whether the arms can follow nobody checks here.
///
/// # Errors
/// If a part refuses its parameters, and those of `begin`.
pub fn wire_cell(
    setup: &Setup,
    begin: impl FnOnce(&mut SimulatedCell, Pose<World, Target>) -> Result<Arc<dyn Trajectory>>,
) -> Result<Wired> {
    wire_cell_with(setup, Arc::new(Linux), begin)
}

fn wire_cell_with(
    setup: &Setup,
    video: Arc<dyn VideoSystem>,
    begin: impl FnOnce(&mut SimulatedCell, Pose<World, Target>) -> Result<Arc<dyn Trajectory>>,
) -> Result<Wired> {
    calibration::look_at(&setup.calibrations, SystemTime::now())?;
    let time = match setup.pace {
        Pace::Fast => Some(Arc::new(VirtualTime::over(Arc::new(VirtualClock::new())))),
        Pace::RealTime => Some(Arc::new(VirtualTime::over(Arc::new(PacedClock::new())))),
        Pace::Live => None,
    };
    let clock: Arc<dyn Clock> = match &time {
        Some(time) => Arc::clone(time) as Arc<dyn Clock>,
        None => Arc::new(SystemClock::new()),
    };
    let WiredArms { sites: [vs_site, tc_site], driven: [vs, tc], flights, monitors, emulated, virtual_ends, on_bus } =
        wire_arms(setup, &clock, time.as_ref())?;
    let mut cell = SimulatedCell {
        vs: vs_site,
        tc: tc_site,
        flange_from_hand: setup.controller.flange_from_hand,
        hand_from_cam_left: setup.controller.hand_from_cam_left,
        flange_from_target: setup.flange_from_target,
        free_target: None,
    };
    // What is planned is planned with what the setup says, what happens follows the truth.
    let start = cell.world_from_target_at(clock.now());
    let experiment = begin(&mut cell, start)?;
    if let Some(world) = setup.world() {
        follow_truth(&mut cell, &world.truth);
    }
    let mut cameras = None;
    let (camera, marking) = match &setup.cameras {
        Cameras::Real(real) => {
            if let Some(says) = &setup.nominal_calibration {
                nominal::look_at_arms(says, &monitors)?;
            }
            let wired = cameras::wire_real(real, setup, (video, Arc::clone(&clock)))?;
            cameras = Some(wired.identities);
            let region = real.region.as_ref().map(|region| load_region(region, real.size())).transpose()?;
            (Sight::Pictures(wired.camera), region.map_or(Marking::Nobody, Marking::Region))
        }
        Cameras::Simulated(world) => {
            let (camera, outline_m) = wire_sight(setup, world, &cell, &clock)?;
            (camera, Marking::Outline(outline_m))
        }
    };
    let parts = Parts {
        clock,
        camera,
        cameras,
        vs,
        tc,
        cell,
        experiment,
        flights,
        marking,
        links: monitors
            .iter()
            .map(|(name, monitor)| (*name, Box::new(MonitoredLink(monitor.clone())) as Box<dyn LinkMonitor>))
            .collect(),
        emulated: emulated.into_iter().map(|server| Box::new(EmulatedServer(server)) as Box<dyn EmulatedArm>).collect(),
        on_bus,
        operator: Box::new(ByCommand),
        interrupt: Arc::default(),
    };
    Ok(Wired { parts, monitors, virtual_ends })
}

/// Puts things where they truly are.
fn follow_truth(cell: &mut SimulatedCell, truth: &Truth) {
    if let Some(flange_from_cam_left) = &truth.flange_from_cam_left {
        cell.hand_from_cam_left = cell.flange_from_hand.inverse() * *flange_from_cam_left;
    }
    cell.flange_from_target = truth.flange_from_target.unwrap_or(cell.flange_from_target);
    cell.tc.world_from_base = truth.tc_world_from_base.unwrap_or(cell.tc.world_from_base);
}

/// Refuses real cameras in whose pictures nobody has marked a target.
///
/// # Errors
/// What to do.
fn check_marked(setup: &Setup) -> Result<()> {
    match setup.real_cameras() {
        Some(cameras) if cameras.region.is_none() => bail!("{NOT_MARKED}"),
        _ => Ok(()),
    }
}

/// The simulated camera, or what stands for it, and the outline of the target.
fn wire_sight(
    setup: &Setup,
    world: &SimulatedWorld,
    cell: &SimulatedCell,
    clock: &Arc<dyn Clock>,
) -> Result<(Sight, Vec<Point3<f64>>)> {
    let (poses, began) = (Box::new(cell.clone()), clock.now());
    let (clock, faults) = (Arc::clone(clock), world.faults.clone());
    let FrameTiming { period, exposure } = setup.frames;
    let timing = SimCameraConfig { period, exposure, blur_moments: world.blur_moments, pairs: None };
    match setup.leader {
        Leader::Pictures(_) => {
            let scene = Scene::build(&world.scene).context("table [scene]")?;
            let outline_m = scene.target().outline_m.clone();
            let noise = Stream::SensorNoise.narrow(setup.seed);
            let renderer = StereoRenderer::new(scene, *setup.true_rig(), &world.sensor, noise);
            let mut renderer = renderer.context("table [camera]")?;
            if setup.pace != Pace::Fast {
                // A pair has to be there before the next one.
                renderer = renderer.with_run_both(at_once);
            }
            let camera = SimStereoCamera::new(renderer, poses, clock, timing)?;
            let camera: Box<dyn StereoCamera> = match faults.list.is_empty() {
                true => Box::new(camera),
                false => Box::new(FaultyCamera::new(camera, faults, began).context("table [camera]")?),
            };
            Ok((Sight::Pictures(camera), outline_m))
        }
        Leader::Geometric(config) => {
            let target = targets::model(&world.scene.target, world.scene.seed).context("table [scene]")?;
            let tracker = GeometricTracker::new(config, *setup.true_rig(), target.outline_m.clone())?;
            let camera = GeometricCamera::new(tracker, poses, clock, &timing)?.with_faults(faults, began)?;
            Ok((Sight::Geometric(Box::new(camera)), target.outline_m))
        }
    }
}

/// Writes what both arms did in the last seconds into this folder, and says where.
pub fn write_flights(
    folder: &Path,
    flights: &[(&'static str, FlightLog)],
    monitors: &[(&'static str, ArmMonitor)],
    failure: &anyhow::Error,
    moment: Moment,
) {
    for (arm, log) in flights {
        let raw = raw_lines(monitors, arm);
        let (fault, counts) = line_facts(monitors, arm);
        match flight::write(folder, arm, &Flight { log, fault, counts, raw: &raw }, failure, moment) {
            Ok(path) => tracing::info!("what the {arm} did before: {}", path.display()),
            Err(error) => tracing::warn!("the flight recorder of the {arm}: {error:#}"),
        }
    }
}

/// What went over the line of an arm in the last seconds; nothing if it has none.
pub fn raw_lines(monitors: &[(&'static str, ArmMonitor)], arm: &str) -> Vec<RawLine> {
    let of_arm = monitors.iter().filter(|(name, _)| *name == arm);
    let pieces = of_arm.flat_map(|(_, monitor)| monitor.raw_bytes());
    pieces
        .map(|piece| RawLine { at: piece.at, is_sent: piece.way == Way::Out, bytes: piece.bytes().to_vec() })
        .collect()
}

/// Why an arm stopped, as its driver tells, and what happened on its line; nothing if it has none.
pub fn line_facts(monitors: &[(&'static str, ArmMonitor)], arm: &str) -> (Option<ArmFault>, Option<LineCounts>) {
    let Some((_, monitor)) = monitors.iter().find(|(name, _)| *name == arm) else { return (None, None) };
    let seen = monitor.snapshot();
    let fault = seen.latched.map(|latched| ArmFault {
        at: latched.at,
        joint: latched.trip.axis().map(Axis::index),
        code: latched.trip.code().map(u16::from),
        cause: latched.trip.to_string(),
        state_before: latched.state_before.to_string(),
    });
    let (link, line) = (&seen.counters, &seen.line);
    let counts = LineCounts {
        sent: link.sent,
        answered: link.answered,
        lost: link.lost,
        late: link.late,
        damaged: link.damaged,
        mismatched: link.mismatched,
        overruns: link.overruns,
        crc_errors: line.crc_errors,
        header_errors: line.header_errors,
        resyncs: line.resyncs,
        unsent: seen.frames_unsent,
    };
    (fault, Some(counts))
}

/// The camera that plays a recorded sequence, and its calibration.
///
/// # Errors
/// If the calibration can not be used.
pub fn wire_replay(sequence: &Sequence, pace: ReplayPace) -> Result<(Box<dyn StereoCamera>, StereoCalibration)> {
    let pacing = match pace {
        ReplayPace::Fast => Pacing::Unpaced,
        ReplayPace::Original => Pacing::Original(Arc::new(SystemClock::new())),
    };
    let camera = ReplayCamera::open_sequence(sequence, ReplayOptions { pacing, ..ReplayOptions::default() })?;
    let calibration = camera.calibration().clone();
    Ok((Box::new(camera), calibration))
}

/// How the hand would follow a target that nothing carries. It may move as nothing can follow, which is only told.
///
/// # Errors
/// A parameter of the motion out of its range.
fn look_at_free_path(setup: &Setup, start: Pose<World, Target>) -> Result<Vec<(&'static str, PathReport)>> {
    /// Moves that are sudden are looked at with this duration, seconds: whether the places can be reached.
    const STAND_IN_S: f64 = 2.0;
    let mut motion = setup.experiment.motion.clone();
    if let MotionConfig::Steps(steps) = &mut motion
        && steps.move_s == 0.0
    {
        steps.move_s = STAND_IN_S;
    }
    let experiment = motion.begin_at(start)?;
    Ok(match check_follower(setup, &*experiment) {
        Ok(report) => vec![("vs-robot", report)],
        Err(refusal) => {
            tracing::warn!("{refusal:#}; the target is free and moves all the same");
            Vec::new()
        }
    })
}

/// Refuses an experiment that one of the arms can not follow within its limits: reach, joint ranges, singular poses, speeds
/// and accelerations of the joints, and the speeds of the hand.
///
/// # Errors
/// The arm, by how much it falls short, and the key of the limit.
pub fn check_paths(setup: &Setup, experiment: &dyn Trajectory) -> Result<[(&'static str, PathReport); 2]> {
    let vs = check_follower(setup, experiment)?;
    let carrier = FlangePath::of_carrier(experiment, &setup.tc.world_from_base, &setup.flange_from_target);
    let tc = check_path("tc-robot", &setup.tc, &carrier, None)?;
    Ok([("vs-robot", vs), ("tc-robot", tc)])
}

fn check_follower(setup: &Setup, experiment: &dyn Trajectory) -> Result<PathReport> {
    let follower = FlangePath::of_follower(
        experiment,
        &setup.vs.world_from_base,
        &Pose::<Target, Model>::coincident(),
        &setup.controller.model_from_hand_desired,
        &setup.controller.flange_from_hand,
    );
    let tracking = setup.controller.speed.tracking;
    let hand_max =
        ToolSpeedMax { linear_m_per_s: tracking.linear_m_per_s, angular_rad_per_s: tracking.angular_rad_per_s };
    check_path("vs-robot", &setup.vs, &follower, Some(hand_max))
}

fn check_path(
    name: &str,
    arm: &ArmSetup,
    path: &FlangePath<'_>,
    tool_speed_max: Option<ToolSpeedMax>,
) -> Result<PathReport> {
    let requirements = PathRequirements { tool_speed_max, ..PathRequirements::OF_EXPERIMENT };
    check_experiment(&arm.chain, &arm.limits, &arm.start_rad, path, &requirements).map_err(|refusal| {
        let keys = keys_of(&arm.key, &refusal);
        let text = format!("the {name} can not follow the experiment (see {keys} and the table [experiment])");
        anyhow::Error::new(refusal).context(text)
    })
}

/// The keys of a setup that decide about a refusal.
fn keys_of(table: &str, refusal: &PathRefusal) -> String {
    match refusal {
        PathRefusal::JointRange { joint, .. } => format!("{table}.operating_range_deg[{joint}]"),
        PathRefusal::TooFast { .. } => "arms.speed_scale".to_owned(),
        PathRefusal::TooAbrupt { joint, .. } => format!("{table}.acceleration_max_rad_per_s2[{joint}]"),
        PathRefusal::ToolTooFast { quantity: ToolSpeed::Linear, .. } => "servo.speed.linear_max_mm_per_s".to_owned(),
        PathRefusal::ToolTooFast { quantity: ToolSpeed::Angular, .. } => "servo.speed.angular_max_deg_per_s".to_owned(),
        _ => format!("{table}.world_from_base, {table}.start_deg"),
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_camera_sim::{CameraFault, CameraFaultKind, GeometricFrame};
    use pb3dp_kinematics::StatedLimits;
    use pb3dp_setup::setup::read_setup;

    use super::*;

    /// What the cameras without images deliver in 60 periods, of which a fault takes about half.
    fn delivered(seed: u64) -> Vec<GeometricFrame> {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        let mut setup = read_setup(std::path::Path::new(file)).unwrap();
        (setup.leader, setup.compared) = (Leader::Geometric(setup.geometric.unwrap()), Vec::new());
        let kind = CameraFaultKind::Dropped { share: 0.5 };
        setup.world_mut().unwrap().faults.list =
            vec![CameraFault { kind, from: Duration::ZERO, until: Duration::from_secs(3600) }];
        setup.reseed(seed);
        let Sight::Geometric(mut camera) = wire(&setup).unwrap().camera else { panic!("images are rendered") };
        (0..60).filter_map(|_| camera.next_frame(Duration::from_secs(1)).ok()).collect()
    }

    #[test]
    fn camera_faults_differ_with_the_seed_and_one_seed_repeats_bit_for_bit() {
        let sequences = |seed| delivered(seed).iter().map(|frame| frame.sequence).collect::<Vec<_>>();
        let of_file = sequences(1);
        assert!((10..50).contains(&of_file.len()), "{of_file:?}");
        for seed in [0, 2, 3] {
            assert_ne!(sequences(seed), of_file, "seed {seed} drops the frames of seed 1");
            assert_eq!(format!("{:?}", delivered(seed)), format!("{:?}", delivered(seed)), "seed {seed}");
        }
    }

    /// The repository's setup with a change, checked against its experiment.
    fn checked(change: impl FnOnce(&mut Setup)) -> Result<[(&'static str, PathReport); 2]> {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        let mut setup = read_setup(std::path::Path::new(file)).unwrap();
        change(&mut setup);
        let world_from_flange = setup.tc.world_from_base * setup.tc.chain.forward(&setup.tc.start_rad);
        let start = world_from_flange * setup.flange_from_target;
        check_paths(&setup, &*setup.experiment.motion.begin_at(start).unwrap())
    }

    fn refusal(change: impl FnOnce(&mut Setup)) -> (PathRefusal, String) {
        let error = checked(change).unwrap_err();
        let text = format!("{error:#}");
        (error.downcast::<PathRefusal>().unwrap(), text)
    }

    #[test]
    fn the_repositorys_experiment_leaves_a_reserve_in_every_limit() {
        let [(_, vs), (_, tc)] = checked(|_| {}).unwrap();
        for (name, report) in [("vs-robot", &vs), ("tc-robot", &tc)] {
            for (joint, peak) in report.acceleration_max_rad_per_s2.iter().enumerate() {
                let allowed = if joint < 4 { 2.0 } else { 5.0 };
                assert!(peak.value < 0.8 * allowed, "{name} joint {joint}: {peak:?}");
            }
        }
        assert!(vs.tool_linear_max_m_per_s.value < 0.8 * 0.4, "{vs:?}");
        assert!(vs.tool_angular_max_rad_per_s.value < 0.8 * 45f64.to_radians(), "{vs:?}");
    }

    #[test]
    fn moves_that_the_hand_may_not_follow_are_refused_with_key_and_ratio() {
        // A turn by 20 degrees in 2 s is at most 0.327 rad/s fast, and 0.164 m/s at 500 mm.
        let (refused, text) = refusal(|setup| setup.controller.speed.tracking.linear_m_per_s = 0.1);
        assert!(matches!(refused, PathRefusal::ToolTooFast { quantity: ToolSpeed::Linear, .. }), "{text}");
        for part in ["vs-robot", "servo.speed.linear_max_mm_per_s", "[experiment]", "0.164 m/s", "1.64 times"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
        let (refused, text) = refusal(|setup| setup.controller.speed.tracking.angular_rad_per_s = 0.3);
        assert!(matches!(refused, PathRefusal::ToolTooFast { quantity: ToolSpeed::Angular, .. }), "{text}");
        for part in ["vs-robot", "servo.speed.angular_max_deg_per_s", "0.327 rad/s", "1.09 times"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
    }

    fn weaken(arm: &mut ArmSetup, joint: usize, acceleration_max_rad_per_s2: f64) {
        let limits = &arm.limits;
        let mut stated = StatedLimits {
            // Of what counts already, everything.
            servo: *limits.operating(),
            operating_min_rad: *limits.operating().position_min_rad(),
            operating_max_rad: *limits.operating().position_max_rad(),
            speed_scale: 1.0,
            acceleration_max_rad_per_s2: *limits.acceleration_max_rad_per_s2(),
            jerk_max_rad_per_s3: *limits.jerk_max_rad_per_s3(),
        };
        stated.acceleration_max_rad_per_s2[joint] = acceleration_max_rad_per_s2;
        arm.limits = stated.effective().unwrap();
    }

    #[test]
    fn moves_that_either_arms_drives_do_not_allow_are_refused_with_key_and_ratio() {
        let [(_, vs), (_, tc)] = checked(|_| {}).unwrap();
        let needed = [vs.acceleration_max_rad_per_s2[1].value, tc.acceleration_max_rad_per_s2[3].value];
        let (refused, text) = refusal(|setup| weaken(&mut setup.vs, 1, needed[0] / 2.0));
        assert!(matches!(refused, PathRefusal::TooAbrupt { joint: 1, .. }), "{text}");
        for part in ["vs-robot", "arms.vs.acceleration_max_rad_per_s2[1]", "2.00 times too much"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
        let (refused, text) = refusal(|setup| weaken(&mut setup.tc, 3, needed[1] / 3.0));
        assert!(matches!(refused, PathRefusal::TooAbrupt { joint: 3, .. }), "{text}");
        for part in ["tc-robot", "arms.tc.acceleration_max_rad_per_s2[3]", "3.00 times too much"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
    }
}
