//! Checks of emulated cameras that show a real pair.

use pb3dp_camera_v4l2::emulated::EmulatedCamera;
use pb3dp_cell::finding::Verdict;

use super::super::emulated_rig::{case, system, system_of_one, typed, typed_of_one};
use super::*;

fn check(more: &[&str], change: impl Fn(usize, &mut EmulatedCamera)) -> Result<Report> {
    let calibration = case().calibration.display().to_string();
    let args: CheckArgs = typed(&[&["--format", "RGB3", "--calib", &calibration, "--pairs", "120"], more].concat());
    let (system, clock) = system(change);
    checked(system, clock, &args)
}

fn failed(report: &Report) -> Vec<&str> {
    let findings = report.findings.iter().filter(|finding| finding.verdict == Verdict::Fail);
    findings.map(|finding| finding.check.as_str()).collect()
}

#[test]
fn good_cameras_pass_every_check() {
    let report = check(&[], |_, _| {}).unwrap();
    assert_eq!((failed(&report), report.passed, report.pairs), (vec![], true, 120), "{}", report.text());
    let checks: Vec<&str> = report.findings.iter().map(|finding| finding.check.as_str()).collect();
    let expected = [
        "rate",
        "jitter",
        "skew",
        "missing",
        "brightness left",
        "clipped bright left",
        "clipped dark left",
        "brightness right",
        "clipped bright right",
        "clipped dark right",
        "brightness of both",
        "sharpness left",
        "sharpness right",
        "focus of both",
        "sides",
        "rows",
    ];
    assert_eq!(checks, expected);
    assert!(report.text().ends_with("16 passed, 0 failed, 0 not checked"), "{}", report.text());
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!((&json["findings"][2]["value"], &json["findings"][2]["limit_max"]), (&1.0.into(), &5.0.into()));
}

#[test]
fn one_device_with_both_views_passes_every_check() {
    let calibration = case().calibration.display().to_string();
    let more = ["--format", "RGB3", "--calib", &calibration, "--pairs", "120"];
    let checked_as = |layout: &str, more: &[&str]| {
        let args: CheckArgs = typed_of_one(layout, more);
        let (system, clock) = system_of_one(|_| {});
        checked(system, clock, &args)
    };
    let report = checked_as("side-by-side", &more).unwrap();
    assert_eq!((failed(&report), report.passed, report.pairs), (vec![], true, 120), "{}", report.text());
    let skew = report.findings.iter().find(|finding| finding.check == "skew").unwrap();
    assert_eq!(skew.value, Some(0.0), "{skew:?}");
    let error = format!("{:#}", checked_as("interleaved", &more).err().unwrap());
    assert!(error.contains("the layout interleaved needs the format Y8I, not RGB3"), "{error}");
    let cropped = ["--crop-left", "0,0,600,480", "--crop-right", "0,0,600,480"];
    let error = format!("{:#}", checked_as("side-by-side", &[&more[..], &cropped].concat()).err().unwrap());
    assert!(error.contains("the images have 600x480 pixels, the calibration 640x480"), "{error}");
    let valued = [&more[..], &["--values", "0,1023"]].concat();
    let error = format!("{:#}", checked_as("side-by-side", &valued).err().unwrap());
    assert!(error.contains("--values: only Y10, Y12 and Y16 have more than 8 bits, RGB3 has not"), "{error}");
}

#[test]
fn each_fault_of_the_cameras_is_found_and_reported() {
    let apart = check(&[], |side, camera| camera.phase = Duration::from_millis(40 + 8 * side as u64)).unwrap();
    assert_eq!(failed(&apart), ["skew"], "{}", apart.text());
    let text = apart.text();
    for part in
        ["FAIL  skew: 8.00 ms at worst (at most 5.00); at 100 mm/s and a distance of 500 mm this is", "--skew-max"]
    {
        assert!(text.contains(part), "{part} is not in {text}");
    }
    let borne = check(&["--skew-max", "9"], |side, camera| camera.phase = Duration::from_millis(40 + 8 * side as u64));
    assert!(borne.unwrap().passed);
    let drifting = check(&[], |side, camera| camera.slowness = 2e-4 * side as f64).unwrap();
    let skew = drifting.findings.iter().find(|finding| finding.check == "skew").unwrap();
    assert!(skew.found.contains("drifting by +200.") && skew.found.contains("beyond the limit in"), "{skew:?}");
    let slow = check(&[], |_, camera| camera.slowness = 0.05).unwrap();
    assert_eq!(failed(&slow), ["rate"], "{}", slow.text());
    let crossed = check(&[], |side, camera| camera.entry.serial = Some(format!("SN{:04}", 1 - side))).unwrap();
    assert!(failed(&crossed).contains(&"sides"), "{}", crossed.text());
    let one_camera = check(&[], |side, camera| {
        if side == 1 {
            camera.paint = |_, memory| memory.fill(90);
        }
    });
    let report = one_camera.unwrap();
    assert_eq!(failed(&report), ["sharpness right", "rows"], "{}", report.text());
}

#[test]
fn failing_cameras_are_reported() {
    let silent = |side: usize, camera: &mut EmulatedCamera| camera.faults.is_silent = side == 1;
    let error = format!("{:#}", check(&[], silent).unwrap_err());
    assert!(error.contains("no pairs come") && error.contains("no image yet"), "{error}");
    let error = format!("{:#}", check(&[], |side, camera| camera.faults.is_unplugged = side == 0).unwrap_err());
    assert!(error.contains("no such camera"), "{error}");
    let ends = check(&[], |side, camera| camera.faults.ends = side == 0);
    assert!(format!("{:#}", ends.unwrap_err()).contains("has ended the stream"));
}
