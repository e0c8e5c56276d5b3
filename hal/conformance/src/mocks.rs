//! Scripted doubles of the hardware traits, for unit tests of their users (see the `mockall` crate for scripting).
//!
//! For an arm with realistic behaviour, use the mock arm of `pb3dp-arm-pa10`; for a clock, the virtual clock of
//! `pb3dp-hal-clock`.

#![allow(missing_docs, reason = "generated expectations; the methods are those of the traits")]

use std::task::Poll;
use std::time::Duration;

use mockall::mock;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{
    Arm, ArmError, ArmInfo, ArmPower, ArmState, CameraError, Clock, FramePair, JointCommand, JointState, PowerOrder,
    StereoCamera, StereoCameraInfo,
};

mock! {
    /// A scripted arm and its power control.
    pub ScriptedArm {}

    impl Arm for ScriptedArm {
        fn info(&self) -> &ArmInfo;
        fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError>;
    }

    impl ArmPower for ScriptedArm {
        fn state(&self) -> ArmState;
        fn is_stopped_by_other(&self) -> bool;
        fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError>;
    }
}

mock! {
    /// A scripted camera.
    pub ScriptedCamera {}

    impl StereoCamera for ScriptedCamera {
        fn info(&self) -> &StereoCameraInfo;
        fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError>;
    }
}

mock! {
    /// A scripted clock.
    pub ScriptedClock {}

    impl Clock for ScriptedClock {
        fn now(&self) -> MonotonicTime;
        fn sleep_until(&self, deadline: MonotonicTime);
    }
}
