//! Control steps as messages, from what the control thread has heard.

use pb3dp_bag::run_messages::{ArmCall, ArmChange, ControlStep, OperatorEntry};
use pb3dp_bag::stops::of_pose;
use pb3dp_cell::journal::TruePoses;
use pb3dp_cell::moving::StepRecord;
use pb3dp_cell::operator::MotionRequest;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{EnablePosition, JointCommand, JointState, PowerOrder};
use pb3dp_servo::supervisor::OperatorInput;
use rtrb::Consumer;

use crate::exact::{note_percept, of_failure, of_pose_if_any, of_state};
use crate::tap::{Answer, ArmReport, Call, Event};

/// Gathers the events of each step.
pub struct Steps {
    events: Consumer<Event>,
    asked: MotionRequest,
    /// The step whose events come.
    open: Option<ControlStep>,
    /// What the arms have told before the first step.
    before: Vec<ArmCall>,
    states_before: Vec<ArmChange>,
    number: u64,
    why: String,
}

impl Steps {
    /// No step yet.
    pub fn new(events: Consumer<Event>) -> Self {
        Self {
            events,
            asked: MotionRequest::default(),
            open: None,
            before: Vec::new(),
            states_before: Vec::new(),
            number: 0,
            why: String::new(),
        }
    }

    /// The finished step; none if its begin is missing.
    pub fn finished(&mut self, moved: &StepRecord, poses: Option<&TruePoses>) -> Option<ControlStep> {
        self.gather();
        let mut step = self.open.take()?;
        self.number = moved.number + 1;
        step.number = moved.number;
        if let Some(percept) = &moved.observed {
            note_percept(&mut step, percept);
        }
        step.finished = true;
        step.mode = moved.mode.to_string();
        step.state = moved.decision.state.name().to_owned();
        let why = moved.decision.why.to_string();
        if why != self.why {
            step.why.clone_from(&why);
            self.why = why;
        }
        step.world_from_hand = of_pose_if_any(poses.map(|poses| &poses.world_from_hand));
        step.world_from_target = of_pose_if_any(poses.map(|poses| &poses.world_from_target));
        step.base_from_model = of_pose_if_any(moved.base_from_model.as_ref());
        Some(step)
    }

    /// The step that a failure has ended.
    pub fn unfinished(&mut self) -> Option<ControlStep> {
        self.gather();
        let step = self.open.take()?;
        Some(ControlStep { number: self.number, ..step })
    }

    /// Takes the events up to the end of the step.
    fn gather(&mut self) {
        while let Ok(event) = self.events.peek() {
            // The end of this step found the ring full.
            if self.open.is_some() && matches!(event, Event::Listened { .. }) {
                return;
            }
            let Ok(event) = self.events.pop() else { return };
            if matches!(event, Event::Ended) {
                return;
            }
            self.take(event);
        }
    }

    fn take(&mut self, event: Event) {
        match (event, &mut self.open) {
            (Event::Enabled { arm, joints, reported: (state, by_other) }, _) => {
                self.before.push(measured(arm, &joints));
                let reported = [ArmReport::State(state), ArmReport::StoppedByOther(by_other)];
                self.states_before.extend(reported.map(|reported| change(arm, 0, reported)));
            }
            (Event::Listened { now, inputs, carries_before_start, lost }, _) => {
                let mut step = self.begun(now, &inputs, carries_before_start, lost);
                step.calls.append(&mut self.before);
                step.changes.append(&mut self.states_before);
                self.open = Some(step);
            }
            (Event::Asked(motion), open) => {
                self.asked = motion;
                if let Some(step) = open {
                    step.speed_share = motion.speed_share;
                    step.hand_from_hand_shifted = of_pose(&motion.hand_from_hand_shifted);
                }
            }
            (Event::Changed { arm, query, reported }, Some(step)) => {
                // Changes and calls of an arm have one order.
                step.changes.push(ArmChange { after: calls_of(step, arm), ..change(arm, query, reported) });
            }
            (Event::Called { arm, call, answer }, Some(step)) => step.calls.push(call_message(arm, call, answer)),
            // After the last step the arms are stopped. In a run, the begin of their step found the ring full.
            (Event::Ended | Event::Changed { .. } | Event::Called { .. }, _) => {}
        }
    }

