//! Counters, and their table.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Duration;

use anyhow::{Result, bail};
use pb3dp_arm_pa10::driver::LinkCounters;
use pb3dp_hal_platform::jitter::Jitter;

use crate::rig::{AT_REST_RAD_PER_S, DEADLINE, Stopped};

/// The run ends after this many stops without a reason.
const FALSE_STOPS_MAX: usize = 50;

/// Counters of a run.
#[derive(Default)]
pub struct Figures {
    cycles: u64,
    missed_deadlines: u64,
    late_elsewhere: u64,
    lateness_max: Duration,
    late_replies: u64,
    kinds: BTreeMap<&'static str, Kind>,
    /// Stops after the control loop missed a deadline.
    late_stops: u64,
    false_stops: Vec<String>,
    enabled: u64,
    tries_more: u64,
    links: Vec<(String, LinkCounters, Jitter)>,
}

/// Counters of one kind of fault.
#[derive(Default)]
struct Kind {
    injected: u64,
    borne: u64,
    /// Stopped an arm although the fault should be tolerated.
    not_borne: u64,
    /// Time until the control loop got the report, and until both arms were stationary.
    stops: Vec<(Duration, Duration)>,
    /// None for a tolerated fault.
    rest_max_millis: Option<u64>,
    /// Stops after which the arms were stationary too late.
    too_late: u64,
}

impl Figures {
    /// A control step started this late.
    pub fn cycle(&mut self, late: Duration) {
        self.cycles += 1;
        self.missed_deadlines += u64::from(late > DEADLINE);
        self.lateness_max = self.lateness_max.max(late);
    }

    /// This many cycles of links and emulated arms started later than a deadline.
    pub fn late_elsewhere(&mut self, cycles: u64) {
        self.late_elsewhere += cycles;
    }

    /// An arm had no measurement in time.
    pub fn late_reply(&mut self) {
        self.late_replies += 1;
    }

    /// Both arms were enabled after this many failed attempts.
    pub fn enabled_after(&mut self, tries: usize) {
        self.enabled += 1;
        self.tries_more += tries as u64;
    }

    /// An arm stopped without an injected fault: because the control loop was late, or without a reason.
    ///
    /// # Errors
    /// After too many stops without a reason.
    pub fn stopped_by_itself(&mut self, stopped: &Stopped) -> Result<()> {
        let why = &stopped.message;
        if stopped.was_late {
            self.late_stops += 1;
            return Ok(());
        }
        self.false_stops.push(why.clone());
        if self.false_stops.len() > FALSE_STOPS_MAX {
            bail!("{} stops without a reason; the last one: {why}", self.false_stops.len());
        }
        Ok(())
    }

    /// A fault starts, after which both arms must be stationary within this time, milliseconds; none for a tolerated fault.
    /// One of the three methods below follows, unless the fault should stop the arms and is not detected.
    pub fn injected(&mut self, name: &'static str, rest_max_millis: Option<u64>) {
        let kind = self.kinds.entry(name).or_default();
        kind.injected += 1;
        kind.rest_max_millis = rest_max_millis;
    }

    /// A fault was tolerated, as it should be.
    pub fn borne(&mut self, name: &'static str) {
        self.kinds.entry(name).or_default().borne += 1;
    }

    /// A fault stopped an arm, but should be tolerated.
    pub fn not_borne(&mut self, name: &'static str) {
        self.kinds.entry(name).or_default().not_borne += 1;
    }

    /// A fault stopped the arms: time until the control loop got the report, and until both arms were stationary.
    pub fn stopped(&mut self, name: &'static str, times: (Duration, Duration)) {
        let kind = self.kinds.entry(name).or_default();
        kind.too_late += u64::from(kind.rest_max_millis.is_some_and(|most| times.1 > Duration::from_millis(most)));
        kind.stops.push(times);
    }

    /// Counters of a link.
    pub fn link(&mut self, name: &str, counters: &LinkCounters, jitter: &Jitter) {
        self.links.push((name.to_owned(), *counters, *jitter));
    }

    fn undetected(&self) -> u64 {
        self.kinds.values().map(|kind| kind.injected - kind.borne - kind.not_borne - kind.stops.len() as u64).sum()
    }

    /// The tables as text.
    pub fn text(&self) -> String {
        let mut text = self.tables();
        for why in &self.false_stops {
            let _ = writeln!(text, "\nstopped without a reason: {why}");
        }
        text
    }

    fn tables(&self) -> String {
        let injected: u64 = self.kinds.values().map(|kind| kind.injected).sum();
        let late = format!("started more than {} ms late", millis(DEADLINE));
        let mut text = String::from("| figure | |\n|---|---:|\n");
        for (name, value) in [
            ("control steps", self.cycles.to_string()),
            (late.as_str(), self.missed_deadlines.to_string()),
            ("cycles of links and emulated arms that were as late", self.late_elsewhere.to_string()),
            ("latest control step, ms", format!("{:.2}", millis(self.lateness_max))),
            ("late measurements", self.late_replies.to_string()),
            ("faults injected", injected.to_string()),
            ("not detected", self.undetected().to_string()),
            ("stops after a delay of that size", self.late_stops.to_string()),
            ("stops without a reason", self.false_stops.len().to_string()),
            ("times enabled", self.enabled.to_string()),
            ("failed attempts to enable", self.tries_more.to_string()),
        ] {
            let _ = writeln!(text, "| {name} | {value} |");
        }
        if !self.kinds.is_empty() {
            text += &self.faults();
        }
        text += &self.links();
        text
    }

