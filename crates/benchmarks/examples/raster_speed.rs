//! Measures the renderer: stereo pairs of 640x480 per second on one core, with all effects except motion blur.
//!
//! Counts CPU time where the system reports it, so that other load does not affect the figure.
//!
//! `cargo run --release -p pb3dp-benchmarks --example raster_speed [SECONDS]`
#![allow(clippy::print_stdout)]

mod common;

use std::time::{Duration, Instant};

use image::RgbImage;
use pb3dp_hal_platform::cpu_time::thread_cpu_millis;
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Scene, SceneConfig};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::TargetConfig;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seconds = std::env::args().nth(1).map_or(Ok(2.0), |text| text.parse::<f64>())?;
    println!("{:<8} {:<12} {:>12} {:>10}", "target", "lens", "pairs/s", "ms/pair");
    for target in [TargetConfig::crab(0.015), TargetConfig::card(), TargetConfig::grey_box(), TargetConfig::potato()] {
        for lens in common::Lens::ALL {
            let scene = Scene::build(&SceneConfig::new(target))?;
            let mut renderer = StereoRenderer::new(scene, common::rig(lens)?, &SensorConfig::default(), 1)?;
            let pairs_per_second = measure(&mut renderer, Duration::from_secs_f64(seconds));
            println!(
                "{:<8} {:<12} {:>12.1} {:>10.2}",
                target.name(),
                lens.name(),
                pairs_per_second,
                1000.0 / pairs_per_second
            );
        }
    }
    Ok(())
}

/// Stereo pairs per second of CPU time while the target oscillates.
fn measure(renderer: &mut StereoRenderer, duration: Duration) -> f64 {
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    let mut frames = 0;
    let start = Instant::now();
    let cpu_start = thread_cpu_millis();
    while start.elapsed() < duration {
        let sway = 0.2 * (frames as f64 * 0.05).sin();
        renderer.render_pair(&common::frontal(0.5, sway, -0.5 * sway), frames, &mut left, &mut right);
        frames += 1;
    }
    frames as f64 / (thread_cpu_millis() - cpu_start) * 1e3
}
