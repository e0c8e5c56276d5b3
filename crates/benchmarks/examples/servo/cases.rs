//! The measured cases: approaches, paths through and to singular poses, and the same with other laws.

use anyhow::{Context, Result};
use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Hand, World};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::{HybridConfig, ImageBasedConfig, LawConfig};
use pb3dp_setup::setup::{Leader, Setup};
use pb3dp_sim::trajectory::Channel;

use crate::runs::{Ran, run};
use crate::setups::{DELAYS_MILLIS, Who, geometric};
use crate::ways::{Way, approach_from, geometric_at_rest, joints_at, out_and_back, place, run_way, world_from_hand};

fn degrees(angles: [f64; 7]) -> JointVector {
    JointVector::from(angles).map(f64::to_radians)
}

fn turned(x_deg: f64, y_deg: f64, z_deg: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::new(x_deg, y_deg, z_deg).map(f64::to_radians))
}

/// Offset of the end of the approaches from the configured hand pose, metres down and ahead of the hand: the smallest
/// that leaves the arm enough range for the start.
const DOWN_M: [f64; 5] = [0.0, -0.1, 0.1, -0.2, 0.2];
const AHEAD_M: [f64; 5] = [0.2, 0.25, 0.3, 0.1, 0.0];

/// Start of an approach.
#[derive(Clone, Copy, Debug)]
pub enum Approach {
    /// At this distance from the target (metres), in a direction turned by this (degrees about x, y, z of the target).
    Off(f64, [f64; 3]),
    /// With these joints (degrees); the desired hand pose is offset by this (metres and degrees, in its axes) from the start.
    From(&'static str, [f64; 7], [f64; 3], [f64; 3]),
}

/// All approaches.
pub const APPROACHES: [Approach; 14] = [
    Approach::Off(0.9, [25.0, 0.0, 0.0]),
    Approach::Off(0.9, [-25.0, 0.0, 0.0]),
    Approach::Off(0.9, [0.0, 25.0, 0.0]),
    Approach::Off(0.9, [0.0, -25.0, 0.0]),
    Approach::Off(0.9, [0.0, 0.0, 25.0]),
    Approach::Off(0.9, [0.0, 0.0, -25.0]),
    Approach::From(
        "shoulder and wrist nearly straight",
        [10.0, 1.0, 5.0, 70.0, 20.0, -1.0, 5.0],
        [0.06, -0.04, 0.1],
        [4.0, -4.0, 15.0],
    ),
    Approach::From(
        "shoulder and wrist straight",
        [0.0, 0.0, 0.0, 70.0, 0.0, 0.0, 0.0],
        [0.0, 0.06, 0.1],
        [0.0, 0.0, 15.0],
    ),
    Approach::From("elbow nearly stretched", [0.0, 60.0, 0.0, 6.0, 0.0, 20.0, 0.0], [0.0, 0.0, -0.12], [0.0, 6.0, 0.0]),
    Approach::From(
        "elbow nearly stretched, target beyond reach",
        [0.0, 60.0, 0.0, 12.0, 0.0, 20.0, 0.0],
        [0.0, 0.0, 0.4],
        [0.0; 3],
    ),
    Approach::From(
        "2 deg from the end of axis 4",
        [0.0, 40.0, 0.0, 129.0, 0.0, -70.0, 0.0],
        [0.0, 0.0, 0.2],
        [0.0, 5.0, 0.0],
    ),
    Approach::From(
        "2 deg from the end of axis 4, target beyond it",
        [0.0, 40.0, 0.0, 129.0, 0.0, -70.0, 0.0],
        [0.0, 0.0, -0.1],
        [0.0; 3],
    ),
    Approach::From(
        "2 deg from the end of axis 2",
        [0.0, 86.0, 0.0, 60.0, 0.0, -40.0, 0.0],
        [0.05, 0.0, -0.1],
        [0.0, 0.0, 10.0],
    ),
    Approach::From(
        "2 deg from the end of axis 1",
        [168.0, 45.0, 0.0, 90.0, 0.0, -45.0, 0.0],
        [0.06, 0.0, 0.05],
        [0.0, 0.0, -10.0],
    ),
];

/// Whether the desired hand pose is reachable.
fn is_reachable(case: &Approach) -> bool {
    !matches!(case, Approach::From(name, ..) if name.contains("beyond"))
}

impl Approach {
    /// Name in tables.
    pub fn name(&self) -> String {
        match self {
            Self::Off(distance_m, turned) => {
                let axes = ["x", "y", "z"];
                let (axis, angle) =
                    (0..3).map(|i| (axes[i], turned[i])).find(|(_, angle)| *angle != 0.0).unwrap_or(("x", 0.0));
                format!("{:.0} mm from the target, {angle:+.0} deg about {axis}", distance_m * 1e3)
            }
            Self::From(name, ..) => (*name).to_owned(),
        }
    }