    fn faults(&self) -> String {
        let mut text = String::from(
            "\n| fault | injected | detected, ms: p50 | p99 | max | stationary, ms: p50 | p99 | max | limit | later |\n",
        );
        text += "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n";
        let mut all = Kind::default();
        for (name, kind) in &self.kinds {
            text += &kind.row(name);
            if kind.rest_max_millis.is_some() {
                all.injected += kind.injected;
                all.stops.extend(&kind.stops);
                all.too_late += kind.too_late;
            }
        }
        text += &all.row("all stops");
        text
    }

    fn links(&self) -> String {
        let mut text =
            String::from("\n| link | sent | lost | late | damaged | foreign | cycles late, ms: p50 | p99 | max |\n");
        text += "|---|---:|---:|---:|---:|---:|---:|---:|---:|\n";
        for (name, counters, jitter) in &self.links {
            let LinkCounters { sent, lost, late, damaged, mismatched, .. } = counters;
            let [p50, p99, max] = [jitter.p50, jitter.p99, jitter.max].map(|late| format!("{:.2}", millis(late)));
            let _ = writeln!(
                text,
                "| {name} | {sent} | {lost} | {late} | {damaged} | {mismatched} | {p50} | {p99} | {max} |"
            );
        }
        text
    }

    /// # Errors
    /// If a fault was not detected, or an arm was stationary too late or stopped without a reason.
    pub fn judge(&self) -> Result<()> {
        let (undetected, without_reason) = (self.undetected(), self.false_stops.len());
        let too_late: u64 = self.kinds.values().map(|kind| kind.too_late).sum();
        if undetected > 0 || without_reason > 0 || too_late > 0 {
            bail!(
                "{undetected} faults were not detected, arms were stationary too late {too_late} times, {without_reason} stops had no reason"
            );
        }
        Ok(())
    }
}

/// The documentation page with the figures of both runs: with faults, and with lost replies only.
pub fn page(origin: &str, (minutes, seed): (f64, u64), (faults, losses): (&Figures, &Figures)) -> String {
    format!(
        "# Arms\n\nThis page is written by the command below; change the program, not the page.\n\n\
         Two emulated arms on pseudo-terminals, as in `configs/hil.toml`, with limiter, coupling, guard and driver; all \
         joints move; the control rate is 100 Hz.\n\
         One of a hundred replies of each controller is lost throughout, never three in a row.\n\n\
         ```text\ncargo xtask soak --page --minutes {minutes} --seed {seed}\n```\n\n{origin}\n\n\
         ## With faults\n\n\
         For {minutes} minutes one of the arms gets random faults, in the commands of [mock-arm.md](../mock-arm.md).\n\
         After each fault both arms are reset and enabled again, which tests the links with 100 exchanges: the arms move for a \
         quarter of the time.\n\n\
         * **detected**: time from the fault to its report to the control loop.\n\
         * **stationary**: time from the fault until all joints of both arms are slower than {AT_REST_RAD_PER_S} rad/s; \
         the joints are checked every millisecond.\n\
         * **limit**, **later**: time until both must be stationary, and number of later stops.\n  Detected by controller or gateway: 30 ms \
         down to speed 0, the lag of the drives, and 20 ms.\n  Detected by missing messages: up to 50 ms more.\n  Detected by the joints: \
         two wrong angles, and the brakes.\n\
         * Tolerated faults must not stop an arm; all other faults must.\n\n{}\n\
         ## With lost replies only\n\n\
         For {minutes} minutes the arms move throughout.\nOne of a hundred replies of each gateway is also lost on its line, never three in \
         a row, and no loss may stop the arms (`--losses-only`).\n\
         The gateway tolerates the lost replies of its controller, the host those of the line.\n\n{}",
        faults.tables(),
        losses.tables()
    )
}

impl Kind {
    fn row(&self, name: &str) -> String {
        let column = |pick: fn(&(Duration, Duration)) -> Duration| -> [String; 3] {
            let mut sorted: Vec<Duration> = self.stops.iter().map(pick).collect();
            sorted.sort();
            [50, 99, 100].map(|percent| {
                let at = (sorted.len() * percent).div_ceil(100).max(1) - 1;
                sorted.get(at).map_or("-".to_owned(), |&time| format!("{:.0}", millis(time)))
            })
        };
        let cells = [column(|(noticed, _)| *noticed), column(|(_, rest)| *rest)].concat().join(" | ");
        let allowed = self.rest_max_millis.map_or("-".to_owned(), |millis| millis.to_string());
        let later = if self.stops.is_empty() { "-".to_owned() } else { self.too_late.to_string() };
        format!("| {name} | {} | {cells} | {allowed} | {later} |\n", self.injected)
    }
}

fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An injected fault that should be tolerated but stops an arm is counted; every stop without a reason is counted, too.
    #[test]
    fn every_fault_is_counted_whatever_becomes_of_it() {
        let mut figures = Figures::default();
        for (name, rest_max_millis) in
            [("borne", None), ("not borne", None), ("stops", Some(100)), ("unnoticed", Some(100))]
        {
            figures.injected(name, rest_max_millis);
        }
        figures.borne("borne");
        figures.not_borne("not borne");
        figures.stopped("stops", (Duration::from_millis(20), Duration::from_millis(101)));
        let text = figures.text();
        for line in ["| faults injected | 4 |", "| not detected | 1 |", "| not borne | 1 |", "| all stops | 2 |"] {
            assert!(text.contains(line), "{line} is missing in\n{text}");
        }
        let judgement = figures.judge().unwrap_err().to_string();
        assert!(judgement.starts_with("1 faults were not detected, arms were"), "{judgement}");
    }
}
