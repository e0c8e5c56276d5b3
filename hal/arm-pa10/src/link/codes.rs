//! Codes of refusals by a gateway.

use pb3dp_message_codes::codes;

use super::gateway::HeldError;

codes! {
    HeldError, "A gateway is held by another host" {
        Held = "PB3DP-ARM-501": "Another host is connected to the gateway. The message names its address."; "End the program there, then try again.";
    }
}
