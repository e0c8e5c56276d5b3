//! What the operator saw when giving a command: stale commands are refused.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use serde::Deserialize;

use crate::refusal::Refusal;

/// Oldest state that a command may refer to. States come at 20 Hz; at half of it a slow connection refuses honest commands, at double an
/// operator may act on a scene that has changed.
pub const SHOWN_AGE_MAX: Duration = Duration::from_millis(2000);

/// State number, target and server time as the page showed them.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct ShownState {
    /// `state.number`.
    pub state: u64,
    /// `target.id`; null without a target.
    pub target: Option<u64>,
    /// `time_ms` of the state.
    pub time_ms: f64,
}

/// The same, at present.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Present {
    /// State number.
    pub state: u64,
    /// Target.
    pub target: Option<u64>,
    /// Time of the run's clock.
    pub now: MonotonicTime,
    /// `time_ms` of the newest command that this holder gave; 0 before the first one.
    pub acted_on_ms: f64,
}

impl ShownState {
    /// Refuses a command that refers to another state or target, to a time too long ago or in the future, or to an earlier time than a
    /// command before.
    ///
    /// # Errors
    /// The first difference.
    pub fn check(&self, command: &'static str, present: &Present) -> Result<(), Refusal> {
        let age_ms = present.now.as_secs_f64() * 1e3 - self.time_ms;
        let limit_ms = SHOWN_AGE_MAX.as_secs_f64() * 1e3;
        // Not a number is refused as well. Times are rounded to microseconds on their way to the page.
        if !(-0.01..=limit_ms).contains(&age_ms) {
            return Err(Refusal::OldState { command, age_ms, limit_ms });
        }
        if self.state != present.state {
            return Err(Refusal::OtherState { command, shown: self.state, current: present.state });
        }
        if self.target != present.target {
            let text_of =
                |target: Option<u64>| target.map_or_else(|| "no target".to_owned(), |id| format!("target {id}"));
            return Err(Refusal::OtherTarget {
                command,
                shown: text_of(self.target),
                current: text_of(present.target),
            });
        }
        if self.time_ms < present.acted_on_ms {
            return Err(Refusal::OutOfOrder { command, late_ms: present.acted_on_ms - self.time_ms });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_command_on_the_present_state_passes() {
        let now = MonotonicTime::from_secs_f64(10.0);
        let present = Present { state: 7, target: Some(2), now, acted_on_ms: 9_900.0 };
        let shown = ShownState { state: 7, target: Some(2), time_ms: 9_950.0 };
        let code = |shown: ShownState| shown.check("start", &present).map_err(|refusal| refusal.code());
        assert_eq!(code(shown), Ok(()));
        for (wrong, expected) in [
            (ShownState { state: 6, ..shown }, "PB3DP-PAN-024"),
            (ShownState { state: 8, ..shown }, "PB3DP-PAN-024"),
            (ShownState { target: None, ..shown }, "PB3DP-PAN-025"),
            (ShownState { target: Some(3), ..shown }, "PB3DP-PAN-025"),
            (ShownState { time_ms: 9_899.0, ..shown }, "PB3DP-PAN-044"),
            (ShownState { time_ms: 7_999.0, ..shown }, "PB3DP-PAN-026"),
            (ShownState { time_ms: 10_001.0, ..shown }, "PB3DP-PAN-026"),
            (ShownState { time_ms: f64::NAN, ..shown }, "PB3DP-PAN-026"),
        ] {
            assert_eq!(code(wrong), Err(expected), "{wrong:?}");
        }
    }
}
