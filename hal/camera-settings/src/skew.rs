//! The cost of a skew: the position error of a target that moves between the exposures of both cameras.

use std::time::Duration;

/// Example of [`SkewCost::text`] without a calibration: distance and baseline of `pb3dp rig plan` by default, metres.
const EXAMPLE_DISTANCE_M: f64 = 0.5;
const EXAMPLE_BASELINE_M: f64 = 0.1;

/// The motion for which the cost of a skew is stated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SkewCost {
    /// Speed of the target relative to the cameras along the baseline, metres per second.
    pub speed_m_per_s: f64,
    /// Distance of the target, metres.
    pub distance_m: f64,
    /// Baseline of the stereo rig, metres; `None` without a calibration.
    pub baseline_m: Option<f64>,
}

impl SkewCost {
    /// Without a setup: the speed and the distance of `pb3dp rig plan` by default.
    pub const OF_NO_SETUP: Self = Self { speed_m_per_s: 0.1, distance_m: EXAMPLE_DISTANCE_M, baseline_m: None };

    /// Motion of the target during the skew, metres: the error parallel to the images.
    pub fn motion_m(&self, skew: Duration) -> f64 {
        self.speed_m_per_s * skew.as_secs_f64()
    }

    /// Depth error, metres; `None` without a baseline. The motion counts as disparity: z v t / b (docs/rig.md, Motion).
    pub fn depth_error_m(&self, skew: Duration) -> Option<f64> {
        let baseline_m = self.baseline_m.filter(|baseline_m| *baseline_m > 0.0)?;
        Some(self.motion_m(skew) * self.distance_m / baseline_m)
    }

    /// The cost in words: speed, distance, error.
    pub fn text(&self, skew: Duration) -> String {
        let (speed, motion) = (self.speed_m_per_s * 1e3, self.motion_m(skew) * 1e3);
        match self.depth_error_m(skew) {
            Some(error_m) => {
                let (distance, error) = (self.distance_m * 1e3, error_m * 1e3);
                format!("at {speed:.0} mm/s and a distance of {distance:.0} mm this is a depth error of {error:.2} mm")
            }
            None => {
                let [distance, baseline] = [EXAMPLE_DISTANCE_M, EXAMPLE_BASELINE_M].map(|metres| metres * 1e3);
                format!(
                    "at {speed:.0} mm/s the target moves by {motion:.2} mm meanwhile; without a calibration the baseline is unknown: at a \
                     distance of {distance:.0} mm and with a baseline of {baseline:.0} mm this is a depth error of {:.2} mm",
                    motion * distance / baseline
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cost_is_that_of_the_plan_of_a_rig() {
        // `pb3dp rig plan --baseline 100 --focal 740 --distance 500`: a skew of 5 ms costs 2.50 mm of depth at 100 mm/s.
        let cost = SkewCost { speed_m_per_s: 0.1, distance_m: 0.5, baseline_m: Some(0.1) };
        let skew = Duration::from_millis(5);
        assert!((cost.depth_error_m(skew).unwrap() - 2.5e-3).abs() < 1e-12);
        assert_eq!(cost.text(skew), "at 100 mm/s and a distance of 500 mm this is a depth error of 2.50 mm");
        let unknown = SkewCost { baseline_m: None, ..cost };
        assert_eq!(unknown.depth_error_m(skew), None);
        let text = unknown.text(skew);
        assert!(text.contains("moves by 0.50 mm") && text.contains("a depth error of 2.50 mm"), "{text}");
    }
}
