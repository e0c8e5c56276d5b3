//! Codes of the errors of arms and cameras, by their kind.

use pb3dp_message_codes::codes;

use crate::arm::ArmErrorKind;
use crate::stereo_camera::CameraErrorKind;

codes! {
    ArmErrorKind, "An arm reports an error" {
        Rejected = "PB3DP-ARM-001": "A command was refused before anything was sent to the arm. The arm holds."; "Remove the reason that the message names.";
        NotEnabled = "PB3DP-ARM-002": "The arm is not in a state in which it moves."; "Enable the drives, or reset the arm if it is stopped.";
        Timeout = "PB3DP-ARM-003": "A reply of the arm is late or lost."; "Nothing, if it happens rarely. Otherwise check the cable, the adapter and the load of the computer.";
        Fault = "PB3DP-ARM-004": "The arm stopped and latched a fault."; "Remove the cause that the message names, then reset the arm.";
        Disconnected = "PB3DP-ARM-005": "The link to the arm is gone."; "Connect the cable, start the gateway, then reset the arm.";
    }
}

codes! {
    CameraErrorKind, "A camera reports an error" {
        Timeout = "PB3DP-CAM-001": "No frame pair arrived in time."; "Check that both cameras send images: `pb3dp panel --cameras`.";
        BadPair = "PB3DP-CAM-002": "A frame pair is damaged or incomplete and was skipped."; "Nothing, if it happens rarely. Otherwise check cables and USB bandwidth.";
        EndOfStream = "PB3DP-CAM-003": "The recording has ended."; "Nothing.";
        Disconnected = "PB3DP-CAM-004": "A camera was unplugged or powered off."; "Connect the camera. pb3dp opens it again by itself within `camera.reopen_for_s`.";
        Unusable = "PB3DP-CAM-005": "A camera, a recording or its configuration cannot be used."; "Correct what the message names. `pb3dp cameras list` shows devices and modes.";
    }
}
