//! Simulated stereo heads: the stated standard deviations are those of the errors, and planted defects are refused.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests may fail loudly, and show what they measured"
)]

mod support;

use pb3dp_calibration::fit::Fit;
use pb3dp_calibration::gates::{Gate, Grade, Limits};
use pb3dp_calibration::held_out::choose;
use pb3dp_calibration::lens::LensModel;
use pb3dp_calibration::quality::Quality;

use support::{Random, SIZE, Session, board, normalised_errors, rig, views};

const RIGS: u32 = 100;
const GOOD: Session =
    Session { views: 15, corner_sigma_px: 0.1, refocused: 0.0, moved_between_eyes_m: 0.0, bow_m: 0.0 };

#[test]
fn exact_corners_give_back_the_exact_head() {
    let mut random = Random::new(7);
    let truth = rig(&mut random);
    let session = Session { corner_sigma_px: 0.0, ..GOOD };
    let fit = Fit::<2>::new(&views(&truth, &session, &mut random), &board(), SIZE, LensModel::Brown4).expect("a fit");
    let found = fit.rig().expect("a head");
    for (a, b) in [(found.left(), truth.left()), (found.right(), truth.right())] {
        assert!((a.pinhole().matrix() - b.pinhole().matrix()).amax() < 1e-5, "{a:?}, {b:?}");
        let lens = a.distortion().coefficients().iter().zip(b.distortion().coefficients());
        assert!(lens.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) < 1e-7, "{a:?}, {b:?}");
    }
    let (a, b) = (found.cam_right_from_cam_left(), truth.cam_right_from_cam_left());
    assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-8, "{a:?}, {b:?}");
}

#[test]
fn stated_standard_deviations_are_those_of_the_errors() {
    let (mut within, mut all, mut squares) = (0_usize, 0_usize, 0.0);
    let mut by_name: std::collections::BTreeMap<String, usize> = std::collections::BTreeMap::new();
    for seed in 0..RIGS {
        let mut random = Random::new(seed);
        let truth = rig(&mut random);
        let views = views(&truth, &GOOD, &mut random);
        let fit = Fit::<2>::new(&views, &board(), SIZE, LensModel::Brown4)
            .unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        for (name, error) in normalised_errors(&fit, &truth) {
            within += usize::from(error.abs() <= 1.0);
            *by_name.entry(name).or_default() += usize::from(error.abs() <= 1.0);
            all += 1;
            squares += error * error;
        }
    }
    let share = within as f64 / all as f64;
    println!(
        "within one standard deviation: {:.1} % of {all}; mean square {:.2}; {by_name:?}",
        100.0 * share,
        squares / all as f64
    );
    assert!((share - 0.683).abs() <= 0.08, "{share}");
    // Each by itself: four standard deviations of a share of 100.
    assert!(by_name.values().all(|count| (49..=87).contains(count)), "{by_name:?}");
}

/// The gates that refuse a session, and the chosen lens model.
fn refusals(seed: u32, session: &Session) -> Vec<Gate> {
    let mut random = Random::new(1000 + seed);
    let truth = rig(&mut random);
    let views = views(&truth, session, &mut random);
    let chosen = choose(&views, &board(), SIZE, &[LensModel::Radial2, LensModel::Brown4, LensModel::Brown5])
        .unwrap_or_else(|error| panic!("seed {seed}: {error}"));
    let quality = Quality::of_stereo(&chosen, &views, SIZE, 0.5).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
    let verdicts = Limits::default().judge(&quality);
    let refused: Vec<Gate> = verdicts.iter().filter(|v| v.grade() == Grade::Refused).map(|v| v.gate).collect();
    if !refused.is_empty() {
        let numbers: Vec<String> = verdicts.iter().map(|v| format!("{} {:.3}", v.gate.key(), v.measured)).collect();
        println!("seed {seed}, {}: {refused:?}: {}", chosen.fit.lens(), numbers.join(", "));
    }
    refused
}

#[test]
fn good_sessions_pass() {
    const SESSIONS: u32 = 30;
    let bad: Vec<u32> = (0..SESSIONS).filter(|seed| !refusals(*seed, &GOOD).is_empty()).collect();
    assert!(bad.len() <= 1, "{bad:?}");
}

#[test]
fn planted_defects_are_refused() {
    const SESSIONS: u32 = 6;
    let defects = [
        ("one camera refocused half way", Session { refocused: 0.02, ..GOOD }, vec![Gate::Reprojection, Gate::Rows]),
        (
            "a board that moves between the exposures",
            Session { moved_between_eyes_m: 0.0008, ..GOOD },
            vec![Gate::Rows],
        ),
        ("corners that are blurred", Session { corner_sigma_px: 0.5, ..GOOD }, vec![Gate::Reprojection]),
        ("few views", Session { views: 5, ..GOOD }, vec![Gate::Views]),
    ];
    for (name, session, reasons) in defects {
        for seed in 0..SESSIONS {
            let refused = refusals(seed, &session);
            assert!(refused.iter().any(|gate| reasons.contains(gate)), "{name}, seed {seed}: {refused:?}");
        }
    }
}
