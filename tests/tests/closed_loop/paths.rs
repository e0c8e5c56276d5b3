//! The placement of the workcell: along the whole experiment of the repository's setup no arm comes close to a singular
//! pose, and an experiment beyond the limits is refused.

use std::sync::Arc;

use nalgebra::{Matrix6, SMatrix, Vector6};
use pb3dp_cell::paths::check_paths;
use pb3dp_estimation::estimator::Method;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Flange, Target, World};
use pb3dp_kinematics::{Chain, DOF, JointVector};
use pb3dp_setup::setup::Setup;
use pb3dp_sim::trajectory::{Channel, Trajectory};
use pb3dp_wiring::wire;

use crate::closed_loop::support::whole_setup;

/// Required lower bound of the smallest singular value of the Jacobian, metres and radians.
const SINGULAR_VALUE_MIN: f64 = 0.05;

fn world_from_target_at_start(setup: &Setup) -> Pose<World, Target> {
    let world_from_flange =
        setup.rig.arms.tc.world_from_base * setup.rig.arms.tc.chain.forward(&setup.rig.arms.tc.start_rad);
    world_from_flange * setup.rig.flange_from_target
}

fn experiment(setup: &Setup) -> Arc<dyn Trajectory> {
    setup.experiment.motion.begin_at(world_from_target_at_start(setup)).unwrap()
}

#[test]
fn both_arms_stay_away_from_singular_poses_along_the_whole_experiment() {
    let setup = whole_setup(Method::Direct);
    let experiment = experiment(&setup);
    assert_eq!((experiment.marks().len(), &setup.experiment.steps().unwrap().channels[..]), (12, &Channel::ALL[..]));
    for (name, report) in check_paths(&setup, &*experiment, world_from_target_at_start(&setup), None).unwrap() {
        let smallest = report.singular_value_min.value;
        assert!(smallest > SINGULAR_VALUE_MIN, "{name}: {smallest}");
        assert!(report.fastest_joint().1.value < 1.0, "{name}: {:?}", report.fastest_joint());
        assert!(report.tightest_joint().1.value > 0.0, "{name}: {:?}", report.tightest_joint());
        let by_another_way = match name {
            "vs-robot" => {
                let target_from_flange = Pose::<Target, _>::coincident()
                    * setup.controller.model_from_hand_desired
                    * setup.controller.flange_from_hand.inverse();
                smallest_along(
                    &setup.rig.arms.vs.chain,
                    setup.rig.arms.vs.start_rad,
                    &setup.rig.arms.vs.world_from_base,
                    &*experiment,
                    &target_from_flange,
                )
            }
            _ => {
                let target_from_flange = setup.rig.flange_from_target.inverse();
                smallest_along(
                    &setup.rig.arms.tc.chain,
                    setup.rig.arms.tc.start_rad,
                    &setup.rig.arms.tc.world_from_base,
                    &*experiment,
                    &target_from_flange,
                )
            }
        };
        assert!(by_another_way > SINGULAR_VALUE_MIN, "{name}: {by_another_way}");
        assert!((by_another_way - smallest).abs() < 2e-3, "{name}: {smallest}, but by differences {by_another_way}");
    }
}

/// The smallest singular value along the experiment from forward kinematics alone: Jacobian by differences, joint angles
/// by Newton's method at each point.
fn smallest_along(
    chain: &Chain,
    start_rad: JointVector,
    world_from_base: &Pose<World, Base>,
    experiment: &dyn Trajectory,
    target_from_flange: &Pose<Target, Flange>,
) -> f64 {
    let mut position_rad = start_rad;
    let mut smallest = f64::INFINITY;
    let steps = (experiment.duration_s() / 0.05) as usize;
    for step in 0..=steps {
        let world_from_target = experiment.pose_at(step as f64 * 0.05);
        let wanted = world_from_base.inverse() * world_from_target * *target_from_flange;
        for _ in 0..50 {
            let missing = between(&chain.forward(&position_rad), &wanted);
            if missing.norm() < 1e-9 {
                break;
            }
            let inverse = jacobian(chain, &position_rad).pseudo_inverse(1e-9).unwrap();
            let step_rad = inverse * missing;
            position_rad += step_rad * (0.2 / step_rad.norm()).min(1.0);
        }
        assert!(between(&chain.forward(&position_rad), &wanted).norm() < 1e-6, "the pose is reached");
        let squared: Matrix6<f64> = {
            let j = jacobian(chain, &position_rad);
            j * j.transpose()
        };
        smallest = smallest.min(squared.symmetric_eigenvalues().min().sqrt());
    }
    smallest
}

/// Translation of the origin (m) and rotation vector (rad) from one pose to the other, in `base`.
fn between(from: &Pose<Base, Flange>, to: &Pose<Base, Flange>) -> Vector6<f64> {
    let way = to.translation_m() - from.translation_m();
    let turn = (to.rotation() * from.rotation().inverse()).scaled_axis();
    Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z)
}

fn jacobian(chain: &Chain, position_rad: &JointVector) -> SMatrix<f64, 6, DOF> {
    const STEP_RAD: f64 = 1e-5;
    let mut jacobian = SMatrix::<f64, 6, DOF>::zeros();
    for joint in 0..DOF {
        let moved = |sign: f64| {
            let mut moved_rad = *position_rad;
            moved_rad[joint] += sign * STEP_RAD;
            chain.forward(&moved_rad)
        };
        jacobian.set_column(joint, &(between(&moved(-1.0), &moved(1.0)) / (2.0 * STEP_RAD)));
    }
    jacobian
}

#[test]
fn the_rigs_default_speed_is_refused_for_this_experiment_by_how_much() {
    let mut setup = whole_setup(Method::Direct);
    for arm in [&mut setup.rig.arms.vs, &mut setup.rig.arms.tc] {
        arm.limits = arm.limits.slowed(f64::MAX, 0.10).unwrap();
    }
    let Err(error) = wire(&setup) else { panic!("at a tenth of the speeds the arms cannot follow") };
    let text = format!("{error:#}");
    let terms: Vec<&str> = text.split_whitespace().collect();
    let axis = terms.iter().position(|term| *term == "axis").expect("the message names the axis");
    assert!((1..=DOF).contains(&terms[axis + 1].parse::<usize>().unwrap()), "{text}");
    let ratio = terms.iter().position(|term| *term == "times").expect("the message gives the ratio");
    assert!(terms[ratio - 1].parse::<f64>().unwrap() > 1.05, "{text}");
    assert!(text.contains("vs-robot") && text.contains("arms.speed_scale"), "{text}");
}

#[test]
fn the_zero_pose_does_not_serve() {
    let mut setup = whole_setup(Method::Direct);
    setup.rig.arms.vs.start_rad = JointVector::zeros();
    setup.rig.arms.tc.start_rad = JointVector::zeros();
    let Err(error) = wire(&setup) else { panic!("a stretched arm is singular") };
    assert!(format!("{error:#}").contains("robot"), "{error:#}");
}
