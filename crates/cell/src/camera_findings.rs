//! Checks of the images of a stereo rig against limits: exposure, sharpness, and vertical alignment, each with a remedy.

use image::RgbImage;
use pb3dp_estimation::pair_check::{PairCheck, PairVerdict, check_pair};
use pb3dp_estimation::rig_watch::{MATCHES_MIN, RowMeter};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::FramePair;

use crate::finding::{Finding, Limits};
use crate::image_quality::{EDGE_MIN_GREY, EDGES_MIN, Exposure, blur_of, brighter_by_percent, softer_by_px};

/// Share of saturated or black pixels, percent: a lamp or its reflection, a black background.
const BRIGHT_MAX_PERCENT: f64 = 2.0;
const DARK_MAX_PERCENT: f64 = 20.0;
/// Mean luminance, grey levels.
const MEAN_GREY: [f64; 2] = [30.0, 210.0];
/// Difference of the mean luminances of both cameras, percent of the brighter one.
const DIFFERENCE_MAX_PERCENT: f64 = 15.0;

/// Blur of an edge, standard deviation in pixels; a step between two pixels measures 0.8.
const BLUR_MAX_PX: f64 = 2.0;
/// Difference in blur between the cameras: the square root of the difference of squares.
const FOCUS_MAX_PX: f64 = 1.0;

/// Vertical misalignment anywhere in the image. The method `direct` measures and removes it, but a calibration with a larger one
/// has other errors too.
const ROWS_MAX_PX: f64 = 1.0;

/// Share of matches behind the cameras, percent: these matches are wrong (`pair_check.rs`).
const BEHIND_MAX_PERCENT: f64 = 25.0;

const NO_CALIBRATION: &str = "no calibration was given";

/// Checks the images of one stereo rig.
pub struct ImageChecks {
    /// The calibration with its meter; `None` without a calibration.
    calibrated: Option<(StereoRig, Result<RowMeter, EstimationError>)>,
}

impl ImageChecks {
    /// Checks for this calibration; without one, `rows` and `sides` are not checked.
    pub fn new(rig: Option<&StereoRig>) -> Self {
        Self { calibrated: rig.map(|rig| (*rig, RowMeter::new(rig, Kernels::best()))) }
    }

    /// All measurements of some pairs of one scene.
    pub fn findings(&mut self, samples: &[&FramePair]) -> Vec<Finding> {
        let cameras: [Vec<&RgbImage>; 2] =
            [samples.iter().map(|pair| &pair.left).collect(), samples.iter().map(|pair| &pair.right).collect()];
        let exposures = [Exposure::of(&cameras[0]), Exposure::of(&cameras[1])];
        let mut findings = Vec::new();
        for (side, exposure) in ["left", "right"].into_iter().zip(&exposures) {
            findings.extend(exposure_findings(exposure, side));
        }
        findings.push(difference(&exposures));
        findings.extend(sharpness([blur_of(&cameras[0]), blur_of(&cameras[1])]));
        findings.push(sides(samples, self.calibrated.as_ref().map(|(rig, _)| rig)));
        findings.push(rows(samples, self.calibrated.as_mut().map(|(_, meter)| meter)));
        findings
    }
}

fn exposure_findings(exposure: &Exposure, side: &str) -> [Finding; 3] {
    let [low, middle, high] = exposure.quantiles_grey;
    let histogram = format!("5 % of the pixels are below {low}, half below {middle}, 95 % below {high}");
    [
        Finding::judged(
            format!("brightness {side}"),
            (exposure.mean_grey, "grey levels"),
            Limits::between(MEAN_GREY[0], MEAN_GREY[1]),
            histogram,
            "more light (or less), else exposure, aperture or gain; is the lens cap off?",
        ),
        Finding::judged(
            format!("clipped bright {side}"),
            (exposure.bright_percent, "% of the pixels"),
            Limits::at_most(BRIGHT_MAX_PERCENT),
            "",
            "a shorter exposure or less gain; move lamps whose reflections are seen",
        ),
        Finding::judged(
            format!("clipped dark {side}"),
            (exposure.dark_percent, "% of the pixels"),
            Limits::at_most(DARK_MAX_PERCENT),
            "",
            "more light, a longer exposure, or more gain; a lower black level if the camera has one",
        ),
    ]
}

