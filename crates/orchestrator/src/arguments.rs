//! Arguments of `pb3dp run`, `estimate` and `track`, and their parsers.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{ArgGroup, Args};
use pb3dp_bag::live::ViewerAddress;
use pb3dp_cell::terminal::{parse_seconds, with_unit};
use pb3dp_estimation::estimator::{DirectTrackerConfig, Method};
use pb3dp_panel::PanelAddress;
use pb3dp_record::dataset::TILT_LIMIT_DEG;
use pb3dp_setup::layers::SetupArgs;
use pb3dp_setup::region_spec::{REGION_HELP, RegionSpec};
use pb3dp_wiring::ReplayPace;
use pb3dp_wiring::{RecordingOptions, TimedRecordingOptions};

use crate::numbers::millis;
use crate::panel_access::{PANEL_ADDRESS, PanelAccess, parse_address};

/// Exit code with `--strict` for an answer other than `ok`, and for setups or recordings that differ.
pub const UNSURE: u8 = 3;

/// Arguments of `pb3dp run`.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("of_the_panel").multiple(true).args(["token", "certificate", "key", "hosts"]).requires("panel"))]
pub struct RunArgs {
    /// The setup.
    #[command(flatten)]
    pub setup: SetupArgs,
    /// Folder for report.html, summary.json and the recorded time series.
    #[arg(long, value_name = "DIR", default_value = "out/run")]
    pub out: PathBuf,
    /// Seed of all random numbers, instead of `run.seed` of the setup: scene, noise, searches, camera faults and emulated arms.
    #[arg(long, value_name = "N", value_parser = parse_seed, allow_hyphen_values = true)]
    pub seed: Option<u64>,
    /// End after this many seconds of the experiment.
    #[arg(long, value_name = "SECONDS", value_parser = parse_seconds, allow_hyphen_values = true)]
    pub stop_after: Option<f64>,
    /// Also record the run: in a FILE.mcap everything, with ROS 2 messages; in a folder of any other name every stereo pair with its
    /// truth. `pb3dp track` reads both.
    #[arg(long, value_name = "FILE.mcap|DIR")]
    pub record: Option<PathBuf>,
    /// Continue the recording in another file after so many megabytes (of 1 000 000 bytes): FILE_001.mcap and so on.
    #[arg(long, value_name = "N", requires = "record", value_parser = clap::value_parser!(u32).range(1..))]
    pub rotate_mb: Option<u32>,
    /// Continue the recording in another file after so many minutes.
    #[arg(long, value_name = "N", requires = "record", value_parser = clap::value_parser!(u32).range(1..))]
    pub rotate_minutes: Option<u32>,
    /// Let viewers that are compatible with Foxglove watch the run, at 127.0.0.1:8765 or another address of this computer.
    #[arg(long, value_name = "ADDRESS:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
    pub live: Option<ViewerAddress>,
    /// The target in the first left image of real cameras; overrides camera.region of the setup.
    #[arg(long, value_name = "REGION", help = format!("The target in the first left image of real cameras; overrides camera.region of the setup: {REGION_HELP}"))]
    pub region: Option<RegionSpec>,
    /// Move real arms with a calibration that states no measured cameras (`calibration_quality`: none).
    #[arg(long)]
    pub nominal_calibration: bool,
    /// The operator of the run. Arms that are not emulated need `console`, --panel or --move.
    #[arg(long, value_enum, default_value_t = OperatorName::Command)]
    pub operator: OperatorName,
    /// Serve the operator panel at this address (127.0.0.1:8087 without one), and let it lead the run: choose the target with the mouse,
    /// start, hold, stop (docs/panel.md).
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = PANEL_ADDRESS, value_parser = parse_address, conflicts_with_all = ["operator", "moves"])]
    pub panel: Option<PanelAddress>,
    /// Other computers.
    #[command(flatten)]
    pub panel_access: PanelAccess,
    /// Move arms that are not emulated without a console, after their names are typed. Then press Enter at least every
    /// supervisor.operator_key_within_s while they move.
    #[arg(long = "move")]
    pub moves: bool,
    /// End with exit code 3 if the hand followed the target for less than 90 % of the time.
    #[arg(long)]
    pub strict: bool,
}

/// The operator of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum OperatorName {
    /// The command itself: it selects the target and starts once; a stop of the arms ends the run.
    Command,
    /// A person who types commands on standard input: select, start, hold, resume, re-align, stop, reset, status, quit. Nothing moves before
    /// start; a stop or fault does not end the run. Without --stop-after the run ends after one hour.
    Console,
}

