//! One device with both views, crops, and formats with more than 8 bits.

use pb3dp_camera_settings::{Crop, DeviceLayout, ImageLayout, PixelFormat, ValueRange};
use pb3dp_geometry::ImageSize;

use super::*;
use crate::setup::{RealCameras, read_cameras};

/// The cameras of the rig example with these changes, or why they are refused.
pub(super) fn cameras(changes: &str) -> Result<RealCameras, String> {
    let sample = Sample::new("rig.toml", |file| read_setup(file).map(drop));
    let mut root = sample.table.clone();
    let camera = root["camera"].as_table_mut().unwrap();
    change_lines(camera, changes);
    if camera.get("layout").and_then(Value::as_str) != Some("two-devices") {
        // What the example states of the right camera.
        let right = camera["right"].as_table_mut().unwrap();
        let keeps = changes.contains("[right]");
        right.retain(|key, value| keeps || !(key == "device" || value.is_integer() || key == "exposure_millis"));
        for key in ["exposure_millis", "gain", "white_balance_kelvin"] {
            right.entry(key).or_insert("keep".into());
        }
    }
    let file = sample.folder.path().join("rig.toml");
    std::fs::write(&file, toml::to_string(&root).unwrap()).unwrap();
    let cameras = read_cameras(&SetupArgs::of_file(&file)).map(|(cameras, _)| cameras);
    cameras.map_err(|error| error.to_string())
}

#[test]
fn two_devices_are_the_default() {
    let found = cameras("").unwrap();
    assert_eq!(found.names(), "bus:usb-0000:00:14.0-1 and bus:usb-0000:00:14.0-2");
    let stereo = found.stereo;
    assert_eq!((stereo.layout, stereo.range, stereo.left.crop), (DeviceLayout::TwoDevices, None, None));
    assert_ne!(stereo.left.name, stereo.right.name);
    assert_eq!(stereo.value_range(), None);
}

#[test]
fn one_device_has_the_settings_of_the_left_side_for_both_views() {
    let one = "layout = \"side-by-side\"\nformat = \"Y12\"\nvalue_range = [64, 4000]\nwidth_px = 672\n[left]\ncrop_px = [2, 0, 640, 480]";
    let found = cameras(&format!("{one}\n[right]\ncrop_px = [30, 0, 640, 480]")).unwrap_err();
    // The example's own right camera is refused key by key.
    for key in ["device", "exposure_millis", "gain", "white_balance_kelvin"] {
        assert!(
            found.contains(&format!("camera.right.{key}: with this camera.layout one device has both views")),
            "{found}"
        );
    }
    let text = cameras(one).unwrap_err();
    assert!(text.contains("the right image would have 672x480 pixels, the left one 640x480"), "{text}");
    let whole = cameras("layout = \"top-bottom\"\nformat = \"Y12\"\nvalue_range = [64, 4000]").unwrap();
    assert_eq!(whole.names(), "bus:usb-0000:00:14.0-1 (top-bottom)");
    let stereo = &whole.stereo;
    assert_eq!(stereo.layout, DeviceLayout::OneImage(ImageLayout::TopBottom));
    assert_eq!((&stereo.left, whole.size()), (&stereo.right, ImageSize { width: 640, height: 480 }));
    assert_eq!((stereo.range, stereo.value_range()), (ValueRange::new(64, 4000), ValueRange::new(64, 4000)));
    let stated = cameras("layout = \"interleaved\"\nformat = \"Y8I\"").unwrap().stereo;
    assert_eq!((stated.layout, stated.left.mode.format), (DeviceLayout::Interleaved, PixelFormat::Y8i));
}

#[test]
fn crops_are_those_of_each_view() {
    let found = cameras(
        "layout = \"two-devices\"\nwidth_px = 672\n[left]\ncrop_px = [2, 0, 640, 480]\n[right]\ncrop_px = [30, 0, 640, 480]",
    );
    let found = found.unwrap();
    let size = ImageSize { width: 640, height: 480 };
    let crops = [&found.stereo.left, &found.stereo.right].map(|side| side.crop);
    assert_eq!(crops, [Some(Crop { left: 2, top: 0, size }), Some(Crop { left: 30, top: 0, size })]);
    assert_eq!((found.size(), found.stereo.left.mode.size.width), (size, 672));
}

#[test]
fn layouts_crops_and_ranges_that_do_not_fit_are_refused() {
    for (changes, expected) in [
        (
            "layout = \"sideways\"",
            "camera.layout: unknown variant: found sideways, expected one of two-devices, side-by-side",
        ),
        ("layout = \"interleaved\"", "camera.layout: the layout interleaved needs the format Y8I, not YUYV"),
        (
            "layout = \"two-devices\"\nformat = \"Y8I\"",
            "camera.layout: the format Y8I has the pixels of both views alternately, which is the layout interleaved, not two-devices",
        ),
        (
            "layout = \"side-by-side\"\nwidth_px = 641",
            "camera.layout: YUYV in the layout side-by-side cannot have views of 641x480",
        ),
        (
            "layout = \"two-devices\"\n[right]\ncrop_px = [3, 0, 600, 480]",
            "camera.right.crop_px: the crop 3,0,600,480 (left, top, width, height) cannot begin there: YUYV has groups of 2x1 pixels",
        ),
        (
            "layout = \"two-devices\"\n[left]\ncrop_px = [100, 0, 600, 480]",
            "camera.left.crop_px: the crop 100,0,600,480 (left, top, width, height) is empty or not inside of a view of 640x480",
        ),
        (
            "layout = \"two-devices\"\n[left]\ncrop_px = [-2, 0, 600, 480]",
            "camera.left.crop_px (left) = -2: allowed are 0 to 4096",
        ),
        (
            "layout = \"two-devices\"\nvalue_range = [0, 1023]",
            "camera.value_range: only formats with more than 8 bits have one",
        ),
        (
            "layout = \"two-devices\"\nformat = \"Y10\"\nvalue_range = [1023, 5]",
            "camera.value_range = [1023, 5]: state [LOW, HIGH] with 0 <= LOW < HIGH <= 65535",
        ),
    ] {
        let text = cameras(changes).unwrap_err();
        assert!(text.contains(expected), "{expected}: not in {text}");
    }
    let expected = "camera.right.device: missing; the setup must state it, unless camera.layout says how one device has both views";
    check_lines(&[("rig.toml", "-camera.right.device", expected)]);
}
