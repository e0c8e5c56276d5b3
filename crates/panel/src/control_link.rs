//! Commands on their way to the control thread. That end never waits, locks or allocates; all other ends belong to threads that may wait.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use pb3dp_cell::handover::{LatestConsumer, LatestProducer, latest};
use pb3dp_geometry::frames::Hand;
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_servo::supervisor::{Decision, OperatorCommand};
use rtrb::{Consumer, Producer, RingBuffer};

/// Commands that no control step has taken yet; `stop`, `hold` and `hold hand` need no space in this queue.
pub const COMMANDS_MAX: usize = 16;
/// Results and troubles that the reporting thread has not read yet.
const RESULTS_MAX: usize = 64;
const TROUBLES_MAX: usize = 16;

/// A command on its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GivenCommand {
    /// Number of the command, from 1.
    pub id: u64,
    /// The command.
    pub command: OperatorCommand,
    /// Time at which the panel received it.
    pub at: MonotonicTime,
    /// State number that the operator saw; the control thread refuses the command in another state.
    pub shown_state: u64,
}

/// What became of a command.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "the control thread allocates nothing, so no variant is boxed")]
pub enum Outcome {
    /// The supervisor has decided.
    Decided(Decision),
    /// The state changed before a control step took it.
    OtherState,
    /// A later `stop` or `hold` overtook it.
    Overtaken,
    /// It waited while this program was suspended.
    Suspended,
}

/// A command with its outcome.
#[derive(Clone, Copy, Debug)]
pub struct TakenCommand {
    /// Number of the command.
    pub id: u64,
    /// The command.
    pub command: OperatorCommand,
    /// What became of it.
    pub outcome: Outcome,
    /// State number afterwards.
    pub number: u64,
    /// Wall-clock time of the control step.
    pub taken_at: Instant,
}

/// The newest decision.
#[derive(Clone, Copy, Debug)]
pub struct ShownDecision {
    /// The decision.
    pub decision: Decision,
    /// State number after it.
    pub number: u64,
}

/// Slot for a command that is never refused for lack of space; holds its last request.
#[derive(Debug, Default)]
pub struct UrgentSlot {
    /// Number of the command; 0 after it was taken.
    id: AtomicU64,
    requested_nanos: AtomicU64,
}

impl UrgentSlot {
    /// Gives the command.
    pub fn give(&self, id: u64, at: MonotonicTime) {
        self.requested_nanos.store(at.as_nanos(), Ordering::SeqCst);
        self.id.fetch_max(id, Ordering::SeqCst);
    }

    /// Takes the command, if there is one.
    pub fn take(&self) -> Option<(u64, MonotonicTime)> {
        match self.id.swap(0, Ordering::SeqCst) {
            0 => None,
            id => Some((id, MonotonicTime::from_nanos(self.requested_nanos.load(Ordering::SeqCst)))),
        }
    }
}

/// State shared with the control thread.
pub struct ControlLink {
    /// `stop`.
    pub stop: UrgentSlot,
    /// `hold`, every arm.
    pub hold: UrgentSlot,
    /// `hold hand`.
    pub hold_hand: UrgentSlot,
    /// Time of the last sign of life plus one, nanoseconds; 0: none.
    heartbeat_nanos: AtomicU64,
    /// Share of the velocity, bits of an `f64`.
    speed_share_bits: AtomicU64,
    /// Number of commands so far.
    commands: AtomicU64,
    /// State number.
    pub number: AtomicU64,
    /// Whether an arm may move.
    pub may_move: AtomicBool,
    /// Whether an arm moves, or may begin to move without a command.
    pub may_begin_to_move: AtomicBool,
    /// Commands are accepted: both arms are enabled.
    pub has_begun: AtomicBool,
    /// The control thread is gone.
    pub is_over: AtomicBool,
    give: Mutex<Producer<GivenCommand>>,
    jog: Mutex<LatestProducer<Pose<Hand, Hand>>>,
}

