//! Traits of the hardware that pb3dp needs, and the data that crosses them. No implementations.
//!
//! * [`StereoCamera`] delivers stereo pairs with the time of exposure.
//! * [`Arm`] takes joint velocities and returns measured joints; [`ArmPower`] switches drives and brakes.
//! * [`Clock`] tells the time; everything else is told it.
//!
//! Each trait carries a contract "for backend authors"; the crate `pb3dp-hal-conformance` tests a backend against it.

pub mod arm;
pub mod clock;
pub mod stereo_camera;

pub use arm::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, JointCommand};
pub use clock::Clock;
pub use pb3dp_kinematics::JointState;
pub use stereo_camera::{CameraError, CameraErrorKind, FramePair, StereoCamera, StereoCameraInfo};
