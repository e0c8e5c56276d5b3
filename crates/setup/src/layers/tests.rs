//! Tests of the layers: precedence, refusals, and values that must not reach a real arm.

use super::*;
use crate::setup::read_layers;

fn args(configs: &[&Path], set: &[&str]) -> SetupArgs {
    let configs = configs.iter().map(|path| path.to_path_buf()).collect();
    SetupArgs { configs, set: set.iter().map(|text| (*text).to_owned()).collect(), ..SetupArgs::default() }
}

fn refusal(configs: &[&Path], set: &[&str]) -> String {
    read_layers(&args(configs, set)).map(|_| ()).unwrap_err().to_string()
}

fn write(folder: &Path, name: &str, text: &str) -> PathBuf {
    let file = folder.join(name);
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    std::fs::write(&file, text).unwrap();
    file
}

fn value(layers: &Layers, key: &str) -> (String, String) {
    let found = layers.effective().into_iter().find(|setting| setting.key == key).unwrap();
    (found.value, found.origin)
}

#[test]
fn later_layers_win_and_every_value_knows_where_it_is_stated() {
    let folder = tempfile::tempdir().unwrap();
    let base = write(folder.path(), "deep/base.toml", "base = \"sim\"\n[run]\nseed = 5\n[scene]\nrelief_mm = 1.0\n");
    let file = write(folder.path(), "mine.toml", "base = \"deep/base.toml\"\n\n[run]\nseed = 6\n");
    let today = write(folder.path(), "today.toml", "scene.relief_mm = 2.5\n");
    let layers = Layers::read(&args(&[&file, &today], &["scene.target=card", "arms.vs.start_deg=[1,2.5]"])).unwrap();
    assert_eq!(value(&layers, "run.seed"), ("6".into(), format!("{}:4:1", file.display())));
    assert_eq!(value(&layers, "scene.relief_mm"), ("2.5".into(), format!("{}:1:7", today.display())));
    assert_eq!(value(&layers, "scene.target"), ("\"card\"".into(), "--set".into()));
    assert_eq!(value(&layers, "arms.vs.start_deg").0, "[1, 2.5]");
    assert!(value(&layers, "servo.law").1.starts_with("built-in sim:"));
    assert!(base.exists() && !layers.effective().iter().any(|setting| setting.key == "base"));
}

#[test]
fn a_whole_setup_can_be_written_and_read_again() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["sim", "playground", "hil", "bare", "published"] {
        let layers = Layers::read(&args(&[Path::new(name)], &[])).unwrap();
        let file = write(folder.path(), "settings.toml", &toml_of(&layers.effective()));
        let again = read_layers(&args(&[&file], &[])).unwrap().layers;
        let values = |layers: &Layers| -> Vec<_> { layers.effective().into_iter().map(|s| (s.key, s.value)).collect() };
        assert_eq!(values(&again), values(&layers), "{name}");
    }
}

#[test]
fn a_file_over_another_does_not_bring_its_base_again() {
    let folder = tempfile::tempdir().unwrap();
    let first = write(folder.path(), "first.toml", "base = \"sim\"\nrun.seed = 5\n");
    let second = write(folder.path(), "second.toml", "base = \"sim\"\nscene.target = \"box\"\n");
    let layers = Layers::read(&args(&[&first, &second], &[])).unwrap();
    assert_eq!((value(&layers, "run.seed").0, value(&layers, "scene.target").0), ("5".into(), "\"box\"".into()));
    let other = write(folder.path(), "other.toml", "base = \"hil\"\n");
    assert!(refusal(&[&first, &other], &[]).contains("is not what the file or setup before it builds on"));
    let lost = write(folder.path(), "lost.toml", "base = \"simm\"\n");
    let text = refusal(&[&lost], &[]);
    assert!(text.contains("lost.toml") && text.contains("base: ") && text.contains("built-in are sim"), "{text}");
}

