//! How well the hand follows: the experiment of Fig. 7, sinusoids and sudden steps, beside the published method and law, beside what
//! an ideal filter or the arm's limits allow, and beside the limits that are to be kept. Run it by `cargo xtask bench servo`.
#![allow(clippy::print_stdout, reason = "prints its figures")]

mod demands;
mod ideal;
mod json;
mod limits;
mod page;
mod runs;
mod setups;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use pb3dp_sim::trajectory::Channel;

use limits::Check;
use runs::{Fig7, Response, Step, fig7, fig7_of, response, step_response};
use setups::{DELAYS_MILLIS, TARGETS, Who, geometric};

const PERIODS_S: [f64; 10] = [30.0, 20.0, 15.0, 10.0, 8.0, 6.0, 5.0, 4.0, 3.0, 2.0];

/// Everything that was measured.
struct Findings {
    fig7: Vec<Fig7>,
    responses: Vec<Response>,
    steps: Vec<Step>,
    /// Simulated seconds per second of this machine, of the experiment without pictures.
    geometric_times_real_time: f64,
}

/// How much is measured.
struct Extent {
    /// Targets and delays of the experiment with pictures, and when it ends.
    fig7: Vec<(Who, usize, f64)>,
    stop_after_s: Option<f64>,
    channels: Vec<Channel>,
    periods_s: Vec<f64>,
}

impl Extent {
    /// All of it.
    fn whole() -> Self {
        let ours =
            DELAYS_MILLIS.iter().flat_map(|delay| (0..TARGETS.len()).map(move |target| (Who::Ours, target, *delay)));
        // The published method needs hue, which the grey box does not have.
        let published =
            DELAYS_MILLIS.iter().flat_map(|delay| (0..3).map(move |target| (Who::Published, target, *delay)));
        let (channels, periods_s) = (Channel::ALL.to_vec(), PERIODS_S.to_vec());
        Self { fig7: ours.chain(published).collect(), stop_after_s: None, channels, periods_s }
    }

    /// A sample of everything, for a test: some seconds.
    fn quick() -> Self {
        let (channels, periods_s) = (vec![Channel::X, Channel::Ry], vec![10.0, 6.0]);
        Self { fig7: vec![(Who::Ours, 0, DELAYS_MILLIS[0])], stop_after_s: Some(13.0), channels, periods_s }
    }
}

impl Findings {
    fn of(extent: &Extent) -> Result<Self> {
        let mut found =
            Self { fig7: Vec::new(), responses: Vec::new(), steps: Vec::new(), geometric_times_real_time: 0.0 };
        for &(who, target, delay_millis) in &extent.fig7 {
            let what = format!("{}, {}, {delay_millis} ms", who.name(), TARGETS[target].0);
            println!("{what} ...");
            found.fig7.push(fig7(who, TARGETS[target], delay_millis, extent.stop_after_s).context(what)?);
        }
        found.without_pictures()?;
        println!("sinusoids and steps ...");
        for &channel in &extent.channels {
            for who in Who::ALL {
                for &period_s in &extent.periods_s {
                    let what = || format!("{}, {} every {period_s} s", who.name(), channel.name());
                    found.responses.push(response(who, channel, period_s).with_context(what)?);
                }
                found.steps.push(step_response(who, channel).with_context(|| format!("step of {}", channel.name()))?);
            }
        }
        Ok(found)
    }

    /// The experiment of Fig. 7 without pictures, for comparison, and its speed.
    fn without_pictures(&mut self) -> Result<()> {
        let setup = Who::Ours.setup(DELAYS_MILLIS[0])?;
        let motion = setup.experiment.motion.clone();
        let mut setup = geometric(setup, motion)?;
        setup.experiment.carrier = pb3dp_orchestrator::config::setup::Carrier::Arm;
        self.geometric_times_real_time = runs::run(&setup, None)?.times_real_time;
        self.fig7.push(fig7_of(&setup, (Who::Ours, "without pictures"), DELAYS_MILLIS[0], None)?);
        Ok(())
    }

