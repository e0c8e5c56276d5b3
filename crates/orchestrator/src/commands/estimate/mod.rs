//! `pb3dp estimate`: the pose of a region in stereo images; a line per case, and errors by group if the truth is known.

pub mod job;
mod rigs;
mod surface;

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use nalgebra::{Matrix6, Vector2};
use pb3dp_cell::annotation::{Annotation, annotate, polygon_px};
use pb3dp_cell::calibration_share::of_first;
use pb3dp_cell::result_lines::EstimateLine;
use pb3dp_cell::terminal::print_line;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation::pair_check::check_pair;
use pb3dp_estimation_core::estimate::{PlaneEstimate, ReferenceOptimum, SecondPlane};
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::region::RegionConfig;
use pb3dp_estimation_core::status::Status;
use pb3dp_hal_platform::cpu_time::{timed, within};
use pb3dp_record::dataset::{find_cases, load_case};
use pb3dp_record::images::{StoredFormat, save};
use pb3dp_record::metrics::{self, DisparityAgreement, EvaluatedCase, Group, compare_plane, table};
use pb3dp_setup::estimator::estimator_config;
use pb3dp_wiring::message_codes::error_text;

use self::job::{Job, pair_name};
use self::rigs::Rigs;
use super::overlay_folder::{make_overlay_folder, report_overlay_folder};
use crate::arguments::{EstimateArgs, UNSURE};
use crate::commands::output_file::{check_cloud, is_same_file};
use crate::commands::pair::{tell_click, usable};
use crate::progress::Progress;

/// Runs the command. It processes all cases; the exit code is a failure if one of them failed.
///
/// # Errors
/// Bad arguments or configuration, or a folder without cases.
pub fn run(args: &EstimateArgs) -> Result<ExitCode> {
    let method = args.method.method;
    if args.reference_optimum && method != Method::Published {
        bail!("--reference-optimum: the method {method} has no reference optimum: use --method {}", Method::Published);
    }
    if let Some(file) = &args.surface {
        if !method.recovers_surface() {
            bail!("--surface: the method {method} recovers no surface: use --method {}", Method::Direct);
        }
        check_cloud("--surface", file)?;
        let inputs = [&args.left, &args.right].into_iter().flatten().chain(&args.calib);
        if let Some(input) = inputs.into_iter().find(|input| is_same_file(file, input)) {
            bail!("--surface {}: is an input of this command: give another name", input.display());
        }
    }
    args.method.warn_without_effect();
    let config = estimator_config(args.method.config.as_deref(), args.method.seed)?;
    let mut overlays = Overlays::open(args.method.overlay.as_deref())?;
    let jobs: Vec<Source> = match (&args.cases, &args.sequence) {
        (Some(dir), _) => {
            let folders = find_cases(dir)?;
            let plural = if folders.len() == 1 { "" } else { "s" };
            tracing::info!("{}: {} case{plural}", dir.display(), folders.len());
            folders.into_iter().map(Source::Case).collect()
        }
        (None, Some(path)) => vec![Source::Recording(path.clone(), args.frame)],
        (None, None) => vec![Source::Files(args.left.clone().unwrap_or_default())],
    };
    if !args.method.json {
        print_line(EstimateLine::HEADING)?;
    }
    let progress = Progress::of(jobs.len(), "pairs");
    let mut rigs = Rigs::default();
    let mut evaluated = Vec::new();
    let (mut refused, mut unsure) = (0_usize, 0_usize);
    for source in jobs {
        let name = source.name();
        let outcome = source.load(args).and_then(|job| work(&job, (method, &config), args, &mut rigs, &mut overlays));
        let line = match outcome {
            Ok((line, evaluation)) => {
                evaluated.extend(evaluation);
                line
            }
            Err(error) => {
                refused += 1;
                let reason = error_text(&error);
                tracing::error!("{}: {reason}", source.label());
                evaluated.extend(source.refused());
                EstimateLine::of_error(&name, method.name(), reason)
            }
        };
        unsure += usize::from(line.status != Status::Ok.as_str());
        progress.advance();
        progress.print_line(&if args.method.json { serde_json::to_string(&line)? } else { line.human() })?;
    }
    drop(progress);
    overlays.report();
    report_errors(&evaluated);
    Ok(match (refused, unsure) {
        (0, 1..) if args.method.strict => ExitCode::from(UNSURE),
        (0, _) => ExitCode::SUCCESS,
        _ => ExitCode::FAILURE,
    })
}

