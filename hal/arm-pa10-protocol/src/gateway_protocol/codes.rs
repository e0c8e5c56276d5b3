//! Numbers that stand for something.

use crate::codes::codes;

codes! {
    /// What a command asks of brakes and servos.
    DriveMode {
        /// Brakes on, servos off.
        Off = 0, "off";
        /// Brakes on, servos on.
        Braked = 1, "braked";
        /// Brakes off, servos follow the speeds.
        Follow = 2, "follow";
    }
}

codes! {
    /// What a control message asks for.
    ControlOperation {
        /// Start the control mode (letter S), brakes on.
        Start = 1, "start";
        /// End the control mode (letter E).
        End = 2, "end";
        /// Clear the alarm of one axis (letter A).
        ClearAlarm = 3, "clear-alarm";
        /// Read the limits of one axis (letter R).
        ReadEeprom = 4, "read-eeprom";
        /// Come to rest, brakes on, servos off, end the control mode.
        Stop = 5, "stop";
        /// Clear the latched state of the gateway itself.
        Reset = 6, "reset";
        /// Come to rest as for `stop`, and latch: the host has found a fault.
        Abort = 7, "abort";
    }
}

codes! {
    /// What the gateway is doing.
    GatewayState {
        /// Control mode off, brakes on.
        Idle = 0, "idle";
        /// Control mode on, brakes on.
        Started = 1, "started";
        /// Brakes opening or open, speed 0.
        Holding = 2, "holding";
        /// Brakes open, speeds are followed.
        Moving = 3, "moving";
        /// On the way to rest, brakes and `idle`; a gateway begins with this.
        Stopping = 4, "stopping";
        /// Stopped by a fault, latched.
        Fault = 5, "fault";
        /// Stopped by an emergency stop, latched.
        EmergencyStop = 6, "emergency-stop";
    }
}

codes! {
    /// Why the gateway stopped the arm.
    StopCause {
        /// It did not.
        None = 0, "none";
        /// The host's commands stayed away.
        HostSilent = 1, "host-silent";
        /// The servo controller did not answer.
        ControllerSilent = 2, "controller-silent";
        /// An axis raised an alarm.
        ServoAlarm = 3, "servo-alarm";
        /// The controller raised an alarm.
        ControllerAlarm = 4, "controller-alarm";
        /// Emergency stop, dead-man switch or limit switch.
        EmergencyStop = 5, "emergency-stop";
        /// An axis lost its power or does not follow.
        AxisUncontrollable = 6, "axis-uncontrollable";
        /// Replies of the controller make no sense.
        ReplyUnusable = 7, "reply-unusable";
        /// The gateway missed its own cycle.
        CycleMissed = 8, "cycle-missed";
        /// An error inside of the gateway.
        Internal = 9, "internal";
        /// The host found a fault and said `abort`.
        HostFault = 10, "host-fault";
        /// A command of the host was outside a motion limit of the gateway.
        LimitExceeded = 11, "limit-exceeded";
        /// The switch of the gateway stands on local.
        LocalControl = 12, "local-control";
    }
}

codes! {
    /// Why the gateway refused a frame.
    RejectReason {
        /// No HELLO came before it.
        NotConnected = 1, "not-connected";
        /// The frame is for another arm.
        WrongArm = 2, "wrong-arm";
        /// The type is unknown.
        UnknownType = 3, "unknown-type";
        /// The payload does not have the length of its type.
        WrongLength = 4, "wrong-length";
        /// A field has a value that is not allowed.
        BadValue = 5, "bad-value";
        /// Not in this state.
        WrongState = 6, "wrong-state";
        /// Repeated, overtaken or too old.
        Stale = 7, "stale";
        /// The servo controller did not answer.
        NoAnswer = 10, "no-answer";
        /// The cause of the latched state is still there.
        CausePresent = 11, "cause-present";
        /// The host asks for more than the motion limits of the gateway.
        LimitsTooWide = 12, "limits-too-wide";
        /// The gateway's list of peers does not have this address.
        PeerNotAllowed = 13, "peer-not-allowed";
        /// Too many new connections.
        TooManyPeers = 14, "too-many-peers";
        /// The proof of the key is wrong.
        KeyMismatch = 15, "key-mismatch";
        /// From gateways of earlier versions, which could demand TLS.
        TlsMismatch = 16, "tls-mismatch";
    }
}

codes! {
    /// Which geometry the arm has.
    Geometry {
        /// Nobody told the gateway.
        Unknown = 0, "unknown";
        /// 315, 450, 500, 80 mm.
        FirstGeneration = 1, "first-generation";
        /// 317, 450, 480, 70 mm.
        SecondGeneration = 2, "second-generation";
    }
}

impl Geometry {
    /// Lengths from the base to the shoulder (S2), the elbow (E1), the wrist (W1) and the flange, mm, if it is known. Sources: for
    /// the first generation MHI's model in OpenHRP3, for the second INRIA's of the PA10-7CE.
    pub fn lengths_mm(self) -> Option<[f64; 4]> {
        match self {
            Self::Unknown => None,
            Self::FirstGeneration => Some([315.0, 450.0, 500.0, 80.0]),
            Self::SecondGeneration => Some([317.0, 450.0, 480.0, 70.0]),
        }
    }
}
