//! Tracking error of the hand: the experiment of Fig. 7, sinusoids and steps, compared with the published method and
//! law, with an ideal filter or the arm's limits, and with the required limits. Run it by `cargo xtask bench servo`.
#![allow(clippy::print_stdout, reason = "prints its figures")]

mod cases;
mod demands;
mod ideal;
mod json;
mod limit_use;
mod limits;
mod page;
mod runs;
mod setups;
mod ways;

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use cases::{Approach, Approached, Law, LawFindings, Singular};
use clap::Parser;
use pb3dp_benchmarks::limit::Check;
use pb3dp_benchmarks::page::{save, text, update};
use pb3dp_benchmarks::parallel::in_parallel;
use pb3dp_sim::trajectory::Channel;
use runs::{Fig7, Response, Step, fig7, fig7_of, response, step_response};
use setups::{DELAYS_MILLIS, Fig7Case, Who, geometric};
use ways::Way;

const PERIODS_S: [f64; 10] = [30.0, 20.0, 15.0, 10.0, 8.0, 6.0, 5.0, 4.0, 3.0, 2.0];

/// All results.
#[derive(Default)]
struct Findings {
    fig7: Vec<Fig7>,
    responses: Vec<Response>,
    steps: Vec<Step>,
    approaches: Vec<Approached>,
    singular: Vec<Way>,
    laws: Vec<LawFindings>,
    /// Simulated seconds per second of this machine, for the experiment without images.
    geometric_times_real_time: f64,
}

/// The extent of a measurement.
#[derive(Default)]
struct Extent {
    /// Runs of the experiment with images, and their end.
    fig7: Vec<Fig7Case>,
    stop_after_s: Option<f64>,
    /// Seed of the experiment with images; otherwise that of the configuration files.
    seed: Option<u64>,
    without_images: bool,
    channels: Vec<Channel>,
    step_channels: Vec<Channel>,
    periods_s: Vec<f64>,
    approaches: Vec<Approach>,
    singular: Vec<Singular>,
    laws: Vec<Law>,
    far: Vec<Approach>,
}

impl Extent {
    /// The whole measurement.
    fn whole() -> Self {
        Self {
            fig7: Fig7Case::all(),
            stop_after_s: None,
            seed: None,
            without_images: true,
            channels: Channel::ALL.to_vec(),
            step_channels: Channel::ALL.to_vec(),
            periods_s: PERIODS_S.to_vec(),
            approaches: cases::APPROACHES.to_vec(),
            singular: cases::SINGULAR.to_vec(),
            laws: Law::ALL.to_vec(),
            far: cases::FAR.to_vec(),
        }
    }

    /// A sample of everything, for a test; takes some seconds.
    fn quick() -> Self {
        let channels = vec![Channel::X, Channel::Ry];
        Self {
            fig7: Fig7Case::all()[..1].to_vec(),
            stop_after_s: Some(13.0),
            without_images: true,
            channels: channels.clone(),
            step_channels: channels,
            periods_s: vec![10.0, 6.0],
            approaches: [0, 6, 9, 11].map(|index| cases::APPROACHES[index]).to_vec(),
            laws: Vec::new(),
            ..Self::whole()
        }
    }

    /// Restricts the measurement to names with one of these words, separated by commas.
    fn only(mut self, words: &str) -> Self {
        let wanted = |name: &str| words.split(',').any(|word| name.contains(word));
        self.fig7.retain(|case| wanted(&format!("fig7/{}", case.name())));
        self.without_images = wanted("fig7/without images");
        self.channels.retain(|channel| wanted(&format!("sine/{}", channel.name())));
        self.step_channels.retain(|channel| wanted(&format!("step/{}", channel.name())));
        self.approaches.retain(|case| wanted(&format!("approach/{}", case.name())));
        self.singular.retain(|case| wanted(&format!("singular/{}", case.name)));
        self.laws.retain(|law| wanted(&format!("laws/{}", law.name())));
        self
    }
}

