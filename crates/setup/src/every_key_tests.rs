//! Every number of the repository's configurations is checked by its own key: far out of range, it is refused with file, key
//! and what is allowed; at either end of what is allowed, no part refuses it afterwards.

mod one_device;
mod real_arms;
mod shared_exposure;

use std::path::Path;

use toml::{Table, Value};

use super::estimator::read_estimator;
use super::layers::{Layers, SetupArgs};
use super::load::ConfigError;
use super::setup::read_setup;

/// Any number is a seed.
const ANY_NUMBER: [&str; 3] = ["run.seed", "estimator.published.rmga.seed", "published.rmga.seed"];

/// One of the repository's configurations, to be changed and read again.
struct Sample {
    folder: tempfile::TempDir,
    name: &'static str,
    table: Table,
    read: fn(&Path) -> Result<(), ConfigError>,
}

impl Sample {
    fn new(name: &'static str, read: fn(&Path) -> Result<(), ConfigError>) -> Self {
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let folder = tempfile::tempdir().unwrap();
        for inner in ["robots", "calibration"] {
            std::fs::create_dir(folder.path().join(inner)).unwrap();
        }
        let calibrations = ["calibration/nominal.json", "calibration/bare_truth.json"];
        for file in ["robots/pa10_gen1.urdf", "robots/pa10_gen2.urdf"].into_iter().chain(calibrations) {
            std::fs::copy(configs.join(file), folder.path().join(file)).unwrap();
        }
        Self { folder, name, table: table(name), read }
    }

    /// Paths of all numbers, elements of lists as `key[index]`.
    fn numbers(&self) -> Vec<(String, Value)> {
        let mut found = Vec::new();
        collect(&Value::Table(self.table.clone()), "", &mut found);
        found.retain(|(key, _)| !ANY_NUMBER.contains(&key.as_str()));
        found
    }

    /// Reads the file with one number changed; `None` if it is accepted.
    fn refusal(&self, key: &str, value: Value) -> Option<String> {
        self.refusal_of(&[(key.to_owned(), value)])
    }

    /// Reads the file with these numbers changed; `None` if it is accepted.
    fn refusal_of(&self, changes: &[(String, Value)]) -> Option<String> {
        let mut root = Value::Table(self.table.clone());
        for (key, value) in changes {
            *find(&mut root, key) = value.clone();
        }
        let file = self.folder.path().join(self.name);
        std::fs::write(&file, toml::to_string(&root).unwrap()).unwrap();
        (self.read)(&file).err().map(|error| error.to_string())
    }

    /// The line of a refusal that is about this key.
    fn line_about(&self, key: &str, value: Value) -> String {
        let stated = format!("{key} = {value}");
        let Some(text) = self.refusal(key, value) else { panic!("{stated} is accepted") };
        assert!(text.contains(self.name), "{text}");
        line_about(key, &text).unwrap_or_else(|| panic!("{stated}: the key is not named in {text}")).to_owned()
    }
}

fn line_about<'a>(key: &str, text: &'a str) -> Option<&'a str> {
    text.lines().find(|line| line.trim_start().starts_with(&format!("{key} = ")))
}

fn collect(value: &Value, key: &str, found: &mut Vec<(String, Value)>) {
    match value {
        Value::Table(table) => {
            for (name, inner) in table {
                let dot = if key.is_empty() { "" } else { "." };
                collect(inner, &format!("{key}{dot}{name}"), found);
            }
        }
        Value::Array(items) => {
            for (index, inner) in items.iter().enumerate() {
                collect(inner, &format!("{key}[{index}]"), found);
            }
        }
        Value::Integer(_) | Value::Float(_) => found.push((key.to_owned(), value.clone())),
        _ => {}
    }
}

fn find<'a>(root: &'a mut Value, key: &str) -> &'a mut Value {
    key.split('.').fold(root, |value, part| match part.strip_suffix(']').and_then(|part| part.split_once('[')) {
        Some((name, index)) => &mut value[name][index.parse::<usize>().unwrap()],
        None => &mut value[part],
    })
}

