//! Tracks all targets through the frames.

use std::mem::Discriminant;

use anyhow::{Context, Result, bail};
use image::RgbImage;
use nalgebra::Vector2;
use pb3dp_cell::calibration_share::term_or_warning;
use pb3dp_cell::follower::Follower;
use pb3dp_estimation::estimator::{FramePrior, Tracker};
use pb3dp_estimation::pair_check::check_pair;
use pb3dp_estimation::skew_watch::Skew;
use pb3dp_estimation_core::estimate::{EstimateWarning, TrackEstimate};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region, RegionConfig};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{MonotonicTime, Pose, StereoRig};
use pb3dp_hal_api::FramePair;
use pb3dp_hal_platform::cpu_time::{timed, within};
use pb3dp_record::images::size_of;
use pb3dp_setup::estimator::estimator_config;
use pb3dp_setup::region_spec::{RegionSpec, load_region};
use pb3dp_wiring::Recording;
use pb3dp_wiring::message_codes::error_text;

use crate::arguments::TrackArgs;
use crate::commands::pair::{tell_click, usable};

/// All targets of a sequence.
pub struct Walk {
    rig: StereoRig,
    regions: RegionConfig,
    targets: Vec<TrackedTarget>,
    /// The first readable frame.
    first: Option<usize>,
    /// The frame since which the motion is compared with the truth: the second one if the exposures of the first pair differ, since that
    /// pair does not show how the target moved in between.
    judged_from: usize,
    /// Mid-exposure of the last readable frame.
    last_at: Option<MonotonicTime>,
    /// What was assumed of the calibration, until it is reported.
    calibration_warnings: Vec<String>,
    rotation_about_normal_observed: bool,
    /// CPU time for one target in one frame, milliseconds.
    deadline_millis: Option<f64>,
    /// The skew of all pairs, if the recording states none, and what is to be told of it with the first frame.
    skew: Option<Skew>,
    skew_warning: Option<String>,
}

/// One target.
pub struct TrackedTarget {
    mark: Mark,
    follower: Follower,
    last_status: Status,
    /// Kinds of warnings of the last frame.
    last_warnings: Vec<Discriminant<EstimateWarning>>,
    poses: Vec<Option<Pose<CamLeft, Model>>>,
    /// Why the region is unusable.
    refused: Option<String>,
}

/// Origin of a region.
enum Mark {
    /// The file of the sequence.
    Polygon(Region),
    /// The command line.
    Spec(RegionSpec),
}

/// Result of one target in one frame.
pub struct TargetResult {
    /// Its number, if there are several.
    pub target: Option<usize>,
    /// The outcome.
    pub outcome: Outcome,
    /// Mismatch between the images and their calibration, and what was assumed of it; reported once, with the first frame.
    pub rig_warnings: Vec<String>,
}

/// Outcome of a target in a frame.
pub enum Outcome {
    /// It was tracked.
    Estimate {
        /// The estimate.
        estimate: Box<TrackEstimate>,
        /// CPU time that it took, milliseconds.
        millis: f64,
    },
    /// Its region is unusable, so it is not tracked.
    Refused {
        /// The reason.
        reason: String,
    },
}

impl TrackedTarget {
    fn new(mark: Mark, tracker: Tracker, range: SearchRange) -> Self {
        Self {
            mark,
            follower: Follower::new(tracker, range),
            last_status: Status::Ok,
            last_warnings: Vec::new(),
            poses: Vec::new(),
            refused: None,
        }
    }

    /// The pose in each frame so far.
    pub fn poses(&self) -> &[Option<Pose<CamLeft, Model>>] {
        &self.poses
    }

    /// Its tracker.
    pub fn tracker(&self) -> &Tracker {
        self.follower.tracker()
    }

    /// One frame; a target with a refused region is not tried again.
    fn look(&mut self, pair: &FramePair, prior: &FramePrior, deadline_millis: Option<f64>) -> Outcome {
        let outcome = match &self.refused {
            Some(reason) => Outcome::Refused { reason: reason.clone() },
            None => match self.step(pair, prior, deadline_millis) {
                Ok((estimate, millis)) => Outcome::Estimate { estimate: Box::new(estimate), millis },
                Err(error) => Outcome::Refused { reason: error_text(&error) },
            },
        };
        match &outcome {
            Outcome::Estimate { estimate, .. } => self.poses.push(estimate.cam_left_from_model),
            Outcome::Refused { reason } => {
                self.poses.push(None);
                self.refused = Some(reason.clone());
            }
        }
        outcome
    }

