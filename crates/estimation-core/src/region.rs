//! The target region: the pixels of the left image that belong to the target.
//!
//! A region is given as a rectangle, a polygon, a mask or a click, and rasterised to a [`RegionMask`]. Coordinates are pixels
//! of the raw left image; integer coordinates are pixel centres. Unusable regions are rejected with a [`RegionError`].
//! [`Region::inspect`] reports regions that may be unsuitable as [`RegionWarning`]s.

use crate::image_view::ImageView;
use image::GrayImage;
use nalgebra::Vector2;
use pb3dp_geometry::ImageSize;

mod grow;
mod mask;
mod outline;
pub mod polygon;

pub use mask::{Coverage, PixelBox, RegionMask};

/// Vertices and rectangles farther from the origin than this are rejected, pixels.
const COORDINATE_MAX_PX: f64 = 100_000.0;

/// The target region in the left image, as marked by the operator.
#[derive(Clone, Debug, PartialEq)]
pub enum Region {
    /// Columns `x..x + width` and rows `y..y + height`.
    Rectangle {
        /// First column, pixels.
        x: i32,
        /// First row, pixels.
        y: i32,
        /// Number of columns, pixels.
        width: u32,
        /// Number of rows, pixels.
        height: u32,
    },
    /// A closed polygon: all pixels whose centre is inside by the even-odd rule or on the outline.
    Polygon {
        /// Vertices (u, v) in order, clockwise or counter-clockwise, pixels.
        vertices_px: Vec<Vector2<f64>>,
    },
    /// A mask of the same size as the left image: every non-zero pixel is inside.
    Mask(GrayImage),
    /// The connected surface around a pixel. It is grown by hue if the pixel is coloured, by luminance if it is grey, with the
    /// tolerances of [`RegionConfig`]; holes are filled. On a multi-coloured object the region covers one colour only.
    Click {
        /// Column, pixels.
        x: i32,
        /// Row, pixels.
        y: i32,
    },
}

/// Limits and tolerances for regions. The paper states none of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionConfig {
    /// Smallest region that is accepted, pixels inside the image. Default 150.
    pub area_min_px: usize,
    /// Largest hue difference from the seed of a click, degrees. Default 20.
    pub click_hue_tolerance_deg: f64,
    /// Largest luminance difference from the seed of a click on grey, grey levels. Default 20.
    pub click_luminance_tolerance: f64,
    /// A pixel (3x3 mean) is coloured if its largest and smallest channel differ by at least this, grey levels. Default 24.
    pub click_chroma_min: f64,
    /// Largest share of the image that a region grown from a click may cover. Default 0.35.
    pub click_area_share_max: f64,
    /// Warns of a grey region if the share of coloured pixels is below this. Default 0.3.
    pub coloured_share_min: f64,
    /// Warns of a textureless region if the standard deviation of the luminance of its 3x3 means is below this, grey levels.
    /// Default 3.
    pub luminance_deviation_min: f64,
}

impl Default for RegionConfig {
    fn default() -> Self {
        Self {
            area_min_px: 150,
            click_hue_tolerance_deg: 20.0,
            click_luminance_tolerance: 20.0,
            click_chroma_min: 24.0,
            click_area_share_max: 0.35,
            coloured_share_min: 0.3,
            luminance_deviation_min: 3.0,
        }
    }
}

