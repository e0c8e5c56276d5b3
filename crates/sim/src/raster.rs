//! The renderer: stereo pictures of a scene, with exact ground truth.
//!
//! Geometry is exact: each pixel centre (integer coordinates) has its own ray, lens distortion included, and textures are
//! read where that ray meets the surface. Surfaces are smoothed by filtered textures; pixels on an edge between surfaces are
//! sampled sixteen times. The same scene, poses, seed and frame index give the same bytes on every machine and in any order.

mod coverage;
mod fine;
mod shade;
mod triangle;
mod view;
mod visibility;

use image::RgbImage;
use nalgebra::{Isometry3, Vector2};
use pb3dp_geometry::{Camera, CameraError, ImageSize, StereoRig};

use self::coverage::EdgePixels;
use self::fine::Fine;
use self::shade::{RUN_MAX, Scratch, shade_run};
use self::triangle::{PartPose, ScreenTriangle, collect_triangles};
use self::view::View;
use self::visibility::{NOTHING, TRIANGLE_BITS, Visibility, triangle_index};
use crate::scene::{Anchor, Scene, SceneObject, ScenePart, ScenePoses};
use crate::sensor::{Developer, NoiseKey, SensorConfig, SensorError};
use crate::wide::wide;

/// Light where nothing is seen, in 256ths of a grey level.
const EMPTY: [u16; 3] = [96 << 8; 3];

/// Why a renderer could not be made or used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// A camera of the rig can not be rendered.
    #[error("the {eye} camera can not be rendered")]
    Camera {
        /// `left` or `right`.
        eye: &'static str,
        /// Why.
        #[source]
        source: CameraError,
    },
    /// The pictures of the rig differ in size.
    #[error("the left picture is {}x{} and the right one {}x{}: the simulated pair needs equal sizes",
        left.width, left.height, right.width, right.height)]
    Sizes {
        /// Size of the left picture.
        left: ImageSize,
        /// Size of the right picture.
        right: ImageSize,
    },
    /// A sensor parameter is out of its range.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// An exposure without poses.
    #[error("an exposure needs at least one moment to be rendered: it has none")]
    NoPoses,
}

/// What the left camera sees, exactly, per pixel centre.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    /// Size of the maps.
    pub size: ImageSize,
    /// Depth (z in `cam_left`), metres, row-major; 0 where nothing is seen.
    pub depth_m: Vec<f32>,
    /// The object seen.
    pub object: Vec<SceneObject>,
}

/// Renders stereo pairs of one scene with one rig.
#[derive(Clone, Debug)]
pub struct StereoRenderer {
    scene: Scene,
    rig: StereoRig,
    seed: u32,
    eyes: [Eye; 2],
    visibility: Visibility,
    edges: EdgePixels,
    triangles: Vec<ScreenTriangle>,
    light: Vec<u16>,
    exposure_sum: Vec<u32>,
    /// Blur of both lenses, and how far each camera is out of focus on top, pixels.
    lens_blur_px: f64,
    defocus_px: [f64; 2],
    /// Finer sampling, if wanted.
    fine: Option<Box<Fine>>,
}

#[derive(Clone, Debug)]
struct Eye {
    view: View,
    developer: Developer,
}

