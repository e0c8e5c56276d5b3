//! An arm goes from pose to pose, and at each of them, when joints and images rest, a pair is taken: what a calibration is made of.
//!
//! The same parts as of a run, with limiter, guard and coupling, and the same loops; the other arm holds. Each way is straight in joint
//! space and at rest at both ends. What has been taken is on disk before the arm goes on.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Clock, FramePair, JointCommand};
use pb3dp_kinematics::{Chain, DOF, JointVector};
use pb3dp_record::images::{StoredFormat, save};
use pb3dp_record::stops::{ArmStand, Stop, Stops, save_stops};
use pb3dp_servo::supervisor::{Confidence, EstimateInput, FrameInput};
use pb3dp_setup::setup::{Pace, Setup};

use super::both_arms::{BothArms, LedArm, Whence};
use super::capturing::{Captured, Capturing};
use super::halves::{Capture, Course, Estimate, Mover, Parted, Record};
use super::parts::{ArmChoice, Parts};
use super::percept::Percept;
use super::plan::Plan;
use super::stillness::shift_px;
use crate::eyes::View;

/// Speed per angle by which a joint is behind its plan, 1/s.
const GAIN_PER_S: f64 = 2.0;
/// A joint that is this near to its end has arrived, rad.
const ARRIVED_WITHIN_RAD: f64 = 5e-4;
/// How long joints may take to arrive after a way should have ended.
const LATE_MAX: Duration = Duration::from_secs(3);
/// Joints that move by less than this in the time below rest, rad: a few steps of a resolver.
const RESTS_WITHIN_RAD: f64 = 2e-4;
/// How long joints have to rest before images count: structures ring after a stop.
const SETTLE: Duration = Duration::from_millis(500);
/// Images that move by less than this from one to the next rest, pixels.
pub const STILL_WITHIN_PX: f64 = 0.05;
/// Before the first way, and behind the last one.
const LEAD: Duration = Duration::from_millis(500);

/// A tour: ways one behind the other, with a stop at the end of each but the last one, which leads back.
#[derive(Clone, Debug)]
pub struct Tour {
    /// The arm that goes.
    pub choice: ArmChoice,
    /// The ways.
    pub ways: Vec<Plan>,
    /// How long images may take to rest; a stop that takes longer is left out.
    pub patience: Duration,
}

impl Tour {
    /// How many stops it has.
    pub fn stops(&self) -> usize {
        self.ways.len().saturating_sub(1)
    }

    /// What it takes at most.
    pub fn duration_max(&self) -> Duration {
        let way = |plan: &Plan| plan.duration() + LATE_MAX + SETTLE + self.patience;
        LEAD * 2 + self.ways.iter().map(way).sum::<Duration>()
    }

    /// What its ways alone take.
    pub fn ways_take(&self) -> Duration {
        self.ways.iter().map(Plan::duration).sum()
    }
}

/// What a tour has come to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Visited {
    /// Stops of which there is a pair.
    pub taken: usize,
    /// Stops at which no image rested in time, by number from 1.
    pub restless: Vec<usize>,
    /// Whether the tour came to its end.
    pub is_whole: bool,
}

/// How far those who take images are, for the thread that moves.
#[derive(Debug, Default)]
struct Progress {
    /// Stops that are done with, from the first one on.
    done: AtomicUsize,
    /// The arm is under way.
    is_under_way: AtomicBool,
}

/// Makes a tour and writes its pairs with a `stops.toml` into a folder; both arms are stopped on every way out.
///
/// # Errors
/// If an arm or the camera fails for good, or something cannot be written; what was taken before is kept.
pub fn run(setup: &Setup, parts: Parts, tour: &Tour, folder: &Path, date: String) -> Result<Visited> {
    let Parts { clock, camera, vs, tc, cell, emulated, interrupt, .. } = parts;
    let progress = Progress::default();
    let mut watching = Watching {
        capturing: Looking {
            capturing: Capturing::new(setup, camera, cell),
            // Nobody has to render what nobody keeps.
            unless_under_way: setup.world().is_some().then_some(&progress),
            pause: (setup.pace == Pace::Live).then_some((&*clock, setup.rig.frames.period)),
        },
        resting: Resting { exposure: setup.rig.frames.exposure, step: None, sums: Sums::default(), before: None },
        keeping: Keeping::new(setup, (folder, date), &progress)?,
    };
    let mut visiting = Visiting {
        arms: BothArms::new(setup, (vs, tc), clock.now()),
        tour,
        progress: &progress,
        is_over: &interrupt,
        phase: Phase::Leading,
        way: 0,
        is_whole: false,
    };
    let course = Course { setup, clock: &clock, duration: tour.duration_max(), interrupt: &interrupt };
    let (ended, _) = course.run(&mut watching, &mut visiting);
    let Visiting { arms, way, is_whole, .. } = visiting;
    // The arms go before what is at the other end of their lines.
    drop(arms);
    drop(emulated);
    let taken = watching.keeping.taken;
    let restless = (0..way.min(tour.stops())).filter(|stop| !taken.contains(stop)).map(|stop| stop + 1).collect();
    ended.map(|()| Visited { taken: taken.len(), restless, is_whole })
}

