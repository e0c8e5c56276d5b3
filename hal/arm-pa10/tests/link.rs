//! The driver over its links: to a gateway in both dialects, and to the servo controller itself.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

#[path = "common/gateway.rs"]
mod gateway;

use std::time::Duration;

use gateway::FakeGateway;
use pb3dp_arm_pa10::arcnet::{self, Route};
use pb3dp_arm_pa10::codec::{
    AngleCounts, ArmReply, AxisReply, AxisStatus, CodecError, CommStatus, ControlMessage, ControlPacket, Packet,
    ReplyMessage, ReplyPacket, SequenceModulus, ServoAlarm, ServoWord, TorqueCounts, WireFormat,
};
use pb3dp_arm_pa10::driver::{
    Activity, Driver, DriverConfig, DriverState, EmergencyStopCause, FaultCause, LimitsCheck, Request, Trip,
    WarmUpFailure,
};
use pb3dp_arm_pa10::gateway_protocol::{
    ArmId, ArmOperation, Control, Dialect, FaultReport, GatewayMessage, GatewayState, Geometry, HostMessage,
    RejectReason, StopCause,
};
use pb3dp_arm_pa10::link::{BusFrameError, BusLink, GatewayLink, GatewayLinkConfig, HelloError, LinkError};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

const CYCLE: Duration = Duration::from_millis(10);
const ARM: ArmId = ArmId(2);

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn velocity() -> JointVector {
    JointVector::from([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7])
}

fn link_config(dialect: Dialect, format: WireFormat) -> GatewayLinkConfig {
    GatewayLinkConfig { arm: ARM, dialect, format, geometry: Geometry::SecondGeneration, cycle: CYCLE }
}

/// All axes of the arms here have limits of 3 rad.
fn driver_config() -> DriverConfig {
    let limit = JointVector::repeat(3.0);
    let limits = LimitsCheck::Compare { lower_rad: -limit, upper_rad: limit, tolerance_rad: 1e-4 };
    DriverConfig { limits, ..DriverConfig::with_cycle(CYCLE) }
}

/// Driver, link and gateway in virtual time; bytes take a millisecond each way.
struct Rig {
    driver: Driver,
    link: GatewayLink,
    gateway: FakeGateway,
    now: MonotonicTime,
    /// Put before the next bytes from the gateway.
    noise: Vec<u8>,
    under_way: Vec<(MonotonicTime, Vec<u8>)>,
}

impl Rig {
    fn new(dialect: Dialect, format: WireFormat) -> Self {
        let config = link_config(dialect, format);
        let mut rig = Self {
            driver: Driver::new(driver_config()).unwrap(),
            link: GatewayLink::new(config),
            gateway: FakeGateway::new(ARM, format),
            now: MonotonicTime::from_nanos(5_000_000_000),
            noise: Vec::new(),
            under_way: Vec::new(),
        };
        rig.open();
        rig
    }

    fn open(&mut self) {
        self.link.open(self.now);
        self.run(ms(10));
        assert!(self.link.hello().is_some());
    }

    fn run(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.tick();
        }
    }

    fn tick(&mut self) {
        let now = self.now;
        let arrived = self.under_way.extract_if(.., |(at, _)| *at <= now).collect::<Vec<_>>();
        for (_, bytes) in arrived {
            self.link.handle_bytes(now, &bytes, &mut self.driver);
        }
        self.link.handle_timeout(now, &mut self.driver);
        if let Some(transmit) = self.driver.poll_transmit(now) {
            match self.link.send(now, &transmit, self.driver.activity()) {
                Ok(()) | Err(LinkError::NotOpen) => {}
                Err(error) => panic!("{error}"),
            }
        }
        self.gateway.clock_us = now.as_nanos() / 1000 - 4_000_000;
        while let Some(bytes) = self.link.poll_output(now) {
            let mut answer = std::mem::take(&mut self.noise);
            answer.extend(self.gateway.answer(&bytes));
            self.under_way.push((now + ms(2), answer));
        }
        self.now = now + Duration::from_micros(500);
    }

    fn request(&mut self, request: Request) {
        self.driver.handle_request(self.now, request).unwrap();
    }

    fn settle(&mut self) {
        for _ in 0..40_000 {
            if self.driver.activity() == Activity::None {
                return;
            }
            self.tick();
        }
        panic!("{:?}", self.driver);
    }

    fn lead_to_moving(&mut self) {
        for request in [Request::Connect, Request::Enable, Request::ReleaseBrakes] {
            self.request(request);
            self.settle();
        }
        for _ in 0..10 {
            self.request(Request::Move(velocity()));
            self.run(CYCLE);
        }
        assert_eq!(self.driver.state(), DriverState::Moving);
    }

    fn trip(&self) -> Trip {
        self.driver.latched().unwrap().trip
    }
}

