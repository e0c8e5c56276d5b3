//! The thread of an arm: it owns driver, link and transport, and never blocks on anything else.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::Letter;
use pb3dp_arm_pa10_protocol::gateway_protocol::ArmId;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Clock, JointCommand};

use super::gateway_port::GatewayPort;
use super::request::{RequestContext, RequestError, Running};
use super::shared::{ArmSnapshot, Shared};
use super::trip_line::TripSeat;
use crate::driver::{Activity, Driver, FaultCause, Request, Trip};

/// Longest time between two turns.
const IDLE: Duration = Duration::from_millis(50);

/// Shortest time between two turns: after a lock that the owner held, or a time that has passed already.
const SOON: Duration = Duration::from_micros(200);

/// Time limit, besides the brake time, to stop an arm that the program has released.
pub(super) const RELEASE_MAX: Duration = Duration::from_millis(1300);

/// Result of a request: its number, and why it failed.
pub(super) type RequestResult = (u64, Result<(), RequestError>);

pub(super) struct Worker {
    pub arm: ArmId,
    pub cycle: Duration,
    pub driver: Driver,
    pub port: GatewayPort,
    pub clock: Arc<dyn Clock>,
    pub seat: TripSeat,
    pub shared: Arc<Shared>,
    pub ends: Sender<RequestResult>,
    pub progress: Progress,
}

/// State of the thread.
#[derive(Default)]
pub(super) struct Progress {
    command: u64,
    request: u64,
    running: Option<Running>,
    /// Result of the last request, until the owner reads it.
    ended: Option<RequestResult>,
    /// The other arms know that this arm has stopped.
    others_reported: bool,
    samples: u64,
    last_sample: MonotonicTime,
    sample_at: Option<MonotonicTime>,
    /// The owner held a lock: its command is not yet executed, or its snapshot is old.
    come_back: bool,
    /// Time of the last message, number of answers before it, and whether it was a cyclic command.
    asked: Option<(MonotonicTime, u64, bool)>,
    releasing: Option<MonotonicTime>,
    failed: bool,
}

/// Body of the thread.
pub(super) fn run(mut worker: Worker) {
    // After a panic the arm must not go on moving: the sound parts stop it.
    if catch_unwind(AssertUnwindSafe(|| worker.serve())).is_err() {
        worker.progress.failed = true;
        worker.seat.trip_others(worker.arm);
        let _ = catch_unwind(AssertUnwindSafe(|| worker.stop_after_failure()));
        let _ = catch_unwind(AssertUnwindSafe(|| worker.shared.publish_waiting(&worker.snapshot())));
    }
}

impl Worker {
    /// Runs until the owner releases the arm and it is stopped.
    fn serve(&mut self) {
        loop {
            self.turn();
            if self.is_over() {
                return;
            }
            self.wait();
        }
    }

    /// Does everything that is due.
    pub(super) fn turn(&mut self) {
        let now = self.clock.now();
        self.take_trip(now);
        self.take_request();
        self.take_command(now);
        self.release(now);
        self.receive(now);
        self.advance_request(now);
        self.transmit();
        self.tell_others();
        self.publish();
    }

    fn take_trip(&mut self, now: MonotonicTime) {
        self.seat.forget_wakings();
        if let Some(trip) = self.seat.take() {
            self.driver.handle_trip(now, trip);
        }
    }

    fn take_request(&mut self) {
        let Some((number, request)) = self.shared.request() else { return };
        if number != self.progress.request {
            self.progress.request = number;
            self.progress.running = Some(Running::new(number, request));
        }
    }

    fn advance_request(&mut self, now: MonotonicTime) {
        let Self { driver, port, cycle, .. } = self;
        let Some(running) = &mut self.progress.running else { return };
        let mut context = RequestContext { driver, port, cycle: *cycle };
        if let Some(end) = running.advance(now, &mut context) {
            self.progress.ended = Some((running.number, end));
            self.progress.running = None;
        }
    }

    fn take_command(&mut self, now: MonotonicTime) {
        let slot = self.shared.command();
        self.progress.come_back = slot.is_none();
        let Some(slot) = slot else { return };
        if slot.ticket == self.progress.command {
            return;
        }
        self.progress.command = slot.ticket;
        // Expired commands expire before a new one could hide it. Ages count from and to the times at which commands were given: one that
        // was given in time is not late because this thread reads it at its next turn.
        self.driver.handle_timeout(slot.at);
        let (at, request) = match slot.command {
            // The ramp of an older one begins now.
            JointCommand::Hold if now.saturating_since(slot.at) > self.cycle => (now, Request::Hold),
            JointCommand::Hold => (slot.at, Request::Hold),
            JointCommand::Velocity(velocity) => (slot.at, Request::Move(velocity)),
        };
        // Refused in a state without motion: its owner sees the state.
        let _ = self.driver.handle_request(at, request);
    }

