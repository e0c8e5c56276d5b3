//! Scores of one region over depth, at the true tilt: the score function of a search.

use anyhow::Context;
use nalgebra::{Vector2, Vector3};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::plane_hypothesis::{PinholePair, PlaneHypothesis};
use pb3dp_estimation_core::region::{RegionConfig, RegionMask};
use pb3dp_estimation_published::estimator::PublishedConfig;
use pb3dp_estimation_published::fitness::HueFitness;
use pb3dp_estimation_published::hue::HuePlane;
use pb3dp_estimation_published::photo_model::PhotoModel;
use pb3dp_estimation_published::search::PlaneScore;
use pb3dp_estimation_views::colour_planes::{ColourPlanes, Wanted};
use pb3dp_estimation_views::front_end::{Side, StereoFrontEnd};
use pb3dp_estimation_views::image_plane::{ImagePlane, PixelWindow};
use pb3dp_geometry::StereoRig;

use super::cell::Cell;
use super::measure::Rendered;

/// Scores at one offset from the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Disparity of the plane minus that of the true plane, at the region's centroid, pixels.
    pub off_px: f64,
    /// The published fitness, eq. (10); `None` if the hypothesis is rejected or the target has no hue.
    pub fitness: Option<f64>,
    /// Correlation of luminance between the region and the right image warped by the plane.
    pub correlation: f64,
}

/// The scores of one rendered pair of a rectified rig, at the disparity offsets `off_px` from the truth.
///
/// # Errors
/// If the pair does not suit the methods.
pub fn scores(cell: &Cell, rig: &StereoRig, pair: &Rendered, off_px: &[f64]) -> anyhow::Result<Vec<Sample>> {
    let mask = pair.trial.region.rasterize(&pair.left, &RegionConfig::default())?;
    let centroid_px = mask.centroid_px().context("the region is empty")?;
    let pinholes = PinholePair::from_rig(rig)?;
    let ray = pinholes.left_ray(&centroid_px);
    let truth =
        PlaneHypothesis::from_inverse_depth_plane(&pair.trial.plane, &ray).context("it is behind the camera")?;
    let focal_baseline_px_m = rig.left().pinhole().fx * rig.baseline_m();
    let hypotheses: Vec<PlaneHypothesis> = off_px
        .iter()
        .map(|off| PlaneHypothesis { z_m: focal_baseline_px_m / (focal_baseline_px_m / truth.z_m + off), ..truth })
        .collect();
    let fitness = published(cell, &pinholes, pair, &mask, &hypotheses)?;
    let [left, right] = luminance(rig, pair)?;
    let correlation = |psi: &PlaneHypothesis| {
        let q = psi.inverse_depth_plane(&ray)? * focal_baseline_px_m;
        let shift = |pixel: &Vector2<f64>| q.dot(&pinholes.left_ray(pixel));
        Some(correlation(&mask, &left, &right, shift))
    };
    let samples = off_px.iter().zip(&hypotheses).zip(fitness).map(|((off_px, psi), fitness)| {
        let correlation = correlation(psi).unwrap_or(f64::NAN);
        Sample { off_px: *off_px, fitness, correlation }
    });
    Ok(samples.collect())
}

fn published(
    cell: &Cell,
    pinholes: &PinholePair,
    pair: &Rendered,
    mask: &RegionMask,
    hypotheses: &[PlaneHypothesis],
) -> anyhow::Result<Vec<Option<f64>>> {
    let config = PublishedConfig::default();
    let [left, right] = [&pair.left, &pair.right].map(|image| HuePlane::from_rgb(image, &config.hue));
    let model = PhotoModel::sample(&left, mask, &config.model);
    if model.inner().is_empty() {
        return Ok(vec![None; hypotheses.len()]);
    }
    let mut fitness = HueFitness::new(config.fitness, Kernels::best())?;
    let prepared = fitness.prepare(pinholes, &model, &right, &cell.search)?;
    let mut scores = vec![0; hypotheses.len()];
    prepared.score(hypotheses, &mut scores);
    Ok(scores.into_iter().map(|score| prepared.fitness(score)).collect())
}

