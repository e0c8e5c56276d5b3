//! A real PA-10 behind its gateway: the arm traits on top of a separate thread.
//!
//! The thread owns the driver, the link and the transport. It cycles at absolute times, reacts to the line at once, keeps the
//! gateway informed while nothing moves, and stops the arm when its owner sends no commands. [`Pa10Arm`] passes commands to the
//! thread and receives samples; [`ArmMonitor`] observes it; [`TripHandle`] stops it; a [`trip_line`] makes the arms of a workcell
//! stop each other.

mod closer;
mod config;
mod gateway_port;
mod keyed;
mod request;
mod shared;
mod trace;
mod trip_line;
mod virtual_time;
mod worker;

use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::task::Poll;
use std::thread::JoinHandle;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{ArmCommand, CodecError};
use pb3dp_arm_pa10_protocol::gateway_protocol::ArmId;
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, JointCommand, PowerOrder};
use pb3dp_hal_platform::realtime::{Realtime, Shortfall, enter};
use pb3dp_hal_platform::transport::{ConnectError, Connector};
use pb3dp_kinematics::JointState;

use self::closer::Closer;
use self::gateway_port::GatewayPort;
use self::shared::{PowerRequest, Shared};
use self::trace::Tracer;
use self::worker::{Progress, RELEASE_MAX, RequestResult, Worker};
use crate::driver::{Activity, Driver, DriverConfig, Trip};

pub use config::{ArmOpenError, Pa10ArmConfig, REALTIME};
pub use keyed::{AccessError, KeyedLink, KeyedTcp, read_shared_key};
pub use request::RequestError;
pub use shared::{ArmMonitor, ArmSnapshot};
pub use trace::{Direction, RawBytes};
pub use trip_line::{TripHandle, TripSeat, trip_line, virtual_trip_line};
pub use virtual_time::{VirtualFarEnd, VirtualTime};

/// A measurement of at most this age, in cycles, is the newest possible one: a slightly late successor is no reason to wait.
const FRESH_CYCLES: f64 = 1.5;

/// Maximum number of consecutive activities of a request.
const ACTIVITIES_MAX: u32 = 3;

/// Failure to open an arm.
const NOT_ENABLED: &str = "it is not enabled";

/// Time limit to open and greet a link.
const OPEN_MAX: Duration = Duration::from_secs(2);

/// A real PA-10.
///
/// `exchange` returns at once, and does not delay a loop with the pace of the arm. After lost answers it waits for the next
/// measurement, for at most one cycle: two in a row return `Timeout` at most, because lost answers are counted and tolerated. In a
/// state without measurements `Hold` returns the last measurement with its time.
///
/// Enabling takes seconds. A caller with another arm whose brakes are open starts it with [`ArmPower::begin_enable`] and continues
/// to exchange with both arms in each cycle: the thread monitors the line, while the caller monitors the joints.
///
/// After enabling, the caller must exchange in each cycle: a velocity fades after 20 ms and stops the arm after 50 ms. An arm that
/// only holds is stopped and latched after 5 s without a request.
///
/// Dropping it stops the arm: it stops within its emergency ramp, and the brakes get the order to close within 100 ms.
pub struct Pa10Arm {
    driver: DriverConfig,
    info: ArmInfo,
    /// As in `info`.
    name: Arc<str>,
    clock: Arc<dyn Clock>,
    shared: Arc<Shared>,
    trip: TripHandle,
    ends: Receiver<RequestResult>,
    work: Work,
    warnings: Vec<String>,
    /// The current request to enable the arm: its number, and the deadline of its result.
    enabling: Option<(u64, MonotonicTime)>,
}

/// Executor of an arm's work.
enum Work {
    /// A separate thread, until it has ended.
    Thread(Option<JoinHandle<()>>),
    /// The callers that wait in virtual time.
    Virtual(Arc<VirtualTime>),
}

/// Where the work of an arm is executed.
enum Place {
    Thread(Realtime),
    Virtual(Arc<VirtualTime>, Box<dyn VirtualFarEnd>),
}

