//! Camera drift: whether the cameras still match their calibration, checked on the images of a run.
//!
//! Every few seconds one stereo pair is measured: vertical misalignment, difference in blur, difference in brightness, and exposure skew.
//! All four are zero if the calibration holds and both cameras are alike. If the calibration file states the blur and brightness
//! differences at calibration, only the change since then counts. The median of the newest samples is compared with its limit, so that a
//! hand in front of a lens for a moment causes no warning. Each excess is reported once.

use std::collections::VecDeque;

use pb3dp_estimation::rig_watch::RowMeter;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_geometry::{MonotonicTime, StereoRig};
use pb3dp_hal_api::FramePair;
use pb3dp_record::calibration_files::Judgement;
use pb3dp_record::report::Table;
use pb3dp_setup::setup::DriftConfig;
use serde::Serialize;

use crate::image_quality::{Exposure, blur_of, brighter_by_percent, softer_by_px};

/// Number of samples in the median.
const LOOKS: usize = 5;
/// Below this share of its limit an excess has ended; the hysteresis avoids repeated warnings near the limit.
const GOOD_SHARE: f64 = 0.8;

/// Image properties at calibration, from the calibration file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WhenCalibrated {
    /// 95th percentile of the vertical misalignment, pixels.
    pub rows_px: Option<f64>,
    /// Blur difference, pixels; positive: right image softer.
    pub focus_px: Option<f64>,
    /// Brightness difference, percent; positive: right image brighter.
    pub brightness_percent: Option<f64>,
}

impl WhenCalibrated {
    /// From the measured numbers of a calibration, by the names of `pb3dp calibrate stereo`.
    pub fn of(judgement: &Judgement) -> Self {
        let number = |name: &str| judgement.numbers.iter().find(|(key, _)| key == name).map(|(_, value)| *value);
        Self {
            rows_px: number("row_error_p95_px"),
            focus_px: number("focus_difference_px"),
            brightness_percent: number("brightness_difference_percent"),
        }
    }
}

/// Measured quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    Rows,
    Focus,
    Brightness,
    Skew,
}

impl Quantity {
    const ALL: [Self; 4] = [Self::Rows, Self::Focus, Self::Brightness, Self::Skew];

    fn name(self) -> &'static str {
        match self {
            Self::Rows => "vertical misalignment, largest in the image",
            Self::Focus => "blur difference (+: right image softer)",
            Self::Brightness => "brightness difference (+: right image brighter)",
            Self::Skew => "exposure skew (+: right camera later)",
        }
    }

    fn unit(self) -> &'static str {
        match self {
            Self::Rows | Self::Focus => "px",
            Self::Brightness => "%",
            Self::Skew => "ms",
        }
    }

    fn limit(self, config: &DriftConfig) -> f64 {
        match self {
            Self::Rows => config.rows_max_px,
            Self::Focus => config.focus_max_px,
            Self::Brightness => config.brightness_max_percent,
            Self::Skew => config.skew_max.as_secs_f64() * 1e3,
        }
    }

    fn advice(self) -> &'static str {
        match self {
            Self::Rows => {
                "the cameras have moved relative to each other since calibration (a knock, a loose screw, heat): tighten them, let \
                 them warm up, and calibrate again"
            }
            Self::Focus => {
                "one lens is dirty, or its focus has moved: clean it; after refocusing a lens, calibrate again"
            }
            Self::Brightness => {
                "one lens is dirty or shaded, or exposure, gain or aperture differ: `pb3dp cameras check` shows which"
            }
            Self::Skew => {
                "one camera is triggered or stamped later than the other one: check the trigger line and stamp_delay_millis"
            }
        }
    }
}

