//! How punctual the cycles of a run in the machine's time were.

use std::time::Duration;

use pb3dp_arm_pa10::io::arm::ArmMonitor;
use pb3dp_record::report::Table;
use serde::Serialize;

/// How punctual one cycle was.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CycleSummary {
    /// Whose: the control loop, or the link of an arm.
    pub name: String,
    /// How many were begun.
    pub cycles: u64,
    /// Half of them began at most this late, milliseconds.
    pub late_p50_millis: f64,
    /// 99 of 100 began at most this late, milliseconds.
    pub late_p99_millis: f64,
    /// The latest, milliseconds.
    pub late_max_millis: f64,
    /// Cycles that were left out because their time had passed.
    pub missed: u64,
    /// Replies that did not come in time; of a link.
    pub replies_lost: Option<u64>,
}

impl CycleSummary {
    /// Of the link of an arm.
    pub fn of_link(name: &str, monitor: &ArmMonitor) -> Self {
        let (jitter, counters) = (monitor.jitter(), monitor.snapshot().counters);
        Self {
            name: name.to_owned(),
            cycles: jitter.cycles,
            late_p50_millis: millis(jitter.p50),
            late_p99_millis: millis(jitter.p99),
            late_max_millis: millis(jitter.max),
            missed: counters.overruns,
            replies_lost: Some(counters.lost),
        }
    }
}

const HEADINGS: [&str; 7] = ["cycle", "begun", "late p50, ms", "p99, ms", "max, ms", "left out", "replies lost"];

impl CycleSummary {
    fn cells(&self) -> [String; 7] {
        let number = |value: f64| format!("{value:.2}");
        [
            self.name.clone(),
            self.cycles.to_string(),
            number(self.late_p50_millis),
            number(self.late_p99_millis),
            number(self.late_max_millis),
            self.missed.to_string(),
            self.replies_lost.map_or("-".to_owned(), |lost| lost.to_string()),
        ]
    }
}

/// The figures as a table of the report.
pub fn table(cycles: &[CycleSummary]) -> Table {
    cycles.iter().fold(Table::new(HEADINGS), |table, cycle| table.row(cycle.cells()))
}

/// The figures as lines for a terminal; nothing for a run in simulated time.
pub fn text_table(cycles: &[CycleSummary]) -> String {
    if cycles.is_empty() {
        return String::new();
    }
    let line = |[name, cells @ ..]: [String; 7]| {
        let cells: String = cells.iter().map(|cell| format!(" {cell:>12}")).collect();
        format!("{name:<16}{cells}\n")
    };
    let rows = std::iter::once(HEADINGS.map(str::to_owned)).chain(cycles.iter().map(CycleSummary::cells));
    std::iter::once("\n".to_owned()).chain(rows.map(line)).collect()
}

/// Steps of lateness that are told apart, and how many: up to a quarter of a second.
const STEP: Duration = Duration::from_micros(10);
const STEPS: usize = 25_000;

/// Collects how late cycles begin; allocates nothing after it was made.
pub struct Lateness {
    counts: Vec<u64>,
    max: Duration,
    missed: u64,
}

impl Default for Lateness {
    fn default() -> Self {
        Self { counts: vec![0; STEPS], max: Duration::ZERO, missed: 0 }
    }
}

impl Lateness {
    /// A cycle began so late.
    pub fn record(&mut self, late: Duration) {
        let step = usize::try_from(late.as_nanos() / STEP.as_nanos()).unwrap_or(usize::MAX);
        self.counts[step.min(STEPS - 1)] += 1;
        self.max = self.max.max(late);
    }

    /// A cycle was left out.
    pub fn miss(&mut self) {
        self.missed += 1;
    }

    /// The figures.
    pub fn summary(&self, name: &str) -> CycleSummary {
        let cycles: u64 = self.counts.iter().sum();
        let at_most = |percent: u64| {
            let wanted = (cycles * percent).div_ceil(100).max(1);
            let mut seen = 0;
            let found = self.counts.iter().position(|count| {
                seen += count;
                seen >= wanted
            });
            let steps = found.map_or(0, |step| u32::try_from(step + 1).unwrap_or(u32::MAX));
            (STEP * steps).min(self.max)
        };
        CycleSummary {
            name: name.to_owned(),
            cycles,
            late_p50_millis: millis(at_most(50)),
            late_p99_millis: millis(at_most(99)),
            late_max_millis: millis(self.max),
            missed: self.missed,
            replies_lost: None,
        }
    }
}

fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_exact_to_a_step() {
        let mut lateness = Lateness::default();
        for late_us in 1..=1000 {
            lateness.record(Duration::from_micros(late_us));
        }
        lateness.record(Duration::from_secs(2));
        lateness.miss();
        let summary = lateness.summary("control loop");
        assert_eq!((summary.cycles, summary.missed), (1001, 1));
        assert!((summary.late_p50_millis - 0.505).abs() < 0.02, "{summary:?}");
        assert!((summary.late_p99_millis - 0.99).abs() < 0.02, "{summary:?}");
        assert_eq!(summary.late_max_millis, 2000.0);
        let empty = Lateness::default().summary("");
        assert_eq!((empty.cycles, empty.late_p99_millis), (0, 0.0));
    }
}
