//! A simulated operator who follows the coach, with the accuracy of human hands.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use pb3dp_calibration::coach::{VIEWS_MAX, ViewRequest, advice};
use pb3dp_calibration::fit::View;
use pb3dp_calibration::gates::{COVERAGE, DEPTH, Gate, Grade, Judged, Limits, TILT};
use pb3dp_calibration::held_out::choose;
use pb3dp_calibration::lens::LensModel;
use pb3dp_calibration::quality::Quality;
use pb3dp_calibration::stand::{Judge, Stand};
use pb3dp_geometry::{StereoRig, so3};
use pb3dp_record::metrics::median;

use crate::support::{Random, SIZE, Session, board, detected_by_both, rig, views};

/// The board at the requested position, with the errors of a hand; moved towards the middle until both cameras see all of it.
fn follow(request: &ViewRequest, rig: &StereoRig, random: &mut Random, name: String) -> View<2> {
    let board = board();
    let middle = board.corner_in_board(board.columns() - 1, board.rows() - 1).coords * 0.5;
    let side_m = 2.0 * (middle.x * middle.y).sqrt();
    let width = f64::from(SIZE.width);
    let distance_m = side_m * rig.left().pinhole().fx / (request.size * width) * random.between(0.9, 1.1);
    let way = request.farther.map_or_else(Vector2::zeros, |side| side.direction()) * request.tilt_deg;
    let mut off = |size: f64| random.between(-size, size);
    // The right side is farther away after a turn about -y, the lower one after a turn about x.
    let turn = Vector3::new((way.y + off(8.0)).to_radians(), (-way.x + off(8.0)).to_radians(), off(20.0).to_radians());
    let out = Vector2::new(f64::from(request.part[0]) - 1.0, f64::from(request.part[1]) - 1.0);
    let shake = Vector2::new(off(0.04), off(0.04));
    // A board that does not fit is held farther away; a board that leaves an image is moved towards the middle of both images.
    for (back, step) in (0..12).flat_map(|back| (0..=30).map(move |step| (back, step))) {
        let distance_m = distance_m * 1.05_f64.powi(back);
        let ahead = Point3::new(0.0, 0.0, distance_m);
        let [left, right] = [
            rig.left().project(&ahead).expect("ahead"),
            rig.right().project(&rig.cam_right_from_cam_left().transform_point(&ahead)).expect("ahead"),
        ];
        let share = 0.45 * (1.0 - f64::from(step) / 30.0);
        let place = Vector2::new(0.5 + 0.5 * (left.x - right.x) / width, 0.5) + out * share + shake;
        let pixel = Vector2::new(place.x * width, place.y * f64::from(SIZE.height));
        let Ok(ray) = rig.left().unproject(&pixel) else { continue };
        let to_middle = Isometry3::from_parts((ray * distance_m).into(), so3::exp(&turn));
        let cam_left_from_board = to_middle * Isometry3::translation(-middle.x, -middle.y, 0.0);
        if let Some(sightings) = detected_by_both(rig, &cam_left_from_board, (0.1, 1.0), random) {
            return View { name, sightings };
        }
    }
    panic!("the board does not fit into both images: {request:?}");
}

/// Views of an operator who follows the advice until there are enough views.
fn coached(rig: &StereoRig, random: &mut Random) -> Vec<View<2>> {
    let mut views: Vec<View<2>> = Vec::new();
    loop {
        let judge =
            if views.len() < 4 { Some(Judge::of_camera(*rig.left())) } else { Judge::new(&views, &board(), SIZE) };
        let judge = judge.expect("a camera");
        let stands: Vec<Stand> = views.iter().filter_map(|view| judge.stand(view, &board())).collect();
        match advice(&stands, &Limits::of_cameras()).request {
            Some(request) => views.push(follow(&request, rig, random, format!("{:02}", views.len()))),
            None => return views,
        }
        assert!(views.len() <= VIEWS_MAX, "there are never enough views");
    }
}

fn judged(views: &[View<2>]) -> Vec<Judged> {
    let chosen = choose(views, &board(), SIZE, &[LensModel::Radial2, LensModel::Brown4]).expect("a fit");
    Limits::of_cameras().judge_cameras(&Quality::of_stereo(&chosen, views, SIZE, 0.5).expect("judged"))
}