/// Summary of one quantity.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DriftSummary {
    /// Name of the quantity.
    pub quantity: &'static str,
    /// Unit of all values.
    pub unit: &'static str,
    /// Number of successful measurements.
    pub looks: u64,
    /// Number of failed measurements: no texture in view.
    pub blind_looks: u64,
    /// Median of the first samples; none with too few samples.
    pub at_first: Option<f64>,
    /// Median of the newest samples.
    pub at_last: Option<f64>,
    /// Median with the largest magnitude.
    pub worst: Option<f64>,
    /// Largest allowed magnitude of a median.
    pub limit: f64,
    /// Value at calibration, if the calibration file states it; for the vertical misalignment its 95th percentile.
    pub when_calibrated: Option<f64>,
}

impl DriftSummary {
    /// Whether the limit was ever exceeded.
    pub fn was_too_far(&self) -> bool {
        self.worst.is_some_and(|worst| worst.abs() > self.limit)
    }
}

/// One quantity over the run.
struct Series {
    quantity: Quantity,
    newest: VecDeque<f64>,
    is_warned: bool,
    summary: DriftSummary,
}

impl Series {
    fn new(quantity: Quantity, (config, when_calibrated): (&DriftConfig, &WhenCalibrated)) -> Self {
        let summary = DriftSummary {
            quantity: quantity.name(),
            unit: quantity.unit(),
            looks: 0,
            blind_looks: 0,
            at_first: None,
            at_last: None,
            worst: None,
            limit: quantity.limit(config),
            when_calibrated: match quantity {
                Quantity::Rows => when_calibrated.rows_px,
                Quantity::Focus => when_calibrated.focus_px,
                Quantity::Brightness => when_calibrated.brightness_percent,
                Quantity::Skew => None,
            },
        };
        Self { quantity, newest: VecDeque::with_capacity(LOOKS), is_warned: false, summary }
    }

    /// Adds a sample; returns a message if the state changes.
    fn push(&mut self, value: Option<f64>) -> Option<String> {
        let Some(value) = value.filter(|value| value.is_finite()) else {
            self.summary.blind_looks += 1;
            return None;
        };
        self.summary.looks += 1;
        if self.newest.len() == LOOKS {
            self.newest.pop_front();
        }
        self.newest.push_back(value);
        if self.newest.len() < LOOKS {
            return None;
        }
        let mut sorted: Vec<f64> = self.newest.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        self.judge(sorted[LOOKS / 2])
    }

    fn judge(&mut self, median: f64) -> Option<String> {
        let DriftSummary { limit, unit, quantity, .. } = self.summary;
        self.summary.at_first.get_or_insert(median);
        self.summary.at_last = Some(median);
        if self.summary.worst.is_none_or(|worst| median.abs() > worst.abs()) {
            self.summary.worst = Some(median);
        }
        let is_far = median.abs() > if self.is_warned { GOOD_SHARE * limit } else { limit };
        if is_far == self.is_warned {
            return None;
        }
        self.is_warned = is_far;
        let found = format!("{quantity}: {median:.2} {unit}, limit {limit:.2}");
        Some(match is_far {
            true => format!("camera drift: {found}; {}", self.quantity.advice()),
            false => format!("camera drift gone: {found}"),
        })
    }
}

/// Measures camera drift during a run.
pub struct DriftWatch {
    config: DriftConfig,
    rows: RowMeter,
    next_at: Option<MonotonicTime>,
    all: [Series; 4],
    /// Whether the cameras expose synchronously.
    is_synchronous: bool,
    when_calibrated: WhenCalibrated,
}

impl DriftWatch {
    /// No measurement yet. The skew of cameras that are not synchronous is not measured.
    ///
    /// # Errors
    /// A rig that the method `direct` cannot use.
    pub fn new(
        config: DriftConfig,
        rig: &StereoRig,
        (is_synchronous, when_calibrated): (bool, WhenCalibrated),
    ) -> Result<Self, EstimationError> {
        let all = Quantity::ALL.map(|quantity| Series::new(quantity, (&config, &when_calibrated)));
        Ok(Self {
            config,
            rows: RowMeter::new(rig, Kernels::best())?,
            next_at: None,
            all,
            is_synchronous,
            when_calibrated,
        })
    }

