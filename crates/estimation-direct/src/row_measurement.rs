//! Measurement of a rig's errors on the rows of a pair, from many points distributed over both images.
//!
//! Points with texture in both directions are matched in the right image: over all possible disparities at a quarter of the size, then
//! refined level by level, and finally to sub-pixel accuracy (Lucas and Kanade, with means and gains removed). A robust fit to their row
//! differences gives the errors that explain them ([`pb3dp_estimation_core::rig_errors`]). It takes some milliseconds.

mod patch;
mod target;

use nalgebra::{Vector2, Vector3};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_estimation_core::rig_errors::{
    ERRORS, ErrorCovariance, ErrorVector, MOVED_FROM, OFFSET, PlanePlace, ROLL, RigErrors, SCALE,
};
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::row_offset::RowOffset;
use pb3dp_estimation_views::colour_planes::{ColourPlanes, UNSEEN, Wanted};
use pb3dp_estimation_views::disparity_plane::{DisparityRange, RectifiedGeometry};
use pb3dp_estimation_views::front_end::{Side, StereoFrontEnd};
use pb3dp_estimation_views::image_plane::PixelWindow;
use pb3dp_estimation_views::raw_view::rows_near;
use pb3dp_estimation_views::region_pyramid::{PyramidSource, RegionLevel, RegionPyramid};
use pb3dp_geometry::StereoRig;

use self::patch::{CORRELATION_MIN, CoarseSearch, GRADIENT_MIN, Patch, RADIUS, refine};
pub use self::target::{KnownTarget, MotionSigmas, RegionRows};

/// Level of the exhaustive search. Chosen by hand, not varied: with the rows on either side, offsets of up to 4 px are
/// found there; time falls to an eighth per level.
const COARSE: usize = 2;
/// Spacing of the points, pixels of the coarse level. Chosen by hand, not varied: 16 px at full size; time grows with the
/// inverse square.
const SPACING: usize = 4;
/// Smallest number of matches for a fit. Chosen by hand, not varied: three for each error.
const FIT_MATCHES_MIN: usize = 15;
/// Smallest number of matches for a fit that is believed. Chosen with figures: of walls whose pattern repeats up to 27 match by chance, and 35 of
/// the corners of a chessboard lean the same way.
pub const MATCHES_MIN: usize = 40;
/// The same if points scatter by less than this, pixels.
const CLOSE_MATCHES_MIN: usize = 25;
const CLOSE_PX: f64 = 0.15;
/// Searches, each for the case that those before find few points: the level, and the rows of this level on either side of the expected one.
/// Chosen by hand, not varied: 4 px of the image; 32 px, which are 2.5 degrees of pitch at a focal length of 740 px; and patches of 18 px and 9 px
/// for small objects before a plain wall.
const SEARCHES: [(usize, i64); 4] = [(COARSE, 1), (COARSE, 8), (1, 2), (0, 4)];
/// Disparities of points, relative to that of infinity, as shares of the image width. Chosen with figures: below, there are only matches by
/// chance; the lowest one allows for a yaw of 2 degrees at a focal length of 740 px.
const DISPARITY_SHARES: [f64; 2] = [-0.04, 0.5];
/// Number of points with texture on one level beyond which the next one is not searched. Chosen with figures: where hundreds of points are not
/// found on the coarse level (insides of bodies, blurred or dark), those of the others scatter as well, and cost 0.3 s.
const PLAIN_MAX: usize = 160;
/// Rows that differ by this much somewhere are measured again, near the rows that the first measurement predicts, and at most so often. Chosen
/// by hand, not varied: smaller offsets are found as well at once.
const AGAIN_FROM_PX: f64 = 1.0;
const AGAIN_MAX: usize = 3;
const AGAIN_REACH_PX: i64 = 4;
/// Neighbouring points share errors of the lens model: their information counts as that of at most this many independent ones. Chosen by hand,
/// not varied.
const INDEPENDENT_MAX: f64 = 100.0;
/// Standard deviations of the errors grow by this, divided by the number of points. Chosen with figures: corners of a chessboard that are taken for
/// their neighbours lean the same way; 35 of them seemed to show a roll of 0.09 degrees, at two standard deviations.
const FEW: f64 = 15.0;
/// Largest standard deviation of a point's row, pixels: beyond it the points were matched by chance. Chosen with figures: boards and walls
/// whose pattern repeats have 2 to 5 px, blurred endoscopes up to 1.3 px.
const SPREAD_MAX_PX: f64 = 1.5;
/// Standard deviation of a point's row, pixels, from which the largest set of points that agree is looked for; the distance within which
/// they agree; the number of tries, and the smallest share of all points. Chosen by hand, not varied: of points of which half are right, one
/// try in 30 draws right ones only.
const SPREAD_DOUBT_PX: f64 = 0.3;
const AGREE_PX: f64 = 1.0;
const CONSENSUS_TRIES: usize = 300;
const CONSENSUS_SHARE: f64 = 0.5;
/// Errors from which the search begins anew if points scatter that much, or the rig seems to have moved. Chosen by hand, not varied: rows differ
/// by up to 3 px in an image of 640 x 480 pixels; where a pattern repeats, other places of it match better on the expected rows than the right
/// ones beside them.
const STARTS: [(usize, f64); 4] = [(ROLL, 0.01), (ROLL, -0.01), (SCALE, 0.01), (SCALE, -0.01)];
/// Smallest standard deviation of a point with sharp texture, relative to the usual one. Chosen by hand, not varied: errors of the lens model
/// do not become smaller with it.
const RELATIVE_SIGMA_MIN: f64 = 0.7;
/// Smallest standard deviation of a point's row, pixels. Chosen by hand, not varied: that of sharp images without noise.
const SPREAD_MIN_PX: f64 = 0.03;

