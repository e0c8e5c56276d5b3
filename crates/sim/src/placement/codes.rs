//! Codes of experiments that an arm cannot follow.

use pb3dp_message_codes::codes;

use super::refusal::PathRefusal;

codes! {
    PathRefusal, "An arm cannot follow the experiment" {
        Requirement = "PB3DP-PATH-001": "A requirement of the check is out of its range."; "Correct the key that the message names.";
        BeginUnreachable = "PB3DP-PATH-002": "The arm does not reach the start of the path."; "Move its base (`arms.NAME.world_from_base`) or change its start angles (`arms.NAME.start_deg`).";
        OutOfReach = "PB3DP-PATH-003": "The path leads out of the reach of the arm."; "Move the base of the arm, or make the motion smaller.";
        JointRange = "PB3DP-PATH-004": "A joint would come too near the end of its range."; "Change base, start angles or the direction of the motion.";
        Singular = "PB3DP-PATH-005": "The arm would come too near a singular pose."; "Change base or start angles.";
        TooFast = "PB3DP-PATH-006": "A joint would have to move faster than its effective limit."; "Lengthen the moves, or raise `arms.speed_scale`.";
        TooAbrupt = "PB3DP-PATH-007": "A joint would have to accelerate more than its limit."; "Lengthen the moves, or make them smaller.";
        ToolTooFast = "PB3DP-PATH-008": "The hand would have to move faster than its limit."; "Lengthen the moves, or raise the limit under `servo.speed`.";
    }
}
