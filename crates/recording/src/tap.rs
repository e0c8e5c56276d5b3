//! Everything that the thread which moves the arms receives, for the recording: answers and states of the arms, commands of the operator.
//!
//! Wrappers of both arms and of the operator put it into a ring of fixed size, which [`crate::steps`] empties on another thread. No
//! method of a wrapper waits or allocates; what finds the ring full is counted and left out.

use std::cell::Cell;
use std::sync::{Arc, Mutex};
use std::task::Poll;

use pb3dp_cell::operator::{MotionRequest, Operator};
use pb3dp_cell::parts::ArmControl;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, JointCommand, JointState, PowerOrder};
use pb3dp_hal_middleware::LimiterStatistics;
use pb3dp_servo::supervisor::{Decision, OperatorInput};
use rtrb::{Consumer, Producer, RingBuffer};

/// Events that wait for the recording: a second of control steps at 500 Hz.
const EVENTS_MAX: usize = 4096;

/// Something that the control thread has received.
#[derive(Clone, Copy, Debug)]
pub enum Event {
    /// An arm before the first step: its last measurement, its state, and whether it is stopped by the other arm.
    Enabled { arm: u8, joints: JointState, reported: (ArmState, bool) },
    /// A control step has begun.
    Listened { now: MonotonicTime, inputs: OperatorInput, carries_before_start: bool, lost: u32 },
    /// How the hand shall move in this step.
    Asked(MotionRequest),
    /// An arm tells another state than before.
    Changed { arm: u8, query: u32, reported: ArmReport },
    /// The control step has come to its end.
    Ended,
    /// An arm was called.
    Called { arm: u8, call: Call, answer: Answer },
}

/// What an arm tells of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ArmReport {
    /// State of drives and brakes.
    State(ArmState),
    /// Whether it is latched only because the other arm stopped.
    StoppedByOther(bool),
}

/// A call of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Call {
    /// One cycle.
    Exchange(JointCommand),
    /// An order to drives and brakes.
    Power(PowerOrder),
}

/// The answer to a call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer {
    /// It is done.
    Done,
    /// It is not done yet.
    Pending,
    /// The measured joints.
    Measured(JointState),
    /// It failed.
    Failed(ArmErrorKind),
}

/// The end of the ring on the control thread.
struct Tap {
    events: Producer<Event>,
    lost: u32,
    has_begun: bool,
    arms: [Before; 2],
}

/// The last report of an arm.
#[derive(Clone, Copy, Debug)]
struct Before {
    /// Last measurement before the first step.
    measured: Option<JointState>,
    /// Its state, and whether it is stopped by the other arm.
    reported: (ArmState, bool),
}

impl Tap {
    fn push(&mut self, event: Event) {
        if self.events.push(event).is_err() {
            self.lost = self.lost.saturating_add(1);
        }
    }
}

/// The shared end. One thread at a time uses it, so it is never contended; if it were, the event would be left out.
#[derive(Clone)]
struct SharedTap(Arc<Mutex<Tap>>);

impl SharedTap {
    fn with(&self, act: impl FnOnce(&mut Tap)) {
        if let Ok(mut tap) = self.0.try_lock() {
            act(&mut tap);
        }
    }
}

/// The parts of a run that the control thread hears.
pub struct RunInputs {
    /// The arm that carries the cameras.
    pub vs: Box<dyn ArmControl>,
    /// The arm that carries the target.
    pub tc: Box<dyn ArmControl>,
    /// The operator.
    pub operator: Box<dyn Operator>,
}

/// Wraps both arms and the operator of a run; returns the other end of the ring.
pub fn tap(inputs: RunInputs) -> (RunInputs, Consumer<Event>) {
    let (events, other_end) = RingBuffer::new(EVENTS_MAX);
    let before = Before { measured: None, reported: (ArmState::Disabled, false) };
    let tap = SharedTap(Arc::new(Mutex::new(Tap { events, lost: 0, has_begun: false, arms: [before; 2] })));
    let tapped = |inner, number| Box::new(TappedArm { inner, tap: tap.clone(), number, queries: Cell::new(0) });
    let (vs, tc) = (tapped(inputs.vs, 0), tapped(inputs.tc, 1));
    let operator = Box::new(TappedOperator { inner: inputs.operator, tap: tap.clone(), asked: Cell::default() });
    (RunInputs { vs, tc, operator }, other_end)
}

