//! Stalls: a part stands still for a moment, and the hold that follows keeps the target.

use pb3dp_geometry::MonotonicTime;

use super::findings::{Cause, Detail, Findings};
use super::inputs::Inputs;
use super::policy::{Action, Condition, Policies, Resume};
use crate::controller::{HoldReason, Mode, STALL_MAX_S};

/// A stall sooner after another one is no single one, seconds: a part that fails again and again holds the arm as any other cause.
pub(super) const STALLS_APART_S: f64 = 1.0;

/// The stall of the present hold, and the end of the last one.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stalls {
    /// Since when the arm holds for a stall.
    pub since: Option<MonotonicTime>,
    ended_at: Option<MonotonicTime>,
}

impl Stalls {
    /// Ends the stall of the present hold.
    pub fn end(&mut self, now: MonotonicTime) {
        if self.since.take().is_some() {
            self.ended_at = Some(now);
        }
    }

    /// Whether a hold that would begin now is for a single stall.
    pub fn may_begin(&self, now: MonotonicTime) -> bool {
        let since_s = self.ended_at.map_or(f64::INFINITY, |ended| now.seconds_since(ended));
        // After a clock step nothing is known about the last one.
        since_s >= STALLS_APART_S
    }

    /// Whether the stall of the present hold is not too long yet.
    pub fn is_short(&self, now: MonotonicTime) -> bool {
        self.since.is_some_and(|since| (0.0..STALL_MAX_S).contains(&now.seconds_since(since)))
    }
}

/// Whether only parts that stand still inhibit motion, every policy of theirs lets the arm resume by itself, and the predicted target is
/// still as certain as the policies demand of an estimate.
pub(super) fn is_only_stalled(findings: &Findings, policies: &Policies, inputs: &Inputs) -> bool {
    let mut causes = findings.all_at_least(policies, Action::Hold);
    let are_stalls = causes.all(|cause| is_stall(cause, policies));
    are_stalls && is_certain(policies, inputs)
}

fn is_stall(cause: Cause, policies: &Policies) -> bool {
    let policy = policies.get(cause.condition);
    let is_still = match cause.condition {
        Condition::JointsStale | Condition::FrameStale | Condition::EstimateStale => cause.value.is_finite(),
        Condition::ControllerRests => matches!(
            cause.detail,
            Detail::Controller(Mode::Holding(HoldReason::JointsStale { .. } | HoldReason::ObservationStale { .. }))
        ),
        _ => false,
    };
    is_still && policy.action == Action::Hold && policy.resume == Resume::ByItself
}

/// Whether the standard deviations of the predicted target are within those that the policies allow for an estimate.
fn is_certain(policies: &Policies, inputs: &Inputs) -> bool {
    let allowed = |condition| policies.get(condition).threshold;
    let Some(covariance) = inputs.target_covariance else { return false };
    let [position_m, orientation_rad] = Findings::sigmas(&covariance);
    position_m <= allowed(Condition::PositionUncertain) && orientation_rad <= allowed(Condition::OrientationUncertain)
}
