//! `pb3dp run`: the complete loop of one setup.

use std::io::{BufRead, BufReader, IsTerminal, Write};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Instant, SystemTime};

use anyhow::{Context, Result, bail};
use pb3dp_cell::attended::AttendedCommand;
use pb3dp_cell::channels::Plan;
use pb3dp_cell::console::Console;
use pb3dp_cell::experiment::{self, Ended};
use pb3dp_cell::flight::Moment;
use pb3dp_cell::interruption::{INTERRUPTED, watch};
use pb3dp_cell::operator::{ByCommand, Operator};
use pb3dp_cell::report::{self, Following, Made};
use pb3dp_cell::summary::summarize;
use pb3dp_cell::terminal::{TypedInput, print_line};
use pb3dp_commissioning::arm::confirm;
use pb3dp_commissioning::commissioned::{check_arms, needed_records, real_arms};
use pb3dp_hal_api::Clock;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_record::dataset::SequenceWriter;
use pb3dp_setup::setup::{Pace, Setup, read_layers};
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
    let mut signals = StopSignals::take_over().context("the signals that end the program cannot be taken over")?;
    let seed = args.seed.as_ref().map(ToString::to_string);
    let region = args.region.as_ref().map(ToString::to_string);
    let asked = args.setup.clone().with("--seed", "run.seed", seed).with("--region", "camera.region", region);
    let mut setup = read_layers(&asked)?;
    accept_nominal(&mut setup, args.nominal_calibration);
    // Before a port opens.
    let records = needed_records(&setup, SystemTime::now())?;
    let typed = confirmed(args, &setup, &mut signals)?;
    previous_run::make(&args.out)?;
    if args.operator == OperatorName::Console && setup.pace == Pace::Fast {
        bail!("--operator console: at pace = \"fast\" nobody can speak in time; set pace to \"real-time\" or \"live\"");
    }
    // Checked before an arm is enabled, and before the previous report is moved.
    if let Some(folder) = &args.record {
        SequenceWriter::check_folder(folder).context("--record")?;
    }
    let Wired { mut parts, monitors, .. } = wire_watched(&setup)?;
    check_arms(&setup, &records, &monitors)?;
    let (clock, interrupt) = (Arc::clone(&parts.clock), Arc::clone(&parts.interrupt));
    let prompt = if std::io::stdin().is_terminal() { "pb3dp> " } else { "" };
    parts.operator = operator(args.operator, &setup, clock, typed, (std::io::stdout(), interrupt, prompt))?;
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

/// Standard input of an operator.
type Typed = Box<dyn BufRead + Send>;

/// Standard input, after a person has typed the names of the arms that are not emulated, where that is necessary.
fn confirmed(args: &RunArgs, setup: &Setup, signals: &mut StopSignals) -> Result<Typed> {
    if setup.is_emulated() || args.operator == OperatorName::Console {
        return Ok(Box::new(BufReader::new(std::io::stdin())));
    }
    let names: Vec<&str> = real_arms(setup).iter().map(|choice| choice.name()).collect();
    let names = names.join(" ");
    if !args.moves {
        bail!(
            "{names}: not emulated, so a person must lead or confirm this run; use --operator console, or --move and type {names:?}"
        );
    }
    print_line(&format!(
        "The arms will move. Keep all persons out of their reach and a hand on the emergency stop.\nWhile they move, press Enter at least \
         every {} s, or they hold.\nType {names} to move them:",
        setup.operator_key_within.as_secs_f64()
    ))?;
    let console = confirm::Console::start()?;
    console.typed(&names, None, signals)?;
    Ok(Box::new(TypedInput::of(console.into_lines())))
}

/// The operator of a run. One of arms that are not emulated shows by keys that it is there.
fn operator(
    name: OperatorName,
    setup: &Setup,
    clock: Arc<dyn Clock>,
    typed: Typed,
    (answers, interrupt, prompt): (impl Write + Send + 'static, Arc<AtomicBool>, &'static str),
) -> Result<Box<dyn Operator>> {
    let console = || Console::start(clock, typed, answers, (interrupt, prompt));
    let with_keys = |console: Console| console.with_keys(setup.operator_key_within);
    Ok(match (name, setup.is_emulated()) {
        (OperatorName::Command, true) => Box::new(ByCommand),
        (OperatorName::Command, false) => Box::new(AttendedCommand(with_keys(console()?))),
        (OperatorName::Console, true) => Box::new(console()?),
        (OperatorName::Console, false) => Box::new(with_keys(console()?)),
    })
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::Duration;

    use clap::ValueEnum as _;
    use pb3dp_geometry::MonotonicTime;
    use pb3dp_hal_clock::VirtualClock;
    use pb3dp_setup::setup::read_setup;

    use super::*;

    /// An operator of arms that are not emulated who could never be silent would move them for nobody.
    #[test]
    fn every_operator_of_real_arms_falls_silent_when_nobody_types() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/rig.toml");
        let setup = read_setup(&file).unwrap();
        assert!(!setup.is_emulated());
        for name in OperatorName::value_variants() {
            let (open, _nobody_types) = std::io::pipe().unwrap();
            let clock = Arc::new(VirtualClock::new());
            let typed = Box::new(BufReader::new(open));
            let answers = (std::io::sink(), Arc::default(), "");
            let mut operator = operator(*name, &setup, clock, typed, answers).unwrap();
            assert!(operator.can_fall_silent(), "{name:?}");
            let begin = MonotonicTime::from_secs_f64(100.0);
            let heard = operator.listen(None, begin);
            assert_eq!((heard.heard_at, heard.silent_after), (Some(begin), Some(Duration::from_secs(30))), "{name:?}");
            let heard = operator.listen(None, begin + Duration::from_secs(40));
            assert_eq!(heard.heard_at, Some(begin), "{name:?} is heard although nobody types");
        }
    }
}