/// Source of a job.
enum Source {
    /// A case folder.
    Case(PathBuf),
    /// The pair of the command line, by its left image.
    Files(PathBuf),
    /// A pair of a recording.
    Recording(PathBuf, u64),
}

impl Source {
    /// Its name, whether the images are usable or not.
    fn name(&self) -> String {
        match self {
            Self::Case(folder) => load_case(folder).map_or_else(
                |_| folder.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned(),
                |case| case.name,
            ),
            Self::Files(left) => pair_name(left),
            Self::Recording(path, frame) => format!("{} {frame}", pair_name(path)),
        }
    }

    /// Name in messages: the folder of a case, or the left image.
    fn label(&self) -> String {
        match self {
            Self::Case(folder) => folder.display().to_string(),
            Self::Files(left) => left.display().to_string(),
            Self::Recording(path, frame) => format!("{}, pair {frame}", path.display()),
        }
    }

    /// Entry of a refused case in the table of errors: counted, without an answer.
    fn refused(&self) -> Option<EvaluatedCase> {
        let Self::Case(folder) = self else { return None };
        let case = load_case(folder).ok().filter(|case| case.truth.is_some())?;
        let (group, status) = (Group::of(&case), Status::Error.as_str());
        Some(EvaluatedCase { group, status, error: None, disparity: None, cpu_millis: f64::NAN })
    }

    fn load(&self, args: &EstimateArgs) -> Result<Job> {
        match self {
            Self::Case(folder) => Job::from_case(folder, args),
            Self::Files(_) => Job::from_files(args),
            Self::Recording(path, _) => Job::from_recording(path, args),
        }
    }
}

/// One case: estimate, compare with the truth, draw.
fn work(
    job: &Job,
    (method, config): (Method, &EstimatorConfig),
    args: &EstimateArgs,
    rigs: &mut Rigs,
    overlays: &mut Overlays<'_>,
) -> Result<(EstimateLine, Option<EvaluatedCase>)> {
    for note in &job.notes {
        tracing::info!("{}: {note}", job.name);
    }
    if let Some(case) = job.case.as_ref().filter(|case| !case.other_keys.is_empty()) {
        tracing::warn!(
            "{}: case.json has keys that are not known and not used: {}",
            job.name,
            case.other_keys.join(", ")
        );
    }
    for warning in &job.calibration_warnings {
        tracing::warn!("{}: {warning}", job.name);
    }
    let pair_warning = usable(&job.name, &check_pair(&job.rig, &job.left, &job.right))?;
    tell_click(&job.name, &job.region, &job.left, &config.published.region);
    let mut estimator = rigs.estimator(job, (method, config))?;
    let (estimate, millis) = timed(|| {
        let mut may_continue = within(args.method.deadline);
        estimator.estimate(
            EstimateRequest::new_target(&job.left, &job.right, &job.region, &job.range).until(&mut may_continue),
        )
    });
    let request = EstimateRequest::new_target(&job.left, &job.right, &job.region, &job.range);
    let visible = args.surface.as_ref().map(|_| estimator.visible_surface(&request));
    rigs.give_back(job, estimator);
    let mut estimate = estimate?;
    let mut surface_warning = None;
    let surface = match (&args.surface, visible) {
        (Some(file), Some(Ok(points))) => Some(surface::write(file, &points)?),
        (Some(file), Some(Err(error))) => {
            surface_warning = Some(surface::not_written(file, &error, &estimate));
            None
        }
        _ => None,
    };
    if args.reference_optimum {
        estimate.reference_optimum = reference_optimum(job, method, config)?;
    }
    let (centroid_px, z_m) = estimate.point_at(job.centroid_px.map(Vector2::from));
    tell(&job.name, &estimate);
    let share = calibration_share(job, &estimate, &centroid_px, &config.published.region)?;
    let mut line = EstimateLine::of(&job.name, method.name(), &estimate, (centroid_px, z_m), share.as_ref(), millis);
    line.surface = surface;
    line.warnings.extend(pair_warning.into_iter().chain(job.calibration_warnings.iter().cloned()));
    if let Some(warning) = surface_warning {
        tracing::warn!("{}: {warning}", job.name);
        line.warnings.push(warning);
    }
    if let Err(error) = overlays.draw(job, &estimate, &line, &config.published.region) {
        tracing::warn!("{}: no image: {error:#}", job.name);
    }
    Ok((line, evaluate(job, &estimate, z_m, millis)?))
}

