//! How punctual the cycles of a run in the machine's time were.

use std::time::Duration;

use pb3dp_arm_pa10::io::arm::{ArmMonitor, Jitter};
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
    /// Replies that did not come in time.
    pub replies_lost: u64,
}

impl CycleSummary {
    /// Of cycles that began so late.
    pub fn new(name: &str, jitter: &Jitter, missed: u64, replies_lost: u64) -> Self {
        Self {
            name: name.to_owned(),
            cycles: jitter.cycles,
            late_p50_millis: millis(jitter.p50),
            late_p99_millis: millis(jitter.p99),
            late_max_millis: millis(jitter.max),
            missed,
            replies_lost,
        }
    }

    /// Of the link of an arm.
    pub fn of_link(name: &str, monitor: &ArmMonitor) -> Self {
        let counters = monitor.snapshot().counters;
        Self::new(name, &monitor.jitter(), counters.overruns, counters.lost)
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
            self.replies_lost.to_string(),
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

fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
