//! The link to a gateway.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{
    Axis, AxisCommand, CodecError, CommAlarm, ControlMessage, ServoAlarm, ServoWord, Signal, SignalSource, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, BRAKE_TIME_MAX, Control, DelayMeter, DriveCommand, DriveMode, FaultReport, Frame, FrameBytes,
    FrameParser, GatewayMessage, GatewayState, Geometry, Hello, HelloReply, Holder, HostMessage, MessageError,
    ParserCounters, Received, Reject, RejectReason, StopCause, WiderLimit,
};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_geometry::MonotonicTime;

use crate::driver::{
    Activity, AxisLimits, BadReply, Driver, EmergencyStopCause, FaultCause, Reply, Sample, Transmit, Trip,
};
use pb3dp_arm_pa10_protocol::watchdog::{CommandWatchdog, WatchdogError};

/// Without an answer to HELLO within this time there is no gateway.
pub const HELLO_TIMEOUT: Duration = Duration::from_millis(500);

/// A partial frame is discarded after this silence.
pub const SILENCE: Duration = Duration::from_millis(20);

/// Period of the heartbeat of an idle host.
pub const HEARTBEAT_INTERVAL: Duration = Duration::from_millis(250);

/// Another host has the gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HeldError {
    /// It moves the arm, or could.
    #[error("the gateway is held by the host at {0}: end the program there; it gives way after a second of silence")]
    Held(Holder),
}

/// Why a gateway is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum HelloError {
    /// Its answer means nothing to this program.
    #[error("the answer of the gateway to HELLO cannot be read")]
    Unreadable(#[source] MessageError),
    /// It has detected another wire format.
    #[error(
        "the arm at the gateway answers in {got}, the configuration says {configured}; find out which generation the arm is"
    )]
    Format {
        /// Format of the gateway.
        got: WireFormat,
        /// Format of the configuration.
        configured: WireFormat,
    },
    /// Its arm has another geometry.
    #[error(
        "the gateway is set to a {got} arm, the configuration to {configured}; measure the arm and correct one of them"
    )]
    Geometry {
        /// Geometry of the gateway.
        got: Geometry,
        /// Geometry of the configuration.
        configured: Geometry,
    },
    /// It has no such input.
    #[error(
        "the setup says {key} = \"wired\", but the gateway reports no wired input for the {signal}; wire the input, or state the bits \
         of a status word, which `pb3dp arm signals` finds",
        key = .signal.key()
    )]
    NotWired {
        /// The signal.
        signal: Signal,
    },
    /// Its watchdog is disabled.
    #[error("the gateway reports {0}; correct its configuration")]
    Watchdog(WatchdogError),
    /// Its brake time is implausible.
    #[error("the gateway reports a brake time of {got:?}, at most {most:?} is allowed; correct its configuration")]
    BrakeTime {
        /// Brake time of the gateway.
        got: Duration,
        /// [`BRAKE_TIME_MAX`].
        most: Duration,
    },
    /// It allows more than the setup.
    #[error(
        "the gateway allows {axis} {got} as its {quantity}, the setup at most {most}: correct {key} of this axis under [limits] in the \
         gateway's file, or the limits of the arm in the setup",
        axis = .0.axis, quantity = .0.quantity, key = .0.quantity.key(),
        got = .0.quantity.text(.0.wider), most = .0.quantity.text(.0.limit)
    )]
    AllowsMore(WiderLimit),
    /// It allows less than this host asks for.
    #[error(
        "the gateway refused the host: the setup asks for {got} as {quantity} of {axis}, the gateway allows {most}: correct the limits \
         of the arm in the setup, or {key} of this axis under [limits] in the gateway's file",
        axis = .0.axis, quantity = .0.quantity, key = .0.quantity.key(),
        got = .0.quantity.text(.0.wider), most = .0.quantity.text(.0.limit)
    )]
    AsksMore(WiderLimit),
    /// Another host has it.
    #[error(transparent)]
    Held(HeldError),
    /// It refused the host.
    #[error("the gateway refused the host: {0}; compare the configurations and versions of both sides")]
    Rejected(RejectReason),
}

/// Why a message cannot be sent.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LinkError {
    /// No gateway has answered.
    #[error("the gateway has not answered HELLO; open the link first")]
    NotOpen,
    /// The message cannot be encoded.
    #[error("the message cannot be encoded")]
    Codec(#[from] CodecError),
    /// A command has one mode for all axes.
    #[error("a command to the gateway has one mode for all axes")]
    MixedModes,
}

