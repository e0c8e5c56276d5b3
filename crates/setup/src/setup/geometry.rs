//! Compares the lengths of a robot description with the stated geometry of the arm.

use pb3dp_arm_pa10_protocol::gateway_protocol::Geometry;
use pb3dp_kinematics::{Chain, JointVector};

use super::super::load::Checker;

/// Tolerance of a length, mm: less than the difference between the generations, so that a flange of 85 mm (as some models have it)
/// belongs to the first generation.
const TOLERANCE_MM: [f64; 4] = [1.0, 5.0, 10.0, 5.0];

/// Rounding errors, mm.
const ROUNDING_MM: f64 = 1e-6;

/// Refuses a robot description with other lengths than the geometry. An unknown geometry is not checked.
pub(super) fn check_geometry(key: &str, geometry: Geometry, chain: &Chain, check: &mut Checker) {
    let Some(expected_mm) = geometry.lengths_mm() else { return };
    let found_mm = lengths_mm(chain);
    let fits = |i: usize| (found_mm[i] - expected_mm[i]).abs() <= TOLERANCE_MM[i] + ROUNDING_MM;
    if (0..found_mm.len()).all(fits) {
        return;
    }
    let listed = |lengths: [f64; 4]| lengths.map(|mm| format!("{mm:.1}")).join(", ");
    check.refuse(format!(
        "{key}.gateway.geometry = {:?}: such an arm has {} mm from base to shoulder, elbow, wrist and flange, {key}.robot has {} mm; \
         measure the arm, then correct the one that is wrong",
        geometry.to_string(),
        listed(expected_mm),
        listed(found_mm)
    ));
}

/// From the base to the shoulder, the elbow, the wrist and the flange.
fn lengths_mm(chain: &Chain) -> [f64; 4] {
    let origins = chain.joint_frames(&JointVector::zeros()).origins_in_base();
    // Base, S1, S2, S3, E1, E2, W1, W2, flange: the joints at shoulder, elbow and wrist that bend the arm.
    [0, 2, 4, 6].map(|from| (origins[from + 2] - origins[from]).norm() * 1e3)
}
