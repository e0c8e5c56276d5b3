//! Simulated stereo rigs on an arm, and boards in a room or on another arm, with exact ground truth.

use nalgebra::{Isometry3, Matrix3x2, Point3, Vector2, Vector3, Vector6};
use pb3dp_calibration::board::Sighting;
use pb3dp_calibration::hand_eye::HandEyeStop;
use pb3dp_calibration::hand_eye::propose::{ProposalRequest, propose};
use pb3dp_geometry::frames::{CamLeft, Flange};
use pb3dp_geometry::{Pose, StereoRig, se3, so3};
use pb3dp_kinematics::{Chain, Damping, JointVector, reach};

use crate::support::{Random, SIZE, board, detected_by_both, rig};

/// One setup: a stereo rig on an arm, and a board.
pub struct World {
    pub rig: StereoRig,
    pub flange_from_cam_left: Isometry3<f64>,
    pub place: Place,
}

#[derive(Clone, Copy)]
pub enum Place {
    Room { base_from_board: Isometry3<f64> },
    Carried { vs_base_from_tc_base: Isometry3<f64>, tc_flange_from_board: Isometry3<f64> },
}

/// How a setup is visited, and its defects.
#[derive(Clone, Copy)]
pub struct Visit {
    pub stops: usize,
    pub corner_sigma_px: f64,
    /// Noise of the flange in each direction, m, and about each axis, rad.
    pub robot_sigma_m: f64,
    pub robot_sigma_rad: f64,
    /// True side of a square divided by the stated one.
    pub squares: f64,
    /// Displacement of the board from the middle of the visit on, m.
    pub board_moved_m: f64,
    /// Only rotations about the camera axis.
    pub one_axis: bool,
    /// Number of stops whose joints were recorded while the arm moved; pose error 5 mm.
    pub moving: usize,
}

pub const GOOD: Visit = Visit {
    stops: 15,
    corner_sigma_px: 0.1,
    robot_sigma_m: 1e-4,
    robot_sigma_rad: 0.02 * std::f64::consts::PI / 180.0,
    squares: 1.0,
    board_moved_m: 0.0,
    one_axis: false,
    moving: 0,
};

fn vector(random: &mut Random, largest: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.between(-largest, largest))
}

impl World {
    /// A stereo rig mounted beside the flange axis, rotated relative to it, and a board in front of it.
    pub fn in_room(random: &mut Random) -> Self {
        let base_from_board = Isometry3::from_parts(
            (Vector3::new(1.1, 0.1, 0.6) + vector(random, 0.2)).into(),
            so3::exp(&Vector3::new(0.3, 1.6, -0.4)) * so3::exp(&vector(random, 0.3)),
        );
        Self::with(random, Place::Room { base_from_board })
    }

    /// The same with the board on the flange of another arm that faces this one.
    pub fn carried(random: &mut Random) -> Self {
        let vs_base_from_tc_base = Isometry3::from_parts(
            (Vector3::new(2.0, 0.1, -0.05) + vector(random, 0.1)).into(),
            so3::exp(&Vector3::new(0.0, 0.0, 3.0)) * so3::exp(&vector(random, 0.05)),
        );
        let tc_flange_from_board = Isometry3::from_parts(
            (Vector3::new(-0.1, -0.06, 0.08) + vector(random, 0.03)).into(),
            so3::exp(&Vector3::new(2.2, 2.2, 0.1)) * so3::exp(&vector(random, 0.2)),
        );
        Self::with(random, Place::Carried { vs_base_from_tc_base, tc_flange_from_board })
    }

    fn with(random: &mut Random, place: Place) -> Self {
        let flange_from_cam_left = Isometry3::from_parts(
            (Vector3::new(-0.05, 0.01, 0.06) + vector(random, 0.03)).into(),
            so3::exp(&Vector3::new(0.02, -0.03, -1.5)) * so3::exp(&vector(random, 0.2)),
        );
        Self { rig: rig(random), flange_from_cam_left, place }
    }