/// Disparity (baseline over depth) at which a turn of the baseline is judged: a scene at five baselines.
const USUAL_DISPARITY: f64 = 0.2;

/// One matched point: its pixels.
#[derive(Clone, Copy, Debug)]
struct RowMatch {
    left_px: Vector2<f64>,
    right_px: Vector2<f64>,
    /// Variance of the row that the texture of the patch allows, in any unit: large on an edge that runs along rows.
    row_variance: f64,
}

impl RowMatch {
    fn offset_px(&self) -> f64 {
        self.right_px.y - self.left_px.y
    }
}

/// Measures the errors of a rig.
#[derive(Clone, Debug)]
pub struct RowMeter {
    front_end: StereoFrontEnd,
    nothing: RigErrors,
}

impl RowMeter {
    /// A meter for the raw images of a rig.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn new(rig: &StereoRig, kernels: Kernels) -> Result<Self, EstimationError> {
        Ok(Self { front_end: StereoFrontEnd::new(rig, kernels)?, nothing: RigErrors::of_rig(&rig.rectify()?) })
    }

    /// Measures a pair of raw images. Without enough points the errors are zero, with the covariance of the prior; with fewer than
    /// [`MATCHES_MIN`] they are mostly not to be believed ([`is_enough`]). `before`: what earlier pairs of the rig have shown.
    ///
    /// # Errors
    /// Images with another size than the rig's.
    pub fn measure<'a>(
        &self,
        left: impl Into<ImageView<'a>>,
        right: impl Into<ImageView<'a>>,
        before: Option<&RigErrors>,
    ) -> Result<RigErrors, EstimationError> {
        let (left, right) = (left.into(), right.into());
        self.front_end.check(left, right)?;
        Ok(measure_rows(self, (left, right), before))
    }

    /// The row offsets at the corners and the centre of the rectified image, with their standard deviations; tangents.
    pub fn offsets(&self, errors: &RigErrors) -> [(f64, f64); 5] {
        let (middle, geometry) = (self.front_end.middle(), self.front_end.geometry());
        let (left, top) = (f64::from(middle.x), f64::from(middle.y));
        let (right, bottom) = (left + middle.width as f64 - 1.0, top + middle.height as f64 - 1.0);
        let centre = (0.5 * (left + right), 0.5 * (top + bottom));
        [(left, top), (right, top), (left, bottom), (right, bottom), centre].map(|(u, v)| {
            let principal_px = geometry.left_principal_px + Vector2::new(geometry.disparity_offset_px, 0.0);
            let ray = (Vector2::new(u, v) - principal_px).component_div(&geometry.focal_px);
            errors.row_offset(&ray, USUAL_DISPARITY)
        })
    }

    /// Largest vertical misalignment in the image, pixels.
    pub fn largest_px(&self, errors: &RigErrors) -> f64 {
        self.offsets(errors).into_iter().map(|(offset, _)| offset.abs()).fold(0.0, f64::max) * self.focal_px()
    }

    /// Vertical misalignment at the image centre, pixels; positive if the right image is lower.
    pub fn centre_px(&self, errors: &RigErrors) -> f64 {
        self.centre(errors).0 * self.focal_px()
    }

    /// The same with its standard deviation, tangents.
    pub fn centre(&self, errors: &RigErrors) -> (f64, f64) {
        self.offsets(errors)[4]
    }

    /// Vertical focal length of the rectified images, pixels.
    pub fn focal_px(&self) -> f64 {
        self.front_end.geometry().focal_px.y
    }
}

