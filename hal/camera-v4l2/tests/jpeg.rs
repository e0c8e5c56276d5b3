//! `MJPG` images: complete ones with and without their tables, and every kind of damage.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use crate::support::{Rig, SECOND, config};
use image::RgbImage;
use pb3dp_camera_pixels::{Converter, Layout, PixelError, YuvMatrix, YuvRange};
use pb3dp_camera_settings::PixelFormat;
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{CameraErrorKind, DeliveredImage, StereoCamera};
use proptest::prelude::*;

/// 160 x 96 pixels of a photograph in the format of cameras: 4:2:2, the standard tables; the second image has a restart marker
/// per 8 rows.
const PLAIN: &[u8] = include_bytes!("data/plain.jpg");
const RESTARTS: &[u8] = include_bytes!("data/restarts.jpg");

fn converter(width: u32, height: u32) -> Converter {
    let (matrix, range) = (YuvMatrix::Bt601, YuvRange::Limited);
    let size = ImageSize { width, height };
    Converter::new(Layout { format: PixelFormat::Mjpg, size, stride: 0, matrix, range }).unwrap()
}

fn decoded(bytes: &[u8]) -> Result<RgbImage, PixelError> {
    let mut image = RgbImage::new(160, 96);
    converter(160, 96).convert(bytes, &mut image).map(|()| image)
}

/// Removes every segment of that type before the first scan.
fn without(bytes: &[u8], kind: u8) -> Vec<u8> {
    let (mut out, mut at) = (bytes[..2].to_vec(), 2);
    while bytes[at + 1] != 0xDA {
        let end = at + 2 + usize::from(u16::from_be_bytes([bytes[at + 2], bytes[at + 3]]));
        if bytes[at + 1] != kind {
            out.extend(&bytes[at..end]);
        }
        at = end;
    }
    out.extend(&bytes[at..]);
    out
}

/// Without tables, as many cameras send them.
fn bare(bytes: &[u8]) -> Vec<u8> {
    let bare = without(bytes, 0xC4);
    assert!(bare.len() + 400 < bytes.len(), "the encoder wrote tables, and they are gone");
    bare
}

/// Start of the scan data.
fn data_begin(bytes: &[u8]) -> usize {
    let scan = bytes.windows(2).rposition(|pair| pair == [0xFF, 0xDA]).unwrap();
    scan + 2 + usize::from(u16::from_be_bytes([bytes[scan + 2], bytes[scan + 3]]))
}

/// The image without some of its bytes.
fn lacking(bytes: &[u8], from: usize, length: usize) -> Vec<u8> {
    [&bytes[..from], &bytes[from + length..]].concat()
}

#[test]
fn images_of_cameras_are_what_libjpeg_makes_of_them() {
    let expected = image::load_from_memory(include_bytes!("data/decoded.png")).unwrap().to_rgb8();
    for bytes in [PLAIN, RESTARTS] {
        let found = decoded(bytes).unwrap();
        let error = found.iter().zip(expected.iter()).map(|(found, expected)| found.abs_diff(*expected)).max();
        assert!(error <= Some(4), "{error:?}");
        assert_eq!(decoded(&bare(bytes)).unwrap(), found);
        // Drivers may return more bytes than the image has.
        assert_eq!(decoded(&[bytes, &[0; 1000], &[0xFF, 0xD9]].concat()).unwrap(), found);
    }
}

#[test]
fn bytes_before_a_marker_that_mean_nothing_are_left_out() {
    let found = decoded(PLAIN).unwrap();
    for more in [&[0x00; 9][..], &[0x12, 0x34, 0xFF, 0x00], &[0xFF]] {
        for bytes in [PLAIN, RESTARTS] {
            let (begin, end) = (data_begin(bytes), bytes.len() - 2);
            let is_marker = |from: &[u8]| matches!(from, [0xFF, 0xD0..=0xD9, ..]);
            let mut stuffed = bytes[..begin].to_vec();
            for at in begin..end + 2 {
                let from = &bytes[at..];
                stuffed.extend(if is_marker(from) { more } else { &[] });
                stuffed.push(from[0]);
            }
            assert_eq!(decoded(&stuffed).unwrap(), found, "{more:?}");
        }
    }
}

#[test]
fn a_jpeg_whose_scan_is_cut_short_is_refused_though_its_end_is_marked() {
    let whole = decoded(PLAIN).unwrap();
    for bytes in [PLAIN.to_vec(), RESTARTS.to_vec(), bare(PLAIN), bare(RESTARTS)] {
        let end = bytes.len() - 2;
        let mut refused = 0;
        for from in data_begin(&bytes)..end {
            match decoded(&lacking(&bytes, from, end - from)) {
                Err(_) => refused += 1,
                // The last bits may be the inserted ones.
                Ok(found) => assert!(found == whole && from > end - 3, "cut at {from} of {end}"),
            }
        }
        assert!(refused > 2000, "{refused}");
    }
}

