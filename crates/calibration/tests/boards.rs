//! Boards with markers: images drawn and evaluated by OpenCV 4.14.0 (tests/data/coded_boards_by_opencv.py), boards printed by
//! this crate, and calibrations from partly visible boards.

use std::collections::BTreeMap;

use image::GrayImage;
use nalgebra::Vector2;
use pb3dp_calibration::board::Board;
use pb3dp_calibration::detection::{NoBoard, find_board};
use pb3dp_calibration::fit::{Fit, View};
use pb3dp_calibration::ink::{draw, ink};
use pb3dp_calibration::lens::LensModel;

use crate::program::calibrate;
use crate::support::{Random, SIZE, Session, board, median_and_p95, normalised_errors, rig, views, views_of};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");

fn charuco() -> Board {
    Board::charuco([8, 6], 0.03, 0.022, "DICT_4X4_50").expect("a board")
}

fn april_grid() -> Board {
    Board::april_grid([6, 6], 0.024, 0.3).expect("a board")
}

/// A corner of an image: its true position, and OpenCV's result.
struct Truth {
    pixel: Vector2<f64>,
    opencv: Option<Vector2<f64>>,
}

/// By image, then column and row.
fn truth() -> BTreeMap<String, BTreeMap<(u32, u32), Truth>> {
    let text = std::fs::read_to_string(format!("{DATA}/coded_boards.csv")).expect("the reference");
    let mut all: BTreeMap<String, BTreeMap<(u32, u32), Truth>> = BTreeMap::new();
    for line in text.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let [image, column, row, u, v, u_opencv, v_opencv] = fields[..] else { panic!("{line}") };
        let number = |text: &str| text.parse::<f64>().ok();
        let at = |u, v| Some(Vector2::new(number(u)?, number(v)?));
        let truth = Truth { pixel: at(u, v).expect(line), opencv: at(u_opencv, v_opencv) };
        let place = (column.parse().expect(line), row.parse().expect(line));
        all.entry(image.to_owned()).or_default().insert(place, truth);
    }
    all
}

#[test]
fn corners_of_images_that_opencv_drew_are_found_where_they_are() {
    let truth = truth();
    assert_eq!(truth.len(), 6);
    for (name, corners) in &truth {
        let image = image::open(format!("{DATA}/coded_boards/{name}.png")).expect("an image").into_luma8();
        let board = if name.starts_with("charuco") { charuco() } else { april_grid() };
        let sighting = find_board(&image, &board).expect(name);
        let errors: Vec<f64> = sighting
            .corners()
            .iter()
            .map(|corner| (corner.pixel - corners[&(corner.column, corner.row)].pixel).norm())
            .collect();
        let theirs: Vec<f64> =
            corners.values().filter_map(|corner| Some((corner.opencv? - corner.pixel).norm())).collect();
        let inside = |pixel: &Vector2<f64>| (12.0..628.0).contains(&pixel.x) && (12.0..468.0).contains(&pixel.y);
        let visible = corners.values().filter(|corner| inside(&corner.pixel)).count();
        let (ours, opencv) = (median_and_p95(&errors), median_and_p95(&theirs));
        let worst = errors.iter().copied().fold(0.0, f64::max);
        println!(
            "{name}: {} of {visible} corners, median {:.3} px, p95 {:.3} px, worst {worst:.3} px; OpenCV {} corners, median {:.3} px, p95 {:.3} px",
            errors.len(),
            ours[0],
            ours[1],
            theirs.len(),
            opencv[0],
            opencv[1]
        );
        // No corner is assigned to another one; nearly as many corners as OpenCV are found, with the same accuracy.
        assert!(worst < 1.0, "{name}: {worst}");
        assert!(errors.len() as f64 >= 0.9 * theirs.len() as f64, "{name}");
        assert!(ours[0] < 0.12 && ours[1] < 0.35, "{name}: {ours:?}");
    }
}

#[test]
fn boards_that_we_print_are_found_in_their_images() {
    for board in [board(), charuco(), april_grid()] {
        let px_per_m = 3000.0;
        let drawn = draw(&ink(&board), px_per_m, 0.02);
        let sighting = find_board(&drawn.image, &board).expect("seen");
        assert_eq!(sighting.corners().len(), board.corner_count(), "{}", board.kind());
        let error = |corner: &pb3dp_calibration::board::BoardCorner| {
            let place = board.corner_in_board(corner.column, corner.row).xy().coords - drawn.origin_m;
            // Edges lie between pixels, whose centres are whole numbers.
            (corner.pixel - (place * px_per_m).add_scalar(-0.5)).norm()
        };
        let [median, p95] = median_and_p95(&sighting.corners().iter().map(error).collect::<Vec<_>>());
        println!("{}: median error {median:.3} px, p95 {p95:.3} px", board.kind());
        assert!(median < 0.1 && p95 < 0.5, "{}: {median}, {p95}", board.kind());
    }
}

