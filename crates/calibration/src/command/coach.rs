//! `pb3dp calibrate coach`: watches a recording while it is being made, and suggests the next view of the board.
//!
//! The suggestions appear in the terminal and optionally on a self-refreshing HTML page. The page is a plain file: a server would
//! need a network port, and a browser on the same machine can open a file.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use crate::board::Chessboard;
use crate::coach::{Advice, Farther, advice};
use crate::fit::{View, sides};
use crate::gates::Limits;
use crate::report::coverage_plots;
use crate::selection::{Candidate, Wanted, adds};
use crate::stand::{Judge, Stand};
use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_record::dataset::{Sequence, is_sequence, load_sequence};
use pb3dp_record::report::{Report, Table, Tone};
use pb3dp_record::stops::STOPS_FILE;

use super::recording::Recording;
use super::source::PairFiles;
use super::{gates_file, numbers, tell};

/// Polling interval, and how long to wait for new images.
const PAUSE: Duration = Duration::from_millis(150);
const PATIENCE_PAUSES: u32 = 400;
/// Views needed before the focal length is guessed; before that, the calibration of the recording is used.
const GUESS_FROM: usize = 4;
/// Refresh interval of the page, s.
const RELOAD_S: u32 = 1;

/// Arguments of `pb3dp calibrate coach`.
#[derive(Debug, Args)]
pub(super) struct CoachArgs {
    /// Folder that `pb3dp cameras record` writes to.
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Inner corners of the chessboard, for example 9x6.
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = numbers::corners)]
    board: [u32; 2],
    /// Side of a square, mm.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, allow_hyphen_values = true)]
    square: f64,
    /// Also write an HTML page that refreshes itself every second; open it in a browser.
    #[arg(long, value_name = "FILE.html")]
    page: Option<PathBuf>,
    /// Gate limits for the later calibration (copy configs/calibration_gates.toml).
    #[arg(long, value_name = "FILE")]
    gates: Option<PathBuf>,
}

/// Result of checking the newest pair.
#[derive(Clone, Debug, PartialEq)]
enum Look {
    NoBoard(String),
    Blurred,
    Moving,
    DetectedBefore,
    Unexplained,
    Taken,
}

impl Look {
    fn text(&self) -> String {
        match self {
            Self::NoBoard(reason) => reason.clone(),
            Self::Blurred => "blurred: hold the board still, add light, or focus the cameras".to_owned(),
            Self::Moving => "the board is moving: hold it still for a moment".to_owned(),
            Self::DetectedBefore => "similar to an earlier view".to_owned(),
            Self::Unexplained => "the corners fit no camera model: check that the board is flat".to_owned(),
            Self::Taken => "taken".to_owned(),
        }
    }
}

/// Measurements of the newest pair.
#[derive(Clone, Copy, Debug, Default)]
struct Now {
    blur_px: Option<f64>,
    speed_px_per_s: Option<f64>,
    tilt_deg: Option<f64>,
}

/// The views accepted so far.
struct Coach<'a> {
    board: &'a Chessboard,
    limits: Limits,
    args: &'a CoachArgs,
    views: Vec<View<2>>,
    last_hint: Option<(Look, usize)>,
}

/// Runs until there are enough views or the recording ends; ending with views missing is a failure.
pub(super) fn run(args: &CoachArgs) -> Result<ExitCode> {
    let [columns, rows] = args.board;
    let board = Chessboard::new(columns, rows, args.square * 1e-3)?;
    let limits = gates_file::read(args.gates.as_deref(), Limits::of_cameras())?;
    let mut coach = Coach { board: &board, limits, args, views: Vec::new(), last_hint: None };
    if args.folder.join(STOPS_FILE).exists() {
        bail!(
            "{}: this is a recording of arm stops, which is already complete; use it with pb3dp calibrate stereo --recording",
            args.folder.display()
        );
    }
    let (mut last, mut waited) = (None, 0);
    tell(&format!("{}: waiting for images; start `pb3dp cameras record --out {0}` now", args.folder.display()))?;
    loop {
        let sequence = newest(&args.folder);
        let frame = sequence.as_ref().ok().and_then(|sequence| sequence.frames().checked_sub(1));
        let (Ok(sequence), Some(frame)) = (sequence.as_ref(), frame.filter(|frame| last != Some(*frame))) else {
            let is_over = sequence.as_ref().is_ok_and(|sequence| !sequence.is_unfinished);
            if is_over && last.is_some() {
                return coach.ended();
            }
            waited += 1;
            if waited > PATIENCE_PAUSES {
                sequence.context("no new images arrive")?;
                bail!("{}: no new images arrive; start `pb3dp cameras record`", args.folder.display());
            }
            std::thread::sleep(PAUSE);
            continue;
        };
        (last, waited) = (Some(frame), 0);
        if coach.look(sequence, frame)? {
            return Ok(ExitCode::SUCCESS);
        }
        std::thread::sleep(PAUSE);
    }
}

/// Loads the part of the recording written so far; a recording that has just begun has no pair yet.
fn newest(folder: &Path) -> Result<Sequence> {
    if !is_sequence(folder) {
        bail!("{}: no recording in this folder; start `pb3dp cameras record --out` with this folder", folder.display());
    }
    Ok(load_sequence(folder)?)
}

