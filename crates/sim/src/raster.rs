//! The renderer: stereo images of a scene, with exact ground truth.
//!
//! Geometry is exact: each pixel centre (integer coordinates) has its own ray, lens distortion included, and textures are sampled
//! where that ray meets the surface. Surfaces are anti-aliased by filtered textures; pixels on an edge between surfaces are
//! sampled sixteen times. The same scene, poses, seed and frame index give the same bytes on every machine and in any order.

mod coverage;
mod exposure;
mod fine;
mod rendered_camera;
mod shade;
mod triangle;
mod view;
mod visibility;

use image::RgbImage;
use nalgebra::{Isometry3, Matrix3, Vector2, Vector3};
use pb3dp_computing::wide;
use pb3dp_geometry::{Camera, CameraError, ImageSize, StereoRig};

use self::coverage::EdgePixels;
pub use self::exposure::{Exposure, Shutter};
use self::rendered_camera::RenderedCamera;
use self::shade::{RUN_MAX, Scratch, shade_run};
use self::triangle::ScreenTriangle;
use self::view::View;
use self::visibility::{NOTHING, TRIANGLE_BITS, Visibility, triangle_index};
use crate::scene::{Scene, ScenePoses};
use crate::sensor::{CameraResponse, NoiseKey, SensorConfig, SensorError};
use crate::targets::part::{SceneObject, ScenePart};
use crate::wide::kernels;

/// Background light where no surface is visible, in 256ths of a grey level.
const EMPTY: [u16; 3] = [96 << 8; 3];

/// Errors of the renderer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// A camera of the rig cannot be rendered.
    #[error("the {side} camera cannot be rendered")]
    Camera {
        /// `left` or `right`.
        side: &'static str,
        /// The reason.
        #[source]
        source: CameraError,
    },
    /// The images of the rig differ in size.
    #[error("the left image is {}x{} and the right image {}x{}; the simulated pair needs equal sizes",
        left.width, left.height, right.width, right.height)]
    Sizes {
        /// Size of the left image.
        left: ImageSize,
        /// Size of the right image.
        right: ImageSize,
    },
    /// A sensor parameter is out of its range.
    #[error(transparent)]
    Sensor(#[from] SensorError),
    /// An exposure without poses.
    #[error("the exposure has no poses; at least one is needed")]
    NoPoses,
    /// A rolling shutter whose last row does not follow its first one.
    #[error("the rolling shutter ends at row {last}, but begins at row {first}; set a later row")]
    Rows {
        /// Row of the first moment.
        first: i32,
        /// Row of the last moment.
        last: i32,
    },
}

/// Exact ground truth of the left camera, per pixel centre.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundTruth {
    /// Size of the maps.
    pub size: ImageSize,
    /// Depth (z in `cam_left`), metres, row-major; 0 where no surface is visible.
    pub depth_m: Vec<f32>,
    /// The visible object.
    pub object: Vec<SceneObject>,
}

impl GroundTruth {
    /// Pixels that show one of these objects, `(column, row)`, with their depth in metres.
    pub fn pixels<'a>(&'a self, objects: &'a [SceneObject]) -> impl Iterator<Item = ([u32; 2], f64)> + 'a {
        let pixels = self.object.iter().zip(&self.depth_m).zip(0..);
        let shown = pixels.filter(|((object, _), _)| objects.contains(object));
        shown.map(|((_, depth_m), index)| ([index % self.size.width, index / self.size.width], f64::from(*depth_m)))
    }

    /// The plane of the visible target in a region: [`Self::plane`] through its pixels there; through those of the panel behind it, which the same arm
    /// carries, if the target has less than a third of the region.
    pub fn plane_in(&self, camera: &Camera, is_inside: impl Fn([u32; 2]) -> bool) -> Option<Vector3<f64>> {
        const ALL: [SceneObject; 4] =
            [SceneObject::Target, SceneObject::Backdrop, SceneObject::Room, SceneObject::Nothing];
        let inside = |objects: &'static [SceneObject]| self.pixels(objects).filter(|(pixel, _)| is_inside(*pixel));
        let is_target = 3 * inside(&ALL[..1]).count() >= inside(&ALL).count();
        Self::plane(camera, inside(if is_target { &ALL[..1] } else { &ALL[1..2] }))
    }