    /// Position error on the flange of a point straight ahead of the cameras, visible to both cameras, metres.
    pub fn point_error_m(
        &self,
        believed: &StereoRig,
        flange_from_cam_left: &Pose<Flange, CamLeft>,
        distance_m: f64,
    ) -> f64 {
        let point = Point3::new(0.0, 0.0, distance_m);
        let left = self.rig.left().project(&point).expect("in sight");
        let right = self.rig.cam_right_from_cam_left().transform_point(&point);
        let right = self.rig.right().project(&right).expect("in sight");
        let cam_left_from_cam_right = believed.cam_right_from_cam_left().inverse();
        let a = believed.left().unproject(&left).expect("a ray");
        let b = cam_left_from_cam_right.transform_vector(&believed.right().unproject(&right).expect("a ray"));
        let origin = cam_left_from_cam_right.translation_m();
        // s a and origin + t b at their closest approach.
        let rays = Matrix3x2::from_columns(&[a, -b]);
        let st = (rays.transpose() * rays).try_inverse().expect("two rays") * rays.transpose() * origin;
        let found = 0.5 * (a * st.x + origin + b * st.y);
        (flange_from_cam_left.transform_point(&found.into()) - self.flange_from_cam_left * point).norm()
    }

    /// The poses in the order of the parameters.
    pub fn poses(&self) -> Vec<Isometry3<f64>> {
        match self.place {
            Place::Room { base_from_board } => vec![self.flange_from_cam_left, base_from_board],
            Place::Carried { vs_base_from_tc_base, tc_flange_from_board } => {
                vec![self.flange_from_cam_left, vs_base_from_tc_base, tc_flange_from_board]
            }
        }
    }

    /// Visits the setup: poses from which both cameras see the whole board.
    pub fn visit(&self, visit: &Visit, random: &mut Random) -> Vec<HandEyeStop> {
        match self.place {
            Place::Room { .. } => (0..visit.stops).map(|index| self.room_stop(index, visit, random)).collect(),
            Place::Carried { .. } => self.carried_stops(visit, random),
        }
    }

    fn room_stop(&self, index: usize, visit: &Visit, random: &mut Random) -> HandEyeStop {
        let Place::Room { base_from_board } = self.place else { panic!("a board in a room") };
        let (cam_left_from_board, sightings) = self.look(visit, random);
        let moved_m = if 2 * index >= visit.stops { visit.board_moved_m } else { 0.0 };
        let base_from_board = base_from_board * Isometry3::translation(moved_m, 0.0, 0.0);
        let base_from_flange = base_from_board * (self.flange_from_cam_left * cam_left_from_board).inverse();
        self.stop(index, visit, (base_from_flange, None), sightings, random)
    }

    /// The first half of the stops by the arm with the cameras, the others by the arm with the board.
    fn carried_stops(&self, visit: &Visit, random: &mut Random) -> Vec<HandEyeStop> {
        let Place::Carried { vs_base_from_tc_base, tc_flange_from_board } = self.place else {
            panic!("a carried board")
        };
        let tc_at_rest =
            Isometry3::from_parts(Vector3::new(0.9, 0.15, 0.6).into(), so3::exp(&Vector3::new(0.2, 1.5, 0.3)));
        let board_at_rest = vs_base_from_tc_base * tc_at_rest * tc_flange_from_board;
        let half = visit.stops / 2;
        let mut stops: Vec<HandEyeStop> = Vec::new();
        let mut vs = Isometry3::identity();
        for index in 0..visit.stops {
            let (cam_left_from_board, sightings) = self.look(visit, random);
            let mut tc = tc_at_rest;
            if index < half {
                vs = board_at_rest * (self.flange_from_cam_left * cam_left_from_board).inverse();
            } else {
                let base_from_board = vs * self.flange_from_cam_left * cam_left_from_board;
                tc = vs_base_from_tc_base.inverse() * base_from_board * tc_flange_from_board.inverse();
            }
            let mut stop = self.stop(index, visit, (vs, Some(tc)), sightings, random);
            // A stationary arm reports the same pose each time.
            if let Some(before) = stops.last() {
                if index < half {
                    stop.tc_base_from_tc_flange = before.tc_base_from_tc_flange;
                } else {
                    stop.base_from_flange = before.base_from_flange;
                }
            }
            stops.push(stop);
        }
        stops
    }

