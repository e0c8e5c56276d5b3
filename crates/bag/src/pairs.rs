//! The stereo pairs of a recording, with their calibration.

use std::path::Path;
use std::time::Duration;

use image::RgbImage;
use pb3dp_camera_settings::PixelFormat;
use pb3dp_geometry::{ImageSize, MonotonicTime};
use pb3dp_record::calibration_files::{StatedCalibration, StereoCalibration, parse_ros_pair, parse_stereo};
use pb3dp_record::images::{StoredImage, size_in_header};
use pb3dp_record::value_range::{ValueRange, range_of_pair};

use crate::BagError;
use crate::cdr::{CdrValue, from_bytes};
use crate::matching::{LeftOut, Matching};
use crate::messages::{CameraInfo, CompressedImage, Header, Image, Point32, PolygonStamped, RegionOfInterest, Text};
use crate::pixels::{Pixels, converted, pixels};
use crate::reader::{Bag, RawMessage};
use crate::segments::{CalibrationChange, CameraInfos, PairTimes, Segment};
use crate::topics::{Topic, find_pair, ours};

/// Longest time between the images of a pair by default: cameras with a common trigger are within it.
pub const PAIR_WITHIN: Duration = Duration::from_millis(3);
/// Messages that are read at most in search of the calibration, if there is no message of it at the begin.
const SEARCHED_MAX: usize = 20_000;

/// Images that are read at most in search of one that is not damaged.
const DAMAGED_MAX: usize = 64;

/// How the pairs of a recording are found.
#[derive(Clone, Debug)]
pub struct PairOptions {
    /// Topics of the left and the right images; by their names if absent.
    pub topics: Option<[String; 2]>,
    /// Longest time between the exposures of a pair.
    pub within: Duration,
    /// Values of images with more than 8 bits that become black and white; measured on the first pair if absent.
    pub range: Option<ValueRange>,
    /// Which of the [segments](StereoBag::segments) [`StereoBag::calibration`] reads, from 1 on; the first one if absent.
    pub segment: Option<usize>,
}

impl Default for PairOptions {
    fn default() -> Self {
        Self { topics: None, within: PAIR_WITHIN, range: None, segment: None }
    }
}

/// A recording with the two topics that have its images.
#[derive(Clone, Debug)]
pub struct StereoBag {
    bag: Bag,
    topics: [Topic; 2],
    options: PairOptions,
}

/// A stereo pair.
#[derive(Debug)]
pub struct BagPair {
    /// Middle of the left exposure, on the clock of the recording.
    pub exposed_at: MonotonicTime,
    /// Middle of the right exposure minus middle of the left one, nanoseconds.
    pub skew_nanos: i64,
    /// The images, or why they cannot be used.
    pub images: Result<[RgbImage; 2], BagError>,
}

/// A region that an operator marked.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkedRegion {
    /// Its corners in the left image, pixels.
    pub corners_px: Vec<[f64; 2]>,
    /// Mid-exposure of that image.
    pub at: MonotonicTime,
}

/// The pairs in the order of their times.
pub struct BagPairs {
    messages: Box<dyn Iterator<Item = Result<RawMessage, BagError>> + Send>,
    topics: [Topic; 2],
    infos: [CameraInfos; 2],
    range: Option<ValueRange>,
    matching: Matching<RawMessage>,
    notes: Vec<String>,
    is_over: bool,
}

struct Stamped {
    at: MonotonicTime,
    message: RawMessage,
}

impl StereoBag {
    /// Opens a recording and finds the topics of its images.
    ///
    /// # Errors
    /// As [`Bag::open`], and topics that are not clear or have no images.
    pub fn open(path: &Path, options: PairOptions) -> Result<Self, BagError> {
        let bag = Bag::open(path)?;
        let with_images: Vec<&str> =
            bag.topics().iter().filter(|topic| topic.has_images()).map(|topic| topic.name.as_str()).collect();
        let known = if with_images.is_empty() { "none".to_owned() } else { with_images.join(", ") };
        let refuse = |why| BagError::Topics { file: path.to_path_buf(), why, known: known.clone() };
        let topics = match &options.topics {
            None => find_pair(bag.topics()).map_err(refuse)?.map(Topic::clone),
            Some(names) => {
                let named = |name: &String| {
                    let found = bag.topics().iter().find(|topic| topic.name == *name && topic.has_images());
                    found.cloned().ok_or_else(|| refuse(format!("{name} is no topic with images")))
                };
                [named(&names[0])?, named(&names[1])?]
            }
        };
        Ok(Self { bag, topics, options })
    }

