//! A hash of a whole record: the same run gives the same hash.

use system_tests::safety::truth::{Step, Truth};

/// FNV-1a, 64 bits: offset and prime (Fowler, Noll, Vo).
const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const PRIME: u64 = 0x0100_0000_01b3;

fn add(hash: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(hash, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(PRIME))
}

fn add_step(hash: u64, step: &Step) -> u64 {
    let arms = step.arms.iter().flat_map(|arm| {
        let since =
            [arm.latched_since_s.unwrap_or(-1.0), f64::from(u8::from(arm.servo_on)), f64::from(u8::from(arm.may_go))];
        arm.position_rad.into_iter().chain(arm.velocity_rad_per_s).chain(since)
    });
    let numbers = arms.chain(step.world_from_target.translation_m).chain([step.t_s, step.pose_age_s]);
    add(numbers.fold(hash, |hash, number| add(hash, &number.to_le_bytes())), step.state.as_bytes())
}

/// Hash of the complete record; every bit counts.
pub fn digest(truth: &Truth) -> u64 {
    let steps = truth.steps.iter().fold(OFFSET, add_step);
    truth.log.iter().fold(steps, |hash, line| add(add(hash, &line.t_millis.to_le_bytes()), line.text.as_bytes()))
}
