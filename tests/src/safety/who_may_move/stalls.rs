//! Holds that are stalls, from the section "Stalls" of docs/supervisor.md: the hand may move on as soon as every input is fresh.
//!
//! The operator reads when the hand holds for a stall, and when the stall is over. This report only restricts: without it a hold is none,
//! and with it the conditions that the model knows, the length and the interval must agree. It does not know the predicted target.

use super::ROUNDING_S;

/// Times of docs/supervisor.md, restated.
mod limits {
    /// A longer stall is an ordinary hold, seconds.
    pub const LONGEST_S: f64 = 0.3;
    /// Least time from the end of a stall to the next one, seconds.
    pub const APART_S: f64 = 1.0;
}
use limits::{APART_S, LONGEST_S};

/// The stall that the operator reads of, and the end of the last one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stalls {
    /// Begin, on the clock of the control loop.
    since_s: Option<f64>,
    ended_s: f64,
    /// Whether it has been a stall by the rules of the model since its begin.
    counts: bool,
}

/// What a step shows of a stall.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stall {
    /// The hand holds for none.
    None,
    /// It holds for one.
    On,
    /// One has ended in this step.
    Over,
}

impl Default for Stalls {
    fn default() -> Self {
        Self { since_s: None, ended_s: f64::NEG_INFINITY, counts: false }
    }
}

impl Stalls {
    /// The report of this step, if there is one, and whether nothing but parts that stand still inhibits motion.
    pub fn look(&mut self, report: Option<bool>, is_only_still: bool, now_s: f64) -> Stall {
        let lasts_s = self.since_s.map_or(0.0, |since_s| now_s - since_s);
        self.counts &= is_only_still && (-ROUNDING_S..LONGEST_S + ROUNDING_S).contains(&lasts_s);
        let Some(begins) = report else { return if self.counts { Stall::On } else { Stall::None } };
        let is_over = std::mem::take(&mut self.counts);
        if self.since_s.take().is_some() {
            self.ended_s = now_s;
        }
        if begins {
            self.since_s = Some(now_s);
            self.counts = is_only_still && now_s - self.ended_s >= APART_S - ROUNDING_S;
        }
        match (self.counts, is_over) {
            (true, _) => Stall::On,
            (false, true) => Stall::Over,
            _ => Stall::None,
        }
    }
}