/// A number of the same type as the one in the file.
fn like(original: &Value, number: f64) -> Value {
    match original {
        Value::Integer(_) => Value::Integer(number as i64),
        _ => Value::Float(number),
    }
}

/// The ends of `... allowed are A to B`.
fn ends(line: &str) -> [f64; 2] {
    let (_, range) = line.split_once(": allowed are ").unwrap_or_else(|| panic!("no range in {line}"));
    let (min, max) = range.split_once(" to ").unwrap();
    [min, max].map(|end| end.split(' ').next().unwrap().parse().unwrap())
}

/// Every number of the sample; the ends of what is allowed for those whose keys begin so, as what it shares with `sim.toml` is checked there.
fn check_every_key(sample: &Sample, own: &str, at_least: usize) {
    let numbers = sample.numbers();
    assert!(numbers.len() >= at_least, "only {} numbers in {}", numbers.len(), sample.name);
    assert_eq!(sample.refusal_of(&[]), None);
    for absurd in [-1e12, f64::NAN, f64::INFINITY] {
        check_absurd(sample, &numbers, absurd);
    }
    let own: Vec<_> = numbers.iter().filter(|(key, _)| key.starts_with(own)).collect();
    assert!(!own.is_empty());
    for (key, original) in own {
        check_ends(sample, key, original);
    }
}

/// One number for all keys at once: a file is refused with a line for each key. What another mistake hides is refused alone.
fn check_absurd(sample: &Sample, numbers: &[(String, Value)], absurd: f64) {
    let can_be = |original: &Value| absurd.is_finite() || original.is_float();
    let changes = numbers.iter().filter(|(_, original)| can_be(original));
    let changes: Vec<_> = changes.map(|(key, original)| (key.clone(), like(original, absurd))).collect();
    let text = sample.refusal_of(&changes).unwrap();
    let hidden = changes.iter().filter(|(key, _)| line_about(key, &text).is_none());
    let alone = hidden.map(|(key, value)| sample.line_about(key, value.clone()));
    for line in text.lines().skip(1).map(str::to_owned).chain(alone).filter(|line| line.contains(": allowed are ")) {
        // A range may follow from another number, which is wrong here too.
        let [min, max] = ends(&line);
        assert!(min <= max && min.abs() <= 1e7 && max.abs() <= 1e7, "{line}");
    }
}

/// What is stated as allowed is allowed: at the ends of a range, other keys may be refused (whose ranges depend on this one)
/// or the list that it is in (the length of a vector, the files of a calibration), but not this key, and nothing by a name that is not
/// in the file.
fn check_ends(sample: &Sample, key: &str, original: &Value) {
    let mut all: Vec<String> = sample.numbers().into_iter().map(|(key, _)| key).collect();
    let calibration = sample.table.get("camera").and_then(|camera| camera.get("calibration"));
    all.extend(calibration.map(|_| "camera.calibration".to_owned()));
    let line = sample.line_about(key, like(original, 1e12));
    let [min, max] = ends(&line);
    assert!(min < max && min.abs() <= 1e7 && max.abs() <= 1e7, "{line}");
    for end in [min, max] {
        for line in sample.refusal(key, like(original, end)).iter().flat_map(|text| text.lines().skip(1)) {
            let named = line.trim_start().split([' ', ':']).next().unwrap();
            assert!(
                named != key && all.iter().any(|key| key == named || key.starts_with(&format!("{named}["))),
                "{key} = {end}: {line}"
            );
        }
    }
}

#[test]
fn every_number_of_the_setup_is_refused_by_its_own_key() {
    check_every_key(&Sample::new("sim.toml", |file| read_setup(file).map(drop)), "", 220);
}

#[test]
fn every_number_of_arms_behind_lines_is_refused_by_its_own_key() {
    check_every_key(&Sample::new("hil.toml", |file| read_setup(file).map(drop)), "arms.", 220);
}

