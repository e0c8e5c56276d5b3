//! Rectification of a stereo rig: rotates both cameras so that image rows are epipolar lines.

use nalgebra::{Matrix3, Vector2, Vector3};

use crate::camera::{Camera, CameraError, Distortion, ImageSize, Pinhole, SIDE_MAX_PX};
use crate::frames::{CamLeft, CamLeftRect, CamRight, CamRightRect};
use crate::maps::PixelMap;
use crate::pose::Pose;
use crate::stereo_rig::{StereoRig, StereoRigError};

/// Smallest sine of the angle between the baseline and the mean viewing direction. Below it the cameras look along the
/// baseline, and there is no common image plane.
const BASELINE_SINE_MIN: f64 = 0.2;
/// Smallest cosine between an original optical axis and the rectified one (60 degrees); at larger angles the rectified image
/// would be mostly empty.
const TURN_COSINE_MIN: f64 = 0.5;

/// Tangent of the angle from the rectified axis (70 degrees) up to which pixels enlarge the image. Half of this value is 54 degrees,
/// where a rectified pixel is 3 times as fine as a raw one; double is 80 degrees, and 30 times.
const FIELD_TANGENT_MAX: f64 = 2.75;
/// An image grows by at most this many times its size on each side. Chosen by hand, not varied.
const GROWTH_MAX: i32 = 1;
/// Images grow in steps of this many pixels: a power of two, so that halved images keep their grid.
const GROWTH_STEP: i32 = 64;
/// Points along each side of a raw image that are mapped to find the size of the rectified one.
const FIELD_POINTS: u32 = 17;

/// A rectified rig, and the rotations and maps that lead to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rectification {
    /// The rectified rig: no distortion, no rotation, equal fx, fy and cy, the right camera at `(baseline, 0, 0)`. Here the
    /// frames `CamLeft` and `CamRight` of the type are the rectified ones.
    pub rig: StereoRig,
    /// From the rectified left image to the original one.
    pub left: PixelMap,
    /// From the rectified right image to the original one.
    pub right: PixelMap,
    /// The rotation of the left camera about its optical centre.
    pub cam_left_rect_from_cam_left: Pose<CamLeftRect, CamLeft>,
    /// The rotation of the right camera about its optical centre.
    pub cam_right_rect_from_cam_right: Pose<CamRightRect, CamRight>,
}