fn rigs() -> [Rig; 3] {
    [
        Rig::new(Dialect::GatewayV1, WireFormat::BigEndian6x10),
        Rig::new(Dialect::Transparent, WireFormat::BigEndian6x10),
        Rig::new(Dialect::Transparent, WireFormat::LittleEndian5x8),
    ]
}

#[test]
fn an_arm_goes_up_and_down_over_a_gateway_in_every_dialect() {
    for mut rig in rigs() {
        rig.lead_to_moving();
        assert_eq!(rig.gateway.state, GatewayState::Moving);
        assert!((rig.gateway.speeds - velocity()).amax() < 1e-9, "{}", rig.gateway.speeds);
        let joints = rig.driver.joints().unwrap();
        assert!((joints.position_rad[6] - AngleCounts(7000).to_rad()).abs() < 1e-6);
        assert!(rig.now.saturating_since(joints.at) <= ms(12), "{:?}", rig.now.saturating_since(joints.at));
        rig.request(Request::Stop);
        rig.settle();
        assert_eq!((rig.driver.state(), rig.gateway.state), (DriverState::Connected, GatewayState::Idle));
        assert!(rig.gateway.rejected.is_empty(), "{:?}", rig.gateway.rejected);
        let counters = rig.driver.counters();
        assert_eq!((counters.lost, counters.damaged, counters.mismatched, counters.late), (0, 0, 0, 0));
    }
}

#[test]
fn a_link_that_nobody_answered_sends_nothing() {
    let mut link = GatewayLink::new(link_config(Dialect::GatewayV1, WireFormat::BigEndian6x10));
    let mut driver = Driver::new(DriverConfig::with_cycle(CYCLE)).unwrap();
    let now = MonotonicTime::from_nanos(1_000_000_000);
    driver.handle_request(now, Request::Connect).unwrap();
    let transmit = driver.poll_transmit(now).unwrap();
    assert_eq!(link.send(now, &transmit, driver.activity()), Err(LinkError::NotOpen));
    assert_eq!(link.poll_output(now), None);
}

#[test]
fn a_gateway_of_another_arm_or_format_is_refused_by_name() {
    let greet = |config| {
        let mut link = GatewayLink::new(config);
        let mut driver = Driver::new(driver_config()).unwrap();
        let mut gateway = FakeGateway::new(ARM, WireFormat::BigEndian6x10);
        let now = MonotonicTime::from_nanos(1_000_000_000);
        link.open(now);
        let answer = gateway.answer(&link.poll_output(now).unwrap());
        link.handle_bytes(now, &answer, &mut driver);
        assert_eq!(link.hello(), None);
        assert_eq!(link.poll_output(now), None);
        *link.hello_error().unwrap()
    };
    let good = link_config(Dialect::GatewayV1, WireFormat::BigEndian6x10);
    let (a, b) = (WireFormat::LittleEndian5x8, WireFormat::BigEndian6x10);
    assert_eq!(greet(GatewayLinkConfig { format: a, ..good }), HelloError::Format { got: b, configured: a });
    let geometry = Geometry::FirstGeneration;
    let expected = HelloError::Geometry { got: Geometry::SecondGeneration, configured: geometry };
    assert_eq!(greet(GatewayLinkConfig { geometry, ..good }), expected);
    assert!(expected.to_string().contains("told a second-generation arm"), "{expected}");
}

#[test]
fn an_idle_link_shows_that_the_host_is_there() {
    let mut rig = Rig::new(Dialect::GatewayV1, WireFormat::BigEndian6x10);
    rig.request(Request::Connect);
    rig.settle();
    rig.gateway.heard.clear();
    rig.run(ms(1100));
    assert_eq!(rig.gateway.heard, [HostMessage::Heartbeat; 4]);
    assert_eq!(rig.driver.counters().mismatched + rig.driver.counters().late, 0);
}

