//! An arm whose bus ends in this computer: a socket in place of the ARCNET card, with an emulated servo controller.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::{ArmOpenError, BusArmConfig, Pa10Arm, REALTIME, trip_line};
use pb3dp_arm_pa10::bus::{BusPort, FRAME_ROOM, FrameListener};
use pb3dp_arm_pa10::driver::{DriverConfig, FaultCause, LimitsCheck, Trip};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockController, MockControllerConfig};
use pb3dp_arm_pa10_protocol::codec::{SequenceModulus, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::ArmId;
use pb3dp_arm_pa10_protocol::places::BusTarget;
use pb3dp_arm_pa10_test_support::cell_end;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, JointCommand, JointState};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::realtime::{Realtime, enter};
use pb3dp_hal_platform::transport::wait_for;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::JointPlant;
use pb3dp_test_support::in_real_time_beside_others;

const BUS_CYCLE: Duration = Duration::from_millis(2);
const EXCHANGE_CYCLE: Duration = Duration::from_millis(10);
const LONG: Duration = Duration::from_secs(5);

fn velocity() -> JointCommand {
    JointCommand::Velocity(JointVector::from([0.1, -0.2, 0.3, -0.15, 0.25, -0.1, 0.2]))
}

/// A controller at the end of a socket, in its own thread.
struct Far {
    controller: Arc<Mutex<MockController>>,
    closed: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    path: std::path::PathBuf,
    clock: FarClock,
}

/// The time of the controller.
#[derive(Clone, Copy)]
struct FarClock {
    start: MonotonicTime,
    begin: Instant,
}

impl FarClock {
    fn now(&self) -> MonotonicTime {
        self.start + self.begin.elapsed()
    }
}

impl Far {
    fn new(name: &str, format: WireFormat) -> Self {
        // Threads of tests may be late: with 6 ms the controller would sometimes stop the arm by itself.
        Self::with(name, format, Some(Duration::from_millis(400)))
    }

    fn with(name: &str, format: WireFormat, watchdog: Option<Duration>) -> Self {
        let path = std::env::temp_dir().join(format!("pb3dp-{name}-{}", std::process::id()));
        let start = MonotonicTime::from_nanos(1_000_000_000);
        let home = JointVector::from([0.2, -0.5, 0.3, 1.1, 0.4, 0.9, 0.1]);
        let plant = Arc::new(Mutex::new(JointPlant::new(cell_end::plant_config(), home, start).unwrap()));
        let config = MockControllerConfig { watchdog, ..MockControllerConfig::new(format) };
        let controller = Arc::new(Mutex::new(MockController::new(config, plant, 7, start).unwrap()));
        let closed = Arc::new(AtomicBool::new(false));
        let clock = FarClock { start, begin: Instant::now() };
        let mut far = Self { controller, closed, thread: None, path, clock };
        far.open();
        far
    }

    /// Opens the bus again, with the same arm.
    fn open(&mut self) {
        let listener = FrameListener::bind(&self.path).unwrap();
        self.closed.store(false, Ordering::SeqCst);
        let (controller, closed, clock) = (Arc::clone(&self.controller), Arc::clone(&self.closed), self.clock);
        self.thread = Some(std::thread::spawn(move || {
            enter(&Realtime { priority: Some(40), locks_memory: false, cpu: None });
            serve(&listener, &controller, &closed, clock);
        }));
    }

    /// True speed of the fastest joint, rad/s.
    fn speed(&self) -> f64 {
        let mut controller = self.controller.lock().unwrap();
        controller.advance(self.clock.now());
        controller.true_joints().1.amax()
    }

    fn mode(&self) -> ControlMode {
        self.controller.lock().unwrap().mode()
    }

    fn inject(&self, line: &str) {
        let mut controller = self.controller.lock().unwrap();
        let now = controller.plant().lock().unwrap().now();
        controller.command_line(now, line).unwrap();
    }

    fn is_at_rest(&self) -> bool {
        let position = || {
            let plant = self.controller.lock().unwrap().plant();
            let plant = plant.lock().unwrap();
            plant.position_at(plant.now()).unwrap()
        };
        let before = position();
        std::thread::sleep(Duration::from_millis(20));
        self.controller.lock().unwrap().is_braked() && (position() - before).amax() < 1e-6
    }

