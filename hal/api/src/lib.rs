//! Traits of the hardware that pb3dp needs, and their data types. No implementations.
//!
//! * [`StereoCamera`] delivers stereo pairs with the time of exposure.
//! * [`Arm`] accepts joint velocities and returns measured joints; [`ArmPower`] controls drives and brakes.
//! * [`Clock`] provides the time; all other code receives the time from it.
//!
//! Each trait defines a contract "for backend authors"; the crate `pb3dp-hal-conformance` tests a backend against it.

pub mod arm;
pub mod clock;
mod codes;
pub mod recent;
pub mod stereo_camera;

pub use arm::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, EnablePosition, JointCommand, PowerOrder};
pub use clock::Clock;
pub use pb3dp_kinematics::JointState;
pub use recent::RecentFailures;
pub use stereo_camera::{
    CameraError, CameraErrorKind, DeliveredImage, FollowedTarget, FramePair, PairExposure, StereoCamera,
    StereoCameraInfo,
};