/// Why a region was rejected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegionError {
    /// A polygon with fewer than three vertices.
    #[error("the region polygon has {count} vertices: give at least 3")]
    TooFewVertices {
        /// Number of vertices.
        count: usize,
    },
    /// A vertex is not a number, or far outside any image.
    #[error("vertex {index} of the region polygon is ({x}, {y}): coordinates must be finite and within 100000 px")]
    Vertex {
        /// Index of the vertex, from 0.
        index: usize,
        /// Column.
        x: f64,
        /// Row.
        y: f64,
    },
    /// A rectangle far outside any image.
    #[error("the region rectangle {width} x {height} at ({x}, {y}) is out of range: give pixels of the left image")]
    Rectangle {
        /// First column.
        x: i32,
        /// First row.
        y: i32,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The region is entirely outside the image.
    #[error(
        "the region, columns {} to {} and rows {} to {}, lies outside the left image of {image_width} x {image_height} px: check the coordinates",
        first_px[0], last_px[0], first_px[1], last_px[1]
    )]
    OffImage {
        /// First column and row of the region.
        first_px: [i64; 2],
        /// Last column and row.
        last_px: [i64; 2],
        /// Columns of the image.
        image_width: u32,
        /// Rows of the image.
        image_height: u32,
    },
    /// The region has too few pixels.
    #[error("the region has {area_px} px inside the left image, at least {area_min_px} are needed: mark a larger area")]
    TooSmall {
        /// Pixels inside the image.
        area_px: usize,
        /// The minimum, [`RegionConfig::area_min_px`].
        area_min_px: usize,
    },
    /// The mask and the left image differ in size.
    #[error(
        "the mask has {mask_width} x {mask_height} px but the left image {image_width} x {image_height}: the sizes must be equal"
    )]
    MaskSize {
        /// Columns of the mask.
        mask_width: u32,
        /// Rows of the mask.
        mask_height: u32,
        /// Columns of the image.
        image_width: u32,
        /// Rows of the image.
        image_height: u32,
    },
    /// The clicked pixel is outside the image.
    #[error("the click ({x}, {y}) lies outside the left image of {image_width} x {image_height} px")]
    ClickOffImage {
        /// Column.
        x: i32,
        /// Row.
        y: i32,
        /// Columns of the image.
        image_width: u32,
        /// Rows of the image.
        image_height: u32,
    },
    /// The region grown from a click covers too much of the image.
    #[error(
        "the region grown from the click ({x}, {y}) by {measure} covers {area_px} px, more than {area_max_px}: the click lies on the background, or the background has the target's {measure}; mark a rectangle or polygon instead"
    )]
    ClickGrewTooFar {
        /// Column.
        x: i32,
        /// Row.
        y: i32,
        /// Pixels of the grown region.
        area_px: usize,
        /// Largest accepted number of pixels.
        area_max_px: usize,
        /// The compared property: hue or luminance.
        measure: &'static str,
    },
    /// The region grown from a click is too small.
    #[error(
        "the region grown from the click ({x}, {y}) by {measure} has {area_px} px, at least {area_min_px} are needed: click on a larger patch of one colour, or mark a rectangle or polygon"
    )]
    ClickTooSmall {
        /// Column.
        x: i32,
        /// Row.
        y: i32,
        /// Pixels of the grown region.
        area_px: usize,
        /// The minimum, [`RegionConfig::area_min_px`].
        area_min_px: usize,
        /// The compared property: hue or luminance.
        measure: &'static str,
    },
}

/// Conditions that may make a region unsuitable.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RegionWarning {
    /// Part of the region is outside the image.
    #[error("{outside_px} of the region's {covered_px} px lie outside the left image and are ignored")]
    PartlyOffImage {
        /// Pixels outside the image.
        outside_px: usize,
        /// Total number of pixels.
        covered_px: usize,
    },
    /// Two edges of the polygon cross.
    #[error(
        "edges {first_edge} and {second_edge} of the region polygon cross: areas enclosed twice are excluded (even-odd rule); check the order of the vertices"
    )]
    SelfIntersecting {
        /// Index of the first edge (index of its first vertex).
        first_edge: usize,
        /// Index of the second edge.
        second_edge: usize,
    },
    /// Most pixels are grey, so their hue is unreliable.
    #[error(
        "only {coloured_percent:.0} % of the region's pixels are coloured (limit {limit_percent:.0} %): the hue of grey pixels is unreliable; choose a coloured target"
    )]
    Grey {
        /// Share of coloured pixels, percent.
        coloured_percent: f64,
        /// Limit, percent.
        limit_percent: f64,
    },
    /// The region has no texture; only its outline can be matched.
    #[error(
        "the region's luminance varies by {deviation:.1} grey levels (limit {limit:.1}): it has no texture, only its outline can be matched; include the outline or choose a textured part"
    )]
    Textureless {
        /// Standard deviation of the luminance, grey levels.
        deviation: f64,
        /// Limit, grey levels.
        limit: f64,
    },
}

