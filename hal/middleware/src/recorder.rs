//! The flight recorder: the last exchanges with an arm, kept in memory until they are requested.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, JointCommand, JointState};

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
}

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
        Self { arm, clock, log, enabling_since: None }
    }

    /// The wrapped arm, read-only.
    pub fn arm(&self) -> &A {
        &self.arm
    }
}

impl<A: Arm + ArmPower> Recorded<A> {
    fn switch(
        &mut self,
        asked: RecordedRequest,
        act: impl FnOnce(&mut A) -> Result<(), ArmError>,
    ) -> Result<(), ArmError> {
        let at = self.clock.now();
        let result = act(&mut self.arm);
        self.note_switched(at, asked, result.as_ref().err().map(ArmError::kind));
        result
    }

    fn note_switched(&self, at: MonotonicTime, asked: RecordedRequest, failed: Option<ArmErrorKind>) {
        let answer = failed.map_or(Ok(None), Err);
        self.log.push(FlightEntry { at, done: self.clock.now(), asked, answer, state: self.arm.state() });
    }

    /// Enabling is one entry, from its start to its end.
    fn note_enabling<T>(&mut self, result: Result<T, ArmError>, is_done: impl Fn(&T) -> bool) -> Result<T, ArmError> {
        if result.as_ref().map_or(true, is_done)
            && let Some(since) = self.enabling_since.take()
        {
            self.note_switched(since, RecordedRequest::Enable, result.as_ref().err().map(ArmError::kind));
        }
        result
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

    fn enable(&mut self) -> Result<(), ArmError> {
        self.switch(RecordedRequest::Enable, A::enable)
    }

    fn begin_enable(&mut self) -> Result<(), ArmError> {
        self.enabling_since = Some(self.clock.now());
        let begun = self.arm.begin_enable();
        self.note_enabling(begun, |()| false)
    }

    fn poll_enable(&mut self) -> Result<bool, ArmError> {
        let polled = self.arm.poll_enable();
        self.note_enabling(polled, |is_on| *is_on)
    }

    fn begin_stop(&mut self) -> Result<(), ArmError> {
        self.arm.begin_stop()
    }

    fn stop(&mut self) -> Result<(), ArmError> {
        self.switch(RecordedRequest::Stop, A::stop)
    }

    fn reset(&mut self) -> Result<(), ArmError> {
        self.switch(RecordedRequest::Reset, A::reset)
    }
}
