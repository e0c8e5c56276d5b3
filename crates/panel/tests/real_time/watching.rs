//! States, images and previews.

use std::sync::Arc;
use std::time::{Duration, Instant};

use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{DeliveredImage, FramePair};
use serde_json::json;

use crate::support::{Page, Rig};

fn header(bytes: &[u8]) -> (u8, u8, u16, u64, f64, [u16; 4]) {
    assert_eq!(&bytes[..4], b"PBI1");
    let u16_at = |at: usize| u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap());
    let sequence = u64::from_le_bytes(bytes[8..16].try_into().unwrap());
    let time_ms = f64::from_le_bytes(bytes[16..24].try_into().unwrap());
    (bytes[4], bytes[5], u16_at(6), sequence, time_ms, [24, 26, 28, 30].map(u16_at))
}

#[test]
fn images_come_while_they_are_wanted() {
    let rig = Rig::new();
    let mut page = Page::open(&rig.client());
    page.send(json!({ "type": "images", "left": true, "right": true, "view": "raw", "fps_max": 30 }));
    let (first, second) = (page.next_image(), page.next_image());
    let (side, kind, flags, sequence, time_ms, place) = header(&first);
    assert_eq!((side, kind, flags, place), (0, 0, 0, [640, 480, 0, 0]));
    assert_eq!((header(&second).0, header(&second).3), (1, sequence), "the right image of the same pair");
    assert!(time_ms > 0.0);
    let image = image::load_from_memory_with_format(&first[32..], image::ImageFormat::Jpeg).unwrap();
    assert_eq!((image.width(), image.height()), (640, 480));
    page.send(json!({ "type": "images", "left": false, "right": true, "view": "rectified", "fps_max": 10 }));
    let mut image = page.next_image();
    while header(&image).2 == 0 {
        image = page.next_image();
    }
    assert_eq!((header(&image).0, header(&image).2), (1, 1));
    page.send(json!({ "type": "images", "left": false, "right": false }));
    std::thread::sleep(Duration::from_millis(300));
    let start = Instant::now();
    let mut count = 0;
    while start.elapsed() < Duration::from_millis(600) {
        count += usize::from(page.next().unwrap().is_err());
    }
    assert!(count < 12, "images that were on their way, no more: {count}");
}

/// Encoding again would cost 2 ms and some sharpness.
#[test]
fn what_a_camera_delivers_as_jpeg_is_passed_on() {
    let black = FramePair::black(ImageSize { width: 640, height: 480 });
    let file = |bytes: &[u8]| DeliveredImage { encoding: DeliveredImage::JPEG, bytes: bytes.to_vec() };
    let delivered = [file(b"left file"), file(b"right file")];
    let rig = Rig::with_images(|_| {}, (true, false), Arc::new(FramePair { delivered, ..black }));
    let mut page = Page::open(&rig.client());
    page.send(json!({ "type": "images", "left": true, "right": true, "view": "raw", "fps_max": 30 }));
    for (side, file) in [&b"left file"[..], b"right file"].into_iter().enumerate() {
        let image = page.next_image();
        assert_eq!((header(&image).0, header(&image).5), (side as u8, [640, 480, 0, 0]));
        assert_eq!(&image[32..], file);
    }
    // A rectified image is another one.
    page.send(json!({ "type": "images", "left": true, "right": false, "view": "rectified", "fps_max": 30 }));
    let rectified = std::iter::repeat_with(|| page.next_image()).find(|image| header(image).2 == 1).unwrap();
    assert!(image::load_from_memory_with_format(&rectified[32..], image::ImageFormat::Jpeg).is_ok());
}

