//! Two cameras of the driver `vivid`.

use std::error::Error;
use std::sync::Arc;
use std::time::{Duration, Instant};

use pb3dp_camera_pixels::{Converter, Layout, YuvKernels, YuvMatrix, YuvRange};
use pb3dp_camera_settings::{
    CameraConfig, CameraName, ControlSettings, DeviceLayout, Interval, ModeRequest, PixelFormat, SKEW_MAX, Setting,
    SkewCost, StampModel, StereoConfig,
};
use pb3dp_camera_v4l2::controls;
use pb3dp_camera_v4l2::linux::Linux;
use pb3dp_camera_v4l2::modes;
use pb3dp_camera_v4l2::names;
use pb3dp_camera_v4l2::{Side, V4l2StereoCamera};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_conformance::{CameraExpectations, stereo_camera_suite};

use crate::report::{Outcome, Report, chain, ensure};
use crate::system::{self, User, as_user};

/// Two devices that only capture.
const VIVID: &str = "n_devs=2 node_types=0x1,0x1";

/// Their bus names.
const BUSES: [&str; 2] = ["platform:vivid-000", "platform:vivid-001"];

/// The pixel format of tests that are not about formats.
const USUAL: PixelFormat = PixelFormat::Yuyv;

/// The input "S-Video" with NTSC: 640x480 at 29.97 per second. The input "Webcam" has 25 at most in that size.
const S_VIDEO: u32 = 2;
const NTSC_M: u64 = 0x1000;
const NTSC: Interval = Interval { numerator: 1001, denominator: 30000 };
const NTSC_PERIOD: Duration = Duration::from_nanos(33_366_667);

/// The two cameras are not synchronised.
const SKEW_MAX_HERE: Duration = Duration::from_millis(20);

/// Pairs at full rate, and the number that may be lost.
const PAIRS: u64 = 300;
const LOST_MAX: u64 = 3;

const SECOND: Duration = Duration::from_secs(1);

/// Controls of `vivid` by their names.
const STAMPS: &str = "Timestamp Source";
const MOVEMENT: &str = "Horizontal Movement";
const DROPPED: &str = "Percentage of Dropped Buffers";
const FLAG_ERROR: &str = "Inject V4L2_BUF_FLAG_ERROR";
const DISCONNECT: &str = "Disconnect";

pub fn check(report: &mut Report) {
    report.check("the cameras are there", || system::load("vivid", VIVID).map(|()| String::new()));
    report.check("cameras are found by place, with modes and controls", found);
    report.check("images are converted", conversion);
    report.check("300 pairs of 640x480 YUYV at full rate, with true stamps", full_rate);
    report.check("the contract of a stereo camera is kept", contract);
    report.check("other formats", formats);
    report.check("a limit of 5 ms refuses pairs that are further apart", skew);
    report.check("silent changes by the driver are refused", changed);
    report.check("timestamps in the future are refused", future);
    report.check("lost and damaged images are left out and counted", damaged);
    report.check("a disconnected camera is detected, and can be reopened", pulled);
    report.check("a second program is refused", second);
    report.check("a user without rights is refused", || {
        let output_text = as_user(User::Nobody, &["open"])?;
        ensure(output_text.contains("permission denied"), || format!("it said: {output_text}"))?;
        Ok(String::new())
    });
}

/// The error message of a program without permissions.
pub fn try_to_open() {
    match names::open(&Linux, &name(0)) {
        Ok(_) => println!("opened"),
        Err(error) => println!("{}", chain(&error)),
    }
}

fn name(number: usize) -> CameraName {
    CameraName::Bus { bus: BUSES[number].to_owned(), index: None }
}

fn control(name: &str) -> Result<u32, Box<dyn Error>> {
    let (_, node) = names::open(&Linux, &self::name(0))?;
    let controls = controls::controls(node.as_ref())?;
    let found = controls.iter().find(|control| control.entry.name == name);
    Ok(found.ok_or_else(|| format!("vivid has no control `{name}`"))?.entry.id)
}

