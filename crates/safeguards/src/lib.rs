//! The safeguards that keep an arm from moving wrongly, by name, so that a test build can switch them off one by one and show that each
//! is there for something.
//!
//! Whoever holds a safeguard asks [`is_off`]. Without the feature `disabled-guards` that is the constant `false`, and nothing of this
//! crate is left in a program. With the feature a build without debug assertions does not compile, so that no release of `pb3dp` has it; a
//! test build of `pb3dp` says so in its version ([`CAN_BE_OFF`]).

#[cfg(all(feature = "disabled-guards", not(debug_assertions)))]
compile_error!(
    "the feature disabled-guards is for tests, which are built with debug assertions: no program for real arms may have it"
);

/// Whether this is a test build in which safeguards can be switched off.
pub const CAN_BE_OFF: bool = cfg!(feature = "disabled-guards");

macro_rules! safeguards {
    ($($name:ident $text:literal $what:literal)*) => {
        /// What keeps an arm from moving wrongly.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Safeguard {
            $(#[doc = $what] $name,)*
        }

        impl Safeguard {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// The name in tables: where it is, then what it looks at.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$name => $text,)* }
            }

            /// What it does, in a sentence without an end.
            pub const fn what(self) -> &'static str {
                match self { $(Self::$name => $what,)* }
            }
        }
    };
}

safeguards! {
    EmergencyStop "supervisor: emergency_stop" "Both arms stop when an arm tells of an emergency stop"
    ArmFault "supervisor: arm_fault" "Both arms stop when an arm has a fault"
    ArmDisabled "supervisor: arm_disabled" "The hand rests while the drives of an arm are off, until the operator's word"
    ClockStepped "supervisor: clock_stepped" "Both arms rest after a step of the clock"
    OperatorSilent "supervisor: operator_silent" "Both arms stop without a sign of life of the operator"
    JointsStale "supervisor: joints_stale" "Both arms rest without fresh joints of both"
    TargetChanged "supervisor: target_changed" "The hand rests when another target is followed than was started"
    FrameStale "supervisor: frame_stale" "The hand rests without fresh images"
    FrameOrder "supervisor: frame_order" "The hand rests when images come out of order"
    TargetLost "supervisor: target_lost" "The hand rests after a target that was lost"
    EstimateStale "supervisor: estimate_stale" "The hand rests without a fresh, confident pose"
    PositionJump "supervisor: position_jump" "The hand rests while the target seems to jump"
    OrientationJump "supervisor: orientation_jump" "The hand rests while the target seems to turn at once"
    Outlier "supervisor: outlier" "The hand rests while the target is not where its motion leads to expect it"
    PositionUncertain "supervisor: position_uncertain" "The hand rests while the position is uncertain"
    OrientationUncertain "supervisor: orientation_uncertain" "The hand rests while the orientation is uncertain"
    CameraSkew "supervisor: camera_skew" "The hand rests while both cameras are not exposed together"
    ControllerRests "supervisor: controller_rests" "The hand rests when the controller gives no velocity"
    TimelyWords "supervisor: age of words" "A word that was said too long ago, or to another state, is not obeyed"
    ClearForWords "supervisor: time before a word" "What comes and goes from image to image has to be gone for a while before start and resume"
    ObservationAge "controller: age of observations" "The controller rests without a fresh observation"
    ObservationTrust "controller: trusted observations" "The controller follows only what the estimator stands by"
    JointsAge "controller: age of joints" "The controller rests without fresh joints"
    JointsForward "controller: clock" "The controller rests when time steps back"
    LimiterSpeed "limiter: speed" "No command is faster than its limit"
    LimiterRange "limiter: range" "No command leads beyond the operating range, braking counted"
    LimiterAcceleration "limiter: acceleration and jerk" "Commands change within the limits of acceleration and jerk"
    LimiterStale "limiter: age of samples" "Each joint comes to rest without a fresh sample"
    GuardRange "guard: range" "A joint beyond its servo or mechanical range is stopped"
    GuardJump "guard: jumps of samples" "Samples that jump are thrown away, two in a row stop the arm"
    GuardSpeed "guard: speed" "A joint that is too fast is stopped"
    GuardTracking "guard: tracking" "A joint that does not go where it is told is stopped"
    CouplingRoom "coupling: room" "No command brings both arms too near to each other"
    CouplingStop "coupling: stop of both" "An arm that fails stops the other one"
    TripLine "trip line" "The driver of an arm that fails stops the other arm at once"
    DriverLink "driver: lost answers" "Three exchanges without an answer stop the arm"
    DriverMeasurementAge "driver: age of measurements" "Answers that tell of an old measurement stop the arm"
    DriverWatchdog "driver: age of commands" "A command that no other follows fades and stops the arm"
    DriverAlarms "driver: alarms" "Alarms and switches of the arm stop it"
    DriverTorque "driver: torque" "A joint that carries too much for too long stops the arm"
    GatewayWatchdog "gateway: age of commands" "A host that is silent has the arm fade and stop"
    GatewayBus "gateway: lost replies" "Three cycles without a reply of the controller stop the arm"
    GatewayAlarms "gateway: alarms" "Alarms and switches of the arm stop it"
}

