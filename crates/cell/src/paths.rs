//! Checks before motion whether both arms can follow an experiment.

use anyhow::{Result, bail};
use nalgebra::{Point3, Vector2};
use pb3dp_geometry::frames::{Model, Target, World};
use pb3dp_geometry::{Camera, Pose, Twist};
use pb3dp_servo::LawConfig;
use pb3dp_setup::setup::{ArmSetup, Carrier, Setup};
use pb3dp_sim::placement::{
    FlangePath, PathRefusal, PathReport, PathRequirements, ToolSpeed, ToolSpeedMax, check_experiment,
};
use pb3dp_sim::trajectory::{Mark, MotionConfig, Trajectory};

/// Checks whether the arms can follow an experiment within their limits: reach, joint ranges, singular poses, speeds and accelerations of
/// the joints, and the speeds of the hand. `start` is the pose of the target before the experiment.
///
/// A free target may move faster than any hand can follow; this causes only a warning. With `until_s` only the motion before this time is
/// checked, seconds of the experiment: a run that ends then never reaches the rest.
///
/// # Errors
/// The arm, the excess over the limit, and the key of the limit; a motion parameter out of its range.
pub fn check_paths(
    setup: &Setup,
    experiment: &dyn Trajectory,
    start: Pose<World, Target>,
    until_s: Option<f64>,
) -> Result<Vec<(&'static str, PathReport)>> {
    check_desired_view(setup)?;
    if let Some(warning) = warning_of_law(setup, &start) {
        tracing::warn!("{warning}");
    }
    let is_carried = setup.experiment.carrier == Carrier::Arm;
    let stand_in = if is_carried { None } else { Some(without_jumps(&setup.experiment.motion).begin_at(start)?) };
    let experiment = &FirstPart { whole: stand_in.as_deref().unwrap_or(experiment), until_s };
    let of_hand = of_hand(setup);
    let (vs, tc) = (&setup.rig.arms.vs, &setup.rig.arms.tc);
    let follower = FlangePath::of_follower(
        experiment,
        &vs.world_from_base,
        &Pose::<Target, Model>::coincident(),
        &setup.controller.model_from_hand_desired,
        &setup.controller.flange_from_hand,
    );
    let carrier = FlangePath::of_carrier(experiment, &tc.world_from_base, &setup.rig.flange_from_target);
    let mut paths = vec![("vs-robot", vs, follower, of_hand)];
    if is_carried {
        paths.push(("tc-robot", tc, carrier, PathRequirements::OF_EXPERIMENT));
    }
    let check = |(name, arm, path, requirements): (_, &ArmSetup, FlangePath<'_>, PathRequirements)| {
        let checked = check_experiment(&arm.chain, &arm.limits, &arm.start_rad, &path, &requirements);
        Ok((name, checked.map_err(|refusal| refused(name, &arm.key, refusal))?))
    };
    match paths.into_iter().map(check).collect::<Result<_>>() {
        Err(refusal) if !is_carried => {
            tracing::warn!("{refusal:#}; the free target moves anyway");
            Ok(Vec::new())
        }
        checked => checked,
    }
}

/// As [`check_paths`], from the start poses of the setup.
///
/// # Errors
/// As [`check_paths`].
pub fn check_stated_paths(setup: &Setup) -> Result<Vec<(&'static str, PathReport)>> {
    let tc = &setup.rig.arms.tc;
    let start = tc.world_from_base * tc.chain.forward(&tc.start_rad) * setup.rig.flange_from_target;
    check_paths(setup, &*setup.experiment.motion.begin_at(start)?, start, None)
}

/// Rotation about the optical axis from which the image-based law is warned of, degrees. The hand retreats and loses the target at 120 and 180
/// degrees (measured in simulation); from 90 degrees on the points of the target come closer in the image before they turn.
const RETREATS_FROM_DEG: f64 = 90.0;

/// Why the image-based law will lose the target that the hand has to approach from its start.
fn warning_of_law(setup: &Setup, start: &Pose<World, Target>) -> Option<String> {
    let (vs, controller) = (&setup.rig.arms.vs, &setup.controller);
    if !matches!(controller.law, LawConfig::ImageBased(_)) {
        return None;
    }
    let world_from_hand = vs.world_from_base * vs.chain.forward(&vs.start_rad) * controller.flange_from_hand;
    let desired = *start * Pose::<Target, Model>::coincident() * controller.model_from_hand_desired;
    let mounting = controller.hand_from_cam_left;
    let turn = (desired * mounting).inverse() * (world_from_hand * mounting);
    // Twice the rotation of the quaternion about the optical axis alone.
    let rotation = turn.rotation();
    let about_axis_deg = 2.0 * rotation.k.abs().atan2(rotation.w.abs()).to_degrees();
    (about_axis_deg > RETREATS_FROM_DEG).then(|| {
        format!(
            "servo.law is image-based, and the camera has to turn by {about_axis_deg:.0} degrees about its optical axis: with this law the hand \
             may retreat until it loses the target (docs/servo.md); use feed-forward or hybrid, or change servo.model_from_hand_desired"
        )
    })
}

