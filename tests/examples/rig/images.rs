//! The camera images: `vivid` has video outputs, which can be looped to its inputs.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::{fs, io};

use image::RgbImage;
use pb3dp_camera_v4l2::linux::Linux;
use pb3dp_camera_v4l2::names;

use crate::outputs::{Scan, Stream, set_hdmi};
use crate::setup::{Devices, LOOP, OSD, control, name};
use crate::system;

/// Two devices with video input and output. Their inputs show a part of the output image without scaling.
const VIVID_TWO: &str = "n_devs=2 node_types=0x101,0x101 ccs_cap_mode=1,1";

/// One such device, whose only input and only output are HDMI: images of television are too narrow for two views.
const VIVID_ONE: &str =
    "n_devs=1 node_types=0x101 ccs_cap_mode=1 num_inputs=1 input_types=3 num_outputs=1 output_types=1";

/// Folder in which the kernel lists video devices.
const NODES: &str = "/sys/class/video4linux";

/// Width and height of a frame of an output, YUYV: PAL by default, or the HDMI mode that [`prepare`] sets.
const PAL: (usize, usize) = (720, 576);
const HDMI: (usize, usize) = (1280, 720);

/// The upper left corner shows the time and the number of each image (`vivid`'s menu "Counters Only"): no two images are the
/// same, as with the noise of real cameras. The program takes a camera that delivers one image twice for frozen. If both views are in
/// one image, the right one has no counters: see [`Output::flicker`].
const COUNTERS: i32 = 1;

/// Creates the cameras; each shows the image of its output.
pub fn prepare(devices: Devices) -> Result<(), Box<dyn Error>> {
    match devices {
        Devices::Two => system::load("vivid", VIVID_TWO)?,
        Devices::One => {
            system::load("vivid", VIVID_ONE)?;
            set_hdmi(&node("vivid-000-vid-cap")?, &node("vivid-000-vid-out")?)?;
        }
    }
    let (looping, text) = (control(LOOP)?, control(OSD)?);
    for number in 0..devices.buses().len() {
        let (_, mut node) = names::open(&Linux, &name(number))?;
        node.set_control(looping, 1)?;
        node.set_control(text, COUNTERS)?;
    }
    Ok(())
}

/// Path of the node with this name.
fn node(wanted: &str) -> Result<PathBuf, Box<dyn Error>> {
    for entry in fs::read_dir(NODES)? {
        let folder = entry?.path();
        if fs::read_to_string(folder.join("name"))?.trim() == wanted {
            return Ok(Path::new("/dev").join(folder.file_name().ok_or("a node without a name")?));
        }
    }
    Err(format!("no {wanted} found").into())
}

/// The output of a camera.
pub struct Output {
    path: PathBuf,
    size: (usize, usize),
    scan: Scan,
    stream: Option<Stream>,
    frame: Vec<u8>,
}

impl Output {
    pub fn find(devices: Devices, number: usize) -> Result<Self, Box<dyn Error>> {
        let path = node(&format!("vivid-{number:03}-vid-out"))?;
        let (size, scan) = match devices {
            Devices::Two => (PAL, Scan::Interlaced),
            Devices::One => (HDMI, Scan::Progressive),
        };
        Ok(Self { path, size, scan, stream: None, frame: Vec::new() })
    }

    /// Puts the image into the frame, with its upper left corner at this position; the unused area gets the colour of the
    /// upper left pixel of the first image. The camera takes the upper left part of the frame.
    pub fn draw(&mut self, image: &RgbImage, (x, y): (u32, u32)) {
        let (width, pixels) = (image.width() as usize, image.as_raw());
        if self.frame.is_empty() {
            let background = [0, 1, 2, 0, 1, 2].map(|channel: usize| pixels[channel]);
            self.frame = yuyv_of(&background).repeat(self.size.0 * self.size.1 / 2);
        }
        for (row, pixels) in pixels.chunks_exact(width * 3).enumerate() {
            let line = &mut self.frame[((y as usize + row) * self.size.0 + x as usize) * 2..][..width * 2];
            for (pair, yuyv) in pixels.chunks_exact(6).zip(line.chunks_exact_mut(4)) {
                yuyv.copy_from_slice(&yuyv_of(pair));
            }
        }
    }

    /// Changes the lowest bit of a pixel: no two frames are the same.
    pub fn flicker(&mut self, (x, y): (u32, u32)) {
        if let Some(luma) = self.frame.get_mut((y as usize * self.size.0 + x as usize) * 2) {
            *luma ^= 1;
        }
    }

    /// Waits until the next frame can be queued.
    pub fn wait(&mut self) {
        if self.stream.as_mut().is_some_and(|stream| stream.wait().is_err()) {
            self.stream = None;
        }
    }

    /// Queues the frame.
    ///
    /// # Errors
    /// A disconnected camera comes back when no process has it open, including its output; the next call opens it again.
    pub fn show(&mut self) -> io::Result<()> {
        let mut stream = match self.stream.take() {
            Some(stream) => stream,
            None => {
                let mut stream = Stream::open(&self.path, self.scan)?;
                // Streaming starts with two buffers.
                stream.give(&self.frame)?;
                stream
            }
        };
        stream.give(&self.frame)?;
        self.stream = Some(stream);
        Ok(())
    }
}

/// Two pixels (ITU-R BT.601, 16 to 235), with the mean of their colours.
fn yuyv_of(pair: &[u8]) -> [u8; 4] {
    let [r0, g0, b0, r1, g1, b1] = [0, 1, 2, 3, 4, 5].map(|index| i32::from(pair[index]));
    let luma = |r: i32, g: i32, b: i32| (((66 * r + 129 * g + 25 * b + 128) >> 8) + 16) as u8;
    let (r, g, b) = (r0 + r1, g0 + g1, b0 + b1);
    let u = ((-38 * r - 74 * g + 112 * b + 256) >> 9) + 128;
    let v = ((112 * r - 94 * g - 18 * b + 256) >> 9) + 128;
    [luma(r0, g0, b0), u as u8, luma(r1, g1, b1), v as u8]
}
