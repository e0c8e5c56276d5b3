//! Why a robot description cannot be used.

use crate::limits::JointLimitsError;

/// Why a robot description cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ChainError {
    /// The text is not well-formed XML, declares a document type, or has too many elements.
    #[error("the robot description cannot be read as URDF")]
    Parse(#[source] roxmltree::Error),
    /// The text is XML, but not a robot description.
    #[error("the root element is <{found}>; the root of a robot description is <robot>")]
    Root {
        /// Name of the root element.
        found: String,
    },
    /// An element of a joint is missing or repeated.
    #[error("{owner} has {count} elements <{element}>; write one")]
    Element {
        /// The joint.
        owner: String,
        /// Name of the element.
        element: &'static str,
        /// Number of these elements.
        count: usize,
    },
    /// An attribute is missing or cannot be read.
    #[error("{owner}: attribute `{attribute}` of <{element}> is {}; write {expected}", shown(.value.as_deref()))]
    Attribute {
        /// The joint or link.
        owner: String,
        /// Name of the element with the attribute.
        element: String,
        /// Name of the attribute.
        attribute: &'static str,
        /// Beginning of its value, if there is one.
        value: Option<String>,
        /// A readable value.
        expected: &'static str,
    },
    /// A requested link does not exist.
    #[error("robot `{robot}` has no link `{link}`; it has: {links}")]
    UnknownLink {
        /// Name of the robot.
        robot: String,
        /// The requested link.
        link: String,
        /// All links, separated by commas.
        links: String,
    },
    /// The tip is not connected to the base.
    #[error(
        "no chain from link `{base}` to link `{tip}`: link `{stopped_at}` is not the child of any joint; check the parent and child of its joint"
    )]
    Broken {
        /// The requested base.
        base: String,
        /// The requested tip.
        tip: String,
        /// The link at which the path to the base ends.
        stopped_at: String,
    },
    /// Two joints have the same child, or joints form a loop.
    #[error(
        "link `{link}` is the child of joint `{joint}` and of another joint, or part of a loop: the description is not a tree"
    )]
    NotATree {
        /// The link that was found twice.
        link: String,
        /// A joint that leads to it.
        joint: String,
    },
    /// A joint of an unsupported kind.
    #[error("joint `{joint}` is {kind}; only revolute (with limits) and fixed joints are supported")]
    JointKind {
        /// Name of the joint.
        joint: String,
        /// Kind of the joint.
        kind: String,
    },
    /// Too few moving joints to move a hand freely, or more than [`DOF`](crate::DOF).
    #[error("the chain from `{base}` to `{tip}` has {count} revolute joints ({joints}); 6 or 7 are supported")]
    JointCount {
        /// The requested base.
        base: String,
        /// The requested tip.
        tip: String,
        /// Number of revolute joints found.
        count: usize,
        /// Their names, separated by commas.
        joints: String,
    },
    /// A joint's limits are missing or invalid.
    #[error("joint `{joint}`: <limit> is missing or invalid; it needs lower < upper (rad) and velocity > 0 (rad/s)")]
    Limits {
        /// Name of the joint.
        joint: String,
        /// The invalid number.
        #[source]
        source: JointLimitsError,
    },
    /// A joint's axis does not have length 1.
    #[error("joint `{joint}`: axis {axis:?} has length {length}, not 1")]
    Axis {
        /// Name of the joint.
        joint: String,
        /// The axis in the file.
        axis: [f64; 3],
        /// Its length.
        length: f64,
    },
    /// A joint follows another joint.
    #[error("joint `{joint}` mimics joint `{leader}`; each joint must move on its own")]
    Mimic {
        /// Name of the joint.
        joint: String,
        /// The joint that it follows.
        leader: String,
    },
    /// A joint's origin contains a number that is not finite.
    #[error("joint `{joint}`: origin xyz {xyz:?} rpy {rpy:?} contains a number that is not finite")]
    Origin {
        /// Name of the joint.
        joint: String,
        /// Position in the file, metres.
        xyz: [f64; 3],
        /// Roll, pitch, yaw in the file, rad.
        rpy: [f64; 3],
    },
}

fn shown(value: Option<&str>) -> String {
    value.map_or("missing".into(), |value| format!("{value:?}"))
}
