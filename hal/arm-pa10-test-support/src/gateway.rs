//! A gateway as docs/arm-protocol.md describes it, without a watchdog: it answers according to its state table.

use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmReply, Axis, AxisReply, AxisStatus, CommStatus, CommWord, EepromAxis, ServoWord, SpeedCounts,
    TorqueCounts, TorqueScale, WireFormat, WiredSignals,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, Control, ControlReply, DriveMode, EepromLimits, Firmware, Frame, FrameParser, GatewayMessage,
    GatewayState, Geometry, Health, HelloReply, HostMessage, MotionLimits, Received, Reject, RejectReason, State,
    StopCause,
};
use pb3dp_kinematics::JointVector;

/// A gateway with its arm.
pub struct FakeGateway {
    pub arm: ArmId,
    pub format: WireFormat,
    pub state: GatewayState,
    pub cause: StopCause,
    /// Reported command ages at which it slows down and stops, µs.
    pub watchdog_us: [u32; 2],
    pub brake_us: u32,
    pub limits: MotionLimits,
    /// Whether the cause of the stop is present, which prevents a reset.
    pub cause_present: bool,
    /// The cause that it reports in this case.
    pub found: Option<StopCause>,
    /// Whether it supports ABORT.
    pub knows_abort: bool,
    /// E is refused this many times, because the brakes have not closed yet.
    pub refuse_end: u32,
    pub servo: [ServoWord; 7],
    /// The last accepted speeds, rad/s.
    pub speeds: JointVector,
    pub messages: Vec<HostMessage>,
    pub rejected: Vec<RejectReason>,
    /// Its own clock, µs.
    pub clock_us: u64,
    is_greeted: bool,
    parser: FrameParser,
}

impl FakeGateway {
    pub fn new(arm: ArmId, format: WireFormat) -> Self {
        Self {
            arm,
            format,
            state: GatewayState::Idle,
            cause: StopCause::None,
            watchdog_us: [20_000, 50_000],
            brake_us: 200_000,
            limits: MotionLimits::WIDEST,
            cause_present: false,
            found: None,
            knows_abort: true,
            refuse_end: 0,
            servo: [ServoWord(0); 7],
            speeds: JointVector::zeros(),
            messages: Vec::new(),
            rejected: Vec::new(),
            clock_us: 0,
            is_greeted: false,
            parser: FrameParser::new(arm),
        }
    }

    pub fn latch(&mut self, cause: StopCause) {
        (self.state, self.cause, self.speeds) = (GatewayState::Fault, cause, JointVector::zeros());
    }

    pub fn restart(&mut self) {
        *self = Self::new(self.arm, self.format);
    }

    /// The answers to these bytes.
    pub fn answer(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut frames = Vec::new();
        self.parser.feed(bytes, |received| frames.push(received));
        let mut answers = Vec::new();
        for received in frames {
            let Received::Frame(frame) = received else { continue };
            let message = HostMessage::decode(&frame).unwrap();
            self.messages.push(message);
            let answer = self.handle(&message).unwrap_or_else(|reason| {
                self.rejected.push(reason);
                let found = self.found.filter(|_| reason == RejectReason::CausePresent);
                let detail = found.map_or(0, |found| u32::from(found.code()));
                GatewayMessage::Reject(Reject { reason, frame_type: frame.frame_type, detail })
            });
            answers.extend(self.frame(&answer, frame.sequence).encode().as_slice());
        }
        answers
    }

    pub fn frame(&self, message: &GatewayMessage, sequence: u16) -> Frame {
        message.frame(self.arm, sequence, self.clock_us)
    }

    fn handle(&mut self, message: &HostMessage) -> Result<GatewayMessage, RejectReason> {
        if let HostMessage::Hello(_) = message {
            self.is_greeted = true;
            return Ok(GatewayMessage::HelloReply(self.hello_reply()));
        }
        if !self.is_greeted {
            return Err(RejectReason::NotConnected);
        }
        match message {
            HostMessage::Command(command) => {
                self.command(command.mode, command.velocity_rad_per_s())?;
                let scale = TorqueScale::of_format(self.format);
                let mut state = State::from_reply(&self.arm_reply(), &scale, 100).unwrap();
                (state.gateway, state.cause) = (self.state, self.cause);
                Ok(GatewayMessage::State(state))
            }
            HostMessage::Control(control @ Control::ReadEeprom(axis)) => {
                self.control(*control)?;
                let (positive_limit_urad, negative_limit_urad) = (3_000_000, -3_000_000);
                Ok(GatewayMessage::EepromLimits(EepromLimits { axis: *axis, positive_limit_urad, negative_limit_urad }))
            }
            HostMessage::Control(Control::Arm(ArmOperation::Abort)) if !self.knows_abort => Err(RejectReason::BadValue),
            HostMessage::Control(control) => {
                self.control(*control)?;
                Ok(GatewayMessage::ControlReply(ControlReply { control: *control, state: self.state }))
            }
            HostMessage::Heartbeat => Ok(GatewayMessage::Health(self.health())),
            HostMessage::Hello(_) => Err(RejectReason::UnknownType),
        }
    }

