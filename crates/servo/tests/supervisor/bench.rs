//! A supervisor with all its inputs: a camera at 33 pairs per second, a confident estimator, a controller that initialises the
//! target after 50 ms and arrives after 300 ms, two arms, and an operator with signs of life. Each input can be changed.

use nalgebra::Matrix6;
use pb3dp_geometry::MonotonicTime;
use pb3dp_servo::Mode;
use pb3dp_servo::supervisor::{
    Action, ArmCondition, ArmInput, Condition, Confidence, Decision, EstimateInput, FrameInput, Innovation, Inputs,
    OperatorCommand, OperatorInput, OperatorRequest, Permission, Policies, Policy, RangeEnd, Resume, State, Supervisor,
    SupervisorConfig,
};

pub const STEP_S: f64 = 0.01;
pub const FRAME_EVERY: u64 = 3;
const LATENCY_S: f64 = 0.02;

/// Strict enough that every condition has an effect.
pub fn config() -> SupervisorConfig {
    SupervisorConfig {
        policies: Policies::of(policy),
        resume_after_s: 0.2,
        go_after_s: 0.1,
        word_age_max_s: 0.5,
        search_max_s: 0.0,
    }
}

fn policy(condition: Condition) -> Policy {
    use Action::{Fault, Hold, Note, Slow, Stop};
    use Resume::{ByItself, ByOperator};
    let (threshold, for_s, action, resume) = match condition {
        Condition::EmergencyStop | Condition::ArmFault => (0.0, 0.0, Fault, ByOperator),
        Condition::ArmDisabled => (0.0, 0.0, Hold, ByOperator),
        Condition::ClockStepped => (0.2, 0.0, Hold, ByOperator),
        Condition::OperatorSilent => (1.0, 0.0, Stop, ByOperator),
        Condition::JointsStale => (0.05, 0.0, Hold, ByItself),
        Condition::TargetChanged | Condition::Miscalibrated => (0.0, 0.0, Hold, ByOperator),
        Condition::FrameStale => (0.25, 0.0, Hold, ByItself),
        Condition::FrameOrder => (0.0, 0.0, Hold, ByItself),
        Condition::TargetLost => (1.0, 0.0, Hold, ByItself),
        Condition::EstimateStale => (0.3, 0.0, Hold, ByItself),
        Condition::LowConfidence => (0.0, 0.1, Slow(0.5), ByItself),
        Condition::PositionJump => (0.1, 0.1, Hold, ByOperator),
        Condition::OrientationJump => (0.6, 0.1, Hold, ByOperator),
        Condition::Outlier => (6.0, 0.1, Hold, ByItself),
        Condition::PositionUncertain => (0.01, 0.1, Hold, ByItself),
        Condition::OrientationUncertain => (0.1, 0.1, Hold, ByItself),
        Condition::CameraSkew => (0.005, 0.1, Hold, ByItself),
        Condition::LimitNear => (0.05, 0.0, Slow(0.3), ByItself),
        Condition::Singularity => (0.03, 0.0, Note, ByItself),
        Condition::ControllerRests => (0.0, 0.0, Hold, ByItself),
        Condition::LateImages => (0.02, 0.0, Hold, ByOperator),
    };
    Policy { threshold, for_s, action, resume }
}

/// [`config`] with one changed policy.
pub fn with(condition: Condition, change: impl FnOnce(&mut Policy)) -> SupervisorConfig {
    let mut config = config();
    change(config.policies.get_mut(condition));
    config
}

pub fn at(seconds: f64) -> MonotonicTime {
    MonotonicTime::from_secs_f64(seconds)
}

/// Inputs without any condition.
pub fn good(now_s: f64) -> Inputs {
    let arm = ArmInput { state: ArmCondition::Enabled, measured_at: Some(at(now_s - 0.005)) };
    let exposed_at = at(now_s - LATENCY_S);
    Inputs {
        operator: OperatorInput { heartbeat_at: Some(at(now_s)), ..OperatorInput::default() },
        controller: Mode::Tracking,
        innovation: Innovation::Agrees,
        target_covariance: None,
        images_late_s: None,
        estimate: Some(EstimateInput {
            at: exposed_at,
            confidence: Confidence::Sure,
            covariance: Some(Matrix6::from_diagonal_element(1e-6)),
            target: 7,
        }),
        frame: Some(FrameInput { sequence: (now_s * 1e3) as u64, at: exposed_at, skew_s: 2e-4 }),
        range_end: Some(RangeEnd { joint: 3, distance_rad: 0.7 }),
        smallest_singular_value: Some(0.12),
        arms: [arm; 2],
    }
}

