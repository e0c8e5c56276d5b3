//! What a recording does not state itself; also as arguments of commands.

use std::str::FromStr;
use std::time::Duration;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use pb3dp_bag::pairs::PAIR_WITHIN;
use pb3dp_camera_settings::ImageLayout;
use pb3dp_geometry::ImageSize;
use pb3dp_record::calibration_files::{LengthUnit, LensModel, StatedCalibration};
use pb3dp_record::value_range::ValueRange;

/// Heading of these options in `--help`.
const HEADING: &str = "Recordings from elsewhere";
/// Heading of the options of calibrations.
const OF_CALIBRATIONS: &str = "Calibrations from elsewhere";

/// What a calibration file does not state itself.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct CalibrationOptions {
    /// Unit of length of an OpenCV calibration: mm, cm or m.
    #[arg(long, value_name = "UNIT", help_heading = OF_CALIBRATIONS)]
    pub calib_unit: Option<LengthUnit>,
    /// Size of the images that the calibration was made with; it is scaled to images of another size and the same shape.
    #[arg(long, value_name = "WxH", value_parser = parse_size, help_heading = OF_CALIBRATIONS)]
    pub calib_size: Option<ImageSize>,
    /// Lens model of an OpenCV calibration with four coefficients: brown (k1 k2 p1 p2) or equidistant (fisheye, k1 k2 k3 k4).
    #[arg(long, value_name = "MODEL", help_heading = OF_CALIBRATIONS)]
    pub calib_lens: Option<LensModel>,
    /// The images are rectified already: use the projection matrices P of the calibration, or without them the rectified cameras of the rig.
    #[arg(long, help_heading = OF_CALIBRATIONS)]
    pub rectified: bool,
}

impl CalibrationOptions {
    /// For the readers.
    pub fn stated(&self) -> StatedCalibration {
        let Self { calib_unit, calib_size, calib_lens, rectified } = *self;
        StatedCalibration { unit: calib_unit, size: calib_size, lens: calib_lens, rectified }
    }
}

/// Width and height in pixels.
///
/// # Errors
/// Another form than `640x480`.
pub fn parse_size(text: &str) -> Result<ImageSize, String> {
    let side = |text: &str| text.trim().parse::<u32>().ok().filter(|side| (1..=65_535).contains(side));
    let sides = text.split_once(['x', 'X']).and_then(|(width, height)| Some((side(width)?, side(height)?)));
    let (width, height) = sides.ok_or_else(|| format!("{text:?} is not WxH in pixels, such as 640x480"))?;
    Ok(ImageSize { width, height })
}

/// What a recording does not state itself.
#[derive(Clone, Debug, Args)]
pub struct RecordingOptions {
    /// Topics of the left and the right images in an MCAP file; by default two that differ only in left and right.
    #[arg(long, value_name = "LEFT,RIGHT", help_heading = HEADING)]
    pub topics: Option<Topics>,
    /// Longest time between the images of a pair in MCAP and EuRoC recordings, milliseconds.
    #[arg(long, value_name = "MS", value_parser = parse_pair_within, default_value = "3", help_heading = HEADING)]
    pub pair_within: Duration,
    /// Values that become black and white in images with more than 8 bits, such as 0,4095; measured on the first pair by default.
    #[arg(long, value_name = "LOW,HIGH", help_heading = HEADING)]
    pub range: Option<ValueRange>,
    /// Part of an MCAP recording whose `camera_info` changes: 1 is that until the first change. Without it and without --calib only the first
    /// one is used.
    #[arg(long, value_name = "N", value_parser = parse_segment, help_heading = HEADING)]
    pub segment: Option<usize>,
    /// Arrangement of both views in each image of a folder.
    #[arg(long, help_heading = HEADING, value_parser = PossibleValuesParser::new(ImageLayout::ALL.map(ImageLayout::name)).try_map(|name| name.parse::<ImageLayout>()))]
    pub layout: Option<ImageLayout>,
    /// Middle of the right exposure minus middle of the left one in every pair, milliseconds; 0 if one trigger drives both cameras. `track`
    /// estimates it from the motion if neither this nor the recording states it, and warns if the motion contradicts it; a single pair cannot use
    /// it.
    #[arg(long, value_name = "MS", value_parser = parse_skew, allow_negative_numbers = true, help_heading = HEADING)]
    pub skew: Option<SkewMillis>,
    /// Pairs per second of a recording without times.
    #[arg(skip)]
    pub rate: Option<PairsPerSecond>,
    /// What the calibration does not state itself.
    #[command(flatten)]
    pub calibration: CalibrationOptions,
}

/// What a recording does not state itself, for commands to which its times matter and that open no cameras.
#[derive(Clone, Debug, Args)]
pub struct TimedRecordingOptions {
    #[command(flatten)]
    options: RecordingOptions,
    /// Pairs per second of a recording without times; 30 by default.
    #[arg(long, value_name = "HZ", value_parser = parse_rate, help_heading = HEADING)]
    rate: Option<PairsPerSecond>,
}

impl TimedRecordingOptions {
    /// Everything.
    pub fn all(&self) -> RecordingOptions {
        RecordingOptions { rate: self.rate, ..self.options.clone() }
    }
}

/// Milliseconds between the exposures of a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkewMillis(pub f64);

/// Pairs per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairsPerSecond(pub f64);

impl SkewMillis {
    /// The largest that is accepted: three periods of 30 pairs per second.
    pub const MAX: f64 = 100.0;
}

impl PairsPerSecond {
    /// Time from pair to pair.
    pub fn period(self) -> Duration {
        Duration::from_secs_f64(1.0 / self.0)
    }
}

impl Default for RecordingOptions {
    fn default() -> Self {
        Self {
            topics: None,
            pair_within: PAIR_WITHIN,
            range: None,
            segment: None,
            layout: None,
            skew: None,
            rate: None,
            calibration: CalibrationOptions::default(),
        }
    }
}

/// Topics of the left and the right images.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topics(pub [String; 2]);

impl FromStr for Topics {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split(',').map(str::trim).collect::<Vec<_>>()[..] {
            [left, right] if !left.is_empty() && !right.is_empty() && left != right => {
                Ok(Self([left.to_owned(), right.to_owned()]))
            }
            _ => Err(format!(
                "{text:?} is not LEFT,RIGHT: two different topics, such as /left/image_raw,/right/image_raw"
            )),
        }
    }
}

fn parse_skew(text: &str) -> Result<SkewMillis, String> {
    match text.parse::<f64>() {
        Ok(millis) if millis.abs() <= SkewMillis::MAX => Ok(SkewMillis(millis)),
        _ => Err(format!("{text:?}: must be between -{0} and {0} milliseconds", SkewMillis::MAX)),
    }
}

fn parse_segment(text: &str) -> Result<usize, String> {
    text.parse().ok().filter(|number| *number > 0).ok_or_else(|| format!("{text:?}: must be a number from 1 on"))
}

fn parse_rate(text: &str) -> Result<PairsPerSecond, String> {
    match text.parse::<f64>() {
        Ok(hz) if (0.01..=10_000.0).contains(&hz) => Ok(PairsPerSecond(hz)),
        _ => Err(format!("{text:?}: must be between 0.01 and 10000 pairs per second")),
    }
}

fn parse_pair_within(text: &str) -> Result<Duration, String> {
    match text.parse::<f64>() {
        Ok(millis) if (0.0..=1000.0).contains(&millis) => Ok(Duration::from_secs_f64(millis * 1e-3)),
        _ => Err(format!("{text:?}: must be between 0 and 1000 milliseconds")),
    }
}
