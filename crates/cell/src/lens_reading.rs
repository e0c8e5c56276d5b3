//! Which reading of a calibration its images agree with, where the file leaves the lens model unstated.

use pb3dp_estimation::rig_watch::RigWatch;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_geometry::StereoRig;
use pb3dp_record::calibration_files::{CalibrationFileError, LensModel, StereoCalibration};

/// Smallest number of points with which a reading counts. Chosen by hand, not varied: fewer than for a belief in the rig itself, because two readings
/// of one file are compared.
const MATCHES_MIN: usize = 30;
/// A reading with which at least this many points agree is used if fewer than [`MATCHES_MIN`] agree with the other one. Chosen: with half of it,
/// the other reading may lack a few points only; with double, 3 of 4 real pairs are refused instead of 2.
const ALONE_MIN: usize = 2 * MATCHES_MIN;
/// Information of the points (points per squared pixel of spread) of the better reading, as a multiple of that of the other one, from which it
/// is used. Chosen by hand, not varied: a spread that is twice as small.
const CLEARLY_BETTER: f64 = 4.0;

/// What the rows of a pair show of a reading.
struct Rows {
    matches: usize,
    spread_px: f64,
    objection: Option<String>,
}

impl Rows {
    fn of(rig: &StereoRig, left: ImageView<'_>, right: ImageView<'_>) -> Option<Self> {
        let mut watch = RigWatch::new(rig).ok()?;
        let measured = watch.look(left, right).ok()?;
        Some(Self { matches: measured.matches, spread_px: measured.spread_px, objection: watch.objection() })
    }

    fn fits(&self) -> bool {
        self.matches >= MATCHES_MIN && self.objection.is_none()
    }

    fn information(&self) -> f64 {
        self.matches as f64 / self.spread_px.powi(2).max(1e-6)
    }

    fn text(&self) -> String {
        match self.matches {
            0 => "0 points on their rows".to_owned(),
            matches => format!("{matches} points within {:.2} px of their rows", self.spread_px),
        }
    }
}