    fn command(&mut self, mode: DriveMode, speeds: JointVector) -> Result<(), RejectReason> {
        use GatewayState::{EmergencyStop, Fault, Holding, Idle, Moving, Started, Stopping};
        let moves = speeds != JointVector::zeros();
        self.state = match (self.state, mode) {
            (Fault | EmergencyStop | Stopping, _) => return Ok(()),
            (Started, DriveMode::Off | DriveMode::Braked) => Started,
            (Holding, DriveMode::Off | DriveMode::Braked) => Started,
            (Started, DriveMode::Follow) if !moves => Holding,
            (Holding | Moving, DriveMode::Follow) => {
                if moves {
                    Moving
                } else {
                    Holding
                }
            }
            (Idle | Started | Moving, _) => return Err(RejectReason::WrongState),
        };
        self.speeds = speeds;
        Ok(())
    }

    fn control(&mut self, control: Control) -> Result<(), RejectReason> {
        let latched = matches!(self.state, GatewayState::Fault | GatewayState::EmergencyStop);
        if control == Control::Arm(ArmOperation::End) && self.refuse_end > 0 {
            self.refuse_end -= 1;
            return Err(RejectReason::WrongState);
        }
        self.state = match (control, self.state) {
            (Control::Arm(ArmOperation::Start), GatewayState::Idle | GatewayState::Started) => GatewayState::Started,
            (Control::Arm(ArmOperation::End), GatewayState::Idle | GatewayState::Started) => GatewayState::Idle,
            (Control::Arm(ArmOperation::Stop), _) if !latched => GatewayState::Idle,
            (Control::Arm(ArmOperation::Abort), state) if latched => state,
            (Control::Arm(ArmOperation::Abort), _) => {
                self.latch(StopCause::HostFault);
                GatewayState::Fault
            }
            (Control::Arm(ArmOperation::Reset), GatewayState::Idle) => GatewayState::Idle,
            (Control::Arm(ArmOperation::Reset), _) if latched && self.cause_present => {
                return Err(RejectReason::CausePresent);
            }
            (Control::Arm(ArmOperation::Reset), _) if latched => {
                self.cause = StopCause::None;
                GatewayState::Idle
            }
            (Control::ClearAlarm(_) | Control::ReadEeprom(_), state) if latched || state == GatewayState::Idle => state,
            _ => return Err(RejectReason::WrongState),
        };
        Ok(())
    }

    fn arm_reply(&self) -> ArmReply {
        let documented = self.format == WireFormat::BigEndian6x10;
        let axes = std::array::from_fn(|index| AxisReply {
            status: if documented { AxisStatus::Servo(self.servo[index]) } else { AxisStatus::Undocumented(0x0110) },
            angle: AngleCounts(1000 * (index as i32 + 1)),
            speed: documented.then_some(SpeedCounts(0)),
            torque: TorqueCounts(-1),
        });
        let comm = if documented { CommStatus::Comm(CommWord(1)) } else { CommStatus::Undocumented(0x0111) };
        ArmReply { axes, comm }
    }

    fn hello_reply(&self) -> HelloReply {
        HelloReply {
            wired: WiredSignals::default(),
            wire_format: Some(self.format),
            geometry: Geometry::SecondGeneration,
            state: self.state,
            cause: self.cause,
            cycle_us: 2000,
            ramp_after_us: self.watchdog_us[0],
            stop_after_us: self.watchdog_us[1],
            controller_watchdog_us: 0,
            brake_release_us: self.brake_us,
            firmware: Firmware::new("fake").unwrap(),
            limits: self.limits,
        }
    }

    fn health(&self) -> Health {
        Health {
            state: self.state,
            cause: self.cause,
            exchanges: 0,
            replies_lost: 0,
            replies_late: 0,
            replies_mismatched: 0,
            overruns: 0,
            worst_cycle_us: 2000,
            host_damaged: 0,
            host_lost: 0,
            host_stale: 0,
        }
    }
}

/// Plausible EEPROM data of an axis.
pub fn plausible_eeprom(axis: Axis) -> EepromAxis {
    EepromAxis {
        axis,
        positive_limit: AngleCounts(391_139),
        negative_limit: AngleCounts(-391_139),
        zero_offset_raw: 0,
        poles: 2,
    }
}
