//! Comparisons of small recordings with numbers derived by hand.

use std::f64::consts::FRAC_1_SQRT_2;
use std::path::{Path, PathBuf};

use pb3dp_bag::messages::{Message, Text};
use pb3dp_bag::run_messages::{ArmCall, ControlStep, Marked, PairResult, RunBegin};
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_geometry::MonotonicTime;
use pb3dp_record::metrics::Statistics;
use tempfile::TempDir;

use super::Comparison;
use super::estimates::EstimatePair;

/// Begin of each run on its clock.
const BEGIN_MILLIS: u64 = 1000;
/// No rotation, and 90 degrees about z, as x, y, z, w.
const UPRIGHT: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
const QUARTER_TURN: [f64; 4] = [0.0, 0.0, FRAC_1_SQRT_2, FRAC_1_SQRT_2];

/// What is written into a recording.
#[derive(Clone)]
struct Run {
    version: &'static str,
    settings: Option<&'static str>,
    has_begin: bool,
    pairs: Vec<PairResult>,
    steps: Vec<ControlStep>,
}

fn run(pairs: Vec<PairResult>, steps: Vec<ControlStep>) -> Run {
    Run { version: "1", settings: Some("pace = \"fast\" # a"), has_begin: true, pairs, steps }
}

fn pose([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> Vec<f64> {
    vec![x, y, z, i, j, k, w]
}

/// A pair at 30 Hz.
fn pair(sequence: u64, cam_left_from_model: Vec<f64>) -> PairResult {
    PairResult {
        sequence,
        exposed_at_nanos: 1_000_000 * (BEGIN_MILLIS + 33 * sequence),
        has_images: true,
        target: 1,
        status: "ok".to_owned(),
        cam_left_from_model,
        rotation_about_normal_observed: true,
        outline_px: vec![1.0, 2.0],
        latency_millis: 2.0,
        age_millis: 3.0,
        ..PairResult::default()
    }
}

fn with_truth(pair: PairResult, cam_left_from_target: Vec<f64>) -> PairResult {
    PairResult { cam_left_from_target, ..pair }
}

/// A step at 100 Hz.
fn step(number: u64, state: &str, calls: Vec<ArmCall>) -> ControlStep {
    ControlStep {
        number,
        at_nanos: 1_000_000 * (BEGIN_MILLIS + 10 * number),
        calls,
        finished: true,
        mode: "tracking".to_owned(),
        state: state.to_owned(),
        ..ControlStep::default()
    }
}

fn call(arm: u8, call: &str, command_rad_per_s: &[f64]) -> ArmCall {
    ArmCall {
        arm,
        call: call.to_owned(),
        command_rad_per_s: command_rad_per_s.to_vec(),
        outcome: "measured".to_owned(),
        ..ArmCall::default()
    }
}

fn write(file: &Path, run: &Run) {
    fn push<M: Message>(writer: &mut BagWriter, topic: &'static str, at_nanos: u64, message: &M) {
        writer.push(topic, MonotonicTime::from_nanos(at_nanos), message);
    }
    let mut writer = BagWriter::create(file, WhenFull::Wait).unwrap();
    push(&mut writer, ours::VERSION, 0, &Text { data: run.version.to_owned() });
    if let Some(settings) = run.settings {
        push(&mut writer, ours::SETUP, 0, &Text { data: settings.to_owned() });
    }
    if run.has_begin {
        let begin = RunBegin {
            begin_nanos: 1_000_000 * BEGIN_MILLIS,
            since_1970_nanos: 0,
            is_person: false,
            can_fall_silent: false,
            marking: Marked::default(),
            target_of_setup: Vec::new(),
        };
        push(&mut writer, ours::BEGIN, 0, &begin);
    }
    run.pairs.iter().for_each(|pair| push(&mut writer, ours::PAIRS, pair.exposed_at_nanos, pair));
    run.steps.iter().for_each(|step| push(&mut writer, ours::STEPS, step.at_nanos, step));
    writer.finish().unwrap();
}

fn compared(a: &Run, b: &Run) -> Comparison {
    let folder = TempDir::new().unwrap();
    let files = [("a.mcap", a), ("b.mcap", b)].map(|(name, run)| {
        let file = folder.path().join(name);
        write(&file, run);
        file
    });
    Comparison::of_files(&files[0], &files[1]).unwrap()
}

fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9, "{found} is not {expected}");
}

fn check(found: Option<Statistics>, [median, p95, max]: [f64; 3]) {
    let found = found.unwrap();
    close(found.median, median);
    close(found.p95, p95);
    close(found.max, max);
}

