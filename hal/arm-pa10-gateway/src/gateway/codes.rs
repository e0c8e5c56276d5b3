//! Codes of refused gateway settings.

use pb3dp_message_codes::codes;

use super::config::GatewayConfigError;

codes! {
    GatewayConfigError, "The settings of a gateway are refused" {
        Cycle = "PB3DP-GW-001": "The cycle on the bus is out of range."; "Give 1 to 10 ms: the servo controller wants 2 ms unless its ROM says otherwise.";
        Lateness = "PB3DP-GW-002": "The allowed lateness of a cycle is out of range."; "Give at least one cycle, and less than the time after which a silent host stops the arm.";
        BrakeTime = "PB3DP-GW-003": "The time that the brakes take to open is out of range."; "Give the measured time, at most 5 s; 200 ms if it is not measured.";
        Watchdog = "PB3DP-GW-004": "The watchdog would slow down a host that keeps its time."; "Give at least 20 ms.";
        Supervision = "PB3DP-GW-005": "Supervision by the controller exists in wire format B only."; "Switch it off, or choose format B if the arm speaks it.";
        Wired = "PB3DP-GW-006": "A signal is stated as wired, but this gateway has no inputs."; "State the bits of a status word: `pb3dp arm signals` finds them.";
        Absent = "PB3DP-GW-007": "A signal that every arm has is stated as absent."; "State the bits of a status word: `pb3dp arm signals` finds them.";
    }
}