pub struct Bench {
    pub supervisor: Supervisor,
    pub now_s: f64,
    /// Change of the inputs in every step.
    pub lie: Box<dyn Fn(&mut Inputs)>,
    pub last: Option<Decision>,
    /// Number of steps in which each condition was found.
    pub steps_found: [u64; Condition::COUNT],
    estimates: (Option<EstimateInput>, Option<FrameInput>),
    request: Option<OperatorRequest>,
    steps: u64,
    steps_since_rearm: u64,
}

impl Bench {
    pub fn new(config: SupervisorConfig) -> Self {
        Self {
            supervisor: Supervisor::new(config).unwrap(),
            now_s: 100.0,
            lie: Box::new(|_| {}),
            last: None,
            steps_found: [0; Condition::COUNT],
            estimates: (None, None),
            request: None,
            steps: 0,
            steps_since_rearm: 0,
        }
    }

    /// A bench in the state tracking.
    pub fn following(config: SupervisorConfig) -> Self {
        let mut bench = Self::new(config);
        bench.begin();
        bench
    }

    /// Selects and starts, and waits for the state tracking.
    pub fn begin(&mut self) {
        self.say(OperatorCommand::Select);
        self.run(0.5);
        let decision = self.say(OperatorCommand::Start);
        assert_eq!(decision.state, State::Approaching, "{}", decision.why);
        self.run(0.5);
        assert_eq!(self.state(), State::Tracking);
        assert_eq!(self.decision().permission, Permission::Move { share: 1.0 });
    }

    pub fn state(&self) -> State {
        self.decision().state
    }

    pub fn decision(&self) -> Decision {
        self.last.unwrap()
    }

    pub fn why(&self) -> String {
        self.decision().why.to_string()
    }

    /// Changes the inputs from now on.
    pub fn lie(&mut self, lie: impl Fn(&mut Inputs) + 'static) {
        self.lie = Box::new(lie);
    }

    pub fn truth(&mut self) {
        self.lie = Box::new(|_| {});
    }

    pub fn say(&mut self, command: OperatorCommand) -> Decision {
        self.say_at(command, self.now_s + STEP_S)
    }

    /// Passes a command with this time to the next step.
    pub fn say_at(&mut self, command: OperatorCommand, requested_s: f64) -> Decision {
        self.request = Some(OperatorRequest { command, at: at(requested_s) });
        self.step()
    }

    /// The inputs of this step.
    fn inputs(&mut self) -> Inputs {
        let mut inputs = good(self.now_s);
        if self.steps.is_multiple_of(FRAME_EVERY) {
            self.estimates = (inputs.estimate, inputs.frame);
        } else {
            inputs.innovation = Innovation::NoneNew;
        }
        (inputs.estimate, inputs.frame) = self.estimates;
        inputs.operator.request = self.request.take();
        inputs.controller = match self.steps_since_rearm {
            0 => Mode::Idle,
            1..5 => Mode::Locking,
            5..30 => Mode::Approaching,
            _ => Mode::Tracking,
        };
        inputs
    }

    pub fn step(&mut self) -> Decision {
        self.now_s += STEP_S;
        let mut inputs = self.inputs();
        (self.lie)(&mut inputs);
        let decision = self.supervisor.step(&inputs, at(self.now_s));
        self.steps += 1;
        self.steps_since_rearm = if decision.rearm { 0 } else { self.steps_since_rearm + 1 };
        for condition in decision.found.iter() {
            self.steps_found[condition as usize] += 1;
        }
        self.last = Some(decision);
        decision
    }

    /// Steps for this time; whether motion was permitted in any step.
    pub fn run(&mut self, seconds: f64) -> bool {
        let mut moved = false;
        for _ in 0..(seconds / STEP_S).round() as usize {
            moved |= matches!(self.step().permission, Permission::Move { .. });
        }
        moved
    }
}
