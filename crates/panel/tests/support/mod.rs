//! A panel with a loop that steps a real supervisor, and plain clients.

pub mod client;
pub mod page;

use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use image::{Rgb, RgbImage};
use nalgebra::{Matrix6, Vector2, Vector3};
use pb3dp_cell::capturing::Captured;
use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::live::enter_control_thread;
use pb3dp_cell::log::ArmSample;
use pb3dp_cell::moving::StepRecord;
use pb3dp_cell::operator::{MotionRequest, Operator};
use pb3dp_cell::parts::GatewayLimits;
use pb3dp_cell::perception::View;
use pb3dp_cell::selection::{Choice, Selections};
use pb3dp_cell::spectator::Spectator;
use pb3dp_estimation::estimator::FramePrior;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{Clock, FramePair};
use pb3dp_hal_clock::SystemClock;
use pb3dp_kinematics::JointState;
use pb3dp_panel::{About, Panel, PanelConfig, PanelOperator, PanelSpectator};
use pb3dp_servo::Mode;
use pb3dp_servo::supervisor::{
    ArmCondition, ArmInput, Confidence, Decision, EstimateInput, FrameInput, Innovation, Inputs, OperatorCommand,
    State, Supervisor,
};
use pb3dp_setup::setup::{Setup, read_setup};
use serde_json::json;

pub use self::client::{Client, TIMEOUT};
pub use self::page::Page;

/// What the loop did.
#[derive(Default)]
pub struct Observed {
    pub last: Option<Decision>,
    pub motion: Option<MotionRequest>,
    /// Commands that the supervisor got, with the time of the step.
    pub commands: Vec<(OperatorCommand, MonotonicTime)>,
    /// Selections that the estimation got.
    pub regions: Vec<(Region, Option<u64>)>,
    /// How often the estimation got the target of the setup.
    pub setup_selected: usize,
    /// Last sign of life in the newest step.
    pub heartbeat_at: Option<MonotonicTime>,
    /// Allocations of the control thread in the panel.
    pub allocations: usize,
    /// Time of the step in which motion ended last.
    pub rested_at: Option<MonotonicTime>,
    /// Between two steps of the control thread, seconds.
    pub longest_period_s: f64,
    stepped_at: Option<MonotonicTime>,
    /// Whether the control thread has SCHED_FIFO.
    pub is_preferred: bool,
    /// From the moment at which a step was due until it was done, seconds. Without the steps that copy a pair, which another thread
    /// does in a run.
    pub lateness_s: Vec<f64>,
}

impl Observed {
    fn stepped(&mut self, now: MonotonicTime) {
        let before = self.stepped_at.replace(now).unwrap_or(now);
        self.longest_period_s = self.longest_period_s.max(now.seconds_since(before));
    }
}

