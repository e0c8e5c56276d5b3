//! The sequences: motions, lighting and occlusion.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model, Target, World};
use pb3dp_sim::scene::ScenePoses;
use pb3dp_sim::targets::Paint;

use super::cell::{Condition, Light, Setup, Shape};
use super::trial::plane_of;

/// Motion of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Motion {
    /// Along and about all axes at once: 50 mm (35 mm down and up) and 20 degrees, periods of 4 to 7 s.
    Combined,
    /// Stationary.
    Still,
    /// 100 mm along and 20 degrees about each axis in turn, out and back: the experiment of the paper's Fig. 7.
    Steps,
    /// A start and a motion of its own.
    Own(OwnMotion),
}

/// A start, and sine waves along and about all axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OwnMotion {
    /// Position at the start, metres.
    pub start_m: Vector3<f64>,
    /// Rotation at the start, degrees: about y, then x, then the normal.
    pub start_deg: Vector3<f64>,
    /// Amplitudes along the axes, metres.
    pub shift_m: Vector3<f64>,
    /// Amplitudes about the axes, degrees.
    pub turn_deg: Vector3<f64>,
    /// Periods of the six waves, seconds.
    pub period_s: [f64; 6],
    /// Their phases at the start, radians.
    pub phase_rad: [f64; 6],
}

/// One sequence.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceSpec {
    /// Its name.
    pub name: String,
    /// The setup without the motion.
    pub setup: Setup,
    /// The motion.
    pub motion: Motion,
    /// Frames.
    pub frames: usize,
    /// Frames per second.
    pub rate_hz: f64,
    /// Whether an occluder slides in and out: frames [`HIDING`].
    pub hides: bool,
    /// Whether surfaces are sampled finely; long runs are not.
    pub fine: bool,
    /// The condition of the cameras.
    pub condition: Condition,
}

/// First frame in which the occluder slides in, first in which the target is fully hidden, first in which the occluder
/// slides out, and first in which the target is fully visible again.
pub const HIDING: [usize; 4] = [60, 68, 98, 106];

/// Search range of the trackers at the start.
pub const SEARCH: SearchRange = SearchRange { z_min_m: 0.33, z_max_m: 0.84, tilt_max_rad: 0.785 };

fn spec(name: &str, setup: Setup) -> SequenceSpec {
    SequenceSpec {
        name: format!("track/{name}"),
        setup,
        motion: Motion::Combined,
        frames: 300,
        rate_hz: 30.0,
        hides: false,
        fine: true,
        condition: Condition::Undisturbed,
    }
}

/// All sequences of a default run.
pub fn all() -> Vec<SequenceSpec> {
    let nominal = Setup::default();
    let mut sequences = Vec::new();
    for paint in [Paint::Crab, Paint::Colourful, Paint::Grey] {
        let setup = Setup { paint, ..nominal };
        sequences.push(spec(&format!("{}-30fps", paint.name()), setup));
        sequences.push(SequenceSpec { rate_hz: 7.5, ..spec(&format!("{}-7.5fps", paint.name()), setup) });
    }
    for relief in [10.0, 25.0] {
        let shape = Shape::Crab { relief_m: relief * 1e-3 };
        let setup = Setup { shape, ..nominal };
        sequences.push(spec(&format!("relief-{relief}mm"), setup));
        sequences.push(spec(&format!("shaded-relief-{relief}mm"), Setup { light: Light::Shaded, ..setup }));
    }
    let relief = Setup { shape: Shape::Crab { relief_m: 0.025 }, ..nominal };
    let steps = SequenceSpec { motion: Motion::Steps, frames: 450, rate_hz: 15.0, ..spec("", relief) };
    sequences.push(SequenceSpec { name: "track/relief-25mm-fig7".into(), ..steps });
    let still = SequenceSpec { motion: Motion::Still, frames: 150, ..spec("", nominal) };
    sequences.push(SequenceSpec { name: "still/crab".into(), ..still });
    sequences.push(SequenceSpec { name: "hidden/crab".into(), frames: 150, hides: true, ..spec("", nominal) });
    sequences
}

/// Ten thousand frames; the motion returns to the start every 28 s.
pub fn long() -> SequenceSpec {
    SequenceSpec { name: "long/crab".into(), frames: 10_000, fine: false, ..spec("", Setup::default()) }
}