/// Takes one pair where both arms are, brakes on: nothing moves.
///
/// # Errors
/// As [`run`], and if no image rests within `patience`.
pub fn look_here(setup: &Setup, parts: Parts, patience: Duration, folder: &Path, date: String) -> Result<()> {
    let Parts { clock, camera, vs, tc, cell, emulated, interrupt, .. } = parts;
    let progress = Progress::default();
    let mut keeping = Keeping::new(setup, (folder, date), &progress)?;
    let mut capturing = Capturing::new(setup, camera, cell);
    let mut arms = BothArms::new(setup, (vs, tc), clock.now());
    let (begin, mut before, mut shift) = (clock.now(), None::<Arc<FramePair>>, f64::INFINITY);
    while !interrupt.load(Ordering::SeqCst) {
        if clock.now().saturating_since(begin) > patience {
            bail!(
                "no image has rested within {patience:?}: the last one moved by {shift:.2} px, {STILL_WITHIN_PX} are allowed; let the rig come to rest"
            );
        }
        arms.look();
        clock.sleep_until(clock.now() + setup.rig.frames.period);
        let Some(pair) = capturing.capture()?.and_then(pair_of) else { continue };
        shift = before.as_ref().map_or(f64::INFINITY, |before| shift_of(before, &pair));
        if shift <= STILL_WITHIN_PX {
            let [vs_rad, tc_rad] = [&arms.vs, &arms.tc].map(|arm| arm.joints().position_rad);
            keeping.keep(&Still { stop: 0, pair, vs_rad, tc_rad })?;
            break;
        }
        before = Some(pair);
    }
    drop(arms);
    drop(emulated);
    Ok(())
}

fn pair_of(captured: Captured) -> Option<Arc<FramePair>> {
    match captured.view {
        View::Images(pair) => Some(pair),
        View::Geometric(_) => None,
    }
}

/// The larger shift of both cameras.
fn shift_of(before: &FramePair, after: &FramePair) -> f64 {
    shift_px(&before.left, &after.left).max(shift_px(&before.right, &after.right))
}

/// One control step.
#[derive(Clone, Copy, Debug)]
pub struct VisitStep {
    vs_rad: JointVector,
    tc_rad: JointVector,
    /// The stop at which the joints rest, and since when.
    rest: Option<(usize, MonotonicTime)>,
}

/// Where in its way the arm is.
#[derive(Clone, Copy, Debug)]
enum Phase {
    /// Before the first step.
    Leading,
    /// Under way since then.
    Going(MonotonicTime),
    /// There, and rests since then, where its joints were this.
    Resting { since: MonotonicTime, from_rad: JointVector, arrived: MonotonicTime },
    /// The last way is done.
    Done,
}

/// Both arms on the tour.
struct Visiting<'a> {
    arms: BothArms,
    tour: &'a Tour,
    progress: &'a Progress,
    is_over: &'a AtomicBool,
    phase: Phase,
    way: usize,
    is_whole: bool,
}

impl Mover for Visiting<'_> {
    type Step = VisitStep;

    fn enable(&mut self) -> Result<bool> {
        self.arms.enable(Whence::Start)
    }

    fn begin_at(&mut self, _begin: MonotonicTime) {}

    fn observe(&mut self, _percept: Percept, _now: MonotonicTime) {}

    fn step(&mut self, now: MonotonicTime) -> Result<VisitStep> {
        self.visit(now).map_err(|failure| self.arms.traced(failure))
    }

    fn stop(&mut self) -> Result<()> {
        self.arms.stop()
    }
}

