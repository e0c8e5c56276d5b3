//! One device whose images have both views: every layout and format, one time for both views, and all failures.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "helpers of tests")]

use std::sync::Arc;
use std::time::Duration;

use crate::support::{PERIOD_MILLIS, Rig, SECOND, SMALL, config, config_of_one, millis};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use pb3dp_camera_settings::{Crop, DeviceLayout, ImageLayout, PixelFormat, StereoConfig, ValueRange};
use pb3dp_camera_v4l2::emulated::{EmulatedCamera, Faults};
use pb3dp_camera_v4l2::{ReopeningCamera, Side};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_hal_conformance::{CameraExpectations, stereo_camera_suite};

const SIDE_BY_SIDE: DeviceLayout = DeviceLayout::OneImage(ImageLayout::SideBySide);
const TOP_BOTTOM: DeviceLayout = DeviceLayout::OneImage(ImageLayout::TopBottom);
const PADDING: u32 = 10;

/// The byte of an image at this position of its memory; nearly all differ from image to image.
fn byte(number: u64, at: usize) -> u8 {
    ((at as u32).wrapping_mul(2_654_435_761).wrapping_add(number as u32 * 77_777_777) >> 19) as u8
}

fn noise(number: u64, memory: &mut [u8]) {
    for (at, place) in memory.iter_mut().enumerate() {
        *place = byte(number, at);
    }
}

/// A rig of one camera that offers this format in the size of both views, and in that of one.
fn rig_of(layout: DeviceLayout, format: PixelFormat) -> Rig {
    Rig::with(|number, camera| {
        let intervals = camera.formats[0].1[0].1.clone();
        let sizes = vec![(layout.device_size(SMALL), intervals.clone()), (SMALL, intervals)];
        camera.formats = vec![(format.fourcc(), sizes)];
        (camera.padding, camera.padding_rows, camera.paint) = (PADDING, 3, noise);
        camera.faults.is_unplugged = number == 1;
    })
}

/// What OpenCV and the kernel documentation call the pixel at a column and row of a device image: its grey value, or its Y, U, V.
fn raw(format: PixelFormat, whole: ImageSize, number: u64, (x, y): (usize, usize)) -> [u16; 3] {
    let at = |offset: usize| u16::from(byte(number, offset));
    let (width, height) = (whole.width as usize, whole.height as usize);
    let padding = PADDING as usize;
    match format {
        PixelFormat::Grey => [at(y * (width + padding) + x); 3],
        PixelFormat::Y10 | PixelFormat::Y12 | PixelFormat::Y16 => {
            let word = y * (2 * width + padding) + 2 * x;
            [at(word) + 256 * at(word + 1); 3]
        }
        PixelFormat::Yuyv => {
            let pair = y * (2 * width + padding) + 4 * (x / 2);
            [at(pair + 2 * (x % 2)), at(pair + 1), at(pair + 3)]
        }
        PixelFormat::Nv12 => {
            let chroma = (height + y / 2) * (width + padding) + 2 * (x / 2);
            [at(y * (width + padding) + x), at(chroma), at(chroma + 1)]
        }
        other => unreachable!("{other}"),
    }
}

/// Red, green and blue: of a word its share of the range in 255 steps; of Y, U, V those of ITU-R BT.601 in the limited range.
fn colour(format: PixelFormat, raw: [u16; 3], values: (f64, f64)) -> [f64; 3] {
    let [a, b, c] = raw.map(f64::from);
    match format {
        PixelFormat::Yuyv | PixelFormat::Nv12 => {
            let (y, u, v) = (255.0 / 219.0 * (a - 16.0), 255.0 / 224.0 * (b - 128.0), 255.0 / 224.0 * (c - 128.0));
            [y + 1.402 * v, y - 0.344_136 * u - 0.714_136 * v, y + 1.772 * u]
        }
        PixelFormat::Grey => [a; 3],
        _ => [((a - values.0) / (values.1 - values.0) * 255.0).round(); 3],
    }
    .map(|channel| channel.clamp(0.0, 255.0))
}

