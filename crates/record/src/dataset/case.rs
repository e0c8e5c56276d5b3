//! A case: one stereo pair, a region in its left image, and ground truth of the plane in the region, if known.

use std::path::{Path, PathBuf};

use image::RgbImage;
use nalgebra::Vector3;
use pb3dp_geometry::ImageSize;

use super::json::{JsonFile, Node};
use super::{CASE_FILE, DatasetError, SearchRange, polygon, search_range};
use crate::calibration_files::{StatedCalibration, StereoCalibration, load_stated, load_stereo};
use crate::images::{DisparityMap, load_rgb, load_rgb_of_size, size_of};

/// What makes a planar case difficult, the value of the key `hard`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hardness {
    /// A region of 28 to 40 pixels across.
    Small,
    /// Weak texture.
    LowTexture,
    /// 15 to 35 % of the region lies on another surface.
    Occluded,
}

impl Hardness {
    const NAMES: [(&'static str, Self); 3] =
        [("small", Self::Small), ("lowtex", Self::LowTexture), ("occl", Self::Occluded)];

    /// The value in `case.json`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Small => "small",
            Self::LowTexture => "lowtex",
            Self::Occluded => "occl",
        }
    }
}

/// Ground truth of the plane of a region.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneTruth {
    /// Unit normal in `cam_left` that faces the camera.
    pub normal_in_cam_left: Vector3<f64>,
    /// Depth of the plane on the ray of the region's centroid, metres.
    pub z_m: f64,
    /// Distance of the plane from the left optical centre, metres: `normal . X = -h`.
    pub h_m: Option<f64>,
    /// Change of depth per pixel of disparity at the centroid, metres.
    pub m_per_px_disparity: Option<f64>,
    /// `(a, b, c)` of the disparity `u_left - u_right = a u + b v + c`, rectified pairs only.
    pub disparity_plane: Option<[f64; 3]>,
    /// Standard deviation of `z_m`, metres.
    pub z_sigma_m: Option<f64>,
    /// Standard deviation of the normal, radians.
    pub normal_sigma_rad: Option<f64>,
    /// How the ground truth was obtained.
    pub how: Option<String>,
}

/// The checked `case.json` of a case folder. The files it refers to are checked when they are loaded.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Name of the case: the key `case`, otherwise the folder name.
    pub name: String,
    /// The case's folder.
    pub folder: PathBuf,
    /// Left image.
    pub left: PathBuf,
    /// Right image.
    pub right: PathBuf,
    /// Calibration file.
    pub calibration: PathBuf,
    /// Disparity ground truth of the left image, if available.
    pub disparity_truth: Option<PathBuf>,
    /// Corners `[u, v]` of the region in the left image, pixels.
    pub region_polygon_left_px: Vec<[f64; 2]>,
    /// Centroid of the region's pixels; `None` if the file does not contain it.
    pub region_centroid_px: Option<[f64; 2]>,
    /// Search range.
    pub search: SearchRange,
    /// Whether the region is a plane; `true` by default.
    pub planar: bool,
    /// What makes the case difficult.
    pub hard: Option<Hardness>,
    /// `public` or `heldout`.
    pub split: Option<String>,
    /// The data set of the pair.
    pub family: Option<String>,
    /// The scene of the pair.
    pub scene: Option<String>,
    /// Kind of region: `rect`, `ellipse`, `object-contour`, `board quad (repeating pattern)`.
    pub region_kind: Option<String>,
    /// Ground truth of the plane.
    pub truth: Option<PlaneTruth>,
    /// Keys that are not part of the format.
    pub other_keys: Vec<String>,
}

/// Both images of a case or of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoImages {
    /// Left image.
    pub left: RgbImage,
    /// Right image, of the same size.
    pub right: RgbImage,
}

const CASE_KEYS: [&str; 18] = [
    "case",
    "split",
    "family",
    "scene",
    "left",
    "right",
    "calib",
    "disp_gt",
    "colour",
    "planar",
    "hard",
    "region_kind",
    "region_polygon_left_px",
    "region_area_px",
    "region_centroid_px",
    "search",
    "truth",
    "texture_mean_abs_gx",
];