    fn begun(&self, now: MonotonicTime, inputs: &OperatorInput, carries_before_start: bool, lost: u32) -> ControlStep {
        let said = |request: pb3dp_servo::supervisor::OperatorRequest| OperatorEntry {
            word: request.command.name().to_owned(),
            at_nanos: request.at.as_nanos(),
        };
        ControlStep {
            at_nanos: now.as_nanos(),
            lost,
            said: inputs.request.map(said).into_iter().collect(),
            heard_at_nanos: inputs.heartbeat_at.map(MonotonicTime::as_nanos).into_iter().collect(),
            silent_after_nanos: inputs
                .silent_after
                .map(|silence| u64::try_from(silence.as_nanos()).unwrap_or(u64::MAX))
                .into_iter()
                .collect(),
            speed_share: self.asked.speed_share,
            hand_from_hand_shifted: of_pose(&self.asked.hand_from_hand_shifted),
            carries_before_start,
            ..ControlStep::default()
        }
    }
}

fn calls_of(step: &ControlStep, arm: u8) -> u32 {
    step.calls.iter().filter(|call| call.arm == arm).count() as u32
}

fn change(arm: u8, query: u32, reported: ArmReport) -> ArmChange {
    let state = match reported {
        ArmReport::State(state) => of_state(state),
        ArmReport::StoppedByOther(true) => "stopped by other",
        ArmReport::StoppedByOther(false) => "not stopped by other",
    };
    ArmChange { arm, after: 0, query, state: state.to_owned() }
}

fn measured(arm: u8, joints: &JointState) -> ArmCall {
    ArmCall {
        arm,
        call: "enabled".to_owned(),
        outcome: "measured".to_owned(),
        measured_at_nanos: joints.at.as_nanos(),
        position_rad: joints.position_rad.as_slice().to_vec(),
        velocity_rad_per_s: joints.velocity_rad_per_s.as_slice().to_vec(),
        ..ArmCall::default()
    }
}

/// The word for a call.
pub fn call_name(call: &Call) -> &'static str {
    match call {
        Call::Exchange(JointCommand::Velocity(_)) => "move",
        Call::Exchange(JointCommand::Hold) => "hold",
        Call::Power(PowerOrder::Enable(EnablePosition::Start)) => "enable",
        Call::Power(PowerOrder::Enable(EnablePosition::Here)) => "enable here",
        Call::Power(PowerOrder::BeginEnable(EnablePosition::Start)) => "begin enable",
        Call::Power(PowerOrder::BeginEnable(EnablePosition::Here)) => "begin enable here",
        Call::Power(PowerOrder::PollEnable) => "poll enable",
        Call::Power(PowerOrder::BeginStop) => "begin stop",
        Call::Power(PowerOrder::Stop) => "stop",
        Call::Power(PowerOrder::Reset) => "reset",
    }
}

fn call_message(arm: u8, call: Call, answer: Answer) -> ArmCall {
    let command_rad_per_s = match call {
        Call::Exchange(JointCommand::Velocity(velocity)) => velocity.as_slice().to_vec(),
        _ => Vec::new(),
    };
    let outcome = |outcome: &str| ArmCall { arm, outcome: outcome.to_owned(), ..ArmCall::default() };
    let answered = match &answer {
        Answer::Done => outcome("done"),
        Answer::Pending => outcome("pending"),
        Answer::Failed(kind) => outcome(of_failure(*kind)),
        Answer::Measured(joints) => measured(arm, joints),
    };
    ArmCall { call: call_name(&call).to_owned(), command_rad_per_s, ..answered }
}