    fn checks(&self) -> Vec<Check> {
        let mut checks: Vec<Check> = self.fig7.iter().flat_map(limits::of_fig7).collect();
        let mut channels: Vec<&str> = self.responses.iter().map(|response| response.channel).collect();
        channels.dedup();
        checks.extend(channels.into_iter().flat_map(|channel| limits::of_responses(channel, &self.responses)));
        checks.extend(self.steps.iter().flat_map(limits::of_step));
        checks
    }

    fn text(&self, checks: &[Check]) -> String {
        [
            page::fig7_table(&self.fig7),
            page::axis_table(&self.fig7),
            page::response_table(&self.responses),
            page::step_table(&self.steps),
            page::limit_table(checks),
        ]
        .join("\n")
    }
}

fn main() -> Result<()> {
    let options = Options::parse(std::env::args().skip(1))?;
    let extent = if options.quick { Extent::quick() } else { Extent::whole() };
    let findings = Findings::of(&extent)?;
    let checks = findings.checks();
    println!("\n{}", findings.text(&checks));
    println!("without pictures: {:.0} times as fast as time", findings.geometric_times_real_time);
    if let Some(file) = &options.json {
        write(file, &format!("{:#}\n", json::all(&findings, &checks, &options.origin)))?;
    }
    if let Some(folder) = &options.page {
        write(&folder.join("servo.md"), &page::page(&findings, &checks, &options.origin))?;
        write(&folder.join("servo.svg"), &page::motion_figure(&findings.fig7).context("no run to draw")?)?;
        write(&folder.join("servo_response.svg"), &page::response_figure(&findings.responses))?;
    }
    let missed = checks.iter().filter(|check| !check.is_kept()).count();
    if missed > 0 {
        bail!("{missed} of {} limits are missed: see the last table", checks.len());
    }
    Ok(())
}

fn write(file: &Path, text: &str) -> Result<()> {
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("{} can not be made", folder.display()))?;
    }
    std::fs::write(file, text).with_context(|| format!("{} can not be written", file.display()))
}

/// What the command line says.
#[derive(Default)]
struct Options {
    quick: bool,
    json: Option<PathBuf>,
    page: Option<PathBuf>,
    origin: String,
}

impl Options {
    fn parse(mut words: impl Iterator<Item = String>) -> Result<Self> {
        let mut options = Self::default();
        while let Some(word) = words.next() {
            if word == "--quick" {
                options.quick = true;
                continue;
            }
            let value = words.next().with_context(|| format!("{word}: give a value"))?;
            match word.as_str() {
                "--json" => options.json = Some(value.into()),
                "--page" => options.page = Some(value.into()),
                "--origin" => options.origin = value,
                other => bail!("{other}: known are --quick, --json, --page and --origin"),
            }
        }
        if options.quick && options.page.is_some() {
            bail!("--page: a quick run writes no page");
        }
        Ok(options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All parts of the measurement on a sample of it; figures are there, and those of the bounds are below what was reached.
    #[test]
    fn a_quick_run_measures_everything() {
        let findings = Findings::of(&Extent::quick()).unwrap();
        let checks = findings.checks();
        let text = findings.text(&checks);
        let [with_pictures, without] = &findings.fig7[..] else { panic!("{text}") };
        for run in [with_pictures, without] {
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
        let json = json::all(&findings, &checks, "a test");
        assert_eq!(json["limits"].as_array().unwrap().len(), checks.len());
        let page = page::page(&findings, &checks, "a test");
        assert!(page.contains("without pictures") && page.contains("| x | 10 |"), "{page}");
        assert!(page::motion_figure(&findings.fig7).unwrap().matches("<path class=\"line").count() >= 12);
        assert!(page::response_figure(&findings.responses).contains("phase"));
    }

    #[test]
    fn the_command_line_is_checked() {
        let parse = |words: &[&str]| Options::parse(words.iter().map(|word| (*word).to_owned()));
        let options = parse(&["--quick", "--json", "x.json"]).unwrap();
        assert!(options.quick && options.json.is_some());
        assert!(parse(&["--page"]).is_err() && parse(&["--slow", "1"]).is_err());
        assert!(parse(&["--quick", "--page", "docs"]).is_err());
    }
}
