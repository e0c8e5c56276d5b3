//! From a setup to the devices of a run: combines backends, limiter, guard and coupling.

pub mod arm;
pub mod calibration;
pub mod camera_controls;
mod cameras;
pub mod commissioning;
mod flights;
mod gateway_check;
mod key_files;
pub mod message_codes;
mod nominal_calibration;
mod parallel;
pub mod reset_standing;
mod simulated;
pub mod simulated_arms;
mod sole_program;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use anyhow::{Result, bail};
use clap::ValueEnum;
use pb3dp_arm_pa10::arm::{ArmMonitor, VirtualTime};
pub use pb3dp_camera_replay::{
    CalibrationOptions, PairsPerSecond, RecordedPairs, Recording, RecordingOptions, SkewMillis, TimedRecordingOptions,
    Topics, calibration_of,
};
use pb3dp_camera_replay::{Pacing, Repeat, ReplayOptions};
use pb3dp_camera_settings::StereoConfig;
use pb3dp_camera_v4l2::ReopeningCamera;
use pb3dp_camera_v4l2::linux::Linux;
use pb3dp_camera_v4l2::video::VideoSystem;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Target, World};
use pb3dp_hal_api::{Clock, StereoCamera};
use pb3dp_hal_clock::{SystemClock, VirtualClock};
use pb3dp_sim::pushed::PushedTarget;
use pb3dp_sim::trajectory::{AtRest, Trajectory};

use self::arm::{EmulatedServer, MonitoredLink, WiredArms, wire_arms_to};
use self::camera_controls::{BareCameras, ControlService};
use self::simulated::wire_sight;
use self::simulated_arms::SimulatedArm;
pub use flights::{line_facts, raw_lines, write_flights};
pub use gateway_check::{geometry_doubt, watchdog_refusal};
pub use key_files::check_key_files;
pub use nominal_calibration::{MOCK_ARM, accept_nominal};

use pb3dp_cell::camera_controls::ControlDesk;
use pb3dp_cell::cell::{FreeTarget, SimulatedCell};
use pb3dp_cell::lens_reading::decide_lens;
use pb3dp_cell::operator::ByCommand;
use pb3dp_cell::paced_clock::PacedClock;
use pb3dp_cell::parts::{EmulatedArm, LinkMonitor, Parts};
use pb3dp_cell::paths::check_paths;
use pb3dp_cell::perception::{NOT_MARKED, TargetSource, VisionInput};
use pb3dp_cell::selection::Selections;
use pb3dp_cell::stepped::{SteppedRun, check_simulated};
use pb3dp_setup::region_spec::load_region;
use pb3dp_setup::setup::{Carrier, Pace, Setup};

/// How long bare cameras that were lost are searched for: somebody is changing cables or lenses. Chosen; after it the command ends.
const BARE_REOPEN_FOR: Duration = Duration::from_secs(3600);

/// Delivery times of recorded frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ReplayPace {
    /// As fast as they are processed.
    Fast,
    /// At the times of the recording.
    Original,
}

/// The devices of a run, with the monitors of its arms.
pub struct Wired {
    /// The devices of a run.
    pub parts: Parts,
    /// Link monitors by the arms' names; arms without a link have none.
    pub monitors: Vec<(&'static str, ArmMonitor)>,
    /// What outlives the program in simulated time.
    pub world: VirtualWorld,
}

/// What outlives a program in simulated time: the time, and the arms that are emulated in it.
#[derive(Clone, Default)]
pub struct VirtualWorld {
    /// The time; none in real time.
    pub time: Option<Arc<VirtualTime>>,
    /// The arms.
    pub arms: Vec<SimulatedArm>,
}

/// Wires the workcell with the experiment of the setup.
///
/// # Errors
/// If a part refuses its parameters, or the arms cannot follow the experiment (with the excess).
pub fn wire(setup: &Setup) -> Result<Parts> {
    Ok(wire_watched(setup)?.parts)
}

/// As [`wire`], with the monitors of the arms.
///
/// # Errors
/// As [`wire`].
pub fn wire_watched(setup: &Setup) -> Result<Wired> {
    wire_with(setup, Arc::new(Linux))
}

/// What one run needs of its wiring.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RunNeeds {
    /// The run ends at this time, seconds of the experiment: the arms need not follow the rest.
    pub until_s: Option<f64>,
    /// The operator selects targets during the run: with real cameras none needs to be marked before.
    pub selects_targets: bool,
}