    /// The recording.
    pub fn bag(&self) -> &Bag {
        &self.bag
    }

    /// Topics of the left and the right images.
    pub fn topics(&self) -> &[Topic; 2] {
        &self.topics
    }

    /// The number of pairs, at most.
    pub fn pairs_max(&self) -> u64 {
        self.topics[0].messages.min(self.topics[1].messages)
    }

    /// Number of the segment that was asked for.
    pub fn segment(&self) -> Option<usize> {
        self.options.segment
    }

    /// The calibration in the recording, as the user states it: that of a run of this program, or the two `camera_info` beside the images.
    ///
    /// # Errors
    /// If there is none, or it cannot be used, and a segment that does not exist.
    pub fn calibration(&self, stated: &StatedCalibration) -> Result<StereoCalibration, BagError> {
        let file = self.bag.path();
        let missing = |why: String| BagError::NoCalibration { file: file.to_path_buf(), why };
        let names = self.topics.each_ref().map(Topic::camera_info);
        let has = |name: &str| self.bag.topics().iter().any(|topic| topic.name == name);
        let absent: Vec<&str> = names.iter().map(String::as_str).filter(|name| !has(name)).collect();
        if !has(ours::CALIBRATION) && !absent.is_empty() {
            return Err(missing(format!("no topic {}", absent.join(" and "))));
        }
        if let Some(number) = self.options.segment {
            let infos = self.infos_of_segment(number)?;
            return self.of_camera_infos(infos.each_ref(), stated);
        }
        let mut found: [Option<CameraInfo>; 2] = [None, None];
        for message in self.bag.messages().take(SEARCHED_MAX) {
            let message = message?;
            let topic = &message.channel.topic;
            if topic == ours::CALIBRATION {
                let Text { data } = decoded(&message)?;
                let name = file.join("calib.json");
                return parse_stereo(&name, &data, None)
                    .and_then(|calibration| calibration.as_stated(stated, stated.size))
                    .map_err(|source| BagError::Calibration { file: file.to_path_buf(), source });
            }
            for (name, found) in names.iter().zip(&mut found) {
                if topic == name && found.is_none() {
                    *found = Some(decoded(&message)?);
                }
            }
            if let [Some(left), Some(right)] = &found {
                return self.of_camera_infos([left, right], stated);
            }
        }
        let lacking = names.iter().zip(&found).filter(|(_, found)| found.is_none()).map(|(name, _)| name.as_str());
        Err(missing(format!("no message of {}", lacking.collect::<Vec<_>>().join(" and "))))
    }

    fn of_camera_infos(
        &self,
        infos: [&CameraInfo; 2],
        stated: &StatedCalibration,
    ) -> Result<StereoCalibration, BagError> {
        let file = self.bag.path().to_path_buf();
        if infos.iter().any(|info| info.k[0] == 0.0) {
            let why = "its camera_info has no camera matrix: the cameras are not calibrated".to_owned();
            return Err(BagError::NoCalibration { file, why });
        }
        let names = self.topics.each_ref().map(|topic| file.join(topic.camera_info().trim_start_matches('/')));
        let texts =
            [0, 1].map(|side| camera_info_text(infos[side], stated.rectified || self.topics[side].is_rectified()));
        let images = self.image_size()?;
        let parsed = parse_ros_pair([&names[0], &names[1]], [&texts[0], &texts[1]], stated.size.or(images));
        parsed
            .and_then(|calibration| calibration.as_stated(stated, images))
            .map_err(|source| BagError::Calibration { file, source })
    }

    /// The segments of the recording: one, unless its `camera_info` changes. Empty without a pair.
    ///
    /// # Errors
    /// If the recording is damaged.
    pub fn segments(&self) -> Result<Vec<Segment>, BagError> {
        let mut pairs = self.pairs();
        let times = pairs.skip_all()?;
        Ok(pairs.segments(&times))
    }