    /// The run of this approach.
    ///
    /// # Errors
    /// If no joints reach the start pose.
    pub fn setup(&self, mut setup: Setup) -> Result<Setup> {
        match *self {
            Self::Off(distance_m, [x, y, z]) => {
                let here = world_from_hand(&setup, &setup.rig.arms.vs.start_rad);
                let begins = |(down_m, ahead_m): (f64, f64)| {
                    let to = here * Pose::<Hand, Hand>::from_translation(Vector3::new(0.0, down_m, ahead_m));
                    joints_at(&setup, &to, &setup.rig.arms.vs.start_rad)?;
                    approach_from(setup.clone(), &to, distance_m, &turned(x, y, z))
                };
                let places = DOWN_M.into_iter().flat_map(|down_m| AHEAD_M.map(|ahead_m| (down_m, ahead_m)));
                let found = places.map(begins).find(Result::is_ok);
                found.context("no target pose makes the start of the approach reachable")?
            }
            Self::From(_, start_deg, shift_m, [x, y, z]) => {
                let start_rad = degrees(start_deg);
                let by = Pose::<Hand, Hand>::from_parts(shift_m.into(), turned(x, y, z));
                let to = world_from_hand(&setup, &start_rad) * by;
                place(&mut setup, start_rad, &to);
                geometric_at_rest(setup)
            }
        }
    }
}

/// Result of an approach, with its expected outcome.
pub struct Approached {
    /// The result.
    pub way: Way,
    /// Whether the desired hand pose is reachable.
    pub is_reachable: bool,
}

/// Runs an approach.
///
/// # Errors
/// Errors of the parts.
pub fn approach(case: &Approach) -> Result<Approached> {
    let setup = case.setup(Who::Ours.setup(DELAYS_MILLIS[0])?)?;
    Ok(Approached { way: run_way(case.name(), &setup)?, is_reachable: is_reachable(case) })
}

/// A path through or to a singular pose.
#[derive(Clone, Copy, Debug)]
pub struct Singular {
    /// Name in tables.
    pub name: &'static str,
    /// Joints on the path (degrees), and the offset of its start from them (metres, along and across, in `world`).
    on_the_way_deg: [f64; 7],
    before_m: [f64; 3],
    /// Initial guess of the joints at the start (degrees).
    guess_deg: [f64; 7],
    /// Distance that the target moves along x of `world`, metres, and the time that it takes.
    way_m: f64,
    way_s: f64,
    /// Whether the whole path is within reach.
    pub is_reachable: bool,
}

const STRAIGHT_WRIST: [f64; 7] = [0.0, 0.0, 0.0, 70.0, 0.0, 0.0, 0.0];
const BEFORE_STRAIGHT_WRIST: [f64; 7] = [0.0, -10.0, 0.0, 75.0, 0.0, 5.0, 0.0];
const BENT: [f64; 7] = [0.0, 57.0, 0.0, 58.0, 0.0, -25.0, 0.0];

/// All of these paths.
pub const SINGULAR: [Singular; 5] = [
    Singular {
        name: "through q2 = q6 = 0",
        on_the_way_deg: STRAIGHT_WRIST,
        before_m: [-0.1, 0.0, 0.0],
        guess_deg: BEFORE_STRAIGHT_WRIST,
        way_m: 0.2,
        way_s: 4.0,
        is_reachable: true,
    },
    Singular {
        name: "10 mm from q2 = q6 = 0",
        on_the_way_deg: STRAIGHT_WRIST,
        before_m: [-0.1, 0.01, 0.0],
        guess_deg: BEFORE_STRAIGHT_WRIST,
        way_m: 0.2,
        way_s: 4.0,
        is_reachable: true,
    },
    Singular {
        name: "30 mm from q2 = q6 = 0",
        on_the_way_deg: STRAIGHT_WRIST,
        before_m: [-0.1, 0.03, 0.0],
        guess_deg: BEFORE_STRAIGHT_WRIST,
        way_m: 0.2,
        way_s: 4.0,
        is_reachable: true,
    },
    Singular {
        name: "to q4 = 0 and back",
        on_the_way_deg: BENT,
        before_m: [0.0; 3],
        guess_deg: BENT,
        way_m: 0.1137,
        way_s: 3.0,
        is_reachable: true,
    },
    Singular {
        name: "150 mm beyond reach and back",
        on_the_way_deg: BENT,
        before_m: [0.0; 3],
        guess_deg: BENT,
        way_m: 0.2637,
        way_s: 4.0,
        is_reachable: false,
    },
];

/// Follows a target through or to a singular pose.
///
/// # Errors
/// Errors of the parts.
pub fn singular(case: &Singular) -> Result<Way> {
    let mut setup = Who::Ours.setup(DELAYS_MILLIS[0])?;
    let on_the_way = world_from_hand(&setup, &degrees(case.on_the_way_deg));
    let begin: Pose<World, Hand> =
        Pose::from_parts(on_the_way.translation_m() + Vector3::from(case.before_m), on_the_way.rotation());
    let start_rad = joints_at(&setup, &begin, &degrees(case.guess_deg)).context("start of the path")?;
    place(&mut setup, start_rad, &begin);
    let motion = out_and_back(Channel::X, case.way_m, case.way_s);
    let mut setup = geometric(setup, motion)?;
    if let Leader::Geometric(config) = &mut setup.leader {
        config.z_max_m = 1.0;
    }
    run_way(case.name, &setup)
}

/// The compared control laws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// The default law.
    FeedForward,
    /// The law of the paper's group.
    Published,
    /// Image-based: points of the model in the image.
    ImageBased,
    /// 2 1/2-D visual servoing.
    Hybrid,
}

