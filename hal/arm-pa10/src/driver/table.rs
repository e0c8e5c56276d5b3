//! The complete table of states and events.

/// State of the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DriverState {
    /// The state of the arm is unknown.
    Disconnected,
    /// The controller answers and shows no fault; control mode off, brakes on.
    Connected,
    /// Control mode on, servos on, brakes on; the link is tested.
    Enabled,
    /// Brakes open, decelerating or stationary.
    Holding,
    /// Brakes open, velocities are executed.
    Moving,
    /// Stopped by a fault, latched.
    Fault,
    /// Stopped by an emergency stop, latched.
    EStop,
}

/// Activities that take several exchanges.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Activity {
    /// None: the state alone determines the messages.
    None,
    /// Connecting: starts and ends the control mode with closed brakes.
    Connecting,
    /// Starts the control mode and tests the link.
    Enabling,
    /// Opens the brakes at speed 0.
    Releasing,
    /// Executes the stop order.
    Stopping,
    /// Clears alarms and checks whether the cause is gone.
    Clearing,
}

/// Events: requests, results, detected faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Event {
    /// Request: connect.
    Connect,
    /// Request: servos on.
    Enable,
    /// Request: open the brakes.
    ReleaseBrakes,
    /// Request: a velocity.
    Move,
    /// Request: stop with open brakes.
    Hold,
    /// Request: stop, brakes on, control mode off.
    Stop,
    /// Request of an operator: clear the latched state.
    Reset,
    /// Request: release the arm.
    Disconnect,
    /// Connecting is complete.
    Inspected,
    /// Enabling is complete.
    Warmed,
    /// The brakes are open.
    Released,
    /// Stopping is complete.
    Stopped,
    /// Clearing is complete, and the cause is gone.
    Cleared,
    /// A fault was detected.
    FaultFound,
    /// An emergency stop was detected.
    EStopFound,
}

/// Effect of an event in a state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Another state.
    To(DriverState),
    /// The state stays until this activity is complete.
    Begin(Activity),
    /// Accepted without effect.
    Stay,
    /// Refused in this state.
    Refuse,
}

impl DriverState {
    /// All states, in the order of the table.
    pub const ALL: [Self; 7] =
        [Self::Disconnected, Self::Connected, Self::Enabled, Self::Holding, Self::Moving, Self::Fault, Self::EStop];

    /// Whether only a reset leaves the state.
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
        Self::Inspected,
        Self::Warmed,
        Self::Released,
        Self::Stopped,
        Self::Cleared,
        Self::FaultFound,
        Self::EStopFound,
    ];
}

/// Effect of an event in a state. Faults and emergency stops also start [`Activity::Stopping`] if the control mode is on.
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
