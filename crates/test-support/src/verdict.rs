//! Decides whether a real-time failure is caused by the product or the machine.

use std::time::Duration;

use crate::witness::{Delay, PERIOD, TOO_LATE, Testimony};

/// Words used by the product and its tests for lateness of threads and lines.
const LATENESS: [&str; 11] = [
    "began late",
    "cycle-missed",
    "CycleMissed",
    "Overrun",
    "Some(Slow {",
    "in a row without a usable reply",
    "stopped the arm: host-silent",
    "the newest measurement is",
    "the brakes stay closed",
    "too loaded",
    "Timeout",
];

/// The cause of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blame {
    /// The machine met its deadlines: the failure counts at once.
    Product,
    /// The test reports lateness, and a witness was equally late at that time: the try is inconclusive.
    Machine,
    /// The machine was late, but the failure is not lateness: the test is tried again, and the failure counts if no try passes.
    Unclear,
}

/// Judges a failure by its text, by the delays recorded by the test itself, and by the observations of the witnesses.
pub fn judge(text: &str, own: &[Delay], testimony: &Testimony) -> Blame {
    let longest = own.iter().max_by_key(|delay| delay.late).filter(|delay| delay.late > TOO_LATE);
    let is_lateness = longest.is_some() || LATENESS.iter().any(|word| text.contains(word));
    let was_as_late = match longest {
        Some(own) => testimony.delays.iter().any(|delay| delay.overlaps(own) && delay.late + PERIOD >= own.late),
        None => testimony.worst > TOO_LATE,
    };
    match (is_lateness, was_as_late) {
        (true, true) => Blame::Machine,
        _ if testimony.worst <= TOO_LATE => Blame::Product,
        _ => Blame::Unclear,
    }
}

/// The result after the tries of a test.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The test is tried again.
    Open,
    /// The test fails with its last failure.
    Failed,
    /// Every try failed by lateness, and the machine was equally late each time.
    NotChecked {
        /// The longest delay of the machine.
        worst: Duration,
    },
}

/// The tries of one test so far.
#[derive(Clone, Debug, Default)]
pub struct Tries {
    failures: u32,
    excused: u32,
    worst: Duration,
}

impl Tries {
    /// Maximum number of tries.
    pub const MAX: u32 = 7;

    /// Updates the verdict after one more failure.
    pub fn failed(&mut self, blame: Blame, testimony: &Testimony) -> Verdict {
        self.failures += 1;
        self.excused += u32::from(blame == Blame::Machine);
        self.worst = self.worst.max(testimony.worst);
        match blame {
            Blame::Product => Verdict::Failed,
            _ if self.failures < Self::MAX => Verdict::Open,
            _ if self.excused == Self::MAX => Verdict::NotChecked { worst: self.worst },
            _ => Verdict::Failed,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;

    const ON_TIME: Duration = Duration::from_millis(2);
    const LATE: Duration = Duration::from_millis(30);

    fn testimony(late: Duration) -> Testimony {
        let at = Instant::now() + Duration::from_secs(5);
        Testimony { delays: vec![Delay { at, late }], worst: late }
    }

    #[test]
    fn only_lateness_beside_a_late_witness_is_the_machines() {
        for (text, late, expected) in [
            ("moved by 0.3 rad", ON_TIME, Blame::Product),
            ("latched CycleMissed", ON_TIME, Blame::Product),
            ("latched CycleMissed", LATE, Blame::Machine),
            // A driver refuses to enable an arm whose last exchanges were slow.
            ("None Some(Slow { slow: 2, exchanges: 100, worst: 15.2ms })", LATE, Blame::Machine),
            ("fault: the gateway stopped the arm: host-silent; the program that", LATE, Blame::Machine),
            ("fault: the gateway stopped the arm: host-silent; the program that", ON_TIME, Blame::Product),
            ("moved by 0.3 rad", LATE, Blame::Unclear),
        ] {
            assert_eq!(judge(text, &[], &testimony(late)), expected, "{text}, witness {late:?} late");
        }
    }

    #[test]
    fn a_witness_excuses_what_was_late_in_the_same_moment_by_as_much() {
        let testimony = testimony(LATE);
        let at = testimony.delays[0].at;
        let own = |at, late| [Delay { at, late }];
        let judged = |own: &[Delay]| judge("stopped", own, &testimony);
        assert_eq!(judged(&own(at, LATE)), Blame::Machine);
        assert_eq!(judged(&own(at, LATE * 2)), Blame::Unclear);
        assert_eq!(judged(&own(at + Duration::from_secs(1), LATE)), Blame::Unclear);
    }

    fn verdicts(blames: &[(Blame, u32)]) -> Verdict {
        let mut tries = Tries::default();
        let all = blames.iter().flat_map(|(blame, count)| (0..*count).map(|_| *blame));
        all.map(|blame| tries.failed(blame, &testimony(LATE))).last().expect("a failure")
    }

    #[test]
    fn seven_failures_fail_unless_the_machine_caused_every_one() {
        use Blame::{Machine, Product, Unclear};
        assert_eq!(verdicts(&[(Product, 1)]), Verdict::Failed);
        assert_eq!(verdicts(&[(Machine, 3), (Product, 1)]), Verdict::Failed);
        assert_eq!(verdicts(&[(Unclear, 6)]), Verdict::Open);
        assert_eq!(verdicts(&[(Unclear, 7)]), Verdict::Failed);
        assert_eq!(verdicts(&[(Machine, 6), (Unclear, 1)]), Verdict::Failed);
        assert_eq!(verdicts(&[(Machine, 7)]), Verdict::NotChecked { worst: LATE });
    }
}