#[test]
fn every_number_of_a_truth_and_of_calibrations_is_refused_by_its_own_key() {
    let mut sample = Sample::new("bare.toml", |file| read_setup(file).map(drop));
    change_lines(&mut sample.table, "camera.calibration = [\"calibration/nominal.json\"]");
    change_lines(&mut sample.table, "camera.calibration_age_max_days = 30.0");
    check_every_key(&sample, "camera.", 240);
    check_every_key(&sample, "truth.", 240);
}

#[test]
fn every_number_of_the_published_law_is_refused_by_its_own_key() {
    check_every_key(&Sample::new("published.toml", |file| read_setup(file).map(drop)), "servo.", 220);
}

#[test]
fn every_number_of_real_cameras_is_refused_by_its_own_key() {
    let mut sample = Sample::new("rig.toml", |file| read_setup(file).map(drop));
    change_lines(&mut sample.table, "camera.left.input = 2\ncamera.left.stated_exposure_millis = 3.5");
    // On a first run not every speed that is allowed elsewhere is.
    change_lines(&mut sample.table, "arms.first_run = false");
    for arm in ["vs", "tc"] {
        change_lines(&mut sample.table, &format!("arms.{arm}.backend = \"emulated\""));
        for key in ["port", "baud"] {
            change_lines(&mut sample.table, &format!("-arms.{arm}.gateway.{key}"));
        }
    }
    check_every_key(&sample, "camera.", 220);
    check_every_key(&sample, "arms.", 220);
    check_every_key(&sample, "supervisor.", 220);
}

fn check_refused(sample: &Sample, expected: &str) {
    let text = sample.refusal_of(&[]).unwrap_or_else(|| panic!("accepted: {expected}"));
    assert!(text.contains(expected), "{expected} is not in {text}");
}