/// Settings of both kinds of time.
struct Start {
    name: String,
    arm: ArmId,
    driver: DriverConfig,
    place: Place,
    target: String,
}

impl Pa10Arm {
    /// Opens the link, greets the gateway and reads the state of the arm, which keeps its brakes closed.
    ///
    /// An arm that is stopped by a fault or an emergency stop is opened too, so that an operator can reset it: its state reports
    /// the stop. `clock` is a real clock. Each arm of a workcell has one place of the same [`trip_line`].
    ///
    /// # Errors
    /// If the link cannot be opened, nobody answers, or the gateway is not the configured one.
    pub fn open(
        config: Pa10ArmConfig,
        connector: Box<dyn Connector>,
        clock: Arc<dyn Clock>,
        seat: TripSeat,
    ) -> Result<Self, ArmOpenError> {
        let Pa10ArmConfig { name, driver, link, realtime } = config;
        check_cycles(&name, &driver, &link)?;
        let (target, place) = (connector.target(), Place::Thread(realtime));
        let start = Start { name, arm: link.arm, driver, place, target };
        let open = move |tracer| GatewayPort::open(link, connector, Closer::start()?, tracer);
        Self::start(start, open, clock, seat)
    }

    /// The same for an arm that is emulated in virtual time, with a place of a [`virtual_trip_line`]; the real-time request is
    /// ignored.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_virtual(
        config: Pa10ArmConfig,
        end: Box<dyn VirtualFarEnd>,
        time: &Arc<VirtualTime>,
        seat: TripSeat,
    ) -> Result<Self, ArmOpenError> {
        let Pa10ArmConfig { name, driver, link, .. } = config;
        check_cycles(&name, &driver, &link)?;
        let clock: Arc<dyn Clock> = Arc::clone(time) as Arc<dyn Clock>;
        let connector = end.connector(Arc::clone(&clock));
        let (target, place) = (connector.target(), Place::Virtual(Arc::clone(time), end));
        let start = Start { name, arm: link.arm, driver, place, target };
        let open = move |tracer| GatewayPort::open(link, connector, Closer::at_once(), tracer);
        Self::start(start, open, clock, seat)
    }

    fn start(
        start: Start,
        open: impl FnOnce(Tracer) -> Result<GatewayPort, ConnectError>,
        clock: Arc<dyn Clock>,
        seat: TripSeat,
    ) -> Result<Self, ArmOpenError> {
        let Start { name, arm, driver: config, place, target } = start;
        let of_arm = || name.clone();
        let driver = Driver::new(config).map_err(|source| ArmOpenError::Config { arm: of_arm(), source })?;
        let shared = Arc::new(Shared::new());
        let opened = open(Tracer::new(shared.trace.clone()));
        let port = opened.map_err(|source| ArmOpenError::Open { arm: of_arm(), target: target.clone(), source })?;
        let mut warnings: Vec<_> = port.warning().into_iter().collect();
        let trip = seat.handle();
        let (ends_out, ends) = channel();
        let worker = Worker {
            arm,
            cycle: config.cycle,
            driver,
            port,
            clock: Arc::clone(&clock),
            seat,
            shared: Arc::clone(&shared),
            ends: ends_out,
            progress: Progress::default(),
        };
        let work = match place {
            Place::Thread(realtime) => {
                let (thread, shortfalls) = spawn(&name, worker, realtime)?;
                warnings.extend(shortfalls.iter().map(|shortfall| format!("arm {name}: {shortfall}")));
                Work::Thread(Some(thread))
            }
            Place::Virtual(time, end) => {
                time.add(worker, end);
                Work::Virtual(time)
            }
        };
        let info = ArmInfo { name: format!("{name} (pa10 at {target})"), cycle: config.cycle };
        let name = Arc::from(info.name.as_str());
        let mut opened = Self { driver: config, info, name, clock, shared, trip, ends, work, warnings, enabling: None };
        opened.fulfil(PowerRequest::Connect).map_err(|source| ArmOpenError::Connect { arm: of_arm(), source })?;
        Ok(opened)
    }

    /// Warnings of the link, and real-time requests that the system refused.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Reads the state of a connected arm again, as at opening; the brakes stay closed.
    ///
    /// # Errors
    /// If the arm is not merely connected, or the state stops it.
    pub fn look(&mut self) -> Result<(), ArmError> {
        self.fulfil(PowerRequest::Look).map_err(|error| self.request_error("looking at it", error))
    }

    /// Observes the arm.
    pub fn monitor(&self) -> ArmMonitor {
        ArmMonitor { shared: Arc::clone(&self.shared) }
    }

    /// A handle that stops this arm from any thread.
    pub fn trip_handle(&self) -> TripHandle {
        self.trip.clone()
    }

    /// Starts a request in the thread, which replaces any other one. Returns its number and the deadline of its result.
    fn begin(&mut self, request: PowerRequest) -> (u64, MonotonicTime) {
        self.enabling = None;
        let number = self.shared.post_request(request);
        self.trip.wake();
        // The thread ends each request in limited time; this covers a thread that does not run.
        let patience = OPEN_MAX + self.driver.activity_timeout * ACTIVITIES_MAX;
        (number, self.clock.now() + patience)
    }

    /// Executes a request and waits for its end.
    fn fulfil(&mut self, request: PowerRequest) -> Result<(), RequestError> {
        let (number, deadline) = self.begin(request);
        loop {
            match self.next_end(deadline) {
                Some((ended, end)) if ended == number => return end,
                Some(_) => {}
                None => return Err(RequestError::NoThread),
            }
        }
    }

    /// Waits for the end of a request.
    fn next_end(&self, deadline: MonotonicTime) -> Option<RequestResult> {
        match &self.work {
            Work::Thread(_) => self.ends.recv_timeout(deadline.saturating_since(self.clock.now())).ok(),
            Work::Virtual(time) => loop {
                if let Ok(end) = self.ends.try_recv() {
                    return Some(end);
                }
                if !time.step(deadline) {
                    return None;
                }
            },
        }
    }

    /// The result of the request with this number, if it has ended.
    fn ended(&self, number: u64, deadline: MonotonicTime) -> Option<Result<(), RequestError>> {
        let ended = self.ends.try_iter().find(|(ended, _)| *ended == number);
        let is_late = self.clock.now() > deadline;
        ended.map(|(_, end)| end).or_else(|| is_late.then_some(Err(RequestError::NoThread)))
    }

    /// Waits until the arm is in the wanted state or the time is over; returns the last snapshot.
    fn wait_for(&self, timeout: Duration, wanted: impl Fn(&ArmSnapshot) -> bool) -> ArmSnapshot {
        let Work::Virtual(time) = &self.work else { return self.shared.wait_for(timeout, wanted) };
        let deadline = self.clock.now() + timeout;
        loop {
            let now = self.shared.snapshot();
            if wanted(&now) || !time.step(deadline) {
                return now;
            }
        }
    }

    /// The error of a failed request.
    fn request_error(&self, what: &str, error: RequestError) -> ArmError {
        let kind = match &error {
            RequestError::Refused(_) | RequestError::WarmUp(_) | RequestError::StillStopping(_) => {
                ArmErrorKind::Rejected
            }
            RequestError::Unplugged(_) | RequestError::Connect(_) | RequestError::NoGateway => {
                ArmErrorKind::Disconnected
            }
            RequestError::Stopped(_) | RequestError::Gateway(_) | RequestError::Stuck(_) | RequestError::NoThread => {
                if self.shared.snapshot().unplugged.is_some() {
                    ArmErrorKind::Disconnected
                } else {
                    ArmErrorKind::Fault
                }
            }
        };
        let trip = if let RequestError::Stopped(latched) = &error { Some(latched.trip) } else { None };
        let text = format!("arm {}: {what}", self.info.name);
        // A source follows the text wherever the whole chain is printed: the text must not repeat it.
        let failed = match error {
            RequestError::Connect(_) | RequestError::Gateway(_) => ArmError::caused_by(kind, text, error),
            _ => ArmError::new(kind, format!("{text}: {error}")),
        };
        about(failed, trip)
    }

    fn error(&self, kind: ArmErrorKind, text: impl std::fmt::Display) -> ArmError {
        ArmError::new(kind, format!("arm {}: {text}", self.info.name))
    }

    /// Why no command reaches the arm, if it is stopped or its link is lost.
    fn stopped(&self, now: &ArmSnapshot) -> ArmError {
        if now.failed {
            return self.error(ArmErrorKind::Fault, crate::driver::FaultCause::Program);
        }
        if let Some(gone) = now.unplugged {
            return self.error(ArmErrorKind::Disconnected, gone);
        }
        match now.latched {
            Some(latched) => about(self.error(ArmErrorKind::Fault, latched.trip), Some(latched.trip)),
            None => self.error(ArmErrorKind::NotEnabled, format_args!("it is {}; enable it first", now.state)),
        }
    }

    /// Whether nothing of this command may be sent.
    fn refuse(&self, command: &JointCommand) -> Result<(), ArmError> {
        let JointCommand::Velocity(velocity) = command else { return Ok(()) };
        let sendable = ArmCommand::velocities(velocity, self.driver.supervision);
        sendable.map(|_| ()).map_err(|error| {
            let message = format!("arm {}: velocity refused, no axis was commanded", self.info.name);
            let refused = ArmError::caused_by(ArmErrorKind::Rejected, message, error);
            if let CodecError::SpeedRange { axis, .. } = error { refused.of_joint(axis.index()) } else { refused }
        })
    }

    /// The newest measurement: for an arm in control mode a fresh one, after a wait if necessary.
    fn newest(&self, command: &JointCommand) -> Result<JointState, ArmError> {
        let fresh = self.info.cycle.mul_f64(FRESH_CYCLES);
        let is_fresh =
            |now: &ArmSnapshot| now.sample_at.is_some_and(|at| self.clock.now().saturating_since(at) <= fresh);
        let snapshot = self.wait_for(self.info.cycle, |now| is_fresh(now) || !is_followed(now));
        if !is_followed(&snapshot) && (matches!(command, JointCommand::Velocity(_)) || is_gone(&snapshot)) {
            return Err(self.stopped(&snapshot));
        }
        match snapshot.joints {
            Some(joints) if is_fresh(&snapshot) || !is_followed(&snapshot) => Ok(joints),
            Some(joints) => {
                let age = self.clock.now().saturating_since(joints.at);
                Err(ArmError::late(Arc::clone(&self.name), age, self.info.cycle))
            }
            None => Err(self.stopped(&snapshot)),
        }
    }
}

