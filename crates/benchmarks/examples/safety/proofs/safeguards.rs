//! The safeguards that prevent wrong arm motion, by name, and runs without some of them.
//!
//! No program contains a switch: `cargo xtask bench safety --disabled` puts the switches of tests/safeguards.toml into a copy of the work tree.

/// Whether this build has the switches.
pub const HAS_SWITCHES: bool = false;

macro_rules! safeguards {
    ($($name:ident $text:literal $what:literal)*) => {
        /// A safeguard against wrong arm motion.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Safeguard {
            $(#[doc = $what] $name,)*
        }

        impl Safeguard {
            /// All safeguards.
            #[cfg(test)]
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// Name in tables: the component, then the checked quantity.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$name => $text,)* }
            }

            /// Description, a sentence without a full stop.
            pub const fn what(self) -> &'static str {
                match self { $(Self::$name => $what,)* }
            }
        }
    };
}

safeguards! {
    EmergencyStop "supervisor: emergency_stop" "Both arms stop when an arm reports an emergency stop"
    ArmFault "supervisor: arm_fault" "Both arms stop when an arm has a fault"
    ArmDisabled "supervisor: arm_disabled" "The hand holds while the drives of an arm are disabled, until the operator's command"
    ClockStepped "supervisor: clock_stepped" "Both arms hold after a step of the clock"
    OperatorSilent "supervisor: operator_silent" "Both arms stop without an operator heartbeat"
    JointsStale "supervisor: joints_stale" "Both arms hold without fresh joint measurements of both arms"
    Miscalibrated "supervisor: miscalibrated" "The hand holds when the images contradict the calibration"
    TargetChanged "supervisor: target_changed" "The hand holds when the tracked target is not the started one"
    FrameStale "supervisor: frame_stale" "The hand holds without fresh images"
    FrameOrder "supervisor: frame_order" "The hand holds when images arrive out of order"
    TargetLost "supervisor: target_lost" "The hand holds after the target is lost"
    EstimateStale "supervisor: estimate_stale" "The hand holds without a fresh, confident pose"
    PositionJump "supervisor: position_jump" "The hand holds while the estimated position jumps"
    OrientationJump "supervisor: orientation_jump" "The hand holds while the estimated orientation jumps"
    Outlier "supervisor: outlier" "The hand holds while the estimate deviates from the predicted target motion"
    PositionUncertain "supervisor: position_uncertain" "The hand holds while the position is uncertain"
    OrientationUncertain "supervisor: orientation_uncertain" "The hand holds while the orientation is uncertain"
    CameraSkew "supervisor: camera_skew" "The hand holds while the camera exposures are not synchronous"
    LateImages "supervisor: late_images" "The hand holds when the images are older than their time stamps"
    StallCause "supervisor: causes of stalls" "Only a hold for parts that stand still ends at once"
    StallsApart "supervisor: time between stalls" "Only one hold within a second ends at once"
    ControllerRests "supervisor: controller_rests" "The hand holds when the controller outputs no velocity"
    TimelyCommands "supervisor: age of commands" "A command that is too old, or was given in another state, is ignored"
    ClearForCommands "supervisor: time before a command" "Intermittent conditions must be absent for a while before start and resume"
    ObservationAge "controller: age of observations" "The controller outputs no velocity without a fresh observation"
    ObservationTrust "controller: trusted observations" "The controller follows only confident estimates"
    JointsAge "controller: age of joints" "The controller outputs no velocity without fresh joint measurements"
    JointsForward "controller: clock" "The controller outputs no velocity when time steps back"
    LimiterSpeed "limiter: speed" "No command is faster than its limit"
    LimiterRange "limiter: range" "No command leads beyond the operating range, including the braking distance"
    LimiterAcceleration "limiter: acceleration and jerk" "Commands change within the limits of acceleration and jerk"
    LimiterStale "limiter: age of samples" "Each joint stops without a fresh sample"
    GuardRange "guard: range" "A joint beyond its servo or mechanical range is stopped"
    GuardJump "guard: jumps of samples" "Samples that jump are rejected, two in a row stop the arm"
    GuardSpeed "guard: speed" "A joint that is too fast is stopped"
    GuardTracking "guard: tracking" "A joint that does not follow its command is stopped"
    CouplingRoom "coupling: room" "No command brings both arms too close to each other"
    CouplingStop "coupling: stop of both" "An arm that fails stops the other arm"
    TripLine "trip line" "The driver of an arm that fails stops the other arm at once"
    DriverLink "driver: lost answers" "Three exchanges without an answer stop the arm"
    DriverMeasurementAge "driver: age of measurements" "Replies with an old measurement stop the arm"
    DriverWatchdog "driver: age of commands" "A command without a successor fades and stops the arm"
    DriverAlarms "driver: alarms" "Alarms and switches of the arm stop it"
    DriverTorque "driver: torque" "A joint torque that is too high for too long stops the arm"
    GatewayWatchdog "gateway: age of commands" "A silent host makes the arm fade and stop"
    GatewayBus "gateway: lost replies" "Three cycles without a reply of the controller stop the arm"
    GatewayLimits "gateway: motion limits" "A command outside the gateway's own motion limits stops the arm"
    GatewayAlarms "gateway: alarms" "Alarms and switches of the arm stop it"
}

/// Runs `work` without these safeguards, in a thread whose name lists them: there the switches find them.
pub fn without<T: Send>(safeguards: &[Safeguard], work: impl FnOnce() -> T + Send) -> std::io::Result<T> {
    let names: Vec<_> = safeguards.iter().map(|safeguard| safeguard.name()).collect();
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().name(names.join("; ")).spawn_scoped(scope, work)?;
        thread.join().map_err(|panic| std::io::Error::other(format!("the run panicked: {panic:?}")))
    })
}