    fn close(&mut self) {
        self.closed.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

impl Drop for Far {
    fn drop(&mut self) {
        self.close();
    }
}

fn serve(listener: &FrameListener, controller: &Mutex<MockController>, closed: &AtomicBool, clock: FarClock) {
    let mut socket = None;
    let mut buffer = [0; FRAME_ROOM];
    while !closed.load(Ordering::SeqCst) {
        if socket.is_none() {
            socket = listener.try_accept().unwrap();
        }
        let now = clock.now();
        {
            let mut controller = controller.lock().unwrap();
            controller.advance(now);
            if let Some(port) = &mut socket {
                let gone = loop {
                    match port.try_receive(&mut buffer) {
                        Ok(Some(length)) => controller.handle_frame(now, &buffer[..length]),
                        Ok(None) => break false,
                        Err(_) => break true,
                    }
                };
                while let Some(frame) = controller.poll_frame(now) {
                    let _ = port.try_send(&frame);
                }
                if gone {
                    socket = None;
                }
            }
        }
        wait_for(socket.as_ref().map(|port| port.fd()), false, None, Duration::from_micros(300));
    }
}

fn config(far: &Far, format: WireFormat) -> BusArmConfig {
    let limit = JointVector::from([177.0f64, 91.0, 174.0, 137.0, 255.0, 165.0, 255.0].map(f64::to_radians));
    let limits = LimitsCheck::Compare { lower_rad: -limit, upper_rad: limit, tolerance_rad: 0.5f64.to_radians() };
    BusArmConfig {
        name: "arm-8".to_owned(),
        arm: ArmId(8),
        driver: DriverConfig { limits, ..DriverConfig::with_cycle(BUS_CYCLE) },
        exchange_cycle: EXCHANGE_CYCLE,
        format,
        modulus: SequenceModulus::Modulo128,
        target: BusTarget::Socket(far.path.clone()),
        realtime: REALTIME,
    }
}

fn open(far: &Far, format: WireFormat) -> Pa10Arm {
    open_with(config(far, format))
}

fn open_with(config: BusArmConfig) -> Pa10Arm {
    let seat = trip_line(1).unwrap().remove(0);
    let arm = Pa10Arm::open_on_bus(config, Arc::new(SystemClock::new()), seat);
    arm.unwrap_or_else(|error| panic!("{error}: {:?}", std::error::Error::source(&error)))
}

fn paced_exchange(arm: &mut Pa10Arm) -> Result<JointState, ArmError> {
    std::thread::sleep(EXCHANGE_CYCLE);
    arm.exchange(velocity())
}

/// Without real time the controller's answers may be late by more than one cycle of 2 ms: three in a row are a fault.
fn enable_and_move(arm: &mut Pa10Arm) {
    for _ in 0..20 {
        if arm.state() == ArmState::Fault {
            arm.reset().unwrap();
        }
        if arm.enable().is_ok() && (0..30).all(|_| paced_exchange(arm).is_ok()) {
            return;
        }
        // Any other stop must be caused by the load of the machine.
        let latched = arm.monitor().snapshot().latched;
        let by_load = latched.is_none_or(|latched| matches!(latched.trip, Trip::Fault(FaultCause::LinkLost { .. })));
        assert!(by_load, "{latched:?}");
        arm.stop().unwrap();
    }
    panic!("the machine is too loaded for a cycle of 2 ms");
}

#[test]
fn an_arm_on_the_bus_itself_goes_up_moves_and_comes_down() {
    in_real_time_beside_others(|| {
        for format in WireFormat::ALL {
            let far = Far::new("moves", format);
            let mut arm = open(&far, format);
            assert_eq!(arm.state(), ArmState::Disabled);
            enable_and_move(&mut arm);
            assert_eq!(arm.info().cycle, EXCHANGE_CYCLE);
            assert!(arm.info().name.starts_with("arm-8 (pa10 at socket "), "{}", arm.info().name);
            let output_text = far.controller.lock().unwrap().commanded_rad_per_s();
            assert!((output_text[2] - 0.3).abs() < 0.01, "{output_text}");
            println!("{format}: {:?}, {:?}", arm.monitor().jitter(), arm.monitor().snapshot().counters);
            arm.stop().unwrap();
            assert!(far.is_at_rest());
        }
    });
}

/// R8: the program waits for brakes that close slowly; without E the controller would have to stop by itself.
#[test]
fn who_lets_go_of_an_arm_with_slow_brakes_still_ends_its_control_mode() {
    in_real_time_beside_others(|| {
        let format = WireFormat::BigEndian6x10;
        let far = Far::new("slow", format);
        let mut config = config(&far, format);
        config.driver.brake_time = Duration::from_secs(2);
        config.driver.activity_timeout = Duration::from_secs(14);
        let mut arm = open_with(config);
        enable_and_move(&mut arm);
        drop(arm);
        let controller = far.controller.lock().unwrap();
        assert!(controller.is_braked());
        assert_eq!((controller.mode(), controller.counters().watchdog_trips), (ControlMode::Adjustment, 0));
    });
}

#[test]
fn a_bus_that_goes_down_is_reported_as_unplugged_and_its_arm_is_stopped_when_it_is_back() {
    in_real_time_beside_others(|| {
        let format = WireFormat::BigEndian6x10;
        // The controller continues with the last velocities.
        let mut far = Far::with("down", format, None);
        let mut arm = open(&far, format);
        enable_and_move(&mut arm);
        far.close();
        let begin = Instant::now();
        while arm.monitor().snapshot().unplugged.is_none() {
            assert!(begin.elapsed() < LONG, "{:?}", arm.monitor().snapshot());
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(arm.exchange(velocity()).unwrap_err().kind(), ArmErrorKind::Disconnected);
        assert_eq!(arm.reset().unwrap_err().kind(), ArmErrorKind::Disconnected);
        assert!(far.speed() > 0.2, "nobody has stopped it");
        far.open();
        // The arm stops without a request, and stays stopped.
        let begin = Instant::now();
        while !(far.speed() < 1e-3 && far.mode() == ControlMode::Adjustment && far.is_at_rest()) {
            assert!(begin.elapsed() < LONG, "{} rad/s, {:?}", far.speed(), arm.monitor().snapshot());
            std::thread::sleep(Duration::from_millis(5));
        }
        let stopped = arm.monitor().snapshot();
        assert!(matches!(
            stopped.latched.unwrap().trip,
            Trip::Fault(FaultCause::Unplugged | FaultCause::LinkLost { .. })
        ));
        assert!(arm.enable().is_err());
        arm.reset().unwrap();
        enable_and_move(&mut arm);
        drop(arm);
        assert!(far.is_at_rest());
    });
}

/// The output of a program that ends while its stop order is unanswered, and the time that it takes.
#[test]
fn a_program_that_lets_go_of_an_arm_that_does_not_hear_it_says_so() {
    const CHILD: &str = "PB3DP_TEST_LETS_GO_OF_A_DEAF_ARM";
    if std::env::var_os(CHILD).is_some() {
        return let_go_of_a_deaf_arm();
    }
    in_real_time_beside_others(|| {
        let name = "real_time::io_arm_on_bus::a_program_that_lets_go_of_an_arm_that_does_not_hear_it_says_so";
        let mut child = std::process::Command::new(std::env::current_exe().unwrap());
        let ended = child.args([name, "--exact", "--nocapture"]).env(CHILD, "1").output().unwrap();
        let output_text = String::from_utf8_lossy(&ended.stderr);
        assert!(ended.status.success(), "{output_text}");
        assert!(String::from_utf8_lossy(&ended.stdout).contains("1 passed"), "no such test: {name}");
        assert!(output_text.contains("EMERGENCY STOP: press it at arm arm-8"), "{output_text}");
    });
}

fn let_go_of_a_deaf_arm() {
    let format = WireFormat::LittleEndian5x8;
    let far = Far::with("deaf", format, None);
    let mut arm = open(&far, format);
    enable_and_move(&mut arm);
    far.inject("deaf 1000000");
    let stopping = Instant::now();
    while arm.state() != ArmState::Fault {
        assert!(stopping.elapsed() < LONG);
        let _ = paced_exchange(&mut arm);
    }
    let error = arm.stop().unwrap_err();
    assert!(error.to_string().contains("emergency stop"), "{error}");
    assert!(arm.monitor().snapshot().stop_unacknowledged);
    let begin = Instant::now();
    drop(arm);
    let took = begin.elapsed();
    assert!(took > Duration::from_secs(1) && took < LONG, "{took:?}");
    assert!(far.speed() > 0.2, "nobody but the operator can stop it");
}

#[test]
fn an_emergency_stop_is_reported_and_reset_when_it_is_released() {
    in_real_time_beside_others(|| {
        let format = WireFormat::BigEndian6x10;
        let far = Far::new("e-stop", format);
        let mut arm = open(&far, format);
        enable_and_move(&mut arm);
        far.inject("e-stop press");
        let begin = Instant::now();
        while arm.state() != ArmState::EStop {
            assert!(begin.elapsed() < LONG, "{:?}", arm.monitor().snapshot());
            let _ = paced_exchange(&mut arm);
        }
        assert!(arm.reset().is_err());
        far.inject("e-stop release");
        arm.reset().unwrap();
        assert_eq!(arm.state(), ArmState::Disabled);
        enable_and_move(&mut arm);
    });
}

#[test]
fn a_bus_that_is_not_there_and_cycles_that_do_not_fit_are_refused() {
    in_real_time_beside_others(|| {
        let far = Far::new("refused", WireFormat::BigEndian6x10);
        let good = config(&far, WireFormat::BigEndian6x10);
        let open = |config| {
            let seat = trip_line(1).unwrap().remove(0);
            Pa10Arm::open_on_bus(config, Arc::new(SystemClock::new()), seat).err().unwrap()
        };
        for exchange_cycle in [Duration::from_millis(1), Duration::from_millis(11)] {
            let error = open(BusArmConfig { exchange_cycle, ..good.clone() });
            assert!(error.to_string().contains(&format!("{exchange_cycle:?} between two exchanges")), "{error}");
        }
        for target in [BusTarget::Arcnet("no-such-bus".to_owned()), BusTarget::Socket("/no/such/socket".into())] {
            let error = open(BusArmConfig { target, ..good.clone() });
            assert!(matches!(error, ArmOpenError::Open { .. }), "{error:?}");
        }
    });
}
