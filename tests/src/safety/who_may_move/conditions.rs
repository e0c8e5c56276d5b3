//! The conditions of docs/supervisor.md that follow from delivered pairs, clock, drives and signs of life.

use super::limits::{
    CLOCK_BEHIND_S, CLOCK_STEP_S, DISABLED_S, FRAME_AGE_S, LOST_AGE_S, POSE_AGE_S, SIGMA, SILENCE_S, SKEW_FOR_S,
    SKEW_S, UNCERTAIN_FOR_S,
};
use super::{Moment, Pair, ROUNDING_S};

/// Active conditions, and what they are found from.
#[derive(Clone, Debug)]
pub(super) struct Conditions {
    /// The pair that was delivered last.
    pub newest: Option<Pair>,
    /// The started target, and the followed one with the time since when.
    pub started: Option<u64>,
    pub followed: Option<u64>,
    pub followed_since_s: f64,
    /// The pair of the step before.
    before: Option<Pair>,
    /// Exposure of the newest estimate, and of the newest confident one.
    estimated_s: f64,
    confident_s: f64,
    /// Exposure of the newest confident one that is certain, and of simultaneous exposures.
    usable_s: f64,
    /// When the newest confident estimate arrived: nothing is known after it.
    confirmed_s: f64,
    /// Estimates from earlier exposures belong to another selection.
    not_before_s: f64,
    stepped_s: Option<f64>,
    /// Since when nothing inhibits motion.
    clear_since_s: Option<f64>,
    skewed_since_s: Option<f64>,
    uncertain_since_s: Option<f64>,
    sigma: [f64; 2],
    is_disordered: bool,
    has_stepped: bool,
    is_disabled: bool,
    is_stale: bool,
    lasts: bool,
    pub is_lost: bool,
    pub is_silent: bool,
}

impl Default for Conditions {
    fn default() -> Self {
        const NEVER_S: f64 = f64::NEG_INFINITY;
        Self {
            newest: None,
            started: None,
            followed: None,
            followed_since_s: NEVER_S,
            before: None,
            estimated_s: NEVER_S,
            confident_s: NEVER_S,
            usable_s: NEVER_S,
            confirmed_s: NEVER_S,
            not_before_s: NEVER_S,
            stepped_s: None,
            clear_since_s: None,
            skewed_since_s: None,
            uncertain_since_s: None,
            sigma: [0.0; 2],
            is_disordered: false,
            has_stepped: false,
            is_disabled: false,
            is_stale: true,
            lasts: true,
            is_lost: true,
            is_silent: true,
        }
    }
}

/// Since when this is so.
fn since(is_so: bool, before_s: Option<f64>, now_s: f64) -> Option<f64> {
    is_so.then(|| before_s.filter(|since_s| *since_s <= now_s).unwrap_or(now_s))
}

