//! The measurements: one synthetic frame, scored in turn by all kernel families and the naive version, many times.

use std::hint::black_box;
use std::time::Instant;

use image::RgbImage;
use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::plane_hypothesis::{PinholePair, PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::region::RegionMask;
use pb3dp_estimation_published::fitness::{FitnessConfig, HueFitness};
use pb3dp_estimation_published::hue::{HueConfig, HuePlane};
use pb3dp_estimation_published::photo_model::{ModelPoint, PhotoModel, PhotoModelConfig, PhotoModelScratch};
use pb3dp_estimation_published::search::PlaneScore;
use pb3dp_estimation_published::search::rmga::{Population, RmGa, RmGaConfig};
use pb3dp_estimation_test_support::naive::{self, Naive};
use pb3dp_estimation_test_support::scene::{self, Scene};
use pb3dp_geometry::{ImageSize, StereoRig};
use serde_json::{Value, json};

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
/// Batches of 60 that are scored per clock reading.
const REPEATS: usize = 20;
/// Seed of the genetic algorithm.
pub const SEED: u64 = 7;

/// Kind of stereo pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PairKind {
    Rectified,
    General,
}

pub const PAIRS: [PairKind; 2] = [PairKind::Rectified, PairKind::General];

impl PairKind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Rectified => "rectified",
            Self::General => "general",
        }
    }

    fn rig(self) -> StereoRig {
        match self {
            Self::Rectified => scene::rectified_rig(SIZE),
            Self::General => scene::general_rig(SIZE),
        }
    }
}

/// Parts of a full frame, and the whole.
const PARTS: [&str; 5] = ["conversions_ms", "model_ms", "preparation_ms", "search_ms", "frame_ms"];

/// The frame used for all measurements.
struct Input {
    rig: StereoRig,
    pair: PinholePair,
    left: RgbImage,
    right: RgbImage,
    region: RegionMask,
    range: SearchRange,
    hypotheses: Vec<PlaneHypothesis>,
}

impl Input {
    fn new(kind: PairKind) -> Self {
        let rig = kind.rig();
        let scene =
            Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.2, theta_y_rad: -0.3, noise: 5.0 };
        let (left, right) = scene.render(&rig);
        let range = SearchRange::new(0.35, 0.65, 45f64.to_radians()).expect("range");
        let config = RmGaConfig { seed: SEED, ..RmGaConfig::default() };
        let codec = *RmGa::new(config, range).expect("config").codec();
        let hypotheses = Population::random(&config).individuals().iter().map(|c| codec.decode(*c)).collect();
        Self {
            pair: PinholePair::from_rig(&rig).expect("pair"),
            region: RegionMask::from_fn(SIZE, |u, v| scene.sees_disc(&rig, u, v)),
            rig,
            left,
            right,
            range,
            hypotheses,
        }
    }
}

/// Medians of everything for one kind of stereo pair.
pub fn run(kind: PairKind, rounds: usize) -> Value {
    let input = Input::new(kind);
    let hue_config = HueConfig::default();
    let model =
        PhotoModel::sample(&HuePlane::from_rgb(&input.left, &hue_config), &input.region, &PhotoModelConfig::default());
    let reference = naive_frame(&input, &model, &hue_config);
    let samples = (input.hypotheses.len() * (model.inner().len() + model.outer().len())) as f64;
    let mut benches: Vec<Bench<'_>> = Kernels::available().map(|kernels| Bench::new(&input, &model, kernels)).collect();
    let (mut naive_ns, mut kernel_ns) = (Vec::new(), vec![Vec::new(); benches.len()]);
    // In turn, so that other load on the machine affects all families alike.
    for round in 0..rounds {
        if round % 4 == 0 {
            naive_ns.push(time_ns(|| score_naively(&reference, &input.hypotheses)) / samples);
        }
        for (bench, times) in benches.iter_mut().zip(&mut kernel_ns) {
            times.push(bench.score_ns() / samples);
            bench.frame();
        }
    }
    let naive_min = min(&naive_ns);
    let naive = median(naive_ns);
    let kernels =
        benches.into_iter().zip(kernel_ns).map(|(bench, times)| bench.result(times, samples, &reference, naive));
    json!({
        "pair": kind.name(), "inner_points": model.inner().len(), "outer_points": model.outer().len(),
        "naive_ns_per_sample": naive, "naive_ns_per_sample_min": naive_min, "kernels": kernels.collect::<Vec<_>>(),
    })
}

fn naive_frame<'a>(input: &'a Input, model: &PhotoModel, config: &HueConfig) -> Naive<'a> {
    let point = |p: &ModelPoint| naive::Point { u: p.u.into(), v: p.v.into(), hue_deg: p.hue.degrees() };
    Naive {
        rig: &input.rig,
        right: &input.right,
        centre_px: model.centre_px(),
        inner: model.inner().iter().map(point).collect(),
        outer: model.outer().iter().map(point).collect(),
        saturation_min: config.saturation_min,
        value_min: config.value_min,
    }
}

