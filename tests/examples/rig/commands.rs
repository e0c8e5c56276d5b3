//! The commands `pb3dp cameras` in this computer.

use std::collections::BTreeSet;
use std::path::Path;

use pb3dp_record::dataset::load_sequence;
use serde_json::Value;

use crate::program::{Running, once};
use crate::report::{Outcome, Report, ensure};
use crate::setup::{Devices, HERE};
use crate::system::wait_for;

/// Images per second.
const RATE_HZ: f64 = 25.0;

/// Number of pairs of a recording; its file.
const PAIRS: usize = 16;
const FOLDER: &str = "/recorded";

/// Findings of `cameras check` that an image without noise can also meet.
const OF_TIME: [&str; 4] = ["rate", "jitter", "skew", "missing"];

pub fn check(devices: Devices, report: &mut Report) {
    report.check("`cameras list` names every camera", || list(devices));
    report.check("`cameras record` keeps every pair, with its time", || record(devices));
    report.check("`cameras check` measures them", measure);
    report.check("a second program at one camera is refused by name", || second(devices));
}

/// Output of the program on standard output, with any exit code.
fn output_of(args: &[&str]) -> Result<(bool, String, String), Box<dyn std::error::Error>> {
    let output = once(args)?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
    Ok((output.status.success(), text(&output.stdout), text(&output.stderr)))
}

fn list(devices: Devices) -> Outcome {
    let (is_good, out, err) = output_of(&["cameras", "list", "--json"])?;
    ensure(is_good, || err)?;
    let listed = out.lines().map(serde_json::from_str).collect::<Result<Vec<Value>, _>>()?;
    let names: BTreeSet<&str> = listed.iter().filter_map(|device| device["names"][0].as_str()).collect();
    let wanted: Vec<String> = devices.buses().iter().map(|bus| format!("bus:{bus}")).collect();
    ensure(names.iter().copied().eq(wanted.iter().map(String::as_str)), || out.clone())?;
    for device in &listed {
        let has = |list: &str, key: &str, value: &str| {
            device[list].as_array().is_some_and(|entries| entries.iter().any(|entry| entry[key] == value))
        };
        ensure(device["problem"].is_null() && has("formats", "fourcc", "YUYV"), || device.to_string())?;
        ensure(has("controls", "name", "Brightness"), || device["controls"].to_string())?;
    }
    Ok(names.into_iter().collect::<Vec<_>>().join(", "))
}

fn record(devices: Devices) -> Outcome {
    let pairs = PAIRS.to_string();
    let args = ["cameras", "record", "--config", HERE, "--out", FOLDER, "--pairs", &pairs, "--json"];
    let (is_good, out, err) = output_of(&args)?;
    ensure(is_good, || format!("{out} {err}"))?;
    let sequence = load_sequence(Path::new(FOLDER))?;
    let calibration = sequence.load_calibration()?;
    let size = calibration.rig.left().size();
    // One time for both views: no skew is recorded.
    let skews = if devices == Devices::Two { PAIRS } else { 0 };
    ensure(sequence.times_s.len() == PAIRS && sequence.skew_s.len() == skews, || format!("{sequence:?}"))?;
    let mut different = 0;
    for frame in 0..PAIRS as u64 {
        let images = sequence.load_images(frame, size)?;
        different += usize::from(images.left != images.right);
    }
    ensure(different == PAIRS, || format!("{different} of {PAIRS} pairs have two images"))?;
    let gaps: Vec<f64> = sequence.times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let worst = gaps.iter().map(|gap| (gap - 1.0 / RATE_HZ).abs()).fold(0.0, f64::max);
    let mean = gaps.iter().sum::<f64>() / gaps.len() as f64;
    let figures = format!("{PAIRS} pairs, {:.2} per second, no gap off by more than {:.1} ms", 1.0 / mean, worst * 1e3);
    ensure(worst < 0.5 / RATE_HZ && (mean * RATE_HZ - 1.0).abs() < 0.02, || figures.clone())?;
    Ok(figures)
}

fn measure() -> Outcome {
    let (_, out, err) = output_of(&["cameras", "check", "--config", HERE, "--pairs", "30", "--json"])?;
    let report: Value = serde_json::from_str(&out).map_err(|error| format!("{error}: {out} {err}"))?;
    let findings = report["findings"].as_array().ok_or("no findings")?;
    let of_time = |finding: &&Value| finding["check"].as_str().is_some_and(|check| OF_TIME.contains(&check));
    let found: Vec<&Value> = findings.iter().filter(of_time).collect();
    let text = |finding: &&Value| format!("{} {:.2}", finding["check"], finding["value"].as_f64().unwrap_or(f64::NAN));
    let texts = format!("{} findings, {}", findings.len(), found.iter().map(text).collect::<Vec<_>>().join(", "));
    let is_good = found.len() == OF_TIME.len() && found.iter().all(|finding| finding["passed"] == true);
    ensure(is_good, || format!("{texts}: {out} {err}"))?;
    Ok(texts)
}

fn second(devices: Devices) -> Outcome {
    let args = ["cameras", "record", "--config", HERE, "--out", "/first", "--pairs", "1000", "--json"];
    let first = Running::start(&args)?;
    // The cameras are in use once it writes.
    wait_for("the first program records", || std::fs::read_dir("/first").ok()?.nth(2).map(|_| ()))?;
    let (is_good, out, err) = output_of(&["cameras", "check", "--config", HERE, "--pairs", "30"])?;
    drop(first);
    ensure(!is_good && err.contains(devices.buses()[0]) && err.contains("used by another program"), || {
        format!("{out} {err}")
    })?;
    Ok(err)
}