impl SequenceSpec {
    /// Fewer frames, for a check in minutes; `None` if a quick run omits it.
    pub fn quick(self) -> Option<Self> {
        let kept = ["track/crab-30fps", "track/relief-25mm", "hidden/crab", "still/crab"];
        let frames = if self.hides { self.frames } else { self.frames.min(90) };
        kept.contains(&self.name.as_str()).then_some(Self { frames, ..self })
    }

    /// Time of a frame, seconds.
    pub fn time_s(&self, frame: usize) -> f64 {
        frame as f64 / self.rate_hz
    }

    /// Pose of the target in the left camera, which is stationary, in a frame.
    pub fn cam_left_from_target(&self, frame: usize) -> Pose<CamLeft, Target> {
        self.cam_left_from_target_at(self.time_s(frame))
    }

    /// The same at any time.
    fn cam_left_from_target_at(&self, t: f64) -> Pose<CamLeft, Target> {
        let (shift, turn_deg) = match self.motion {
            Motion::Still => (Vector3::zeros(), Vector3::zeros()),
            Motion::Combined => combined(t),
            Motion::Steps => steps(t),
            Motion::Own(own) => own.since_start(t),
        };
        let start = match self.motion {
            Motion::Own(own) => turned(&own.start_deg),
            _ => UnitQuaternion::from_scaled_axis(Vector3::new(0.10, -0.08, 0.35)),
        };
        Pose::from_parts(self.start_m() + shift, turned(&turn_deg) * start)
    }

    fn start_m(&self) -> Vector3<f64> {
        match self.motion {
            // Leaves space for 100 mm along every axis.
            Motion::Steps => Vector3::new(0.0, -0.045, 0.48),
            Motion::Own(own) => own.start_m,
            _ => Vector3::new(0.05, 0.0, 0.53),
        }
    }

    /// The scene of a frame.
    pub fn poses(&self, frame: usize) -> ScenePoses {
        self.poses_at(self.time_s(frame))
    }

    /// The scene at any time. `world` is the frame of the occluder if there is one, otherwise that of the left camera.
    pub fn poses_at(&self, time_s: f64) -> ScenePoses {
        let cam_left_from_world: Pose<CamLeft, World> = if self.hides {
            Pose::from_translation(Vector3::new(edge_m(time_s * self.rate_hz), 0.0, 0.37))
        } else {
            Pose::coincident()
        };
        let world_from_cam_left = cam_left_from_world.inverse();
        ScenePoses {
            world_from_cam_left,
            world_from_target: world_from_cam_left * self.cam_left_from_target_at(time_s),
        }
    }

    /// Whether the target is fully visible in a frame.
    pub fn is_free(&self, frame: usize) -> bool {
        !self.hides || frame < HIDING[0] || frame >= HIDING[3]
    }
}

/// Left edge of the occluder: right of the image, in front of the target, and out again.
fn edge_m(frame: f64) -> f64 {
    let [from, covered, leaves, free] = HIDING.map(|frame| frame as f64);
    let (away, before) = (0.40, -0.16);
    let slide = |start: f64, end: f64| ((frame - start) / (end - start)).clamp(0.0, 1.0);
    away + (before - away) * (slide(from, covered) - slide(leaves, free))
}

/// A rotation by these angles in degrees: about y, then x, then z.
fn turned(turn_deg: &Vector3<f64>) -> UnitQuaternion<f64> {
    let about = |axis: Vector3<f64>, degrees: f64| UnitQuaternion::from_scaled_axis(axis * degrees.to_radians());
    about(Vector3::y(), turn_deg.y) * about(Vector3::x(), turn_deg.x) * about(Vector3::z(), turn_deg.z)
}

impl OwnMotion {
    /// Translation in metres and rotation in degrees since the start.
    fn since_start(&self, t: f64) -> (Vector3<f64>, Vector3<f64>) {
        let wave = |k: usize| {
            let (period_s, phase) = (self.period_s[k], self.phase_rad[k]);
            (std::f64::consts::TAU * t / period_s + phase).sin() - phase.sin()
        };
        let waves = |first: usize| Vector3::from_fn(|axis, _| wave(first + axis));
        (self.shift_m.component_mul(&waves(0)), self.turn_deg.component_mul(&waves(3)))
    }
}

