//! The complete file of one setup, for `pb3dp run`: every table is checked and converted to parameters.

mod arms;
mod calibration;
mod camera;
pub(crate) mod camera_faults;
mod commissioning;
mod drift;
mod experiment;
mod geometric;
mod geometry;
mod image_stream;
mod link;
mod mounts;
mod range;
mod real_cameras;
pub mod seeds;
mod servo;
mod shape;
mod shared_exposure;
mod sight;
mod supervisor;
mod target_state;
mod truth;

use std::path::{Path, PathBuf};
use std::time::Duration;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use pb3dp_estimation::estimator::{EstimatorConfig, Method};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::frames::{Flange, Target};
use pb3dp_geometry::{Frame, Pose, StereoRig};
use pb3dp_servo::ControllerConfig;
use pb3dp_servo::supervisor::{Condition, SupervisorConfig};
use pb3dp_sim::camera_faults::CameraFaults;
use pb3dp_sim::geometric::GeometricConfig;
use pb3dp_sim::scene::SceneConfig;
use pb3dp_sim::sensor::SensorConfig;
use serde::Deserialize;
use serde::de::IgnoredAny;

use self::arms::{ArmSection, ArmTables, ArmsSection};
pub use self::arms::{ArmSetup, Arms, acceleration_max_rad_per_s2};
pub use self::calibration::{AGE, CAMERA_TABLE, CAMERAS, CalibrationInUse, Waiver, rounded};
use self::camera::SceneSection;
pub use self::drift::DriftConfig;
use self::drift::DriftSection;
use self::experiment::ExperimentSection;
pub use self::experiment::{Carrier, Experiment};
use self::geometric::GeometricSection;
use self::link::GATEWAY_CYCLE_MAX_MILLIS;
pub use self::link::{ArmLink, GatewayWay, SignalsSection};
use self::mounts::{Mounts, MountsSection};
use self::range::search_range;
pub use self::real_cameras::{RealCameras, Synchronisation, interval, is_for_cameras_only, read_cameras};
use self::seeds::Stream;
use self::servo::ServoSection;
use self::sight::{CameraEntry, CameraTable, VisionSettings};
use self::supervisor::SupervisorSection;
pub use self::truth::Truth;
use self::truth::TruthSection;
use super::direct::DirectSection;
use super::estimator::PublishedSection;
use super::layers::{Layers, SetupArgs};
use super::load::{Checker, ConfigError, ConfigFile, FileKind};
use super::table::Builds;

/// A checked setup.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Seed of all random numbers; [`Setup::reseed`] changes it.
    pub seed: u64,
    /// Relation of simulated time to the clock of the computer.
    pub pace: Pace,
    /// Time between two control steps.
    pub control_period: Duration,
    /// Time from the end of an exposure until its estimate reaches the controller.
    pub estimate_latency: Duration,
    /// Cameras, arms and their poses.
    pub rig: Rig,
    /// Everything that only a simulation has; `None` with real cameras.
    pub world: Option<SimulatedWorld>,
    /// Limits of the camera drift, if the setup has them.
    pub drift: Option<DriftConfig>,
    /// Estimator of the control loop.
    pub leader: Leader,
    /// Parameters of the geometric tracker, if the setup has them.
    pub geometric: Option<GeometricConfig>,
    /// Methods that estimate from the same pairs for comparison.
    pub compared: Vec<Method>,
    /// Parameters of all methods.
    pub estimator: EstimatorConfig,
    /// Search range.
    pub range: SearchRange,
    /// The visual-servo controller.
    pub controller: ControllerConfig,
    /// Settings of the supervisor.
    pub supervisor: SupervisorConfig,
    /// Longest time without a key at the console of arms that are not emulated.
    pub operator_key_within: Duration,
    /// Arms move only while the operator presses the button of the panel.
    pub hold_to_run: bool,
    /// Motion of the target.
    pub experiment: Experiment,
    /// All values with their origin.
    pub layers: Layers,
}

