//! Minutes of two emulated V4L2 cameras, 640x480 at 30 Hz, in one file. Only the kernel is missing.

use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use pb3dp_bag::pairs::{PairOptions, StereoBag};
use pb3dp_bag::sinks::Sinks;
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_camera_settings::{
    CameraConfig, CameraName, ControlSettings, DeviceLayout, Interval, ModeRequest, PixelFormat, SKEW_MAX, Setting,
    SkewCost, StampModel, StereoConfig,
};
use pb3dp_camera_v4l2::V4l2StereoCamera;
use pb3dp_camera_v4l2::emulated::{EmulatedCamera, EmulatedSystem};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{Clock, FramePair, StereoCamera};
use pb3dp_hal_clock::SystemClock;
use pb3dp_record::dataset::load_case;
use pb3dp_recording::pairs::{About, PairRecording};

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
const INTERVAL: Interval = Interval { numerator: 1, denominator: 30 };
/// Bytes of a driver's buffer per row: enough for each image as JPEG.
const PADDING: u32 = 640;
/// Different images, which the cameras repeat.
const IMAGES: usize = 30;

/// What became of a long recording.
#[derive(Debug)]
pub struct Long {
    pub format: PixelFormat,
    pub minutes: f64,
    pub pairs: u64,
    /// Pairs that the cameras left out.
    pub lost: u64,
    /// Messages that found the queue full.
    pub dropped: u64,
    /// Pairs that the file has.
    pub read_back: u64,
    pub bytes: u64,
}

impl Long {
    /// Whether the file has every pair of the cameras.
    pub fn is_whole(&self) -> bool {
        self.lost == 0 && self.dropped == 0 && self.read_back == self.pairs
    }
}

/// Records two cameras in this format, `MJPG`, `GREY` or `YUYV`, and reads the file back.
pub fn record(format: &str, duration: Duration, file: &Path) -> Result<Long> {
    let fourcc: [u8; 4] = format.as_bytes().try_into().context("a format has four letters")?;
    let format = PixelFormat::of_fourcc(fourcc).context("an unknown format")?;
    prepare(format)?;
    let (clock, mut camera) = cameras(format, fourcc)?;
    let writer = BagWriter::create(file, WhenFull::Drop)?;
    let about = About::new(String::new(), "long recording", clock.now())?;
    let mut recording = PairRecording::new(&about, None, Sinks::new(Some(writer), None, None));
    let mut pair = FramePair::black(SIZE);
    let (begin, mut pairs, mut lost, mut before) = (clock.now(), 0, 0, None);
    while clock.now().saturating_since(begin) < duration {
        camera.next_pair_into(&mut pair, Duration::from_secs(1))?;
        lost += before.replace(pair.sequence).map_or(0, |before: u64| pair.sequence - before - 1);
        recording.images(&pair);
        pairs += 1;
    }
    let minutes = clock.now().saturating_since(begin).as_secs_f64() / 60.0;
    let dropped = recording.finish().written.context("a recording")??.dropped;
    let bytes = std::fs::metadata(file)?.len();
    let read = StereoBag::open(file, PairOptions::default())?
        .pairs()
        .filter(|pair| pair.as_ref().is_ok_and(|pair| pair.images.is_ok()));
    Ok(Long { format, minutes, pairs, lost, dropped, read_back: read.count() as u64, bytes })
}

/// The images of both cameras in the format of the camera.
static PAINTED: OnceLock<[Vec<Vec<u8>>; 2]> = OnceLock::new();

/// Real images, moved by a pixel from one to the next.
fn prepare(format: PixelFormat) -> Result<()> {
    let case = load_case(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases/bb201_c0"))?;
    let images = case.load_images()?;
    let painted = |image: &RgbImage| {
        let moved = |by: usize| {
            let shifted = RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
                *image.get_pixel((u + by as u32) % image.width(), v % image.height())
            });
            bytes_of(&shifted, format)
        };
        (0..IMAGES).map(moved).collect::<Result<Vec<_>>>()
    };
    let painted = [painted(&images.left)?, painted(&images.right)?];
    PAINTED.set(painted).ok().context("prepared twice")
}

fn bytes_of(image: &RgbImage, format: PixelFormat) -> Result<Vec<u8>> {
    let grey = || image.pixels().map(|pixel| pixel.0[1]);
    Ok(match format {
        PixelFormat::Grey => grey().collect(),
        PixelFormat::Yuyv => grey().flat_map(|grey| [grey, 128]).collect(),
        PixelFormat::Mjpg => {
            let mut file = Vec::new();
            JpegEncoder::new_with_quality(&mut file, 85).encode_image(image)?;
            file
        }
        other => bail!("{other}: use MJPG, GREY or YUYV"),
    })
}

fn paint(side: usize, number: u64, memory: &mut [u8]) {
    let Some(painted) = PAINTED.get() else { return };
    let image = &painted[side][number as usize % IMAGES];
    // Rows of the other formats have the same padding; their images need not be whole.
    let fits = image.len().min(memory.len());
    memory[..fits].copy_from_slice(&image[..fits]);
}

fn cameras(format: PixelFormat, fourcc: [u8; 4]) -> Result<(Arc<dyn Clock>, V4l2StereoCamera)> {
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let cameras = (0..2).map(|side| {
        let mut camera = EmulatedCamera::usual(side);
        camera.formats = vec![(fourcc, vec![(SIZE, vec![INTERVAL])])];
        camera.padding = if format == PixelFormat::Mjpg { PADDING } else { 0 };
        camera.paint = if side == 0 {
            |number, memory| paint(0, number, memory)
        } else {
            |number, memory| paint(1, number, memory)
        };
        camera
    });
    let system = EmulatedSystem::new(Arc::clone(&clock), cameras.collect());
    let config = |side: u32| CameraConfig {
        name: CameraName::Serial { serial: format!("SN000{side}"), index: None },
        mode: ModeRequest {
            format,
            size: SIZE,
            interval: INTERVAL,
            input: None,
            standard: None,
            takes_interlaced: false,
        },
        controls: ControlSettings { exposure: Setting::Manual(Duration::from_millis(4)), ..ControlSettings::default() },
        exposure: None,
        stamps: StampModel::default(),
        crop: None,
    };
    let (layout, left, right) = (DeviceLayout::TwoDevices, config(0), config(1));
    let config = StereoConfig {
        layout,
        range: None,
        left,
        right,
        skew_max: SKEW_MAX,
        skew_cost: SkewCost::OF_NO_SETUP,
        shared_exposure: None,
    };
    let camera = V4l2StereoCamera::open(Arc::new(system), Arc::clone(&clock), &config)?;
    Ok((clock, camera))
}