/// Arguments that select and tune the estimation method.
#[derive(Debug, Args)]
pub struct MethodArgs {
    /// The estimation method.
    #[arg(long, value_name = "NAME", default_value = Method::Direct.name(), value_parser = method_parser())]
    pub method: Method,
    /// A TOML file with all parameters of the method (copy configs/estimator.toml); the documented defaults without it.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Seed of the search, instead of that of the configuration; without effect on the method direct.
    #[arg(long, value_name = "N", value_parser = parse_seed, allow_hyphen_values = true)]
    pub seed: Option<u64>,
    /// Depths to search, millimetres; overrides the case or sequence.
    #[arg(long, value_name = "MIN,MAX", value_parser = parse_z_range, allow_hyphen_values = true)]
    pub z_range: Option<ZRange>,
    /// Largest tilt to search, degrees; overrides the case or sequence. Default 60.
    #[arg(long, value_name = "DEGREES", value_parser = parse_tilt, allow_hyphen_values = true)]
    pub tilt_max: Option<f64>,
    /// Return the best answer so far after this time per pair, milliseconds, with a warning.
    #[arg(long, value_name = "MS", value_parser = parse_deadline, allow_hyphen_values = true)]
    pub deadline: Option<f64>,
    /// One JSON object per line on standard output instead of a table.
    #[arg(long)]
    pub json: bool,
    /// End with exit code 3 if an answer has another status than `ok`.
    #[arg(long)]
    pub strict: bool,
    /// Write images with region, re-projected model and pose axes into this folder; `track` also writes an animated PNG,
    /// sequence.png.
    #[arg(long, value_name = "DIR")]
    pub overlay: Option<PathBuf>,
}

impl MethodArgs {
    /// Warns of options that the method ignores.
    pub fn warn_without_effect(&self) {
        if self.seed.is_some() && self.method == Method::Direct {
            tracing::warn!("--seed has no effect: the method {} always gives the same answer", self.method);
        }
    }
}

/// Meaning of the numbers of `pb3dp estimate --json`.
const ESTIMATE_JSON: &str = "Lines of --json (one per case):
  schema_version    number of the form of results; rises when a word or key gets another meaning or goes away
  case, method      their names
  status            ok, weak-tilt, weak-depth, ambiguous, miscalibrated, not-observable or error
  z_mm              depth of the plane on the ray of the region's centroid, millimetres, or null
  normal            3 numbers or null: unit normal of the plane along the axes of the left camera, towards the camera
  fitness           how well the images agree, at most 1, or null
  z_sigma_mm        standard deviation of z_mm, or null
  normal_sigma_deg  standard deviation of the normal, degrees, or null
  ms                CPU time of one thread from the images in memory to the pose, milliseconds
  centroid_px       the point of the left image on whose ray the depths are given
  second_plane      z_mm, normal and share of another surface in the region, or null
  point_mm          3 numbers or null: where the plane meets the ray of centroid_px, in the left camera
  cam_left_from_model  16 numbers, row by row, or null: the frame of the model on the plane
  covariance        36 numbers, row by row, or null: of that frame, as in pb3dp track
  calibration_covariance  the share of the calibration, if the calibration file states a covariance
  pose_covariance   the sum of both, or null
  observed          six booleans or null: whether x, y, z and the turns about them are determined
                    (the region itself fixes x, y and the turn about z)
  row_offset_px     row of the right image minus row of the left one (rectified), as measured, or null
  surface           only with --surface: file, points, measured (points with a match of their own), sigma_median_mm
  reason            what led to the status
  warnings          what may make the answer worse than it looks";

/// Arguments of `pb3dp estimate`.
#[derive(Debug, Args)]
#[command(after_long_help = ESTIMATE_JSON, group = ArgGroup::new("images").required(true).args(["cases", "left", "sequence"]))]
#[command(group = ArgGroup::new("of_recordings").multiple(true).args(["frame", "topics", "pair_within", "layout"]).conflicts_with_all(["cases", "left"]))]
#[command(group = ArgGroup::new("of_deep_images").args(["range"]).conflicts_with("cases"))]
pub struct EstimateArgs {
    /// Every case folder (one with a case.json) under DIR; the format is described in docs/dataset-format.md.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["right", "calib", "region"])]
    pub cases: Option<PathBuf>,
    /// The left image: PNG, JPEG, TIFF, BMP, PGM, PPM or WebP.
    #[arg(long, value_name = "FILE", requires_all = ["right", "calib", "region"])]
    pub left: Option<PathBuf>,
    /// The right image.
    #[arg(long, value_name = "FILE", requires = "left")]
    pub right: Option<PathBuf>,
    /// Calibration: the file that `pb3dp calibrate` writes, calib.json, a Kalibr camchain, an OpenCV stereo YAML or its two files
    /// `intrinsics.yml,extrinsics.yml`, or two ROS camera_info files `left.yaml,right.yaml`; or a folder that contains `calib.json`,
    /// `calibration.toml` or one of these pairs.
    #[arg(long, value_name = "FILE[,FILE]", value_delimiter = ',')]
    pub calib: Vec<PathBuf>,
    /// The object in the left image.
    #[arg(long, value_name = "REGION", help = format!("The object in the left image: {REGION_HELP}"))]
    pub region: Option<RegionSpec>,
    /// A recording, of every kind that `pb3dp track` reads; without --region the region of the recording.
    #[arg(long, value_name = "PATH")]
    pub sequence: Option<PathBuf>,
    /// The pair of the recording, from 0.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub frame: u64,
    /// What a recording does not state itself.
    #[command(flatten)]
    pub recording: RecordingOptions,
    /// Also search every hypothesis that a chromosome can express, so that search error and fitness error can be distinguished (slow; --method published only).
    #[arg(long)]
    pub reference_optimum: bool,
    /// Write the visible surface of the region, pixel by pixel, with its colours and standard deviations into this PLY file, in the
    /// frame of the left camera and in millimetres (direct only): for objects that are no plane. Of a region of more than 160 000
    /// pixels every second or fourth one.
    #[arg(long, value_name = "FILE", conflicts_with = "cases")]
    pub surface: Option<PathBuf>,
    /// Estimation options.
    #[command(flatten)]
    pub method: MethodArgs,
}

