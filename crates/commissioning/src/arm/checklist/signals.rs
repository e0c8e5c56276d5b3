//! `pb3dp arm signals`: finds the bits of the status words that show emergency stop, limit switch, dead-man switch and power.

use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_arm_pa10_protocol::codec::{Signal, SignalSource, StatusSignals, WireFormat};
use pb3dp_cell::parts::ArmChoice;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_api::{ArmPower, Clock};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_setup::setup::{Setup, read_layers};
use pb3dp_wiring::commissioning::{ObservedArm, see};

use super::OperatorName;
use super::operator::{Act, Operator, Question};
use super::status_bits::{Changes, Choice, Observed, Words};
use super::{Place, operator_of};
use crate::commissioned::CommissioningRecord;

/// Measurements before and after an action.
const CALM: u32 = 20;
/// Measurements while a switch is actuated.
const ACTUATED: u32 = 5;
/// Measurements until the words have to be as before.
const ATTEMPTS_MAX: u32 = 50;
/// Time between two measurements.
const PAUSE: Duration = Duration::from_millis(20);

/// Arguments of `pb3dp arm signals`.
#[derive(Debug, Args)]
pub struct SignalsArgs {
    #[command(flatten)]
    place: Place,
    /// Operator of the switches: a person, or the program if the arm is emulated.
    #[arg(long, value_enum, default_value = "person")]
    operator: OperatorName,
    /// Longest wait for an answer, seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=3600))]
    patience: u32,
}

/// The arm and its operator.
struct Bench {
    setup: Setup,
    choice: ArmChoice,
    clock: Arc<dyn Clock>,
    operator: Box<dyn Operator>,
    stop: StopSignals,
}

/// Runs the command. The brakes stay closed.
///
/// # Errors
/// A refused configuration, an arm that does not answer or is stopped, or an ambiguous result.
pub fn run(args: &SignalsArgs) -> Result<ExitCode> {
    // Before any thread starts.
    let stop = StopSignals::take_over()?;
    let (choice, mut setup) = (args.place.choice(), read_layers(&args.place.setup)?);
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let stated = choice.of(&setup).link.signals().context("an arm with backend = \"mock\" has no status words")?;
    // What is known must not stop the arm while its switches are actuated.
    choice.of_mut(&mut setup).link.forget_signals();
    let wanted = (args.operator, args.patience, &[choice][..]);
    let (operator, _line) = operator_of(wanted, &mut setup, &clock)?;
    let mut bench = Bench { setup, choice, clock, operator, stop };
    let format = choice.of(&bench.setup).link.format().context("an arm with backend = \"mock\" has no status words")?;
    print_line(&format!("{}: the brakes stay closed, and nothing moves", choice.name()))?;
    let mut found: Vec<(Signal, Changes)> = Vec::new();
    let mut signals = StatusSignals::UNKNOWN;
    for signal in Signal::ALL {
        if stated.get(signal) == SignalSource::Wired {
            print_line(&format!("{signal}: wired by the setup"))?;
            signals = signals.with(signal, SignalSource::Wired);
            continue;
        }
        if signal.may_be_absent() && !bench.ask(&Question::HasSwitch(signal))? {
            signals = signals.with(signal, SignalSource::Absent);
            continue;
        }
        let changes = bench.observe(signal)?.changes(format);
        print_line(&format!("{signal}: {changes}"))?;
        let refusal =
            || format!("{signal}: repeat the command; if this persists, the arm needs a wired input at its gateway");
        found.push((signal, changes.check().with_context(refusal)?));
    }
    for (signal, changes) in &found {
        let others = found.iter().filter(|(other, _)| other != signal).map(|(other, changes)| (*other, changes));
        let bits = match changes.choose(others).context("no bits")? {
            Choice::Own(bits) => bits,
            Choice::Shared(bits, other) => {
                let source = SignalSource::Bits(bits);
                if !bench.ask(&Question::Shared { signal: *signal, other, source })? {
                    bail!("{signal}: its bits also show the {other}; such an arm needs a wired input at its gateway");
                }
                bits
            }
        };
        signals = signals.with(*signal, SignalSource::Bits(bits));
    }
    bench.finish(&signals)?;
    Ok(ExitCode::SUCCESS)
}

impl Bench {
    fn ask(&mut self, question: &Question) -> Result<bool> {
        self.operator.ask(question, &mut self.stop)
    }