/// The share of the calibration in the covariance of the model frame at a point of the left image.
fn calibration_share(
    job: &Job,
    estimate: &PlaneEstimate,
    at_px: &Vector2<f64>,
    regions: &RegionConfig,
) -> Result<Option<Matrix6<f64>>> {
    let (Some(term), Some(frame)) = (&job.calibration_term, estimate.model_frame(at_px)) else { return Ok(None) };
    let outline_px = job.region.outline_px(&job.region.rasterize(&job.left, regions)?);
    Ok(of_first(term, &job.rig, &frame.cam_left_from_model, &outline_px))
}

/// The best of all chromosomes; separate from the estimate, so that its time does not count.
fn reference_optimum(job: &Job, method: Method, config: &EstimatorConfig) -> Result<Option<ReferenceOptimum>> {
    let mut config = config.clone();
    config.published.reference_optimum = true;
    let mut estimator = Estimator::new(method, &job.rig, &config)?;
    Ok(estimator
        .estimate(EstimateRequest::new_target(&job.left, &job.right, &job.region, &job.range))?
        .reference_optimum)
}

/// Logs status, reason, warnings, a second surface, and the contributions of search and fitness to the error.
fn tell(name: &str, estimate: &PlaneEstimate) {
    match estimate.status {
        Status::Ok => tracing::info!("{name}: ok: {}", estimate.reason),
        status => tracing::warn!("{name}: {status}: {}", estimate.reason),
    }
    for warning in &estimate.warnings {
        tracing::warn!("{name}: {warning}");
    }
    if let Some(SecondPlane { pose, share }) = &estimate.second_plane {
        let [x, y, z]: [f64; 3] = pose.normal_in_cam_left.into();
        tracing::info!(
            "{name}: {:.0} % of the region lies on another surface: z {:.2} mm, normal {x:+.3} {y:+.3} {z:+.3}",
            100.0 * share,
            1e3 * pose.z_m
        );
    }
    if let (Some(optimum), Some(psi), Some(found)) = (estimate.reference_optimum, estimate.psi, estimate.fitness) {
        let (best, fitness) = (optimum.psi, optimum.fitness);
        let search = if found >= fitness {
            format!("search error: none (equal fitness; {} chromosomes tie)", optimum.ties)
        } else {
            format!(
                "search error: fitness {:.4} short, {:+.2} mm and {:.2} deg away",
                fitness - found,
                (psi.z_m - best.z_m) * 1e3,
                psi.normal().angle(&best.normal()).to_degrees()
            )
        };
        tracing::info!(
            "{name}: reference optimum of all chromosomes: fitness {fitness:.4}, z {:.2} mm, tilts {:.2} and {:.2} deg; {search}",
            best.z_m * 1e3,
            best.theta_x_rad.to_degrees(),
            best.theta_y_rad.to_degrees(),
        );
    }
}

