//! Clearance between two arms: each arm is a set of capsules, and the clearance is the smallest distance between any two of
//! them.

use nalgebra::{Isometry3, Point3, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, World};

use crate::{DOF, JointFrames, JointVector};

/// A capsule: all points within `radius_m` of a line segment. Metres; the frame is the owner's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Capsule {
    /// End points of the segment.
    pub ends_m: [Point3<f64>; 2],
    /// Distance of the surface from the segment.
    pub radius_m: f64,
}

impl Capsule {
    /// Distance between the surfaces, metres; negative if the capsules overlap, by at most the penetration depth.
    pub fn distance_m(&self, other: &Self) -> f64 {
        segment_distance(&self.ends_m, &other.ends_m) - self.radius_m - other.radius_m
    }

    /// The smallest enclosing sphere: its centre and its radius, metres.
    fn ball(&self) -> (Point3<f64>, f64) {
        let [a, b] = self.ends_m;
        (nalgebra::center(&a, &b), 0.5 * (b - a).norm() + self.radius_m)
    }

    fn moved(&self, motion: &Isometry3<f64>) -> Self {
        Self { ends_m: self.ends_m.map(|end| motion * end), radius_m: self.radius_m }
    }
}

/// Body to which a part of an arm is attached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// The base, which does not move.
    Base,
    /// The link after a joint, numbered from the base, 0 to 6.
    Joint(usize),
    /// The flange with everything mounted there: a tool, cameras, a target.
    Flange,
}

/// A part of an arm; the capsule must enclose the real part, including cables.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmPart {
    /// Name for messages, for example `upper arm`.
    pub name: String,
    /// Body to which it is attached.
    pub carrier: Carrier,
    /// Its shape in the carrier's frame, metres.
    pub capsule: Capsule,
}

/// Why parts are not a valid collision shape of an arm.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ArmShapeError {
    /// There are no parts, so that no clearance would ever be too small.
    #[error("the arm's collision shape has no parts; give at least one capsule")]
    Empty,
    /// A number is not a valid length.
    #[error("part `{part}`: {value} m is invalid; radii must be above 0 and all numbers finite")]
    Number {
        /// Name of the part.
        part: String,
        /// The number given, metres.
        value: f64,
    },
    /// A joint that the arm does not have.
    #[error("part `{part}` is attached to joint {joint}; joints are numbered from the base, 0 to 6")]
    NoSuchJoint {
        /// Name of the part.
        part: String,
        /// The index given.
        joint: usize,
    },
}

/// Collision shape of an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmShape {
    parts: Vec<ArmPart>,
}

/// The two parts nearest to each other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearance<'a> {
    /// Distance between them, metres; negative if they overlap.
    pub distance_m: f64,
    /// Part of the first arm.
    pub first: &'a str,
    /// Part of the second arm.
    pub second: &'a str,
}

/// An arm at one moment: its shape, its base pose, and its joint poses.
#[derive(Clone, Copy, Debug)]
pub struct PlacedArm<'a> {
    /// The shape.
    pub shape: &'a ArmShape,
    /// Pose of the base.
    pub world_from_base: &'a Pose<World, Base>,
    /// Joint frames of the arm's own chain.
    pub frames: &'a JointFrames,
}

impl ArmShape {
    /// Creates a shape from its parts.
    ///
    /// # Errors
    /// No parts, a radius that is not positive, a number that is not finite, or a joint that does not exist.
    pub fn new(parts: Vec<ArmPart>) -> Result<Self, ArmShapeError> {
        if parts.is_empty() {
            return Err(ArmShapeError::Empty);
        }
        for ArmPart { name, carrier, capsule } in &parts {
            let part = || name.clone();
            let coordinates = capsule.ends_m.iter().flat_map(|end| end.iter());
            if let Some(&value) = coordinates.chain([&capsule.radius_m]).find(|value| !value.is_finite()) {
                return Err(ArmShapeError::Number { part: part(), value });
            }
            if capsule.radius_m <= 0.0 {
                return Err(ArmShapeError::Number { part: part(), value: capsule.radius_m });
            }
            if let Carrier::Joint(joint @ DOF..) = *carrier {
                return Err(ArmShapeError::NoSuchJoint { part: part(), joint });
            }
        }
        Ok(Self { parts })
    }

    /// The parts.
    pub fn parts(&self) -> &[ArmPart] {
        &self.parts
    }

