//! Corners and calibrations of rendered boards with known truth.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use nalgebra::{Isometry3, Vector2};
use pb3dp_calibration::board::Sighting;
use pb3dp_calibration::detection::{Localizer, find_board_by};
use pb3dp_calibration::fit::View;
use pb3dp_calibration::held_out::choose;
use pb3dp_calibration::lens::LensModel;
use pb3dp_calibration::quality::Quality;
use pb3dp_geometry::StereoRig;
use pb3dp_record::metrics::percentile;

use crate::bound::{Corner, variance_px2};
use crate::renderer::{GREYS, Imaging, Renderer};
use crate::support::{Random, SIZE, Session, board, detected_by_both, normalised_errors, placed, rig};

/// Views per rig.
const VIEWS: usize = 15;

/// The localizers that are compared, with their names in tables.
pub const LOCALIZERS: [(Localizer, &str); 2] =
    [(Localizer::CentreOfMass, "centre of mass"), (Localizer::SaddlePoint, "saddle point")];

/// Image conditions.
pub const CONDITIONS: [(&str, Imaging); 5] = [
    ("noise 2", Imaging { blur_px: 0.5, noise_grey: 2.0, contrast: 1.0 }),
    ("noise 5", Imaging { blur_px: 0.5, noise_grey: 5.0, contrast: 1.0 }),
    ("dim, noise 2", Imaging { blur_px: 0.5, noise_grey: 2.0, contrast: 0.25 }),
    ("blur 1 px, noise 2", Imaging { blur_px: 1.0, noise_grey: 2.0, contrast: 1.0 }),
    ("blur 2 px, noise 2", Imaging { blur_px: 2.0, noise_grey: 2.0, contrast: 1.0 }),
];

/// The figures of one localizer on all rigs of one condition.
#[derive(Clone, Default)]
pub struct Measured {
    /// Errors of corners.
    pub corners: Vec<Vector2<f64>>,
    pub missed_boards: usize,
    pub detection_ms: Vec<f64>,
    pub calibration_ms: Vec<f64>,
    pub reprojection_px: Vec<f64>,
    pub held_out_px: Vec<f64>,
    /// Stated standard deviation of a corner.
    pub stated_px: Vec<f64>,
    pub focal_px: Vec<f64>,
    pub principal_point_px: Vec<f64>,
    pub baseline_mm: Vec<f64>,
    pub rotation_deg: Vec<f64>,
    /// Numbers within one and two stated standard deviations, and all.
    pub within: [usize; 3],
    pub failed_fits: usize,
}

impl Measured {
    /// Root mean square error of a corner in a row or column, px.
    pub fn rms_px(&self) -> f64 {
        (self.corners.iter().map(Vector2::norm_squared).sum::<f64>() / (2 * self.corners.len()).max(1) as f64).sqrt()
    }

    /// Percentile of the distance of a corner from its true position, px.
    pub fn distance_px(&self, percent: f64) -> f64 {
        percentile(&self.corners.iter().map(Vector2::norm).collect::<Vec<_>>(), percent).unwrap_or(f64::NAN)
    }

    /// Share of all numbers within `sigmas` (1 or 2) stated standard deviations, percent.
    pub fn covered_percent(&self, sigmas: usize) -> f64 {
        100.0 * self.within[sigmas - 1] as f64 / self.within[2].max(1) as f64
    }

    fn add(&mut self, other: Self) {
        self.corners.extend(other.corners);
        self.missed_boards += other.missed_boards;
        self.failed_fits += other.failed_fits;
        for (to, from) in [
            (&mut self.detection_ms, other.detection_ms),
            (&mut self.calibration_ms, other.calibration_ms),
            (&mut self.reprojection_px, other.reprojection_px),
            (&mut self.held_out_px, other.held_out_px),
            (&mut self.stated_px, other.stated_px),
            (&mut self.focal_px, other.focal_px),
            (&mut self.principal_point_px, other.principal_point_px),
            (&mut self.baseline_mm, other.baseline_mm),
            (&mut self.rotation_deg, other.rotation_deg),
        ] {
            to.extend(from);
        }
        for (to, from) in self.within.iter_mut().zip(other.within) {
            *to += from;
        }
    }
}

