//! A real arm and its line: unplugged, plugged in again, swapped, damaged, stalled, and opened twice.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

use std::os::fd::BorrowedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::{ArmOpenError, Pa10Arm, RequestError};
use pb3dp_arm_pa10::driver::{DriverState, FaultCause, Trip};
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, Control, ControlReply, GatewayMessage, GatewayState, StopCause,
};
use pb3dp_arm_pa10_test_support::arm_rig::{CYCLE, FORMAT, Rig, config, rig, seat, serial, velocity};
use pb3dp_arm_pa10_test_support::far_end::FarEnd;
use pb3dp_arm_pa10_test_support::gateway::FakeGateway;
use pb3dp_hal_api::{Arm, ArmErrorKind, ArmPower, ArmState, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::tcp::{TcpConfig, TcpLink};
use pb3dp_hal_platform::transport::{ByteLink, ConnectError, Connector, Symptom, Unplugged};
use pb3dp_test_support::in_real_time_beside_others;
use rustix::io::Errno;

/// The limit is 20 ms; a loaded machine may delay the test itself, but not most of the times.
#[test]
fn unplugging_in_motion_is_noticed_within_20_ms_and_needs_a_reset() {
    in_real_time_beside_others(|| {
        let mut noticed: Vec<Duration> = (0..5).map(|_| unplugged_in_motion()).collect();
        println!("unplugged, noticed after {noticed:?}");
        noticed.sort();
        assert!(noticed[2] <= Duration::from_millis(20), "{noticed:?}");
    });
}

/// Time until the lost link was detected.
fn unplugged_in_motion() -> Duration {
    let mut rig = rig();
    rig.enable_and_move();
    let unplugged = rig.far.unplug();
    rig.wait_until_stopped();
    let noticed = unplugged.elapsed();
    assert_eq!(rig.trip(), Trip::Fault(FaultCause::Unplugged));
    for command in [velocity(), JointCommand::Hold] {
        assert_eq!(rig.arm.exchange(command).unwrap_err().kind(), ArmErrorKind::Disconnected);
    }
    for result in [rig.arm.enable(), rig.arm.stop(), rig.arm.reset()] {
        assert_eq!(result.unwrap_err().kind(), ArmErrorKind::Disconnected);
    }
    assert_eq!(rig.arm.state(), ArmState::Fault);
    noticed
}

#[test]
fn a_line_that_is_plugged_in_again_works_after_a_reset() {
    in_real_time_beside_others(|| {
        // A listener survives a lost connection, a pseudo-terminal does not.
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let serve = move || {
            let link = TcpLink::from_stream(listener.accept().unwrap().0).unwrap();
            (FarEnd::serve(Box::new(link), FakeGateway::new(ArmId(2), FORMAT)), listener)
        };
        let first = std::thread::spawn(serve);
        let arm = Pa10Arm::open(config(2), Box::new(TcpConfig { address }), Arc::new(SystemClock::new()), seat());
        let (far, listener) = first.join().unwrap();
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far };
        rig.enable_and_move();
        rig.far.unplug();
        rig.wait_until_stopped();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Unplugged));
        let again = std::thread::spawn(move || {
            let link = TcpLink::from_stream(listener.accept().unwrap().0).unwrap();
            FarEnd::serve(Box::new(link), FakeGateway::new(ArmId(2), FORMAT))
        });
        assert_eq!(rig.arm.state(), ArmState::Fault, "nothing comes back by itself");
        rig.arm.reset().unwrap();
        rig.far = again.join().unwrap();
        assert_eq!(rig.arm.state(), ArmState::Disabled);
        rig.enable_and_move();
    });
}

/// A port with a transient error: the device does not disappear.
struct Flaky {
    port: SerialConfig,
    breaks: Arc<AtomicBool>,
}

struct FlakyLink {
    link: Box<dyn ByteLink>,
    breaks: Arc<AtomicBool>,
}

impl Connector for Flaky {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        Ok(Box::new(FlakyLink { link: self.port.connect()?, breaks: Arc::clone(&self.breaks) }))
    }

    fn target(&self) -> String {
        self.port.target()
    }
}

impl ByteLink for FlakyLink {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        if self.breaks.swap(false, Ordering::SeqCst) {
            return Err(Unplugged { symptom: Symptom::Os(Errno::IO) });
        }
        self.link.try_read(buffer)
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.link.try_write(bytes)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.link.fd()
    }
}

#[test]
fn a_port_that_failed_once_is_let_go_of_and_had_again_by_a_reset() {
    in_real_time_beside_others(|| {
        let pty = Pty::open().unwrap();
        let breaks = Arc::new(AtomicBool::new(false));
        let connector = Flaky { port: serial(&pty), breaks: Arc::clone(&breaks) };
        let far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(2), FORMAT));
        let arm = Pa10Arm::open(config(2), Box::new(connector), Arc::new(SystemClock::new()), seat());
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far };
        rig.enable_and_move();
        breaks.store(true, Ordering::SeqCst);
        rig.wait_until_stopped();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Unplugged));
        // The gateway has stopped the arm meanwhile.
        rig.far.gateway.lock().unwrap().latch(StopCause::HostSilent);
        rig.arm.reset().unwrap();
        rig.enable_and_move();
    });
}

/// A port that the kernel closes slowly, as it does for 30 s if bytes cannot be sent any more.
struct SlowToClose(Box<dyn ByteLink>);

const CLOSING: Duration = Duration::from_secs(3);

impl ByteLink for SlowToClose {
    fn name(&self) -> &str {
        self.0.name()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        self.0.try_read(buffer)
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.0.try_write(bytes)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.0.fd()
    }
}

impl Drop for SlowToClose {
    fn drop(&mut self) {
        std::thread::sleep(CLOSING);
    }
}

