//! Which event leads where: the whole state machine on one page.

/// Where the driver is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DriverState {
    /// Nothing is known of the arm.
    Disconnected,
    /// The controller answers and shows no fault; control mode off, brakes on.
    Connected,
    /// Control mode on, servos on, brakes on; the link is proven.
    Enabled,
    /// Brakes open, coming to rest or at rest.
    Holding,
    /// Brakes open, velocities are followed.
    Moving,
    /// Stopped by a fault, latched.
    Fault,
    /// Stopped by an emergency stop, latched.
    EStop,
}

/// What takes several exchanges.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Activity {
    /// None: the state alone says what is sent.
    None,
    /// Looks at the arm: starts and ends the control mode with brakes on.
    Connecting,
    /// Starts the control mode and proves the link.
    Enabling,
    /// Opens the brakes at speed 0.
    Releasing,
    /// Goes through the stop order.
    Stopping,
    /// Clears alarms and looks whether the cause is gone.
    Clearing,
}

/// What can happen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Event {
    /// Asked for: look at the arm.
    Connect,
    /// Asked for: servos on.
    Enable,
    /// Asked for: brakes open.
    ReleaseBrakes,
    /// Asked for: a velocity.
    Move,
    /// Asked for: come to rest with open brakes.
    Hold,
    /// Asked for: come to rest, brakes on, control mode off.
    Stop,
    /// Asked for by an operator: clear the latched state.
    Reset,
    /// Requested: release the arm.
    Disconnect,
    /// Done: connecting.
    Seen,
    /// Done: enabling.
    Warmed,
    /// Done: releasing.
    Released,
    /// Done: stopping.
    Stopped,
    /// Done: clearing, and the cause is gone.
    Cleared,
    /// Found: a fault.
    FaultFound,
    /// Found: an emergency stop.
    EStopFound,
}

/// What an event does in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Another state.
    To(DriverState),
    /// The state stays until this activity is done.
    Begin(Activity),
    /// Allowed, and changes nothing.
    Stay,
    /// Not in this state.
    Refuse,
}

impl DriverState {
    /// All states, in the order of the table.
    pub const ALL: [Self; 7] =
        [Self::Disconnected, Self::Connected, Self::Enabled, Self::Holding, Self::Moving, Self::Fault, Self::EStop];

    /// Whether only a reset leads on.
    pub fn is_latched(self) -> bool {
        matches!(self, Self::Fault | Self::EStop)
    }

    /// Whether the brakes are open or opening.
    pub fn has_open_brakes(self) -> bool {
        matches!(self, Self::Holding | Self::Moving)
    }
}

impl Event {
    /// All events, in the order of the table.
    pub const ALL: [Self; 15] = [
        Self::Connect,
        Self::Enable,
        Self::ReleaseBrakes,
        Self::Move,
        Self::Hold,
        Self::Stop,
        Self::Reset,
        Self::Disconnect,
        Self::Seen,
        Self::Warmed,
        Self::Released,
        Self::Stopped,
        Self::Cleared,
        Self::FaultFound,
        Self::EStopFound,
    ];
}

/// What an event does in a state. Faults and emergency stops also begin [`Activity::Stopping`] where the control mode is on.
#[rustfmt::skip]
pub fn outcome(state: DriverState, event: Event) -> Outcome {
    use DriverState::{Connected, Disconnected, EStop, Enabled, Fault, Holding, Moving};
    use Outcome::{Begin, Refuse, Stay, To};
    const N: Outcome = Refuse;
    const F: Outcome = To(Fault);
    const S: Outcome = To(EStop);
    const STOP: Outcome = Begin(Activity::Stopping);
    const LOOK: Outcome = Begin(Activity::Connecting);
    const WARM: Outcome = Begin(Activity::Enabling);
    const OPEN: Outcome = Begin(Activity::Releasing);
    const WIPE: Outcome = Begin(Activity::Clearing);
    const TABLE: [[Outcome; 15]; 7] = [
        // Connect Enable ReleaseBrakes Move         Hold         Stop  Reset Disconnect        Seen           Warmed       Released     Stopped        Cleared        FaultFound EStopFound
        [LOOK,     N,     N,            N,           N,           Stay, N,    Stay,             To(Connected), N,           N,           Stay,          N,             F,         S],   // Disconnected
        [N,        WARM,  N,            N,           Stay,        Stay, N,    To(Disconnected), N,             To(Enabled), N,           Stay,          N,             F,         S],   // Connected
        [N,        N,     OPEN,         N,           Stay,        STOP, N,    N,                N,             N,           To(Holding), To(Connected), N,             F,         S],   // Enabled
        [N,        N,     N,            To(Moving),  Stay,        STOP, N,    N,                N,             N,           N,           To(Connected), N,             F,         S],   // Holding
        [N,        N,     N,            Stay,        To(Holding), STOP, N,    N,                N,             N,           N,           To(Connected), N,             F,         S],   // Moving
        [N,        N,     N,            N,           N,           Stay, WIPE, N,                N,             N,           N,           Stay,          To(Connected), Stay,      S],   // Fault
        [N,        N,     N,            N,           N,           Stay, WIPE, N,                N,             N,           N,           Stay,          To(Connected), Stay,      Stay], // EStop
    ];
    TABLE[state as usize][event as usize]
}

impl std::fmt::Display for DriverState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Disconnected => "disconnected",
            Self::Connected => "connected, brakes on",
            Self::Enabled => "enabled, brakes on",
            Self::Holding => "holding",
            Self::Moving => "moving",
            Self::Fault => "stopped by a fault",
            Self::EStop => "stopped by an emergency stop, dead-man switch or limit switch",
        })
    }
}

impl std::fmt::Display for Activity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::None => "idle",
            Self::Connecting => "connecting",
            Self::Enabling => "enabling",
            Self::Releasing => "opening the brakes",
            Self::Stopping => "stopping",
            Self::Clearing => "clearing alarms",
        })
    }
}