impl Region {
    /// Rasterises the region: the pixels of `left` that belong to it. Parts outside the image are ignored.
    ///
    /// # Errors
    /// Unusable regions: outside the image, too small, or malformed; see [`RegionError`].
    pub fn rasterize<'a>(
        &self,
        left: impl Into<ImageView<'a>>,
        config: &RegionConfig,
    ) -> Result<RegionMask, RegionError> {
        let mut mask = RegionMask::empty(ImageSize { width: 0, height: 0 });
        self.rasterize_into(left.into(), config, &mut mask)?;
        Ok(mask)
    }

    /// Same as [`Self::rasterize`]; rectangles and polygons reuse the memory of `mask`.
    ///
    /// # Errors
    /// As [`Self::rasterize`]; the contents of the mask are then undefined.
    pub fn rasterize_into(
        &self,
        left: ImageView<'_>,
        config: &RegionConfig,
        mask: &mut RegionMask,
    ) -> Result<(), RegionError> {
        let size = size_of(left);
        mask.reset(size);
        let covered_px = match self {
            Self::Rectangle { x, y, width, height } => rectangle(*x, *y, *width, *height, mask)?,
            Self::Polygon { vertices_px } => polygon_mask(vertices_px, mask)?,
            Self::Mask(image) => {
                let (found, covered_px) = mask_of_image(image, size)?;
                *mask = found;
                covered_px
            }
            Self::Click { x, y } => {
                *mask = click(left, *x, *y, config)?;
                return Ok(());
            }
        };
        let area_px = mask.area_px();
        if area_px == 0 && covered_px > 0 {
            let [first_px, last_px] = self.bounds_px();
            return Err(RegionError::OffImage {
                first_px,
                last_px,
                image_width: size.width,
                image_height: size.height,
            });
        }
        if area_px < config.area_min_px {
            return Err(RegionError::TooSmall { area_px, area_min_px: config.area_min_px });
        }
        Ok(())
    }

    /// First and last column and row of a rectangle or polygon.
    fn bounds_px(&self) -> [[i64; 2]; 2] {
        match self {
            Self::Rectangle { x, y, width, height } => {
                let first = [i64::from(*x), i64::from(*y)];
                [first, [first[0] + i64::from(*width) - 1, first[1] + i64::from(*height) - 1]]
            }
            Self::Polygon { vertices_px } => {
                let of = |axis: usize, pick: fn(f64, f64) -> f64| {
                    vertices_px.iter().map(|vertex| vertex[axis]).reduce(pick).unwrap_or_default().round() as i64
                };
                [[of(0, f64::min), of(1, f64::min)], [of(0, f64::max), of(1, f64::max)]]
            }
            // Their pixels are in the image.
            Self::Mask(_) | Self::Click { .. } => [[0; 2]; 2],
        }
    }

    /// Warnings about the region; `mask` is the result of [`Self::rasterize`] on the same image.
    pub fn inspect<'a>(
        &self,
        left: impl Into<ImageView<'a>>,
        mask: &RegionMask,
        config: &RegionConfig,
    ) -> Vec<RegionWarning> {
        let mut warnings = self.inspect_shape(mask);
        warnings.extend(appearance_warnings(left.into(), mask, config));
        warnings
    }

    /// Same as [`Self::inspect`], for the shape only: for methods that evaluate the texture themselves.
    pub fn inspect_shape(&self, mask: &RegionMask) -> Vec<RegionWarning> {
        let mut warnings = Vec::new();
        let covered_px = match self {
            Self::Rectangle { width, height, .. } => *width as usize * *height as usize,
            Self::Polygon { vertices_px } => polygon::covered_px(vertices_px),
            Self::Mask(_) | Self::Click { .. } => mask.area_px(),
        };
        let outside_px = covered_px.saturating_sub(mask.area_px());
        if outside_px > 0 {
            warnings.push(RegionWarning::PartlyOffImage { outside_px, covered_px });
        }
        if let Self::Polygon { vertices_px } = self
            && let Some((first_edge, second_edge)) = polygon::first_self_intersection(vertices_px)
        {
            warnings.push(RegionWarning::SelfIntersecting { first_edge, second_edge });
        }
        warnings
    }

    /// The region's outline as a polygon, pixels: its own vertices if it has them, otherwise traced around the largest part of
    /// `mask`.
    pub fn outline_px(&self, mask: &RegionMask) -> Vec<Vector2<f64>> {
        match self {
            Self::Polygon { vertices_px } => vertices_px.clone(),
            Self::Rectangle { x, y, width, height } => {
                let (x0, y0) = (f64::from(*x) - 0.5, f64::from(*y) - 0.5);
                let (x1, y1) = (x0 + f64::from(*width), y0 + f64::from(*height));
                vec![Vector2::new(x0, y0), Vector2::new(x1, y0), Vector2::new(x1, y1), Vector2::new(x0, y1)]
            }
            Self::Mask(_) | Self::Click { .. } => mask.outline_px(),
        }
    }
}