/// Half the side of the square of points, metres: about the target's size.
const POINTS_HALF_WIDTH_M: f64 = 0.05;

impl Law {
    /// All laws.
    pub const ALL: [Self; 4] = [Self::FeedForward, Self::Published, Self::ImageBased, Self::Hybrid];

    /// Name as in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::FeedForward => "feed-forward",
            Self::Published => "published",
            Self::ImageBased => "image-based",
            Self::Hybrid => "hybrid",
        }
    }

    /// The setup with this law; laws without feed-forward get the gain and the smoothing of the published law.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn setup(self) -> Result<Setup> {
        let who = if self == Self::FeedForward { Who::Ours } else { Who::Published };
        let mut setup = who.setup(DELAYS_MILLIS[0])?;
        if let LawConfig::Published(law) = setup.controller.law {
            let (gain_per_s, target_filter) = (law.gains.position_per_s, law.target_filter);
            setup.controller.law = match self {
                Self::ImageBased => LawConfig::ImageBased(ImageBasedConfig {
                    gain_per_s,
                    half_width_m: POINTS_HALF_WIDTH_M,
                    target_filter,
                }),
                Self::Hybrid => LawConfig::Hybrid(HybridConfig { gain_per_s, target_filter }),
                Self::FeedForward | Self::Published => setup.controller.law,
            };
        }
        Ok(setup)
    }
}

/// Results of one law: the experiment of Fig. 7, and approaches from far away.
pub struct LawFindings {
    /// The law.
    pub law: Law,
    /// The experiment, without images.
    pub fig7: Ran,
    /// The approaches.
    pub ways: Vec<Way>,
}

/// Approaches in which the laws differ: distance and rotation.
pub const FAR: [Approach; 5] = [
    Approach::Off(0.5, [0.0, 0.0, 30.0]),
    Approach::Off(0.5, [0.0, 0.0, 60.0]),
    Approach::Off(0.5, [0.0, 0.0, 90.0]),
    Approach::Off(0.7, [0.0, 25.0, 0.0]),
    Approach::Off(0.9, [25.0, 0.0, 0.0]),
];

/// Runs everything with one law.
///
/// # Errors
/// Errors of the parts.
pub fn law_findings(law: Law, far: &[Approach]) -> Result<LawFindings> {
    let setup = law.setup()?;
    let motion = setup.experiment.motion.clone();
    let fig7 = run(&geometric(setup, motion)?, None)?;
    let ways = far.iter().map(|case| {
        let name = case.name();
        case.setup(law.setup()?).and_then(|setup| run_way(name.clone(), &setup)).context(name)
    });
    Ok(LawFindings { law, fig7, ways: ways.collect::<Result<_>>()? })
}
