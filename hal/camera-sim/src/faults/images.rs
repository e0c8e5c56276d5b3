//! Faults of a camera with images.

use std::time::Duration;

use image::RgbImage;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, FramePair, StereoCamera, StereoCameraInfo};
use pb3dp_sim::camera_faults::{AffectedCameras, CameraFault, CameraFaultKind, CameraFaults};
use pb3dp_sim::noise::{hash, unit};

use super::{Delivered, Delivery, Plan, bar};

impl Delivered for FramePair {
    fn with_content_of(&self, other: &Self) -> Self {
        Self { left: other.left.clone(), right: other.right.clone(), delivered: other.delivered.clone(), ..*self }
    }
}

/// A camera with faults. It intentionally breaks the contract of [`StereoCamera`], to test the reaction of a program.
pub struct FaultyCamera<C> {
    camera: C,
    plan: Plan,
    /// The pair delivered by the camera.
    fresh: FramePair,
    /// The previous pair.
    before: Option<FramePair>,
    delivery: Delivery<FramePair>,
}

impl<C: StereoCamera> FaultyCamera<C> {
    /// The same camera with these faults; fault times count from `began`.
    ///
    /// # Errors
    /// `Unusable` for an invalid fault.
    pub fn new(camera: C, faults: CameraFaults, began: MonotonicTime) -> Result<Self, CameraError> {
        let plan = Plan::new(faults, began)?;
        let fresh = FramePair::black(camera.info().size);
        Ok(Self { camera, plan, fresh, before: None, delivery: Delivery::new() })
    }
}

impl<C: StereoCamera> StereoCamera for FaultyCamera<C> {
    fn info(&self) -> &StereoCameraInfo {
        self.camera.info()
    }

    fn expose(&mut self, timeout: Duration) -> Option<MonotonicTime> {
        self.camera.expose(timeout)
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        self.camera.next_pair_into(&mut self.fresh, timeout)?;
        let faults = self.plan.at(self.fresh.sequence, self.fresh.exposed_at);
        let mut next = self.fresh.clone();
        for fault in &faults {
            spoil(&mut next, fault, self.before.as_ref(), self.plan.progress(fault, self.fresh.exposed_at));
        }
        if !faults.is_empty() {
            next.clear_delivered();
        }
        self.before = Some(self.fresh.clone());
        *pair = self.delivery.deliver(next, &faults)?;
        Ok(())
    }
}

/// Applies a fault to the images of a pair.
fn spoil(pair: &mut FramePair, fault: &CameraFault, before: Option<&FramePair>, progress: f64) {
    match fault.kind {
        CameraFaultKind::Torn { .. } => {
            if let Some(before) = before {
                tear(&mut pair.left, &before.left);
                tear(&mut pair.right, &before.right);
            }
        }
        CameraFaultKind::Skewed { stamped_nanos } => {
            pair.skew_nanos = stamped_nanos;
            if let Some(before) = before {
                pair.right.clone_from(&before.right);
            }
        }
        CameraFaultKind::Black { cameras } => each(pair, cameras, |_| 0),
        CameraFaultKind::Saturated { cameras } => each(pair, cameras, |_| 255),
        CameraFaultKind::Brightness { cameras, factor } => {
            let table: [u8; 256] = std::array::from_fn(|grey| (grey as f64 * factor).round().min(255.0) as u8);
            each(pair, cameras, |grey| table[usize::from(grey)]);
        }
        CameraFaultKind::Occluder { width_share, crosses } => {
            let [left, right] = bar(width_share, crosses, progress);
            hang(&mut pair.left, left);
            hang(&mut pair.right, right);
        }
        CameraFaultKind::Miscalibrated { columns_px, rows_px, roll_rad, scale } => {
            pair.right = warped(&pair.right, [columns_px, rows_px], roll_rad, scale);
        }
        CameraFaultKind::Dropped { .. }
        | CameraFaultKind::Repeated { .. }
        | CameraFaultKind::Late { .. }
        | CameraFaultKind::Frozen => (),
    }
}

/// Replaces the lower half by another image.
fn tear(image: &mut RgbImage, before: &[u8]) {
    let half = before.len() / 2;
    let bytes: &mut [u8] = image;
    bytes[half..].copy_from_slice(&before[half..]);
}

fn each(pair: &mut FramePair, cameras: AffectedCameras, of: impl Fn(u8) -> u8) {
    for (image, _) in [&mut pair.left, &mut pair.right].into_iter().zip(cameras.are()).filter(|(_, is)| *is) {
        image.iter_mut().for_each(|grey| *grey = of(*grey));
    }
}

