//! Ranges and ticks of an axis.

/// A range of values and its ticks.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Scale {
    pub(super) from: f64,
    pub(super) to: f64,
    pub(super) ticks: Vec<f64>,
    decimals: usize,
}

impl Scale {
    /// A scale over `from..to` with about `count` ticks at 1, 2 or 5 times a power of ten. An empty range is widened.
    pub(super) fn new(from: f64, to: f64, count: usize) -> Self {
        let (from, to) = widened(from, to);
        let raw = (to - from) / count.max(1) as f64;
        let power = 10_f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= raw * 0.999).unwrap_or(raw);
        let (first, last) = ((from / step - 1e-9).ceil() as i64, (to / step + 1e-9).floor() as i64);
        let decimals = (-(step.log10() + 1e-9).floor()).clamp(0.0, 9.0) as usize;
        Self { from, to, ticks: (first..=last).map(|i| i as f64 * step).collect(), decimals }
    }

    /// A scale that leaves a margin of a twentieth of the range at both ends.
    pub(super) fn with_margin(from: f64, to: f64, count: usize) -> Self {
        let (from, to) = widened(from, to);
        let margin = 0.05 * (to - from);
        Self::new(from - margin, to + margin, count)
    }

    /// Relative position of a value, 0 at `from` and 1 at `to`.
    pub(super) fn share(&self, value: f64) -> f64 {
        (value - self.from) / (self.to - self.from)
    }

    /// The label of a tick.
    pub(super) fn label(&self, tick: f64) -> String {
        // Adding zero turns a negative zero into zero.
        let label = format!("{:.*}", self.decimals, tick + 0.0);
        label.replace('-', "\u{2212}")
    }
}

fn widened(from: f64, to: f64) -> (f64, f64) {
    if !(from.is_finite() && to.is_finite()) {
        return (0.0, 1.0);
    }
    let (from, to) = if from <= to { (from, to) } else { (to, from) };
    let least = 1e-9_f64.max(1e-9 * from.abs().max(to.abs()));
    if to - from >= least { (from, to) } else { (from - 0.5_f64.max(1e3 * least), to + 0.5_f64.max(1e3 * least)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let check = |from, to, count, expected: &[&str]| {
            let scale = Scale::new(from, to, count);
            let labels: Vec<_> = scale.ticks.iter().map(|t| scale.label(*t)).collect();
            assert_eq!(labels, expected, "{from} to {to}");
        };
        check(0.0, 62.0, 7, &["0", "10", "20", "30", "40", "50", "60"]);
        check(-0.13, 0.12, 5, &["\u{2212}0.10", "\u{2212}0.05", "0.00", "0.05", "0.10"]);
        check(499.2, 503.1, 4, &["500", "501", "502", "503"]);
        check(0.0, 0.003, 3, &["0.000", "0.001", "0.002", "0.003"]);
        check(0.0, 1.0, 5, &["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
    }

    #[test]
    fn empty_reversed_and_undefined_ranges_still_give_a_scale() {
        let constant = Scale::new(3.0, 3.0, 4);
        assert!(constant.from < 3.0 && constant.to > 3.0 && constant.ticks.len() >= 3);
        assert_eq!(Scale::new(5.0, 1.0, 4), Scale::new(1.0, 5.0, 4));
        assert_eq!(Scale::new(f64::NAN, 1.0, 4).to, 1.0);
        let tiny = Scale::new(1e12, 1e12 + 1e-6, 4);
        assert!(tiny.ticks.len() < 20 && tiny.share(1e12).is_finite());
    }
}