fn difference(exposures: &[Exposure; 2]) -> Finding {
    let [left, right] = exposures.map(|exposure| exposure.mean_grey);
    Finding::judged(
        "brightness of both",
        (brighter_by_percent(exposures).abs(), "% apart"),
        Limits::at_most(DIFFERENCE_MAX_PERCENT),
        format!("left {left:.0}, right {right:.0} grey levels"),
        "set the same exposure, gain and aperture in both cameras, and no automatic modes; is one lens dirty?",
    )
}

fn sharpness(blurs: [Option<f64>; 2]) -> Vec<Finding> {
    const FOCUS: &str =
        "focus and clean the lens, and lock it; close the aperture; is the exposure short enough for what moves?";
    let mut findings = Vec::new();
    for (side, blur) in ["left", "right"].into_iter().zip(blurs) {
        let check = format!("sharpness {side}");
        findings.push(match blur {
            Some(px) => Finding::judged(check, (px, "px of blur"), Limits::at_most(BLUR_MAX_PX), "", FOCUS),
            None => {
                let found = format!("fewer than {EDGES_MIN} edges of {EDGE_MIN_GREY} grey levels are seen");
                let advice = "show both cameras something with sharp edges at the distance at which they work (a printed page, a calibration \
                              board); if they see one, focus them and give more light";
                Finding::fail(check, found, advice)
            }
        });
    }
    if let [Some(left), Some(right)] = blurs {
        let px = softer_by_px([left, right]);
        let softer = if px < 0.0 { "left" } else { "right" };
        findings.push(Finding::judged(
            "focus of both",
            (px.abs(), "px of blur in one camera only"),
            Limits::at_most(FOCUS_MAX_PX),
            format!("the {softer} one is softer"),
            "focus the softer one: a camera that is less sharp tilts the result (docs/method.md)",
        ));
    }
    findings
}

/// Whether the left image is from the left camera: then points visible in both images are in front of the cameras.
fn sides(samples: &[&FramePair], rig: Option<&StereoRig>) -> Finding {
    const CHECK: &str = "sides";
    let Some(rig) = rig else {
        return Finding::not_checked(
            CHECK,
            NO_CALIBRATION,
            "give --calib FILE to see whether left and right are exchanged",
        );
    };
    let checks: Vec<PairCheck> = samples.iter().map(|pair| check_pair(rig, &pair.left, &pair.right)).collect();
    let sum = |count: fn(&PairCheck) -> usize| checks.iter().map(count).sum::<usize>();
    let (points, behind) = (sum(|one| one.agreeing), sum(|one| one.behind));
    let exchanged = sum(|one| one.fitting_exchanged);
    let is_swapped = checks.iter().any(|check| check.verdict == PairVerdict::Swapped);
    let has_verdict = |check: &PairCheck| !matches!(check.verdict, PairVerdict::Unknown | PairVerdict::Unrelated);
    if !is_swapped && !checks.iter().any(has_verdict) {
        let found = format!("only {points} points in all are found in both images");
        let advice = "show both cameras a scene with much texture, 300 to 800 mm away";
        return Finding::not_checked(CHECK, found, advice);
    }
    let percent = if is_swapped { 100.0 } else { behind as f64 / points.max(1) as f64 * 100.0 };
    let (found, advice) = if is_swapped {
        let found = format!(
            "left and right are exchanged: once they are the other way round {exchanged} points are in front of them"
        );
        (found, "exchange --left and --right (left.device and right.device of a setup); no plug has to be moved")
    } else {
        let found = format!("{behind} of {points} points");
        (found, "the calibration does not belong to these cameras: give the right file, or calibrate again")
    };
    Finding::judged(
        CHECK,
        (percent, "% of the points behind the cameras"),
        Limits::at_most(BEHIND_MAX_PERCENT),
        found,
        advice,
    )
}