fn crop(left: u32, top: u32, width: u32, height: u32) -> Crop {
    Crop { left, top, size: ImageSize { width, height } }
}

/// Both views of a pair, pixel by pixel, against the bytes of the image.
#[track_caller]
fn check_pair(config: &StereoConfig, pair: &FramePair, values: (f64, f64)) {
    let (layout, format) = (config.layout, config.left.mode.format);
    let views = layout.origins(SMALL).into_iter().zip([&config.left, &config.right]).zip([&pair.left, &pair.right]);
    for (lane, ((origin, side), image)) in views.enumerate() {
        let crop = side.crop.unwrap_or(Crop { left: 0, top: 0, size: SMALL });
        assert_eq!(image.dimensions(), (crop.size.width, crop.size.height));
        for (x, y, pixel) in image.enumerate_pixels() {
            let at = ((origin.0 + crop.left + x) as usize, (origin.1 + crop.top + y) as usize);
            let expected = if layout == DeviceLayout::Interleaved {
                let row = 2 * SMALL.width as usize + PADDING as usize;
                [f64::from(byte(pair.sequence, at.1 * row + 2 * at.0 + lane)); 3]
            } else {
                colour(format, raw(format, layout.device_size(SMALL), pair.sequence, at), values)
            };
            for (found, expected) in pixel.0.into_iter().zip(expected) {
                // Colours are rounded to the nearest step; grey values are exact.
                let allowed = if matches!(format, PixelFormat::Yuyv | PixelFormat::Nv12) { 1.0 } else { 0.0 };
                assert!(
                    (f64::from(found) - expected).abs() <= allowed,
                    "{layout} {format} {at:?}: {pixel:?}, not {expected}"
                );
            }
        }
    }
}

#[test]
fn every_layout_and_format_gives_both_views_with_one_time() {
    let grey = ([0.0, 255.0], "mono8");
    let deep = |high| ([0.0, high], "mono16");
    for (format, ([low, high], encoding)) in [
        (PixelFormat::Grey, grey),
        (PixelFormat::Y10, deep(1023.0)),
        (PixelFormat::Y12, deep(4095.0)),
        (PixelFormat::Y16, deep(65_535.0)),
        (PixelFormat::Nv12, ([0.0, 255.0], "")),
        (PixelFormat::Yuyv, ([0.0, 255.0], "yuv422_yuy2")),
        (PixelFormat::Y8i, grey),
    ] {
        let layouts = [SIDE_BY_SIDE, TOP_BOTTOM, DeviceLayout::Interleaved];
        for layout in layouts.into_iter().filter(|layout| layout.check(format, SMALL).is_ok()) {
            for crops in [None, Some([crop(2, 4, 33, 21), crop(30, 20, 33, 21)])] {
                let rig = rig_of(layout, format);
                let mut config = config_of_one(layout, format);
                (config.left.crop, config.right.crop) = (crops.map(|crops| crops[0]), crops.map(|crops| crops[1]));
                let mut camera = rig.open(&config).unwrap();
                assert_eq!(camera.info().size, config.size());
                for number in 0..2 {
                    let pair = camera.next_pair(SECOND).unwrap();
                    assert_eq!((pair.sequence, pair.skew_nanos), (number, 0));
                    check_pair(&config, &pair, (low, high));
                    let found = pair.delivered.each_ref().map(|delivered| delivered.encoding);
                    assert_eq!(found, [encoding; 2], "{format} {layout}");
                }
                let counters = camera.counters();
                assert_eq!((counters.left, counters.pairs, counters.skew_max_nanos), (counters.right, 2, 0));
                assert_eq!(counters.left.good, 2);
            }
        }
    }
}