impl Coach<'_> {
    /// Checks a pair and reports what is missing; returns whether there are enough views.
    fn look(&mut self, sequence: &Sequence, frame: u64) -> Result<bool> {
        let pairs = PairFiles::of_sequence(sequence);
        let recording = Recording::new(&pairs, self.board)?;
        let mut now = Now::default();
        let look = match recording.look(frame) {
            Err(reason) => Look::NoBoard(reason),
            Ok(candidate) => self.judged((sequence, &recording), frame, candidate, &mut now)?,
        };
        let size = recording.size;
        let stands = self.stands(sequence);
        let advice = advice(&stands, &self.limits);
        if self.last_hint.as_ref() != Some(&(look.clone(), self.views.len())) {
            tell(&self.line(&look, &advice))?;
            self.last_hint = Some((look.clone(), self.views.len()));
        }
        if let Some(file) = &self.args.page {
            let page = self.page(&look, &advice, &now).image_plots(&coverage_plots(&self.views, size));
            // Written to a temporary file and renamed, so that the browser never reads an incomplete page.
            let partial = file.with_extension("partial");
            page.write(&partial)?;
            std::fs::rename(&partial, file).with_context(|| format!("{}: cannot write file", file.display()))?;
        }
        Ok(advice.request.is_none())
    }

    /// Accepts a pair as a view if it is useful.
    fn judged(
        &mut self,
        (sequence, recording): (&Sequence, &Recording<'_>),
        frame: u64,
        candidate: Candidate<2>,
        now: &mut Now,
    ) -> Result<Look> {
        let wanted = Wanted::default();
        now.blur_px = candidate.blur_px;
        now.speed_px_per_s = recording.speed_px_per_s(frame, &candidate)?;
        let stand = self.judge(sequence).and_then(|judge| judge.stand(&candidate.view, self.board));
        let Some(stand) = stand else { return Ok(Look::Unexplained) };
        now.tilt_deg = Some(stand.tilt_angle_deg());
        if !adds(&stand, &self.stands(sequence), &wanted) {
            return Ok(Look::DetectedBefore);
        }
        if !now.speed_px_per_s.is_some_and(|speed| speed <= wanted.speed_max_px_per_s) {
            return Ok(Look::Moving);
        }
        if !now.blur_px.is_some_and(|blur| blur <= wanted.blur_max_px) {
            return Ok(Look::Blurred);
        }
        self.views.push(candidate.view);
        Ok(Look::Taken)
    }

    /// Creates the judge of board poses; at first from the calibration of the recording, which may be nominal.
    fn judge(&self, sequence: &Sequence) -> Option<Judge> {
        let size = sequence.load_calibration().ok().map(|calibration| *calibration.rig.left());
        let known = size.filter(|_| self.views.len() < GUESS_FROM);
        known.map(Judge::of_camera).or_else(|| Judge::new(&self.views, self.board, size?.size()))
    }

    fn stands(&self, sequence: &Sequence) -> Vec<Stand> {
        let judge = self.judge(sequence);
        judge.iter().flat_map(|judge| self.views.iter().filter_map(|view| judge.stand(view, self.board))).collect()
    }

    /// The instruction to the operator.
    fn next(&self, advice: &Advice) -> String {
        let [columns, rows] = self.args.board;
        match &advice.request {
            Some(request) => format!("next: {request}"),
            None => format!(
                "enough views: stop the recording and run pb3dp calibrate stereo --recording {} --board {columns}x{rows} --square {} --out calibration.toml --report calibration.html",
                self.args.folder.display(),
                self.args.square
            ),
        }
    }

    fn line(&self, look: &Look, advice: &Advice) -> String {
        let progress = &advice.progress;
        let so_far = format!("{} views, {:.0} % covered", progress.views, 100.0 * progress.coverage());
        format!("{so_far}: {}\n  {}", look.text(), self.next(advice))
    }

    fn page(&self, look: &Look, advice: &Advice, now: &Now) -> Report {
        let progress = &advice.progress;
        let number =
            |value: Option<f64>, unit: &str| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.1}{unit}"));
        let tone = match (&advice.request, look) {
            (None, _) | (_, Look::Taken) => Tone::Good,
            (_, Look::DetectedBefore) => Tone::Fair,
            _ => Tone::Bad,
        };
        let mut tilts = Table::new(["side farther away", "views"]);
        for (side, count) in Farther::ALL.into_iter().zip(progress.tilted) {
            tilts = tilts.row([side.name().to_owned(), count.to_string()]);
        }
        Report::new("Calibration coach")
            .reloading(RELOAD_S)
            .verdict(tone, &self.next(advice), &[format!("now: {}", look.text())])
            .figures(&[
                ("views", progress.views.to_string()),
                ("image coverage, worse camera", format!("{:.0} %", 100.0 * progress.coverage())),
                ("edge blur now", number(now.blur_px, " px")),
                ("motion now", number(now.speed_px_per_s, " px/s")),
                ("tilt now", number(now.tilt_deg, "\u{b0}")),
                ("close-up views", progress.near.to_string()),
            ])
            .table(&tilts)
            .heading(&format!("Corners detected so far, {} and {}", sides::<2>()[0], sides::<2>()[1]))
    }

    /// Reports that the recording ended before there were enough views.
    fn ended(&self) -> Result<ExitCode> {
        let views = self.views.len();
        tell(&format!(
            "the recording ended with {views} views, which are not enough; pb3dp calibrate stereo --recording checks all its pairs and may find more views"
        ))?;
        Ok(ExitCode::FAILURE)
    }
}