    /// Whether a point is inside a part, at least `depth_m` below its surface.
    pub fn covers(&self, frames: &JointFrames, point_in_base: Point3<f64>, depth_m: f64) -> bool {
        let point = Capsule { ends_m: [point_in_base; 2], radius_m: 0.0 };
        let distance_m = |part: &ArmPart| part.capsule.moved(&frames.base_from(part.carrier)).distance_m(&point);
        self.parts.iter().any(|part| distance_m(part) <= ROUNDING_M - depth_m)
    }

    /// Name of the first piece of the arm that the shape leaves bare: a point of the line from the base through all joint origins to
    /// the flange that is not `thickness_m` below the surface of a part.
    ///
    /// The line is inside any real arm whose joints are on it, and so is everything closer to it than the thinnest link is thick: a shape
    /// that leaves some of it bare does not enclose the arm. A shape that covers all of it may still be too thin.
    pub fn bare_piece(&self, frames: &JointFrames, thickness_m: f64) -> Option<String> {
        let origins = frames.origins_in_base();
        let name = |index: usize| match index {
            0 => "the base".to_owned(),
            joint if joint <= DOF => format!("joint {}", joint - 1),
            _ => "the flange".to_owned(),
        };
        origins.windows(2).enumerate().find_map(|(index, ends)| {
            let steps = ((ends[1] - ends[0]).norm() / BARE_STEP_M).ceil().max(1.0) as u32;
            let point = |step: u32| ends[0] + (ends[1] - ends[0]) * (f64::from(step) / f64::from(steps));
            let is_covered = (0..=steps).map(point).all(|point| self.covers(frames, point, thickness_m));
            (!is_covered).then(|| format!("between {} and {}", name(index), name(index + 1)))
        })
    }
}

impl PlacedArm<'_> {
    /// Upper bound of the motion of any point of a part, metres, while every joint rotates by at most `reach_rad`.
    ///
    /// Computed from the tip on: a joint moves everything that it carries along an arc around its axis. The radius of the arc
    /// is the distance of the part's farther end, plus the motion that the joints after it may have added.
    fn moves_by(&self, part: &ArmPart, reach_rad: &JointVector) -> f64 {
        let (joints, base_from_part) = match part.carrier {
            Carrier::Base => return 0.0,
            Carrier::Joint(joint) => (joint + 1, self.frames.base_from_joint[joint]),
            Carrier::Flange => (DOF, *self.frames.base_from_flange.isometry()),
        };
        let ends = part.capsule.ends_m.map(|end| base_from_part * end);
        let mut moved_m = 0.0;
        for joint in (0..joints).rev() {
            let origin = Point3::from(self.frames.base_from_joint[joint].translation.vector);
            let axis = &self.frames.axis_in_base[joint];
            let radius = |end: &Point3<f64>| axis.cross(&(end - origin)).norm();
            moved_m += reach_rad[joint].abs() * (radius(&ends[0]).max(radius(&ends[1])) + moved_m);
        }
        moved_m
    }

    fn in_world(&self, part: &ArmPart) -> Capsule {
        part.capsule.moved(&(self.world_from_base.isometry() * self.frames.base_from(part.carrier)))
    }

    /// The part in `world`, enlarged by its largest motion while every joint rotates by at most `reach_rad`.
    fn swept(&self, part: &ArmPart, reach_rad: &JointVector) -> Capsule {
        let capsule = self.in_world(part);
        Capsule { radius_m: capsule.radius_m + self.moves_by(part, reach_rad), ..capsule }
    }
}

impl JointFrames {
    /// Pose of the body to which a part is attached.
    fn base_from(&self, carrier: Carrier) -> Isometry3<f64> {
        match carrier {
            Carrier::Base => Isometry3::identity(),
            Carrier::Joint(joint) => self.base_from_joint[joint],
            Carrier::Flange => *self.base_from_flange.isometry(),
        }
    }
}

/// Distance between two points at which it is checked whether a shape covers the arm; parts are several times as thick.
const BARE_STEP_M: f64 = 0.01;

/// Far above the rounding error of a distance in a workcell.
const ROUNDING_M: f64 = 1e-9;

/// Number of parts whose positions are buffered together; arms have fewer.
const PARTS_AT_ONCE: usize = 16;

