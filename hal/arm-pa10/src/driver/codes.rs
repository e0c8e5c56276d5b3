//! Codes of the causes that stop a PA-10.

use pb3dp_message_codes::codes;

use super::condition::{EmergencyStopCause, FaultCause};
use super::link::WarmUpFailure;
use super::requests::Refusal;

codes! {
    FaultCause, "A fault stopped a PA-10" {
        LinkLost = "PB3DP-ARM-101": "Several exchanges in a row had no usable reply."; "If the arm moves, press its emergency stop. Check cable and power, and that no other program uses the line. Then reset.";
        MeasurementTooOld = "PB3DP-ARM-102": "The gateway answers, but its newest measurement is too old: the servo controller does not answer it."; "Look at the gateway's log and at the servo controller. Then reset.";
        Unplugged = "PB3DP-ARM-104": "The link was unplugged or closed."; "If the arm moves, press its emergency stop. Connect the link again. Then reset.";
        WrongArm = "PB3DP-ARM-105": "A frame of another arm came through this link."; "Correct the number of the arm, or swap the links of the two arms. Then reset.";
        CommandTimeout = "PB3DP-ARM-106": "The control loop sent no velocity for longer than the watchdog allows."; "Find what delayed the control loop: `pb3dp doctor`. Then reset.";
        OwnerSilent = "PB3DP-ARM-107": "The program made no request while the brakes were open."; "Find what delayed the control loop: `pb3dp doctor`. Then reset.";
        ServoAlarm = "PB3DP-ARM-108": "An axis raised an alarm. The message names the axis and the alarm."; "Remove the cause by the manual of the arm. Then reset.";
        ControllerAlarm = "PB3DP-ARM-109": "The servo controller raised an alarm."; "Remove the cause by the manual of the arm. Then reset.";
        AxisUncontrollable = "PB3DP-ARM-110": "An axis has no power or does not follow while the brakes are open."; "Check the power of this axis. Then reset.";
        ArmUncontrollable = "PB3DP-ARM-111": "The controller reports that the arm does not follow."; "Look at the panel of the servo controller. Then reset.";
        TorqueTooHigh = "PB3DP-ARM-112": "The torque of a joint was above its limit for too long: the joint is blocked, overloaded or pushed."; "Free the joint. Then reset.";
        Gateway = "PB3DP-ARM-113": "The gateway stopped the arm. The message names its reason."; "Do what the message says. Then reset.";
        GatewayStopped = "PB3DP-ARM-114": "The gateway stopped following, without a reason and without an order of this program."; "Find out who stopped it. Then reset.";
        Rejected = "PB3DP-ARM-115": "The gateway refused a message of this program."; "Compare the versions and settings of host and gateway. Then reset.";
        CauseNotCleared = "PB3DP-ARM-116": "The arm cannot be reset, because the cause of its stop is still there."; "Remove the cause. `pb3dp arm probe` shows the status words. Then reset.";
        LimitsDiffer = "PB3DP-ARM-117": "The servo controller keeps another limit for an axis than the configuration."; "Find out whether this is the arm of the configuration, and correct the wrong one. Then reset.";
        ActivityTimeout = "PB3DP-ARM-118": "Enabling, stopping or resetting took too long."; "Check that the arm answers: `pb3dp arm probe`. Then reset.";
        OtherArm = "PB3DP-ARM-119": "The other arm of the cell stopped and stopped this one, too."; "Look at the message of the other arm. Reset both.";
        Supervisor = "PB3DP-ARM-121": "The supervisor of this program stopped the arm."; "Look at the message of the supervisor. Then reset.";
        Released = "PB3DP-ARM-122": "The program released the arm while its brakes were open."; "Stop the arm before the program ends.";
        Program = "PB3DP-ARM-123": "The thread that watches the arm failed. This is a defect of pb3dp."; "Report it with the log, and start the program again.";
        Internal = "PB3DP-ARM-124": "The driver met an event that its state machine does not expect. This is a defect of pb3dp."; "Report it with the log. Then reset.";
        GatewayLimit = "PB3DP-ARM-125": "A command was outside a motion limit of the gateway. The message names axis and quantity."; "Compare `[limits]` in the gateway's file with the arm's limits in the setup. Report a defect if they agree. Then reset.";
        LinkPoor = "PB3DP-ARM-126": "Too many of the last 100 exchanges had no usable reply, or a damaged one."; "If the arm moves, press its emergency stop. Check cable and ground, the latency timer of the serial adapter and the load of the computer: `pb3dp doctor`. Then reset.";
    }
}

codes! {
    EmergencyStopCause, "An emergency stop stopped a PA-10" {
        Axis = "PB3DP-ARM-201": "An axis reports an emergency stop, a dead-man switch or a limit switch."; "Release or hold the switch that the message names. Then reset.";
        Controller = "PB3DP-ARM-202": "The servo controller reports an emergency stop, a dead-man switch or a limit switch."; "Release or hold the switch that the message names. Then reset.";
        Switch = "PB3DP-ARM-203": "A switch bit of the controller is set that the configuration calls an emergency stop."; "Release the switch. Then reset.";
        Gateway = "PB3DP-ARM-204": "The gateway reports a switch and cannot tell which one."; "Release emergency stops, hold the dead-man switch, leave limit switches. Then reset.";
    }
}

codes! {
    WarmUpFailure, "A PA-10 cannot be enabled" {
        Damaged = "PB3DP-ARM-301": "Replies were damaged, or answered another request."; "Check cable, ground and baud rate.";
        Slow = "PB3DP-ARM-302": "Replies were lost or too slow."; "Check the latency timer of the serial adapter and the load of the computer: `pb3dp doctor`.";
        PowerTooWarm = "PB3DP-ARM-303": "The power supply of the servo controller is too warm."; "Let it cool down.";
        AxisUncontrollable = "PB3DP-ARM-304": "An axis has no power or does not follow although its servo is on."; "Check the power of this axis, then enable again.";
        ArmUncontrollable = "PB3DP-ARM-305": "The controller reports that the arm does not follow although its servos are on."; "Look at the panel of the servo controller, then enable again.";
        DeadManReleased = "PB3DP-ARM-306": "The dead-man switch is released."; "Hold it, then enable again.";
    }
}

codes! {
    Refusal, "A request to a PA-10 is refused" {
        NotInState = "PB3DP-ARM-401": "The request is not possible in this state of the arm."; "Follow the hint of the message: usually reset or enable first.";
        Busy = "PB3DP-ARM-402": "Another activity of the arm has to end first."; "Wait for its end, or stop the arm.";
        Velocity = "PB3DP-ARM-403": "A velocity cannot be expressed in the arm's units, and none of it was sent."; "Report it with the log: limits should have prevented it.";
    }
}
