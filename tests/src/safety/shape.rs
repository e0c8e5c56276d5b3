//! Distances of bodies that consist of all points within a radius of a line segment.

use super::pa10::{Lengths, Links, links};
use super::truth::{Joints, Placement};
use super::ur5e;

/// All points within `radius_m` of the line segment between two points, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rod {
    /// Ends of the line segment.
    pub ends_m: [[f64; 3]; 2],
    /// Distance of the surface from the segment.
    pub radius_m: f64,
}

impl Rod {
    /// The rod in another frame.
    pub fn placed(&self, a_from_b: &Placement) -> Self {
        Self { ends_m: self.ends_m.map(|end| a_from_b.point(&end)), radius_m: self.radius_m }
    }

    /// Distance of the surfaces, metres; below 0 where they overlap.
    pub fn distance_m(&self, other: &Self) -> f64 {
        line_distance_m(&self.ends_m, &other.ends_m) - self.radius_m - other.radius_m
    }
}

/// The smallest distance between two sets of rods, metres. NaN if a position is NaN.
pub fn room_m(some: &[Rod], others: &[Rod]) -> f64 {
    let mut least_m = f64::INFINITY;
    for one in some {
        for other in others {
            let distance_m = one.distance_m(other);
            if distance_m.is_nan() {
                return distance_m;
            }
            least_m = least_m.min(distance_m);
        }
    }
    least_m
}

fn minus(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Distance of two line segments by clamping the end points of their common perpendicular, one after the other
/// (C. Ericson, Real-Time Collision Detection, 2005, section 5.1.9).
fn line_distance_m(first: &[[f64; 3]; 2], second: &[[f64; 3]; 2]) -> f64 {
    let (d1, d2) = (minus(&first[1], &first[0]), minus(&second[1], &second[0]));
    let r = minus(&first[0], &second[0]);
    let (a, e, f) = (dot(&d1, &d1), dot(&d2, &d2), dot(&d2, &r));
    let (c, b) = (dot(&d1, &r), dot(&d1, &d2));
    const POINT: f64 = 1e-18;
    let (s, t) = if a <= POINT && e <= POINT {
        (0.0, 0.0)
    } else if a <= POINT {
        (0.0, (f / e).clamp(0.0, 1.0))
    } else if e <= POINT {
        ((-c / a).clamp(0.0, 1.0), 0.0)
    } else {
        let denominator = a * e - b * b;
        let s = if denominator > 1e-12 * a * e { ((b * f - c * e) / denominator).clamp(0.0, 1.0) } else { 0.0 };
        let t = (b * s + f) / e;
        if t < 0.0 {
            ((-c / a).clamp(0.0, 1.0), 0.0)
        } else if t > 1.0 {
            (((b - c) / a).clamp(0.0, 1.0), 1.0)
        } else {
            (s, t)
        }
    };
    let apart: [f64; 3] = std::array::from_fn(|i| r[i] + d1[i] * s - d2[i] * t);
    dot(&apart, &apart).sqrt()
}

/// The links of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Build {
    /// A PA-10 with these lengths.
    Pa10(Lengths),
    /// An arm with six axes.
    Ur5e,
}

impl Build {
    /// Bodies of base, upper arm, forearm and wrist as line segments, and `base_from_flange`.
    fn links(&self, q_rad: &Joints) -> ([[[f64; 3]; 2]; 4], Placement) {
        match self {
            Self::Pa10(lengths) => {
                let Links { shoulder_m, elbow_m, wrist_m, flange } = links(lengths, q_rad);
                let points = [[0.0; 3], shoulder_m, elbow_m, wrist_m, flange.translation_m];
                (std::array::from_fn(|i| [points[i], points[i + 1]]), flange)
            }
            Self::Ur5e => ur5e::links(q_rad),
        }
    }

    /// Pose of the flange in `base`.
    pub fn flange(&self, q_rad: &Joints) -> Placement {
        self.links(q_rad).1
    }
}

