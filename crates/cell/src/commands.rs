//! What became of the velocities that the arms were told.

use pb3dp_hal_middleware::LimiterStatistics;
use pb3dp_record::report::Table;
use serde::Serialize;

/// What became of the velocities of one arm.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct CommandSummary {
    /// The arm's name.
    pub name: &'static str,
    /// How many came to its limiter.
    pub velocities: u64,
    /// How many of them the limiter changed.
    pub changed: u64,
    /// How many were refused, by the limiter or behind it.
    pub refused: u64,
}

impl CommandSummary {
    /// From what the limiter of an arm has counted.
    pub fn of(name: &'static str, statistics: &LimiterStatistics) -> Self {
        let LimiterStatistics { velocity_commands, changed, refused, .. } = *statistics;
        Self { name, velocities: velocity_commands, changed, refused }
    }
}

/// The figures as a table of the report.
pub fn table(commands: &[CommandSummary]) -> Table {
    let headings = Table::new(["arm", "velocities", "changed by the limiter", "refused"]);
    commands.iter().fold(headings, |table, CommandSummary { name, velocities, changed, refused }| {
        table.row([(*name).to_owned(), velocities.to_string(), changed.to_string(), refused.to_string()])
    })
}

/// The figures as lines for a terminal.
pub fn text_lines(commands: &[CommandSummary]) -> String {
    let line = |CommandSummary { name, velocities, changed, refused }: &CommandSummary| {
        let what = format!("{name}, velocities");
        format!("{what:<34} {velocities}, {changed} changed by the limiter, {refused} refused\n")
    };
    commands.iter().map(line).collect()
}
