//! Pending faults.

use pb3dp_geometry::MonotonicTime;

use super::fault::Fault;
use super::random::Random;
use super::script::{ScriptLine, When};

/// Pending faults, by time or by probability.
#[derive(Clone, Debug)]
pub(super) struct Schedule {
    start: MonotonicTime,
    random: Random,
    /// By time; those of one moment in the order in which they were given.
    timed: Vec<(MonotonicTime, Fault)>,
    chances: Vec<Chance>,
}

#[derive(Clone, Copy, Debug)]
struct Chance {
    probability: f64,
    at_most_in_a_row: Option<u32>,
    in_a_row: u32,
    fault: Fault,
}

impl Schedule {
    pub fn new(start: MonotonicTime, random: Random) -> Self {
        Self { start, random, timed: Vec::new(), chances: Vec::new() }
    }

    pub fn add(&mut self, now: MonotonicTime, line: &ScriptLine) {
        let fault = line.fault;
        let at = match line.when {
            When::Now => now,
            When::In(time) => now + time,
            When::At(time) => self.start + time,
            When::Chance { probability, at_most_in_a_row } => {
                self.chances.push(Chance { probability, at_most_in_a_row, in_a_row: 0, fault });
                return;
            }
        };
        let place = self.timed.partition_point(|(earlier, _)| *earlier <= at);
        self.timed.insert(place, (at, fault));
    }

    pub fn next(&self) -> Option<MonotonicTime> {
        self.timed.first().map(|(at, _)| *at)
    }

    pub fn pop(&mut self, now: MonotonicTime) -> Option<Fault> {
        let due = self.next()? <= now;
        due.then(|| self.timed.remove(0).1)
    }

    /// Random faults at an answered message.
    pub fn roll(&mut self) -> Vec<Fault> {
        let mut faults = Vec::new();
        for chance in &mut self.chances {
            let hit = self.random.unit() < chance.probability;
            let allowed = chance.at_most_in_a_row.is_none_or(|most| chance.in_a_row < most);
            if hit && allowed {
                chance.in_a_row += 1;
                faults.push(chance.fault);
            } else {
                chance.in_a_row = 0;
            }
        }
        faults
    }
}