/// Meaning of the numbers of `pb3dp track --json`.
const TRACK_JSON: &str =
    "Lines of --json (one per frame; one per frame and target, with the key `target`, if there are several):
  schema_version       number of the form of results; rises when a word or key gets another meaning or goes away
  frame                counts from 0
  target               only if there are several: 0 is the target of the sequence, then those of --region in their order
  t_s                  mid-exposure, seconds
  status               ok, weak-tilt, partly-observed, weak-depth, ambiguous, miscalibrated, not-observable, lost or error
  cam_left_from_model  16 numbers, row by row, millimetres: maps the model's coordinates to the left camera's
  covariance           36 numbers, row by row, or null: of xi = (x, y, z in mm, then a rotation vector in radians), both
                       along the axes of the model, with true pose = cam_left_from_model * exp(xi): of the pose since the
                       first one, and in the first frame that of the first pose
  first_pose_covariance  the same of the first pose against the visible surface of the target
  pose_covariance      the sum, in the first frame that of the first pose: the same of this pose against the visible surface
  surface_from_model   16 numbers as above: the plane of the visible surface beside the model, as the frames so far show it
  surface_covariance   the same as covariance, of that plane against the visible surface of the target
  surface_version      number of frames that have improved it; 0: it is the plane of the model
  calibration_covariance, calibration_covariance_of_motion  the share of the calibration in pose_covariance, and that to be
                       added to covariance, if the calibration file states a covariance
  observed             six booleans, whether the images determine x, y, z and the turns about them, or null
  fitness              how well the images agree, at most 1, or null
  ms                   CPU time of one thread from the images in memory to the pose, milliseconds
  reason               what led to the status
  warnings             what may make the pose worse than it looks";

/// Arguments of `pb3dp track`.
#[derive(Debug, Args)]
#[command(after_long_help = TRACK_JSON)]
pub struct TrackArgs {
    /// The recording: a sequence folder, an MCAP file or rosbag2 folder, a EuRoC folder, or a folder of images (docs/recordings.md).
    #[arg(long, value_name = "PATH")]
    pub sequence: PathBuf,
    /// Calibration of the recording's cameras, instead of its own: as --calib of `pb3dp estimate`.
    #[arg(long, value_name = "FILE[,FILE]", value_delimiter = ',')]
    pub calib: Vec<PathBuf>,
    /// What the recording does not state itself.
    #[command(flatten)]
    pub recording: TimedRecordingOptions,
    /// Process frames as fast as possible, or at the times of the recording.
    #[arg(long, value_enum, default_value = "fast")]
    pub pace: ReplayPace,
    /// Targets in the left image of frame 0, in addition to that of the recording.
    #[arg(long, value_name = "REGION", help = format!("A target in the left image of frame 0, in addition to that of the recording if it has one; may be repeated: {REGION_HELP}"))]
    pub region: Vec<RegionSpec>,
    /// Time in which both cameras read all rows one after the other, milliseconds: what a moving target turns and shears in it is in the
    /// covariance (direct only).
    #[arg(long, value_name = "MS", value_parser = millis(DirectTrackerConfig::ROLLING_SHUTTER_MILLIS), allow_negative_numbers = true)]
    pub rolling_shutter: Option<f64>,
    /// Write the recovered surface with its colours and standard deviations into this PLY file, in the model frame (direct only).
    #[arg(long, value_name = "FILE")]
    pub surface: Option<PathBuf>,
    /// Write the estimates into this CSV file, with the columns of estimates.csv of a run; `age_ms` is empty. With several targets
    /// each has its own, FILE-0.csv and so on.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Estimation options.
    #[command(flatten)]
    pub method: MethodArgs,
}