    /// The owner is gone: stop as quickly as after a fault if the arm could move.
    fn release(&mut self, now: MonotonicTime) {
        if !self.shared.is_released() || self.progress.releasing.is_some() {
            return;
        }
        self.progress.releasing = Some(now);
        self.progress.running = None;
        if self.driver.state().has_open_brakes() {
            self.driver.handle_trip(now, Trip::Fault(FaultCause::Released));
        } else {
            let _ = self.driver.handle_request(now, Request::Stop);
        }
    }

    fn receive(&mut self, now: MonotonicTime) {
        if self.port.receive(now, &mut self.driver).is_err() {
            self.driver.handle_unplugged(now);
        }
        let answered = self.driver.counters().answered;
        if let Some((asked, _, is_cyclic)) = self.progress.asked.take_if(|(_, before, _)| answered > *before) {
            let meter = if is_cyclic { &self.shared.round_trips } else { &self.shared.control_trips };
            meter.record(now.saturating_since(asked));
        }
        if let Some(misses) = self.port.silence(now).filter(|_| !self.driver.state().is_latched()) {
            self.driver.handle_trip(now, Trip::Fault(FaultCause::LinkLost { misses }));
        }
        if let Some(joints) = self.driver.joints()
            && joints.at > self.progress.last_sample
        {
            self.progress.last_sample = joints.at;
            self.progress.samples += 1;
            self.progress.sample_at = Some(now);
        }
    }

    fn transmit(&mut self) {
        let now = self.clock.now();
        let due = self.driver.transmit_due();
        if let Some(transmit) = self.driver.poll_transmit(now) {
            let is_cyclic = transmit.message.letter() == Letter::Cyclic;
            if is_cyclic {
                self.shared.jitter.record(now.saturating_since(due));
            }
            self.progress.asked = Some((now, self.driver.counters().answered, is_cyclic));
            self.port.send(now, &transmit, self.driver.activity());
        }
        if self.port.flush(now).is_err() {
            self.driver.handle_unplugged(now);
        }
    }

    /// A stopped arm stops the others, unless they stopped it.
    fn tell_others(&mut self) {
        let Some(latched) = self.driver.latched() else {
            self.progress.others_reported = false;
            return;
        };
        if !self.progress.others_reported && !latched.trip.is_by_other_arm() {
            self.seat.trip_others(self.arm);
        }
        self.progress.others_reported = true;
    }

    fn publish(&mut self) {
        let published = self.shared.publish(&self.snapshot());
        self.progress.come_back |= !published;
        // Only now, so that the owner finds the state after the request.
        if published && let Some(ended) = self.progress.ended.take() {
            // An owner that does not wait needs no result.
            let _ = self.ends.send(ended);
        }
    }

    fn snapshot(&self) -> ArmSnapshot {
        let driver = &self.driver;
        ArmSnapshot {
            state: driver.state(),
            activity: driver.activity(),
            latched: driver.latched().copied(),
            unplugged: self.port.gone(),
            failed: self.progress.failed,
            joints: driver.joints().copied(),
            sample_at: self.progress.sample_at,
            samples: self.progress.samples,
            sample: driver.sample().copied(),
            shown: self.port.shown().copied(),
            limits: *driver.limits(),
            gateway: self.port.hello().copied(),
            gateway_found: self.port.found().copied(),
            counters: *driver.counters(),
            line: self.port.line(),
            frames_unsent: self.port.frames_unsent(),
        }
    }

    /// Whether the owner has released the arm and nothing is left to do for it.
    pub(super) fn is_over(&self) -> bool {
        let Some(since) = self.progress.releasing else { return false };
        let at_rest = self.driver.activity() == Activity::None || self.port.gone().is_some();
        at_rest || self.clock.now().saturating_since(since) >= RELEASE_MAX + self.driver.brake_time()
    }

    fn wait(&mut self) {
        let left = self.idle_for(self.clock.now());
        self.port.wait(self.seat.waker(), left);
    }

    /// Time without work, unless something arrives.
    pub(super) fn idle_for(&self, now: MonotonicTime) -> Duration {
        let soon = self.progress.come_back.then(|| now + SOON);
        let deadlines = [self.driver.next_deadline(), self.port.next_deadline(), soon];
        let next = deadlines.into_iter().flatten().min().unwrap_or(now + IDLE);
        if next <= now { SOON } else { next.saturating_since(now).min(IDLE) }
    }

    fn stop_after_failure(&mut self) {
        self.shared.release();
        let now = self.clock.now();
        self.driver.handle_trip(now, Trip::Fault(FaultCause::Program));
        self.serve();
    }
}
