//! `pb3dp arm test`: the rig checklist, step by step, with a dated report.

mod comms;
mod emulated;
mod jog;
mod kill;
mod limits;
mod operator;
mod report;
mod session;
pub mod signals;
mod status_bits;
mod steps;
mod stops;
mod test_line;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use pb3dp_arm_pa10::arm::ArmSnapshot;
use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_cell::attended_motion::instructions;
use pb3dp_cell::live::enter_control_thread;
use pb3dp_cell::machine::machine;
use pb3dp_cell::parts::ArmChoice;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_api::{Clock, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_setup::layers::toml_of;
use pb3dp_setup::setup::{ArmLink, GatewayWay, Setup, read_layers};
use pb3dp_wiring::commissioning::{check_other_is_off, emulate_at_address, see, set_line, slow_setup};
use sha2::{Digest, Sha256};

use self::emulated::Emulated;
use self::operator::{Operator, Person};
use self::report::{Outcome, ProgramFacts, StepReport, TestReport};
use self::session::{Session, is_interruption};
use self::steps::{STEPS, Step};
use self::test_line::{TestKey, TestLine};
use super::confirm::{Console, need_no_button, need_person};
use super::flights::{folder_of, utc};
use super::motion::{JOG_RAD_PER_S, show_room};
use super::probe_report::GatewayFacts;
use super::{Company, Place, parse_jog};
use crate::commissioned::{CommissioningRecord, VALID_DAYS};

/// Version of the report format.
const REPORT_FORMAT: u32 = 1;

/// Arguments of `pb3dp arm test`.
#[derive(Debug, Args)]
pub struct TestArgs {
    #[command(flatten)]
    place: Place,
    /// Run the steps after the arm's name is typed. Without it nothing moves.
    #[arg(long = "move")]
    moves: bool,
    #[command(flatten)]
    company: Company,
    /// The axis that moves, 1 at the base to 7 at the flange.
    #[arg(long, value_name = "1..7", default_value_t = 7, value_parser = clap::value_parser!(u8).range(1..=7))]
    axis: u8,
    /// Angle of each move, degrees, at most 30. A move of 10 degrees takes 18 s, in which the operator has to act.
    #[arg(long, value_name = "DEGREES", default_value = "10", value_parser = parse_jog, allow_hyphen_values = true)]
    by: f64,
    /// Run only these steps, separated by commas.
    #[arg(long, value_parser = steps::parser(), value_name = "STEP", value_delimiter = ',', conflicts_with = "skip")]
    only: Vec<&'static Step>,
    /// Run all steps but these.
    #[arg(long, value_parser = steps::parser(), value_name = "STEP", value_delimiter = ',')]
    skip: Vec<&'static Step>,
    /// Operator of switches and cables: a person, or the program if the arm is emulated.
    #[arg(long, value_enum, default_value = "person")]
    operator: OperatorName,
    /// Longest wait for an answer, seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=3600))]
    patience: u32,
    /// Output folder for report.md, report.json and settings.toml; out/arm-test-ARM-DATE without it.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// Operators by their names on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum OperatorName {
    Person,
    Emulated,
}

/// Runs the command.
///
/// # Errors
/// A refused configuration, an arm that does not answer or is stopped, a missing confirmation, or a report that cannot be written.
pub fn run(args: &TestArgs, commit: &'static str) -> Result<ExitCode> {
    // Before any thread starts.
    let signals = StopSignals::take_over()?;
    let began = SystemTime::now();
    let setup = read_layers(&args.place.setup)?;
    let asked = asked(args, &setup)?;
    let (mut session, target) = begin((args, &asked), &setup, signals, began)?;
    show(args, &asked, &session)?;
    if !args.moves {
        print_line("dry run: the brakes stayed on and nothing moved; use --move to run the test")?;
        return Ok(ExitCode::SUCCESS);
    }
    // A file that is no record is found before a step.
    open_record(&setup, &mut session)?;
    confirm(&args.company.word(session.choice), &asked, &mut session)?;
    std::fs::create_dir_all(&session.out).with_context(|| format!("{}: cannot be created", session.out.display()))?;
    let (settings, file) = (toml_of(&setup.layers.effective()), session.out.join("settings.toml"));
    std::fs::write(&file, &settings).with_context(|| format!("{}: cannot be written", file.display()))?;
    enter_control_thread();
    let steps = all_steps(&asked, &mut session);
    let result = Outcome::of(&steps);
    let report = TestReport {
        format: REPORT_FORMAT,
        result,
        arm: session.choice.name(),
        began: utc(began),
        ended: utc(SystemTime::now()),
        program: ProgramFacts { version: env!("CARGO_PKG_VERSION"), commit },
        machine: machine(),
        config: args.place.setup.to_string(),
        config_sha256: sha256(settings.as_bytes()),
        target,
        is_emulated: session.line.is_some(),
        gateway: GatewayFacts::of(&session.gateway),
        operator: session.operator.name(),
        axis: args.axis,
        by_deg: args.by,
        speed_rad_per_s: JOG_RAD_PER_S,
        steps,
    };
    let path = report.write(&session.out)?;
    let arm = session.choice.of(&setup);
    match &session.record_file {
        Some(path) => {
            print_line(&format!("commissioning record: {}, valid for {VALID_DAYS} days", path.display()))?;
        }
        None if arm.link.is_toy() => {}
        None => {
            print_line(&format!("no commissioning record was written: {}.commissioning_record is not set", arm.key))?
        }
    }
    print_line(&format!("{}: {}\nreport: {}", session.choice.name(), result.word(), path.display()))?;
    let is_well = matches!(result, Outcome::Passed | Outcome::Incomplete);
    Ok(if is_well { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Continues the commissioning record of an arm that is not emulated, if the setup names its file; writes nothing.
fn open_record(setup: &Setup, session: &mut Session<'_>) -> Result<()> {
    let arm = session.choice.of(setup);
    session.record_file = arm.commissioning_record.clone().filter(|_| !arm.link.is_toy());
    if let Some(path) = &session.record_file {
        session.record = session.record.clone().continued(path)?;
    }
    Ok(())
}

/// The requested steps, in order.
fn asked(args: &TestArgs, setup: &Setup) -> Result<Vec<&'static Step>> {
    let is_toy = args.place.choice().other().of(setup).link.is_toy();
    // Only the emulated operator can press the switch of an emulated arm.
    let has_other = !args.company.alone && (!is_toy || args.operator == OperatorName::Emulated);
    let wanted = |step: &&'static Step| match args.only.is_empty() {
        true => !args.skip.contains(step) && (!step.needs_other() || has_other),
        false => args.only.contains(step),
    };
    let asked: Vec<_> = STEPS.iter().filter(wanted).collect();
    if need_other(&asked) && args.company.alone {
        bail!("the step interlock needs the other arm: remove --alone");
    }
    if asked.is_empty() {
        bail!("no step is left: skip fewer steps");
    }
    Ok(asked)
}

/// Whether the other arm takes part in one of these steps.
fn need_other(steps: &[&'static Step]) -> bool {
    steps.iter().any(|step| step.needs_other())
}

/// Connects to the arm, checks it and prepares the session.
fn begin<'a>(
    (args, asked): (&'a TestArgs, &[&'static Step]),
    setup: &Setup,
    signals: StopSignals,
    began: SystemTime,
) -> Result<(Session<'a>, String)> {
    let choice = args.place.choice();
    if args.moves && !choice.of(setup).link.is_toy() {
        need_no_button(setup)?;
    }
    let mut setup = slow_setup(setup, choice, JOG_RAD_PER_S)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let (operator, line) = operator((args, asked), &mut setup, &clock)?;
    if args.company.alone {
        check_other_is_off(&setup, choice, &clock)?;
    }
    let (snapshot, target) = look(&setup, choice, &clock)?;
    let out = args.out.clone().unwrap_or_else(|| folder_of("test", choice, began));
    if out.join("report.json").exists() {
        bail!("{}: there is a report already; use another --out", out.display());
    }
    let record = CommissioningRecord::of(choice, choice.of(&setup), &snapshot)?;
    let session = Session {
        place: &args.place,
        setup,
        choice,
        clock,
        signals,
        operator,
        axis: Axis::from_number(u16::from(args.axis))?,
        by_rad: args.by.to_radians(),
        home_rad: snapshot.joints.context("the arm reported no joints")?.position_rad,
        gateway: snapshot.gateway.context("the arm has no gateway")?,
        record,
        record_file: None,
        line,
        out,
        report: StepReport::default(),
    };
    Ok((session, target))
}

/// Probes the arm; returns its state and how it was reached.
fn look(setup: &Setup, choice: ArmChoice, clock: &Arc<dyn Clock>) -> Result<(ArmSnapshot, String)> {
    let mut observed = see(setup, choice, clock)?;
    if let Some(latched) = observed.arm.monitor().snapshot().latched {
        bail!("{} is stopped: {}; after the cause is gone, use `pb3dp arm reset`", choice.name(), latched.trip);
    }
    // A gateway knows the wire format once the controller has answered.
    observed.arm.look()?;
    Ok((observed.arm.monitor().snapshot(), observed.target))
}

/// The operator, and the address of an arm emulated for this test.
fn operator(
    (args, asked): (&TestArgs, &[&'static Step]),
    setup: &mut Setup,
    clock: &Arc<dyn Clock>,
) -> Result<(Box<dyn Operator>, Option<TestLine>)> {
    let choice = args.place.choice();
    let is_person = args.operator == OperatorName::Person;
    let arms: &[ArmChoice] = match is_person {
        // A dry run needs no hand.
        true if !args.moves => &[],
        true if !need_other(asked) => &[choice],
        false if args.company.alone => &[choice],
        _ => &[choice, choice.other()],
    };
    operator_of((args.operator, args.patience, arms), setup, clock)
}

/// The operator of the switches and cables of these arms, and the address of the first one if it is emulated for this.
fn operator_of(
    (name, patience_s, choices): (OperatorName, u32, &[ArmChoice]),
    setup: &mut Setup,
    clock: &Arc<dyn Clock>,
) -> Result<(Box<dyn Operator>, Option<TestLine>)> {
    let patience = Duration::from_secs(u64::from(patience_s));
    if name == OperatorName::Person {
        let is_emulated = |arm: &&ArmChoice| matches!(&arm.of(setup).link, ArmLink::Gateway(_, GatewayWay::Emulated));
        if let Some(emulated) = choices.iter().find(is_emulated) {
            bail!(
                "{}.backend = \"emulated\" has no switch and no cable for you: use --operator emulated, or run `pb3dp mock-arm --tcp` with a key in \
                 another terminal and set backend = \"tcp\"",
                emulated.of(setup).key
            );
        }
        if !choices.is_empty() {
            need_person()?;
        }
        let times = (patience, setup.operator_key_within);
        return Ok((Box::new(Person::new(Console::start()?, times, Arc::clone(clock))?), None));
    }
    let mut arms = Vec::new();
    let key = TestKey::new()?;
    let mut first = None;
    for choice in choices {
        let server = emulate_at_address(setup, *choice, key.file(), clock).context("--operator emulated")?;
        let address = server.address().parse().context("the address of the emulated arm")?;
        set_line(setup, *choice, address, key.file().to_owned());
        first = first.or(Some(address));
        arms.push((*choice, server));
    }
    let line = first.map(|address| TestLine { address, key });
    Ok((Box::new(Emulated::new((Console::start()?, patience), arms)), line))
}

/// Prints the plan.
fn show(args: &TestArgs, asked: &[&'static Step], session: &Session<'_>) -> Result<()> {
    let choice = session.choice;
    print_line(&format!("{}: test, {} of {} steps", choice.name(), asked.len(), STEPS.len()))?;
    for (index, step) in asked.iter().enumerate() {
        print_line(&step.line(index + 1))?;
    }
    if !asked.iter().any(|step| step.moves()) {
        return Ok(());
    }
    let mut arm = session.connect(!args.company.alone)?;
    let now_rad = arm.driven.exchange(JointCommand::Hold)?.position_rad;
    let other_rad = match &mut arm.other {
        Some(other) => Some(other.driven.exchange(JointCommand::Hold)?.position_rad),
        None => None,
    };
    print_line(&format!("moves, at most {JOG_RAD_PER_S} rad/s, there and back:"))?;
    for by_rad in [session.by_rad, -session.by_rad] {
        let plan = session.plan_by(now_rad, by_rad)?;
        print_line(plan.table(choice.of(&session.setup)).trim_end())?;
        print_line(&format!("within {:.1} s", plan.duration().as_secs_f64()))?;
        show_room(&session.setup, choice, &plan, other_rad.as_ref())?;
    }
    let plan = session.plan_by(now_rad, session.by_rad)?;
    if let (true, Some(warning)) = (asked.iter().any(|step| step.is_acted_on()), session.too_short_for_a_person(&plan))
    {
        print_line(&format!("warning: {warning}"))?;
    }
    Ok(())
}

/// Asks the operator to confirm that arms may move.
fn confirm(word: &str, asked: &[&'static Step], session: &mut Session<'_>) -> Result<()> {
    if asked.iter().any(|step| step.moves()) {
        let others = if need_other(asked) { " The brakes of both arms open." } else { "" };
        print_line(&format!(
            "The arm will move.{others} Keep all persons out of its reach and a hand on the emergency stop.\n\
             {}",
            instructions(session.setup.operator_key_within)
        ))?;
    }
    print_line(&format!("Type {word} to begin:"))?;
    session.operator.confirm(word, &mut session.signals)
}

/// Runs the steps; those after a failed one are skipped. Nothing ends the checklist without a report.
fn all_steps(asked: &[&'static Step], session: &mut Session<'_>) -> Vec<StepReport> {
    let mut reports: Vec<StepReport> = Vec::new();
    let mut ended: Option<String> = None;
    for step in &STEPS {
        let report = match &ended {
            _ if !asked.contains(&step) => StepReport::skipped(step.name, step.title, "not requested"),
            Some(why) => StepReport::skipped(step.name, step.title, why),
            None => {
                let report = one_step(step, session);
                let shown = show_result(&report);
                ended = match (report.result, shown) {
                    (Outcome::Failed | Outcome::Interrupted, _) => Some(format!("the step {} did not pass", step.name)),
                    (_, Err(error)) => Some(format!("the result of {} could not be shown: {error}", step.name)),
                    (_, Ok(())) => None,
                };
                report
            }
        };
        reports.push(report);
    }
    reports
}

fn one_step(step: &Step, session: &mut Session<'_>) -> StepReport {
    let (wall, begin) = (SystemTime::now(), session.clock.now());
    session.report = StepReport::begin(step.name, step.title);
    let outcome = begin_step(step, session).and_then(|()| step.run(session));
    let mut report = std::mem::take(&mut session.report);
    report.began = Some(utc(wall));
    report.monotonic_s = Some(begin.as_secs_f64());
    report.took_s = session.clock.now().seconds_since(begin);
    let complaints = report.complaints();
    let outcome = match (outcome, &session.record_file) {
        (Ok(()), Some(path)) if complaints.is_empty() => session.record.pass(step.name, utc(SystemTime::now()), path),
        (outcome, _) => outcome,
    };
    report.result = match &outcome {
        Err(error) if is_interruption(error) => Outcome::Interrupted,
        Ok(()) if complaints.is_empty() => Outcome::Passed,
        _ => Outcome::Failed,
    };
    report.reasons.extend(complaints);
    if let Err(error) = outcome {
        report.reasons.push(format!("{error:#}"));
    }
    report
}

/// Announces a step, and removes its earlier pass from the commissioning record.
fn begin_step(step: &Step, session: &mut Session<'_>) -> Result<()> {
    print_line(&format!("\n{}: {}", step.name, step.title))?;
    session.record_file.as_ref().map_or(Ok(()), |path| session.record.begin(step.name, path))
}

/// Prints the figures and the result of a step.
fn show_result(report: &StepReport) -> std::io::Result<()> {
    for figure in &report.figures {
        let word = if figure.passed { "ok" } else { "NOT OK" };
        print_line(&format!("  {}: {} ({}) {word}", figure.what, figure.found, figure.allowed))?;
    }
    for reason in &report.reasons {
        print_line(&format!("  {reason}"))?;
    }
    print_line(&format!("{}: {}", report.step, report.result.word()))
}

/// The SHA-256 of this content, as `sha256sum` prints it.
fn sha256(content: &[u8]) -> String {
    Sha256::digest(content).iter().map(|byte| format!("{byte:02x}")).collect()
}