#[test]
fn a_recording_equals_itself() {
    let steps = vec![step(0, "idle", vec![call(0, "move", &[0.1; 7])]), step(1, "tracking", Vec::new())];
    let run = run(vec![pair(0, pose([0.1, 0.2, 0.5], QUARTER_TURN)), pair(1, Vec::new())], steps);
    let found = compared(&run, &run);
    assert!(found.is_equal());
    let text = found.text();
    assert!(text.ends_with("equal to the bit") && text.contains("2 pairs matched by number, 0 differ\n"), "{text}");
    assert_eq!(found.estimates.offset.angle_deg.map(|angle| angle.max), Some(0.0));
}

#[test]
fn poses_are_compared_by_distance_and_angle() {
    let steps = vec![step(0, "idle", Vec::new())];
    let at_rest = pose([0.0, 0.0, 0.5], UPRIGHT);
    let a = run((0..4).map(|number| pair(number, at_rest.clone())).collect(), steps.clone());
    // 0, then 3-4-5, then 6-8-10 with a quarter turn, then none.
    let mut b = run(
        vec![
            pair(0, at_rest),
            pair(1, pose([0.003, 0.004, 0.5], UPRIGHT)),
            pair(2, pose([0.006, 0.008, 0.5], QUARTER_TURN)),
            PairResult { status: "lost".to_owned(), ..pair(3, Vec::new()) },
        ],
        steps,
    );
    b.pairs[2].latency_millis = 5.0;
    let found = compared(&a, &b);
    // 95 % of [0, 5, 10]: position 1.9, 0.9 of the way from 5 to 10; of [0, 0, 90]: 0.9 of the way to 90.
    check(found.estimates.offset.distance_mm, [5.0, 9.5, 10.0]);
    check(found.estimates.offset.angle_deg, [0.0, 81.0, 90.0]);
    assert_eq!((found.estimates.same_status, found.estimates.pose_in_one_only), (3, [1, 0]));
    assert_eq!(found.estimates.latency_ms[2].map(|latency| latency.max), Some(3.0));
    assert_eq!((found.estimates.matched.differing, found.estimates.matched.first), (3, Some(([1, 1], 0.033))));
    let text = found.text();
    assert!(text.contains("the first at 0.033 s (pair 1); with a pose in A only: 1, in B only: 0"), "{text}");
    assert!(text.contains("same status: 3 of 4 pairs, 75.0 %") && text.ends_with("the runs differ"), "{text}");
}

/// The target moves by 10 mm along x, then turns by 90 degrees about its z. A has its model frame 100 mm beside the target, B has an
/// error of 2 mm in the second pair.
fn runs_with_truth() -> [Run; 2] {
    let truth = [([0.0, 0.0], UPRIGHT), ([0.01, 0.0], UPRIGHT), ([0.01, 0.0], QUARTER_TURN)];
    let a = [([0.1, 0.0], UPRIGHT), ([0.11, 0.0], UPRIGHT), ([0.01, 0.1], QUARTER_TURN)];
    let b = [([0.0, 0.0], UPRIGHT), ([0.012, 0.0], UPRIGHT), ([0.01, 0.0], QUARTER_TURN)];
    [a, b].map(|poses| {
        let at = |([x, y], rotation): ([f64; 2], [f64; 4])| pose([x, y, 0.5], rotation);
        let pairs = (0..3).map(|k| with_truth(pair(k as u64, at(poses[k])), at(truth[k]))).collect();
        run(pairs, vec![step(0, "idle", Vec::new())])
    })
}

#[test]
fn the_place_of_the_model_frame_on_the_target_is_no_error() {
    let [a, b] = runs_with_truth();
    let found = compared(&a, &b);
    // Rounding of the quaternions reaches 1e-16 m.
    check(found.estimates.errors[0].distance_mm, [0.0, 0.0, 0.0]);
    // 95 % of [0, 0, 2]: 0.9 of the way from 0 to 2.
    check(found.estimates.errors[1].distance_mm, [0.0, 1.8, 2.0]);
    check(found.estimates.moved.distance_mm, [0.0, 1.8, 2.0]);
    assert_eq!(found.estimates.offset.distance_mm.map(|distance| distance.max.round()), Some(100.0));
    assert!(found.text().contains("position error of B, mm"));
}

