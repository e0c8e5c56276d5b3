//! The codes of all messages: those of a cell, and those of the devices that only this crate names.

use std::error::Error;

use pb3dp_arm_pa10::arm::{AccessError, RequestError};
use pb3dp_arm_pa10::driver::{EmergencyStopCause, FaultCause, Refusal, WarmUpFailure};
use pb3dp_arm_pa10::link::{HeldError, HelloError};
use pb3dp_arm_pa10_gateway::gateway::GatewayConfigError;
use pb3dp_cell::message_codes::{self, CodeTable, table};
pub use pb3dp_message_codes::{Argument, spell_arguments};
use pb3dp_message_codes::{Coded, MessageCode};

/// The option of the program for what a message asks for.
pub fn option_of(argument: Argument) -> &'static str {
    match argument {
        Argument::DepthRange => "--z-range",
        Argument::TiltLimit => "--tilt-max",
        Argument::VisibleSurface => "--surface",
        Argument::Skew => "--skew",
        Argument::Rectified => "--rectified",
    }
}

/// The same for a program that reads these values from a setup.
pub fn key_of(argument: Argument) -> &'static str {
    match argument {
        Argument::DepthRange => "estimator.z_min_mm, estimator.z_max_mm",
        Argument::TiltLimit => "estimator.tilt_max_deg",
        Argument::VisibleSurface => "--surface of `pb3dp estimate`",
        Argument::Skew => "--skew of `pb3dp track`",
        Argument::Rectified => "--rectified of `pb3dp track`",
    }
}

/// All tables, in the order of the reference.
pub fn tables() -> Vec<CodeTable> {
    let of_devices = [
        table::<FaultCause>(),
        table::<EmergencyStopCause>(),
        table::<WarmUpFailure>(),
        table::<Refusal>(),
        table::<GatewayConfigError>(),
        table::<HeldError>(),
        table::<AccessError>(),
        table::<pb3dp_panel::Refusal>(),
    ];
    message_codes::TABLES.into_iter().chain(of_devices).collect()
}

const PREFIX: &str = "PB3DP-";

/// The code of a message with its cause and remedy; `None` if no message has this code. Case, the prefix `PB3DP-` and the
/// brackets of a log line may differ.
pub fn find(code: &str) -> Option<&'static MessageCode> {
    let code = code.trim_matches(['[', ']', ' ']).to_ascii_uppercase();
    let number = code.strip_prefix(PREFIX).unwrap_or(&code);
    let is_same = |known: &&MessageCode| known.code.strip_prefix(PREFIX) == Some(number);
    tables().into_iter().flat_map(|(_, codes)| codes).find(is_same)
}

/// The code of an error: that of its deepest source that has one, because it is the most specific.
pub fn code_of(error: &anyhow::Error) -> Option<&'static MessageCode> {
    error.chain().filter_map(|cause| message_codes::code_of(cause).or_else(|| of_device(cause))).last()
}

/// An error with its sources and its code, as a log line shows it. A message that already ends with a code stays as it is.
pub fn error_text(error: &anyhow::Error) -> String {
    let text = format!("{error:#}");
    match code_of(error) {
        Some(known) if !text.contains(PREFIX) => format!("{text} [{}]", known.code),
        _ => text,
    }
}

fn of_device(error: &(dyn Error + 'static)) -> Option<&'static MessageCode> {
    let fault = error.downcast_ref::<FaultCause>().map(Coded::message_code);
    let stop = || error.downcast_ref::<EmergencyStopCause>().map(Coded::message_code);
    let warm_up = || error.downcast_ref::<WarmUpFailure>().map(Coded::message_code);
    let refusal = || error.downcast_ref::<Refusal>().map(Coded::message_code);
    let gateway = || error.downcast_ref::<GatewayConfigError>().map(Coded::message_code);
    let access = || error.downcast_ref::<AccessError>().map(Coded::message_code);
    let panel = || error.downcast_ref::<pb3dp_panel::Refusal>().map(Coded::message_code);
    let held = || match error.downcast_ref::<RequestError>() {
        Some(RequestError::Gateway(HelloError::Held(held))) => Some(held.message_code()),
        _ => None,
    };
    fault.or_else(stop).or_else(warm_up).or_else(refusal).or_else(gateway).or_else(access).or_else(panel).or_else(held)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use anyhow::Context;
    use pb3dp_hal_api::{ArmError, ArmErrorKind};
    use pb3dp_setup::explain::explain;
    use pb3dp_setup::setup::read_setup;

    use super::*;

    #[test]
    fn codes_have_one_form_and_are_given_once_with_sentences() {
        let mut unique = BTreeSet::new();
        for code in tables().into_iter().flat_map(|(_, codes)| codes) {
            let parts: Vec<&str> = code.code.split('-').collect();
            let is_well_formed = matches!(parts[..], ["PB3DP", area, number]
                if area.chars().all(|c| c.is_ascii_uppercase()) && number.len() == 3 && number.parse::<u16>().is_ok());
            assert!(is_well_formed, "{}", code.code);
            assert!(unique.insert(code.code), "{} is given twice", code.code);
            for text in [code.cause, code.remedy] {
                assert!(text.len() > 7 && text.ends_with('.') && text.len() < 200, "{}: {text}", code.code);
            }
        }
        assert!(unique.len() > 100, "{}", unique.len());
    }

    #[test]
    fn a_message_of_a_run_names_keys_that_exist() {
        for argument in Argument::ALL {
            let keys: Vec<&str> = key_of(argument).split(", ").filter(|name| name.contains('.')).collect();
            assert!(keys.iter().all(|key| explain(key).is_ok_and(|found| found[0].key == *key)), "{keys:?}");
            assert_eq!(keys.is_empty(), key_of(argument).starts_with("--"));
        }
    }

    #[test]
    fn the_most_specific_source_gives_the_code() {
        let missing = read_setup(Path::new("/nowhere/rig.toml")).context("the rig").unwrap_err();
        assert_eq!(code_of(&missing).unwrap().code, "PB3DP-CFG-001");
        let fault = ArmError::caused_by(ArmErrorKind::Fault, "arm vs-robot", FaultCause::Unplugged);
        assert_eq!(code_of(&fault.into()).unwrap().code, "PB3DP-ARM-104");
        let silent = ArmError::new(ArmErrorKind::Timeout, "arm vs-robot: late");
        assert_eq!(code_of(&anyhow::Error::new(silent).context("run")).unwrap().code, "PB3DP-ARM-003");
        assert_eq!(code_of(&anyhow::anyhow!("something else")), None);
        let silent = ArmError::new(ArmErrorKind::Timeout, "arm vs-robot: late");
        assert_eq!(error_text(&anyhow::Error::new(silent).context("run")), "run: arm vs-robot: late [PB3DP-ARM-003]");
        assert_eq!(error_text(&anyhow::anyhow!("held [PB3DP-SUP-001]")), "held [PB3DP-SUP-001]");
        for code in ["PB3DP-ARM-104", "pb3dp-arm-104", "ARM-104", "[PB3DP-ARM-104]"] {
            assert_eq!(find(code).unwrap().code, "PB3DP-ARM-104", "{code}");
        }
        assert_eq!(find("PB3DP-ARM-999"), None);
    }
}