fn check_cycles(arm: &str, driver: &DriverConfig, link: &GatewayLinkConfig) -> Result<(), ArmOpenError> {
    if driver.cycle == link.cycle {
        return Ok(());
    }
    Err(ArmOpenError::Cycles { arm: arm.to_owned(), driver: driver.cycle, link: link.cycle })
}

/// The thread of an arm, and the real-time requests that the system refused.
fn spawn(name: &str, worker: Worker, realtime: Realtime) -> Result<(JoinHandle<()>, Vec<Shortfall>), ArmOpenError> {
    let (shortfalls_out, shortfalls) = channel();
    let serve = move || {
        // The receiver exists until the thread has started.
        let _ = shortfalls_out.send(enter(&realtime));
        worker::run(worker);
    };
    let thread = std::thread::Builder::new().name(format!("arm {name}")).spawn(serve);
    let thread = thread.map_err(|source| ArmOpenError::Thread { arm: name.to_owned(), source })?;
    Ok((thread, shortfalls.recv_timeout(OPEN_MAX).unwrap_or_default()))
}

/// Adds to an error what the cause of the stop says: joint, alarm code, and whether commands may not reach the arm.
fn about(error: ArmError, trip: Option<Trip>) -> ArmError {
    let (axis, code) = (trip.and_then(|trip| trip.axis()), trip.and_then(|trip| trip.code()));
    let error = if trip.is_some_and(|trip| trip.may_still_move()) { error.out_of_reach() } else { error };
    let error = if let Some(axis) = axis { error.of_joint(axis.index()) } else { error };
    if let Some(code) = code { error.with_code(u16::from(code)) } else { error }
}

