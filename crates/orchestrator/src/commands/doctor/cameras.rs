//! Cameras and their connection to the computer.

use super::access::{Identity, denied};
use super::needs::{Cameras, Needs};
use super::system::System;
use pb3dp_camera_settings::CameraName;
use pb3dp_cell::finding::{Finding, Verdict};

/// Mbit/s of USB 2: the speed of a camera that is connected with it.
const USB2_MBIT_PER_S: f64 = 480.0;

/// A camera in the list of the kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
struct ConnectedCamera {
    /// `/dev/video0`.
    path: String,
    name: String,
    /// `None` if it is not a USB device.
    usb: Option<UsbPlace>,
    /// Serial number of its USB device.
    serial: Option<String>,
}

impl ConnectedCamera {
    /// Whether the camera has this name.
    fn has(&self, name: &CameraName) -> bool {
        match name {
            CameraName::Path(path) => path.as_os_str() == self.path.as_str(),
            CameraName::Serial { serial, .. } => self.serial.as_ref() == Some(serial),
            CameraName::Bus { bus, .. } => self.bus().as_ref() == Some(bus),
        }
    }

    /// Its port as reported by the driver (`usb_make_path` of the kernel): `usb-0000:00:14.0-2.3`.
    fn bus(&self) -> Option<String> {
        let usb = self.usb.as_ref()?;
        let (_, sockets) = usb.port.split_once('-')?;
        Some(format!("usb-{}-{sockets}", usb.controller))
    }
}

/// USB location of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
struct UsbPlace {
    /// The controller: `0000:00:14.0`.
    controller: String,
    /// The bus: `usb1`. A controller of USB 3 has two.
    bus: String,
    /// Ports from the computer to the device: `1-2.3`.
    port: String,
    /// `480`, Mbit/s.
    speed: Option<String>,
}

/// All checks of cameras.
pub(super) fn check(system: &dyn System, needs: &Needs) -> Vec<Finding> {
    const CHECK: &str = "cameras";
    if needs.cameras == Cameras::NotNeeded {
        return vec![Finding::pass(CHECK, format!("{} needs no camera", needs.source))];
    }
    let Some(who) = Identity::of(system) else { return Vec::new() };
    let cameras = found(system);
    let names = match &needs.cameras {
        Cameras::These([left, right]) => vec![("left", left), ("right", right)],
        Cameras::One(both) => vec![("left", both)],
        Cameras::NotNeeded | Cameras::Perhaps => Vec::new(),
    };
    if !names.is_empty() {
        let mut findings = named(system, &who, &cameras, &names);
        findings.push(calibration(needs));
        return findings;
    }
    if cameras.is_empty() {
        let advice = "simulation needs no camera; otherwise check cable and hub, and the output of `lsusb` and `dmesg`";
        return vec![Finding::warning(CHECK, "no camera is connected (/sys/class/video4linux)", advice)];
    }
    let mut findings: Vec<_> = cameras.iter().map(|camera| usable(system, &who, camera)).collect();
    findings.extend(topology(&cameras));
    findings
}

/// The cameras of a setup, each with the name of its table.
fn named(
    system: &dyn System,
    who: &Identity,
    cameras: &[ConnectedCamera],
    names: &[(&str, &CameraName)],
) -> Vec<Finding> {
    const CHECK: &str = "cameras";
    let (mut findings, mut chosen) = (Vec::new(), Vec::new());
    for &(side, name) in names {
        let camera_of = if names.len() == 1 { "the camera".to_owned() } else { format!("the {side} camera") };
        if is_of_driver(name) {
            let found = format!("{camera_of}, {name}, cannot be checked here; only its driver knows it");
            findings.push(Finding::warning(CHECK, found, "check that `pb3dp cameras list` shows it"));
            continue;
        }
        match cameras.iter().find(|camera| camera.has(name)) {
            Some(camera) => {
                let finding = usable(system, who, camera);
                findings.push(if finding.verdict == Verdict::Pass {
                    finding
                } else {
                    Finding { verdict: Verdict::Fail, ..finding }
                });
                chosen.push(camera.clone());
            }
            None => {
                let there: Vec<String> = cameras
                    .iter()
                    .map(|camera| format!("{} at {}", camera.path, camera.bus().unwrap_or_default()))
                    .collect();
                let there = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
                let advice = format!("check cable and hub, or correct camera.{side}.device; connected: {there}");
                findings.push(Finding::fail(CHECK, format!("{camera_of}, {name}, is not connected"), advice));
            }
        }
    }
    if let [left, right] = &chosen[..]
        && left.path == right.path
    {
        let found = format!("left and right are the same camera, {}", left.path);
        findings.push(Finding::fail(CHECK, found, "give each side its own camera"));
        chosen.pop();
    }
    findings.extend(topology(&chosen));
    findings
}

/// Whether the setup names a real calibration of its cameras, according to the file.
fn calibration(needs: &Needs) -> Finding {
    const CHECK: &str = "calibration";
    match &needs.nominal_calibration {
        None => Finding::pass(CHECK, "the calibration was measured"),
        Some(says) => {
            let advice = "calibrate the cameras, and name the file in camera.calibration; until then real arms move only with \
                          --nominal-calibration";
            Finding::warning(CHECK, format!("the calibration of {} was not measured ({says})", needs.source), advice)
        }
    }
}

