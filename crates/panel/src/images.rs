//! Encodes images for the page: each once for all clients, and only while somebody looks.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Bytes;
use image::RgbImage;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use pb3dp_geometry::maps::RemapTable;
use pb3dp_geometry::{ImageSize, MonotonicTime, StereoRig};
use pb3dp_hal_api::FramePair;

use crate::encoded_pair::EncodedPair;
use crate::hub::Hub;
use crate::messages::time_ms;
use crate::viewers::Wanted;

/// Quality of the JPEGs, with colours at half the resolution: 2.1 ms for 640x480.
const QUALITY: u8 = 75;
/// Time between two checks whether the panel ends.
const LOOK: Duration = Duration::from_millis(50);
/// Size of the header.
const HEADER_BYTES: usize = 32;
/// Flag of a rectified image.
const RECTIFIED: u16 = 1;

/// Encodes until the panel ends.
pub fn run(hub: &Hub) {
    let mut rectifier = Rectifier::new(hub.about.stereo);
    let mut encoded_at: Option<MonotonicTime> = None;
    while !hub.is_over() {
        let Some(pair) = hub.watched.pairs.wait(LOOK) else { continue };
        let wanted = hub.viewers.wanted();
        if wanted == Wanted::default() {
            continue;
        }
        // A tenth less than the interval, so that a rate as high as that of the cameras takes every pair.
        let interval_s = 0.9 / wanted.fps_max.max(0.1);
        let is_early =
            encoded_at.is_some_and(|before| (0.0..interval_s).contains(&pair.exposed_at.seconds_since(before)));
        if is_early {
            continue;
        }
        encoded_at = Some(pair.exposed_at);
        hub.images.send_replace(Some(Arc::new(encode_pair(&pair, wanted, &mut rectifier))));
    }
}

fn encode_pair(pair: &FramePair, wanted: Wanted, rectifier: &mut Rectifier) -> EncodedPair {
    let mut encoded = EncodedPair { at: pair.exposed_at, ..EncodedPair::default() };
    for side in [0, 1] {
        let image = if side == 0 { &pair.left } else { &pair.right };
        if wanted.images[0][side] {
            encoded.messages[0][side] = message(pair, (side, 0), image);
        }
        if wanted.images[1][side] {
            encoded.messages[1][side] =
                rectifier.rectified(side, image).and_then(|image| message(pair, (side, RECTIFIED), &image));
        }
    }
    encoded
}

/// Header and JPEG; `None` for an image that JPEG cannot hold.
fn message(pair: &FramePair, (side, flags): (usize, u16), image: &RgbImage) -> Option<Bytes> {
    let (width, height) = (u16::try_from(image.width()).ok()?, u16::try_from(image.height()).ok()?);
    let mut bytes = Vec::with_capacity(HEADER_BYTES + image.as_raw().len() / 8);
    bytes.extend_from_slice(b"PBI1");
    bytes.push(u8::from(side == 1));
    bytes.push(0);
    bytes.extend_from_slice(&flags.to_le_bytes());
    bytes.extend_from_slice(&pair.sequence.to_le_bytes());
    bytes.extend_from_slice(&time_ms(pair.exposed_at).to_le_bytes());
    for number in [width, height, 0, 0] {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    let mut encoder = Encoder::new(&mut bytes, QUALITY);
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    encoder.encode(image.as_raw(), width, height, ColorType::Rgb).ok()?;
    Some(bytes.into())
}

/// Rectifies images; the tables are computed when somebody first wants them.
struct Rectifier {
    rig: StereoRig,
    tables: Option<Option<[RemapTable; 2]>>,
}

impl Rectifier {
    fn new(rig: StereoRig) -> Self {
        Self { rig, tables: None }
    }

    fn rectified(&mut self, side: usize, image: &RgbImage) -> Option<RgbImage> {
        let rig = &self.rig;
        let tables = self.tables.get_or_insert_with(|| match rig.rectify() {
            Ok(rectification) => Some([rectification.left, rectification.right]),
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
