//! Exposure, gain, white balance and focus: set, and read back.
//!
//! Automatic modes are disabled unless they are requested. Otherwise the left and right camera would choose different values and
//! their images would differ. Autofocus changes the calibrated focal length. Automatic exposure changes the exposure time, which
//! is needed for the timestamps, and may lower the frame rate.

use std::io;
use std::time::Duration;

use pb3dp_camera_settings::{ControlSettings, Setting};
use pb3dp_hal_api::CameraError;

use crate::error::{failed, unusable};
use crate::video::{ControlEntry, ControlKind, VideoNode};

/// Maximum number of controls; protects against a driver whose list does not end.
const CONTROLS_MAX: usize = 512;

/// Control IDs, `include/uapi/linux/v4l2-controls.h`.
pub mod id {
    /// Automatic white balance, 0 or 1.
    pub const AUTO_WHITE_BALANCE: u32 = 0x0098_090C;
    /// Automatic gain, 0 or 1.
    pub const AUTO_GAIN: u32 = 0x0098_0912;
    /// Gain, in units of the driver.
    pub const GAIN: u32 = 0x0098_0913;
    /// White balance, kelvin.
    pub const WHITE_BALANCE_TEMPERATURE: u32 = 0x0098_091A;
    /// Exposure mode: see the menu.
    pub const EXPOSURE_AUTO: u32 = 0x009A_0901;
    /// Exposure time, 100 microseconds.
    pub const EXPOSURE_ABSOLUTE: u32 = 0x009A_0902;
    /// Whether the frame rate may drop in the dark, 0 or 1.
    pub const EXPOSURE_AUTO_PRIORITY: u32 = 0x009A_0903;
    /// Focus, in units of the driver.
    pub const FOCUS_ABSOLUTE: u32 = 0x009A_090A;
    /// Autofocus, 0 or 1.
    pub const FOCUS_AUTO: u32 = 0x009A_090C;
    /// Focal length of a zoom lens, in units of the driver.
    pub const ZOOM_ABSOLUTE: u32 = 0x009A_090D;
}

/// Item of the menu `EXPOSURE_AUTO`: manual.
const EXPOSURE_MANUAL: i32 = 1;
/// Items of that menu: automatic time with fixed aperture, and fully automatic.
const EXPOSURE_BY_CAMERA: [i32; 2] = [3, 0];

/// The unit of [`id::EXPOSURE_ABSOLUTE`].
pub(crate) const EXPOSURE_UNIT: Duration = Duration::from_micros(100);

/// Focus setting of a lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Focus {
    /// Manual lens: the camera does not control it.
    ByHand,
    /// This value, in units of the driver.
    Fixed(i32),
    /// Autofocus is active.
    Automatic,
}

/// Present focus setting of a camera.
///
/// # Errors
/// Errors of the driver.
pub fn focus_now(node: &dyn VideoNode, device: &str) -> Result<Focus, CameraError> {
    let controls = read(node, device)?;
    let value = |id| find(&controls, id).and_then(|control| control.value);
    Ok(match (value(id::FOCUS_AUTO), value(id::FOCUS_ABSOLUTE)) {
        (Some(mode), _) if mode != 0 => Focus::Automatic,
        (_, Some(value)) => Focus::Fixed(value),
        (_, None) => Focus::ByHand,
    })
}

/// A control with its value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Control {
    /// Description by the driver.
    pub entry: ControlEntry,
    /// Value; `None` if the control has none or cannot be read.
    pub value: Option<i32>,
    /// Menu items.
    pub menu: Vec<(i32, String)>,
}

/// Unit of the values of a control, and the size of the value 1 in it; `None` if only the driver knows.
pub fn unit_of(id: u32) -> Option<(&'static str, f64)> {
    match id {
        id::EXPOSURE_ABSOLUTE => Some(("ms", EXPOSURE_UNIT.as_secs_f64() * 1e3)),
        id::WHITE_BALANCE_TEMPERATURE => Some(("K", 1.0)),
        _ => None,
    }
}

