//! Codes of files that cannot be used.

use pb3dp_message_codes::codes;

use crate::calibration_files::CalibrationFileError;
use crate::dataset::DatasetError;
use crate::images::ImageProblem;

codes! {
    CalibrationFileError, "A calibration file is refused" {
        Read = "PB3DP-CAL-001": "A calibration file cannot be read."; "Check the path and the permissions.";
        NoText = "PB3DP-CAL-002": "The file is not text: it may be an image."; "Name the YAML, JSON or TOML file of the calibration.";
        Write = "PB3DP-CAL-003": "A calibration file cannot be written."; "Check the folder, its permissions and the free space.";
        Syntax = "PB3DP-CAL-004": "The file is not valid YAML, JSON or TOML."; "Correct the line that the message names, or export the calibration again.";
        Key = "PB3DP-CAL-005": "A value of the calibration is missing or wrong."; "Correct the key that the message names. A wrong sign of the baseline often means that left and right are exchanged.";
        Format = "PB3DP-CAL-006": "The file is not a stereo calibration in a known format."; "Use a Kalibr camchain, an OpenCV stereo YAML, two ROS camera_info files, calib.json or a file of `pb3dp calibrate`.";
        Directory = "PB3DP-CAL-007": "The folder contains no calibration under a known name."; "Name the calibration file itself.";
        Paths = "PB3DP-CAL-008": "Too few or too many calibration files were named."; "Name one file, a left and a right one separated by a comma, or a folder.";
        Stated = "PB3DP-CAL-010": "What an option states of a calibration is missing, or contradicts the file."; "Do what the message says: state the option, or leave it out.";
        NotRepresentable = "PB3DP-CAL-009": "The format cannot hold this calibration."; "Choose another format: the TOML of `pb3dp calibrate` holds every calibration.";
    }
}

codes! {
    DatasetError, "A case or sequence folder is refused" {
        Io = "PB3DP-DAT-001": "A file or folder cannot be read or written."; "Check that it exists, its permissions and the free space.";
        Syntax = "PB3DP-DAT-002": "A file is not valid JSON."; "Correct the place that the message names.";
        MissingKey = "PB3DP-DAT-003": "A required key is missing."; "Add it: docs/dataset-format.md describes all keys.";
        Value = "PB3DP-DAT-004": "A value of the description is not allowed."; "Correct it: the message says what is allowed.";
        NoCases = "PB3DP-DAT-005": "The folder contains no cases."; "Name the folder that holds the case folders.";
        Exists = "PB3DP-DAT-006": "A recording would overwrite another one."; "Give an empty folder.";
        Image = "PB3DP-DAT-007": "An image of the folder cannot be used."; "Do what the message says about the image.";
        Calibration = "PB3DP-DAT-008": "The calibration of the folder cannot be used."; "Do what the message says about the calibration.";
        Frame = "PB3DP-DAT-009": "A frame does not fit the frames before it."; "Record the sequence again, or leave this frame out.";
    }
}

codes! {
    ImageProblem, "An image file is refused" {
        Missing = "PB3DP-IMG-001": "The file does not exist."; "Check the path.";
        Folder = "PB3DP-IMG-002": "The path is a folder."; "Name the image file in it.";
        Io = "PB3DP-IMG-003": "The file cannot be read or written."; "Check the permissions and the free space.";
        UnknownFormat = "PB3DP-IMG-004": "The file is no image in a known format."; "Convert it to PNG, for instance with ImageMagick.";
        Damaged = "PB3DP-IMG-005": "The file ends early or its content is damaged."; "Copy or record it again.";
        Size = "PB3DP-IMG-006": "The image has another size than expected."; "Use images of one size, and the calibration of this size.";
        Depth = "PB3DP-IMG-007": "The image has more than 8 bits per channel, or numbers that are no integers."; "Convert it to 8 bits; where `--range` exists, images with 16 bits are read.";
        Transparent = "PB3DP-IMG-008": "Some pixels are transparent and have no colour."; "Remove the alpha channel.";
        TooLarge = "PB3DP-IMG-010": "The image has more pixels than can be read."; "Scale the images and the calibration by the same factor.";
        NotDisparity = "PB3DP-IMG-009": "A disparity map must be a 16-bit grey image."; "Write it as a 16-bit grey PNG.";
        Refused = "PB3DP-IMG-011": "The path is a named pipe, a socket or a device, or the file is too large."; "Name a regular file with the image.";
    }
}
