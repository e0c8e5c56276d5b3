//! The flight recorder: the last exchanges with an arm, kept in memory until they are requested.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{
    Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, JointCommand, JointState, PowerOrder,
};

/// One exchange, or one operation of drives and brakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlightEntry {
    /// Start time.
    pub at: MonotonicTime,
    /// End time.
    pub done: MonotonicTime,
    /// The request.
    pub asked: RecordedRequest,
    /// The result: measured joints of an exchange, or the kind of the error.
    pub answer: Result<Option<JointState>, ArmErrorKind>,
    /// State of drives and brakes afterwards.
    pub state: ArmState,
}

/// A request to an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RecordedRequest {
    /// An exchange with this command.
    Exchange(JointCommand),
    /// Enable.
    Enable,
    /// Stop and disable.
    Stop,
    /// Reset.
    Reset,
}

/// The last entries of an arm. Clones share the same entries.
#[derive(Clone)]
pub struct FlightLog {
    ring: Arc<Mutex<VecDeque<FlightEntry>>>,
    capacity: usize,
}

/// Records the exchanges with an arm, as many as the log holds. Nothing is allocated after construction.
///
/// Use it directly around a backend, so that it sees the commands after every wrapper.
pub struct Recorded<A> {
    arm: A,
    clock: Arc<dyn Clock>,
    log: FlightLog,
    /// Time since which the arm is being enabled.
    enabling_since: Option<MonotonicTime>,
    listener: Option<SampleListener>,
}

/// Gets each measurement of an arm in the thread of the exchange: it must not wait.
pub type SampleListener = Box<dyn FnMut(&JointState) + Send>;

impl FlightLog {
    /// An empty log for this number of entries, at least 1.
    pub fn with_capacity(entries: usize) -> Self {
        let capacity = entries.max(1);
        Self { ring: Arc::new(Mutex::new(VecDeque::with_capacity(capacity))), capacity }
    }

    /// The entries, oldest first.
    pub fn entries(&self) -> Vec<FlightEntry> {
        self.ring().iter().copied().collect()
    }

    fn ring(&self) -> MutexGuard<'_, VecDeque<FlightEntry>> {
        self.ring.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push(&self, entry: FlightEntry) {
        let mut ring = self.ring();
        if ring.len() == self.capacity {
            ring.pop_front();
        }
        ring.push_back(entry);
    }
}

impl<A> Recorded<A> {
    /// Records the exchanges with `arm` in `log`, with the times of `clock`.
    pub fn new(arm: A, clock: Arc<dyn Clock>, log: FlightLog) -> Self {
        Self { arm, clock, log, enabling_since: None, listener: None }
    }

    /// Also passes each measurement to this listener.
    #[must_use]
    pub fn with_listener(self, listener: Option<SampleListener>) -> Self {
        Self { listener, ..self }
    }

    /// The wrapped arm, read-only.
    pub fn arm(&self) -> &A {
        &self.arm
    }
}

impl<A: Arm + ArmPower> Arm for Recorded<A> {
    fn info(&self) -> &ArmInfo {
        self.arm.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let at = self.clock.now();
        let result = self.arm.exchange(command);
        let answer = result.as_ref().map(|sample| Some(*sample)).map_err(ArmError::kind);
        let asked = RecordedRequest::Exchange(command);
        self.log.push(FlightEntry { at, done: self.clock.now(), asked, answer, state: self.arm.state() });
        if let (Ok(sample), Some(listener)) = (&result, &mut self.listener) {
            listener(sample);
        }
        result
    }
}

impl<A: Arm + ArmPower> ArmPower for Recorded<A> {
    fn state(&self) -> ArmState {
        self.arm.state()
    }

    fn is_stopped_by_other(&self) -> bool {
        self.arm.is_stopped_by_other()
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        let at = self.clock.now();
        if let PowerOrder::BeginEnable(_) = order {
            self.enabling_since = Some(at);
        }
        let result = self.arm.power(order);
        let ended = match order {
            PowerOrder::Enable(_) => Some((at, RecordedRequest::Enable)),
            // Enabling is one entry, from its start to its end.
            PowerOrder::BeginEnable(_) if result.is_ok() => None,
            PowerOrder::PollEnable if matches!(result, Ok(Poll::Pending)) => None,
            PowerOrder::BeginEnable(_) | PowerOrder::PollEnable => {
                self.enabling_since.take().map(|since| (since, RecordedRequest::Enable))
            }
            PowerOrder::BeginStop => None,
            PowerOrder::Stop => Some((at, RecordedRequest::Stop)),
            PowerOrder::Reset => Some((at, RecordedRequest::Reset)),
        };
        if let Some((at, asked)) = ended {
            let answer = result.as_ref().map(|_| None).map_err(ArmError::kind);
            self.log.push(FlightEntry { at, done: self.clock.now(), asked, answer, state: self.arm.state() });
        }
        result
    }
}