#[test]
fn the_state_has_the_errors_and_poses_of_the_target() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.start(&client);
    let state = client.wait_for("errors", |state| state["target"]["error_mm"][2].as_f64().is_some_and(|z| z < -1.0));
    let target = &state["target"];
    let near = |value: &serde_json::Value, expected: f64| (value.as_f64().unwrap() - expected).abs() < 1e-6;
    assert!(near(&target["error_mm"][2], -2.0) && near(&target["error_deg"][0], 0.0), "{target}");
    assert!(near(&target["point_mm"][2], 600.0) && near(&target["motion_sigma_mm"][0], 0.1), "{target}");
    assert!(near(&target["sigma_mm"][0], 0.1 * 5_f64.sqrt()), "{target}");
    assert_eq!(target["status"], "ok");
    assert_eq!(target["outline_right_px"].as_array().unwrap().len(), 4);
    assert!(state["truth"]["world_from_target"].is_array() && target["world_from_model"].is_array());
    assert!(target["cam_left_from_model"].is_array() && state["state"]["is_moving"] == true);
    assert!(state["control"]["error_mm"].as_f64().unwrap() > 0.0);
    assert!(state["realtime_factor"].as_f64().unwrap() > 0.5 && state["images"]["fps"].as_f64().unwrap() > 5.0);
    for arm in state["arms"].as_array().unwrap() {
        assert_eq!((&arm["condition"], arm["position_deg"].as_array().unwrap().len()), (&json!("enabled"), 7));
    }
    let info = client.get("/api/info").json();
    let arm = &info["arms"][0];
    assert_eq!((arm["chain"].as_array().unwrap().len(), arm["axis"].as_array().unwrap().len()), (8, 7));
    // Each range within the next one; the gateway of the other arm is not known.
    let limit = &arm["limits"][2];
    let end = |range: &str| limit[range][1].as_f64().unwrap();
    assert!(end("operating_deg") <= end("servo_deg") && end("servo_deg") < end("mechanical_deg"), "{limit}");
    assert!(near(&limit["gateway_deg"][1], 0.3_f64.to_degrees()), "{limit}");
    assert!(near(&limit["gateway_deg"][0], -0.2_f64.to_degrees()), "{limit}");
    assert!(near(&limit["gateway_speed_deg_per_s"], 0.5_f64.to_degrees()), "{limit}");
    assert!(limit["speed_deg_per_s"].as_f64() < limit["drive_speed_deg_per_s"].as_f64(), "{limit}");
    let other = &info["arms"][1]["limits"][2];
    assert!(other["gateway_deg"].is_null() && other["gateway_speed_deg_per_s"].is_null(), "{other}");
}

#[test]
fn a_heat_overlay_covers_the_target() {
    let rig = Rig::new();
    let client = rig.holder();
    rig.start(&client);
    let mut page = Page::open(&rig.client());
    page.send(json!({ "type": "images", "left": true, "right": false, "heat": true }));
    let mut image = page.next_image();
    while header(&image).1 == 0 {
        image = page.next_image();
    }
    let (side, kind, flags, _, _, place) = header(&image);
    assert_eq!((side, kind, flags, place), (0, 1, 0, [41, 41, 300, 220]));
    let overlay = image::load_from_memory_with_format(&image[32..], image::ImageFormat::Png).unwrap().into_rgba8();
    assert_eq!(overlay.dimensions(), (41, 41));
    // The images of this test are not those of a plane at this depth.
    assert!(overlay.pixels().any(|pixel| pixel.0[3] > 100));
}

#[test]
fn a_client_that_does_not_read_does_not_hold_up_another() {
    let rig = Rig::new();
    let client = rig.client();
    let mut deaf: Vec<Page> = (0..4).map(|_| Page::open(&client)).collect();
    for page in &mut deaf {
        page.send(json!({ "type": "images", "left": true, "right": true, "fps_max": 60 }));
    }
    let mut page = Page::open(&client);
    page.send(json!({ "type": "images", "left": true, "right": true, "fps_max": 60 }));
    let (start, mut states, mut images) = (Instant::now(), 0, 0);
    let mut longest = Duration::ZERO;
    let mut before = Instant::now();
    while start.elapsed() < Duration::from_secs(3) {
        match page.next().unwrap() {
            Ok(message) if message["type"] == "state" => {
                states += 1;
                longest = longest.max(before.elapsed());
                before = Instant::now();
            }
            Ok(_) => {}
            Err(_) => images += 1,
        }
    }
    assert!(states >= 30 && images >= 40, "{states} states, {images} images");
    assert!(longest < Duration::from_millis(450), "{longest:?}");
}

