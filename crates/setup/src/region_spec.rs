//! Notation of a region on the command line.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result, bail};
use image::GrayImage;
use nalgebra::Vector2;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::ImageSize;
use pb3dp_record::images::{check_header, load_rgb};

/// A region as the user typed it; files are not opened yet.
#[derive(Clone, Debug, PartialEq)]
pub enum RegionSpec {
    /// `rect:x,y,width,height` in pixels.
    Rectangle([f64; 4]),
    /// `poly:x1,y1;x2,y2;...` in pixels.
    Polygon(Vec<[f64; 2]>),
    /// `mask:FILE`, an image of the size of the left image; pixels that are not black are inside.
    Mask(PathBuf),
    /// `click:x,y`: grown from this pixel.
    Click([f64; 2]),
}

/// The notations of a region, for errors and `--help`.
pub const REGION_HELP: &str = "rect:X,Y,WIDTH,HEIGHT | poly:X1,Y1;X2,Y2;X3,Y3... | mask:FILE | click:X,Y (pixels in the left image; quote what has a `;`)";

impl FromStr for RegionSpec {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let (kind, rest) =
            text.split_once(':').ok_or_else(|| format!("region {text:?} has no kind; write one of: {REGION_HELP}"))?;
        match kind {
            "rect" => Ok(Self::Rectangle(numbers("x,y,width,height", text, rest)?)),
            "click" => Ok(Self::Click(numbers("x,y", text, rest)?)),
            "poly" => {
                let vertices = rest
                    .split(';')
                    .filter(|p| !p.trim().is_empty())
                    .map(|p| numbers("x,y of one corner, with `;` between corners", text, p))
                    .collect::<std::result::Result<Vec<_>, _>>()?;
                if vertices.len() < 3 {
                    return Err(format!(
                        "region {text:?} has {} vertices; a polygon needs at least 3 (a shell ends commands at `;`: quote the region)",
                        vertices.len()
                    ));
                }
                Ok(Self::Polygon(vertices))
            }
            "mask" if !rest.is_empty() => Ok(Self::Mask(PathBuf::from(rest))),
            _ => Err(format!("region {text:?} is not understood; write one of: {REGION_HELP}")),
        }
    }
}

impl std::fmt::Display for RegionSpec {
    /// The notation of the command line.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Rectangle([x, y, width, height]) => write!(f, "rect:{x},{y},{width},{height}"),
            Self::Polygon(corners) => {
                let corners: Vec<String> = corners.iter().map(|[x, y]| format!("{x},{y}")).collect();
                write!(f, "poly:{}", corners.join(";"))
            }
            Self::Mask(file) => write!(f, "mask:{}", file.display()),
            Self::Click([x, y]) => write!(f, "click:{x},{y}"),
        }
    }
}

/// Exactly `N` finite numbers with commas between them; `names` tells them apart in the error.
fn numbers<const N: usize>(names: &str, whole: &str, text: &str) -> std::result::Result<[f64; N], String> {
    let values = text
        .split(',')
        .map(|part| match part.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("region {whole:?}: {part:?} is not a number")),
        })
        .collect::<std::result::Result<Vec<f64>, _>>()?;
    let count = values.len();
    values.try_into().map_err(|_| format!("region {whole:?}: {text:?} has {count} numbers, expected {N}: {names}"))
}

impl RegionSpec {
    /// Refuses a region outside images of this size, or without area; masks are checked when they are read.
    ///
    /// # Errors
    /// The reason, as text.
    pub fn check_inside(&self, images: ImageSize) -> std::result::Result<(), String> {
        let corners = match self {
            Self::Mask(_) => return Ok(()),
            Self::Click(place) => vec![*place],
            Self::Polygon(corners) => corners.clone(),
            Self::Rectangle([x, y, width, height]) => {
                if *width <= 0.0 || *height <= 0.0 {
                    return Err(format!("width {width} and height {height} of a rectangle must be positive"));
                }
                vec![[*x, *y], [x + width, *y], [x + width, y + height], [*x, y + height]]
            }
        };
        let is_inside = |&&[u, v]: &&[f64; 2]| {
            (-0.5..=f64::from(images.width) - 0.5).contains(&u) && (-0.5..=f64::from(images.height) - 0.5).contains(&v)
        };
        match corners.iter().find(|corner| !is_inside(corner)) {
            None => Ok(()),
            Some([u, v]) => Err(format!(
                "the corner {u},{v} is outside of the left image, which has {}x{} pixels",
                images.width, images.height
            )),
        }
    }
}

