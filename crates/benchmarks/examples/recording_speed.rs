//! Stereo pairs of 640x480 that one thread compresses and writes per second, in each format and into one MCAP file: the recording rate.
//!
//! `cargo run --release -p pb3dp-benchmarks --example recording_speed` uses a real pair of `tests/data` and writes to
//! the folder for temporary files.

#![allow(clippy::print_stdout, reason = "a program for the console")]

use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

use image::RgbImage;
use pb3dp_bag::cdr::Bytes;
use pb3dp_bag::messages::{Header, Image};
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_geometry::MonotonicTime;
use pb3dp_record::dataset::{FrameFiles, load_case};
use pb3dp_record::images::StoredFormat;

/// Duration and number of measurements per format; the best one counts, because other programs only slow it down.
const WHILE: Duration = Duration::from_millis(500);
const TIMES: usize = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let case = load_case(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases/bb201_c0"))?;
    let images = case.load_images()?;
    let folder = std::env::temp_dir().join(format!("pb3dp-recording-speed-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    println!("| format | pairs per second and thread | kB per pair |\n|---|---|---|");
    for (name, format) in [
        ("PNG (as `record` writes it)", StoredFormat::Png),
        ("PNG (as small as it gets)", StoredFormat::Png),
        ("JPEG 95", StoredFormat::Jpeg { quality: 95 }),
        ("JPEG 90", StoredFormat::Jpeg { quality: 90 }),
    ] {
        let place = |side: &str| folder.join(format!("{side}.{}", format.extension()));
        let files = FrameFiles { left: place("left"), right: place("right"), images: format };
        let mut best = 0.0_f64;
        for _ in 0..TIMES {
            let (begin, mut pairs) = (Instant::now(), 0);
            while begin.elapsed() < WHILE {
                files.save(&images.left, &images.right)?;
                pairs += 1;
            }
            best = best.max(f64::from(pairs) / begin.elapsed().as_secs_f64());
        }
        let bytes = std::fs::metadata(&files.left)?.len() + std::fs::metadata(&files.right)?.len();
        println!("| {name} | {best:.0} | {} |", bytes / 1000);
    }
    let (rate, bytes) = into_one_file(&folder, [&images.left, &images.right])?;
    println!("| MCAP, not compressed | {rate:.0} | {} |", bytes / 1000);
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}

/// Pairs per second into one file, and bytes per pair.
fn into_one_file(folder: &Path, images: [&RgbImage; 2]) -> Result<(f64, u64), Box<dyn Error>> {
    let mut best = (0.0_f64, 0);
    for number in 0..TIMES {
        let file = folder.join(format!("{number}.mcap"));
        let mut writer = BagWriter::create(&file, WhenFull::Wait)?;
        let (begin, mut pairs) = (Instant::now(), 0_u32);
        while begin.elapsed() < WHILE {
            let at = MonotonicTime::from_nanos(u64::from(pairs) * 33_333_333);
            for (image, topic) in images.into_iter().zip([ours::LEFT_IMAGE, ours::RIGHT_IMAGE]) {
                let (width, height) = image.dimensions();
                let header = Header { stamp: at.into(), frame_id: "cam_left".to_owned() };
                let (encoding, data) = ("rgb8".to_owned(), Bytes(image.as_raw().clone()));
                writer.push(
                    topic,
                    at,
                    &Image { header, height, width, encoding, is_bigendian: 0, step: 3 * width, data },
                );
            }
            pairs += 1;
        }
        writer.finish()?;
        let rate = f64::from(pairs) / begin.elapsed().as_secs_f64();
        best = (best.0.max(rate), std::fs::metadata(&file)?.len() / u64::from(pairs));
        std::fs::remove_file(&file)?;
    }
    Ok(best)
}