impl StereoRenderer {
    /// Prepares rendering; `seed` selects the sensor noise.
    ///
    /// # Errors
    /// A sensor parameter out of range, pictures of different size, or a camera with a pixel that has no ray.
    pub fn new(scene: Scene, rig: StereoRig, sensor: &SensorConfig, seed: u32) -> Result<Self, RenderError> {
        sensor.validate()?;
        let (left, right) = (rig.left().size(), rig.right().size());
        if left != right {
            return Err(RenderError::Sizes { left, right });
        }
        let eye = |name: &'static str, camera: &Camera, response| {
            let view = View::new(camera).map_err(|source| RenderError::Camera { eye: name, source })?;
            Ok::<_, RenderError>(Eye { developer: Developer::new(sensor, response, view.width), view })
        };
        let eyes = [eye("left", rig.left(), &sensor.left)?, eye("right", rig.right(), &sensor.right)?];
        let pixels = left.width as usize * left.height as usize;
        Ok(Self {
            scene,
            rig,
            seed,
            eyes,
            visibility: Visibility::new(pixels),
            edges: EdgePixels::default(),
            triangles: Vec::new(),
            light: vec![0; 3 * pixels],
            exposure_sum: Vec::new(),
            lens_blur_px: sensor.lens_blur_px,
            defocus_px: [0.0; 2],
            fine: None,
        })
    }

    /// The same with surfaces sampled twice as fine along either axis and blurred by the lens before the pixels integrate
    /// them, as light is: textures finer than a pixel make hardly any false patterns then. For measurements of thousandths
    /// of a pixel; takes about five times as long.
    ///
    /// # Errors
    /// A camera with a pixel that has no ray.
    pub fn with_fine_sampling(mut self) -> Result<Self, RenderError> {
        self.fine = Some(Box::new(Fine::new(&self.rig)?));
        for eye in &mut self.eyes {
            eye.developer.leave_blur_out();
        }
        Ok(self)
    }

    /// The same with cameras out of focus: standard deviation of a blur that comes on top of the sensor's
    /// [`lens_blur_px`](SensorConfig::lens_blur_px), for the left and the right camera, pixels, 0 to 4.
    ///
    /// # Errors
    /// A blur out of range.
    pub fn with_defocus_px(mut self, left: f64, right: f64) -> Result<Self, RenderError> {
        if let Some(value) = [left, right].into_iter().find(|value| !(0.0..=4.0).contains(value)) {
            return Err(SensorError { name: "defocus_px", value, min: 0.0, max: 4.0 }.into());
        }
        self.defocus_px = [left, right];
        Ok(self)
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The rig.
    pub fn rig(&self) -> &StereoRig {
        &self.rig
    }

    /// Size of both pictures.
    pub fn size(&self) -> ImageSize {
        self.rig.left().size()
    }

    /// Renders one pair, sharp: everything stands still at `poses`.
    ///
    /// `frame_index` selects the noise: use a new one for every pair. The pictures are made to size and overwritten.
    pub fn render_pair(&mut self, poses: &ScenePoses, frame_index: u64, left: &mut RgbImage, right: &mut RgbImage) {
        for (eye, picture) in [left, right].into_iter().enumerate() {
            self.render_light(eye, poses);
            self.develop(eye, frame_index, picture);
        }
    }

    /// Renders one pair with motion blur: the mean of the light at several moments of the exposure.
    ///
    /// # Errors
    /// If there is no moment.
    pub fn render_exposure(
        &mut self,
        moments: &[ScenePoses],
        frame_index: u64,
        left: &mut RgbImage,
        right: &mut RgbImage,
    ) -> Result<(), RenderError> {
        match moments {
            [] => return Err(RenderError::NoPoses),
            [poses] => self.render_pair(poses, frame_index, left, right),
            _ => {
                for (eye, picture) in [left, right].into_iter().enumerate() {
                    self.gather_light(eye, moments);
                    self.develop(eye, frame_index, picture);
                }
            }
        }
        Ok(())
    }

    /// The left picture without noise, quantisation and limits: red, green, blue, row-major, grey levels.
    ///
    /// The limit that the renderer's pictures approach with many exposures; for what depends on exact gradients.
    pub fn ideal_left(&mut self, poses: &ScenePoses, picture: &mut Vec<f32>) {
        self.render_light(0, poses);
        self.blur(0);
        self.eyes[0].developer.develop_ideal(&self.light, picture);
    }

    /// What the left camera sees at `poses`: depth and object of every pixel centre.
    pub fn ground_truth(&mut self, poses: &ScenePoses) -> GroundTruth {
        self.see(0, poses);
        let depth_m = self.visibility.inv_z.iter().map(|&inv_z| if inv_z > 0.0 { 1.0 / inv_z } else { 0.0 }).collect();
        let object = self.visibility.seen.iter().map(|&seen| self.object(seen)).collect();
        GroundTruth { size: self.size(), depth_m, object }
    }

    /// The target's outline in the left picture, pixels, lens distortion included: the region that an operator would draw.
    ///
    /// `None` if a point of it is not in front of the camera. Points may lie outside the picture.
    pub fn target_outline_px(&self, poses: &ScenePoses) -> Option<Vec<Vector2<f64>>> {
        let cam_left_from_target = poses.world_from_cam_left.inverse() * poses.world_from_target;
        let outline = &self.scene.target().outline_m;
        outline.iter().map(|point| self.rig.left().project(&cam_left_from_target.transform_point(point))).collect()
    }

    fn object(&self, seen: u32) -> SceneObject {
        if seen == NOTHING { SceneObject::Nothing } else { self.scene.parts()[(seen >> TRIANGLE_BITS) as usize].object }
    }

    /// Finds the visible triangles of one eye.
    fn see(&mut self, eye: usize, poses: &ScenePoses) {
        self.collect(eye, poses, None);
        self.visibility.draw(&self.eyes[eye].view, &self.triangles);
    }

    /// Collects the triangles that one eye may see, for its own view or a finer one.
    fn collect(&mut self, eye: usize, poses: &ScenePoses, view: Option<&View>) {
        let cam_from_world = self.cam_from_world(eye, poses);
        let view = view.unwrap_or(&self.eyes[eye].view);
        self.triangles.clear();
        for (index, part) in self.scene.parts().iter().enumerate() {
            let world_from_part = match part.anchor {
                Anchor::World => Isometry3::identity(),
                Anchor::Target => *poses.world_from_target.isometry(),
            };
            let pose = PartPose {
                cam_from_part: cam_from_world * world_from_part,
                world_from_part,
                world_from_cam: cam_from_world.inverse(),
            };
            collect_triangles(part, index as u16, &pose, self.scene.lighting(), view, &mut self.triangles);
        }
    }

    fn cam_from_world(&self, eye: usize, poses: &ScenePoses) -> Isometry3<f64> {
        let cam_left_from_world = *poses.world_from_cam_left.inverse().isometry();
        if eye == 0 { cam_left_from_world } else { self.rig.cam_right_from_cam_left().isometry() * cam_left_from_world }
    }

    /// Renders the light on one sensor.
    fn render_light(&mut self, eye: usize, poses: &ScenePoses) {
        if let Some(mut fine) = self.fine.take() {
            let (view, visibility, light) = fine.parts(eye);
            self.collect(eye, poses, Some(view));
            visibility.draw(view, &self.triangles);
            shade(&mut self.edges, view, visibility, (self.scene.parts(), &self.triangles), light);
            fine.integrate(self.lens_blur_px.hypot(self.defocus_px[eye]), &mut self.light);
            self.fine = Some(fine);
            return;
        }
        self.see(eye, poses);
        let surfaces = (self.scene.parts(), self.triangles.as_slice());
        shade(&mut self.edges, &self.eyes[eye].view, &self.visibility, surfaces, &mut self.light);
    }

    /// Renders the mean light of several moments.
    fn gather_light(&mut self, eye: usize, moments: &[ScenePoses]) {
        self.exposure_sum.clear();
        self.exposure_sum.resize(self.light.len(), 0);
        for poses in moments {
            self.render_light(eye, poses);
            for (sum, &light) in self.exposure_sum.iter_mut().zip(&self.light) {
                *sum += u32::from(light);
            }
        }
        let count = moments.len() as u32;
        for (light, &sum) in self.light.iter_mut().zip(&self.exposure_sum) {
            *light = ((sum + count / 2) / count) as u16;
        }
    }

    fn blur(&mut self, eye: usize) {
        if self.defocus_px[eye] > 0.0 && self.fine.is_none() {
            self.eyes[eye].developer.defocus(&mut self.light, self.defocus_px[eye]);
        }
    }

    fn develop(&mut self, eye: usize, frame_index: u64, picture: &mut RgbImage) {
        self.blur(eye);
        let size = self.size();
        if picture.dimensions() != (size.width, size.height) {
            *picture = RgbImage::new(size.width, size.height);
        }
        let key = NoiseKey { seed: self.seed, frame_index, eye: eye as u32 };
        self.eyes[eye].developer.develop(&self.light, &key, picture);
    }
}