/// Whether only the driver can resolve this name.
fn is_of_driver(name: &CameraName) -> bool {
    matches!(name, CameraName::Bus { bus, .. } if !bus.starts_with("usb-"))
}

/// The image nodes: the first one of each camera.
fn found(system: &dyn System) -> Vec<ConnectedCamera> {
    let folder = "/sys/class/video4linux";
    let names = system.names(folder).into_iter().filter(|name| name.starts_with("video"));
    let is_first = |name: &String| system.text(&format!("{folder}/{name}/index")).is_none_or(|index| index == "0");
    let camera = |name: String| {
        let (usb, serial) = usb_place(system, &format!("{folder}/{name}/device")).unzip();
        ConnectedCamera {
            name: system.text(&format!("{folder}/{name}/name")).unwrap_or_else(|| "without a name".to_owned()),
            usb,
            serial: serial.flatten(),
            path: format!("/dev/{name}"),
        }
    };
    names.filter(is_first).map(camera).collect()
}

/// Port and serial number, from `/sys/devices/pci0000:00/0000:00:14.0/usb1/1-2/1-2.3/1-2.3:1.0`.
fn usb_place(system: &dyn System, device: &str) -> Option<(UsbPlace, Option<String>)> {
    let target = system.target(device)?;
    let parts: Vec<&str> = target.split('/').collect();
    let is_bus = |part: &&str| {
        part.strip_prefix("usb").is_some_and(|rest| !rest.is_empty() && rest.bytes().all(|b| b.is_ascii_digit()))
    };
    let bus = parts.iter().position(is_bus)?;
    let after = &parts[bus + 1..];
    let depth = after.iter().take_while(|part| part.contains('-') && !part.contains(':')).count();
    let port = after[..depth].last()?;
    let device = format!("{}/{}", parts[..=bus].join("/"), after[..depth].join("/"));
    let place = UsbPlace {
        controller: bus.checked_sub(1).map(|index| parts[index].to_owned())?,
        bus: parts[bus].to_owned(),
        port: (*port).to_owned(),
        speed: system.text(&format!("{device}/speed")),
    };
    Some((place, system.text(&format!("{device}/serial"))))
}

fn usable(system: &dyn System, who: &Identity, camera: &ConnectedCamera) -> Finding {
    const CHECK: &str = "cameras";
    let ConnectedCamera { path, name, .. } = camera;
    let Some(node) = system.node(path) else {
        let advice = "check that udev runs, and that this program can access /dev (containers)";
        return Finding::warning(CHECK, format!("{path} ({name}) is listed, but has no device file"), advice);
    };
    match denied(system, who, path, &node) {
        Some((found, advice)) => Finding::warning(CHECK, found, advice),
        None => Finding::pass(CHECK, format!("{path} ({name}) is connected, and this user can use it")),
    }
}

/// Two cameras that share a bus which one of them fills.
fn topology(cameras: &[ConnectedCamera]) -> Vec<Finding> {
    const CHECK: &str = "USB topology";
    let at_usb: Vec<(&ConnectedCamera, &UsbPlace)> =
        cameras.iter().filter_map(|camera| camera.usb.as_ref().map(|usb| (camera, usb))).collect();
    let mbit = |usb: &UsbPlace| usb.speed.as_ref().and_then(|speed| speed.parse::<f64>().ok());
    let mut findings = Vec::new();
    for (camera, usb) in &at_usb {
        if mbit(usb).is_some_and(|speed| speed < USB2_MBIT_PER_S) {
            let speed = usb.speed.as_deref().unwrap_or_default();
            findings.push(Finding::fail(
                CHECK,
                format!("{} runs at {speed} Mbit/s", camera.path),
                "use another or a shorter cable, or another socket: images need at least 480 Mbit/s",
            ));
        }
    }
    for (index, (camera, usb)) in at_usb.iter().enumerate() {
        for (other, other_usb) in &at_usb[index + 1..] {
            let pair = format!("{} (port {}) and {} (port {})", camera.path, usb.port, other.path, other_usb.port);
            let is_slow = mbit(usb).is_none_or(|speed| speed <= USB2_MBIT_PER_S);
            findings.push(if usb.bus != other_usb.bus {
                Finding::pass(CHECK, format!("{pair} do not share a bus ({}, {})", usb.bus, other_usb.bus))
            } else if is_slow {
                Finding::warning(
                    CHECK,
                    format!("{pair} share {} of the controller {}, with 480 Mbit/s for both", usb.bus, usb.controller),
                    "two uncompressed streams do not fit, and the second camera fails with `no space left on device`; use a socket of another \
                     controller, MJPG, a smaller image or a lower rate (docs/rig.md)",
                )
            } else {
                let speed = usb.speed.as_deref().unwrap_or_default();
                Finding::pass(CHECK, format!("{pair} share {} of the controller {} at {speed} Mbit/s", usb.bus, usb.controller))
            });
        }
    }
    findings
}