    /// For pairs whose skew nobody has stated.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn watch_skew(&mut self) -> Result<()> {
        Ok(self.follower.watch_skew(true)?)
    }

    /// For pairs whose skew is stated.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn check_skew(&mut self) -> Result<()> {
        Ok(self.follower.check_skew()?)
    }

    /// Follows the target for its skew only; whether the next pair is needed.
    pub fn look_for_skew(
        &mut self,
        pair: &FramePair,
        assumed: Option<Skew>,
        before: &mut Option<MonotonicTime>,
    ) -> bool {
        let last_at = before.replace(pair.exposed_at);
        let dt_s = last_at.map(|last_at| pair.exposed_at.seconds_since(last_at));
        let prior = FramePrior { dt_s, ..prior_of(assumed) };
        self.step(pair, &prior, None).is_ok() && self.tracker().skew().is_some_and(|skew| !skew.is_done())
    }

    fn region(&self, left: &RgbImage) -> Result<Region> {
        match &self.mark {
            Mark::Polygon(region) => Ok(region.clone()),
            Mark::Spec(spec) => load_region(spec, size_of(left)),
        }
    }

    fn step(
        &mut self,
        pair: &FramePair,
        prior: &FramePrior,
        deadline_millis: Option<f64>,
    ) -> Result<(TrackEstimate, f64)> {
        let region = if self.follower.is_started() { None } else { Some(self.region(&pair.left)?) };
        let (estimate, millis) = timed(|| {
            let mut may_continue = within(deadline_millis);
            self.follower.look(&pair.left, &pair.right, region.as_ref(), prior, &mut may_continue)
        });
        Ok((estimate?, millis))
    }

    /// Logs warnings, those of the same kind in neighbouring frames once, and the reason whenever the status changes.
    fn tell(&mut self, what: &str, estimate: &TrackEstimate) {
        let kind = std::mem::discriminant::<EstimateWarning>;
        for warning in estimate.warnings.iter().filter(|warning| !self.last_warnings.contains(&kind(warning))) {
            tracing::warn!("{what}: {warning}");
        }
        self.last_warnings = estimate.warnings.iter().map(kind).collect();
        if estimate.status != self.last_status {
            match estimate.status {
                Status::Ok => tracing::info!("{what}: ok: {}", estimate.reason),
                status => tracing::warn!("{what}: {status}: {}", estimate.reason),
            }
        }
        self.last_status = estimate.status;
    }
}

impl Walk {
    /// The region of the sequence, then those of the command line.
    ///
    /// # Errors
    /// A refused configuration, or a method that does not track.
    pub fn new(rig: &StereoRig, recording: &Recording, args: &TrackArgs, range: SearchRange) -> Result<Self> {
        let method = args.method.method;
        let mut config = estimator_config(args.method.config.as_deref(), args.method.seed)?;
        config.track.rolling_shutter_millis = args.rolling_shutter.unwrap_or(config.track.rolling_shutter_millis);
        let own = recording.region_polygon_left_px.as_ref().map(|corners| {
            let vertices_px = corners.iter().map(|&[u, v]| Vector2::new(u, v)).collect();
            Mark::Polygon(Region::Polygon { vertices_px })
        });
        let marks: Vec<Mark> = own.into_iter().chain(args.region.iter().cloned().map(Mark::Spec)).collect();
        if marks.is_empty() {
            bail!(
                "the recording has no region: mark the target in the left image of its first frame with --region, such as --region rect:X,Y,WIDTH,HEIGHT, or with the mouse: pb3dp panel --sequence {}",
                args.sequence.display()
            );
        }
        let term = term_or_warning(recording.camera.calibration());
        let target = |mark| {
            let tracker = Tracker::new(method, rig, &config)?.with_calibration(term.clone());
            Ok(TrackedTarget::new(mark, tracker, range))
        };
        Ok(Self {
            rig: *rig,
            regions: config.published.region,
            targets: marks.into_iter().map(target).collect::<Result<_>>()?,
            first: None,
            judged_from: 0,
            last_at: None,
            calibration_warnings: recording.camera.calibration().warnings.clone(),
            rotation_about_normal_observed: true,
            deadline_millis: args.method.deadline,
            skew: None,
            skew_warning: None,
        })
    }

