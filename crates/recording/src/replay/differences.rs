//! What differs between a recording and its replay, and since when.

use std::collections::BTreeMap;

/// What is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// Status, pose and covariance of each pair.
    Estimates,
    /// Pose of the target by the filter, in each step.
    Filter,
    /// Calls of the arms, with their velocities.
    Commands,
    /// Mode of the controller, state and reason of the supervisor.
    Decisions,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Estimates, Self::Filter, Self::Commands, Self::Decisions];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Estimates => "estimates",
            Self::Filter => "filter",
            Self::Commands => "commands",
            Self::Decisions => "decisions",
        }
    }
}

/// Comparisons of one kind.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Compared {
    /// Number of comparisons.
    pub compared: u64,
    /// Number that differed.
    pub differing: u64,
    /// The first difference.
    pub first: Option<First>,
}

/// The first difference of a kind.
#[derive(Clone, Debug, PartialEq)]
pub struct First {
    /// Time since the begin of the run, seconds.
    pub t_s: f64,
    /// In the recording.
    pub recorded: String,
    /// In the replay.
    pub now: String,
}

/// Comparisons of all kinds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Differences(BTreeMap<Kind, Compared>);

impl Differences {
    /// Compares; `texts` gives both values, the recorded one first.
    pub fn compare(&mut self, kind: Kind, t_s: f64, is_same: bool, texts: impl FnOnce() -> (String, String)) {
        if is_same {
            self.0.entry(kind).or_default().compared += 1;
            return;
        }
        let (recorded, now) = texts();
        self.differ(kind, t_s, recorded, now);
    }

    /// A difference.
    pub fn differ(&mut self, kind: Kind, t_s: f64, recorded: String, now: String) {
        let entry = self.0.entry(kind).or_default();
        entry.compared += 1;
        entry.differing += 1;
        entry.first.get_or_insert(First { t_s, recorded, now });
    }

    /// Adds others, which came later.
    pub fn add(&mut self, later: Self) {
        for (kind, other) in later.0 {
            let entry = self.0.entry(kind).or_default();
            entry.compared += other.compared;
            entry.differing += other.differing;
            entry.first = entry.first.take().or(other.first);
        }
    }

    /// The comparisons of a kind.
    pub fn of(&self, kind: Kind) -> Compared {
        self.0.get(&kind).cloned().unwrap_or_default()
    }

    /// Whether anything differed.
    pub fn any(&self) -> bool {
        self.0.values().any(|compared| compared.differing > 0)
    }

    /// A line for each kind, with its first difference.
    pub fn text(&self) -> String {
        let line = |kind: Kind| {
            let Compared { compared, differing, first } = self.of(kind);
            let first = first.map_or(String::new(), |First { t_s, recorded, now }| {
                format!("\n    first at {t_s:.3} s\n    recorded: {recorded}\n    now:      {now}")
            });
            format!("{:<10} {compared:>8} compared, {differing} differ{first}\n", kind.name())
        };
        Kind::ALL.map(line).concat()
    }
}
