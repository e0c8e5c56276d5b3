//! From the system's errors to those of a camera: each names the device, what was tried, and what to do.

use std::io;

use pb3dp_hal_api::{CameraError, CameraErrorKind};
use rustix::io::Errno;

/// A sentence about a device, without an error of the system behind it.
pub(crate) fn unusable(device: &str, what: impl std::fmt::Display) -> CameraError {
    CameraError::new(CameraErrorKind::Unusable, format!("{device}: {what}"))
}

/// What an error of the system means, and what helps.
pub(crate) fn failed(device: &str, doing: &str, error: io::Error) -> CameraError {
    let (kind, advice) = match Errno::from_io_error(&error) {
        Some(Errno::NODEV | Errno::NXIO | Errno::SHUTDOWN | Errno::NOENT) => {
            (CameraErrorKind::Disconnected, "the camera is gone; look at its plug, cable and hub, then open it again")
        }
        Some(Errno::IO | Errno::PROTO | Errno::PIPE) => (
            CameraErrorKind::Disconnected,
            "the camera does not answer as it should; look at its plug, cable and hub, then open it again",
        ),
        Some(Errno::BUSY) => (
            CameraErrorKind::Unusable,
            "another program has it (`fuser -v /dev/video*` shows which one); end that program, then open it again",
        ),
        Some(Errno::ACCESS | Errno::PERM) => (
            CameraErrorKind::Unusable,
            "this user may not use it; make the user a member of the group that `ls -l /dev/video*` shows, and log in again",
        ),
        Some(Errno::NOSPC) => (
            CameraErrorKind::Unusable,
            "the USB bus has no room for its images; plug the cameras into ports of different controllers, or ask for MJPG, a \
             smaller size or a lower rate",
        ),
        _ => (CameraErrorKind::Unusable, "the driver refuses it; `dmesg` may say why"),
    };
    CameraError::caused_by(kind, format!("{device}: {doing} failed: {advice}"), error)
}
