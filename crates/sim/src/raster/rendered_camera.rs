//! One camera of the pair: visible surfaces, light on the sensor, and images.

use image::RgbImage;
use nalgebra::Isometry3;
use pb3dp_geometry::{Camera, ImageSize};

use super::coverage::EdgePixels;
use super::exposure::{Exposure, Shutter};
use super::fine::Fine;
use super::triangle::{PartPose, ScreenTriangle, collect_triangles};
use super::view::View;
use super::visibility::Visibility;
use super::{RenderError, shade};
use crate::scene::{Scene, ScenePoses};
use crate::sensor::{CameraResponse, Developer, NoiseKey, SensorConfig};
use crate::targets::part::Anchor;

/// One camera with all its render state; both cameras can render in parallel.
#[derive(Clone, Debug)]
pub(crate) struct RenderedCamera {
    cam_from_cam_left: Isometry3<f64>,
    view: View,
    developer: Developer,
    visibility: Visibility,
    edges: EdgePixels,
    triangles: Vec<ScreenTriangle>,
    light: Vec<u16>,
    exposure_sum: Vec<u32>,
    /// Blur of the lens, and additional defocus, pixels.
    lens_blur_px: f64,
    defocus_px: f64,
    /// Finer sampling, if enabled.
    fine: Option<Box<Fine>>,
}

impl RenderedCamera {
    /// # Errors
    /// A camera with a pixel that has no ray; the error contains `name`.
    pub(crate) fn new(
        name: &'static str,
        camera: &Camera,
        cam_from_cam_left: Isometry3<f64>,
        sensor: &SensorConfig,
        response: &CameraResponse,
    ) -> Result<Self, RenderError> {
        let view = View::new(camera).map_err(|source| RenderError::Camera { side: name, source })?;
        let pixels = view.width * view.height;
        Ok(Self {
            cam_from_cam_left,
            developer: Developer::new(sensor, response, view.width),
            view,
            visibility: Visibility::new(pixels),
            edges: EdgePixels::default(),
            triangles: Vec::new(),
            light: vec![0; 3 * pixels],
            exposure_sum: Vec::new(),
            lens_blur_px: sensor.lens_blur_px,
            defocus_px: 0.0,
            fine: None,
        })
    }

    /// Samples `camera`, which must be the camera of this renderer, finer than its pixels.
    ///
    /// # Errors
    /// A camera with a pixel that has no ray; the error contains `name`.
    pub(crate) fn sample_finely(&mut self, name: &'static str, camera: &Camera) -> Result<(), RenderError> {
        self.fine = Some(Box::new(Fine::new(name, camera)?));
        self.developer.leave_blur_out();
        Ok(())
    }

    /// Sets the defocus.
    pub(crate) fn defocus(&mut self, defocus_px: f64) {
        self.defocus_px = defocus_px;
    }

    /// Changes the response.
    pub(crate) fn set_response(&mut self, response: &CameraResponse) {
        self.developer.set_response(response);
    }

    /// Takes an image of `size`: the light of all times, processed by the sensor model.
    pub(crate) fn expose(
        &mut self,
        scene: &Scene,
        exposure: &Exposure<'_>,
        key: &NoiseKey,
        size: ImageSize,
        image: &mut RgbImage,
    ) {
        match exposure.moments {
            [poses] => self.render_light(scene, poses),
            _ => self.gather_light(scene, exposure),
        }
        self.blur();
        if image.dimensions() != (size.width, size.height) {
            *image = RgbImage::new(size.width, size.height);
        }
        self.developer.develop(&self.light, key, image);
    }

    /// The image without noise, quantisation and clipping.
    pub(crate) fn ideal(&mut self, scene: &Scene, poses: &ScenePoses, image: &mut Vec<f32>) {
        self.render_light(scene, poses);
        self.blur();
        self.developer.develop_ideal(&self.light, image);
    }

    /// Determines the visible triangles.
    pub(crate) fn see(&mut self, scene: &Scene, poses: &ScenePoses) -> &Visibility {
        self.collect(scene, poses, None);
        self.visibility.draw(&self.view, &self.triangles);
        &self.visibility
    }

    /// Collects the potentially visible triangles, in this camera's view or a finer one.
    fn collect(&mut self, scene: &Scene, poses: &ScenePoses, view: Option<&View>) {
        let cam_from_world = self.cam_from_cam_left * poses.world_from_cam_left.inverse().isometry();
        let view = view.unwrap_or(&self.view);
        self.triangles.clear();
        for (index, part) in scene.parts().iter().enumerate() {
            let world_from_part = match part.anchor {
                Anchor::World => Isometry3::identity(),
                Anchor::Target => *poses.world_from_target.isometry(),
            };
            let pose = PartPose {
                cam_from_part: cam_from_world * world_from_part,
                world_from_part,
                world_from_cam: cam_from_world.inverse(),
            };
            collect_triangles(part, index as u16, &pose, scene.lighting(), view, &mut self.triangles);
        }
    }

    /// Renders the light on the sensor.
    fn render_light(&mut self, scene: &Scene, poses: &ScenePoses) {
        if let Some(mut fine) = self.fine.take() {
            let (view, visibility, light) = fine.parts();
            self.collect(scene, poses, Some(view));
            visibility.draw(view, &self.triangles);
            shade(&mut self.edges, view, visibility, (scene.parts(), &self.triangles), light);
            fine.integrate(self.lens_blur_px.hypot(self.defocus_px), &mut self.light);
            self.fine = Some(fine);
            return;
        }
        self.see(scene, poses);
        let surfaces = (scene.parts(), self.triangles.as_slice());
        shade(&mut self.edges, &self.view, &self.visibility, surfaces, &mut self.light);
    }

    /// Renders the light over several times: its mean, or row after row.
    fn gather_light(&mut self, scene: &Scene, exposure: &Exposure<'_>) {
        self.exposure_sum.clear();
        self.exposure_sum.resize(self.light.len(), 0);
        let stride = 3 * self.view.width;
        for (moment, poses) in exposure.moments.iter().enumerate() {
            let Some(rows) = exposure.rows(moment, self.view.height) else { continue };
            self.render_light(scene, poses);
            for row in rows {
                let share = exposure.share(moment, row);
                let values = row * stride..(row + 1) * stride;
                for (sum, &light) in self.exposure_sum[values.clone()].iter_mut().zip(&self.light[values]) {
                    *sum += share * u32::from(light);
                }
            }
        }
        let whole = match exposure.shutter {
            Shutter::Global => 256 * exposure.moments.len() as u32,
            Shutter::Rolling { .. } => 256,
        };
        for (light, &sum) in self.light.iter_mut().zip(&self.exposure_sum) {
            *light = ((sum + whole / 2) / whole) as u16;
        }
    }

    fn blur(&mut self) {
        if self.defocus_px > 0.0 && self.fine.is_none() {
            self.developer.defocus(&mut self.light, self.defocus_px);
        }
    }
}