    /// The inverse-depth plane `q` (1/depth on a ray `d` with third component 1 is `q . d`, 1/m) of robust least squares through pixels with a
    /// depth, metres: with Tukey's weights (1 - (r / c)^2)^2, c = 4.685 standard deviations by the median of the residuals |r|, so that it is the
    /// plane of least squares of a curved surface, and the larger one of two faces. The inverse depth of a pixel is its disparity but for a factor, so
    /// this is the plane that fits a stereo pair best. `None` if the pixels do not span a plane.
    pub fn plane(camera: &Camera, pixels: impl Iterator<Item = ([u32; 2], f64)>) -> Option<Vector3<f64>> {
        const ROUNDS: usize = 20;
        let visible =
            pixels.map(|(pixel, depth_m)| Some((camera.unproject(&pixel.map(f64::from).into()).ok()?, 1.0 / depth_m)));
        let visible: Vec<(Vector3<f64>, f64)> = visible.collect::<Option<_>>()?;
        let fitted = |weight: &dyn Fn(f64) -> f64, plane: &Vector3<f64>| {
            let (mut information, mut pull) = (Matrix3::zeros(), Vector3::zeros());
            for (ray, inverse_depth) in &visible {
                let weight = weight(inverse_depth - plane.dot(ray));
                information += ray * ray.transpose() * weight;
                pull += ray * (inverse_depth * weight);
            }
            Some(information.try_inverse()? * pull)
        };
        let mut plane = fitted(&|_| 1.0, &Vector3::zeros())?;
        for _ in 0..ROUNDS {
            let mut residuals: Vec<f64> =
                visible.iter().map(|(ray, inverse)| (inverse - plane.dot(ray)).abs()).collect();
            let middle = residuals.len() / 2;
            let limit = 4.685 * 1.4826 * *residuals.select_nth_unstable_by(middle, f64::total_cmp).1;
            // Of a plane all residuals are rounding.
            let limit = limit.max(1e-9);
            plane = fitted(&|residual| (1.0 - (residual / limit).powi(2)).max(0.0).powi(2), &plane)?;
        }
        Some(plane)
    }
}

/// A function that calls both closures once, in any order or in parallel.
pub type RunBoth = fn(&mut (dyn FnMut() + Send), &mut (dyn FnMut() + Send));

/// Renders stereo pairs of one scene with one rig.
#[derive(Clone, Debug)]
pub struct StereoRenderer {
    scene: Scene,
    rig: StereoRig,
    seed: u32,
    cameras: [RenderedCamera; 2],
    run_both: RunBoth,
}

impl StereoRenderer {
    /// Prepares rendering; `seed` selects the sensor noise.
    ///
    /// # Errors
    /// A sensor parameter out of range, images of different size, or a camera with a pixel that has no ray.
    pub fn new(scene: Scene, rig: StereoRig, sensor: &SensorConfig, seed: u32) -> Result<Self, RenderError> {
        sensor.validate()?;
        let (left, right) = (rig.left().size(), rig.right().size());
        if left != right {
            return Err(RenderError::Sizes { left, right });
        }
        let cam_right_from_cam_left = *rig.cam_right_from_cam_left().isometry();
        let cameras = [
            RenderedCamera::new("left", rig.left(), Isometry3::identity(), sensor, &sensor.left)?,
            RenderedCamera::new("right", rig.right(), cam_right_from_cam_left, sensor, &sensor.right)?,
        ];
        let run_both: RunBoth = |left, right| {
            left();
            right();
        };
        Ok(Self { scene, rig, seed, cameras, run_both })
    }

    /// Renders both images of a pair through `run_both`; the images do not depend on the order of the calls.
    #[must_use]
    pub fn with_run_both(mut self, run_both: RunBoth) -> Self {
        self.run_both = run_both;
        self
    }

    /// Samples surfaces twice as finely along both axes and applies the lens blur before the pixel integration, as in a real
    /// camera. Textures finer than a pixel then cause hardly any aliasing. For measurements of thousandths of a pixel; about five
    /// times slower.
    ///
    /// # Errors
    /// A camera with a pixel that has no ray.
    pub fn with_fine_sampling(mut self) -> Result<Self, RenderError> {
        let [left, right] = &mut self.cameras;
        left.sample_finely("left", self.rig.left())?;
        right.sample_finely("right", self.rig.right())?;
        Ok(self)
    }