/// Whether the camera sets this control by itself at present; `None` if it has no automatic mode.
pub fn is_automatic(controls: &[Control], id: u32) -> Option<bool> {
    let mode = |id| find(controls, id).and_then(|control| control.value);
    match id {
        id::EXPOSURE_ABSOLUTE => mode(id::EXPOSURE_AUTO).map(|mode| EXPOSURE_BY_CAMERA.contains(&mode)),
        id::GAIN => mode(id::AUTO_GAIN).map(|mode| mode != 0),
        id::WHITE_BALANCE_TEMPERATURE => mode(id::AUTO_WHITE_BALANCE).map(|mode| mode != 0),
        id::FOCUS_ABSOLUTE => mode(id::FOCUS_AUTO).map(|mode| mode != 0),
        _ => None,
    }
}

/// Whether a control moves the lens, so that a calibration no longer holds.
pub fn moves_the_lens(id: u32) -> bool {
    matches!(id, id::FOCUS_ABSOLUTE | id::FOCUS_AUTO | id::ZOOM_ABSOLUTE)
}

/// All controls of a device with their values.
///
/// # Errors
/// Errors of the driver.
pub fn controls(node: &dyn VideoNode) -> io::Result<Vec<Control>> {
    let mut controls = Vec::new();
    let mut after = 0;
    while controls.len() < CONTROLS_MAX {
        let Some(entry) = node.control_after(after)? else { break };
        if entry.id <= after {
            break;
        }
        after = entry.id;
        if entry.kind == ControlKind::Other {
            continue;
        }
        let value = if entry.kind == ControlKind::Button { None } else { node.control(entry.id).ok() };
        let mut menu = Vec::new();
        if entry.kind == ControlKind::Menu {
            for line in entry.min.max(0)..=entry.max.min(255) {
                menu.extend(node.menu_line(entry.id, line as u32)?.map(|text| (line, text)));
            }
        }
        controls.push(Control { entry, value, menu });
    }
    Ok(controls)
}

/// Sets one control and reads it back.
///
/// # Errors
/// There is no control with this number, the value is not possible or is not kept, or an error of the driver.
pub fn set(node: &mut dyn VideoNode, device: &str, id: u32, value: i32) -> Result<(), CameraError> {
    let controls = read(node, device)?;
    let control = find(&controls, id).ok_or_else(|| unusable(device, format!("it has no control {id:#010x}")))?;
    write(node, device, &control.entry, value)?;
    verify(node, device, &control.entry, value)
}

/// Applies the requested controls to a camera, and reads everything back at the end. Returns the exposure time if the camera
/// reports it.
///
/// # Errors
/// A requested property is not available, a value is not possible or not kept, or an error of the driver.
pub fn apply(
    node: &mut dyn VideoNode,
    device: &str,
    requests: &ControlSettings,
) -> Result<Option<Duration>, CameraError> {
    let controls = read(node, device)?;
    let mut plan = Plan { device, controls: &controls, steps: Vec::new() };
    plan.exposure(requests.exposure)?;
    plan.property("gain", id::AUTO_GAIN, id::GAIN, requests.gain)?;
    plan.property("white balance", id::AUTO_WHITE_BALANCE, id::WHITE_BALANCE_TEMPERATURE, requests.white_balance)?;
    plan.property("focus", id::FOCUS_AUTO, id::FOCUS_ABSOLUTE, requests.focus)?;
    for (id, value) in &requests.others {
        let control = find(&controls, *id).ok_or_else(|| unusable(device, format!("it has no control {id:#010x}")))?;
        plan.steps.push((control, *value));
    }
    for (control, value) in &plan.steps {
        write(node, device, &control.entry, *value)?;
    }
    // At the end: setting a control may change another one.
    for (control, value) in &plan.steps {
        verify(node, device, &control.entry, *value)?;
    }
    exposure(node, device, &controls)
}

/// Present exposure time of a camera; `None` if the camera does not report it, or in automatic mode.
///
/// # Errors
/// Errors of the driver.
pub fn exposure_now(node: &dyn VideoNode, device: &str) -> Result<Option<Duration>, CameraError> {
    exposure(node, device, &read(node, device)?)
}

/// As [`exposure_now`], for known controls.
fn exposure(node: &dyn VideoNode, device: &str, controls: &[Control]) -> Result<Option<Duration>, CameraError> {
    let is_by_hand = match find(controls, id::EXPOSURE_AUTO) {
        Some(_) => {
            let mode =
                node.control(id::EXPOSURE_AUTO).map_err(|error| failed(device, "reading its exposure mode", error))?;
            mode == EXPOSURE_MANUAL
        }
        None => true,
    };
    if !is_by_hand || find(controls, id::EXPOSURE_ABSOLUTE).is_none() {
        return Ok(None);
    }
    let units = node.control(id::EXPOSURE_ABSOLUTE).map_err(|error| failed(device, "reading its exposure", error))?;
    Ok(u32::try_from(units).ok().map(|units| EXPOSURE_UNIT * units))
}

