//! Cases in memory: all inputs of a method, loaded before its time is measured.

use std::path::{Path, PathBuf};
use std::rc::Rc;

use anyhow::{Context, bail};
use nalgebra::Vector2;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region, RegionConfig};
use pb3dp_geometry::StereoRig;
use pb3dp_record::dataset::{Case, PlaneTruth, StereoImages, find_cases, load_case};
use pb3dp_record::images::DisparityMap;
use pb3dp_record::metrics::Group;

use super::score::{CaseFacts, TruthSigma};

/// A case in memory.
pub struct Prepared {
    /// Facts about the case for the results.
    pub facts: Rc<CaseFacts>,
    /// Both images.
    pub images: StereoImages,
    /// Its calibration.
    pub rig: StereoRig,
    /// The region.
    pub region: Region,
    /// The search range.
    pub range: SearchRange,
    /// The truth.
    pub truth: PlaneTruth,
    /// Pixel of the left image at which the depth is compared.
    pub centroid_px: [f64; 2],
    /// The region's corners, pixels.
    pub polygon_px: Vec<[f64; 2]>,
    /// True disparities of the left image.
    pub disparity: Option<DisparityMap>,
}

/// The case folders under `folder`, sorted; with a filter only those whose name contains the filter text.
///
/// # Errors
/// A folder that cannot be read or has no case, or a filter that matches none.
pub fn find(folder: &Path, filter: Option<&str>) -> anyhow::Result<Vec<PathBuf>> {
    let mut found = find_cases(folder)?;
    if let Some(filter) = filter {
        let name_of = |case: &Path| case.file_name().map(|name| name.to_string_lossy().into_owned());
        found.retain(|case| name_of(case).is_some_and(|name| name.contains(filter)));
        if found.is_empty() {
            bail!("no case in {} has a name with {filter:?}", folder.display());
        }
    }
    Ok(found)
}

/// Loads a case; `None` if the truth of its plane is unknown.
///
/// # Errors
/// A file that is missing or damaged, by name.
pub fn load(folder: &Path) -> anyhow::Result<Option<Prepared>> {
    let case = load_case(folder)?;
    let Some(truth) = case.truth.clone() else { return Ok(None) };
    let images = case.load_images()?;
    let rig = case.load_calibration()?.rig;
    let vertices_px = case.region_polygon_left_px.iter().map(|&[u, v]| Vector2::new(u, v)).collect();
    let region = Region::Polygon { vertices_px };
    let mask = region
        .rasterize(&images.left, &RegionConfig::default())
        .with_context(|| format!("{}: the region is not usable", case.name))?;
    let centre = mask.centroid_px().with_context(|| format!("{}: the region is empty", case.name))?;
    Ok(Some(Prepared {
        facts: Rc::new(facts_of(&case, &truth, mask.area_px())),
        region,
        range: SearchRange {
            z_min_m: case.search.z_min_m,
            z_max_m: case.search.z_max_m,
            tilt_max_rad: case.search.tilt_max_rad,
        },
        truth,
        centroid_px: case.region_centroid_px.unwrap_or([centre.x, centre.y]),
        disparity: case.load_disparity_truth()?,
        polygon_px: case.region_polygon_left_px,
        images,
        rig,
    }))
}

fn facts_of(case: &Case, truth: &PlaneTruth, region_px: usize) -> CaseFacts {
    CaseFacts {
        name: case.name.clone(),
        group: Group::of(case),
        split: case.split.clone(),
        family: case.family.clone(),
        hard: case.hard.map(pb3dp_record::dataset::Hardness::name),
        region_px,
        z_m: truth.z_m,
        sigma: TruthSigma { z_m: truth.z_sigma_m.unwrap_or(0.0), normal_rad: truth.normal_sigma_rad.unwrap_or(0.0) },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_of_this_repository_is_loaded_with_its_truth() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases");
        let found = find(&folder, Some("bb201")).expect("there");
        let case = load(&found[0]).expect("loads").expect("has a truth");
        // The values are in its case.json, in millimetres and degrees.
        assert_eq!((case.facts.name.as_str(), case.facts.group), ("bb201_c0", Group::Boards));
        assert!((case.facts.z_m - 0.336_905_622_820).abs() < 1e-9);
        assert!((case.facts.sigma.normal_rad.to_degrees() - 0.043_694_855).abs() < 1e-8);
        assert!((case.range.z_min_m - 0.2655).abs() < 1e-12 && case.disparity.is_none());
        // The quadrangle of its corners has an area of 49835.5 square pixels, by the shoelace formula.
        assert!(case.facts.region_px.abs_diff(49_835) < 30, "{}", case.facts.region_px);
    }
}
