//! The refinement of a plane does not allocate after it has processed a region of the same size.
#![allow(clippy::unwrap_used, reason = "inputs that are valid")]

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_estimation_core::row_offset::RowOffset;
use pb3dp_estimation_direct::photometric::{PlaneRefiner, RefineConfig};
use pb3dp_estimation_views::colour_planes::Wanted;
use pb3dp_estimation_views::disparity_plane::{DisparityPlane, DisparityRange};
use pb3dp_estimation_views::front_end::StereoFrontEnd;
use pb3dp_estimation_views::region_pyramid::{PyramidSource, RegionPyramid};

use crate::plane_pair::{Paint, SIZE, Setup, Texture, render};

#[test]
fn a_second_refinement_allocates_nothing() {
    let pair = render(&Setup::default(), &Texture::new(Paint::Crab, 5), &Texture::new(Paint::Sand, 9));
    let front_end = StereoFrontEnd::new(&pair.rig, Kernels::best()).unwrap();
    let g = *front_end.geometry();
    let region = RegionMask::from_fn(SIZE, |x, y| pair.region[(y * SIZE.width + x) as usize]);
    let mut pyramid = RegionPyramid::default();
    let source = PyramidSource {
        left: (&pair.left).into(),
        right: (&pair.right).into(),
        region: &region,
        disparity_px: DisparityRange { lowest: g.disparity_px(0.9).floor(), highest: g.disparity_px(0.35).ceil() },
        rows: RowOffset::default(),
        wanted: Wanted::Colour,
        search_area_px: 6000,
    };
    assert!(pyramid.update(&front_end, &source));
    let q = pair.plane.normal / pair.plane.normal.dot(&pair.plane.point);
    let truth = DisparityPlane::from_inverse_depth_plane(&q, &g, pyramid.centroid_px());
    let start = DisparityPlane { d0_px: truth.d0_px + 0.4, ..truth };
    let mut refiner = PlaneRefiner::new(RefineConfig::default(), Kernels::best());
    let first = refiner.refine(&front_end, &source, &pyramid, &start).unwrap();
    let before = pb3dp_allocation_count::requests();
    let second = refiner.refine(&front_end, &source, &pyramid, &start).unwrap();
    assert_eq!(pb3dp_allocation_count::requests() - before, 0);
    assert_eq!(first, second);
}
