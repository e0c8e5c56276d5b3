//! Quality of the link: lost, late and damaged replies.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_hal_api::RecentFailures;

/// Tolerated exchanges in a row without a usable reply.
const MISSES_TOLERATED: u32 = 2;

/// Tolerated exchanges without an undamaged reply among the last 100. Chosen so that it stops what the rule above does not see, a pattern,
/// and hardly anything else: if replies are lost at random, three in a row come sooner up to a loss of 15 %. Half of it would stop an arm
/// every few minutes at a loss of 5 %; with twice as many, one lost reply of three would go on for ever.
const BAD_TOLERATED: u32 = 19;

/// Why received bytes are not the expected reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadReply {
    /// Damaged: wrong checksum, length or field.
    Damaged,
    /// The answer to an earlier message.
    Late,
    /// The answer to another request.
    Mismatched,
}

/// Message counts of the link since the driver was created.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Messages sent.
    pub sent: u64,
    /// Messages with a usable reply in time.
    pub answered: u64,
    /// Messages without a usable reply in time.
    pub lost: u64,
    /// Replies to earlier messages.
    pub late: u64,
    /// Damaged replies.
    pub damaged: u64,
    /// Replies to another request, or to none.
    pub mismatched: u64,
    /// Cycles that were skipped because the driver was polled too late.
    pub overruns: u64,
}

/// Why the brakes must not open.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WarmUpFailure {
    /// Replies were damaged, or answered another request.
    #[error(
        "{bad} damaged or foreign replies in {exchanges} exchanges, none is allowed; check cable, ground and baud rate"
    )]
    Damaged {
        /// Number of these replies.
        bad: u64,
        /// Number of exchanges.
        exchanges: u32,
    },
    /// Replies were too slow or lost.
    #[error(
        "{slow} of {exchanges} replies were lost or took longer than {allowed:?} (slowest {worst:?}), at most 1 in 100 is \
         allowed; check the latency timer of the adapter and the load of the computer"
    )]
    Slow {
        /// Number of these replies.
        slow: u32,
        /// Number of exchanges.
        exchanges: u32,
        /// Half of the watchdog time.
        allowed: Duration,
        /// The slowest reply that came.
        worst: Duration,
    },
    /// The power supply is too warm.
    #[error("the controller's power supply is too warm; let it cool down")]
    PowerTooWarm,
    /// An axis has no power or does not follow.
    #[error(
        "{axis}: power off or uncontrollable with its servo on (status word 0x{word:04x}); check its power, then enable again"
    )]
    AxisUncontrollable {
        /// Which axis.
        axis: Axis,
        /// Its status word.
        word: u16,
    },
    /// The dead-man switch is released.
    #[error("the dead-man switch is released (status word 0x{word:04x}); hold it, then enable again")]
    DeadManReleased {
        /// The status word.
        word: u16,
    },
    /// The controller reports that the arm does not follow.
    #[error(
        "controller: power off or arm uncontrollable with the servos on (status word 0x{word:04x}); check its panel, then enable again"
    )]
    ArmUncontrollable {
        /// The status word.
        word: u16,
    },
}

/// Counts lost, late and damaged replies.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LinkMonitor {
    pub counters: LinkCounters,
    misses: u32,
    recent: RecentFailures,
    /// A damaged reply came since the last outcome.
    is_damaged: bool,
}

/// Test of the link before the brakes may open.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct WarmUp {
    exchanges: u32,
    slow: u32,
    bad_before: u64,
    allowed: Duration,
    worst: Duration,
}

impl LinkMonitor {
    pub fn handle_sent(&mut self) {
        self.counters.sent += 1;
    }

    pub fn handle_answer(&mut self, round_trip: Duration, warm_up: Option<&mut WarmUp>) {
        self.counters.answered += 1;
        self.misses = 0;
        self.recent.push(std::mem::take(&mut self.is_damaged));
        let Some(warm_up) = warm_up else { return };
        warm_up.exchanges += 1;
        warm_up.slow += u32::from(round_trip > warm_up.allowed);
        warm_up.worst = warm_up.worst.max(round_trip);
    }

    /// Counts a message without a usable reply. Returns their number in a row, if it is too large.
    pub fn handle_miss(&mut self, warm_up: Option<&mut WarmUp>) -> Option<u32> {
        self.counters.lost += 1;
        self.misses += 1;
        self.recent.push(true);
        self.is_damaged = false;
        if let Some(warm_up) = warm_up {
            warm_up.exchanges += 1;
            warm_up.slow += 1;
        }
        (self.misses > MISSES_TOLERATED).then_some(self.misses)
    }

    pub fn handle_bad(&mut self, bad: BadReply) {
        // A late one was counted as a miss, and a second copy of a reply does no harm.
        self.is_damaged |= bad == BadReply::Damaged;
        match bad {
            BadReply::Damaged => self.counters.damaged += 1,
            BadReply::Late => self.counters.late += 1,
            BadReply::Mismatched => self.counters.mismatched += 1,
        }
    }

    /// Exchanges among the last 100 without an undamaged reply, if there are too many.
    pub fn too_many_bad(&self) -> Option<u32> {
        Some(self.recent.count()).filter(|bad| *bad > BAD_TOLERATED)
    }

    pub fn forget_misses(&mut self) {
        self.misses = 0;
        self.recent.clear();
    }

    pub fn new_warm_up(&self, allowed: Duration) -> WarmUp {
        WarmUp { exchanges: 0, slow: 0, bad_before: self.bad(), allowed, worst: Duration::ZERO }
    }

    /// The result of the warm-up, once it has `exchanges_needed` exchanges.
    pub fn judge(&self, warm_up: WarmUp, exchanges_needed: u32) -> Option<Result<(), WarmUpFailure>> {
        let WarmUp { exchanges, slow, bad_before, allowed, worst } = warm_up;
        if exchanges < exchanges_needed {
            return None;
        }
        let bad = self.bad() - bad_before;
        if bad > 0 {
            return Some(Err(WarmUpFailure::Damaged { bad, exchanges }));
        }
        // The 99th percentile is within the bound if at most one in 100 exceeds it.
        let too_slow = slow > exchanges / 100;
        Some(if too_slow { Err(WarmUpFailure::Slow { slow, exchanges, allowed, worst }) } else { Ok(()) })
    }

    fn bad(&self) -> u64 {
        self.counters.damaged + self.counters.mismatched
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An answer that comes after a damaged one counts as bad; a late copy does not.
    #[test]
    fn damaged_replies_count_although_an_answer_follows() {
        let after = |bad: BadReply, exchanges: u32| {
            let mut link = LinkMonitor::default();
            for _ in 0..exchanges {
                link.handle_bad(bad);
                link.handle_answer(Duration::from_millis(1), None);
            }
            link.too_many_bad()
        };
        assert_eq!(
            [BAD_TOLERATED, BAD_TOLERATED + 1].map(|n| after(BadReply::Damaged, n)),
            [None, Some(BAD_TOLERATED + 1)]
        );
        assert_eq!(after(BadReply::Late, 50), None);
        assert_eq!(after(BadReply::Mismatched, 50), None);
    }
}
