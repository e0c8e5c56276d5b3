//! The configurations for single pairs.

use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_sim::targets::Paint;

use super::cell::{Backdrop, Cell, Light, PoseRange, Question, RegionKind, RigKind, Setup, Shape, Tilt};

/// Search range of the methods in the nominal configuration: larger than the range of the poses.
const SEARCH: SearchRange = SearchRange { z_min_m: 0.33, z_max_m: 0.84, tilt_max_rad: 45.0 / DEGREES };
/// The same for configurations with other depths.
const SEARCH_FAR: SearchRange = SearchRange { z_min_m: 0.30, z_max_m: 1.15, ..SEARCH };
const DEGREES: f64 = 180.0 / std::f64::consts::PI;

const NOMINAL: PoseRange = PoseRange::NOMINAL;

/// Paints with a texture.
const TEXTURED: [Paint; 6] = [Paint::Colourful, Paint::Crab, Paint::Red, Paint::Grey, Paint::Faint, Paint::Repetitive];

fn cell(name: impl Into<String>, value: f64, setup: Setup) -> Cell {
    Cell { name: name.into(), value, setup, poses: NOMINAL, search: SEARCH, question: Question::Accuracy }
}

/// All configurations, in the order of the table.
pub fn all() -> Vec<Cell> {
    let mut cells = Vec::new();
    for paint in TEXTURED {
        cells.push(cell(format!("target/{}", paint.name()), 0.0, painted(paint)));
    }
    cells.extend(geometry());
    cells.extend(cameras());
    cells.extend(surroundings());
    cells.extend(relief_and_light());
    for paint in TEXTURED {
        cells.push(Cell {
            poses: PoseRange { z_min_m: 0.35, z_max_m: 0.80, tilt: Tilt::UpTo(40.0) },
            question: Question::ColdStart,
            ..cell(format!("cold/{}", paint.name()), 0.0, painted(paint))
        });
    }
    cells.extend(unobservable());
    cells
}

fn painted(paint: Paint) -> Setup {
    Setup { paint, ..Setup::default() }
}

/// Baseline, distance, tilt.
fn geometry() -> Vec<Cell> {
    let nominal = Setup::default();
    let mut cells = Vec::new();
    for baseline in [60.0, 100.0, 150.0] {
        let rig = RigKind::Parallel { baseline_m: baseline * 1e-3 };
        cells.push(cell(format!("baseline/{baseline}mm"), baseline, Setup { rig, ..nominal }));
    }
    for distance in [350.0, 425.0, 500.0, 600.0, 700.0, 850.0, 1000.0] {
        let (z_min_m, z_max_m) = (distance * 1e-3 - 0.005, distance * 1e-3 + 0.005);
        cells.push(Cell {
            poses: PoseRange { z_min_m, z_max_m, ..NOMINAL },
            search: SEARCH_FAR,
            ..cell(format!("distance/{distance}mm"), distance, nominal)
        });
    }
    for tilt in [0.0, 10.0, 20.0, 30.0, 40.0] {
        let poses = PoseRange { tilt: Tilt::Exactly(tilt), ..NOMINAL };
        cells.push(Cell { poses, ..cell(format!("tilt/{tilt}deg"), tilt, nominal) });
    }
    for paint in [Paint::Colourful, Paint::Crab, Paint::Grey] {
        let setup = Setup { rig: RigKind::Unequal, ..painted(paint) };
        cells.push(cell(format!("unrectified/{}", paint.name()), 0.0, setup));
    }
    cells
}

/// Noise, gain, colour, focus, vertical misalignment.
fn cameras() -> Vec<Cell> {
    let nominal = Setup::default();
    let mut cells = Vec::new();
    for noise_grey in [0.5, 1.0, 2.0, 3.0, 4.0, 8.0] {
        cells.push(cell(format!("noise/{noise_grey}"), noise_grey, Setup { noise_grey, ..nominal }));
    }
    for gain in [0.7, 1.3] {
        cells.push(cell(format!("gain/{gain}"), gain, Setup { gain: [gain; 3], ..nominal }));
    }
    cells.push(cell("white-balance/20%", 20.0, Setup { gain: [1.2, 1.0, 0.8], ..nominal }));
    cells.push(cell("defocus/1.5px", 1.5, Setup { defocus_px: 1.5, ..nominal }));
    cells.push(cell("rows/0.5px", 0.5, Setup { rows_off_px: 0.5, ..nominal }));
    cells
}