/// What is in a file of the repository is refused after a change, with the words beside it. A change is further lines of TOML, or `-` and the
/// key to remove.
fn check_lines(rows: &[(&'static str, &str, &str)]) {
    for &(name, lines, expected) in rows {
        let mut sample = Sample::new(name, |file| read_setup(file).map(drop));
        change_lines(&mut sample.table, lines);
        check_refused(&sample, expected);
    }
}

fn change_lines(root: &mut Table, lines: &str) {
    fn merge(into: &mut Table, from: Table) {
        for (key, value) in from {
            match (into.get_mut(&key), value) {
                (Some(Value::Table(inner)), Value::Table(changed)) => merge(inner, changed),
                (_, value) => drop(into.insert(key, value)),
            }
        }
    }
    match lines.strip_prefix('-') {
        Some(key) => {
            let (tables, last) = key.rsplit_once('.').unwrap_or(("", key));
            let table = tables
                .split('.')
                .filter(|name| !name.is_empty())
                .fold(root, |table, name| table[name].as_table_mut().unwrap());
            assert!(table.remove(last).is_some(), "{key}");
        }
        None => merge(root, lines.parse().unwrap()),
    }
}

/// What is calibrated or truly elsewhere stands in one place only, and in files that fit.
#[test]
fn calibrations_and_truths_that_do_not_fit_are_refused() {
    let truth = format!("truth = {}", table("bare.toml")["truth"]);
    check_lines(&[
        ("rig.toml", &truth, "truth: with camera.backend = \"v4l2\" nobody knows it"),
        ("bare.toml", "truth.calibration = [\"no.json\"]", "truth.calibration: "),
        ("bare.toml", "camera.width_px = 320", "truth.calibration: "),
        (
            "rig.toml",
            "camera.waived_gates = [\"rows until 2027-01-31\"]",
            "camera.waived_gates: \"rows\" is no gate of",
        ),
        ("rig.toml", "camera.waived_gates = [\"age\"]", "camera.waived_gates: \"age\" has no last day"),
        ("sim.toml", "mounts.hand_eye = \"hand_eye.toml\"", "both are set"),
    ]);
    let mut elsewhere = Sample::new("sim.toml", |file| read_setup(file).map(drop));
    change_lines(&mut elsewhere.table, "-mounts.hand_from_cam_left");
    change_lines(&mut elsewhere.table, "mounts.hand_eye = \"hand_eye.toml\"");
    check_refused(&elsewhere, "mounts.hand_eye: ");
}

/// Each backend of the cameras has keys of its own, and what goes with it.
#[test]
fn keys_of_other_cameras_are_refused_with_key_and_backend() {
    let sim = table("sim.toml");
    let scene = format!("scene = {}", sim["scene"]);
    let geometric = format!("estimator.geometric = {}", sim["estimator"]["geometric"]);
    check_lines(&[
        ("rig.toml", "camera.focal_px = 740.0", "camera.focal_px: unknown key"),
        ("rig.toml", "camera.focal_px = 740.0", "(with camera.backend = \"v4l2\")"),
        ("sim.toml", "camera.format = \"YUYV\"", "(with camera.backend = \"sim\")"),
        ("sim.toml", "-scene", "scene: missing; camera.backend = \"sim\""),
        ("rig.toml", &scene, "scene: camera.backend = \"v4l2\""),
        ("rig.toml", "run.pace = \"fast\"", "run.pace: real cameras do not wait"),
        ("rig.toml", "experiment.target = \"free\"", "experiment.target = \"free\": only a simulated target"),
        ("rig.toml", &geometric, "estimator.geometric: with camera.backend = \"v4l2\""),
        (
            "rig.toml",
            "camera.format = \"H264\"",
            "camera.format: \"H264\" is not a supported pixel format; use one of: YUYV, RGB3",
        ),
        ("rig.toml", "camera.region = \"circle:3\"", "camera.region: region \"circle:3\" is not understood"),
        (
            "rig.toml",
            "camera.region = \"rect:600,400,100,50\"",
            "camera.region: the corner 700,400 is outside of the left image, which has 640x480 pixels",
        ),
        (
            "rig.toml",
            "camera.frame_rate_hz = 2.0",
            "supervisor.policies.frame_stale.age_s = 0.25: allowed are 0.99 to 1",
        ),
        ("rig.toml", "camera.calibration = [\"no.yaml\"]", "camera.calibration: "),
        ("rig.toml", "camera.width_px = 320", "is for images of 640x480, the cameras are asked for 320x480"),
        ("rig.toml", "-camera.reopen_for_s", "camera.reopen_for_s: missing"),
        ("rig.toml", "camera.backend = \"usb\"", "camera.backend"),
    ]);
}

/// Each camera has a device of its own, and says of each control who chooses.
#[test]
fn eyes_that_are_no_cameras_are_refused() {
    let of_left = format!("camera.right.device = {}", table("rig.toml")["camera"]["left"]["device"]);
    let twice = "camera.right.further_controls = [{ id = 0x98f901, value = -3 }, { id = 0x98f901, value = -3 }]";
    check_lines(&[
        ("rig.toml", &of_left, "camera.left.device is the same"),
        (
            "rig.toml",
            "camera.right.device = \"the right one\"",
            "camera.right.device: `the right one` is not a camera name",
        ),
        ("rig.toml", "camera.right.gain = \"much\"", "camera.right.gain"),
        ("rig.toml", "camera.right.gain = \"much\"", "\"keep\""),
        ("rig.toml", "camera.right.gain = 3.5", "camera.right.gain"),
        ("rig.toml", "camera.right.gain = 3.5", "a whole one"),
        ("rig.toml", "camera.right.gaim = 3", "camera.right.gaim: unknown key"),
        ("rig.toml", twice, "further_controls[1].id = 10025217: further_controls[0] sets the same control"),
        (
            "rig.toml",
            "camera.right.further_controls = [{ id = 1099511627776, value = 1 }]",
            "camera.right.further_controls[0].id = 1099511627776: allowed are 1 to",
        ),
        (
            "rig.toml",
            "camera.right.exposure_millis = 50.0",
            "camera.right.exposure_millis = 50: allowed are 0.1 to 33.3",
        ),
    ]);
    for accepted in ["gain = \"keep\"", "gain = \"auto\"", "further_controls = [{ id = 0x98f901, value = -3 }]"] {
        let mut sample = Sample::new("rig.toml", |file| read_setup(file).map(drop));
        change_lines(&mut sample.table, &format!("camera.right.{accepted}"));
        assert_eq!(sample.refusal_of(&[]), None);
    }
}

fn table(name: &str) -> Table {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs").join(name);
    // With all that its base says.
    Layers::read(&SetupArgs::of_file(&file)).unwrap().figment().extract().unwrap()
}

/// A law has its own tables, and only these.
#[test]
fn tables_that_do_not_fit_the_law_are_refused() {
    let refusal = |name: &'static str, change: &dyn Fn(&mut Table)| {
        let mut sample = Sample::new(name, |file| read_setup(file).map(drop));
        change(sample.table["servo"].as_table_mut().unwrap());
        sample.refusal("run.seed", Value::Integer(1))
    };
    for (name, law, tables) in [
        ("sim.toml", "feed-forward", &["arm_response", "feed_forward", "null_motion", "unstated", "target"][..]),
        ("published.toml", "published", &["gains", "smoothing"]),
    ] {
        for table in tables {
            let text = refusal(name, &|servo| drop(servo.remove(*table))).unwrap();
            let expected = format!("servo.{table}: missing; servo.law = \"{law}\" needs it");
            assert!(text.contains(&expected), "{text}");
        }
        let other = if law == "published" { "feed-forward" } else { "published" };
        let text = refusal(name, &|servo| servo["law"] = other.into()).unwrap();
        for table in tables {
            let expected = format!("servo.{table}: servo.law = \"{other}\" has no such table");
            assert!(text.contains(&expected), "{text}");
        }
    }
    assert!(refusal("sim.toml", &|servo| servo["law"] = "fastest".into()).unwrap().contains("servo.law"));
    assert!(refusal("sim.toml", &|servo| drop(servo.remove("law"))).unwrap().contains("servo.law: missing"));
    // A target that never rests is a model of its own.
    let never_rests = |servo: &mut Table| {
        for part in ["linear", "angular"] {
            servo["target"][part].as_table_mut().unwrap().remove("rest");
        }
    };
    assert_eq!(refusal("sim.toml", &never_rests), None);
}

/// Laws for comparison, each with its own table beside the smoothing.
#[test]
fn every_number_of_the_laws_for_comparison_is_refused_by_its_own_key() {
    for (law, numbers) in [
        ("law = \"image-based\"", "image_based = { gain_per_s = 4.0, half_width_mm = 50.0 }"),
        ("law = \"hybrid\"", "hybrid = { gain_per_s = 4.0 }"),
    ] {
        let mut sample = Sample::new("published.toml", |file| read_setup(file).map(drop));
        change_lines(&mut sample.table, "-servo.gains");
        change_lines(&mut sample.table, &format!("[servo]\n{law}\n{numbers}"));
        check_every_key(&sample, "servo.", 217);
    }
}

/// A search is asked for twice, and off otherwise.
#[test]
fn a_search_needs_its_pattern_and_its_permission() {
    let mut sample = Sample::new("sim.toml", |file| read_setup(file).map(drop));
    let numbers = "back_mm = 30.0, radius_mm = 20.0, turns = 2.0, speed_mm_per_s = 20.0, time_s = 20.0";
    change_lines(&mut sample.table, &format!("servo.search = {{ {numbers} }}"));
    check_refused(&sample, "servo.search: no search is permitted without supervisor.search_max_s");
    change_lines(&mut sample.table, "supervisor.search_max_s = 20.0");
    assert_eq!(sample.refusal_of(&[]), None);
    check_every_key(&sample, "servo.search.", 220);
}

/// What a setup whose arms are behind lines refuses.
#[test]
fn ways_to_an_arm_that_do_not_fit_are_refused() {
    let other = table("hil.toml")["arms"]["vs"]["robot"].as_str().unwrap().replace("gen2", "gen1");
    let other = format!("arms.vs.robot = {other:?}");
    let live = "run.pace = \"fast\"\n[arms.vs]\nbackend = \"tcp\"\n\
        gateway = { address = \"127.0.0.1:4601\", key_file = \"arm.key\" }";
    check_lines(&[
        (
            "hil.toml",
            "arms.vs.gateway.certificate = \"arm.crt\"",
            "arms.vs.gateway.certificate: this key is gone: the key file alone protects the link to a gateway; remove this one",
        ),
        (
            "hil.toml",
            "arms.vs.gateway = { port = \"/dev/ttyUSB0\", baud = 921600 }",
            "backend = \"emulated\" needs no port, baud, address, key_file or socket: remove port and baud",
        ),
        ("hil.toml", live, "(arms.vs.backend) needs pace = \"live\""),
        ("hil.toml", "-arms.vs.gateway", "arms.vs.gateway: missing"),
        ("hil.toml", "arms.vs.backend = \"mock\"", "arms.vs.gateway: an arm with backend = \"mock\" has none"),
        ("hil.toml", "arms.vs.backend = \"serial\"", "\"serial\" needs port and baud: add port and baud"),
        ("hil.toml", "arms.vs.backend = \"tcp\"", "\"tcp\" needs address and key_file: add address and key_file"),
        ("hil.toml", "arms.vs.backend = \"local\"", "\"local\" needs socket: add socket"),
        (
            "hil.toml",
            "[arms.vs]\nbackend = \"local\"\ngateway = { socket = \"local:/run/arm1.sock\" }",
            "arms.vs.gateway.socket = \"local:/run/arm1.sock\": write the path alone, \"/run/arm1.sock\"",
        ),
        ("hil.toml", "arms.vs.backend = \"usb\"", "arms.vs.backend"),
        (
            "hil.toml",
            "arms.vs.gateway.geometry = \"first-generation\"",
            "arms.vs.gateway.geometry = \"first-generation\": such an arm has 315.0, 450.0, 500.0, 80.0 mm from base to shoulder, \
             elbow, wrist and flange, arms.vs.robot has 317.0, 450.0, 480.0, 70.0 mm; measure the arm",
        ),
        ("hil.toml", &other, "arms.vs.gateway.geometry = \"second-generation\""),
        (
            "hil.toml",
            "arms.vs.backend = \"arcnet\"",
            "arms.vs.backend = \"arcnet\": this word is gone: the gateway is the only",
        ),
        ("hil.toml", "arms.vs.bus = { arm = 1 }", "arms.vs.bus: this key is gone: the gateway is the only"),
        (
            "hil.toml",
            "arms.vs.gateway.dialect = \"transparent\"",
            "arms.vs.gateway.dialect = \"transparent\": this word is gone: host and gateway have one set of messages; remove the key",
        ),
    ]);
    let mut sample = Sample::new("hil.toml", |file| read_setup(file).map(drop));
    change_lines(&mut sample.table, "arms.vs.gateway.dialect = \"gateway-v1\"");
    assert_eq!(sample.refusal_of(&[]), None, "setups of earlier versions, in recordings too");
    let serial = "backend = \"serial\"\ngateway = { port = \"/dev/ttyUSB0\", baud = 921600 }";
    change_lines(&mut sample.table, &format!("[arms.vs]\n{serial}"));
    assert_eq!(sample.refusal_of(&[]), None);
    let line = sample.line_about("arms.vs.gateway.baud", Value::Integer(300));
    assert_eq!(ends(&line), [9600.0, 12_000_000.0]);
    let text = sample.refusal("arms.vs.gateway.baud", Value::Integer(9600)).unwrap();
    assert!(text.contains("arms.vs.gateway.baud: 9600 baud take") && text.contains("at least 350000 baud"), "{text}");
}

/// Addresses are numbers, and each arm has its own.
#[test]
fn addresses_that_lead_nowhere_or_to_both_arms_are_refused() {
    let refusal = |vs: &str, tc: &str| {
        let mut sample = Sample::new("hil.toml", |file| read_setup(file).map(drop));
        for (name, address) in [("vs", vs), ("tc", tc)] {
            let gateway = format!("{{ address = {address:?}, key_file = \"arm.key\" }}");
            change_lines(&mut sample.table, &format!("[arms.{name}]\nbackend = \"tcp\"\ngateway = {gateway}"));
        }
        sample.refusal_of(&[])
    };
    assert_eq!(refusal("127.0.0.1:4601", "127.0.0.1:4602"), None);
    for wrong in ["localhost:4601", "127.0.0.1", "4601", ""] {
        let text = refusal(wrong, "127.0.0.1:4602").unwrap();
        let expected = format!("arms.vs.gateway.address = {wrong:?}: allowed are the number of a computer and a port");
        assert!(text.contains(&expected), "{text}");
    }
    let text = refusal("127.0.0.1:4601", "127.0.0.1:4601").unwrap();
    let expected = "arms.tc.gateway.address = \"127.0.0.1:4601\": arms.vs.gateway.address is the same";
    assert!(text.contains(expected), "{text}");
}

#[test]
fn every_number_of_the_estimator_is_refused_by_its_own_key() {
    check_every_key(&Sample::new("estimator.toml", |file| read_estimator(file).map(drop)), "", 75);
}

#[test]
fn frames_that_are_far_apart_are_refused_by_length() {
    let mut sample = Sample::new("sim.toml", |file| read_setup(file).map(drop));
    // Each component is allowed, their length is not.
    change_lines(&mut sample.table, "mounts.flange_from_hand.translation_mm = [4000.0, -4000.0, 4000.0]");
    check_refused(&sample, "mounts.flange_from_hand.translation_mm (its length) = 6928.2");
    check_refused(&sample, "allowed are 0 to 5000");
}

/// Tables whose parts declare the ranges, and the keys in them that no part checks.
const TABLES_OF_PARTS: [(&str, &str, &[&str]); 9] = [
    ("setup/servo.rs", include_str!("setup/servo.rs"), &[]),
    ("setup/target_state.rs", include_str!("setup/target_state.rs"), &[]),
    ("setup/supervisor.rs", include_str!("setup/supervisor.rs"), &[]),
    ("setup/range.rs", include_str!("setup/range.rs"), &[]),
    ("setup/geometric.rs", include_str!("setup/geometric.rs"), &[]),
    ("setup/camera.rs", include_str!("setup/camera.rs"), &["focal_px", "baseline_mm", "distortion", "exposure_millis"]),
    ("setup/camera_faults.rs", include_str!("setup/camera_faults.rs"), &["stamped_millis", "{key}"]),
    ("direct.rs", include_str!("direct.rs"), &[]),
    (
        "estimator.rs",
        include_str!("estimator.rs"),
        &[
            "area_min_px",
            "click_hue_tolerance_deg",
            "click_luminance_tolerance",
            "click_chroma_min",
            "click_area_share_max",
            "coloured_share_warn",
            "luminance_deviation_warn",
        ],
    ),
];

/// A range that a part declares is not stated a second time in the table of the part.
#[test]
fn ranges_of_parts_are_stated_by_the_parts_only() {
    for (file, text, own) in TABLES_OF_PARTS {
        let has_range = |line: &&str| line.contains("..=") && (line.contains("check.") || line.contains("=>"));
        for line in text.lines().filter(has_range) {
            let states_a_number = line.split("..=").skip(1).any(|end| end.starts_with(|c: char| c.is_ascii_digit()));
            let is_own = own.iter().any(|key| line.contains(&format!("{key}\"")) || line.contains(&format!("{key}: ")));
            assert!(!states_a_number || is_own, "{file} repeats a range of a part: {line}");
        }
    }
}
