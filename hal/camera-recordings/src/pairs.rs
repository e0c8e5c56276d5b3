//! The pairs of a recording, with or without a calibration.

use std::path::{Path, PathBuf};
use std::time::Duration;

use image::RgbImage;
use pb3dp_bag::BagError;
use pb3dp_bag::pairs::StereoBag;
use pb3dp_bag::segments::{CalibrationChange, Segment};
use pb3dp_camera_settings::ImageLayout;
use pb3dp_geometry::{ImageSize, MonotonicTime};
use pb3dp_hal_api::{CameraError, CameraErrorKind};
use pb3dp_record::dataset::Sequence;
use pb3dp_record::images::{ImageFileError, ImageProblem, StoredImage, check_size, size_of};
use pb3dp_record::value_range::ValueRange;

use crate::bag::{BagImages, BagTimes};
use crate::euroc;
use crate::folder::{image_pairs, images_with_both};
use crate::kind::{Kind, folder_of, no_recording, unusable_bag};
use crate::options::{PairsPerSecond, RecordingOptions, SkewMillis};
use crate::source::{Place, Source, TimedPairs, in_order};

/// Time between the pairs of recordings that state none.
pub const PERIOD: Duration = Duration::from_nanos(33_333_333);

/// Pairs whose images are tried for their size: the first ones may be damaged.
const SIZE_FROM_MAX: u64 = 20;

/// The pairs of a recording, in any order; quickest in their own.
#[derive(Debug)]
pub struct RecordedPairs {
    name: String,
    source: Source,
    has_times: bool,
    states_skew: bool,
    /// The images of pairs that are in an MCAP recording.
    bag: Option<BagImages>,
    /// The parts of an MCAP recording with one calibration, and the number of the one that was asked for.
    segments: Vec<Segment>,
    segment: Option<usize>,
    range: Option<ValueRange>,
    notes: Vec<String>,
    warnings: Vec<String>,
}

impl RecordedPairs {
    /// The pairs of a recording of any kind that is read; a calibration is not needed.
    ///
    /// # Errors
    /// Kind `Unusable` if the recording or its description cannot be used.
    pub fn open(path: &Path, asked: &RecordingOptions) -> Result<Self, CameraError> {
        let path = folder_of(path);
        Self::of(path, &Kind::of(path, asked)?, asked, PERIOD)
    }