/// Occlusion of the target, and background inside the marked region.
fn surroundings() -> Vec<Cell> {
    let nominal = Setup::default();
    let rectangle = |gap_m: f64| Setup { region: RegionKind::Rectangle, backdrop: Backdrop::Sand { gap_m }, ..nominal };
    vec![
        cell("occlusion/20%", 20.0, Setup { occluded_share: 0.2, ..nominal }),
        cell("occlusion/40%", 40.0, Setup { occluded_share: 0.4, ..nominal }),
        cell("rectangle/30mm-behind", 30.0, rectangle(0.03)),
        cell("rectangle/100mm-behind", 100.0, rectangle(0.1)),
        cell("rectangle/100mm-behind-20%-hidden", 100.0, Setup { occluded_share: 0.2, ..rectangle(0.1) }),
    ]
}

fn relief_and_light() -> Vec<Cell> {
    let nominal = Setup::default();
    let mut cells = Vec::new();
    for relief in [5.0, 10.0, 25.0] {
        let shape = Shape::Crab { relief_m: relief * 1e-3 };
        cells.push(cell(format!("relief/{relief}mm"), relief, Setup { shape, ..nominal }));
    }
    for paint in [Paint::Colourful, Paint::Crab, Paint::Grey] {
        let setup = Setup { light: Light::Glossy, ..painted(paint) };
        cells.push(cell(format!("glossy/{}", paint.name()), 0.0, setup));
    }
    for relief in [10.0, 25.0] {
        let shape = Shape::Crab { relief_m: relief * 1e-3 };
        let setup = Setup { shape, light: Light::Glossy, ..nominal };
        cells.push(cell(format!("glossy/relief-{relief}mm"), relief, setup));
    }
    cells
}

/// Scenes in which a plane is not observable, or not from hue.
fn unobservable() -> Vec<Cell> {
    let scene = |name: &str, setup: Setup| Cell { question: Question::Unobservable, ..cell(name, 0.0, setup) };
    let uniform = painted(Paint::Uniform);
    vec![
        scene("unobservable/uniform-interior", Setup { region: RegionKind::Interior, ..uniform }),
        scene("unobservable/blank-wall", Setup { shape: Shape::Wall, backdrop: Backdrop::Nothing, ..uniform }),
        scene("unobservable/same-hue-behind", Setup { backdrop: Backdrop::SameHue, ..Setup::default() }),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_search_ranges_hold_the_poses() {
        let cells = all();
        for (index, cell) in cells.iter().enumerate() {
            assert!(cells[..index].iter().all(|other| other.name != cell.name), "{} occurs twice", cell.name);
            cell.search.validate().unwrap();
            assert!(cell.search.z_min_m < cell.poses.z_min_m && cell.search.z_max_m > cell.poses.z_max_m);
            let mut random = super::super::random::Random::of(1, &cell.name, 0);
            for _ in 0..50 {
                let tilt = cell.poses.tilt_rad(&mut random);
                assert!(tilt.iter().all(|angle| angle.abs() < cell.search.tilt_max_rad), "{}: {tilt:?}", cell.name);
            }
        }
    }

    #[test]
    fn tilts_in_any_direction_have_their_size() {
        let poses = PoseRange { tilt: Tilt::Exactly(30.0), ..NOMINAL };
        let mut random = super::super::random::Random::of(1, "x", 0);
        for _ in 0..20 {
            let [theta_x_rad, theta_y_rad] = poses.tilt_rad(&mut random);
            let psi = pb3dp_estimation_core::plane_hypothesis::PlaneHypothesis { z_m: 1.0, theta_x_rad, theta_y_rad };
            assert!((psi.normal().z.acos().to_degrees() - 30.0).abs() < 1e-6);
        }
    }
}
