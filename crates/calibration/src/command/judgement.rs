//! The origin and quality data stored in a calibration file.

use std::path::Path;

use crate::fit::sides;
use crate::gates::Judged;
use crate::held_out::Chosen;
use crate::quality::Quality;
use anyhow::Result;
use nalgebra::DMatrix;
use pb3dp_record::calibration_files::{
    CAMERAS_FILE, CameraIdentity, JudgedGate, Judgement, ParameterCovariance, load_cameras,
};

/// The cameras in the file `named`, or in the `cameras.toml` in the folder of the left images or above it; unknown without a
/// file.
pub(super) fn cameras(named: Option<&Path>, left: &Path) -> Result<[CameraIdentity; 2]> {
    let near = || [Some(left), left.parent()].into_iter().flatten().map(|folder| folder.join(CAMERAS_FILE));
    let file = named.map(Path::to_path_buf).or_else(|| near().find(|file| file.is_file()));
    match file {
        Some(file) => {
            super::tell(&format!("cameras: {}", file.display()))?;
            Ok(load_cameras(&file)?)
        }
        None => {
            super::tell(
                "cameras unknown: the calibration file will not identify them; give --cameras with a cameras.toml (docs/calibration.md)",
            )?;
            Ok(Default::default())
        }
    }
}

/// All quality data of a stereo calibration except the camera identities.
pub(super) fn of(
    chosen: &Chosen<2>,
    quality: &Quality,
    judged: &[Judged],
    (newest, cameras): (&str, [CameraIdentity; 2]),
) -> Judgement {
    let mut numbers = vec![
        ("corners".to_owned(), quality.corners as f64),
        ("reprojection_rms_px".to_owned(), quality.reprojection_rms_px),
        ("held_out_rms_px".to_owned(), quality.held_out_rms_px),
    ];
    if let Some(rows) = quality.rows {
        numbers.extend([("row_error_mean_px".to_owned(), rows.mean_px), ("row_error_p95_px".to_owned(), rows.p95_px)]);
    }
    let by_camera = sides::<2>().into_iter().zip(&quality.reprojection_rms_by_camera_px);
    numbers.extend(by_camera.map(|(side, rms_px)| (format!("reprojection_rms_{side}_px"), *rms_px)));
    let by_view = &quality.reprojection_rms_by_view_px;
    numbers.extend(by_view.iter().map(|(view, rms_px)| (format!("view {view}: reprojection_rms_px"), *rms_px)));
    let source = format!("{} views of {}, lens model {}", quality.views, chosen.fit.board().kind(), chosen.fit.lens());
    let covariance = chosen.fit.covariance().of_cameras();
    judgement((newest, source, cameras), numbers, (&covariance.names, &covariance.matrix), judged)
}

/// The quality data of a calibration from its date, source and cameras.
pub(super) fn judgement(
    (date, source, cameras): (&str, String, [CameraIdentity; 2]),
    numbers: Vec<(String, f64)>,
    (names, covariance): (&[String], &DMatrix<f64>),
    judged: &[Judged],
) -> Judgement {
    let rows = covariance.row_iter().map(|row| row.iter().copied().collect()).collect();
    Judgement {
        date: date.to_owned(),
        tool: concat!("pb3dp-calibrate ", env!("CARGO_PKG_VERSION")).to_owned(),
        source,
        cameras,
        numbers,
        covariance: Some(ParameterCovariance { names: names.to_vec(), rows }),
        gates: judged.iter().map(JudgedGate::from).collect(),
    }
}