/// Whether velocities reach the arm.
fn is_followed(now: &ArmSnapshot) -> bool {
    now.state.has_open_brakes() && now.activity == Activity::None && !is_gone(now)
}

fn is_gone(now: &ArmSnapshot) -> bool {
    now.failed || now.unplugged.is_some()
}

impl Arm for Pa10Arm {
    fn info(&self) -> &ArmInfo {
        &self.info
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let result = self.refuse(&command).and_then(|()| {
            self.shared.put_command(self.clock.now(), command);
            self.newest(&command)
        });
        if result.is_err() {
            // Any error cancels the motion.
            self.shared.put_command(self.clock.now(), JointCommand::Hold);
        }
        result
    }
}

impl ArmPower for Pa10Arm {
    fn state(&self) -> ArmState {
        self.shared.snapshot().arm_state()
    }

    fn is_stopped_by_other(&self) -> bool {
        let now = self.shared.snapshot();
        let by_other = |latched: crate::driver::Latched| latched.trip.is_by_other_arm();
        !now.failed && now.latched.is_some_and(by_other)
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        let (done, failed) = match order {
            PowerOrder::Enable(_) => (self.fulfil(PowerRequest::Enable), NOT_ENABLED),
            PowerOrder::BeginEnable(_) => {
                self.enabling = Some(self.begin(PowerRequest::Enable));
                return Ok(Poll::Ready(()));
            }
            PowerOrder::PollEnable => match self.enabling {
                None if self.state() == ArmState::Enabled => return Ok(Poll::Ready(())),
                None => return Ok(Poll::Pending),
                Some((number, deadline)) => {
                    let Some(end) = self.ended(number, deadline) else { return Ok(Poll::Pending) };
                    self.enabling = None;
                    (end, NOT_ENABLED)
                }
            },
            PowerOrder::BeginStop => {
                self.begin(PowerRequest::Stop);
                return Ok(Poll::Ready(()));
            }
            PowerOrder::Stop => (self.fulfil(PowerRequest::Stop), "stopping"),
            PowerOrder::Reset if !matches!(self.state(), ArmState::Fault | ArmState::EStop) => {
                return Ok(Poll::Ready(()));
            }
            PowerOrder::Reset => (self.fulfil(PowerRequest::Reset), "it is not reset"),
        };
        done.map(Poll::Ready).map_err(|error| self.request_error(failed, error))
    }
}

impl Drop for Pa10Arm {
    fn drop(&mut self) {
        self.shared.release();
        self.trip.wake();
        let thread = match &mut self.work {
            Work::Thread(thread) => thread.take(),
            Work::Virtual(time) => {
                return time.release(&self.shared, self.clock.now() + RELEASE_MAX + self.driver.brake_time);
            }
        };
        let Some(thread) = thread else { return };
        // The program may end after this: the thread gets the time that it needs, unless it does not run.
        let reported_us = self.shared.snapshot().gateway.map_or(0, |hello| hello.brake_release_us);
        let brakes = self.driver.brake_time.max(Duration::from_micros(reported_us.into()));
        let deadline = self.clock.now() + RELEASE_MAX + brakes + Duration::from_millis(500);
        while !thread.is_finished() && self.clock.now() < deadline {
            std::thread::sleep(Duration::from_millis(1));
        }
        if thread.is_finished() {
            let _ = thread.join();
        }
    }
}
