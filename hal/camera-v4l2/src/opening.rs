//! Opens the devices of a stereo camera: two, or one with both views.

use std::time::Duration;

use pb3dp_camera_pixels::{Lane, View};
use pb3dp_camera_settings::{CameraConfig, Crop, DeviceLayout, ModeRequest, StereoConfig, nanos};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::CameraError;

use crate::controls;
use crate::error::unusable;
use crate::modes;
use crate::names::{self, CaptureDevice};
use crate::stream::{Stream, StreamConfig, Streams};
use crate::video::{VideoNode, VideoSystem};

/// Maximum time, in periods, that an image may wait in the driver; the buffered images of a late caller are older.
const AGE_PERIODS_MAX: u32 = 4;

/// Number of driver buffers: one is held, one is being filled, two are reserve for a late caller.
const BUFFERS: u32 = 4;

/// The devices in their requested mode; their streams are not started.
pub(crate) struct OpenedDevices {
    /// Name of the stereo camera for messages.
    pub(crate) name: String,
    /// Left and right device; twice the same if one device has both views.
    pub(crate) found: [CaptureDevice; 2],
    pub(crate) streams: Streams,
    pub(crate) period: Duration,
}

/// Opens the devices of a configuration.
///
/// # Errors
/// As [`crate::V4l2StereoCamera::open`].
pub(crate) fn open_devices(system: &dyn VideoSystem, config: &StereoConfig) -> Result<OpenedDevices, CameraError> {
    let mut config = config.clone();
    if config.shared_exposure.is_some() {
        // Both cameras must have a control for the exposure, which is checked next with a message of its own.
        for side in [&mut config.left, &mut config.right] {
            side.exposure.get_or_insert(Duration::ZERO);
        }
    }
    if config.layout.is_one_device() { open_one(system, &config) } else { open_two(system, &config) }
}

fn open_two(system: &dyn VideoSystem, config: &StereoConfig) -> Result<OpenedDevices, CameraError> {
    let views = views(config)?;
    let [(left_found, mut left), (right_found, mut right)] =
        [names::open(system, &config.left.name)?, names::open(system, &config.right.name)?];
    let name = format!("v4l2 {} + {}", config.left.name, config.right.name);
    if left_found.entry.path == right_found.entry.path {
        let path = left_found.entry.path.display();
        let what = format!(
            "left and right are the same camera, {path}; if each of its images has both views, state their layout (side-by-side, top-bottom \
             or interleaved)"
        );
        return Err(unusable(&name, what));
    }
    let left_config = prepare(left.as_mut(), &left_found, &config.left, config.left.mode)?;
    let right_config = prepare(right.as_mut(), &right_found, &config.right, config.right.mode)?;
    let [period, other] = [&left_config, &right_config].map(|prepared| prepared.mode.period_s);
    if (period - other).abs() > 1e-6 * period {
        return Err(unusable(
            &name,
            format!("frame rates differ: {:.4} and {:.4} images per second", 1.0 / period, 1.0 / other),
        ));
    }
    let [left_view, right_view] = views;
    let streams = [
        Stream::new(left, left_config, (&[left_view], config.range), BUFFERS)?,
        Stream::new(right, right_config, (&[right_view], config.range), BUFFERS)?,
    ];
    let (found, streams) = ([left_found, right_found], Streams::Two(Box::new(streams)));
    Ok(OpenedDevices { name, found, streams, period: Duration::from_secs_f64(period) })
}

fn open_one(system: &dyn VideoSystem, config: &StereoConfig) -> Result<OpenedDevices, CameraError> {
    let CameraConfig { name, mode, .. } = &config.left;
    let views = views(config)?;
    let (found, mut node) = names::open(system, name)?;
    let mode = ModeRequest { size: config.layout.device_size(mode.size), ..*mode };
    let stream_config = prepare(node.as_mut(), &found, &config.left, mode)?;
    let period = Duration::from_secs_f64(stream_config.mode.period_s);
    let stream = Stream::new(node, stream_config, (&views, config.range), BUFFERS)?;
    Ok(OpenedDevices {
        name: format!("v4l2 {name} ({})", config.layout),
        found: [found.clone(), found],
        streams: Streams::One(Box::new(stream)),
        period,
    })
}

/// The left and the right view in the images of their devices.
fn views(config: &StereoConfig) -> Result<[View; 2], CameraError> {
    let StereoConfig { layout, left, right, .. } = config;
    // Of one device, `left` has the mode of both views.
    let sides = if layout.is_one_device() { [(left, left), (left, right)] } else { [(left, left), (right, right)] };
    for (device, side) in sides {
        let ModeRequest { format, size, .. } = device.mode;
        let crop = side.crop.map_or(Ok(()), |crop| crop.check(size, format));
        layout.check(format, size).and(crop).map_err(|error| unusable(&device.name.to_string(), error))?;
    }
    let crops = sides.map(|(device, side)| side.crop.unwrap_or_else(|| Crop::whole(device.mode.size)));
    if crops[0].size != crops[1].size {
        let [ImageSize { width, height }, right] = crops.map(|crop| crop.size);
        let what = format!(
            "image sizes differ: {width}x{height} of left and {}x{} of right; both need the same size and the same width and height of \
             their crops",
            right.width, right.height
        );
        return Err(unusable(&left.name.to_string(), what));
    }
    let lanes = if *layout == DeviceLayout::Interleaved { [Lane::First, Lane::Second] } else { [Lane::First; 2] };
    let [left_origin, right_origin] = layout.origins(left.mode.size);
    let view = |crop: Crop, (left, top): (u32, u32), lane| View {
        part: Crop { left: left.saturating_add(crop.left), top: top.saturating_add(crop.top), size: crop.size },
        lane,
    };
    Ok([view(crops[0], left_origin, lanes[0]), view(crops[1], right_origin, lanes[1])])
}

/// Sets the requested mode and controls of a device.
fn prepare(
    node: &mut dyn VideoNode,
    found: &CaptureDevice,
    config: &CameraConfig,
    mode: ModeRequest,
) -> Result<StreamConfig, CameraError> {
    let device = format!("{} ({})", config.name, found.entry.path.display());
    let mode = modes::negotiate(node, &device, &mode)?;
    let applied = controls::apply(node, &device, &config.controls)?;
    let exposure = applied.or(config.exposure).ok_or_else(|| {
        let what = "it does not report its exposure time, which is needed for the image timestamps; set a manual exposure, \
                    or give the exposure time";
        unusable(&device, what)
    })?;
    let period = Duration::from_secs_f64(mode.period_s);
    // A timestamp may be earlier than the arrival by exposure and transfer, which take up to a period each.
    let age_max = period * AGE_PERIODS_MAX + exposure + config.stamps.readout + config.stamps.delay;
    if nanos(age_max) == i64::MAX {
        return Err(unusable(&device, "its exposure, readout and delay times are too long"));
    }
    Ok(StreamConfig { device, mode, exposure, stamps: config.stamps, age_max })
}