fn size_of(image: ImageView<'_>) -> ImageSize {
    ImageSize { width: image.width(), height: image.height() }
}

fn rectangle(x: i32, y: i32, width: u32, height: u32, mask: &mut RegionMask) -> Result<usize, RegionError> {
    let far = |v: i64| v.unsigned_abs() as f64 > COORDINATE_MAX_PX;
    let (right, bottom) = (i64::from(x) + i64::from(width), i64::from(y) + i64::from(height));
    if [i64::from(x), i64::from(y), right, bottom].into_iter().any(far) {
        return Err(RegionError::Rectangle { x, y, width, height });
    }
    for row in i64::from(y)..bottom {
        mask.insert_span(row, i64::from(x), right - 1);
    }
    Ok(width as usize * height as usize)
}

fn polygon_mask(vertices_px: &[Vector2<f64>], mask: &mut RegionMask) -> Result<usize, RegionError> {
    if vertices_px.len() < 3 {
        return Err(RegionError::TooFewVertices { count: vertices_px.len() });
    }
    let out_of_range = |v: &Vector2<f64>| !v.iter().all(|c| c.abs() <= COORDINATE_MAX_PX);
    if let Some(index) = vertices_px.iter().position(out_of_range) {
        return Err(RegionError::Vertex { index, x: vertices_px[index].x, y: vertices_px[index].y });
    }
    Ok(polygon::fill(vertices_px, mask))
}

fn mask_of_image(image: &GrayImage, size: ImageSize) -> Result<(RegionMask, usize), RegionError> {
    if image.width() != size.width || image.height() != size.height {
        return Err(RegionError::MaskSize {
            mask_width: image.width(),
            mask_height: image.height(),
            image_width: size.width,
            image_height: size.height,
        });
    }
    let mask = RegionMask::from_fn(size, |x, y| image.get_pixel(x, y)[0] != 0);
    let covered_px = mask.area_px();
    Ok((mask, covered_px))
}

fn click(left: ImageView<'_>, x: i32, y: i32, config: &RegionConfig) -> Result<RegionMask, RegionError> {
    let size = size_of(left);
    let inside = x >= 0 && y >= 0 && (x as u32) < size.width && (y as u32) < size.height;
    if !inside {
        return Err(RegionError::ClickOffImage { x, y, image_width: size.width, image_height: size.height });
    }
    let (seed, mask) = grow::from_seed(left, x as u32, y as u32, config);
    let measure = match seed {
        grow::Seed::Hue(_) => "hue",
        grow::Seed::Luminance(_) => "luminance",
    };
    let area_px = mask.area_px();
    let area_max_px = (f64::from(size.width) * f64::from(size.height) * config.click_area_share_max) as usize;
    if area_px > area_max_px {
        return Err(RegionError::ClickGrewTooFar { x, y, area_px, area_max_px, measure });
    }
    if area_px < config.area_min_px {
        return Err(RegionError::ClickTooSmall { x, y, area_px, area_min_px: config.area_min_px, measure });
    }
    Ok(mask)
}

fn appearance_warnings(left: ImageView<'_>, mask: &RegionMask, config: &RegionConfig) -> Vec<RegionWarning> {
    let (mut count, mut coloured, mut sum, mut sum_of_squares) = (0_usize, 0_usize, 0.0, 0.0);
    mask.for_each(|x, y| {
        let colour = grow::smooth_colour(left, x, y);
        count += 1;
        coloured += usize::from(colour.chroma >= config.click_chroma_min);
        sum += colour.luminance;
        sum_of_squares += colour.luminance * colour.luminance;
    });
    let mut warnings = Vec::new();
    if count == 0 {
        return warnings;
    }
    let n = count as f64;
    let coloured_share = coloured as f64 / n;
    if coloured_share < config.coloured_share_min {
        warnings.push(RegionWarning::Grey {
            coloured_percent: 100.0 * coloured_share,
            limit_percent: 100.0 * config.coloured_share_min,
        });
    }
    let deviation = (sum_of_squares / n - (sum / n).powi(2)).max(0.0).sqrt();
    if deviation < config.luminance_deviation_min {
        warnings.push(RegionWarning::Textureless { deviation, limit: config.luminance_deviation_min });
    }
    warnings
}

#[cfg(test)]
mod tests;