impl Conditions {
    /// Determines the conditions of this step.
    pub fn look(&mut self, moment: &Moment) {
        let now_s = moment.now_s;
        let step_s = self.stepped_s.replace(now_s).map_or(0.0, |before_s| now_s - before_s);
        let is_behind = now_s - moment.true_s < -CLOCK_BEHIND_S;
        self.has_stepped = !(-ROUNDING_S..=CLOCK_STEP_S + ROUNDING_S).contains(&step_s) || is_behind;
        if step_s < -ROUNDING_S {
            // Times from before are not comparable, and may lie ahead.
            for time_s in [&mut self.estimated_s, &mut self.not_before_s, &mut self.followed_since_s] {
                *time_s = time_s.min(now_s);
            }
            self.before = None;
        }
        self.take(now_s);
        let age_s = |at_s: f64| now_s - at_s;
        let above = |value: f64, limit: f64| value > limit + ROUNDING_S;
        self.is_silent = moment.heartbeat_s.is_none_or(|heartbeat_s| above(age_s(heartbeat_s), SILENCE_S));
        self.is_disabled = moment.disabled_s > DISABLED_S;
        let frame_age_s = self.newest.map_or(f64::INFINITY, |pair| age_s(pair.exposed_s));
        self.is_stale = above(age_s(self.confident_s), POSE_AGE_S) || above(frame_age_s, FRAME_AGE_S);
        self.is_lost = above(age_s(self.confident_s), LOST_AGE_S);
        let is_skewed = self.newest.is_some_and(|pair| above(pair.skew_s.abs(), SKEW_S));
        let is_uncertain = self.sigma.iter().zip(SIGMA).any(|(sigma, limit)| above(*sigma, limit));
        self.skewed_since_s = since(is_skewed, self.skewed_since_s, now_s);
        self.uncertain_since_s = since(is_uncertain, self.uncertain_since_s, now_s);
        let lasts =
            |since_s: Option<f64>, for_s: f64| since_s.is_some_and(|since_s| now_s - since_s > for_s + ROUNDING_S);
        if !is_skewed && !is_uncertain {
            self.usable_s = self.confident_s;
        }
        self.lasts = self.is_stale
            || self.is_disordered
            || above(age_s(self.usable_s), POSE_AGE_S)
            || lasts(self.skewed_since_s, SKEW_FOR_S)
            || lasts(self.uncertain_since_s, UNCERTAIN_FOR_S);
        let is_inhibited =
            self.is_stale || self.is_disordered || is_skewed || is_uncertain || self.needs_operator() || self.is_silent;
        self.clear_since_s = since(!is_inhibited, self.clear_since_s, now_s);
    }

    /// Takes the newest pair, once.
    fn take(&mut self, now_s: f64) {
        let Some(pair) = self.newest.filter(|pair| Some(*pair) != self.before) else { return };
        let is_in_order = |before: Pair| pair.number > before.number && pair.exposed_s > before.exposed_s;
        self.is_disordered = self.before.replace(pair).is_some_and(|before| !is_in_order(before));
        if pair.exposed_s <= self.estimated_s || pair.exposed_s < self.not_before_s - ROUNDING_S {
            return;
        }
        self.estimated_s = pair.exposed_s;
        if pair.has_pose {
            self.sigma = pair.sigma;
            if self.followed.replace(pair.target) != Some(pair.target) {
                self.followed_since_s = now_s;
            }
        }
        if pair.is_confident {
            (self.confident_s, self.confirmed_s) = (pair.exposed_s, now_s);
        }
    }

    /// The operator selects a target: nothing is known of it yet.
    pub fn select(&mut self, now_s: f64) {
        const NEVER_S: f64 = f64::NEG_INFINITY;
        (self.estimated_s, self.confident_s, self.confirmed_s) = (NEVER_S, NEVER_S, NEVER_S);
        self.usable_s = NEVER_S;
        (self.followed, self.followed_since_s, self.clear_since_s) = (None, NEVER_S, None);
        (self.sigma, self.not_before_s) = ([0.0; 2], now_s);
    }

    /// Whether nothing has inhibited motion for so long, up to the newest confident estimate.
    pub fn is_clear_for(&self, for_s: f64) -> bool {
        self.clear_since_s.is_some_and(|since_s| self.confirmed_s - since_s >= for_s - ROUNDING_S)
    }

    /// Whether nothing inhibits motion now.
    pub fn is_clear(&self) -> bool {
        self.clear_since_s.is_some()
    }

    /// Whether nothing inhibits motion but images and estimates that have not come.
    pub fn are_only_parts_still(&self) -> bool {
        let is_other = self.is_disordered || self.skewed_since_s.is_some() || self.uncertain_since_s.is_some();
        !(is_other || self.is_lost || self.is_silent || self.needs_operator())
    }

    /// Whether a condition holds the hand until it has gone.
    pub fn holds(&self) -> bool {
        self.lasts
    }

    /// Whether a condition of both arms waits for the operator.
    pub fn holds_both(&self) -> bool {
        self.has_stepped || self.is_disabled
    }

    /// Whether a condition waits for the operator.
    pub fn needs_operator(&self) -> bool {
        let is_other = self.started.zip(self.followed).is_some_and(|(started, followed)| started != followed);
        self.holds_both() || is_other
    }
}
