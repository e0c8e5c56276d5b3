//! The target region: its pixels by rectangle, mask and click, and what is refused or warned of.

use image::{Rgb, RgbImage};

use super::*;

const CONFIG: RegionConfig = RegionConfig {
    area_min_px: 150,
    click_hue_tolerance_deg: 20.0,
    click_luminance_tolerance: 20.0,
    click_chroma_min: 24.0,
    click_area_share_max: 0.35,
    coloured_share_min: 0.3,
    luminance_deviation_min: 3.0,
};

/// A red disc (hue about 0, with dark red spots) of radius 20 at (60, 40) on a grey ramp.
fn scene() -> RgbImage {
    RgbImage::from_fn(160, 90, |x, y| {
        let (dx, dy) = (f64::from(x) - 60.0, f64::from(y) - 40.0);
        let spot = (x / 5 + y / 7) % 5 == 0;
        if dx.hypot(dy) <= 20.0 {
            let red = if spot { 90 } else { 210 };
            Rgb([red, red / 6, red / 5])
        } else {
            let level = 40 + x as u8;
            Rgb([level, level, level + 4])
        }
    })
}

fn polygon_of(points: &[(f64, f64)]) -> Region {
    Region::Polygon { vertices_px: points.iter().map(|p| Vector2::new(p.0, p.1)).collect() }
}

#[track_caller]
fn refused(region: &Region, expected: &RegionError) {
    assert_eq!(region.rasterize(&scene(), &CONFIG).as_ref(), Err(expected));
}

#[test]
fn defaults_are_the_documented_ones() {
    assert_eq!(RegionConfig::default(), CONFIG);
}

#[test]
fn a_rectangle_covers_its_pixels_and_tells_what_is_off_the_image() {
    let region = Region::Rectangle { x: -4, y: 80, width: 30, height: 20 };
    let mask = region.rasterize(&scene(), &CONFIG).expect("large enough");
    assert_eq!(mask.area_px(), 26 * 10);
    assert_eq!(mask.bbox(), Some(PixelBox { x: 0, y: 80, width: 26, height: 10 }));
    let warnings = region.inspect(&scene(), &mask, &CONFIG);
    assert!(warnings.contains(&RegionWarning::PartlyOffImage { outside_px: 600 - 260, covered_px: 600 }));
    assert!(
        warnings.iter().any(|w| matches!(w, RegionWarning::Grey { coloured_percent, .. } if *coloured_percent < 1.0))
    );
}

#[test]
fn regions_that_can_not_serve_are_refused_with_their_numbers() {
    refused(
        &Region::Rectangle { x: 200, y: 3, width: 40, height: 40 },
        &RegionError::OffImage { first_px: [200, 3], last_px: [239, 42], image_width: 160, image_height: 90 },
    );
    refused(
        &Region::Rectangle { x: 2_000_000_000, y: 0, width: 4_000_000_000, height: 4_000_000_000 },
        &RegionError::Rectangle { x: 2_000_000_000, y: 0, width: 4_000_000_000, height: 4_000_000_000 },
    );
    refused(
        &Region::Rectangle { x: 10, y: 10, width: 12, height: 12 },
        &RegionError::TooSmall { area_px: 144, area_min_px: 150 },
    );
    refused(
        &Region::Rectangle { x: 1, y: 1, width: 0, height: 9 },
        &RegionError::TooSmall { area_px: 0, area_min_px: 150 },
    );
    refused(&polygon_of(&[(1.0, 1.0), (50.0, 50.0)]), &RegionError::TooFewVertices { count: 2 });
    refused(&polygon_of(&[(1.0, 1.0), (50.0, 50.0), (1e9, 3.0)]), &RegionError::Vertex { index: 2, x: 1e9, y: 3.0 });
    let nan = polygon_of(&[(1.0, f64::NAN), (50.0, 50.0), (3.0, 60.0)]).rasterize(&scene(), &CONFIG);
    assert!(matches!(nan, Err(RegionError::Vertex { index: 0, .. })));
    refused(
        &Region::Mask(GrayImage::new(159, 90)),
        &RegionError::MaskSize { mask_width: 159, mask_height: 90, image_width: 160, image_height: 90 },
    );
    refused(&Region::Mask(GrayImage::new(160, 90)), &RegionError::TooSmall { area_px: 0, area_min_px: 150 });
    refused(
        &Region::Click { x: 160, y: 0 },
        &RegionError::ClickOffImage { x: 160, y: 0, image_width: 160, image_height: 90 },
    );
}

