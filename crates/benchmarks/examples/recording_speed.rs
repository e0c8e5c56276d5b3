//! Stereo pairs of 640x480 that one thread compresses and writes per second, in each format: the recording rate.
//!
//! `cargo run --release -p pb3dp-benchmarks --example recording_speed` uses a real pair of `tests/data` and writes to
//! the folder for temporary files.

#![allow(clippy::print_stdout, reason = "a program for the console")]

use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

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
        ("PNG (as `record` writes it)", StoredFormat::QuickPng),
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
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}
