//! The photo model: sample points of the left image with their hues, on the target and in a band around it.
//!
//! No prior data is needed; the model can be rebuilt in every frame. The paper leaves counts, spacing and the band open; here
//! they are parameters. The points are on a regular grid whose spacing follows from the area and the wanted count, so the count
//! is approximate (within 15 % for compact regions; a region with fewer pixels gives one point per pixel). A grid point whose
//! pixel has no hue (see [`HueConfig`](crate::hue::HueConfig)) is dropped: it neither votes nor counts in the fitness'
//! normalisation.

use nalgebra::Vector2;
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_geometry::ranges;

use crate::hue::{Hue, HuePlane};

/// Point counts and band of a photo model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PhotoModelConfig {
    /// Wanted number of points on the target, 1 to 20000. Default 240.
    pub inner_points: u32,
    /// Wanted number of points in the band, 0 (no band) to 20000. Default 80.
    pub outer_points: u32,
    /// Smallest distance between grid points of either set, pixels, 1 to 100. Default 1. If the counts cannot be reached, this
    /// parameter alone determines the spacing.
    pub spacing_min_px: u32,
    /// Distance between the region and the band, pixels, 0 to 200: excludes the blurred outline. Default 2.
    pub band_gap_px: u32,
    /// Width of the band, pixels, 1 to 200. Default 8.
    pub band_width_px: u32,
}

impl Default for PhotoModelConfig {
    fn default() -> Self {
        Self { inner_points: 240, outer_points: 80, spacing_min_px: 1, band_gap_px: 2, band_width_px: 8 }
    }
}

impl PhotoModelConfig {
    ranges! {
        pub fn validate "photo model ";
        inner_points, INNER_POINTS: u32 = 1..=20_000;
        outer_points, OUTER_POINTS: u32 = 0..=20_000;
        spacing_min_px, SPACING_MIN_PX: u32 = 1..=100;
        band_gap_px, BAND_GAP_PX: u32 = 0..=200;
        band_width_px, BAND_WIDTH_PX: u32 = 1..=200;
    }
}

/// A sample point: a left pixel and its hue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModelPoint {
    /// Column of the left image.
    pub u: i32,
    /// Row of the left image.
    pub v: i32,
    /// Hue of the left image there.
    pub hue: Hue,
}

/// Sample points of one region of one left image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhotoModel {
    centre_px: Vector2<f64>,
    inner: Vec<ModelPoint>,
    outer: Vec<ModelPoint>,
    inner_sampled: usize,
}

/// Work space of [`PhotoModel::resample`], kept between frames to avoid allocation.
#[derive(Clone, Debug)]
pub struct PhotoModelScratch {
    near: RegionMask,
    far: RegionMask,
}

impl Default for PhotoModelScratch {
    fn default() -> Self {
        let empty = RegionMask::empty(pb3dp_geometry::ImageSize { width: 0, height: 0 });
        Self { near: empty.clone(), far: empty }
    }
}

impl PhotoModel {
    /// Samples the model of `region` in the left image with the hues `hue`. Empty if the region is empty.
    pub fn sample(hue: &HuePlane, region: &RegionMask, config: &PhotoModelConfig) -> Self {
        let mut model = Self::default();
        model.resample(hue, region, config, &mut PhotoModelScratch::default());
        model
    }

    /// Rebuilds the model in its existing memory.
    pub fn resample(
        &mut self,
        hue: &HuePlane,
        region: &RegionMask,
        config: &PhotoModelConfig,
        scratch: &mut PhotoModelScratch,
    ) {
        self.inner.clear();
        self.outer.clear();
        self.inner_sampled = 0;
        let Some(centre_px) = region.centroid_px() else { return };
        self.centre_px = centre_px;
        let inner_grid = Grid::new(centre_px, region.area_px(), config.inner_points, config.spacing_min_px);
        self.inner_sampled = inner_grid.sample(region, |_, _| false, hue, &mut self.inner);
        if config.outer_points == 0 {
            return;
        }
        region.dilate_into(config.band_gap_px, &mut scratch.near);
        region.dilate_into(config.band_gap_px + config.band_width_px, &mut scratch.far);
        let band_area_px = scratch.far.area_px() - scratch.near.area_px();
        let outer_grid = Grid::new(centre_px, band_area_px, config.outer_points, config.spacing_min_px);
        let near = &scratch.near;
        outer_grid.sample(&scratch.far, |u, v| near.contains(u, v), hue, &mut self.outer);
    }