/// Translation in metres and rotation in degrees.
pub fn combined(t: f64) -> (Vector3<f64>, Vector3<f64>) {
    let wave = |size: f64, period_s: f64| size * (std::f64::consts::TAU * t / period_s).sin();
    let shift = Vector3::new(wave(0.05, 5.6), wave(0.035, 4.0), wave(0.05, 7.0));
    (shift, Vector3::new(wave(20.0, 4.0), wave(20.0, 5.6), wave(20.0, 7.0)))
}

/// Duration of a move and of the hold after it, seconds.
const MOVE_S: f64 = 2.0;
const REST_S: f64 = 0.5;

fn steps(t: f64) -> (Vector3<f64>, Vector3<f64>) {
    let event = (t / (MOVE_S + REST_S)).floor();
    let s = ((t - event * (MOVE_S + REST_S)) / MOVE_S).min(1.0);
    // Minimum jerk: stationary at either end.
    let rise = s * s * s * (10.0 + s * (6.0 * s - 15.0));
    let (axis, back) = ((event / 2.0) as usize, event % 2.0 > 0.5);
    let share = if back { 1.0 - rise } else { rise };
    let (mut shift, mut turn_deg) = (Vector3::zeros(), Vector3::zeros());
    match axis {
        0..3 => shift[axis] = 0.1 * share,
        3..6 => turn_deg[axis - 3] = 20.0 * share,
        _ => {}
    }
    (shift, turn_deg)
}

/// The model frame of the first frame, as the trackers define it: origin on the plane on `centre_ray`, z along the
/// normal away from the camera, x along the image's x axis in the plane.
pub fn model_in_first_frame(first: &Pose<CamLeft, Target>, centre_ray: &Vector3<f64>) -> Pose<CamLeft, Model> {
    let plane = plane_of(first);
    let z = plane.normalize();
    let x = (Vector3::x() - z * z.x).normalize();
    let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
    Pose::from_rotation_matrix(&axes, centre_ray / plane.dot(centre_ray))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_stay_in_the_range_and_turn_as_far_as_they_should() {
        for sequence in all().into_iter().chain([long()]) {
            let turn_deg = |frame: usize| {
                let (start, now) = (sequence.cam_left_from_target(0), sequence.cam_left_from_target(frame));
                (now * start.inverse()).rotation_angle_rad().to_degrees()
            };
            let (mut depths, mut turned) = ([f64::INFINITY, 0.0f64], 0.0f64);
            for frame in 0..sequence.frames.min(1000) {
                let z = sequence.cam_left_from_target(frame).translation_m().z;
                depths = [depths[0].min(z), depths[1].max(z)];
                turned = turned.max(turn_deg(frame));
            }
            assert!(depths[0] > 0.45 && depths[1] < 0.62, "{}: {depths:?}", sequence.name);
            let expected = if sequence.motion == Motion::Still { 0.0..1e-9 } else { 19.9..45.0 };
            assert!(expected.contains(&turned), "{}: {turned} degrees", sequence.name);
        }
    }

    #[test]
    fn the_long_run_returns_to_its_start() {
        let long = long();
        let period = (28.0 * long.rate_hz) as usize;
        for lap in 1..=long.frames / period {
            let away = long.cam_left_from_target(0).inverse() * long.cam_left_from_target(lap * period);
            assert!(away.log().norm() < 1e-9, "lap {lap}");
        }
    }

    #[test]
    fn the_model_frame_lies_on_the_plane() {
        let first = all()[0].cam_left_from_target(0);
        let ray = Vector3::new(0.09, 0.01, 1.0);
        let model = model_in_first_frame(&first, &ray);
        let in_target = (first.inverse() * model).translation_m();
        assert!(in_target.z.abs() < 1e-12);
        let x = model.transform_vector(&Vector3::x());
        let z = model.transform_vector(&Vector3::z());
        assert!((z - first.transform_vector(&Vector3::z())).norm() < 1e-12);
        assert!(x.y.abs() < 0.05 && x.x > 0.9 && x.dot(&z).abs() < 1e-12);
    }
}
