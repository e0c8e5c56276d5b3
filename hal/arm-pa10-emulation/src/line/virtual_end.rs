//! The far end of an arm's line in virtual time: gateway, servo controller and cable.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use pb3dp_arm_pa10::arm::VirtualFarEnd;
use pb3dp_arm_pa10_gateway::gateway::Gateway;
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, SharedKey};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_hal_platform::transport::Connector;

use super::virtual_line::{SharedLine, VirtualLine, VirtualPort, lock};
pub use super::virtual_line::{Tampering, Towards};
use crate::far_end::FarEnd;
use crate::mock_controller::LineError;

/// The far end of the line of an arm in virtual time, for operators and tests.
#[derive(Clone, Debug)]
pub struct VirtualEnd {
    far: Arc<Mutex<FarEnd>>,
    line: SharedLine,
    /// Something happened that the host has not seen.
    touched: Arc<AtomicBool>,
}

impl VirtualEnd {
    /// The far end of a line with this bit rate.
    pub fn new(far: FarEnd, baud: u32) -> Self {
        Self {
            far: Arc::new(Mutex::new(far)),
            line: Arc::new(Mutex::new(VirtualLine::new(baud))),
            touched: Arc::default(),
        }
    }

    /// The same with a key that host and gateway share: each frame travels in an authentic record, and the gateway notices a closed
    /// connection, as on TCP. The handshake is left out.
    pub fn with_key(self, key: SharedKey, arm: ArmId) -> Self {
        lock(&self.line).set_key(key, arm);
        self
    }

    /// Read access to gateway and controller.
    pub fn look<T>(&self, look: impl FnOnce(&FarEnd) -> T) -> T {
        look(&lock(&self.far))
    }

    /// Starts or ends a fault, by a line as in a script.
    ///
    /// # Errors
    /// Names the wrong word and the allowed ones; nothing happens then.
    pub fn command_line(&self, line: &str) -> Result<(), LineError> {
        let mut far = lock(&self.far);
        let now = far.now();
        far.controller.command_line(now, line)
    }

    /// Unplugs the cable: both sides detect it.
    pub fn unplug(&self) {
        self.set_plugged(false);
    }

    /// Plugs the cable in again. A reset restores the arm.
    pub fn plug(&self) {
        self.set_plugged(true);
    }

    /// The program at the host's end dies: nothing that it sends from now on arrives, and it cannot connect again. `is_closed`: the system
    /// closes its connection, which a gateway notices if the line has a key.
    pub fn lose_program(&self, is_closed: bool) {
        lock(&self.line).lose_program(is_closed);
        self.touched.store(true, Ordering::Release);
    }

    /// Somebody on the line changes, repeats or removes the next bytes that are sent.
    pub fn tamper(&self, towards: Towards, tampering: Tampering) {
        lock(&self.line).tamper(towards, tampering);
    }

    /// The process of the gateway dies in the middle of its work, and a new one starts, which knows nothing of it. The cable stays
    /// plugged in; a connection with a key ends.
    pub fn restart_gateway(&self) {
        let mut line = lock(&self.line);
        if line.has_key() {
            line.cut();
        }
        drop(line);
        let mut far = lock(&self.far);
        let now = far.now();
        if let Some(gateway) = &mut far.gateway
            && let Ok(new) = Gateway::new(*gateway.config(), now)
        {
            *gateway = new;
            self.touched.store(true, Ordering::Release);
        }
    }

    fn set_plugged(&self, is_plugged: bool) {
        let mut line = lock(&self.line);
        if line.is_plugged() != is_plugged {
            line.set_plugged(is_plugged);
            lock(&self.far).hang_up();
            self.touched.store(true, Ordering::Release);
        }
    }
}

impl VirtualFarEnd for VirtualEnd {
    fn connector(&self, clock: Arc<dyn Clock>) -> Box<dyn Connector> {
        let program = lock(&self.line).program();
        Box::new(VirtualPort { line: Arc::clone(&self.line), clock, program, touched: Arc::clone(&self.touched) })
    }

    fn is_touched(&self) -> bool {
        self.touched.load(Ordering::Acquire)
    }

    fn next_deadline(&self, now: MonotonicTime) -> Option<MonotonicTime> {
        let line = lock(&self.line);
        let far = lock(&self.far);
        let answered =
            line.to_gateway.next_arrival().and_then(|at| match far.controller.readable_on_line(at.max(now)) {
                0 => far.controller.reads_line_again(),
                _ => Some(at),
            });
        [answered, line.to_host.next_arrival(), far.next_deadline()].into_iter().flatten().min()
    }

    fn work(&self, now: MonotonicTime) -> bool {
        let mut line = lock(&self.line);
        let arrives = line.to_host.next_arrival().is_some_and(|at| at <= now);
        let mut far = lock(&self.far);
        far.advance(now, |_| {});
        if line.take_left() {
            far.hang_up();
        }
        let mut buffer = [0; 512];
        let room = far.controller.readable_on_line(now).min(buffer.len());
        let count = line.to_gateway.take(now, &mut buffer[..room]);
        if count > 0 {
            let is_authentic = line.open(&buffer[..count], |frame| far.hear(now, frame));
            far.exchange(&mut |_| {});
            if !is_authentic {
                line.cut();
                far.hang_up();
                self.touched.store(true, Ordering::Release);
            }
        }
        far.answer(now, |bytes| {
            if line.is_plugged() {
                line.answer(now, bytes);
            }
        });
        self.touched.swap(false, Ordering::AcqRel) || arrives
    }
}
