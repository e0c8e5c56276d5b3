//! Poses on the command line and in setups: millimetres and a rotation vector in degrees.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use nalgebra::Vector3;
use pb3dp_geometry::frames::{Base, CamLeft, Flange, Hand, World};
use pb3dp_geometry::{Frame, Pose, so3};
use pb3dp_setup::layers::{Layers, SetupArgs};

use super::numbers::list_of_toml;

/// Six numbers: x, y, z in mm, and a rotation vector in degrees.
pub(super) fn six(text: &str) -> Result<[f64; 6], String> {
    let wrong = || format!("{text:?} is not six numbers X,Y,Z,RX,RY,RZ (mm, and a rotation vector in degrees)");
    let numbers = text.split(',').map(|number| number.trim().parse::<f64>().ok().filter(|number| number.is_finite()));
    numbers.collect::<Option<Vec<_>>>().and_then(|numbers| numbers.try_into().ok()).ok_or_else(wrong)
}

/// The pose of six numbers.
pub(super) fn pose<To: Frame, From: Frame>([x, y, z, rx, ry, rz]: [f64; 6]) -> Pose<To, From> {
    let turn = Vector3::new(rx, ry, rz).map(f64::to_radians);
    Pose::from_parts(Vector3::new(x, y, z) * 1e-3, so3::exp(&turn))
}

/// The pose tables of a setup (`configs/rig.toml`); `pb3dp run` reads the complete file.
pub(super) struct Setup {
    file: PathBuf,
    root: toml::Table,
}

impl Setup {
    pub(super) fn read(file: &Path) -> Result<Self> {
        let layers = Layers::read(&SetupArgs::of_file(file))?;
        let root = layers.figment().extract().with_context(|| format!("{}: invalid setup", file.display()))?;
        Ok(Self { file: file.to_path_buf(), root })
    }

    /// Pose of an arm's base in the world.
    pub(super) fn world_from_base(&self, arm: &str) -> Result<Pose<World, Base>> {
        self.pose(&["arms", arm, "world_from_base"])
    }

    /// Pose of the left camera on the flange.
    pub(super) fn flange_from_cam_left(&self) -> Result<Pose<Flange, CamLeft>> {
        let flange_from_hand: Pose<Flange, Hand> = self.pose(&["mounts", "flange_from_hand"])?;
        let hand_from_cam_left: Pose<Hand, CamLeft> = self.pose(&["mounts", "hand_from_cam_left"])?;
        Ok(flange_from_hand * hand_from_cam_left)
    }

    /// A pose whose frames are given by its key.
    fn pose<To: Frame, From: Frame>(&self, keys: &[&str]) -> Result<Pose<To, From>> {
        let place = || format!("{}: {}", self.file.display(), keys.join("."));
        let (last, above) = keys.split_last().with_context(place)?;
        let mut table = Some(&self.root);
        for key in above {
            table = table.and_then(|table| table.get(*key)).and_then(toml::Value::as_table);
        }
        let value = table.and_then(|table| table.get(*last)).with_context(|| format!("{}: missing", place()))?;
        let wrong =
            || format!("{}: must be {{ translation_mm = [x, y, z], rotation_vector_deg = [x, y, z] }}", place());
        let [x, y, z] = list_of_toml(value.get("translation_mm")).with_context(wrong)?;
        let [rx, ry, rz] = list_of_toml(value.get("rotation_vector_deg")).with_context(wrong)?;
        Ok(pose([x, y, z, rx, ry, rz]))
    }
}
