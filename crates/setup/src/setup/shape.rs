//! The keys `parts`: shape of an arm, for the clearance between two arms.

use nalgebra::Point3;
use pb3dp_kinematics::{ArmPart, ArmShape, Capsule, Carrier, DOF};
use serde::Deserialize;

use super::super::load::Checker;

/// A capsule that moves with a link of the arm.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PartEntry {
    name: String,
    on: String,
    from_mm: [f64; 3],
    to_mm: [f64; 3],
    radius_mm: f64,
}

/// The shape; `None` if anything was refused.
pub(super) fn build_shape(key: &str, entries: &[PartEntry], check: &mut Checker) -> Option<ArmShape> {
    let parts: Option<Vec<ArmPart>> =
        entries.iter().enumerate().map(|(index, entry)| entry.build(&format!("{key}[{index}]"), check)).collect();
    let is_clean = check.is_clean();
    ArmShape::new(parts?)
        .inspect_err(|error| {
            if is_clean {
                check.refuse(format!("{key}: {error}"))
            }
        })
        .ok()
}

impl PartEntry {
    fn build(&self, key: &str, check: &mut Checker) -> Option<ArmPart> {
        check.numbers(&format!("{key}.from_mm"), &self.from_mm, -2000.0..=2000.0);
        check.numbers(&format!("{key}.to_mm"), &self.to_mm, -2000.0..=2000.0);
        check.number(&format!("{key}.radius_mm"), self.radius_mm, 1.0..=1000.0);
        let carrier = self.carrier();
        if carrier.is_none() {
            check.refuse(format!("{key}.on = {:?}: allowed are base, joint 0 to joint {}, flange", self.on, DOF - 1));
        }
        let point = |place_mm: [f64; 3]| Point3::from(place_mm.map(|coordinate| coordinate * 1e-3));
        Some(ArmPart {
            name: self.name.clone(),
            carrier: carrier?,
            capsule: Capsule { ends_m: [point(self.from_mm), point(self.to_mm)], radius_m: self.radius_mm * 1e-3 },
        })
    }

    /// The joint that the capsule moves with, if any.
    pub(super) fn joint(&self) -> Option<usize> {
        match self.carrier()? {
            Carrier::Joint(joint) => Some(joint),
            Carrier::Base | Carrier::Flange => None,
        }
    }

    fn carrier(&self) -> Option<Carrier> {
        match self.on.as_str() {
            "base" => Some(Carrier::Base),
            "flange" => Some(Carrier::Flange),
            joint => {
                let joint = joint.strip_prefix("joint ")?.parse().ok()?;
                (joint < DOF).then_some(Carrier::Joint(joint))
            }
        }
    }
}
