//! Configuration of one measurement: one factor varied from the nominal setup.

use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_sim::targets::Paint;

use super::random::Random;

/// Cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RigKind {
    /// Two equal pinhole cameras, fx = fy = 740 px, 640 x 480, side by side.
    Parallel {
        /// Baseline, metres.
        baseline_m: f64,
    },
    /// Different focal lengths, lens distortion, 5 degrees of vergence, all axes rotated; baseline 100 mm.
    Unequal,
}

/// Target shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// The crab's outline with a relief of this height, metres; 0 is flat.
    Crab {
        /// Height, metres.
        relief_m: f64,
    },
    /// A wall that fills the image.
    Wall,
}

/// Background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Backdrop {
    /// Sand with bluish patches, at this distance behind the target's rear, metres.
    Sand {
        /// Distance, metres.
        gap_m: f64,
    },
    /// A panel with the crab's own hues, 30 mm behind.
    SameHue,
    /// Uniform grey.
    Nothing,
}

/// Lighting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Uniform.
    Even,
    /// One lamp near the cameras that does not move with the target: shading by the angle to the lamp.
    Shaded,
    /// The same lamp, with a specular highlight.
    Glossy,
}

/// The condition of both cameras.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Condition {
    /// Both cameras expose one moment, always equally long.
    #[default]
    Undisturbed,
    /// The exposure changes at every sixth frame: normal, longer, normal, shorter.
    ExposureSteps {
        /// Factor of the longer exposure; the shorter one is divided by it.
        factor: f64,
        /// Only the right camera changes; otherwise both do.
        only_right: bool,
    },
    /// An exposure of this duration.
    Blur {
        /// Duration, seconds.
        exposure_s: f64,
    },
    /// The right camera exposes later than the left one.
    Skew {
        /// Delay, seconds.
        delay_s: f64,
        /// Whether the trackers know it.
        is_known: bool,
    },
    /// Both cameras read row after row. The time of a frame is that at which the row of the target's origin is read.
    RollingShutter {
        /// Time to read all rows, seconds.
        readout_s: f64,
    },
}

impl Condition {
    /// Middle of the right exposure minus middle of the left one, if the trackers know it, seconds.
    pub fn skew_s(self) -> f64 {
        match self {
            Self::Skew { delay_s, is_known: true } => delay_s,
            _ => 0.0,
        }
    }

    /// Time in which the rows of an image are read, milliseconds; the trackers know it.
    pub fn rolling_shutter_millis(self) -> f64 {
        match self {
            Self::RollingShutter { readout_s } => 1e3 * readout_s,
            _ => 0.0,
        }
    }

    /// The frame since which the motion is judged: with a skew the second one, the first whose depth is not that of a target at rest.
    pub fn first_judged(self) -> usize {
        usize::from(self.skew_s() != 0.0)
    }

    /// Whether a frame is rendered from several moments.
    pub fn has_moments(self) -> bool {
        matches!(self, Self::Blur { .. } | Self::RollingShutter { .. })
    }
}

/// The region that the operator marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RegionKind {
    /// The target's outline.
    Outline,
    /// The rectangle around the outline.
    Rectangle,
    /// An ellipse well inside the target.
    Interior,
}

/// A setup; the default is the nominal one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Texture of the target.
    pub paint: Paint,
    /// Shape of the target.
    pub shape: Shape,
    /// Background.
    pub backdrop: Backdrop,
    /// Lighting.
    pub light: Light,
    /// Cameras.
    pub rig: RigKind,
    /// Vertical misalignment of the right image relative to the calibration, downwards, pixels.
    pub rows_off_px: f64,
    /// Standard deviation of the noise, grey levels.
    pub noise_grey: f64,
    /// Gain of the right camera, red, green, blue.
    pub gain: [f64; 3],
    /// Defocus of the right camera, standard deviation of the blur, pixels.
    pub defocus_px: f64,
    /// Share of the target's pixels in the left image that an occluder hides.
    pub occluded_share: f64,
    /// The region.
    pub region: RegionKind,
}

/// Offset of the right camera, grey levels.
pub const OFFSET_GREY: [f64; 3] = [3.0, 0.0, -2.0];

