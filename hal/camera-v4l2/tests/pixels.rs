//! Pixels of every format, against images that were made by other means.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use image::RgbImage;
use pb3dp_camera_settings::{BayerOrder, PixelFormat};
use pb3dp_camera_v4l2::pixels::{Converter, Layout, PixelError, YuvKernels, YuvMatrix, YuvRange};
use pb3dp_geometry::ImageSize;
use proptest::prelude::*;

fn layout(format: PixelFormat, (width, height): (u32, u32), stride: usize) -> Layout {
    let (matrix, range) = (YuvMatrix::Bt601, YuvRange::Limited);
    Layout { format, size: ImageSize { width, height }, stride, matrix, range }
}

fn converted(layout: Layout, bytes: &[u8]) -> RgbImage {
    let mut image = RgbImage::new(layout.size.width, layout.size.height);
    Converter::new(layout).unwrap().convert(bytes, &mut image).unwrap();
    image
}

/// A colourful image without symmetries.
fn scene(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| image::Rgb([(3 * x + y) as u8, (x + 5 * y) as u8, (90 + 2 * x - y) as u8]))
}

/// The image's bytes, with rows `stride` apart and 0xEE between them; the last row has no padding.
fn padded(rows: impl Iterator<Item = Vec<u8>>, stride: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    for row in rows {
        bytes.resize(bytes.len().div_ceil(stride) * stride, 0xEE);
        bytes.extend(row);
    }
    bytes
}

#[test]
fn formats_are_named_by_their_four_letters() {
    for format in PixelFormat::ALL {
        assert_eq!(format.to_string().parse(), Ok(format));
    }
    for bad in ["", "H264", "yuyv", "MJPEG"] {
        let refusal = bad.parse::<PixelFormat>().unwrap_err().to_string();
        assert!(
            refusal.starts_with(&format!("{bad:?} is no layout")) && refusal.contains("write one of: YUYV, RGB3"),
            "{refusal}"
        );
    }
}

#[test]
fn rows_of_plain_formats_keep_their_colours_and_padding_is_left_out() {
    let scene = scene(7, 5);
    let rows = |of_pixel: fn(&[u8]) -> Vec<u8>| {
        scene.chunks_exact(21).map(move |row| row.chunks_exact(3).flat_map(of_pixel).collect::<Vec<u8>>())
    };
    let rgb = padded(rows(|p| p.to_vec()), 32);
    assert_eq!(converted(layout(PixelFormat::Rgb24, (7, 5), 32), &rgb), scene);
    let bgr = padded(rows(|p| vec![p[2], p[1], p[0]]), 24);
    assert_eq!(converted(layout(PixelFormat::Bgr24, (7, 5), 24), &bgr), scene);
    let grey = padded(rows(|p| vec![p[1]]), 16);
    let found = converted(layout(PixelFormat::Grey, (7, 5), 16), &grey);
    assert!(found.pixels().zip(scene.pixels()).all(|(found, scene)| found.0 == [scene.0[1]; 3]));
}

#[test]
fn yuyv_honours_the_stride_and_an_odd_width() {
    // 5 pixels in 12 bytes, 20 bytes apart; each row of its own brightness, without colour.
    let bytes = padded((0..4).map(|row| [40 * row + 20, 128].repeat(6)), 20);
    let layout = Layout { range: YuvRange::Full, ..layout(PixelFormat::Yuyv, (5, 4), 20) };
    assert_eq!(layout.bytes_min(), 72);
    let found = converted(layout, &bytes);
    assert!(found.enumerate_pixels().all(|(_, y, pixel)| pixel.0 == [40 * y as u8 + 20; 3]), "{found:?}");
    if YuvKernels::best() == YuvKernels::SCALAR {
        let reason = "this processor has neither AVX2 nor NEON: nothing to compare with the portable code";
        pb3dp_test_support::not_checked("pixels::yuyv_honours_the_stride_and_an_odd_width", reason);
    }
    let mut scalar = RgbImage::new(5, 4);
    Converter::new(layout).unwrap().with_kernels(YuvKernels::SCALAR).convert(&bytes, &mut scalar).unwrap();
    assert_eq!(found, scalar);
}

/// What a sensor with that pattern sees.
fn mosaic(scene: &RgbImage, order: BayerOrder) -> Vec<u8> {
    let channels = match order {
        BayerOrder::Rggb => [[0, 1], [1, 2]],
        BayerOrder::Grbg => [[1, 0], [2, 1]],
        BayerOrder::Gbrg => [[1, 2], [0, 1]],
        BayerOrder::Bggr => [[2, 1], [1, 0]],
    };
    scene.enumerate_pixels().map(|(x, y, pixel)| pixel.0[channels[y as usize % 2][x as usize % 2]]).collect()
}