    /// A model from given points, for callers that select the points themselves.
    pub fn from_points(centre_px: Vector2<f64>, inner: Vec<ModelPoint>, outer: Vec<ModelPoint>) -> Self {
        Self { centre_px, inner_sampled: inner.len(), inner, outer }
    }

    /// The points of the model in `side` x `side` blocks of the box around its inner points; without the empty blocks.
    pub fn blocks(&self, side: u32) -> Vec<Self> {
        let extent = |of: fn(&ModelPoint) -> i32| {
            let first = self.inner.iter().map(of).min().unwrap_or_default();
            (first, self.inner.iter().map(of).max().unwrap_or_default() - first + 1)
        };
        let (columns, rows) = (extent(|p| p.u), extent(|p| p.v));
        let side = side as i32;
        let part =
            |value: i32, (first, count): (i32, i32)| ((value - first) * side).div_euclid(count).clamp(0, side - 1);
        let block_of = |point: &ModelPoint| (part(point.v, rows) * side + part(point.u, columns)) as usize;
        let empty = Self::from_points(self.centre_px, Vec::new(), Vec::new());
        let mut blocks = vec![empty; (side * side) as usize];
        self.inner.iter().for_each(|point| blocks[block_of(point)].inner.push(*point));
        self.outer.iter().for_each(|point| blocks[block_of(point)].outer.push(*point));
        blocks.retain(|block| !(block.inner.is_empty() && block.outer.is_empty()));
        blocks
    }

    /// The model's centre: centroid of the region's pixels in the left image.
    pub fn centre_px(&self) -> Vector2<f64> {
        self.centre_px
    }

    /// Points on the target with a hue, row by row.
    pub fn inner(&self) -> &[ModelPoint] {
        &self.inner
    }

    /// Points in the band with a hue, row by row.
    pub fn outer(&self) -> &[ModelPoint] {
        &self.outer
    }

    /// Grid points on the target, with or without hue.
    pub fn inner_sampled(&self) -> usize {
        self.inner_sampled
    }

    /// Share of the target's grid points with a hue, 0 to 1; 0 for an empty model. It is low on grey targets, for which this
    /// method does not work.
    pub fn coloured_share(&self) -> f64 {
        self.inner.len() as f64 / self.inner_sampled.max(1) as f64
    }
}

/// Regular grid through the pixel nearest to the centre.
struct Grid {
    origin: (i32, i32),
    spacing_px: f64,
}

impl Grid {
    /// One point per `area_px / points`, with a spacing of at least `spacing_min_px` and at least one pixel.
    fn new(centre_px: Vector2<f64>, area_px: usize, points: u32, spacing_min_px: u32) -> Self {
        let spacing_px = (area_px as f64 / f64::from(points.max(1))).sqrt().max(f64::from(spacing_min_px.max(1)));
        Self { origin: (centre_px.x.round() as i32, centre_px.y.round() as i32), spacing_px }
    }

    /// Appends the grid points inside `mask` that are not excluded and have a hue; returns the number of grid points with or
    /// without hue.
    fn sample(
        &self,
        mask: &RegionMask,
        excluded: impl Fn(i32, i32) -> bool,
        hue: &HuePlane,
        points: &mut Vec<ModelPoint>,
    ) -> usize {
        let Some(bounds) = mask.bbox() else { return 0 };
        let mut sampled = 0;
        for v in self.lines(self.origin.1, bounds.y, bounds.height) {
            for u in self.lines(self.origin.0, bounds.x, bounds.width) {
                if !mask.contains(u, v) || excluded(u, v) {
                    continue;
                }
                sampled += 1;
                if let Some(hue) = hue.at(u, v) {
                    points.push(ModelPoint { u, v, hue });
                }
            }
        }
        sampled
    }

    /// Grid coordinates that may fall into `first..first + count`.
    fn lines(&self, origin: i32, first: u32, count: u32) -> impl Iterator<Item = i32> + use<> {
        let spacing_px = self.spacing_px;
        let before = (f64::from(first) - f64::from(origin)) / spacing_px;
        let steps = (f64::from(count) / spacing_px) as i32 + 2;
        let start = before.floor() as i32;
        (start..=start + steps).map(move |k| origin + (f64::from(k) * spacing_px).round() as i32)
    }
}

#[cfg(test)]
#[path = "photo_model_tests.rs"]
mod tests;