/// As [`wire_watched`], for one run.
///
/// # Errors
/// As [`wire`].
pub fn wire_run(setup: &Setup, needs: &RunNeeds) -> Result<Wired> {
    wire_experiment(setup, needs, Arc::new(Linux))
}

/// As [`wire`], with real cameras from this video system.
///
/// # Errors
/// As [`wire`].
pub fn wire_with(setup: &Setup, video: Arc<dyn VideoSystem>) -> Result<Wired> {
    wire_experiment(setup, &RunNeeds::default(), video)
}

/// A simulated run of the setup that its caller steps, with the experiment of the setup, or the first seconds of it.
///
/// # Errors
/// As [`wire`]; arms or cameras that are not simulated, before anything is opened.
pub fn wire_stepped(setup: Setup, stop_after_s: Option<f64>) -> Result<SteppedRun> {
    check_simulated(&setup)?;
    let needs = RunNeeds { until_s: stop_after_s, selects_targets: false };
    let parts = wire_run(&setup, &needs)?.parts;
    SteppedRun::start(setup, parts, stop_after_s)
}

fn wire_experiment(setup: &Setup, needs: &RunNeeds, video: Arc<dyn VideoSystem>) -> Result<Wired> {
    if !needs.selects_targets {
        check_marked(setup)?;
    }
    let mut pushed = None;
    let mut wired = wire_cell_with(setup, (video, VirtualWorld::default()), |cell, start| {
        let experiment: Arc<dyn Trajectory> = match setup.experiment.carrier {
            Carrier::Person => Arc::new(pushed.insert(PushedTarget::new(start)).clone()),
            Carrier::Arm | Carrier::Nothing => setup.experiment.motion.begin_at(start)?,
        };
        if setup.experiment.carrier != Carrier::Arm {
            cell.free_target = Some(FreeTarget::new(Arc::clone(&experiment)));
        }
        for (name, report) in check_paths(setup, &*experiment, start, needs.until_s)? {
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
    })?;
    wired.parts.pushed = pushed;
    if needs.selects_targets {
        if matches!(wired.parts.marking, TargetSource::None) {
            wired.parts.marking = TargetSource::FromOperator;
        }
        if matches!(wired.parts.camera, VisionInput::Images(_)) {
            let selections = Selections::default();
            selections.set_target_of_setup(&wired.parts.marking);
            wired.parts.selections = Some(selections);
        }
    }
    Ok(wired)
}

/// Wires the workcell with a target that is held stationary for this long, independent of the experiment of the setup.
///
/// # Errors
/// If a part refuses its parameters.
pub fn wire_at_rest(setup: &Setup, duration: Duration) -> Result<Wired> {
    check_marked(setup)?;
    wire_to_look(setup, duration)
}

/// As [`wire_at_rest`], for image capture only: no marked target is needed.
///
/// # Errors
/// If a part refuses its parameters.
pub fn wire_to_look(setup: &Setup, duration: Duration) -> Result<Wired> {
    let duration_s = duration.as_secs_f64();
    wire_cell(setup, |_, world_from_target| Ok(Arc::new(AtRest { world_from_target, duration_s })))
}

/// Wires the workcell with the target motion that `begin` returns for the start pose; the paths are not checked here.
///
/// # Errors
/// If a part refuses its parameters, and the errors of `begin`.
pub fn wire_cell(
    setup: &Setup,
    begin: impl FnOnce(&mut SimulatedCell, Pose<World, Target>) -> Result<Arc<dyn Trajectory>>,
) -> Result<Wired> {
    wire_cell_with(setup, (Arc::new(Linux), VirtualWorld::default()), begin)
}

/// As [`wire_cell`], for a program that begins in the world that another program has left.
///
/// # Errors
/// As [`wire_cell`]; an arm that is latched.
pub fn wire_cell_in(
    setup: &Setup,
    world: &VirtualWorld,
    begin: impl FnOnce(&mut SimulatedCell, Pose<World, Target>) -> Result<Arc<dyn Trajectory>>,
) -> Result<Wired> {
    wire_cell_with(setup, (Arc::new(Linux), world.clone()), begin)
}

fn wire_cell_with(
    setup: &Setup,
    (video, world): (Arc<dyn VideoSystem>, VirtualWorld),
    begin: impl FnOnce(&mut SimulatedCell, Pose<World, Target>) -> Result<Arc<dyn Trajectory>>,
) -> Result<Wired> {
    calibration::look_at(&setup.rig.calibrations, SystemTime::now())?;
    let time = match setup.pace {
        Pace::Fast if world.time.is_some() => world.time,
        Pace::Fast => Some(Arc::new(VirtualTime::over(Arc::new(VirtualClock::new())))),
        Pace::RealTime => Some(Arc::new(VirtualTime::over(Arc::new(PacedClock::new())))),
        Pace::Live => None,
    };
    let clock: Arc<dyn Clock> = match &time {
        Some(time) => Arc::clone(time) as Arc<dyn Clock>,
        None => Arc::new(SystemClock::new()),
    };
    let WiredArms { sites: [vs_site, tc_site], driven: [vs, tc], flights, monitors, emulated, standing } =
        wire_arms_to(setup, &clock, time.as_ref(), &world.arms)?;
    let mut cell = SimulatedCell::of(setup, [vs_site, tc_site]);
    // Planning uses the setup; the simulation uses the true poses.
    let start = cell.world_from_target_at(clock.now());
    let experiment = begin(&mut cell, start)?;
    let (mut cameras, mut camera_controls) = (None, None);
    let (camera, marking) = match (&setup.rig.real_cameras, &setup.world) {
        (Some(real), _) => {
            if let Some(says) = &setup.rig.nominal_calibration {
                nominal_calibration::look_at_arms(says, &monitors)?;
            }
            let wired = cameras::wire_real(real, setup, (video, Arc::clone(&clock)))?;
            (cameras, camera_controls) = (Some(wired.identities), Some(wired.controls));
            let region = real.region.as_ref().map(|region| load_region(region, real.size())).transpose()?;
            (VisionInput::Images(wired.camera), region.map_or(TargetSource::None, TargetSource::Region))
        }
        (None, Some(world)) => {
            let (camera, outline_m) = wire_sight(setup, world, &mut cell, &clock)?;
            (camera, TargetSource::Outline(outline_m))
        }
        (None, None) => bail!("the setup has neither real cameras nor a simulated world"),
    };
    let parts = Parts {
        clock,
        camera,
        cameras,
        camera_controls,
        vs,
        tc,
        cell,
        experiment,
        flights,
        keep_flights: Box::new(|_, _| {}),
        marking,
        links: monitors.iter().map(|(name, monitor)| (*name, link_of(monitor, setup.control_period))).collect(),
        emulated: emulated.into_iter().map(|server| Box::new(EmulatedServer(server)) as Box<dyn EmulatedArm>).collect(),
        operator: Box::new(ByCommand),
        spectators: Vec::new(),
        pushed: None,
        selections: None,
        interrupt: Arc::default(),
    };
    Ok(Wired { parts, monitors, world: VirtualWorld { time, arms: standing } })
}

fn link_of(monitor: &ArmMonitor, period: Duration) -> Box<dyn LinkMonitor> {
    Box::new(MonitoredLink { monitor: monitor.clone(), period })
}

/// Refuses real cameras without a marked target.
///
/// # Errors
/// No target is marked.
fn check_marked(setup: &Setup) -> Result<()> {
    match setup.rig.real_cameras.as_ref() {
        Some(cameras) if cameras.region.is_none() => bail!("{NOT_MARKED}"),
        _ => Ok(()),
    }
}

/// Two real cameras that nothing carries, with their controls. After a loss they are searched for an hour.
///
/// # Errors
/// If they cannot be used.
pub fn open_cameras(
    config: &StereoConfig,
    (system, clock): (Arc<dyn VideoSystem>, Arc<dyn Clock>),
) -> Result<(Box<dyn StereoCamera>, ControlDesk)> {
    let names = [&config.left, &config.right].map(|camera| camera.name.to_string());
    let camera = ReopeningCamera::open(system, Arc::clone(&clock), config.clone(), BARE_REOPEN_FOR)?;
    let (service, desk) = ControlService::new(clock, names);
    Ok((Box::new(BareCameras { camera, service }), desk))
}

/// The cameras of this computer.
pub fn video_system() -> Arc<dyn VideoSystem> {
    Arc::new(Linux)
}

/// A recording that is played at its pace, again and again. A program that is too slow misses pairs, as with real cameras.
///
/// # Errors
/// If the recording or its calibration cannot be used.
pub fn wire_endless_replay(
    path: &Path,
    calibration: &[PathBuf],
    asked: &RecordingOptions,
    clock: Arc<dyn Clock>,
) -> Result<Recording> {
    let options = ReplayOptions { pacing: Pacing::Live(clock), repeat: Repeat::Forever, ..ReplayOptions::default() };
    decided(Recording::open(path, calibration, asked, options)?)
}

/// Decides the lens model of a calibration that does not state it, by the first pair that can be read.
fn decided(mut recording: Recording) -> Result<Recording> {
    let calibration = recording.camera.calibration();
    if calibration.other_lens.is_none() {
        return Ok(recording);
    }
    let calibration = calibration.clone();
    let known = calibration.warnings.len();
    let pair = recording.camera.first_pair()?;
    let calibration = decide_lens(calibration, &pair.left, &pair.right)?;
    recording.warnings.extend(calibration.warnings.iter().skip(known).cloned());
    recording.camera.replace_calibration(calibration);
    Ok(recording)
}

/// A recording that is played once.
///
/// # Errors
/// If the recording or its calibration cannot be used.
pub fn wire_replay(
    path: &Path,
    calibration: &[PathBuf],
    asked: &RecordingOptions,
    pace: ReplayPace,
) -> Result<Recording> {
    let pacing = match pace {
        ReplayPace::Fast => Pacing::Unpaced,
        ReplayPace::Original => Pacing::Original(Arc::new(SystemClock::new())),
    };
    decided(Recording::open(path, calibration, asked, ReplayOptions { pacing, ..ReplayOptions::default() })?)
}

#[cfg(test)]
mod tests {
    use pb3dp_setup::setup::{Leader, read_setup};
    use pb3dp_sim::camera_faults::{CameraFault, CameraFaultKind};
    use pb3dp_sim::geometric::GeometricFrame;

    use super::*;

    fn setup_of(name: &str) -> Setup {
        let file = format!("{}/../../configs/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        read_setup(std::path::Path::new(&file)).unwrap()
    }

    /// The simulated cell without images.
    fn without_images() -> Setup {
        let mut setup = setup_of("sim");
        (setup.leader, setup.compared) = (Leader::Geometric(setup.geometric.unwrap()), Vec::new());
        setup
    }

    /// Frames from the cameras without images in 60 periods, about half of which a fault drops.
    fn delivered(seed: u64) -> Vec<GeometricFrame> {
        let mut setup = without_images();
        let kind = CameraFaultKind::Dropped { share: 0.5 };
        setup.world.as_mut().unwrap().faults.list =
            vec![CameraFault { kind, from: Duration::ZERO, until: Duration::from_secs(3600) }];
        setup.reseed(seed);
        let VisionInput::Geometric(mut camera) = wire(&setup).unwrap().camera else { panic!("images are rendered") };
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

    #[test]
    fn a_stepped_run_is_the_run_that_is_not_stepped() {
        let setup = without_images();
        let outcome = pb3dp_cell::experiment::run(&setup, wire(&setup).unwrap(), Some(1.5), None).unwrap();
        let whole: Vec<_> = outcome.log.control.iter().map(|sample| (sample.world_from_hand, sample.arms)).collect();
        let mut run = wire_stepped(setup, Some(1.5)).unwrap();
        let mut stepped = Vec::new();
        while let Some(step) = run.step().unwrap() {
            stepped.push((step.poses.unwrap().world_from_hand, step.moved.arms));
        }
        assert!(stepped == whole && stepped.len() == 151, "{} and {} steps", stepped.len(), whole.len());
        assert!(run.step().unwrap().is_none() && run.end().unwrap().is_none());
    }

    #[test]
    fn a_stepped_run_refuses_what_is_not_simulated_and_can_be_left() {
        let refused = wire_stepped(setup_of("rig"), None).err().unwrap().to_string();
        assert!(refused.contains("arms that are not simulated"), "{refused}");
        let mut run = wire_stepped(without_images(), None).unwrap();
        assert_eq!(run.step().unwrap().unwrap().moved.number, 0);
        drop(run);
        let mut run = wire_stepped(without_images(), None).unwrap();
        assert!(run.push_target(nalgebra::Vector3::x(), 0.0).is_err());
        assert!(run.end().unwrap().is_some() && run.step().unwrap().is_none());
    }
}