/// Decides an unstated lens model by a pair of raw images: a reading is used if the images object to the other one, or if many more points
/// agree with it, or more points with a much smaller spread. A calibration that needs no decision is returned as it is.
///
/// # Errors
/// The images do not decide; the message names the option that does.
pub fn decide_lens<'a>(
    calibration: StereoCalibration,
    left: impl Into<ImageView<'a>>,
    right: impl Into<ImageView<'a>>,
) -> Result<StereoCalibration, CalibrationFileError> {
    let Some(other) = &calibration.other_lens else { return Ok(calibration) };
    let (left, right) = (left.into(), right.into());
    let (brown, equidistant) = (Rows::of(&calibration.rig, left, right), Rows::of(other, left, right));
    let (Some(brown), Some(equidistant)) = (brown, equidistant) else {
        return Err(calibration.undecided_lens("the images cannot be compared with both"));
    };
    let is_alone = |one: &Rows, two: &Rows| one.matches >= ALONE_MIN && two.matches < MATCHES_MIN;
    let is_sharper = |one: &Rows, two: &Rows| {
        two.matches > 0
            && one.matches > two.matches
            && one.spread_px < two.spread_px
            && one.information() >= CLEARLY_BETTER * two.information()
    };
    let is_better = |one: &Rows, two: &Rows| is_alone(one, two) || is_sharper(one, two);
    let is_clear = |one: &Rows, two: &Rows| one.fits() && (two.objection.is_some() || is_better(one, two));
    let (lens, found, against) = match (is_clear(&brown, &equidistant), is_clear(&equidistant, &brown)) {
        (true, false) => (LensModel::BrownConrady, &brown, &equidistant),
        (false, true) => (LensModel::Equidistant, &equidistant, &brown),
        _ => {
            let found = format!("the images do not decide ({}, and {})", brown.text(), equidistant.text());
            return Err(calibration.undecided_lens(&found));
        }
    };
    let because = format!("the images then show {}, with the other model {}", found.text(), against.text());
    Ok(calibration.with_lens(lens, &because))
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};
    use nalgebra::{Point3, Vector2};
    use pb3dp_geometry::{Camera, Distortion, Pinhole};
    use pb3dp_record::dataset::load_case;

    use super::*;

    /// A real pair as lenses with these coefficients would show it, with its calibration of two readings.
    fn rendered_board(lens: LensModel, k: [f64; 4]) -> (StereoCalibration, [RgbImage; 2]) {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/cases/bb201_c0");
        let case = load_case(folder.as_ref()).unwrap();
        let (images, calibration) = (case.load_images().unwrap(), case.load_calibration().unwrap());
        let rig = calibration.rig;
        let reading = |lens: LensModel| {
            let distortion = match lens {
                LensModel::BrownConrady => Distortion::BrownConrady5 { coefficients: [k[0], k[1], k[2], k[3], 0.0] },
                LensModel::Equidistant => Distortion::Equidistant { coefficients: k },
            };
            // The fields of view are cut, so that every pixel has a source.
            let camera = |of: &Camera| {
                let Pinhole { fx, fy, cx, cy } = *of.pinhole();
                Camera::new(of.size(), Pinhole { fx: 1.2 * fx, fy: 1.2 * fy, cx, cy }, distortion).unwrap()
            };
            StereoRig::new(camera(rig.left()), camera(rig.right()), *rig.cam_right_from_cam_left()).unwrap()
        };
        let (brown, equidistant) = (reading(LensModel::BrownConrady), reading(LensModel::Equidistant));
        let taken_by = if lens == LensModel::BrownConrady { &brown } else { &equidistant };
        let left = warped(&images.left, rig.left(), taken_by.left());
        let right = warped(&images.right, rig.right(), taken_by.right());
        (StereoCalibration { rig: brown, other_lens: Some(equidistant), ..calibration }, [left, right])
    }

    fn warped(image: &RgbImage, from: &Camera, to: &Camera) -> RgbImage {
        RgbImage::from_fn(to.size().width, to.size().height, |u, v| {
            let ray = to.unproject(&Vector2::new(f64::from(u), f64::from(v)));
            let Some(at) = ray.ok().and_then(|ray| from.project(&Point3::from(ray))) else { return Rgb([0; 3]) };
            let (x, y) = (at.x.floor(), at.y.floor());
            let grey = |dx: f64, dy: f64| {
                let clamped = |c: f64, side: u32| c.clamp(0.0, f64::from(side) - 1.0) as u32;
                let [r, g, b] = image.get_pixel(clamped(x + dx, image.width()), clamped(y + dy, image.height())).0;
                (f64::from(r) + f64::from(g) + f64::from(b)) / 3.0
            };
            let (a, b) = (at.x - x, at.y - y);
            let rows = [0.0, 1.0].map(|dy| grey(0.0, dy) * (1.0 - a) + grey(1.0, dy) * a);
            Rgb([(rows[0] * (1.0 - b) + rows[1] * b).round() as u8; 3])
        })
    }

    #[test]
    fn the_reading_that_its_images_agree_with_is_used() {
        for (lens, k) in [
            (LensModel::Equidistant, [-0.0127, 0.0412, -0.0385, 0.0078]),
            (LensModel::BrownConrady, [-0.214, 0.0583, 0.0007, -0.0011]),
        ] {
            let (calibration, [left, right]) = rendered_board(lens, k);
            let expected = if lens == LensModel::BrownConrady { Some(calibration.rig) } else { calibration.other_lens };
            let decided = decide_lens(calibration, &left, &right).unwrap();
            assert_eq!((Some(decided.rig), decided.other_lens), (expected, None));
            let warning = decided.warnings.last().unwrap();
            assert!(warning.contains(&lens.to_string()) && warning.contains("--calib-lens"), "{warning}");
        }
    }

    #[test]
    fn images_that_show_nothing_do_not_decide() {
        let (calibration, [left, _]) = rendered_board(LensModel::Equidistant, [0.01, 0.0, 0.0, 0.0]);
        let grey = RgbImage::from_pixel(left.width(), left.height(), Rgb([90; 3]));
        let refused = decide_lens(calibration, &grey, &grey).unwrap_err().to_string();
        assert!(refused.contains("the images do not decide (0 points on their rows"), "{refused}");
        assert!(refused.contains("--calib-lens brown or --calib-lens equidistant"), "{refused}");
    }
}