    /// Takes a skew for all pairs, and a warning for the first frame.
    pub fn use_skew(&mut self, skew: Option<Skew>, warning: Option<String>) {
        (self.skew, self.skew_warning) = (skew, warning);
    }

    /// For pairs whose skew nobody knows: each target is watched for it.
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn watch_skew(&mut self) -> Result<()> {
        self.targets.iter_mut().try_for_each(TrackedTarget::watch_skew)
    }

    /// The first target.
    pub fn first_target(&mut self) -> Option<&mut TrackedTarget> {
        self.targets.first_mut()
    }

    /// The frame since which the motion is compared with the truth.
    pub fn judged_from(&self) -> usize {
        self.judged_from
    }

    /// All targets, that of the sequence first.
    pub fn targets(&self) -> &[TrackedTarget] {
        &self.targets
    }

    /// Whether the region of a target was refused.
    pub fn has_refused(&self) -> bool {
        self.targets.iter().any(|target| target.refused.is_some())
    }

    /// Whether the rotation about the normal was measured in every frame.
    pub fn rotation_about_normal_observed(&self) -> bool {
        self.rotation_about_normal_observed
    }

    /// Results of each target in a frame. If the region of one of several targets is refused, the others continue.
    ///
    /// # Errors
    /// Exchanged images in the first frame, or only refused regions.
    pub fn step(&mut self, frame: usize, pair: &FramePair) -> Result<Vec<TargetResult>> {
        let mut rig_warnings = Vec::new();
        let is_first = self.first.is_none();
        if is_first {
            let what = format!("frame {frame}");
            let pair_warning = usable(&what, &check_pair(&self.rig, &pair.left, &pair.right)).context(what)?;
            rig_warnings = pair_warning.into_iter().chain(std::mem::take(&mut self.calibration_warnings)).collect();
            if frame > 0 {
                tracing::warn!("the regions belong to frame 0, which cannot be read; they are used in frame {frame}");
            }
            if let Some(warning) = self.skew_warning.take() {
                tracing::warn!("{warning}");
                rig_warnings.push(warning);
            }
            self.first = Some(frame);
            if pair.skew_nanos != 0 || self.skew.is_some() {
                self.judged_from = frame + 1;
            }
        }
        let before = self.last_at.replace(pair.exposed_at);
        let dt_s = before.map(|before| pair.exposed_at.seconds_since(before));
        let skew = self.skew.or(Some(Skew { skew_s: pair.skew_s(), sigma_s: 0.0 }));
        let prior = FramePrior { dt_s, ..prior_of(skew) };
        let several = self.targets.len() > 1;
        let mut all = Vec::with_capacity(self.targets.len());
        for (index, target) in self.targets.iter_mut().enumerate() {
            let index = several.then_some(index);
            let what = index.map_or(format!("frame {frame}"), |index| format!("frame {frame}, target {index}"));
            let was_refused = target.refused.is_some();
            if is_first && let Ok(region) = target.region(&pair.left) {
                tell_click(&what, &region, &pair.left, &self.regions);
            }
            let outcome = target.look(pair, &prior, self.deadline_millis);
            match &outcome {
                Outcome::Estimate { estimate, .. } => {
                    target.tell(&what, estimate);
                    self.rotation_about_normal_observed &=
                        estimate.rotation_about_normal_observed || estimate.cam_left_from_model.is_none();
                }
                Outcome::Refused { reason } if !several => bail!("{what}: {reason}"),
                Outcome::Refused { reason } if !was_refused => {
                    tracing::error!("{what}: {reason}: this target is left out");
                }
                Outcome::Refused { .. } => {}
            }
            all.push(TargetResult { target: index, outcome, rig_warnings: rig_warnings.clone() });
        }
        if self.targets.iter().all(|target| target.refused.is_some()) {
            bail!("frame {frame}: the regions of all targets are refused");
        }
        Ok(all)
    }

    /// A frame that could not be read.
    pub fn skip(&mut self) {
        self.targets.iter_mut().for_each(|target| target.poses.push(None));
    }
}

/// What is known of the skew of a pair.
fn prior_of(skew: Option<Skew>) -> FramePrior {
    let known = |skew: Skew| FramePrior { skew_sigma_s: skew.sigma_s, ..FramePrior::of_skew(skew.skew_s) };
    skew.map(known).unwrap_or_default()
}