/// The clearance between two arms; minus infinity if a position is not a number.
pub fn clearance<'a>(first: &PlacedArm<'a>, second: &PlacedArm<'a>) -> Clearance<'a> {
    let nowhere = JointVector::zeros();
    clearance_within((first, &nowhere), (second, &nowhere))
}

/// Lower bound of the clearance between two arms while each joint moves independently within `reach_rad` of its position; minus
/// infinity if a position is not a number.
pub fn clearance_within<'a>(
    (first, first_reach_rad): (&PlacedArm<'a>, &JointVector),
    (second, second_reach_rad): (&PlacedArm<'a>, &JointVector),
) -> Clearance<'a> {
    let mut nearest: Option<Clearance<'a>> = None;
    // On the stack: this runs in every cycle, which must not allocate.
    for others in second.shape.parts.chunks(PARTS_AT_ONCE) {
        let nothing = Capsule { ends_m: [Point3::origin(); 2], radius_m: 0.0 };
        let mut others_swept = [(nothing, nothing.ball()); PARTS_AT_ONCE];
        for ((swept, ball), other) in others_swept.iter_mut().zip(others) {
            *swept = second.swept(other, second_reach_rad);
            *ball = swept.ball();
        }
        for one in &first.shape.parts {
            let one_swept = first.swept(one, first_reach_rad);
            let (middle, radius_m) = one_swept.ball();
            for (other, (other_swept, (other_middle, other_radius_m))) in others.iter().zip(&others_swept) {
                // For most parts the distance of the enclosing spheres is decisive.
                let apart_m = (middle - other_middle).norm() - radius_m - other_radius_m;
                if nearest.is_some_and(|so_far| apart_m > so_far.distance_m + ROUNDING_M) {
                    continue;
                }
                let distance_m = one_swept.distance_m(other_swept);
                // A NaN counts as no clearance.
                let distance_m = if distance_m.is_nan() { f64::NEG_INFINITY } else { distance_m };
                if nearest.is_none_or(|so_far| distance_m < so_far.distance_m) {
                    nearest = Some(Clearance { distance_m, first: &one.name, second: &other.name });
                }
            }
        }
    }
    // A shape has at least one part.
    nearest.unwrap_or(Clearance { distance_m: f64::NEG_INFINITY, first: "", second: "" })
}

/// Distance between two line segments.
///
/// Minimum of a convex quadratic form of two parameters within 0 to 1. It is the unconstrained minimum if that is inside.
/// Otherwise it is on one of the four edges, where an end of one segment is nearest to the other segment.
fn segment_distance(a: &[Point3<f64>; 2], b: &[Point3<f64>; 2]) -> f64 {
    let ends = [
        distance_to_segment(&a[0], b),
        distance_to_segment(&a[1], b),
        distance_to_segment(&b[0], a),
        distance_to_segment(&b[1], a),
    ];
    let on_an_edge = ends.into_iter().fold(f64::INFINITY, |least, distance| match distance {
        // `min` would drop a NaN.
        _ if distance.is_nan() => distance,
        _ if distance < least => distance,
        _ => least,
    });
    inner_distance(a, b).map_or(on_an_edge, |inner| inner.min(on_an_edge))
}

/// Length of the common perpendicular of two segments, if both feet are inside the segments.
fn inner_distance(a: &[Point3<f64>; 2], b: &[Point3<f64>; 2]) -> Option<f64> {
    let (along_a, along_b, between) = (a[1] - a[0], b[1] - b[0], b[0] - a[0]);
    let normal: Vector3<f64> = along_a.cross(&along_b);
    let squared = normal.norm_squared();
    // For parallel segments, an end is among the nearest points.
    if squared <= 1e-18 * along_a.norm_squared() * along_b.norm_squared() || squared == 0.0 {
        return None;
    }
    let at_a = between.cross(&along_b).dot(&normal) / squared;
    let at_b = between.cross(&along_a).dot(&normal) / squared;
    let within = |share: f64| (0.0..=1.0).contains(&share);
    (within(at_a) && within(at_b)).then(|| (between.dot(&normal) / squared.sqrt()).abs())
}

