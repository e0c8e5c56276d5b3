//! Each rule of the camera suite detects a camera that breaks it, and a good camera passes.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::cell::Cell;
use std::time::Duration;

use image::{Rgb, RgbImage};
use pb3dp_geometry::{ImageSize, MonotonicTime};
use pb3dp_hal_api::{CameraError, CameraErrorKind, FramePair, StereoCamera, StereoCameraInfo};
use pb3dp_hal_conformance::{CameraExpectations, Report, stereo_camera_suite};

const PAIRS: u64 = 5;
const PERIOD: Duration = Duration::from_millis(33);

/// The defect of a camera; one at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Defect {
    None,
    OneCameraIsSmaller,
    RepeatsAPair,
    TimeStandsStill,
    RunsAtHalfSpeed,
    AllocatesAnew,
    KeepsOldFiles,
    KeepsForeignBuffers,
    EndsEarly,
    EndsLate,
    RestartsAfterTheEnd,
    TimesOutAfterTheEnd,
    DamagedPair,
    TimesOutForEver,
    TooSlow,
    OtherImagesEachTime,
    InfoChanges,
    NoName,
    NoSize,
    Disconnects,
}

struct Camera {
    defect: Defect,
    info: StereoCameraInfo,
    next: u64,
    calls: u64,
    made: u64,
}

fn camera(defect: Defect, made: u64) -> Camera {
    let size = match defect {
        Defect::NoSize => ImageSize { width: 0, height: 0 },
        _ => ImageSize { width: 16, height: 9 },
    };
    let name = if defect == Defect::NoName { String::new() } else { format!("{defect:?}") };
    Camera { defect, info: StereoCameraInfo { name, size, period: Some(PERIOD) }, next: 0, calls: 0, made }
}

impl Camera {
    fn fail(&self, kind: CameraErrorKind) -> Result<(), CameraError> {
        Err(CameraError::new(kind, format!("{kind:?} of {}", self.info.name)))
    }

    fn fill(&self, image: &mut RgbImage, side: u8) {
        let (width, height) = (self.info.size.width, self.info.size.height);
        let smaller = u32::from(self.defect == Defect::OneCameraIsSmaller && side == 1);
        let wanted = (width - smaller.min(width), height);
        let foreign = image.dimensions() != wanted && self.defect != Defect::KeepsForeignBuffers;
        if foreign || self.defect == Defect::AllocatesAnew {
            *image = RgbImage::new(wanted.0, wanted.1);
        }
        let changing = if self.defect == Defect::OtherImagesEachTime { self.made as u8 } else { 0 };
        let colour = Rgb([self.next as u8, side, changing]);
        image.pixels_mut().for_each(|pixel| *pixel = colour);
    }

    /// The error to return instead of a pair, if any.
    fn instead_of_a_pair(&mut self) -> Option<CameraErrorKind> {
        let end = match self.defect {
            Defect::EndsEarly => PAIRS - 1,
            Defect::EndsLate => PAIRS + 1,
            _ => PAIRS,
        };
        let at_end = self.next >= end;
        match self.defect {
            Defect::RestartsAfterTheEnd if self.next > end => None,
            Defect::TimesOutAfterTheEnd if self.next > end => Some(CameraErrorKind::Timeout),
            Defect::TimesOutForEver if self.next == 2 => Some(CameraErrorKind::Timeout),
            Defect::Disconnects if self.next == 2 => Some(CameraErrorKind::Disconnected),
            Defect::DamagedPair if self.next == 2 => {
                self.next += 1;
                Some(CameraErrorKind::BadPair)
            }
            _ => at_end.then_some(CameraErrorKind::EndOfStream),
        }
    }
}

