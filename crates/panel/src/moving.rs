//! Limits of what an operator may change while an arm moves.

use nalgebra::Vector3;

use crate::messages::Triple;
use crate::messages::state::JogState;
use crate::refusal::Refusal;

/// Largest change of the jog by one command.
pub const JOG_STEP_MM: f64 = 10.0;
/// The same for its rotation.
pub const JOG_STEP_DEG: f64 = 2.0;
/// Largest jog.
pub const JOG_MM: f64 = 100.0;
/// The same for its rotation.
pub const JOG_DEG: f64 = 20.0;
/// Largest push of the simulated target.
const PUSH_MM: f64 = 500.0;
const PUSH_DEG: f64 = 90.0;

/// Numbers come from a page as decimals: a step of ten times 0.1 must not be above the limit of 1.
const ROUNDING: f64 = 1e-6;

/// Checks a change of the jog.
///
/// # Errors
/// A step or an offset that is too large or not finite.
pub fn check_jog(before: &JogState, wanted: &JogState) -> Result<(), Refusal> {
    let norm = |triple: Triple| Vector3::from(triple).norm();
    let step = |wanted: Triple, before: Triple| (Vector3::from(wanted) - Vector3::from(before)).norm();
    for (what, value, limit, unit) in [
        ("the offset", norm(wanted.offset_mm), JOG_MM, "mm"),
        ("the rotation", norm(wanted.offset_deg), JOG_DEG, "deg"),
        ("one step", step(wanted.offset_mm, before.offset_mm), JOG_STEP_MM, "mm"),
        ("one step of the rotation", step(wanted.offset_deg, before.offset_deg), JOG_STEP_DEG, "deg"),
    ] {
        // Not a number is refused as well.
        let is_allowed = value <= limit + ROUNDING;
        if !is_allowed {
            return Err(Refusal::Jog { what, value, limit, unit });
        }
    }
    Ok(())
}

/// Checks a share of the velocity, percent.
///
/// # Errors
/// If it is not in 0 to 100.
pub fn check_speed(percent: f64) -> Result<(), Refusal> {
    in_range("percent", percent, 0.0, 100.0)
}

/// Checks a push of the simulated target.
///
/// # Errors
/// If it is too large or not finite.
pub fn check_push(offset_mm: Triple, turn_deg: f64) -> Result<(), Refusal> {
    offset_mm.iter().try_for_each(|offset| in_range("offset_mm", *offset, -PUSH_MM, PUSH_MM))?;
    in_range("turn_deg", turn_deg, -PUSH_DEG, PUSH_DEG)
}

fn in_range(key: &'static str, value: f64, least: f64, most: f64) -> Result<(), Refusal> {
    if (least..=most).contains(&value) { Ok(()) } else { Err(Refusal::Range { key, value, least, most }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jog_moves_in_small_steps_within_its_range() {
        let before = JogState { offset_mm: [95.0, 0.0, 0.0], offset_deg: [0.0, 19.0, 0.0] };
        let ok = JogState { offset_mm: [99.0, 3.0, 0.0], offset_deg: [0.0, 20.0, 0.0] };
        assert!(check_jog(&before, &ok).is_ok() && check_jog(&before, &before).is_ok());
        for (offset_mm, offset_deg) in [
            ([100.1, 0.0, 0.0], before.offset_deg),
            ([84.9, 0.0, 0.0], before.offset_deg),
            ([f64::NAN, 0.0, 0.0], before.offset_deg),
            ([f64::INFINITY, 0.0, 0.0], before.offset_deg),
            (before.offset_mm, [0.0, 20.1, 0.0]),
            (before.offset_mm, [0.0, 16.9, 0.0]),
        ] {
            assert!(check_jog(&before, &JogState { offset_mm, offset_deg }).is_err(), "{offset_mm:?} {offset_deg:?}");
        }
    }

    #[test]
    fn a_speed_is_a_share_of_what_the_setup_allows() {
        assert!(check_speed(0.0).is_ok() && check_speed(100.0).is_ok());
        assert!(check_speed(100.1).is_err() && check_speed(-1.0).is_err() && check_speed(f64::NAN).is_err());
    }
}
