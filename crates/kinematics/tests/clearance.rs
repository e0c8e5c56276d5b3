//! Clearance between two PA-10 arms 804 mm apart, as in the two-arm workcells of the literature.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use nalgebra::{Point3, UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, World};
use pb3dp_kinematics::{
    ArmPart, ArmShape, ArmShapeError, Capsule, Carrier, Chain, Clearance, JointVector, PlacedArm, clearance,
};

const GEN2: &str = include_str!("../../../configs/robots/pa10_gen2.urdf");

fn part(name: &str, carrier: Carrier, ends_m: [[f64; 3]; 2], radius_m: f64) -> ArmPart {
    ArmPart { name: name.to_owned(), carrier, capsule: Capsule { ends_m: ends_m.map(Point3::from), radius_m } }
}

/// Column, upper arm (from the shoulder, after S2, to the elbow), forearm (after E1) and a camera bar across the flange.
fn shape() -> ArmShape {
    ArmShape::new(vec![
        part("column", Carrier::Base, [[0.0, 0.0, 0.0], [0.0, 0.0, 0.317]], 0.12),
        part("upper arm", Carrier::Joint(1), [[0.0; 3], [0.0, 0.0, 0.45]], 0.1),
        part("forearm", Carrier::Joint(3), [[0.0; 3], [0.0, 0.0, 0.48]], 0.08),
        part("camera bar", Carrier::Flange, [[-0.1, 0.0, 0.05], [0.1, 0.0, 0.05]], 0.03),
    ])
    .unwrap()
}

fn base_at(y_m: f64, yaw_deg: f64) -> Pose<World, Base> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::to_radians(yaw_deg));
    Pose::from_parts(Vector3::new(0.2, y_m, 0.7), turn)
}

struct Room {
    distance_m: f64,
    parts: [String; 2],
}

fn room(first_deg: [f64; 7], second_deg: [f64; 7]) -> Room {
    let chain = Chain::from_urdf_str(GEN2, "base_link", "flange").unwrap();
    let shape = shape();
    let frames = [first_deg, second_deg].map(|deg| chain.joint_frames(&JointVector::from(deg).map(f64::to_radians)));
    let bases = [base_at(0.0, 90.0), base_at(0.804, -90.0)];
    let placed = |i: usize| PlacedArm { shape: &shape, world_from_base: &bases[i], frames: &frames[i] };
    let Clearance { distance_m, first, second } = clearance(&placed(0), &placed(1));
    let exchanged = clearance(&placed(1), &placed(0));
    assert!((exchanged.distance_m - distance_m).abs() < 1e-12 || exchanged.distance_m == distance_m);
    assert_eq!((exchanged.first, exchanged.second), (second, first));
    Room { distance_m, parts: [first.to_owned(), second.to_owned()] }
}

#[test]
fn two_upright_arms_are_a_base_distance_apart() {
    // The camera bars point at each other, each 0.1 m long to that side.
    let found = room([0.0; 7], [0.0; 7]);
    assert!((found.distance_m - (0.804 - 2.0 * (0.1 + 0.03))).abs() < 1e-12, "{} {:?}", found.distance_m, found.parts);
    assert_eq!(found.parts, ["camera bar", "camera bar"]);
    // Rotated across by W2, they leave the columns as the nearest parts.
    let across = room([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 90.0], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -90.0]);
    assert!((across.distance_m - (0.804 - 2.0 * 0.12)).abs() < 1e-12, "{} {:?}", across.distance_m, across.parts);
    assert_eq!(across.parts, ["column", "column"]);
}

/// Both bases face each other. S2 = 90 degrees lowers the first arm towards the second: its elbow is 0.45 m away at shoulder
/// height, and the forearm extends a further 0.48 m, through the column of the second arm.
#[test]
fn an_arm_that_leans_over_reaches_the_other() {
    let over = room([0.0, 90.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 7]);
    assert!((over.distance_m + (0.08 + 0.12)).abs() < 1e-9, "{} {:?}", over.distance_m, over.parts);
    // With the elbow bent up again the upper arm is nearest: 0.804 - 0.45, minus both radii.
    let bent = room([0.0, 90.0, 0.0, -90.0, 0.0, 0.0, 0.0], [0.0; 7]);
    let by_hand = 0.804 - 0.45 - 0.1 - 0.12;
    assert!((bent.distance_m - by_hand).abs() < 1e-9, "{} {:?}, {by_hand}", bent.distance_m, bent.parts);
    assert_eq!(bent.parts, ["upper arm", "column"]);
    // S1 rotates it away.
    let away = room([180.0, 90.0, 0.0, -90.0, 0.0, 0.0, 0.0], [0.0; 7]);
    assert!(away.distance_m > 0.5, "{}", away.distance_m);
}

#[test]
fn a_joint_that_is_no_number_leaves_no_room() {
    let lost = room([0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 7]);
    assert_eq!(lost.distance_m, f64::NEG_INFINITY);
}

#[test]
fn parts_that_are_none_are_refused_by_name() {
    let bar = |carrier, radius_m| vec![part("bar", carrier, [[0.0; 3], [0.0, 0.0, 0.1]], radius_m)];
    assert_eq!(ArmShape::new(Vec::new()), Err(ArmShapeError::Empty));
    for radius_m in [0.0, -0.1, f64::INFINITY] {
        let error = ArmShape::new(bar(Carrier::Base, radius_m)).unwrap_err();
        assert_eq!(error, ArmShapeError::Number { part: "bar".to_owned(), value: radius_m });
    }
    let error = ArmShape::new(bar(Carrier::Joint(7), 0.1)).unwrap_err().to_string();
    assert!(error.contains("`bar` is attached to joint 7"), "{error}");
    assert!(ArmShape::new(vec![part("x", Carrier::Base, [[0.0; 3], [0.0, f64::NAN, 0.0]], 0.1)]).is_err());
}