/// The controls to write, in this order.
struct Plan<'a> {
    device: &'a str,
    controls: &'a [Control],
    steps: Vec<(&'a Control, i32)>,
}

impl Plan<'_> {
    fn exposure(&mut self, request: Setting<Duration>) -> Result<(), CameraError> {
        let value = match request {
            Setting::Manual(time) => {
                let units = (time.as_nanos() + EXPOSURE_UNIT.as_nanos() / 2) / EXPOSURE_UNIT.as_nanos();
                Setting::Manual(i32::try_from(units).unwrap_or(i32::MAX))
            }
            Setting::Keep => Setting::Keep,
            Setting::Auto => Setting::Auto,
        };
        if let Some(mode) = find(self.controls, id::EXPOSURE_AUTO) {
            let has = |line: &i32| mode.menu.iter().any(|(number, _)| number == line);
            let line = match value {
                Setting::Auto => EXPOSURE_BY_CAMERA.into_iter().find(has),
                _ => Some(EXPOSURE_MANUAL).filter(has),
            };
            let line = line.ok_or_else(|| {
                unusable(self.device, format!("its control `{}` does not have the requested mode", mode.entry.name))
            })?;
            self.steps.push((mode, line));
        }
        // A dark scene must not lower the frame rate.
        self.steps.extend(find(self.controls, id::EXPOSURE_AUTO_PRIORITY).map(|control| (control, 0)));
        self.value("exposure time", id::EXPOSURE_ABSOLUTE, value)
    }

    fn property(&mut self, name: &str, auto: u32, value: u32, request: Setting<i32>) -> Result<(), CameraError> {
        let by_camera = i32::from(request == Setting::Auto);
        match find(self.controls, auto) {
            Some(control) => self.steps.push((control, by_camera)),
            None if by_camera == 1 => return Err(self.lacks(name, "automatic mode")),
            None => {}
        }
        self.value(name, value, request)
    }

    fn value(&mut self, name: &str, id: u32, request: Setting<i32>) -> Result<(), CameraError> {
        if let Setting::Manual(value) = request {
            let control = find(self.controls, id).ok_or_else(|| self.lacks(name, "control"))?;
            self.steps.push((control, value));
        }
        Ok(())
    }

    fn lacks(&self, name: &str, what: &str) -> CameraError {
        let there: Vec<&str> = self.controls.iter().map(|control| control.entry.name.as_str()).collect();
        unusable(
            self.device,
            format!("it has no {what} for the {name}; remove this setting, or use one of: {}", there.join(", ")),
        )
    }
}

fn read(node: &dyn VideoNode, device: &str) -> Result<Vec<Control>, CameraError> {
    controls(node).map_err(|error| failed(device, "reading its controls", error))
}

fn find(controls: &[Control], id: u32) -> Option<&Control> {
    controls.iter().find(|control| control.entry.id == id)
}

pub(crate) fn write(
    node: &mut dyn VideoNode,
    device: &str,
    entry: &ControlEntry,
    value: i32,
) -> Result<(), CameraError> {
    let ControlEntry { id, name, min, max, step, .. } = entry;
    let is_step = *step <= 1 || (i64::from(value) - i64::from(*min)) % i64::from(*step) == 0;
    if value < *min || value > *max || !is_step {
        return Err(unusable(
            device,
            format!("`{name}` cannot be {value}; its range is {min} to {max} in steps of {step}"),
        ));
    }
    node.set_control(*id, value).map_err(|error| failed(device, &format!("setting `{name}` to {value}"), error))
}

pub(crate) fn verify(node: &dyn VideoNode, device: &str, entry: &ControlEntry, value: i32) -> Result<(), CameraError> {
    if entry.kind == ControlKind::Button {
        return Ok(());
    }
    let name = &entry.name;
    let found = node.control(entry.id).map_err(|error| failed(device, &format!("reading `{name}` back"), error))?;
    if found != value {
        return Err(unusable(device, format!("`{name}` was set to {value}, but the driver reports {found}")));
    }
    Ok(())
}