/// The rectified images of a pair, with the rows of the right one moved as some errors say.
#[derive(Debug, Default)]
struct Shown {
    pyramid: RegionPyramid,
    rows: Option<RowOffset>,
}

fn measure_rows(meter: &RowMeter, images: (ImageView<'_>, ImageView<'_>), before: Option<&RigErrors>) -> RigErrors {
    let mut shown = Shown::default();
    let mut measure = |errors| {
        let start = RigErrors { errors, ..meter.nothing };
        measure_from(meter, images, start, &mut shown)
    };
    let (first, is_plain) = measure(before.map_or(ErrorVector::zeros(), |before| before.errors));
    let (is_found, scatters) = (is_enough(&first), first.spread_px > SPREAD_DOUBT_PX);
    let is_worth_it = match is_found {
        true => scatters || first.believed().1 > MOVED_FROM,
        false => is_plain && first.matches > 0,
    };
    let others: Vec<ErrorVector> = match before {
        Some(before) if (!is_found || scatters) && before.errors != ErrorVector::zeros() => vec![ErrorVector::zeros()],
        None if is_worth_it => STARTS.map(|(index, size)| ErrorVector::ith(index, size)).to_vec(),
        _ => Vec::new(),
    };
    others.into_iter().fold(first, |best, start| better(best, measure(start).0))
}

/// Whether a measurement is to be believed.
pub fn is_enough(measured: &RigErrors) -> bool {
    let few_are_enough = measured.spread_px <= CLOSE_PX;
    measured.matches >= if few_are_enough { CLOSE_MATCHES_MIN } else { MATCHES_MIN }
}

fn better(best: RigErrors, other: RigErrors) -> RigErrors {
    let is_better = match is_enough(&best) && is_enough(&other) {
        true => information(&other) > information(&best),
        false => is_enough(&other) || (!is_enough(&best) && other.matches > best.matches),
    };
    if is_better { other } else { best }
}

/// The measurement that a search near the rows of known errors leads to, and whether the image has little texture.
fn measure_from(
    meter: &RowMeter,
    images: (ImageView<'_>, ImageView<'_>),
    start: RigErrors,
    shown: &mut Shown,
) -> (RigErrors, bool) {
    let (mut best, mut level, mut textured) = (start, COARSE, 0);
    for search in SEARCHES {
        let is_finer = search.0 < COARSE;
        if is_finer && textured > PLAIN_MAX {
            break;
        }
        if is_enough(&best) && (!is_finer || best.spread_px <= SPREAD_DOUBT_PX) {
            continue;
        }
        let measured;
        (measured, textured) = meter.measured_near(&best, search, images, shown);
        let found = better(best, measured);
        if found != best {
            (best, level) = (found, search.0);
        }
    }
    // Patches are found with more certainty on their own rows.
    for _ in 0..AGAIN_MAX {
        if meter.largest_px(&best) < AGAIN_FROM_PX {
            break;
        }
        let (again, _) = meter.measured_near(&best, (level, AGAIN_REACH_PX >> level), images, shown);
        if information(&again) <= information(&best) {
            break;
        }
        best = again;
    }
    (best, textured <= PLAIN_MAX)
}

