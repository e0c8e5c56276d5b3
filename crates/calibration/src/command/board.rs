//! The board arguments, and `pb3dp calibrate board`, which writes a board for printing.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crate::board::Board;
use crate::ink::{draw, ink, svg};
use anyhow::{Context, Result, bail};
use clap::Args;

use super::numbers;

/// White margin around a printed board, as a share of its shorter side.
const MARGIN_SHARE: f64 = 0.08;
/// Longest side of a board image, pixels.
const SIDE_MAX_PX: f64 = 30_000.0;

/// A board pattern without physical sizes.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum BoardName {
    /// Inner corners.
    Chessboard([u32; 2]),
    /// Squares and marker dictionary.
    Charuco([u32; 2], String),
    /// Tags.
    AprilGrid([u32; 2]),
}

/// `9x6`, `charuco:8x6:DICT_4X4_50` or `aprilgrid:6x6`.
fn board_name(text: &str) -> Result<BoardName, String> {
    match text.split(':').collect::<Vec<_>>()[..] {
        [numbers] => Ok(BoardName::Chessboard(numbers::corners(numbers)?)),
        ["charuco", squares, dictionary] => Ok(BoardName::Charuco(numbers::corners(squares)?, dictionary.to_owned())),
        ["aprilgrid", tags] => Ok(BoardName::AprilGrid(numbers::corners(tags)?)),
        _ => Err(format!("{text:?} is not a board; examples: 9x6, charuco:8x6:DICT_4X4_50, aprilgrid:6x6")),
    }
}

/// Arguments that describe the board.
#[derive(Clone, Debug, Args)]
pub(super) struct BoardArgs {
    /// Board pattern. 9x6: chessboard by its inner corners (where four squares meet; one fewer than squares per side).
    /// charuco:8x6:DICT_4X4_50: ChArUco board by its squares and OpenCV dictionary name. aprilgrid:6x6: Kalibr AprilGrid by its
    /// tags.
    #[arg(long, value_name = "BOARD", value_parser = board_name)]
    pub(super) board: BoardName,
    /// Side of a square of a chessboard or ChArUco board, mm. Measure ten squares and divide: images cannot reveal a wrong size.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, allow_hyphen_values = true)]
    pub(super) square: Option<f64>,
    /// Side of a marker of a ChArUco board, mm.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, allow_hyphen_values = true)]
    pub(super) marker: Option<f64>,
    /// Side of a tag of an AprilGrid, mm, between its outer black edges.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, allow_hyphen_values = true)]
    pub(super) tag: Option<f64>,
    /// Gap between two tags of an AprilGrid, divided by the side of a tag.
    #[arg(long, value_name = "SHARE", default_value = "0.3")]
    pub(super) spacing: f64,
}

impl BoardArgs {
    /// The board, if all required sizes are given.
    pub(super) fn board(&self) -> Result<Board> {
        let needed = |length: Option<f64>, option: &str| {
            let missing = || format!("{option} MM is required for this board; measure it with a ruler");
            length.map(|length_mm| length_mm * 1e-3).with_context(missing)
        };
        let idle = match &self.board {
            BoardName::Chessboard(_) => [("--marker", self.marker), ("--tag", self.tag)],
            BoardName::Charuco(..) => [("--tag", self.tag), ("", None)],
            BoardName::AprilGrid(_) => [("--square", self.square), ("--marker", self.marker)],
        };
        if let Some((option, _)) = idle.iter().find(|(_, length)| length.is_some()) {
            bail!("{option} does not apply to this board; remove it");
        }
        Ok(match &self.board {
            BoardName::Chessboard([columns, rows]) => Board::new(*columns, *rows, needed(self.square, "--square")?)?,
            BoardName::Charuco(squares, dictionary) => Board::charuco(
                *squares,
                needed(self.square, "--square")?,
                needed(self.marker, "--marker")?,
                dictionary,
            )?,
            BoardName::AprilGrid(tags) => Board::april_grid(*tags, needed(self.tag, "--tag")?, self.spacing)?,
        })
    }
}

/// Arguments of `pb3dp calibrate board`.
#[derive(Debug, Args)]
pub(super) struct PrintArgs {
    #[command(flatten)]
    board: BoardArgs,
    /// Output file: .svg or .png. Print it without scaling to the page, and measure the print.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Resolution of a .png, pixels per inch.
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(50..=2400))]
    dpi: u32,
}

/// Writes a board for printing.
pub(super) fn run(args: &PrintArgs) -> Result<ExitCode> {
    let board = args.board.board()?;
    let ink = ink(&board);
    let [left, top, right, bottom] = crate::ink::extent_m(&ink);
    let (width_m, height_m) = (right - left, bottom - top);
    let margin_m = MARGIN_SHARE * width_m.min(height_m);
    let (file, px_per_m) = (args.out.as_path(), f64::from(args.dpi) / 0.0254);
    let ends = |suffix: &str| file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(suffix));
    if ends("svg") {
        std::fs::write(file, svg(&ink, margin_m)).with_context(|| format!("{}: cannot write file", file.display()))?;
    } else if ends("png") {
        if width_m.max(height_m) * px_per_m > SIDE_MAX_PX {
            bail!("{} dpi: the image would be too large; use a lower --dpi, or write an .svg", args.dpi);
        }
        write_png(&draw(&ink, px_per_m, margin_m).image, px_per_m, file)
            .with_context(|| format!("{}: cannot write file", file.display()))?;
    } else {
        bail!("{}: unknown file extension; use .svg or .png", file.display());
    }
    super::tell(&format!(
        "wrote {}: {}, printed area {:.2} x {:.2} mm; print it without scaling, fix it to a flat plate, and measure the print: use the measured sizes for the calibration",
        file.display(),
        board.kind(),
        width_m * 1e3,
        height_m * 1e3
    ))?;
    Ok(ExitCode::SUCCESS)
}

/// Writes a PNG with its resolution in the pHYs chunk.
fn write_png(image: &image::GrayImage, px_per_m: f64, file: &Path) -> Result<()> {
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(file)?), image.width(), image.height());
    encoder.set_color(png::ColorType::Grayscale);
    let per_m = px_per_m.round() as u32;
    encoder.set_pixel_dims(Some(png::PixelDimensions { xppu: per_m, yppu: per_m, unit: png::Unit::Meter }));
    encoder.write_header()?.write_image_data(image.as_raw())?;
    Ok(())
}
