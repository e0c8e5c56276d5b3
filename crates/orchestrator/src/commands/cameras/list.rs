//! `pb3dp cameras list`: connected cameras and their capabilities.

use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_camera_settings::PixelFormat;
use pb3dp_camera_v4l2::controls::controls;
use pb3dp_camera_v4l2::known_models::{KnownModel, Proposal, recognise};
use pb3dp_camera_v4l2::modes::{OfferedFormat, offered};
use pb3dp_camera_v4l2::names::{self, CaptureDevice};
use pb3dp_camera_v4l2::video::{IntervalEntry, SizeEntry, VideoSystem};
use pb3dp_cell::camera_controls::CameraControl;
use pb3dp_cell::terminal::print_line;
use pb3dp_wiring::camera_controls::described;
use serde::Serialize;

/// Meaning of exit code and `--json`.
const LIST_JSON: &str =
    "Exit code: 0 if each device can be used, 1 if there is none, or one cannot be asked (its `problem` says why).
Lines of --json (one per device):
  device    its file now, which changes from boot to boot
  card      what it calls itself, or null
  driver    of the kernel, or null
  names     names that stay its own, the best one first: for --left and --right, and for configurations
  serial    serial number, or null
  bus       where it is plugged in, or null
  model     of a known device: name, note, and proposal (layout, format, views_px: sizes of a view; null if it has no images with both
            views); else null
  formats   fourcc, is_taken (whether pb3dp can use it), sizes: width_px, height_px and rates_hz (a list), or rates_from_to_hz; or
            from_px, to_px, step_px of a range of sizes
  controls  id, name, kind, min, max, step, default, value (or null), unit (name, and factor: the size of the value 1; or null), mode
            (auto, manual or null), is_locked (another control decides on it now), moves_the_lens, menu (value, text)
  problem   why it cannot be used, and what to do; or null";

