//! `pb3dp run`: the complete loop of one setup.

use std::io::{BufReader, IsTerminal};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Instant, SystemTime};

use anyhow::{Context, Result, bail};
use pb3dp_cell::channels::Plan;
use pb3dp_cell::console::Console;
use pb3dp_cell::experiment::{self, Ended};
use pb3dp_cell::flight::Moment;
use pb3dp_cell::interruption::{INTERRUPTED, watch};
use pb3dp_cell::report::{self, Following, Made};
use pb3dp_cell::summary::summarize;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_record::dataset::SequenceWriter;
use pb3dp_setup::setup::{Pace, read_layers};
use pb3dp_wiring::{Wired, accept_nominal, wire_watched, write_flights};

use crate::arguments::{OperatorName, RunArgs, UNSURE};
use crate::commands::previous_run;
use crate::logging::last_words;

/// Runs the command: experiment, then report.
///
/// # Errors
/// A refused configuration, an experiment that the arms cannot follow, or a failed part.
pub fn run(args: &RunArgs) -> Result<ExitCode> {
    // Before any thread starts: a signal that ended the program would leave the arms to their gateways.
    let signals = StopSignals::take_over().context("the signals that end the program cannot be taken over")?;
    let seed = args.seed.as_ref().map(ToString::to_string);
    let region = args.region.as_ref().map(ToString::to_string);
    let asked = args.setup.clone().with("--seed", "run.seed", seed).with("--region", "camera.region", region);
    let mut setup = read_layers(&asked)?;
    accept_nominal(&mut setup, args.nominal_calibration);
    previous_run::make(&args.out)?;
    if args.operator == OperatorName::Console && setup.pace == Pace::Fast {
        bail!("--operator console: at pace = \"fast\" nobody can speak in time; set pace to \"real-time\" or \"live\"");
    }
    // Checked before an arm is enabled, and before the previous report is moved.
    if let Some(folder) = &args.record {
        SequenceWriter::check_folder(folder).context("--record")?;
    }
    let Wired { mut parts, monitors, .. } = wire_watched(&setup)?;
    if args.operator == OperatorName::Console {
        let lines = BufReader::new(std::io::stdin());
        let (clock, interrupt) = (Arc::clone(&parts.clock), Arc::clone(&parts.interrupt));
        let prompt = if std::io::stdin().is_terminal() { "pb3dp> " } else { "" };
        parts.operator = Box::new(Console::start(clock, lines, std::io::stdout(), (interrupt, prompt))?);
    }
    let plan = Plan::of(&setup.experiment.motion, &*parts.experiment);
    let started = Instant::now();
    let interrupt = Arc::clone(&parts.interrupt);
    let was_interrupted = watch(signals, &interrupt, std::mem::take(&mut parts.on_bus), last_words)?;
    let (clock, flights) = (Arc::clone(&parts.clock), parts.flights.clone());
    // Late, so that a refused run leaves the previous one in its place.
    previous_run::keep(&args.out)?;
    let Ended { outcome, how } = experiment::conduct(&setup, parts, args.stop_after, args.record.as_deref())?;
    if let Err(failure) = &how {
        let moment = Moment { monotonic: clock.now(), wall: SystemTime::now() };
        write_flights(&args.out, &flights, &monitors, failure, moment);
    }
    let made =
        Made { configuration: asked.to_string(), commit: crate::COMMIT, wall_s: started.elapsed().as_secs_f64() };
    let summary = summarize(&outcome.log, &plan);
    let following = report::tell(&args.out, &setup, &made, (&outcome, summary, &plan), how)?;
    // A person at the console decides when the hand follows.
    if args.operator == OperatorName::Command {
        following.warn();
    }
    Ok(match following {
        _ if was_interrupted.load(Ordering::SeqCst) => ExitCode::from(INTERRUPTED),
        Following::TooLittle { .. } if args.strict => ExitCode::from(UNSURE),
        Following::Well | Following::TooLittle { .. } => ExitCode::SUCCESS,
    })
}