fn config(format: PixelFormat, skew_max: Duration) -> Result<StereoConfig, Box<dyn Error>> {
    let others = vec![(control(STAMPS)?, 1), (control(MOVEMENT)?, 4), (control(DROPPED)?, 0)];
    let camera = |number| CameraConfig {
        name: name(number),
        mode: ModeRequest {
            format,
            size: ImageSize { width: 640, height: 480 },
            interval: NTSC,
            input: Some(S_VIDEO),
            standard: Some(NTSC_M),
            takes_interlaced: true,
        },
        controls: ControlSettings { gain: Setting::Keep, others: others.clone(), ..ControlSettings::default() },
        // It has none.
        exposure: Some(Duration::ZERO),
        stamps: StampModel::default(),
        crop: None,
    };
    let layout = DeviceLayout::TwoDevices;
    Ok(StereoConfig {
        layout,
        range: None,
        left: camera(0),
        right: camera(1),
        skew_max,
        skew_cost: SkewCost::OF_NO_SETUP,
        shared_exposure: None,
    })
}

fn open_with(config: &StereoConfig) -> Result<V4l2StereoCamera, CameraError> {
    V4l2StereoCamera::open(Arc::new(Linux), Arc::new(SystemClock::new()), config)
}

fn open() -> Result<V4l2StereoCamera, Box<dyn Error>> {
    Ok(open_with(&config(USUAL, SKEW_MAX_HERE)?)?)
}

/// The next pair; a busy machine may be late for a while.
fn next(camera: &mut V4l2StereoCamera, pair: &mut FramePair) -> Result<(), CameraError> {
    let mut left = 60;
    loop {
        match camera.next_pair_into(pair, SECOND) {
            Err(error) if error.kind() == CameraErrorKind::Timeout && left > 0 => left -= 1,
            result => return result,
        }
    }
}

/// Checks that a call fails with this kind of error and these words.
fn refusal<T>(result: Result<T, CameraError>, kind: CameraErrorKind, words: &str) -> Outcome {
    let error = result.err().ok_or("it was not refused")?;
    let text = chain(&error);
    ensure(error.kind() == kind && text.contains(words), || format!("{:?}: {text}", error.kind()))?;
    Ok(text)
}

fn found() -> Outcome {
    let listing = names::list(&Linux)?;
    let buses: Vec<&str> = listing.found.iter().map(|found| found.capability.bus.as_str()).collect();
    ensure(buses == BUSES && listing.refused.is_empty(), || format!("{listing:?}"))?;
    let (_, node) = names::open(&Linux, &name(1))?;
    let offered = modes::offered(node.as_ref())?;
    let yuyv = offered.iter().find(|format| format.fourcc == *b"YUYV").ok_or("no YUYV")?;
    let controls = controls::controls(node.as_ref())?;
    ensure(!yuyv.sizes.is_empty() && controls.len() > 10, || format!("{yuyv} {controls:?}"))?;
    Ok(format!("{} formats, {} controls, {yuyv}", offered.len(), controls.len()))
}

/// Conversion time per image on this computer, for information.
fn conversion() -> Outcome {
    let (size, stride) = (ImageSize { width: 640, height: 480 }, 1280);
    let layout = Layout { format: PixelFormat::Yuyv, size, stride, matrix: YuvMatrix::Bt601, range: YuvRange::Limited };
    let (bytes, mut image) = (vec![99; 1280 * 480], FramePair::black(size).left);
    let mut converter = Converter::new(layout)?;
    let begin = Instant::now();
    for _ in 0..4 {
        converter.convert(&bytes, &mut image)?;
    }
    let millis = begin.elapsed().as_secs_f64() * 250.0;
    Ok(format!("YUYV of 640x480 in {millis:.0} ms ({})", YuvKernels::best().name()))
}

/// Runs at the rate of a real rig.
fn full_rate() -> Outcome {
    let mut camera = open()?;
    let period = camera.info().period.ok_or("no period")?;
    let mut pair = FramePair::black(camera.info().size);
    next(&mut camera, &mut pair)?;
    let (first_sequence, first_at, before) = (pair.sequence, pair.exposed_at, camera.counters());
    let begin = Instant::now();
    let (mut same, mut last) = (0, fingerprint(&pair));
    while pair.sequence < first_sequence + PAIRS {
        next(&mut camera, &mut pair)?;
        let now = fingerprint(&pair);
        same += u32::from(now == last);
        last = now;
    }
    let (took, counters) = (begin.elapsed().as_secs_f64(), camera.counters());
    let periods = pair.sequence - first_sequence;
    let delivered = counters.pairs - before.pairs;
    let mean = pair.exposed_at.seconds_since(first_at) / periods as f64;
    let text = format!(
        "{delivered} of {periods} pairs in {took:.1} s, {:.3} per second by stamps, skew at most {:.1} ms",
        1.0 / mean,
        counters.skew_max_nanos as f64 * 1e-6
    );
    ensure(delivered + LOST_MAX >= periods, || format!("{text}; {counters:?}"))?;
    // The driver stamps with the resolution of kernel ticks.
    let tolerance = 1.0 / periods as f64;
    ensure((mean / period.as_secs_f64() - 1.0).abs() < tolerance, || format!("the rate by stamps is wrong: {text}"))?;
    ensure((took - periods as f64 * mean).abs() < 0.5, || format!("stamps and clock disagree: {text}"))?;
    ensure(same == 0, || format!("{same} images are identical to their predecessors; {text}"))?;
    Ok(text)
}