/// Arguments of `pb3dp cameras list`.
#[derive(Debug, Args)]
#[command(after_long_help = LIST_JSON)]
pub(super) struct ListArgs {
    /// One JSON object per line on standard output instead of tables.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// If there is no camera, the system cannot be queried, or standard output cannot be written.
pub(super) fn run(system: &dyn VideoSystem, args: &ListArgs) -> Result<ExitCode> {
    let devices = devices(system)?;
    if devices.is_empty() {
        bail!(
            "there is no camera (/sys/class/video4linux has none that takes images): look at cable and hub, and whether `lsusb` and `dmesg` \
             show it; `pb3dp doctor` looks at the rest"
        );
    }
    for (index, device) in devices.iter().enumerate() {
        if args.json {
            print_line(&serde_json::to_string(device)?)?;
        } else {
            let gap = if index > 0 { "\n" } else { "" };
            print_line(&format!("{gap}{}", device.text()))?;
        }
    }
    let is_whole = devices.iter().all(|device| device.problem.is_none());
    Ok(if is_whole { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// One device in the form of `--json`.
#[derive(Debug, Serialize)]
struct Device {
    device: String,
    card: Option<String>,
    driver: Option<String>,
    names: Vec<String>,
    serial: Option<String>,
    bus: Option<String>,
    model: Option<Model>,
    formats: Vec<Format>,
    controls: Vec<CameraControl>,
    problem: Option<String>,
}

#[derive(Debug, Serialize)]
struct Model {
    name: &'static str,
    note: &'static str,
    proposal: Option<ProposedMode>,
}

#[derive(Debug, Serialize)]
struct ProposedMode {
    layout: &'static str,
    format: String,
    views_px: Vec<[u32; 2]>,
}

#[derive(Debug, Serialize)]
struct Format {
    fourcc: String,
    is_taken: bool,
    sizes: Vec<Size>,
}

#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Size {
    One { width_px: u32, height_px: u32, rates_hz: Vec<f64>, rates_from_to_hz: Option<[f64; 2]> },
    Range { from_px: [u32; 2], to_px: [u32; 2], step_px: [u32; 2] },
}

/// All devices that capture images or cannot be queried, sorted by path.
fn devices(system: &dyn VideoSystem) -> Result<Vec<Device>> {
    let listing = names::list(system).context("the cameras of this computer cannot be listed")?;
    let mut devices: Vec<(_, Device)> = Vec::new();
    for found in &listing.found {
        devices.push((found.entry.path.clone(), asked(system, found)));
    }
    for (path, error) in listing.refused {
        devices.push((path.clone(), Device::refused(&path, &anyhow::Error::new(error))));
    }
    // Natural order: video2 before video10.
    let order = |path: &Path| {
        let name = path.display().to_string();
        (name.len(), name)
    };
    devices.sort_by_key(|(path, _)| order(path));
    Ok(devices.into_iter().map(|(_, device)| device).collect())
}

/// A device with its properties; one that does not answer has a problem.
fn asked(system: &dyn VideoSystem, found: &CaptureDevice) -> Device {
    let device = found.entry.path.display().to_string();
    let known = Device {
        card: Some(found.capability.card.clone()),
        driver: Some(found.capability.driver.clone()),
        names: found.stable_names().iter().map(ToString::to_string).collect(),
        serial: found.entry.serial.clone(),
        bus: Some(found.capability.bus.clone()).filter(|bus| !bus.is_empty()),
        ..Device::named(&device)
    };
    let answers =
        system.open(&found.entry.path).and_then(|node| Ok((offered(node.as_ref())?, controls(node.as_ref())?)));
    match answers {
        Ok((formats, controls)) => Device {
            model: recognise(&found.capability.card, &formats).map(Model::of),
            formats: formats.iter().map(Format::of).collect(),
            controls: described(&controls),
            ..known
        },
        Err(error) => {
            let problem =
                format!("{device}: asking what it can do failed: {error}; look at its plug and cable, and try again");
            Device { problem: Some(problem), ..known }
        }
    }
}

impl Device {
    fn named(device: &str) -> Self {
        Self {
            device: device.to_owned(),
            card: None,
            driver: None,
            names: Vec::new(),
            serial: None,
            bus: None,
            model: None,
            formats: Vec::new(),
            controls: Vec::new(),
            problem: None,
        }
    }

    fn refused(path: &Path, error: &anyhow::Error) -> Self {
        Self { problem: Some(format!("{error:#}")), ..Self::named(&path.display().to_string()) }
    }

    /// As text.
    fn text(&self) -> String {
        let mut text = self.device.clone();
        if let (Some(card), Some(driver)) = (&self.card, &self.driver) {
            let _ = write!(text, "  {card} (driver {driver})");
        }
        for name in &self.names {
            let _ = write!(text, "\n  name     {name}");
        }
        if self.names.is_empty() && self.problem.is_none() {
            text.push_str("\n  name     none that stays: only its file names it");
        }
        if let Some(model) = &self.model {
            let _ = write!(text, "\n  {}", model.text());
        }
        for format in &self.formats {
            let _ = write!(text, "\n  format   {}", format.text());
        }
        if !self.controls.is_empty() {
            text.push_str("\n\n  | control | name | kind | from | to | step | default | now |\n  |---|---|---|---|---|---|---|---|");
        }
        for control in &self.controls {
            let _ = write!(text, "\n  {}", row(control));
        }
        if let Some(problem) = &self.problem {
            let _ = write!(text, "\n  PROBLEM  {problem}");
        }
        text
    }
}

impl Model {
    fn of(KnownModel { name, note, proposal }: KnownModel) -> Self {
        let proposal = proposal.map(|Proposal { layout, format, views }| ProposedMode {
            layout: layout.name(),
            format: format.to_string(),
            views_px: views.iter().map(|view| [view.width, view.height]).collect(),
        });
        Self { name, note, proposal }
    }

    fn text(&self) -> String {
        let mut text = format!("model    {}: {} (not confirmed with a real device)", self.name, self.note);
        if let Some(ProposedMode { layout, format, views_px }) = &self.proposal {
            let views: Vec<String> = views_px.iter().map(|[width, height]| format!("{width}x{height}")).collect();
            let _ = write!(
                text,
                "\n  propose  layout = \"{layout}\", format = \"{format}\", width_px and height_px of one view: {}",
                views.join(", ")
            );
        }
        text
    }
}

impl Format {
    fn of(offered: &OfferedFormat) -> Self {
        let size = |(size, rates): &(SizeEntry, Vec<IntervalEntry>)| Size::of(size, rates);
        Self {
            fourcc: String::from_utf8_lossy(&offered.fourcc).trim_end().to_owned(),
            is_taken: PixelFormat::of_fourcc(offered.fourcc).is_some(),
            sizes: offered.sizes.iter().map(size).collect(),
        }
    }

    fn text(&self) -> String {
        let sizes: Vec<String> = self.sizes.iter().map(Size::text).collect();
        let note = if self.is_taken { "" } else { " (not taken by pb3dp)" };
        format!("{}{note}  {}", self.fourcc, sizes.join("; "))
    }
}

impl Size {
    fn of(size: &SizeEntry, rates: &[IntervalEntry]) -> Self {
        let one = match *size {
            SizeEntry::Discrete(one) => one,
            SizeEntry::Range { from, to, step } => {
                return Self::Range {
                    from_px: [from.width, from.height],
                    to_px: [to.width, to.height],
                    step_px: step.into(),
                };
            }
        };
        let mut rates_hz = Vec::new();
        let mut rates_from_to_hz = None;
        for rate in rates {
            match rate {
                IntervalEntry::Discrete(interval) => rates_hz.extend(interval.per_second()),
                // The shortest interval is the highest rate.
                IntervalEntry::Range(shortest, longest) => {
                    rates_from_to_hz = longest.per_second().zip(shortest.per_second()).map(<[f64; 2]>::from);
                }
            }
        }
        Self::One { width_px: one.width, height_px: one.height, rates_hz, rates_from_to_hz }
    }

    fn text(&self) -> String {
        let rate = |hz: f64| format!("{hz:.3}").trim_end_matches('0').trim_end_matches('.').to_owned();
        match self {
            Self::One { width_px, height_px, rates_hz, rates_from_to_hz } => {
                let mut rates: Vec<String> = rates_hz.iter().map(|hz| rate(*hz)).collect();
                rates.extend(rates_from_to_hz.map(|[from, to]| format!("{} to {}", rate(from), rate(to))));
                let rates = if rates.is_empty() { "a rate not told".to_owned() } else { rates.join(", ") };
                format!("{width_px}x{height_px} at {rates}")
            }
            Self::Range { from_px, to_px, step_px } => format!(
                "{}x{} to {}x{} by steps of {}x{}",
                from_px[0], from_px[1], to_px[0], to_px[1], step_px[0], step_px[1]
            ),
        }
    }
}

/// A control as a row of the table.
fn row(control: &CameraControl) -> String {
    let line = |value: i32| {
        let text = control.menu.iter().find(|line| line.value == value).map(|line| format!(" ({})", line.text));
        format!("{value}{}", text.unwrap_or_default())
    };
    let now = control.value.map_or_else(|| "-".to_owned(), line);
    let locked = if control.is_locked { ", locked" } else { "" };
    format!(
        "| {:#010x} | {} | {} | {} | {} | {} | {} | {now}{locked} |",
        control.id,
        control.name,
        control.kind.name(),
        control.min,
        control.max,
        control.step,
        line(control.default)
    )
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use pb3dp_camera_v4l2::emulated::{Call, EmulatedCamera, EmulatedSystem};
    use pb3dp_geometry::ImageSize;
    use pb3dp_hal_clock::VirtualClock;
    use rustix::io::Errno;

    use pb3dp_camera_settings::Interval;

    use super::*;

    fn system(cameras: Vec<EmulatedCamera>) -> EmulatedSystem {
        EmulatedSystem::new(Arc::new(VirtualClock::default()), cameras)
    }

    fn busy(number: u32) -> EmulatedCamera {
        let mut camera = EmulatedCamera::usual(number);
        camera.faults.calls.insert(Call::Open, Errno::BUSY);
        camera
    }

    #[test]
    fn a_device_tells_its_names_formats_and_controls() {
        let mut camera = EmulatedCamera::usual(4);
        camera.formats.push((*b"H264", vec![(ImageSize { width: 640, height: 480 }, Vec::new())]));
        let devices = devices(&system(vec![camera])).unwrap();
        let text = devices[0].text();
        for part in [
            "/dev/video4  Emulated camera 4 (driver emulated)",
            "name     bus:usb-emulated-4",
            "name     serial:SN0004",
            "format   YUYV  640x480 at 30, 15; 64x48 at 30, 15",
            "format   H264 (not taken by pb3dp)  640x480 at a rate not told",
            "| 0x009a0902 | Exposure Time, Absolute | integer | 1 | 5000 | 1 | 100 | 100 |",
            "| 3 (Aperture Priority Mode) | 3 (Aperture Priority Mode) |",
        ] {
            assert!(text.contains(part), "{part:?} is missing:\n{text}");
        }
        let json: serde_json::Value = serde_json::to_value(&devices[0]).unwrap();
        assert_eq!(json["names"][1], "serial:SN0004");
        assert_eq!(json["formats"][0]["sizes"][1]["rates_hz"][1], 15.0);
        assert_eq!(json["formats"][2]["is_taken"], false);
        let exposure = json["controls"].as_array().unwrap().iter().find(|line| line["id"] == 0x009A_0902).unwrap();
        assert_eq!((exposure["value"].as_i64(), exposure["max"].as_i64()), (Some(100), Some(5000)));
        assert!(json["problem"].is_null());
    }

    #[test]
    fn a_known_model_comes_with_the_layout_to_ask_for() {
        let size = |width, height| (ImageSize { width, height }, vec![Interval { numerator: 1, denominator: 30 }]);
        let mut zed = EmulatedCamera::usual(0);
        zed.capability.card = "ZED 2i: ZED 2i".to_owned();
        zed.formats = vec![(*b"YUYV", vec![size(2560, 720), size(1344, 376)])];
        let mut infrared = EmulatedCamera::usual(2);
        infrared.capability.card = "Intel(R) RealSense(TM) Depth Ca".to_owned();
        infrared.formats = vec![(*b"GREY", vec![size(640, 480)]), (*b"Y8I ", vec![size(848, 480)])];
        let mut colour = infrared.clone();
        colour.entry.path = "/dev/video4".into();
        colour.formats = vec![(*b"YUYV", vec![size(640, 480)])];
        let devices = devices(&system(vec![zed, infrared, colour, EmulatedCamera::usual(6)])).unwrap();
        for (device, parts) in devices.iter().zip([
            &[
                "model    Stereolabs ZED: both views side by side",
                "not confirmed with a real device",
                "propose  layout = \"side-by-side\", format = \"YUYV\", width_px and height_px of one view: 1280x720, 672x376",
            ][..],
            &[
                "model    Intel RealSense",
                "propose  layout = \"interleaved\", format = \"Y8I\", width_px and height_px of one view: 848x480",
                "format   Y8I  848x480 at 30",
            ],
            &["model    Intel RealSense: this node has one view"],
            &["format   YUYV"],
        ]) {
            let text = device.text();
            assert!(parts.iter().all(|part| text.contains(part)), "{text}");
        }
        assert!(!devices[2].text().contains("propose") && devices[3].model.is_none());
        let json = serde_json::to_value(&devices[1]).unwrap();
        assert_eq!(json["model"]["proposal"]["views_px"], serde_json::json!([[848, 480]]));
        assert_eq!(json["formats"][1]["fourcc"], "Y8I");
    }

    #[test]
    fn a_device_that_can_not_be_asked_is_listed_with_what_to_do() {
        let devices = devices(&system(vec![busy(10), EmulatedCamera::usual(2)])).unwrap();
        let paths: Vec<&str> = devices.iter().map(|device| device.device.as_str()).collect();
        assert_eq!(paths, ["/dev/video2", "/dev/video10"]);
        assert!(devices[0].problem.is_none());
        let problem = devices[1].problem.as_deref().unwrap();
        assert!(problem.contains("/dev/video10") && problem.contains("used by another program"), "{problem}");
        assert!(
            devices[1].text().contains("PROBLEM  /dev/video10: opening the device failed"),
            "{}",
            devices[1].text()
        );
    }

    #[test]
    fn sizes_and_rates_that_are_ranges_are_listed() {
        let size = |width, height| ImageSize { width, height };
        let range = SizeEntry::Range { from: size(48, 32), to: size(1920, 1200), step: (2, 4) };
        assert_eq!(Size::of(&range, &[]).text(), "48x32 to 1920x1200 by steps of 2x4");
        let interval = |numerator, denominator| Interval { numerator, denominator };
        let rates = IntervalEntry::Range(interval(1001, 60_000), interval(1, 5));
        assert_eq!(Size::of(&SizeEntry::Discrete(size(640, 480)), &[rates]).text(), "640x480 at 5 to 59.94");
    }

    #[test]
    fn without_a_camera_it_says_what_to_do() {
        let error = run(&system(Vec::new()), &ListArgs { json: true }).unwrap_err();
        assert!(error.to_string().contains("look at cable and hub"), "{error}");
        assert_eq!(run(&system(vec![EmulatedCamera::usual(0)]), &ListArgs { json: true }).unwrap(), ExitCode::SUCCESS);
        assert_eq!(run(&system(vec![busy(0)]), &ListArgs { json: false }).unwrap(), ExitCode::FAILURE);
    }
}
