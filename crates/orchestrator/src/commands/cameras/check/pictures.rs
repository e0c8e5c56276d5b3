//! What pictures are like: exposure, sharpness, and whether the rows of both belong together.

use image::RgbImage;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method, RowMeasurement};
use pb3dp_estimation::pair_check::{PairCheck, PairVerdict, check_pair};
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::FramePair;

use super::finding::{Finding, Limits};

/// Grey levels from which on, and up to which, a pixel has lost what it showed.
const BRIGHT: u8 = 254;
const DARK: u8 = 4;
/// Share of such pixels, percent: a lamp or its reflection, a black background.
const BRIGHT_MAX_PERCENT: f64 = 2.0;
const DARK_MAX_PERCENT: f64 = 20.0;
/// Mean luminance, grey levels.
const MEAN_GREY: [f64; 2] = [30.0, 210.0];
/// Difference of the mean luminances of both eyes, percent of the brighter one.
const DIFFERENCE_MAX_PERCENT: f64 = 15.0;

/// An edge has to be as high, grey levels, to tell how sharp it is.
const EDGE_MIN_GREY: f64 = 40.0;
/// Fewer edges do not tell.
const EDGES_MIN: usize = 200;
/// The sharpest quarter of the edges counts: the others may be soft by themselves.
const SHARPEST_SHARE: f64 = 0.25;
/// Blur of an edge, standard deviation in pixels; steps from pixel to pixel come out as 0.8.
const BLUR_MAX_PX: f64 = 2.0;
/// Blur that one eye has and the other one has not: the square root of the difference of both squares.
const FOCUS_MAX_PX: f64 = 1.0;

/// Anywhere in the picture. The method `direct` measures it and takes it out, but a calibration that is off by more is off elsewhere too.
const ROWS_MAX_PX: f64 = 1.0;
/// As many points must be found again in the other picture; with fewer nothing is measured (`row_measurement.rs`).
const MATCHES_MIN: usize = 15;

/// Matches that may lie behind the cameras, percent: no scene is there, so these have gone wrong (`pair_check.rs`).
const BEHIND_MAX_PERCENT: f64 = 25.0;

const NO_CALIBRATION: &str = "no calibration was given";

/// All findings about pictures.
pub(super) fn findings(samples: &[FramePair], rig: Option<&StereoRig>) -> Vec<Finding> {
    let eyes: [Vec<&RgbImage>; 2] =
        [samples.iter().map(|pair| &pair.left).collect(), samples.iter().map(|pair| &pair.right).collect()];
    let exposures = [Exposure::of(&eyes[0]), Exposure::of(&eyes[1])];
    let mut findings = Vec::new();
    for (side, exposure) in ["left", "right"].into_iter().zip(&exposures) {
        findings.extend(exposure.findings(side));
    }
    findings.push(difference(&exposures));
    findings.extend(sharpness([blur_of(&eyes[0]), blur_of(&eyes[1])]));
    findings.push(sides(samples, rig));
    findings.push(rows(samples, rig));
    findings
}

/// How bright the pictures of one camera are.
#[derive(Clone, Copy, Debug)]
struct Exposure {
    bright_percent: f64,
    dark_percent: f64,
    mean_grey: f64,
    /// Luminances below which 5, 50 and 95 % of the pixels are.
    quantiles_grey: [usize; 3],
}

impl Exposure {
    fn of(pictures: &[&RgbImage]) -> Self {
        let mut histogram = [0_u64; 256];
        let (mut bright, mut dark, mut sum) = (0_u64, 0_u64, 0_u64);
        for pixel in pictures.iter().flat_map(|picture| picture.pixels()) {
            let [r, g, b] = pixel.0;
            // One channel that is full has lost its colour; all of them at nothing have lost everything.
            bright += u64::from(r.max(g).max(b) >= BRIGHT);
            dark += u64::from(r.max(g).max(b) <= DARK);
            let grey = luminance(pixel.0);
            histogram[grey as usize] += 1;
            sum += u64::from(grey);
        }
        let count = histogram.iter().sum::<u64>().max(1);
        let quantile = |share: f64| {
            let mut below = 0;
            histogram.iter().position(|pixels| {
                below += pixels;
                below as f64 >= share * count as f64
            })
        };
        let percent = |pixels: u64| pixels as f64 / count as f64 * 100.0;
        Self {
            bright_percent: percent(bright),
            dark_percent: percent(dark),
            mean_grey: sum as f64 / count as f64,
            quantiles_grey: [0.05, 0.5, 0.95].map(|share| quantile(share).unwrap_or_default()),
        }
    }

