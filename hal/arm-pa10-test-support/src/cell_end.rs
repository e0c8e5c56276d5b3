//! The far end of a real line: the project's gateway and an emulated servo controller, in their own thread.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use pb3dp_arm_pa10_emulation::mock_controller::{MockController, MockControllerConfig};
use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig, GatewayStatus};
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Firmware, GatewayState, MotionLimits};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::realtime::{Realtime, enter};
use pb3dp_hal_platform::transport::{ByteLink, wait};
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::JointPlant;

pub use crate::plant_config::plant_config;

/// A thread that was delayed for longer than this skips the rest of the time: gateway and arm stand still with the thread,
/// because the tests do not measure the machine that runs them.
const CATCH_UP_MAX: Duration = Duration::from_millis(15);

/// Gateway and controller.
pub struct Cell {
    pub gateway: Gateway,
    pub controller: MockController,
    /// Bytes for the host are lost while this is set.
    pub answers_lost: u32,
    /// The line is neither read nor written.
    pub stalled: bool,
    /// The time of gateway and controller.
    pub now: MonotonicTime,
}

/// Gateway and controller with their thread.
pub struct CellEnd {
    cell: Arc<Mutex<Cell>>,
    closed: Arc<AtomicBool>,
    thread: Option<JoinHandle<Instant>>,
}

impl Cell {
    pub fn new(arm: ArmId, format: WireFormat, home: JointVector) -> Self {
        let now = MonotonicTime::from_nanos(1_000_000_000);
        let plant = Arc::new(Mutex::new(JointPlant::new(plant_config(), home, now).unwrap()));
        // Emulated brakes and watchdog have the published values, and the gateway is configured for the slower brake.
        let controller = MockController::new(MockControllerConfig::new(format), plant, 7, now).unwrap();
        let config = GatewayConfig::new(arm, format, Firmware::new("test cell 1").unwrap(), MotionLimits::WIDEST);
        Self { gateway: Gateway::new(config, now).unwrap(), controller, answers_lost: 0, stalled: false, now }
    }

    /// Processes everything that is due until then, in order of time.
    fn advance(&mut self, until: MonotonicTime) {
        loop {
            let next = self
                .controller
                .next_deadline()
                .map_or(self.gateway.next_deadline(), |at| at.min(self.gateway.next_deadline()));
            let now = next.max(self.now);
            if now > until {
                break;
            }
            self.work(now);
        }
        self.work(until);
    }

    fn work(&mut self, now: MonotonicTime) {
        self.now = now;
        self.controller.advance(now);
        while let Some(frame) = self.controller.poll_frame(now) {
            self.gateway.handle_bus_frame(now, &frame);
        }
        while let Some(frame) = self.gateway.poll_bus_frame(now) {
            self.controller.handle_frame(now, &frame);
        }
    }

    fn output(&mut self) -> Vec<u8> {
        let mut output = Vec::new();
        while let Some(bytes) = self.gateway.poll_host_output(self.now) {
            match self.answers_lost.checked_sub(1) {
                Some(left) => self.answers_lost = left,
                None => output.extend_from_slice(&bytes),
            }
        }
        output
    }

    pub fn position(&self) -> JointVector {
        let plant = self.controller.plant();
        let plant = plant.lock().unwrap();
        plant.position_at(plant.now()).unwrap()
    }
}

impl CellEnd {
    /// Serves this end until it is closed.
    pub fn serve(bytes: Box<dyn ByteLink>, cell: Cell) -> Self {
        let cell = Arc::new(Mutex::new(cell));
        let closed = Arc::new(AtomicBool::new(false));
        let (of_thread, closed_of_thread) = (Arc::clone(&cell), Arc::clone(&closed));
        let thread = std::thread::spawn(move || {
            // Real-time where permitted: this thread stands for a separate device.
            enter(&Realtime { priority: Some(40), locks_memory: false, cpu: None });
            pump(bytes, &of_thread, &closed_of_thread)
        });
        Self { cell, closed, thread: Some(thread) }
    }

    pub fn cell(&self) -> MutexGuard<'_, Cell> {
        self.cell.lock().unwrap()
    }

    /// Injects a line of a fault script.
    pub fn inject(&self, line: &str) {
        let mut cell = self.cell();
        let now = cell.now;
        cell.controller.command_line(now, line).unwrap();
    }

    pub fn status(&self) -> GatewayStatus {
        self.cell().gateway.status()
    }

    pub fn state(&self) -> GatewayState {
        self.status().state
    }

    /// Unplugs the line; returns the time.
    pub fn unplug(&mut self) -> Instant {
        self.closed.store(true, Ordering::SeqCst);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for CellEnd {
    fn drop(&mut self) {
        self.closed.store(true, Ordering::SeqCst);
    }
}

fn pump(bytes: Box<dyn ByteLink>, cell: &Mutex<Cell>, closed: &AtomicBool) -> Instant {
    let mut bytes = Some(bytes);
    let begin = Instant::now();
    let mut unplugged = begin;
    let origin = cell.lock().unwrap().now;
    let mut lost = Duration::ZERO;
    let mut buffer = [0; 512];
    let mut output: Vec<u8> = Vec::new();
    loop {
        {
            let mut cell = cell.lock().unwrap();
            let behind = (origin + begin.elapsed().saturating_sub(lost)).saturating_since(cell.now);
            lost += behind.saturating_sub(CATCH_UP_MAX);
            cell.advance(origin + begin.elapsed().saturating_sub(lost));
            let now = cell.now;
            if closed.load(Ordering::SeqCst) && bytes.take().is_some() {
                unplugged = Instant::now();
                cell.gateway.handle_host_gone(now);
            }
            if cell.stalled {
                drop(cell);
                std::thread::sleep(Duration::from_millis(1));
                continue;
            }
            if let Some(bytes) = &mut bytes {
                let count = bytes.try_read(&mut buffer).unwrap_or(0);
                cell.gateway.handle_host_bytes(now, &buffer[..count]);
                output.extend(cell.output());
                let written = bytes.try_write(&output).unwrap_or(0);
                output.drain(..written);
            } else if cell.gateway.is_at_rest() {
                // The gateway has completed its reaction to a lost line.
                return unplugged;
            }
        }
        match &bytes {
            Some(bytes) => wait(Some(bytes.as_ref()), false, None, Duration::from_millis(1)),
            None => wait(None, false, None, Duration::from_millis(1)),
        };
    }
}