/// Why a rig cannot be rectified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RectificationError {
    /// The baseline is almost parallel to the viewing direction.
    #[error(
        "the baseline is only {angle_deg:.1} degrees from the mean viewing direction, so the pair has no common image plane: check the translation of the calibration"
    )]
    BaselineAlongView {
        /// Angle between baseline and mean optical axis, degrees.
        angle_deg: f64,
    },
    /// Rectification would have to turn an optical axis too far.
    #[error(
        "rectification would rotate the {camera} camera by {angle_deg:.1} degrees (limit 60): check the rotation of the calibration"
    )]
    Turn {
        /// `left` or `right`.
        camera: &'static str,
        /// Angle between the optical axis and the rectified one, degrees.
        angle_deg: f64,
    },
    /// The lens model of a camera does not hold in the middle of its image.
    #[error(
        "the lens model of the {camera} camera does not hold in the middle half of its image: check its distortion coefficients and focal lengths"
    )]
    Lens {
        /// `left` or `right`.
        camera: &'static str,
        /// The pixel that has no ray.
        #[source]
        source: CameraError,
    },
    /// The rectified camera is invalid.
    #[error("no rectified camera")]
    Camera(#[from] CameraError),
    /// The rectified rig is invalid.
    #[error("no rectified rig")]
    Rig(#[from] StereoRigError),
}

impl StereoRig {
    /// Computes the rectified rig, the rotations to it, and the maps of the images.
    ///
    /// The common x axis is the baseline. The common z axis is the mean of both viewing directions, made perpendicular to the baseline.
    /// Focal lengths are the means of both cameras. The middle of a raw image stays in the middle column of the rectified one; cx may
    /// therefore differ, and disparities then have an offset. cy is common. Both images take the larger of the two sizes. A rig that is
    /// already rectified, with images of equal size, remains unchanged.
    ///
    /// # Errors
    /// A baseline along the viewing direction, a camera whose optical axis would have to turn by more than 60 degrees, a lens model
    /// without rays in the middle half of its image, or a rectified camera or rig out of the accepted ranges.
    pub fn rectify(&self) -> Result<Rectification, RectificationError> {
        check_lens("left", self.left())?;
        check_lens("right", self.right())?;
        let left_turn = rectified_axes(self)?;
        // Directions: right rectified = left rectified = turn * left = turn * left_from_right * right.
        let right_turn = left_turn * self.cam_right_from_cam_left().rotation_matrix().transpose();
        check_turn("left", &left_turn)?;
        check_turn("right", &right_turn)?;
        let cam_left_rect_from_cam_left = Pose::from_rotation_matrix(&left_turn, Vector3::zeros());
        let cam_right_rect_from_cam_right = Pose::from_rotation_matrix(&right_turn, Vector3::zeros());
        let (left, right) = rectified_cameras(self, &left_turn, &right_turn)?;
        let cam_right_from_cam_left = Pose::from_translation(Vector3::new(-self.baseline_m(), 0.0, 0.0));
        Ok(Rectification {
            rig: StereoRig::new(left, right, cam_right_from_cam_left)?,
            left: PixelMap::rotate(self.left(), &left, &cam_left_rect_from_cam_left),
            right: PixelMap::rotate(self.right(), &right, &cam_right_rect_from_cam_right),
            cam_left_rect_from_cam_left,
            cam_right_rect_from_cam_right,
        })
    }
}

impl Rectification {
    /// The same rectification, with images large enough to show the whole field of the raw ones, within two limits: 70 degrees from the
    /// axis in columns and in rows, and three times the columns and rows. Each pixel keeps its ray and its size; only the origin of the
    /// pixel coordinates changes. A rig that is already rectified remains unchanged.
    ///
    /// # Errors
    /// None in practice: the larger cameras differ from valid ones in size and principal point only.
    pub fn covering_field(&self) -> Result<Self, RectificationError> {
        let (left, right) = (field(&self.left), field(&self.right));
        // Rows remain common, and disparities are not changed.
        let (low, high) = (left.low.inf(&right.low), left.high.sup(&right.high));
        let size = ImageSize { width: (high.x - low.x) as u32, height: (high.y - low.y) as u32 };
        let grown = |camera: &Camera| {
            let Pinhole { fx, fy, cx, cy } = *camera.pinhole();
            let pinhole = Pinhole { fx, fy, cx: cx - f64::from(low.x), cy: cy - f64::from(low.y) };
            Camera::new(size, pinhole, Distortion::None)
        };
        let (left_camera, right_camera) = (grown(self.rig.left())?, grown(self.rig.right())?);
        Ok(Self {
            rig: StereoRig::new(left_camera, right_camera, *self.rig.cam_right_from_cam_left())?,
            left: self.left.with_destination(&left_camera),
            right: self.right.with_destination(&right_camera),
            ..*self
        })
    }
}

/// First pixel of an image, and the pixel after the last one.
struct Field {
    low: Vector2<i32>,
    high: Vector2<i32>,
}

/// The range of rectified pixels that covers the raw image of `map` and the present rectified image.
fn field(map: &PixelMap) -> Field {
    let (raw, size, pinhole) = (map.source_size(), map.size(), map.destination_pinhole());
    let size = Vector2::new(size.width as i32, size.height as i32);
    let reach = Vector2::new(pinhole.fx, pinhole.fy) * FIELD_TANGENT_MAX;
    let principal = Vector2::new(pinhole.cx, pinhole.cy);
    let (mut low, mut high) = (Vector2::zeros(), size.map(f64::from));
    let along = |i: u32, length: u32| f64::from(length - 1) * f64::from(i) / f64::from(FIELD_POINTS - 1);
    for (i, j) in (0..FIELD_POINTS).flat_map(|j| (0..FIELD_POINTS).map(move |i| (i, j))) {
        let Some(pixel) = map.destination(&Vector2::new(along(i, raw.width), along(j, raw.height))) else { continue };
        let pixel = pixel.sup(&(principal - reach)).inf(&(principal + reach));
        (low, high) = (low.inf(&pixel), high.sup(&pixel.add_scalar(1.0)));
    }
    // Whole steps of growth, of which a side limits the number.
    let steps = |grown: Vector2<f64>| {
        size.zip_map(&grown, |length, grown| {
            let limit = (length * GROWTH_MAX) / GROWTH_STEP;
            let room = (SIDE_MAX_PX as i32 - length).max(0) / 2 / GROWTH_STEP;
            // Half a pixel of the border is not worth a step.
            (((grown - 0.5) / f64::from(GROWTH_STEP)).ceil() as i32).max(0).min(limit).min(room) * GROWTH_STEP
        })
    };
    Field { low: -steps(-low), high: size + steps(high - size.map(f64::from)) }
}

/// The matrix whose rows are the rectified axes, in `cam_left`.
fn rectified_axes(rig: &StereoRig) -> Result<Matrix3<f64>, RectificationError> {
    if rig.is_rectified() {
        return Ok(Matrix3::identity());
    }
    let x = rig.right_centre_in_cam_left() / rig.baseline_m();
    let right_view_in_cam_left = rig.cam_right_from_cam_left().inverse().transform_vector(&Vector3::z());
    let view = Vector3::z() + right_view_in_cam_left;
    let y = view.cross(&x);
    // This also rejects opposite views, whose sum is zero.
    if y.norm() <= BASELINE_SINE_MIN * view.norm() {
        return Err(RectificationError::BaselineAlongView { angle_deg: view.angle(&x).to_degrees() });
    }
    let y = y.normalize();
    Ok(Matrix3::from_rows(&[x.transpose(), y.transpose(), x.cross(&y).transpose()]))
}

/// Checks that the centre of the image and the points half-way to its corners have rays.
fn check_lens(name: &'static str, camera: &Camera) -> Result<(), RectificationError> {
    let (centre, quarter) = (centre(camera.size()), centre(camera.size()) * 0.5);
    let corners = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (0.0, 0.0)];
    for (x, y) in corners {
        let pixel = centre + Vector2::new(x, y).component_mul(&quarter);
        camera.unproject(&pixel).map_err(|source| RectificationError::Lens { camera: name, source })?;
    }
    Ok(())
}

