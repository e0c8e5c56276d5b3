//! Records from a camera to a sequence folder at its full rate: capture never waits for the disk.
//!
//! The calling thread captures pairs into preallocated memory; a bounded queue passes them to threads that compress and write. A
//! pair without space in the queue is dropped and counted. Frames are numbered in the order of capture. If a frame cannot be
//! written, the recording ends, and the frames before it remain a valid sequence.

use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_record::dataset::{DatasetError, FrameFiles, SequenceSummary, SequenceWriter, WrittenFrame};

/// Timeout of one call for a pair, so that signals are handled.
pub(super) const CALL_TIMEOUT: Duration = Duration::from_millis(250);

/// Time without images, or number of periods if that is longer, after which the cameras count as failed.
pub(super) const CAMERA_TIMEOUT: Duration = Duration::from_secs(3);
const PATIENCE_PERIODS: u32 = 5;

/// End of a recording, and its resources.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    pub(super) pairs_max: Option<u64>,
    pub(super) time_max: Option<Duration>,
    /// Capacity of the queue, pairs.
    pub(super) queue: usize,
    /// Writing threads.
    pub(super) writers: usize,
}

/// Storage of a pair.
pub(super) type Save<'a> = dyn Fn(&FrameFiles, &FramePair) -> Result<(), DatasetError> + Sync + 'a;

/// Losses of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Missing {
    /// No space in the queue: the disk or the processor was too slow.
    pub(super) queue: u64,
    /// The cameras did not deliver the pairs, or the pairs were refused.
    pub(super) cameras: u64,
}

/// Result of a recording.
#[derive(Debug)]
pub(super) struct Outcome {
    /// The files; `None` if nothing was written, or the sequence could not be completed.
    pub(super) summary: Option<SequenceSummary>,
    /// Time from the first to the last captured pair, seconds.
    pub(super) seconds: f64,
    pub(super) missing: Missing,
    /// The last error of the cameras.
    pub(super) complaint: Option<String>,
    /// Why the recording ended early.
    pub(super) failure: Option<Failure>,
}

/// Why a recording ends early.
#[derive(Debug)]
pub(super) enum Failure {
    Camera(CameraError),
    Disk(DatasetError),
    Thread(std::io::Error),
}

/// A captured pair that waits to be written.
struct Slot {
    number: u64,
    files: Option<FrameFiles>,
    pair: FramePair,
}

/// The first frame that could not be written.
#[derive(Default)]
struct Broken {
    /// Its number, readable without the lock.
    number: AtomicU64,
    error: Mutex<Option<(u64, DatasetError)>>,
}

impl Broken {
    fn new() -> Self {
        Self { number: AtomicU64::new(u64::MAX), error: Mutex::new(None) }
    }

    fn number(&self) -> u64 {
        self.number.load(Ordering::SeqCst)
    }

    fn note(&self, number: u64, error: DatasetError) {
        let mut first = self.error.lock().unwrap_or_else(PoisonError::into_inner);
        if first.as_ref().is_none_or(|(known, _)| number < *known) {
            *first = Some((number, error));
            self.number.store(number, Ordering::SeqCst);
        }
    }

