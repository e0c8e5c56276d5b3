//! The region of a request. A mask is refused: a client must not name files of this computer.

use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::ImageSize;
use pb3dp_setup::region_spec::{RegionSpec, load_region};

use crate::refusal::Refusal;

/// Longest text of a region.
const TEXT_MAX: usize = 16 * 1024;
/// Corners of a polygon; drawing by hand gives a few hundred.
const CORNERS_MAX: usize = 500;

/// Reads a region and checks that it is inside images of this size.
///
/// # Errors
/// What is wrong, with the remedy.
pub fn region_in(text: &str, size: ImageSize) -> Result<Region, Refusal> {
    let refused = |why: String| Refusal::Region { why };
    if text.len() > TEXT_MAX {
        return Err(refused(format!("the region has {} characters, limit {TEXT_MAX}; draw fewer corners", text.len())));
    }
    let spec: RegionSpec = text.parse().map_err(refused)?;
    match &spec {
        RegionSpec::Mask(_) => {
            return Err(refused("a mask file cannot be used here; use rect:, poly: or click:".to_owned()));
        }
        RegionSpec::Polygon(corners) if corners.len() > CORNERS_MAX => {
            let count = corners.len();
            return Err(refused(format!("the polygon has {count} corners, limit {CORNERS_MAX}; draw fewer")));
        }
        _ => {}
    }
    spec.check_inside(size).map_err(refused)?;
    load_region(&spec, size).map_err(|error| refused(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_inside_the_image_are_read_and_files_are_not() {
        let size = ImageSize { width: 640, height: 480 };
        assert!(region_in("rect:10,20,30,40", size).is_ok());
        assert!(region_in("click:3.4,4.6", size).is_ok());
        let corners = |count: usize| format!("poly:{}", vec!["1,2"; count].join(";"));
        for (wrong, part) in [
            ("mask:/etc/passwd".to_owned(), "mask file"),
            ("rect:600,20,80,40".to_owned(), "outside"),
            ("rect:1,2,3".to_owned(), "has 3 numbers"),
            (corners(501), "501 corners"),
            (corners(5000), "characters"),
        ] {
            let refusal = region_in(&wrong, size).unwrap_err();
            assert!(refusal.code() == "PB3DP-PAN-032" && refusal.to_string().contains(part), "{refusal}");
        }
    }
}
