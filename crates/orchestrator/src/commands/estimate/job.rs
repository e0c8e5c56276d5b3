//! Jobs of `pb3dp estimate`: cases of a dataset, or one stereo pair.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use image::RgbImage;
use nalgebra::Vector2;
use pb3dp_cell::calibration_share::term_or_warning;
use pb3dp_cell::lens_reading::decide_lens;
use pb3dp_cell::search_range::{self, range_of_dataset};
use pb3dp_estimation::calibration_term::CalibrationTerm;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::StereoCamera;
use pb3dp_record::calibration_files::load_stated;
use pb3dp_record::dataset::{Case, load_case};
use pb3dp_record::images::{StoredImage, check_size, size_of};
use pb3dp_setup::region_spec::load_region;
use pb3dp_wiring::{ReplayPace, wire_replay};

use crate::arguments::{EstimateArgs, MethodArgs};

/// Input of an estimate, in memory.
pub struct Job {
    /// Name of the case, or of the left image.
    pub name: String,
    /// Left image.
    pub left: RgbImage,
    /// Right image.
    pub right: RgbImage,
    /// Calibration.
    pub rig: StereoRig,
    /// Its share in covariances, if its file has a covariance.
    pub calibration_term: Option<CalibrationTerm>,
    /// The files of the calibration.
    pub calibration_files: Vec<PathBuf>,
    /// What the user should know of the files.
    pub notes: Vec<String>,
    /// Assumptions about the calibration that can be wrong.
    pub calibration_warnings: Vec<String>,
    /// The object.
    pub region: Region,
    /// Image point at which the depth is reported; default: the region's centroid.
    pub centroid_px: Option<[f64; 2]>,
    /// Search range.
    pub range: SearchRange,
    /// The case with its truth, if the job is a case.
    pub case: Option<Case>,
}

impl Job {
    /// Loads a case folder.
    ///
    /// # Errors
    /// A missing or damaged file, or inconsistent values; by name.
    pub fn from_case(folder: &Path, args: &EstimateArgs) -> Result<Self> {
        let case = load_case(folder)?;
        let images = case.load_images()?;
        let calibration = case.load_calibration_for(size_of(&images.left), &args.recording.calibration.stated())?;
        check_sizes(&calibration.rig, &images.left, &case.left, &calibration.source)?;
        let calibration = decide_lens(calibration, &images.left, &images.right)?;
        let vertices_px = case.region_polygon_left_px.iter().map(|&[u, v]| Vector2::new(u, v)).collect();
        Ok(Self {
            name: case.name.clone(),
            left: images.left,
            right: images.right,
            calibration_term: term_or_warning(&calibration),
            rig: calibration.rig,
            calibration_files: vec![case.calibration.clone()],
            notes: calibration.notes,
            calibration_warnings: calibration.warnings,
            region: Region::Polygon { vertices_px },
            centroid_px: case.region_centroid_px,
            range: overridden(range_of_dataset(&case.search), &args.method),
            case: Some(case),
        })
    }

    /// Loads the pair of the command line.
    ///
    /// # Errors
    /// A missing or damaged file, or inconsistent values; by name.
    pub fn from_files(args: &EstimateArgs) -> Result<Self> {
        let (Some(left_file), Some(right_file), Some(region)) = (&args.left, &args.right, &args.region) else {
            bail!("one pair needs --left, --right, --calib and --region");
        };
        let left = StoredImage::load(left_file)?;
        let calibration = load_stated(&args.calib, Some(left.size()), &args.recording.calibration.stated())?;
        let right = StoredImage::load(right_file)?;
        check_size(right_file, right.size(), (left.size(), &left_file.display().to_string()))?;
        let ([left, right], note) = StoredImage::to_rgb_pair([left, right], &mut args.recording.range.clone());
        check_sizes(&calibration.rig, &left, left_file, &calibration.source)?;
        let calibration = decide_lens(calibration, &left, &right)?;
        let calibration_term = term_or_warning(&calibration);
        let mut notes = calibration.notes;
        notes.extend(note);
        let given = default_range(&calibration.rig, args.method.z_range.is_none(), &mut notes);
        Ok(Self {
            name: pair_name(left_file),
            region: load_region(region, size_of(&left))?,
            left,
            right,
            rig: calibration.rig,
            calibration_term,
            calibration_files: args.calib.clone(),
            notes,
            calibration_warnings: calibration.warnings,
            centroid_px: None,
            range: overridden(given, &args.method),
            case: None,
        })
    }
}

