//! Simulated stereo rigs: the stated standard deviations match the errors, and planted defects are refused.

use pb3dp_calibration::board::Chessboard;
use pb3dp_calibration::fit::Fit;
use pb3dp_calibration::gates::{FLATNESS, FOCUS, Gate, Grade, HELD_OUT, Limits, MOTION, SCALE, TILT, VIEWS};
use pb3dp_calibration::held_out::choose;
use pb3dp_calibration::lens::LensModel;
use pb3dp_calibration::quality::Quality;

use pb3dp_test_support::sweep;

use crate::support::{Random, SIZE, Session, board, normalised_errors, rig, views};

fn rigs() -> u32 {
    sweep(12, 100)
}

/// A board that is flat to 0.2 mm.
const GOOD: Session = Session { flatness_m: 0.0002, ..Session::GOOD };

#[test]
fn exact_corners_give_back_the_exact_head() {
    let mut random = Random::new(7);
    let truth = rig(&mut random);
    let session = Session { corner_sigma_px: 0.0, flatness_m: 0.0, ..GOOD };
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

/// A folder from which one image is missing: all later pairs are one off.
#[test]
fn pairs_that_are_one_off_are_named() {
    for seed in 0..4 {
        let mut random = Random::new(seed);
        let truth = rig(&mut random);
        let right_ones = views(&truth, &GOOD, &mut random);
        let one_off: Vec<_> = right_ones
            .windows(2)
            .map(|pair| {
                let mut view = pair[0].clone();
                view.sightings[1] = pair[1].sightings[1].clone();
                view
            })
            .collect();
        let refused = Fit::<2>::new(&one_off, &board(), SIZE, LensModel::Brown4).expect_err("no fit").to_string();
        assert!(refused.contains("of the pair before it: the pairs are one off"), "{refused}");
        assert!(refused.contains(&one_off[0].name) && refused.contains("14 pairs"), "{refused}");
        assert!(Fit::<2>::new(&right_ones, &board(), SIZE, LensModel::Brown4).is_ok(), "{seed}");
    }
}

/// Errors of all parameters in units of their stated standard deviations, over all rigs.
fn check_standard_deviations(name: &str, session: &Session) {
    let (mut within, mut all, mut squares) = (0_usize, 0_usize, 0.0);
    let mut by_name: std::collections::BTreeMap<String, usize> = std::collections::BTreeMap::new();
    for seed in 0..rigs() {
        let mut random = Random::new(seed);
        let truth = rig(&mut random);
        let views = views(&truth, session, &mut random);
        let fit = Fit::<2>::new(&views, &board(), SIZE, LensModel::Brown4)
            .and_then(|flat| flat.with_shape(&views))
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
        "{name}: within one standard deviation: {:.1} % of {all}; mean square {:.2}; {by_name:?}",
        100.0 * share,
        squares / all as f64
    );
    let rigs = f64::from(rigs());
    assert!((share - 0.683).abs() <= 0.8 / rigs.sqrt(), "{name}: {share}");
    // Each parameter by itself: four standard deviations of a share estimated from this many samples.
    let (mean, four_sigma) = (0.683 * rigs, 4.0 * (0.683 * 0.317 * rigs).sqrt());
    let is_near = |count: &usize| (*count as f64 - mean).abs() <= four_sigma;
    assert!(by_name.values().all(is_near), "{name}: {by_name:?}");
}

#[test]
fn stated_standard_deviations_are_those_of_the_errors() {
    check_standard_deviations("flat board", &Session { flatness_m: 0.0, ..GOOD });
    check_standard_deviations("board flat to 0.2 mm", &GOOD);
}

/// Why a session was refused: the gates, or the message of an error.
struct Refusal {
    gates: Vec<Gate>,
    message: String,
}

/// A simulated session of a seed, judged; the squares are assumed to be `square_mm` large (true size 25), and the baseline is
/// known to 1 %.
fn judged(seed: u32, session: &Session, models: &[LensModel], (square_mm, exchanged): (f64, bool)) -> Refusal {
    let mut random = Random::new(1000 + seed);
    let truth = rig(&mut random);
    let mut views = views(&truth, session, &mut random);
    let ruler_m = truth.baseline_m() * (1.0 + random.between(-0.01, 0.01));
    for view in views.iter_mut().filter(|_| exchanged) {
        view.sightings.swap(0, 1);
    }
    let typed = Chessboard::new(board().columns(), board().rows(), square_mm * 1e-3).expect("a board");
    let error = |error: &dyn std::error::Error| Refusal { gates: Vec::new(), message: error.to_string() };
    let chosen = match choose(&views, &typed, SIZE, models) {
        Ok(chosen) => chosen,
        Err(reason) => return error(&reason),
    };
    let quality = match Quality::of_stereo(&chosen, &views, SIZE, 0.5) {
        Ok(quality) => quality.with_known_baseline(&chosen.fit.rig().expect("a head"), ruler_m),
        Err(reason) => return error(&reason),
    };
    let verdicts = Limits::of_cameras().judge_cameras(&quality);
    let gates: Vec<Gate> = verdicts.iter().filter(|v| v.grade() == Grade::Refused).map(|v| v.gate).collect();
    let numbers: Vec<String> = verdicts.iter().map(|v| format!("{} {:.3}", v.gate.key, v.measured)).collect();
    Refusal { gates, message: numbers.join(", ") }
}

#[test]
fn good_sessions_pass() {
    let models = [LensModel::Radial2, LensModel::Brown4, LensModel::Brown5];
    let refused = (0..rigs()).map(|seed| (seed, judged(seed, &GOOD, &models, (25.0, false))));
    let mut count = 0;
    for (seed, refusal) in refused {
        if !refusal.gates.is_empty() {
            println!("seed {seed}: {:?}: {}", refusal.gates, refusal.message);
            count += 1;
        }
    }
    println!("{count} of {} good sessions are refused", rigs());
    assert!(count <= sweep(1, 3), "{count}");
}

/// A defect: the sessions that have it, and the gates or error words that may refuse it.
struct Planted {
    name: &'static str,
    session: fn(&mut Random) -> Session,
    typed: fn(&mut Random) -> (f64, bool),
    gates: &'static [Gate],
    words: &'static str,
}

const AS_IT_IS: fn(&mut Random) -> (f64, bool) = |_| (25.0, false);

const PLANTED: [Planted; 8] = [
    Planted {
        name: "wrong square size",
        session: |_| GOOD,
        typed: |random| ([24.0, 26.0, 20.0, 30.0, 52.0, 2.5][random.between(0.0, 6.0) as usize], false),
        gates: &[SCALE],
        words: "",
    },
    Planted {
        name: "one camera refocused half way by 1 to 2 %",
        session: |random| Session { refocused: random.between(0.01, 0.02), ..GOOD },
        typed: AS_IT_IS,
        gates: &[FOCUS],
        words: "",
    },
    Planted {
        name: "streaks of 3 to 8 px in all views",
        session: |_| Session { streak_max_px: 8.0, ..GOOD },
        typed: AS_IT_IS,
        gates: &[MOTION, HELD_OUT],
        words: "",
    },
    Planted {
        name: "2 ms between the exposures of the cameras, board at 50 to 200 mm/s",
        session: |random| Session { moved_between_cameras_m: 0.002 * random.between(0.05, 0.2), ..GOOD },
        typed: AS_IT_IS,
        gates: &[MOTION],
        words: "",
    },
    Planted {
        name: "a board bent by 2 mm",
        session: |_| Session { flatness_m: 0.002, ..GOOD },
        typed: AS_IT_IS,
        gates: &[FLATNESS],
        words: "",
    },
    Planted {
        name: "left and right images exchanged",
        session: |_| GOOD,
        typed: |_| (25.0, true),
        gates: &[],
        words: "left and right images are not exchanged",
    },
    Planted {
        name: "3 to 5 views",
        session: |random| Session { views: random.between(3.0, 6.0) as usize, ..GOOD },
        typed: AS_IT_IS,
        gates: &[VIEWS],
        words: "usable views of the board",
    },
    Planted {
        name: "views tilted by 6 degrees at most",
        session: |_| Session { tilt_max_rad: 0.1, ..GOOD },
        typed: AS_IT_IS,
        gates: &[TILT],
        words: "tilted",
    },
];

/// Checks some of the planted defects, in a separate thread.
fn check_planted(range: std::ops::Range<usize>) {
    let (rigs, mut missed) = (rigs(), 0);
    for planted in &PLANTED[range] {
        let mut refused = 0;
        for seed in 0..rigs {
            let mut random = Random::new(5000 + seed);
            let session = (planted.session)(&mut random);
            let refusal = judged(seed, &session, &[LensModel::Brown4], (planted.typed)(&mut random));
            let words = !planted.words.is_empty() && refusal.message.contains(planted.words);
            if words || refusal.gates.iter().any(|gate| planted.gates.contains(gate)) {
                refused += 1;
            } else {
                println!("{}, seed {seed}: {:?}: {}", planted.name, refusal.gates, refusal.message);
            }
        }
        println!("{}: {refused} of {rigs} refused with the right reason", planted.name);
        missed += rigs - refused;
    }
    assert_eq!(missed, 0);
}

#[test]
fn wrong_sizes_and_changes_are_refused_with_the_right_reason() {
    check_planted(0..2);
}

#[test]
fn motion_is_refused_with_the_right_reason() {
    check_planted(2..4);
}

#[test]
fn bent_boards_and_exchanged_eyes_are_refused_with_the_right_reason() {
    check_planted(4..6);
}

#[test]
fn poor_views_are_refused_with_the_right_reason() {
    check_planted(6..PLANTED.len());
}

#[test]
fn the_lens_that_is_chosen_leaves_nothing_to_other_numbers() {
    let (mut within, mut all, mut by_lens) = (0_usize, 0_usize, std::collections::BTreeMap::new());
    for seed in 0..sweep(10, 40) {
        let mut random = Random::new(seed);
        let truth = rig(&mut random);
        let views = views(&truth, &GOOD, &mut random);
        let models = [LensModel::Radial1, LensModel::Radial2, LensModel::Brown4, LensModel::Brown5];
        let chosen = choose(&views, &board(), SIZE, &models).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        *by_lens.entry(chosen.fit.lens().to_string()).or_insert(0) += 1;
        for (name, error) in normalised_errors(&chosen.fit, &truth) {
            // Coefficients of a simpler model differ from those of the truth.
            if ["fx", "fy", "cx", "cy", "_m", "_rad"].iter().any(|end| name.ends_with(end)) {
                within += usize::from(error.abs() <= 1.0);
                all += 1;
            }
        }
    }
    let share = within as f64 / all as f64;
    println!("chosen: {by_lens:?}; within one standard deviation: {:.1} % of {all}", 100.0 * share);
    // It was 61 % when a model was accepted whose held-out error was 1 % above the lowest.
    assert!((share - 0.683).abs() <= sweep(0.12, 0.06), "{share}");
}
