//! One exposure for both cameras.

use std::time::Duration;

use pb3dp_camera_settings::Setting;

use super::one_device::cameras;
use super::*;

const SHARED: &str = "[left]\nexposure_millis = \"shared\"\n[right]\nexposure_millis = \"shared\"\n";

#[test]
fn both_cameras_share_an_exposure_within_the_limits_of_the_table() {
    assert_eq!(cameras("").unwrap().stereo.shared_exposure, None);
    let found = cameras(SHARED).unwrap();
    let shared = found.stereo.shared_exposure.unwrap();
    assert_eq!((shared.target_grey, shared.gain, (shared.nearest_m * 1e3).round()), (110.0, None, 350.0));
    assert_eq!(shared.time, [Duration::from_micros(500), Duration::from_millis(8)]);
    assert_eq!((found.stereo.left.controls.exposure, found.exposure()), (Setting::Keep, Duration::from_millis(8)));
    let gains = "[left]\nexposure_millis = \"shared\"\ngain = \"shared\"\n[right]\nexposure_millis = \"shared\"\ngain = \"shared\"\n";
    let text = cameras(gains).unwrap_err();
    assert!(text.contains("camera.shared_exposure.gain_max: missing; gain = \"shared\" needs it"), "{text}");
    let limits = |min: i64, max: i64| format!("{gains}[shared_exposure]\ngain_min = {min}\ngain_max = {max}\n");
    assert_eq!(cameras(&limits(8, 64)).unwrap().stereo.shared_exposure.unwrap().gain, Some([8, 64]));
    let text = cameras(&limits(65, 64)).unwrap_err();
    assert!(text.contains("camera.shared_exposure.gain_min = 65: larger than gain_max = 64"), "{text}");
}

#[test]
fn what_one_camera_alone_shares_is_refused() {
    for (changes, expected) in [
        ("[left]\nexposure_millis = \"shared\"\n", "camera.right.exposure_millis: \"shared\" in the other camera"),
        ("[right]\nexposure_millis = \"shared\"\n", "camera.left.exposure_millis: \"shared\" in the other camera"),
        (
            "[left]\ngain = \"shared\"\n[right]\ngain = \"shared\"\n",
            "camera.left.gain: \"shared\" needs exposure_millis = \"shared\", too",
        ),
        ("[left]\nfocus = \"shared\"\n", "camera.left.focus = \"shared\": only exposure_millis and gain can be shared"),
    ] {
        let text = cameras(changes).unwrap_err();
        assert!(text.contains(expected), "{expected} is not in {text}");
    }
}

#[test]
fn an_exposure_that_blurs_too_much_is_refused() {
    let sample = Sample::new("rig.toml", |file| read_setup(file).map(drop));
    let shared = |key: &str| (format!("camera.{key}.exposure_millis"), Value::String("shared".into()));
    let changes = |blur_max_px: f64| {
        let blur = ("camera.shared_exposure.blur_max_px".to_owned(), Value::Float(blur_max_px));
        [shared("left"), shared("right"), blur]
    };
    assert_eq!(sample.refusal_of(&changes(2.0)), None);
    let least = ("camera.shared_exposure.exposure_min_millis".to_owned(), Value::Float(5.0));
    let [left, right, blur] = changes(0.2);
    let text = sample.refusal_of(&[left, right, blur, least]).unwrap();
    assert!(text.contains("5.00 ms is the shortest exposure; allow more blur"), "{text}");
}
