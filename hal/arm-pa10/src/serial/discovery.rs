//! List of serial ports.

use std::fmt;
use std::path::{Path, PathBuf};

use serialport::{SerialPortType, available_ports};

/// Folder of all terminals in Linux.
const TERMINALS: &str = "/sys/class/tty";

/// Folder of names that stay with an adapter.
const STABLE_NAMES: &str = "/dev/serial/by-id";

/// A serial port with its properties.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PortDescription {
    /// `/dev/ttyUSB0`: may be another adapter after a restart.
    pub path: String,
    /// A name that stays with the adapter, if the system has one: for configurations.
    pub stable_path: Option<PathBuf>,
    /// Its kind.
    pub kind: PortKind,
}

/// Kind of a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PortKind {
    /// A USB adapter.
    Usb {
        /// Vendor ID.
        vendor_id: u16,
        /// Product ID.
        product_id: u16,
        /// Product name.
        product: Option<String>,
        /// Serial number.
        serial_number: Option<String>,
    },
    /// Built in.
    BuiltIn,
    /// Bluetooth.
    Bluetooth,
    /// Unknown.
    Unknown,
}

/// The serial ports of this computer, sorted by path, without pseudo-terminals.
///
/// # Errors
/// If the system returns an error.
pub fn ports() -> Result<Vec<PortDescription>, serialport::Error> {
    if !Path::new(TERMINALS).is_dir() {
        // serialport panics here.
        let description = format!("{TERMINALS} is missing: is this Linux, with /sys mounted?");
        return Err(serialport::Error::new(serialport::ErrorKind::NoDevice, description));
    }
    let describe = |port: serialport::SerialPortInfo| PortDescription {
        stable_path: stable_path(Path::new(&port.port_name)),
        kind: kind(port.port_type),
        path: port.port_name,
    };
    let mut ports: Vec<_> = available_ports()?.into_iter().map(describe).collect();
    ports.sort_by(|one, other| one.path.cmp(&other.path));
    Ok(ports)
}

/// List of ports for messages.
pub(super) fn names() -> String {
    match ports() {
        Ok(ports) if ports.is_empty() => "there are no serial ports".to_owned(),
        Ok(ports) => {
            let paths: Vec<_> = ports.into_iter().map(|port| port.path).collect();
            format!("there are {}", paths.join(", "))
        }
        Err(error) => format!("ports cannot be listed: {error}"),
    }
}

fn kind(port_type: SerialPortType) -> PortKind {
    match port_type {
        SerialPortType::UsbPort(usb) => PortKind::Usb {
            vendor_id: usb.vid,
            product_id: usb.pid,
            product: usb.product,
            serial_number: usb.serial_number,
        },
        SerialPortType::PciPort => PortKind::BuiltIn,
        SerialPortType::BluetoothPort => PortKind::Bluetooth,
        SerialPortType::Unknown => PortKind::Unknown,
    }
}

fn stable_path(port: &Path) -> Option<PathBuf> {
    let target = port.canonicalize().ok()?;
    let names = std::fs::read_dir(STABLE_NAMES).ok()?;
    let mut names: Vec<_> = names.filter_map(|entry| Some(entry.ok()?.path())).collect();
    names.sort();
    names.into_iter().find(|name| name.canonicalize().is_ok_and(|other| other == target))
}

impl fmt::Display for PortDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.path)?;
        match &self.kind {
            PortKind::Usb { vendor_id, product_id, product, serial_number } => {
                write!(f, ": USB {vendor_id:04x}:{product_id:04x}")?;
                for text in [product, serial_number].into_iter().flatten() {
                    write!(f, " {text}")?;
                }
            }
            PortKind::BuiltIn => f.write_str(": built in")?,
            PortKind::Bluetooth => f.write_str(": Bluetooth")?,
            PortKind::Unknown => {}
        }
        if let Some(stable) = &self.stable_path {
            write!(f, " ({})", stable.display())?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_is_described_with_what_is_known() {
        let usb = PortKind::Usb {
            vendor_id: 0x0403,
            product_id: 0x6001,
            product: Some("FT232R".to_owned()),
            serial_number: Some("A50285BI".to_owned()),
        };
        let port = PortDescription {
            path: "/dev/ttyUSB0".to_owned(),
            stable_path: Some("/dev/serial/by-id/x".into()),
            kind: usb,
        };
        assert_eq!(port.to_string(), "/dev/ttyUSB0: USB 0403:6001 FT232R A50285BI (/dev/serial/by-id/x)");
        let plain = PortDescription { path: "/dev/ttyS0".to_owned(), stable_path: None, kind: PortKind::BuiltIn };
        assert_eq!(plain.to_string(), "/dev/ttyS0: built in");
    }

    #[test]
    fn ports_can_be_listed() {
        // The ports depend on the machine; the order and the absence of pseudo-terminals do not.
        if let Ok(ports) = ports() {
            assert!(ports.is_sorted_by(|one, other| one.path < other.path), "{ports:?}");
            assert!(ports.iter().all(|port| !port.path.starts_with("/dev/pts/")), "{ports:?}");
        }
    }
}