/// The ends of the control thread.
pub struct ControlEnds {
    pub(crate) commands: Consumer<GivenCommand>,
    pub(crate) jog: LatestConsumer<Pose<Hand, Hand>>,
    pub(crate) shown: LatestProducer<ShownDecision>,
    pub(crate) results: Producer<TakenCommand>,
    pub(crate) troubles: Producer<Option<String>>,
}

/// The ends of the reporting thread.
pub struct ReportingEnds {
    pub(crate) shown: LatestConsumer<ShownDecision>,
    pub(crate) results: Consumer<TakenCommand>,
    pub(crate) troubles: Consumer<Option<String>>,
}

impl ControlLink {
    /// All ends.
    pub fn new() -> (Self, ControlEnds, ReportingEnds) {
        let (give, commands) = RingBuffer::new(COMMANDS_MAX);
        let (give_jog, jog) = latest();
        let (give_shown, shown) = latest();
        let (give_results, results) = RingBuffer::new(RESULTS_MAX);
        let (give_troubles, troubles) = RingBuffer::new(TROUBLES_MAX);
        let link = Self {
            stop: UrgentSlot::default(),
            hold: UrgentSlot::default(),
            hold_hand: UrgentSlot::default(),
            heartbeat_nanos: AtomicU64::new(0),
            speed_share_bits: AtomicU64::new(1.0_f64.to_bits()),
            commands: AtomicU64::new(0),
            number: AtomicU64::new(1),
            may_move: AtomicBool::new(false),
            may_begin_to_move: AtomicBool::new(false),
            has_begun: AtomicBool::new(false),
            is_over: AtomicBool::new(false),
            give: Mutex::new(give),
            jog: Mutex::new(give_jog),
        };
        let control = ControlEnds { commands, jog, shown: give_shown, results: give_results, troubles: give_troubles };
        (link, control, ReportingEnds { shown, results, troubles })
    }

    /// A new number of a command.
    pub fn next_id(&self) -> u64 {
        self.commands.fetch_add(1, Ordering::SeqCst) + 1
    }

    /// Queues a command; returns false if the queue is full.
    pub fn queue(&self, command: GivenCommand) -> bool {
        self.give.lock().unwrap_or_else(PoisonError::into_inner).push(command).is_ok()
    }

    /// The slot of a command that only ends motion.
    pub fn slot_of(&self, command: OperatorCommand) -> Option<&UrgentSlot> {
        match command {
            OperatorCommand::Stop => Some(&self.stop),
            OperatorCommand::Hold => Some(&self.hold),
            OperatorCommand::HoldHand => Some(&self.hold_hand),
            OperatorCommand::Select
            | OperatorCommand::Start
            | OperatorCommand::Resume
            | OperatorCommand::Realign
            | OperatorCommand::Reset => None,
        }
    }

    /// Holds every arm, on behalf of the panel itself.
    pub fn hold_every_arm(&self, at: MonotonicTime) {
        self.hold.give(self.next_id(), at);
    }

    /// Sets the last sign of life.
    pub fn set_heartbeat_at(&self, heartbeat_at: Option<MonotonicTime>) {
        let nanos = heartbeat_at.map_or(0, |at| at.as_nanos().saturating_add(1));
        self.heartbeat_nanos.store(nanos, Ordering::SeqCst);
    }

    /// The last sign of life.
    pub fn heartbeat_at(&self) -> Option<MonotonicTime> {
        self.heartbeat_nanos.load(Ordering::SeqCst).checked_sub(1).map(MonotonicTime::from_nanos)
    }

    /// Sets the share of the velocity.
    pub fn set_speed_share(&self, share: f64) {
        self.speed_share_bits.store(share.to_bits(), Ordering::SeqCst);
    }

    /// The share of the velocity.
    pub fn speed_share(&self) -> f64 {
        f64::from_bits(self.speed_share_bits.load(Ordering::SeqCst))
    }

    /// Sets the offset of the desired pose of the hand.
    pub fn set_jog(&self, hand_from_hand_shifted: Pose<Hand, Hand>) {
        self.jog.lock().unwrap_or_else(PoisonError::into_inner).give(hand_from_hand_shifted);
    }
}