/// Expected answer.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Waiting {
    Nothing,
    Hello,
    /// State of a gateway that has stopped its arm, after this answer to HELLO.
    Shown(HelloReply),
    /// An operation of the gateway before this message: RESET before the S that starts a control mode after a fault, ABORT before
    /// the stop that follows a fault.
    Before(ArmOperation, ControlMessage),
    Message(ControlMessage),
}

/// Encodes messages into frames of the gateway protocol, and decodes answers from a stream of bytes.
#[derive(Clone, Debug)]
pub struct GatewayLink {
    config: GatewayLinkConfig,
    parser: FrameParser,
    delay: DelayMeter,
    sequence: u16,
    /// Sequence number of the outstanding frame.
    asked: u16,
    waiting: Waiting,
    /// The gateway has received the fault for which the driver stops the arm.
    aborted: bool,
    hello: Option<HelloReply>,
    hello_error: Option<HelloError>,
    shown: Option<Sample>,
    output: Option<FrameBytes>,
    heartbeat: Option<u16>,
    last_sent: MonotonicTime,
    last_received: MonotonicTime,
    /// Damaged frames that the driver has counted.
    damage_reported: u64,
}

impl GatewayLink {
    /// A link that is not open.
    pub fn new(config: GatewayLinkConfig) -> Self {
        Self {
            config,
            parser: FrameParser::new(config.arm),
            delay: DelayMeter::default(),
            sequence: 0,
            asked: 0,
            waiting: Waiting::Nothing,
            aborted: false,
            hello: None,
            hello_error: None,
            shown: None,
            output: None,
            heartbeat: None,
            last_sent: MonotonicTime::ZERO,
            last_received: MonotonicTime::ZERO,
            damage_reported: 0,
        }
    }

    /// Sends HELLO; also after the link was closed or broken. Without an answer within [`HELLO_TIMEOUT`] there is no gateway.
    pub fn open(&mut self, now: MonotonicTime) {
        self.hello = None;
        self.hello_error = None;
        self.shown = None;
        self.heartbeat = None;
        self.aborted = false;
        self.parser.restart();
        // The gateway may have been restarted, and its clock with it.
        self.delay = DelayMeter::default();
        let cycle_us = u32::try_from(self.config.cycle.as_micros()).unwrap_or(u32::MAX);
        let hello = HostMessage::Hello(Hello { cycle_us, limits: self.config.limits.asked });
        self.waiting = Waiting::Hello;
        self.asked = self.emit(now, &hello);
    }

    /// Why the gateway that answered was refused.
    pub fn hello_error(&self) -> Option<&HelloError> {
        self.hello_error.as_ref()
    }

    /// Identification and abilities of the gateway, after its answer.
    pub fn hello(&self) -> Option<&HelloReply> {
        self.hello.as_ref()
    }

    /// Last measurement of an arm that its gateway had stopped before the greeting, if there is one.
    pub fn shown(&self) -> Option<&Sample> {
        self.shown.as_ref()
    }

    /// Statistics of the stream.
    pub fn counters(&self) -> &ParserCounters {
        self.parser.counters()
    }

    /// Sends a message of a driver with this activity.
    ///
    /// # Errors
    /// If the link is not open, or the message cannot be encoded: nothing is sent.
    pub fn send(&mut self, now: MonotonicTime, transmit: &Transmit, activity: Activity) -> Result<(), LinkError> {
        if self.hello.is_none() {
            return Err(LinkError::NotOpen);
        }
        let Transmit { message, latches, .. } = *transmit;
        self.aborted &= latches;
        let before = if latches && !self.aborted {
            // The gateway has its own latch, which must outlive this program.
            ArmOperation::Abort
        } else if activity == Activity::Clearing && message == ControlMessage::Start {
            // The gateway checks the arm by itself before it releases it.
            ArmOperation::Reset
        } else {
            return self.say(now, message);
        };
        self.waiting = Waiting::Before(before, message);
        self.asked = self.emit(now, &HostMessage::Control(Control::Arm(before)));
        Ok(())
    }

    /// The bytes to write now: call again until there are none.
    pub fn poll_output(&mut self, now: MonotonicTime) -> Option<FrameBytes> {
        if let Some(bytes) = self.output.take() {
            return Some(bytes);
        }
        let idle = now.saturating_since(self.last_sent) >= HEARTBEAT_INTERVAL;
        if self.hello.is_some() && idle {
            self.heartbeat = Some(self.emit(now, &HostMessage::Heartbeat));
        }
        self.output.take()
    }

