//! An arm visits a list of poses; at each stop, once joints and images are stationary, one stereo pair is recorded for a calibration.
//!
//! Uses the same parts and loops as a run, with limiter, guard and coupling; the other arm holds. Each path is straight in joint space and
//! stationary at both ends. Each pair is on disk before the arm moves on.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Clock, EnablePosition, FramePair, JointCommand};
use pb3dp_kinematics::{Chain, DOF, JointVector};
use pb3dp_record::images::{StoredFormat, save};
use pb3dp_record::stops::{ArmStand, Stop, Stops, save_stops};
use pb3dp_recording::stops::StopsRecording;
use pb3dp_setup::setup::{Pace, Setup};

use super::drive::{ARRIVED_WITHIN_RAD, GAIN_PER_S, LATE_MAX};
use super::stillness::shift_px;
use pb3dp_cell::both_arms::{BothArms, CellArm};
use pb3dp_cell::capturing::{Captured, Capturing};
use pb3dp_cell::halves::{Capture, Estimate, Mover, Record, RunContext};
use pb3dp_cell::parts::{ArmChoice, Parts};
use pb3dp_cell::percept::Percept;
use pb3dp_cell::perception::View;
use pb3dp_cell::plan::Plan;

/// Joints that move by less than this within the settling time are stationary, rad: a few steps of a resolver.
const RESTS_WITHIN_RAD: f64 = 2e-4;
/// Time for which joints must be stationary before images count: the structure vibrates after a stop.
const SETTLE: Duration = Duration::from_millis(500);
/// Images with less motion than this from one to the next are stationary, pixels.
pub const STILL_WITHIN_PX: f64 = 0.05;
/// Wait before the first path and after the last one.
const LEAD: Duration = Duration::from_millis(500);

/// A tour: consecutive paths with a stop at the end of each but the last one, which returns to the start.
#[derive(Clone, Debug)]
pub struct Tour {
    /// The arm that moves.
    pub choice: ArmChoice,
    /// The paths.
    pub ways: Vec<Plan>,
    /// Longest wait for stationary images; a stop that takes longer is skipped.
    pub patience: Duration,
}

impl Tour {
    /// Number of stops.
    pub fn stops(&self) -> usize {
        self.ways.len().saturating_sub(1)
    }

    /// Longest duration.
    pub fn duration_max(&self) -> Duration {
        let way = |plan: &Plan| plan.duration() + LATE_MAX + SETTLE + self.patience;
        LEAD * 2 + self.ways.iter().map(way).sum::<Duration>()
    }

    /// Duration of the paths alone.
    pub fn travel_time(&self) -> Duration {
        self.ways.iter().map(Plan::duration).sum()
    }
}

/// Result of a tour.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Visited {
    /// Number of stops with a recorded pair.
    pub taken: usize,
    /// Stops without stationary images in time, numbered from 1.
    pub unsettled_stops: Vec<usize>,
    /// Whether the tour reached its end.
    pub is_whole: bool,
}

/// Progress of the image half, for the motion half.
#[derive(Debug, Default)]
struct Progress {
    /// Number of finished stops, from the first one on.
    done: AtomicUsize,
    /// The arm is moving between stops.
    is_under_way: AtomicBool,
}

/// Where stops are written; at least one is given.
pub struct Output {
    /// A folder, which gets a `stops.toml` beside the images.
    pub folder: Option<PathBuf>,
    /// A file.
    pub file: Option<StopsRecording>,
}

/// Makes a tour and writes its pairs; stops both arms on every exit path.
///
/// # Errors
/// If an arm or the camera fails permanently, or writing fails; pairs recorded before are kept.
pub fn run(setup: &Setup, parts: Parts, tour: &Tour, output: Output, date: String) -> Result<Visited> {
    let Parts { clock, camera, vs, tc, cell, emulated, interrupt, .. } = parts;
    let progress = Progress::default();
    let mut looking = StopCapture {
        capturing: Capturing::new(setup, camera, cell),
        // In simulation, images that are not used are not rendered.
        unless_under_way: setup.world.is_some().then_some(&progress),
        pause: (setup.pace == Pace::Live).then_some((&*clock, setup.rig.frames.period)),
    };
    let mut resting = Resting { exposure: setup.rig.frames.exposure, step: None, sums: Sums::default(), before: None };
    let mut stop_recorder = StopRecorder::new(setup, (output, date), &progress)?;
    let mut visit_run = VisitMotion {
        arms: BothArms::new(setup, (vs, tc), clock.now()),
        tour,
        progress: &progress,
        is_over: &interrupt,
        phase: Phase::Leading,
        way: 0,
        is_whole: false,
    };
    let run_context = RunContext { setup, clock: &clock, duration: tour.duration_max(), interrupt: &interrupt };
    let (ended, _) = run_context.run((&mut looking, &mut resting, &mut stop_recorder), &mut visit_run);
    let VisitMotion { arms, way, is_whole, .. } = visit_run;
    // The arms are dropped before the emulators at the other end of their links.
    drop(arms);
    drop(emulated);
    let StopRecorder { taken, output, .. } = stop_recorder;
    let written = output.file.map_or(Ok(()), StopsRecording::finish);
    let unsettled_stops =
        (0..way.min(tour.stops())).filter(|stop| !taken.contains(stop)).map(|stop| stop + 1).collect();
    ended.and(written).map(|()| Visited { taken: taken.len(), unsettled_stops, is_whole })
}