/// Cameras, arms, mounts and limits of a workcell, as its owner knows them. [`SimulatedWorld`] has everything that only a
/// simulation has.
#[derive(Clone, Debug)]
pub struct Rig {
    /// The stereo pair, as calibrated.
    pub stereo: StereoRig,
    /// Times of its exposures.
    pub frames: FrameTiming,
    /// The cameras of this computer; `None` if the cameras are those of a [`SimulatedWorld`].
    pub real_cameras: Option<RealCameras>,
    /// Statement of the calibration, if no cameras were measured for it (for example a drawing); no real arm moves with such a
    /// calibration.
    pub nominal_calibration: Option<String>,
    /// Calibration files in use: of the cameras, and of their mounting on the arm.
    pub calibrations: Vec<CalibrationInUse>,
    /// The arms.
    pub arms: Arms,
    /// Minimum clearance between both arms, metres.
    pub least_room_m: f64,
    /// Whether the arms were not run yet.
    pub first_run: bool,
    /// Share of the joints' speed limits, which the limits of the arms contain already.
    pub speed_scale: f64,
    /// Mounting of the target on the second arm.
    pub flange_from_target: Pose<Flange, Target>,
}

/// Times of the exposures of a stereo pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameTiming {
    /// Period.
    pub period: Duration,
    /// Exposure time.
    pub exposure: Duration,
}

/// Everything that only a simulation has.
#[derive(Clone, Debug)]
pub struct SimulatedWorld {
    /// The scene.
    pub scene: SceneConfig,
    /// Sensor model of the cameras.
    pub sensor: SensorConfig,
    /// Seed of the sensor noise.
    pub sensor_seed: u32,
    /// Moments of an exposure that are rendered and averaged: 1 for sharp images.
    pub blur_moments: u32,
    /// Camera faults.
    pub faults: CameraFaults,
    /// True values, if they differ from the setup.
    pub truth: Truth,
}

/// Estimator of the control loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leader {
    /// A method that uses images.
    Images(Method),
    /// The truth with noise; no image is rendered.
    Geometric(GeometricConfig),
}

impl Leader {
    /// Its name in configurations and reports.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Images(method) => method.name(),
            Self::Geometric(_) => geometric::NAME,
        }
    }

    /// Whether it uses images.
    pub fn needs_images(&self) -> bool {
        matches!(self, Self::Images(_))
    }
}