const ORDERS: [BayerOrder; 4] = [BayerOrder::Rggb, BayerOrder::Grbg, BayerOrder::Gbrg, BayerOrder::Bggr];

#[test]
fn bayer_images_of_linear_colours_come_out_as_they_were() {
    // The mean of neighbours is exact where colours change linearly; at the rim it is not, since they are mirrored there.
    for (width, height) in [(8, 6), (9, 7)] {
        let pixel =
            |x: u32, y: u32| image::Rgb([(10 + 4 * x + 2 * y) as u8, (200 - 2 * x - 4 * y) as u8, (60 + 6 * y) as u8]);
        let scene = RgbImage::from_fn(width, height, pixel);
        for order in ORDERS {
            let bytes = mosaic(&scene, order);
            let found = converted(layout(PixelFormat::Bayer8(order), (width, height), width as usize), &bytes);
            for (x, y, pixel) in found.enumerate_pixels() {
                let at_rim = x == 0 || y == 0 || x == width - 1 || y == height - 1;
                assert!(at_rim || *pixel == scene[(x, y)], "{order:?} at {x}, {y}: {pixel:?}, not {:?}", scene[(x, y)]);
            }
        }
    }
}

#[test]
fn bayer_images_of_one_colour_come_out_as_they_were_to_the_rim() {
    for size in [(2, 2), (3, 2), (2, 5), (7, 4)] {
        let scene = RgbImage::from_pixel(size.0, size.1, image::Rgb([200, 90, 30]));
        for order in ORDERS {
            let bytes = mosaic(&scene, order);
            let found = converted(layout(PixelFormat::Bayer8(order), size, size.0 as usize), &bytes);
            assert_eq!(found, scene, "{order:?} {size:?}");
        }
    }
}

#[test]
fn what_can_not_be_an_image_is_refused_with_its_numbers() {
    let mut image = RgbImage::new(1, 1);
    let error = Converter::new(layout(PixelFormat::Yuyv, (640, 480), 1279)).unwrap_err();
    assert!(matches!(error, PixelError::Stride { row: 1280, stride: 1279, .. }), "{error}");
    let error = Converter::new(layout(PixelFormat::Bayer8(BayerOrder::Rggb), (1, 480), 1)).unwrap_err();
    assert!(matches!(error, PixelError::BayerSize { width: 1, .. }), "{error}");
    let mut converter = Converter::new(layout(PixelFormat::Yuyv, (640, 480), 1280)).unwrap();
    let error = converter.convert(&vec![0; 614_399], &mut image).unwrap_err();
    let expected = "614399 bytes are too few: YUYV of 640x480 pixels has 614400 or more";
    assert_eq!(error.to_string(), expected);
}

#[test]
fn buffers_are_used_again_and_nothing_is_taken_from_the_heap() {
    for format in PixelFormat::ALL.into_iter().filter(|format| *format != PixelFormat::Mjpg) {
        let stride = format.row_bytes(64).unwrap();
        let mut converter = Converter::new(layout(format, (64, 48), stride)).unwrap();
        let (bytes, mut image) = (vec![77; stride * 48], RgbImage::new(64, 48));
        let before = pb3dp_allocation_count::requests();
        for _ in 0..3 {
            converter.convert(&bytes, &mut image).unwrap();
        }
        assert_eq!(pb3dp_allocation_count::requests(), before, "{format}");
        let mut foreign = RgbImage::new(3, 3);
        converter.convert(&bytes, &mut foreign).unwrap();
        assert_eq!(foreign, image, "{format}");
    }
}

#[test]
fn names_lead_back_to_their_formats() {
    for format in PixelFormat::ALL {
        assert_eq!(PixelFormat::of_fourcc(format.fourcc()), Some(format));
    }
    assert_eq!(PixelFormat::of_fourcc(*b"H264"), None);
}

proptest! {
    /// Whatever a driver delivers: an image or an error.
    #[test]
    fn random_bytes_never_do_harm(
        which in 0_usize..9, width in 0_u32..20, height in 0_u32..9, padding in 0_usize..5,
        bytes in prop::collection::vec(any::<u8>(), 0..600),
    ) {
        let format = PixelFormat::ALL[which];
        let stride = format.row_bytes(width).unwrap_or(0) + padding;
        if let Ok(mut converter) = Converter::new(layout(format, (width, height), stride)) {
            let mut image = RgbImage::new(width, height);
            let is_enough = bytes.len() >= converter.layout().bytes_min();
            let result = converter.convert(&bytes, &mut image);
            prop_assert!(result.is_ok() == is_enough || format == PixelFormat::Mjpg, "{result:?}");
        }
    }
}