fn luminance(rig: &StereoRig, pair: &Rendered) -> anyhow::Result<[ImagePlane; 2]> {
    let front_end = StereoFrontEnd::new(rig, Kernels::best())?;
    let load = |side, image: &image::RgbImage| {
        let size = front_end.size(side);
        let window = PixelWindow { x: 0, y: 0, width: size.width as usize, height: size.height as usize };
        let mut planes = ColourPlanes::default();
        front_end.load(side, ImageView::from(image), window, Wanted::Luminance, &mut planes);
        planes.luminance().clone()
    };
    Ok([load(Side::Left, &pair.left), load(Side::Right, &pair.right)])
}

/// Correlation over the pixels whose correspondence, `shift` columns to the left, lies in the right image.
fn correlation(mask: &RegionMask, left: &ImagePlane, right: &ImagePlane, shift: impl Fn(&Vector2<f64>) -> f64) -> f64 {
    let (mut count, mut sums) = (0.0, [0.0; 5]);
    mask.for_each(|u, v| {
        let pixel = Vector2::new(f64::from(u), f64::from(v));
        let Some(b) = between(right.row(v as usize), pixel.x - shift(&pixel)) else { return };
        let a = f64::from(left.row(v as usize)[u as usize]);
        count += 1.0;
        for (sum, term) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
            *sum += term;
        }
    });
    let [a, b, aa, bb, ab] = sums;
    let moments = Vector3::new(aa - a * a / count, bb - b * b / count, ab - a * b / count);
    moments.z / (moments.x * moments.y).sqrt()
}

/// The interpolated value between pixels of a row (Keys 1981, a = -1/2); `None` if a neighbour is missing.
fn between(row: &[f32], at: f64) -> Option<f64> {
    let whole = at.floor();
    if !(whole >= 1.0 && whole + 2.0 < row.len() as f64) {
        return None;
    }
    let first = whole as usize - 1;
    let [a, b, c, d] = [0, 1, 2, 3].map(|i| f64::from(row[first + i]));
    let t = at - whole;
    Some(b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a))))
}

#[cfg(test)]
mod tests {
    use super::super::cells;
    use super::super::measure::Worker;
    use super::super::scenes::SceneStore;
    use super::*;

    #[test]
    fn both_scores_have_their_summit_near_the_truth_and_grey_has_no_hue() {
        let offsets: Vec<f64> = (-60..=60).map(|i| f64::from(i) * 0.25).collect();
        let summit = |name: &str, of: &dyn Fn(&Sample) -> f64| {
            let cell = cells::all().into_iter().find(|cell| cell.name == name).unwrap();
            let scene = SceneStore::default().scene(&cell.setup).unwrap();
            let mut worker = Worker::new(&cell, &scene, 5, &[]).unwrap();
            let pair = worker.render(0).unwrap();
            let samples = scores(&cell, worker.stated_rig(), &pair, &offsets).unwrap();
            let best = samples.iter().max_by(|a, b| of(a).total_cmp(&of(b))).unwrap();
            (best.off_px, of(best))
        };
        let (off_px, height) = summit("target/colourful", &|s| s.correlation);
        assert!(off_px.abs() < 0.3 && height > 0.8, "{off_px} px, {height}");
        let (off_px, height) = summit("target/colourful", &|s| s.fitness.unwrap_or(-9.0));
        assert!(off_px.abs() < 1.5 && height > 0.6, "{off_px} px, {height}");
        let (_, height) = summit("target/grey", &|s| s.fitness.unwrap_or(-9.0));
        assert!(height < 0.4, "{height}");
    }

    #[test]
    fn a_cubic_is_read_as_it_is() {
        let row: Vec<f32> = (0..9).map(|i| (i * i) as f32).collect();
        assert!((between(&row, 4.3).unwrap() - 18.49).abs() < 1e-5);
        assert_eq!((between(&row, 0.9), between(&row, 7.0)), (None, None));
    }
}