    fn into_error(self) -> Option<(u64, DatasetError)> {
        self.error.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Records until the plan is fulfilled, `is_over` returns true, or an error occurs.
pub(super) fn record(
    camera: &mut dyn StereoCamera,
    clock: &dyn Clock,
    mut writer: SequenceWriter,
    plan: &Plan,
    save: &Save<'_>,
    is_over: &mut dyn FnMut() -> bool,
) -> Outcome {
    let size = camera.info().size;
    // One more than the queue holds: the one that is being filled.
    let (give_empty, empty) = sync_channel(plan.queue + 1);
    let (full, take_full) = sync_channel(plan.queue + 1);
    let (broken, take_full) = (Broken::new(), Mutex::new(take_full));
    let mut taking = Taking {
        clock,
        plan,
        broken: &broken,
        empty,
        full,
        current: Box::new(Slot { number: 0, files: None, pair: FramePair::black(size) }),
        times: None,
        last_sequence: None,
        missing: Missing::default(),
        complaint: None,
    };
    for _ in 0..plan.queue {
        // There is space for all of them.
        let _ = give_empty.try_send(Box::new(Slot { number: 0, files: None, pair: FramePair::black(size) }));
    }
    let (failure, taken) = std::thread::scope(|scope| {
        for _ in 0..plan.writers.max(1) {
            let (give_empty, take_full, broken) = (give_empty.clone(), &take_full, &broken);
            let write = move || write_all(take_full, &give_empty, broken, save);
            if let Err(error) = std::thread::Builder::new().name("record".to_owned()).spawn_scoped(scope, write) {
                return (Some(Failure::Thread(error)), taking.end());
            }
        }
        let failure = taking.run(camera, &mut writer, is_over);
        // Dropping the sender closes the queue: the writers finish what is queued.
        (failure, taking.end())
    });
    let Taken { seconds, missing, complaint } = taken;
    let broken = broken.into_error();
    let failure = broken.map_or(failure, |(number, error)| {
        writer.keep(number);
        Some(Failure::Disk(error))
    });
    let (summary, failure) = match (writer.frames(), failure) {
        (0, failure) => (None, failure),
        (_, failure) => match writer.finish() {
            Ok(summary) => (Some(summary), failure),
            Err(error) => (None, Some(failure.unwrap_or(Failure::Disk(error)))),
        },
    };
    Outcome { summary, seconds, missing, complaint, failure }
}

/// The capturing thread.
struct Taking<'a> {
    clock: &'a dyn Clock,
    plan: &'a Plan,
    broken: &'a Broken,
    empty: Receiver<Box<Slot>>,
    full: SyncSender<Box<Slot>>,
    current: Box<Slot>,
    /// Times of the first and the last pair, seconds.
    times: Option<(f64, f64)>,
    last_sequence: Option<u64>,
    missing: Missing,
    complaint: Option<String>,
}

/// Result of the capturing thread.
struct Taken {
    seconds: f64,
    missing: Missing,
    complaint: Option<String>,
}

impl Taking<'_> {
    fn run(
        &mut self,
        camera: &mut dyn StereoCamera,
        writer: &mut SequenceWriter,
        is_over: &mut dyn FnMut() -> bool,
    ) -> Option<Failure> {
        let begin = self.clock.now();
        let mut heartbeat_at = begin;
        let patience = CAMERA_TIMEOUT.max(camera.info().period.unwrap_or_default() * PATIENCE_PERIODS);
        let is_done = |writer: &SequenceWriter| self.plan.pairs_max.is_some_and(|max| writer.frames() >= max);
        while !is_done(writer) && self.broken.number() == u64::MAX && !is_over() {
            if self.plan.time_max.is_some_and(|max| self.clock.now().saturating_since(begin) >= max) {
                break;
            }
            match camera.next_pair_into(&mut self.current.pair, CALL_TIMEOUT) {
                Ok(()) => {
                    heartbeat_at = self.clock.now();
                    if let Err(error) = self.hand_over(writer) {
                        return Some(Failure::Disk(error));
                    }
                }
                Err(error) => {
                    let goes_on = matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair);
                    let text = error.with_causes();
                    if self.complaint.is_none() {
                        tracing::warn!("{text}");
                    }
                    self.complaint = Some(text);
                    if !goes_on || self.clock.now().saturating_since(heartbeat_at) >= patience {
                        return Some(Failure::Camera(error));
                    }
                }
            }
        }
        None
    }

    /// Queues the captured pair, if there is space.
    fn hand_over(&mut self, writer: &mut SequenceWriter) -> Result<(), DatasetError> {
        let pair = &self.current.pair;
        let before = self.last_sequence.replace(pair.sequence);
        self.missing.cameras += before.map_or(0, |before| pair.sequence.saturating_sub(before + 1));
        let at_s = pair.exposed_at.as_secs_f64();
        self.times = Some((self.times.map_or(at_s, |(first, _)| first), at_s));
        let Ok(empty) = self.empty.try_recv() else {
            if self.missing.queue == 0 {
                tracing::warn!("pairs are left out: {} wait to be written", self.plan.queue);
            }
            self.missing.queue += 1;
            return Ok(());
        };
        self.current.number = writer.frames();
        self.current.files = Some(writer.accept(&WrittenFrame {
            left: &pair.left,
            right: &pair.right,
            exposed_at: pair.exposed_at,
            skew_nanos: pair.skew_nanos,
            cam_left_from_model: None,
        })?);
        // There is space for all slots, and the writers outlive this end.
        let _ = self.full.try_send(std::mem::replace(&mut self.current, empty));
        Ok(())
    }

    fn end(self) -> Taken {
        let seconds = self.times.map_or(0.0, |(first, last)| last - first);
        Taken { seconds, missing: self.missing, complaint: self.complaint }
    }
}

/// A writing thread: runs until the queue is closed and empty.
fn write_all(
    take_full: &Mutex<Receiver<Box<Slot>>>,
    give_empty: &SyncSender<Box<Slot>>,
    broken: &Broken,
    save: &Save<'_>,
) {
    loop {
        let taken = take_full.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok(mut slot) = taken else { return };
        if let Some(files) = slot.files.take().filter(|_| slot.number < broken.number())
            && let Err(error) = save(&files, &slot.pair)
        {
            broken.note(slot.number, error);
        }
        // After the end of the recording nobody uses the slot.
        let _ = give_empty.try_send(slot);
    }
}
