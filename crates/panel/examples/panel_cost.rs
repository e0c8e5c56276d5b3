//! What the panel costs: processor time of its threads, and lateness of the control loop beside it, with 0, 1 and 5 pages and with one
//! that does not read. Run it by `cargo xtask bench panel`.
#![allow(
    clippy::expect_used,
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "prints its figures; helpers of the tests may fail loudly"
)]

#[allow(dead_code, reason = "shared with the tests")]
#[path = "../tests/support/mod.rs"]
mod support;

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::FramePair;
use serde_json::json;
use support::{Page, Rig};

/// Largest processor time with one page, percent of one processor. Required.
const ONE_PAGE_MAX_PERCENT: f64 = 20.0;
/// Largest lateness of control steps with pages, relative to that without. Required.
const LATENESS_RATIO_MAX: f64 = 1.1;
/// Lateness of control steps that no comparison resolves, ms: the timers of a system without real-time scheduling.
const LATENESS_NOISE_MS: f64 = 0.1;
/// Rounds through all cases, so that a slow minute of the machine meets each of them.
const ROUNDS: usize = 3;

/// Pages beside a control loop.
struct Case {
    name: &'static str,
    /// Pages that read.
    pages: usize,
    /// Whether there is one that does not.
    has_idle: bool,
    /// Whether the control loop has the scheduling of a live run.
    is_preferred: bool,
}

const fn case(name: &'static str, pages: usize, has_idle: bool, is_preferred: bool) -> Case {
    Case { name, pages, has_idle, is_preferred }
}

/// The first one of each scheduling is what the others are compared with.
const CASES: [Case; 6] = [
    case("no page", 0, false, true),
    case("1 page", 1, false, true),
    case("5 pages", 5, false, true),
    case("1 page, and 1 that does not read", 1, true, true),
    case("no page", 0, false, false),
    case("1 page", 1, false, false),
];

/// Figures of one case, over all rounds.
#[derive(Default)]
struct Figures {
    cpu_percent: Vec<f64>,
    lateness_ms: Vec<f64>,
    images_per_s: Vec<f64>,
    /// Whether the system refused the scheduling of a live run in some round.
    is_refused: bool,
}

fn main() {
    let options: Vec<String> = std::env::args().skip(1).collect();
    let value =
        |name: &str| options.iter().position(|option| option == name).and_then(|at| options.get(at + 1)).cloned();
    let length = Duration::from_secs(if options.iter().any(|option| option == "--quick") { 2 } else { 20 });
    let mut figures: [Figures; CASES.len()] = Default::default();
    for _ in 0..ROUNDS {
        for (figures, case) in figures.iter_mut().zip(&CASES) {
            measure(case, length, figures);
        }
    }
    let (text, missed) = tables(&mut figures, length);
    print!("{text}");
    if let Some(file) = value("--page").map(PathBuf::from) {
        fs::write(&file, page(&text, &value("--origin").unwrap_or_default())).expect("the page");
    }
    assert_eq!(missed, 0, "limits are missed; see the last table");
}

/// A recorded pair.
fn recorded() -> Arc<FramePair> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases/bb204_c0");
    let image = |name: &str| image::open(folder.join(name)).expect("a recorded image").into_rgb8();
    let (left, right) = (image("left.png"), image("right.png"));
    let size = ImageSize { width: left.width(), height: left.height() };
    Arc::new(FramePair { left, right, ..FramePair::black(size) })
}

/// A page that takes every image.
struct PageLoad {
    is_over: Arc<AtomicBool>,
    images: Arc<AtomicU64>,
    thread: JoinHandle<()>,
}

fn asking(rig: &Rig) -> Page {
    let mut page = Page::open_without_answer(&rig.client());
    page.send(json!({ "type": "images", "left": true, "right": true, "view": "raw", "fps_max": 30 }));
    page
}

fn watch(rig: &Rig) -> PageLoad {
    let mut page = asking(rig);
    let (is_over, images) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let (over, count) = (is_over.clone(), images.clone());
    let thread = std::thread::spawn(move || {
        // A browser runs on another computer, or as a program of less importance.
        let _ = rustix::process::setpriority_process(None, 19);
        while !over.load(Ordering::SeqCst) {
            match page.next() {
                Ok(Err(_)) => _ = count.fetch_add(1, Ordering::SeqCst),
                Ok(Ok(_)) => {}
                Err(error) => panic!("a page that reads was closed: {error}"),
            }
        }
    });
    PageLoad { is_over, images, thread }
}

