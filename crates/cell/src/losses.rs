//! What the log says of pairs that do not come: the first of its kind, then less and less often, and once when pairs come again.

/// So many pairs in a row end a time in which pairs are lost: a second at 30 per second.
const CALM: u32 = 30;

/// Kinds of losses that are told apart; others count with the rest.
const KINDS_MAX: usize = 8;

/// Pairs that did not come, from the first one until they come again, each of them.
#[derive(Debug, Default)]
pub struct Losses {
    lost: u64,
    /// Pairs since the last loss.
    came: u32,
    /// Kinds that were told, without their numbers.
    told: Vec<String>,
}

impl Losses {
    /// One more, and why: what is to be said of it. A kind is told at once, all losses together when there were 2, 4, 8 of them:
    /// a camera that is away for an hour, or every other pair that is refused, is told in twenty lines.
    pub fn add(&mut self, why: &str) -> Option<String> {
        self.lost += 1;
        self.came = 0;
        // Each pair that is refused has a skew of its own; that is no news.
        let kind: String = why.chars().filter(|letter| !letter.is_ascii_digit()).collect();
        let is_new = self.told.len() < KINDS_MAX && !self.told.contains(&kind);
        if is_new {
            self.told.push(kind);
        }
        match self.lost {
            1 => Some(why.to_owned()),
            lost if is_new || lost.is_power_of_two() => Some(format!("{why} (pairs that did not come so far: {lost})")),
            _ => None,
        }
    }

    /// A pair has come: what is to be said of that.
    pub fn pair_has_come(&mut self) -> Option<String> {
        self.came = self.came.saturating_add(1);
        if self.lost == 0 || self.came < CALM {
            return None;
        }
        let Self { lost, .. } = std::mem::take(self);
        (lost > 1).then(|| format!("camera: pairs come again, {lost} did not"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_that_is_away_is_told_at_once_then_seldom_and_when_it_is_back() {
        let mut losses = Losses::default();
        let said: Vec<_> = (0..100).filter_map(|_| losses.add("left: no pairs")).collect();
        assert_eq!(said[0], "left: no pairs");
        assert_eq!((said.len(), said[6].as_str()), (7, "left: no pairs (pairs that did not come so far: 64)"));
        let said: Vec<_> = (0..100).map(|_| losses.pair_has_come()).collect();
        assert_eq!(said[29].as_deref(), Some("camera: pairs come again, 100 did not"));
        assert_eq!(said.iter().flatten().count(), 1);
        // The next time is told anew, and one pair is not worth a second line.
        assert_eq!(losses.add("left: no pairs").as_deref(), Some("left: no pairs"));
        assert!((0..100).all(|_| losses.pair_has_come().is_none()));
    }

    #[test]
    fn where_every_other_pair_is_refused_the_log_does_not_flood() {
        let mut losses = Losses::default();
        let mut said = Vec::new();
        // Ten minutes.
        for k in 0..9000 {
            said.extend(losses.add(&format!("right was exposed {}.{} ms after left", 5 + k % 7, k % 10)));
            said.extend(losses.pair_has_come());
        }
        assert_eq!(said.len(), 14, "{said:#?}");
    }

    #[test]
    fn another_reason_is_told_at_once_and_two_in_turn_are_told_once_each() {
        let mut losses = Losses::default();
        let said: Vec<_> = (0..1000)
            .flat_map(|_| ["too far apart", "damaged"])
            .filter_map(|why| losses.add(why))
            .filter(|line| line.contains("damaged"))
            .collect();
        assert_eq!(said[0], "damaged (pairs that did not come so far: 2)");
        assert!(said.len() < 12, "{said:#?}");
        // However many reasons there are.
        let many = (0..1000).filter(|k| losses.add(&"x".repeat(*k)).is_some()).count();
        assert!(many < 10, "{many}");
    }
}
