//! Measures the renderer: stereo pairs of 640x480 per second on one core, with all effects except motion blur.
//!
//! Counts CPU time where the system reports it, so that other load does not affect the figure.
//!
//! `cargo run --release -p pb3dp-benchmarks --example raster_speed [SECONDS]`
//!
//! With `--images FOLDER` it writes a contact sheet per target instead, for inspection: left and right image, frontal with an ideal lens and
//! tilted with a distorted one.
#![allow(clippy::print_stdout)]

use std::path::Path;
use std::time::{Duration, Instant};

use image::RgbImage;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};
use pb3dp_hal_platform::cpu_time::thread_cpu_millis;
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Scene, SceneConfig, ScenePoses};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::TargetConfig;

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    match words.as_slice() {
        [option, folder] if option == "--images" => images(Path::new(folder)),
        [] => speed(2.0),
        [seconds, ..] => speed(seconds.parse()?),
    }
}

fn speed(seconds: f64) -> Result<()> {
    println!("{:<8} {:<12} {:>12} {:>10}", "target", "lens", "pairs/s", "ms/pair");
    for target in [TargetConfig::crab(0.015), TargetConfig::card(), TargetConfig::grey_box(), TargetConfig::potato()] {
        for lens in Lens::ALL {
            let mut renderer = renderer(target, lens)?;
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
        renderer.render_pair(&frontal(0.5, sway, -0.5 * sway), frames, &mut left, &mut right);
        frames += 1;
    }
    frames as f64 / (thread_cpu_millis() - cpu_start) * 1e3
}

/// Writes the contact sheets.
fn images(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)?;
    let targets = [
        ("crab", TargetConfig::crab(0.020)),
        ("crab_flat", TargetConfig::crab(0.0)),
        ("card", TargetConfig::card()),
        ("box", TargetConfig::grey_box()),
        ("potato", TargetConfig::potato()),
    ];
    for (name, target) in targets {
        let frontal = render(target, Lens::Ideal, (0.0, 0.0))?;
        let turned = render(target, Lens::Distorted, (-0.25, 0.35))?;
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

fn render(target: TargetConfig, lens: Lens, turn_rad: (f64, f64)) -> Result<[RgbImage; 2]> {
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    renderer(target, lens)?.render_pair(&frontal(0.5, turn_rad.0, turn_rad.1), 0, &mut left, &mut right);
    Ok([left, right])
}

fn renderer(target: TargetConfig, lens: Lens) -> Result<StereoRenderer> {
    let scene = Scene::build(&SceneConfig::new(target))?;
    Ok(StereoRenderer::new(scene, rig(lens)?, &SensorConfig::default(), 1)?)
}

/// Lens model of the example rig.
#[derive(Clone, Copy, PartialEq)]
enum Lens {
    /// No distortion.
    Ideal,
    /// Distortion of a typical 6 mm lens.
    Distorted,
}

impl Lens {
    /// Both lens models.
    const ALL: [Self; 2] = [Self::Ideal, Self::Distorted];

    /// Name in tables.
    fn name(self) -> &'static str {
        if self == Self::Ideal { "ideal" } else { "distorted" }
    }
}

/// 640x480, fx 740 px, baseline 100 mm.
fn rig(lens: Lens) -> Result<StereoRig> {
    let camera = |shift: f64| -> Result<Camera> {
        let distortion = match lens {
            Lens::Ideal => Distortion::None,
            Lens::Distorted => {
                Distortion::BrownConrady5 { coefficients: [-0.12 - 0.01 * shift, 0.09, 0.0006, -0.0004, 0.0] }
            }
        };
        let pinhole = Pinhole { fx: 740.0, fy: 740.0, cx: 319.5, cy: 239.5 };
        Ok(Camera::new(ImageSize { width: 640, height: 480 }, pinhole, distortion)?)
    };
    Ok(StereoRig::new(camera(0.0)?, camera(1.0)?, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0)))?)
}

/// The camera axis is +x of the world, one metre up; the target is in front of it, rotated about its axes (radians).
fn frontal(distance_m: f64, turn_x_rad: f64, turn_y_rad: f64) -> ScenePoses {
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let world_from_cam_left = Pose::from_rotation_matrix(&axes, Vector3::new(0.3, 0.1, 0.5));
    let turn = UnitQuaternion::from_euler_angles(turn_x_rad, turn_y_rad, 0.0);
    let cam_left_from_target: Pose<CamLeft, Target> = Pose::from_parts(Vector3::new(0.05, 0.0, distance_m), turn);
    ScenePoses { world_from_cam_left, world_from_target: world_from_cam_left * cam_left_from_target }
}
