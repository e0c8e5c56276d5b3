//! Codes of the supervisor's messages.

use pb3dp_message_codes::codes;

use super::policy::Condition;
use super::wording::RefusedFor;

codes! {
    Condition, "Motion is inhibited" {
        EmergencyStop = "PB3DP-SUP-001": "An emergency stop, a dead-man switch or a limit switch stopped an arm."; "Release the switch. Then use `reset`.";
        ArmFault = "PB3DP-SUP-002": "A fault stopped an arm. The message of the arm names it."; "Remove the cause. Then use `reset`.";
        ArmDisabled = "PB3DP-SUP-003": "The drives of an arm are disabled."; "Wait until they are enabled, or use `select`, which enables them.";
        ClockStepped = "PB3DP-SUP-004": "The clock of this computer jumped, or the control loop was delayed for longer than the limit."; "Find what delays the computer or sets its clock. `pb3dp doctor` checks the usual reasons.";
        OperatorSilent = "PB3DP-SUP-005": "The operator gave no sign of life in time: no key at the terminal, or no heartbeat of the panel."; "Press Enter at the terminal, or check the panel and its connection. Then use `resume`, or `reset` after a stop.";
        JointsStale = "PB3DP-SUP-006": "The newest joint measurement of an arm is too old."; "Check the cable and the gateway of this arm.";
        TargetChanged = "PB3DP-SUP-007": "The estimator follows another target than the one that was started."; "Use `select`, check the region, then use `start`.";
        FrameStale = "PB3DP-SUP-008": "The newest frame pair is too old."; "Check the cameras and their cables. After the start, wait for the first pair.";
        FrameOrder = "PB3DP-SUP-009": "Frame pairs arrive out of order: a camera was restarted or sends an old image."; "Check the cameras. Then use `resume`.";
        Miscalibrated = "PB3DP-SUP-023": "The images contradict the calibration of the cameras: they have moved against each other, or the file is of other cameras."; "Fasten the cameras, calibrate again, and restart the program. The status of the estimates names the rows and angles.";
        TargetLost = "PB3DP-SUP-010": "There was no confident pose of the target for so long that the target counts as lost."; "Bring the target back into view of both cameras, or use `select` again.";
        EstimateStale = "PB3DP-SUP-011": "The newest confident pose is too old."; "Clear the view of the target. If the target is in view, look at the status of the estimates.";
        LowConfidence = "PB3DP-SUP-012": "The estimator reports no pose, or a pose with low confidence."; "Clear the view of the target, give it more light, or use `select` again.";
        PositionJump = "PB3DP-SUP-013": "The estimated target position jumped by more than the limit between two pairs."; "Check that the estimator follows the same object. Then use `resume`.";
        OrientationJump = "PB3DP-SUP-014": "The estimated target orientation jumped by more than the limit between two pairs."; "Check that the estimator follows the same object. Then use `resume`.";
        Outlier = "PB3DP-SUP-015": "The estimated pose lies too many standard deviations from the prediction."; "Check that the estimator follows the same object. Then use `resume`.";
        PositionUncertain = "PB3DP-SUP-016": "The standard deviation of the target position is above the limit."; "Give the target more light, more texture or more pixels: move it nearer.";
        OrientationUncertain = "PB3DP-SUP-017": "The standard deviation of the target orientation is above the limit."; "Give the target more light, more texture or more pixels: move it nearer.";
        CameraSkew = "PB3DP-SUP-018": "Left and right camera were not exposed at the same time."; "Check the trigger cable and the trigger mode of the cameras.";
        LimitNear = "PB3DP-SUP-019": "A joint of the arm that carries the cameras is near the end of its range."; "Move the target towards the middle of the arm's range.";
        Singularity = "PB3DP-SUP-020": "The arm that carries the cameras is near a singular pose."; "Move the target to where the arm is not stretched out.";
        ControllerRests = "PB3DP-SUP-021": "The controller outputs no velocity: it waits for consistent observations, or holds."; "Wait, or remove the reason that the message names.";
        LateImages = "PB3DP-SUP-022": "The images are older than their time stamps: the target seems to move with the hand, and the hand would swing."; "Find what delays the images: buffers of the cameras, the driver, another program. Measure the delays with `pb3dp identify delay`, then use `resume`.";
    }
}

codes! {
    RefusedFor, "An operator command is refused" {
        State = "PB3DP-SUP-101": "The command is not possible in this state."; "Use the command that the message names.";
        Age = "PB3DP-SUP-102": "The command arrived too late."; "Repeat it. If this happens often, check the connection of the terminal.";
        OlderThanState = "PB3DP-SUP-103": "After the command was given the state changed, or motion was ended."; "Check the new state, then repeat the command.";
        OlderThanTarget = "PB3DP-SUP-104": "The command was given before the current target was seen."; "Check the target, then repeat the command.";
        Overtaken = "PB3DP-SUP-105": "The state changed in the same step as the command."; "Check the new state, then repeat the command.";
        Cause = "PB3DP-SUP-106": "A condition inhibits motion. The message names it."; "Remove this condition, then repeat the command.";
        NotClear = "PB3DP-SUP-107": "Motion was inhibited until a moment ago."; "Wait for the time that the message names, then repeat the command.";
    }
}