    /// Measures a pair with this exposure time if a measurement is due; returns its messages.
    pub fn look(&mut self, at: MonotonicTime, skew_s: f64, pair: &FramePair) -> Vec<String> {
        // A clock that was set back must not end the measurements.
        let is_due = self.next_at.is_none_or(|next_at| at >= next_at || next_at > at + self.config.every);
        if !is_due {
            return Vec::new();
        }
        self.next_at = Some(at + self.config.every);
        let measured = self.rows.measure(&pair.left, &pair.right, None).ok().filter(|measured| measured.matches > 0);
        let cameras = [&pair.left, &pair.right];
        let blurs_px = cameras.map(|image| blur_of(&[image]));
        let values = [
            measured.map(|measured| self.rows.largest_px(&measured.believed().0)),
            blurs_px[0].zip(blurs_px[1]).map(|(left, right)| {
                added_blur_px(softer_by_px([left, right]), self.when_calibrated.focus_px.unwrap_or(0.0))
            }),
            Some(
                brighter_by_percent(&cameras.map(|image| Exposure::of(&[image])))
                    - self.when_calibrated.brightness_percent.unwrap_or(0.0),
            ),
            Some(skew_s * 1e3).filter(|_| self.is_synchronous),
        ];
        self.all.iter_mut().zip(values).filter_map(|(series, value)| series.push(value)).collect()
    }

    /// The summary of each quantity.
    pub fn summaries(self) -> Vec<DriftSummary> {
        let [rows, focus, brightness, skew] = self.all.map(|series| series.summary);
        let skew = Some(skew).filter(|_| self.is_synchronous);
        [rows, focus, brightness].into_iter().chain(skew).collect()
    }
}

/// Change of the blur difference since calibration: variances add up.
fn added_blur_px(now_px: f64, before_px: f64) -> f64 {
    let variance = now_px * now_px.abs() - before_px * before_px.abs();
    variance.abs().sqrt().copysign(variance)
}

/// The summaries as a report table.
pub fn table(summaries: &[DriftSummary]) -> Table {
    let headings =
        ["quantity", "unit", "at calibration", "first", "last", "worst", "limit", "samples", "without texture", ""];
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    summaries.iter().fold(Table::new(headings), |table, one| {
        let verdict = match (one.worst, one.was_too_far()) {
            (None, _) => "unknown",
            (Some(_), true) => "TOO FAR",
            (Some(_), false) => "ok",
        };
        table.row([
            one.quantity.to_owned(),
            one.unit.to_owned(),
            number(one.when_calibrated),
            number(one.at_first),
            number(one.at_last),
            number(one.worst),
            format!("{:.2}", one.limit),
            one.looks.to_string(),
            one.blind_looks.to_string(),
            verdict.to_owned(),
        ])
    })
}