#[test]
fn a_stated_range_counts_for_both_views() {
    let mut config = config_of_one(SIDE_BY_SIDE, PixelFormat::Y12);
    config.range = ValueRange::new(200, 40_000);
    let pair = rig_of(SIDE_BY_SIDE, PixelFormat::Y12).open(&config).unwrap().next_pair(SECOND).unwrap();
    check_pair(&config, &pair, (200.0, 40_000.0));
    // Words are recorded as they were, without padding.
    let row = 4 * SMALL.width as usize + PADDING as usize;
    let (y, x) = (5, 9);
    let at = y * row + 2 * (SMALL.width as usize + x);
    let word = 2 * (y * SMALL.width as usize + x);
    assert_eq!(pair.delivered[1].bytes[word..word + 2], [byte(0, at), byte(0, at + 1)]);
}

/// A JPEG of both views, darker with each image.
fn jpeg(number: u64, memory: &mut [u8]) {
    let mut file = Vec::new();
    let scene = scene(number);
    JpegEncoder::new_with_quality(&mut file, 90).encode_image(&scene).unwrap();
    memory.fill(0);
    memory[..file.len()].copy_from_slice(&file);
}

fn scene(number: u64) -> RgbImage {
    RgbImage::from_fn(128, 48, |x, y| image::Rgb([(x + y) as u8, (200 - x) as u8, 3 * y as u8 + number as u8]))
}

#[test]
fn a_jpeg_of_both_views_is_decoded_once_and_parted() {
    let rig = rig_of(SIDE_BY_SIDE, PixelFormat::Mjpg);
    rig.system.with(0, |camera| (camera.padding, camera.paint) = (1024, jpeg)).unwrap();
    let mut config = config_of_one(SIDE_BY_SIDE, PixelFormat::Mjpg);
    (config.left.crop, config.right.crop) = (Some(crop(1, 3, 60, 40)), Some(crop(4, 8, 60, 40)));
    let mut camera = rig.open(&config).unwrap();
    for number in 0..3 {
        let pair = camera.next_pair(SECOND).unwrap();
        let scene = scene(number);
        for (image, (left, top)) in [(&pair.left, (1, 3)), (&pair.right, (68, 8))] {
            let expected = image::imageops::crop_imm(&scene, left, top, 60, 40).to_image();
            let worst = image.iter().zip(expected.iter()).map(|(a, b)| a.abs_diff(*b)).max();
            assert!(worst <= Some(12), "JPEG changes an image by more than {worst:?}");
        }
        assert!(pair.delivered.iter().all(|delivered| delivered.encoding.is_empty()));
    }
}

#[test]
fn it_keeps_the_contract() {
    for (layout, format) in [(SIDE_BY_SIDE, PixelFormat::Yuyv), (DeviceLayout::Interleaved, PixelFormat::Y8i)] {
        let (rig, config) = (rig_of(layout, format), config_of_one(layout, format));
        stereo_camera_suite(|| rig.open(&config).unwrap(), &CameraExpectations::endless(40)).assert_passed();
        stereo_camera_suite(|| reopening(&rig, &config), &CameraExpectations::endless(40)).assert_passed();
    }
}

fn reopening(rig: &Rig, config: &StereoConfig) -> ReopeningCamera {
    ReopeningCamera::open(Arc::new(rig.system.clone()), rig.clock.clone(), config.clone(), SECOND * 10).unwrap()
}

#[test]
fn loss_and_silence_are_reported_within_two_periods() {
    let config = config_of_one(TOP_BOTTOM, PixelFormat::Grey);
    type Fault = (fn(&mut Faults), CameraErrorKind);
    let faults: [Fault; 4] = [
        (|faults| faults.is_unplugged = true, CameraErrorKind::Disconnected),
        (|faults| faults.has_stopped = true, CameraErrorKind::Disconnected),
        (|faults| faults.ends = true, CameraErrorKind::Disconnected),
        (|faults| faults.is_silent = true, CameraErrorKind::Timeout),
    ];
    for (k, (fault, kind)) in faults.into_iter().enumerate() {
        let rig = rig_of(TOP_BOTTOM, PixelFormat::Grey);
        let mut camera = rig.open(&config).unwrap();
        camera.next_pair(SECOND).unwrap();
        rig.faults(0, fault);
        let (result, took) = rig.timed(&mut camera);
        let error = result.unwrap_err();
        assert_eq!(error.kind(), kind, "fault {k}: {error}");
        assert!(
            took <= 2.0 * PERIOD_MILLIS + 0.01 && error.to_string().contains("serial:SN0000"),
            "{took} ms: {error}"
        );
        rig.faults(0, |faults| *faults = Faults::default());
        assert_eq!(camera.next_pair(SECOND).is_ok(), kind == CameraErrorKind::Timeout, "fault {k}");
    }
}

