//! `MJPG` images: JPEGs, in which many cameras omit the Huffman tables, and whose scan data may be partly lost on the bus.
//!
//! A camera that omits the tables uses those of ITU-T T.81, annex K.3; they are inserted before decoding. If data are missing,
//! decoders continue with zeros, so that the rest of the image is grey. To detect this, ones are inserted before each marker of
//! the scan. T.81 assigns no symbol to the code of ones only (annex C), so a decoder that reads past missing data finds an
//! invalid code. A decoder that has read all data skips the bytes before the marker; many cameras insert a few bytes there
//! themselves. The markers are counted as well. Losses smaller than a block, some tens of bytes, are not detected.

use image::RgbImage;
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::PixelError;

/// Start marker, end marker and a frame header: the minimum size of a JPEG.
pub(super) const BYTES_MIN: usize = 24;

const MARKER: u8 = 0xFF;
const START_OF_IMAGE: u8 = 0xD8;
const END_OF_IMAGE: u8 = 0xD9;
const START_OF_SCAN: u8 = 0xDA;
const HUFFMAN_TABLES: u8 = 0xC4;
/// The first of eight restart markers.
const RESTART: u8 = 0xD0;
const RESTART_INTERVAL: u8 = 0xDD;
/// Frame types with one scan: baseline, and extended sequential.
const FRAMES: [u8; 2] = [0xC0, 0xC1];

/// 64 ones, each 0xFF followed by a stuffed zero byte: a code has at most 16 bits, and up to 15 more bits of its value may be
/// read with it.
const NO_CODE: [u8; 16] = [0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0, 0xFF, 0];

/// Decodes JPEGs, with reusable memory for the decoder input.
#[derive(Debug, Default)]
pub(super) struct Decoder {
    completed: Vec<u8>,
}

impl Decoder {
    /// Decodes into an image of the size that the JPEG must have.
    pub(super) fn decode(&mut self, bytes: &[u8], target: &mut RgbImage) -> Result<(), PixelError> {
        self.complete(bytes).map_err(|what| PixelError::JpegDamaged { bytes: bytes.len(), what })?;
        let failed =
            |error: zune_jpeg::errors::DecodeErrors| PixelError::Jpeg { bytes: bytes.len(), why: error.to_string() };
        let options = DecoderOptions::default().set_strict_mode(true).jpeg_set_out_colorspace(ColorSpace::RGB);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&self.completed), options);
        decoder.decode_headers().map_err(failed)?;
        let found = decoder.info().map_or((0, 0), |info| (usize::from(info.width), usize::from(info.height)));
        let expected = target.dimensions();
        if found != (expected.0 as usize, expected.1 as usize) {
            return Err(PixelError::JpegSize { found, expected });
        }
        decoder.decode_into(target).map_err(failed)
    }

    /// Copies the image, with tables and with ends that cannot be read past.
    fn complete(&mut self, bytes: &[u8]) -> Result<(), &'static str> {
        let anatomy = Anatomy::of(bytes)?;
        let completed = &mut self.completed;
        completed.clear();
        completed.extend_from_slice(&bytes[..anatomy.scan]);
        if !anatomy.has_tables {
            append_standard_tables(completed);
        }
        append_scan(completed, &bytes[anatomy.scan..], anatomy.restarts()?)
    }
}

/// Appends the file of a decodable image: with Huffman tables, and without what the driver left after its end.
pub(super) fn append_file(bytes: &[u8], file: &mut Vec<u8>) {
    let Ok(Anatomy { scan, has_tables, .. }) = Anatomy::of(bytes) else { return };
    let end = bytes.windows(2).rposition(|pair| pair == [MARKER, END_OF_IMAGE]).map_or(bytes.len(), |at| at + 2);
    file.extend_from_slice(&bytes[..scan]);
    if !has_tables {
        append_standard_tables(file);
    }
    file.extend_from_slice(&bytes[scan..end.max(scan)]);
}

