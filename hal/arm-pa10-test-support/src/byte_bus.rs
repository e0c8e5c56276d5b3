//! A controller with a byte interface.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_arm_pa10_emulation::mock_controller::{MockController, MockControllerConfig};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::JointPlant;

/// A controller with a byte interface.
pub struct Bus {
    pub controller: MockController,
    pub now: MonotonicTime,
}

impl Bus {
    pub fn new(config: MockControllerConfig, plant: JointPlant) -> Self {
        let now = plant.now();
        Self { controller: MockController::new(config, Arc::new(Mutex::new(plant)), 7, now).unwrap(), now }
    }

    /// Sends a packet in a frame, and returns the packet that is received within 1 ms.
    pub fn exchange(&mut self, packet: &[u8]) -> Option<Vec<u8>> {
        let mut frame = vec![0xFF, 0xFE, u8::try_from(256 - packet.len()).unwrap(), 0x00];
        frame.extend(packet);
        self.controller.handle_frame(self.now, &frame);
        self.wait(Duration::from_millis(1));
        let reply = self.controller.poll_frame(self.now)?;
        assert_eq!(self.controller.poll_frame(self.now), None, "one message, one reply");
        let length = reply.len() - 4;
        assert_eq!(reply[..3], [0xFE, 0xFF, u8::try_from(256 - length).unwrap()], "{reply:?}");
        Some(reply[4..].to_vec())
    }

    pub fn wait(&mut self, time: Duration) {
        self.now = self.now + time;
        self.controller.advance(self.now);
    }

    /// Sends the same data for every axis, and `tail` after the axes.
    pub fn cyclic(&mut self, sequence: u8, axis: &[u8], tail: &[u8]) -> Vec<u8> {
        let mut packet = vec![sequence, b'C'];
        packet.extend(axis.repeat(7));
        packet.extend(tail);
        self.exchange(&packet).unwrap()
    }

    pub fn fault(&mut self, line: &str) {
        self.controller.command_line(self.now, line).unwrap();
    }

    /// True angles, rad.
    pub fn position(&self) -> JointVector {
        let plant = self.controller.plant();
        let plant = plant.lock().unwrap();
        plant.position_at(plant.now()).unwrap()
    }
}