    fn see(&self) -> Result<ObservedArm> {
        see(&self.setup, self.choice, &self.clock)
    }

    /// The words before, while and after a switch is actuated.
    fn observe(&mut self, signal: Signal) -> Result<Observed> {
        let mut observed = Observed::default();
        let (on, off) = (Act::Switch(self.choice, signal, true), Act::Switch(self.choice, signal, false));
        if signal == Signal::DeadMan {
            self.operator.ready("Its words are read.", Some(off), &mut self.stop)?;
        }
        let mut opened_arm = self.see()?;
        for _ in 0..CALM {
            let words = look(&mut opened_arm)?.with_context(|| {
                format!("{} is stopped; after the cause is gone, use `pb3dp arm reset`", self.choice.name())
            })?;
            observed.before.push(words);
        }
        self.operator.ready("Keep it so. The words are read.", Some(on), &mut self.stop)?;
        for _ in 0..ACTUATED {
            match look(&mut opened_arm)? {
                Some(words) => observed.during.push(words),
                None => break,
            }
        }
        if observed.during.is_empty() {
            self.refuse_stop_of_format_a(&opened_arm)?;
            // The gateway keeps the words of the stop for the next connection.
            drop(opened_arm);
            opened_arm = self.see()?;
            let snapshot = opened_arm.arm.monitor().snapshot();
            let at_stop =
                snapshot.shown.or(snapshot.sample).context("the gateway shows no status words of the stop")?;
            observed.during.push(Words::of(&at_stop.condition));
        }
        self.operator.ready("The words are read.", Some(off), &mut self.stop)?;
        if opened_arm.arm.monitor().snapshot().latched.is_some() {
            opened_arm
                .arm
                .reset()
                .context("the arm is stopped, and cannot be reset although the switch is released")?;
        }
        // A switch may bounce.
        for _ in 0..ATTEMPTS_MAX {
            if look(&mut opened_arm)? == observed.before.last().copied() {
                break;
            }
        }
        for _ in 0..CALM {
            observed.after.push(look(&mut opened_arm)?.context("the arm stopped after the switch was released")?);
        }
        Ok(observed)
    }

    /// An alarm of format B may stop the arm. Another stop means that the gateway knows the bits, and it would stay silent about them.
    fn refuse_stop_of_format_a(&self, opened_arm: &ObservedArm) -> Result<()> {
        if self.choice.of(&self.setup).link.format() == Some(WireFormat::BigEndian6x10) {
            return Ok(());
        }
        let latched = opened_arm.arm.monitor().snapshot().latched;
        bail!(
            "the arm was stopped ({}), so its words cannot be compared: set the keys of [arm.signals] in the gateway's file to \"unknown\" \
             for this command, and reset the arm",
            latched.map(|latched| latched.trip.to_string()).unwrap_or_default()
        )
    }

    /// Prints and records the result.
    fn finish(&mut self, signals: &StatusSignals) -> Result<()> {
        let arm = self.choice.of(&self.setup);
        let lines: Vec<_> =
            Signal::ALL.iter().map(|signal| format!("{} = \"{}\"", signal.key(), signals.get(*signal))).collect();
        let lines = lines.join("\n");
        print_line(&format!("\nfor the setup:\n\n[{}.gateway.signals]\n{lines}", arm.key))?;
        print_line(&format!("\nfor the file of the gateway:\n\n[arm.signals]\n{lines}"))?;
        let Some(path) = arm.commissioning_record.as_ref().filter(|_| !arm.link.is_toy()) else {
            return Ok(());
        };
        let snapshot = self.see()?.arm.monitor().snapshot();
        // Steps that were passed with other signals count for nothing.
        let new = CommissioningRecord::of(self.choice, arm, &snapshot)?.with_signals(signals);
        new.continued(path)?.save(path)?;
        Ok(print_line(&format!("\ncommissioning record: {}", path.display()))?)
    }
}

/// The words of a measurement with closed brakes; `None` if they stopped the arm.
fn look(opened_arm: &mut ObservedArm) -> Result<Option<Words>> {
    std::thread::sleep(PAUSE);
    let looked = opened_arm.arm.look();
    let snapshot = opened_arm.arm.monitor().snapshot();
    match (snapshot.latched, snapshot.sample) {
        (Some(_), _) => Ok(None),
        (None, Some(sample)) => looked.map(|()| Some(Words::of(&sample.condition))).map_err(Into::into),
        (None, None) => bail!("the arm reported no status words"),
    }
}
