//! How punctual the cycles of a run in the machine's time were.

use std::time::Duration;

use pb3dp_hal_platform::jitter::{Jitter, JitterMeter};
use pb3dp_record::report::Table;
use pb3dp_setup::setup::Setup;
use serde::Serialize;

use super::parts::{LinkCounts, LinkMonitor};

/// What a thread of a run in the machine's time counts.
#[derive(Debug, Default)]
pub struct Beat {
    /// How late its cycles were.
    pub lateness: JitterMeter,
    /// Cycles that were left out.
    pub missed: u64,
    /// What it handed over and nobody took: a newer one was there first, or there was no room.
    pub dropped: u64,
}

/// How punctual the threads of a run in the machine's time were.
#[derive(Debug, Default)]
pub struct Punctuality {
    /// From the end of the exposure until the frame is there; frames that did not come, and those that were overwritten.
    pub capture: Beat,
    /// From the frame until what was seen is known to those who move; percepts that were overwritten, and what was not written down.
    pub estimation: Beat,
    /// From the time of a control step until it begins; steps that nobody took.
    pub control: Beat,
    /// From what was seen until it is written down; control steps that came too late for the truth to be known.
    pub recording: Beat,
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

/// How punctual one cycle was.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CycleSummary {
    /// Whose: a thread of the run, or the link of an arm.
    pub name: String,
    /// Time from one to the next, milliseconds.
    pub period_millis: f64,
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
    /// What was handed over and not taken: overwritten by something newer, or without room.
    pub dropped: u64,
    /// Replies that did not come in time.
    pub replies_lost: u64,
}

impl CycleSummary {
    /// Of what has this period and was so late; nothing was left out or lost.
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

    fn of_thread(name: &str, period: Duration, beat: &Beat) -> Self {
        let Beat { missed, dropped, .. } = *beat;
        Self { missed, dropped, ..Self::new(name, period, &beat.lateness.summary()) }
    }

    /// Of the link of an arm with this period.
    pub fn of_link(name: &str, period: Duration, monitor: &dyn LinkMonitor) -> Self {
        let LinkCounts { missed, replies_lost } = monitor.counts();
        Self { missed, replies_lost, ..Self::new(name, period, &monitor.lateness()) }
    }
}

const HEADINGS: [&str; 9] =
    ["cycle", "period, ms", "begun", "late p50, ms", "p99, ms", "max, ms", "left out", "not taken", "replies lost"];

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

/// The figures as a table of the report.
pub fn table(cycles: &[CycleSummary]) -> Table {
    cycles.iter().fold(Table::new(HEADINGS), |table, cycle| table.row(cycle.cells()))
}

/// The figures as lines for a terminal; nothing for a run in simulated time.
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