#[test]
fn damaged_and_lost_images_are_counted_for_both_views() {
    let rig = rig_of(SIDE_BY_SIDE, PixelFormat::Yuyv);
    let mut camera = rig.open(&config_of_one(SIDE_BY_SIDE, PixelFormat::Yuyv)).unwrap();
    camera.next_pair(SECOND).unwrap();
    rig.faults(0, |faults| (faults.damaged, faults.short) = (1, 1));
    let pair = camera.next_pair(SECOND).or_else(|_| camera.next_pair(SECOND)).unwrap();
    assert!(pair.sequence >= 2, "{}", pair.sequence);
    let counters = camera.counters();
    assert_eq!((counters.left.damaged, counters.left.short, counters.left), (1, 0, counters.right));
    assert_eq!((counters.left.unpaired, counters.drift), (0, None));
}

/// Pairs of two seconds, and the last message.
fn taken(rig: &Rig, camera: &mut ReopeningCamera) -> (u32, String) {
    let (end, mut came, mut error_text) = (rig.clock.now() + SECOND * 2, 0, String::new());
    let mut pair = FramePair::black(SMALL);
    while rig.clock.now() < end {
        match camera.next_pair_into(&mut pair, millis(66)) {
            Ok(()) => came += 1,
            Err(error) => error_text = error.to_string(),
        }
    }
    (came, error_text)
}

#[test]
fn a_lost_device_is_reopened_and_another_one_is_refused() {
    type Change = fn(&mut EmulatedCamera);
    let changes: [(Option<&str>, Change, Option<&str>); 5] = [
        (Some("A"), |_| {}, None),
        (None, |_| {}, None),
        (Some("A"), |camera| camera.capability.bus = "usb-elsewhere".to_owned(), None),
        (Some("A"), |camera| camera.entry.serial = Some("B".to_owned()), Some("the device has serial number B, not A")),
        (None, |camera| camera.capability.bus = "usb-elsewhere".to_owned(), Some("the device has port usb-elsewhere")),
    ];
    for (serial, change, refusal) in changes {
        let rig = rig_of(SIDE_BY_SIDE, PixelFormat::Grey);
        rig.system.with(0, |camera| camera.entry.serial = serial.map(str::to_owned)).unwrap();
        let mut config = config_of_one(SIDE_BY_SIDE, PixelFormat::Grey);
        config.left.name = "/dev/video0".parse().unwrap();
        let mut camera = reopening(&rig, &config);
        assert!(camera.are_distinguished(), "one device cannot be exchanged with itself");
        camera.next_pair(SECOND).unwrap();
        rig.faults(0, |faults| faults.is_unplugged = true);
        assert_eq!(taken(&rig, &mut camera).0, 0);
        rig.faults(0, |faults| *faults = Faults::default());
        rig.system.with(0, change).unwrap();
        let (came, error_text) = taken(&rig, &mut camera);
        match refusal {
            None => assert!(came > 50 && camera.reopened() == 1, "{came}: {error_text}"),
            Some(text) => assert!(came == 0 && error_text.contains(text), "{came}: {error_text}"),
        }
    }
}

