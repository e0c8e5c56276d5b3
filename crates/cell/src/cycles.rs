//! Timing of the cycles in a real-time run.

use std::time::Duration;

use pb3dp_hal_platform::jitter::{Jitter, JitterMeter};
use pb3dp_record::report::Table;
use pb3dp_setup::setup::Setup;
use serde::Serialize;

use super::devices::{LinkCounts, LinkMonitor};

/// Counters of one thread in a real-time run.
#[derive(Debug, Default)]
pub struct ThreadTiming {
    /// Lateness of its cycles.
    pub lateness: JitterMeter,
    /// Skipped cycles.
    pub missed: u64,
    /// Items handed over but not consumed: overwritten by a newer one, or no space.
    pub dropped: u64,
}

/// Timing of the threads in a real-time run.
#[derive(Debug, Default)]
pub struct Punctuality {
    /// From the end of the exposure to the frame; frames that did not arrive, and frames that were overwritten.
    pub capture: ThreadTiming,
    /// From the frame to the estimate at the motion half; percepts that were overwritten, and results that were not recorded.
    pub estimation: ThreadTiming,
    /// From the time of a control step to its begin; steps that were not consumed.
    pub control: ThreadTiming,
    /// From an estimate to its record; control steps that arrived too late for a true pose.
    pub recording: ThreadTiming,
}

impl Punctuality {
    /// One line for each thread.
    pub fn summaries(&self, setup: &Setup, replies_lost: u64) -> [CycleSummary; 4] {
        let (camera, control) = (setup.rig.frames.period, setup.control_period);
        [
            CycleSummary::of_thread("capture", camera, &self.capture),
            CycleSummary::of_thread("estimation", camera, &self.estimation),
            CycleSummary { replies_lost, ..CycleSummary::of_thread("control", control, &self.control) },
            CycleSummary::of_thread("recording", camera, &self.recording),
        ]
    }
}

/// Timing of one cycle.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CycleSummary {
    /// A thread of the run, or the link of an arm.
    pub name: String,
    /// Period, milliseconds.
    pub period_millis: f64,
    /// Number of cycles begun.
    pub cycles: u64,
    /// Median lateness, milliseconds.
    pub late_p50_millis: f64,
    /// 99th percentile of the lateness, milliseconds.
    pub late_p99_millis: f64,
    /// Largest lateness, milliseconds.
    pub late_max_millis: f64,
    /// Cycles skipped because their time had passed.
    pub missed: u64,
    /// Items not consumed: overwritten by a newer one, or no space.
    pub dropped: u64,
    /// Replies that did not arrive in time.
    pub replies_lost: u64,
}

impl CycleSummary {
    /// Timing of a cycle with this period and lateness; nothing skipped or lost.
    pub fn new(name: &str, period: Duration, jitter: &Jitter) -> Self {
        Self {
            name: name.to_owned(),
            period_millis: millis(period),
            cycles: jitter.cycles,
            late_p50_millis: millis(jitter.p50),
            late_p99_millis: millis(jitter.p99),
            late_max_millis: millis(jitter.max),
            missed: 0,
            dropped: 0,
            replies_lost: 0,
        }
    }

    fn of_thread(name: &str, period: Duration, timing: &ThreadTiming) -> Self {
        let ThreadTiming { missed, dropped, .. } = *timing;
        Self { missed, dropped, ..Self::new(name, period, &timing.lateness.summary()) }
    }

    /// Timing of an arm's link.
    pub fn of_link(name: &str, monitor: &dyn LinkMonitor) -> Self {
        let LinkCounts { missed, replies_lost } = monitor.counts();
        Self { missed, replies_lost, ..Self::new(name, monitor.period(), &monitor.lateness()) }
    }
}

const HEADINGS: [&str; 9] =
    ["cycle", "period, ms", "begun", "late p50, ms", "p99, ms", "max, ms", "skipped", "not consumed", "replies lost"];

impl CycleSummary {
    fn cells(&self) -> [String; 9] {
        let number = |value: f64| format!("{value:.2}");
        [
            self.name.clone(),
            number(self.period_millis),
            self.cycles.to_string(),
            number(self.late_p50_millis),
            number(self.late_p99_millis),
            number(self.late_max_millis),
            self.missed.to_string(),
            self.dropped.to_string(),
            self.replies_lost.to_string(),
        ]
    }
}

/// The figures as a report table.
pub fn table(cycles: &[CycleSummary]) -> Table {
    cycles.iter().fold(Table::new(HEADINGS), |table, cycle| table.row(cycle.cells()))
}

/// The figures as terminal lines; empty for a run in simulated time.
pub fn text_table(cycles: &[CycleSummary]) -> String {
    if cycles.is_empty() {
        return String::new();
    }
    let line = |[name, cells @ ..]: [String; 9]| {
        let cells: String = cells.iter().map(|cell| format!(" {cell:>12}")).collect();
        format!("{name:<16}{cells}\n")
    };
    let rows = std::iter::once(HEADINGS.map(str::to_owned)).chain(cycles.iter().map(CycleSummary::cells));
    std::iter::once("\n".to_owned()).chain(rows.map(line)).collect()
}

fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
