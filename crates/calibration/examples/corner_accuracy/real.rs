//! Real boards: errors of held-out views, with each localizer.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use image::GrayImage;
use pb3dp_calibration::board::{Chessboard, Sighting};
use pb3dp_calibration::detection::{agree, find_board_by};
use pb3dp_calibration::fit::View;
use pb3dp_calibration::held_out::choose;
use pb3dp_calibration::lens::LensModel;
use pb3dp_calibration::quality::Quality;
use pb3dp_calibration::sharpness::blur_px;
use pb3dp_geometry::ImageSize;
use pb3dp_record::metrics::median;

use crate::rendered::LOCALIZERS;

/// Stereo pairs of one board.
pub struct Set {
    pub name: String,
    pub board: Chessboard,
    pub pairs: Vec<[PathBuf; 2]>,
}

impl Set {
    /// The boards of this repository.
    pub fn of_repository() -> Result<Vec<Self>> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
        let set = |name: &str, folder: PathBuf, board: Chessboard, numbers: std::ops::RangeInclusive<u32>| {
            let pair = |number| ["left", "right"].map(|side| folder.join(format!("{side}{number:02}.jpg")));
            let pairs = numbers.map(pair).filter(|[left, _]| left.is_file()).collect();
            Self { name: name.to_owned(), board, pairs }
        };
        Ok(vec![
            set("OpenCV chessboards", folder.join("opencv_chessboards"), Chessboard::new(9, 6, 0.025)?, 1..=14),
            set("Bumblebee2 chessboards", folder.join("bumblebee2_chessboards"), Chessboard::new(6, 4, 0.03)?, 1..=11),
        ])
    }

    /// `name,folder,prefix,COLUMNSxROWS,square_mm`: every subfolder with the prefix has a `left.png` and a `right.png`.
    pub fn parse(text: &str) -> Result<Self> {
        let fields: Vec<&str> = text.split(',').collect();
        let [name, folder, prefix, size, square_mm] = fields[..] else {
            bail!("--boards {text}: give name,folder,prefix,COLUMNSxROWS,square_mm");
        };
        let (columns, rows) = size.split_once('x').with_context(|| format!("{size}: give COLUMNSxROWS"))?;
        let board = Chessboard::new(columns.parse()?, rows.parse()?, 1e-3 * square_mm.parse::<f64>()?)?;
        let mut folders = Vec::new();
        for entry in std::fs::read_dir(folder).with_context(|| format!("{folder}: cannot read the folder"))? {
            folders.push(entry?.path());
        }
        folders.retain(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(prefix)));
        folders.sort();
        let pairs = folders.iter().map(|folder| ["left.png", "right.png"].map(|name| folder.join(name))).collect();
        Ok(Self { name: name.to_owned(), board, pairs })
    }
}

/// The figures of one localizer on one set.
pub struct OfSet {
    pub name: String,
    pub localizer: &'static str,
    pub views: usize,
    pub pairs: usize,
    pub lens: String,
    pub blur_px: f64,
    pub corner_sigma_px: f64,
    pub view_scatter: f64,
    pub reprojection_px: f64,
    pub held_out_px: f64,
    pub rows_px: f64,
    pub detection_ms: f64,
}

/// Measures one set with all localizers.
pub fn measure(set: &Set) -> Result<Vec<OfSet>> {
    let load = |file: &PathBuf| -> Result<GrayImage> {
        Ok(image::open(file).with_context(|| format!("{}: cannot read", file.display()))?.into_luma8())
    };
    let images = set.pairs.iter().map(|[left, right]| Ok([load(left)?, load(right)?])).collect::<Result<Vec<_>>>()?;
    let [first, _] = images.first().with_context(|| format!("{}: no pairs", set.name))?;
    let size = ImageSize { width: first.width(), height: first.height() };
    let of = |(localizer, name): &(_, &'static str)| -> Result<OfSet> {
        let (mut views, mut blurs, mut times_ms) = (Vec::new(), Vec::new(), Vec::new());
        for (number, pair) in images.iter().enumerate() {
            let mut see = |image: &GrayImage| -> Option<Sighting> {
                let began = Instant::now();
                let sighting = find_board_by(image, &set.board, *localizer).ok();
                times_ms.push(1e3 * began.elapsed().as_secs_f64());
                blurs.extend(blur_px(image, sighting.as_ref()?));
                sighting
            };
            if let (Some(left), Some(right)) = (see(&pair[0]), see(&pair[1])) {
                let right = agree(&left, right, &set.board);
                views.push(View { name: format!("{number:02}"), sightings: [left, right] });
            }
        }
        let chosen = choose(&views, &set.board, size, &LensModel::ALL).with_context(|| set.name.clone())?;
        let quality = Quality::of_stereo(&chosen, &views, size, 0.5)?;
        Ok(OfSet {
            name: set.name.clone(),
            localizer: name,
            views: views.len(),
            pairs: images.len(),
            lens: chosen.fit.lens().to_string(),
            blur_px: median(&blurs).unwrap_or(f64::NAN),
            corner_sigma_px: chosen.fit.covariance().corner_sigma_px,
            view_scatter: chosen.fit.covariance().view_scatter,
            reprojection_px: quality.reprojection_rms_px,
            held_out_px: quality.held_out_rms_px,
            rows_px: quality.rows.map_or(f64::NAN, |rows| rows.rms_px),
            detection_ms: median(&times_ms).unwrap_or(f64::NAN),
        })
    };
    LOCALIZERS.iter().map(of).collect()
}