pub struct Rig {
    pub panel: Option<Panel>,
    pub clock: Arc<SystemClock>,
    pub observed: Arc<Mutex<Observed>>,
    /// Stops the loop from listening, as a hung control thread.
    pub is_paused: Arc<AtomicBool>,
    pub interrupt: Arc<AtomicBool>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

pub fn setup() -> Setup {
    read_setup(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/sim.toml")).unwrap()
}

impl Rig {
    pub fn new() -> Self {
        Self::with(|_| {}, true)
    }

    /// A rig with another configuration; if it does not run, no control step has come yet.
    pub fn with(change: impl FnOnce(&mut PanelConfig), runs: bool) -> Self {
        Self::with_images(change, (runs, false), textured(0, MonotonicTime::ZERO))
    }

    /// As [`Self::with`], with these images again and again; the control thread may have the scheduling of a live run.
    pub fn with_images(
        change: impl FnOnce(&mut PanelConfig),
        (runs, is_live): (bool, bool),
        images: Arc<FramePair>,
    ) -> Self {
        let setup = setup();
        let clock = Arc::new(SystemClock::new());
        let mut config = PanelConfig::at("127.0.0.1:0".parse().unwrap());
        change(&mut config);
        let interrupt = Arc::clone(&config.interrupt);
        let about = About::of_setup(&setup, "sim", "0.0.0").with_gateways(&[("vs-robot", gateway_limits())]);
        let (panel, operator, spectator) = Panel::start(config, clock.clone(), about).unwrap();
        let observed = Arc::<Mutex<Observed>>::default();
        let (is_paused, is_over) = (Arc::new(AtomicBool::new(!runs)), Arc::new(AtomicBool::new(false)));
        let cell = Loop {
            clock: clock.clone(),
            supervisor: Supervisor::new(setup.supervisor.clone()).unwrap(),
            selections: panel.selections(),
            observed: observed.clone(),
            is_paused: is_paused.clone(),
            is_over: is_over.clone(),
            is_live,
            target: 0,
            sequence: 0,
            images,
            looks: 0,
            start_rad: setup.rig.arms.vs.start_rad,
        };
        let thread = std::thread::spawn(move || cell.run(operator, spectator));
        let rig = Self { panel: Some(panel), clock, observed, is_paused, interrupt, is_over, thread: Some(thread) };
        if runs {
            let has_begun =
                |state: &serde_json::Value| state["state"]["name"] == "idle" && state["images"]["sequence"].is_u64();
            rig.client().wait_for("the first steps and images", has_begun);
        }
        rig
    }

    pub fn address(&self) -> SocketAddr {
        self.panel.as_ref().unwrap().address()
    }

    /// A client without a session.
    pub fn client(&self) -> Client {
        Client::new(self.address())
    }

    /// A client that holds the lease, and its page, which sends the signs of life.
    pub fn holder_with_page(&self) -> (Client, Page) {
        let mut client = self.client();
        client.take("test");
        let page = Page::open(&client);
        (client, page)
    }

    /// A client that holds the lease and keeps it alive as a script does.
    pub fn holder(&self) -> Client {
        let mut client = self.client();
        client.take("test");
        client.keep_alive();
        client
    }

    pub fn state(&self) -> State {
        self.observed.lock().unwrap().last.unwrap().state
    }

    pub fn wait_for(&self, what: &str, mut is: impl FnMut(&Observed) -> bool) {
        let start = Instant::now();
        while !is(&self.observed.lock().unwrap()) {
            assert!(start.elapsed() < TIMEOUT, "{what}: {:?}", self.observed.lock().unwrap().last);
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    pub fn wait_for_state(&self, state: State) {
        self.wait_for(state.name(), |observed| observed.last.is_some_and(|last| last.state == state));
    }

    /// Selects a target and waits until it may be followed.
    pub fn select(&self, client: &Client) {
        client.command("select", json!({ "region": "rect:200,150,120,90" })).is_accepted();
        self.wait_for("ready", |observed| {
            observed.last.is_some_and(|last| last.is_ready && last.state == State::Selecting)
        });
        client.wait_for("a target", |state| state["target"]["id"] == 1 && state["state"]["is_ready"] == true);
    }

    /// Waits until no arm may move.
    pub fn wait_for_rest(&self) {
        self.wait_for("rest", |observed| {
            observed.last.is_some_and(|last| !last.state.is_moving() && last.no_arm_may_move)
        });
    }

    /// Selects a target and starts.
    pub fn start(&self, client: &Client) {
        self.select(client);
        let start = || client.command("start", json!({}));
        // A machine that is building may suspend the program for a moment.
        let is_suspended = |reply: &self::client::Reply| reply.status != 200 && reply.code() == "PB3DP-PAN-030";
        let reply =
            std::iter::repeat_with(start).take(5).find(|reply| !is_suspended(reply)).expect("suspended five times");
        reply.is_accepted();
        self.wait_for_state(State::Approaching);
    }

    pub fn count_of(&self, command: OperatorCommand) -> usize {
        self.observed.lock().unwrap().commands.iter().filter(|(given, _)| *given == command).count()
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::SeqCst);
        drop(self.panel.take());
        let joined = self.thread.take().unwrap().join();
        if !std::thread::panicking() {
            joined.unwrap();
            assert_eq!(self.observed.lock().unwrap().allocations, 0, "the control thread must not allocate");
        }
    }
}

struct Loop {
    clock: Arc<SystemClock>,
    supervisor: Supervisor,
    selections: Selections,
    observed: Arc<Mutex<Observed>>,
    is_paused: Arc<AtomicBool>,
    is_over: Arc<AtomicBool>,
    is_live: bool,
    target: u64,
    sequence: u64,
    images: Arc<FramePair>,
    looks: u64,
    start_rad: pb3dp_kinematics::JointVector,
}

/// Limits of a gateway of the camera arm; the ends of the joints differ.
fn gateway_limits() -> GatewayLimits {
    let upper_rad = std::array::from_fn(|joint| 0.1 * (joint + 1) as f64);
    GatewayLimits { speed_max_rad_per_s: [0.5; 7], range_rad: [[-0.2; 7], upper_rad] }
}

/// Sleep after each step.
const STEP: Duration = Duration::from_millis(4);

/// A textured pair with a disparity of 40 pixels everywhere.
fn textured(sequence: u64, at: MonotonicTime) -> Arc<FramePair> {
    let grey = |u: i64, v: i64| {
        let hash = (u.wrapping_mul(73_856_093) ^ v.wrapping_mul(19_349_663)).rem_euclid(251);
        Rgb([hash as u8, (hash / 2 + 60) as u8, 128])
    };
    let image = |shift: i64| RgbImage::from_fn(640, 480, |u, v| grey((i64::from(u) + shift) / 4, i64::from(v) / 4));
    Arc::new(FramePair {
        sequence,
        exposed_at: at,
        skew_nanos: 0,
        left: image(0),
        right: image(40),
        delivered: Default::default(),
        exposure: None,
    })
}

/// Whether the calling thread has the policy SCHED_FIFO.
fn is_fifo() -> bool {
    // `policy` of proc(5), counted from the end of the name.
    const POLICY: usize = 38;
    let stat = std::fs::read_to_string("/proc/thread-self/stat").unwrap_or_default();
    stat.rsplit_once(") ").and_then(|(_, fields)| fields.split(' ').nth(POLICY)) == Some("1")
}

impl Loop {
    fn run(mut self, mut operator: PanelOperator, mut spectator: PanelSpectator) {
        if self.is_live {
            enter_control_thread();
        }
        self.observed.lock().unwrap().is_preferred = is_fifo();
        let mut last: Option<Decision> = None;
        let mut newest: Option<(FrameInput, EstimateInput)> = None;
        let image = Arc::clone(&self.images);
        let due = AtomicU64::new(0);
        while !self.is_over.load(Ordering::SeqCst) {
            let due_at = Instant::now() + STEP;
            std::thread::sleep(STEP);
            if self.is_paused.load(Ordering::SeqCst) {
                continue;
            }
            let now = self.clock.now();
            let has_copied = now.as_nanos() >= due.load(Ordering::SeqCst);
            if has_copied {
                due.store(now.as_nanos() + 30_000_000, Ordering::SeqCst);
                let percept = self.look(now, &image, &mut spectator);
                newest = Some(percept);
            }
            let before = pb3dp_allocation_count::requests();
            let input = operator.listen(last.as_ref(), now);
            let motion = operator.motion();
            let mut allocations = pb3dp_allocation_count::requests() - before;
            let arm = ArmInput { state: ArmCondition::Enabled, measured_at: Some(now) };
            let inputs = Inputs {
                operator: input,
                controller: Mode::Approaching,
                innovation: Innovation::Agrees,
                target_covariance: None,
                images_late_s: None,
                estimate: newest.map(|(_, estimate)| estimate),
                frame: newest.map(|(frame, _)| frame),
                range_end: None,
                smallest_singular_value: Some(1.0),
                arms: [arm; 2],
            };
            let decision = self.supervisor.step(&inputs, now);
            let before = pb3dp_allocation_count::requests();
            operator.show(&decision);
            allocations += pb3dp_allocation_count::requests() - before;
            spectator.moved(&self.moved(now, decision), None);
            let mut observed = self.observed.lock().unwrap();
            if last.is_some_and(|last| last.state.is_moving()) && !decision.state.is_moving() {
                observed.rested_at = Some(now);
            }
            observed.commands.extend(input.request.map(|request| (request.command, now)));
            observed.allocations += allocations;
            observed.heartbeat_at = input.heartbeat_at;
            observed.stepped(now);
            observed.motion = Some(motion);
            observed.last = Some(decision);
            if !has_copied {
                observed.lateness_s.push(due_at.elapsed().as_secs_f64());
            }
            last = Some(decision);
        }
    }

    /// A control step of arms that rest.
    fn moved(&self, at: MonotonicTime, decision: Decision) -> StepRecord {
        let still = pb3dp_kinematics::JointVector::zeros();
        StepRecord {
            number: 0,
            at,
            observed: None,
            base_from_model: None,
            model_from_surface: Pose::coincident(),
            mode: Mode::Approaching,
            decision,
            vs_joints: JointState { at, position_rad: self.start_rad, velocity_rad_per_s: still },
            arms: [ArmSample { position_rad: self.start_rad, requested_rad_per_s: None }; 2],
            conditions: [ArmCondition::Enabled; 2],
        }
    }

    /// The next pair with its estimate.
    fn look(
        &mut self,
        at: MonotonicTime,
        image: &FramePair,
        spectator: &mut PanelSpectator,
    ) -> (FrameInput, EstimateInput) {
        let region = self.selections.take().and_then(|choice| {
            let Choice::Marked(selection) = choice else {
                self.observed.lock().unwrap().setup_selected += 1;
                return None;
            };
            let drawn_on = selection.drawn_on.map(|pair| pair.sequence);
            self.observed.lock().unwrap().regions.push((selection.region.clone(), drawn_on));
            Some(selection.region)
        });
        self.target += u64::from(region.is_some());
        self.sequence += 1;
        let frame = FrameInput { sequence: self.sequence, at, skew_s: 0.0 };
        let pose = (self.target > 0).then(|| Pose::from_translation(Vector3::new(0.01, 0.02, 0.6)));
        let covariance = pose.map(|_| Matrix6::identity() * 1e-8);
        let estimate = TrackEstimate {
            cam_left_from_model: pose,
            covariance,
            pose_covariance: covariance.map(|since_first| 5.0 * since_first),
            fitness: Some(0.97),
            outline_px: [[300.0, 220.0], [340.0, 220.0], [340.0, 260.0], [300.0, 260.0]].map(Vector2::from).to_vec(),
            ..TrackEstimate::without_pose(Status::Ok, "test".to_owned())
        };
        let (left, right) = (image.left.clone(), image.right.clone());
        let delivered = image.delivered.clone();
        let pair = FramePair {
            sequence: self.sequence,
            exposed_at: at,
            skew_nanos: 0,
            left,
            right,
            delivered,
            exposure: None,
        };
        // The target moves away by 2 mm after its first estimate, and the estimate does not follow.
        self.looks += u64::from(self.target > 0);
        let truth_m = Vector3::new(0.01, 0.02, if self.looks > 1 { 0.602 } else { 0.6 });
        let truth = Pose::from_translation(truth_m);
        spectator.estimated(&PairEstimate {
            steps: 0,
            chosen: None,
            captured: Captured { frame, cam_left_from_target: Some(truth), view: View::Images(Arc::new(pair)) },
            target: self.target,
            region,
            prior: FramePrior::default(),
            estimate,
            target_from_plane: None,
            latency_millis: 2.0,
            age_millis: 20.0,
        });
        let confidence = if pose.is_some() { Confidence::Sure } else { Confidence::NoPose };
        (frame, EstimateInput { at, confidence, covariance, target: self.target })
    }
}