impl Job {
    /// Loads the pair of a recording that the command line names.
    ///
    /// # Errors
    /// A recording that cannot be used, a pair that it does not have or that is damaged, and no region.
    pub fn from_recording(path: &Path, args: &EstimateArgs) -> Result<Self> {
        if args.recording.skew.is_some() {
            bail!(
                "--skew has no effect on a single pair, whose motion is not known: leave it out, or use `pb3dp track`"
            );
        }
        let mut recording = wire_replay(path, &args.calib, &args.recording, ReplayPace::Fast).context("--sequence")?;
        let pairs = recording.camera.pairs();
        if args.frame >= pairs {
            bail!("--frame {}: the recording has {pairs} pairs, numbered from 0", args.frame);
        }
        recording.camera.skip_to(args.frame);
        let rig = *recording.camera.rig();
        let pair = recording.camera.next_pair(Duration::ZERO).with_context(|| format!("--frame {}", args.frame))?;
        let region = match (&args.region, &recording.region_polygon_left_px) {
            (Some(spec), _) => load_region(spec, size_of(&pair.left))?,
            // The region belongs to the first pair.
            (None, Some(corners)) if args.frame == 0 => {
                Region::Polygon { vertices_px: corners.iter().map(|&[u, v]| Vector2::new(u, v)).collect() }
            }
            (None, _) => bail!(
                "pair {} has no region: mark the object in its left image with --region; a region of the recording belongs to pair 0",
                args.frame
            ),
        };
        let of_calibration = &recording.camera.calibration().warnings;
        for warning in recording.warnings.iter().filter(|warning| !of_calibration.contains(warning)) {
            tracing::warn!("{warning}");
        }
        let mut notes = recording.notes;
        notes.extend(recording.camera.calibration().notes.iter().cloned());
        notes.extend(recording.camera.take_notes());
        let given = match &recording.search {
            Some(search) => range_of_dataset(search),
            None => default_range(&rig, args.method.z_range.is_none(), &mut notes),
        };
        Ok(Self {
            name: format!("{} {}", pair_name(path), args.frame),
            left: pair.left,
            right: pair.right,
            rig,
            calibration_term: term_or_warning(recording.camera.calibration()),
            calibration_files: args.calib.clone(),
            notes,
            calibration_warnings: recording.camera.calibration().warnings.clone(),
            region,
            centroid_px: None,
            range: overridden(given, &args.method),
            case: None,
        })
    }
}

/// Name of a pair of image files: the left file name without its extension.
pub fn pair_name(left_file: &Path) -> String {
    left_file.file_stem().map_or_else(|| "pair".into(), |stem| stem.to_string_lossy().into_owned())
}

/// Refuses an image of another size than the calibration.
fn check_sizes(rig: &StereoRig, left: &RgbImage, file: &Path, source: &str) -> Result<()> {
    Ok(check_size(file, size_of(left), (rig.left().size(), &format!("the calibration ({source})")))?)
}

/// The default range; a note states it if it is used.
pub fn default_range(rig: &StereoRig, is_used: bool, notes: &mut Vec<String>) -> SearchRange {
    let range = search_range::default_range(rig);
    if is_used {
        notes.push(format!(
            "no --z-range given: searching {:.0} to {:.0} mm (disparities of 35 to 5 % of the width); a narrower range is \
             searched more finely",
            range.z_min_m * 1e3,
            range.z_max_m * 1e3
        ));
    }
    range
}

/// The command line overrides the file.
pub fn overridden(given: SearchRange, method: &MethodArgs) -> SearchRange {
    let mut range = given;
    if let Some(z) = method.z_range {
        (range.z_min_m, range.z_max_m) = (z.min_mm * 1e-3, z.max_mm * 1e-3);
    }
    if let Some(tilt_max_deg) = method.tilt_max {
        range.tilt_max_rad = tilt_max_deg.to_radians();
    }
    range
}