fn rows(samples: &[&FramePair], meter: Option<&mut Result<RowMeter, EstimationError>>) -> Finding {
    const CHECK: &str = "rows";
    let Some(meter) = meter else {
        return Finding::not_checked(
            CHECK,
            NO_CALIBRATION,
            "give --calib FILE to have the rows of both images compared",
        );
    };
    let does_not_fit = |error: &EstimationError| {
        let found = format!("the images do not fit the calibration: {error}");
        Finding::fail(CHECK, found, "give the calibration of these cameras in this size")
    };
    let meter = match meter {
        Ok(meter) => meter,
        Err(error) => return does_not_fit(error),
    };
    let measured: Result<Vec<_>, _> = samples.iter().map(|pair| meter.measure(&pair.left, &pair.right, None)).collect();
    let mut measured = match measured {
        Ok(measured) => measured,
        Err(error) => return does_not_fit(&error),
    };
    let most = measured.iter().map(|one| one.matches).max().unwrap_or_default();
    measured.retain(|one| one.matches > 0);
    measured.sort_by(|a, b| meter.largest_px(a).total_cmp(&meter.largest_px(b)));
    let Some(middle) = measured.get(measured.len() / 2) else {
        let found = format!("only {most} points are found in both images, {MATCHES_MIN} are needed");
        let advice = "show both cameras a scene with much texture, 300 to 800 mm away; if they see one, the calibration is far off";
        return Finding::fail(CHECK, found, advice);
    };
    let found = format!(
        "{:+.2} px at the centre, each point {:.2} px around it, {} points",
        meter.centre_px(middle),
        middle.spread_px,
        middle.matches
    );
    let advice = "the cameras have moved against each other, or the calibration is of others: screw them down, let them warm up, and calibrate again";
    Finding::judged(CHECK, (meter.largest_px(middle), "px off at worst"), Limits::at_most(ROWS_MAX_PX), found, advice)
}

#[cfg(test)]
mod tests {
    use image::Rgb;
    use pb3dp_record::dataset::load_case;
    use pb3dp_record::images::load_rgb;

    use super::*;
    use crate::finding::Verdict;

    /// A real pair, and the calibration of its cameras.
    fn real() -> (FramePair, StereoRig) {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases");
        let mut folders: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        folders.sort();
        let case = load_case(folders.iter().find(|folder| folder.is_dir()).unwrap()).unwrap();
        let [left, right] = [&case.left, &case.right].map(|file| load_rgb(file).unwrap());
        (pair(left, right), case.load_calibration().unwrap().rig)
    }

    fn findings(samples: &[FramePair], rig: Option<&StereoRig>) -> Vec<Finding> {
        ImageChecks::new(rig).findings(&samples.iter().collect::<Vec<_>>())
    }

    fn pair(left: RgbImage, right: RgbImage) -> FramePair {
        FramePair { left, right, ..FramePair::black(pb3dp_geometry::ImageSize { width: 1, height: 1 }) }
    }