fn check_turn(camera: &'static str, turn: &Matrix3<f64>) -> Result<(), RectificationError> {
    let cosine = turn[(2, 2)];
    if cosine < TURN_COSINE_MIN {
        let angle_deg = cosine.clamp(-1.0, 1.0).acos().to_degrees();
        return Err(RectificationError::Turn { camera, angle_deg });
    }
    Ok(())
}

/// Cameras with common focal lengths and common cy, in which each source image's centre stays at the centre.
fn rectified_cameras(
    rig: &StereoRig,
    left_turn: &Matrix3<f64>,
    right_turn: &Matrix3<f64>,
) -> Result<(Camera, Camera), RectificationError> {
    let (l, r) = (rig.left(), rig.right());
    let size = ImageSize { width: l.size().width.max(r.size().width), height: l.size().height.max(r.size().height) };
    let fx = 0.5 * (l.pinhole().fx + r.pinhole().fx);
    let fy = 0.5 * (l.pinhole().fy + r.pinhole().fy);
    let principal = |camera: &Camera, turn: &Matrix3<f64>| -> Result<Vector2<f64>, CameraError> {
        let ray = turn * camera.unproject(&centre(camera.size()))?;
        Ok(centre(size) - Vector2::new(fx * ray.x, fy * ray.y) / ray.z)
    };
    let (left, right) = (principal(l, left_turn)?, principal(r, right_turn)?);
    let cy = 0.5 * (left.y + right.y);
    let camera = |cx: f64| Camera::new(size, Pinhole { fx, fy, cx, cy }, Distortion::None);
    Ok((camera(left.x)?, camera(right.x)?))
}

/// The centre of an image whose pixel centres have integer coordinates.
fn centre(size: ImageSize) -> Vector2<f64> {
    Vector2::new(f64::from(size.width) - 1.0, f64::from(size.height) - 1.0) * 0.5
}
