//! What a recording of a run has: its settings with their files, its begin, and its steps and pairs in the order in which they were
//! written.

use std::fs;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use image::RgbImage;
use pb3dp_bag::BagError;
use pb3dp_bag::matching::Waiting;
use pb3dp_bag::messages::LogLine;
use pb3dp_bag::pairs::{decoded, recorded_image};
use pb3dp_bag::reader::{Bag, Messages, RawMessage};
use pb3dp_bag::run_messages::{ControlStep, PairResult, RunBegin, SetupFile};
use pb3dp_bag::topics::ours;
use pb3dp_cell::spectator::RunEnd;
use pb3dp_geometry::{ImageSize, MonotonicTime};
use pb3dp_hal_api::FramePair;
use pb3dp_record::value_range::ValueRange;
use pb3dp_setup::layers::SetupArgs;
use tempfile::TempDir;

use crate::exact::end;
use crate::head::{self, Head};

/// Topics of a replay besides the head and the images.
const TOPICS: [&str; 4] = [ours::STEPS, ours::PAIRS, ours::EVENTS, ours::END];
/// A recorded run, read up to its first step.
pub struct RecordedRun {
    /// Version of the program that has recorded it.
    pub version: String,
    /// How it began.
    pub begin: RunBegin,
    /// Settings and files for [`Self::setup_args`].
    folder: TempDir,
    /// All settings with their origins, as a TOML file.
    pub setup_text: String,
    /// Steps and pairs.
    pub items: Items,
}

/// Steps and pairs of a run in the order in which they were written.
pub struct Items {
    begin: RunBegin,
    messages: Messages,
    /// A step or pair that was read with the head.
    ahead: Option<RawMessage>,
    images: Waiting<RawMessage>,
    drawn_on: [Option<(MonotonicTime, RawMessage)>; 2],
}

/// How the images of a run become those that its estimates had.
#[derive(Clone, Copy, Debug)]
pub struct DecodeOptions {
    /// Size of the calibration.
    pub size: ImageSize,
    /// The values that became black and white, for cameras with more than 8 bits.
    pub range: Option<ValueRange>,
}

/// The next part of a run.
pub enum Item {
    /// A control step.
    Step(Box<ControlStep>),
    /// An estimate.
    Pair(Box<RecordedPair>),
    /// A change of state.
    Event(LogLine),
    /// The end of the run.
    End(RunEnd),
}

/// An estimate with its images, if they are there.
pub struct RecordedPair {
    /// The estimate.
    pub result: PairResult,
    /// The images.
    pub images: Option<Arc<FramePair>>,
    /// An older pair on which the operator drew.
    pub drawn_on: Option<Arc<FramePair>>,
}

impl RecordedRun {
    /// Opens a recording; also one that was broken off.
    ///
    /// # Errors
    /// A file that is no recording of a run, or cannot be read.
    pub fn open(path: &Path, with_images: bool) -> Result<Self> {
        let bag = Bag::open(path)?;
        // With the images, the file is read as a whole and its check sums are verified.
        let mut messages = if with_images {
            Box::new(bag.messages())
        } else {
            bag.messages_on(&[&head::TOPICS[..], &TOPICS].concat())?
        };
        let mut head = Head::default();
        let ahead = loop {
            let Some(message) = messages.next().transpose()? else { break None };
            if !head.take(&message)? && TOPICS.contains(&message.channel.topic.as_str()) {
                break Some(message);
            }
        };
        let (setup_text, begin) = head.run(path)?;
        let folder = TempDir::with_prefix("pb3dp-replay-").context("no folder for the settings of the recording")?;
        write_settings(folder.path(), &setup_text, &head.files)?;
        let (images, drawn_on) = Default::default();
        let items = Items { begin: begin.clone(), messages, ahead, images, drawn_on };
        Ok(Self { version: head.version, begin, folder, setup_text, items })
    }

    /// The setup of the run with these changes.
    pub fn setup_args(&self, set: &[String]) -> SetupArgs {
        SetupArgs { set: set.to_vec(), ..SetupArgs::of_file(&self.folder.path().join(SETTINGS)) }
    }
}