/// Draws a bar from top to bottom, with a pattern fixed to it.
fn hang(image: &mut RgbImage, sides: [f64; 2]) {
    const PATCH_PX: u32 = 8;
    let width = f64::from(image.width());
    let [first, end] = sides.map(|side| (side * width).round());
    for (column, row, pixel) in image.enumerate_pixels_mut() {
        let from_side = f64::from(column) - first;
        if from_side >= 0.0 && f64::from(column) < end {
            let patch = hash(&[from_side as u32 / PATCH_PX, row / PATCH_PX]);
            pixel.0 = [0, 1, 2].map(|channel| (60.0 + 80.0 * unit(hash(&[patch, channel]))) as u8);
        }
    }
}

/// The image shifted, rotated and scaled about its centre, with interpolation; pixels beyond its border are black.
fn warped(image: &RgbImage, shift_px: [f64; 2], roll_rad: f64, scale: f64) -> RgbImage {
    let (width, height) = image.dimensions();
    let centre = [width, height].map(|count| (f64::from(count) - 1.0) / 2.0);
    let (s, c) = (roll_rad.sin() / scale, roll_rad.cos() / scale);
    RgbImage::from_fn(width, height, |column, row| {
        let from_centre = [f64::from(column) - centre[0] - shift_px[0], f64::from(row) - centre[1] - shift_px[1]];
        let x = centre[0] + c * from_centre[0] + s * from_centre[1];
        let y = centre[1] - s * from_centre[0] + c * from_centre[1];
        let (left, top) = (x.floor(), y.floor());
        let grey = |dx: f64, dy: f64, channel: usize| {
            let (column, row) = (left + dx, top + dy);
            let inside = column >= 0.0 && row >= 0.0 && column < f64::from(width) && row < f64::from(height);
            if inside { f64::from(image.get_pixel(column as u32, row as u32).0[channel]) } else { 0.0 }
        };
        let (fx, fy) = (x - left, y - top);
        image::Rgb([0, 1, 2].map(|channel| {
            let upper = grey(0.0, 0.0, channel) * (1.0 - fx) + grey(1.0, 0.0, channel) * fx;
            let lower = grey(0.0, 1.0, channel) * (1.0 - fx) + grey(1.0, 1.0, channel) * fx;
            (upper * (1.0 - fy) + lower * fy).round() as u8
        }))
    })
}

#[cfg(test)]
mod tests {
    use pb3dp_hal_api::DeliveredImage;

    use super::*;

    /// Pairs whose pixels encode camera, number and position.
    struct Counting {
        info: StereoCameraInfo,
        next: u64,
    }

    const PERIOD: Duration = Duration::from_millis(10);

    impl Counting {
        fn new() -> Self {
            let size = pb3dp_geometry::ImageSize { width: 40, height: 30 };
            Self { info: StereoCameraInfo { name: "counting".to_owned(), size, period: Some(PERIOD) }, next: 0 }
        }
    }

    fn pixel(side: u8, number: u64, column: u32, row: u32) -> [u8; 3] {
        [column as u8 + 1, row as u8 + 1, 10 * (number as u8 + 1) + side]
    }

    impl StereoCamera for Counting {
        fn info(&self) -> &StereoCameraInfo {
            &self.info
        }

        fn next_pair_into(&mut self, pair: &mut FramePair, _: Duration) -> Result<(), CameraError> {
            let number = self.next;
            self.next += 1;
            let image = |side| RgbImage::from_fn(40, 30, |column, row| image::Rgb(pixel(side, number, column, row)));
            (pair.sequence, pair.exposed_at, pair.skew_nanos) =
                (number, MonotonicTime::ZERO + PERIOD * number as u32, 0);
            (pair.left, pair.right) = (image(0), image(1));
            let delivered = DeliveredImage { encoding: "mono8", bytes: vec![number as u8] };
            pair.delivered = [delivered.clone(), delivered];
            Ok(())
        }
    }

    /// The pair with number 2, which alone has this fault.
    fn third(kind: CameraFaultKind) -> FramePair {
        let list = vec![CameraFault { kind, from: PERIOD * 2, until: PERIOD * 3 }];
        let faults = CameraFaults { list, seed: 1 };
        let mut camera = FaultyCamera::new(Counting::new(), faults, MonotonicTime::ZERO).unwrap();
        let mut clean = Counting::new();
        for _ in 0..2 {
            let (given, expected) = (camera.next_pair(PERIOD).unwrap(), clean.next_pair(PERIOD).unwrap());
            assert_eq!((given.sequence, given.left), (expected.sequence, expected.left));
            assert_eq!(given.delivered, expected.delivered);
        }
        let pair = camera.next_pair(PERIOD).unwrap();
        assert_eq!(camera.next_pair(PERIOD).unwrap().left.get_pixel(5, 5).0, pixel(0, 3, 5, 5));
        pair
    }

    fn pixels(pair: &FramePair, column: u32, row: u32) -> [[u8; 3]; 2] {
        [&pair.left, &pair.right].map(|image| image.get_pixel(column, row).0)
    }