fn distance_to_segment(point: &Point3<f64>, segment: &[Point3<f64>; 2]) -> f64 {
    let (along, to_point) = (segment[1] - segment[0], point - segment[0]);
    let squared = along.norm_squared();
    let share = if squared > 0.0 { (to_point.dot(&along) / squared).clamp(0.0, 1.0) } else { 0.0 };
    (to_point - along * share).norm()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn capsule(a: [f64; 3], b: [f64; 3], radius_m: f64) -> Capsule {
        Capsule { ends_m: [a.into(), b.into()], radius_m }
    }

    #[test]
    fn distances_by_hand() {
        let rod = capsule([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 0.1);
        for (other, expected, what) in [
            (capsule([0.5, -1.0, 0.4], [0.5, 1.0, 0.4], 0.05), 0.25, "crossing above the middle"),
            (capsule([0.2, 0.5, 0.0], [0.7, 0.5, 0.0], 0.05), 0.35, "parallel, side by side"),
            (capsule([1.5, 0.0, 0.0], [2.5, 0.0, 0.0], 0.05), 0.35, "in line, behind each other"),
            (capsule([1.3, 0.4, 0.0], [1.3, 0.4, 5.0], 0.05), 0.35, "past the end: 3, 4, 5"),
            (capsule([0.5, 0.3, 0.0], [0.5, 0.3, 0.0], 0.1), 0.1, "a ball"),
            (capsule([0.5, -1.0, 0.0], [0.5, 1.0, 0.0], 0.05), -0.15, "through each other"),
        ] {
            assert!((rod.distance_m(&other) - expected).abs() < 1e-12, "{what}: {}", rod.distance_m(&other));
            assert!((other.distance_m(&rod) - expected).abs() < 1e-12, "{what}, exchanged");
        }
    }

    #[test]
    fn the_ball_around_a_capsule_touches_both_its_ends() {
        let (middle, radius_m) = capsule([1.0, -2.0, 0.5], [3.0, 1.0, 6.5], 0.1).ball();
        // 2, 3, 6: 7 m long.
        assert!((middle - Point3::new(2.0, -0.5, 3.5)).norm() < 1e-15 && (radius_m - 3.6).abs() < 1e-15, "{radius_m}");
    }

    #[test]
    fn what_is_no_number_is_never_room() {
        let rod = capsule([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], 0.1);
        let lost = capsule([f64::NAN, 3.0, 0.0], [0.0, 4.0, 0.0], 0.1);
        assert!(rod.distance_m(&lost).is_nan() && lost.distance_m(&rod).is_nan());
    }

    /// The rig's arm, straight up, with a part at its flange; and another arm 2 m away.
    fn two_arms(check: impl Fn(&crate::Chain, &ArmShape, &[Pose<World, Base>; 2])) {
        let urdf = include_str!("../../../configs/robots/pa10_gen2.urdf");
        let chain = crate::Chain::from_urdf_str(urdf, "base_link", "flange").unwrap();
        let part = |name: &str, carrier, end_m: [f64; 3]| ArmPart {
            name: name.to_owned(),
            carrier,
            capsule: capsule([0.0, 0.0, 0.0], end_m, 0.1),
        };
        let shape = ArmShape::new(vec![
            part("base", Carrier::Base, [0.0, 0.0, 0.317]),
            part("upper arm", Carrier::Joint(1), [0.0, 0.0, 0.45]),
            part("forearm", Carrier::Joint(3), [0.0, 0.0, 0.48]),
            part("tool", Carrier::Flange, [0.05, 0.0, 0.2]),
        ])
        .unwrap();
        let turned = nalgebra::UnitQuaternion::from_euler_angles(0.0, 0.0, 3.0);
        let places = [
            Pose::from_parts(Vector3::new(-1.0, 0.1, 0.7), nalgebra::UnitQuaternion::identity()),
            Pose::from_parts(Vector3::new(1.0, 0.0, 0.7), turned),
        ];
        check(&chain, &shape, &places);
    }

    #[test]
    fn arms_that_stand_up_are_as_far_apart_as_their_bases() {
        two_arms(|chain, shape, places| {
            let frames = chain.joint_frames(&JointVector::zeros());
            let [first, second] = [0, 1].map(|i| PlacedArm { shape, world_from_base: &places[i], frames: &frames });
            let bases_m = (2.0f64 * 2.0 + 0.1 * 0.1).sqrt();
            let room = clearance(&first, &second);
            assert!(room.distance_m < bases_m - 0.2 && room.distance_m > bases_m - 0.31, "{room:?}");
            // S1 rotates the part on its axis, and the tool's end 50 mm from it.
            let mut reach_rad = JointVector::zeros();
            reach_rad[0] = 0.1;
            let within = clearance_within((&first, &reach_rad), (&second, &JointVector::zeros()));
            assert!((room.distance_m - within.distance_m - 0.005).abs() < 1e-12, "{room:?} {within:?}");
            // S2 rotates the tool's end about the shoulder, 0.45 + 0.48 + 0.07 + 0.2 m below it.
            (reach_rad[0], reach_rad[1]) = (0.0, 0.1);
            let within = clearance_within((&first, &reach_rad), (&second, &JointVector::zeros()));
            assert!((room.distance_m - within.distance_m - 0.12).abs() < 2e-3, "{room:?} {within:?}");
        });
    }

    /// By hand, for the upright arm: the elbow is 0.45 m above the shoulder, the flange 0.55 m above the elbow.
    #[test]
    fn what_is_carried_moves_by_the_arcs_of_all_joints_below_it() {
        two_arms(|chain, shape, places| {
            let frames = chain.joint_frames(&JointVector::zeros());
            let arm = PlacedArm { shape, world_from_base: &places[0], frames: &frames };
            let of = |carrier, end_m: [f64; 3], reach_rad: [f64; DOF]| {
                let capsule = capsule([0.0; 3], end_m, 0.1);
                arm.moves_by(&ArmPart { name: "part".to_owned(), carrier, capsule }, &JointVector::from(reach_rad))
            };
            // The joint that carries a part moves it as well.
            let upper_arm = of(Carrier::Joint(1), [0.0, 0.0, 0.45], [0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]);
            assert!((upper_arm - 0.1 * 0.45).abs() < 1e-12, "{upper_arm}");
            // A joint after a part does not.
            assert_eq!(of(Carrier::Joint(1), [0.0, 0.0, 0.45], [0.0, 0.0, 0.3, 0.4, 0.5, 0.6, 0.7]), 0.0);
            // The motion added by E1 increases the distance from the shoulder when S2 rotates.
            let tool = of(Carrier::Flange, [0.0, 0.0, 0.2], [0.0, -0.2, 0.0, 0.3, 0.0, 0.0, 0.0]);
            let by_elbow_m = 0.3 * (0.55 + 0.2);
            let by_hand_m = by_elbow_m + 0.2 * (0.45 + 0.55 + 0.2 + by_elbow_m);
            assert!((tool - by_hand_m).abs() < 1e-12, "{tool} {by_hand_m}");
        });
    }

    #[test]
    fn a_shape_that_does_not_enclose_the_arm_is_refused_with_the_uncovered_point() {
        two_arms(|chain, _, _| {
            let bent = chain.joint_frames(&JointVector::from([0.1, 0.9, -0.2, 0.5, 0.3, 0.4, 0.0]));
            let all = |radius_m: f64| {
                let part = |carrier, length_m: f64| {
                    let capsule = capsule([0.0; 3], [0.0, 0.0, length_m], radius_m);
                    ArmPart { name: "part".to_owned(), carrier, capsule }
                };
                let (base, upper, fore, hand) =
                    (Carrier::Base, Carrier::Joint(1), Carrier::Joint(3), Carrier::Joint(5));
                vec![part(base, 0.317), part(upper, 0.45), part(fore, 0.48), part(hand, 0.08)]
            };
            let bare = |radius_m, thickness_m| ArmShape::new(all(radius_m)).unwrap().bare_piece(&bent, thickness_m);
            assert_eq!((bare(0.02, 0.0), bare(0.02, 0.02)), (None, None));
            assert_eq!(bare(0.02, 0.021).as_deref(), Some("between the base and joint 0"));
            for (missing, piece) in [
                (0, "between the base and joint 0"),
                (1, "between joint 1 and joint 2"),
                (2, "between joint 3 and joint 4"),
                (3, "between joint 6 and the flange"),
            ] {
                let mut parts = all(0.02);
                parts.remove(missing);
                assert_eq!(ArmShape::new(parts).unwrap().bare_piece(&bent, 0.0).as_deref(), Some(piece));
            }
            // Parts that enclose the upright arm and move with the base leave the bent arm bare.
            let fixed = ArmPart {
                carrier: Carrier::Base,
                capsule: capsule([0.0; 3], [0.0, 0.0, 1.5], 0.2),
                name: "pillar".to_owned(),
            };
            let fixed = ArmShape::new(vec![fixed]).unwrap();
            assert_eq!(fixed.bare_piece(&chain.joint_frames(&JointVector::zeros()), 0.0), None);
            assert!(fixed.bare_piece(&bent, 0.0).is_some());
        });
    }

    #[test]
    fn an_arm_of_many_parts_is_looked_at_to_its_last_part() {
        two_arms(|chain, shape, places| {
            let frames = chain.joint_frames(&JointVector::from([0.1, 0.9, -0.2, 0.5, 0.3, 0.4, 0.0]));
            let bases = std::iter::repeat_n(&shape.parts()[0], PARTS_AT_ONCE + 3);
            let many = ArmShape::new(bases.chain(shape.parts()).cloned().collect()).unwrap();
            let placed = |shape, i: usize| PlacedArm { shape, world_from_base: &places[i], frames: &frames };
            let few_room = clearance(&placed(shape, 0), &placed(shape, 1));
            assert_eq!(few_room.second, "tool");
            assert_eq!(clearance(&placed(shape, 0), &placed(&many, 1)), few_room);
            assert_eq!(clearance(&placed(&many, 0), &placed(shape, 1)), few_room);
        });
    }

    /// Reference without the early exits of the comparison.
    fn of_all_pairs(first: (&PlacedArm<'_>, &JointVector), second: (&PlacedArm<'_>, &JointVector)) -> f64 {
        let swept = |(arm, reach_rad): (&PlacedArm<'_>, &JointVector)| -> Vec<Capsule> {
            arm.shape.parts.iter().map(|part| arm.swept(part, reach_rad)).collect()
        };
        let (first, second) = (swept(first), swept(second));
        let distances = first.iter().flat_map(|one| second.iter().map(|other| one.distance_m(other)));
        distances.fold(f64::INFINITY, f64::min)
    }

    fn any_joints(most: f64) -> impl Strategy<Value = JointVector> {
        prop::array::uniform7(-most..most).prop_map(JointVector::from)
    }

    fn any_point() -> impl Strategy<Value = Point3<f64>> {
        prop::array::uniform3(-1.0..1.0f64).prop_map(Point3::from)
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

        /// Wherever the joints of both arms move within their reach, the clearance is at least the reported one.
        #[test]
        fn no_pose_within_reach_has_less_room(
            first in any_joints(2.0), second in any_joints(2.0), first_part in any_joints(1.0), second_part in any_joints(1.0),
            size in 0.0..0.5f64,
        ) {
            two_arms(|chain, shape, places| {
                let reach_rad = JointVector::repeat(size);
                let [from, to] = [[first, second], [first + first_part * size, second + second_part * size]]
                    .map(|joints| joints.map(|joints| chain.joint_frames(&joints)));
                let placed = |frames, i: usize| PlacedArm { shape, world_from_base: &places[i], frames };
                let limited = clearance_within(
                    (&placed(&from[0], 0), &reach_rad),
                    (&placed(&from[1], 1), &reach_rad),
                );
                let all = of_all_pairs((&placed(&from[0], 0), &reach_rad), (&placed(&from[1], 1), &reach_rad));
                assert_eq!(limited.distance_m, all);
                let found = clearance(&placed(&to[0], 0), &placed(&to[1], 1));
                assert!(limited.distance_m <= found.distance_m + 1e-12, "{limited:?} {found:?}");
            });
        }

        /// No pair of points on a fine grid is nearer, and at least one is nearly as near.
        #[test]
        fn segments_are_as_far_apart_as_their_points(
            a in [any_point(), any_point()], b in [any_point(), any_point()],
        ) {
            const STEPS: u32 = 100;
            let found = segment_distance(&a, &b);
            let on = |segment: &[Point3<f64>; 2], k: u32| segment[0] + (segment[1] - segment[0]) * (f64::from(k) / f64::from(STEPS));
            let mut least = f64::INFINITY;
            for (i, j) in (0..=STEPS).flat_map(|i| (0..=STEPS).map(move |j| (i, j))) {
                least = least.min((on(&a, i) - on(&b, j)).norm());
            }
            let step = ((a[1] - a[0]).norm() + (b[1] - b[0]).norm()) / f64::from(STEPS);
            prop_assert!(found <= least + 1e-12 && found >= least - step, "{found} {least}");
        }
    }
}