    /// Processes bytes from the line, in pieces of any size.
    pub fn handle_bytes(&mut self, now: MonotonicTime, bytes: &[u8], driver: &mut Driver) {
        if !bytes.is_empty() {
            self.last_received = now;
        }
        // The parser is moved out, so that its frames can change the rest of the link.
        let mut parser = self.parser.clone();
        parser.feed(bytes, |received| self.handle_received(now, &received, driver));
        self.parser = parser;
        self.tell_damage(driver);
    }

    /// Handles time: a frame without its rest is discarded.
    pub fn handle_timeout(&mut self, now: MonotonicTime, driver: &mut Driver) {
        if !self.parser.is_within_frame() || now.saturating_since(self.last_received) < SILENCE {
            return;
        }
        let mut parser = self.parser.clone();
        parser.handle_silence(|received| self.handle_received(now, &received, driver));
        self.parser = parser;
        self.tell_damage(driver);
    }

    /// Time of the next required call: for a heartbeat, or because the line fell silent within a frame.
    pub fn next_deadline(&self) -> Option<MonotonicTime> {
        let heartbeat = self.hello.is_some().then(|| self.last_sent + HEARTBEAT_INTERVAL);
        let silence = self.parser.is_within_frame().then(|| self.last_received + SILENCE);
        [heartbeat, silence].into_iter().flatten().min()
    }

    fn say(&mut self, now: MonotonicTime, message: ControlMessage) -> Result<(), LinkError> {
        let encoded = encoded(&message)?;
        self.waiting = Waiting::Message(message);
        self.asked = self.emit(now, &encoded);
        Ok(())
    }

    fn emit(&mut self, now: MonotonicTime, message: &HostMessage) -> u16 {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        self.output = Some(message.frame(self.config.arm, sequence, now.as_nanos() / 1000).encode());
        self.last_sent = now;
        sequence
    }

    fn tell_damage(&mut self, driver: &mut Driver) {
        let counters = self.parser.counters();
        let damaged = counters.crc_errors + counters.header_errors + counters.truncated + counters.other_version;
        for _ in self.damage_reported..damaged {
            driver.handle_bad_reply(BadReply::Damaged);
        }
        self.damage_reported = damaged;
    }

    fn handle_received(&mut self, now: MonotonicTime, received: &Received, driver: &mut Driver) {
        let frame = match received {
            Received::Frame(frame) => frame,
            Received::OtherArm(frame) => {
                driver.handle_wrong_arm(now, frame.arm.0);
                return;
            }
        };
        let late = self.delay.handle(frame.timestamp_us, now.as_nanos() / 1000);
        match GatewayMessage::decode(frame) {
            Err(error) if self.waiting == Waiting::Hello && frame.sequence == self.asked => {
                self.hello_error = Some(HelloError::Unreadable(error));
            }
            Err(_) => driver.handle_bad_reply(BadReply::Damaged),
            Ok(GatewayMessage::Fault(report)) => driver.handle_trip(now, trip(&report, &self.config)),
            Ok(GatewayMessage::Health(_)) if self.heartbeat.take_if(|asked| *asked == frame.sequence).is_some() => {}
            Ok(answer) => self.handle_answer(now, frame, &answer, late, driver),
        }
    }