#[test]
fn another_board_is_not_taken_for_it() {
    let image = draw(&ink(&charuco()), 2500.0, 0.02).image;
    let other = Board::charuco([8, 6], 0.03, 0.022, "DICT_6X6_50").expect("a board");
    assert!(find_board(&image, &other).is_err());
    assert_eq!(find_board(&image, &april_grid()), Err(NoBoard::Markers));
    assert_eq!(find_board(&GrayImage::new(200, 200), &charuco()), Err(NoBoard::Markers));
    assert_eq!(find_board(&GrayImage::new(3, 3), &april_grid()), Err(NoBoard::None));
}

#[test]
fn the_program_prints_boards_that_are_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let name = ["--board", "charuco:8x6:DICT_4X4_50", "--square", "30", "--marker", "22"];
    let (png, svg) = (path("board.png"), path("board.svg"));
    let printed = calibrate(&[&["board"], &name, &["--dpi", "100", "--out", &png]]);
    printed.succeeded().contains_all(&["240.00 x 180.00 mm"]);
    let image = image::open(&png).expect("an image").into_luma8();
    let sighting = find_board(&image, &charuco()).expect("seen");
    let at = |column, row| sighting.at(column, row).expect("seen").pixel;
    let length_mm = (at(6, 0) - at(0, 0)).norm() / 100.0 * 25.4;
    assert!((length_mm - 180.0).abs() < 0.05, "{length_mm}");
    calibrate(&[&["board"], &name, &["--out", &svg]]).succeeded();
    let text = std::fs::read_to_string(&svg).expect("a drawing");
    // White margins of 0.08 of the shorter side.
    assert!(text.contains("width=\"268.8000mm\" height=\"208.8000mm\""), "{}", &text[..200]);
    for (args, named) in [
        (vec!["--board", "charuco:8x6:DICT_4X4_50", "--square", "30", "--out", &png], "--marker"),
        (vec!["--board", "charuco:8x6:DICT_9X9", "--square", "30", "--marker", "22", "--out", &png], "DICT_9X9"),
        (vec!["--board", "aprilgrid:6x6", "--square", "30", "--tag", "24", "--out", &png], "--square"),
        (vec!["--board", "dots:6x6", "--square", "30", "--out", &png], "aprilgrid:6x6"),
        (vec!["--board", "9x6", "--square", "30", "--out", "board.pdf"], ".svg or .png"),
    ] {
        calibrate(&[&["board"], &args]).refused().contains_all(&[named]);
    }
}

/// Share of parameters within one stated standard deviation, over rigs that saw a board.
fn share_within(
    name: &str,
    board: &Board,
    see: impl Fn(&pb3dp_geometry::StereoRig, &Session, &mut Random) -> Vec<View<2>>,
) {
    const RIGS: u32 = 20;
    let session = Session { flatness_m: 0.0002, ..Session::GOOD };
    let (mut within, mut all, mut detected, mut corners) = (0_usize, 0_usize, 0_usize, 0_usize);
    for seed in 0..RIGS {
        let mut random = Random::new(300 + seed);
        let truth = rig(&mut random);
        let views = see(&truth, &session, &mut random);
        detected +=
            views.iter().flat_map(|view| &view.sightings).map(|sighting| sighting.corners().len()).sum::<usize>();
        corners += 2 * views.len() * board.corner_count();
        let fit = Fit::<2>::new(&views, board, SIZE, LensModel::Brown4)
            .and_then(|flat| flat.with_shape(&views))
            .unwrap_or_else(|error| panic!("{name}, seed {seed}: {error}"));
        let errors = normalised_errors(&fit, &truth);
        within += errors.iter().filter(|(_, error)| error.abs() <= 1.0).count();
        all += errors.len();
    }
    let share = within as f64 / all as f64;
    println!(
        "{name}: {detected} of {corners} corners detected; within one standard deviation: {:.1} % of {all}",
        100.0 * share
    );
    assert!((share - 0.683).abs() <= 0.08, "{name}: {share}");
}

#[test]
fn heads_are_calibrated_from_parts_of_boards() {
    share_within("whole chessboards", &board(), views);
    let parts = |rig: &_, session: &_, random: &mut _| views_of(&april_grid(), rig, session, 0.5, random);
    share_within("parts of an AprilGrid", &april_grid(), parts);
}