#[test]
fn a_mask_image_is_taken_where_it_is_not_zero() {
    let image = GrayImage::from_fn(160, 90, |x, y| image::Luma([u8::from(x > 100 && y < 30)]));
    let mask = Region::Mask(image).rasterize(&scene(), &CONFIG).expect("large enough");
    assert_eq!(mask.area_px(), 59 * 30);
    assert!(mask.contains(101, 29) && !mask.contains(100, 29) && !mask.contains(101, 30));
}

#[test]
fn a_click_takes_the_coloured_object_across_its_dark_spots() {
    let mask = Region::Click { x: 66, y: 49 }.rasterize(&scene(), &CONFIG).expect("a red disc");
    let disc = RegionMask::from_fn(mask.size(), |x, y| (f64::from(x) - 60.0).hypot(f64::from(y) - 40.0) <= 20.0);
    let mut differing = 0;
    for y in 0..90 {
        for x in 0..160 {
            differing += usize::from(mask.contains(x, y) != disc.contains(x, y));
        }
    }
    assert!(differing < disc.area_px() / 8, "{differing} of {} px differ", disc.area_px());
    assert!(mask.contains(60, 40) && !mask.contains(60, 64));
}

#[test]
fn a_click_on_grey_grows_by_luminance() {
    let mask = Region::Click { x: 120, y: 40 }.rasterize(&scene(), &CONFIG).expect("a band of the ramp");
    // The ramp has one level per column, so 20 levels are 20 columns to either side.
    assert_eq!(mask.bbox(), Some(PixelBox { x: 100, y: 0, width: 41, height: 90 }));
}

#[test]
fn a_click_on_a_large_background_is_refused() {
    let flat = RgbImage::from_fn(160, 90, |x, y| {
        let target = (40..60).contains(&x) && (40..60).contains(&y);
        if target { Rgb([200, 40, 40]) } else { Rgb([60, 110, 190]) }
    });
    let error = Region::Click { x: 5, y: 5 }.rasterize(&flat, &CONFIG).expect_err("background");
    assert!(matches!(error, RegionError::ClickGrewTooFar { area_px, measure: "hue", .. } if area_px > 13_000));
    let speck = RgbImage::from_fn(160, 90, |x, _| if x % 2 == 0 { Rgb([200, 40, 40]) } else { Rgb([40, 40, 200]) });
    let small = RegionConfig { click_hue_tolerance_deg: 2.0, ..CONFIG };
    let error = Region::Click { x: 80, y: 5 }.rasterize(&speck, &small).expect_err("one column");
    assert!(matches!(error, RegionError::ClickTooSmall { .. }), "{error}");
}

#[test]
fn crossing_edges_and_missing_texture_are_warned_of() {
    let bow = polygon_of(&[(100.0, 10.0), (150.0, 60.0), (150.0, 10.0), (100.0, 60.0)]);
    let flat = RgbImage::from_pixel(160, 90, Rgb([30, 160, 40]));
    let mask = bow.rasterize(&flat, &CONFIG).expect("large enough");
    let warnings = bow.inspect(&flat, &mask, &CONFIG);
    assert_eq!(warnings[0], RegionWarning::SelfIntersecting { first_edge: 0, second_edge: 2 });
    assert_eq!(warnings[1], RegionWarning::Textureless { deviation: 0.0, limit: 3.0 });
    assert_eq!(warnings.len(), 2);
}
