//! One pair of emulated cameras whose memory is a file, for a comparison with other decoders (tests/recordings/test_pixels.py).
//!
//! `emulated_pair FORMAT LAYOUT WIDTHxHEIGHT STRIDE RANGE CROP_LEFT CROP_RIGHT FILE FOLDER`
//!
//! The size is that of one view; `-` stands for no range or crop. `FILE` has the bytes of a driver buffer, in which rows are STRIDE bytes
//! apart. Writes `left.rgb` and `right.rgb` (rows of red, green, blue), and `left.delivered` and `right.delivered` if there are such images,
//! into the folder, and prints width, height, skew in nanoseconds and the encoding of the delivered images.

#![allow(clippy::print_stdout, reason = "a console program")]

use std::error::Error;
use std::fs;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use pb3dp_camera_settings::{
    CameraConfig, ControlSettings, Crop, DeviceLayout, Interval, ModeRequest, PixelFormat, SKEW_MAX, Setting, SkewCost,
    StampModel, StereoConfig,
};
use pb3dp_camera_v4l2::V4l2StereoCamera;
use pb3dp_camera_v4l2::emulated::{EmulatedCamera, EmulatedSystem};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{Clock, StereoCamera};
use pb3dp_hal_clock::VirtualClock;

const USAGE: &str = "emulated_pair FORMAT LAYOUT WIDTHxHEIGHT STRIDE RANGE CROP_LEFT CROP_RIGHT FILE FOLDER";
const INTERVAL: Interval = Interval { numerator: 1, denominator: 30 };

/// The memory of each image.
static MEMORY: OnceLock<Vec<u8>> = OnceLock::new();

/// Fills a buffer as the driver does.
fn paint(_: u64, memory: &mut [u8]) {
    let Some(bytes) = MEMORY.get() else { return };
    let length = bytes.len().min(memory.len());
    memory[..length].copy_from_slice(&bytes[..length]);
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [format, layout, size, stride, range, crop_left, crop_right, file, folder] = words.as_slice() else {
        return Err(USAGE.into());
    };
    let format: PixelFormat = format.parse()?;
    let layout: DeviceLayout = layout.parse()?;
    let (width, height) = size.split_once('x').ok_or(USAGE)?;
    let view = ImageSize { width: width.parse()?, height: height.parse()? };
    let is_stated = |word: &&String| *word != "-";
    let crop = |word: &String| Some(word).filter(is_stated).map(|word| word.parse::<Crop>()).transpose();
    let bytes = fs::read(file)?;
    let device_size = layout.device_size(view);
    // The buffer of a JPEG must hold the file.
    let row = format.row_bytes(device_size.width).unwrap_or(0);
    let padding = stride.parse::<usize>()?.checked_sub(row).ok_or("STRIDE is shorter than a row")?;
    MEMORY.get_or_init(|| bytes);

    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::default());
    let emulated = |number| EmulatedCamera {
        formats: vec![(format.fourcc(), vec![(device_size, vec![INTERVAL])])],
        padding: padding as u32,
        paint,
        ..EmulatedCamera::usual(number)
    };
    let system = EmulatedSystem::new(Arc::clone(&clock), vec![emulated(0), emulated(1)]);
    let side = |number: u32, crop| -> Result<CameraConfig, Box<dyn Error>> {
        let mode = ModeRequest {
            format,
            size: view,
            interval: INTERVAL,
            input: None,
            standard: None,
            takes_interlaced: false,
        };
        let exposure = Setting::Manual(Duration::from_millis(4));
        let controls = ControlSettings { exposure, ..ControlSettings::default() };
        let name = format!("serial:SN{number:04}").parse()?;
        Ok(CameraConfig { name, mode, controls, exposure: None, stamps: StampModel::default(), crop })
    };
    let range = Some(range).filter(is_stated).map(|range| range.parse()).transpose()?;
    let (left, right) = (side(0, crop(crop_left)?)?, side(1, crop(crop_right)?)?);
    let config = StereoConfig {
        layout,
        range,
        left,
        right,
        skew_max: SKEW_MAX,
        skew_cost: SkewCost::OF_NO_SETUP,
        shared_exposure: None,
    };
    let pair = V4l2StereoCamera::open(Arc::new(system), clock, &config)?.next_pair(Duration::from_secs(1))?;
    for ((name, image), delivered) in [("left", &pair.left), ("right", &pair.right)].into_iter().zip(&pair.delivered) {
        fs::write(Path::new(folder).join(format!("{name}.rgb")), image.as_raw())?;
        if !delivered.encoding.is_empty() {
            fs::write(Path::new(folder).join(format!("{name}.delivered")), &delivered.bytes)?;
        }
    }
    let (width, height) = pair.left.dimensions();
    println!("{width} {height} {} {}", pair.skew_nanos, pair.delivered[0].encoding);
    Ok(())
}