/// Records one pair at the current pose, with closed brakes.
///
/// # Errors
/// As [`run`], and if no image is stationary within `patience`.
pub fn record_here(setup: &Setup, parts: Parts, patience: Duration, output: Output, date: String) -> Result<()> {
    let Parts { clock, camera, vs, tc, cell, emulated, interrupt, .. } = parts;
    let progress = Progress::default();
    let mut stop_recorder = StopRecorder::new(setup, (output, date), &progress)?;
    let mut capturing = Capturing::new(setup, camera, cell);
    let mut arms = BothArms::new(setup, (vs, tc), clock.now());
    let (begin, mut before, mut shift) = (clock.now(), None::<Arc<FramePair>>, f64::INFINITY);
    while !interrupt.load(Ordering::SeqCst) {
        if clock.now().saturating_since(begin) > patience {
            bail!(
                "no stationary image within {patience:?}: the last image moved by {shift:.2} px, limit {STILL_WITHIN_PX} px; stop all motion of the rig"
            );
        }
        arms.look();
        clock.sleep_until(clock.now() + setup.rig.frames.period);
        let Some(pair) = capturing.capture()?.and_then(pair_of) else { continue };
        shift = before.as_ref().map_or(f64::INFINITY, |before| shift_of(before, &pair));
        if shift <= STILL_WITHIN_PX {
            let [vs_rad, tc_rad] = [&arms.vs, &arms.tc].map(|arm| arm.joints().position_rad);
            stop_recorder.moved(&VisitStep { at: pair.exposed_at, vs_rad, tc_rad, rest: None });
            stop_recorder.keep(&Still { stop: 0, pair, vs_rad, tc_rad })?;
            break;
        }
        before = Some(pair);
    }
    drop(arms);
    drop(emulated);
    stop_recorder.output.file.map_or(Ok(()), StopsRecording::finish)
}

fn pair_of(captured: Captured) -> Option<Arc<FramePair>> {
    match captured.view {
        View::Images(pair) => Some(pair),
        View::Geometric(_) | View::Nothing => None,
    }
}

/// The larger image motion of the two cameras.
fn shift_of(before: &FramePair, after: &FramePair) -> f64 {
    shift_px(&before.left, &after.left).max(shift_px(&before.right, &after.right))
}

/// One control step of a tour.
#[derive(Clone, Copy, Debug)]
pub struct VisitStep {
    at: MonotonicTime,
    vs_rad: JointVector,
    tc_rad: JointVector,
    /// The stop at which the joints are stationary, and since when.
    rest: Option<(usize, MonotonicTime)>,
}

/// Progress on the current path.
#[derive(Clone, Copy, Debug)]
enum Phase {
    /// Before the first step.
    Leading,
    /// Moving since this time.
    Going(MonotonicTime),
    /// Arrived; stationary since `since` within a tolerance of `from_rad`.
    Resting { since: MonotonicTime, from_rad: JointVector, arrived: MonotonicTime },
    /// The last path is finished.
    Done,
}

/// The motion half of a tour.
struct VisitMotion<'a> {
    arms: BothArms,
    tour: &'a Tour,
    progress: &'a Progress,
    is_over: &'a AtomicBool,
    phase: Phase,
    way: usize,
    is_whole: bool,
}

