//! Planes of what both cameras see, anywhere in the image: they tell how far away a lost target would be there and how it would be tilted,
//! so that only its roll remains to be searched.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector3};

/// Distance of neighbouring places, in radii of the target at its expected distance. Chosen with figures: on the frames of three sequences
/// of stills in which the target is lost, as many are found as with half of it.
pub(super) const SPACING_RADII: f64 = 0.35;
/// Half of the side of the square whose points give a plane, in radii of the target at the distance of the place. Chosen with figures: with
/// 0.8 as many are found.
const REACH_RADII: f64 = 0.5;
/// Largest deviation of a point from its plane, as a share of the distance, in the first and in later rounds. Chosen by hand, not varied: the
/// first plane faces the camera.
const DEVIATIONS: [f64; 3] = [0.15, 0.05, 0.05];
/// Smallest number of points of a plane: four for each of its values. Chosen by hand, not varied.
const POINTS_MIN: usize = 12;

/// A plane that both cameras see, in `cam_left`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VisiblePlane {
    /// A point on it, in the middle of the points that show it, metres.
    pub(super) at_m: Vector3<f64>,
    /// Unit normal, away from the camera.
    pub(super) normal: Vector3<f64>,
}

/// A point as its ray (third component 1) and its inverse depth, 1/m.
type Sight = (Vector3<f64>, f64);

/// The planes through the neighbourhoods of places all over the image, given points in `cam_left` (metres), for a target of this radius at
/// this distance.
pub(super) fn visible_planes(points: &[Point3<f64>], radius_m: f64, distance_m: f64) -> Vec<VisiblePlane> {
    let spacing = SPACING_RADII * radius_m / distance_m;
    let tile_of = |ray: &Vector3<f64>| [ray.y, ray.x].map(|x| (x / spacing).round() as i64);
    let mut tiles: BTreeMap<[i64; 2], Vec<Sight>> = BTreeMap::new();
    for point in points.iter().filter(|point| point.z > 0.0) {
        let ray = point.coords / point.z;
        tiles.entry(tile_of(&ray)).or_default().push((ray, 1.0 / point.z));
    }
    let mut near = Vec::new();
    let plane_at = |(tile, own): (&[i64; 2], &Vec<Sight>)| {
        let mut depths: Vec<f64> = own.iter().map(|(_, inverse_depth)| *inverse_depth).collect();
        let middle = depths.len() / 2;
        let inverse_depth = *depths.select_nth_unstable_by(middle, f64::total_cmp).1;
        let centre = Vector3::new(tile[1] as f64 * spacing, tile[0] as f64 * spacing, 1.0);
        let reach = REACH_RADII * radius_m * inverse_depth;
        let is_near = |(ray, _): &&Sight| (ray - centre).amax() <= reach;
        near.clear();
        let [first, last] = [-reach, reach].map(|by| tile_of(&centre.add_scalar(by)));
        for row in first[0]..=last[0] {
            let tiles = tiles.range([row, first[1]]..=[row, last[1]]);
            near.extend(tiles.flat_map(|(_, sights)| sights).filter(is_near));
        }
        plane_through(&near, &centre, inverse_depth)
    };
    tiles.iter().filter_map(plane_at).collect()
}

/// The plane that most points near a ray share.
fn plane_through(near: &[Sight], centre: &Vector3<f64>, inverse_depth: f64) -> Option<VisiblePlane> {
    // Inverse depth is `plane . (ray - centre, 1)`.
    let row = |ray: &Vector3<f64>| Vector3::new(ray.x - centre.x, ray.y - centre.y, 1.0);
    let mut plane = Vector3::new(0.0, 0.0, inverse_depth);
    for deviation in DEVIATIONS {
        let (mut squares, mut pull, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0);
        for (ray, value) in near {
            let row = row(ray);
            if (plane.dot(&row) - value).abs() <= deviation * inverse_depth {
                squares += row * row.transpose();
                pull += row * *value;
                count += 1;
            }
        }
        if count < POINTS_MIN.max(near.len() / 2) {
            return None;
        }
        plane = squares.try_inverse()? * pull;
    }
    let inverse_depth_plane = Vector3::new(plane.x, plane.y, plane.z - plane.xy().dot(&centre.xy()));
    let normal = inverse_depth_plane.try_normalize(0.0)?;
    (plane.z > 0.0).then(|| VisiblePlane { at_m: centre / plane.z, normal })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of the plane through (0, 0, `distance_m`) with this normal where `shows` its ray.
    fn points(distance_m: f64, normal: Vector3<f64>, shows: impl Fn(f64, f64) -> bool) -> Vec<Point3<f64>> {
        let rays = (-30..=30).flat_map(|i| (-20..=20).map(move |j| (0.017 * f64::from(i), 0.017 * f64::from(j))));
        let shown = rays.filter(|(x, y)| shows(*x, *y)).map(|(x, y)| Vector3::new(x, y, 1.0));
        shown.map(|ray| Point3::from(ray * (normal.z * distance_m / normal.dot(&ray)))).collect()
    }

    #[test]
    fn a_tilted_board_before_a_wall_has_its_own_planes() {
        let (wall, board) = (Vector3::z(), Vector3::new(0.5, -0.2, 0.8).normalize());
        let is_board = |x: f64, y: f64| (x - 0.1).abs() < 0.2 && (y + 0.05).abs() < 0.15;
        let mut all = points(0.9, wall, |x, y| !is_board(x, y));
        all.extend(points(0.4, board, is_board));
        let planes = visible_planes(&all, 0.08, 0.45);
        let on_board = |plane: &&VisiblePlane| {
            let ray = plane.at_m / plane.at_m.z;
            (ray.x - 0.1).abs() < 0.1 && (ray.y + 0.05).abs() < 0.05
        };
        let own: Vec<_> = planes.iter().filter(on_board).collect();
        assert!(own.len() >= 3, "{own:?}");
        for plane in own {
            assert!(plane.normal.angle(&board) < 1e-6, "{plane:?}");
            assert!((plane.at_m - Vector3::new(0.0, 0.0, 0.4)).dot(&board).abs() < 1e-9, "{plane:?}");
        }
        assert!(planes.iter().any(|plane| plane.normal.angle(&wall) < 1e-6 && (plane.at_m.z - 0.9).abs() < 1e-9));
    }

    #[test]
    fn few_points_and_points_behind_the_camera_show_no_plane() {
        assert!(visible_planes(&[], 0.1, 0.5).is_empty());
        let behind = points(-0.5, Vector3::z(), |_, _| true);
        assert!(visible_planes(&behind, 0.1, 0.5).is_empty());
        let few = points(0.5, Vector3::z(), |x, y| x.abs() < 0.02 && y.abs() < 0.03);
        assert!(visible_planes(&few, 0.1, 0.5).is_empty());
    }
}