    /// A board pose visible completely to both cameras, with the detections.
    fn look(&self, visit: &Visit, random: &mut Random) -> (Isometry3<f64>, [Sighting; 2]) {
        loop {
            let pose = self.placed(visit, random);
            if let Some(sightings) = self.sightings(&pose, visit, random) {
                return (pose, sightings);
            }
        }
    }

    fn placed(&self, visit: &Visit, random: &mut Random) -> Isometry3<f64> {
        let board = board();
        let middle = board.corner_in_board(board.columns() - 1, board.rows() - 1).coords * 0.5;
        let share = random.between(0.3, 0.6);
        let distance_m = 2.0 * middle.x * self.rig.left().pinhole().fx / (share * f64::from(SIZE.width));
        let pixel = Vector2::new(random.between(100.0, 540.0), random.between(80.0, 400.0));
        let ray = self.rig.left().unproject(&pixel).expect("inside the image");
        let (tilt, way) = (random.between(0.1, 0.6), random.between(0.0, std::f64::consts::TAU));
        let about_axis = Vector3::new(0.0, 0.0, random.between(-0.5, 0.5));
        let tilt =
            if visit.one_axis { Vector3::zeros() } else { Vector3::new(tilt * way.cos(), tilt * way.sin(), 0.0) };
        let turn = so3::exp(&tilt) * so3::exp(&about_axis);
        Isometry3::from_parts((ray * distance_m).into(), turn) * Isometry3::translation(-middle.x, -middle.y, 0.0)
    }

    /// Detections of the board in both cameras, including the true size of its squares.
    pub fn sightings(
        &self,
        cam_left_from_board: &Isometry3<f64>,
        visit: &Visit,
        random: &mut Random,
    ) -> Option<[Sighting; 2]> {
        detected_by_both(&self.rig, cam_left_from_board, (visit.corner_sigma_px, visit.squares), random)
    }

    /// A stop as reported by the robot.
    fn stop(
        &self,
        index: usize,
        visit: &Visit,
        (vs, tc): (Isometry3<f64>, Option<Isometry3<f64>>),
        sightings: [Sighting; 2],
        random: &mut Random,
    ) -> HandEyeStop {
        let mut noisy = |pose: Isometry3<f64>| {
            let by = Vector6::from_fn(|n, _| {
                random.normal() * if n < 3 { visit.robot_sigma_m } else { visit.robot_sigma_rad }
            });
            pose * se3::exp(&by)
        };
        let mut measured = noisy(vs);
        let tc = tc.map(|tc| Pose::from_isometry(noisy(tc)));
        // Spread over the visit.
        let late = visit.moving > 0 && index % (visit.stops / visit.moving) == 2;
        if late && index / (visit.stops / visit.moving) < visit.moving {
            let way = Vector3::from_fn(|_, _| random.normal()).normalize() * 0.005;
            measured *= Isometry3::translation(way.x, way.y, way.z);
        }
        HandEyeStop {
            name: format!("{index:02}"),
            sightings,
            base_from_flange: Pose::from_isometry(measured),
            tc_base_from_tc_flange: tc,
        }
    }
}

/// A PA-10 with a stereo rig on its flange, a board in front of it, and noise in its joints.
pub struct JointWorld {
    pub world: World,
    chain: Chain,
    /// The arm according to the robot description.
    believed: Chain,
    rest_rad: JointVector,
    joint_sigma_rad: f64,
}