    fn handle_answer(
        &mut self,
        now: MonotonicTime,
        frame: &Frame,
        answer: &GatewayMessage,
        late: Duration,
        driver: &mut Driver,
    ) {
        if frame.sequence != self.asked || self.waiting == Waiting::Nothing {
            driver.handle_bad_reply(BadReply::Late);
            return;
        }
        match (std::mem::replace(&mut self.waiting, Waiting::Nothing), answer) {
            (Waiting::Hello, GatewayMessage::HelloReply(reply)) => match self.judge(reply) {
                Ok(watchdog) => {
                    driver.note_watchdog(watchdog.stop_after());
                    self.greeted(now, reply);
                }
                Err(error) => self.hello_error = Some(error),
            },
            (Waiting::Hello, GatewayMessage::Held(holder)) => {
                self.hello_error = Some(HelloError::Held(HeldError::Held(*holder)));
            }
            (Waiting::Hello, GatewayMessage::Reject(Reject { reason, detail, .. })) => {
                let limit = WiderLimit::from_detail(*detail, &self.config.limits.asked)
                    .filter(|_| *reason == RejectReason::LimitsTooWide);
                self.hello_error = Some(limit.map_or(HelloError::Rejected(*reason), HelloError::AsksMore));
            }
            (Waiting::Shown(hello), answer) => {
                if let GatewayMessage::State(state) = answer {
                    let sample = Sample::from_state(state);
                    self.shown = Some(Sample { age: sample.age + late, ..sample });
                }
                // A gateway without a measurement refuses.
                self.hello = Some(hello);
            }
            (Waiting::Before(operation, message), GatewayMessage::ControlReply(reply))
                if reply.control == Control::Arm(operation) =>
            {
                self.aborted |= operation == ArmOperation::Abort;
                self.go_on(now, message, driver);
            }
            // A gateway without this operation: the order itself has to suffice.
            (Waiting::Before(ArmOperation::Abort, message), GatewayMessage::Reject(reject)) if is_final(reject) => {
                self.aborted = true;
                self.go_on(now, message, driver);
            }
            (Waiting::Before(..) | Waiting::Message(_), GatewayMessage::Reject(Reject { reason, detail, .. })) => {
                if *reason == RejectReason::NotConnected {
                    // It was restarted: greet it again.
                    self.hello = None;
                }
                driver.handle_reply(now, &refusal(*reason, *detail));
            }
            (Waiting::Message(message), answer) => match self.reply(&message, answer, late) {
                Ok(reply) => driver.handle_reply(now, &reply),
                Err(bad) => driver.handle_bad_reply(bad),
            },
            _ => driver.handle_bad_reply(BadReply::Mismatched),
        }
    }

    /// Sends the message that had to wait for an operation of the gateway.
    fn go_on(&mut self, now: MonotonicTime, message: ControlMessage, driver: &mut Driver) {
        if self.say(now, message).is_err() {
            driver.handle_bad_reply(BadReply::Mismatched);
        }
    }

    /// A gateway that has stopped its arm answers a command with its last measurement, and does not execute the command.
    fn greeted(&mut self, now: MonotonicTime, hello: &HelloReply) {
        let is_stopped = matches!(hello.state, GatewayState::Fault | GatewayState::EmergencyStop);
        if is_stopped {
            self.waiting = Waiting::Shown(*hello);
            self.asked = self.emit(now, &HostMessage::Command(DriveCommand::at_rest(DriveMode::Off)));
        } else {
            self.hello = Some(*hello);
        }
    }

    /// Whether this is the configured gateway.
    fn judge(&self, hello: &HelloReply) -> Result<CommandWatchdog, HelloError> {
        let GatewayLinkConfig { format, geometry, .. } = self.config;
        if let Some(got) = hello.wire_format.filter(|got| *got != format) {
            return Err(HelloError::Format { got, configured: format });
        }
        if let Some(signal) = self.config.signals.from(SignalSource::Wired).find(|signal| !hello.wired.has(*signal)) {
            return Err(HelloError::NotWired { signal });
        }
        let is_stated = |geometry| geometry != Geometry::Unknown;
        if is_stated(hello.geometry) && is_stated(geometry) && hello.geometry != geometry {
            return Err(HelloError::Geometry { got: hello.geometry, configured: geometry });
        }
        if let Some(wider) = hello.limits.wider_than(&self.config.limits.allowed) {
            return Err(HelloError::AllowsMore(wider));
        }
        let duration = |us: u32| Duration::from_micros(u64::from(us));
        let (got, most) = (duration(hello.brake_release_us), BRAKE_TIME_MAX);
        if got > most {
            return Err(HelloError::BrakeTime { got, most });
        }
        CommandWatchdog::new(duration(hello.ramp_after_us), duration(hello.stop_after_us)).map_err(HelloError::Watchdog)
    }

    fn reply(&self, asked: &ControlMessage, answer: &GatewayMessage, late: Duration) -> Result<Reply, BadReply> {
        let is_cyclic = matches!(asked, ControlMessage::Cyclic(_));
        match answer {
            GatewayMessage::State(state) if is_cyclic => {
                let sample = Sample::from_state(state);
                Ok(Reply::Sample(Sample { age: sample.age + late, ..sample }))
            }
            GatewayMessage::ControlReply(reply) if control_of(asked) == Some(reply.control) => Ok(Reply::Done),
            GatewayMessage::EepromLimits(limits) if *asked == ControlMessage::ReadEeprom(limits.axis) => {
                let rad = |angle_urad: i32| f64::from(angle_urad) * 1e-6;
                let (lower_rad, upper_rad) = (rad(limits.negative_limit_urad), rad(limits.positive_limit_urad));
                Ok(Reply::Limits(AxisLimits { axis: limits.axis, lower_rad, upper_rad }))
            }
            _ => Err(BadReply::Mismatched),
        }
    }
}

