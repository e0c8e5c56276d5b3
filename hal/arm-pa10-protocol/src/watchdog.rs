//! What becomes of a velocity whose successor stays away: the same rule for host and gateway.

use std::time::Duration;

/// A watchdog that waits longer than this is none.
pub const STOP_AFTER_MAX: Duration = Duration::from_millis(200);

/// How old a command may get.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandWatchdog {
    ramp_after: Duration,
    stop_after: Duration,
}

/// What to do with a command of some age.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Staleness {
    /// Follow it.
    Fresh,
    /// Follow this part of it, between 0 and 1: all axes alike, so the way of the hand is kept.
    Ramp(f64),
    /// Stand, brakes on, fault.
    Expired,
}

/// Why times make no watchdog.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "a watchdog that slows down after {ramp_after:?} and stops after {stop_after:?}: the first must be shorter than the second, \
     and the second at most 200 ms"
)]
pub struct WatchdogError {
    ramp_after: Duration,
    stop_after: Duration,
}

impl CommandWatchdog {
    /// Slows down from the age `ramp_after` on, and stands at the age `stop_after`.
    ///
    /// # Errors
    /// If the first is not shorter than the second, or the second is longer than [`STOP_AFTER_MAX`].
    pub fn new(ramp_after: Duration, stop_after: Duration) -> Result<Self, WatchdogError> {
        if ramp_after < stop_after && stop_after <= STOP_AFTER_MAX {
            Ok(Self { ramp_after, stop_after })
        } else {
            Err(WatchdogError { ramp_after, stop_after })
        }
    }

    /// Age from which on the arm is slowed down.
    pub fn ramp_after(&self) -> Duration {
        self.ramp_after
    }

    /// Age at which the arm stands.
    pub fn stop_after(&self) -> Duration {
        self.stop_after
    }

    /// What to do with a command of this age.
    pub fn judge(&self, age: Duration) -> Staleness {
        if age <= self.ramp_after {
            return Staleness::Fresh;
        }
        if age >= self.stop_after {
            return Staleness::Expired;
        }
        let left = self.stop_after.saturating_sub(age).as_secs_f64();
        Staleness::Ramp(left / self.stop_after.saturating_sub(self.ramp_after).as_secs_f64())
    }
}

impl Default for CommandWatchdog {
    /// Slows down after 20 ms and stands after 50 ms.
    fn default() -> Self {
        Self { ramp_after: Duration::from_millis(20), stop_after: Duration::from_millis(50) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn a_command_fades_between_its_two_ages() {
        let watchdog = CommandWatchdog::default();
        for age in [0, 10, 20] {
            assert_eq!(watchdog.judge(ms(age)), Staleness::Fresh, "{age}");
        }
        assert_eq!(watchdog.judge(ms(35)), Staleness::Ramp(0.5));
        for age in [50, 51, 100_000] {
            assert_eq!(watchdog.judge(ms(age)), Staleness::Expired, "{age}");
        }
        let mut last = 1.0;
        for age_us in 20_001..50_000 {
            let Staleness::Ramp(part) = watchdog.judge(Duration::from_micros(age_us)) else { panic!("{age_us}") };
            assert!(part < last && part > 0.0, "{age_us}: {part} after {last}");
            last = part;
        }
    }

    #[test]
    fn a_watchdog_that_is_none_is_refused() {
        assert!(CommandWatchdog::new(ms(20), ms(200)).is_ok());
        for (ramp, stop) in [(20, 201), (20, 20), (50, 20)] {
            let error = CommandWatchdog::new(ms(ramp), ms(stop)).unwrap_err();
            assert!(error.to_string().contains(&format!("stops after {stop}ms")), "{error}");
        }
    }
}