#[test]
fn a_preview_tells_whether_a_region_will_work_and_why_not() {
    let rig = Rig::new();
    let client = rig.client();
    let state = client.wait_for("images", |state| state["images"]["sequence"].is_u64());
    let sequence = state["images"]["sequence"].as_u64().unwrap();
    let preview = |region: &str, sequence: u64| {
        client.post("preview", &json!({ "region": region, "sequence": sequence }).to_string())
    };
    let reply = preview("rect:200,150,200,150", sequence);
    assert_eq!(reply.status, 200, "{}", reply.body);
    let answer = reply.json();
    assert_eq!(answer["sequence"], sequence);
    assert_eq!(answer["outline_px"].as_array().unwrap().len(), 4);
    assert!(answer["ms"].as_f64().unwrap() > 0.0);
    assert!(answer["will_work"] == true || !answer["why"].as_str().unwrap().is_empty(), "{answer}");
    client.wait_for("newer images", |state| state["images"]["sequence"].as_u64().unwrap() >= sequence + 2);
    let small = preview("rect:200,150,5,5", sequence).json();
    assert_eq!(small["will_work"], false);
    assert!(small["why"].as_str().unwrap().contains("25"), "{small}");
    let begun = client.post("preview", &json!({ "sequence": sequence + 2 }).to_string());
    assert_eq!((begun.status, begun.body.as_str()), (200, "{}"), "drawing begins");
    // Both pairs are kept, although the others of their time are gone.
    client.wait_for("newer images", |state| state["images"]["sequence"].as_u64().unwrap() > sequence + 60);
    assert_eq!(preview("rect:200,150,200,150", sequence).status, 200);
    assert_eq!(preview("rect:200,150,200,150", sequence + 2).status, 200);
    let gone = preview("rect:200,150,200,150", sequence + 1);
    assert_eq!((gone.status, gone.code().as_str()), (409, "PB3DP-PAN-033"), "{}", gone.body);
    assert_eq!(preview("mask:/etc/passwd", sequence).code(), "PB3DP-PAN-032");
    assert_eq!(preview("rect:600,400,100,100", sequence).code(), "PB3DP-PAN-032");
}

#[test]
fn the_epipolar_line_is_where_the_right_camera_sees_the_ray() {
    let rig = Rig::new();
    let client = rig.client();
    let line = client.get("/api/epipolar?u=320&v=240").json();
    let points = line["right_px"].as_array().unwrap();
    assert!(points.len() > 5);
    let at = |index: usize| points[index][0].as_f64().unwrap();
    assert!(at(points.len() - 1) < at(0), "nearer points lie farther left in the right image");
    assert_eq!(client.get("/api/epipolar?u=320").status, 400);
    assert_eq!(client.get("/api/epipolar?u=320&v=NaN").status, 400);
}

#[test]
fn a_new_page_gets_the_last_log_lines_and_later_ones() {
    let lines = pb3dp_panel::LogLines::default();
    let theirs = lines.clone();
    let rig = Rig::with(|config| config.log_lines = theirs, true);
    lines.push(pb3dp_geometry::MonotonicTime::from_secs_f64(0.5), "warn", "the first [PB3DP-SUP-005]");
    std::thread::sleep(Duration::from_millis(200));
    let mut page = Page::open_without_answer(&rig.client());
    let log = page.next_of("log");
    assert_eq!(log["lines"][0]["text"], "the first [PB3DP-SUP-005]");
    assert_eq!((&log["lines"][0]["level"], &log["lines"][0]["code"]), (&json!("warn"), &json!("PB3DP-SUP-005")));
    lines.push(pb3dp_geometry::MonotonicTime::from_secs_f64(0.6), "info", "the second");
    assert_eq!(page.next_of("log")["lines"][0]["text"], "the second");
}

#[test]
fn the_end_of_the_panel_ends_its_connections() {
    let mut rig = Rig::new();
    let mut page = Page::open(&rig.client());
    let start = Instant::now();
    drop(rig.panel.take());
    assert!(start.elapsed() < Duration::from_secs(2));
    while page.next().is_ok() {}
}