/// The refusal for a driver, with the cause reported by the gateway if there is one.
fn refusal(reason: RejectReason, detail: u32) -> Reply {
    let found = u8::try_from(detail).ok().and_then(StopCause::from_code);
    match (reason, found) {
        (RejectReason::CausePresent, Some(found)) if found != StopCause::None => Reply::CauseNotCleared(found),
        _ => Reply::Rejected(reason),
    }
}

/// Whether a repeated request would be refused again.
fn is_final(reject: &Reject) -> bool {
    use RejectReason::{NoAnswer, NotConnected, Stale};
    !matches!(reject.reason, NotConnected | Stale | NoAnswer)
}

/// The control message of a message that is not cyclic.
fn control_of(message: &ControlMessage) -> Option<Control> {
    Some(match message {
        ControlMessage::Start => Control::Arm(ArmOperation::Start),
        ControlMessage::End => Control::Arm(ArmOperation::End),
        ControlMessage::ClearAlarm(axis) => Control::ClearAlarm(*axis),
        ControlMessage::ReadEeprom(axis) => Control::ReadEeprom(*axis),
        ControlMessage::Cyclic(_) => return None,
        #[cfg(feature = "brake-release")]
        ControlMessage::ReleaseBrakes => return None,
    })
}

/// A message of the driver as a message of the gateway.
fn encoded(message: &ControlMessage) -> Result<HostMessage, LinkError> {
    if let Some(control) = control_of(message) {
        return Ok(HostMessage::Control(control));
    }
    let ControlMessage::Cyclic(command) = message else {
        return Err(CodecError::Letter { got: message.letter().byte() }.into());
    };
    let mode = match command.axes[0] {
        AxisCommand::Off => DriveMode::Off,
        AxisCommand::Braked => DriveMode::Braked,
        AxisCommand::Speed(_) => DriveMode::Follow,
    };
    let same = |axis: &AxisCommand| std::mem::discriminant(axis) == std::mem::discriminant(&command.axes[0]);
    if !command.axes.iter().all(same) {
        return Err(LinkError::MixedModes);
    }
    Ok(HostMessage::Command(match mode {
        DriveMode::Follow => DriveCommand::follow(&command.velocity_rad_per_s())?,
        DriveMode::Off | DriveMode::Braked => DriveCommand::at_rest(mode),
    }))
}

/// Why the gateway stopped the arm, as precisely as its report states.
fn trip(report: &FaultReport, config: &GatewayLinkConfig) -> Trip {
    // The alarms of format A are unknown.
    let has_alarms = config.format == WireFormat::BigEndian6x10;
    let word = if has_alarms { report.word } else { 0 };
    let servo = |axis: Axis| ServoWord(word).alarm().map(|alarm: ServoAlarm| (axis, alarm));
    let controller = || pb3dp_arm_pa10_protocol::codec::CommWord(word).alarm();
    match report.cause {
        StopCause::EmergencyStop => {
            let alarm = match report.axis {
                Some(axis) => servo(axis).map(|(axis, alarm)| EmergencyStopCause::Axis { axis, alarm }),
                None => controller().map(|alarm: CommAlarm| EmergencyStopCause::Controller { alarm }),
            };
            let FaultReport { axis, word, .. } = *report;
            let shown = || config.signals.shown_by(axis.is_some(), word).next();
            // 0: the cause belongs to no word.
            let switch =
                || shown().filter(|_| word != 0).map(|signal| EmergencyStopCause::Switch { signal, axis, word });
            Trip::EStop(alarm.or_else(switch).unwrap_or(EmergencyStopCause::Gateway))
        }
        StopCause::ServoAlarm => {
            let named = report.axis.and_then(servo).map(|(axis, alarm)| FaultCause::ServoAlarm { axis, alarm });
            Trip::Fault(named.unwrap_or(FaultCause::Gateway(report.cause)))
        }
        StopCause::ControllerAlarm => {
            let named = controller().map(|alarm| FaultCause::ControllerAlarm { alarm });
            Trip::Fault(named.unwrap_or(FaultCause::Gateway(report.cause)))
        }
        cause => {
            let limit = report.limit().map(|(axis, quantity)| FaultCause::GatewayLimit { axis, quantity });
            Trip::Fault(limit.unwrap_or(FaultCause::Gateway(cause)))
        }
    }
}