    #[test]
    fn images_suffer_as_they_should() {
        let torn = third(CameraFaultKind::Torn { share: 1.0 });
        assert_eq!(pixels(&torn, 7, 14), [pixel(0, 2, 7, 14), pixel(1, 2, 7, 14)]);
        assert_eq!(pixels(&torn, 7, 15), [pixel(0, 1, 7, 15), pixel(1, 1, 7, 15)]);
        let skewed = third(CameraFaultKind::Skewed { stamped_nanos: -7 });
        assert_eq!(pixels(&skewed, 3, 4), [pixel(0, 2, 3, 4), pixel(1, 1, 3, 4)]);
        assert_eq!((skewed.skew_nanos, skewed.sequence), (-7, 2));
        let frozen = third(CameraFaultKind::Frozen);
        assert_eq!(pixels(&frozen, 3, 4), [pixel(0, 1, 3, 4), pixel(1, 1, 3, 4)]);
        assert_eq!((frozen.sequence, frozen.exposed_at), (2, MonotonicTime::ZERO + PERIOD * 2));
        let again = third(CameraFaultKind::Repeated { share: 1.0, as_new: false });
        assert_eq!((again.sequence, again.exposed_at), (1, MonotonicTime::ZERO + PERIOD));
        let black = third(CameraFaultKind::Black { cameras: AffectedCameras::Right });
        assert_eq!(pixels(&black, 3, 4), [pixel(0, 2, 3, 4), [0; 3]]);
        let white = third(CameraFaultKind::Saturated { cameras: AffectedCameras::Left });
        assert_eq!(pixels(&white, 3, 4), [[255; 3], pixel(1, 2, 3, 4)]);
        assert!(
            [&torn, &skewed, &black, &white]
                .iter()
                .all(|pair| pair.delivered.iter().all(|image| image.bytes.is_empty()))
        );
        let bright = third(CameraFaultKind::Brightness { cameras: AffectedCameras::Both, factor: 9.0 });
        assert_eq!(pixels(&bright, 3, 4), [[36, 45, 255], [36, 45, 255]]);
    }

    #[test]
    fn a_bar_hangs_farther_left_in_the_right_image() {
        let pair = third(CameraFaultKind::Occluder { width_share: 0.2, crosses: false });
        let hidden = |image: &RgbImage, side| -> Vec<u32> {
            (0..40).filter(|&column| image.get_pixel(column, 9).0 != pixel(side, 2, column, 9)).collect()
        };
        assert_eq!(hidden(&pair.left, 0), (22..30).collect::<Vec<_>>());
        assert_eq!(hidden(&pair.right, 1), (10..18).collect::<Vec<_>>());
        assert_eq!(pair.left.get_pixel(23, 9), pair.right.get_pixel(11, 9), "the pattern moves with the bar");
    }

    #[test]
    fn a_right_image_that_is_somewhere_else() {
        let moved = |columns_px, rows_px, roll_rad, scale| {
            third(CameraFaultKind::Miscalibrated { columns_px, rows_px, roll_rad, scale })
        };
        let shifted = moved(3.0, -2.0, 0.0, 1.0);
        assert_eq!(pixels(&shifted, 13, 8), [pixel(0, 2, 13, 8), pixel(1, 2, 10, 10)]);
        assert_eq!(pixels(&shifted, 1, 8)[1], [0; 3]);
        // A quarter of a pixel to the right: red encodes the column.
        let red = |pair: &FramePair, column, row| pair.right.get_pixel(column, row).0[0];
        assert_eq!(red(&moved(0.25, 0.0, 0.0, 1.0), 20, 3), red(&moved(0.0, 0.0, 0.0, 1.0), 20, 3));
        assert_eq!(red(&moved(0.75, 0.0, 0.0, 1.0), 20, 3), red(&moved(0.0, 0.0, 0.0, 1.0), 19, 3));
        // The centre stays; a point 10 pixels to the right of it moves to 12 pixels to the right, or 10 below.
        let centre = pixel(1, 2, 19, 14);
        let near = |found: [u8; 3], expected: [u8; 3]| {
            assert!(found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 1), "{found:?} {expected:?}");
        };
        near(moved(0.0, 0.0, 0.3, 1.2).right.get_pixel(19, 14).0, centre);
        near(moved(0.0, 0.0, 0.0, 1.2).right.get_pixel(31, 14).0, pixel(1, 2, 29, 14));
        let quarter = moved(0.0, 0.0, 0.5, 1.0);
        let (s, c) = 0.5f64.sin_cos();
        let (column, row) = ((19.5 + 10.0 * c).round(), (14.5 + 10.0 * s).round());
        near(quarter.right.get_pixel(column as u32, row as u32).0, pixel(1, 2, 29, 14));
    }
}