/// Points for the variance of one.
fn information(measured: &RigErrors) -> f64 {
    measured.matches as f64 / measured.spread_px.powi(2).max(1e-9)
}

impl RowMeter {
    /// A measurement that looks for points near the rows that known errors predict, on a level and so many of its rows on either side; and the
    /// number of points with texture.
    fn measured_near(
        &self,
        known: &RigErrors,
        (level, reach): (usize, i64),
        images: (ImageView<'_>, ImageView<'_>),
        shown: &mut Shown,
    ) -> (RigErrors, usize) {
        let (front_end, geometry) = (&self.front_end, self.front_end.geometry());
        let middle = front_end.middle();
        let mut region = RegionMask::empty(front_end.size(Side::Left));
        for y in 0..middle.height {
            let (x, y) = (i64::from(middle.x), i64::from(middle.y) + y as i64);
            region.insert_span(y, x, x + middle.width as i64 - 1);
        }
        let width = middle.width as f64;
        let centre_px = Vector2::new(
            f64::from(middle.x) + 0.5 * (width - 1.0),
            f64::from(middle.y) + 0.5 * (middle.height as f64 - 1.0),
        );
        let ray = geometry.left_ray(&centre_px).xy();
        let ([lowest, highest], infinite) = (DISPARITY_SHARES, geometry.disparity_offset_px);
        let place = PlanePlace { ray, disparity: USUAL_DISPARITY, focal_px: geometry.focal_px };
        let source = PyramidSource {
            left: images.0,
            right: images.1,
            region: &region,
            disparity_px: DisparityRange { lowest: lowest * width - infinite, highest: highest * width - infinite },
            rows: rows_near(known, &place, geometry),
            wanted: Wanted::Luminance,
            search_area_px: usize::MAX,
        };
        if shown.rows != Some(source.rows) {
            shown.pyramid.update(front_end, &source);
            shown.rows = Some(source.rows);
        }
        let any = |_: &Vector2<f64>| Some(source.disparity_px);
        let (matches, textured) = self.matches(&source.rows, any, (level, reach), &shown.pyramid);
        (fit(&matches, geometry, self.nothing), textured)
    }

    /// Matches of the points in a region that the search on a level finds, with the rows of the unmoved right image; and the number of points
    /// with texture. `rows`: how the pyramid shows them; `disparity_px`: where to search for a rectified left pixel.
    fn matches(
        &self,
        rows: &RowOffset,
        disparity_px: impl Fn(&Vector2<f64>) -> Option<DisparityRange>,
        (coarse, reach): (usize, i64),
        pyramid: &RegionPyramid,
    ) -> (Vec<RowMatch>, usize) {
        let Some(level) = pyramid.levels().get(coarse) else { return (Vec::new(), 0) };
        let (columns, lines) = (level.left.window.width, level.left.window.height);
        let margin = RADIUS + 2;
        let mut search = CoarseSearch::new(level, reach, self.front_end.kernels());
        let points = (margin..lines.saturating_sub(margin))
            .step_by(SPACING)
            .flat_map(|y| (margin..columns.saturating_sub(margin)).step_by(SPACING).map(move |x| (x, y)));
        let inside = points.filter(|(x, y)| level.region[y * columns + x] != 0);
        let levels = &pyramid.levels()[..=coarse];
        let (mut matches, mut textured) = (Vec::new(), 0);
        for (x, y) in inside {
            let point = Vector2::new(x as i64, y as i64);
            let Some(patch) = textured_patch(level, point) else { continue };
            textured += 1;
            let Some(range) = disparity_px(&level.full_from_level(&point.map(|at| at as f64))) else { continue };
            let Some(mut found) = find_again(levels, &mut search, &patch, (point, range)) else { continue };
            // The pyramid shows the right image with its rows moved.
            found.right_px.y += rows.at(&found.right_px);
            matches.push(found);
        }
        (matches, textured)
    }

    /// Column and row of a point of the left camera in the rectified left image, tangents.
    pub fn left_ray(&self, in_cam_left_m: &Vector3<f64>) -> Vector2<f64> {
        let rectified = self.front_end.cam_left_rect_from_cam_left().transform_vector(in_cam_left_m);
        rectified.xy() / rectified.z
    }

