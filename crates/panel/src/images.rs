//! Encodes images for the page: each once for all clients, and only while somebody looks. What a camera delivers as JPEG is passed on.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use image::RgbImage;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use pb3dp_geometry::maps::RemapTable;
use pb3dp_geometry::{ImageSize, MonotonicTime, StereoRig};
use pb3dp_hal_api::FramePair;

use crate::encoded_pair::{EncodedPair, ImageHead, JPEG_IMAGE, RECTIFIED};
use crate::heat;
use crate::hub::Hub;
use crate::viewers::Wanted;

/// Quality of the JPEGs, with colours at half the resolution: 2.1 ms for 640x480.
const QUALITY: u8 = 75;
/// Time between two checks whether the panel ends.
const LOOK: Duration = Duration::from_millis(50);
/// Time between two heat overlays, seconds: they cost as much as an image.
const HEAT_EVERY_S: f64 = 0.2;

/// Encodes until the panel ends.
pub fn run(hub: &Hub) {
    let mut rectifier = Rectifier::new(hub.about.stereo, hub.about.is_calibrated);
    let (mut encoded_at, mut heated_at) = (None, None);
    while !hub.is_over() {
        let Some(pair) = hub.watched.pairs.wait(LOOK) else { continue };
        let wanted = hub.viewers.wanted();
        if wanted == Wanted::default() {
            continue;
        }
        // A tenth less than the interval, so that a rate as high as that of the cameras takes every pair.
        let interval_s = 0.9 / wanted.fps_max.max(0.1);
        if !is_due(encoded_at, interval_s, pair.exposed_at) {
            continue;
        }
        encoded_at = Some(pair.exposed_at);
        let mut encoded = encode_pair(&pair, wanted, &mut rectifier);
        let is_heat_due = is_due(heated_at, HEAT_EVERY_S, pair.exposed_at);
        if let (true, true, Some(newest)) = (wanted.heat, is_heat_due, hub.watched.newest()) {
            heated_at = Some(pair.exposed_at);
            encoded.heat = heat::message(&pair, &newest, &hub.about.stereo);
        }
        hub.images.send_replace(Some(Arc::new(encoded)));
    }
}

/// Whether the interval has passed; also after the clock went back.
fn is_due(before: Option<MonotonicTime>, interval_s: f64, now: MonotonicTime) -> bool {
    !before.is_some_and(|before| (0.0..interval_s).contains(&now.seconds_since(before)))
}

fn encode_pair(pair: &FramePair, wanted: Wanted, rectifier: &mut Rectifier) -> EncodedPair {
    let mut encoded = EncodedPair { at: pair.exposed_at, ..EncodedPair::default() };
    for side in [0, 1] {
        let image = if side == 0 { &pair.left } else { &pair.right };
        if wanted.images[0][side] {
            encoded.messages[0][side] = match pair.delivered[side].jpeg() {
                Some(file) => delivered(pair, side, file),
                None => message(pair, (side, 0), image),
            };
        }
        if wanted.images[1][side] {
            encoded.messages[1][side] =
                rectifier.rectified(side, image).and_then(|image| message(pair, (side, RECTIFIED), &image));
        }
    }
    encoded
}

/// Head and the JPEG of the camera.
fn delivered(pair: &FramePair, side: usize, file: &[u8]) -> Option<Bytes> {
    let place = [pair.left.width(), pair.left.height(), 0, 0];
    let head = ImageHead { pair, side: u8::from(side == 1), kind: JPEG_IMAGE, flags: 0, place };
    let mut bytes = head.to_bytes(file.len())?;
    bytes.extend_from_slice(file);
    Some(bytes.into())
}

/// Head and JPEG; `None` for an image that JPEG cannot hold.
fn message(pair: &FramePair, (side, flags): (usize, u16), image: &RgbImage) -> Option<Bytes> {
    let place = [image.width(), image.height(), 0, 0];
    let head = ImageHead { pair, side: u8::from(side == 1), kind: JPEG_IMAGE, flags, place };
    let mut bytes = head.to_bytes(image.as_raw().len() / 8)?;
    let mut encoder = Encoder::new(&mut bytes, QUALITY);
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    let (width, height) = (u16::try_from(image.width()).ok()?, u16::try_from(image.height()).ok()?);
    encoder.encode(image.as_raw(), width, height, ColorType::Rgb).ok()?;
    Some(bytes.into())
}

/// Rectifies images; the tables are computed when somebody first wants them.
struct Rectifier {
    rig: StereoRig,
    tables: Option<Option<[RemapTable; 2]>>,
}

impl Rectifier {
    /// Without a calibration there are no rectified images.
    fn new(rig: StereoRig, is_calibrated: bool) -> Self {
        Self { rig, tables: (!is_calibrated).then_some(None) }
    }

    fn rectified(&mut self, side: usize, image: &RgbImage) -> Option<RgbImage> {
        let rig = &self.rig;
        let tables = self.tables.get_or_insert_with(|| match rig.rectify() {
            Ok(rectification) => Some([rectification.left.table(), rectification.right.table()]),
            Err(error) => {
                tracing::warn!("rectified images are not available: {error}");
                None
            }
        });
        let table = tables.as_ref()?.get(side)?;
        let mut rectified = RgbImage::new(table.size().width, table.size().height);
        let size = ImageSize { width: image.width(), height: image.height() };
        table.remap_rgb(image.as_raw(), size, &mut rectified).ok()?;
        Some(rectified)
    }
}