/// A few pixels of every row of the left image: they differ in a moving image.
fn fingerprint(pair: &FramePair) -> Vec<u8> {
    pair.left.iter().step_by(1009).copied().collect()
}

fn contract() -> Outcome {
    let config = config(USUAL, SKEW_MAX_HERE)?;
    let open = || open_with(&config).unwrap_or_else(|error| panic!("{}", chain(&error)));
    let report = stereo_camera_suite(open, &CameraExpectations::endless(15));
    report.assert_passed();
    Ok(String::new())
}

fn formats() -> Outcome {
    let (_, node) = names::open(&Linux, &name(0))?;
    let offered = modes::offered(node.as_ref())?;
    drop(node);
    let mut brightness = Vec::new();
    let ours: Vec<PixelFormat> = offered.iter().filter_map(|format| PixelFormat::of_fourcc(format.fourcc)).collect();
    for format in &ours {
        let mut camera = open_with(&config(*format, SKEW_MAX_HERE)?)?;
        let mut pair = FramePair::black(camera.info().size);
        for _ in 0..2 {
            next(&mut camera, &mut pair)?;
        }
        // Colour bars: the same in every format, within what the format can represent.
        let sum: u64 = pair.left.pixels().map(|pixel| u64::from(pixel.0[1])).sum();
        brightness.push((*format, sum as f64 / f64::from(640 * 480)));
    }
    let text: Vec<String> = brightness.iter().map(|(format, green)| format!("{format} {green:.0}")).collect();
    let text = format!("mean of green: {}", text.join(", "));
    ensure(ours.len() >= 4, || format!("only {ours:?}"))?;
    let (least, most) =
        brightness.iter().fold((255.0_f64, 0.0_f64), |(a, b), (_, green)| (a.min(*green), b.max(*green)));
    ensure(least > 60.0 && most < 200.0 && most - least < 40.0, || format!("too different: {text}"))?;
    Ok(text)
}

/// The driver decides the offset between the two cameras; a right timestamp for an earlier time simulates a right camera that is
/// early.
fn skew() -> Outcome {
    for delay_millis in [0, 8, 16, 24] {
        let mut config = config(USUAL, SKEW_MAX)?;
        config.right.stamps.delay = Duration::from_millis(delay_millis);
        let mut camera = open_with(&config)?;
        let mut pair = FramePair::black(camera.info().size);
        let (mut delivered, mut output_text) = (0, String::new());
        for _ in 0..30 {
            match next(&mut camera, &mut pair) {
                Ok(()) => {
                    delivered += 1;
                    ensure(pair.skew_nanos.abs() <= 5_000_000, || format!("a pair {} ns apart", pair.skew_nanos))?;
                }
                Err(error) => output_text = error.to_string(),
            }
        }
        let refused = camera.counters().skew_refused;
        if refused >= 25 {
            ensure(output_text.contains("at most 5.0 ms is allowed"), || output_text.clone())?;
            return Ok(format!("{refused} of 30 refused, {delivered} within the limit; {output_text}"));
        }
    }
    Err("for every offset the right camera was within 5 ms of the left camera".into())
}

fn changed() -> Outcome {
    let mut request = config(USUAL, SKEW_MAX_HERE)?;
    request.left.mode.interval = Interval { numerator: 1, denominator: 60 };
    refusal(open_with(&request), CameraErrorKind::Unusable, "requested 60.000 images per second")?;
    let mut request = config(PixelFormat::Mjpg, SKEW_MAX_HERE)?;
    request.left.mode.takes_interlaced = false;
    refusal(open_with(&request), CameraErrorKind::Unusable, "requested MJPG")?;
    let mut request = config(USUAL, SKEW_MAX_HERE)?;
    request.left.mode.takes_interlaced = false;
    refusal(open_with(&request), CameraErrorKind::Unusable, "which tears moving objects")?;
    let mut request = config(USUAL, SKEW_MAX_HERE)?;
    request.left.controls.focus = Setting::Manual(3);
    refusal(open_with(&request), CameraErrorKind::Unusable, "it has no control for the focus")
}

