//! Emulated cameras that show a real pair of `tests/data`, for tests.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use clap::Parser;
use image::RgbImage;
use pb3dp_camera_settings::Interval;
use pb3dp_camera_v4l2::emulated::{EmulatedCamera, EmulatedSystem};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::VirtualClock;
use pb3dp_record::dataset::{Case, load_case};
use pb3dp_record::images::load_rgb;

/// The real pair.
pub(super) fn case() -> Case {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases");
    let mut folders: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    folders.sort();
    load_case(folders.iter().find(|folder| folder.is_dir()).unwrap()).unwrap()
}

/// Its two images.
pub(super) fn images() -> &'static [RgbImage; 2] {
    static IMAGES: OnceLock<[RgbImage; 2]> = OnceLock::new();
    IMAGES.get_or_init(|| {
        let case = case();
        [load_rgb(&case.left).unwrap(), load_rgb(&case.right).unwrap()]
    })
}

/// An image with its number in its first bytes, so that each one differs.
fn paint(side: usize, number: u64, memory: &mut [u8]) {
    memory.copy_from_slice(images()[side].as_raw());
    memory[..8].copy_from_slice(&number.to_le_bytes());
}

fn paint_left(number: u64, memory: &mut [u8]) {
    paint(0, number, memory);
}

fn paint_right(number: u64, memory: &mut [u8]) {
    paint(1, number, memory);
}

/// The number in an image.
pub(super) fn number_in(image: &RgbImage) -> u64 {
    u64::from_le_bytes(image.as_raw()[..8].try_into().unwrap())
}

/// A system with both cameras, 640x480 `RGB3` at 30 per second in virtual time; the right one runs 1 ms after the left one.
pub(super) fn system(change: impl Fn(usize, &mut EmulatedCamera)) -> (Arc<EmulatedSystem>, Arc<dyn Clock>) {
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::default());
    clock.sleep_until(pb3dp_geometry::MonotonicTime::from_nanos(5_000_000_000));
    let cameras = (0..2).map(|side| {
        let mut camera = EmulatedCamera::usual(side as u32);
        let interval = Interval { numerator: 1, denominator: 30 };
        camera.formats = vec![(*b"RGB3", vec![(ImageSize { width: 640, height: 480 }, vec![interval])])];
        camera.phase = Duration::from_millis(40 + side as u64);
        camera.paint = if side == 0 { paint_left } else { paint_right };
        change(side, &mut camera);
        camera
    });
    (Arc::new(EmulatedSystem::new(clock.clone(), cameras.collect())), clock)
}

/// Both images side by side, with the number as [`paint`] has it.
fn paint_both(number: u64, memory: &mut [u8]) {
    let sides = images().each_ref().map(|image| image.chunks_exact(3 * 640));
    let [left, right] = sides;
    for (row, (left, right)) in memory.chunks_exact_mut(2 * 3 * 640).zip(left.zip(right)) {
        row[..3 * 640].copy_from_slice(left);
        row[3 * 640..].copy_from_slice(right);
    }
    memory[..8].copy_from_slice(&number.to_le_bytes());
}

/// As [`system`], with one device that has both views side by side.
pub(super) fn system_of_one(change: impl Fn(&mut EmulatedCamera)) -> (Arc<EmulatedSystem>, Arc<dyn Clock>) {
    system(|side, camera| {
        camera.formats[0].1[0].0 = ImageSize { width: 1280, height: 480 };
        camera.paint = paint_both;
        camera.faults.is_unplugged = side == 1;
        change(camera);
    })
}

/// Command-line arguments with the names and the exposure of these cameras.
pub(in crate::commands) fn typed<A: clap::Args>(more: &[&str]) -> A {
    typed_with(&["--left", "serial:SN0000", "--right", "serial:SN0001"], more)
}

/// As [`typed`], for one device with both views in this layout.
pub(super) fn typed_of_one<A: clap::Args>(layout: &str, more: &[&str]) -> A {
    typed_with(&["--both", "serial:SN0000", "--views", layout], more)
}

/// Command-line arguments with the cameras of a setup: [configs/rig.toml](../../../../../configs/rig.toml) with these cameras.
pub(super) fn typed_of_setup<A: clap::Args>(more: &[&str]) -> A {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/rig.toml").display().to_string();
    let settings = [
        "--set",
        "camera.left.device=\"serial:SN0000\"",
        "--set",
        "camera.right.device=\"serial:SN0001\"",
        "--set",
        "camera.format=\"RGB3\"",
    ];
    parsed(&[&["pb3dp", "--config", &file], settings.as_slice(), more].concat())
}

fn typed_with<A: clap::Args>(names: &[&str], more: &[&str]) -> A {
    parsed(&[&["pb3dp", "--exposure", "4"], names, more].concat())
}

fn parsed<A: clap::Args>(words: &[&str]) -> A {
    #[derive(Parser)]
    struct Line<A: clap::Args> {
        #[command(flatten)]
        args: A,
    }
    Line::<A>::parse_from(words).args
}
