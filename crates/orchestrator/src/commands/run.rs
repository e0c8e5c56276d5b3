//! `pb3dp run`: the complete loop of one setup.

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant, SystemTime};

use anyhow::{Context, Result, bail};
use pb3dp_bag::BagError;
use pb3dp_bag::live::Live;
use pb3dp_bag::recent::{Recent, RecentOptions};
use pb3dp_bag::sinks::Sinks;
use pb3dp_bag::writer::{BagWriter, Rotation, WhenFull};
use pb3dp_cell::console::ConsoleTargets;
use pb3dp_cell::experiment::{self, Ended};
use pb3dp_cell::flight::Moment;
use pb3dp_cell::interruption::{INTERRUPTED, watch};
use pb3dp_cell::report::{self, Following, Made};
use pb3dp_cell::terminal::print_line;
use pb3dp_commissioning::commissioned::check_arms;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_record::dataset::SequenceWriter;
use pb3dp_recording::pairs::{About, is_file};
use pb3dp_recording::run::{RecordTo, record_run};
use pb3dp_setup::layers::{Layers, toml_of};
use pb3dp_setup::setup::{Pace, Setup, read_layers};
use pb3dp_wiring::{RunNeeds, Wired, accept_nominal, wire_run, write_flights};

use crate::arguments::{OperatorName, RunArgs, UNSURE};
use crate::commands::attendance::Attendance;
use crate::commands::output_file::check_recording_name;
use crate::commands::panel_of_run;
use crate::commands::result_folder::ResultFolder;
use crate::logging::final_flush;

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
    take_options_of_real_arms(args, &mut setup);
    // Before a port opens.
    let records = check_arms(&setup, SystemTime::now())?;
    let panel_config = args.panel.map(|address| args.panel_access.config(address)).transpose()?;
    let attendance = Attendance::confirmed(args, &setup, &mut signals)?;
    // Checked before an arm is enabled, and before an earlier run is moved.
    args.record.as_deref().map_or(Ok(()), |path| check_recording(path, args))?;
    let _results = ResultFolder::take(&args.out)?;
    let is_led_by_person = args.panel.is_some() || args.operator == OperatorName::Console;
    let needs = RunNeeds { until_s: args.stop_after, selects_targets: is_led_by_person };
    let Wired { mut parts, monitors, .. } = wire_run(&setup, &needs)?;
    records.iter().try_for_each(|record| record.check(&monitors))?;
    // Lives until the end of the run.
    let panel = panel_config.map(|at| panel_of_run::start(at, (&setup, &asked.to_string()), &mut parts)).transpose()?;
    if let Some(attendance) = attendance {
        let size = setup.rig.stereo.left().size();
        let targets = parts.selections.clone().map(|selections| ConsoleTargets { size, selections });
        let (clock, interrupt) = (Arc::clone(&parts.clock), Arc::clone(&parts.interrupt));
        parts.operator = attendance.operator(clock, std::io::stdout(), interrupt, targets)?;
    }
    let started = Instant::now();
    let interrupt = Arc::clone(&parts.interrupt);
    let was_interrupted = watch(signals, &interrupt, final_flush)?;
    let (clock, flights) = (Arc::clone(&parts.clock), parts.flights.clone());
    let out = args.out.clone();
    let keep_flights = move |number: usize, failure: &anyhow::Error| {
        let moment = Moment { monotonic: clock.now(), wall: SystemTime::now() };
        write_flights((&out, number), &flights, &monitors, failure, moment);
    };
    // A fault does not end a run with a console; the recorders forget it after some seconds.
    parts.keep_flights = Box::new(keep_flights.clone());
    tracing::info!("the results of this run go to {} (--out)", args.out.display());
    let (file, folder) = match args.record.as_deref() {
        Some(path) if is_file(path) => (Some(path), None),
        folder => (None, folder),
    };
    let sinks = sinks(args, &setup, file)?;
    if let Some(live) = sinks.live() {
        tracing::info!("viewers can watch at ws://{} (--live)", live.address());
    }
    if file.is_some() || args.live.is_some() || setup.pace == Pace::Live {
        let about = About::new(toml_of(&Layers::read(&asked)?.effective()), crate::COMMIT, parts.clock.now())?;
        parts = record_run(&about, &setup, parts, RecordTo { sinks, faults: args.out.clone() })?;
    }
    let Ended { outcome, how, faults } = experiment::conduct(&setup, parts, args.stop_after, folder)?;
    if let Err(failure) = &how {
        keep_flights(faults + 1, failure);
    }
    drop(panel);
    let made =
        Made { configuration: asked.to_string(), commit: crate::COMMIT, wall_s: started.elapsed().as_secs_f64() };
    let following = report::write_report(&args.out, &setup, &made, &outcome, how, print_line)?;
    // A person decides when the hand follows.
    if !is_led_by_person {
        following.warn();
    }
    Ok(match following {
        _ if was_interrupted.load(Ordering::SeqCst) => ExitCode::from(INTERRUPTED),
        Following::TooLittle { .. } if args.strict => ExitCode::from(UNSURE),
        Following::Well | Following::TooLittle { .. } => ExitCode::SUCCESS,
    })
}

/// Options of real arms; with emulated ones they only give a warning, because one command line serves a rig and its simulation.
fn take_options_of_real_arms(args: &RunArgs, setup: &mut Setup) {
    if !setup.is_emulated() {
        accept_nominal(setup, args.nominal_calibration);
        return;
    }
    for (option, is_given) in [("--move", args.moves), ("--nominal-calibration", args.nominal_calibration)] {
        if is_given {
            tracing::warn!("{option} has no effect: the arms of this setup are emulated");
        }
    }
}

/// Who gets the messages of the run. The newest seconds are held in live runs, for a file at each fault.
fn sinks(args: &RunArgs, setup: &Setup, file: Option<&Path>) -> Result<Sinks> {
    let when_full = if setup.pace == Pace::Fast { WhenFull::Wait } else { WhenFull::Drop };
    let rotation = Rotation {
        bytes_max: args.rotate_mb.map(|megabytes| u64::from(megabytes) * 1_000_000),
        duration_max: args.rotate_minutes.map(|minutes| Duration::from_secs(60 * u64::from(minutes))),
    };
    let writer =
        file.map(|file| BagWriter::create_rotating(file, when_full, rotation)).transpose().context("--record")?;
    let recent = (setup.pace == Pace::Live).then(|| Recent::start(RecentOptions::default())).transpose()?;
    let live = args.live.map(Live::serve).transpose().context("--live")?;
    Ok(Sinks::new(writer, recent, live))
}

/// Refuses to overwrite an earlier recording, and names of folders that look like files.
fn check_recording(path: &Path, args: &RunArgs) -> Result<()> {
    check_recording_name("--record", path)?;
    match is_file(path) {
        true if path.exists() => Err(BagError::Exists { file: path.to_path_buf() }).context("--record"),
        true => create_parent(path).context("--record"),
        false if args.rotate_mb.is_some() || args.rotate_minutes.is_some() => bail!(
            "--record {}: a sequence folder is not divided (--rotate-mb, --rotate-minutes); name a FILE.mcap",
            path.display()
        ),
        false => SequenceWriter::check_folder(path).context("--record"),
    }
}

/// Creates the folder of a new file.
pub(super) fn create_parent(file: &Path) -> Result<()> {
    let Some(folder) = file.parent() else { return Ok(()) };
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be created", folder.display()))
}