impl StereoCamera for Camera {
    fn info(&self) -> &StereoCameraInfo {
        &self.info
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        self.calls += 1;
        if self.defect == Defect::InfoChanges && self.calls == 3 {
            self.info.name.push('!');
        }
        if self.defect == Defect::TooSlow && self.calls == 3 {
            std::thread::sleep(2 * timeout + Duration::from_millis(550));
        }
        if let Some(kind) = self.instead_of_a_pair() {
            if kind == CameraErrorKind::EndOfStream {
                self.next += 1;
            }
            return self.fail(kind);
        }
        let mut left = std::mem::take(&mut pair.left);
        let mut right = std::mem::take(&mut pair.right);
        self.fill(&mut left, 0);
        self.fill(&mut right, 1);
        let delivered = if self.defect == Defect::KeepsOldFiles { pair.delivered.clone() } else { Default::default() };
        let repeats = u64::from(self.defect == Defect::RepeatsAPair && self.next == 3);
        let speed = if self.defect == Defect::RunsAtHalfSpeed { 2 } else { 1 };
        let periods = if self.defect == Defect::TimeStandsStill { 7 } else { speed * (self.next - repeats) };
        let exposed_at = MonotonicTime::ZERO + PERIOD * periods as u32;
        *pair = FramePair {
            sequence: self.next - repeats,
            exposed_at,
            skew_nanos: -40,
            left,
            right,
            delivered,
            exposure: None,
        };
        self.next += 1;
        Ok(())
    }
}

fn suite(defect: Defect) -> Report {
    let made = Cell::new(0);
    let expectations =
        CameraExpectations { timeout: Duration::from_millis(50), ..CameraExpectations::recording_of(PAIRS as usize) };
    let make = || {
        made.set(made.get() + 1);
        camera(defect, made.get())
    };
    stereo_camera_suite(make, &expectations)
}

#[test]
fn a_good_camera_passes() {
    suite(Defect::None).assert_passed();
}

#[test]
fn each_defect_breaks_its_rule() {
    let defects = [
        (Defect::OneCameraIsSmaller, "size-as-stated"),
        (Defect::RepeatsAPair, "newer-than-before"),
        (Defect::TimeStandsStill, "newer-than-before"),
        (Defect::RunsAtHalfSpeed, "period-as-stated"),
        (Defect::AllocatesAnew, "buffers-are-reused"),
        (Defect::KeepsForeignBuffers, "foreign-buffer-is-resized"),
        (Defect::KeepsOldFiles, "foreign-files-are-replaced"),
        (Defect::EndsEarly, "number-of-pairs"),
        (Defect::EndsLate, "number-of-pairs"),
        (Defect::RestartsAfterTheEnd, "end-is-final"),
        (Defect::TimesOutAfterTheEnd, "end-is-final"),
        (Defect::DamagedPair, "number-of-bad-pairs"),
        (Defect::TimesOutForEver, "unexpected-error"),
        (Defect::Disconnects, "unexpected-error"),
        (Defect::TooSlow, "returns-in-time"),
        (Defect::OtherImagesEachTime, "repeatable"),
        (Defect::InfoChanges, "info-stays"),
        (Defect::NoName, "info-is-real"),
        (Defect::NoSize, "info-is-real"),
    ];
    for (defect, rule) in defects {
        let report = suite(defect);
        assert!(report.breaks(rule), "{rule} was not caught; {report}");
    }
}

#[test]
fn bad_pairs_that_are_expected_are_no_violation() {
    let expectations = CameraExpectations {
        pairs: Some(PAIRS as usize - 1),
        bad_pairs: 1,
        ..CameraExpectations::recording_of(PAIRS as usize)
    };
    stereo_camera_suite(|| camera(Defect::DamagedPair, 0), &expectations).assert_passed();
}

#[test]
fn an_endless_camera_must_not_end() {
    let enough = CameraExpectations::endless(PAIRS as usize);
    stereo_camera_suite(|| camera(Defect::None, 0), &enough).assert_passed();
    let report = stereo_camera_suite(|| camera(Defect::None, 0), &CameraExpectations::endless(PAIRS as usize + 3));
    assert!(report.breaks("unexpected-error") && report.breaks("number-of-pairs"), "{report}");
}

#[test]
fn a_report_names_camera_rule_and_values() {
    let report = suite(Defect::OneCameraIsSmaller);
    let text = report.to_string();
    assert!(text.starts_with("OneCameraIsSmaller: breaks the contract\n  size-as-stated: pair 0"), "{text}");
    assert!(text.contains("the right image is (15, 9), stated is (16, 9)"), "{text}");
    assert!(std::panic::catch_unwind(|| report.assert_passed()).is_err());
}
