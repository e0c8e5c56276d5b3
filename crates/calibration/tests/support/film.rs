//! Rendered recordings of a chessboard that is carried from pose to pose.

use image::RgbImage;
use nalgebra::{Isometry3, Translation3, Vector2, Vector3};
use pb3dp_geometry::{Camera, Distortion, ImageSize, MonotonicTime, Pinhole, Pose, StereoRig, so3};
use pb3dp_record::dataset::{SearchRange, SequenceDraft, SequenceWriter, WrittenFrame};
use pb3dp_record::images::StoredFormat;

use crate::renderer::{Imaging, Renderer};
use crate::support::{Random, board};

pub const SIZE: ImageSize = ImageSize { width: 480, height: 360 };
pub const RATE_HZ: f64 = 30.0;
/// Pairs at each pose, and on the path to the next one.
pub const AT_REST: usize = 8;
const ON_THE_WAY: usize = 4;

/// Two different cameras, turned against each other.
pub fn rig() -> StereoRig {
    let camera = |fx: f64, fy: f64, cx: f64, cy: f64, k1: f64| {
        let distortion = Distortion::BrownConrady5 { coefficients: [k1, 0.02, 0.0, 0.0, 0.0] };
        Camera::new(SIZE, Pinhole { fx, fy, cx, cy }, distortion).expect("a camera")
    };
    let cam_right_from_cam_left =
        Pose::from_parts(Vector3::new(-0.062, 0.001, -0.002), so3::exp(&Vector3::new(0.01, 0.03, -0.015)));
    let (left, right) = (camera(452.0, 450.5, 236.0, 183.0, -0.08), camera(447.0, 448.5, 244.0, 176.0, -0.06));
    StereoRig::new(left, right, cam_right_from_cam_left).expect("a head")
}

/// The board with its centre on the ray of a position in the left image (shares of its width and height).
pub fn placed(rig: &StereoRig, place: [f64; 2], depth_m: f64, turn: [f64; 3]) -> Isometry3<f64> {
    let board = board();
    let middle = board.corner_in_board(board.columns() - 1, board.rows() - 1).coords * 0.5;
    let pixel = Vector2::new(place[0] * f64::from(SIZE.width), place[1] * f64::from(SIZE.height));
    let ray = rig.left().unproject(&pixel).expect("inside the image");
    let turn = so3::exp(&Vector3::from(turn));
    Isometry3::from_parts((ray * (depth_m / ray.z)).into(), turn) * Translation3::from(-middle)
}

/// The board poses of a session: all corners of the image, several tilts and depths.
pub fn places(rig: &StereoRig) -> Vec<Isometry3<f64>> {
    let list = [
        ([0.58, 0.5], 0.36, [0.05, 0.1, 0.02]),
        ([0.42, 0.3], 0.45, [0.45, 0.1, 0.1]),
        ([0.77, 0.3], 0.48, [-0.4, 0.2, -0.1]),
        ([0.40, 0.72], 0.47, [0.3, -0.45, 0.15]),
        ([0.77, 0.72], 0.46, [0.1, 0.5, 0.3]),
        ([0.56, 0.28], 0.42, [-0.5, 0.0, 0.0]),
        ([0.56, 0.74], 0.43, [0.5, 0.05, -0.2]),
        ([0.36, 0.5], 0.44, [0.1, -0.5, 0.05]),
        ([0.79, 0.5], 0.45, [0.0, 0.55, 0.1]),
        ([0.6, 0.5], 0.6, [0.3, 0.4, 0.5]),
        ([0.56, 0.48], 0.5, [-0.35, -0.35, -0.4]),
        ([0.36, 0.26], 0.5, [0.2, 0.3, -0.1]),
        ([0.8, 0.76], 0.52, [-0.2, -0.3, 0.1]),
    ];
    list.into_iter().map(|(place, depth_m, turn)| placed(rig, place, depth_m, turn)).collect()
}

/// Renders both images.
pub struct Studio {
    pub rig: StereoRig,
    cameras: [Renderer; 2],
}

impl Studio {
    pub fn new(rig: StereoRig) -> Self {
        Self { cameras: [rig.left(), rig.right()].map(Renderer::new), rig }
    }

    pub fn pair(&self, cam_left_from_board: &Isometry3<f64>, blur_px: f64) -> [RgbImage; 2] {
        let cam_right_from_board = self.rig.cam_right_from_cam_left().isometry() * cam_left_from_board;
        let [left, right] = &self.cameras;
        [(left, cam_left_from_board), (right, &cam_right_from_board)].map(|(camera, cam_from_board)| {
            let imaging = Imaging { blur_px, noise_grey: 0.0, contrast: 1.0 };
            let image = camera.image(&camera.light(cam_from_board, &board()), imaging, &mut Random::new(0));
            image::DynamicImage::from(image).into_rgb8()
        })
    }
}

/// A writer of a recording.
pub fn writer(folder: &std::path::Path, rig: &StereoRig) -> SequenceWriter {
    let draft = SequenceDraft {
        region_polygon_left_px: vec![[200.0, 100.0], [280.0, 100.0], [280.0, 180.0]],
        search: SearchRange { z_min_m: 0.3, z_max_m: 0.8, tilt_max_rad: 1.0 },
        images: StoredFormat::Png,
    };
    SequenceWriter::create(folder, rig, draft).expect("a folder")
}

/// Adds the next pair of a recording.
pub fn push(writer: &mut SequenceWriter, [left, right]: &[RgbImage; 2]) {
    let exposed_at = MonotonicTime::from_secs_f64(10.0 + writer.frames() as f64 / RATE_HZ);
    let frame = WrittenFrame { left, right, exposed_at, skew_nanos: 0, cam_left_from_model: None };
    writer.push(frame).expect("written");
}

/// Records a board that is carried from pose to pose; at one of them the images are blurred. Returns the index of the board pose
/// in each pair; `None` between poses.
pub fn record(
    folder: &std::path::Path,
    studio: &Studio,
    places: &[Isometry3<f64>],
    blurred: usize,
) -> Vec<Option<usize>> {
    let mut writer = writer(folder, &studio.rig);
    let mut rests = Vec::new();
    for (index, place) in places.iter().enumerate() {
        let pair = studio.pair(place, if index == blurred { 3.0 } else { 0.0 });
        for _ in 0..AT_REST {
            push(&mut writer, &pair);
            rests.push(Some(index));
        }
        let Some(next) = places.get(index + 1) else { break };
        for step in 1..=ON_THE_WAY {
            let share = step as f64 / (ON_THE_WAY + 1) as f64;
            push(&mut writer, &studio.pair(&place.lerp_slerp(next, share), 0.0));
            rests.push(None);
        }
    }
    writer.finish().expect("written");
    rests
}