impl Findings {
    fn of(extent: &Extent) -> Result<Self> {
        let mut found = Self { fig7: with_images(extent)?, ..Self::default() };
        if extent.without_images {
            found.without_images()?;
        }
        for &channel in &extent.channels {
            println!("sine/{} ...", channel.name());
            for who in Who::ALL {
                for &period_s in &extent.periods_s {
                    let what = || format!("{}, {} every {period_s} s", who.name(), channel.name());
                    found.responses.push(response(who, channel, period_s).with_context(what)?);
                }
            }
        }
        for &channel in &extent.step_channels {
            println!("step/{} ...", channel.name());
            for who in Who::ALL {
                found.steps.push(step_response(who, channel).with_context(|| format!("step of {}", channel.name()))?);
            }
        }
        for case in &extent.approaches {
            println!("approach/{} ...", case.name());
            found.approaches.push(cases::approach(case).with_context(|| case.name())?);
        }
        for case in &extent.singular {
            println!("singular/{} ...", case.name);
            found.singular.push(cases::singular(case).context(case.name)?);
        }
        for &law in &extent.laws {
            println!("laws/{} ...", law.name());
            found.laws.push(cases::law_findings(law, &extent.far).context(law.name())?);
        }
        Ok(found)
    }

    /// The experiment of Fig. 7 without images, for comparison, and its speed.
    fn without_images(&mut self) -> Result<()> {
        let setup = Who::Ours.setup(DELAYS_MILLIS[0])?;
        let motion = setup.experiment.motion.clone();
        let mut setup = geometric(setup, motion)?;
        setup.experiment.carrier = pb3dp_setup::setup::Carrier::Arm;
        self.geometric_times_real_time = runs::run(&setup, None)?.times_real_time;
        let case = Fig7Case { who: Who::Ours, target: 0, delay_millis: DELAYS_MILLIS[0] };
        self.fig7.push(fig7_of(&setup, &case, "without images", None)?);
        Ok(())
    }

    fn checks(&self) -> Vec<Check> {
        let mut checks: Vec<Check> = self.fig7.iter().flat_map(limits::of_fig7).collect();
        let mut channels: Vec<&str> = self.responses.iter().map(|response| response.channel).collect();
        channels.dedup();
        checks.extend(channels.into_iter().flat_map(|channel| limits::of_responses(channel, &self.responses)));
        checks.extend(self.steps.iter().flat_map(limits::of_step));
        checks.extend(self.approaches.iter().flat_map(limits::of_approach));
        let reachable = |way: &&Way| cases::SINGULAR.iter().any(|case| case.name == way.name && case.is_reachable);
        checks.extend(self.singular.iter().flat_map(|way| limits::of_singular(way, reachable(&way))));
        checks
    }
}

/// The runs with images, in parallel on all processors; each gives the same result alone.
fn with_images(extent: &Extent) -> Result<Vec<Fig7>> {
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    in_parallel(
        extent.fig7.len(),
        threads,
        || Ok(()),
        |(), index| {
            let case = &extent.fig7[index];
            println!("fig7/{} ...", case.name());
            fig7(case, extent.seed, extent.stop_after_s).with_context(|| case.name())
        },
    )
}

fn main() -> Result<()> {
    let options = Options::parse();
    let started = std::time::Instant::now();
    let extent = if options.quick { Extent::quick() } else { Extent::whole() };
    let extent = Extent { seed: options.seed, ..extent };
    let extent = options.only.iter().fold(extent, |extent, words| extent.only(words));
    let findings = Findings::of(&extent)?;
    let checks = findings.checks();
    let found = json::all(&findings, &checks, &options.origin);
    let parts = page::parts(&found, &options.origin);
    println!("\n{}", text(&parts));
    println!("total time {:.1} minutes", started.elapsed().as_secs_f64() / 60.0);
    if let Some(file) = &options.json {
        save(file, &format!("{found:#}\n"))?;
    }
    if let Some(folder) = &options.page {
        update(&folder.join("servo.md"), &parts)?;
        save(&folder.join("servo.svg"), &page::motion_figure(&findings.fig7).context("no run to plot")?)?;
        save(&folder.join("servo_response.svg"), &page::response_figure(&findings.responses))?;
    }
    let missed = checks.iter().filter(|check| !check.is_kept()).count();
    if missed > 0 {
        bail!("{missed} of {} limits are missed; see the last table", checks.len());
    }
    Ok(())
}

