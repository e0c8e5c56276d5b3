//! An arm with six axes: the meaning of a description with fewer joints than the capacity.

use nalgebra::Matrix4;
use pb3dp_kinematics::{Chain, DOF, JointVector, NO_JOINT_RAD, singular_values};

fn ur5e_like() -> Chain {
    Chain::from_urdf_str(include_str!("../../../configs/robots/ur5e_like.urdf"), "base_link", "flange").unwrap()
}

fn pa10() -> Chain {
    Chain::from_urdf_str(include_str!("../../../configs/robots/pa10_gen2.urdf"), "base_link", "flange").unwrap()
}

/// Without any symmetry.
const JOINTS_RAD: [f64; DOF] = [0.3, -1.1, 1.4, -0.7, 0.9, -0.4, 0.0];

/// From the Denavit-Hartenberg parameters, multiplied in another language (Python with numpy).
#[test]
fn the_flange_is_where_the_published_parameters_put_it() {
    let expected = Matrix4::new(
        0.572_133_68,
        0.645_804_03,
        -0.505_569_20,
        -0.590_169_30, //
        -0.578_241_08,
        -0.119_532_47,
        -0.807_062_11,
        -0.386_899_60, //
        -0.581_635_89,
        0.754_088_29,
        0.305_041_87,
        0.363_912_49, //
        0.0,
        0.0,
        0.0,
        1.0,
    );
    let found = ur5e_like().forward(&JOINTS_RAD.into()).isometry().to_homogeneous();
    assert!((found - expected).amax() < 2e-8, "{found}");
}

#[test]
fn singular_values_are_those_of_the_six_columns() {
    let expected = [1.990_758_82, 1.514_667_11, 0.820_374_68, 0.416_200_65, 0.386_560_37, 0.196_012_44];
    let found = singular_values(&ur5e_like().jacobian(&JOINTS_RAD.into()));
    assert!(found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-7), "{found}");
}

#[test]
fn nothing_depends_on_the_joint_that_there_is_not() {
    let chain = ur5e_like();
    assert_eq!((chain.joints(), chain.joint_names().len()), (6, 6));
    let mut moved = JointVector::from(JOINTS_RAD);
    moved[6] = 2.0;
    assert_eq!(chain.forward(&moved), chain.forward(&JOINTS_RAD.into()));
    assert_eq!(chain.jacobian(&moved).column(6), nalgebra::Vector6::zeros());
    assert_eq!(chain.limits().position_max_rad()[6], NO_JOINT_RAD);
    let origins = chain.joint_frames(&JOINTS_RAD.into()).origins_in_base();
    assert_eq!(origins[DOF - 1], origins[DOF], "the arm as a polyline gets no further joint");
}

#[test]
fn an_arm_with_shoulder_and_wrist_has_an_elbow_and_others_have_none() {
    assert_eq!(pa10().elbow(), Some(3));
    assert_eq!(ur5e_like().elbow(), None);
    // Axes that do not intersect are not a shoulder.
    let bent =
        include_str!("../../../configs/robots/pa10_gen2.urdf").replacen("xyz=\"0 0 0.317\"", "xyz=\"0.02 0 0.317\"", 1);
    assert_ne!(bent, include_str!("../../../configs/robots/pa10_gen2.urdf"));
    assert_eq!(Chain::from_urdf_str(&bent, "base_link", "flange").unwrap().elbow(), None);
}

#[test]
fn too_few_and_too_many_joints_are_refused_with_their_number() {
    let text = include_str!("../../../configs/robots/ur5e_like.urdf");
    let fixed = text.replacen("name=\"wrist_3\" type=\"revolute\"", "name=\"wrist_3\" type=\"fixed\"", 1);
    let message = Chain::from_urdf_str(&fixed, "base_link", "flange").unwrap_err().to_string();
    assert!(message.contains("has 5 revolute joints") && message.contains("6 or 7 are supported"), "{message}");
}