/// One terminal line for each exceeded limit.
pub fn text_lines(summaries: &[DriftSummary]) -> String {
    let too_far = summaries.iter().filter(|one| one.was_too_far());
    too_far
        .filter_map(|one| {
            let worst = one.worst?;
            Some(format!("camera drift: {} {worst:.2} {}, limit {:.2}\n", one.quantity, one.unit, one.limit))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::Duration;

    use image::RgbImage;
    use nalgebra::{UnitQuaternion, Vector3};
    use pb3dp_geometry::Pose;
    use pb3dp_record::dataset::{Case, load_case};
    use pb3dp_record::images::load_rgb;

    use super::*;

    const CONFIG: DriftConfig = DriftConfig {
        every: Duration::from_secs(2),
        rows_max_px: 0.5,
        focus_max_px: 1.0,
        brightness_max_percent: 15.0,
        skew_max: Duration::from_millis(1),
    };

    fn case() -> Case {
        load_case(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases/bb201_c0")).unwrap()
    }

    fn pair(case: &Case) -> FramePair {
        let [left, right] = [&case.left, &case.right].map(|file| load_rgb(file).unwrap());
        FramePair { left, right, ..FramePair::black(pb3dp_geometry::ImageSize { width: 1, height: 1 }) }
    }

    /// Messages and summaries after repeated measurements of one pair.
    fn watched(
        rig: &StereoRig,
        pair: &FramePair,
        skew_s: f64,
        is_synchronous: bool,
    ) -> (Vec<String>, Vec<DriftSummary>) {
        let mut watch = DriftWatch::new(CONFIG, rig, (is_synchronous, WhenCalibrated::default())).unwrap();
        let look = |k: u64| watch.look(MonotonicTime::from_nanos(k * 500_000_000), skew_s, pair);
        // Ten seconds of pairs at half-second intervals.
        let warnings = (0..20).flat_map(look).collect();
        (warnings, watch.summaries())
    }

    fn values(found: &[DriftSummary]) -> Vec<f64> {
        found.iter().map(|one| one.at_last.unwrap_or(f64::NAN)).collect()
    }

    #[test]
    fn a_pair_that_fits_its_calibration_says_nothing() {
        let case = case();
        let (warnings, found) = watched(&case.load_calibration().unwrap().rig, &pair(&case), 0.2e-3, true);
        assert!(warnings.is_empty(), "{warnings:?}");
        assert!(found.iter().all(|one| one.looks == 5 && one.blind_looks == 0 && !one.was_too_far()), "{found:#?}");
        assert!((values(&found)[3] - 0.2).abs() < 1e-9, "{found:#?}");
    }

    #[test]
    fn each_changed_camera_is_reported_with_its_change() {
        let case = case();
        let rig = case.load_calibration().unwrap().rig;
        let sound = pair(&case);
        let (_, before) = watched(&rig, &sound, 0.0, true);
        let before = values(&before);
        // The right camera tilts by 0.1 degrees: with the wrong calibration all rows shift by the focal length times the angle.
        let nod = Pose::from_parts(
            Vector3::zeros(),
            UnitQuaternion::from_scaled_axis(Vector3::new(0.1_f64.to_radians(), 0.0, 0.0)),
        );
        let nodded = StereoRig::new(*rig.left(), *rig.right(), nod * *rig.cam_right_from_cam_left()).unwrap();
        let by_px = rig.right().pinhole().fy * 0.1_f64.to_radians();
        let (warnings, found) = watched(&nodded, &sound, 0.0, true);
        assert!((values(&found)[0] - by_px).abs() < 0.3 + before[0], "{} px, {by_px} expected", values(&found)[0]);
        assert!(
            warnings.len() == 1 && warnings[0].contains("misalignment") && warnings[0].contains("calibrate again"),
            "{warnings:?}"
        );

        // The measured blur equals the applied blur; the other values stay.
        let softer = FramePair { right: image::imageops::blur(&sound.right, 1.5), ..sound.clone() };
        let (warnings, found) = watched(&rig, &softer, 0.0, true);
        assert!(warnings.len() == 1 && warnings[0].contains("blur difference"), "{warnings:?}");
        assert!((values(&found)[1] - 1.5).abs() < 0.4, "{found:#?}");
        let (_, found) =
            watched(&rig, &FramePair { left: image::imageops::blur(&sound.left, 1.5), ..sound.clone() }, 0.0, true);
        assert!((values(&found)[1] + 1.5).abs() < 0.4, "{found:#?}");

        // A third less light.
        let darker = |image: &RgbImage| {
            let mut darker = image.clone();
            darker.iter_mut().for_each(|level| *level = (f64::from(*level) * 2.0 / 3.0) as u8);
            darker
        };
        let (warnings, found) = watched(&rig, &FramePair { left: darker(&sound.left), ..sound.clone() }, 0.0, true);
        assert!(warnings.len() == 1 && warnings[0].contains("right image brighter"), "{warnings:?}");
        assert!((values(&found)[2] - 100.0 / 3.0).abs() < 8.0, "{found:#?}");

        let (warnings, _) = watched(&rig, &sound, -2e-3, true);
        assert!(warnings.len() == 1 && warnings[0].contains("-2.00 ms, limit 1.00"), "{warnings:?}");
        let (warnings, found) = watched(&rig, &sound, -2e-3, false);
        assert!(warnings.is_empty() && found.len() == 3, "{warnings:?} {found:#?}");
    }

    #[test]
    fn images_without_texture_are_blind_looks() {
        let case = case();
        let size = case.load_calibration().unwrap().rig.left().size();
        let (warnings, found) = watched(&case.load_calibration().unwrap().rig, &FramePair::black(size), 0.0, true);
        assert!(warnings.is_empty(), "{warnings:?}");
        assert_eq!((found[0].looks, found[0].blind_looks, found[1].blind_looks), (0, 5, 5));
        let cells = format!("{:?}", table(&found));
        assert!(cells.contains("unknown"), "{cells}");
    }

    #[test]
    fn eyes_that_were_unlike_when_they_were_calibrated_are_judged_by_what_has_come_to_it() {
        let case = case();
        let rig = case.load_calibration().unwrap().rig;
        let sound = pair(&case);
        let softer = FramePair { right: image::imageops::blur(&sound.right, 1.5), ..sound.clone() };
        let (_, as_now) = watched(&rig, &softer, 0.0, true);
        let [focus_px, brightness_percent] = [1, 2].map(|n| as_now[n].at_last);
        let mut watch =
            DriftWatch::new(CONFIG, &rig, (true, WhenCalibrated { rows_px: Some(0.2), focus_px, brightness_percent }))
                .unwrap();
        let look = |k: u64| watch.look(MonotonicTime::from_nanos(k * 2_000_000_000), 0.0, &softer);
        let warnings: Vec<String> = (0..6).flat_map(look).collect();
        let found = watch.summaries();
        assert!(warnings.is_empty(), "{warnings:?}");
        assert!(found[1].at_last.is_some_and(|px| px.abs() < 0.01), "{found:#?}");
        assert!(found[2].at_last.is_some_and(|percent| percent.abs() < 0.01), "{found:#?}");
        assert_eq!([found[0].when_calibrated, found[1].when_calibrated], [Some(0.2), focus_px]);
        // If both were alike, the blur of one is the change; equal blur of the other one cancels it.
        assert!((added_blur_px(1.5, 0.0) - 1.5).abs() < 1e-12 && (added_blur_px(0.0, 1.5) + 1.5).abs() < 1e-12);
        assert!((added_blur_px(-1.0, 1.0) + 2f64.sqrt()).abs() < 1e-12);
    }

    /// Verdicts for these values, one sample each.
    fn warnings_of(values: &[f64]) -> Vec<Option<bool>> {
        let mut series = Series::new(Quantity::Rows, (&CONFIG, &WhenCalibrated::default()));
        let verdict = |line: String| !line.contains("drift gone");
        values.iter().map(|&value| series.push(Some(value)).map(verdict)).collect()
    }

    #[test]
    fn one_bad_measurement_reports_nothing_and_a_lasting_one_is_reported_once() {
        let calm = [0.1; 5];
        assert!(warnings_of(&[&calm[..], &[9.0, f64::NAN, 9.0], &calm[..]].concat()).iter().all(Option::is_none));
        let bad = warnings_of(&[&calm[..], &[-0.6; 20]].concat());
        assert_eq!((bad.iter().flatten().count(), bad[7]), (1, Some(true)), "{bad:?}");
        // A value just below the limit does not end the excess, and its end is reported once.
        let wavering = warnings_of(&[&[0.6; 5][..], &[0.45; 10], &[0.55; 10], &[0.3; 10]].concat());
        assert_eq!(wavering.into_iter().flatten().collect::<Vec<_>>(), [true, false]);
    }

    #[test]
    fn a_clock_that_was_set_back_does_not_end_the_looks() {
        let case = case();
        let (rig, pair) = (case.load_calibration().unwrap().rig, pair(&case));
        let mut watch = DriftWatch::new(CONFIG, &rig, (true, WhenCalibrated::default())).unwrap();
        for second in [100, 101, 5, 7] {
            watch.look(MonotonicTime::from_nanos(second * 1_000_000_000), 0.0, &pair);
        }
        assert_eq!(watch.summaries()[2].looks, 3);
    }
}