/// Shape of an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmBody {
    /// Its links.
    pub build: Build,
    /// `world_from_base`.
    pub base: Placement,
    /// Radii of base, upper arm, forearm and wrist, metres.
    pub radii_m: [f64; 4],
    /// Bodies mounted on the flange, in its frame.
    pub mounted: Vec<Rod>,
}

impl ArmBody {
    /// All bodies of the arm in `world`, base first, mounted bodies last; written to `rods`, which is cleared first.
    pub fn place(&self, q_rad: &Joints, rods: &mut Vec<Rod>) {
        let (bodies, flange) = self.build.links(q_rad);
        rods.clear();
        let of_links = bodies.into_iter().zip(self.radii_m);
        rods.extend(of_links.map(|(ends_m, radius_m)| Rod { ends_m, radius_m }.placed(&self.base)));
        let world_from_flange = self.base.then(&flange);
        rods.extend(self.mounted.iter().map(|rod| rod.placed(&world_from_flange)));
    }

    /// No point of the arm is farther than this from any of its axes, metres.
    pub fn reach_m(&self) -> f64 {
        let links_m = match self.build {
            Build::Pa10(Lengths { elbow, wrist, flange, .. }) => elbow + wrist + flange,
            Build::Ur5e => ur5e::REACH_M,
        };
        let beyond = self.mounted.iter().flat_map(|rod| rod.ends_m.map(|end| dot(&end, &end).sqrt() + rod.radius_m));
        links_m + beyond.fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_estimation_core::rng::SplitMix64;

    use super::*;

    fn rod(a: [f64; 3], b: [f64; 3], radius_m: f64) -> Rod {
        Rod { ends_m: [a, b], radius_m }
    }

    #[test]
    fn distances_by_hand() {
        let along_x = rod([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 0.1);
        for (other, expected_m) in [
            (rod([0.3, -1.0, 0.5], [0.3, 1.0, 0.5], 0.2), 0.2),
            (rod([0.2, 0.4, 0.0], [0.9, 0.4, 0.0], 0.1), 0.2),
            (rod([3.0, 0.0, 0.0], [1.6, 0.0, 0.0], 0.1), 0.4),
            (rod([-0.6, 0.8, 0.0], [-0.6, 0.8, 3.0], 0.3), 0.6),
            (rod([0.5, 0.7, 0.0], [0.5, 0.7, 0.0], 0.1), 0.5),
            (rod([0.5, -1.0, 0.0], [0.5, 1.0, 0.0], 0.2), -0.3),
        ] {
            assert!((along_x.distance_m(&other) - expected_m).abs() < 1e-12, "{other:?}");
            assert!((other.distance_m(&along_x) - expected_m).abs() < 1e-12, "{other:?}, exchanged");
        }
    }

    /// Compares with the smallest distance on a fine grid of points of both segments.
    #[test]
    fn distances_are_those_of_a_grid() {
        let mut random = SplitMix64::new(7);
        for _ in 0..200 {
            let [first, second] = [0, 1].map(|_| [0, 1].map(|_| [0, 1, 2].map(|_| random.between(-1.0, 1.0))));
            let exact_m = line_distance_m(&first, &second);
            let mut grid_m = f64::INFINITY;
            for i in 0..=100 {
                for j in 0..=100 {
                    let on = |line: &[[f64; 3]; 2], share: f64| -> [f64; 3] {
                        std::array::from_fn(|k| line[0][k] + (line[1][k] - line[0][k]) * share)
                    };
                    let apart = minus(&on(&first, f64::from(i) / 100.0), &on(&second, f64::from(j) / 100.0));
                    grid_m = grid_m.min(dot(&apart, &apart).sqrt());
                }
            }
            assert!(exact_m <= grid_m + 1e-12 && grid_m - exact_m < 0.03, "{exact_m} {grid_m}");
        }
    }

    #[test]
    fn what_is_no_number_is_no_room() {
        let good = rod([0.0; 3], [1.0, 0.0, 0.0], 0.1);
        let lost = rod([f64::NAN, 3.0, 0.0], [0.0, 4.0, 0.0], 0.1);
        assert!(room_m(&[good, lost], &[good]).is_nan());
    }
}
