//! Beside OpenCV 4.14.0 on the same corners of real pictures (tests/data/stereo_by_opencv.py).

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests may fail loudly, and show what they measured"
)]

use std::collections::BTreeMap;

use nalgebra::{Rotation3, Vector2, Vector3};
use pb3dp_calibration::board::{BoardCorner, Chessboard, Sighting};
use pb3dp_calibration::fit::{Fit, View};
use pb3dp_calibration::lens::LensModel;
use pb3dp_geometry::ImageSize;

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
const CORNERS: &str = include_str!("data/corners.csv");
const OPENCV: &str = include_str!("data/opencv_4_14_stereo.csv");

fn views() -> Vec<View<2>> {
    let mut seen: BTreeMap<&str, [Vec<BoardCorner>; 2]> = BTreeMap::new();
    for line in CORNERS.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let [view, camera, column, row, u, v] = fields[..] else { panic!("{line}") };
        let pixel = Vector2::new(u.parse().expect(line), v.parse().expect(line));
        let corner = BoardCorner { column: column.parse().expect(line), row: row.parse().expect(line), pixel };
        seen.entry(view).or_default()[usize::from(camera == "right")].push(corner);
    }
    let view = |(name, sightings): (&str, [Vec<BoardCorner>; 2])| View {
        name: name.to_owned(),
        sightings: sightings.map(Sighting::new),
    };
    seen.into_iter().map(view).collect()
}

/// What OpenCV found: numbers by name.
fn opencv() -> BTreeMap<&'static str, Vec<f64>> {
    let line = |line: &'static str| {
        let (name, numbers) = line.split_once(',').expect(line);
        (name, numbers.split(',').map(|number| number.parse().expect(line)).collect())
    };
    OPENCV.lines().map(line).collect()
}

#[test]
fn stereo_calibration_agrees_with_opencv() {
    let (views, opencv) = (views(), opencv());
    assert_eq!(views.len(), 12);
    let fit =
        Fit::<2>::new(&views, &Chessboard::new(9, 6, 0.025).expect("a board"), SIZE, LensModel::Brown5).expect("a fit");
    let rig = fit.rig().expect("a head");
    let errors: Vec<f64> =
        fit.errors().iter().flatten().flatten().map(|corner| corner.error_px.norm_squared()).collect();
    let rms_px = (errors.iter().sum::<f64>() / errors.len() as f64).sqrt();
    assert!(rms_px <= 1.0001 * opencv["rms_px"][0], "{rms_px}, {:?}", opencv["rms_px"]);
    let baseline_mm = rig.baseline_m() * 1e3;
    assert!((baseline_mm - opencv["baseline_mm"][0]).abs() < 0.001, "{baseline_mm}, {:?}", opencv["baseline_mm"]);
    for (side, camera) in [("left", rig.left()), ("right", rig.right())] {
        let (p, theirs) = (camera.pinhole(), &opencv[format!("{side}_fx_fy_cx_cy").as_str()]);
        for (ours, theirs) in [p.fx, p.fy, p.cx, p.cy].iter().zip(theirs) {
            assert!((ours - theirs).abs() < 0.002, "{side}: {p:?}, {theirs}");
        }
    }
    let worst = fit.cam_left_from_board().zip(&views).fold((0.0_f64, 0.0_f64), |worst, (ours, view)| {
        let theirs = &opencv[format!("board_{}", view.name).as_str()];
        let turn = Rotation3::new(Vector3::from_row_slice(&theirs[..3]));
        let shift_mm = (ours.translation_m() * 1e3 - Vector3::from_row_slice(&theirs[3..])).norm();
        (worst.0.max(shift_mm), worst.1.max(ours.rotation().to_rotation_matrix().angle_to(&turn).to_degrees()))
    });
    println!(
        "rms {rms_px:.5} px, OpenCV {:.5} px; baseline {baseline_mm:.4} mm, OpenCV {:.4} mm; boards within {:.5} mm and {:.6} degrees",
        opencv["rms_px"][0], opencv["baseline_mm"][0], worst.0, worst.1
    );
    assert!(worst.0 < 0.002 && worst.1 < 0.001, "{worst:?}");
}