fn measured(verdicts: &[Judged], gate: Gate) -> f64 {
    verdicts.iter().find(|verdict| verdict.gate == gate).expect("judged").measured
}

#[test]
fn who_follows_the_coach_passes_the_gates() {
    const HEADS: u32 = 20;
    let gates = [COVERAGE, TILT, DEPTH];
    let mut numbers: [[Vec<f64>; 2]; 3] = Default::default();
    let mut counts = Vec::new();
    let (mut good, mut good_at_random) = (0, 0);
    for seed in 0..HEADS {
        let mut random = Random::new(7000 + seed);
        let truth = rig(&mut random);
        let coached = coached(&truth, &mut random);
        let session = Session { views: coached.len(), ..Session::GOOD };
        let at_random = judged(&views(&truth, &session, &mut random));
        let verdicts = judged(&coached);
        counts.push(coached.len() as f64);
        for (lists, gate) in numbers.iter_mut().zip(gates) {
            lists[0].push(measured(&verdicts, gate));
            lists[1].push(measured(&at_random, gate));
        }
        let refused: Vec<_> = verdicts.iter().filter(|v| v.grade() == Grade::Refused).collect();
        assert!(refused.is_empty(), "seed {seed}, {} views: {refused:?}", coached.len());
        let is_good = |verdicts: &[Judged]| {
            gates
                .iter()
                .all(|gate| verdicts.iter().any(|verdict| verdict.gate == *gate && verdict.grade() == Grade::Good))
        };
        good += u32::from(is_good(&verdicts));
        good_at_random += u32::from(is_good(&at_random));
    }
    println!("views: median {}, at most {}", median(&counts).unwrap(), counts.iter().copied().fold(0.0, f64::max));
    println!("coverage, tilt and depth good: {good} of {HEADS}, with as many random views {good_at_random}");
    for (lists, gate) in numbers.iter().zip(gates) {
        let [coached, random] = lists.each_ref().map(|list| median(list).unwrap());
        println!("{}: median {coached:.3}, at random {random:.3}", gate.key);
    }
    assert!(counts.iter().all(|count| *count <= VIEWS_MAX as f64));
    assert!(good >= HEADS * 9 / 10 && good > good_at_random, "{good}, {good_at_random}");
    assert!(median(&numbers[2][0]).unwrap() < median(&numbers[2][1]).unwrap());
}

#[test]
fn the_advice_is_given_as_text() {
    let first = advice(&[], &Limits::of_cameras()).request.expect("a view");
    assert_eq!(
        first.to_string(),
        "hold the board in the middle of the images, facing the cameras, near: as large as fits"
    );
    let mut random = Random::new(3);
    let truth = rig(&mut random);
    let views = [follow(&first, &truth, &mut random, "00".to_owned())];
    let judge = Judge::of_camera(*truth.left());
    let stand = judge.stand(&views[0], &board()).expect("a stand");
    let second = advice(&[stand], &Limits::of_cameras());
    println!("{:?}: {}", second.progress, second.request.expect("a view"));
    let text = second.request.expect("a view").to_string();
    assert!(
        text.contains("corner of the images, as far out as possible with the whole board in both images"),
        "{text}"
    );
    assert!(text.contains("its right side 30 degrees farther away"), "{text}");
}

#[test]
fn a_stand_is_what_was_done() {
    let mut random = Random::new(12);
    let truth = rig(&mut random);
    let judge = Judge::of_camera(*truth.left());
    for part in [[1, 1], [0, 0], [2, 2]] {
        for farther in pb3dp_calibration::coach::Farther::ALL {
            let request = ViewRequest { part, farther: Some(farther), tilt_deg: 30.0, size: 0.3 };
            let view = follow(&request, &truth, &mut random, "00".to_owned());
            let stand = judge.stand(&view, &board()).expect("a stand");
            let along = stand.tilt_deg.dot(&farther.direction());
            // In an image corner the same rotation is a different tilt against the ray.
            assert!((10.0..60.0).contains(&along), "{request:?}: {stand:?}");
            assert!((stand.size / 0.3 - 1.0).abs() < 0.3, "{stand:?}");
            assert!((stand.centre.x - 0.5) * (f64::from(part[0]) - 1.0) >= 0.0, "{stand:?}");
        }
    }
}