impl Items {
    /// The next step or pair, its images decoded; none at the end.
    ///
    /// # Errors
    /// A damaged message.
    pub fn next_item(&mut self, how: DecodeOptions) -> Result<Option<Item>> {
        loop {
            let message = match self.ahead.take() {
                Some(message) => message,
                None => match self.messages.next().transpose()? {
                    Some(message) => message,
                    None => return Ok(None),
                },
            };
            let side = |topics: [&str; 2]| topics.iter().position(|topic| *topic == message.channel.topic);
            let images = side([ours::LEFT_IMAGE, ours::RIGHT_IMAGE]);
            let images = images.or_else(|| side([ours::LEFT_COMPRESSED, ours::RIGHT_COMPRESSED]));
            match (images, side(ours::DRAWN_ON), message.channel.topic.as_str()) {
                (Some(side), ..) => self.keep(side, message)?,
                (_, Some(side), _) => self.drawn_on[side] = Some((stamp(&message)?, message)),
                (.., ours::STEPS) => return Ok(Some(Item::Step(Box::new(decoded(&message)?)))),
                (.., ours::BEGIN) if decoded::<RunBegin>(&message)? != self.begin => {
                    bail!("several runs: name one recording, or a folder with the files of one divided recording")
                }
                (.., ours::EVENTS) => return Ok(Some(Item::Event(decoded(&message)?))),
                (.., ours::END) => return Ok(Some(Item::End(end(&decoded(&message)?)))),
                (.., ours::PAIRS) => return Ok(Some(Item::Pair(Box::new(self.pair(decoded(&message)?, how)?)))),
                _ => {}
            }
        }
    }

    fn keep(&mut self, side: usize, message: RawMessage) -> Result<()> {
        let (at, bytes) = (stamp(&message)?, message.data.len());
        self.images.push(side, at, (message, bytes));
        Ok(())
    }

    fn pair(&mut self, result: PairResult, how: DecodeOptions) -> Result<RecordedPair> {
        let skew_nanos = (result.skew_s * 1e9).round() as i64;
        let left_at = result.exposed_at_nanos.saturating_add(self.begin.since_1970_nanos);
        let right_at = left_at.saturating_add_signed(skew_nanos);
        let exposed_at = MonotonicTime::from_nanos(result.exposed_at_nanos);
        let images = take_at(&mut self.images, 0, left_at)
            .zip(take_at(&mut self.images, 1, right_at))
            .map(|(left, right)| pair([&left, &right], how, (result.sequence, exposed_at, skew_nanos)))
            .transpose()?;
        let drawn_sequence = result.chosen.first().and_then(|chosen| chosen.drawn_on.first());
        let drawn_on = match (self.drawn_on.each_mut().map(Option::take), drawn_sequence) {
            ([Some((at, left)), Some((_, right))], Some(sequence)) => {
                let at = MonotonicTime::from_nanos(at.as_nanos().saturating_sub(self.begin.since_1970_nanos));
                Some(pair([&left, &right], how, (*sequence, at, 0))?)
            }
            _ => None,
        };
        Ok(RecordedPair { result, images, drawn_on })
    }
}

/// Name of the settings in the folder of the recording.
const SETTINGS: &str = "settings.toml";

/// Writes settings, and the files that they name, with paths into the folder.
fn write_settings(folder: &Path, text: &str, files: &[SetupFile]) -> Result<()> {
    let mut text = text.to_owned();
    for (index, SetupFile { path, data }) in files.iter().enumerate() {
        let name = Path::new(path).file_name().unwrap_or_default().to_string_lossy();
        let own = folder.join(format!("{index}-{name}"));
        fs::write(&own, &data.0).with_context(|| format!("{} cannot be written", own.display()))?;
        let own = own.display();
        text = text.replace(&format!("\"{path}\""), &format!("\"{own}\""));
        text = text.replace(&format!("\"mask:{path}\""), &format!("\"mask:{own}\""));
    }
    let settings = folder.join(SETTINGS);
    fs::write(&settings, text).with_context(|| format!("{} cannot be written", settings.display()))
}

/// The middle of the exposure.
fn stamp(message: &RawMessage) -> Result<MonotonicTime> {
    Ok(pb3dp_bag::pairs::stamp(message)?)
}

/// The image of this time; images before it belong to no pair.
fn take_at(waiting: &mut Waiting<RawMessage>, side: usize, at_nanos: u64) -> Option<RawMessage> {
    // A stamp in seconds and nanoseconds is exact; a skew is rounded.
    let index = waiting.times(side).position(|at| at.as_nanos().abs_diff(at_nanos) <= 1)?;
    (0..index).for_each(|_| drop(waiting.pop(side)));
    waiting.pop(side).map(|(_, message)| message)
}

fn pair(
    images: [&RawMessage; 2],
    DecodeOptions { size, range }: DecodeOptions,
    (sequence, exposed_at, skew_nanos): (u64, MonotonicTime, i64),
) -> Result<Arc<FramePair>> {
    let [left, right]: [Result<(MonotonicTime, RgbImage), BagError>; 2] =
        images.map(|message| recorded_image(message, size, range));
    let (left, right) = (left?.1, right?.1);
    Ok(Arc::new(FramePair {
        sequence,
        exposed_at,
        skew_nanos,
        left,
        right,
        delivered: Default::default(),
        exposure: None,
    }))
}