#[test]
fn a_jpeg_that_lacks_a_packet_is_refused() {
    for bytes in [PLAIN, RESTARTS] {
        let (begin, end) = (data_begin(bytes), bytes.len() - 2);
        for length in [128, 188, 512, 1024] {
            // Also the whole end of restart intervals: the markers before it are still consecutive.
            for from in (begin..end - length).step_by(3) {
                assert!(decoded(&lacking(bytes, from, length)).is_err(), "{length} bytes from {from} on");
            }
        }
    }
}

#[test]
fn what_is_no_whole_jpeg_is_refused_with_its_length() {
    for length in [0, 10, 24, 200, PLAIN.len() / 2, PLAIN.len() - 2, PLAIN.len() - 1] {
        let error = decoded(&PLAIN[..length]).unwrap_err();
        assert!(error.to_string().contains(&format!("{length} bytes")), "{error}");
    }
    // A missing scan marker, and a repeated one.
    let is_restart = |pair: &[u8]| pair[0] == 0xFF && (0xD0..=0xD7).contains(&pair[1]);
    let at = RESTARTS.windows(2).position(is_restart).unwrap();
    for broken in [lacking(RESTARTS, at, 2), [&RESTARTS[..at + 2], &RESTARTS[at..]].concat()] {
        let error = decoded(&broken).unwrap_err().to_string();
        assert!(error.contains("a part of the scan (its restart markers are not consecutive)"), "{error}");
    }
    let mut image = RgbImage::new(152, 96);
    let error = converter(152, 96).convert(PLAIN, &mut image).unwrap_err();
    assert_eq!(error.to_string(), "the JPEG has 160x96 pixels, expected are 152x96");
}

/// Size of the emulated camera's buffers, bytes.
const BUFFER: u32 = 96 * 64;

#[test]
fn cut_images_of_a_camera_are_dropped_and_counted_and_the_next_ones_come() {
    // Of ten images of the right camera the third one is truncated, and the sixth one lacks a packet.
    fn paint(number: u64, memory: &mut [u8]) {
        let end = RESTARTS.len() - 2;
        let sent = match number % 10 {
            2 => lacking(RESTARTS, end - 700, 700),
            5 => lacking(RESTARTS, 1500, 512),
            _ => RESTARTS.to_vec(),
        };
        memory.fill(0);
        memory[..sent.len()].copy_from_slice(&sent);
    }
    let size = ImageSize { width: 160, height: 96 };
    let rig = Rig::with(|side, camera| {
        camera.formats = vec![(*b"MJPG", vec![(size, vec![config().left.mode.interval])])];
        camera.padding = BUFFER / size.height;
        camera.paint = if side == 1 { paint } else { |_, memory| memory[..PLAIN.len()].copy_from_slice(PLAIN) };
    });
    let mut config = config();
    for mode in [&mut config.left.mode, &mut config.right.mode] {
        (mode.format, mode.size) = (PixelFormat::Mjpg, size);
    }
    let mut camera = rig.open(&config).unwrap();
    let whole = decoded(PLAIN).unwrap();
    for number in 0..20 {
        match camera.next_pair(SECOND) {
            Ok(pair) => {
                assert!(![2, 5].contains(&(number % 10)) && pair.left == whole && pair.right == whole);
                // The driver's buffers are longer than the images.
                assert_eq!(pair.delivered.each_ref().map(DeliveredImage::jpeg), [Some(PLAIN), Some(RESTARTS)]);
            }
            Err(error) => {
                assert!([2, 5].contains(&(number % 10)) && error.kind() == CameraErrorKind::BadPair, "{error}");
                assert!(error.to_string().contains("serial:SN0001"), "{error}");
            }
        }
    }
    let counters = camera.counters();
    assert_eq!((counters.pairs, counters.right.damaged, counters.left.damaged), (16, 4, 0));
    assert_eq!((counters.right.good, counters.left.good), (16, 20));
}

/// A browser need not know the tables that a camera omits.
#[test]
fn the_file_of_an_image_can_be_read_by_every_decoder() {
    let converter = converter(160, 96);
    let file_of = |bytes: &[u8]| {
        let mut file = Vec::new();
        assert_eq!(converter.copy_delivered(bytes, &mut file), DeliveredImage::JPEG);
        file
    };
    for complete in [PLAIN, RESTARTS] {
        assert_eq!(file_of(complete), complete);
        let with_rest = [&bare(complete)[..], &[0xFF, 0, 7]].concat();
        let strict = image::load_from_memory_with_format(&file_of(&with_rest), image::ImageFormat::Jpeg).unwrap();
        assert!(strict.into_rgb8() == decoded(complete).unwrap());
    }
}

proptest! {
    #[test]
    fn damaged_jpegs_never_do_harm(at in 2_usize..3400, byte in any::<u8>(), length in 0_usize..5000, which in 0_usize..2) {
        let mut bytes = bare([PLAIN, RESTARTS][which]);
        if let Some(place) = bytes.get_mut(at) {
            *place = byte;
        }
        bytes.truncate(length);
        // Some damage cannot be detected; the code must not panic.
        let _ = decoded(&bytes);
    }
}
