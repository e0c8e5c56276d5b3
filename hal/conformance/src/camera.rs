//! The contract of [`StereoCamera`].

use std::time::{Duration, Instant};

use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{CameraError, CameraErrorKind, DeliveredImage, FramePair, StereoCamera, StereoCameraInfo};

use crate::Report;

/// Number of calls after the end of a stream that must all report it.
const CALLS_AFTER_END: usize = 3;

/// Number of consecutive time-outs after which the test gives up.
const TIMEOUTS_MAX: usize = 50;

/// Scheduling delay tolerated on a busy machine.
const SCHEDULING_SLACK: Duration = Duration::from_millis(500);

/// The expected behaviour of a camera.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CameraExpectations {
    /// Complete pairs until `EndOfStream`; `None` for a camera that never ends.
    pub pairs: Option<usize>,
    /// Damaged or missing pairs that are reported as `BadPair` before the end.
    pub bad_pairs: usize,
    /// Number of pairs of an endless camera that are checked.
    pub sample: usize,
    /// Timeout of every call.
    pub timeout: Duration,
    /// Whether a camera created again delivers the same images, byte for byte.
    pub repeatable: bool,
}

impl CameraExpectations {
    /// A recording with this number of good pairs.
    pub fn recording_of(pairs: usize) -> Self {
        Self { pairs: Some(pairs), bad_pairs: 0, sample: 0, timeout: Duration::from_secs(1), repeatable: true }
    }

    /// A camera or a simulation that never ends, of which `sample` pairs are checked.
    pub fn endless(sample: usize) -> Self {
        Self { pairs: None, bad_pairs: 0, sample, timeout: Duration::from_secs(1), repeatable: false }
    }
}

/// Tests a camera against its contract. Every call of `make` opens it again from its start; except for `repeatable`, only one is
/// open at a time.
///
/// Rules: `info-is-real`, `info-stays`, `size-as-stated`, `newer-than-before`, `period-as-stated`, `buffers-are-reused`,
/// `foreign-buffer-is-resized`, `returns-in-time`, `number-of-pairs`, `number-of-bad-pairs`,
/// `unexpected-error`, `end-is-final`, `repeatable`.
pub fn stereo_camera_suite<C: StereoCamera>(make: impl Fn() -> C, expectations: &CameraExpectations) -> Report {
    let mut camera = make();
    let info = camera.info().clone();
    let mut report = Report::new(&info.name);
    check_info(&info, &mut report);
    let stream = read_stream(&mut camera, expectations, &mut report);
    report.check("info-stays", *camera.info() == info, || format!("first {info:?}, then {:?}", camera.info()));
    check_counts(&stream, expectations, &mut report);
    // A device can be open only once.
    drop(camera);
    check_buffers(&mut make(), expectations, &mut report);
    if expectations.repeatable {
        check_repeatable(&make, expectations, &mut report);
    }
    report
}

/// The results of a stream, without the images.
#[derive(Default)]
struct Stream {
    pairs: usize,
    bad_pairs: usize,
    ended: bool,
    last: Option<FramePair>,
}

fn check_info(info: &StereoCameraInfo, report: &mut Report) {
    let ImageSize { width, height } = info.size;
    report.check("info-is-real", width > 0 && height > 0, || format!("size {width}x{height}"));
    report.check("info-is-real", !info.name.is_empty(), || "no name".to_owned());
    report.check("info-is-real", info.period != Some(Duration::ZERO), || "a period of zero".to_owned());
}

/// Reads until the end, or the sample size of an endless camera.
fn read_stream<C: StereoCamera>(camera: &mut C, expectations: &CameraExpectations, report: &mut Report) -> Stream {
    let mut stream = Stream::default();
    let mut pair = FramePair::black(camera.info().size);
    let mut timeouts = 0;
    // One more than expected, so that a surplus is detected; every call except a time-out counts.
    let calls_max = expectations.pairs.map_or(expectations.sample, |pairs| pairs + expectations.bad_pairs + 1);
    let mut calls = 0;
    while calls < calls_max {
        match timed_call(camera, &mut pair, expectations, report) {
            Ok(()) => {
                check_pair(&pair, &mut stream, camera.info(), report);
                timeouts = 0;
                calls += 1;
            }
            Err(error) if error.kind() == CameraErrorKind::Timeout && timeouts < TIMEOUTS_MAX => timeouts += 1,
            Err(error) if error.kind() == CameraErrorKind::BadPair => {
                stream.bad_pairs += 1;
                calls += 1;
            }
            Err(error) => {
                stream.ended = error.kind() == CameraErrorKind::EndOfStream;
                let expected = stream.ended && expectations.pairs.is_some();
                report.check("unexpected-error", expected, || format!("after {} pairs: {error}", stream.pairs));
                check_end(camera, &error, expectations, report);
                break;
            }
        }
    }
    stream
}

fn timed_call<C: StereoCamera>(
    camera: &mut C,
    pair: &mut FramePair,
    expectations: &CameraExpectations,
    report: &mut Report,
) -> Result<(), CameraError> {
    let started = Instant::now();
    let result = camera.next_pair_into(pair, expectations.timeout);
    let took = started.elapsed();
    report.check("returns-in-time", took <= 2 * expectations.timeout + SCHEDULING_SLACK, || {
        format!("a call with a timeout of {:?} took {took:?}", expectations.timeout)
    });
    result
}

