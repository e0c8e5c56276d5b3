//! Requests of an operator, step by step: each takes several activities of the driver.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::StatusSignals;
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, HelloReply, RejectReason, StopCause};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::transport::{ConnectError, Unplugged};

use super::gateway_port::{GatewayPort, Greeted};
use super::shared::PowerRequest;
use crate::driver::{
    Activity, Driver, DriverState, EmergencyStopCause, FaultCause, Latched, Refusal, Request, Sample, Trip,
    WarmUpFailure,
};
use crate::link::HelloError;

/// Additional cycles by which the host waits for the brakes: the gateway starts its time later.
const BRAKE_MARGIN_CYCLES: u32 = 3;

/// Time between two requests to a gateway that still stops its arm.
const ASK_AGAIN: Duration = Duration::from_millis(50);

/// A gateway has stopped its arm after the brake time and this.
const STOP_MAX: Duration = Duration::from_secs(1);

/// Why a request failed.
#[derive(Debug, thiserror::Error)]
pub enum RequestError {
    /// Not possible in this state.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The arm is stopped.
    #[error("{}", .0.trip)]
    Stopped(Latched),
    /// The link is not reliable enough for open brakes.
    #[error("the brakes stay closed: {0}")]
    WarmUp(WarmUpFailure),
    /// The gateway does not answer.
    #[error(
        "no gateway answers within 0.5 s; check the number of the arm (`gateway.arm`, `arm.number` in the gateway's file) and the log of \
         the gateway; on a serial line also its power, the cable and the rate, and that no other program uses the line"
    )]
    NoGateway,
    /// The gateway is not the configured one.
    #[error(transparent)]
    Gateway(HelloError),
    /// The stop order of the gateway takes too long.
    #[error("the gateway is still stopping the arm after {0:?}; try again in a second, and check the gateway's log")]
    StillStopping(Duration),
    /// The link cannot be opened again.
    #[error("the link cannot be opened")]
    Connect(#[source] ConnectError),
    /// The link is lost.
    #[error(transparent)]
    Unplugged(#[from] Unplugged),
    /// The thread of the arm does not answer.
    #[error(
        "the thread that monitors the arm does not answer: a defect of pb3dp; report it with the log, and start the program \
         again"
    )]
    NoThread,
    /// The driver did not execute the request.
    #[error("the driver stays {0}: a defect of pb3dp; report it with the log")]
    Stuck(DriverState),
}

/// Progress of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Not started.
    New,
    /// HELLO was sent.
    Greeting,
    /// The driver executes the activity of this request.
    Asked,
    /// The gateway still stops the arm: the next request is at this time.
    Pausing(MonotonicTime),
}

/// A request in progress.
#[derive(Debug)]
pub(super) struct Running {
    pub number: u64,
    request: PowerRequest,
    stage: Stage,
    /// Time since which the gateway has been stopping the arm.
    stopping: Option<MonotonicTime>,
}

/// Resources of a request.
pub(super) struct RequestContext<'a> {
    pub driver: &'a mut Driver,
    pub port: &'a mut GatewayPort,
    /// Clock of the host.
    pub cycle: Duration,
}

impl Running {
    pub fn new(number: u64, request: PowerRequest) -> Self {
        Self { number, request, stage: Stage::New, stopping: None }
    }

    /// Does the next step. `Some` when the request has succeeded or failed.
    pub fn advance(
        &mut self,
        now: MonotonicTime,
        context: &mut RequestContext<'_>,
    ) -> Option<Result<(), RequestError>> {
        let done = match self.request {
            PowerRequest::Connect => self.connect(now, context),
            PowerRequest::Enable => self.enable(now, context),
            PowerRequest::Stop => self.stop(now, context),
            PowerRequest::Reset => self.reset(now, context),
            PowerRequest::Look => self.look(now, context),
        };
        done.transpose()
    }