impl Mover for VisitMotion<'_> {
    type Step = VisitStep;

    fn enable(&mut self) -> Result<bool> {
        self.arms.enable(EnablePosition::Start)
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

impl VisitMotion<'_> {
    fn led(&mut self) -> [&mut CellArm; 2] {
        match self.tour.choice {
            ArmChoice::Vs => [&mut self.arms.vs, &mut self.arms.tc],
            ArmChoice::Tc => [&mut self.arms.tc, &mut self.arms.vs],
        }
    }

    fn visit(&mut self, now: MonotonicTime) -> Result<VisitStep> {
        if matches!(self.phase, Phase::Leading) {
            let begins_rad = self.led()[0].joints().position_rad;
            // The operator may have taken minutes to answer, and an arm can sag when its brakes open.
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
        let [vs_rad, tc_rad] = [&self.arms.vs, &self.arms.tc].map(|arm| arm.joints().position_rad);
        Ok(VisitStep { at: now, vs_rad, tc_rad, rest })
    }

    /// Command for the arm.
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
                "{} did not arrive at stop {}: residual {:+.3} degrees",
                plan.axis_name(joint),
                self.way + 1,
                behind_rad[joint].to_degrees()
            );
        }
        Ok(JointCommand::Velocity(speed_rad_per_s + behind_rad * GAIN_PER_S))
    }

    /// Advances to the next phase when due.
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
                    // A late pair of this stop is recognised as finished.
                    self.way += 1;
                    self.progress.done.fetch_max(self.way, Ordering::SeqCst);
                    self.phase = Phase::Going(now);
                }
            }
            Phase::Leading | Phase::Done => {}
        }
    }
}

/// The camera; with a progress, no images are requested while the arm moves.
struct StopCapture<'a> {
    capturing: Capturing,
    unless_under_way: Option<&'a Progress>,
    /// Replaces the wait for an image where nothing else paces the loop.
    pause: Option<(&'a dyn Clock, Duration)>,
}

impl Capture for StopCapture<'_> {
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
}

/// A stationary pair with the joints of its stop.
struct Still {
    stop: usize,
    pair: Arc<FramePair>,
    vs_rad: JointVector,
    tc_rad: JointVector,
}

/// Finds stationary pairs.
struct Resting {
    exposure: Duration,
    step: Option<VisitStep>,
    sums: Sums,
    /// The previous pair, if it belongs to the same stop.
    before: Option<(usize, Arc<FramePair>)>,
}

/// Sums of the joints at one stop: the mean reduces resolver noise.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    stop: Option<usize>,
    count: f64,
    vs_rad: JointVector,
    tc_rad: JointVector,
}

impl Estimate<VisitStep> for Resting {
    type Observed = Option<Still>;

    fn moved(&mut self, step: &VisitStep) {
        self.step = Some(*step);
        let Some((stop, _)) = step.rest else {
            self.sums = Sums::default();
            return;
        };
        if self.sums.stop != Some(stop) {
            self.sums = Sums { stop: Some(stop), ..Sums::default() };
        }
        self.sums.count += 1.0;
        self.sums.vs_rad += step.vs_rad;
        self.sums.tc_rad += step.tc_rad;
    }

    fn look(&mut self, frame: Captured) -> Result<(Option<Percept>, Option<Still>)> {
        let at = frame.frame.at;
        let skew = Duration::from_secs_f64(frame.frame.skew_s.abs().min(1.0));
        let stop = self.step.and_then(|step| step.rest).filter(|(_, since)| at >= *since + self.exposure + skew);
        let (Some((stop, _)), Some(pair)) = (stop, pair_of(frame)) else {
            self.before = None;
            return Ok((None, None));
        };
        let before = self.before.replace((stop, Arc::clone(&pair))).filter(|(of, _)| *of == stop);
        let is_still = before.is_some_and(|(_, before)| shift_of(&before, &pair) <= STILL_WITHIN_PX);
        let Sums { count, vs_rad, tc_rad, .. } = self.sums;
        let still = Still { stop, pair, vs_rad: vs_rad / count, tc_rad: tc_rad / count };
        Ok((None, is_still.then_some(still)))
    }
}

/// Writes pairs and joints.
struct StopRecorder<'a> {
    output: Output,
    stops: Stops,
    /// Numbers of the recorded stops.
    taken: Vec<usize>,
    chains: [Chain; 2],
    progress: &'a Progress,
}

