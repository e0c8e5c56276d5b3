//! Printed results of a hand-eye calibration.

use crate::hand_eye::{HandEyeFit, RobotSigma};
use nalgebra::Isometry3;
use pb3dp_geometry::frames::{Base, CamLeft, Flange, Hand, World};
use pb3dp_geometry::{Frame, Pose, StereoRig, so3};
use pb3dp_record::calibration_files::BoardPlace;

/// Number of stops with the largest differences to list.
const WORST_STOPS: usize = 3;

/// The poses with the standard deviation of each number, and the stops.
pub(super) fn fit(fit: &HandEyeFit, robot: RobotSigma) -> String {
    let mut lines: Vec<String> = fit.poses().iter().map(|(name, at)| pose(fit, name, at)).collect();
    lines.push(format!(
        "+- is one standard deviation, from {:.3} px per corner and an arm noise of {:.2} times the stated {} mm and {} degrees",
        fit.corner_sigma_px,
        fit.robot_noise_ratio,
        robot.translation_m * 1e3,
        rounded(robot.rotation_rad.to_degrees())
    ));
    let scales = [("squares", fit.scales.squares), ("baseline", fit.scales.baseline)];
    let scales = scales.map(|(name, s)| format!("{name} {:.5} +- {:.5}", s.factor, s.sigma)).join(", ");
    lines.push(format!("true over stated length, with the robot as reference: {scales}"));
    lines.extend(fit.rejected().map(|stop| {
        format!(
            "rejected stop {:?}: disagrees with all others by {:.2} mm and {:.3} degrees, {:.0} standard deviations",
            stop.name, stop.left_out_mm, stop.left_out_deg, stop.left_out_sigmas
        )
    }));
    let mut used: Vec<_> = fit.used().collect();
    used.sort_by(|a, b| b.left_out_sigmas.total_cmp(&a.left_out_sigmas));
    let worst = used
        .iter()
        .take(WORST_STOPS)
        .map(|stop| format!("{:?} {:.2} mm, {:.3} degrees", stop.name, stop.left_out_mm, stop.left_out_deg));
    let worst = worst.collect::<Vec<_>>().join("; ");
    lines
        .push(format!("board pose seen from a stop against the calibration from all other stops, worst ones: {worst}"));
    lines.join("\n")
}

/// Rounds an angle that was entered in degrees and converted to radians and back.
fn rounded(value: f64) -> f64 {
    (value * 1e9).round() / 1e9
}

fn pose(fit: &HandEyeFit, name: &str, pose: &Isometry3<f64>) -> String {
    let (t, turn) = (pose.translation.vector * 1e3, so3::log(&pose.rotation).map(f64::to_degrees));
    let sigma = |number: &str| fit.sigma(&format!("{name}.{number}")).unwrap_or(f64::NAN);
    let [x, y, z] = ["x_m", "y_m", "z_m"].map(|number| sigma(number) * 1e3);
    let [rx, ry, rz] = ["rx_rad", "ry_rad", "rz_rad"].map(|number| sigma(number).to_degrees());
    format!(
        "{name}: {:.3}, {:.3}, {:.3} mm (+- {x:.3}, {y:.3}, {z:.3} along its own axes), rotation vector {:.4}, {:.4}, {:.4} degrees (+- {rx:.4}, {ry:.4}, {rz:.4})",
        t.x, t.y, t.z, turn.x, turn.y, turn.z
    )
}

/// The lines to put into a setup.
pub(super) fn lines(fit: &HandEyeFit, rig: &StereoRig, vs_world_from_base: Option<Pose<World, Base>>) -> String {
    // The hand frame is midway between the two cameras, with the axes of the left camera.
    let hand_from_cam_left: Pose<Hand, CamLeft> = Pose::from_translation(-0.5 * rig.right_centre_in_cam_left());
    let flange_from_hand: Pose<Flange, Hand> = fit.flange_from_cam_left() * hand_from_cam_left.inverse();
    let mut lines = vec![
        "lines for the setup; the hand frame is midway between the cameras, with the axes of the left camera:"
            .to_owned(),
        "[mounts]".to_owned(),
        format!("flange_from_hand = {}", table(&flange_from_hand)),
        format!("hand_from_cam_left = {}", table(&hand_from_cam_left)),
    ];
    if let BoardPlace::Carried { vs_base_from_tc_base, .. } = fit.board() {
        let (world_from_base, note) = match vs_world_from_base {
            Some(pose) => (pose, "arms.vs.world_from_base is taken from --setup"),
            None => (
                Pose::coincident(),
                "the world frame is the base of vs: set arms.vs.world_from_base to zeros, or give --setup",
            ),
        };
        lines.push(format!("[arms.tc]   # {note}"));
        lines.push(format!("world_from_base = {}", table(&(world_from_base * vs_base_from_tc_base))));
    }
    lines.join("\n")
}

fn table<To: Frame, From: Frame>(pose: &Pose<To, From>) -> String {
    let list = |numbers: nalgebra::Vector3<f64>, digits: usize| {
        numbers.iter().map(|number| format!("{number:.digits$}")).collect::<Vec<_>>().join(", ")
    };
    let turn = so3::log(&pose.rotation()).map(f64::to_degrees);
    format!(
        "{{ translation_mm = [{}], rotation_vector_deg = [{}] }}",
        list(pose.translation_m() * 1e3, 4),
        list(turn, 5)
    )
}