    /// `Ok(Some(()))` when done, `Ok(None)` if it continues.
    fn connect(&mut self, now: MonotonicTime, context: &mut RequestContext<'_>) -> Result<Option<()>, RequestError> {
        match self.stage {
            Stage::New => {
                context.port.greet(now);
                self.stage = Stage::Greeting;
            }
            // Another arm has answered, or another arm of the workcell has stopped.
            Stage::Greeting if is_stopped_from_elsewhere(context.driver) => return Err(stopped(context.driver)),
            Stage::Pausing(until) => self.ask_again(now, until, context),
            Stage::Greeting => {
                if greeted(now, context)? {
                    if context.port.hello().is_some_and(|hello| is_stopping(hello.state)) {
                        self.pause(now, context)?;
                        return Ok(None);
                    }
                    if let Some(trip) = context
                        .port
                        .hello()
                        .and_then(|hello| stopped_before(hello, context.port.shown(), context.driver.signals()))
                    {
                        // The operator has to see and reset it.
                        context.driver.handle_trip(now, trip);
                    }
                    // The gateway may also have reported the change without a request.
                    if context.driver.state().is_latched() {
                        return Ok(Some(()));
                    }
                    context.driver.handle_request(now, Request::Connect)?;
                    self.stage = Stage::Asked;
                }
            }
            Stage::Asked if context.driver.activity() != Activity::None => {}
            Stage::Asked => return Ok(Some(())),
        }
        check_connected(context)?;
        Ok(None)
    }

    /// Connects a connected arm again.
    fn look(&mut self, now: MonotonicTime, context: &mut RequestContext<'_>) -> Result<Option<()>, RequestError> {
        if self.stage == Stage::New {
            if context.driver.activity() != Activity::None {
                return Ok(None);
            }
            check_connected(context)?;
            match context.driver.state() {
                DriverState::Fault | DriverState::EStop => return Err(stopped(context.driver)),
                DriverState::Disconnected => {}
                // The driver refuses with its reason if the control mode is on.
                _ => context.driver.handle_request(now, Request::Disconnect)?,
            }
        }
        self.connect(now, context)
    }

    fn enable(&mut self, now: MonotonicTime, context: &mut RequestContext<'_>) -> Result<Option<()>, RequestError> {
        let driver = &mut *context.driver;
        if driver.activity() != Activity::None {
            return Ok(None);
        }
        let request = match (driver.state(), self.stage) {
            (DriverState::Holding | DriverState::Moving, Stage::Asked) => return Ok(Some(())),
            // The driver refuses with its reason.
            (DriverState::Holding | DriverState::Moving, _) => Request::Enable,
            (DriverState::Fault | DriverState::EStop, _) => return Err(stopped(driver)),
            (DriverState::Disconnected, _) => Request::Connect,
            (DriverState::Connected, Stage::Asked) => {
                return Err(driver
                    .warm_up_failure()
                    .map_or(RequestError::Stuck(driver.state()), |why| RequestError::WarmUp(*why)));
            }
            (DriverState::Connected, _) => {
                self.stage = Stage::Asked;
                Request::Enable
            }
            (DriverState::Enabled, _) => {
                self.stage = Stage::Asked;
                Request::ReleaseBrakes
            }
        };
        driver.handle_request(now, request)?;
        Ok(None)
    }

    fn stop(&mut self, now: MonotonicTime, context: &mut RequestContext<'_>) -> Result<Option<()>, RequestError> {
        if self.stage == Stage::New {
            context.driver.handle_request(now, Request::Stop)?;
            self.stage = Stage::Asked;
        }
        // Nobody would hear the rest of the order.
        check_connected(context)?;
        Ok((context.driver.activity() == Activity::None).then_some(()))
    }

    fn reset(&mut self, now: MonotonicTime, context: &mut RequestContext<'_>) -> Result<Option<()>, RequestError> {
        if context.driver.activity() != Activity::None {
            // It is stopping, or being cleared.
            return Ok(None);
        }
        match self.stage {
            Stage::New if !context.driver.state().is_latched() => {
                // The driver refuses with its reason.
                context.driver.handle_request(now, Request::Reset)?;
                return Ok(Some(()));
            }
            Stage::New => {
                if context.port.gone().is_some() {
                    context.port.reopen().map_err(RequestError::Connect)?;
                }
                context.port.greet(now);
                self.stage = Stage::Greeting;
            }
            Stage::Pausing(until) => self.ask_again(now, until, context),
            Stage::Greeting => {
                if greeted(now, context)? {
                    context.driver.handle_request(now, Request::Reset)?;
                    self.stage = Stage::Asked;
                }
            }
            // After a dead host the gateway needs time, and refuses until then.
            Stage::Asked if is_refused_while_stopping(context.driver) => self.pause(now, context)?,
            Stage::Asked if context.driver.state().is_latched() => return Err(stopped(context.driver)),
            Stage::Asked => return Ok(Some(())),
        }
        check_connected(context)?;
        Ok(None)
    }
}