impl Visiting<'_> {
    fn led(&mut self) -> [&mut LedArm; 2] {
        match self.tour.choice {
            ArmChoice::Vs => [&mut self.arms.vs, &mut self.arms.tc],
            ArmChoice::Tc => [&mut self.arms.tc, &mut self.arms.vs],
        }
    }

    fn visit(&mut self, now: MonotonicTime) -> Result<VisitStep> {
        if matches!(self.phase, Phase::Leading) {
            let begins_rad = self.led()[0].joints().position_rad;
            // An operator may have taken minutes to type, and brakes that open let an arm sag.
            self.tour.ways[0].check_begin(&begins_rad)?;
            self.phase = Phase::Going(now + LEAD);
        }
        let command = self.command(now)?;
        let [goes, stays] = self.led();
        stays.exchange(JointCommand::Hold)?;
        goes.exchange(command)?;
        let position_rad = goes.joints().position_rad;
        self.advance(now, &position_rad);
        self.progress.is_under_way.store(!matches!(self.phase, Phase::Resting { .. }), Ordering::SeqCst);
        let rest = match self.phase {
            Phase::Resting { since, .. } if now.saturating_since(since) >= SETTLE && self.way < self.tour.stops() => {
                Some((self.way, since + SETTLE))
            }
            _ => None,
        };
        Ok(VisitStep { vs_rad: self.arms.vs.joints().position_rad, tc_rad: self.arms.tc.joints().position_rad, rest })
    }

    /// What the arm is told.
    fn command(&mut self, now: MonotonicTime) -> Result<JointCommand> {
        let Phase::Going(begin) = self.phase else { return Ok(JointCommand::Hold) };
        let plan = &self.tour.ways[self.way];
        let passed = now.saturating_since(begin);
        let (planned_rad, speed_rad_per_s) = plan.at(passed);
        let [goes, _] = self.led();
        let behind_rad = planned_rad - goes.joints().position_rad;
        if passed > plan.duration() + LATE_MAX {
            let joint = behind_rad.iamax();
            bail!(
                "{} did not arrive at stop {}: {:+.3} degrees are left",
                plan.axis_name(joint),
                self.way + 1,
                behind_rad[joint].to_degrees()
            );
        }
        Ok(JointCommand::Velocity(speed_rad_per_s + behind_rad * GAIN_PER_S))
    }

    /// The next phase, if it is time.
    fn advance(&mut self, now: MonotonicTime, position_rad: &JointVector) {
        match self.phase {
            Phase::Going(begin) => {
                let plan = &self.tour.ways[self.way];
                let is_there = (plan.end_rad() - position_rad).amax() <= ARRIVED_WITHIN_RAD;
                if now.saturating_since(begin) >= plan.duration() && is_there {
                    self.phase = Phase::Resting { since: now, from_rad: *position_rad, arrived: now };
                }
            }
            Phase::Resting { since, from_rad, arrived } => {
                if (position_rad - from_rad).amax() > RESTS_WITHIN_RAD {
                    self.phase = Phase::Resting { since: now, from_rad: *position_rad, arrived };
                }
                let is_late = now.saturating_since(arrived) > SETTLE + self.tour.patience;
                let is_last = self.way >= self.tour.stops();
                if is_last && now.saturating_since(since) >= LEAD {
                    self.is_whole = true;
                    self.phase = Phase::Done;
                    self.is_over.store(true, Ordering::SeqCst);
                } else if !is_last && (self.progress.done.load(Ordering::SeqCst) > self.way || is_late) {
                    // Whoever comes late with a pair of this stop finds that it is done with.
                    self.way += 1;
                    self.progress.done.fetch_max(self.way, Ordering::SeqCst);
                    self.phase = Phase::Going(now);
                }
            }
            Phase::Leading | Phase::Done => {}
        }
    }
}

/// Camera, judgement of what rests, and what is kept: each may have a thread.
struct Watching<'a> {
    capturing: Looking<'a>,
    resting: Resting,
    keeping: Keeping<'a>,
}

/// A camera that is not asked for images while the arm is under way, if a progress is given.
struct Looking<'a> {
    capturing: Capturing,
    unless_under_way: Option<&'a Progress>,
    /// How long it waits in the place of an image, where nobody else tells when the next one is due.
    pause: Option<(&'a dyn Clock, Duration)>,
}

impl Capture for Looking<'_> {
    type Frame = Captured;

    fn capture(&mut self) -> Result<Option<Captured>> {
        match self.unless_under_way {
            Some(progress) if progress.is_under_way.load(Ordering::SeqCst) => {
                if let Some((clock, period)) = self.pause {
                    clock.sleep_until(clock.now() + period);
                }
                Ok(None)
            }
            _ => self.capturing.capture(),
        }
    }

    fn input(frame: &Captured) -> FrameInput {
        Capturing::input(frame)
    }
}

