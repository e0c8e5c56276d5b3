//! An operator selects targets while a run goes on: on an image of a moment ago, another one, and one that cannot be used.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail the test")]

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::experiment;
use pb3dp_cell::journal::TruePoses;
use pb3dp_cell::moving::StepRecord;
use pb3dp_cell::operator::Operator;
use pb3dp_cell::parts::Parts;
use pb3dp_cell::perception::{TargetSource, View};
use pb3dp_cell::selection::{Choice, Selection, Selections};
use pb3dp_cell::spectator::Spectator;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::FramePair;
use pb3dp_servo::supervisor::{Decision, OperatorCommand, OperatorInput, OperatorRequest, State};
use pb3dp_setup::setup::{Carrier, Setup, read_setup};
use pb3dp_wiring::wire;
use system_tests::repository;

/// What was seen, and the newest pairs with the true region of the target in each.
#[derive(Default)]
struct Observed {
    pairs: VecDeque<(Arc<FramePair>, Region)>,
    estimates: Vec<(u64, Status, String)>,
    states: Vec<State>,
}

struct SelectionSpectator {
    setup: Setup,
    outline: TargetSource,
    observed: Arc<Mutex<Observed>>,
}

impl Spectator for SelectionSpectator {
    fn moved(&mut self, step: &StepRecord, _poses: Option<TruePoses>) {
        self.observed.lock().unwrap().states.push(step.decision.state);
    }

    fn estimated(&mut self, pair: &PairEstimate) {
        let View::Images(images) = &pair.captured.view else { panic!("the run has images") };
        let region = self.outline.region(&self.setup, pair.captured.cam_left_from_target.as_ref()).unwrap();
        let mut observed = self.observed.lock().unwrap();
        observed.pairs.push_back((Arc::clone(images), region));
        if observed.pairs.len() > 10 {
            observed.pairs.pop_front();
        }
        observed.estimates.push((pair.target, pair.estimate.status, pair.estimate.reason.clone()));
    }
}

/// Commands at their times; `select` marks a target, `start` waits until it is possible.
struct Script {
    steps: VecDeque<(f64, OperatorCommand)>,
    observed: Arc<Mutex<Observed>>,
    selections: Selections,
    selected: usize,
    refused: Arc<Mutex<Vec<String>>>,
}

impl Script {
    /// The first target is drawn on a pair of 0.3 s ago, the second is the middle of its right half, the third has no area to speak of.
    fn selection(&mut self) -> Selection {
        self.selected += 1;
        let observed = self.observed.lock().unwrap();
        match self.selected {
            1 => {
                let (pair, region) = observed.pairs.front().unwrap().clone();
                Selection { region, drawn_on: Some(pair), model: None }
            }
            2 => Selection {
                region: Region::Rectangle { x: 330, y: 200, width: 60, height: 80 },
                drawn_on: None,
                model: None,
            },
            _ => {
                Selection { region: Region::Rectangle { x: 5, y: 5, width: 2, height: 1 }, drawn_on: None, model: None }
            }
        }
    }
}

impl Operator for Script {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let is_due = self.steps.front().is_some_and(|&(at_s, command)| {
            now >= MonotonicTime::ZERO + Duration::from_secs_f64(at_s)
                && (command != OperatorCommand::Start || last.is_some_and(|last| last.is_ready))
        });
        let request = if is_due { self.steps.pop_front() } else { None };
        if let Some((_, OperatorCommand::Select)) = request {
            let selection = self.selection();
            self.selections.give(Choice::Marked(selection));
        }
        let request = request.map(|(_, command)| OperatorRequest { command, at: now });
        OperatorInput { request, heartbeat_at: Some(now), silent_after: None }
    }

    fn show(&mut self, decision: &Decision) {
        self.refused.lock().unwrap().extend(decision.refused.as_ref().map(ToString::to_string));
    }

    fn tell(&mut self, _trouble: Option<String>) {}

    fn is_person(&self) -> bool {
        true
    }

    fn can_fall_silent(&self) -> bool {
        false
    }
}

#[test]
fn targets_are_selected_one_after_another_while_the_run_goes_on() {
    let mut setup = read_setup(&repository().join("configs/sim.toml")).unwrap();
    setup.compared.clear();
    setup.experiment.carrier = Carrier::Person;
    let parts = wire(&setup).unwrap();
    let (observed, selections, refused) = (Arc::<Mutex<Observed>>::default(), Selections::default(), Arc::default());
    let selection_spectator =
        SelectionSpectator { setup: setup.clone(), outline: parts.marking.clone(), observed: Arc::clone(&observed) };
    use OperatorCommand::{Hold, Select, Start};
    let begin_s = 1.5;
    let steps =
        [(begin_s, Select), (begin_s, Start), (6.0, Hold), (6.5, Select), (6.5, Start), (9.0, Hold), (9.3, Select)];
    let script = Script {
        steps: steps.into(),
        observed: Arc::clone(&observed),
        selections: selections.clone(),
        selected: 0,
        refused: Arc::clone(&refused),
    };
    let parts = Parts {
        marking: TargetSource::FromOperator,
        selections: Some(selections),
        operator: Box::new(script),
        spectators: vec![Box::new(selection_spectator)],
        ..parts
    };
    let outcome = experiment::run(&setup, parts, Some(10.0), None).unwrap();
    assert_eq!(*refused.lock().unwrap(), Vec::<String>::new());
    let observed = observed.lock().unwrap();
    let of = |target: u64| observed.estimates.iter().filter(move |(of, ..)| *of == target);
    assert!(of(0).all(|(_, status, why)| *status == Status::Lost && why.contains("no target is selected")));
    assert!(of(0).count() > 30, "before the first selection");
    assert!(of(1).skip(1).all(|(_, status, _)| *status == Status::Ok), "{:?}", of(1).next());
    assert!(of(2).filter(|(_, status, _)| status.depth_is_sure()).count() > 60, "{:?}", of(2).next_back());
    let (_, status, why) = of(3).next().unwrap();
    assert_eq!(*status, Status::NotObservable, "{why}");
    assert!(of(3).skip(1).all(|(_, _, why)| why.contains("no target is selected")), "{:?}", of(3).next_back());
    let mut states = observed.states.clone();
    states.dedup();
    use State::{Approaching, Holding, Idle, Selecting, Tracking};
    let expected = [Idle, Selecting, Approaching, Tracking, Holding, Selecting];
    assert_eq!(states[..6], expected);
    assert_eq!(states.last(), Some(&Selecting), "{states:?}");
    assert!(outcome.log.control.len() > 900);
}
