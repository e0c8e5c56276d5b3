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

/// What the first pairs of a recording tell.
#[derive(Debug, Default)]
pub struct Told {
    /// The skew, if they show one.
    pub skew: Option<Skew>,
    /// What an unknown one may cost.
    pub cost: Option<EstimateWarning>,
}

/// Follows the first target of a recording, opened for this purpose, until its motion has told the skew. A damaged pair, a region that is refused
/// and a target that is not found tell nothing here; they are reported where they count.
pub fn of(mut recording: Recording, mut walk: Walk) -> Result<Told> {
    let mut pair = FramePair::black(recording.camera.rig().left().size());
    let Some(target) = walk.first_target() else { return Ok(Told::default()) };
    target.watch_skew()?;
    let mut before = None;
    for _ in 0..PAIRS.min(recording.times_s.len()) {
        if recording.camera.next_pair_into(&mut pair, PAIR_TIMEOUT).is_err()
            || !target.look_for_skew(&pair, &mut before)
        {
            break;
        }
    }
    let watch = target.tracker().skew();
    Ok(Told { skew: watch.and_then(|watch| watch.found()), cost: watch.and_then(|watch| watch.cost()) })
}

impl Told {
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