#[test]
fn controls_and_identity_are_those_of_the_device() {
    let rig = rig_of(SIDE_BY_SIDE, PixelFormat::Grey);
    let mut camera = rig.open(&config_of_one(SIDE_BY_SIDE, PixelFormat::Grey)).unwrap();
    assert_eq!(camera.info().name, "v4l2 serial:SN0000 (side-by-side)");
    let identities = [Side::Left, Side::Right].map(|side| camera.identity(side).unwrap());
    assert_eq!(identities[0], identities[1]);
    assert_eq!(identities[0].serial.as_deref(), Some("SN0000"));
    camera.set_control(Side::Right, pb3dp_camera_v4l2::controls::id::GAIN, 77).unwrap();
    let gain = camera.controls(Side::Left).unwrap().into_iter().find(|control| control.entry.name == "Gain").unwrap();
    assert_eq!(gain.value, Some(77));
    // Exposure 4 ms from the stamp on: one time for both views.
    let before = rig.clock.now();
    let pair = camera.next_pair(SECOND).unwrap();
    assert!(pair.exposed_at < before + Duration::from_millis(50) && pair.skew_nanos == 0);
}

#[test]
fn what_does_not_fit_is_refused_with_what_to_do() {
    let one = config_of_one;
    let of = |change: fn(&mut StereoConfig), layout, format| {
        let mut config = one(layout, format);
        change(&mut config);
        config
    };
    for (config, text) in [
        (
            of(|_| {}, DeviceLayout::Interleaved, PixelFormat::Grey),
            "the layout interleaved needs the format Y8I, not GREY",
        ),
        (of(|_| {}, SIDE_BY_SIDE, PixelFormat::Y8i), "which is the layout interleaved, not side-by-side"),
        (of(|_| {}, DeviceLayout::TwoDevices, PixelFormat::Y8i), "which is the layout interleaved, not two-devices"),
        (
            of(|config| config.left.mode.size.width = 63, SIDE_BY_SIDE, PixelFormat::Yuyv),
            "YUYV in the layout side-by-side cannot have views of 63x48",
        ),
        (
            of(|config| config.right.crop = Some(crop(3, 0, 40, 40)), SIDE_BY_SIDE, PixelFormat::Yuyv),
            "the crop 3,0,40,40 (left, top, width, height) cannot begin there: YUYV has groups of 2x1 pixels",
        ),
        (
            of(|config| config.left.crop = Some(crop(0, 1, 40, 40)), SIDE_BY_SIDE, PixelFormat::Nv12),
            "NV12 has groups of 2x2 pixels, so left must be a multiple of 2 and top one of 2",
        ),
        (
            of(|config| config.left.crop = Some(crop(0, 20, 40, 40)), SIDE_BY_SIDE, PixelFormat::Grey),
            "the crop 0,20,40,40 (left, top, width, height) is empty or not inside of a view of 64x48 pixels",
        ),
        (
            of(|config| config.left.crop = Some(crop(0, 0, 40, 40)), SIDE_BY_SIDE, PixelFormat::Grey),
            "image sizes differ: 40x40 of left and 64x48 of right",
        ),
    ] {
        let rig = rig_of(config.layout, config.left.mode.format);
        let error = rig.open(&config).err().expect("it must be refused");
        assert_eq!(error.kind(), CameraErrorKind::Unusable);
        assert!(error.to_string().contains(text) && error.to_string().starts_with("serial:SN0000: "), "{error}");
    }
    // A device without images of both views.
    let rig = Rig::new();
    let error = rig.open(&one(SIDE_BY_SIDE, PixelFormat::Grey)).err().unwrap().to_string();
    assert!(error.contains("requested GREY of 128x48, the driver selected GREY of 64x48"), "{error}");
    // The same device twice.
    let mut twice = config();
    twice.right.name = twice.left.name.clone();
    let error = Rig::new().open(&twice).err().unwrap().to_string();
    assert!(error.contains("the same camera") && error.contains("state their layout"), "{error}");
    // Two devices may be cropped, too.
    let mut cropped = config();
    (cropped.left.crop, cropped.right.crop) = (Some(crop(0, 0, 40, 40)), Some(crop(24, 8, 40, 40)));
    let pair = Rig::new().open(&cropped).unwrap().next_pair(SECOND).unwrap();
    assert_eq!((pair.left.dimensions(), pair.right.dimensions(), pair.skew_nanos), ((40, 40), (40, 40), 2_000_000));
}
