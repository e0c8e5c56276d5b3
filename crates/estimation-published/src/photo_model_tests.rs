//! The photo model: number, spacing and hues of its points, and parameters that are refused.

use image::{Rgb, RgbImage};
use pb3dp_geometry::ImageSize;
use proptest::prelude::*;

use super::*;
use crate::hue::HueConfig;

const SIZE: ImageSize = ImageSize { width: 200, height: 160 };

/// The hue increases with the column; grey below row 120.
fn left_image() -> HuePlane {
    let image =
        RgbImage::from_fn(
            SIZE.width,
            SIZE.height,
            |u, v| {
                if v >= 120 { Rgb([90, 90, 90]) } else { Rgb([200, u as u8, 0]) }
            },
        );
    HuePlane::from_rgb(&image, &HueConfig::default())
}

fn disc(u: i32, v: i32, radius: i32) -> RegionMask {
    RegionMask::from_fn(SIZE, |x, y| {
        let (dx, dy) = (x as i32 - u, y as i32 - v);
        dx * dx + dy * dy <= radius * radius
    })
}

/// Distance to the nearest pixel of the mask, by exhaustive search.
fn distance_px(mask: &RegionMask, point: &ModelPoint) -> f64 {
    let mut nearest = f64::INFINITY;
    mask.for_each(|x, y| {
        nearest = nearest.min(f64::from(x as i32 - point.u).hypot(f64::from(y as i32 - point.v)));
    });
    nearest
}

#[test]
fn counts_and_areas_are_those_asked_for() {
    let region = disc(90, 60, 35);
    let config = PhotoModelConfig::default();
    let model = PhotoModel::sample(&left_image(), &region, &config);
    assert!((204..=276).contains(&model.inner().len()), "{} inner points", model.inner().len());
    assert!((64..=96).contains(&model.outer().len()), "{} outer points", model.outer().len());
    assert_eq!(model.inner_sampled(), model.inner().len());
    assert_eq!(model.centre_px(), Vector2::new(90.0, 60.0));
    assert!(model.inner().iter().all(|p| region.contains(p.u, p.v)));
    for point in model.outer() {
        let distance = distance_px(&region, point);
        assert!(distance > 2.0 && distance <= 10.0, "{point:?} is {distance} px outside");
    }
}

#[test]
fn points_carry_the_hue_of_their_pixel_row_by_row() {
    let hue = left_image();
    let model = PhotoModel::sample(&hue, &disc(90, 60, 35), &PhotoModelConfig::default());
    for points in [model.inner(), model.outer()] {
        assert!(points.iter().all(|p| hue.at(p.u, p.v) == Some(p.hue)));
        assert!(points.is_sorted_by_key(|p| (p.v, p.u)));
        assert!(points.windows(2).all(|pair| pair[0] != pair[1]));
    }
}

#[test]
fn grey_points_are_left_out_and_reported() {
    let model = PhotoModel::sample(&left_image(), &disc(90, 120, 30), &PhotoModelConfig::default());
    assert!(model.inner().iter().all(|p| p.v < 120));
    assert!((0.4..0.6).contains(&model.coloured_share()), "{}", model.coloured_share());
    let grey = PhotoModel::sample(&left_image(), &disc(90, 143, 15), &PhotoModelConfig::default());
    assert!(grey.inner().is_empty() && grey.inner_sampled() > 200);
    assert_eq!(grey.coloured_share(), 0.0);
}

#[test]
fn a_tiny_region_gives_one_point_per_pixel() {
    let region = disc(50, 50, 3);
    let model = PhotoModel::sample(&left_image(), &region, &PhotoModelConfig::default());
    assert_eq!(model.inner().len(), region.area_px());
}

#[test]
fn a_spacing_can_be_asked_for_instead_of_a_count() {
    let config =
        PhotoModelConfig { inner_points: 20_000, outer_points: 20_000, spacing_min_px: 7, ..Default::default() };
    let model = PhotoModel::sample(&left_image(), &disc(90, 60, 30), &config);
    for points in [model.inner(), model.outer()] {
        assert!(points.len() > 10);
        assert!(points.iter().all(|p| (p.u - 90) % 7 == 0 && (p.v - 60) % 7 == 0), "{points:?}");
    }
}

#[test]
fn a_band_at_the_border_stays_in_the_image() {
    let model = PhotoModel::sample(&left_image(), &disc(8, 9, 12), &PhotoModelConfig::default());
    assert!(!model.outer().is_empty());
    assert!(model.outer().iter().all(|p| p.u >= 0 && p.v >= 0));
}

#[test]
fn no_region_gives_an_empty_model_and_no_band_no_outer_points() {
    let empty = PhotoModel::sample(&left_image(), &RegionMask::empty(SIZE), &PhotoModelConfig::default());
    assert!(empty.inner().is_empty() && empty.outer().is_empty() && empty.inner_sampled() == 0);
    let config = PhotoModelConfig { outer_points: 0, ..PhotoModelConfig::default() };
    let bare = PhotoModel::sample(&left_image(), &disc(90, 60, 20), &config);
    assert!(bare.outer().is_empty() && !bare.inner().is_empty());
}

#[test]
fn parameters_out_of_range_are_refused() {
    let good = PhotoModelConfig::default();
    assert!(good.validate().is_ok());
    for config in [
        PhotoModelConfig { inner_points: 0, ..good },
        PhotoModelConfig { outer_points: 20_001, ..good },
        PhotoModelConfig { spacing_min_px: 0, ..good },
        PhotoModelConfig { spacing_min_px: 101, ..good },
        PhotoModelConfig { band_gap_px: 201, ..good },
        PhotoModelConfig { band_width_px: 0, ..good },
    ] {
        assert!(config.validate().is_err(), "{config:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn the_grid_is_regular_and_a_remade_model_is_the_same(
        u in 30..170, v in 25..100, radius in 10..30, inner_points in 20u32..400, outer_points in 10u32..150,
    ) {
        let config = PhotoModelConfig { inner_points, outer_points, ..PhotoModelConfig::default() };
        let (hue, region) = (left_image(), disc(u, v, radius));
        let fresh = PhotoModel::sample(&hue, &region, &config);
        let mut reused = PhotoModel::sample(&hue, &disc(60, 60, 33), &PhotoModelConfig::default());
        reused.resample(&hue, &region, &config, &mut PhotoModelScratch::default());
        prop_assert_eq!(&fresh, &reused);
        // Rows are equidistant up to rounding to pixels.
        let mut rows: Vec<i32> = fresh.inner().iter().map(|p| p.v).collect();
        rows.dedup();
        let gaps: Vec<i32> = rows.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let (least, most) = (gaps.iter().min().copied().unwrap_or(1), gaps.iter().max().copied().unwrap_or(1));
        prop_assert!(most - least <= 1, "row gaps {gaps:?}");
    }
}
