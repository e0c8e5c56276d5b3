//! `pb3dp arm probe`: everything measurable on an arm with its brakes on.

use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Result;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::SystemClock;
use pb3dp_setup::setup::read_layers;
use pb3dp_wiring::commissioning::see;

use super::ProbeArgs;
use super::probe_report::ProbeReport;

/// Runs the command.
///
/// # Errors
/// A refused configuration.
pub fn run(args: &ProbeArgs) -> Result<ExitCode> {
    let setup = read_layers(&args.place.setup)?;
    let choice = args.place.choice();
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut report = ProbeReport::begin(choice);
    match see(&setup, choice, &clock) {
        Ok(mut observed) => {
            observed.arm.warnings().iter().for_each(|warning| report.warn(warning.clone()));
            let monitor = observed.arm.monitor();
            // Each call exchanges at least one message, so this loop ends.
            for _ in 0..args.exchanges {
                let snapshot = monitor.snapshot();
                if snapshot.latched.is_some() || snapshot.counters.sent >= u64::from(args.exchanges) {
                    break;
                }
                if let Err(error) = observed.arm.look() {
                    if monitor.snapshot().latched.is_none() {
                        report.refuse(format!("{:#}", anyhow::Error::from(error)));
                    }
                    break;
                }
            }
            report.add(choice.of(&setup), observed.target.clone(), &monitor);
        }
        Err(error) => report.refuse(format!("{error:#}")),
    }
    print_line(&if args.json { serde_json::to_string(&report)? } else { report.to_string() })?;
    Ok(if report.fits { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