/// The errors of a case with truth, if a servo may use the answer.
fn evaluate(job: &Job, estimate: &PlaneEstimate, z_m: Option<f64>, millis: f64) -> Result<Option<EvaluatedCase>> {
    let Some((case, truth)) = job.case.as_ref().and_then(|case| Some((case, case.truth.as_ref()?))) else {
        return Ok(None);
    };
    let plane = z_m
        .filter(|_| estimate.status.depth_is_sure())
        .zip(estimate.normal_in_cam_left())
        .map(|(z_m, normal_in_cam_left)| metrics::PlaneEstimate { z_m, normal_in_cam_left });
    let disparity = match (&plane, case.planar, case.load_disparity_truth()?) {
        (Some(plane), false, Some(map)) => {
            let centroid_px = job.centroid_px.unwrap_or([estimate.centroid_px.x, estimate.centroid_px.y]);
            DisparityAgreement::of(plane, centroid_px, &job.rig, &case.region_polygon_left_px, &map)
        }
        _ => None,
    };
    let error = plane.map(|plane| compare_plane(&plane, truth));
    let (group, status) = (Group::of(case), estimate.status.as_str());
    Ok(Some(EvaluatedCase { group, status, error, disparity, cpu_millis: millis }))
}

/// The table of errors by group, on standard error.
fn report_errors(evaluated: &[EvaluatedCase]) {
    if evaluated.is_empty() {
        return;
    }
    let text = table::text_table(&metrics::summarize(evaluated));
    let mut stderr = std::io::stderr().lock();
    // A closed standard error is ignored.
    let _ =
        std::io::Write::write_all(&mut stderr, format!("\nErrors against the truth of the cases:\n{text}").as_bytes());
}

/// The overlay images of all cases.
struct Overlays<'a> {
    folder: Option<&'a Path>,
    /// Used file names.
    taken: HashSet<String>,
}

impl<'a> Overlays<'a> {
    fn open(folder: Option<&'a Path>) -> Result<Self> {
        if let Some(folder) = folder {
            make_overlay_folder(folder)?;
        }
        Ok(Self { folder, taken: HashSet::new() })
    }

    /// Writes the overlay image of a case, if requested.
    fn draw(&mut self, job: &Job, estimate: &PlaneEstimate, line: &EstimateLine, regions: &RegionConfig) -> Result<()> {
        let Some(folder) = self.folder else { return Ok(()) };
        let outline_px = outline(job, estimate, regions);
        let frame = estimate.model_frame(&estimate.centroid_px).map(|frame| frame.cam_left_from_model);
        let depth = line.z_mm.map_or(String::new(), |z| format!("  z {z:.1} mm"));
        let fitness = line.fitness.map_or(String::new(), |fitness| format!("  fitness {fitness:.3}"));
        let annotation = Annotation {
            outline_px,
            cam_left_from_model: frame,
            label: format!("{} {}{depth}{fitness}", line.case, line.status),
            status: estimate.status,
        };
        let image = annotate(&job.left, &job.right, &job.rig, &[annotation]);
        save(&image, &folder.join(self.file_name(&line.case)), StoredFormat::Png)?;
        Ok(())
    }

    fn report(&self) {
        if let Some(folder) = self.folder {
            report_overlay_folder(folder, self.taken.len());
        }
    }

    /// A unique file name for a case, inside the folder for any name of the case.
    fn file_name(&mut self, case: &str) -> String {
        let plain = |c: char| if c.is_alphanumeric() || "-_ ".contains(c) { c } else { '_' };
        let stem: String = case.chars().map(plain).collect();
        let mut name = format!("{stem}.png");
        let mut number = 2_usize;
        while !self.taken.insert(name.clone()) {
            name = format!("{stem}-{number}.png");
            number += 1;
        }
        name
    }
}

/// Outline of a region for drawing.
fn outline(job: &Job, estimate: &PlaneEstimate, regions: &RegionConfig) -> Vec<[f64; 2]> {
    match job.region.rasterize(&job.left, regions) {
        Ok(mask) => polygon_px(&job.region.outline_px(&mask)),
        Err(_) => vec![[estimate.centroid_px.x, estimate.centroid_px.y]],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_stay_in_their_folder_and_apart() {
        let mut overlays = Overlays::open(None).unwrap();
        assert_eq!(overlays.file_name("bb201_c0"), "bb201_c0.png");
        assert_eq!(overlays.file_name("bb201_c0"), "bb201_c0-2.png");
        assert_eq!(overlays.file_name("x/../../evil"), "x_______evil.png");
        assert_eq!(overlays.file_name(".."), "__.png");
    }
}
