//! The environment: arms that obey the bytes on their lines, and cameras on the hand that show the simulated view.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use image::RgbImage;
use pb3dp_arm_pa10_emulation::line::mock_server::{MockReport, MockServer};
use pb3dp_cell::cell::SimulatedCell;
use pb3dp_geometry::frames::{Hand, Target};
use pb3dp_geometry::{Camera, Frame, ImageSize, Pinhole, Pose, StereoRig};
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::SystemClock;
use pb3dp_setup::setup::{Setup, read_setup};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Lighting, PoseSource, Scene, ScenePoses};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::{self, TargetConfig};
use pb3dp_wiring::arm::far_side;

use crate::images::Output;
use crate::lines::far_end;
use crate::setup::{Devices, HERE};

/// Smaller motions are not rendered again: a hundredth of a pixel.
const VISIBLE_M: f64 = 1e-5;
const VISIBLE_RAD: f64 = 2e-5;

/// Size of the rendered part of the images, around the target; the rest is background. Rendering whole images takes this
/// computer longer than the frame period.
const WINDOW: ImageSize = ImageSize { width: 208, height: 160 };

/// Position of that part in the left and in the right view: x and y of the upper left pixel.
const CORNERS: [(u32, u32); 2] = [(290, 160), (142, 160)];

/// Interval of the search for a missing output.
const AGAIN: Duration = Duration::from_millis(10);

/// The environment of the program.
pub struct World {
    arms: [MockServer; 2],
    cell: SimulatedCell,
    /// The marked region and the target have the same centre.
    hand_wanted_from_target: Pose<Hand, Target>,
    clock: Arc<dyn Clock>,
    painter: Option<JoinHandle<()>>,
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    is_over: AtomicBool,
    shown: AtomicU64,
}

impl World {
    /// Arms at the start of the setup, at the far ends of its lines.
    pub fn start(devices: Devices) -> Result<Self, Box<dyn Error>> {
        let setup = read_setup(Path::new(HERE))?;
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let (vs, vs_site) = far_side(("vs", &setup.rig.arms.vs), far_end(&setup.rig.arms.vs, "FAR1")?, &clock)?;
        let (tc, tc_site) = far_side(("tc", &setup.rig.arms.tc), far_end(&setup.rig.arms.tc, "FAR2")?, &clock)?;
        let cell = SimulatedCell {
            vs: vs_site,
            tc: tc_site,
            flange_from_hand: setup.controller.flange_from_hand,
            hand_from_cam_left: setup.controller.hand_from_cam_left,
            flange_from_target: setup.rig.flange_from_target,
            free_target: None,
            scene: None,
        };
        let shared = Arc::new(Shared::default());
        let painter = Painter::new(devices, &setup, cell.clone(), Arc::clone(&clock), Arc::clone(&shared))?;
        let painter = Some(std::thread::Builder::new().name("painter".to_owned()).spawn(|| painter.paint())?);
        let hand_wanted_from_target = setup.controller.model_from_hand_desired.inverse().relabel();
        Ok(Self { arms: [vs, tc], cell, hand_wanted_from_target, clock, painter, shared })
    }

    /// State of the arms.
    pub fn arms(&self) -> [MockReport; 2] {
        [self.arms[0].report(), self.arms[1].report()]
    }

    /// True error of the hand relative to its desired pose: metres, and degrees.
    pub fn hand_off(&self) -> (f64, f64) {
        let now = self.clock.now();
        let hand_from_target = self.cell.world_from_hand_at(now).inverse() * self.cell.world_from_target_at(now);
        let off = self.hand_wanted_from_target.inverse() * hand_from_target;
        (off.translation_m().norm(), off.rotation_angle_rad().to_degrees())
    }

    /// Number of stereo pairs that were shown.
    pub fn shown(&self) -> u64 {
        self.shared.shown.load(Ordering::SeqCst)
    }
}