/// Refuses a desired pose of the hand from which no camera sees the origin of the target: the hand would turn the cameras away, and the
/// target would be lost.
fn check_desired_view(setup: &Setup) -> Result<()> {
    let (rig, controller) = (&setup.rig.stereo, &setup.controller);
    let cam_left_from_model = (controller.model_from_hand_desired * controller.hand_from_cam_left).inverse();
    let in_left = Point3::from(cam_left_from_model.translation_m());
    let in_right = rig.cam_right_from_cam_left().transform_point(&in_left);
    let pixels = [rig.left().project(&in_left), rig.right().project(&in_right)];
    let is_inside = |camera: &Camera, px: &Vector2<f64>| {
        let size = camera.size();
        (0.0..f64::from(size.width)).contains(&px.x) && (0.0..f64::from(size.height)).contains(&px.y)
    };
    let is_visible = |(camera, px): (&Camera, &Option<Vector2<f64>>)| px.is_some_and(|px| is_inside(camera, &px));
    if [rig.left(), rig.right()].into_iter().zip(&pixels).any(is_visible) {
        return Ok(());
    }
    let place = |px: Option<Vector2<f64>>| match px {
        Some(px) if px.amax() < 1e5 => format!("at ({:.0}, {:.0}) px", px.x, px.y),
        // Almost at right angles to its optical axis.
        _ => "not in front of it".to_owned(),
    };
    let [left, right] = pixels.map(place);
    let size = rig.left().size();
    bail!(
        "servo.model_from_hand_desired: from this pose of the hand neither camera sees the origin of the target (left camera: {left}, right \
         camera: {right}, images of {}x{} px): the hand would turn away and lose it; state a pose that faces the target",
        size.width,
        size.height
    )
}

/// The motion of a run that may end early.
struct FirstPart<'a> {
    whole: &'a dyn Trajectory,
    /// When the run ends, seconds; none: at the end of the motion.
    until_s: Option<f64>,
}

impl Trajectory for FirstPart<'_> {
    fn pose_at(&self, t_s: f64) -> Pose<World, Target> {
        self.whole.pose_at(t_s)
    }

    fn twist_at(&self, t_s: f64) -> Twist<World> {
        self.whole.twist_at(t_s)
    }

    fn marks(&self) -> &[Mark] {
        self.whole.marks()
    }

    fn duration_s(&self) -> f64 {
        let whole_s = self.whole.duration_s();
        self.until_s.map_or(whole_s, |until_s| until_s.clamp(0.0, whole_s))
    }
}

/// The same motion with a duration for each step move, so that its poses can be checked for reach.
fn without_jumps(motion: &MotionConfig) -> MotionConfig {
    /// Substitute duration of a step move, seconds: slow enough for every supported arm.
    const STAND_IN_S: f64 = 2.0;
    let mut motion = motion.clone();
    if let MotionConfig::Steps(steps) = &mut motion
        && steps.move_s == 0.0
    {
        steps.move_s = STAND_IN_S;
    }
    motion
}

/// What the path of the hand must fulfil.
fn of_hand(setup: &Setup) -> PathRequirements {
    let tracking = setup.controller.speed.tracking;
    let hand_max =
        ToolSpeedMax { linear_m_per_s: tracking.linear_m_per_s, angular_rad_per_s: tracking.angular_rad_per_s };
    PathRequirements { tool_speed_max: Some(hand_max), ..PathRequirements::OF_EXPERIMENT }
}

/// Setup table of the arm whose hand goes to the desired pose before the target.
const FOLLOWER: &str = "arms.vs";

/// A refusal with the setup keys that decide it.
fn refused(name: &str, table: &str, refusal: PathRefusal) -> anyhow::Error {
    let keys = keys_of(table, &refusal);
    let text = format!("the {name} cannot follow the experiment (see {keys} and the table [experiment])");
    anyhow::Error::new(refusal).context(text)
}