/// Loads and checks `case.json` of a case folder.
///
/// # Errors
/// A missing or unreadable file, a missing key, or a value that is not allowed; the message names file, key and value.
pub fn load_case(folder: &Path) -> Result<Case, DatasetError> {
    let file = JsonFile::read(&folder.join(CASE_FILE))?;
    let root = file.root();
    let text = |key: &str| root.optional(key).map(|node| node.text().map(str::to_owned)).transpose();
    let folder_name = || folder.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned();
    Ok(Case {
        name: text("case")?.unwrap_or_else(folder_name),
        folder: folder.to_owned(),
        left: root.get("left")?.path()?,
        right: root.get("right")?.path()?,
        calibration: root.get("calib")?.path()?,
        disparity_truth: root.optional("disp_gt").map(|node| node.path()).transpose()?,
        region_polygon_left_px: polygon(&root.get("region_polygon_left_px")?)?,
        region_centroid_px: root.optional("region_centroid_px").map(|node| node.numbers::<2>()).transpose()?,
        search: search_range(&root.get("search")?)?,
        planar: root.optional("planar").map(|node| node.boolean()).transpose()?.unwrap_or(true),
        hard: root.optional("hard").map(|node| hardness(&node)).transpose()?,
        split: text("split")?,
        family: text("family")?,
        scene: text("scene")?,
        region_kind: text("region_kind")?,
        truth: root.optional("truth").map(|node| plane_truth(&node)).transpose()?,
        other_keys: root.other_keys(&CASE_KEYS),
    })
}

fn hardness(node: &Node<'_>) -> Result<Hardness, DatasetError> {
    let name = node.text()?;
    let found = Hardness::NAMES.into_iter().find(|(known, _)| *known == name);
    found.map(|(_, hard)| hard).ok_or_else(|| node.refuse("must be small, lowtex, occl or null"))
}

fn plane_truth(node: &Node<'_>) -> Result<PlaneTruth, DatasetError> {
    let millis = |key: &str| node.optional(key).map(|n| n.positive().map(|mm| mm * 1e-3)).transpose();
    Ok(PlaneTruth {
        normal_in_cam_left: facing_unit_normal(&node.get("normal")?)?,
        z_m: node.get("z_mm")?.positive()? * 1e-3,
        h_m: millis("h_mm")?,
        m_per_px_disparity: millis("mm_per_px_disparity")?,
        disparity_plane: node.optional("disparity_plane").map(|n| n.numbers::<3>()).transpose()?,
        z_sigma_m: node.optional("z_sigma_mm").map(|n| n.not_negative().map(|mm| mm * 1e-3)).transpose()?,
        normal_sigma_rad: node
            .optional("normal_sigma_deg")
            .map(|n| n.not_negative().map(f64::to_radians))
            .transpose()?,
        how: node.optional("how").map(|n| n.text().map(str::to_owned)).transpose()?,
    })
}

fn facing_unit_normal(node: &Node<'_>) -> Result<Vector3<f64>, DatasetError> {
    let normal = Vector3::from(node.numbers::<3>()?);
    if (normal.norm() - 1.0).abs() > 1e-3 {
        return Err(node.refuse(format!("must have length 1 (to 0.001), not {:.4}", normal.norm())));
    }
    if normal.z >= 0.0 {
        return Err(node.refuse("must face the camera: its z must be negative"));
    }
    Ok(normal.normalize())
}

impl Case {
    /// Loads both images and checks that they have the same size.
    ///
    /// # Errors
    /// An image that is missing, damaged or of another size; the message names it.
    pub fn load_images(&self) -> Result<StereoImages, DatasetError> {
        let left = load_rgb(&self.left)?;
        let right = load_rgb_of_size(&self.right, size_of(&left), &self.left.display().to_string())?;
        Ok(StereoImages { left, right })
    }

    /// Loads the calibration.
    ///
    /// # Errors
    /// The file is missing or refused.
    pub fn load_calibration(&self) -> Result<StereoCalibration, DatasetError> {
        Ok(load_stereo(std::slice::from_ref(&self.calibration))?)
    }

    /// As [`Self::load_calibration`], for images of this size, with what the user states; [`StereoCalibration::other_lens`] is left to be
    /// decided.
    ///
    /// # Errors
    /// As [`Self::load_calibration`]; the user and the file state different things.
    pub fn load_calibration_for(
        &self,
        images: ImageSize,
        stated: &StatedCalibration,
    ) -> Result<StereoCalibration, DatasetError> {
        Ok(load_stated(std::slice::from_ref(&self.calibration), Some(images), stated)?)
    }

    /// Loads the disparity ground truth, if the case has one.
    ///
    /// # Errors
    /// The file is missing, damaged or not a disparity map.
    pub fn load_disparity_truth(&self) -> Result<Option<DisparityMap>, DatasetError> {
        Ok(self.disparity_truth.as_deref().map(DisparityMap::load).transpose()?)
    }

