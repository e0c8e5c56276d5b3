//! `pb3dp estimate`: the pose of a region in stereo pictures.

pub mod job;
pub mod output;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use nalgebra::Vector2;
use pb3dp_estimation::estimate::PlaneEstimate;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation::region::Region;
use pb3dp_record::dataset::find_cases;
use pb3dp_record::images::{PictureFormat, save};
use pb3dp_record::metrics::{self, DisparityAgreement, EvaluatedCase, Group, compare_plane, table};

use self::job::Job;
use self::output::{EstimateLine, print_line};
use super::pair::check_pictures;
use crate::cli::{EstimateArgs, MethodArgs};
use crate::config::estimator::read_estimator;
use crate::cpu_time::timed;
use crate::picture::{Annotation, annotate, model_frame_on_plane};

/// Runs the command. The exit code is a failure if a case could not be worked on; all others are worked on all the same.
///
/// # Errors
/// Bad arguments or configuration, or a folder without cases.
pub fn run(args: &EstimateArgs) -> Result<ExitCode> {
    let method = Method::from_name(&args.method.method)?;
    let config = estimator_config(&args.method, args.reference_optimum)?;
    if let Some(folder) = &args.method.overlay {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: can not be created", folder.display()))?;
    }
    let jobs = match &args.cases {
        Some(dir) => find_cases(dir)?.into_iter().map(Source::Case).collect(),
        None => vec![Source::Files],
    };
    if !args.method.json {
        print_line(EstimateLine::HEADING)?;
    }
    let mut evaluated = Vec::new();
    let mut refused = 0_usize;
    for source in jobs {
        let name = source.name();
        let outcome = source.load(args).and_then(|job| work(&job, method, &config, &args.method));
        let line = match outcome {
            Ok((line, evaluation)) => {
                evaluated.extend(evaluation);
                line
            }
            Err(error) => {
                refused += 1;
                tracing::error!("{name}: {error:#}");
                EstimateLine::of_error(&name, method.name())
            }
        };
        print_line(&if args.method.json { serde_json::to_string(&line)? } else { line.human() })?;
    }
    report_errors(&evaluated);
    Ok(if refused == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Where a job comes from.
enum Source {
    /// A case folder.
    Case(PathBuf),
    /// The pair that the command line names.
    Files,
}

impl Source {
    /// Its name, known before anything is read.
    fn name(&self) -> String {
        match self {
            Self::Case(folder) => folder.file_name().unwrap_or(folder.as_os_str()).to_string_lossy().into_owned(),
            Self::Files => "pair".to_owned(),
        }
    }

    fn load(&self, args: &EstimateArgs) -> Result<Job> {
        match self {
            Self::Case(folder) => Job::from_case(folder, &args.method),
            Self::Files => Job::from_files(args),
        }
    }
}

/// The method's parameters from the defaults, a file and the command line, in this order.
///
/// # Errors
/// If the file is refused.
pub fn estimator_config(args: &MethodArgs, reference_optimum: bool) -> Result<EstimatorConfig> {
    let mut config = match &args.config {
        Some(file) => read_estimator(file)?,
        None => EstimatorConfig::default(),
    };
    config.published.reference_optimum = reference_optimum;
    if let Some(seed) = args.seed {
        config.published.rmga.seed = seed;
    }
    Ok(config)
}

/// One case: estimate, compare with the truth, draw.
fn work(
    job: &Job,
    method: Method,
    config: &EstimatorConfig,
    args: &MethodArgs,
) -> Result<(EstimateLine, Option<EvaluatedCase>)> {
    for note in &job.notes {
        tracing::info!("{}: {note}", job.name);
    }
    check_pictures(&job.name, &job.rig, &job.left, &job.right)?;
    let mut estimator = Estimator::new(method, &job.rig, config)?;
    let (estimate, millis) = timed(|| estimator.estimate(&job.left, &job.right, &job.region, &job.range));
    let estimate = estimate?;
    let z_m = match job.centroid_px {
        Some([u, v]) => estimate.depth_at_pixel(&Vector2::new(u, v)),
        None => estimate.z_m(),
    };
    tell(&job.name, &estimate);
    let line = EstimateLine::of(&job.name, method.name(), &estimate, z_m, millis);
    if let Some(folder) = &args.overlay {
        draw(job, &estimate, &line, folder)?;
    }
    Ok((line, evaluate(job, &estimate, z_m, millis)?))
}

/// Status, reason and warnings to the log, and how far search and fitness are to blame.
fn tell(name: &str, estimate: &PlaneEstimate) {
    if estimate.status.as_str() != "ok" {
        tracing::warn!("{name}: {}: {}", estimate.status, estimate.reason);
    }
    for warning in &estimate.warnings {
        tracing::warn!("{name}: {warning}");
    }
    if let (Some((best, fitness)), Some(psi), Some(found)) =
        (estimate.reference_optimum, estimate.psi, estimate.fitness)
    {
        tracing::info!(
            "{name}: reference optimum of all chromosomes: fitness {fitness:.4}, z {:.2} mm, tilts {:.2} and {:.2} deg; the \
             search reached {found:.4}, off by {:.2} mm and {:.2} deg",
            best.z_m * 1e3,
            best.theta_x_rad.to_degrees(),
            best.theta_y_rad.to_degrees(),
            (psi.z_m - best.z_m) * 1e3,
            psi.normal().angle(&best.normal()).to_degrees()
        );
    }
}

/// The errors of a case with truth.
fn evaluate(job: &Job, estimate: &PlaneEstimate, z_m: Option<f64>, millis: f64) -> Result<Option<EvaluatedCase>> {
    let Some((case, truth)) = job.case.as_ref().and_then(|case| Some((case, case.truth.as_ref()?))) else {
        return Ok(None);
    };
    let plane = z_m
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
    Ok(Some(EvaluatedCase { group: Group::of(case), error, disparity, cpu_millis: millis }))
}

/// The table of errors by group, on standard error.
fn report_errors(evaluated: &[EvaluatedCase]) {
    if evaluated.is_empty() {
        return;
    }
    let text = table::text_table(&metrics::summarize(evaluated));
    let mut stderr = std::io::stderr().lock();
    // Nobody can be told if standard error is closed.
    let _ =
        std::io::Write::write_all(&mut stderr, format!("\nErrors against the truth of the cases:\n{text}").as_bytes());
}

/// Writes the picture of a case.
fn draw(job: &Job, estimate: &PlaneEstimate, line: &EstimateLine, folder: &Path) -> Result<()> {
    let outline_px = outline(&job.region, &job.left, estimate);
    let frame = estimate.pose.and_then(|pose| {
        let ray = job.rig.left().unproject(&estimate.centroid_px).ok()?;
        model_frame_on_plane(ray * pose.depth_on_ray(&ray)?, &pose.normal_in_cam_left)
    });
    let depth = line.z_mm.map_or(String::new(), |z| format!("  z {z:.1} mm"));
    let fitness = line.fitness.map_or(String::new(), |fitness| format!("  fitness {fitness:.3}"));
    let annotation = Annotation {
        outline_px: &outline_px,
        cam_left_from_model: frame,
        label: format!("{} {}{depth}{fitness}", line.case, line.status),
        is_bad: frame.is_none(),
    };
    let file = folder.join(format!("{}.png", line.case));
    save(&annotate(&job.left, &job.right, &job.rig, &annotation), &file, PictureFormat::Png)?;
    Ok(())
}

/// Outline of a region for drawing.
fn outline(region: &Region, left: &image::RgbImage, estimate: &PlaneEstimate) -> Vec<[f64; 2]> {
    match region.rasterize(left, &Default::default()) {
        Ok(mask) => region.outline_px(&mask).iter().map(|p| [p.x, p.y]).collect(),
        Err(_) => vec![[estimate.centroid_px.x, estimate.centroid_px.y]],
    }
}
