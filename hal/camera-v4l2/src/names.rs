//! Persistent camera names, and the device for a name.
//!
//! The number in `/dev/video0` depends on the order of detection, so left and right could be exchanged at the next boot. The port
//! of a camera (`bus:usb-0000:00:14.0-2`) and its serial number (`serial:4F5A19C0`) are persistent.

use std::path::PathBuf;

use pb3dp_camera_settings::CameraName;
use pb3dp_hal_api::{CameraError, CameraErrorKind};

use crate::error::{failed, unusable};
use crate::video::{Capability, NodeEntry, VideoNode, VideoSystem};

/// A device that captures images.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CaptureDevice {
    /// Entry in the device list.
    pub entry: NodeEntry,
    /// Capability reported by the device.
    pub capability: Capability,
}

impl CaptureDevice {
    /// Names that are still valid after the next boot, the best one first.
    pub fn stable_names(&self) -> Vec<CameraName> {
        let index = self.entry.index.filter(|index| *index > 0);
        let bus = Some(self.capability.bus.clone()).filter(|bus| !bus.is_empty());
        let bus = bus.map(|bus| CameraName::Bus { bus, index });
        let serial = self.entry.serial.clone().map(|serial| CameraName::Serial { serial, index });
        bus.into_iter().chain(serial).collect()
    }

    fn has(&self, name: &CameraName) -> bool {
        let is_node = |index: &Option<u32>| index.is_none() || *index == self.entry.index;
        match name {
            CameraName::Path(path) => self.entry.path == *path,
            CameraName::Bus { bus, index } => self.capability.bus == *bus && is_node(index),
            CameraName::Serial { serial, index } => self.entry.serial.as_ref() == Some(serial) && is_node(index),
        }
    }
}

/// The result of a search for cameras.
#[derive(Debug, Default)]
pub struct Listing {
    /// Devices that capture images, sorted by path.
    pub found: Vec<CaptureDevice>,
    /// Devices that could not be queried.
    pub refused: Vec<(PathBuf, CameraError)>,
}

/// Searches for cameras; other nodes are skipped.
///
/// # Errors
/// The system cannot list the devices.
pub fn list(system: &dyn VideoSystem) -> Result<Listing, CameraError> {
    let entries = system.entries().map_err(|error| failed("cameras", "listing the devices", error))?;
    let mut listing = Listing::default();
    for entry in entries {
        let device = entry.path.display().to_string();
        let asked = system
            .open(&entry.path)
            .map_err(|error| failed(&device, "opening the device", error))
            .and_then(|node| node.capability().map_err(|error| failed(&device, "reading its capabilities", error)));
        match asked {
            Ok(capability) if capability.captures && capability.streams => {
                listing.found.push(CaptureDevice { entry, capability })
            }
            Ok(_) => {}
            Err(error) => listing.refused.push((entry.path, error)),
        }
    }
    Ok(listing)
}

/// Opens the camera with this name.
///
/// # Errors
/// `Disconnected` if there is none; `Unusable` if the name matches several cameras, or the camera may not be opened.
pub fn open(system: &dyn VideoSystem, name: &CameraName) -> Result<(CaptureDevice, Box<dyn VideoNode>), CameraError> {
    let device = name.to_string();
    // A udev rule may have given the node another name.
    let name = &match name {
        CameraName::Path(path) => CameraName::Path(system.resolve(path).unwrap_or_else(|| path.clone())),
        CameraName::Bus { .. } | CameraName::Serial { .. } => name.clone(),
    };
    let listing = list(system)?;
    let mut fitting: Vec<&CaptureDevice> = listing.found.iter().filter(|found| found.has(name)).collect();
    // Of several nodes of one device the first one is used; the same serial number on two devices is ambiguous.
    let first = fitting.iter().map(|found| found.entry.index).min().unwrap_or_default();
    fitting.retain(|found| found.entry.index == first);
    let found = match fitting.as_slice() {
        [found] => (*found).clone(),
        [] => return Err(missing(system, &device, name, listing)),
        several => {
            let names: Vec<String> = several.iter().map(|found| describe(found)).collect();
            let what = format!(
                "this name matches {} cameras: {}; use the name of a port, bus:...",
                names.len(),
                names.join(", ")
            );
            return Err(unusable(&device, what));
        }
    };
    let node = system.open(&found.entry.path).map_err(|error| failed(&device, "opening the device", error))?;
    // Another camera may have taken the path since the listing.
    let capability = node.capability().map_err(|error| failed(&device, "reading its capabilities", error))?;
    if capability != found.capability {
        let message =
            format!("{device}: {} now belongs to another camera; open the camera again", found.entry.path.display());
        return Err(CameraError::new(CameraErrorKind::Disconnected, message));
    }
    Ok((found, node))
}

fn describe(found: &CaptureDevice) -> String {
    let name = found.stable_names().first().map_or_else(String::new, |name| format!(" {name}"));
    format!("{}{name} ({})", found.entry.path.display(), found.capability.card)
}

fn missing(system: &dyn VideoSystem, device: &str, name: &CameraName, mut listing: Listing) -> CameraError {
    // A device that cannot be queried could be the requested one; its own error is more specific.
    let is_asked_for = |path: &PathBuf| !matches!(name, CameraName::Path(asked) if asked != path);
    if let Some(at) = listing.refused.iter().position(|(path, _)| is_asked_for(path)) {
        let (_, error) = listing.refused.swap_remove(at);
        let message = format!("{device}: no accessible camera has this name, and one device cannot be queried");
        return CameraError::caused_by(error.kind(), message, error);
    }
    let there: Vec<String> = listing.found.iter().map(describe).collect();
    let there = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
    if let CameraName::Path(path) = name
        && system.resolve(path).is_some()
    {
        return unusable(device, format!("not a capture device; available cameras: {there}"));
    }
    let message = format!("{device}: no such camera; check plug and cable; available cameras: {there}");
    CameraError::new(CameraErrorKind::Disconnected, message)
}