fn score_naively(reference: &Naive<'_>, hypotheses: &[PlaneHypothesis]) {
    for psi in hypotheses {
        black_box(reference.fitness(psi.z_m, psi.theta_x_rad, psi.theta_y_rad));
    }
}

/// One kernel family with the buffers it reuses between frames.
struct Bench<'a> {
    input: &'a Input,
    kernels: Kernels,
    /// Input for scoring alone; prepared once.
    scoring: HueFitness,
    scoring_model: PhotoModel,
    scoring_right: HuePlane,
    scores: Vec<i32>,
    /// Input for whole frames.
    left: HuePlane,
    right: HuePlane,
    model: PhotoModel,
    scratch: PhotoModelScratch,
    fitness: HueFitness,
    search: RmGa,
    population: Population,
    /// Times of [`PARTS`].
    frames: Vec<[f64; PARTS.len()]>,
}

impl<'a> Bench<'a> {
    fn new(input: &'a Input, model: &PhotoModel, kernels: Kernels) -> Self {
        let config = RmGaConfig { seed: SEED, ..RmGaConfig::default() };
        let fitness = HueFitness::new(FitnessConfig::default(), kernels).expect("config");
        Self {
            input,
            kernels,
            scoring: fitness.clone(),
            scoring_model: model.clone(),
            scoring_right: HuePlane::from_rgb(&input.right, &HueConfig::default()),
            scores: vec![0; input.hypotheses.len()],
            left: HuePlane::default(),
            right: HuePlane::default(),
            model: PhotoModel::default(),
            scratch: PhotoModelScratch::default(),
            fitness,
            search: RmGa::new(config, input.range).expect("config"),
            population: Population::random(&config),
            frames: Vec::new(),
        }
    }

    /// Time to score all hypotheses once.
    fn score_ns(&mut self) -> f64 {
        let Self { input, scoring, scoring_model, scoring_right, scores, .. } = self;
        let frame = scoring.prepare(&input.pair, scoring_model, scoring_right, &input.range).expect("frame");
        let total = time_ns(|| {
            for _ in 0..REPEATS {
                frame.score(black_box(&input.hypotheses), scores);
                black_box(&scores);
            }
        });
        total / REPEATS as f64
    }

    /// A full frame: both conversions, the model, the preparation, nine generations.
    fn frame(&mut self) {
        let Self { input, kernels, left, right, model, scratch, fitness, search, population, .. } = self;
        let config = HueConfig::default();
        let start = Instant::now();
        left.update_from_rgb(black_box(&input.left), &config, *kernels);
        right.update_from_rgb(black_box(&input.right), &config, *kernels);
        let converted = Instant::now();
        model.resample(left, &input.region, &PhotoModelConfig::default(), scratch);
        let modelled = Instant::now();
        let frame = fitness.prepare(&input.pair, model, right, &input.range).expect("frame");
        let prepared = Instant::now();
        black_box(search.evolve(population, &frame));
        let end = Instant::now();
        let ms = |from: Instant, to: Instant| (to - from).as_secs_f64() * 1e3;
        self.frames.push([
            ms(start, converted),
            ms(converted, modelled),
            ms(modelled, prepared),
            ms(prepared, end),
            ms(start, end),
        ]);
    }

    /// Scoring of 60 hypotheses, including their preparation; `with_preparation`: that of the frame (the match table of rectified pairs)
    /// divided among 9 generations. Also the largest difference of F from the naive version.
    fn result(mut self, times: Vec<f64>, samples: f64, reference: &Naive<'_>, naive_ns: f64) -> Value {
        let part = |part: usize| self.frames.iter().map(|times| times[part]).collect::<Vec<f64>>();
        let generations = self.search.config().generations as f64;
        let (ns_min, frame_min_ms) = (min(&times), min(&part(4)));
        let ns = median(times);
        let with_preparation = ns + median(part(2)) * 1e6 / (generations * samples);
        let mut row = json!({
            "kernels": self.kernels.set().name(), "ns_per_sample": ns, "ns_per_sample_min": ns_min,
            "ns_per_sample_with_preparation": with_preparation, "ratio_to_naive": naive_ns / with_preparation,
            "frame_min_ms": frame_min_ms,
        });
        for (index, name) in PARTS.into_iter().enumerate() {
            row[name] = median(part(index)).into();
        }
        row["fitness_difference_max"] = self.fitness_difference_max(reference).into();
        row
    }

    fn fitness_difference_max(&mut self, reference: &Naive<'_>) -> f64 {
        let Self { input, scoring, scoring_model, scoring_right, scores, .. } = self;
        let frame = scoring.prepare(&input.pair, scoring_model, scoring_right, &input.range).expect("frame");
        frame.score(&input.hypotheses, scores);
        let differences = input.hypotheses.iter().zip(scores).filter_map(|(psi, score)| {
            let expected = reference.fitness(psi.z_m, psi.theta_x_rad, psi.theta_y_rad);
            Some((frame.fitness(*score)? - expected).abs())
        });
        differences.fold(0.0, f64::max)
    }
}

fn time_ns(mut work: impl FnMut()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64() * 1e9
}

/// Median of a non-empty list.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn min(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::INFINITY, f64::min)
}