/// Appends the scan from its marker to the end of the image; camera images have one scan. Trailing bytes of the driver are
/// ignored.
fn append_scan(completed: &mut Vec<u8>, bytes: &[u8], restarts_min: usize) -> Result<(), &'static str> {
    const LACKS: &str = "a part of the scan (its restart markers are not consecutive)";
    let header = number_at(bytes, 2).and_then(|length| bytes.get(..2 + length)).ok_or("the header of the scan")?;
    completed.extend_from_slice(header);
    let (mut rest, mut restarts) = (&bytes[header.len()..], 0);
    loop {
        let at = rest.iter().position(|byte| *byte == MARKER).ok_or("the end marker")?;
        let (data, from_marker) = rest.split_at(at);
        completed.extend_from_slice(data);
        rest = match *from_marker.get(1).ok_or("the end marker")? {
            // A marker may begin with several 0xFF.
            MARKER => &from_marker[1..],
            kind => {
                if kind != 0 {
                    completed.extend_from_slice(&NO_CODE);
                }
                completed.extend_from_slice(&[MARKER, kind]);
                match kind {
                    0 => {}
                    END_OF_IMAGE if restarts >= restarts_min => return Ok(()),
                    // Restart markers are numbered from 0 to 7 cyclically.
                    kind if kind == RESTART + (restarts % 8) as u8 => restarts += 1,
                    _ => return Err(LACKS),
                }
                &from_marker[2..]
            }
        };
    }
}

/// The structure of a JPEG and of its scan.
#[derive(Debug, Default)]
struct Anatomy {
    /// Position of the marker of the first scan.
    scan: usize,
    /// Whether there are Huffman tables before it.
    has_tables: bool,
    /// Number of coded units (groups of blocks) of the whole image.
    units: usize,
    /// Number of units between two restart markers; zero: there are no restart markers.
    interval: usize,
}

impl Anatomy {
    /// Parses the segments up to the first scan.
    fn of(bytes: &[u8]) -> Result<Self, &'static str> {
        if !bytes.starts_with(&[MARKER, START_OF_IMAGE]) {
            return Err("the start marker");
        }
        let (mut at, mut found) = (2, Self::default());
        loop {
            let Some([MARKER, kind]) = bytes.get(at..at + 2) else { return Err("a marker before the first scan") };
            match *kind {
                // A marker may begin with several 0xFF.
                MARKER => at += 1,
                START_OF_SCAN => return Ok(Self { scan: at, ..found }),
                kind => {
                    let length = number_at(bytes, at + 2).ok_or("the length of a segment")?;
                    let segment = bytes.get(at + 2..at + 2 + length).ok_or("the end of a segment")?;
                    found.has_tables |= kind == HUFFMAN_TABLES;
                    if FRAMES.contains(&kind) {
                        found.units = units(segment).ok_or("the size of the image")?;
                    } else if kind == RESTART_INTERVAL {
                        found.interval = number_at(segment, 2).ok_or("the restart interval")?;
                    }
                    at += 2 + length;
                }
            }
        }
    }

    /// Number of restart markers required in the scan.
    fn restarts(&self) -> Result<usize, &'static str> {
        let before_last = self.units.checked_sub(1).ok_or("a frame of one scan")?;
        Ok(before_last.checked_div(self.interval).unwrap_or(0))
    }
}

/// Number of coded units (blocks, or groups of blocks of all components) of the frame with this header (T.81, A.2).
fn units(segment: &[u8]) -> Option<usize> {
    let [height, width] = [number_at(segment, 3)?, number_at(segment, 5)?];
    let components = segment.get(8..)?.chunks_exact(3);
    let of_one = components.len() == 1;
    let largest = |shift: u8| {
        let factors = components.clone().map(|component| usize::from(component[1] >> shift & 15));
        if of_one { 1 } else { factors.max().unwrap_or(0) }
    };
    let [across, down] = [8 * largest(4), 8 * largest(0)];
    (across > 0 && down > 0).then(|| width.div_ceil(across) * height.div_ceil(down))
}

/// A number of two bytes; the length of a segment includes these two.
fn number_at(bytes: &[u8], at: usize) -> Option<usize> {
    Some(usize::from(u16::from_be_bytes(*bytes.get(at..at + 2)?.first_chunk()?)))
}

