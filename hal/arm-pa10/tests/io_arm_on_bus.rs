//! An arm whose bus ends in this computer: a socket in the place of the ARCNET card, an emulated servo controller behind it.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

#[path = "common/cell_end.rs"]
mod cell_end;
#[path = "common/patience.rs"]
mod patience;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use patience::patiently;
use pb3dp_arm_pa10::codec::{SequenceModulus, WireFormat};
use pb3dp_arm_pa10::driver::{DriverConfig, FaultCause, LimitsCheck, Trip};
use pb3dp_arm_pa10::gateway_protocol::ArmId;
use pb3dp_arm_pa10::io::arm::{ArmOpenError, BusArmConfig, BusTarget, Pa10Arm, REALTIME, trip_line};
use pb3dp_arm_pa10::io::bus::{BusPort, FRAME_ROOM, FrameListener};
use pb3dp_arm_pa10::io::realtime::{Realtime, enter};
use pb3dp_arm_pa10::io::transport::wait_for;
use pb3dp_arm_pa10::mock_controller::{ControlMode, MockController, MockControllerConfig};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, JointCommand, JointState};
use pb3dp_hal_clock::SystemClock;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::JointPlant;

const BUS_CYCLE: Duration = Duration::from_millis(2);
const EXCHANGE_CYCLE: Duration = Duration::from_millis(10);
const LONG: Duration = Duration::from_secs(5);

fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

fn velocity() -> JointCommand {
    JointCommand::Velocity(JointVector::from([0.1, -0.2, 0.3, -0.15, 0.25, -0.1, 0.2]))
}

/// A controller at the end of a socket, in a thread of its own.
struct Far {
    controller: Arc<Mutex<MockController>>,
    closed: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    path: std::path::PathBuf,
}

impl Far {
    fn new(name: &str, format: WireFormat) -> Self {
        let path = std::env::temp_dir().join(format!("pb3dp-{name}-{}", std::process::id()));
        let listener = FrameListener::bind(&path).unwrap();
        let start = MonotonicTime::from_nanos(1_000_000_000);
        let home = JointVector::from([0.2, -0.5, 0.3, 1.1, 0.4, 0.9, 0.1]);
        let plant = Arc::new(Mutex::new(JointPlant::new(cell_end::plant_config(), home, start).unwrap()));
        // Threads of tests are not always run in time: 6 ms would be an arm that stops by itself now and then.
        let config =
            MockControllerConfig { watchdog: Some(Duration::from_millis(400)), ..MockControllerConfig::new(format) };
        let controller = Arc::new(Mutex::new(MockController::new(config, plant, 7, start).unwrap()));
        let closed = Arc::new(AtomicBool::new(false));
        let (of_thread, closed_of_thread) = (Arc::clone(&controller), Arc::clone(&closed));
        let thread = std::thread::spawn(move || {
            enter(&Realtime { priority: Some(40), locks_memory: false, cpu: None });
            serve(&listener, &of_thread, &closed_of_thread, start);
        });
        Self { controller, closed, thread: Some(thread), path }
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

fn serve(listener: &FrameListener, controller: &Mutex<MockController>, closed: &AtomicBool, start: MonotonicTime) {
    let begin = Instant::now();
    let mut socket = None;
    let mut buffer = [0; FRAME_ROOM];
    while !closed.load(Ordering::SeqCst) {
        if socket.is_none() {
            socket = listener.try_accept().unwrap();
        }
        let now = start + begin.elapsed();
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
        // What came in between must be the machine's fault.
        let latched = arm.monitor().snapshot().latched;
        let by_load = latched.is_none_or(|latched| matches!(latched.trip, Trip::Fault(FaultCause::LinkLost { .. })));
        assert!(by_load, "{latched:?}");
        arm.stop().unwrap();
    }
    panic!("the machine is too loaded for a cycle of 2 ms");
}

#[test]
fn an_arm_on_the_bus_itself_goes_up_moves_and_comes_down() {
    patiently(|| {
        let _turn = turn();
        for format in WireFormat::ALL {
            let far = Far::new("moves", format);
            let mut arm = open(&far, format);
            assert_eq!(arm.state(), ArmState::Disabled);
            enable_and_move(&mut arm);
            assert_eq!(arm.info().cycle, EXCHANGE_CYCLE);
            assert!(arm.info().name.starts_with("arm-8 (pa10 at socket "), "{}", arm.info().name);
            let told = far.controller.lock().unwrap().commanded_rad_per_s();
            assert!((told[2] - 0.3).abs() < 0.01, "{told}");
            println!("{format}: {:?}, {:?}", arm.monitor().jitter(), arm.monitor().snapshot().counters);
            arm.stop().unwrap();
            assert!(far.is_at_rest());
        }
    });
}

/// R8: brakes that close slowly are waited for; without E the controller would have to stop by itself.
#[test]
fn who_lets_go_of_an_arm_with_slow_brakes_still_ends_its_control_mode() {
    patiently(|| {
        let _turn = turn();
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
fn a_bus_that_goes_down_is_told_as_unplugged_and_comes_back_by_a_reset() {
    patiently(|| {
        let _turn = turn();
        let format = WireFormat::BigEndian6x10;
        let mut far = Far::new("down", format);
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
        let far = Far::new("down", format);
        arm.reset().unwrap();
        enable_and_move(&mut arm);
        drop(arm);
        assert!(far.is_at_rest());
    });
}

#[test]
fn an_emergency_stop_is_told_and_reset_when_it_is_released() {
    patiently(|| {
        let _turn = turn();
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
    patiently(|| {
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
