//! `pb3dp rig plan`, and docs/rig.md, whose figures are what it prints.

use serde_json::Value;

use crate::cli::support::{pb3dp, repository};

fn plan(options: &str) -> Value {
    let args = [&["rig", "plan"], &options.split_whitespace().collect::<Vec<_>>()[..], &["--json"]].concat();
    serde_json::from_str(pb3dp(&args).assert_success().stdout.trim()).unwrap()
}

fn page() -> String {
    std::fs::read_to_string(repository().join("docs/rig.md")).unwrap()
}

#[test]
fn text_and_json_say_the_same() {
    let options = "--baseline 100 --focal 740 --distance 500";
    let json = plan(options);
    let near = |key: &str, expected: f64| {
        let value = json["at"][key].as_f64().unwrap();
        assert!((value / expected - 1.0).abs() < 1e-3, "{key}: {value}, not {expected}");
    };
    near("disparity_px", 148.0);
    near("depth_per_px_mm", 3.3784);
    near("depth_calibration_mm", 0.33784);
    near("blur_px", 0.74);
    near("skew_depth_mm", 2.5);
    assert_eq!(json["table"].as_array().unwrap().len(), 6);
    assert!(json["at"]["defocus_px"].is_null() && json["lens"].is_null(), "{json}");
    let text = pb3dp(&[&["rig", "plan"], &options.split(' ').collect::<Vec<_>>()[..]].concat()).assert_success().stdout;
    assert!(text.contains("148.0 px") && text.contains("3.38 mm") && text.contains("2.50 mm of depth"), "{text}");
    for line in json["table"].as_array().unwrap() {
        let start =
            format!("| {:.0} | {:.1} |", line["distance_mm"].as_f64().unwrap(), line["disparity_px"].as_f64().unwrap());
        assert_eq!(text.lines().filter(|row| row.starts_with(&start)).count(), 1, "{start} in\n{text}");
    }
}

#[test]
fn a_measured_disparity_noise_takes_the_place_of_the_images() {
    let base = "--baseline 100 --focal 740 --distance 500";
    let of = |more: &str| plan(&format!("{base} {more}"))["at"]["depth_noise_mm"].as_f64().unwrap();
    let (one, two) = (of("--disparity-noise 0.1"), of("--disparity-noise 0.2"));
    assert!((two / one - 2.0).abs() < 1e-9 && one > 0.0);
    assert!((of("--noise 6") / of("") - 2.0).abs() < 1e-9 && (of("--gradient 16") / of("") - 0.5).abs() < 1e-9);
}

#[test]
fn defects_of_a_stereo_rig_are_reported() {
    let warned = |options: &str, part: &str| {
        let json = plan(options);
        let warnings = json["warnings"].to_string();
        assert!(warnings.contains(part), "{part:?} is missing for {options}: {warnings}");
        let args = [&["rig", "plan"], &options.split_whitespace().collect::<Vec<_>>()[..]].concat();
        assert!(
            pb3dp(&args)
                .assert_success()
                .stdout
                .contains(&format!("WARNING {}", json["warnings"][0].as_str().unwrap()))
        );
    };
    warned("--baseline 300 --focal 740 --distance 300", "not wholly in both images");
    warned("--baseline 100 --focal 200 --distance 800", "25 px");
    warned("--baseline 100 --focal 740 --distance 300 --exposure 20", "4.9 px of motion blur");
    warned("--baseline 100 --focal 740 --distance 500 --skew 16", "trigger both cameras");
    let quiet = plan("--baseline 100 --focal 740 --distance 500 --skew 0.05");
    assert_eq!(quiet["warnings"], serde_json::json!([]));
    assert!(plan("--baseline 300 --focal 740 --distance 300")["at"]["depth_mm"].is_null());
}

#[test]
fn bad_numbers_are_refused_with_what_is_allowed() {
    let refused = |options: &str, parts: &[&str]| {
        let mut args = vec!["rig", "plan"];
        args.extend(options.split_whitespace());
        pb3dp(&args).assert_refused(parts);
    };
    refused("--baseline 0.1 --focal 740 --distance 500", &["--baseline", "in millimetres; did you mean 100?"]);
    refused("--baseline 100 --focal -1 --distance 500", &["--focal", "\"-1\"", "from 50 to 20000 px"]);
    refused("--baseline 100 --focal 740 --distance nan", &["--distance", "from 50 to 10000 mm"]);
    refused("--baseline 100 --focal 740 --distance 500 --size 640", &["--size", "640x480"]);
    refused("--baseline 100 --focal 740 --distance 500 --range 800,300", &["--range", "300,800"]);
    refused("--baseline 100 --focal 740 --distance 500 --noise 0", &["--noise", "from 0.05 to 50 grey levels"]);
    refused(
        "--baseline 100 --focal 740 --distance 500 --disparity-noise 1 --noise 2",
        &["--noise", "--disparity-noise"],
    );
    refused("--baseline 100 --focal 740 --distance 500 --f-number 4", &["--pixel"]);
    refused("--focal 740 --distance 500", &["--baseline"]);
}

/// Each `sh` block of the page whose command plans a head is followed by what it prints.
#[test]
fn the_page_shows_what_the_command_prints() {
    let page = page();
    let mut shown = 0;
    for part in page.split("```sh\npb3dp rig plan ").skip(1) {
        let (options, rest) = part.split_once("\n```\n").unwrap();
        let output = rest.trim_start().strip_prefix("```text\n").unwrap_or_else(|| panic!("no output of {options}"));
        let (output, _) = output.split_once("```").unwrap();
        let args = [&["rig", "plan"], &options.split_whitespace().collect::<Vec<_>>()[..]].concat();
        let printed = pb3dp(&args).assert_success().stdout;
        assert_eq!(output, printed, "docs/rig.md: pb3dp rig plan {options} prints\n{printed}");
        shown += 1;
    }
    assert!(shown >= 2, "{shown}");
}

/// Cells of a row of the table of heads, as the command has them.
fn row(options: &str) -> String {
    let options_and_distance = format!("{options} --distance 500");
    let json = plan(&options_and_distance);
    let table = json["table"].as_array().unwrap();
    let at = |mm: f64| table.iter().find(|line| (line["distance_mm"].as_f64().unwrap() - mm).abs() < 1e-6).unwrap();
    let errors = |mm: f64| {
        let line = at(mm);
        match (line["depth_mm"].as_f64(), line["tilt_deg"].as_f64()) {
            (Some(depth), Some(tilt)) => format!("{depth:.2} mm, {tilt:.2}"),
            _ => "-".to_owned(),
        }
    };
    format!(
        "| `{options}` | {:.0} | {:.0} | {} | {} | {} |",
        json["head"]["view_deg"][0].as_f64().unwrap(),
        json["head"]["nearest_in_both_mm"].as_f64().unwrap(),
        errors(300.0),
        errors(500.0),
        errors(800.0)
    )
}

#[test]
fn the_table_of_heads_is_what_the_command_says() {
    let page = page();
    let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| `--baseline")).collect();
    let mut wrong = Vec::new();
    for shown in &rows {
        let options = shown.split('`').nth(1).unwrap();
        let expected = row(options);
        if *shown != expected {
            wrong.push(expected);
        }
    }
    assert!(rows.len() >= 5 && wrong.is_empty(), "rows of docs/rig.md should be\n{}", wrong.join("\n"));
}