/// Whether a test has switched this safeguard off: never, in this build.
#[cfg(not(feature = "disabled-guards"))]
#[inline(always)]
pub const fn is_off(_: Safeguard) -> bool {
    false
}

#[cfg(feature = "disabled-guards")]
mod switches {
    use std::cell::Cell;

    use super::Safeguard;

    thread_local! {
        /// One bit for each.
        static OFF: Cell<u64> = const { Cell::new(0) };
    }

    /// Whether a test has switched this safeguard off on this thread.
    pub fn is_off(safeguard: Safeguard) -> bool {
        OFF.get() & bit(safeguard) != 0
    }

    /// Does something on this thread without these safeguards; afterwards those are back that were there before, after a panic, too.
    pub fn without<T>(safeguards: &[Safeguard], work: impl FnOnce() -> T) -> T {
        let before = OFF.get();
        let _back = Back(before);
        OFF.set(safeguards.iter().fold(before, |off, safeguard| off | bit(*safeguard)));
        work()
    }

    const fn bit(safeguard: Safeguard) -> u64 {
        assert!(Safeguard::ALL.len() <= 64);
        1 << safeguard as u64
    }

    struct Back(u64);

    impl Drop for Back {
        fn drop(&mut self) {
            OFF.set(self.0);
        }
    }
}

#[cfg(feature = "disabled-guards")]
pub use switches::{is_off, without};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_has_a_name_of_its_own() {
        let mut names: Vec<_> = Safeguard::ALL.iter().map(|safeguard| safeguard.name()).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), Safeguard::ALL.len());
    }

    #[cfg(feature = "disabled-guards")]
    #[test]
    fn they_are_off_as_long_as_the_work_lasts_and_on_this_thread_only() {
        use Safeguard::{GuardRange, LimiterRange};
        let are_off = || [LimiterRange, GuardRange].map(is_off);
        let inside = without(&[LimiterRange], || {
            assert_eq!(without(&[GuardRange], are_off), [true, true]);
            assert_eq!(std::thread::scope(|scope| scope.spawn(are_off).join()).unwrap(), [false, false]);
            are_off()
        });
        assert_eq!((inside, are_off()), ([true, false], [false, false]));
        let panicked = std::panic::catch_unwind(|| without(&[GuardRange], || std::panic::resume_unwind(Box::new(()))));
        assert!(panicked.is_err() && !is_off(GuardRange));
    }

    #[cfg(not(feature = "disabled-guards"))]
    #[test]
    fn without_the_feature_none_is_off() {
        const { assert!(!is_off(Safeguard::LimiterRange) && !CAN_BE_OFF) }
    }
}