    /// The `camera_info` of both cameras at the first pair of a segment, counted from 1 on.
    fn infos_of_segment(&self, number: usize) -> Result<[CameraInfo; 2], BagError> {
        let segments = self.segments()?;
        let file = || self.bag().path().to_path_buf();
        let Some(segment) = segments.get(number.wrapping_sub(1)) else {
            return Err(BagError::NoSegment { file: file(), asked: number, segments: segments.len() });
        };
        let names = self.topics().each_ref().map(Topic::camera_info);
        let until = of_both(segment.times);
        let mut found: [Option<(MonotonicTime, CameraInfo)>; 2] = [None, None];
        for message in self.bag().messages_on(&names.each_ref().map(String::as_str))? {
            let message = message?;
            let Some(side) = names.iter().position(|name| *name == message.channel.topic) else { continue };
            // A damaged one is none.
            let (Ok(at), Ok(info)) = (stamp(&message), decoded(&message)) else { continue };
            if at <= until[side] && found[side].as_ref().is_none_or(|(newest, _)| *newest <= at) {
                found[side] = Some((at, info));
            }
        }
        let missing = || BagError::NoCalibration { file: file(), why: format!("none before segment {number}") };
        let [left, right] = found.map(|found| found.map(|(_, info)| info).ok_or_else(missing));
        Ok([left?, right?])
    }

    /// Size of the left images: that of the first one that can be read.
    fn image_size(&self) -> Result<Option<ImageSize>, BagError> {
        for message in self.bag.messages_on(&[&self.topics[0].name])?.take(DAMAGED_MAX) {
            let message = message?;
            let size = match is_compressed(&message) {
                true => decoded::<CompressedImage>(&message).ok().and_then(|image| size_in_header(&image.data.0)),
                false => decoded::<Image>(&message).ok().map(|Image { width, height, .. }| ImageSize { width, height }),
            };
            if size.is_some() {
                return Ok(size);
            }
        }
        Ok(None)
    }

    /// The first region that an operator marked in a run of this program.
    ///
    /// # Errors
    /// If the recording is damaged.
    pub fn region(&self) -> Result<Option<MarkedRegion>, BagError> {
        if !self.bag.topics().iter().any(|topic| topic.name == ours::REGION) {
            return Ok(None);
        }
        for message in self.bag.messages() {
            let message = message?;
            if message.channel.topic == ours::REGION {
                let region: PolygonStamped = decoded(&message)?;
                let corner = |point: &Point32| [f64::from(point.x), f64::from(point.y)];
                let corners_px = region.polygon.points.iter().map(corner).collect();
                return Ok(Some(MarkedRegion { corners_px, at: region.header.stamp.monotonic() }));
            }
        }
        Ok(None)
    }

    /// All pairs.
    pub fn pairs(&self) -> BagPairs {
        let is_ours = self.bag.topics().iter().any(|topic| topic.name == ours::CALIBRATION);
        let infos = |topic: &Topic| CameraInfos::of((!is_ours).then(|| topic.camera_info()));
        BagPairs {
            messages: Box::new(self.bag.messages()),
            infos: self.topics.each_ref().map(infos),
            topics: self.topics.clone(),
            range: self.options.range,
            matching: Matching::new(self.options.within),
            notes: Vec::new(),
            is_over: false,
        }
    }
}

impl BagPairs {
    /// Images without a partner so far.
    pub fn left_out(&self) -> LeftOut {
        self.matching.left_out()
    }

    /// The segments of all pairs, which have these times.
    pub fn segments(&self, times: &[PairTimes]) -> Vec<Segment> {
        let before = std::iter::once(None).chain(times.iter().copied().map(Some));
        let begin = |((first, times), before): ((u64, &PairTimes), Option<PairTimes>)| {
            let change = self.change_between(before, *times);
            (first == 0 || change.is_some()).then_some(Segment { first, times: *times, change })
        };
        (0..).zip(times).zip(before).filter_map(begin).collect()
    }