#[test]
fn a_stricter_action_takes_the_resume_of_the_base_away() {
    for action in ["stop", "fault"] {
        let setup = args(&[Path::new("sim")], &[&format!("supervisor.policies.target_lost.action={action}")]);
        assert!(read_layers(&setup).is_ok(), "{action}: {:?}", read_layers(&setup).err());
    }
    let stated = ["supervisor.policies.target_lost.action=stop", "supervisor.policies.target_lost.resume=by-itself"];
    assert!(refusal(&[Path::new("sim")], &stated).contains("target_lost.resume"));
}

#[test]
fn a_kind_takes_the_tables_of_other_kinds_away() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(
        folder.path(),
        "a.toml",
        "base = \"hil\"\n[arms.vs]\nbackend = \"mock\"\n[arms.tc]\nbackend = \"mock\"\n[run]\npace = \"fast\"\n",
    );
    let setup = read_layers(&args(&[&file], &[])).unwrap();
    assert!(setup.layers.origin_of("arms.vs.gateway").is_none() && setup.layers.origin_of("arms.vs.robot").is_some());
    let published = Layers::read(&args(&[Path::new("published")], &[])).unwrap();
    assert!(published.origin_of("servo.feed_forward").is_none() && published.origin_of("servo.gains").is_some());
    let without = write(folder.path(), "b.toml", "base = \"sim\"\nwithout = [\"servo.target.linear.rest\"]\n");
    assert!(read_layers(&args(&[&without], &[])).is_ok());
    let wrong = write(folder.path(), "c.toml", "base = \"sim\"\nwithout = [\"servo.no\"]\n");
    assert!(refusal(&[&wrong], &[]).contains("\"servo.no\" is not in the base"));
}

/// A simulation's limits never reach a real arm: all that is missing is named at once.
#[test]
fn a_real_arm_takes_nothing_from_a_built_in_setup() {
    let folder = tempfile::tempdir().unwrap();
    for base in ["sim", "hil", "rig"] {
        let text = format!("base = \"{base}\"\n[arms.vs]\nbackend = \"tcp\"\n");
        let text = refusal(&[&write(folder.path(), "real.toml", &text)], &[]);
        for key in ["mounts", "arms.vs.operating_range_deg", "arms.vs.acceleration_max_rad_per_s2", "arms.vs.gateway"] {
            assert!(text.contains(&format!("{key}: missing")), "{base}, {key}: {text}");
        }
        assert!(text.contains("`pb3dp config init arms` prints a file with all of them"), "{base}: {text}");
    }
    // The example of a rig states all of it, and what it leaves out of speed is slow.
    let example = built_in::RIG_EXAMPLE.replace("speed_scale = 0.10 ", "# ").replace("first_run = true ", "# ");
    let file = write(folder.path(), "rig.toml", &example);
    let setup = read_layers(&args(&[&file], &[])).unwrap();
    assert!(setup.layers.origin_of("arms.speed_scale").is_none() && setup.layers.origin_of("arms.first_run").is_none());
}

/// A typo is one problem: nothing else of the base is missing because of it.
#[test]
fn a_mistyped_backend_is_the_only_line_and_gets_the_nearest_word() {
    let folder = tempfile::tempdir().unwrap();
    for base in ["sim", "hil"] {
        let text = format!("base = \"{base}\"\n[arms.vs]\nbackend = \"tpc\"\n");
        let text = refusal(&[&write(folder.path(), "typo.toml", &text)], &[]);
        let lines: Vec<&str> = text.lines().skip(1).collect();
        assert!(lines.len() == 1 && lines[0].contains("found tpc") && lines[0].contains("did you mean tcp?"), "{text}");
    }
}