fn check_pair(pair: &FramePair, stream: &mut Stream, info: &StereoCameraInfo, report: &mut Report) {
    let number = stream.pairs;
    stream.pairs += 1;
    let stated = (info.size.width, info.size.height);
    for (side, image) in [("left", &pair.left), ("right", &pair.right)] {
        report.check("size-as-stated", image.dimensions() == stated, || {
            format!("pair {number}: the {side} image is {:?}, stated is {stated:?}", image.dimensions())
        });
    }
    if let Some(before) = &stream.last {
        let newer = pair.sequence > before.sequence && pair.exposed_at > before.exposed_at;
        report.check("newer-than-before", newer, || {
            let (a, b) = (before.exposed_at.as_nanos(), pair.exposed_at.as_nanos());
            format!(
                "pair {number}: sequence {} after {}, exposed at {b} ns after {a} ns",
                pair.sequence, before.sequence
            )
        });
        if let Some(period) = info.period.filter(|_| newer) {
            let periods = (pair.sequence - before.sequence) as f64;
            let off = pair.exposed_at.seconds_since(before.exposed_at) - periods * period.as_secs_f64();
            report.check("period-as-stated", off.abs() <= 0.5 * period.as_secs_f64(), || {
                format!("pair {number}: {periods} periods of {period:?} missed by {off} s")
            });
        }
    }
    stream.last =
        Some(FramePair { left: Default::default(), right: Default::default(), delivered: Default::default(), ..*pair });
}

/// After the end or the loss of the device, every call returns the same kind.
fn check_end<C: StereoCamera>(
    camera: &mut C,
    first: &CameraError,
    expectations: &CameraExpectations,
    report: &mut Report,
) {
    if !matches!(first.kind(), CameraErrorKind::EndOfStream | CameraErrorKind::Disconnected) {
        return;
    }
    for call in 1..=CALLS_AFTER_END {
        let again = camera.next_pair(expectations.timeout).map_err(|error| error.kind());
        report.check("end-is-final", again.as_ref().err() == Some(&first.kind()), || {
            let found = again.map_or_else(|kind| format!("{kind:?}"), |_| "a pair".to_owned());
            format!("call {call} after {:?} returned {found}", first.kind())
        });
    }
}

fn check_counts(stream: &Stream, expectations: &CameraExpectations, report: &mut Report) {
    let expected = expectations.pairs.unwrap_or(expectations.sample);
    let complete = stream.pairs == expected && stream.ended == expectations.pairs.is_some();
    report.check("number-of-pairs", complete, || {
        let end = if stream.ended { "and the end" } else { "and no end" };
        format!("{} pairs {end} were delivered, expected are {expected}", stream.pairs)
    });
    let (found, expected) = (stream.bad_pairs, expectations.bad_pairs);
    report.check("number-of-bad-pairs", found == expected, || format!("{found} bad pairs, expected are {expected}"));
}

/// What an earlier image left in a buffer.
const FOREIGN: &[u8] = b"file of an earlier image";

/// A buffer of the right size keeps its memory; a buffer of another size is replaced.
fn check_buffers<C: StereoCamera>(camera: &mut C, expectations: &CameraExpectations, report: &mut Report) {
    let size = camera.info().size;
    let mut pair = FramePair::black(size);
    let memory = |pair: &FramePair| (pair.left.as_ptr(), pair.right.as_ptr());
    let before = memory(&pair);
    if next_good(camera, &mut pair, expectations).is_some() {
        report.check("buffers-are-reused", memory(&pair) == before, || {
            "a buffer of the right size was given another memory".to_owned()
        });
    }
    let mut foreign = FramePair::black(ImageSize { width: size.width / 2 + 1, height: size.height + 3 });
    let image = DeliveredImage { encoding: "mono8", bytes: FOREIGN.to_vec() };
    foreign.delivered = [image.clone(), image];
    if next_good(camera, &mut foreign, expectations).is_some() {
        let dimensions = (foreign.left.dimensions(), foreign.right.dimensions());
        let stated = (size.width, size.height);
        report.check("foreign-buffer-is-resized", dimensions == (stated, stated), || {
            format!("into a buffer of another size came {dimensions:?}, stated is {stated:?}")
        });
        report.check(
            "foreign-files-are-replaced",
            foreign.delivered.iter().all(|image| image.bytes != FOREIGN),
            || "the delivered bytes of an earlier image stayed in the buffer".to_owned(),
        );
    }
}

/// Skips time-outs and the expected number of bad pairs; `None` at the end.
fn next_good<C: StereoCamera>(camera: &mut C, pair: &mut FramePair, expectations: &CameraExpectations) -> Option<()> {
    for _ in 0..=TIMEOUTS_MAX + expectations.bad_pairs {
        match camera.next_pair_into(pair, expectations.timeout) {
            Ok(()) => return Some(()),
            Err(error) if matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair) => {}
            Err(_) => return None,
        }
    }
    None
}

fn check_repeatable<C: StereoCamera>(make: &impl Fn() -> C, expectations: &CameraExpectations, report: &mut Report) {
    let (mut one, mut other) = (make(), make());
    let pairs = expectations.pairs.unwrap_or(expectations.sample);
    for number in 0..pairs {
        let pair_of = |camera: &mut C| {
            let mut pair = FramePair::black(camera.info().size);
            next_good(camera, &mut pair, expectations).map(|()| pair)
        };
        let (Some(a), Some(b)) = (pair_of(&mut one), pair_of(&mut other)) else { return };
        let same_times = (a.sequence, a.exposed_at, a.skew_nanos) == (b.sequence, b.exposed_at, b.skew_nanos);
        let same = same_times && a.left == b.left && a.right == b.right;
        if !report.check("repeatable", same, || format!("pair {number} differs when the camera is made anew")) {
            return;
        }
    }
}