/// All figures of one condition.
#[derive(Clone, Default)]
pub struct OfCondition {
    pub by_localizer: [Measured; LOCALIZERS.len()],
    /// Bounds of the variance of corners, px^2: from the nearest 5 x 5 pixels, and from all pixels up to half a square.
    pub bounds_px2: [Vec<f64>; 2],
}

impl OfCondition {
    /// Root mean square of a bound, px.
    pub fn bound_px(&self, index: usize) -> f64 {
        let of = &self.bounds_px2[index];
        (of.iter().sum::<f64>() / of.len().max(1) as f64).sqrt()
    }
}

/// Measures all conditions on rigs with the seeds `seed`, `seed + 1`, ...
pub fn measure(seed: u32, rigs: u32, threads: usize) -> Vec<OfCondition> {
    let next = AtomicU32::new(0);
    let found = Mutex::new(vec![Vec::new(); CONDITIONS.len()]);
    let work = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= rigs {
                return;
            }
            for (index, of) in of_rig(seed + number).into_iter().enumerate() {
                found.lock().expect("no panic")[index].push((number, of));
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..threads.max(1) {
            scope.spawn(work);
        }
    });
    let merged = |mut list: Vec<(u32, OfCondition)>| {
        list.sort_by_key(|(number, _)| *number);
        list.into_iter().fold(OfCondition::default(), |mut all, (_, of)| {
            for (to, from) in all.by_localizer.iter_mut().zip(of.by_localizer) {
                to.add(from);
            }
            for (to, from) in all.bounds_px2.iter_mut().zip(of.bounds_px2) {
                to.extend(from);
            }
            all
        })
    };
    found.into_inner().expect("no panic").into_iter().map(merged).collect()
}

fn of_rig(seed: u32) -> Vec<OfCondition> {
    let mut random = Random::new(seed);
    let rig = rig(&mut random);
    let renderers = [Renderer::new(rig.left()), Renderer::new(rig.right())];
    let scenes = scenes(&rig, &mut random);
    let lights: Vec<[Vec<f64>; 2]> = scenes
        .iter()
        .map(|(poses, _)| std::array::from_fn(|camera| renderers[camera].light(&poses[camera], &board())))
        .collect();
    let of_condition = |(index, (_, imaging)): (usize, &(&str, Imaging))| {
        let mut all = OfCondition::default();
        let mut views: [Vec<View<2>>; LOCALIZERS.len()] = Default::default();
        for (number, ((poses, truth), light)) in scenes.iter().zip(&lights).enumerate() {
            let mut noise = Random::new(seed.wrapping_mul(1009) + (number * CONDITIONS.len() + index) as u32 + 1);
            let images: [_; 2] =
                std::array::from_fn(|camera| renderers[camera].image(&light[camera], *imaging, &mut noise));
            for camera in 0..2 {
                add_bounds(&renderers[camera], &poses[camera], &truth[camera], *imaging, &mut all.bounds_px2);
            }
            for ((localizer, _), (measured, views)) in
                LOCALIZERS.iter().zip(all.by_localizer.iter_mut().zip(&mut views))
            {
                let sightings: [Option<Sighting>; 2] =
                    std::array::from_fn(|camera| {
                        let began = Instant::now();
                        let sighting = find_board_by(&images[camera], &board(), *localizer).ok();
                        measured.detection_ms.push(1e3 * began.elapsed().as_secs_f64());
                        let Some(sighting) = sighting else {
                            measured.missed_boards += 1;
                            return None;
                        };
                        measured.corners.extend(sighting.corners().iter().filter_map(|corner| {
                            Some(corner.pixel - truth[camera].at(corner.column, corner.row)?.pixel)
                        }));
                        Some(sighting)
                    });
                if let [Some(left), Some(right)] = sightings {
                    views.push(View { name: format!("{number:02}"), sightings: [left, right] });
                }
            }
        }
        for (measured, views) in all.by_localizer.iter_mut().zip(&views) {
            calibrate(&rig, views, measured);
        }
        all
    };
    CONDITIONS.iter().enumerate().map(of_condition).collect()
}

