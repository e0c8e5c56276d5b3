//! `pb3dp track` on a small sequence that the test records.

use std::path::Path;

use pb3dp_geometry::MonotonicTime;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_record::dataset::{SearchRange, SequenceDraft, SequenceWriter, WrittenFrame};
use pb3dp_record::images::PictureFormat;
use pb3dp_sim::targets::TargetConfig;

use crate::support::*;

const FRAMES: usize = 7;
/// How far the target goes from frame to frame, mm: right, up, away.
const STEP_MM: [f64; 3] = [3.0, -1.5, 2.5];

/// Records a card that drifts.
fn record(folder: &Path) -> Vec<Pose<CamLeft, Target>> {
    let mut renderer = renderer(TargetConfig::card());
    let way = |i: usize| -> [f64; 3] { std::array::from_fn(|axis| STEP_MM[axis] * 1e-3 * i as f64) };
    let pose_at = |i: usize| {
        let [x, y, z] = way(i);
        poses([x - 0.01, y + 0.005, z + 0.45], [0.1, -0.15, 0.08])
    };
    let outline = renderer.target_outline_px(&pose_at(0).0).unwrap();
    let draft = SequenceDraft {
        region_polygon_left_px: outline.iter().map(|p| [p.x, p.y]).collect(),
        search: SearchRange { z_min_m: 0.35, z_max_m: 0.65, tilt_max_rad: 0.6 },
        pictures: PictureFormat::Png,
    };
    let mut writer = SequenceWriter::create(folder, &rig(), draft).unwrap();
    let mut truth = Vec::new();
    for i in 0..FRAMES {
        let (scene_poses, cam_left_from_target) = pose_at(i);
        let (left, right) = render(&mut renderer, &scene_poses, i as u64);
        let exposed_at = MonotonicTime::from_nanos(2_000_000_000 + 33_000_000 * i as u64);
        let in_model = Pose::from_parts(cam_left_from_target.translation_m(), cam_left_from_target.rotation());
        let frame =
            WrittenFrame { left: &left, right: &right, exposed_at, skew_nanos: 0, cam_left_from_model: Some(in_model) };
        writer.push(frame).unwrap();
        truth.push(cam_left_from_target);
    }
    writer.finish().unwrap();
    truth
}

#[test]
fn a_drifting_card_is_followed_and_a_missing_frame_costs_only_itself() {
    let dir = tempfile::tempdir().unwrap();
    let sequence = dir.path().join("sequence");
    let truth = record(&sequence);
    let track =
        |overlay: &Path| pb3dp(&words(&[&"track", &"--sequence", &sequence, &"--json", &"--overlay", &overlay]));
    let whole = track(&dir.path().join("whole")).assert_success();
    let lines = whole.json_lines(&TRACK_KEYS);
    assert_eq!(lines.len(), FRAMES);
    let first = numbers(&lines[0]["cam_left_from_model"]);
    for (i, line) in lines.iter().enumerate() {
        assert_eq!(line["frame"], i);
        assert!((line["t_s"].as_f64().unwrap() - 2.0 - 0.033 * i as f64).abs() < 1e-9, "{line}");
        assert!(["ok", "weak-tilt"].contains(&line["status"].as_str().unwrap()), "{line}\n{}", whole.stderr);
        let m = numbers(&line["cam_left_from_model"]);
        assert_eq!((m.len(), &m[12..]), (16, &[0.0, 0.0, 0.0, 1.0][..]));
        for axis in 0..3 {
            let (moved, true_moved) = (m[4 * axis + 3] - first[4 * axis + 3], STEP_MM[axis] * i as f64);
            assert!(
                (moved - true_moved).abs() < 6.0,
                "frame {i}, axis {axis}: moved {moved} mm, truly {true_moved} mm"
            );
        }
        let normal = nalgebra::Vector3::new(m[2], m[6], m[10]);
        let off_deg = normal.angle(&truth[i].transform_vector(&nalgebra::Vector3::z())).to_degrees();
        assert!(off_deg < 8.0, "frame {i}: z of the model frame is off by {off_deg} degrees");
        assert!(line["covariance"].is_null() || numbers(&line["covariance"]).len() == 36, "{line}");
    }
    for part in ["translation, mm", "tilt, deg", "jitter", &format!("lost 0 of {FRAMES} frames")] {
        assert!(whole.stderr.contains(part), "{part:?} is missing in:\n{}", whole.stderr);
    }
    assert_animated(&dir.path().join("whole/sequence.png"), FRAMES as u32);

    std::fs::remove_file(sequence.join("right_0003.png")).unwrap();
    let finished = track(&dir.path().join("gap"));
    finished.assert_refused(&["frame 3", "right_0003.png", &format!("lost 1 of {FRAMES} frames")]);
    let with_gap = finished.json_lines(&TRACK_KEYS);
    assert_eq!(with_gap.len(), FRAMES);
    assert_eq!(with_gap[3]["status"], "error");
    assert!(TRACK_KEYS[3..].iter().all(|key| with_gap[3][key].is_null()), "{}", with_gap[3]);
    for i in (0..FRAMES).filter(|&i| i != 3) {
        assert!(["ok", "weak-tilt"].contains(&with_gap[i]["status"].as_str().unwrap()), "{}", with_gap[i]);
        assert!(dir.path().join(format!("gap/frame_{i:04}.png")).exists());
    }
    assert!(with_gap[..3].iter().zip(&lines).all(|(a, b)| without_time(a.clone()) == without_time(b.clone())));
    assert_animated(&dir.path().join("gap/sequence.png"), FRAMES as u32 - 1);
}

/// An animated PNG with so many frames: the number stands behind the name of its `acTL` chunk.
fn assert_animated(file: &Path, frames: u32) {
    let bytes = std::fs::read(file).unwrap();
    let at = bytes.windows(4).position(|window| window == b"acTL").expect("the picture is animated") + 4;
    assert_eq!(u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()), frames);
    image::open(file).unwrap();
}

#[test]
fn a_sequence_without_its_first_frame_starts_with_the_second() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path());
    std::fs::write(dir.path().join("left_0000.png"), "").unwrap();
    let finished = pb3dp(&words(&[&"track", &"--sequence", &dir.path(), &"--json"]));
    finished.assert_refused(&["frame 0", "left_0000.png"]);
    let lines = finished.json_lines(&TRACK_KEYS);
    assert_eq!((lines.len(), lines[0]["status"].as_str()), (FRAMES, Some("error")));
    assert!(lines[1..].iter().all(|line| !line["cam_left_from_model"].is_null()), "{}", finished.stdout);
}
