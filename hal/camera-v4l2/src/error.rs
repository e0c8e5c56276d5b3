//! Conversion of system errors to camera errors: each names the device, the failed operation, and the remedy.

use std::io;

use pb3dp_hal_api::{CameraError, CameraErrorKind};
use rustix::io::Errno;

/// An error of a device without an underlying system error.
pub(crate) fn unusable(device: &str, what: impl std::fmt::Display) -> CameraError {
    CameraError::new(CameraErrorKind::Unusable, format!("{device}: {what}"))
}

/// The meaning of a system error, and the remedy.
pub(crate) fn failed(device: &str, doing: &str, error: io::Error) -> CameraError {
    let (kind, advice) = match Errno::from_io_error(&error) {
        Some(Errno::NODEV | Errno::NXIO | Errno::SHUTDOWN | Errno::NOENT) => (
            CameraErrorKind::Disconnected,
            "the camera is disconnected; check its plug, cable and hub, then open it again",
        ),
        Some(Errno::IO | Errno::PROTO | Errno::PIPE) => (
            CameraErrorKind::Disconnected,
            "the camera does not respond correctly; check its plug, cable and hub, then open it again",
        ),
        Some(Errno::BUSY) => (
            CameraErrorKind::Unusable,
            "the device is used by another program (`fuser -v /dev/video*` shows which one); end that program, then open the camera again",
        ),
        Some(Errno::ACCESS | Errno::PERM) => (
            CameraErrorKind::Unusable,
            "permission denied; add the user to the group shown by `ls -l /dev/video*`, and log in again",
        ),
        Some(Errno::NOSPC) => (
            CameraErrorKind::Unusable,
            "not enough USB bandwidth; connect the cameras to ports of different controllers, or use MJPG, a \
             smaller size or a lower frame rate",
        ),
        _ => (CameraErrorKind::Unusable, "the driver refused the request; `dmesg` may show the reason"),
    };
    CameraError::caused_by(kind, format!("{device}: {doing} failed: {advice}"), error)
}
