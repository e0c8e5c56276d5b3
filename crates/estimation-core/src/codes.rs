//! Message codes of rejected estimation requests.

use pb3dp_message_codes::codes;

use crate::error::EstimationError;
use crate::region::RegionError;

codes! {
    EstimationError, "An estimate is refused" {
        Parameter = "PB3DP-EST-001": "A parameter of the method is out of its range."; "Set it to a value that the message allows.";
        ImageSize = "PB3DP-EST-002": "The image size differs from the image size of the calibration."; "Use the calibration of this image size, or images of the calibrated size.";
        Distorted = "PB3DP-EST-003": "The method needs images without lens distortion."; "Undistort or rectify the images and use the resulting calibration, or choose the method `direct`.";
        EmptyModel = "PB3DP-EST-004": "No point of the target has a hue, so the published method has no model."; "Mark a coloured target, or choose the method `direct`.";
        Region = "PB3DP-EST-005": "The region of the target is refused. The message says why."; "Mark another region.";
        Remap = "PB3DP-EST-006": "The images could not be undistorted."; "Check the distortion coefficients of the calibration.";
        Rectification = "PB3DP-EST-007": "The stereo pair has no common image plane."; "Check rotation and translation of the calibration: left and right may be exchanged.";
        Camera = "PB3DP-EST-008": "A camera model cannot be evaluated at a pixel."; "Check the camera matrix and the distortion coefficients of the calibration.";
        UnknownMethod = "PB3DP-EST-009": "There is no estimation method of this name."; "Use one of the names in the message.";
        NotStarted = "PB3DP-EST-010": "The next frame was requested before a target was marked."; "Mark a target in the first request.";
        OnlyPairs = "PB3DP-EST-011": "The method estimates single pairs only and cannot track."; "Choose another method for sequences.";
        NoSurface = "PB3DP-EST-012": "Too few pixels of the region have a match in the right image to give a surface."; "Check the depth range, the calibration, and whether left and right are exchanged.";
    }
}

codes! {
    RegionError, "A region is refused" {
        TooFewVertices = "PB3DP-REG-001": "The polygon has fewer than three vertices."; "Give at least three.";
        Vertex = "PB3DP-REG-002": "A vertex of the polygon is not a number or lies far outside the image."; "Give pixels of the left image.";
        Rectangle = "PB3DP-REG-003": "The rectangle lies far outside the image."; "Give pixels of the left image.";
        OffImage = "PB3DP-REG-004": "The whole region lies outside the left image."; "Check the coordinates: x to the right, y down, from the upper left corner.";
        TooSmall = "PB3DP-REG-005": "The region has too few pixels."; "Mark a larger area of the target.";
        MaskSize = "PB3DP-REG-006": "The mask and the left image differ in size."; "Draw the mask on the left image without resizing it.";
        ClickOffImage = "PB3DP-REG-007": "The click lies outside the left image."; "Give a pixel of the left image.";
        ClickGrewTooFar = "PB3DP-REG-008": "The region that grew from the click covers most of the image: the click hit the background, or the background has the target's colour."; "Mark a rectangle or a polygon.";
        ClickTooSmall = "PB3DP-REG-009": "The region that grew from the click has too few pixels."; "Click on a larger patch of one colour, or mark a rectangle or a polygon.";
    }
}
