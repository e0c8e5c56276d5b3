//! `pb3dp identify delay` on the simulated cell, whose delays are known.

use crate::cli::support::{pb3dp, repository};

fn config(name: &str) -> String {
    repository().join("configs").join(name).display().to_string()
}

#[test]
fn delays_of_the_simulated_cell_are_found() {
    let args =
        ["identify", "delay", "--config", &config("sim.toml"), "--move", "--way", "3", "--seconds", "8", "--json"];
    let output = pb3dp(&args).assert_success();
    let found: serde_json::Value = serde_json::from_str(output.stdout.trim()).unwrap();
    let millis = |key: &str| found[key]["value"].as_f64().unwrap();
    // 10 ms of dead time and 30 ms of lag (configs/sim.toml), and what the limiter rounds off.
    assert!((39.5..43.0).contains(&millis("command_to_motion")), "{found}");
    assert!((9.0..14.0).contains(&millis("arm_delay")), "{found}");
    assert!(millis("stamp_to_exposure").abs() < 1.0, "{found}");
    assert!((found["stamp_to_use_p50"].as_f64().unwrap() - 28.0).abs() < 5.0, "{found}");
    assert!(found["estimates"].as_u64().unwrap() > 200, "{found}");
}

#[test]
fn nothing_moves_without_the_typed_name() {
    let output = pb3dp(&["identify", "delay", "--config", &config("hil.toml")]).assert_success();
    assert!(output.stdout.contains("nothing was moved; add --move"), "{}", output.stdout);
    let refused = ["identify", "delay", "--config", &config("sim.toml"), "--move", "--way", "31"];
    pb3dp(&refused).assert_refused(&["way_m is 0.031", "--way is in mm"]);
    let refused = ["identify", "delay", "--config", &config("sim.toml"), "--move", "--way", "30", "--seconds", "6"];
    pb3dp(&refused).assert_refused(&["speed_m_per_s is 0.44", "at most 0.06 m/s", "swing for longer"]);
}

#[test]
fn a_region_is_for_real_cameras() {
    let region = ["--region", "rect:250,170,110,110"];
    let simulated = ["identify", "delay", "--config", &config("sim.toml")];
    pb3dp(&[&simulated[..], &region].concat()).assert_refused(&["--region", "the cameras are simulated"]);
    let real = ["identify", "delay", "--config", &config("rig.toml")];
    let output = pb3dp(&[&real[..], &region].concat()).assert_success();
    assert!(output.stdout.contains("nothing was moved; add --move"), "{}", output.stdout);
}

#[test]
fn a_folder_that_can_not_be_made_is_found_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a file");
    std::fs::write(&file, "no folder").unwrap();
    let out = file.join("out").display().to_string();
    let args =
        ["identify", "delay", "--config", &config("sim.toml"), "--move", "--way", "3", "--seconds", "8", "--out", &out];
    pb3dp(&args).assert_refused(&["cannot be created"]);
}
