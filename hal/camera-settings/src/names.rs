//! Names of cameras that stay theirs, whatever number their devices get.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// What a camera is known by.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CameraName {
    /// Where it is plugged in, as its driver tells it.
    Bus {
        /// As the driver tells it.
        bus: String,
        /// Which of the device's nodes; without it the first one that captures.
        index: Option<u32>,
    },
    /// Its serial number.
    Serial {
        /// As the system tells it.
        serial: String,
        /// Which of the device's nodes; without it the first one that captures.
        index: Option<u32>,
    },
    /// The file of its node, which may be another camera's tomorrow.
    Path(PathBuf),
}

/// A text that is no name of a camera.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` names no camera: write bus:PLACE, serial:NUMBER (both as `pb3dp cameras list` shows them) or /dev/videoN"
)]
pub struct CameraNameError(String);

impl FromStr for CameraName {
    type Err = CameraNameError;

    fn from_str(text: &str) -> Result<Self, CameraNameError> {
        let error = || CameraNameError(text.to_owned());
        if text.starts_with('/') {
            return Ok(Self::Path(text.into()));
        }
        let (kind, rest) = text.split_once(':').ok_or_else(error)?;
        let (name, index) = match rest.rsplit_once('#') {
            Some((name, index)) => (name, Some(index.parse().map_err(|_| error())?)),
            None => (rest, None),
        };
        let name = Some(name.to_owned()).filter(|name| !name.is_empty()).ok_or_else(error)?;
        match kind {
            "bus" => Ok(Self::Bus { bus: name, index }),
            "serial" => Ok(Self::Serial { serial: name, index }),
            _ => Err(error()),
        }
    }
}

impl fmt::Display for CameraName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (kind, name, index) = match self {
            Self::Path(path) => return write!(f, "{}", path.display()),
            Self::Bus { bus, index } => ("bus", bus, index),
            Self::Serial { serial, index } => ("serial", serial, index),
        };
        write!(f, "{kind}:{name}")?;
        index.map_or(Ok(()), |index| write!(f, "#{index}"))
    }
}