/// After kill -9 of the host the gateway is latched: a new host must not move before an operator resets.
#[test]
fn a_gateway_that_stopped_the_arm_before_wants_a_reset() {
    for mut rig in rigs() {
        rig.gateway.latch(StopCause::HostSilent);
        rig.request(Request::Connect);
        rig.settle();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Rejected(RejectReason::WrongState)));
        rig.gateway.cause_present = true;
        rig.request(Request::Reset);
        rig.settle();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Rejected(RejectReason::CausePresent)));
        rig.gateway.cause_present = false;
        rig.gateway.heard.clear();
        rig.request(Request::Reset);
        rig.settle();
        assert_eq!((rig.driver.state(), rig.gateway.state), (DriverState::Connected, GatewayState::Idle));
        let reset = HostMessage::Control(Control::Arm(ArmOperation::Reset));
        assert_eq!(rig.gateway.heard.iter().filter(|message| **message == reset).count(), 1);
    }
}

#[test]
fn a_gateway_that_latches_during_motion_stops_the_driver_with_its_cause() {
    let mut rig = Rig::new(Dialect::GatewayV1, WireFormat::BigEndian6x10);
    rig.lead_to_moving();
    rig.gateway.latch(StopCause::CycleMissed);
    rig.run(ms(30));
    assert_eq!(rig.trip(), Trip::Fault(FaultCause::Gateway(StopCause::CycleMissed)));
    rig.settle();
}

#[test]
fn a_restarted_gateway_is_greeted_anew_before_a_reset_can_succeed() {
    let mut rig = Rig::new(Dialect::GatewayV1, WireFormat::BigEndian6x10);
    rig.lead_to_moving();
    rig.gateway.restart();
    rig.run(ms(30));
    assert_eq!(rig.trip(), Trip::Fault(FaultCause::Rejected(RejectReason::NotConnected)));
    rig.settle();
    assert_eq!(rig.link.hello(), None);
    rig.open();
    rig.request(Request::Reset);
    rig.settle();
    assert_eq!(rig.driver.state(), DriverState::Connected);
}

#[test]
fn a_fault_report_names_axis_and_alarm() {
    let over_current = ServoWord(0).with_alarm(ServoAlarm::OverCurrent).0;
    let axis = pb3dp_arm_pa10::codec::Axis::ALL[3];
    let report = |cause, axis, word| FaultReport { cause, state_before: GatewayState::Moving, axis, word };
    for (report, expected) in [
        (
            report(StopCause::ServoAlarm, Some(axis), over_current),
            Trip::Fault(FaultCause::ServoAlarm { axis, alarm: ServoAlarm::OverCurrent }),
        ),
        (
            report(StopCause::EmergencyStop, Some(axis), 0x0120),
            Trip::EStop(EmergencyStopCause::Axis { axis, alarm: ServoAlarm::DeadManOff }),
        ),
        (report(StopCause::EmergencyStop, None, 0), Trip::EStop(EmergencyStopCause::Gateway)),
        (report(StopCause::Internal, None, 0), Trip::Fault(FaultCause::Gateway(StopCause::Internal))),
    ] {
        let mut rig = Rig::new(Dialect::GatewayV1, WireFormat::BigEndian6x10);
        rig.lead_to_moving();
        let bytes = rig.gateway.frame(&GatewayMessage::Fault(report), 0).encode();
        rig.link.handle_bytes(rig.now, &bytes, &mut rig.driver);
        assert_eq!(rig.trip(), expected);
    }
}

#[test]
fn a_frame_of_the_other_arm_stops_this_one() {
    let mut rig = Rig::new(Dialect::GatewayV1, WireFormat::BigEndian6x10);
    rig.lead_to_moving();
    let other = FakeGateway::new(ArmId(1), WireFormat::BigEndian6x10);
    let report = FaultReport { cause: StopCause::None, state_before: GatewayState::Idle, axis: None, word: 0 };
    let bytes = other.frame(&GatewayMessage::Fault(report), 0).encode();
    rig.link.handle_bytes(rig.now, &bytes, &mut rig.driver);
    assert_eq!(rig.trip(), Trip::Fault(FaultCause::WrongArm { got: 1 }));
}

#[test]
fn noise_on_the_line_is_survived_and_counted_and_keeps_the_brakes_on() {
    let damaged = {
        let gateway = FakeGateway::new(ARM, WireFormat::BigEndian6x10);
        let report = FaultReport { cause: StopCause::None, state_before: GatewayState::Idle, axis: None, word: 0 };
        let mut bytes = gateway.frame(&GatewayMessage::Fault(report), 9).encode().as_slice().to_vec();
        bytes[18] ^= 0xFF;
        bytes
    };
    let mut rig = Rig::new(Dialect::GatewayV1, WireFormat::BigEndian6x10);
    rig.lead_to_moving();
    rig.noise = damaged.clone();
    rig.request(Request::Hold);
    rig.run(ms(100));
    assert_eq!((rig.driver.state(), rig.driver.counters().damaged), (DriverState::Holding, 1));
    assert_eq!(rig.driver.counters().lost, 0);

    let mut rig = Rig::new(Dialect::GatewayV1, WireFormat::BigEndian6x10);
    rig.request(Request::Connect);
    rig.settle();
    rig.request(Request::Enable);
    rig.run(ms(300));
    rig.noise = damaged;
    rig.settle();
    assert!(matches!(rig.driver.warm_up_failure(), Some(WarmUpFailure::Damaged { bad: 1, .. })));
}