/// Every missing key is named, and the one line that would state them all.
#[test]
fn a_setup_without_a_base_is_refused_with_the_line_to_add() {
    let folder = tempfile::tempdir().unwrap();
    let whole = built_in::setup("sim").unwrap().text;
    let one_missing = whole.replacen("go_after_s = ", "# go_after_s = ", 1);
    assert_ne!(one_missing, whole);
    for text in
        ["", "[run]\nseed = 2\n", "[scene]\ntarget = \"card\"\n", "[arms.vs]\nbackend = \"tcp\"\n", &one_missing]
    {
        let text = refusal(&[&write(folder.path(), "mine.toml", text)], &[]);
        assert!(text.contains("add the first line base = \"sim\""), "{text}");
    }
}

#[test]
fn variables_do_not_command_a_real_arm_nor_hide_one() {
    let folder = tempfile::tempdir().unwrap();
    let file = write(folder.path(), "rig.toml", built_in::RIG_EXAMPLE);
    let with = |key: &str, value: &str| {
        let mut layers = Layers::default();
        layers.add_config(&file, Path::new("."), 0).unwrap();
        let real = layers.real_arms();
        let variable = Layer::of_words(Origin::Variable("PB3DP_X".to_owned()), key, value).unwrap();
        layers.push(variable.clone());
        layers.check_variables(&[variable], real).map_err(|error| error.to_string())
    };
    assert_eq!(with("run.seed", "5"), Ok(()));
    for (key, value) in [
        ("arms.first_run", "false"),
        ("arms.vs.gateway.port", "/dev/ttyUSB7"),
        ("arms.vs.backend", "mock"),
        ("mounts.flange_from_hand.translation_mm", "[0, 0, 0]"),
        ("servo.speed.linear_max_mm_per_s", "400.0"),
        ("experiment.channels", "[\"rz\"]"),
        ("camera.calibration", "[\"other.json\"]"),
        ("camera.left.device", "/dev/video3"),
        ("estimator.method", "published"),
        ("run.estimate_latency_millis", "5.0"),
    ] {
        assert!(with(key, value).unwrap_err().contains(&format!("PB3DP_X: sets {key}")), "{key}");
    }
}

#[test]
fn what_is_no_setup_is_refused_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let broken = write(folder.path(), "broken.toml", "base = \"sim\"\n[run\nseed = 5\n");
    assert!(refusal(&[&broken], &[]).contains("broken.toml:2:5"), "{}", refusal(&[&broken], &[]));
    let own = write(folder.path(), "own.toml", "base = \"own.toml\"\n");
    assert!(refusal(&[&own], &[]).contains("does one build on itself"));
    assert!(refusal(&[Path::new("simm")], &[]).contains("built-in are sim, playground, hil, rig, bare, published"));
    let sim = Path::new("sim");
    assert!(refusal(&[sim], &["scene.target"]).contains("write KEY=VALUE"));
    let all = refusal(&[sim], &["run.sed=3", "servo.speed.soft_start_s=-1", "arms.vs.start_deg=[1]", "run.pace=quick"]);
    for part in
        ["run.sed: unknown key; did you mean seed?", "soft_start_s = -1: allowed are 0 to 10 s", "1 numbers", "quick"]
    {
        assert!(all.contains(part), "{part}: {all}");
    }
}

#[test]
fn paths_lie_beside_the_file_that_states_them_and_bare_names_may_be_built_in() {
    let folder = tempfile::tempdir().unwrap();
    let elsewhere = write(folder.path(), "a.toml", "base = \"sim\"\narms.vs.robot = \"robots/pa10_gen2.urdf\"\n");
    assert!(refusal(&[&elsewhere], &[]).contains("robots/pa10_gen2.urdf cannot be read"), "a folder must be there");
    let bare = write(folder.path(), "b.toml", "base = \"sim\"\narms.vs.robot = \"pa10_gen1\"\n");
    let setup = read_layers(&args(&[&bare], &[])).unwrap();
    assert_ne!(setup.rig.arms.vs.chain.joint_names(), [""; 0]);
    assert!(
        read_layers(&args(&[Path::new("sim")], &["arms.carries_cameras=ur5e"])).unwrap().rig.arms.vs.chain.joints()
            == 6
    );
}