#[test]
fn a_target_that_is_initialised_again_has_a_new_first_estimate() {
    let [a, mut b] = runs_with_truth();
    b.pairs[1].target = 2;
    b.pairs[2].target = 2;
    b.pairs[2].cam_left_from_model = pose([0.012, 0.0, 0.5], QUARTER_TURN);
    let found = compared(&a, &b);
    let errors: Vec<f64> =
        found.estimates.pairs.iter().filter_map(|pair| pair.errors[1]).map(|e| e.distance_mm).collect();
    // The true target turns about its own origin; the motion of B turns about a point 2 mm along x, which moves this origin by 2 mm along
    // x and -2 mm along y.
    assert_eq!(errors.len(), 3);
    close(errors[0], 0.0);
    close(errors[1], 0.0);
    close(errors[2], 8.0_f64.sqrt());
}

#[test]
fn runs_with_other_times_match_by_the_nearest_time() {
    let steps = vec![step(0, "idle", Vec::new())];
    let at_rest = pose([0.0, 0.0, 0.5], UPRIGHT);
    let a = run((0..3).map(|number| pair(number, at_rest.clone())).collect(), steps.clone());
    // 10 ms later: the last of B at 76 ms belongs to the last of A at 66 ms; B has no partner for 0 ms.
    let later = |number| {
        let pair = pair(number, at_rest.clone());
        PairResult { exposed_at_nanos: pair.exposed_at_nanos + 10_000_000, ..pair }
    };
    let b = run(vec![later(1), later(2)], steps);
    let found = compared(&a, &b);
    let partners: Vec<[usize; 2]> = found.estimates.pairs.iter().map(|pair: &EstimatePair| pair.at).collect();
    assert_eq!((partners, found.estimates.matched.matching.alone), (vec![[1, 0], [2, 1]], [1, 0]));
    // Every estimate is the same, but one pair is missing.
    assert!(found.estimates.matched.differing == 0 && !found.is_equal());
    assert!(found.text().contains("2 pairs matched by time, 0 differ; without a partner: 1 of A, 0 of B"));
}

#[test]
fn filtered_poses_are_compared_step_by_step() {
    let filtered = |number, x| ControlStep {
        base_from_model: pose([x, 0.0, 1.0], UPRIGHT),
        ..step(number, "tracking", Vec::new())
    };
    let a = run(Vec::new(), vec![filtered(0, 0.0), filtered(1, 0.1), step(2, "tracking", Vec::new())]);
    let b = run(Vec::new(), vec![filtered(0, 0.0), filtered(1, 0.104), filtered(2, 0.2)]);
    let found = compared(&a, &b).filter;
    // 95 % of [0, 4]: 0.95 of the way.
    check(found.offset.distance_mm, [2.0, 3.8, 4.0]);
    assert_eq!(
        (found.matched.differing, found.matched.first, found.pose_in_one_only),
        (2, Some(([1, 1], 0.01)), [0, 1])
    );
}

#[test]
fn commands_are_compared_joint_by_joint_and_a_hold_is_zero() {
    let velocity = |second_joint| [0.1, second_joint, 0.0, 0.0, 0.0, 0.0, -0.1];
    let calls = |second_joint, tc: ArmCall| vec![call(0, "move", &velocity(second_joint)), tc];
    let hold = || call(1, "hold", &[]);
    let a = run(Vec::new(), vec![step(0, "tracking", calls(0.0, hold())), step(1, "tracking", calls(0.3, hold()))]);
    let still = call(1, "move", &[0.0; 7]);
    let b = run(Vec::new(), vec![step(0, "tracking", calls(0.0, hold())), step(1, "tracking", calls(0.1, still))]);
    let found = compared(&a, &b);
    let [vs, tc] = found.commands.arms;
    // One of 14 differences is 0.2 rad/s.
    close(vs.rms_rad_per_s.unwrap(), (0.2_f64 * 0.2 / 14.0).sqrt());
    close(vs.max_rad_per_s.unwrap(), 0.2);
    assert_eq!((vs.steps, vs.first_beyond_s), (2, Some(0.01)));
    assert_eq!((tc.steps, tc.max_rad_per_s, tc.first_beyond_s), (2, Some(0.0), None));
    assert_eq!(found.commands.matched.differing, 1);
    assert!(!found.is_equal());
}

