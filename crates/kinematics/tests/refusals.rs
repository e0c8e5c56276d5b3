//! Descriptions that are not a chain of seven revolute joints are rejected, with the name of the joint or link.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::error::Error;

use pb3dp_kinematics::{Chain, ChainError};

const GEN1: &str = include_str!("../../../configs/robots/pa10_gen1.urdf");

fn refused(urdf: &str, tip: &str) -> ChainError {
    Chain::from_urdf_str(urdf, "base_link", tip).unwrap_err()
}

/// One change to the good file must be rejected with a message that contains every one of `words`.
fn check(from: &str, to: &str, words: &[&str]) {
    assert!(GEN1.contains(from), "`{from}` is not in the file: nothing would be tested");
    let error = refused(&GEN1.replacen(from, to, 1), "flange");
    let message = match error.source() {
        Some(cause) => format!("{error}: {cause}"),
        None => error.to_string(),
    };
    for word in words {
        assert!(message.contains(word), "`{word}` is missing in: {message}");
    }
}

#[test]
fn text_that_is_no_urdf() {
    assert!(matches!(refused("<robot", "flange"), ChainError::Parse(_)));
    assert!(matches!(refused("", "flange"), ChainError::Parse(_)));
    assert!(matches!(refused("joints: 7", "flange"), ChainError::Parse(_)));
}

#[test]
fn text_that_is_no_robot_description() {
    check("<?xml version=\"1.0\"?>", "<!DOCTYPE robot [<!ENTITY a \"1\">]>", &["cannot be read as URDF", "DTD"]);
    let many = format!("{}</robot>", "<a/>".repeat(100_000));
    check("</robot>", &many, &["cannot be read as URDF", "nodes limit"]);
    let other_root = GEN1.replace("<robot ", "<model ").replace("</robot>", "</model>");
    assert!(refused(&other_root, "flange").to_string().contains("<model>; the root of a robot description is <robot>"));
}

