//! Settings with which the steps of a commissioning record were passed: a stop that was tested with other ones was not tested.

use std::collections::BTreeMap;

use pb3dp_arm_pa10_protocol::codec::{Signal, StatusSignals};
use pb3dp_arm_pa10_protocol::gateway_protocol::HelloReply;
use pb3dp_kinematics::DOF;
use pb3dp_setup::setup::ArmSetup;
use serde::{Deserialize, Serialize};

use super::SAME_DEG;

/// What records of earlier versions call the messages between host and gateway.
const MESSAGES: &str = "gateway-v1";

/// Settings of the setup that decide what the steps test. They are compared before a port opens.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetupSettings {
    /// By the key of the signal: how it is noticed.
    signals: BTreeMap<String, String>,
    /// Wire format of the controller.
    wire_format: String,
    /// Messages between host and gateway, in records of earlier versions.
    #[serde(skip_serializing_if = "Option::is_none")]
    dialect: Option<String>,
    /// Operating range of each axis, degrees. A narrower one was tested, too.
    operating_range_deg: Vec<[f64; 2]>,
}

/// Settings that the gateway reports and that decide what the steps test. They are compared before brakes open.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GatewaySettings {
    /// Time between two exchanges with the controller.
    cycle_us: u32,
    /// Age of a command from which on the gateway slows the arm down.
    ramp_after_us: u32,
    /// Age of a command at which the gateway closes the brakes.
    stop_after_us: u32,
    /// Time-out of the controller, 0 if it is unknown.
    controller_watchdog_us: u32,
    /// Time that the brakes take to open.
    brake_us: u32,
    /// Range of each axis, degrees. A narrower one was tested, too.
    range_deg: Vec<[f64; 2]>,
}

fn degrees(rad: f64) -> f64 {
    (rad.to_degrees() * 1e4).round() / 1e4
}

/// A setting that differs: as recorded, and as found.
fn changed(what: &str, old: &dyn std::fmt::Display, new: &dyn std::fmt::Display) -> String {
    format!("{what} is {new}, its steps were passed with {old}")
}

/// The first axis whose range is wider than the recorded one.
fn wider(what: &str, old: &[[f64; 2]], new: &[[f64; 2]]) -> Option<String> {
    if old.len() != new.len() {
        return Some(changed(&format!("the number of axes of {what}"), &old.len(), &new.len()));
    }
    old.iter().zip(new).enumerate().find_map(|(axis, (old, new))| {
        // False for NaN.
        let is_inside = new[0] >= old[0] - SAME_DEG && new[1] <= old[1] + SAME_DEG;
        let text = |range: &[f64; 2]| format!("{} to {} degrees", range[0], range[1]);
        (!is_inside).then(|| changed(&format!("{what} of axis {}", axis + 1), &text(old), &text(new)))
    })
}

impl SetupSettings {
    /// The settings of an arm.
    pub fn of(arm: &ArmSetup) -> Self {
        let range = arm.limits.operating();
        let ends = |joint| [range.position_min_rad()[joint], range.position_max_rad()[joint]].map(degrees);
        let signals = arm.link.signals().unwrap_or(StatusSignals::UNKNOWN);
        let settings = Self {
            signals: BTreeMap::new(),
            wire_format: arm.link.format().map(|format| format.to_string()).unwrap_or_default(),
            dialect: None,
            operating_range_deg: (0..DOF).map(ends).collect(),
        };
        settings.with_signals(&signals)
    }

    /// The settings with other sources of the signals.
    #[must_use]
    pub fn with_signals(self, signals: &StatusSignals) -> Self {
        let texts = Signal::ALL.iter().map(|signal| (signal.key().to_owned(), signals.get(*signal).to_string()));
        Self { signals: texts.collect(), ..self }
    }

    /// The first setting that differs from the recorded one.
    pub fn difference(&self, found: &Self) -> Option<String> {
        let keys = self.signals.keys().chain(found.signals.keys());
        let mut of_signals = keys.filter_map(|key| {
            let [old, new] =
                [self, found].map(|settings| settings.signals.get(key).map_or("not stated", String::as_str));
            (old != new).then(|| changed(&format!("signals.{key}"), &format!("\"{old}\""), &format!("\"{new}\"")))
        });
        if let Some(difference) = of_signals.next() {
            return Some(difference);
        }
        if self.wire_format != found.wire_format {
            return Some(changed("wire_format", &self.wire_format, &found.wire_format));
        }
        if let Some(other) = self.dialect.as_deref().filter(|dialect| *dialect != MESSAGES) {
            return Some(changed("the dialect of the gateway", &other, &MESSAGES));
        }
        wider("operating_range_deg", &self.operating_range_deg, &found.operating_range_deg)
    }
}