fn measure(case: &Case, length: Duration, figures: &mut Figures) {
    let rig = Rig::with_images(|_| {}, (true, case.is_preferred), recorded());
    let page_loads: Vec<PageLoad> = (0..case.pages).map(|_| watch(&rig)).collect();
    // It asks for images and takes none; the server closes it after half a second.
    let idle = case.has_idle.then(|| asking(&rig));
    std::thread::sleep(Duration::from_millis(500));
    rig.observed.lock().unwrap().lateness_s.clear();
    let images_before: u64 = page_loads.iter().map(|page| page.images.load(Ordering::SeqCst)).sum();
    let (began, cpu_before) = (Instant::now(), cpu_of_panel_s());
    std::thread::sleep(length);
    let (passed_s, cpu_s) = (began.elapsed().as_secs_f64(), cpu_of_panel_s() - cpu_before);
    let images: u64 = page_loads.iter().map(|page| page.images.load(Ordering::SeqCst)).sum();
    figures.cpu_percent.push(100.0 * cpu_s / passed_s);
    figures.is_refused |= case.is_preferred && !rig.observed.lock().unwrap().is_preferred;
    figures.lateness_ms.extend(rig.observed.lock().unwrap().lateness_s.iter().map(|late_s| 1e3 * late_s));
    if case.pages > 0 {
        figures.images_per_s.push((images - images_before) as f64 / passed_s / case.pages as f64);
    }
    drop(idle);
    for page in page_loads {
        page.is_over.store(true, Ordering::SeqCst);
        page.thread.join().expect("a page");
    }
}

/// Processor time of the threads of the panel, seconds.
fn cpu_of_panel_s() -> f64 {
    let tasks = fs::read_dir("/proc/self/task").expect("/proc").flatten();
    let of_task = |folder: PathBuf| -> Option<f64> {
        let name = fs::read_to_string(folder.join("comm")).ok()?;
        // Nanoseconds on a processor, then waiting for one.
        let nanos: f64 = fs::read_to_string(folder.join("schedstat")).ok()?.split(' ').next()?.parse().ok()?;
        name.starts_with("panel").then_some(nanos * 1e-9)
    };
    tasks.filter_map(|task| of_task(task.path())).sum()
}

fn percentile(values: &mut [f64], percent: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = (percent / 100.0 * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(at).copied().unwrap_or(f64::NAN)
}

/// The tables, and the number of missed limits.
fn tables(figures: &mut [Figures], length: Duration) -> (String, usize) {
    let mut text = String::from(
        "| pages | control thread | processor, % of one | images per second and page | lateness of control steps, ms: median / p99 |\n\
         |---|---|---:|---:|---:|\n",
    );
    let mut p99 = Vec::new();
    for (of, case) in figures.iter_mut().zip(&CASES) {
        let (median, late) = (percentile(&mut of.lateness_ms, 50.0), percentile(&mut of.lateness_ms, 99.0));
        let (cpu, images) = (percentile(&mut of.cpu_percent, 50.0), percentile(&mut of.images_per_s, 50.0));
        let images = if images.is_nan() { "-".to_owned() } else { format!("{images:.1}") };
        let scheduling = match (case.is_preferred, of.is_refused) {
            (true, false) => "SCHED_FIFO",
            (true, true) => "SCHED_FIFO refused",
            (false, _) => "usual",
        };
        p99.push(late);
        let _ = writeln!(text, "| {} | {scheduling} | {cpu:.1} | {images} | {median:.3} / {late:.3} |", case.name);
    }
    let seconds = length.as_secs();
    let _ =
        writeln!(text, "\n{ROUNDS} rounds of {seconds} s; medians of the rounds, and all control steps together.\n");
    text.push_str("| limit | measured | at most | met |\n|---|---:|---:|---|\n");
    let mut missed = 0;
    let mut check = |what: &str, measured: f64, most: f64| {
        let is_met = measured <= most;
        missed += usize::from(!is_met);
        let _ = writeln!(text, "| {what} | {measured:.3} | {most:.3} | {} |", if is_met { "yes" } else { "**no**" });
    };
    let one_page = figures.get_mut(1).map_or(f64::NAN, |of| percentile(&mut of.cpu_percent, 50.0));
    check("processor with one page, %", one_page, ONE_PAGE_MAX_PERCENT);
    // Without the scheduling of a live run, the lateness is that of the operating system.
    let preferred = || CASES.iter().zip(&p99).filter(|(case, _)| case.is_preferred);
    let alone = preferred().next().map_or(f64::NAN, |(_, late)| *late);
    let most = (LATENESS_RATIO_MAX * alone).max(alone + LATENESS_NOISE_MS);
    for (case, late) in preferred().skip(1) {
        check(&format!("{}: lateness p99, ms", case.name), *late, most);
    }
    (text, missed)
}

fn page(tables: &str, origin: &str) -> String {
    format!(
        "# Cost of the panel

This page is written by `cargo xtask bench panel`; change the program, not the page.

The panel runs beside a control loop with the supervisor of a run, which sleeps 4 ms after each step and gives the panel a recorded stereo pair of 640x480 33 times per second (`tests/data/cases/bb204_c0`).
Each page asks for both raw images at 30 per second (JPEG, 4:2:0, quality 75) and gets all states.

* **processor**: time of the threads of the panel; the pages are threads of the same program and not counted.
* **lateness**: from the moment at which a step is due until it is done, the supervisor included; without the steps that copy a pair, which another thread does in a run.
* **control thread**: a live run asks for SCHED_FIFO with priority 40; with the usual scheduling, a thread of the panel that computes may delay a step by a time slice of the operating system.

{origin}

{tables}"
    )
}