    /// The first change of the calibration so far that holds for a pair of these times, and for the one before it did not.
    fn change_between(&self, before: Option<PairTimes>, now: PairTimes) -> Option<CalibrationChange> {
        let [from, to] = [before.map(of_both), Some(of_both(now))];
        let changes = (0..2).filter_map(|side| self.infos[side].change_between(from.map(|from| from[side]), to?[side]));
        changes.min_by_key(|change| change.at)
    }

    /// What the user should know since the last call.
    pub fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }

    /// The times of the next pair, whose images are not converted: middle of the left exposure, and skew in nanoseconds. `None` at the end.
    ///
    /// # Errors
    /// If the recording is damaged.
    pub fn skip_pair(&mut self) -> Result<Option<PairTimes>, BagError> {
        self.next_match().map(|found| found.map(|found| times(&found))).transpose()
    }

    /// The times of all pairs that follow.
    ///
    /// # Errors
    /// If the recording is damaged.
    pub fn skip_all(&mut self) -> Result<Vec<PairTimes>, BagError> {
        std::iter::from_fn(|| self.skip_pair().transpose()).collect()
    }

    /// The next pair, without conversion of its images; the messages of its left and right image.
    fn next_match(&mut self) -> Option<Result<[Stamped; 2], BagError>> {
        loop {
            if let Some(found) = self.matching.next_pair() {
                return Some(Ok(found.map(|(at, message)| Stamped { at, message })));
            }
            let message = match self.messages.next() {
                Some(Ok(message)) => message,
                Some(Err(error)) => return Some(Err(error)),
                None if self.matching.is_complete() => return None,
                None => {
                    self.matching.complete();
                    continue;
                }
            };
            let topic = &message.channel.topic;
            if let Some(infos) = self.infos.iter_mut().find(|infos| infos.topic.as_ref() == Some(topic)) {
                // A damaged one is no change.
                if let (Ok(info), Ok(at)) = (decoded(&message), stamp(&message)) {
                    infos.take(info, at);
                }
                continue;
            }
            let Some(side) = self.topics.iter().position(|images| images.name == *topic) else { continue };
            match stamp(&message) {
                Ok(at) => {
                    let bytes = message.data.len();
                    self.matching.push(side, at, (message, bytes));
                }
                Err(error) => return Some(Err(error)),
            }
        }
    }

    fn images(&mut self, found: &[Stamped; 2]) -> Result<[RgbImage; 2], BagError> {
        let [left, right] = [pixels_of(&found[0])?, pixels_of(&found[1])?];
        let deep: Vec<_> = [&left, &right].into_iter().filter_map(Pixels::deep).collect();
        let (range, note) = range_of_pair(&mut self.range, &deep);
        self.notes.extend(note);
        let refuse = |stamped: &Stamped| {
            let (topic, stamp_s) = (stamped.message.channel.topic.clone(), stamped.at.as_secs_f64());
            move |why| BagError::Pixels { topic, stamp_s, why }
        };
        Ok([left.into_rgb(range).map_err(refuse(&found[0]))?, right.into_rgb(range).map_err(refuse(&found[1]))?])
    }
}

impl Iterator for BagPairs {
    type Item = Result<BagPair, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.is_over {
            return None;
        }
        let found = match self.next_match() {
            Some(Ok(found)) => found,
            Some(Err(error)) => {
                self.is_over = true;
                return Some(Err(error));
            }
            None => {
                self.is_over = true;
                return None;
            }
        };
        let (exposed_at, skew_nanos) = times(&found);
        let images = self.images(&found);
        Some(Ok(BagPair { exposed_at, skew_nanos, images }))
    }
}

/// Middle of the left and of the right exposure.
fn of_both((left_at, skew_nanos): PairTimes) -> [MonotonicTime; 2] {
    [left_at, MonotonicTime::from_nanos(left_at.as_nanos().saturating_add_signed(skew_nanos))]
}

fn times([left, right]: &[Stamped; 2]) -> PairTimes {
    (left.at, right.at.as_nanos() as i64 - left.at.as_nanos() as i64)
}