impl GatewaySettings {
    /// The settings of a connected gateway.
    pub fn of(gateway: &HelloReply) -> Self {
        Self {
            cycle_us: gateway.cycle_us,
            ramp_after_us: gateway.ramp_after_us,
            stop_after_us: gateway.stop_after_us,
            controller_watchdog_us: gateway.controller_watchdog_us,
            brake_us: gateway.brake_release_us,
            range_deg: gateway.limits.axes.iter().map(|axis| axis.to_si().range_rad.map(degrees)).collect(),
        }
    }

    /// The first setting that differs from the recorded one.
    pub fn difference(&self, found: &Self) -> Option<String> {
        let times = [
            ("the cycle of the gateway", self.cycle_us, found.cycle_us),
            ("the age of a command at which the gateway slows the arm down", self.ramp_after_us, found.ramp_after_us),
            ("the age of a command at which the gateway stops the arm", self.stop_after_us, found.stop_after_us),
            ("the time-out of the controller", self.controller_watchdog_us, found.controller_watchdog_us),
            ("the brake time", self.brake_us, found.brake_us),
        ];
        let millis = |us: u32| format!("{} ms", f64::from(us) / 1e3);
        let differs = times.into_iter().find(|(_, old, new)| old != new);
        differs
            .map(|(what, old, new)| changed(what, &millis(old), &millis(new)))
            .or_else(|| wider("the range of the gateway", &self.range_deg, &found.range_deg))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A change of settings, and a part of what is said about it.
    type Change<T> = (fn(&mut T), &'static str);

    pub fn setup_settings() -> SetupSettings {
        SetupSettings {
            signals: BTreeMap::new(),
            wire_format: "format B".to_owned(),
            dialect: None,
            operating_range_deg: vec![[-170.0, 160.0]; DOF],
        }
        .with_signals(&StatusSignals::ORCA)
    }

    pub fn gateway_settings() -> GatewaySettings {
        GatewaySettings {
            cycle_us: 2000,
            ramp_after_us: 20_000,
            stop_after_us: 50_000,
            controller_watchdog_us: 6000,
            brake_us: 200_000,
            range_deg: vec![[-175.0, 165.0]; DOF],
        }
    }

    #[test]
    fn each_setting_that_a_step_has_tested_is_compared() {
        assert_eq!(setup_settings().difference(&setup_settings()), None);
        let changes: [Change<SetupSettings>; 4] = [
            (
                |new| *new.signals.get_mut("emergency_stop").unwrap() = "controller 0x0010 set".to_owned(),
                "signals.emergency_stop is \"controller 0x0010 set\", its steps were passed with \"controller ",
            ),
            (|new| *new.signals.get_mut("dead_man").unwrap() = "absent".to_owned(), "signals.dead_man is \"absent\""),
            (|new| new.wire_format = "format A".to_owned(), "wire_format is format A"),
            (
                |new| new.operating_range_deg[3][1] = 161.0,
                "operating_range_deg of axis 4 is -170 to 161 degrees, its steps were passed with -170 to 160",
            ),
        ];
        for (change, text) in changes {
            let mut new = setup_settings();
            change(&mut new);
            let difference = setup_settings().difference(&new).unwrap();
            assert!(difference.contains(text), "{difference}");
        }
        let mut narrower = setup_settings();
        narrower.operating_range_deg[3] = [-160.0, 150.0];
        assert_eq!(setup_settings().difference(&narrower), None);
        // A record of an earlier version says with which messages its steps were passed.
        let earlier = |dialect: &str| SetupSettings { dialect: Some(dialect.to_owned()), ..setup_settings() };
        assert_eq!(earlier("gateway-v1").difference(&setup_settings()), None);
        let difference = earlier("transparent").difference(&setup_settings()).unwrap();
        assert!(difference.contains("dialect of the gateway is gateway-v1"), "{difference}");
    }

    #[test]
    fn each_setting_of_the_gateway_is_compared() {
        assert_eq!(gateway_settings().difference(&gateway_settings()), None);
        let changes: [Change<GatewaySettings>; 6] = [
            (|new| new.cycle_us = 4000, "cycle of the gateway is 4 ms"),
            (|new| new.ramp_after_us = 30_000, "slows the arm down is 30 ms"),
            (|new| new.stop_after_us = 80_000, "stops the arm is 80 ms, its steps were passed with 50 ms"),
            (|new| new.controller_watchdog_us = 0, "time-out of the controller is 0 ms"),
            (|new| new.brake_us = 300_000, "brake time is 300 ms"),
            (|new| new.range_deg[0][0] = -176.0, "range of the gateway of axis 1"),
        ];
        for (change, text) in changes {
            let mut new = gateway_settings();
            change(&mut new);
            let difference = gateway_settings().difference(&new).unwrap();
            assert!(difference.contains(text), "{difference}");
        }
    }
}