/// Blur of both lenses, pixels.
pub const LENS_BLUR_PX: f64 = 0.6;

impl Default for Setup {
    fn default() -> Self {
        Self {
            paint: Paint::Crab,
            shape: Shape::Crab { relief_m: 0.0 },
            backdrop: Backdrop::Sand { gap_m: 0.03 },
            light: Light::Even,
            rig: RigKind::Parallel { baseline_m: 0.1 },
            rows_off_px: 0.0,
            noise_grey: 3.0,
            gain: [1.06, 0.98, 0.93],
            defocus_px: 0.0,
            occluded_share: 0.0,
            region: RegionKind::Outline,
        }
    }
}

impl Setup {
    /// Baseline, metres.
    pub fn baseline_m(&self) -> f64 {
        match self.rig {
            RigKind::Parallel { baseline_m } => baseline_m,
            RigKind::Unequal => 0.1,
        }
    }

    /// Height of the target's relief, metres.
    pub fn relief_m(&self) -> f64 {
        match self.shape {
            Shape::Crab { relief_m } => relief_m,
            Shape::Wall => 0.0,
        }
    }

    /// Whether the target is a plane, so that the bound holds for the truth.
    pub fn is_planar(&self) -> bool {
        self.relief_m() == 0.0
    }
}

/// Orientation of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tilt {
    /// Both tilts uniform within plus and minus this, degrees.
    Box(f64),
    /// Exactly this, in any direction, degrees.
    Exactly(f64),
    /// Uniform up to this, in any direction, degrees.
    UpTo(f64),
}

/// Range of poses of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseRange {
    /// Nearest depth of the target's origin, metres.
    pub z_min_m: f64,
    /// Farthest, metres.
    pub z_max_m: f64,
    /// Orientations.
    pub tilt: Tilt,
}

impl PoseRange {
    /// 420 to 650 mm, both tilts up to 25 degrees.
    pub const NOMINAL: Self = Self { z_min_m: 0.42, z_max_m: 0.65, tilt: Tilt::Box(25.0) };

    /// A random tilt: the two angles of the plane hypothesis in its order of rotation, radians.
    pub fn tilt_rad(&self, random: &mut Random) -> [f64; 2] {
        let (magnitude_deg, direction) = match self.tilt {
            Tilt::Box(limit) => {
                return [(); 2].map(|()| random.between(-limit, limit).to_radians());
            }
            Tilt::Exactly(degrees) => (degrees, random.between(0.0, std::f64::consts::TAU)),
            Tilt::UpTo(degrees) => (random.between(0.0, degrees), random.between(0.0, std::f64::consts::TAU)),
        };
        let (sin, cos) = magnitude_deg.to_radians().sin_cos();
        // The normal (sin cos d, sin sin d, cos) as Ry(theta_y) Rx(theta_x) e_z.
        let (nx, ny) = (sin * direction.cos(), sin * direction.sin());
        [-ny.asin(), nx.atan2(cos)]
    }
}

/// Question that a configuration answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Question {
    /// Accuracy of the answers.
    Accuracy,
    /// Success rate of a cold start; a thousand poses.
    ColdStart,
    /// Whether the method reports that the plane is not observable; a thousand poses.
    Unobservable,
}

/// One configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Cell {
    /// Name such as `noise/8`: the factor, and its value.
    pub name: String,
    /// The value as a number, for the figures; 0 if it is not a number.
    pub value: f64,
    /// The setup.
    pub setup: Setup,
    /// The poses.
    pub poses: PoseRange,
    /// Depths and tilts that the methods search.
    pub search: SearchRange,
    /// The question.
    pub question: Question,
}

impl Cell {
    /// Name of the varied factor.
    pub fn factor(&self) -> &str {
        self.name.split('/').next().unwrap_or_default()
    }

    /// Number of poses of a full or a quick run.
    pub fn pose_count(&self, quick: bool) -> usize {
        match (self.question, quick) {
            (Question::Accuracy, false) => 200,
            (_, false) => 1000,
            (Question::Accuracy, true) => 32,
            (_, true) => 64,
        }
    }
}