impl Parted for Watching<'_> {
    type Step = VisitStep;
    type Frame = Captured;
    type Seen = Option<Still>;

    fn begin_at(&mut self, _begin: MonotonicTime) {}

    fn parts(
        &mut self,
    ) -> (
        impl Capture<Frame = Captured>,
        impl Estimate<Frame = Captured, Seen = Option<Still>, Step = VisitStep>,
        impl Record<Seen = Option<Still>, Step = VisitStep>,
    ) {
        (&mut self.capturing, Judging(&mut self.resting), Writing(&mut self.keeping))
    }
}

/// A pair that rests, with the joints of its stop.
struct Still {
    stop: usize,
    pair: Arc<FramePair>,
    vs_rad: JointVector,
    tc_rad: JointVector,
}

/// Tells which pairs rest.
struct Resting {
    exposure: Duration,
    step: Option<VisitStep>,
    sums: Sums,
    /// The pair before, if it belongs to the same stop.
    before: Option<(usize, Arc<FramePair>)>,
}

/// Joints of one stop, added up: their mean has less of the noise of resolvers.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    stop: Option<usize>,
    count: f64,
    vs_rad: JointVector,
    tc_rad: JointVector,
}

struct Judging<'a>(&'a mut Resting);

impl Estimate for Judging<'_> {
    type Frame = Captured;
    type Seen = Option<Still>;
    type Step = VisitStep;

    fn moved(&mut self, step: &VisitStep) {
        let Self(resting) = self;
        resting.step = Some(*step);
        let Some((stop, _)) = step.rest else {
            resting.sums = Sums::default();
            return;
        };
        if resting.sums.stop != Some(stop) {
            resting.sums = Sums { stop: Some(stop), ..Sums::default() };
        }
        resting.sums.count += 1.0;
        resting.sums.vs_rad += step.vs_rad;
        resting.sums.tc_rad += step.tc_rad;
    }

    fn look(&mut self, frame: Captured) -> Result<(Percept, Option<Still>)> {
        let Self(resting) = self;
        let at = frame.frame.at;
        let estimate = EstimateInput { at, confidence: Confidence::NoPose, covariance: None, target: 0 };
        let percept = Percept { frame: frame.frame, estimate, observation: None };
        let skew = Duration::from_secs_f64(frame.frame.skew_s.abs().min(1.0));
        let stop = resting.step.and_then(|step| step.rest).filter(|(_, since)| at >= *since + resting.exposure + skew);
        let (Some((stop, _)), Some(pair)) = (stop, pair_of(frame)) else {
            resting.before = None;
            return Ok((percept, None));
        };
        let before = resting.before.replace((stop, Arc::clone(&pair))).filter(|(of, _)| *of == stop);
        let is_still = before.is_some_and(|(_, before)| shift_of(&before, &pair) <= STILL_WITHIN_PX);
        let Sums { count, vs_rad, tc_rad, .. } = resting.sums;
        let still = Still { stop, pair, vs_rad: vs_rad / count, tc_rad: tc_rad / count };
        Ok((percept, is_still.then_some(still)))
    }
}

/// Writes pairs and joints.
struct Keeping<'a> {
    folder: PathBuf,
    stops: Stops,
    /// Numbers of those stops.
    taken: Vec<usize>,
    chains: [Chain; 2],
    progress: &'a Progress,
}

impl<'a> Keeping<'a> {
    fn new(setup: &Setup, (folder, date): (&Path, String), progress: &'a Progress) -> Result<Self> {
        for side in ["left", "right"] {
            let folder = folder.join(side);
            std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be created", folder.display()))?;
        }
        let chains = [setup.rig.vs.chain.clone(), setup.rig.tc.chain.clone()];
        Ok(Self {
            folder: folder.to_path_buf(),
            stops: Stops { date, stops: Vec::new() },
            taken: Vec::new(),
            chains,
            progress,
        })
    }