#[test]
fn attributes_that_cannot_be_read() {
    let velocity = r#"<limit lower="-1.5882496193148399" upper="1.5882496193148399" velocity="1""#;
    for (from, to, words) in [
        (
            r#"<axis xyz="0 1 0"/>"#,
            r#"<axis/>"#,
            ["joint `s2`", "attribute `xyz` of <axis> is missing", "three numbers"],
        ),
        (r#"<axis xyz="0 1 0"/>"#, r#"<axis xyz="0 1 0 0"/>"#, ["joint `s2`", "\"0 1 0 0\"", "three numbers"]),
        (r#"<axis xyz="0 1 0"/>"#, r#"<axis xyz="0 1 y 0"/>"#, ["joint `s2`", "\"0 1 y 0\"", "three numbers"]),
        (r#"xyz="0 0 0.115""#, r#"xyz="0 0 0,115""#, ["joint `s2`", "`xyz` of <origin> is \"0 0 0,115\"", "such as"]),
        (r#"xyz="0 0 0.115""#, r#"xyz="""#, ["joint `s2`", "`xyz` of <origin> is \"\"", "three numbers"]),
        (
            velocity,
            &velocity.replace(r#"velocity="1""#, ""),
            ["joint `s2`", "`velocity` of <limit> is missing", "such as"],
        ),
        (velocity, &velocity.replace(r#"="1""#, r#"="1 rad/s""#), ["joint `s2`", "\"1 rad/s\"", "one number"]),
        (r#"<joint name="s2""#, "<joint", ["joint number 2 of the file", "`name` of <joint> is missing", "a name"]),
        (r#"name="s2" type="revolute""#, r#"name="s2""#, ["joint `s2`", "`type` of <joint> is missing", "`revolute`"]),
        (r#"<link name="link_1"/>"#, "<link/>", ["link number 2 of the file", "`name` of <link> is missing", "a name"]),
        (r#"<parent link="link_1"/>"#, "", ["joint `s2`", "0 elements <parent>", "write one"]),
        (r#"<parent link="link_1"/>"#, "<parent/>", ["joint `s2`", "`link` of <parent> is missing", "a link"]),
        (
            r#"<axis xyz="0 1 0"/>"#,
            r#"<axis xyz="0 1 0"/><axis xyz="1 0 0"/>"#,
            ["joint `s2`", "2 elements <axis>", "one"],
        ),
    ] {
        check(from, to, &words);
    }
}

/// URDF 1.1 has another orientation; from 1.2 on a missing limit means "no limit".
#[test]
fn features_of_later_versions() {
    let later = |version: &str, from: &str, to: &str| {
        assert!(GEN1.contains(from), "`{from}` is not in the file: nothing would be tested");
        let urdf = GEN1.replacen("<robot ", &format!("<robot version=\"{version}\" "), 1).replacen(from, to, 1);
        Chain::from_urdf_str(&urdf, "base_link", "flange").map_err(|error| error.to_string())
    };
    let (origin, turned) = (r#"<origin xyz="0 0 0.115""#, r#"<origin quat_xyzw="0.6 0 0 0.8" xyz="0 0 0.115""#);
    assert!(later("1.0", origin, turned).is_ok());
    let refused = later("1.1", origin, turned).unwrap_err();
    assert!(
        refused.contains("joint `s2`") && refused.contains("`quat_xyzw`") && refused.contains("`rpy`"),
        "{refused}"
    );
    let (upper, without) = (r#" upper="1.5882496193148399""#, "");
    assert!(later("1.0", upper, without).is_ok(), "without an upper limit it is 0");
    assert!(later("1.2", upper, without).unwrap_err().contains("joint `s2`: <limit> is missing or invalid"));
}

#[test]
fn other_elements_and_namespaces_are_ignored() {
    let good = Chain::from_urdf_str(GEN1, "base_link", "flange").unwrap();
    let extra =
        r#"<x:axis xmlns:x="urn:x" xyz="none"/><transmission><joint/></transmission><!-- none --><axis xyz="0 1 0"/>"#;
    let end = r#"<gazebo><link/></gazebo><material name="a"/><x:joint xmlns:x="urn:x"/></robot>"#;
    let urdf = GEN1.replacen(r#"<axis xyz="0 1 0"/>"#, extra, 1).replacen("</robot>", end, 1);
    let with_default_namespace = urdf.replacen("<robot ", "<robot xmlns=\"urn:urdf\" ", 1);
    for urdf in [urdf, with_default_namespace] {
        let chain = Chain::from_urdf_str(&urdf, "base_link", "flange").unwrap();
        assert_eq!(format!("{chain:?}"), format!("{good:?}"));
    }
}

#[test]
fn unknown_link() {
    let message = refused(GEN1, "tool0").to_string();
    assert!(message.contains("`tool0`") && message.contains("link_7, flange"), "{message}");
}

#[test]
fn wrong_number_of_joints() {
    let message = refused(GEN1, "link_5").to_string();
    assert!(message.contains("has 5 revolute joints (s1, s2, s3, e1, e2)"), "{message}");
    let eighth = r#"<link name="extra"/><joint name="x1" type="revolute"><parent link="flange"/><child link="extra"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint></robot>"#;
    let message = refused(&GEN1.replace("</robot>", eighth), "extra").to_string();
    assert!(message.contains("has 8 revolute joints") && message.contains("x1"), "{message}");
}

#[test]
fn joints_and_links_that_are_no_chain() {
    for kind in ["continuous", "prismatic", "floating", "planar"] {
        check(r#""e1" type="revolute""#, &format!(r#""e1" type="{kind}""#), &["joint `e1`", kind]);
    }
    let limit = r#"<limit lower="-2.3911010752322315" upper="2.3911010752322315" velocity="2" effort="68"/>"#;
    let [still, above, endless] =
        [(r#"velocity="2""#, r#"velocity="0""#), (r#"lower="-2.39"#, r#"lower="2.39"#), ("=\"2\"", "=\"inf\"")]
            .map(|(from, to)| limit.replace(from, to));
    let again = r#"<joint name="again" type="fixed"><parent link="link_1"/><child link="link_5"/></joint></robot>"#;
    let (axis, origin) = (r#"<axis xyz="0 1 0"/>"#, r#"<origin xyz="0 0 0.115""#);
    let (child_4, child_6) = (r#"<child link="link_4"/>"#, r#"<child link="link_6"/>"#);
    for (from, to, words) in [
        (child_4, r#"<child link="elsewhere"/>"#, &["link `link_4`", "`base_link`", "`flange`"][..]),
        (r#"<parent link="base_link"/>"#, r#"<parent link="link_3"/>"#, &["not a tree"]),
        ("</robot>", again, &["link `link_5`", "not a tree"]),
        (limit, "", &["joint `e1`", "lower < upper", "0 to 0 rad"]),
        (limit, &still, &["joint `e1`", "velocity", "0 rad/s"]),
        (limit, &above, &["joint `e1`"]),
        (limit, &endless, &["joint `e1`", "inf rad/s"]),
        (axis, r#"<axis xyz="0 0.9 0"/>"#, &["joint `s2`", "length 0.9"]),
        (axis, r#"<axis xyz="0 0 0"/>"#, &["joint `s2`", "length 0"]),
        (axis, r#"<axis xyz="0 NaN 0"/>"#, &["joint `s2`", "NaN"]),
        (origin, r#"<origin xyz="0 NaN 0.115""#, &["joint `s2`", "not finite"]),
        (child_6, r#"<child link="link_6"/><mimic joint="s2"/>"#, &["joint `w1`", "mimics joint `s2`"]),
    ] {
        check(from, to, words);
    }
}