/// The setup keys that decide a refusal.
fn keys_of(table: &str, refusal: &PathRefusal) -> String {
    match refusal {
        PathRefusal::JointRange { joint, .. } => format!("{table}.operating_range_deg[{joint}]"),
        PathRefusal::TooFast { .. } => "arms.speed_scale".to_owned(),
        PathRefusal::TooAbrupt { joint, .. } => format!("{table}.acceleration_max_rad_per_s2[{joint}]"),
        PathRefusal::ToolTooFast { quantity: ToolSpeed::Linear, .. } => "servo.speed.linear_max_mm_per_s".to_owned(),
        PathRefusal::ToolTooFast { quantity: ToolSpeed::Angular, .. } => "servo.speed.angular_max_deg_per_s".to_owned(),
        _ if table == FOLLOWER => {
            format!("servo.model_from_hand_desired, {table}.world_from_base, {table}.start_deg")
        }
        _ => format!("{table}.world_from_base, {table}.start_deg"),
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_geometry::so3;
    use pb3dp_kinematics::StatedLimits;
    use pb3dp_servo::{ImageBasedConfig, TargetFilterConfig};
    use pb3dp_setup::setup::{ArmSetup, read_setup};

    use super::*;

    /// The repository's setup with a change, checked against its experiment.
    fn checked(change: impl FnOnce(&mut Setup)) -> Result<Vec<(&'static str, PathReport)>> {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        let mut setup = read_setup(std::path::Path::new(file)).unwrap();
        change(&mut setup);
        check_stated_paths(&setup)
    }

    fn refusal(change: impl FnOnce(&mut Setup)) -> (PathRefusal, String) {
        let error = checked(change).unwrap_err();
        let text = format!("{error:#}");
        (error.downcast::<PathRefusal>().unwrap(), text)
    }

    #[test]
    fn the_repositorys_experiment_leaves_a_reserve_in_every_limit() {
        let [(_, vs), (_, tc)] = <[_; 2]>::try_from(checked(|_| {}).unwrap()).unwrap();
        for (name, report) in [("vs-robot", &vs), ("tc-robot", &tc)] {
            for (joint, peak) in report.acceleration_max_rad_per_s2.iter().enumerate() {
                let allowed = if joint < 4 { 2.0 } else { 5.0 };
                assert!(peak.value < 0.8 * allowed, "{name} joint {joint}: {peak:?}");
            }
        }
        assert!(vs.tool_linear_max_m_per_s.value < 0.8 * 0.4, "{vs:?}");
        assert!(vs.tool_angular_max_rad_per_s.value < 0.8 * 45f64.to_radians(), "{vs:?}");
    }

    #[test]
    fn moves_that_the_hand_may_not_follow_are_refused_with_key_and_ratio() {
        // A turn by 20 degrees in 2 s reaches at most 0.327 rad/s, and 0.164 m/s at 500 mm.
        let (refused, text) = refusal(|setup| setup.controller.speed.tracking.linear_m_per_s = 0.1);
        assert!(matches!(refused, PathRefusal::ToolTooFast { quantity: ToolSpeed::Linear, .. }), "{text}");
        for part in ["vs-robot", "servo.speed.linear_max_mm_per_s", "[experiment]", "0.164 m/s", "1.64 times"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
        let (refused, text) = refusal(|setup| setup.controller.speed.tracking.angular_rad_per_s = 0.3);
        assert!(matches!(refused, PathRefusal::ToolTooFast { quantity: ToolSpeed::Angular, .. }), "{text}");
        for part in ["vs-robot", "servo.speed.angular_max_deg_per_s", "0.327 rad/s", "1.09 times"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
    }

    /// The hand may not turn by 20 degrees in 2 s, but the moves along x before it are slow enough.
    #[test]
    fn only_the_part_before_the_end_of_the_run_is_checked() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
        let mut setup = read_setup(std::path::Path::new(file)).unwrap();
        setup.controller.speed.tracking.linear_m_per_s = 0.1;
        let tc = &setup.rig.arms.tc;
        let start = tc.world_from_base * tc.chain.forward(&tc.start_rad) * setup.rig.flange_from_target;
        let experiment = setup.experiment.motion.begin_at(start).unwrap();
        let refused_at_s = match check_paths(&setup, &*experiment, start, None).unwrap_err().downcast() {
            Ok(PathRefusal::ToolTooFast { at_s, .. }) => at_s,
            other => panic!("{other:?}"),
        };
        let until = |s: f64| check_paths(&setup, &*experiment, start, Some(s));
        assert!(until(1.0).is_ok());
        assert!(until(refused_at_s).is_err() && until(1e6).is_err());
        assert_eq!(until(1e6).unwrap_err().to_string(), until(f64::INFINITY).unwrap_err().to_string());
    }

    #[test]
    fn a_desired_pose_out_of_reach_is_named() {
        for desired in [[0.0, 0.0, -3.0], [0.3, 0.0, -2.0]] {
            let (_, text) = refusal(|setup| {
                let pose = &mut setup.controller.model_from_hand_desired;
                *pose = Pose::from_parts(desired.into(), pose.rotation());
            });
            for part in ["vs-robot", "see servo.model_from_hand_desired, arms.vs.world_from_base"] {
                assert!(text.contains(part), "{part} is not in {text}");
            }
        }
    }

    #[test]
    fn large_rotations_about_the_optical_axis_warn_of_the_image_based_law() {
        let warning = |law: &str, turn_deg: f64| {
            let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
            let mut setup = read_setup(std::path::Path::new(file)).unwrap();
            if law == "image-based" {
                setup.controller.law = LawConfig::ImageBased(ImageBasedConfig {
                    gain_per_s: 4.0,
                    half_width_m: 0.05,
                    target_filter: TargetFilterConfig {
                        position_time_constant_s: 0.05,
                        orientation_time_constant_s: 0.3,
                        gate_position_m: 0.1,
                        gate_orientation_rad: 0.5,
                        observations_to_lock: 3,
                    },
                });
            }
            let tc = &setup.rig.arms.tc;
            let start = tc.world_from_base * tc.chain.forward(&tc.start_rad) * setup.rig.flange_from_target;
            let pose = &mut setup.controller.model_from_hand_desired;
            let turn = so3::exp(&nalgebra::Vector3::new(0.0, 0.0, turn_deg.to_radians()));
            *pose = Pose::from_parts(pose.translation_m(), pose.rotation() * turn);
            warning_of_law(&setup, &start)
        };
        for turn_deg in [120.0, 180.0] {
            let text = warning("image-based", turn_deg).unwrap();
            assert!(text.contains("servo.law is image-based") && text.contains("use feed-forward or hybrid"), "{text}");
            assert_eq!(warning("feed-forward", turn_deg), None);
        }
        assert_eq!(warning("image-based", 30.0), None);
    }

    #[test]
    fn a_desired_pose_that_looks_elsewhere_is_refused() {
        for turn_deg in [[0.0, 60.0, 0.0], [90.0, 0.0, 0.0], [0.0, 180.0, 0.0]] {
            let error = checked(|setup| {
                let pose = &mut setup.controller.model_from_hand_desired;
                let turn = so3::exp(&nalgebra::Vector3::from(turn_deg.map(f64::to_radians)));
                *pose = Pose::from_parts(pose.translation_m(), pose.rotation() * turn);
            });
            let text = format!("{:#}", error.unwrap_err());
            assert!(
                text.contains("servo.model_from_hand_desired: from this pose of the hand neither camera sees"),
                "{text}"
            );
        }
    }

    fn weaken(arm: &mut ArmSetup, joint: usize, acceleration_max_rad_per_s2: f64) {
        let limits = &arm.limits;
        let mut stated = StatedLimits {
            // All of the operating limits.
            servo: *limits.operating(),
            operating_min_rad: *limits.operating().position_min_rad(),
            operating_max_rad: *limits.operating().position_max_rad(),
            speed_scale: 1.0,
            acceleration_max_rad_per_s2: *limits.acceleration_max_rad_per_s2(),
            jerk_max_rad_per_s3: *limits.jerk_max_rad_per_s3(),
        };
        stated.acceleration_max_rad_per_s2[joint] = acceleration_max_rad_per_s2;
        arm.limits = stated.effective().unwrap();
    }

    #[test]
    fn moves_that_either_arms_drives_do_not_allow_are_refused_with_key_and_ratio() {
        let [(_, vs), (_, tc)] = <[_; 2]>::try_from(checked(|_| {}).unwrap()).unwrap();
        let needed = [vs.acceleration_max_rad_per_s2[1].value, tc.acceleration_max_rad_per_s2[3].value];
        let (refused, text) = refusal(|setup| weaken(&mut setup.rig.arms.vs, 1, needed[0] / 2.0));
        assert!(matches!(refused, PathRefusal::TooAbrupt { joint: 1, .. }), "{text}");
        for part in ["vs-robot", "arms.vs.acceleration_max_rad_per_s2[1]", "2.00 times too much"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
        let (refused, text) = refusal(|setup| weaken(&mut setup.rig.arms.tc, 3, needed[1] / 3.0));
        assert!(matches!(refused, PathRefusal::TooAbrupt { joint: 3, .. }), "{text}");
        for part in ["tc-robot", "arms.tc.acceleration_max_rad_per_s2[3]", "3.00 times too much"] {
            assert!(text.contains(part), "{part} is not in {text}");
        }
    }
}
