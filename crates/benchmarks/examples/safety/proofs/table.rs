//! The proof of each safeguard.

use pb3dp_servo::supervisor::OperatorCommand;
use pb3dp_setup::setup::Carrier::{Arm, Nothing};
use pb3dp_sim::trajectory::Channel;

use super::Proof;
use super::safeguards::Safeguard::{self, *};
use crate::faults::Kind;
use crate::scenario::{Dice, swing, there_and_back};

type Motion = fn(&mut Dice) -> (pb3dp_sim::trajectory::MotionConfig, pb3dp_setup::setup::Carrier);
type Faults = fn(&mut Dice) -> Vec<(f64, f64, Kind)>;

/// The hand follows a target that moves by itself, or on the other arm.
const FREE: Motion = |_| swing(Nothing, Channel::X, 0.08, 4.0);
const CARRIED: Motion = |_| swing(Arm, Channel::X, 0.06, 4.0);

/// Faster than the arms may follow.
const FAST: Motion = |_| swing(Arm, Channel::X, 0.15, 1.0);

const fn alone(guard: Safeguard, motion: Motion, faults: Faults) -> Proof {
    Proof { guard, others: &[], has_person: false, motion, faults }
}

const fn among(guard: Safeguard, others: &'static [Safeguard], motion: Motion, faults: Faults) -> Proof {
    Proof { guard, others, has_person: false, motion, faults }
}

/// Longer than a run.
const FOR_EVER_S: f64 = 60.0;

/// With an operator, so that a run continues after a stop.
const fn with_person(guard: Safeguard, others: &'static [Safeguard], motion: Motion, faults: Faults) -> Proof {
    Proof { guard, others, has_person: true, motion, faults }
}

fn of_both(name: &'static str, line: &str, end: &str) -> Vec<(f64, f64, Kind)> {
    [0, 1].map(|arm| (0.1, FOR_EVER_S, Kind::of_arm(arm, name, line, Some(end)))).into()
}

fn of_arm(name: &'static str, line: &str, end: &str) -> Vec<(f64, f64, Kind)> {
    vec![(0.1, 2.0, Kind::of_arm(0, name, line, Some(end)))]
}

const NO_POSE: Faults = |_| vec![(0.0, 2.0, Kind::NoPose)];
const NO_FRAMES: Faults = |_| vec![(0.0, 2.0, Kind::EstimatesLost(1.0))];
const DOUBTFUL: Faults = |_| vec![(0.0, 2.0, Kind::Doubtful)];
const LINES_SILENT: Faults = |_| of_both("line: silent", "line silence on", "line silence off");
const BUSES_SILENT: Faults = |_| of_both("bus: silent", "silence on", "silence off");
const EMERGENCY: Faults = |_| of_arm("arm: emergency stop", "e-stop press", "e-stop release");
const ALARM: Faults = |_| of_arm("arm: servo alarm", "alarm 4 0x0e", "alarm 4 off");
const JUMP: Faults = |_| vec![(0.1, 1.0, Kind::of_arm(0, "arm: encoder jumps", "jump 4 0.3rad", None))];
const FAR_JUMP: Faults = |_| vec![(0.1, 1.0, Kind::of_arm(0, "arm: encoder jumps", "jump 2 0.95rad", None))];
const RUNAWAY: Faults = |_| of_arm("arm: runaway joint", "runaway 1 1.0rad/s", "runaway 1 off");

