//! What the host may ask for in each state: the table of `docs/arm-protocol.md` on one page.

use pb3dp_arm_pa10_protocol::gateway_protocol::GatewayState;

/// What a host can ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostRequest {
    /// A command with all brakes on.
    BrakesOn,
    /// A command with open brakes and speeds 0.
    Rest,
    /// A command with open brakes and a speed.
    Motion,
    /// The control mode.
    Start,
    /// The end of the control mode.
    End,
    /// To clear an alarm or to read limits.
    Service,
    /// The stop order.
    Stop,
    /// The end of a latched state.
    Reset,
    /// The stop order of a host that has found a fault.
    Abort,
}

/// What the gateway does about it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GatewayAction {
    /// Follows the command from now on, in this state.
    Follow(GatewayState),
    /// Does nothing of the command, and shows where it is.
    Show,
    /// Speaks to the controller, and answers when that is done.
    Speak,
    /// Nothing: it is done already.
    Nothing,
    /// Begins the stop order.
    BeginStop,
    /// Begins the stop order or goes on with it, and latches.
    Latch,
    /// Refuses it.
    Refuse,
}

impl HostRequest {
    /// All of them, in the order of the table.
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

/// What the gateway does in a state, besides the conditions that the text adds: times of brakes, measurements, work under way.
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