#[test]
fn changes_of_state_are_side_by_side_with_the_time_in_each_state() {
    let steps = |states: &[&str]| -> Vec<ControlStep> {
        states.iter().enumerate().map(|(number, state)| step(number as u64, state, Vec::new())).collect()
    };
    let a = run(Vec::new(), steps(&["idle", "idle", "tracking", "tracking", "stopped"]));
    let mut b = run(Vec::new(), steps(&["idle", "tracking", "holding", "holding", "stopped"]));
    b.steps[2].why = "lost".to_owned();
    let found = compared(&a, &b);
    let text = found.text();
    let row = |a: &str, b: &str| text.contains(&format!("    {a:<40}{b}\n"));
    assert!(row("0.000 s begins idle", "0.000 s begins idle"), "{text}");
    assert!(row("0.020 s idle -> tracking", "0.010 s idle -> tracking"), "{text}");
    assert!(row("-", "0.020 s tracking -> holding"), "{text}");
    let seconds: Vec<(&str, [f64; 2])> = found.decisions.seconds.iter().map(|(state, s)| (&**state, *s)).collect();
    let [holding, idle, tracking] = &seconds[..] else { panic!("{seconds:?}") };
    assert_eq!([holding.0, idle.0, tracking.0], ["holding", "idle", "tracking"]);
    for (found, expected) in [(holding.1, [0.0, 0.02]), (idle.1, [0.02, 0.01]), (tracking.1, [0.02, 0.01])] {
        close(found[0], expected[0]);
        close(found[1], expected[1]);
    }
    // The reason of the third step holds for the fourth and the fifth as well.
    assert_eq!((found.decisions.matched.differing, found.decisions.matched.first), (4, Some(([1, 1], 0.01))));
}

#[test]
fn other_versions_and_settings_are_reported_but_no_difference_of_the_runs() {
    let a = run(Vec::new(), vec![step(0, "idle", Vec::new())]);
    let b = Run { version: "2", settings: Some("pace = \"real\" # b\n[servo]\ngain = 1.0"), ..a.clone() };
    let found = compared(&a, &b);
    let text = found.text();
    assert!(text.contains("version    differs\n    A  1\n    B  2\n"), "{text}");
    assert!(text.contains("settings   2 of 2 differ\n    pace\n        A  \"fast\"\n        B  \"real\"\n"), "{text}");
    assert!(text.contains("    servo.gain\n        A  (not stated)\n        B  1.0\n"), "{text}");
    assert!(found.is_equal() && text.ends_with("equal to the bit, with other settings"), "{text}");
}

#[test]
fn a_page_and_a_table_are_written() {
    let [a, b] = runs_with_truth();
    let folder = TempDir::new().unwrap();
    let found = compared(&a, &b);
    let [page, table] = found.write(&folder.path().join("new")).unwrap();
    let page = std::fs::read_to_string(page).unwrap();
    assert!(page.contains("the runs differ") && page.matches("<figure class=\"plot\">").count() > 10);
    let table = std::fs::read_to_string(table).unwrap();
    let lines: Vec<Vec<&str>> = table.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(lines.len(), 4);
    assert!(lines.iter().all(|line| line.len() == lines[0].len()), "{table}");
    let cell = |row: usize, name: &str| lines[row][lines[0].iter().position(|heading| *heading == name).unwrap()];
    assert_eq!([cell(2, "t_a_s"), cell(2, "x_a_mm"), cell(2, "x_b_mm")], ["0.033000", "110.000000", "12.000000"]);
    assert_eq!([cell(2, "distance_mm"), cell(2, "error_b_mm"), cell(2, "equal")], ["98.000000", "2.000000", "0"]);
}

fn refused(folder: &TempDir, name: &str, run: Option<&Run>) -> String {
    let file: PathBuf = folder.path().join(name);
    match run {
        Some(run) => write(&file, run),
        None => std::fs::write(&file, "no MCAP").unwrap(),
    }
    let error = Comparison::of_files(&file, &file).map(|_| ()).unwrap_err();
    let error = format!("{error:#}");
    assert!(error.contains(name), "{error}");
    error
}

#[test]
fn what_is_no_recorded_run_is_refused_by_its_name() {
    let folder = TempDir::new().unwrap();
    let whole = run(Vec::new(), vec![step(0, "idle", Vec::new())]);
    let error = |name, run: &Run| refused(&folder, name, Some(run));
    assert!(error("only_images.mcap", &Run { settings: None, ..whole.clone() }).contains("no recording of a run"));
    assert!(error("old.mcap", &Run { has_begin: false, ..whole.clone() }).contains("pb3dp run --record"));
    assert!(error("empty.mcap", &Run { steps: Vec::new(), ..whole.clone() }).contains("no control step"));
    assert!(error("damaged.mcap", &Run { settings: Some("pace ="), ..whole.clone() }).contains("settings"));
    let no_pose = run(vec![pair(0, vec![1.0])], whole.steps);
    assert!(error("no_pose.mcap", &no_pose).contains("cam_left_from_model: 1 numbers"));
    assert!(error("of_other_version.mcap", &no_pose).contains("recorded by 1"));
    assert!(refused(&folder, "text.mcap", None).contains("is no MCAP file"));
}