    /// Defocuses the cameras: standard deviation of a blur added to the sensor's [`lens_blur_px`](SensorConfig::lens_blur_px),
    /// for the left and the right camera, pixels, 0 to 4.
    ///
    /// # Errors
    /// A blur out of range.
    pub fn with_defocus_px(mut self, left: f64, right: f64) -> Result<Self, RenderError> {
        if let Some(value) = [left, right].into_iter().find(|value| !(0.0..=4.0).contains(value)) {
            return Err(SensorError { name: "defocus_px", value, min: 0.0, max: 4.0 }.into());
        }
        for (side, defocus_px) in self.cameras.iter_mut().zip([left, right]) {
            side.defocus(defocus_px);
        }
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

    /// Size of both images.
    pub fn size(&self) -> ImageSize {
        self.rig.left().size()
    }

    /// Renders one pair without motion blur, with everything stationary at `poses`.
    ///
    /// `frame_index` selects the noise: use a new one for every pair. The images are resized and overwritten.
    pub fn render_pair(&mut self, poses: &ScenePoses, frame_index: u64, left: &mut RgbImage, right: &mut RgbImage) {
        self.expose([Exposure::global(std::slice::from_ref(poses)); 2], frame_index, left, right);
    }

    /// Renders one pair with motion blur: the mean of the light at several times during the exposure.
    ///
    /// # Errors
    /// No pose is given.
    pub fn render_exposure(
        &mut self,
        moments: &[ScenePoses],
        frame_index: u64,
        left: &mut RgbImage,
        right: &mut RgbImage,
    ) -> Result<(), RenderError> {
        self.render_exposures([Exposure::global(moments); 2], frame_index, left, right)
    }

    /// Renders one pair whose cameras, left and right, expose at their own moments: cameras that are not synchronous, or
    /// that read row after row.
    ///
    /// # Errors
    /// A camera without poses, or a rolling shutter with rows in the wrong order.
    pub fn render_exposures(
        &mut self,
        exposures: [Exposure<'_>; 2],
        frame_index: u64,
        left: &mut RgbImage,
        right: &mut RgbImage,
    ) -> Result<(), RenderError> {
        exposures.iter().try_for_each(Exposure::check)?;
        self.expose(exposures, frame_index, left, right);
        Ok(())
    }

    /// Changes the responses of the cameras, left and right, for the following pairs.
    ///
    /// # Errors
    /// A number out of its range.
    pub fn set_responses(&mut self, [left, right]: [CameraResponse; 2]) -> Result<(), SensorError> {
        SensorConfig { left, right, ..SensorConfig::IDEAL }.validate()?;
        for (camera, response) in self.cameras.iter_mut().zip([left, right]) {
            camera.set_response(&response);
        }
        Ok(())
    }

    fn expose(&mut self, exposures: [Exposure<'_>; 2], frame_index: u64, left: &mut RgbImage, right: &mut RgbImage) {
        let (scene, size, seed) = (&self.scene, self.rig.left().size(), self.seed);
        let [left_side, right_side] = &mut self.cameras;
        let key = |side| NoiseKey { seed, frame_index, side };
        (self.run_both)(&mut || left_side.expose(scene, &exposures[0], &key(0), size, left), &mut || {
            right_side.expose(scene, &exposures[1], &key(1), size, right);
        });
    }

    /// The left image without noise, quantisation and clipping: red, green, blue, row-major, grey levels.
    ///
    /// It is the limit of the mean of many exposures; use it where exact gradients matter.
    pub fn ideal_left(&mut self, poses: &ScenePoses, image: &mut Vec<f32>) {
        self.cameras[0].ideal(&self.scene, poses, image);
    }

    /// Depth and object of every pixel centre of the left camera at `poses`.
    pub fn ground_truth(&mut self, poses: &ScenePoses) -> GroundTruth {
        let visible = self.cameras[0].see(&self.scene, poses);
        let depth_m = visible.inv_z.iter().map(|&inv_z| if inv_z > 0.0 { 1.0 / inv_z } else { 0.0 }).collect();
        let object = visible.visible.iter().map(|&visible| object_of(&self.scene, visible)).collect();
        GroundTruth { size: self.rig.left().size(), depth_m, object }
    }

    /// The target's outline in the left image, pixels, lens distortion included: the region that an operator would draw.
    ///
    /// `None` if a point of it is not in front of the camera. Points may lie outside the image.
    pub fn target_outline_px(&self, poses: &ScenePoses) -> Option<Vec<Vector2<f64>>> {
        let cam_left_from_target = poses.world_from_cam_left.inverse() * poses.world_from_target;
        let outline = &self.scene.target().outline_m;
        outline.iter().map(|point| self.rig.left().project(&cam_left_from_target.transform_point(point))).collect()
    }
}

fn object_of(scene: &Scene, visible: u32) -> SceneObject {
    if visible == NOTHING { SceneObject::Nothing } else { scene.parts()[(visible >> TRIANGLE_BITS) as usize].object }
}

/// Shades everything visible in one view.
fn shade(
    edges: &mut EdgePixels,
    view: &View,
    visibility: &Visibility,
    (parts, triangles): (&[ScenePart], &[ScreenTriangle]),
    light: &mut [u16],
) {
    edges.resolve(view, visibility, triangles);
    let visible = ShadingInput { view, visibility, parts, triangles };
    shade_surfaces(kernels(), &visible, light);
    edges.shade(&visible, light);
}

/// Input of the shading: the parts of the scene and their triangles as seen by one camera.
struct ShadingInput<'a> {
    view: &'a View,
    visibility: &'a Visibility,
    parts: &'a [ScenePart],
    triangles: &'a [ScreenTriangle],
}

wide! {
    /// Shades every pixel at its centre, in runs of pixels that see the same triangle.
    fn shade_surfaces(visible: &ShadingInput<'_>, light: &mut [u16]) = shade_surfaces_kernel;
}

#[inline(always)]
fn shade_surfaces_kernel(visible: &ShadingInput<'_>, light: &mut [u16]) {
    let view = visible.view;
    let mut scratch = Scratch::new();
    for row in 0..view.height {
        let start = row * view.width;
        let codes = &visible.visibility.visible[start..start + view.width];
        let mut column = 0;
        while column < view.width {
            let code = codes[column];
            let run = codes[column..].iter().take(RUN_MAX).take_while(|&&other| other == code).count();
            let pixels = start + column..start + column + run;
            let out = &mut light[3 * pixels.start..3 * pixels.end];
            if code == NOTHING {
                out.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&EMPTY));
            } else {
                let triangle = &visible.triangles[triangle_index(code)];
                let texture = &visible.parts[usize::from(triangle.part)].texture;
                let rays = (&view.ray_x[pixels.clone()], &view.ray_y[pixels]);
                shade_run(triangle, texture, view.pixel_size, rays, &mut scratch, out);
            }
            column += run;
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use pb3dp_computing::cpu::{KernelSet, Kernels};
    use pb3dp_geometry::{Camera, Distortion, Pinhole, Pose};

    use super::*;
    use crate::scene::SceneConfig;
    use crate::targets::TargetConfig;
    use crate::wide::tests::with;

    #[test]
    fn all_versions_of_the_kernels_and_any_order_of_the_eyes_give_the_same_bytes() {
        let camera = |cx: f64| {
            let pinhole = Pinhole { fx: 231.0, fy: 229.0, cx, cy: 73.0 };
            let distortion = Distortion::BrownConrady5 { coefficients: [-0.2, 0.1, 0.001, -0.002, 0.0] };
            // A width that is not a multiple of any vector width, so that remainders are tested.
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
        let pair = |renderer: &mut StereoRenderer| {
            let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
            renderer.render_pair(&poses, 8, &mut left, &mut right);
            (left, right)
        };
        let widest = pair(&mut renderer);
        assert!(widest.0 != widest.1);
        if !KernelSet::Avx2.is_available() {
            pb3dp_test_support::not_checked(
                "raster::tests::all_versions_of_the_kernels_and_any_order_of_the_eyes_give_the_same_bytes",
                "this processor has no AVX2",
            );
        }
        for kernels in Kernels::available() {
            assert!(widest == with(kernels, || pair(&mut renderer)), "{}", kernels.set().name());
        }
        let right_first = pair(&mut renderer.with_run_both(|left, right| {
            right();
            left();
        }));
        assert!(widest == right_first);
    }
}