    /// Length of the baseline, metres.
    pub fn baseline_m(&self) -> f64 {
        self.front_end.geometry().baseline_m
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Right ray of a match with third component 1, with the row that it should have, and its disparity in tangents.
fn ray_and_disparity(found: &RowMatch, geometry: &RectifiedGeometry) -> (Vector2<f64>, f64) {
    let right_principal_px = geometry.left_principal_px + Vector2::new(geometry.disparity_offset_px, 0.0);
    let disparity_px = found.left_px.x - found.right_px.x + geometry.disparity_offset_px;
    let ray_px = Vector2::new(found.right_px.x, found.left_px.y) - right_principal_px;
    (ray_px.component_div(&geometry.focal_px), disparity_px / geometry.focal_px.x)
}

/// The patch around a point with texture.
fn textured_patch(level: &RegionLevel, point: Vector2<i64>) -> Option<Patch> {
    // Noise halves with the size.
    let gradient_min = GRADIENT_MIN * f64::from(1 << COARSE) / level.scale as f64;
    let patch = Patch::take(level.left.luminance(), point).filter(|patch| patch.gradient >= gradient_min);
    patch.filter(|_| is_visible(&level.left, point))
}

/// Whether the raw image shows the whole patch: the border of what it shows is no texture.
fn is_visible(planes: &ColourPlanes, place: Vector2<i64>) -> bool {
    let radius = RADIUS as i64;
    let inside =
        |at: i64, length: usize| (at - radius).max(0) as usize..((at + radius + 1).max(0) as usize).min(length);
    let columns = inside(place.x, planes.window.width);
    inside(place.y, planes.window.height).all(|y| {
        let row = &planes.flags[y * planes.window.width..][columns.clone()];
        row.iter().all(|flags| flags & UNSEEN == 0)
    })
}

/// The match of a patch of the last level.
fn find_again(
    levels: &[RegionLevel],
    search: &mut CoarseSearch<'_>,
    patch: &Patch,
    (point, disparity_px): (Vector2<i64>, DisparityRange),
) -> Option<RowMatch> {
    let (_, finer) = levels.split_last()?;
    let mut place = search.find(patch, point, disparity_px)?;
    let mut at = point;
    for level in finer.iter().rev() {
        at *= 2;
        let patch = Patch::take(level.left.luminance(), at)?;
        let around = (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| 2 * place + Vector2::new(dx, dy)));
        let scored = around.filter_map(|p| Some((patch.correlation_at(level.right.luminance(), p)?, p)));
        let (best, found) = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
        if f64::from(best) < CORRELATION_MIN[1] {
            return None;
        }
        place = found;
    }
    let (left, right) = (&levels[0].left, &levels[0].right);
    if !is_visible(right, place) {
        return None;
    }
    let (shift, row_variance) = refine(left.luminance(), right.luminance(), at, place)?;
    let whole = |window: PixelWindow, px: Vector2<i64>| {
        Vector2::new(px.x as f64 + f64::from(window.x), px.y as f64 + f64::from(window.y))
    };
    Some(RowMatch { left_px: whole(left.window, at), right_px: whole(right.window, place) + shift, row_variance })
}

/// Number of steps of the robust fit. Chosen by hand, not varied.
const FIT_STEPS: usize = 15;

/// Robust fit of the errors to the row differences of the matches (Tukey's biweight).
fn fit(matches: &[RowMatch], geometry: &RectifiedGeometry, nothing: RigErrors) -> RigErrors {
    if matches.len() < FIT_MATCHES_MIN {
        return nothing;
    }
    let focal_px = &geometry.focal_px;
    let by = |found: &RowMatch| {
        let (ray, disparity) = ray_and_disparity(found, geometry);
        nothing.row_derivative(&ray, disparity)
    };
    // In units of the usual match.
    let usual = median(matches.iter().map(|found| found.row_variance).collect());
    let rows: Vec<WeightedRow> = matches
        .iter()
        .map(|found| {
            let relative = (found.row_variance / usual).sqrt().max(RELATIVE_SIGMA_MIN);
            (by(found) / relative, found.offset_px() / focal_px.y / relative, relative)
        })
        .collect();
    let mut start = nothing;
    start.errors[OFFSET] = median(matches.iter().map(|found| found.offset_px() / focal_px.y).collect());
    let of_all = fit_from(start, &rows, focal_px.y);
    if of_all.spread_px <= SPREAD_DOUBT_PX {
        return of_all;
    }
    // Matches by chance may agree with each other better than with the true ones.
    let agreeing = consensus(&rows, AGREE_PX / focal_px.y);
    if (agreeing.len() as f64) >= CONSENSUS_SHARE * rows.len() as f64 && agreeing.len() >= FIT_MATCHES_MIN {
        let found = fit_from(of_all, &agreeing, focal_px.y);
        let scatter = median(rows.iter().map(|(by, offset, _)| (offset - by.dot(&found.errors)).abs()).collect());
        return RigErrors { spread_px: 1.4826 * scatter * focal_px.y, ..found };
    }
    if of_all.spread_px > SPREAD_MAX_PX { nothing } else { of_all }
}

/// Derivative of the row offset by the errors and the offset, both over the relative standard deviation, and this deviation.
type WeightedRow = (ErrorVector, f64, f64);

/// The largest set of rows that agree with the errors of some [`ERRORS`] of them within a distance (RANSAC; Fischler and Bolles 1981).
fn consensus(rows: &[WeightedRow], near: f64) -> Vec<WeightedRow> {
    let prior = RigErrors::default().covariance.map_diagonal(|variance| (near / 3.0).powi(2) / variance);
    let agrees = |(by, offset, _): &WeightedRow, errors: &ErrorVector| (offset - by.dot(errors)).abs() < near;
    let mut random = SplitMix64::new(1);
    let mut best = (0, ErrorVector::zeros());
    for _ in 0..CONSENSUS_TRIES {
        let (mut information, mut pull) = (ErrorCovariance::from_diagonal(&prior), ErrorVector::zeros());
        for _ in 0..ERRORS {
            let (by, offset, _) = &rows[random.below(rows.len() as u32) as usize];
            information += by * by.transpose();
            pull += by * *offset;
        }
        let Some(known) = information.cholesky() else { continue };
        let errors = known.solve(&pull);
        let count = rows.iter().filter(|row| agrees(row, &errors)).count();
        if count > best.0 {
            best = (count, errors);
        }
    }
    rows.iter().filter(|row| agrees(row, &best.1)).copied().collect()
}

fn fit_from(start: RigErrors, rows: &[WeightedRow], focal_px: f64) -> RigErrors {
    let prior = RigErrors::default().covariance.map_diagonal(|variance| 1.0 / variance);
    let mut errors = start.errors;
    let (mut spread, mut information) = (0.0, ErrorCovariance::zeros());
    for _ in 0..FIT_STEPS {
        let residual = |(by, offset, _): &WeightedRow| offset - by.dot(&errors);
        // As of few values (Rousseeuw and Leroy 1987, chapter 5, section 1).
        let of_few = 1.0 + 5.0 / (rows.len() - ERRORS) as f64;
        spread = 1.4826 * of_few * median(rows.iter().map(|row| residual(row).abs()).collect());
        spread = spread.max(SPREAD_MIN_PX / focal_px);
        let mut pull = ErrorVector::zeros();
        information = ErrorCovariance::zeros();
        let mut count = 0.0;
        for row in rows {
            let r = residual(row);
            let weight = (1.0 - (r / (4.0 * spread)).powi(2)).max(0.0).powi(2);
            information += weight * row.0 * row.0.transpose();
            pull += weight * r * row.0;
            count += weight / row.2.powi(2);
        }
        let share = (INDEPENDENT_MAX / count).min(1.0) / (spread * spread);
        information = information * share + ErrorCovariance::from_diagonal(&prior);
        pull = pull * share - prior.component_mul(&errors);
        let Some(known) = information.cholesky() else { return start };
        errors += known.solve(&pull);
    }
    let Some(covariance) = information.cholesky().map(|known| known.inverse()) else { return start };
    let of_few = 1.0 + FEW / (rows.len() - ERRORS) as f64;
    let covariance = covariance * of_few.powi(2);
    RigErrors { errors, covariance, matches: rows.len(), spread_px: spread * focal_px, ..start }
}