/// An arm whose answers are recorded.
struct TappedArm {
    inner: Box<dyn ArmControl>,
    tap: SharedTap,
    number: u8,
    /// Queries since the last call.
    queries: Cell<u32>,
}

impl TappedArm {
    fn reported(&self, reported: ArmReport) {
        let (arm, query) = (self.number, self.queries.get());
        self.queries.set(query + 1);
        self.tap.with(|tap| {
            let before = &mut tap.arms[usize::from(arm)].reported;
            let now = match reported {
                ArmReport::State(state) => (state, before.1),
                ArmReport::StoppedByOther(is) => (before.0, is),
            };
            if std::mem::replace(before, now) != now && tap.has_begun {
                tap.push(Event::Changed { arm, query, reported });
            }
        });
    }

    fn called<T>(
        &mut self,
        call: Call,
        answer: Result<T, ArmError>,
        meaning: impl FnOnce(&T) -> Answer,
    ) -> Result<T, ArmError> {
        self.queries.set(0);
        let reported = match &answer {
            Ok(answer) => meaning(answer),
            Err(error) => Answer::Failed(error.kind()),
        };
        self.tap.with(|tap| match reported {
            _ if tap.has_begun => tap.push(Event::Called { arm: self.number, call, answer: reported }),
            Answer::Measured(joints) => tap.arms[usize::from(self.number)].measured = Some(joints),
            _ => {}
        });
        answer
    }
}

impl Arm for TappedArm {
    fn info(&self) -> &ArmInfo {
        self.inner.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let answer = self.inner.exchange(command);
        self.called(Call::Exchange(command), answer, |joints| Answer::Measured(*joints))
    }
}

impl ArmPower for TappedArm {
    fn state(&self) -> ArmState {
        let state = self.inner.state();
        self.reported(ArmReport::State(state));
        state
    }

    fn is_stopped_by_other(&self) -> bool {
        let is = self.inner.is_stopped_by_other();
        self.reported(ArmReport::StoppedByOther(is));
        is
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        let answer = self.inner.power(order);
        let meaning = |progress: &Poll<()>| if progress.is_ready() { Answer::Done } else { Answer::Pending };
        self.called(Call::Power(order), answer, meaning)
    }
}

impl ArmControl for TappedArm {
    fn statistics(&self) -> LimiterStatistics {
        self.inner.statistics()
    }
}

/// An operator whose words are recorded.
struct TappedOperator {
    inner: Box<dyn Operator>,
    tap: SharedTap,
    asked: Cell<Option<MotionRequest>>,
}

impl Operator for TappedOperator {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let inputs = self.inner.listen(last, now);
        let carries_before_start = self.inner.carries_before_start();
        self.tap.with(|tap| {
            if !std::mem::replace(&mut tap.has_begun, true) {
                for (arm, Before { measured, reported }) in [0, 1].into_iter().zip(tap.arms) {
                    measured.into_iter().for_each(|joints| tap.push(Event::Enabled { arm, joints, reported }));
                }
            }
            let lost = tap.lost;
            let event = Event::Listened { now, inputs, carries_before_start, lost };
            if tap.events.push(event).is_ok() {
                tap.lost = 0;
            } else {
                tap.lost = tap.lost.saturating_add(1);
            }
        });
        inputs
    }

    fn show(&mut self, decision: &Decision) {
        self.inner.show(decision);
    }

    fn end_step(&mut self) {
        self.inner.end_step();
        self.tap.with(|tap| tap.push(Event::Ended));
    }

    fn tell(&mut self, trouble: Option<String>) {
        self.inner.tell(trouble);
    }

    fn motion(&self) -> MotionRequest {
        let motion = self.inner.motion();
        if self.asked.replace(Some(motion)) != Some(motion) {
            self.tap.with(|tap| tap.push(Event::Asked(motion)));
        }
        motion
    }

    fn answer(&mut self, result: String) {
        self.inner.answer(result);
    }

    fn is_person(&self) -> bool {
        self.inner.is_person()
    }

    fn carries_before_start(&self) -> bool {
        self.inner.carries_before_start()
    }

    fn can_fall_silent(&self) -> bool {
        self.inner.can_fall_silent()
    }
}
