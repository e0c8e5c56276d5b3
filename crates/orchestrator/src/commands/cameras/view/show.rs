//! The cameras of the page: captures pairs, encodes them as JPEG in parallel, and sets controls between two pairs.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use anyhow::{Context, Result};
use hyper::body::Bytes;
use pb3dp_camera_v4l2::{Side, StreamCounters, V4l2StereoCamera};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FramePair, StereoCamera, StereoCameraInfo};
use pb3dp_record::images::{StoredFormat, encode};
use serde::Serialize;
use tokio::sync::{oneshot, watch};

use super::super::list::ControlLine;

/// Capacity of the queue of requests to the cameras.
pub(super) const ASKS_MAX: usize = 16;

/// Time-out of one call for a pair, so that requests and signals are handled; a number of periods for slow cameras.
const PATIENCE_OF_A_CALL: Duration = Duration::from_millis(250);
const PATIENCE_PERIODS: u32 = 3;

/// Time between two attempts to open disconnected cameras.
const REOPEN: Duration = Duration::from_millis(500);

/// Number of pairs for the measured rate.
const WINDOW: usize = 60;

/// Quality of the JPEGs of the page.
const QUALITY: u8 = 80;

/// State for the page and for `/state`.
#[derive(Clone, Debug, Serialize)]
pub(super) struct State {
    cameras: String,
    width_px: u32,
    height_px: u32,
    /// The agreed mode.
    asked_hz: Option<f64>,
    /// Pairs since the start.
    pairs: u64,
    /// Over the last pairs.
    rate_hz: Option<f64>,
    skew_ms: Option<f64>,
    /// Over the last pairs.
    skew_worst_ms: Option<f64>,
    /// Missing pairs.
    missing: u64,
    left: Losses,
    right: Losses,
    /// Number of times that controls were set or the cameras opened again; control values may have changed.
    control_changes: u64,
    /// Present errors of the cameras.
    problem: Option<String>,
}

/// Dropped images of one camera.
#[derive(Clone, Copy, Debug, Default, Serialize)]
struct Losses {
    lost: u64,
    damaged: u64,
    short: u64,
    late: u64,
    unpaired: u64,
    wrongly_stamped: u64,
}

impl Losses {
    fn of(counters: &StreamCounters) -> Self {
        Self {
            lost: counters.lost,
            damaged: counters.damaged,
            short: counters.short,
            late: counters.stale + counters.superseded,
            unpaired: counters.unpaired,
            wrongly_stamped: counters.not_newer + counters.future + counters.unstamped,
        }
    }
}

impl State {
    pub(super) fn new(info: &StereoCameraInfo) -> Self {
        Self {
            cameras: info.name.clone(),
            width_px: info.size.width,
            height_px: info.size.height,
            asked_hz: info.period.map(|period| 1.0 / period.as_secs_f64()),
            pairs: 0,
            rate_hz: None,
            skew_ms: None,
            skew_worst_ms: None,
            missing: 0,
            left: Losses::default(),
            right: Losses::default(),
            control_changes: 0,
            problem: None,
        }
    }
}

/// An encoded pair.
#[derive(Debug)]
pub(super) struct Images {
    /// JPEGs of the left and the right image.
    pub(super) jpegs: [Bytes; 2],
}

/// Requests to the cameras.
#[derive(Debug)]
pub(super) enum ControlRequest {
    /// Read all controls of a camera.
    Controls,
    /// Set a control, then read all controls.
    Set { id: u32, value: i32 },
}

/// A request to the cameras with the receiver of its answer.
#[derive(Debug)]
pub(super) struct PendingRequest {
    pub(super) side: Side,
    pub(super) request: ControlRequest,
    pub(super) answer: oneshot::Sender<Result<Vec<ControlLine>, String>>,
}

/// State shared by the cameras and the page.
pub(super) struct Show<'a> {
    pub(super) clock: &'a dyn Clock,
    pub(super) state: watch::Sender<Arc<State>>,
    pub(super) images: watch::Sender<Option<Arc<Images>>>,
    pub(super) asks: Receiver<PendingRequest>,
}

/// Opens disconnected cameras again.
pub(super) type Open<'a> = dyn FnMut() -> Result<V4l2StereoCamera, CameraError> + 'a;

