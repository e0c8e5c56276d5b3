//! What a setup cannot take from an arm that is not emulated: an enclosing shape, and the speed of its drives.

use super::*;

type Change = fn(&mut Table);

/// Whatever the other arm does, it would never be too near to a point at the base.
#[test]
fn shapes_that_do_not_enclose_a_real_arm_are_refused() {
    const BARE: &str = "arms.vs.parts: the arm is bare between the base and joint";
    fn parts(root: &mut Table) -> &mut Vec<Value> {
        root["arms"]["vs"]["parts"].as_array_mut().unwrap()
    }
    fn move_part(root: &mut Table, index: usize, on: &str) {
        parts(root)[index].as_table_mut().unwrap().insert("on".to_owned(), on.into());
    }
    /// Encloses the line through the joints, and not the link around it.
    fn thin(root: &mut Table, index: usize) {
        parts(root)[index].as_table_mut().unwrap().insert("radius_mm".to_owned(), Value::Float(30.0));
    }
    let changes: [(Change, &str); 7] = [
        (|root| drop(parts(root).drain(1..)), "arms.vs.parts: the arm is bare between joint"),
        (|root| drop(parts(root).remove(0)), BARE),
        (|root| move_part(root, 1, "joint 0"), "arms.vs.parts: the arm is bare between joint"),
        (|root| thin(root, 3), "arms.vs.parts: the arm is bare between joint"),
        (|root| drop(parts(root).remove(4)), "arms.vs.parts: the left camera is in no part"),
        (|root| move_part(root, 4, "joint 3"), "arms.vs.parts: the right camera is in no part"),
        (
            |root| drop(root["arms"]["tc"]["parts"].as_array_mut().unwrap().drain(4..)),
            "arms.tc.parts: the target is in no part",
        ),
    ];
    for (change, expected) in changes {
        let mut sample = Sample::new("rig.toml", |file| read_setup(file).map(drop));
        change(&mut sample.table);
        check_refused(&sample, expected);
    }
    check_lines(&[("rig.toml", "arms.least_room_mm = 9.0", "arms.least_room_mm = 9: allowed are 10 to 1000 mm")]);
    // What is simulated may have any shape.
    let mut sample = Sample::new("sim.toml", |file| read_setup(file).map(drop));
    parts(&mut sample.table).drain(1..);
    assert_eq!(sample.refusal_of(&[]), None);
}

/// The limits of a run are shares of the speeds that the robot description states.
#[test]
fn a_robot_description_cannot_raise_the_speed_of_a_drive() {
    let refusal = |name: &'static str, velocity: &str| {
        let sample = Sample::new(name, |file| read_setup(file).map(drop));
        let folder = sample.folder.path().join("robots");
        let text = std::fs::read_to_string(folder.join("pa10_gen2.urdf")).unwrap();
        let file = folder.join("changed.urdf");
        std::fs::write(&file, text.replacen("velocity=\"1\"", &format!("velocity=\"{velocity}\""), 2)).unwrap();
        sample.refusal_of(&[("arms.vs.robot".to_owned(), Value::String(file.display().to_string()))])
    };
    let text = refusal("rig.toml", "4").unwrap();
    let stated = "axis 2 has velocity = 4 rad/s; the drive of a PA-10 turns it by at most 1.0000 rad/s";
    assert!(text.contains("arms.vs.robot") && text.contains(stated), "{text}");
    // A slower one is possible, and so is any speed of an arm simulated in this program.
    for (name, velocity) in [("rig.toml", "0.5"), ("sim.toml", "4")] {
        assert_eq!(refusal(name, velocity), None);
    }
}
