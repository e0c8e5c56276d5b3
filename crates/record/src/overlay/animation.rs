//! Animated images of a sequence, as APNG: true colour, displayed by every browser, and written by the PNG encoder that the
//! program already contains.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use image::imageops::FilterType;
use image::{DynamicImage, RgbImage};

/// Size limits of an animation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnimationLimits {
    /// Maximum width, pixels; wider images are scaled down.
    pub width_max_px: u32,
    /// Maximum number of frames. If more are pushed, every other frame is dropped, so that the whole sequence is covered.
    pub frames_max: usize,
}

impl Default for AnimationLimits {
    /// 640 pixels and 60 frames: at most about 10 MB.
    fn default() -> Self {
        Self { width_max_px: 640, frames_max: 60 }
    }
}

/// Why an animation was not written.
#[derive(Debug, thiserror::Error)]
pub enum AnimationError {
    /// No frame was pushed.
    #[error("animation {} has no frames; push at least one", file.display())]
    Empty {
        /// The file.
        file: PathBuf,
    },
    /// The file cannot be written.
    #[error("animation {} cannot be written; check the folder and the free space", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The cause.
        #[source]
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// Collects frames and writes them as one animated PNG that repeats endlessly.
#[derive(Debug)]
pub struct Animation {
    limits: AnimationLimits,
    frames: Vec<(f64, RgbImage)>,
    stride: u64,
    pushed: u64,
    last_s: f64,
}

impl Animation {
    /// An empty animation.
    pub fn new(limits: AnimationLimits) -> Self {
        let limits = AnimationLimits { width_max_px: limits.width_max_px.max(1), frames_max: limits.frames_max.max(2) };
        Self { limits, frames: Vec::new(), stride: 1, pushed: 0, last_s: 0.0 }
    }

    /// Adds the image at a time (seconds, increasing). All images are scaled to the size of the first.
    pub fn push(&mut self, at_s: f64, image: &RgbImage) {
        let number = self.pushed;
        self.pushed += 1;
        self.last_s = at_s;
        if !number.is_multiple_of(self.stride) {
            return;
        }
        if self.frames.len() == self.limits.frames_max {
            self.stride *= 2;
            let mut keep = false;
            self.frames.retain(|_| {
                keep = !keep;
                keep
            });
            if !number.is_multiple_of(self.stride) {
                return;
            }
        }
        self.frames.push((at_s, self.reduced(image)));
    }

    /// Number of frames that would be written now.
    pub fn frames(&self) -> usize {
        self.frames.len()
    }

    fn reduced(&self, image: &RgbImage) -> RgbImage {
        let (width, height) = match self.frames.first() {
            Some((_, first)) => first.dimensions(),
            None => {
                let width = image.width().clamp(1, self.limits.width_max_px);
                let height = u64::from(image.height()) * u64::from(width) / u64::from(image.width().max(1));
                (width, (height as u32).max(1))
            }
        };
        let mut small = match image.dimensions() == (width, height) {
            true => image.clone(),
            // The image crate's own, optimised copy of the code.
            false => DynamicImage::from(image.clone()).resize_exact(width, height, FilterType::Triangle).into_rgb8(),
        };
        // Sensor noise in the low bits cannot be compressed; 5 bits per channel make the file three times smaller.
        small.iter_mut().for_each(|x| *x = (*x & 0xF8) | (*x >> 5));
        small
    }

    /// Writes the animation.
    /// # Errors
    /// The animation is empty or the file cannot be written.
    pub fn write(&self, file: &Path) -> Result<(), AnimationError> {
        let Some((_, first)) = self.frames.first() else {
            return Err(AnimationError::Empty { file: file.to_owned() });
        };
        self.encode(file, first.dimensions())
            .map_err(|source| AnimationError::Write { file: file.to_owned(), source: source.into() })
    }

    fn encode(&self, file: &Path, (width, height): (u32, u32)) -> Result<(), png::EncodingError> {
        let mut encoder = png::Encoder::new(BufWriter::new(File::create(file)?), width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_animated(self.frames.len() as u32, 0)?;
        let mut writer = encoder.write_header()?;
        for (i, (at_s, image)) in self.frames.iter().enumerate() {
            let until_s = self.frames.get(i + 1).map_or(self.last_shown_until_s(), |next| next.0);
            writer.set_frame_delay(delay_millis(until_s - at_s), 1000)?;
            writer.write_image_data(image.as_raw())?;
        }
        writer.finish()
    }

    /// The last frame is shown for the average duration plus one second, so that the restart is visible.
    fn last_shown_until_s(&self) -> f64 {
        let (Some(first), Some(last)) = (self.frames.first(), self.frames.last()) else { return 0.0 };
        let steps = (self.frames.len() - 1).max(1) as f64;
        last.0.max(self.last_s) + (last.0 - first.0) / steps + 1.0
    }
}

fn delay_millis(seconds: f64) -> u16 {
    (seconds * 1e3).round().clamp(10.0, f64::from(u16::MAX)) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    /// Frame delays and mean brightness of each frame, read back by the decoder.
    fn read_back(file: &Path) -> Vec<(u16, u64)> {
        let decoder = png::Decoder::new(std::io::BufReader::new(File::open(file).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let frames = reader.info().animation_control.unwrap().num_frames;
        let mut buffer = vec![0; reader.output_buffer_size().unwrap()];
        (0..frames)
            .map(|_| {
                reader.next_frame(&mut buffer).unwrap();
                let sum: u64 = buffer.iter().map(|x| u64::from(*x)).sum();
                (reader.info().frame_control.unwrap().delay_num, sum / buffer.len() as u64)
            })
            .collect()
    }

    #[test]
    fn frames_times_and_size_survive() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.png");
        let mut animation = Animation::new(AnimationLimits { width_max_px: 16, frames_max: 10 });
        for (at_s, grey) in [(5.0, 40), (5.25, 120), (5.75, 248)] {
            animation.push(at_s, &RgbImage::from_pixel(32, 24, Rgb([grey, grey, grey])));
        }
        animation.write(&file).unwrap();
        // The last frame: average 375 ms and one second.
        assert_eq!(read_back(&file), [(250, 41), (500, 123), (1375, 255)]);
        assert_eq!(image::open(&file).unwrap().into_rgb8().dimensions(), (16, 12));
    }

    #[test]
    fn many_frames_are_thinned_over_the_whole_sequence() {
        let mut animation = Animation::new(AnimationLimits { width_max_px: 4, frames_max: 8 });
        for i in 0..100 {
            animation.push(f64::from(i), &RgbImage::new(4, 3));
        }
        let times: Vec<_> = animation.frames.iter().map(|f| f.0).collect();
        assert_eq!(times, [0.0, 16.0, 32.0, 48.0, 64.0, 80.0, 96.0]);
    }

    #[test]
    fn an_empty_animation_is_refused_by_name() {
        let error = Animation::new(AnimationLimits::default()).write(Path::new("x/anim.png")).unwrap_err();
        assert!(error.to_string().contains("anim.png"));
        let mut animation = Animation::new(AnimationLimits::default());
        animation.push(0.0, &RgbImage::new(2, 2));
        let error = animation.write(Path::new("/nonexistent/anim.png")).unwrap_err();
        assert!(matches!(error, AnimationError::Write { .. }));
    }
}
