//! Persistent camera names, independent of the device numbers.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// The name of a camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CameraName {
    /// Its port, as reported by the driver.
    Bus {
        /// Bus string reported by the driver.
        bus: String,
        /// Index of the device node; default: the first one that captures.
        index: Option<u32>,
    },
    /// Its serial number.
    Serial {
        /// Serial number reported by the system.
        serial: String,
        /// Index of the device node; default: the first one that captures.
        index: Option<u32>,
    },
    /// The file of its node, which may belong to another camera after a restart.
    Path(PathBuf),
}

/// A text that is not a camera name.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{0}` is not a camera name; write bus:PLACE, serial:NUMBER (both as shown by `pb3dp cameras list`) or /dev/videoN"
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
