//! Target motions: the twelve marked steps of the paper's Fig. 7, and sinusoids for the frequency response.
//!
//! A trajectory gives the target pose in `world` as a function of the seconds since its start. Rotations turn the target about
//! its own origin, which stays fixed. Time is an input; nothing here reads a clock.

use std::f64::consts::TAU;
use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::frames::{Target, World};
use pb3dp_geometry::{Pose, Twist};

/// One of the six motion axes of the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Channel {
    /// Translation along x.
    X,
    /// Translation along y.
    Y,
    /// Translation along z.
    Z,
    /// Rotation about x.
    Rx,
    /// Rotation about y.
    Ry,
    /// Rotation about z.
    Rz,
}

impl Channel {
    /// All six in the order of the experiment.
    pub const ALL: [Self; 6] = [Self::X, Self::Y, Self::Z, Self::Rx, Self::Ry, Self::Rz];

    /// Name in files, tables and marks: `x`, `y`, `z`, `rx`, `ry`, `rz`.
    pub fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::Rx => "rx",
            Self::Ry => "ry",
            Self::Rz => "rz",
        }
    }

    /// The channel with this [`Self::name`].
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|channel| channel.name() == name)
    }

    /// Whether the channel rotates the target; otherwise it translates it.
    pub fn is_rotation(self) -> bool {
        matches!(self, Self::Rx | Self::Ry | Self::Rz)
    }

    /// Direction of the translation or axis of the rotation, in the experiment's axes.
    fn axis(self) -> Vector3<f64> {
        match self {
            Self::X | Self::Rx => Vector3::x(),
            Self::Y | Self::Ry => Vector3::y(),
            Self::Z | Self::Rz => Vector3::z(),
        }
    }
}

/// The frame whose axes are meant by x, y, z of an experiment. The axes stay fixed while the target moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExperimentAxes {
    /// The axes of `world`: z up.
    World,
    /// The axes of `target` at the start: for a target that faces the hand these are the hand's axes too (x right, y down,
    /// z away from the cameras).
    TargetAtStart,
}

/// A time in the experiment that reports and plots mark.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Number from 1, as (1) to (12) in Fig. 7.
    pub number: usize,
    /// Seconds since the start of the trajectory.
    pub at_s: f64,
    /// The motion that begins here: `x +100 mm`, `rz back`.
    pub label: String,
}

/// Why a trajectory was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// A number is out of its range.
    #[error("trajectory parameter {key} is {value}; allowed is {allowed}")]
    Parameter {
        /// Name of the parameter.
        key: &'static str,
        /// Its value.
        value: f64,
        /// The allowed values.
        allowed: &'static str,
    },
    /// Nothing would move.
    #[error("trajectory parameter channels is empty; give at least one of x, y, z, rx, ry, rz")]
    NoChannels,
}

/// A motion of the target in the workcell.
pub trait Trajectory: Send + Sync {
    /// Target pose `t_s` seconds after the start; the start pose before it, the last pose after the end.
    fn pose_at(&self, t_s: f64) -> Pose<World, Target>;

    /// Velocity of the target's origin and its angular velocity at that time, both expressed in `world`.
    fn twist_at(&self, t_s: f64) -> Twist<World>;

    /// The marks for reports, in the order of time.
    fn marks(&self) -> &[Mark];

    /// Duration, seconds.
    fn duration_s(&self) -> f64;
}

/// Parameters of the step experiment; negative lengths and angles reverse the direction.
#[derive(Clone, Debug, PartialEq)]
pub struct StepExperimentConfig {
    /// The channels that move, one after another, each out and back.
    pub channels: Vec<Channel>,
    /// Displacement of a translation, metres, -1 to 1.
    pub translation_m: f64,
    /// Angle of a rotation, radians, -pi to pi (exclusive).
    pub rotation_rad: f64,
    /// Duration of each move, seconds, 0.05 to 600; or 0: an instantaneous jump, which no arm could follow.
    pub move_s: f64,
    /// Hold time after each move, seconds, 0 to 600; 0.05 to 600 after jumps.
    pub hold_s: f64,
    /// Hold time before the first move, seconds, 0 to 600: time for the hand to reach its pose.
    pub lead_in_s: f64,
    /// The frame of the axes.
    pub axes: ExperimentAxes,
}

