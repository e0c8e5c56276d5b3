//! Counts of the velocity commands sent to the arms.

use pb3dp_hal_middleware::LimiterStatistics;
use pb3dp_record::report::Table;
use serde::Serialize;

/// Velocity command counts of one arm.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CommandSummary {
    /// The arm's name.
    pub name: &'static str,
    /// Velocity commands that reached its limiter.
    pub velocities: u64,
    /// Commands that the limiter changed.
    pub changed: u64,
    /// Commands refused by the limiter or by the arm.
    pub refused: u64,
}

impl CommandSummary {
    /// From the limiter's statistics.
    pub fn of(name: &'static str, statistics: &LimiterStatistics) -> Self {
        let LimiterStatistics { velocity_commands, changed, refused, .. } = *statistics;
        Self { name, velocities: velocity_commands, changed, refused }
    }
}

/// What a count of changes means.
const CHANGES: &str = "Changes by the limiter are normal: it keeps the limits of speed, acceleration, jerk and range (docs/arm-limits.md).";

/// The counts in words.
pub fn paragraph() -> String {
    format!("Velocity commands per arm. {CHANGES} A refused command makes the arm hold.")
}

/// The counts as a report table.
pub fn table(commands: &[CommandSummary]) -> Table {
    let headings = Table::new(["arm", "velocities", "changed by the limiter", "refused"]);
    commands.iter().fold(headings, |table, CommandSummary { name, velocities, changed, refused }| {
        table.row([(*name).to_owned(), velocities.to_string(), changed.to_string(), refused.to_string()])
    })
}

/// The counts as terminal lines.
pub fn text_lines(commands: &[CommandSummary]) -> String {
    let line = |CommandSummary { name, velocities, changed, refused }: &CommandSummary| {
        let what = format!("{name}, velocities");
        format!("{what:<34} {velocities}, {changed} changed by the limiter, {refused} refused\n")
    };
    let has_changes = commands.iter().any(|command| command.changed > 0);
    let note = has_changes.then(|| format!("{CHANGES}\n"));
    commands.iter().map(line).chain(note).collect()
}