impl JointWorld {
    /// A board about 0.5 m in front of the cameras; the joint noise causes a flange position error of `flange_sigma_m` (root of
    /// the sum of the three variances).
    pub fn new(flange_sigma_m: f64, random: &mut Random) -> Self {
        let urdf = include_str!("../../../../configs/robots/pa10_gen2.urdf");
        let chain = Chain::from_urdf_str(urdf, "base_link", "flange").expect("an arm");
        let rest_rad = JointVector::from([0.1, 0.79, -0.2, 1.70, 0.15, -0.92, 0.2])
            + JointVector::from_fn(|_, _| random.between(-0.1, 0.1));
        let mut world = World::in_room(random);
        let levers = chain.jacobian(&rest_rad).fixed_rows::<3>(0).norm();
        let middle = board().corner_in_board(8, 5).coords * 0.5;
        let at = Vector3::new(random.between(0.02, 0.08), random.between(-0.03, 0.03), random.between(0.45, 0.6));
        let to_middle = Isometry3::from_parts(at.into(), so3::exp(&vector(random, 0.2)));
        let cam_left_from_board = to_middle * Isometry3::translation(-middle.x, -middle.y, 0.0);
        let base_from_board = chain.forward(&rest_rad).isometry() * world.flange_from_cam_left * cam_left_from_board;
        world.place = Place::Room { base_from_board };
        Self { world, believed: chain.clone(), chain, rest_rad, joint_sigma_rad: flange_sigma_m / levers }
    }

    /// The same arm, with the robot description of the first generation.
    pub fn taken_for_the_first_generation(mut self) -> Self {
        let urdf = include_str!("../../../../configs/robots/pa10_gen1.urdf");
        self.believed = Chain::from_urdf_str(urdf, "base_link", "flange").expect("an arm");
        self
    }

    /// Visits the poses proposed from a first view, with an approximate camera pose.
    pub fn visit(&self, visit: &Visit, random: &mut Random) -> Vec<HandEyeStop> {
        let Place::Room { base_from_board } = self.world.place else { panic!("a board in a room") };
        let first = (self.chain.forward(&self.rest_rad).isometry() * self.world.flange_from_cam_left).inverse()
            * base_from_board;
        let request = ProposalRequest {
            count: visit.stops + 5,
            distance_m: 0.5,
            guess_error_m: 0.01,
            guess_error_rad: 3.0_f64.to_radians(),
            focal_error: 0.0,
        };
        let views = propose(&self.world.rig, &board(), &Pose::from_isometry(first), &request).expect("views");
        let mut stops = Vec::new();
        for view in views.cam_left_from_board {
            let base_from_flange = base_from_board * (self.world.flange_from_cam_left * view.isometry()).inverse();
            let Some(joints_rad) = self.joints(&base_from_flange) else { continue };
            let base_from_cam = self.chain.forward(&joints_rad).isometry() * self.world.flange_from_cam_left;
            let detected = self.world.sightings(&(base_from_cam.inverse() * base_from_board), visit, random);
            let Some(sightings) = detected else { continue };
            let reported_rad = joints_rad + JointVector::from_fn(|_, _| random.normal() * self.joint_sigma_rad);
            stops.push(HandEyeStop {
                name: format!("{:02}", stops.len()),
                sightings,
                base_from_flange: self.believed.forward(&reported_rad),
                tc_base_from_tc_flange: None,
            });
        }
        stops.truncate(visit.stops);
        stops
    }

    /// Joint positions with the flange at a pose, starting from the arm's home position; `None` if out of reach.
    fn joints(&self, base_from_flange: &Isometry3<f64>) -> Option<JointVector> {
        let damping = Damping::new(0.01, 0.01).expect("damping");
        let joints_rad = reach(&self.chain, &self.rest_rad, &Pose::from_isometry(*base_from_flange), &damping).ok()?;
        self.chain.limits().violation(&joints_rad).is_none().then_some(joints_rad)
    }
}
