//! Writes a contact sheet per target into a folder, for inspection: left and right image, frontal with an ideal lens
//! and tilted with a distorted one.
//!
//! `cargo run --release -p pb3dp-benchmarks --example raster_images FOLDER`
#![allow(clippy::print_stdout)]

mod common;

use std::path::PathBuf;

use image::RgbImage;
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Scene, SceneConfig};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::TargetConfig;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).ok_or("no folder given: name the output folder")?);
    std::fs::create_dir_all(&folder)?;
    let targets = [
        ("crab", TargetConfig::crab(0.020)),
        ("crab_flat", TargetConfig::crab(0.0)),
        ("card", TargetConfig::card()),
        ("box", TargetConfig::grey_box()),
        ("potato", TargetConfig::potato()),
    ];
    for (name, target) in targets {
        let frontal = render(target, common::Lens::Ideal, (0.0, 0.0))?;
        let turned = render(target, common::Lens::Distorted, (-0.25, 0.35))?;
        let mut sheet = RgbImage::new(1280, 960);
        for (image, (x, y)) in frontal.iter().chain(&turned).zip([(0, 0), (640, 0), (0, 480), (640, 480)]) {
            image::imageops::replace(&mut sheet, image, x, y);
        }
        let file = folder.join(format!("{name}.png"));
        sheet.save(&file)?;
        println!("{}", file.display());
    }
    Ok(())
}

fn render(
    target: TargetConfig,
    lens: common::Lens,
    turn_rad: (f64, f64),
) -> Result<[RgbImage; 2], Box<dyn std::error::Error>> {
    let scene = Scene::build(&SceneConfig::new(target))?;
    let mut renderer = StereoRenderer::new(scene, common::rig(lens)?, &SensorConfig::default(), 1)?;
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    renderer.render_pair(&common::frontal(0.5, turn_rad.0, turn_rad.1), 0, &mut left, &mut right);
    Ok([left, right])
}