impl Show<'_> {
    /// Shows the cameras until the end; disconnected cameras are opened again as soon as possible.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub(super) fn run(
        self,
        camera: V4l2StereoCamera,
        open: &mut Open<'_>,
        is_over: &mut dyn FnMut() -> bool,
    ) -> Result<()> {
        let size = camera.info().size;
        // One pair is captured while one is encoded, without a queue: a page wants the newest pair.
        let (give, take) = sync_channel::<Box<FramePair>>(1);
        let (give_back, back) = sync_channel::<Box<FramePair>>(1);
        let _ = give_back.try_send(Box::new(FramePair::black(size)));
        let Self { clock, state, images, asks } = self;
        let encode_all = move || {
            for pair in take {
                let jpegs =
                    [&pair.left, &pair.right].map(|image| encode(image, StoredFormat::Jpeg { quality: QUALITY }));
                if let [Ok(left), Ok(right)] = jpegs {
                    let jpegs = [left.into(), right.into()];
                    images.send_replace(Some(Arc::new(Images { jpegs })));
                }
                let _ = give_back.try_send(pair);
            }
        };
        std::thread::Builder::new().name("page images".to_owned()).spawn(encode_all).context("no thread for images")?;
        let mut taking = Taking {
            sender: &state,
            state: State::new(camera.info()),
            give,
            back,
            pair: Box::new(FramePair::black(size)),
            recent: VecDeque::with_capacity(WINDOW),
            last_sequence: None,
        };
        let mut camera = Some(camera);
        while !is_over() {
            match &mut camera {
                Some(open_one) => {
                    if !taking.step(open_one) {
                        camera = None;
                    }
                }
                None => {
                    clock.sleep_until(clock.now() + REOPEN);
                    camera = taking.reopen(open);
                }
            }
            for ask in asks.try_iter().take(ASKS_MAX) {
                taking.state.control_changes += u64::from(matches!(ask.request, ControlRequest::Set { .. }));
                // The client may have gone.
                let _ = ask.answer.send(answered(camera.as_mut(), ask.side, &ask.request));
            }
        }
        Ok(())
    }
}

fn answered(
    camera: Option<&mut V4l2StereoCamera>,
    side: Side,
    request: &ControlRequest,
) -> Result<Vec<ControlLine>, String> {
    let text = |error: CameraError| format!("{:#}", anyhow::Error::new(error));
    let camera = camera.ok_or_else(|| "the cameras are lost; look at plug, cable and hub".to_owned())?;
    if let ControlRequest::Set { id, value } = request {
        camera.set_control(side, *id, *value).map_err(text)?;
    }
    Ok(camera.controls(side).map_err(text)?.iter().map(ControlLine::of).collect())
}

/// The capturing part.
struct Taking<'a> {
    sender: &'a watch::Sender<Arc<State>>,
    state: State,
    give: SyncSender<Box<FramePair>>,
    back: Receiver<Box<FramePair>>,
    pair: Box<FramePair>,
    /// Times and skews of the last pairs.
    recent: VecDeque<(MonotonicTime, i64)>,
    last_sequence: Option<u64>,
}

impl Taking<'_> {
    /// Captures a pair; returns whether the cameras are still connected.
    fn step(&mut self, camera: &mut V4l2StereoCamera) -> bool {
        let patience =
            camera.info().period.map_or(PATIENCE_OF_A_CALL, |period| PATIENCE_OF_A_CALL.max(period * PATIENCE_PERIODS));
        let taken = camera.next_pair_into(&mut self.pair, patience);
        let counters = camera.counters();
        (self.state.left, self.state.right) = (Losses::of(&counters.left), Losses::of(&counters.right));
        let stays = match taken {
            Ok(()) => {
                self.note();
                self.state.problem = None;
                // A slow page skips pairs.
                if let Ok(empty) = self.back.try_recv() {
                    let _ = self.give.try_send(std::mem::replace(&mut self.pair, empty));
                }
                true
            }
            Err(error) => {
                let stays = matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair);
                self.state.problem = Some(format!("{:#}", anyhow::Error::new(error)));
                stays
            }
        };
        self.sender.send_replace(Arc::new(self.state.clone()));
        stays
    }

    fn note(&mut self) {
        let FramePair { sequence, exposed_at, skew_nanos, .. } = *self.pair;
        let before = self.last_sequence.replace(sequence);
        self.state.missing += before.map_or(0, |before| sequence.saturating_sub(before + 1));
        self.state.pairs += 1;
        if self.recent.len() == WINDOW {
            self.recent.pop_front();
        }
        self.recent.push_back((exposed_at, skew_nanos));
        let millis = |nanos: i64| nanos as f64 * 1e-6;
        self.state.skew_ms = Some(millis(skew_nanos));
        self.state.skew_worst_ms =
            self.recent.iter().map(|(_, skew)| *skew).max_by_key(|skew| skew.unsigned_abs()).map(millis);
        let seconds = self.recent.front().map_or(0.0, |(first, _)| exposed_at.seconds_since(*first));
        self.state.rate_hz = (seconds > 0.0).then(|| (self.recent.len() - 1) as f64 / seconds);
    }

    /// Searches for disconnected cameras.
    fn reopen(&mut self, open: &mut Open<'_>) -> Option<V4l2StereoCamera> {
        match open() {
            Ok(camera) => {
                tracing::info!("{}: there again", camera.info().name);
                self.recent.clear();
                self.last_sequence = None;
                self.state.control_changes += 1;
                Some(camera)
            }
            Err(error) => {
                self.state.rate_hz = None;
                self.state.problem = Some(format!("{:#}", anyhow::Error::new(error)));
                self.sender.send_replace(Arc::new(self.state.clone()));
                None
            }
        }
    }
}