/// Shades everything that one view sees.
fn shade(
    edges: &mut EdgePixels,
    view: &View,
    visibility: &Visibility,
    (parts, triangles): (&[ScenePart], &[ScreenTriangle]),
    light: &mut [u16],
) {
    edges.resolve(view, visibility, triangles);
    let seen = Seen { view, visibility, parts, triangles };
    shade_surfaces(&seen, light);
    edges.shade(&seen, light);
}

/// What is shaded: the parts of the scene and their triangles as seen by one camera.
struct Seen<'a> {
    view: &'a View,
    visibility: &'a Visibility,
    parts: &'a [ScenePart],
    triangles: &'a [ScreenTriangle],
}

wide! {
    /// Shades every pixel at its centre, in runs of pixels that see the same triangle.
    fn shade_surfaces(seen: &Seen<'_>, light: &mut [u16]) = shade_surfaces_kernel;
}

#[inline(always)]
fn shade_surfaces_kernel(seen: &Seen<'_>, light: &mut [u16]) {
    let view = seen.view;
    let mut scratch = Scratch::new();
    for row in 0..view.height {
        let start = row * view.width;
        let codes = &seen.visibility.seen[start..start + view.width];
        let mut column = 0;
        while column < view.width {
            let code = codes[column];
            let run = codes[column..].iter().take(RUN_MAX).take_while(|&&other| other == code).count();
            let pixels = start + column..start + column + run;
            let out = &mut light[3 * pixels.start..3 * pixels.end];
            if code == NOTHING {
                out.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&EMPTY));
            } else {
                let triangle = &seen.triangles[triangle_index(code)];
                let texture = &seen.parts[usize::from(triangle.part)].texture;
                let rays = (&view.ray_x[pixels.clone()], &view.ray_y[pixels]);
                shade_run(triangle, texture, view.pixel_size, rays, &mut scratch, out);
            }
            column += run;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SceneConfig;
    use crate::targets::TargetConfig;
    use crate::wide::tests::without_avx2;
    use nalgebra::Vector3;
    use pb3dp_geometry::{Distortion, Pinhole, Pose};

    #[test]
    fn both_versions_of_the_kernels_give_the_same_bytes() {
        let camera = |cx: f64| {
            let pinhole = Pinhole { fx: 231.0, fy: 229.0, cx, cy: 73.0 };
            let distortion = Distortion::BrownConrady5 { coefficients: [-0.2, 0.1, 0.001, -0.002, 0.0] };
            // A width that is no multiple of any vector, so that remainders are used.
            Camera::new(ImageSize { width: 205, height: 147 }, pinhole, distortion).unwrap()
        };
        let rig =
            StereoRig::new(camera(99.0), camera(103.0), Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).unwrap();
        let scene = Scene::build(&SceneConfig::new(TargetConfig::crab(0.02))).unwrap();
        let mut renderer = StereoRenderer::new(scene, rig, &SensorConfig::default(), 4).unwrap();
        let turn = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.2, -0.3, 0.1));
        let poses = ScenePoses {
            world_from_cam_left: Pose::from_translation(Vector3::new(0.0, 0.0, 0.1)),
            world_from_target: Pose::from_parts(Vector3::new(0.04, 0.01, 0.6), turn),
        };
        let mut pair = || {
            let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
            renderer.render_pair(&poses, 8, &mut left, &mut right);
            (left, right)
        };
        let widest = pair();
        let plain = without_avx2(pair);
        assert!(widest == plain);
    }
}
