//! Who leads a run: the command line, alone or with a person beside the arms, or a console.

use std::io::{BufRead, BufReader, IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use anyhow::{Result, bail};
use pb3dp_cell::attended::AttendedCommand;
use pb3dp_cell::console::{Console, ConsoleOptions, ConsoleTargets};
use pb3dp_cell::operator::{ByCommand, Operator};
use pb3dp_cell::terminal::{TypedInput, print_line};
use pb3dp_commissioning::arm::confirm;
use pb3dp_commissioning::commissioned::real_arms;
use pb3dp_hal_api::Clock;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_setup::setup::{Pace, Setup};

use crate::arguments::{OperatorName, RunArgs};

/// The operator that was asked for, and standard input, from which one is heard.
pub struct Attendance {
    name: OperatorName,
    is_emulated: bool,
    key_within: Duration,
    typed: Box<dyn BufRead + Send>,
}

impl Attendance {
    /// Waits until a person has typed the names of the arms that are not emulated, unless a console leads the run; `None` if the panel
    /// leads it.
    ///
    /// # Errors
    /// Arms that nobody leads or confirms, something else typed, a pace that no person can follow, or a panel without images.
    pub fn confirmed(args: &RunArgs, setup: &Setup, signals: &mut StopSignals) -> Result<Option<Self>> {
        if args.panel.is_some() {
            if setup.pace == Pace::Fast {
                bail!(
                    "--panel: at run.pace = \"fast\" no person can follow; use --config playground, or --set run.pace=real-time (or live)"
                );
            }
            if !setup.leader.needs_images() {
                let method = setup.leader.name();
                bail!(
                    "--panel: with estimator.method = {method:?} there are no images in which a target can be chosen"
                );
            }
            return Ok(None);
        }
        if args.operator == OperatorName::Console && setup.pace == Pace::Fast {
            bail!(
                "--operator console: at pace = \"fast\" nobody can speak in time; set pace to \"real-time\" or \"live\""
            );
        }
        if setup.hold_to_run {
            bail!("supervisor.hold_to_run = true: only the panel has a button to hold; use --panel");
        }
        let (is_emulated, key_within) = (setup.is_emulated(), setup.operator_key_within);
        if !is_emulated {
            confirm::need_person()?;
        }
        let by = |typed| Some(Self { name: args.operator, is_emulated, key_within, typed });
        if is_emulated || args.operator == OperatorName::Console {
            return Ok(by(Box::new(BufReader::new(std::io::stdin()))));
        }
        let names: Vec<&str> = real_arms(setup).iter().map(|choice| choice.name()).collect();
        let names = names.join(" ");
        if !args.moves {
            bail!(
                "{names}: not emulated, so a person must lead or confirm this run; use --operator console, or --move and type {names:?}"
            );
        }
        print_line(&format!(
            "The arms will move. Keep all persons out of their reach and a hand on the emergency stop.\nWhile they move, press Enter at \
             least every {} s, or they hold.\nType {names} to move them:",
            key_within.as_secs_f64()
        ))?;
        let console = confirm::Console::start()?;
        console.typed(&names, None, signals)?;
        Ok(by(Box::new(TypedInput::of(console.into_lines()))))
    }

    /// The operator. One of arms that are not emulated shows by keys that it is there.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub fn operator(
        self,
        clock: Arc<dyn Clock>,
        answers: impl Write + Send + 'static,
        interrupt: Arc<AtomicBool>,
        targets: Option<ConsoleTargets>,
    ) -> Result<Box<dyn Operator>> {
        let Self { name, is_emulated, key_within, typed } = self;
        let prompt = if std::io::stdin().is_terminal() { "pb3dp> " } else { "" };
        let console = || Console::start(clock, typed, answers, ConsoleOptions { interrupt, prompt, targets });
        Ok(match (name, is_emulated) {
            (OperatorName::Command, true) => Box::new(ByCommand),
            (OperatorName::Command, false) => Box::new(AttendedCommand::new(console()?.with_keys(key_within))),
            (OperatorName::Console, true) => Box::new(console()?),
            (OperatorName::Console, false) => Box::new(console()?.with_keys(key_within)),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

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
            let attendance =
                Attendance { name: *name, is_emulated: false, key_within: setup.operator_key_within, typed };
            let mut operator = attendance.operator(clock, std::io::sink(), Arc::default(), None).unwrap();
            assert!(operator.can_fall_silent(), "{name:?}");
            let begin = MonotonicTime::from_secs_f64(100.0);
            let input = operator.listen(None, begin);
            assert_eq!(
                (input.heartbeat_at, input.silent_after),
                (Some(begin), Some(Duration::from_secs(30))),
                "{name:?}"
            );
            let input = operator.listen(None, begin + Duration::from_secs(40));
            assert_eq!(input.heartbeat_at, Some(begin), "{name:?} is heard although nobody types");
        }
    }
}