/// By default `vivid` stamps the end of an image that is still to come, unless it is late itself.
fn future() -> Outcome {
    let mut request = config(USUAL, SKEW_MAX_HERE)?;
    for camera in [&mut request.left, &mut request.right] {
        camera.controls.others[0].1 = 0;
    }
    let clock = Arc::new(SystemClock::new());
    let mut camera = V4l2StereoCamera::open(Arc::new(Linux), clock.clone(), &request)?;
    let mut pair = FramePair::black(camera.info().size);
    let (mut delivered, mut refused) = (0, 0);
    for _ in 0..5 {
        match camera.next_pair_into(&mut pair, Duration::from_millis(100)) {
            Ok(()) => {
                delivered += 1;
                let ahead = pair.exposed_at.seconds_since(clock.now());
                ensure(ahead <= 4e-3, || format!("a pair was exposed {ahead} s after it was delivered"))?;
            }
            Err(error) => refused += u32::from(error.to_string().contains("lie in the future")),
        }
    }
    let left_out = camera.counters().left.future + camera.counters().right.future;
    ensure(left_out > 0, || format!("no image was left out, {delivered} pairs were delivered"))?;
    Ok(format!("{left_out} images were left out, {refused} calls said so, {delivered} pairs had come late enough"))
}

fn damaged() -> Outcome {
    let (dropped, flag_error) = (control(DROPPED)?, control(FLAG_ERROR)?);
    let mut camera = open()?;
    let mut pair = FramePair::black(camera.info().size);
    next(&mut camera, &mut pair)?;
    camera.set_control(Side::Left, dropped, 20)?;
    // The driver selects the lost images at random; the probability of fewer than three losses in 200 images is 1e-16.
    for _ in 0..200 {
        next(&mut camera, &mut pair)?;
        if camera.counters().left.lost >= 3 {
            break;
        }
    }
    camera.set_control(Side::Left, dropped, 0)?;
    let counters = camera.counters();
    ensure(counters.left.lost >= 3, || format!("of 200 images and a fifth lost: {counters:?}"))?;
    camera.set_control(Side::Right, flag_error, 0)?;
    for _ in 0..5 {
        next(&mut camera, &mut pair)?;
    }
    let after = camera.counters();
    ensure(after.right.damaged == 1, || format!("{after:?}"))?;
    Ok(format!("{} lost, {} damaged, {} unpaired", after.left.lost, after.right.damaged, after.right.unpaired))
}

fn pulled() -> Outcome {
    let disconnect = control(DISCONNECT)?;
    let mut worst = Duration::ZERO;
    for side in [Side::Left, Side::Right] {
        let mut camera = open()?;
        let mut pair = FramePair::black(camera.info().size);
        for _ in 0..5 {
            next(&mut camera, &mut pair)?;
        }
        let begin = Instant::now();
        // The camera is removed during the call: whatever the call returns, the next one reports it.
        let _ = camera.set_control(side, disconnect, 0);
        refusal(camera.next_pair_into(&mut pair, SECOND), CameraErrorKind::Disconnected, BUSES[side as usize])?;
        worst = worst.max(begin.elapsed());
        refusal(camera.next_pair_into(&mut pair, SECOND), CameraErrorKind::Disconnected, BUSES[side as usize])?;
        // The old handle is closed: the driver can be reloaded only if no process has it open.
        let mut again = open()?;
        next(&mut again, &mut pair)?;
    }
    ensure(worst <= NTSC_PERIOD * 2, || format!("detected after {worst:?}"))?;
    Ok(format!("detected after {:.1} ms at most", worst.as_secs_f64() * 1e3))
}

fn second() -> Outcome {
    let first = open()?;
    let text =
        refusal(open_with(&config(USUAL, SKEW_MAX_HERE)?), CameraErrorKind::Unusable, "used by another program")?;
    drop(first);
    let mut again = open()?;
    let mut pair = FramePair::black(again.info().size);
    next(&mut again, &mut pair)?;
    Ok(text)
}