    fn named<'a>(findings: &'a [Finding], check: &str) -> &'a Finding {
        findings.iter().find(|finding| finding.check == check).unwrap_or_else(|| panic!("{check}: {findings:?}"))
    }

    /// A board of tiles whose edges are blurred by a Gaussian of this standard deviation, seen from a little aside.
    fn board(sigma_px: f64) -> RgbImage {
        // The integral of a Gaussian, by the logistic curve of the same slope.
        let step = |x: f64| 1.0 / (1.0 + (-x * 4.0 / (sigma_px * std::f64::consts::TAU.sqrt())).exp());
        RgbImage::from_fn(320, 240, |x, y| {
            let u = f64::from(x) + 0.13 * f64::from(y) + 7.3;
            let along = u.rem_euclid(40.0);
            let up = step(along - 10.0) - step(along - 30.0);
            Rgb([(60.0 + 120.0 * up).round() as u8; 3])
        })
    }

    #[test]
    fn blur_is_what_edges_were_blurred_by() {
        let blur = |sigma_px| blur_of(&[&board(sigma_px)]).unwrap();
        for sigma_px in [1.5, 2.0, 3.0] {
            assert!((blur(sigma_px) / sigma_px - 1.0).abs() < 0.15, "{sigma_px}: {}", blur(sigma_px));
        }
        assert!(blur(0.3) < 1.0, "{}", blur(0.3));
        assert_eq!(blur_of(&[&RgbImage::from_pixel(320, 240, Rgb([90; 3]))]), None);
        let findings = findings(&[pair(board(0.8), board(2.5))], None);
        let passed =
            ["sharpness left", "sharpness right", "focus of both", "rows"].map(|name| named(&findings, name).verdict);
        let (pass, fail) = (Verdict::Pass, Verdict::Fail);
        assert_eq!(passed, [pass, fail, fail, Verdict::NotChecked], "{findings:?}");
        assert_eq!(named(&findings, "focus of both").found, "the right one is softer");
    }

    #[test]
    fn exposures_are_judged() {
        let grey = |level: u8| RgbImage::from_pixel(64, 48, Rgb([level; 3]));
        let verdicts = |left: u8, right: u8| {
            let findings = findings(&[pair(grey(left), grey(right))], None);
            ["brightness left", "clipped bright left", "clipped dark right", "brightness of both"]
                .map(|name| named(&findings, name).verdict == Verdict::Pass)
        };
        assert_eq!(verdicts(100, 95), [true, true, true, true]);
        assert_eq!(verdicts(255, 240), [false, false, true, true]);
        assert_eq!(verdicts(3, 3), [false, true, false, true]);
        assert_eq!(verdicts(100, 70), [true, true, true, false]);
    }

    #[test]
    fn eyes_that_are_exchanged_are_found() {
        let (FramePair { left, right, .. }, rig) = real();
        let exchanged = findings(&[pair(right.clone(), left.clone()), pair(right, left)], Some(&rig));
        let sides = named(&exchanged, "sides");
        assert_eq!((sides.verdict, sides.value), (Verdict::Fail, Some(100.0)), "{sides:?}");
        assert!(sides.found.starts_with("left and right are exchanged"), "{sides:?}");
        assert!(
            sides.advice.as_ref().is_some_and(|advice| advice.contains("exchange --left and --right")),
            "{sides:?}"
        );
        // What says nothing is not judged.
        let grey = || RgbImage::from_pixel(640, 480, Rgb([90; 3]));
        assert_eq!(named(&findings(&[pair(grey(), grey())], Some(&rig)), "sides").verdict, Verdict::NotChecked);
        assert_eq!(named(&findings(&[pair(grey(), grey())], None), "sides").found, NO_CALIBRATION);
    }

    #[test]
    fn a_real_pair_passes_and_a_shifted_one_does_not() {
        let (FramePair { left, right, .. }, rig) = real();
        let whole = findings(&[pair(left.clone(), right.clone())], Some(&rig));
        assert!(whole.iter().all(|finding| finding.verdict == Verdict::Pass), "{whole:#?}");
        // Three rows lower.
        let lower = RgbImage::from_fn(right.width(), right.height(), |x, y| *right.get_pixel(x, y.saturating_sub(3)));
        let findings = findings(&[pair(left, lower)], Some(&rig));
        let rows = named(&findings, "rows");
        assert!(rows.verdict == Verdict::Fail && (rows.value.unwrap() - 3.0).abs() < 1.0, "{rows:?}");
    }
}
