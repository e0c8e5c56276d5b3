//! Shaped velocities: limits that hold, and directions that are kept.

use proptest::prelude::*;

use super::*;

fn limits() -> JointLimits {
    let max = JointVector::from([2.9, 1.5, 2.8, 2.2, 4.3, 2.7, 4.2]);
    JointLimits::new(-max, max * 0.9, JointVector::from([1.0, 1.1, 2.0, 2.1, 6.0, 6.1, 6.2])).unwrap()
}

fn drives() -> DriveLimits {
    DriveLimits {
        acceleration: JointVector::from([2.0, 2.0, 2.5, 2.5, 5.0, 5.0, 5.0]),
        jerk: JointVector::from([40.0, 40.0, 50.0, 50.0, 100.0, 100.0, 100.0]),
    }
}

/// In the middle of ranges of 100 rad.
fn much_room() -> StopDistance {
    let none = JointVector::zeros();
    StopDistance { to_ends: [JointVector::repeat(100.0); 2], peaks: [none; 2], reaction_s: 0.1 }
}

fn room_at(position: &JointVector) -> StopDistance {
    let limits = limits();
    StopDistance {
        to_ends: [position - limits.position_min_rad(), limits.position_max_rad() - position],
        ..much_room()
    }
}

struct Bench {
    previous: SetPoint,
    drives: DriveLimits,
    caps: SpeedCaps,
}

fn speeds(share: f64) -> JointVector {
    limits().velocity_max_rad_per_s() * share
}

impl Bench {
    fn moving(velocity: JointVector) -> Self {
        let drives = drives();
        let caps = caps(&JointVector::zeros(), &limits(), &speeds(0.5), &drives, 0.05);
        Self { previous: SetPoint { velocity, ..SetPoint::rest() }, drives, caps }
    }

    fn shape(&self, desired: &JointVector, dt_s: f64, stop_distance: Option<&StopDistance>) -> Shaped {
        let speeds = speeds(0.5);
        let step = CycleInput { previous: &self.previous, dt_s, drives: &self.drives, speeds: &speeds };
        shape(desired, &self.caps, &step, stop_distance)
    }
}

/// At the time of the set-point the joint has the acceleration of the set-point: 2 rad/s^2 upwards, which takes 0.1 s and 0.0567
/// rad to become zero, and another 0.12 rad to stop from 0.6 rad/s.
#[test]
fn a_joint_that_is_gaining_speed_needs_room_for_it() {
    let drive = DriveLimit { acceleration: 2.0, jerk: 20.0 };
    let joint =
        |upwards: f64| JointStep { velocity: 0.5 * upwards, acceleration: 2.0 * upwards, dt_s: 0.0, drive, speed: 1.0 };
    let stop_distance =
        |way_rad: f64| StopDistance { to_ends: [JointVector::repeat(way_rad); 2], reaction_s: 0.0, ..much_room() };
    for (side, upwards) in [(0, -1.0), (1, 1.0)] {
        assert!(joint(upwards).has_room(&stop_distance(0.177), 4, side, 0.5), "{side}");
        assert!(!joint(upwards).has_room(&stop_distance(0.176), 4, side, 0.5), "{side}");
    }
}

#[test]
fn outside_its_range_a_joint_may_only_return() {
    let mut position = JointVector::zeros();
    position[1] = 1.4;
    position[3] = -2.3;
    let caps = caps(&position, &limits(), &speeds(0.5), &drives(), 0.05);
    assert_eq!((caps.lower[1], caps.upper[1]), (-0.55, 0.0));
    assert_eq!((caps.lower[3], caps.upper[3]), (0.0, 1.05));
    assert_eq!((caps.lower[0], caps.upper[0]), (-0.5, 0.5));
    assert_eq!(caps.by_position[1], [false, true]);
}

/// 0.2 rad before its limit, with T = 0.05 + 2 / (2 x 40) = 0.075 s: 2 (-0.075 + sqrt(0.075^2 + 0.2)).
#[test]
fn the_cap_counts_the_time_that_jerk_takes() {
    let mut position = JointVector::zeros();
    position[1] = 1.5 * 0.9 - 0.2;
    let caps = caps(&position, &limits(), &speeds(1.0), &drives(), 0.05);
    assert!((caps.upper[1] - 2.0 * (-0.075 + (0.075f64 * 0.075 + 0.2).sqrt())).abs() < 1e-12, "{caps:?}");
}

#[test]
fn too_fast_scales_the_whole_vector() {
    let desired = JointVector::from([0.2, -1.1, 0.3, 0.0, 0.1, 0.0, -0.4]);
    let shaped = Bench::moving(desired * 0.5).shape(&desired, 0.01, Some(&much_room()));
    assert!((shaped.set_point.velocity - desired * 0.5).amax() < 1e-12, "{shaped:?}");
    assert!(shaped.speed_limited && !shaped.position_limited && !shaped.acceleration_limited, "{shaped:?}");
}

#[test]
fn a_joint_at_its_limit_holds_the_whole_arm() {
    let mut position = JointVector::zeros();
    position[5] = limits().position_max_rad()[5];
    let mut bench = Bench::moving(JointVector::zeros());
    bench.caps = caps(&position, &limits(), &speeds(0.5), &drives(), 0.05);
    let shaped = bench.shape(&JointVector::repeat(0.1), 0.1, Some(&room_at(&position)));
    assert_eq!(shaped.set_point, SetPoint::rest());
    assert!(shaped.position_limited && !shaped.speed_limited);
    let away = bench.shape(&JointVector::repeat(-0.01), 0.5, Some(&room_at(&position)));
    assert!((away.set_point.velocity - JointVector::repeat(-0.01)).amax() < 1e-3, "{away:?}");
}