/// Tracking error of the hand in simulation.
#[derive(Parser)]
struct Options {
    /// A sample of everything, in seconds.
    #[arg(long, conflicts_with = "page")]
    quick: bool,
    /// Only parts whose name contains one of these words, separated by commas.
    #[arg(long, value_name = "WORDS", conflicts_with = "page")]
    only: Option<String>,
    /// Seed of the experiment with images.
    #[arg(long, value_name = "NUMBER", conflicts_with = "page")]
    seed: Option<u64>,
    /// File for the results.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Folder of the page, for a full run.
    #[arg(long, value_name = "FOLDER")]
    page: Option<PathBuf>,
    /// Commit and machine, for the page.
    #[arg(long, default_value = "", value_name = "TEXT")]
    origin: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All parts of the measurement on a sample; all figures exist, and the bounds are below the measured errors.
    #[test]
    fn a_quick_run_measures_everything() {
        let findings = Findings::of(&Extent::quick()).unwrap();
        let checks = findings.checks();
        let found = json::all(&findings, &checks, "a test");
        let text = text(&page::parts(&found, "a test"));
        assert!(!text.contains('?'), "{text}");
        let folder = tempfile::tempdir().unwrap();
        update(&folder.path().join("servo.md"), &page::parts(&found, "a test")).unwrap();
        let [with_images, without] = &findings.fig7[..] else { panic!("{text}") };
        for run in [with_images, without] {
            let (found, ideal) = (run.summary.locked, run.ideal);
            assert_eq!(run.summary.frames_without_pose, 0, "{text}");
            assert!(ideal.moving.unwrap().mm < found.moving_mm.unwrap().rms, "{text}");
            assert!(ideal.moving.unwrap().deg < found.moving_deg.unwrap().rms, "{text}");
        }
        assert_eq!((findings.responses.len(), findings.steps.len()), (8, 4));
        assert!(
            findings.responses.iter().all(|r| r.is_possible() && r.gain_db.is_some() && r.phase_deg.is_some()),
            "{text}"
        );
        assert!(findings.steps.iter().all(|step| step.shortest_s > 0.1 && step.shortest_s < 2.0), "{text}");
        assert_eq!((findings.approaches.len(), findings.singular.len()), (4, 5));
        // No path exceeds a limit of the arm; reachable approaches arrive, the others report why they do not.
        let of_ways = findings.approaches.iter().map(|approach| &approach.way).chain(&findings.singular);
        for way in of_ways {
            let mut of_way = checks.iter().filter(|check| check.what.starts_with(&way.name)).peekable();
            assert!(of_way.peek().is_some() && of_way.all(Check::is_kept), "{}: {text}", way.name);
        }
        assert!(text.contains("| without images ") && text.contains("| x    | 10 "), "{text}");
        assert!(page::motion_figure(&findings.fig7).unwrap().matches("<path class=\"line").count() >= 12);
        assert!(page::response_figure(&findings.responses).contains("phase"));
    }

    #[test]
    fn a_part_is_chosen_by_words_in_names() {
        let extent = Extent::whole().only("fig7/direct/crab-like card/66,step/rz,singular/to");
        let names: Vec<String> = extent.fig7.iter().map(Fig7Case::name).collect();
        assert!(
            !names.is_empty() && names.iter().all(|name| name.starts_with("direct/crab-like card/66")),
            "{names:?}"
        );
        assert!(!extent.without_images && extent.channels.is_empty());
        assert_eq!((&extent.step_channels[..], extent.singular.len(), extent.laws.len()), (&[Channel::Rz][..], 1, 0));
    }

    #[test]
    fn the_command_line_is_checked() {
        let parse = |words: &[&str]| Options::try_parse_from(std::iter::once("servo").chain(words.iter().copied()));
        let options = parse(&["--quick", "--json", "x.json"]).unwrap();
        assert!(options.quick && options.json.is_some());
        assert!(parse(&["--page"]).is_err() && parse(&["--slow", "1"]).is_err());
        assert!(parse(&["--quick", "--page", "docs"]).is_err() && parse(&["--only", "x", "--page", "docs"]).is_err());
    }
}