    fn findings(&self, side: &str) -> [Finding; 3] {
        let [low, middle, high] = self.quantiles_grey;
        let histogram = format!("5 % of the pixels are below {low}, half below {middle}, 95 % below {high}");
        [
            Finding::judged(
                format!("brightness {side}"),
                (self.mean_grey, "grey levels"),
                Limits::between(MEAN_GREY[0], MEAN_GREY[1]),
                histogram,
                "more light (or less), else exposure, aperture or gain; is the lens cap off?",
            ),
            Finding::judged(
                format!("clipped bright {side}"),
                (self.bright_percent, "% of the pixels"),
                Limits::at_most(BRIGHT_MAX_PERCENT),
                "",
                "a shorter exposure or less gain; move lamps whose reflections are seen",
            ),
            Finding::judged(
                format!("clipped dark {side}"),
                (self.dark_percent, "% of the pixels"),
                Limits::at_most(DARK_MAX_PERCENT),
                "",
                "more light, a longer exposure, or more gain; a lower black level if the camera has one",
            ),
        ]
    }
}

fn luminance([r, g, b]: [u8; 3]) -> u8 {
    ((u32::from(r) * 77 + u32::from(g) * 150 + u32::from(b) * 29) >> 8) as u8
}

fn difference(exposures: &[Exposure; 2]) -> Finding {
    let [left, right] = exposures.map(|exposure| exposure.mean_grey);
    let percent = (left - right).abs() / left.max(right).max(1.0) * 100.0;
    Finding::judged(
        "brightness of both",
        (percent, "% apart"),
        Limits::at_most(DIFFERENCE_MAX_PERCENT),
        format!("left {left:.0}, right {right:.0} grey levels"),
        "set the same exposure, gain and aperture in both cameras, and no automatic modes; is one lens dirty?",
    )
}

/// Blur of the sharpest edges of pictures, standard deviation in pixels; `None` where there are too few edges.
///
/// An edge of height A that was blurred by a Gaussian of standard deviation s has the steepest slope A / (s sqrt(2 pi)), so s follows
/// from both. Height is how far the luminance goes up or down along a row without turning.
fn blur_of(pictures: &[&RgbImage]) -> Option<f64> {
    let mut blurs = Vec::new();
    let mut row = Vec::new();
    for picture in pictures {
        let width = picture.width() as usize;
        for pixels in picture.as_raw().chunks_exact((3 * width).max(1)) {
            row.clear();
            row.extend(pixels.chunks_exact(3).map(|rgb| f64::from(luminance([rgb[0], rgb[1], rgb[2]]))));
            edges(&row, &mut blurs);
        }
    }
    if blurs.len() < EDGES_MIN {
        return None;
    }
    let at = (blurs.len() as f64 * SHARPEST_SHARE / 2.0) as usize;
    // The middle of the sharpest quarter.
    Some(*blurs.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// Blurs of all edges along a row.
fn edges(row: &[f64], blurs: &mut Vec<f64>) {
    let mut begin = 0;
    while begin + 1 < row.len() {
        let sign = (row[begin + 1] - row[begin]).signum();
        let mut end = begin + 1;
        while end + 1 < row.len() && (row[end + 1] - row[end]) * sign > 0.0 {
            end += 1;
        }
        let height = (row[end] - row[begin]).abs();
        // Both ends must be in the picture, and not be cut off by white or black.
        let is_whole = begin > 0 && end + 1 < row.len() && row[begin].max(row[end]) < f64::from(BRIGHT);
        if height >= EDGE_MIN_GREY && is_whole && row[begin].min(row[end]) > f64::from(DARK) {
            // Central differences, as the steepest place may be between two pixels.
            let slope =
                (begin..=end).filter(|&x| x > 0 && x + 1 < row.len()).map(|x| 0.5 * (row[x + 1] - row[x - 1]).abs());
            let slope = slope.fold(0.0, f64::max);
            if slope > 0.0 {
                blurs.push(height / (slope * std::f64::consts::TAU.sqrt()));
            }
        }
        begin = end;
    }
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
                Finding::missing(check, Some(false), found, advice)
            }
        });
    }
    if let [Some(left), Some(right)] = blurs {
        let px = (left * left - right * right).abs().sqrt();
        let softer = if left > right { "left" } else { "right" };
        findings.push(Finding::judged(
            "focus of both",
            (px, "px of blur in one eye only"),
            Limits::at_most(FOCUS_MAX_PX),
            format!("the {softer} one is softer"),
            "focus the softer one: an eye that is less sharp tilts the result (docs/method.md)",
        ));
    }
    findings
}