    /// Keeps a pair, unless its stop is done with.
    fn keep(&mut self, still: &Still) -> Result<()> {
        if self.progress.done.load(Ordering::SeqCst) > still.stop {
            return Ok(());
        }
        let name = |side: &str| format!("{side}/{:06}.png", still.stop);
        let (left, right) = (name("left"), name("right"));
        for (file, image) in [(&left, &still.pair.left), (&right, &still.pair.right)] {
            let file = self.folder.join(file);
            save(image, &file, StoredFormat::QuickPng)?;
        }
        let [vs, tc] = [(&self.chains[0], &still.vs_rad), (&self.chains[1], &still.tc_rad)].map(stand);
        self.taken.push(still.stop);
        self.stops.stops.push(Stop { left, right, vs, tc: Some(tc) });
        save_stops(&self.folder, &self.stops)?;
        self.progress.done.fetch_max(still.stop + 1, Ordering::SeqCst);
        tracing::info!("stop {}: taken", still.stop + 1);
        Ok(())
    }
}

fn stand((chain, joints_rad): (&Chain, &JointVector)) -> ArmStand {
    let joints: [f64; DOF] = (*joints_rad).into();
    ArmStand { joints_rad: joints, base_from_flange: chain.forward(joints_rad) }
}

struct Writing<'w, 'a>(&'w mut Keeping<'a>);

impl Record for Writing<'_, '_> {
    type Seen = Option<Still>;
    type Step = VisitStep;

    fn moved(&mut self, _step: &VisitStep) {}

    fn note(&mut self, seen: Option<Still>) -> Result<()> {
        seen.map_or(Ok(()), |still| self.0.keep(&still))
    }
}

#[cfg(test)]
mod tests {
    use image::RgbImage;
    use pb3dp_geometry::ImageSize;

    use super::*;

    const EXPOSURE: Duration = Duration::from_millis(4);

    /// A pattern that was moved by this.
    fn image(by_px: f64) -> RgbImage {
        RgbImage::from_fn(96, 72, |x, y| {
            let value = 120.0 + 60.0 * ((f64::from(x) - by_px) * 0.4).sin() * (f64::from(y) * 0.3).cos();
            image::Rgb([value.round() as u8; 3])
        })
    }

    fn frame(millis: u64, by_px: f64, skew_s: f64) -> Captured {
        let at = MonotonicTime::from_nanos(millis * 1_000_000);
        let black = FramePair::black(ImageSize { width: 96, height: 72 });
        let pair = FramePair { left: image(0.0), right: image(by_px), ..black };
        Captured {
            frame: FrameInput { sequence: millis, at, skew_s },
            cam_left_from_target: None,
            view: View::Images(Arc::new(pair)),
        }
    }

    fn step(stop: Option<usize>, since_millis: u64, joint_rad: f64) -> VisitStep {
        let vs_rad = JointVector::repeat(joint_rad);
        let rest = stop.map(|stop| (stop, MonotonicTime::from_nanos(since_millis * 1_000_000)));
        VisitStep { vs_rad, tc_rad: -vs_rad, rest }
    }

    #[test]
    fn only_images_that_rest_with_the_joints_count() {
        let mut resting = Resting { exposure: EXPOSURE, step: None, sums: Sums::default(), before: None };
        let mut judging = Judging(&mut resting);
        let taken = |judging: &mut Judging<'_>, frame: Captured| judging.look(frame).unwrap().1.map(|still| still.stop);
        // Nothing rests before the joints do.
        assert_eq!(taken(&mut judging, frame(10, 0.0, 0.0)), None);
        judging.moved(&step(None, 0, 0.5));
        assert_eq!(taken(&mut judging, frame(20, 0.0, 0.0)), None);
        judging.moved(&step(Some(3), 100, 0.1));
        // Exposed before that: on its way.
        assert_eq!(taken(&mut judging, frame(102, 0.0, 0.0)), None);
        // By stamps that are apart one of the eyes was.
        assert_eq!(taken(&mut judging, frame(110, 0.0, 0.01)), None);
        assert_eq!(taken(&mut judging, frame(130, 0.0, 0.0)), None, "the first one has nothing to be compared with");
        assert_eq!(taken(&mut judging, frame(160, 0.3, 0.0)), None, "the hand still swings");
        judging.moved(&step(Some(3), 100, 0.3));
        let (_, still) = judging.look(frame(190, 0.3, 0.0)).unwrap();
        let still = still.expect("both images and joints rest");
        assert_eq!(still.stop, 3);
        // The mean of both measurements.
        assert!((still.vs_rad[0] - 0.2).abs() < 1e-12 && (still.tc_rad[6] + 0.2).abs() < 1e-12);
        // The next stop begins anew.
        judging.moved(&step(Some(4), 300, 0.7));
        assert_eq!(taken(&mut judging, frame(320, 0.3, 0.0)), None);
        assert_eq!(taken(&mut judging, frame(350, 0.3, 0.0)), Some(4));
    }
}
