//! Time to convert a 640x480 image from the driver's bytes to the pixels that the estimators use, on one core.
//!
//! `cargo run --release -p pb3dp-benchmarks --example pixel_speed`
//!
//! Prints the median over many images for each format, for `YUYV` also with the scalar code. Fails if `YUYV` exceeds
//! the limit.

#![allow(clippy::print_stdout, clippy::expect_used, reason = "a console program with its own images")]

use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use pb3dp_camera_pixels::{Converter, Layout, YuvKernels, YuvMatrix, YuvRange};
use pb3dp_camera_settings::PixelFormat;
use pb3dp_geometry::ImageSize;

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
const IMAGES: usize = 401;

/// Limit for one `YUYV` image: half a per cent of the frame period.
const YUYV_MILLIS_MAX: f64 = 0.15;

fn main() -> ExitCode {
    println!("| format | kernels | ms per image of 640x480 (median of {IMAGES}) |");
    println!("|---|---|---|");
    for format in PixelFormat::ALL.into_iter().filter(|format| *format != PixelFormat::Yuyv) {
        println!("| {format} | | {:.3} |", millis(format, YuvKernels::best()));
    }
    let scalar = millis(PixelFormat::Yuyv, YuvKernels::SCALAR);
    let best = millis(PixelFormat::Yuyv, YuvKernels::best());
    println!("| YUYV | scalar | {scalar:.3} |");
    println!("| YUYV | {} | {best:.3} |", YuvKernels::best().name());
    println!("YUYV: vector code is {:.1} times as fast as scalar code", scalar / best);
    if best > YUYV_MILLIS_MAX {
        println!("YUYV is slower than the limit of {YUYV_MILLIS_MAX} ms");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}

fn millis(format: PixelFormat, kernels: YuvKernels) -> f64 {
    let bytes = image(format);
    let stride = format.row_bytes(SIZE.width).unwrap_or(0);
    let layout = Layout { format, size: SIZE, stride, matrix: YuvMatrix::Bt601, range: YuvRange::Limited };
    let mut converter = Converter::new(layout).expect("a valid layout").with_kernels(kernels);
    let mut target = RgbImage::new(SIZE.width, SIZE.height);
    let mut times: Vec<f64> = (0..IMAGES)
        .map(|_| {
            let begin = Instant::now();
            converter.convert(black_box(&bytes), &mut target).expect("a complete image");
            black_box(&target);
            begin.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[IMAGES / 2]
}

/// Bytes of an image with texture everywhere.
fn image(format: PixelFormat) -> Vec<u8> {
    let value = |k: u32| (k.wrapping_mul(2_654_435_761) >> 26) as u8 + (k / 97) as u8 % 128;
    match format.row_bytes(SIZE.width) {
        Some(row) => (0..row as u32 * SIZE.height).map(value).collect(),
        None => {
            let scene = RgbImage::from_fn(SIZE.width, SIZE.height, |x, y| {
                image::Rgb([(x / 3) as u8, value(x / 8 + 80 * (y / 8)), (y / 2) as u8])
            });
            let mut bytes = Vec::new();
            JpegEncoder::new_with_quality(&mut bytes, 85).encode_image(&scene).expect("an image");
            bytes
        }
    }
}