/// Board poses in both cameras, and the true corners.
type Scene = ([Isometry3<f64>; 2], [Sighting; 2]);

fn scenes(rig: &StereoRig, random: &mut Random) -> Vec<Scene> {
    let exact = Session { corner_sigma_px: 0.0, ..Session::GOOD };
    let mut scenes = Vec::with_capacity(VIEWS);
    while scenes.len() < VIEWS {
        let left = placed(rig, &board(), &exact, random);
        let Some(truth) = detected_by_both(rig, &left, (0.0, 1.0), random) else { continue };
        scenes.push(([left, rig.cam_right_from_cam_left().isometry() * left], truth));
    }
    scenes
}

fn add_bounds(
    renderer: &Renderer,
    cam_from_board: &Isometry3<f64>,
    truth: &Sighting,
    imaging: Imaging,
    bounds_px2: &mut [Vec<f64>; 2],
) {
    for corner in truth.corners() {
        let [at, along_row, along_column] = renderer.edges(cam_from_board, &board(), corner);
        let (column, row) = (corner.column, corner.row);
        let next = [
            truth.at(column + 1, row),
            truth.at(column, row + 1),
            column.checked_sub(1).and_then(|column| truth.at(column, row)),
            row.checked_sub(1).and_then(|row| truth.at(column, row)),
        ];
        let nearest = next.into_iter().flatten().map(|other| (other.pixel - at).norm()).fold(f64::INFINITY, f64::min);
        let model = Corner {
            at,
            edges: [along_row, along_column],
            half_contrast: 0.5 * imaging.contrast * (GREYS[1] - GREYS[0]),
            // The area of a pixel has the variance 1/12 in each direction, and so has the rounding to whole grey levels.
            blur_px: (imaging.blur_px.powi(2) + 1.0 / 12.0).sqrt(),
            noise_grey: (imaging.noise_grey.powi(2) + 1.0 / 12.0).sqrt(),
        };
        let of_25 = variance_px2(&model, 3.0, |offset| offset.amax() <= 2.5);
        let of_square = variance_px2(&model, 0.5 * nearest, |offset| offset.norm() <= 0.5 * nearest);
        for (list, bound) in bounds_px2.iter_mut().zip([of_25, of_square]) {
            list.extend(bound);
        }
    }
}

fn calibrate(truth: &StereoRig, views: &[View<2>], measured: &mut Measured) {
    let began = Instant::now();
    let chosen = choose(views, &board(), SIZE, &[LensModel::Brown4]);
    let Ok((chosen, rig)) = chosen.and_then(|chosen| chosen.fit.rig().map(|rig| (chosen, rig))) else {
        measured.failed_fits += 1;
        return;
    };
    measured.calibration_ms.push(1e3 * began.elapsed().as_secs_f64());
    let Ok(quality) = Quality::of_stereo(&chosen, views, SIZE, 0.5) else {
        measured.failed_fits += 1;
        return;
    };
    measured.reprojection_px.push(quality.reprojection_rms_px);
    measured.held_out_px.push(quality.held_out_rms_px);
    measured.stated_px.push(chosen.fit.covariance().corner_sigma_px);
    for (found, truth) in [(rig.left(), truth.left()), (rig.right(), truth.right())] {
        let (a, b) = (found.pinhole(), truth.pinhole());
        measured.focal_px.push((a.fx - b.fx).abs());
        measured.principal_point_px.push((a.cx - b.cx).hypot(a.cy - b.cy));
    }
    measured.baseline_mm.push(1e3 * (rig.baseline_m() - truth.baseline_m()).abs());
    let turn = rig.cam_right_from_cam_left().rotation().angle_to(&truth.cam_right_from_cam_left().rotation());
    measured.rotation_deg.push(turn.to_degrees());
    for (_, error) in normalised_errors(&chosen.fit, truth) {
        measured.within[0] += usize::from(error.abs() <= 1.0);
        measured.within[1] += usize::from(error.abs() <= 2.0);
        measured.within[2] += 1;
    }
}