/// The image of a message that this program has recorded, and the middle of its exposure; a JPEG is decoded as from the camera.
/// `range`: the values that became black and white in images with more than 8 bits; all 16-bit values by default.
///
/// # Errors
/// What is wrong with it.
pub fn recorded_image(
    message: &RawMessage,
    size: ImageSize,
    range: Option<ValueRange>,
) -> Result<(MonotonicTime, RgbImage), BagError> {
    let at = stamp(message)?;
    let (topic, stamp_s) = (message.channel.topic.clone(), at.as_secs_f64());
    let read = if is_compressed(message) {
        let CompressedImage { data, .. } = decoded(message)?;
        converted(PixelFormat::Mjpg, size, 0, &data.0)
    } else {
        pixels(&decoded::<Image>(message)?).and_then(|pixels| pixels.into_rgb(range.unwrap_or(ValueRange::FULL)))
    };
    read.map(|image| (at, image)).map_err(|why| BagError::Pixels { topic, stamp_s, why })
}

fn is_compressed(message: &RawMessage) -> bool {
    message.channel.schema.as_ref().is_some_and(|schema| schema.name.ends_with("/CompressedImage"))
}

/// The content of a message.
///
/// # Errors
/// If it is not such a message.
pub fn decoded<T: CdrValue>(message: &RawMessage) -> Result<T, BagError> {
    from_bytes(&message.data).map_err(|why| BagError::Message {
        topic: message.channel.topic.clone(),
        stamp_s: message.log_nanos as f64 * 1e-9,
        why,
    })
}

/// The time in the header of an image; that of writing if the header has none.
pub fn stamp(message: &RawMessage) -> Result<MonotonicTime, BagError> {
    let Header { stamp, .. } = decoded(message)?;
    Ok(match stamp.nanos() {
        0 => MonotonicTime::from_nanos(message.log_nanos),
        _ => stamp.monotonic(),
    })
}

fn pixels_of(Stamped { at, message }: &Stamped) -> Result<Pixels, BagError> {
    let (topic, stamp_s) = (&message.channel.topic, at.as_secs_f64());
    if is_compressed(message) {
        let image: CompressedImage = decoded(message)?;
        let stored = StoredImage::parse(Path::new(topic), &image.data.0);
        return stored.map(Pixels::Ready).map_err(|source| BagError::Image { topic: topic.clone(), stamp_s, source });
    }
    let image: Image = decoded(message)?;
    pixels(&image).map_err(|why| BagError::Pixels { topic: topic.clone(), stamp_s, why })
}

/// A message as the text of a `camera_info` file of ROS. Rectified images have the rectified camera, and neither distortion nor rotation.
fn camera_info_text(info: &CameraInfo, is_rectified: bool) -> String {
    let list = |values: &[f64]| values.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(", ");
    let matrix = |key: &str, rows: usize, columns: usize, values: &[f64]| {
        format!("{key}:\n  rows: {rows}\n  cols: {columns}\n  data: [{}]\n", list(values))
    };
    let p = &info.p;
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let (k, r) = match is_rectified {
        true => ([p[0], p[1], p[2], p[4], p[5], p[6], p[8], p[9], p[10]], identity),
        false => (info.k, info.r),
    };
    let (model, d) = match (is_rectified || info.d.is_empty(), info.distortion_model.as_str()) {
        (true, _) => ("plumb_bob", &[0.0; 5][..]),
        // The older name of ROS.
        (false, "fisheye") => ("equidistant", &info.d[..]),
        (false, model) => (model, &info.d[..]),
    };
    let mut text = format!("image_width: {}\nimage_height: {}\n", info.width, info.height);
    text += &format!("binning_x: {}\nbinning_y: {}\n", info.binning_x, info.binning_y);
    let RegionOfInterest { x_offset, y_offset, height, width, .. } = info.roi;
    text += &format!("roi: {{x_offset: {x_offset}, y_offset: {y_offset}, height: {height}, width: {width}}}\n");
    text += &matrix("camera_matrix", 3, 3, &k);
    text += &format!("distortion_model: {model}\n");
    text += &matrix("distortion_coefficients", 1, d.len(), d);
    text += &matrix("rectification_matrix", 3, 3, &r);
    text += &matrix("projection_matrix", 3, 4, p);
    text
}
