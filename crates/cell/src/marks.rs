//! Experiment marks in a plot.

use pb3dp_record::report::LinePlot;

use super::log::RunLog;

/// Adds the marks of the experiment to a plot.
pub fn with_marks(plot: LinePlot, log: &RunLog) -> LinePlot {
    log.marks.iter().fold(plot, |plot, mark| plot.mark(mark.at_s, format!("({})", mark.number)))
}
