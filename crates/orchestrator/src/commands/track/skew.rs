//! The skew of a recording that states none: from the motion of its target.

use anyhow::Result;
use pb3dp_estimation::skew_watch::Skew;
use pb3dp_estimation_core::estimate::EstimateWarning;
use pb3dp_hal_api::{FramePair, StereoCamera};
use pb3dp_wiring::Recording;

use super::PAIR_TIMEOUT;
use super::walk::Walk;

/// Pairs from the beginning on that are looked at. Chosen by hand, not varied: two seconds at 30 pairs per second.
const PAIRS: usize = 60;
/// Rounds that improve what was found, and the standard deviation from which that is not needed, seconds. Chosen by hand, not varied.
const ROUNDS: usize = 2;
const ENOUGH_S: f64 = 4e-4;

/// What the first pairs of a recording tell.
#[derive(Debug, Default)]
pub struct SkewResult {
    /// The skew, if they show one.
    pub skew: Option<Skew>,
    /// What an unknown one may cost.
    pub cost: Option<EstimateWarning>,
}

/// What the first pairs of a recording tell, which `again` opens for this purpose. A skew that was found while it was in the way is found better
/// once it is taken out.
pub fn of(mut again: impl FnMut() -> Result<(Recording, Walk)>) -> Result<SkewResult> {
    let mut found_skew = look(again()?, None)?;
    for _ in 0..ROUNDS {
        let Some(before) = found_skew.skew.filter(|skew| skew.sigma_s > ENOUGH_S) else { break };
        let next = look(again()?, Some(before))?;
        if next.skew.is_none_or(|skew| skew.sigma_s > before.sigma_s) {
            break;
        }
        found_skew = next;
    }
    Ok(found_skew)
}

/// Follows the first target until its motion has told the skew. A damaged pair, a region that is refused and a target that is not found tell
/// nothing here; they are reported where they count.
fn look((mut recording, mut walk): (Recording, Walk), assumed: Option<Skew>) -> Result<SkewResult> {
    let mut pair = FramePair::black(recording.camera.rig().left().size());
    let Some(target) = walk.first_target() else { return Ok(SkewResult::default()) };
    if assumed.is_some() { target.check_skew() } else { target.watch_skew() }?;
    let mut before = None;
    for _ in 0..PAIRS.min(recording.times_s.len()) {
        if recording.camera.next_pair_into(&mut pair, PAIR_TIMEOUT).is_err()
            || !target.look_for_skew(&pair, assumed, &mut before)
        {
            break;
        }
    }
    let watch = target.tracker().skew();
    Ok(SkewResult { skew: watch.and_then(|watch| watch.found()), cost: watch.and_then(|watch| watch.cost()) })
}

impl SkewResult {
    /// As a warning.
    pub fn warning(&self) -> Option<String> {
        match (&self.skew, &self.cost) {
            (Some(Skew { skew_s, sigma_s }), _) => Some(format!(
                "the right camera exposes {:+.1} ± {:.1} ms after the left one, as its rows show when the target moves: taken out (--skew states it)",
                1e3 * skew_s,
                1e3 * sigma_s
            )),
            (None, cost) => cost.as_ref().map(ToString::to_string),
        }
    }
}