/// In the order of the table on the page.
pub const PROOFS: &[Proof] = &[
    among(EstimateStale, &[TargetLost, ObservationAge, ControllerRests], FREE, NO_POSE),
    among(ObservationAge, &[TargetLost, EstimateStale], FREE, NO_POSE),
    among(FrameStale, &[TargetLost, EstimateStale, ObservationAge, ControllerRests], FREE, NO_FRAMES),
    among(ObservationTrust, &[TargetLost, EstimateStale, ControllerRests], FREE, DOUBTFUL),
    alone(FrameOrder, FREE, |_| vec![(0.0, 2.0, Kind::NumbersStand)]),
    alone(TargetChanged, FREE, |_| vec![(0.0, 2.0, Kind::OtherTarget)]),
    alone(CameraSkew, FREE, |_| vec![(0.0, 2.0, Kind::Skew(0.02))]),
    alone(PositionUncertain, FREE, |_| vec![(0.0, 2.0, Kind::Unsure([3000.0, 1.0]))]),
    alone(OrientationUncertain, FREE, |_| vec![(0.0, 2.0, Kind::Unsure([1.0, 300.0]))]),
    alone(LateImages, FREE, |_| vec![(0.0, 4.0, Kind::OldContent(6))]),
    alone(StallCause, FREE, |_| vec![(0.0, 0.36, Kind::Skew(0.02))]),
    alone(StallsApart, FREE, |_| vec![(0.0, 0.30, Kind::EstimatesLost(1.0)), (0.6, 0.40, Kind::EstimatesLost(1.0))]),
    among(Outlier, &[ObservationAge, ControllerRests], FREE, |_| vec![(0.0, 2.0, Kind::Scatter(0.3))]),
    among(ClockStepped, &[JointsForward, ControllerRests], FREE, |_| {
        vec![(0.0, 4.0, Kind::ClockJump(-0.9)), (0.0, 4.0, Kind::EstimatesLost(1.0))]
    }),
    among(JointsForward, &[ClockStepped, ControllerRests], FREE, |_| {
        vec![(0.0, 4.0, Kind::ClockJump(-0.9)), (0.0, 4.0, Kind::EstimatesLost(1.0))]
    }),
    among(LimiterSpeed, &[GatewayLimits], FAST, |_| vec![]),
    among(GatewayLimits, &[LimiterSpeed], FAST, |_| vec![]),
    among(LimiterRange, &[CouplingRoom, GatewayLimits], |_| swing(Arm, Channel::Z, 0.5, 6.0), |_| vec![]),
    among(LimiterAcceleration, &[GatewayLimits], |_| there_and_back(Arm, Channel::X, 0.10, 0.3), |_| vec![]),
    alone(GuardSpeed, CARRIED, RUNAWAY),
    alone(GuardTracking, CARRIED, |_| {
        vec![(0.1, 3.5, Kind::of_arm(0, "arm: runaway joint", "runaway 3 0.15rad/s", Some("runaway 3 off")))]
    }),
    among(GuardJump, &[GuardTracking, GuardSpeed], CARRIED, JUMP),
    among(GuardRange, &[GuardJump, GuardTracking, GuardSpeed, GatewayLimits], CARRIED, FAR_JUMP),
    // The hand has no pose and holds, and the other arm brings the target.
    alone(CouplingRoom, |_| there_and_back(Arm, Channel::Z, -0.6, 3.0), |_| vec![(-1.8, 5.0, Kind::NoPose)]),
    among(LimiterStale, &[DriverLink, JointsStale, JointsAge], CARRIED, LINES_SILENT),
    among(JointsStale, &[DriverLink, LimiterStale, JointsAge], CARRIED, LINES_SILENT),
    among(
        JointsAge,
        &[
            GatewayBus,
            DriverMeasurementAge,
            LimiterStale,
            JointsStale,
            ControllerRests,
            ObservationAge,
            FrameStale,
            EstimateStale,
            TargetLost,
        ],
        FREE,
        BUSES_SILENT,
    ),
    among(DriverLink, &[LimiterStale, JointsStale, JointsAge], CARRIED, LINES_SILENT),
    among(DriverMeasurementAge, &[GatewayBus, LimiterStale, JointsStale, JointsAge], CARRIED, BUSES_SILENT),
    among(GatewayBus, &[DriverMeasurementAge, LimiterStale, JointsStale, JointsAge], CARRIED, BUSES_SILENT),
    alone(DriverWatchdog, CARRIED, |_| vec![(0.1, 1.0, Kind::Overrun(1.0))]),
    alone(GatewayWatchdog, CARRIED, |_| of_arm("line: gateway deaf", "line deaf on", "line deaf off")),
    among(DriverAlarms, &[GatewayAlarms, GuardTracking], CARRIED, EMERGENCY),
    among(GatewayAlarms, &[DriverAlarms, GuardTracking], CARRIED, EMERGENCY),
    alone(DriverTorque, CARRIED, |_| of_arm("arm: torque", "torque 4 300Nm", "torque 4 0Nm")),
    with_person(OperatorSilent, &[], CARRIED, |_| vec![(0.1, 3.0, Kind::Silence)]),
    with_person(TimelyCommands, &[], CARRIED, |_| {
        vec![
            (0.1, 0.0, Kind::OperatorCommand(OperatorCommand::Hold, 0.0)),
            (0.6, 0.0, Kind::OperatorCommand(OperatorCommand::Resume, 0.55)),
        ]
    }),
    with_person(CouplingStop, &[TripLine, ArmFault, EmergencyStop], CARRIED, EMERGENCY),
    with_person(TripLine, &[CouplingStop, ArmFault, EmergencyStop], CARRIED, EMERGENCY),
    with_person(ArmFault, &[CouplingStop, TripLine, EmergencyStop], CARRIED, ALARM),
    with_person(EmergencyStop, &[CouplingStop, TripLine, ArmFault], CARRIED, EMERGENCY),
];

/// Safeguards that these runs cannot show, and the tests that show them.
pub const ELSEWHERE: [(Safeguard, &str); 7] = [
    (ArmDisabled, "nothing moves while the drives are disabled; `crates/servo/tests/supervisor`, start_and_resume.rs"),
    (
        TargetLost,
        "takes effect 0.7 s after the hold without a fresh pose; it adds the conditions for resuming, `crates/servo/tests/supervisor`",
    ),
    (Miscalibrated, "these runs have no images; `tests/tests/camera_faults.rs`"),
    (PositionJump, "only the law `published` reports jumps; `crates/servo/tests/supervisor/conditions.rs`"),
    (OrientationJump, "the same"),
    (
        ClearForCommands,
        "a command must fall between two outliers, which happens in one run of 1500; `crates/servo/tests/supervisor/settling.rs`",
    ),
    (
        ControllerRests,
        "a holding controller outputs no velocity to send; this condition keeps the supervisor from reporting motion",
    ),
];
