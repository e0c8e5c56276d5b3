//! `pb3dp run`: the whole loop of one setup.

use std::io::BufReader;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Instant, SystemTime};

use anyhow::{Context, Result, anyhow, bail};
use pb3dp_cell::channels::Plan;
use pb3dp_cell::console::Console;
use pb3dp_cell::experiment::{self, Ended};
use pb3dp_cell::flight::Moment;
use pb3dp_cell::interruption::{INTERRUPTED, watch};
use pb3dp_cell::machine::machine;
use pb3dp_cell::report;
use pb3dp_cell::summary::{RunSummary, summarize};
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_record::dataset::SequenceWriter;
use pb3dp_setup::region_spec::RegionSpec;
use pb3dp_setup::setup::{CalibrationInUse, Pace, Setup, read_layers};
use pb3dp_wiring::{Wired, accept_nominal, wire_watched, write_flights};

use crate::arguments::{OperatorName, RunArgs};
use crate::logging::last_words;

/// A run in which the hand followed for a smaller share of the time is pointed out.
const FOLLOWING_EXPECTED: f64 = 0.9;

/// Runs the command: experiment, then report.
///
/// # Errors
/// A configuration that is refused, an experiment that the arms can not follow, or a part that fails.
pub fn run(args: &RunArgs) -> Result<ExitCode> {
    // Before any thread is started: a signal that ends the program would leave the arms to their gateways.
    let signals = StopSignals::take_over().context("the signals that end the program can not be taken over")?;
    let mut asked = args.setup.clone();
    if let Some(seed) = args.seed {
        asked = asked.with("run.seed", &seed);
    }
    let mut setup = read_layers(&asked)?;
    mark(&mut setup, args.region.as_ref())?;
    accept_nominal(&mut setup, args.nominal_calibration);
    std::fs::create_dir_all(&args.out).with_context(|| format!("{}: can not be created", args.out.display()))?;
    if args.operator == OperatorName::Console && setup.pace == Pace::Fast {
        bail!("--operator console: at pace = \"fast\" nobody can speak in time; set pace to \"real-time\" or \"live\"");
    }
    // What can not be recorded is refused before an arm is switched on, and before the last report is lost.
    if let Some(folder) = &args.record {
        SequenceWriter::check_folder(folder).context("--record")?;
    }
    let Wired { mut parts, monitors, .. } = wire_watched(&setup)?;
    if args.operator == OperatorName::Console {
        let lines = BufReader::new(std::io::stdin());
        let (clock, interrupt) = (Arc::clone(&parts.clock), Arc::clone(&parts.interrupt));
        parts.operator = Box::new(Console::start(clock, lines, std::io::stdout(), interrupt)?);
    }
    let plan = Plan::of(&setup.experiment.motion, &*parts.experiment);
    let started = Instant::now();
    let interrupt = Arc::clone(&parts.interrupt);
    let was_interrupted = watch(signals, &interrupt, std::mem::take(&mut parts.on_bus), last_words)?;
    let (clock, flights) = (Arc::clone(&parts.clock), parts.flights.clone());
    let Ended { outcome, how } = experiment::conduct(&setup, parts, args.stop_after, args.record.as_deref())?;
    if let Err(failure) = &how {
        let moment = Moment { monotonic: clock.now(), wall: SystemTime::now() };
        write_flights(&args.out, &flights, &monitors, failure, moment);
    }
    let wall_s = started.elapsed().as_secs_f64();
    let ended_by = how.as_ref().err().map(|failure| format!("{failure:#}"));
    let summary = RunSummary { ended_by, ..summarize(&outcome.log, &plan) };
    let provenance = provenance(args, &setup, summary.duration_s, wall_s);
    let written = report::write(&args.out, &outcome, &summary, (&provenance, &plan.world_from_axes));
    let told = written.and_then(|()| tell(args, &summary));
    both(how, told)?;
    Ok(if was_interrupted.load(Ordering::SeqCst) { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

/// Prints the figures, and where the report is.
fn tell(args: &RunArgs, summary: &RunSummary) -> Result<()> {
    print_line(&report::text_table(summary))?;
    let following = summary.share_following();
    if following < FOLLOWING_EXPECTED {
        tracing::warn!(
            "the hand followed the target for {:.0} % of the time only; the statuses above and what the supervisor says in the report tell why",
            100.0 * following
        );
    }
    Ok(print_line(&format!("report: {}", args.out.join("report.html").display()))?)
}

/// How the run has ended, also where its report could not be written.
fn both(how: Result<()>, told: Result<()>) -> Result<()> {
    match (how, told) {
        (Err(failure), Err(untold)) => {
            Err(failure.context(format!("the report is not complete ({untold:#}), and the run had failed before")))
        }
        (how, told) => how.and(told),
    }
}

/// Where the pictures come from.
fn pictures(setup: &Setup) -> String {
    match setup.real_cameras() {
        Some(cameras) => format!("{} and {}", cameras.stereo.left.name, cameras.stereo.right.name),
        None if setup.leader.needs_pictures() => "rendered".to_owned(),
        None => "none".to_owned(),
    }
}

/// Marks the target of real cameras, if a region is given.
///
/// # Errors
/// If the cameras are simulated, or the region is outside of their pictures.
pub(super) fn mark(setup: &mut Setup, region: Option<&RegionSpec>) -> Result<()> {
    match (setup.real_cameras_mut(), region) {
        (_, None) => {}
        (Some(cameras), Some(region)) => {
            region.check_inside(cameras.size()).map_err(|why| anyhow!("--region: {why}"))?;
            cameras.region = Some(region.clone());
        }
        (None, Some(_)) => bail!(
            "--region: the cameras of this setup are simulated, and where the target is in their pictures is known"
        ),
    }
    Ok(())
}

/// What somebody needs to repeat the run.
fn provenance(args: &RunArgs, setup: &Setup, simulated_s: f64, wall_s: f64) -> Vec<(String, String)> {
    let line = |key: &str, value: String| (key.to_owned(), value);
    let calibrations: Vec<String> = setup.rig.calibrations.iter().map(CalibrationInUse::text).collect();
    let compared: Vec<&str> = setup.compared.iter().map(|method| method.name()).collect();
    vec![
        line("program", format!("pb3dp {}", env!("CARGO_PKG_VERSION"))),
        line("commit", crate::COMMIT.to_owned()),
        line("configuration", args.setup.to_string()),
        line("method", setup.leader.name().to_owned()),
        line("pictures", pictures(setup)),
        line(
            "calibrations",
            if calibrations.is_empty() { "none: as drawn".to_owned() } else { calibrations.join("; ") },
        ),
        line("compared", if compared.is_empty() { "none".to_owned() } else { compared.join(", ") }),
        line("seed", setup.seed.to_string()),
        line("machine", machine()),
        line("duration", format!("{simulated_s:.1} s simulated in {wall_s:.1} s")),
    ]
}

#[cfg(test)]
mod tests {
    use anyhow::anyhow;

    use super::*;

    #[test]
    fn the_failure_of_a_run_is_told_also_without_a_report() {
        let (arm, disk) = (|| Err(anyhow!("an overcurrent")), || Err(anyhow!("no space is left")));
        let text = format!("{:#}", both(arm(), disk()).unwrap_err());
        assert!(text.contains("an overcurrent") && text.contains("no space is left"), "{text}");
        assert_eq!(both(arm(), Ok(())).unwrap_err().to_string(), "an overcurrent");
        assert_eq!(both(Ok(()), disk()).unwrap_err().to_string(), "no space is left");
        assert!(both(Ok(()), Ok(())).is_ok());
    }
}