impl Running {
    /// Waits for the end of the gateway's stop order, for a limited time.
    fn pause(&mut self, now: MonotonicTime, context: &RequestContext<'_>) -> Result<(), RequestError> {
        let brakes =
            context.port.hello().map_or(Duration::ZERO, |hello| Duration::from_micros(hello.brake_release_us.into()));
        let waited = now.saturating_since(*self.stopping.get_or_insert(now));
        if waited > brakes + STOP_MAX {
            return Err(RequestError::StillStopping(waited));
        }
        self.stage = Stage::Pausing(now + ASK_AGAIN);
        Ok(())
    }

    fn ask_again(&mut self, now: MonotonicTime, until: MonotonicTime, context: &mut RequestContext<'_>) {
        if now >= until {
            context.port.greet_again(now);
            self.stage = Stage::Greeting;
        }
    }
}

/// Whether another cause than the gateway has stopped the arm.
fn is_stopped_from_elsewhere(driver: &Driver) -> bool {
    let by_gateway = |latched: &Latched| {
        matches!(
            latched.trip,
            Trip::EStop(_)
                | Trip::Fault(
                    FaultCause::Gateway(_)
                        | FaultCause::GatewayLimit { .. }
                        | FaultCause::ServoAlarm { .. }
                        | FaultCause::ControllerAlarm { .. }
                )
        )
    };
    driver.latched().is_some_and(|latched| !by_gateway(latched))
}

/// Whether a gateway stops its arm, or will as soon as it detects the loss of the previous host.
fn is_stopping(state: GatewayState) -> bool {
    matches!(state, GatewayState::Holding | GatewayState::Moving | GatewayState::Stopping)
}

/// Whether a reset failed because the gateway was not reachable yet.
fn is_refused_while_stopping(driver: &Driver) -> bool {
    let refused = Trip::Fault(FaultCause::Rejected(RejectReason::WrongState));
    driver.state().is_latched() && driver.latched().is_some_and(|latched| latched.trip == refused)
}

/// Whether the other side was greeted and is the right one.
fn greeted(now: MonotonicTime, context: &mut RequestContext<'_>) -> Result<bool, RequestError> {
    match context.port.greeted(now) {
        Greeted::Waiting => Ok(false),
        Greeted::Silent => {
            check_connected(context)?;
            Err(RequestError::NoGateway)
        }
        Greeted::Refused(error) => Err(RequestError::Gateway(error)),
        Greeted::Done => {
            if let Some(hello) = context.port.hello() {
                let brakes = Duration::from_micros(u64::from(hello.brake_release_us));
                context.driver.raise_brake_time(brakes + context.cycle * BRAKE_MARGIN_CYCLES);
            }
            Ok(true)
        }
    }
}

/// Why the gateway stopped the arm before this host connected, if it did: for example after a dead host.
fn stopped_before(hello: &HelloReply, shown: Option<&Sample>, signals: &StatusSignals) -> Option<Trip> {
    // Status words name switch, axis and alarm.
    let named = shown.and_then(|sample| sample.condition.trip(signals));
    match (hello.state, hello.cause) {
        (GatewayState::EmergencyStop, _) | (_, StopCause::EmergencyStop) => {
            let emergency_stop = named.filter(|trip| matches!(trip, Trip::EStop(_)));
            Some(emergency_stop.unwrap_or(Trip::EStop(EmergencyStopCause::Gateway)))
        }
        (_, StopCause::None) => None,
        (_, cause) => {
            let is_alarm = |trip: &Trip| match cause {
                StopCause::ServoAlarm => matches!(trip, Trip::Fault(FaultCause::ServoAlarm { .. })),
                StopCause::ControllerAlarm => matches!(trip, Trip::Fault(FaultCause::ControllerAlarm { .. })),
                _ => false,
            };
            Some(named.filter(is_alarm).unwrap_or(Trip::Fault(FaultCause::Gateway(cause))))
        }
    }
}

fn check_connected(context: &RequestContext<'_>) -> Result<(), RequestError> {
    context.port.gone().map_or(Ok(()), |gone| Err(gone.into()))
}

fn stopped(driver: &Driver) -> RequestError {
    driver.latched().map_or(RequestError::Stuck(driver.state()), |latched| RequestError::Stopped(*latched))
}
