//! History of joint samples, for the pose of the hand at the time of an exposure.

use std::collections::VecDeque;

use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::{JointState, JointVector};

/// Ring buffer of joint samples, ordered by time. All memory is allocated at construction.
#[derive(Clone, Debug)]
pub struct JointHistory {
    samples: VecDeque<JointState>,
    capacity: usize,
    gap_max_s: f64,
}

/// Why the joints at a time are unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NotInHistory {
    /// Before the oldest sample.
    TooOld,
    /// Too long after the newest sample.
    TooNew,
    /// Between two samples with too large a gap.
    Gap,
}

impl JointHistory {
    /// Creates a buffer for `capacity` samples; gaps longer than `gap_max_s` are not interpolated.
    pub fn new(capacity: usize, gap_max_s: f64) -> Self {
        let capacity = capacity.max(2);
        Self { samples: VecDeque::with_capacity(capacity), capacity, gap_max_s }
    }

    /// Appends a sample. An equal time replaces the newest sample; an earlier time is refused (`false`).
    pub fn push(&mut self, sample: JointState) -> bool {
        match self.samples.back_mut() {
            Some(newest) if sample.at < newest.at => return false,
            Some(newest) if sample.at == newest.at => *newest = sample,
            _ => {
                if self.samples.len() == self.capacity {
                    self.samples.pop_front();
                }
                self.samples.push_back(sample);
            }
        }
        true
    }

    /// Removes all samples.
    pub fn clear(&mut self) {
        self.samples.clear();
    }

    /// The newest sample.
    pub fn newest(&self) -> Option<&JointState> {
        self.samples.back()
    }

    /// Joint angles at a time: interpolated linearly between samples. Up to the longest gap after the newest sample they are
    /// extrapolated with the measured velocity.
    ///
    /// # Errors
    /// If no sample is close enough in time.
    pub fn position_at(&self, at: MonotonicTime) -> Result<JointVector, NotInHistory> {
        let behind = self.samples.partition_point(|sample| sample.at < at);
        match (behind.checked_sub(1).and_then(|before| self.samples.get(before)), self.samples.get(behind)) {
            (_, Some(after)) if after.at == at => Ok(after.position_rad),
            (None, _) => Err(NotInHistory::TooOld),
            (Some(newest), None) => {
                let ahead_s = at.seconds_since(newest.at);
                if ahead_s > self.gap_max_s {
                    return Err(NotInHistory::TooNew);
                }
                Ok(newest.position_rad + newest.velocity_rad_per_s * ahead_s)
            }
            (Some(before), Some(after)) => {
                let gap_s = after.at.seconds_since(before.at);
                if gap_s > self.gap_max_s {
                    return Err(NotInHistory::Gap);
                }
                Ok(before.position_rad.lerp(&after.position_rad, at.seconds_since(before.at) / gap_s))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> MonotonicTime {
        MonotonicTime::from_nanos(millis * 1_000_000)
    }

    fn sample(millis: u64, first_joint_rad: f64) -> JointState {
        let mut position_rad = JointVector::from([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
        position_rad[0] = first_joint_rad;
        let velocity_rad_per_s = JointVector::from([2.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0]);
        JointState { at: at(millis), position_rad, velocity_rad_per_s }
    }

    fn history() -> JointHistory {
        let mut history = JointHistory::new(4, 0.05);
        for (millis, angle) in [(80, -1.0), (90, 0.5), (100, 1.0), (110, 2.0), (120, 4.0)] {
            assert!(history.push(sample(millis, angle)));
        }
        history
    }

    #[test]
    fn interpolates_between_samples_and_continues_the_newest() {
        let history = history();
        for (millis, expected) in [(90, 0.5), (95, 0.75), (105, 1.5), (110, 2.0), (118, 3.6), (120, 4.0), (130, 4.02)] {
            let angle = history.position_at(at(millis)).unwrap()[0];
            assert!((angle - expected).abs() < 1e-12, "{millis} ms: {angle}");
        }
        assert!((history.position_at(at(130)).unwrap()[6] - 0.59).abs() < 1e-12);
    }

    #[test]
    fn refuses_what_it_does_not_know() {
        let mut history = history();
        assert_eq!(history.position_at(at(89)), Err(NotInHistory::TooOld), "the oldest sample was overwritten");
        assert_eq!(history.position_at(at(171)), Err(NotInHistory::TooNew));
        assert!(history.push(sample(200, 5.0)));
        assert_eq!(history.position_at(at(150)), Err(NotInHistory::Gap));
        history.clear();
        assert_eq!(history.position_at(at(200)), Err(NotInHistory::TooOld));
    }

    #[test]
    fn time_does_not_run_backwards_and_equal_times_replace() {
        let mut history = history();
        assert!(!history.push(sample(119, 9.0)));
        assert!(history.push(sample(120, 6.0)));
        assert_eq!(history.position_at(at(120)).unwrap()[0], 6.0);
        assert_eq!(history.position_at(at(115)).unwrap()[0], 4.0);
    }

    #[test]
    fn keeps_its_memory() {
        let mut history = JointHistory::new(16, 0.05);
        let before = history.samples.capacity();
        for i in 0..1000 {
            history.push(sample(i, 0.0));
        }
        assert_eq!((history.samples.len(), history.samples.capacity()), (16, before));
    }
}
