//! Front end: from raw images to hue. Undistorts the images if the rig has distortion, then computes both hue planes.

use image::RgbImage;
use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::{EstimationError, check_image_sizes};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::plane_hypothesis::PinholePair;
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_geometry::maps::RemapTable;
use pb3dp_geometry::{Camera, Distortion, ImageSize, StereoRig};

use crate::hue::{HueConfig, HuePlane};

/// Both cameras with their buffers; allocates only for the first pair.
#[derive(Clone, Debug)]
pub(super) struct FrontEnd {
    rig: StereoRig,
    pair: PinholePair,
    left: CameraInput,
    right: CameraInput,
    hue_config: HueConfig,
    kernels: Kernels,
}

impl FrontEnd {
    pub(super) fn new(rig: &StereoRig, hue_config: HueConfig, kernels: Kernels) -> Result<Self, EstimationError> {
        let pair = PinholePair::from_rig(&rig.undistorted())?;
        let (left, right) = (CameraInput::new(rig.left()), CameraInput::new(rig.right()));
        Ok(Self { rig: *rig, pair, left, right, hue_config, kernels })
    }

    /// Rejects images with a size other than the calibration's.
    pub(super) fn check_sizes(&self, left: ImageView<'_>, right: ImageView<'_>) -> Result<(), EstimationError> {
        check_image_sizes(&self.rig, left, right)
    }

    /// Loads a pair of raw images.
    pub(super) fn load(&mut self, left: ImageView<'_>, right: ImageView<'_>) -> Result<(), EstimationError> {
        self.check_sizes(left, right)?;
        self.left.load(left, &self.hue_config, self.kernels)?;
        self.right.load(right, &self.hue_config, self.kernels)
    }

    /// The rig of the raw images.
    pub(super) fn rig(&self) -> &StereoRig {
        &self.rig
    }

    /// Pinholes of the undistorted pair, and the transform between them.
    pub(super) fn pair(&self) -> &PinholePair {
        &self.pair
    }

    pub(super) fn left_hue(&self) -> &HuePlane {
        &self.left.hue
    }

    pub(super) fn right_hue(&self) -> &HuePlane {
        &self.right.hue
    }

    /// The region in the undistorted left image.
    pub(super) fn undistort_region(&self, mask: RegionMask) -> Result<RegionMask, EstimationError> {
        let Some((table, _)) = &self.left.undistortion else { return Ok(mask) };
        let (source_size, size) = (mask.size(), table.size());
        let mut source = vec![0; source_size.width as usize * source_size.height as usize];
        mask.for_each(|x, y| source[(y * source_size.width + x) as usize] = 255);
        let mut destination = vec![0; size.width as usize * size.height as usize];
        table.remap_mask(&source, source_size, &mut destination)?;
        Ok(RegionMask::from_fn(size, |x, y| destination[(y * size.width + x) as usize] != 0))
    }

    /// Maps a pixel of the raw left image to the undistorted one; `None` if it has no ray.
    pub(super) fn undistort_pixel(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let ray = self.rig.left().unproject(pixel).ok()?;
        Some(self.pair.left().pixel_from_normalized(&ray.xy()))
    }
}

/// The undistortion of one camera, and the hue of its latest image.
#[derive(Clone, Debug)]
struct CameraInput {
    /// Remap table and undistorted image, if the camera has distortion.
    undistortion: Option<(RemapTable, RgbImage)>,
    /// The image to undistort in one piece of 8-bit colour, if it is not yet.
    whole: Vec<u8>,
    hue: HuePlane,
}

impl CameraInput {
    fn new(camera: &Camera) -> Self {
        let undistortion = (!matches!(camera.distortion(), Distortion::None)).then(|| {
            let table = RemapTable::undistort(camera);
            let image = RgbImage::new(table.size().width, table.size().height);
            (table, image)
        });
        Self { undistortion, whole: Vec::new(), hue: HuePlane::default() }
    }

    fn load(&mut self, image: ImageView<'_>, config: &HueConfig, kernels: Kernels) -> Result<(), EstimationError> {
        let Some((table, undistorted)) = &mut self.undistortion else {
            self.hue.update_from_rgb(image, config, kernels);
            return Ok(());
        };
        let size = ImageSize { width: image.width(), height: image.height() };
        table.remap_rgb(image.contiguous_rgb(&mut self.whole), size, undistorted)?;
        self.hue.update_from_rgb(&*undistorted, config, kernels);
        Ok(())
    }
}