impl Default for StepExperimentConfig {
    /// The experiment of Fig. 7: six channels, 100 mm, 20 degrees, moves of 2 s, holds of 3 s.
    fn default() -> Self {
        Self {
            channels: Channel::ALL.to_vec(),
            translation_m: 0.1,
            rotation_rad: 20f64.to_radians(),
            move_s: 2.0,
            hold_s: 3.0,
            lead_in_s: 3.0,
            axes: ExperimentAxes::TargetAtStart,
        }
    }
}

/// The experiment of Fig. 7: each channel in turn moves out and back by minimum-jerk moves with holds between them.
#[derive(Clone, Debug)]
pub struct StepExperiment {
    config: StepExperimentConfig,
    frame: StartFrame,
    marks: Vec<Mark>,
}

impl StepExperiment {
    /// The experiment that starts with the target at `world_from_target`.
    ///
    /// # Errors
    /// A parameter out of its range, or no channel.
    pub fn new(config: StepExperimentConfig, world_from_target: Pose<World, Target>) -> Result<Self, TrajectoryError> {
        if config.channels.is_empty() {
            return Err(TrajectoryError::NoChannels);
        }
        check_amplitudes(config.translation_m, config.rotation_rad)?;
        if config.move_s == 0.0 {
            in_range("hold_s", config.hold_s, 0.05, 600.0, "0.05 to 600 s after sudden moves")?;
        } else {
            in_range("move_s", config.move_s, 0.05, 600.0, "0, or 0.05 to 600 s")?;
            in_range("hold_s", config.hold_s, 0.0, 600.0, "0 to 600 s")?;
        }
        in_range("lead_in_s", config.lead_in_s, 0.0, 600.0, "0 to 600 s")?;
        let frame = StartFrame::new(config.axes, world_from_target)?;
        let marks = step_marks(&config);
        Ok(Self { config, frame, marks })
    }

    /// Displacement along the active channel, and its rate.
    fn displacement(&self, t_s: f64) -> Displacement {
        let slot_s = self.config.move_s + self.config.hold_s;
        let into_s = t_s - self.config.lead_in_s;
        let last = 2 * self.config.channels.len() - 1;
        let slot = if into_s > 0.0 { ((into_s / slot_s) as usize).min(last) } else { 0 };
        let channel = self.config.channels[slot / 2];
        let into_slot_s = into_s - slot as f64 * slot_s;
        let (share, share_per_s) = if self.config.move_s > 0.0 {
            let (share, rate) = minimum_jerk(into_slot_s / self.config.move_s);
            (share, rate / self.config.move_s)
        } else {
            (if into_slot_s >= 0.0 { 1.0 } else { 0.0 }, 0.0)
        };
        let outward = slot.is_multiple_of(2);
        let (share, sign) = if outward { (share, 1.0) } else { (1.0 - share, -1.0) };
        let way = way(channel, self.config.translation_m, self.config.rotation_rad);
        Displacement { channel, value: way * share, rate: sign * way * share_per_s }
    }
}

impl Trajectory for StepExperiment {
    fn pose_at(&self, t_s: f64) -> Pose<World, Target> {
        self.frame.pose(&self.displacement(t_s))
    }

    fn twist_at(&self, t_s: f64) -> Twist<World> {
        self.frame.twist(&self.displacement(t_s))
    }

    fn marks(&self) -> &[Mark] {
        &self.marks
    }

    fn duration_s(&self) -> f64 {
        let slots = 2.0 * self.config.channels.len() as f64;
        self.config.lead_in_s + slots * (self.config.move_s + self.config.hold_s)
    }
}

/// A stationary target.
#[derive(Clone, Debug)]
pub struct AtRest {
    /// Pose of the target.
    pub world_from_target: Pose<World, Target>,
    /// Duration, seconds.
    pub duration_s: f64,
}

impl Trajectory for AtRest {
    fn pose_at(&self, _t_s: f64) -> Pose<World, Target> {
        self.world_from_target
    }

    fn twist_at(&self, _t_s: f64) -> Twist<World> {
        Twist::zero()
    }

    fn marks(&self) -> &[Mark] {
        &[]
    }

    fn duration_s(&self) -> f64 {
        self.duration_s
    }
}

/// Parameters of a sinusoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SineConfig {
    /// The channel that moves.
    pub channel: Channel,
    /// Amplitude: metres, -1 to 1, or radians, -pi to pi (exclusive).
    pub amplitude: f64,
    /// Duration of one period, seconds, 0.1 to 600.
    pub period_s: f64,
    /// Periods at full amplitude, 1 to 1000.
    pub periods: u32,
    /// Hold time before the motion, seconds, 0 to 600.
    pub lead_in_s: f64,
    /// The frame of the axes.
    pub axes: ExperimentAxes,
}