/// Class and number, number of codes of 1 to 16 bits, and their symbols.
type Table = (u8, [u8; 16], &'static [u8]);

fn append_standard_tables(bytes: &mut Vec<u8>) {
    let length = 2 + STANDARD_TABLES.iter().map(|(_, _, values)| 17 + values.len()).sum::<usize>();
    bytes.extend_from_slice(&[MARKER, HUFFMAN_TABLES]);
    bytes.extend_from_slice(&(length as u16).to_be_bytes());
    for (class, counts, values) in STANDARD_TABLES {
        bytes.push(class);
        bytes.extend_from_slice(&counts);
        bytes.extend_from_slice(values);
    }
}

/// ITU-T T.81, tables K.3 to K.6.
const STANDARD_TABLES: [Table; 4] = [
    (0x00, [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0], &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
    (0x01, [0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0], &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]),
    (0x10, [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7D], &LUMINANCE_AC),
    (0x11, [0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 0x77], &CHROMINANCE_AC),
];

#[rustfmt::skip]
const LUMINANCE_AC: [u8; 162] = [
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07, 0x22, 0x71,
    0x14, 0x32, 0x81, 0x91, 0xA1, 0x08, 0x23, 0x42, 0xB1, 0xC1, 0x15, 0x52, 0xD1, 0xF0, 0x24, 0x33, 0x62, 0x72,
    0x82, 0x09, 0x0A, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x25, 0x26, 0x27, 0x28, 0x29, 0x2A, 0x34, 0x35, 0x36, 0x37,
    0x38, 0x39, 0x3A, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4A, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59,
    0x5A, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6A, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7A, 0x83,
    0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8A, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9A, 0xA2, 0xA3,
    0xA4, 0xA5, 0xA6, 0xA7, 0xA8, 0xA9, 0xAA, 0xB2, 0xB3, 0xB4, 0xB5, 0xB6, 0xB7, 0xB8, 0xB9, 0xBA, 0xC2, 0xC3,
    0xC4, 0xC5, 0xC6, 0xC7, 0xC8, 0xC9, 0xCA, 0xD2, 0xD3, 0xD4, 0xD5, 0xD6, 0xD7, 0xD8, 0xD9, 0xDA, 0xE1, 0xE2,
    0xE3, 0xE4, 0xE5, 0xE6, 0xE7, 0xE8, 0xE9, 0xEA, 0xF1, 0xF2, 0xF3, 0xF4, 0xF5, 0xF6, 0xF7, 0xF8, 0xF9, 0xFA,
];

#[rustfmt::skip]
const CHROMINANCE_AC: [u8; 162] = [
    0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61, 0x71, 0x13, 0x22,
    0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xA1, 0xB1, 0xC1, 0x09, 0x23, 0x33, 0x52, 0xF0, 0x15, 0x62, 0x72, 0xD1,
    0x0A, 0x16, 0x24, 0x34, 0xE1, 0x25, 0xF1, 0x17, 0x18, 0x19, 0x1A, 0x26, 0x27, 0x28, 0x29, 0x2A, 0x35, 0x36,
    0x37, 0x38, 0x39, 0x3A, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49, 0x4A, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58,
    0x59, 0x5A, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69, 0x6A, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7A,
    0x82, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89, 0x8A, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9A,
    0xA2, 0xA3, 0xA4, 0xA5, 0xA6, 0xA7, 0xA8, 0xA9, 0xAA, 0xB2, 0xB3, 0xB4, 0xB5, 0xB6, 0xB7, 0xB8, 0xB9, 0xBA,
    0xC2, 0xC3, 0xC4, 0xC5, 0xC6, 0xC7, 0xC8, 0xC9, 0xCA, 0xD2, 0xD3, 0xD4, 0xD5, 0xD6, 0xD7, 0xD8, 0xD9, 0xDA,
    0xE2, 0xE3, 0xE4, 0xE5, 0xE6, 0xE7, 0xE8, 0xE9, 0xEA, 0xF2, 0xF3, 0xF4, 0xF5, 0xF6, 0xF7, 0xF8, 0xF9, 0xFA,
];
