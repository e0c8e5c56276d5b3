//! Time to convert the driver's bytes to the pixels that the estimators use, on one core: one image of 640x480, and pairs of which one
//! device delivers both views.
//!
//! `cargo run --release -p pb3dp-benchmarks --example pixel_speed`
//!
//! Prints medians over many images for each format, for `YUYV` also with the scalar code, and for pairs beside a copy of the same bytes,
//! measured in turns. Fails if `YUYV` or a Bayer pair exceeds its limit.

#![allow(clippy::print_stdout, clippy::expect_used, reason = "a console program with its own images")]

use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use pb3dp_camera_pixels::{Converter, Lane, Layout, View, ViewsConverter, YuvKernels, YuvMatrix, YuvRange};
use pb3dp_camera_settings::{Crop, DeviceLayout, ImageLayout, PixelFormat};
use pb3dp_geometry::ImageSize;

/// Size of one view.
const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
const IMAGES: usize = 401;

/// Limit for one `YUYV` image: half a per cent of the frame period.
const YUYV_MILLIS_MAX: f64 = 0.15;

/// Longest time of a Bayer pair, as a multiple of that of a `GREY` pair in the same run: it is 2.6, and 30 if the compiler does not
/// vectorise the code.
const BAYER_TO_GREY_MAX: f64 = 5.0;

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
    println!();
    println!(
        "| format | layout | bytes of a pair | ms per pair | with the copy for a recording | copy of the bytes | ratio |"
    );
    println!("|---|---|---|---|---|---|---|");
    let pairs: Vec<_> = PixelFormat::ALL.into_iter().map(|format| (format, pair_row(format))).collect();
    let grey = pairs.iter().find(|(format, _)| *format == PixelFormat::Grey).map_or(f64::NAN, |(_, millis)| *millis);
    let mut is_slow = exceeds("YUYV", best, YUYV_MILLIS_MAX);
    for (format, millis) in pairs.iter().filter(|(format, _)| matches!(format, PixelFormat::Bayer8(_))) {
        is_slow |= exceeds(&format!("a {format} pair"), *millis, BAYER_TO_GREY_MAX * grey);
    }
    if is_slow { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// Prints a time above its limit.
fn exceeds(what: &str, millis: f64, millis_max: f64) -> bool {
    if millis > millis_max {
        println!("{what} takes {millis:.3} ms; the limit is {millis_max:.3} ms");
    }
    millis > millis_max
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Duration of some work, ms.
fn timed(work: impl FnOnce()) -> f64 {
    let begin = Instant::now();
    work();
    begin.elapsed().as_secs_f64() * 1e3
}

fn layout(format: PixelFormat, size: ImageSize) -> Layout {
    let stride = format.row_bytes(size.width).unwrap_or(0);
    Layout { format, size, stride, matrix: YuvMatrix::Bt601, range: YuvRange::Limited }
}

fn millis(format: PixelFormat, kernels: YuvKernels) -> f64 {
    let bytes = image(format, SIZE);
    let mut converter = Converter::new(layout(format, SIZE)).expect("a valid layout").with_kernels(kernels);
    let mut target = RgbImage::new(SIZE.width, SIZE.height);
    let convert = |_| {
        timed(|| {
            converter.convert(black_box(&bytes), &mut target).expect("a complete image");
            black_box(&target);
        })
    };
    median((0..IMAGES).map(convert).collect())
}

/// One device with both views of this format, beside a copy of its bytes. Returns the time of a conversion, ms.
fn pair_row(format: PixelFormat) -> f64 {
    let arrangement = match format {
        PixelFormat::Y8i => DeviceLayout::Interleaved,
        _ => DeviceLayout::OneImage(ImageLayout::SideBySide),
    };
    let size = arrangement.device_size(SIZE);
    let lanes = if format == PixelFormat::Y8i { [Lane::First, Lane::Second] } else { [Lane::First; 2] };
    let view = |((left, top), lane)| View { part: Crop { left, top, size: SIZE }, lane };
    let views: Vec<View> = arrangement.origins(SIZE).into_iter().zip(lanes).map(view).collect();
    let mut converter = ViewsConverter::new(layout(format, size), &views, None).expect("valid views");
    let bytes = image(format, size);
    let mut pair = [RgbImage::new(SIZE.width, SIZE.height), RgbImage::new(SIZE.width, SIZE.height)];
    let (mut delivered, mut copy) = ([Vec::new(), Vec::new()], vec![0; bytes.len()]);
    let [mut converting, mut recording, mut copying] = [const { Vec::new() }; 3];
    for _ in 0..IMAGES {
        let convert = timed(|| {
            converter.convert(black_box(&bytes), &mut pair.each_mut()).expect("a complete image");
            black_box(&pair);
        });
        let record = timed(|| {
            for (side, delivered) in delivered.iter_mut().enumerate() {
                converter.copy_delivered(side, black_box(&bytes), delivered);
            }
            black_box(&delivered);
        });
        converting.push(convert);
        recording.push(convert + record);
        copying.push(timed(|| {
            copy.copy_from_slice(black_box(&bytes));
            black_box(&copy);
        }));
    }
    let [convert, record, copy] = [converting, recording, copying].map(median);
    println!(
        "| {format} | {arrangement} | {} | {convert:.3} | {record:.3} | {copy:.3} | {:.1} |",
        bytes.len(),
        convert / copy
    );
    convert
}

/// Bytes of an image with texture everywhere.
fn image(format: PixelFormat, size: ImageSize) -> Vec<u8> {
    let value = |k: u32| (k.wrapping_mul(2_654_435_761) >> 26) as u8 + (k / 97) as u8 % 128;
    match format.row_bytes(size.width) {
        Some(row) => (0..(row * format.memory_rows(size.height)) as u32).map(value).collect(),
        None => {
            let scene = RgbImage::from_fn(size.width, size.height, |x, y| {
                image::Rgb([(x / 3) as u8, value(x / 8 + 80 * (y / 8)), (y / 2) as u8])
            });
            let mut bytes = Vec::new();
            JpegEncoder::new_with_quality(&mut bytes, 85).encode_image(&scene).expect("an image");
            bytes
        }
    }
}
