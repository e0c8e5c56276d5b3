//! How good the link is.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::Axis;

/// Exchanges in a row without a usable reply that are tolerated.
const MISSES_TOLERATED: u32 = 2;

/// Why bytes that came were no use as the reply that is waited for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadReply {
    /// Damaged: a wrong check, length or field.
    Damaged,
    /// The answer to an earlier message.
    Late,
    /// The answer to something else.
    Mismatched,
}

/// What happened on the link since the driver was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Messages sent.
    pub sent: u64,
    /// Messages with a usable reply in time.
    pub answered: u64,
    /// Messages without one.
    pub lost: u64,
    /// Replies to earlier messages.
    pub late: u64,
    /// Damaged replies.
    pub damaged: u64,
    /// Replies to something else, or that nobody waited for.
    pub mismatched: u64,
    /// Cycles that were left out because the driver was not asked in time.
    pub overruns: u64,
}

/// Why the brakes may not open.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WarmUpFailure {
    /// Replies were damaged or answered something else.
    #[error(
        "{bad} damaged or foreign replies in {exchanges} exchanges; none may be: check cable, ground and baud rate"
    )]
    Damaged {
        /// How many.
        bad: u64,
        /// Of how many exchanges.
        exchanges: u32,
    },
    /// Replies were too slow or lost.
    #[error(
        "{slow} of {exchanges} replies were lost or took longer than {allowed:?} (the slowest {worst:?}), at most 1 in 100 may: \
         check the latency timer of the adapter and the load of the machine"
    )]
    Slow {
        /// How many.
        slow: u32,
        /// Of how many exchanges.
        exchanges: u32,
        /// Half of the watchdog.
        allowed: Duration,
        /// The slowest reply that came.
        worst: Duration,
    },
    /// The power supply is too warm.
    #[error("the controller's power supply is too warm; let it cool down")]
    PowerTooWarm,
    /// An axis has no power or does not follow.
    #[error(
        "{axis}: status word 0x{word:04x} says power off or uncontrollable with its servo on; check its power, then enable again"
    )]
    AxisUncontrollable {
        /// Which axis.
        axis: Axis,
        /// Its status word.
        word: u16,
    },
    /// The controller says that the arm does not follow.
    #[error(
        "controller: status word 0x{word:04x} says uncontrollable with the servos on; look at its panel, then enable again"
    )]
    ArmUncontrollable {
        /// The status word.
        word: u16,
    },
}

/// Counts misses in a row and the exchanges of a warm-up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LinkMonitor {
    pub counters: LinkCounters,
    misses: u32,
    warm_up: WarmUp,
}

#[derive(Clone, Copy, Debug, Default)]
struct WarmUp {
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

    pub fn handle_answer(&mut self, round_trip: Duration) {
        self.counters.answered += 1;
        self.misses = 0;
        self.warm_up.exchanges += 1;
        self.warm_up.slow += u32::from(round_trip > self.warm_up.allowed);
        self.warm_up.worst = self.warm_up.worst.max(round_trip);
    }

    /// A message without a usable reply: how many in a row, if these are too many.
    pub fn handle_miss(&mut self) -> Option<u32> {
        self.counters.lost += 1;
        self.misses += 1;
        self.warm_up.exchanges += 1;
        self.warm_up.slow += 1;
        (self.misses > MISSES_TOLERATED).then_some(self.misses)
    }

    pub fn handle_bad(&mut self, bad: BadReply) {
        match bad {
            BadReply::Damaged => self.counters.damaged += 1,
            BadReply::Late => self.counters.late += 1,
            BadReply::Mismatched => self.counters.mismatched += 1,
        }
    }

    /// Messages in a row without a usable reply.
    pub fn misses(&self) -> u32 {
        self.misses
    }

    pub fn forget_misses(&mut self) {
        self.misses = 0;
    }

    pub fn begin_warm_up(&mut self, allowed: Duration) {
        self.warm_up = WarmUp { allowed, bad_before: self.bad(), ..WarmUp::default() };
    }

    /// The judgement over the warm-up, once it has so many exchanges.
    pub fn warm_up(&self, exchanges_needed: u32) -> Option<Result<(), WarmUpFailure>> {
        let WarmUp { exchanges, slow, bad_before, allowed, worst } = self.warm_up;
        if exchanges < exchanges_needed {
            return None;
        }
        let bad = self.bad() - bad_before;
        if bad > 0 {
            return Some(Err(WarmUpFailure::Damaged { bad, exchanges }));
        }
        // The 99th percentile is within the bound if at most one in 100 is beyond.
        let too_slow = slow > exchanges / 100;
        Some(if too_slow { Err(WarmUpFailure::Slow { slow, exchanges, allowed, worst }) } else { Ok(()) })
    }

    fn bad(&self) -> u64 {
        self.counters.damaged + self.counters.mismatched
    }
}