/// Depths to search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ZRange {
    /// Nearest, millimetres.
    pub min_mm: f64,
    /// Farthest, millimetres.
    pub max_mm: f64,
}

/// The methods by name, with what each is for.
fn method_parser() -> impl TypedValueParser<Value = Method> {
    let values = Method::ALL.map(|method| PossibleValue::new(method.name()).help(method.summary()));
    PossibleValuesParser::new(values).try_map(|name| Method::from_name(&name))
}

pub(crate) fn parse_z_range(text: &str) -> Result<ZRange, String> {
    let refuse = || format!("{text:?} is not MIN,MAX in millimetres with 0 < MIN < MAX, for instance 350,650");
    let (min, max) = text.split_once(',').ok_or_else(refuse)?;
    let bare = |depth: &str| depth.trim().trim_end_matches("mm").trim_end().parse::<f64>();
    let (Ok(first), Ok(second)) = (bare(min), bare(max)) else { return Err(refuse()) };
    let (min_mm, max_mm) = (first.min(second), first.max(second));
    if !(min_mm > 0.0 && min_mm < max_mm && max_mm.is_finite()) {
        return Err(refuse());
    }
    if text.contains("mm") {
        return Err(format!("{text:?}: give the numbers in millimetres, without a unit: {min_mm},{max_mm}"));
    }
    if max_mm < 20.0 {
        return Err(format!("{text:?} is in millimetres; did you mean {},{}?", 1e3 * min_mm, 1e3 * max_mm));
    }
    if first > second {
        return Err(format!(
            "{text:?} is not MIN,MAX in millimetres: MIN comes first; did you mean {min_mm},{max_mm}?"
        ));
    }
    Ok(ZRange { min_mm, max_mm })
}

fn parse_seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("{text:?} is not a whole number from 0 to {}", u64::MAX))
}

pub(crate) fn parse_tilt(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(degrees) if (0.0..=TILT_LIMIT_DEG).contains(&degrees) => Ok(degrees),
        _ => Err(with_unit(text, "degrees", &["deg", "degrees", "°"])
            .unwrap_or_else(|| format!("{text:?}: must be between 0 and {TILT_LIMIT_DEG} degrees"))),
    }
}

fn parse_deadline(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(millis) if (0.0..=1e6).contains(&millis) => Ok(millis),
        _ => Err(with_unit(text, "milliseconds", &["ms"])
            .unwrap_or_else(|| format!("{text:?}: must be between 0 and 1000000 milliseconds"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_checked() {
        assert_eq!(parse_z_range("350, 650"), Ok(ZRange { min_mm: 350.0, max_mm: 650.0 }));
        assert!(parse_z_range("0.25,0.55").unwrap_err().contains("millimetres; did you mean 250,550?"));
        for (text, meant) in [
            ("540,265", "MIN comes first; did you mean 265,540?"),
            ("350mm, 650 mm", "in millimetres, without a unit: 350,650"),
        ] {
            assert!(parse_z_range(text).is_err_and(|error| error.contains(meant)), "{text}");
        }
        assert!(parse_tilt("60deg").unwrap_err().ends_with("in degrees, without a unit: 60"));
        assert!(parse_deadline("20 ms").unwrap_err().ends_with("in milliseconds, without a unit: 20"));
        assert!(parse_deadline("1s").unwrap_err().ends_with("in milliseconds, without a unit"));
        assert!(parse_seconds("10s").unwrap_err().ends_with("in seconds, without a unit: 10"));
        for bad in ["350", "650,650", "-1,5", "a,b", "1,inf"] {
            assert!(parse_z_range(bad).unwrap_err().contains("MIN,MAX"), "{bad}");
        }
        assert!(
            ["nan", "-1", "0", "inf", "x"].iter().all(|bad| parse_seconds(bad).is_err())
                && parse_seconds("2.5") == Ok(2.5)
        );
        assert!(["-1", "1.5", "x", ""].iter().all(|bad| parse_seed(bad).is_err()) && parse_seed("7") == Ok(7));
        assert!(["85.01", "-1", "nan", "x"].iter().all(|bad| parse_tilt(bad).is_err()) && parse_tilt("45") == Ok(45.0));
    }

    #[test]
    fn the_largest_tilt_is_that_of_the_estimators() {
        let search = |deg: f64| pb3dp_estimation_core::plane_hypothesis::SearchRange::new(0.3, 0.6, deg.to_radians());
        assert!(parse_tilt("85").is_ok_and(|deg| search(deg).is_ok()) && search(85.01).is_err());
        let message = "must be between 0 and 85 degrees";
        assert!(parse_tilt("85.01").is_err_and(|error| error.contains(message)));
        assert!(search(85.01).is_err_and(|error| error.to_string().contains("tilt_max_rad")));
    }
}
