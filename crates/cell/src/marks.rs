//! Marks of the experiment in a plot.

use pb3dp_record::report::LinePlot;

use super::log::RunLog;

/// The plot with the marks of the experiment.
pub fn with_marks(plot: LinePlot, log: &RunLog) -> LinePlot {
    log.marks.iter().fold(plot, |plot, mark| plot.mark(mark.at_s, format!("({})", mark.number)))
}