/// The region that the command line or a configuration names, in images of this size.
///
/// # Errors
/// A mask that cannot be read, has another size or marks everything, or a rectangle without area.
pub fn load_region(spec: &RegionSpec, images: ImageSize) -> Result<Region> {
    Ok(match spec {
        RegionSpec::Rectangle([x, y, width, height]) => {
            let corners = [[*x, *y], [x + width, *y], [x + width, y + height], [*x, y + height]];
            if *width <= 0.0 || *height <= 0.0 {
                bail!("--region rect: width {width} and height {height} must be positive");
            }
            match corners[0].iter().chain([width, height]).all(|value| value.fract() == 0.0 && value.abs() < 1e6) {
                true => Region::Rectangle { x: *x as i32, y: *y as i32, width: *width as u32, height: *height as u32 },
                false => Region::Polygon { vertices_px: corners.map(|[u, v]| Vector2::new(u, v)).to_vec() },
            }
        }
        RegionSpec::Polygon(vertices) => {
            Region::Polygon { vertices_px: vertices.iter().map(|&[u, v]| Vector2::new(u, v)).collect() }
        }
        RegionSpec::Mask(file) => region_of_mask(&file.display().to_string(), load_mask(file, images)?)?,
        RegionSpec::Click([x, y]) => Region::Click { x: x.round() as i32, y: y.round() as i32 },
    })
}

/// The region of a mask; `name` stands for it in messages.
///
/// # Errors
/// A mask that marks everything.
pub fn region_of_mask(name: &str, mask: GrayImage) -> Result<Region> {
    if mask.pixels().all(|pixel| pixel.0[0] > 0) {
        bail!("{name}: the mask has no black pixel, so everything would be the object: is it a mask?");
    }
    Ok(Region::Mask(mask))
}

fn load_mask(file: &Path, images: ImageSize) -> Result<GrayImage> {
    let checked = check_header(file, images, "the left image").and_then(|()| load_rgb(file));
    let image = checked.context("the mask of --region cannot be used")?;
    let any = |pixel: &image::Rgb<u8>| image::Luma([pixel.0.iter().copied().max().unwrap_or(0)]);
    Ok(GrayImage::from_fn(image.width(), image.height(), |x, y| any(image.get_pixel(x, y))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_is_read() {
        assert_eq!("rect:10,20,30.5,40".parse(), Ok(RegionSpec::Rectangle([10.0, 20.0, 30.5, 40.0])));
        assert_eq!("click:3, 4".parse(), Ok(RegionSpec::Click([3.0, 4.0])));
        assert_eq!("poly:0,0;5,0;5,7".parse(), Ok(RegionSpec::Polygon(vec![[0.0, 0.0], [5.0, 0.0], [5.0, 7.0]])));
        assert_eq!("mask:a:b.png".parse(), Ok(RegionSpec::Mask(PathBuf::from("a:b.png"))));
    }

    #[test]
    fn what_is_outside_of_the_image_is_refused_with_its_corner() {
        let size = ImageSize { width: 640, height: 480 };
        let refusal = |text: &str| text.parse::<RegionSpec>().unwrap().check_inside(size);
        for inside in ["rect:0,0,639.5,479.5", "click:639,0", "poly:0,0;600,0;600,479", "mask:there.png"] {
            assert_eq!(refusal(inside), Ok(()), "{inside}");
        }
        for (outside, part) in [
            ("rect:600,400,100,50", "700,400"),
            ("rect:-3,0,100,50", "-3,0"),
            ("click:640,0", "640,0"),
            ("poly:0,0;600,0;600,480", "600,480"),
            ("rect:10,10,0,5", "must be positive"),
        ] {
            assert!(refusal(outside).unwrap_err().contains(part), "{outside}: {:?}", refusal(outside));
        }
    }

    #[test]
    fn refusals_name_the_text() {
        for (text, part) in [
            ("10,20,30,40", "no kind"),
            ("rect:1,2,3", "has 3 numbers, expected 4: x,y,width,height"),
            ("rect:1,2,3,NaN", "\"NaN\" is not a number"),
            ("poly:1,2;3,4", "at least 3"),
            ("poly:1,2,3,4,5,6", "expected 2: x,y of one corner, with `;` between corners"),
            ("circle:1,2,3", "not understood"),
            ("mask:", "not understood"),
        ] {
            let error = text.parse::<RegionSpec>().unwrap_err();
            assert!(error.contains(part) && error.contains(text), "{error}");
        }
    }
}
