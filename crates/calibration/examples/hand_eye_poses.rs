//! Writes the poses of the simulated rigs of `tests/hand_eye.rs` as CSV, for `tests/data/hand_eye_by_opencv.py`.
//!
//! One line per stop: rig, stop, then the flange in the base and the board in the left camera, each as a rotation vector (rad)
//! and a translation (m). The board pose is computed from the corners in both images.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "it writes what tests compare with, and may fail loudly"
)]

#[allow(dead_code, reason = "shared with the tests")]
#[path = "../tests/support/mod.rs"]
mod support;

#[allow(dead_code, reason = "shared with the tests")]
#[path = "../tests/support/arm.rs"]
mod arm;

use nalgebra::Isometry3;
use pb3dp_calibration::hand_eye::place_board;
use pb3dp_geometry::so3;

fn main() {
    println!("rig,stop,rx,ry,rz,x,y,z,board_rx,board_ry,board_rz,board_x,board_y,board_z");
    for seed in 0..100 {
        let mut random = support::Random::new(seed);
        let world = arm::World::in_room(&mut random);
        for stop in world.visit(&arm::GOOD, &mut random) {
            let board = place_board(&world.rig, &support::board(), &stop.sightings).expect("a board");
            let numbers = |pose: &Isometry3<f64>| {
                let (turn, shift) = (so3::log(&pose.rotation), pose.translation.vector);
                let all = turn.iter().chain(shift.iter());
                all.map(|number| format!("{number:.9}")).collect::<Vec<_>>().join(",")
            };
            println!(
                "{seed},{},{},{}",
                stop.name,
                numbers(stop.base_from_flange.isometry()),
                numbers(board.isometry())
            );
        }
    }
}