/// The servo controller on the bus, as far as a driver sees it.
fn controller_reply(format: WireFormat, asked: &ControlPacket) -> Packet {
    let axis = AxisReply {
        status: AxisStatus::Undocumented(0),
        angle: AngleCounts(-204_800),
        speed: None,
        torque: TorqueCounts(0),
    };
    let message = match asked.message {
        ControlMessage::Cyclic(_) => {
            ReplyMessage::Cyclic(ArmReply { axes: [axis; 7], comm: CommStatus::Undocumented(0) })
        }
        other => ReplyMessage::Done(other.letter()),
    };
    ReplyPacket { sequence: asked.sequence, message }.encode(format).unwrap()
}

#[test]
fn an_arm_goes_up_and_down_on_the_bus_itself() {
    let format = WireFormat::LittleEndian5x8;
    let mut driver = Driver::new(DriverConfig::with_cycle(ms(2))).unwrap();
    let mut link = BusLink::new(format, SequenceModulus::Modulo128);
    let mut now = MonotonicTime::from_nanos(1_000_000_000);
    let mut settle = |driver: &mut Driver, requests: &[Request]| {
        for request in requests {
            driver.handle_request(now, *request).unwrap();
            for _ in 0..1000 {
                now = now + ms(2);
                let Some(transmit) = driver.poll_transmit(now) else { continue };
                let frame = link.send(&transmit).unwrap();
                let bytes = arcnet::decode(Route::TO_CONTROLLER, &frame).unwrap();
                let asked = ControlPacket::decode(format, bytes).unwrap();
                let reply = arcnet::encode(Route::TO_HOST, &controller_reply(format, &asked)).unwrap();
                let foreign =
                    arcnet::encode(Route { sender: 5, receiver: 6 }, &controller_reply(format, &asked)).unwrap();
                link.handle_frame(now, &foreign, driver).unwrap();
                link.handle_frame(now + Duration::from_micros(400), &reply, driver).unwrap();
            }
            assert_eq!(driver.activity(), Activity::None);
        }
    };
    settle(&mut driver, &[Request::Connect, Request::Enable, Request::ReleaseBrakes, Request::Hold]);
    assert_eq!(driver.state(), DriverState::Holding);
    assert!((driver.joints().unwrap().position_rad[3].to_degrees() + 90.0).abs() < 1e-9);
    settle(&mut driver, &[Request::Stop]);
    assert_eq!(driver.state(), DriverState::Connected);
    assert_eq!((driver.counters().lost, driver.counters().mismatched), (0, 0));
}

#[test]
fn a_stale_or_damaged_reply_on_the_bus_is_told_and_counted() {
    let format = WireFormat::LittleEndian5x8;
    let mut driver = Driver::new(DriverConfig::with_cycle(ms(2))).unwrap();
    let mut link = BusLink::new(format, SequenceModulus::Modulo256);
    let now = MonotonicTime::from_nanos(1_000_000_000);
    driver.handle_request(now, Request::Connect).unwrap();
    let transmit = driver.poll_transmit(now).unwrap();
    link.send(&transmit).unwrap();
    let asked = ControlPacket { sequence: 0, message: transmit.message };
    let stale = ControlPacket { sequence: 255, ..asked };
    let frame = arcnet::encode(Route::TO_HOST, &controller_reply(format, &stale)).unwrap();
    let error = link.handle_frame(now, &frame, &mut driver).unwrap_err();
    assert_eq!(error, BusFrameError::Packet(CodecError::Sequence { got: 255, expected: 0 }));
    let good = arcnet::encode(Route::TO_HOST, &controller_reply(format, &asked)).unwrap();
    link.handle_frame(now, &good[..5], &mut driver).unwrap_err();
    link.handle_frame(now, &good, &mut driver).unwrap();
    let counters = driver.counters();
    assert_eq!((counters.late, counters.damaged, counters.answered), (1, 1, 1));
}
