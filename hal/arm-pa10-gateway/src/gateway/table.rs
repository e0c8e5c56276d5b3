//! Requests that the host may make in each state: the table of `docs/arm-protocol.md`.

use pb3dp_arm_pa10_protocol::gateway_protocol::GatewayState;

/// Requests of a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostRequest {
    /// A command with all brakes on.
    BrakesOn,
    /// A command with open brakes and speeds 0.
    Rest,
    /// A command with open brakes and a speed.
    Motion,
    /// Start the control mode.
    Start,
    /// End the control mode.
    End,
    /// Clear an alarm or read limits.
    Service,
    /// The stop order.
    Stop,
    /// End a latched state.
    Reset,
    /// The stop order of a host that has found a fault.
    Abort,
}

/// Action of the gateway on a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GatewayAction {
    /// Follows the command from now on, in this state.
    Follow(GatewayState),
    /// Executes nothing, and answers with the state.
    Show,
    /// Sends a message to the controller, and answers when that is done.
    Speak,
    /// Nothing: the request is already fulfilled.
    Nothing,
    /// Begins the stop order.
    BeginStop,
    /// Begins or continues the stop order, and latches.
    Latch,
    /// Refuses the request.
    Refuse,
}

impl HostRequest {
    /// All requests, in the order of the table.
    pub const ALL: [Self; 9] = [
        Self::BrakesOn,
        Self::Rest,
        Self::Motion,
        Self::Start,
        Self::End,
        Self::Service,
        Self::Stop,
        Self::Reset,
        Self::Abort,
    ];
}

/// The action in a state, without the further conditions of the document: brake times, measurements, requests in progress.
#[rustfmt::skip]
pub fn action(state: GatewayState, request: HostRequest) -> GatewayAction {
    use GatewayAction::{BeginStop as Stop, Latch, Nothing as Done, Refuse as N, Show, Speak};
    const START: GatewayAction = GatewayAction::Follow(GatewayState::Started);
    const HOLD: GatewayAction = GatewayAction::Follow(GatewayState::Holding);
    const MOVE: GatewayAction = GatewayAction::Follow(GatewayState::Moving);
    const TABLE: [[GatewayAction; 9]; 7] = [
        // BrakesOn Rest  Motion Start  End    Service Stop  Reset  Abort
        [N,         N,    N,     Speak, Done,  Speak,  Done, Done,  Latch], // idle
        [START,     HOLD, N,     Done,  Speak, N,      Stop, N,     Latch], // started
        [START,     HOLD, MOVE,  N,     N,     N,      Stop, N,     Latch], // holding
        [N,         HOLD, MOVE,  N,     N,     N,      Stop, N,     Latch], // moving
        [Show,      Show, Show,  N,     N,     N,      Done, N,     Latch], // stopping
        [Show,      Show, Show,  N,     N,     Speak,  Done, Speak, Done],  // fault
        [Show,      Show, Show,  N,     N,     Speak,  Done, Speak, Done],  // emergency-stop
    ];
    TABLE[usize::from(state.code())][request as usize]
}