    /// The pairs of a recording of this kind; `period` is the time between pairs if it states none.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn of(path: &Path, kind: &Kind, asked: &RecordingOptions, period: Duration) -> Result<Self, CameraError> {
        let period = asked.rate.map_or(period, PairsPerSecond::period);
        let mut pairs = Self::found(path, kind, asked, period)?;
        pairs.check_range()?;
        let without_rate = match kind {
            Kind::Case(_) => Some("is one pair"),
            _ => pairs.has_times.then_some("states the times of its pairs"),
        };
        if let (Some(PairsPerSecond(hz)), Some(why)) = (asked.rate, without_rate) {
            let message = format!("--rate {hz} has no effect: {} {why}; leave it out", pairs.name);
            return Err(CameraError::new(CameraErrorKind::Unusable, message));
        }
        if let Some(SkewMillis(millis)) = asked.skew {
            pairs.source.set_skew((millis * 1e6).round() as i64);
        }
        pairs.states_skew = asked.skew.is_some() || pairs.source.has_skew();
        Ok(pairs)
    }

    /// Refuses a range of values for files that have 8 bits.
    fn check_range(&self) -> Result<(), CameraError> {
        let file = match &self.source.pair(0).place {
            Place::Files(file, _) | Place::Both(file, _) if self.range.is_some() => file,
            _ => return Ok(()),
        };
        // A damaged one is reported where it is used.
        if StoredImage::load(file).is_ok_and(|image| !image.is_deep()) {
            let message = format!("--range has no effect: {} has 8 bits per channel; leave it out", file.display());
            return Err(CameraError::new(CameraErrorKind::Unusable, message));
        }
        Ok(())
    }

    fn found(path: &Path, kind: &Kind, asked: &RecordingOptions, period: Duration) -> Result<Self, CameraError> {
        let source = match kind {
            Kind::Sequence(sequence) => {
                let warnings = warnings_of(sequence);
                return Ok(Self { warnings, ..Self::new(path, Source::of_sequence(sequence, period), asked) });
            }
            Kind::Case(case) => Source::of_images(vec![Place::Files(case.left.clone(), case.right.clone())], period),
            Kind::Bag(bag) => return Self::of_bag(path, bag, asked, period),
            Kind::Euroc(cameras) => {
                let pairs = euroc::pairs(cameras, asked.pair_within)?;
                return Self::timed(path, &cameras[0].display().to_string(), pairs, asked, period);
            }
            Kind::Images => {
                let places = match asked.layout {
                    Some(layout) => images_with_both(path)?.into_iter().map(|file| Place::Both(file, layout)).collect(),
                    None => {
                        let pairs = image_pairs(path).map_err(|error| no_recording(path, error))?;
                        pairs.into_iter().map(|(left, right)| Place::Files(left, right)).collect()
                    }
                };
                Source::of_images(places, period)
            }
        };
        Ok(Self { has_times: false, ..Self::new(path, source, asked) })
    }

    fn new(path: &Path, source: Source, asked: &RecordingOptions) -> Self {
        let (notes, warnings) = (Vec::new(), Vec::new());
        let name = format!("replay {}", path.display());
        Self {
            name,
            source,
            has_times: true,
            states_skew: false,
            bag: None,
            segments: Vec::new(),
            segment: None,
            range: asked.range,
            notes,
            warnings,
        }
    }

    fn of_bag(path: &Path, bag: &StereoBag, asked: &RecordingOptions, period: Duration) -> Result<Self, CameraError> {
        let BagTimes { times, left_out, segments } =
            BagImages::times(bag).map_err(|error| unusable_bag(path, error))?;
        let [left, right] = bag.topics().clone().map(|topic| topic.name);
        let notes = vec![format!("images: {left} and {right}")];
        let mut warnings = Vec::new();
        if bag.bag().is_unfinished() {
            warnings.push(format!(
                "the recording was broken off: it has no end; its {} pairs until the last whole one are used",
                times.len()
            ));
        }
        if times.is_empty() {
            let (file, within_ms) = (path.to_path_buf(), asked.pair_within.as_secs_f64() * 1e3);
            return Err(unusable_bag(path, BagError::NoPairs { file, left, right, within_ms, left_out }));
        }
        let pairs = (0..).zip(times).map(|(number, (at, skew_nanos))| (Place::Bag(number), at, skew_nanos)).collect();
        let mut found = Self::timed(path, &bag.topics()[0].name, TimedPairs { pairs, left_out }, asked, period)?;
        found.bag = Some(BagImages::new(bag.clone()));
        (found.segments, found.segment) = (segments, bag.segment());
        found.notes.splice(0..0, notes);
        found.warnings.splice(0..0, warnings);
        Ok(found)
    }

    /// `left`: whose times they are.
    fn timed(
        path: &Path,
        left: &str,
        TimedPairs { pairs, left_out }: TimedPairs,
        asked: &RecordingOptions,
        period: Duration,
    ) -> Result<Self, CameraError> {
        let within_ms = asked.pair_within.as_secs_f64() * 1e3;
        if pairs.is_empty() {
            let message = format!(
                "cannot replay {}: no left image has a right one within {within_ms} ms; state a longer time with --pair-within, or check the clocks of the cameras",
                path.display()
            );
            return Err(CameraError::new(CameraErrorKind::Unusable, message));
        }
        let mut warnings = Vec::from_iter(left_out.warning(within_ms));
        let times: Vec<MonotonicTime> = pairs.iter().map(|(_, at, _)| *at).collect();
        if times.len() > 1 && times.iter().all(|at| *at == times[0]) {
            warnings.push(format!(
                "all pairs have the same time, {:.6} s in {left}: a pair every {:.1} ms is assumed",
                times[0].as_secs_f64(),
                period.as_secs_f64() * 1e3
            ));
            let places = pairs.into_iter().map(|(place, ..)| place).collect();
            return Ok(Self {
                warnings,
                has_times: false,
                ..Self::new(path, Source::of_images(places, period), asked)
            });
        }
        let kept = in_order(&times);
        let is_kept = |number: &usize| kept.binary_search(number).is_ok();
        if let Some(wrong) = (0..times.len()).find(|number| !is_kept(number)) {
            let beside = if wrong > 0 { wrong - 1 } else { 1 };
            warnings.push(format!(
                "pairs left out, because their times go back, repeat or jump: {} (the first is pair {wrong} of the recording: {:.6} s {} {:.6} s in {left})",
                times.len() - kept.len(),
                times[wrong].as_secs_f64(),
                if wrong > 0 { "after" } else { "before" },
                times[beside].as_secs_f64()
            ));
        }
        let pairs = pairs.into_iter().enumerate().filter(|(number, _)| is_kept(number)).map(|(_, pair)| pair);
        Ok(Self { warnings, ..Self::new(path, Source::of_times(pairs.collect(), period), asked) })
    }

    /// The same without the pairs before a time; none is left out if all are before it.
    #[must_use]
    pub fn since(self, from: MonotonicTime, period: Duration) -> Self {
        let (source, left_out) = self.source.since(from, period);
        let mut notes = self.notes;
        if left_out > 0 {
            notes.push(format!("the first {left_out} pairs are left out: the target was marked after them"));
        }
        Self { source, notes, ..self }
    }

    /// The pairs of one segment, whose calibration is that of the recording: the one that was asked for, or the first one. If the user gives a
    /// calibration, only one that was asked for.
    ///
    /// # Errors
    /// Kind `Unusable` if it has no pair, or the first one does not begin with the calibration of the recording.
    pub fn with_one_calibration(mut self, is_given: bool) -> Result<Self, CameraError> {
        let (asked, is_alone) =
            (self.segment, self.segments.len() < 2 && self.segments.iter().all(|one| one.change.is_none()));
        if asked.is_none() && (is_given || is_alone) {
            return Ok(self);
        }
        let number = asked.unwrap_or(1);
        let refuse = |why: String| Err(CameraError::new(CameraErrorKind::Unusable, format!("{}: {why}", self.name)));
        let rest = "--calib with a calibration of all pairs";
        let Some(segment) = number.checked_sub(1).and_then(|index| self.segments.get(index)) else {
            return refuse(format!("--segment {number} does not exist: there are {}", self.segments.len()));
        };
        if let (None, Some(change)) = (asked, &segment.change) {
            return refuse(format!(
                "{}, before its first pair: state --segment 1 for the calibration of that pair, or give {rest}",
                changes(segment, change)
            ));
        }
        let next = self.segments.get(number);
        let numbers = segment.first..next.map_or(u64::MAX, |next| next.first);
        let Some(source) = self.source.with_numbers(numbers, self.period().unwrap_or(PERIOD)) else {
            return refuse(format!("segment {number} has no pair that can be used"));
        };
        if let Some((next, change)) =
            next.and_then(|next| Some((next, next.change.as_ref()?))).filter(|_| asked.is_none())
        {
            self.warnings.push(format!(
                "the recording ends where {}: {} pairs are used, and {} are not; these need --segment 2{}, or {rest}",
                changes(next, change),
                source.pairs(),
                self.source.pairs() - source.pairs(),
                if self.segments.len() > 2 { format!(" to {}", self.segments.len()) } else { String::new() }
            ));
        }
        Ok(Self { source, ..self })
    }

    /// Name for messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of pairs, good or bad.
    pub fn count(&self) -> u64 {
        self.source.pairs()
    }

    /// Middle of the left exposure of each pair, seconds on the clock of the recording.
    pub fn times_s(&self) -> Vec<f64> {
        self.source.times_s()
    }

    /// Time between pairs, if it is constant (to a fifth).
    pub fn period(&self) -> Option<Duration> {
        self.source.period()
    }

    /// Time of the first pair on the clock of the recording; zero if it was negative.
    pub fn first_at(&self) -> MonotonicTime {
        self.source.first_at()
    }

    /// Time from the very first pair to the one at a position that counts over all rounds.
    pub fn since_start(&self, position: u64) -> Duration {
        self.source.since_start(position)
    }

    /// Middle of the right exposure minus middle of the left one, nanoseconds, of the pair at a position that counts over all rounds.
    pub fn skew_nanos(&self, position: u64) -> i64 {
        self.source.pair(position).skew_nanos
    }

    /// Middle of the left exposure of a pair on the clock of the recording.
    pub fn exposed_at(&self, number: u64) -> MonotonicTime {
        self.source.first_at() + self.source.pair(number).since_first
    }

    /// Whether the recording states when its pairs were taken.
    pub fn has_times(&self) -> bool {
        self.has_times
    }

    /// Whether the time between the exposures of a pair is known: stated, or by different times of both images.
    pub fn states_skew(&self) -> bool {
        self.states_skew
    }

    /// The left and the right image file of each pair, if all images are in files of their own with 8 bits.
    pub fn files(&self) -> Option<Vec<[PathBuf; 2]>> {
        let file = |number| match &self.source.pair(number).place {
            Place::Files(left, right) => Some([left.clone(), right.clone()]),
            Place::Both(..) | Place::Bag(_) => None,
        };
        let files: Vec<_> = (0..self.count()).map(file).collect::<Option<_>>()?;
        // Damaged ones are reported where they are used.
        let is_deep =
            files.iter().flatten().find_map(|file| StoredImage::load(file).ok()).is_some_and(|image| image.is_deep());
        (!is_deep).then_some(files)
    }

    /// Size of the left images: that of the first one that can be read.
    pub fn image_size(&mut self) -> Option<ImageSize> {
        let bag = &mut self.bag;
        let source = &self.source;
        let size = |number| match &source.pair(number).place {
            Place::Files(left, _) => StoredImage::load(left).ok().map(|image| image.size()),
            Place::Both(file, layout) => StoredImage::load(file).ok().map(|image| layout.half(image.size())),
            Place::Bag(in_recording) => {
                let (images, _) = bag.as_mut()?.images(*in_recording).ok()?;
                Some(size_of(&images[0]))
            }
        };
        (0..source.pairs().min(SIZE_FROM_MAX)).find_map(size)
    }

    /// The images of the pair with this number, from 0. `expected` is the size that they must have, with what requires it.
    ///
    /// # Errors
    /// Kind `BadPair` with the file and what is wrong with it; kind `Unusable` if the first pair has another size.
    pub fn images(&mut self, number: u64, expected: Option<(ImageSize, &str)>) -> Result<[RgbImage; 2], CameraError> {
        let name = &self.name;
        let bad_pair = |error: ImageFileError| {
            // A calibration of another size suits no pair.
            let (kind, what) = match (number, &error.problem) {
                (0, ImageProblem::Size { .. }) => (CameraErrorKind::Unusable, "the recording is not used".to_owned()),
                _ => (CameraErrorKind::BadPair, format!("pair {number} is skipped: {}", error.file.display())),
            };
            CameraError::caused_by(kind, format!("{name}: {what}"), error)
        };
        let (images, notes) = match &self.source.pair(number).place {
            Place::Files(left, right) => {
                let load = |file| loaded(file, expected).map_err(bad_pair);
                let (images, note) = StoredImage::to_rgb_pair([load(left)?, load(right)?], &mut self.range);
                (images, Vec::from_iter(note))
            }
            Place::Both(file, layout) => {
                let both = StoredImage::load(file).and_then(|both| halves(file, both, *layout, expected));
                let (images, note) = StoredImage::to_rgb_pair(both.map_err(bad_pair)?, &mut self.range);
                (images, Vec::from_iter(note))
            }
            Place::Bag(in_recording) => {
                let bag = self.bag.as_mut().ok_or_else(|| {
                    CameraError::new(CameraErrorKind::Unusable, "replay: bug: a recording without its file, report it")
                })?;
                bag.images(*in_recording).map_err(|error| {
                    let message = format!("{name}: pair {number} is skipped");
                    CameraError::caused_by(CameraErrorKind::BadPair, message, error)
                })?
            }
        };
        self.notes.extend(notes);
        for image in &images {
            let (size, Some((wanted, because_of))) = (image.dimensions(), expected) else { continue };
            if size != (wanted.width, wanted.height) {
                // The images of a topic have one size; files may be mixed.
                let (kind, what) = match number == 0 && self.bag.is_some() {
                    true => (CameraErrorKind::Unusable, "the recording is not used".to_owned()),
                    false => (CameraErrorKind::BadPair, format!("pair {number} is skipped")),
                };
                let message = format!(
                    "{}: {what}: an image has {}x{} pixels, but {because_of} has {}x{}; use the calibration of this size",
                    self.name, size.0, size.1, wanted.width, wanted.height
                );
                return Err(CameraError::new(kind, message));
            }
        }
        Ok(images)
    }

    /// What the user should know since the last call.
    pub fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }

    /// What is missing or not as it should be, since the last call.
    pub fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }
}

