//! Rendered recordings of a chessboard that is carried from pose to pose.

use image::{GrayImage, Luma, RgbImage};
use nalgebra::{Isometry3, Point3, Translation3, Vector2, Vector3};
use pb3dp_calibration::board::Chessboard;
use pb3dp_geometry::{Camera, Distortion, ImageSize, MonotonicTime, Pinhole, Pose, StereoRig, so3};
use pb3dp_record::dataset::{SearchRange, SequenceDraft, SequenceWriter, WrittenFrame};
use pb3dp_record::images::StoredFormat;

pub const SIZE: ImageSize = ImageSize { width: 480, height: 360 };
pub const RATE_HZ: f64 = 30.0;
/// Pairs at each pose, and on the path to the next one.
pub const AT_REST: usize = 8;
const ON_THE_WAY: usize = 4;

pub fn board() -> Chessboard {
    Chessboard::new(9, 6, 0.025).expect("a board")
}

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

/// The board as a camera sees it, with two by two samples per pixel.
pub fn image(camera: &Camera, cam_from_board: &Isometry3<f64>, rays: &[Vector3<f64>]) -> GrayImage {
    let board = board();
    let (columns, rows) = (f64::from(board.columns()), f64::from(board.rows()));
    let board_from_cam = cam_from_board.inverse();
    let centre = board_from_cam * Point3::origin();
    let grey = |ray: &Vector3<f64>| {
        let ray = board_from_cam * ray;
        let at = centre - ray * (centre.z / ray.z);
        let (c, r) = (at.x / board.square_m(), at.y / board.square_m());
        let is_on =
            |margin: f64| (-1.0 - margin..columns + margin).contains(&c) && (-1.0 - margin..rows + margin).contains(&r);
        let is_dark = (c.floor() + r.floor()).rem_euclid(2.0) < 0.5;
        match (is_on(0.0), is_on(0.6)) {
            (true, _) if is_dark => 35.0,
            (true, _) | (_, true) => 215.0,
            _ => 110.0,
        }
    };
    let width = camera.size().width;
    GrayImage::from_fn(width, camera.size().height, |u, v| {
        let first = 4 * (v * width + u) as usize;
        let sum: f64 = rays[first..first + 4].iter().map(grey).sum();
        Luma([(0.25 * sum).round() as u8])
    })
}

/// The rays of all samples of a camera's images.
pub fn rays(camera: &Camera) -> Vec<Vector3<f64>> {
    let size = camera.size();
    let mut rays = Vec::with_capacity(4 * (size.width * size.height) as usize);
    for (v, u) in (0..size.height).flat_map(|v| (0..size.width).map(move |u| (v, u))) {
        for (du, dv) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
            let pixel = Vector2::new(f64::from(u) + du, f64::from(v) + dv);
            rays.push(camera.unproject(&pixel).expect("inside the image"));
        }
    }
    rays
}

/// Renders both images.
pub struct Studio {
    pub rig: StereoRig,
    rays: [Vec<Vector3<f64>>; 2],
}

impl Studio {
    pub fn new(rig: StereoRig) -> Self {
        Self { rays: [rays(rig.left()), rays(rig.right())], rig }
    }

    pub fn pair(&self, cam_left_from_board: &Isometry3<f64>, blur_px: f32) -> [RgbImage; 2] {
        let cam_right_from_board = self.rig.cam_right_from_cam_left().isometry() * cam_left_from_board;
        let left = image(self.rig.left(), cam_left_from_board, &self.rays[0]);
        let right = image(self.rig.right(), &cam_right_from_board, &self.rays[1]);
        [left, right].map(|image| {
            let image = if blur_px > 0.0 { image::imageops::blur(&image, blur_px) } else { image };
            image::DynamicImage::from(image).into_rgb8()
        })
    }
}

/// A writer of a recording.
pub fn writer(folder: &std::path::Path, rig: &StereoRig) -> SequenceWriter {
    let draft = SequenceDraft {
        region_polygon_left_px: vec![[200.0, 100.0], [280.0, 100.0], [280.0, 180.0]],
        search: SearchRange { z_min_m: 0.3, z_max_m: 0.8, tilt_max_rad: 1.0 },
        images: StoredFormat::QuickPng,
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
