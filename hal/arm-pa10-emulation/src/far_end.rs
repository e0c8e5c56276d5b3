//! Far end of the line to an emulated arm, without I/O and clock: a servo controller, optionally behind a gateway.
//!
//! The owner passes the bytes of the host, advances the time, and takes the bytes for the host: a thread in real time
//! (`io::mock_server`), or a simulation (`io::arm::VirtualTime`).

use std::time::Duration;

use pb3dp_arm_pa10_gateway::gateway::Gateway;
use pb3dp_arm_pa10_protocol::arcnet::Frame;
use pb3dp_geometry::MonotonicTime;

use crate::mock_controller::MockController;

/// An emulated servo controller, optionally behind a gateway.
#[derive(Debug)]
pub struct FarEnd {
    /// The controller with its arm.
    pub controller: MockController,
    /// The gateway; without one the host is on the bus itself.
    pub gateway: Option<Gateway>,
    now: MonotonicTime,
}

impl FarEnd {
    /// Starts both at `now`.
    pub fn new(controller: MockController, gateway: Option<Gateway>, now: MonotonicTime) -> Self {
        Self { controller, gateway, now }
    }

    /// Time that both have reached.
    pub fn now(&self) -> MonotonicTime {
        self.now
    }

    /// Advances both to a time, each event at its own time. Without a gateway `bus` gets the frames for the host.
    pub fn advance(&mut self, to: MonotonicTime, mut bus: impl FnMut(&[u8])) {
        loop {
            self.exchange(&mut bus);
            let wanted = self.gateway.as_ref().map(Gateway::next_deadline);
            let next = [wanted, self.controller.next_deadline()].into_iter().flatten().min();
            let Some(next) = next.filter(|next| *next <= to) else { break };
            self.now = next.max(self.now + Duration::from_nanos(1));
        }
        self.now = self.now.max(to);
        self.controller.advance(self.now);
    }

    /// Handles the due events of the bus.
    pub fn exchange(&mut self, bus: &mut impl FnMut(&[u8])) {
        while let Some(frame) = self.controller.poll_frame(self.now) {
            match &mut self.gateway {
                Some(gateway) => gateway.handle_bus_frame(self.now, &frame),
                None => bus(&frame),
            }
        }
        if let Some(frame) = self.gateway.as_mut().and_then(|gateway| gateway.poll_bus_frame(self.now)) {
            self.controller.handle_frame(self.now, &frame);
        }
    }

    /// Passes bytes of the host to the gateway.
    pub fn hear(&mut self, now: MonotonicTime, bytes: &[u8]) {
        let Self { controller, gateway: Some(gateway), .. } = self else { return };
        controller.hear_on_line(now, bytes, |bytes| gateway.handle_host_bytes(now, bytes));
    }

    /// Puts answers of the gateway on the line; `host` gets those that have arrived.
    pub fn answer(&mut self, now: MonotonicTime, mut host: impl FnMut(&Frame)) {
        while let Some(bytes) = self.gateway.as_mut().and_then(|gateway| gateway.poll_host_output(now)) {
            self.controller.send_on_line(now, &bytes);
        }
        while let Some(bytes) = self.controller.poll_line(now) {
            host(&bytes);
        }
    }

    /// Breaks the line and drops its content.
    pub fn hang_up(&mut self) {
        self.controller.clear_line();
        if let Some(gateway) = &mut self.gateway {
            gateway.handle_host_gone(self.now);
        }
    }

    /// Time of the next event.
    pub fn next_deadline(&self) -> Option<MonotonicTime> {
        let wanted = self.gateway.as_ref().map(Gateway::next_deadline);
        [wanted, self.controller.next_deadline(), self.controller.next_on_line()].into_iter().flatten().min()
    }
}