/// The acceleration of the first step is 0.01 s x jerk: of the command 0.5, S1 gets the possible 0.01 s x 40 x 0.01 s.
#[test]
fn a_start_keeps_its_direction() {
    let desired = JointVector::from([0.5, -0.25, 0.0, 0.1, 0.2, 0.0, 1.0]);
    let shaped = Bench::moving(JointVector::zeros()).shape(&desired, 0.01, Some(&much_room()));
    assert!((shaped.set_point.velocity - desired * 0.008).amax() < 1e-12, "{shaped:?}");
    assert!((shaped.set_point.acceleration - desired * 0.8).amax() < 1e-9, "{shaped:?}");
    assert!(shaped.acceleration_limited);
}

#[test]
fn slowing_down_keeps_its_direction_to_the_end() {
    let direction = JointVector::from([0.5, -0.25, 0.0, 0.1, 0.2, 0.0, 1.0]);
    for part in [0.3, 0.0] {
        let mut bench = Bench::moving(direction);
        for _ in 0..200 {
            bench.previous = bench.shape(&(direction * part), 0.01, Some(&much_room())).set_point;
            let velocity = bench.previous.velocity;
            let along = velocity.dot(&direction) / direction.norm_squared();
            assert!((velocity - direction * along).amax() < 1e-12, "{along}: {velocity}");
        }
        assert!((bench.previous.velocity - direction * part).amax() < 1e-9, "{}", bench.previous.velocity);
    }
}

#[test]
fn a_change_of_direction_moves_each_joint_as_far_as_it_may() {
    let mut previous = JointVector::zeros();
    previous[0] = 0.5;
    let mut desired = JointVector::zeros();
    desired[1] = 0.001;
    let shaped = Bench::moving(previous).shape(&desired, 0.01, Some(&much_room()));
    let velocity = shaped.set_point.velocity;
    assert!((velocity[0] - 0.496).abs() < 1e-12, "jerk x dt^2 less: {shaped:?}");
    assert!(velocity[1] > 0.0005 && velocity[1] <= 0.001, "{shaped:?}");
}

#[test]
fn without_a_place_every_joint_comes_to_rest_by_itself() {
    let moving = JointVector::from([0.1, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0]);
    let mut bench = Bench::moving(moving);
    for _ in 0..20 {
        bench.previous = bench.shape(&moving, 0.01, None).set_point;
    }
    let velocity = bench.previous.velocity;
    assert!(velocity[0].abs() < 1e-3 && velocity[4] > 1.0, "{velocity}");
}

fn any_vector(size: f64) -> impl Strategy<Value = JointVector> {
    prop::array::uniform7(-size..size).prop_map(JointVector::from)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(1000) })]

    /// From any set-point of an earlier step, and with any remaining range, every step keeps speed, acceleration and jerk limits.
    #[test]
    fn limits_of_change_always_hold(
        requests in prop::collection::vec((any_vector(20.0), any_vector(3.0), 0.0..0.05f64, any::<bool>()), 1..60),
        scale in 0.05..1.0f64, reaction in 0.0..0.3f64,
    ) {
        let (limits, drives) = (limits(), drives());
        let speeds = speeds(scale);
        let mut previous = SetPoint::rest();
        for (desired, position, dt_s, is_known) in requests {
            let caps = caps(&position, &limits, &speeds, &drives, reaction);
            let step = CycleInput { previous: &previous, dt_s, drives: &drives, speeds: &speeds };
            let stop_distance = room_at(&position);
            let SetPoint { velocity, acceleration } = shape(&desired, &caps, &step, is_known.then_some(&stop_distance)).set_point;
            for i in 0..DOF {
                prop_assert!(velocity[i].abs() <= speeds[i], "joint {i}: {velocity}");
                let change = velocity[i] - previous.velocity[i];
                prop_assert!(change.abs() <= drives.acceleration[i] * dt_s + 1e-12, "joint {i}: {change}");
                prop_assert!(acceleration[i].abs() <= drives.acceleration[i], "joint {i}: {acceleration}");
                let jerk = acceleration[i] - previous.acceleration[i];
                prop_assert!(jerk.abs() <= drives.jerk[i] * dt_s + 1e-9, "joint {i}: {jerk} in {dt_s}");
            }
            previous = SetPoint { velocity, acceleration };
        }
    }

    #[test]
    fn from_rest_the_direction_is_kept(position in any_vector(2.0), desired in any_vector(20.0), step in 0.001..0.05f64) {
        let mut bench = Bench::moving(JointVector::zeros());
        bench.caps = caps(&position, &limits(), &speeds(0.5), &drives(), 0.05);
        let shaped = bench.shape(&desired, step, Some(&room_at(&position)));
        let velocity = shaped.set_point.velocity;
        let along = velocity.dot(&desired) / desired.norm_squared();
        prop_assert!((0.0..=1.0).contains(&along));
        prop_assert!((velocity - desired * along).amax() < 1e-9, "{shaped:?}");
    }
}
