//! Log lines for lost pairs: the first of each kind, then less and less often, and one when pairs arrive again.

/// Number of consecutive pairs that end a loss period: one second at 30 per second.
const CALM: u32 = 30;

/// Number of distinguished kinds of losses; further kinds share the last entry.
const KINDS_MAX: usize = 8;

/// Losses from the first one until pairs arrive again.
#[derive(Debug, Default)]
pub struct Losses {
    lost: u64,
    /// Pairs since the last loss.
    came: u32,
    /// Kinds already logged, without their numbers.
    reported: Vec<String>,
}

impl Losses {
    /// Counts a loss and its cause; returns a log line if one is due. A new kind is logged at once, the total after 2, 4, 8 losses and so
    /// on: a camera that is away for an hour, or that loses every other pair, produces twenty lines.
    pub fn add(&mut self, why: &str) -> Option<String> {
        self.lost += 1;
        self.came = 0;
        // The skew differs in every rejected pair; only the text identifies the kind.
        let kind: String = why.chars().filter(|letter| !letter.is_ascii_digit()).collect();
        let is_new = self.reported.len() < KINDS_MAX && !self.reported.contains(&kind);
        if is_new {
            self.reported.push(kind);
        }
        match self.lost {
            1 => Some(why.to_owned()),
            lost if is_new || lost.is_power_of_two() => Some(format!("{why} (pairs lost so far: {lost})")),
            _ => None,
        }
    }

    /// Counts an arrived pair; returns a log line if a loss period ends.
    pub fn pair_has_come(&mut self) -> Option<String> {
        self.came = self.came.saturating_add(1);
        if self.lost == 0 || self.came < CALM {
            return None;
        }
        let Self { lost, .. } = std::mem::take(self);
        (lost > 1).then(|| format!("camera: pairs arrive again, {lost} were lost"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_camera_is_reported_at_once_then_seldom_and_when_it_is_back() {
        let mut losses = Losses::default();
        let lines: Vec<_> = (0..100).filter_map(|_| losses.add("left: no pairs")).collect();
        assert_eq!(lines[0], "left: no pairs");
        assert_eq!((lines.len(), lines[6].as_str()), (7, "left: no pairs (pairs lost so far: 64)"));
        let lines: Vec<_> = (0..100).map(|_| losses.pair_has_come()).collect();
        assert_eq!(lines[29].as_deref(), Some("camera: pairs arrive again, 100 were lost"));
        assert_eq!(lines.iter().flatten().count(), 1);
        // The next period is logged anew, and a single pair gets no second line.
        assert_eq!(losses.add("left: no pairs").as_deref(), Some("left: no pairs"));
        assert!((0..100).all(|_| losses.pair_has_come().is_none()));
    }

    #[test]
    fn where_every_other_pair_is_refused_the_log_does_not_flood() {
        let mut losses = Losses::default();
        let mut lines = Vec::new();
        // Ten minutes.
        for k in 0..9000 {
            lines.extend(losses.add(&format!("right was exposed {}.{} ms after left", 5 + k % 7, k % 10)));
            lines.extend(losses.pair_has_come());
        }
        assert_eq!(lines.len(), 14, "{lines:#?}");
    }

    #[test]
    fn another_reason_is_reported_at_once_and_two_alternating_ones_once_each() {
        let mut losses = Losses::default();
        let lines: Vec<_> = (0..1000)
            .flat_map(|_| ["skew too large", "damaged"])
            .filter_map(|why| losses.add(why))
            .filter(|line| line.contains("damaged"))
            .collect();
        assert_eq!(lines[0], "damaged (pairs lost so far: 2)");
        assert!(lines.len() < 12, "{lines:#?}");
        // For any number of kinds.
        let many = (0..1000).filter(|k| losses.add(&"x".repeat(*k)).is_some()).count();
        assert!(many < 10, "{many}");
    }
}