impl<'a> StopRecorder<'a> {
    fn new(setup: &Setup, (output, date): (Output, String), progress: &'a Progress) -> Result<Self> {
        for folder in output.folder.iter().flat_map(|folder| ["left", "right"].map(|side| folder.join(side))) {
            std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be created", folder.display()))?;
        }
        let chains = [setup.rig.arms.vs.chain.clone(), setup.rig.arms.tc.chain.clone()];
        Ok(Self { output, stops: Stops { date, stops: Vec::new() }, taken: Vec::new(), chains, progress })
    }

    /// Records a pair, unless its stop is finished.
    fn keep(&mut self, still: &Still) -> Result<()> {
        if self.progress.done.load(Ordering::SeqCst) > still.stop {
            return Ok(());
        }
        let [vs, tc] = [(&self.chains[0], &still.vs_rad), (&self.chains[1], &still.tc_rad)].map(stand);
        if let Some(folder) = &self.output.folder {
            let name = |side: &str| format!("{side}/{:06}.png", still.stop);
            let (left, right) = (name("left"), name("right"));
            for (file, image) in [(&left, &still.pair.left), (&right, &still.pair.right)] {
                save(image, &folder.join(file), StoredFormat::Png)?;
            }
            self.stops.stops.push(Stop { left, right, vs, tc: Some(tc) });
            save_stops(folder, &self.stops)?;
        }
        if let Some(file) = &mut self.output.file {
            file.stop(&still.pair, [&vs, &tc]);
        }
        self.taken.push(still.stop);
        self.progress.done.fetch_max(still.stop + 1, Ordering::SeqCst);
        tracing::info!("stop {}: recorded", still.stop + 1);
        Ok(())
    }
}

fn stand((chain, joints_rad): (&Chain, &JointVector)) -> ArmStand {
    let joints: [f64; DOF] = (*joints_rad).into();
    ArmStand { joints_rad: joints, base_from_flange: chain.forward(joints_rad) }
}

impl Record<VisitStep, Option<Still>> for StopRecorder<'_> {
    /// Records the joints of a control step.
    fn moved(&mut self, step: &VisitStep) {
        if let Some(file) = &mut self.output.file {
            file.step(step.at, [&step.vs_rad, &step.tc_rad]);
        }
    }

    fn note(&mut self, still_stop: Option<Still>) -> Result<()> {
        still_stop.map_or(Ok(()), |still| self.keep(&still))
    }
}

#[cfg(test)]
mod tests {
    use image::RgbImage;
    use pb3dp_geometry::ImageSize;
    use pb3dp_servo::supervisor::FrameInput;

    use super::*;

    const EXPOSURE: Duration = Duration::from_millis(4);

    /// A pattern shifted by this.
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
        VisitStep { at: MonotonicTime::ZERO, vs_rad, tc_rad: -vs_rad, rest }
    }

    #[test]
    fn only_images_that_rest_with_the_joints_count() {
        let mut resting = Resting { exposure: EXPOSURE, step: None, sums: Sums::default(), before: None };
        let taken = |resting: &mut Resting, frame: Captured| resting.look(frame).unwrap().1.map(|still| still.stop);
        // No image counts before the joints are stationary.
        assert_eq!(taken(&mut resting, frame(10, 0.0, 0.0)), None);
        resting.moved(&step(None, 0, 0.5));
        assert_eq!(taken(&mut resting, frame(20, 0.0, 0.0)), None);
        resting.moved(&step(Some(3), 100, 0.1));
        // Exposed before that, during the motion.
        assert_eq!(taken(&mut resting, frame(102, 0.0, 0.0)), None);
        // By the stamps one of the images was exposed during the motion.
        assert_eq!(taken(&mut resting, frame(110, 0.0, 0.01)), None);
        assert_eq!(taken(&mut resting, frame(130, 0.0, 0.0)), None, "the first pair has no predecessor");
        assert_eq!(taken(&mut resting, frame(160, 0.3, 0.0)), None, "the hand still swings");
        resting.moved(&step(Some(3), 100, 0.3));
        let (_, still) = resting.look(frame(190, 0.3, 0.0)).unwrap();
        let still = still.expect("images and joints are stationary");
        assert_eq!(still.stop, 3);
        // The mean of both measurements.
        assert!((still.vs_rad[0] - 0.2).abs() < 1e-12 && (still.tc_rad[6] + 0.2).abs() < 1e-12);
        // The next stop starts over.
        resting.moved(&step(Some(4), 300, 0.7));
        assert_eq!(taken(&mut resting, frame(320, 0.3, 0.0)), None);
        assert_eq!(taken(&mut resting, frame(350, 0.3, 0.0)), Some(4));
    }
}