/// Relation of simulated time to the clock of the computer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pace {
    /// As fast as the computer can.
    Fast,
    /// One simulated second takes at least one second; the results are those of `Fast`.
    RealTime,
    /// The clock of the computer: vision and motion have their own threads, and late results arrive late.
    Live,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SetupFile {
    run: RunSection,
    #[serde(rename = "camera")]
    _camera: IgnoredAny,
    scene: Option<SceneSection>,
    truth: Option<TruthSection>,
    drift: Option<DriftSection>,
    estimator: EstimatorSection,
    servo: ServoSection,
    supervisor: SupervisorSection,
    #[serde(rename = "arms")]
    _arms: IgnoredAny,
    mounts: MountsSection,
    experiment: ExperimentSection,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RunSection {
    seed: u64,
    pace: Pace,
    control_period_millis: f64,
    estimate_latency_millis: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct EstimatorSection {
    method: String,
    compare: Vec<String>,
    z_min_mm: f64,
    z_max_mm: f64,
    tilt_max_deg: f64,
    published: PublishedSection,
    direct: DirectSection,
    geometric: Option<GeometricSection>,
}

/// A rigid transform in a file; the key names its frames.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoseEntry {
    translation_mm: [f64; 3],
    rotation_vector_deg: [f64; 3],
}

/// Largest distance between two frames on one arm, or between hand and target: the controller's bound.
const ON_THE_ARM_MM: f64 = 1e3 * ControllerConfig::LENGTH_MAX_M;
/// Largest distance of a base from the origin of the world.
const IN_THE_CELL_MM: f64 = 20_000.0;

impl PoseEntry {
    /// The transform, with at most `length_max_mm` between the origins.
    fn build<To: Frame, From: Frame>(&self, key: &str, length_max_mm: f64, check: &mut Checker) -> Pose<To, From> {
        check.numbers(&format!("{key}.translation_mm"), &self.translation_mm, -length_max_mm..=length_max_mm);
        if self.translation_mm.iter().all(|component| component.abs() <= length_max_mm) {
            let length_mm = Vector3::from(self.translation_mm).norm();
            check.number(&format!("{key}.translation_mm (its length)"), length_mm, 0.0..=length_max_mm);
        }
        check.numbers(&format!("{key}.rotation_vector_deg"), &self.rotation_vector_deg, -360.0..=360.0);
        let rotation = Vector3::from(self.rotation_vector_deg).map(f64::to_radians);
        Pose::from_parts(Vector3::from(self.translation_mm) * 1e-3, UnitQuaternion::from_scaled_axis(rotation))
    }
}

impl Setup {
    /// Whether both arms are simulated or emulated in this program, so that nothing outside it moves.
    pub fn is_emulated(&self) -> bool {
        self.rig.arms.vs.link.is_toy() && self.rig.arms.tc.link.is_toy()
    }

    /// The skew of a pair from which the policy `camera_skew` acts.
    pub fn camera_skew_max(&self) -> Duration {
        millis(self.supervisor.policies.get(Condition::CameraSkew).threshold * 1e3)
    }

    /// The rendered cameras: those of the setup, unless the truth differs.
    pub fn true_rig(&self) -> &StereoRig {
        self.world.as_ref().and_then(|world| world.truth.rig.as_ref()).unwrap_or(&self.rig.stereo)
    }
}

/// Reads and checks the setup of one file.
///
/// # Errors
/// As [`read_layers`].
pub fn read_setup(file: &Path) -> Result<Setup, ConfigError> {
    read_layers(&SetupArgs::of_file(file))
}

/// Reads and checks a setup with all its layers.
///
/// # Errors
/// An unreadable file, unknown or missing keys, values out of range; the error names file, line, key and allowed values.
pub fn read_layers(args: &SetupArgs) -> Result<Setup, ConfigError> {
    let config = ConfigFile::of(args.name().to_path_buf(), FileKind::Setup, Layers::read(args)?);
    let mut check = Checker::default();
    let setup = read_tables(&config, &mut check).map(Setup::seeded);
    config.finish(check)?;
    // Every path without a setup has a refusal.
    let lines = || "  the setup is not complete".to_owned();
    setup.ok_or_else(|| ConfigError::Values { file: args.name().to_path_buf(), lines: lines() })
}

/// Refusals of a setup with this text after `key` is set to another value, line by line.
pub(crate) fn refusals_of(name: &'static str, text: &str, key: &str, value: &str) -> Vec<String> {
    let Ok(layers) = Layers::of_text_with(name, text, &[format!("{key}={value}")]) else { return Vec::new() };
    let config = ConfigFile::of(PathBuf::from(name), FileKind::Setup, layers);
    let mut check = Checker::default();
    drop(read_tables(&config, &mut check));
    let refused = config.finish(check).err().map(|error| error.to_string());
    refused.iter().flat_map(|text| text.lines()).map(str::to_owned).collect()
}

fn read_tables(config: &ConfigFile, check: &mut Checker) -> Option<Setup> {
    let raw: Option<SetupFile> = config.all();
    let camera = config.at("camera", "").and_then(|entry: CameraEntry| entry.table(config));
    let arms = config.named_tables::<ArmsSection, ArmSection>("arms");
    let mut setup = raw?.build((&camera?, &arms?), check)?;
    setup.layers = config.layers().clone();
    Some(setup)
}

/// Two arms with the same number: swapped cables of their gateways would not be detected.
fn refuse_equal_numbers(Arms { vs, tc, .. }: &Arms, check: &mut Checker) {
    if let (Some(number), Some(same)) = (vs.link.number(), tc.link.number())
        && number == same
    {
        check.refuse(format!(
            "{}.gateway.arm = {}: {}.gateway.arm is the same; give each arm a number of its own",
            tc.key, number.0, vs.key
        ));
    }
}

/// Two arms on one line: a line has one arm.
fn refuse_one_place(Arms { vs, tc, .. }: &Arms, check: &mut Checker) {
    if let (Some((_, place)), Some((key, same))) = (vs.link.place(), tc.link.place())
        && place == same
    {
        check.refuse(format!(
            "{}.{key} = \"{place}\": {}.{key} is the same; each arm has a line of its own",
            tc.key, vs.key
        ));
    }
}

impl SetupFile {
    fn build(
        &self,
        (camera, (all_arms, arm_tables)): (&CameraTable, &(ArmsSection, ArmTables)),
        check: &mut Checker,
    ) -> Option<Setup> {
        let period_max_millis = if all_arms.has_link(arm_tables) { GATEWAY_CYCLE_MAX_MILLIS } else { 20.0 };
        let control_period_millis =
            check.limited("run.control_period_millis", self.run.control_period_millis, 2.0..=period_max_millis);
        check.number("run.estimate_latency_millis", self.run.estimate_latency_millis, 0.0..=500.0);
        let (method, compared, estimator, range) = self.estimator.build(self.run.seed, check);
        let geometric = self.estimator.geometric.as_ref().map(|section| section.build(&range, check));
        let leader = self.estimator.leader(method, geometric, check);
        let motion = (self.servo.speed_max_m_per_s(), &range);
        let sight = camera.build(motion, self.scene.as_ref(), check);
        let experiment = self.experiment.build(check);
        let size = sight.as_ref().map(|sight| sight.rig.left().size());
        let truth = self.truth.as_ref().map(|truth| truth.build(size, check)).unwrap_or_default();
        let drift = self.drift.build("drift", check);
        let arms = all_arms.build(arm_tables, control_period_millis, check);
        let mounts = self.mounts.build(check);
        let controller = self.servo.build(&mounts, check);
        let frame_period = sight.as_ref().map_or(Duration::ZERO, |sight| sight.frames.period);
        let supervisor = self.supervisor.build(frame_period, check);
        if self.servo.searches() && supervisor.search_max_s <= 0.0 {
            check.refuse("servo.search: no search is permitted without supervisor.search_max_s; set it to the seconds that one may take".to_owned());
        }
        let arms = arms?;
        self.check_pace([&arms.vs, &arms.tc], check);
        if camera.is_real() {
            self.refuse_simulation(experiment.as_ref(), check);
        }
        refuse_equal_numbers(&arms, check);
        refuse_one_place(&arms, check);
        check_shapes(&arms, &mounts, sight.as_ref().map(|sight| &sight.rig), check);
        if !check.is_clean() {
            return None;
        }
        let VisionSettings { rig, frames, real_cameras, world, nominal_calibration, calibration } = sight?;
        Some(Setup {
            seed: self.run.seed,
            pace: self.run.pace,
            control_period: millis(self.run.control_period_millis),
            estimate_latency: millis(self.run.estimate_latency_millis),
            rig: Rig {
                stereo: rig,
                frames,
                real_cameras,
                nominal_calibration,
                calibrations: calibration.into_iter().chain(mounts.calibration).collect(),
                arms,
                least_room_m: all_arms.least_room_mm * 1e-3,
                first_run: all_arms.first_run,
                speed_scale: all_arms.speed_scale,
                flange_from_target: mounts.flange_from_target,
            },
            world: world.map(|world| SimulatedWorld { truth, ..world }),
            drift,
            leader: leader?,
            geometric,
            compared,
            estimator,
            range,
            controller,
            supervisor,
            operator_key_within: Duration::from_secs_f64(self.supervisor.key_within_s()),
            hold_to_run: self.supervisor.hold_to_run,
            experiment: experiment?,
            layers: Layers::default(),
        })
    }
}

/// Checks that the shapes of arms that are not emulated enclose also the cameras and the target.
fn check_shapes(arms: &Arms, mounts: &Mounts, rig: Option<&StereoRig>, check: &mut Checker) {
    let flange_from_cam_left = mounts.flange_from_hand * mounts.hand_from_cam_left;
    let mut cameras = vec![("the left camera", flange_from_cam_left.transform_point(&Point3::origin()))];
    if let Some(rig) = rig {
        let right = Point3::from(rig.right_centre_in_cam_left());
        cameras.push(("the right camera", flange_from_cam_left.transform_point(&right)));
    }
    arms.vs.check_shape(&cameras, check);
    arms.tc.check_shape(&[("the target", mounts.flange_from_target.transform_point(&Point3::origin()))], check);
}

impl SetupFile {
    /// Real arms need the clock of the computer.
    fn check_pace(&self, arms: [&ArmSetup; 2], check: &mut Checker) {
        for arm in arms.into_iter().filter(|arm| !arm.link.is_toy() && self.run.pace != Pace::Live) {
            let key = &arm.key;
            check.refuse(format!(
                "run.pace: an arm that is not simulated in this program ({key}.backend) needs pace = \"live\""
            ));
        }
    }

    /// Settings that need simulated cameras.
    fn refuse_simulation(&self, experiment: Option<&Experiment>, check: &mut Checker) {
        let with = "with camera.backend = \"v4l2\"";
        if self.run.pace != Pace::Live {
            check.refuse(format!("run.pace: real cameras do not wait for simulated time; {with} it is \"live\""));
        }
        if self.truth.is_some() {
            check.refuse(format!("truth: {with} nobody knows it; remove the table"));
        }
        if self.estimator.is_geometric() || self.estimator.geometric.is_some() {
            check.refuse(format!(
                "estimator.geometric: {with} there is no truth that could stand for images; remove the table, and choose a method that \
                 looks at images"
            ));
        }
        if let Some((written, carrier)) = experiment.and_then(|experiment| match experiment.carrier {
            Carrier::Arm => None,
            Carrier::Nothing => Some(("free", "nothing")),
            Carrier::Person => Some(("pushed", "a person")),
        }) {
            check.refuse(format!(
                "experiment.target = {written:?}: only a simulated target is carried by {carrier}; {with} it is \"carried\""
            ));
        }
    }
}

impl EstimatorSection {
    fn build(&self, seed: u64, check: &mut Checker) -> (Option<Method>, Vec<Method>, EstimatorConfig, SearchRange) {
        let range = self.range(check);
        let method = match self.is_geometric() {
            true => None,
            false => named("estimator.method", (&self.method, geometric::ALSO_KNOWN), check),
        };
        let compared = self.compared(method, check);
        let mut published = self.published.build("estimator.published", check);
        published.rmga.seed = published.rmga.seed.wrapping_add(Stream::PublishedSearch.of(seed));
        let direct = self.direct.build("estimator.direct", published.region, check);
        let track = self.direct.build_tracker("estimator.direct", check);
        (method, compared, EstimatorConfig { published, direct, track }, range)
    }

    fn is_geometric(&self) -> bool {
        self.method == geometric::NAME
    }

    /// The estimator of the control loop; `None` if it is refused.
    fn leader(
        &self,
        method: Option<Method>,
        geometric: Option<GeometricConfig>,
        check: &mut Checker,
    ) -> Option<Leader> {
        if !self.is_geometric() {
            return method.map(Leader::Images);
        }
        if geometric.is_none() {
            let method = &self.method;
            check.refuse(format!("estimator.geometric: missing; estimator.method = {method:?} needs it"));
        }
        geometric.map(Leader::Geometric)
    }

    /// The compared methods.
    fn compared(&self, method: Option<Method>, check: &mut Checker) -> Vec<Method> {
        let compared: Vec<Method> =
            self.compare.iter().filter_map(|name| named("estimator.compare", (name, ""), check)).collect();
        let names = self.compare.join(", ");
        if compared.iter().enumerate().any(|(i, other)| Some(*other) == method || compared[..i].contains(other)) {
            check.refuse(format!(
                "estimator.compare = [{names}]: name every other method once, and not `method` itself"
            ));
        }
        if self.is_geometric() && !compared.is_empty() {
            check.refuse(format!(
                "estimator.compare = [{names}]: with method = {:?} no image is rendered, and nobody can look on",
                self.method
            ));
        }
        compared
    }

    fn range(&self, check: &mut Checker) -> SearchRange {
        search_range([self.z_min_mm, self.z_max_mm, self.tilt_max_deg], check)
    }
}

/// The method with this name; `None` if it is refused.
fn named(key: &str, (name, also): (&str, &str), check: &mut Checker) -> Option<Method> {
    Method::from_name(name).inspect_err(|error| check.refuse(format!("{key} = {name:?}: {error}{also}"))).ok()
}

/// A duration from a checked number of milliseconds; zero for NaN.
fn millis(value: f64) -> Duration {
    Duration::try_from_secs_f64(value * 1e-3).unwrap_or_default()
}