/// Whether the left picture is the one of the left eye: points that are found in both pictures are in front of the cameras then.
fn sides(samples: &[FramePair], rig: Option<&StereoRig>) -> Finding {
    const CHECK: &str = "sides";
    let Some(rig) = rig else {
        return Finding::missing(
            CHECK,
            None,
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
        let found = format!("only {points} points in all are found in both pictures");
        let advice = "show both cameras a scene with much texture, 300 to 800 mm away";
        return Finding::missing(CHECK, None, found, advice);
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

fn rows(samples: &[FramePair], rig: Option<&StereoRig>) -> Finding {
    const CHECK: &str = "rows";
    let Some(rig) = rig else {
        return Finding::missing(
            CHECK,
            None,
            NO_CALIBRATION,
            "give --calib FILE to have the rows of both pictures compared",
        );
    };
    let measure = |estimator: &mut Estimator, pair: &FramePair| estimator.prepare(&pair.left, &pair.right);
    let measured = Estimator::new(Method::Direct, rig, &EstimatorConfig::default()).and_then(|mut estimator| {
        samples.iter().map(|pair| measure(&mut estimator, pair)).collect::<Result<Vec<Option<RowMeasurement>>, _>>()
    });
    let mut measured: Vec<RowMeasurement> = match measured {
        Ok(measured) => measured.into_iter().flatten().collect(),
        Err(error) => {
            let found = format!("the pictures do not fit the calibration: {error}");
            return Finding::missing(CHECK, Some(false), found, "give the calibration of these cameras in this size");
        }
    };
    let most = measured.iter().map(|one| one.matches).max().unwrap_or_default();
    measured.retain(|one| one.matches >= MATCHES_MIN);
    let size = rig.right().size();
    let worst = |one: &RowMeasurement| one.rows.magnitude_max_px(size.width, size.height);
    measured.sort_by(|a, b| worst(a).total_cmp(&worst(b)));
    let Some(middle) = measured.get(measured.len() / 2) else {
        let found = format!("only {most} points are found in both pictures, {MATCHES_MIN} are needed");
        let advice = "show both cameras a scene with much texture, 300 to 800 mm away; if they see one, the calibration is far off";
        return Finding::missing(CHECK, Some(false), found, advice);
    };
    let found = format!(
        "{:+.2} px at the centre, each point {:.2} px around it, {} points",
        middle.rows.offset_px, middle.spread_px, middle.matches
    );
    let advice = "the cameras have moved against each other, or the calibration is of others: screw them down, let them warm up, and calibrate again";
    Finding::judged(CHECK, (worst(middle), "px off at worst"), Limits::at_most(ROWS_MAX_PX), found, advice)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    use super::super::super::emulated_rig::{case, pictures};

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
            ["sharpness left", "sharpness right", "focus of both", "rows"].map(|name| named(&findings, name).passed);
        assert_eq!(passed, [Some(true), Some(false), Some(false), None], "{findings:?}");
        assert_eq!(named(&findings, "focus of both").found, "the right one is softer");
    }

    #[test]
    fn exposures_are_judged() {
        let grey = |level: u8| RgbImage::from_pixel(64, 48, Rgb([level; 3]));
        let verdicts = |left: u8, right: u8| {
            let findings = findings(&[pair(grey(left), grey(right))], None);
            ["brightness left", "clipped bright left", "clipped dark right", "brightness of both"]
                .map(|name| named(&findings, name).passed == Some(true))
        };
        assert_eq!(verdicts(100, 95), [true, true, true, true]);
        assert_eq!(verdicts(255, 240), [false, false, true, true]);
        assert_eq!(verdicts(3, 3), [false, true, false, true]);
        assert_eq!(verdicts(100, 70), [true, true, true, false]);
    }

    #[test]
    fn eyes_that_are_exchanged_are_found() {
        let [left, right] = pictures().clone();
        let rig = case().load_calibration().unwrap().rig;
        let exchanged = findings(&[pair(right.clone(), left.clone()), pair(right, left)], Some(&rig));
        let sides = named(&exchanged, "sides");
        assert_eq!((sides.passed, sides.value), (Some(false), Some(100.0)), "{sides:?}");
        assert!(sides.found.starts_with("left and right are exchanged"), "{sides:?}");
        assert!(
            sides.advice.as_ref().is_some_and(|advice| advice.contains("exchange --left and --right")),
            "{sides:?}"
        );
        // What says nothing is not judged.
        let grey = || RgbImage::from_pixel(640, 480, Rgb([90; 3]));
        assert_eq!(named(&findings(&[pair(grey(), grey())], Some(&rig)), "sides").passed, None);
        assert_eq!(named(&findings(&[pair(grey(), grey())], None), "sides").found, NO_CALIBRATION);
    }

    #[test]
    fn a_real_pair_passes_and_a_shifted_one_does_not() {
        let [left, right] = pictures().clone();
        let rig = case().load_calibration().unwrap().rig;
        let whole = findings(&[pair(left.clone(), right.clone())], Some(&rig));
        assert!(whole.iter().all(|finding| finding.passed == Some(true)), "{whole:#?}");
        // Three rows lower.
        let lower = RgbImage::from_fn(right.width(), right.height(), |x, y| *right.get_pixel(x, y.saturating_sub(3)));
        let findings = findings(&[pair(left, lower)], Some(&rig));
        let rows = named(&findings, "rows");
        assert!(rows.passed == Some(false) && (rows.value.unwrap() - 3.0).abs() < 1.0, "{rows:?}");
    }
}
