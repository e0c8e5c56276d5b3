//! Codes of recordings that cannot be used.

use pb3dp_message_codes::codes;

use crate::BagError;

codes! {
    BagError, "A recording is refused" {
        Io = "PB3DP-BAG-001": "A file or folder cannot be read or written."; "Check the path, the permissions and the free space.";
        NoMcap = "PB3DP-BAG-002": "The file is no MCAP file."; "Name a file.mcap, or the folder of a rosbag2 recording with such files.";
        Sqlite = "PB3DP-BAG-003": "The recording is in SQLite, the older format of rosbag2."; "Convert it with rosbags-convert, as the message says.";
        Damaged = "PB3DP-BAG-004": "The file is damaged before its end."; "Copy it again; `pb3dp recover FILE` keeps what is readable.";
        Exists = "PB3DP-BAG-005": "A recording would overwrite another file."; "Give another name.";
        Topics = "PB3DP-BAG-006": "It is not clear which topics have the left and the right images."; "Name them with --topics LEFT,RIGHT.";
        Message = "PB3DP-BAG-007": "A message does not have the format of its type."; "Record it again. Only plain CDR of ROS 2 is read.";
        Pixels = "PB3DP-BAG-008": "An image has an encoding that is not read, or fewer bytes than it needs."; "Record one of the encodings in docs/dataset-format.md.";
        Image = "PB3DP-BAG-009": "A compressed image cannot be used."; "Do what the message says about the image.";
        NoCalibration = "PB3DP-BAG-010": "The recording has no calibration of both cameras."; "Give one with --calib.";
        Calibration = "PB3DP-BAG-011": "The calibration in the recording cannot be used."; "Correct it as the message says, or give another one with --calib.";
        NoPairs = "PB3DP-BAG-012": "No left image has a right one of nearly the same time."; "State a longer time with --pair-within, or check the clocks of the cameras.";
        Keeping = "PB3DP-BAG-013": "The newest seconds are to be kept twice at a time."; "Wait until the first file is whole.";
        Serve = "PB3DP-BAG-014": "Viewers cannot be served at the address."; "Give another address or port with --live, or end the program that uses it.";
        Refused = "PB3DP-BAG-015": "The path is a named pipe, a socket or a device."; "Copy the content into a file, and name this file.";
        NoSegment = "PB3DP-BAG-016": "The recording does not have this many calibrations."; "State a --segment that exists, or leave it out.";
    }
}