    /// Whether the region is a chessboard or a board with markers, whose pattern repeats.
    pub fn is_board(&self) -> bool {
        self.region_kind.as_deref().is_some_and(|kind| kind.contains("board"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn valid() -> Value {
        json!({
            "left": "../_scenes/s/left.png", "right": "right.jpg", "calib": "/abs/calib.json",
            "region_polygon_left_px": [[10, 20], [110.5, 25], [90, 140]],
            "search": {"z_min_mm": 300, "z_max_mm": 900.5, "tilt_max_deg": 60},
        })
    }

    fn load(value: &Value) -> Result<Case, DatasetError> {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("box_7");
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join(CASE_FILE), value.to_string()).unwrap();
        load_case(&folder)
    }

    fn check_refused(change: impl FnOnce(&mut Value), parts: &[&str]) {
        let mut value = valid();
        change(&mut value);
        let message = load(&value).unwrap_err().to_string();
        for part in parts.iter().chain(&["case.json"]) {
            assert!(message.contains(part), "{message:?} must contain {part:?}");
        }
    }

    #[test]
    fn the_smallest_case_has_defaults() {
        let case = load(&valid()).unwrap();
        assert_eq!(case.name, "box_7");
        assert!(case.left.ends_with("box_7/../_scenes/s/left.png"));
        assert_eq!(case.calibration, Path::new("/abs/calib.json"));
        assert!((case.search.z_max_m - 0.9005).abs() < 1e-12);
        assert!((case.search.tilt_max_rad - std::f64::consts::FRAC_PI_3).abs() < 1e-12);
        assert!(case.planar && case.truth.is_none() && case.hard.is_none() && !case.is_board());
        assert_eq!(case.region_polygon_left_px[1], [110.5, 25.0]);
    }

    #[test]
    fn truth_is_read_in_metres_and_radians_and_extra_keys_are_listed() {
        let mut value = valid();
        value["truth"] = json!({"normal": [0.36, -0.48, -0.8], "z_mm": 512.5, "z_sigma_mm": 0.25,
            "normal_sigma_deg": 90, "mm_per_px_disparity": 2.0, "disparity_plane": [0.1, -0.2, 30], "new_key": 1});
        value["hard"] = json!("occl");
        value["regoin"] = json!(1);
        let case = load(&value).unwrap();
        let truth = case.truth.unwrap();
        assert!((truth.normal_in_cam_left - Vector3::new(0.36, -0.48, -0.8)).norm() < 1e-12);
        assert!((truth.z_m - 0.5125).abs() < 1e-12);
        assert!((truth.z_sigma_m.unwrap() - 0.000_25).abs() < 1e-12);
        assert!((truth.normal_sigma_rad.unwrap() - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert_eq!(truth.disparity_plane, Some([0.1, -0.2, 30.0]));
        assert_eq!(truth.h_m, None);
        assert_eq!(case.hard, Some(Hardness::Occluded));
        assert_eq!(case.other_keys, ["regoin"]);
    }

    #[test]
    fn refusals_name_key_value_and_what_is_allowed() {
        check_refused(|v| drop(v.as_object_mut().unwrap().remove("left")), &["`left`", "missing"]);
        check_refused(|v| v["calib"] = json!(7), &["`calib`", "7", "string"]);
        check_refused(|v| drop(v["search"].as_object_mut().unwrap().remove("z_min_mm")), &["`search.z_min_mm`"]);
        check_refused(|v| v["search"]["z_min_mm"] = json!(-1), &["`search.z_min_mm`", "-1"]);
        check_refused(|v| v["search"]["z_max_mm"] = json!(300), &["`search.z_max_mm`", "300", "greater"]);
        check_refused(|v| v["search"]["tilt_max_deg"] = json!(85.01), &["`search.tilt_max_deg`", "0 and 85 degrees"]);
        check_refused(|v| v["region_polygon_left_px"] = json!([[1, 2], [3, 4]]), &["at least 3 corners", "not 2"]);
        check_refused(|v| v["region_polygon_left_px"] = json!([[1, 2], [3, 4], [5, 6]]), &["0.00 square pixels"]);
        check_refused(|v| v["region_polygon_left_px"][1] = json!([1, 2, 3]), &["`region_polygon_left_px[1]`"]);
        check_refused(|v| v["region_polygon_left_px"][2][1] = json!("x"), &["`region_polygon_left_px[2][1]`", "\"x\""]);
        check_refused(|v| v["hard"] = json!("very"), &["`hard`", "\"very\"", "lowtex"]);
        check_refused(|v| v["planar"] = json!(1), &["`planar`", "true or false"]);
        check_refused(|v| v["truth"] = json!({"z_mm": 500}), &["`truth.normal`", "missing"]);
        check_refused(|v| v["truth"] = json!({"normal": [0, 0, -1], "z_mm": -5}), &["`truth.z_mm`", "-5"]);
        check_refused(|v| v["truth"] = json!({"normal": [0, 0, 1], "z_mm": 5}), &["face the camera"]);
        check_refused(|v| v["truth"] = json!({"normal": [0, 0.5, -1], "z_mm": 5}), &["length 1", "1.1180"]);
        check_refused(|v| *v = json!([1, 2]), &["(whole file)", "object"]);
    }

    #[test]
    fn broken_json_says_where() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(CASE_FILE), "{\"left\": \n oops}").unwrap();
        let error = load_case(dir.path()).unwrap_err();
        let cause = std::error::Error::source(&error).unwrap().to_string();
        assert!(cause.contains("line 2"), "{cause}");
    }
}
