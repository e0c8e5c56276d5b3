//! Parameters of the refinement.

/// Parameters of the refinement.
///
/// Points, iterations and jump are those of the prototype of ADR 7, and so is the erosion of 6 px: if a camera was out of focus,
/// its errors were a fourth to a sixth of those with 2 px. Chosen with figures on 849 real windows and cases: of these 720 pass with
/// a place of 0.05 px and a border of 2 px, 746 with 0.13 and 1 px, and 2 more changes (docs/benchmarks/left_out.md). The other
/// defaults are chosen by hand, not varied.
#[derive(Clone, Debug, PartialEq)]
pub struct RefineConfig {
    /// Largest number of levels used, starting with the finest.
    pub levels_max: usize,
    /// The finest level is the first on which the region has at most this many pixels.
    pub area_max_px: usize,
    /// Largest number of points per level; those with the strongest gradients are used.
    pub points_max: usize,
    /// Largest number of steps on the finest level.
    pub iterations_max: usize,
    /// A plane that moves by more than this at the region's centroid has not converged, pixels.
    pub jump_max_px: f64,
    /// Width of the region's border that is always excluded, pixels; at most half of the share below.
    pub erosion_min_px: f64,
    /// Width of the border that is excluded if it agrees worse than the interior, pixels.
    pub erosion_max_px: f64,
    /// Largest excluded width at each side, as a share of the square root of the region's area.
    pub erosion_share_max: f64,
    /// Standard deviation of the smoothing, pixels of a level.
    pub smoothing_px: f64,
    /// Standard deviation of the sampling position of a pixel, pixels: gradient times this counts as noise.
    pub place_sigma_px: f64,
    /// Standard deviation of the row offset that remains after the pair's known offset, pixels; 0 keeps the rows fixed.
    pub row_sigma_px: f64,
    /// Standard deviation of the calibration's disparity error at the centroid and, as a slope, over half the region's side, pixels.
    pub calibration_sigma_px: f64,
    /// Standard deviation of the difference of both images' blur variances at an edge, squared pixels. Keeps blur from passing as a slope.
    pub blur_sigma_px2: f64,
}

impl Default for RefineConfig {
    fn default() -> Self {
        Self {
            levels_max: 2,
            area_max_px: 24_000,
            points_max: 5000,
            iterations_max: 8,
            jump_max_px: 1.5,
            erosion_min_px: 1.0,
            erosion_max_px: 6.0,
            erosion_share_max: 0.06,
            smoothing_px: 0.5,
            place_sigma_px: 0.13,
            row_sigma_px: 0.3,
            calibration_sigma_px: 0.002,
            blur_sigma_px2: 0.0,
        }
    }
}