fn changes(segment: &Segment, CalibrationChange { topic, at }: &CalibrationChange) -> String {
    format!("the calibration changes at pair {} ({topic}, {:.6} s)", segment.first, at.as_secs_f64())
}

fn warnings_of(sequence: &Sequence) -> Vec<String> {
    let mut warnings = Vec::new();
    if sequence.is_unfinished {
        warnings.push(format!(
            "the recording was broken off: it has no sequence.json; its {} frames until the last whole one are used",
            sequence.frames()
        ));
    }
    if !sequence.other_keys.is_empty() {
        warnings.push(format!(
            "sequence.json has keys that are not known and not used: {}",
            sequence.other_keys.join(", ")
        ));
    }
    warnings
}

fn loaded(file: &Path, expected: Option<(ImageSize, &str)>) -> Result<StoredImage, ImageFileError> {
    let image = StoredImage::load(file)?;
    expected.map_or(Ok(()), |expected| check_size(file, image.size(), expected))?;
    Ok(image)
}

/// Both views of an image.
fn halves(
    file: &Path,
    both: StoredImage,
    layout: ImageLayout,
    expected: Option<(ImageSize, &str)>,
) -> Result<[StoredImage; 2], ImageFileError> {
    let half = expected.map_or_else(|| layout.half(both.size()), |(size, _)| size);
    let because_of = match expected {
        Some((_, because_of)) => format!("a pair of {because_of}"),
        None => "two views of the same size".to_owned(),
    };
    check_size(file, both.size(), (layout.whole(half), &because_of))?;
    Ok(layout.origins(half).map(|origin| both.part(origin, half)))
}