impl Drop for World {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::SeqCst);
        if let Some(painter) = self.painter.take() {
            painter.join().ok();
        }
    }
}

/// Renders the camera images after each motion.
struct Painter {
    renderer: StereoRenderer,
    outputs: Vec<Output>,
    /// Of each view: its output, and the position of its rendered part there.
    places: [(usize, (u32, u32)); 2],
    cell: SimulatedCell,
    clock: Arc<dyn Clock>,
    shared: Arc<Shared>,
}

impl Painter {
    fn new(
        devices: Devices,
        setup: &Setup,
        cell: SimulatedCell,
        clock: Arc<dyn Clock>,
        shared: Arc<Shared>,
    ) -> Result<Self, Box<dyn Error>> {
        // Without a room and without noise, which would take this computer long.
        let (target, parts) = targets::build(&TargetConfig::card(), 1)?;
        let scene = Scene::from_parts(parts, target, Lighting::default())?;
        let sensor = SensorConfig { right: SensorConfig::default().right, ..SensorConfig::IDEAL };
        let renderer = StereoRenderer::new(scene, windows(&setup.rig.stereo)?, &sensor, 1)?;
        let find = |number| Output::find(devices, number);
        let outputs = (0..devices.buses().len()).map(find).collect::<Result<_, _>>()?;
        let [left, (x, y)] = CORNERS;
        let places = match devices {
            Devices::Two => [(0, left), (1, (x, y))],
            Devices::One => [(0, left), (0, (setup.rig.stereo.left().size().width + x, y))],
        };
        Ok(Self { renderer, outputs, places, cell, clock, shared })
    }

    fn paint(mut self) {
        let ImageSize { width, height } = WINDOW;
        let mut images = [RgbImage::new(width, height), RgbImage::new(width, height)];
        let mut drawn = None;
        while !self.shared.is_over.load(Ordering::SeqCst) {
            self.outputs.iter_mut().for_each(Output::wait);
            let now = self.clock.now();
            let poses = self.cell.poses_at(now);
            if drawn.is_none_or(|drawn| is_visible(&drawn, &poses)) {
                let [left, right] = &mut images;
                self.renderer.render_pair(&poses, 0, left, right);
                for (image, (output, corner)) in images.iter().zip(self.places) {
                    self.outputs[output].draw(image, corner);
                }
                drawn = Some(poses);
            }
            let (output, corner) = self.places[1];
            self.outputs[output].flicker(corner);
            let shown: Vec<_> = self.outputs.iter_mut().map(Output::show).collect();
            let is_shown = shown.iter().all(Result::is_ok);
            self.shared.shown.fetch_add(u64::from(is_shown), Ordering::SeqCst);
            if !is_shown {
                self.clock.sleep_until(now + AGAIN);
            }
        }
    }
}

/// The rendered parts of both images.
fn windows(rig: &StereoRig) -> Result<StereoRig, Box<dyn Error>> {
    let window = |camera: &Camera, (x, y): (u32, u32)| {
        let whole = *camera.pinhole();
        let part = Pinhole { cx: whole.cx - f64::from(x), cy: whole.cy - f64::from(y), ..whole };
        Camera::new(WINDOW, part, *camera.distortion())
    };
    let (left, right) = (window(rig.left(), CORNERS[0])?, window(rig.right(), CORNERS[1])?);
    Ok(StereoRig::new(left, right, *rig.cam_right_from_cam_left())?)
}

/// Whether the difference is visible.
fn is_visible(before: &ScenePoses, now: &ScenePoses) -> bool {
    fn differ<A: Frame, B: Frame>(before: &Pose<A, B>, now: &Pose<A, B>) -> bool {
        let motion = before.inverse() * *now;
        motion.translation_m().norm() > VISIBLE_M || motion.rotation_angle_rad() > VISIBLE_RAD
    }
    differ(&before.world_from_cam_left, &now.world_from_cam_left)
        || differ(&before.world_from_target, &now.world_from_target)
}