impl SineConfig {
    /// Start and end of the part at full amplitude, seconds; used for the frequency response.
    pub fn steady_s(&self) -> (f64, f64) {
        let from = self.lead_in_s + self.period_s;
        (from, from + self.period_s * f64::from(self.periods))
    }
}

/// A sinusoid on one channel: grows over one period, stays at full amplitude, fades over one period. Position, velocity and
/// acceleration are continuous, so that an arm can follow from standstill.
#[derive(Clone, Debug)]
pub struct Sine {
    config: SineConfig,
    frame: StartFrame,
    marks: Vec<Mark>,
}

impl Sine {
    /// The sinusoid about `world_from_target`.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(config: SineConfig, world_from_target: Pose<World, Target>) -> Result<Self, TrajectoryError> {
        if config.channel.is_rotation() {
            check_amplitudes(0.0, config.amplitude)?;
        } else {
            check_amplitudes(config.amplitude, 0.0)?;
        }
        in_range("period_s", config.period_s, 0.1, 600.0, "0.1 to 600 s")?;
        in_range("periods", f64::from(config.periods), 1.0, 1000.0, "1 to 1000")?;
        in_range("lead_in_s", config.lead_in_s, 0.0, 600.0, "0 to 600 s")?;
        let frame = StartFrame::new(config.axes, world_from_target)?;
        let marks = sine_marks(&config);
        Ok(Self { config, frame, marks })
    }

    /// As [`SineConfig::steady_s`].
    pub fn steady_s(&self) -> (f64, f64) {
        self.config.steady_s()
    }

    fn displacement(&self, t_s: f64) -> Displacement {
        let SineConfig { channel, amplitude, period_s, periods, lead_in_s, .. } = self.config;
        let turns = (t_s - lead_in_s) / period_s;
        let (rise, rise_rate) = minimum_jerk(turns);
        let (fall, fall_rate) = minimum_jerk(turns - 1.0 - f64::from(periods));
        let (envelope, envelope_rate) = (rise - fall, (rise_rate - fall_rate) / period_s);
        let (sin, cos) = (TAU * turns).sin_cos();
        Displacement {
            channel,
            value: amplitude * envelope * sin,
            rate: amplitude * (envelope_rate * sin + envelope * cos * TAU / period_s),
        }
    }
}

impl Trajectory for Sine {
    fn pose_at(&self, t_s: f64) -> Pose<World, Target> {
        self.frame.pose(&self.displacement(t_s))
    }

    fn twist_at(&self, t_s: f64) -> Twist<World> {
        self.frame.twist(&self.displacement(t_s))
    }

    fn marks(&self) -> &[Mark] {
        &self.marks
    }

    fn duration_s(&self) -> f64 {
        self.config.lead_in_s + self.config.period_s * f64::from(self.config.periods + 2)
    }
}

/// A motion of the target, by its parameters.
#[derive(Clone, Debug, PartialEq)]
pub enum MotionConfig {
    /// Moves out and back with holds between them.
    Steps(StepExperimentConfig),
    /// A sinusoid of one channel.
    Sine(SineConfig),
}

impl MotionConfig {
    /// The motion that starts with the target at `world_from_target`.
    ///
    /// # Errors
    /// A parameter out of its range, or no channel.
    pub fn begin_at(&self, world_from_target: Pose<World, Target>) -> Result<Arc<dyn Trajectory>, TrajectoryError> {
        Ok(match self {
            Self::Steps(config) => Arc::new(StepExperiment::new(config.clone(), world_from_target)?),
            Self::Sine(config) => Arc::new(Sine::new(*config, world_from_target)?),
        })
    }

    /// The frame of the axes.
    pub fn axes(&self) -> ExperimentAxes {
        match self {
            Self::Steps(config) => config.axes,
            Self::Sine(config) => config.axes,
        }
    }

    /// Whether the target jumps.
    pub fn is_sudden(&self) -> bool {
        matches!(self, Self::Steps(config) if config.move_s == 0.0)
    }
}

/// Displacement (m or rad) and velocity (per second) of the target along one channel.
struct Displacement {
    channel: Channel,
    value: f64,
    rate: f64,
}