struct SlowPort(SerialConfig);

impl Connector for SlowPort {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        Ok(Box::new(SlowToClose(self.0.connect()?)))
    }

    fn target(&self) -> String {
        self.0.target()
    }
}

#[test]
fn a_port_that_takes_long_to_close_holds_up_neither_the_stop_nor_its_notice() {
    in_real_time_beside_others(|| {
        let pty = Pty::open().unwrap();
        let connector = SlowPort(serial(&pty));
        let far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(2), FORMAT));
        let arm = Pa10Arm::open(config(2), Box::new(connector), Arc::new(SystemClock::new()), seat());
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far };
        rig.enable_and_move();
        let unplugged = rig.far.unplug();
        rig.wait_until_stopped();
        assert!(unplugged.elapsed() < CLOSING / 2, "{:?}", unplugged.elapsed());
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Unplugged));
        let error = rig.arm.reset().unwrap_err();
        assert_eq!(error.kind(), ArmErrorKind::Disconnected);
        let text = std::error::Error::source(&error).and_then(|source| source.source()).unwrap().to_string();
        assert!(text.contains("still closing"), "{error}: {text}");
        assert!(unplugged.elapsed() < CLOSING, "the reset waits for no longer than it says");
    });
}

#[test]
fn the_gateway_of_another_arm_is_refused() {
    in_real_time_beside_others(|| {
        let pty = Pty::open().unwrap();
        let connector = serial(&pty);
        let _far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(3), FORMAT));
        let error = Pa10Arm::open(config(2), Box::new(connector), Arc::new(SystemClock::new()), seat()).err().unwrap();
        assert!(matches!(error, ArmOpenError::Connect { source: RequestError::NoGateway, .. }), "{error:?}");
        let source = std::error::Error::source(&error).unwrap().to_string();
        assert!(source.contains("the number of the arm"), "{source}");
    });
}

#[test]
fn a_sound_frame_of_another_arm_stops_this_one() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let stray = FakeGateway::new(ArmId(9), FORMAT);
        let report = GatewayMessage::ControlReply(ControlReply {
            control: Control::Arm(ArmOperation::Start),
            state: GatewayState::Started,
        });
        rig.far.line.noise.lock().unwrap().extend_from_slice(&stray.frame(&report, 0).encode());
        rig.wait_until_stopped();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::WrongArm { got: 9 }));
        let error = rig.arm.exchange(velocity()).unwrap_err();
        assert!(error.to_string().contains("a reply came from arm 9"), "{error}");
    });
}

#[test]
fn garbage_on_the_line_is_counted_and_costs_no_answer() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        let lost = rig.monitor().snapshot().counters.lost;
        for round in 0..20u8 {
            rig.far.line.noise.lock().unwrap().extend_from_slice(&[0xA5, 0x5A, round, 0xFF, 0xA5, 0x00, 0x5A]);
            rig.exchange(velocity(), 1);
        }
        let after = rig.monitor().snapshot();
        assert_eq!(after.state, DriverState::Moving, "{after:?}");
        assert!(after.line.resyncs >= 15 && after.line.skipped_bytes >= 100, "{after:?}");
        println!("lost by garbage: {}", after.counters.lost - lost);
        assert!(after.counters.lost - lost <= 5, "{after:?}");
    });
}

#[test]
fn a_lost_answer_is_borne_and_three_are_a_fault() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        rig.far.line.drop_answers.store(1, Ordering::SeqCst);
        std::thread::sleep(2 * CYCLE);
        rig.exchange(velocity(), 5);
        assert!(rig.monitor().snapshot().counters.lost >= 1);
        rig.far.line.drop_answers.store(u32::MAX, Ordering::SeqCst);
        let error = rig.exchange_until_stopped();
        assert!(matches!(rig.trip(), Trip::Fault(FaultCause::LinkLost { misses: 3 })), "{:?}", rig.trip());
        assert!(error.to_string().contains("3 exchanges in a row without a usable reply"), "{error}");
        assert!(
            error.may_still_move() && error.to_string().contains("if the arm moves, press its emergency stop: "),
            "{error}"
        );
    });
}

#[test]
fn a_peer_that_stalls_holds_nothing_up() {
    in_real_time_beside_others(|| {
        let mut rig = rig();
        rig.enable_and_move();
        rig.far.line.stalled.store(true, Ordering::SeqCst);
        let begin = Instant::now();
        rig.exchange_until_stopped();
        assert!(matches!(rig.trip(), Trip::Fault(FaultCause::LinkLost { misses: 3 })), "{:?}", rig.trip());
        // The stop order advances by time, and a reset fails in bounded time.
        let error = rig.arm.reset().unwrap_err();
        assert!(error.to_string().contains("no gateway answers"), "{error}");
        assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
        rig.far.line.stalled.store(false, Ordering::SeqCst);
        rig.far.gateway.lock().unwrap().latch(StopCause::HostSilent);
        rig.arm.reset().unwrap();
        assert_eq!(rig.arm.state(), ArmState::Disabled);
    });
}

#[test]
fn a_second_owner_is_refused() {
    in_real_time_beside_others(|| {
        let pty = Pty::open().unwrap();
        let again = serial(&pty);
        let connector = serial(&pty);
        let far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(2), FORMAT));
        let arm = Pa10Arm::open(config(2), Box::new(connector), Arc::new(SystemClock::new()), seat());
        let mut rig = Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far };
        let error = Pa10Arm::open(config(2), Box::new(again), Arc::new(SystemClock::new()), seat()).err().unwrap();
        let source = std::error::Error::source(&error).unwrap().to_string();
        assert!(source.contains("in use by another program or arm"), "{source}");
        rig.enable_and_move();
    });
}