/// Start pose of the target, and the axes of the channels.
#[derive(Clone, Copy, Debug)]
struct StartFrame {
    start: Pose<World, Target>,
    /// Rotation `world_from_axes`.
    world_from_axes: UnitQuaternion<f64>,
}

impl StartFrame {
    fn new(axes: ExperimentAxes, start: Pose<World, Target>) -> Result<Self, TrajectoryError> {
        if !start.is_finite() {
            let value = f64::NAN;
            return Err(TrajectoryError::Parameter { key: "world_from_target", value, allowed: "finite numbers" });
        }
        let world_from_axes = match axes {
            ExperimentAxes::World => UnitQuaternion::identity(),
            ExperimentAxes::TargetAtStart => start.rotation(),
        };
        Ok(Self { start, world_from_axes })
    }

    fn pose(&self, displacement: &Displacement) -> Pose<World, Target> {
        let along = self.world_from_axes * displacement.channel.axis() * displacement.value;
        if displacement.channel.is_rotation() {
            let turn = UnitQuaternion::from_scaled_axis(along);
            Pose::from_parts(self.start.translation_m(), turn * self.start.rotation())
        } else {
            Pose::from_parts(self.start.translation_m() + along, self.start.rotation())
        }
    }

    fn twist(&self, displacement: &Displacement) -> Twist<World> {
        let along = self.world_from_axes * displacement.channel.axis() * displacement.rate;
        if displacement.channel.is_rotation() {
            Twist::new(Vector3::zeros(), along)
        } else {
            Twist::new(along, Vector3::zeros())
        }
    }
}

/// Position (share of the displacement, 0 to 1) of a minimum-jerk move at the share `s` of its time, and its derivative with
/// respect to `s`.
fn minimum_jerk(s: f64) -> (f64, f64) {
    let s = s.clamp(0.0, 1.0);
    let share = s * s * s * (10.0 + s * (-15.0 + s * 6.0));
    let rate = 30.0 * s * s * (1.0 - s) * (1.0 - s);
    (share, rate)
}

fn way(channel: Channel, translation_m: f64, rotation_rad: f64) -> f64 {
    if channel.is_rotation() { rotation_rad } else { translation_m }
}

/// `+100 mm` or `-20 deg`: millimetres and degrees for display.
fn way_text(channel: Channel, way: f64) -> String {
    if channel.is_rotation() { format!("{:+.4} deg", way.to_degrees()) } else { format!("{:+.4} mm", way * 1e3) }
        .replace(".0000", "")
}

fn step_marks(config: &StepExperimentConfig) -> Vec<Mark> {
    let slot_s = config.move_s + config.hold_s;
    let mut marks = Vec::with_capacity(2 * config.channels.len());
    for channel in &config.channels {
        let out = way_text(*channel, way(*channel, config.translation_m, config.rotation_rad));
        for what in [out.as_str(), "back"] {
            let at_s = config.lead_in_s + slot_s * marks.len() as f64;
            marks.push(Mark { number: marks.len() + 1, at_s, label: format!("{} {what}", channel.name()) });
        }
    }
    marks
}

fn sine_marks(config: &SineConfig) -> Vec<Mark> {
    let name = config.channel.name();
    let full_s = config.lead_in_s + config.period_s;
    let amplitude = way_text(config.channel, config.amplitude);
    let fade_s = full_s + config.period_s * f64::from(config.periods);
    [
        (config.lead_in_s, format!("{name} rises")),
        (full_s, format!("{name} {amplitude} every {} s", config.period_s)),
        (fade_s, format!("{name} fades")),
    ]
    .into_iter()
    .enumerate()
    .map(|(index, (at_s, label))| Mark { number: index + 1, at_s, label })
    .collect()
}

fn check_amplitudes(translation_m: f64, rotation_rad: f64) -> Result<(), TrajectoryError> {
    in_range("translation_m", translation_m, -1.0, 1.0, "-1 to 1 m")?;
    let just_under_pi = std::f64::consts::PI - 1e-9;
    in_range("rotation_rad", rotation_rad, -just_under_pi, just_under_pi, "more than -pi and less than pi rad")
}

fn in_range(key: &'static str, value: f64, min: f64, max: f64, allowed: &'static str) -> Result<(), TrajectoryError> {
    if value >= min && value <= max { Ok(()) } else { Err(TrajectoryError::Parameter { key, value, allowed }) }
}
