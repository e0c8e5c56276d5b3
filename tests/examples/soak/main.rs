//! Two arms on pseudo-terminals for minutes: random faults, and the time until both arms are stationary.
//!
//! The arms are those of `configs/hil.toml`, emulated byte by byte, with the full software chain of a real arm; both move at
//! 100 Hz. One of a hundred replies is lost throughout, never three in a row. Run it by `cargo xtask soak`.
#![allow(clippy::print_stdout, reason = "prints its figures")]

mod faults;
mod figures;
mod rig;

use std::time::Duration;

use anyhow::{Context, Result, bail};
use faults::{FAULTS, Fault};
use figures::Figures;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_hal_api::ArmErrorKind;
use rig::{Rig, Stopped};

/// Largest time to detect a fault.
const NOTICE_MAX: Duration = Duration::from_secs(1);
/// A fault without a reaction within this time counts as tolerated.
const BORNE_AFTER: Duration = Duration::from_millis(300);
/// A week.
const MINUTES_MAX: f64 = 10_080.0;

fn main() -> Result<()> {
    let options = Options::parse(std::env::args().skip(1))?;
    let faults = if options.losses_only { None } else { Some(with_faults(&options)?) };
    let losses = if options.losses_only || options.page.is_some() { Some(losses_only(&options)?) } else { None };
    if let (Some(file), Some(faults), Some(losses)) = (&options.page, &faults, &losses) {
        let page = figures::page(&options.origin, (options.minutes, options.seed), (faults, losses));
        std::fs::write(file, page).with_context(|| format!("cannot write {file}"))?;
    }
    faults.iter().chain(&losses).try_for_each(Figures::judge)
}

/// Lost replies only: of the controllers, and of the gateways.
fn losses_only(options: &Options) -> Result<Figures> {
    let mut rig = Rig::new(options.seed)?;
    rig.lose_replies_on_the_line(options.seed);
    let mut figures = Figures::default();
    let end = rig.clock.now() + options.duration();
    while rig.clock.now() < end {
        rig.make_ready(&mut figures)?;
        if let Err(stopped) = rig.cycle_for(end.saturating_since(rig.clock.now()), &mut figures) {
            figures.stopped_by_itself(&stopped)?;
        }
    }
    rig.add_links(&mut figures);
    print!("{}", figures.text());
    Ok(figures)
}

/// Faults of all kinds in turn.
fn with_faults(options: &Options) -> Result<Figures> {
    let mut rig = Rig::new(options.seed)?;
    let mut random = SplitMix64::new(options.seed);
    let mut figures = Figures::default();
    let end = rig.clock.now() + options.duration();
    let mut order: Vec<&Fault> = Vec::new();
    while rig.clock.now() < end {
        rig.make_ready(&mut figures)?;
        if order.is_empty() {
            // Every kind once, in a new order each time.
            order.extend(&FAULTS);
            shuffle(&mut order, &mut random);
        }
        let quiet = Duration::from_millis(u64::from(200 + random.below(400)));
        if let Err(stopped) = rig.cycle_for(quiet, &mut figures) {
            figures.stopped_by_itself(&stopped)?;
            continue;
        }
        let Some(fault) = order.pop() else { continue };
        let arm = random.below(2) as usize;
        inject(&mut rig, fault, arm, &mut random, &mut figures)?;
    }
    rig.add_links(&mut figures);
    print!("{}", figures.text());
    Ok(figures)
}

/// One fault: until it is detected and both arms are stationary, or until it counts as tolerated.
fn inject(rig: &mut Rig, fault: &Fault, arm: usize, random: &mut SplitMix64, figures: &mut Figures) -> Result<()> {
    let axis = 1 + random.below(7);
    let line = fault.begin.replace("AXIS", &axis.to_string());
    let at = rig.fault(arm, &line)?;
    figures.injected(fault.name, fault.rest_max_millis);
    let outcome = rig.cycle_for(if fault.rest_max_millis.is_some() { NOTICE_MAX } else { BORNE_AFTER }, figures);
    match outcome {
        // A fault that should stop the arms but did not is counted as not detected.
        Ok(()) if fault.rest_max_millis.is_some() => {}
        Ok(()) => figures.borne(fault.name),
        Err(stopped) => {
            let Stopped { at: noticed, kind, message, .. } = &stopped;
            if fault.rest_max_millis.is_none() {
                let message = format!("after `{line}`, which should be tolerated: {message}");
                figures.not_borne(fault.name);
                return figures.stopped_by_itself(&Stopped { message, ..stopped });
            }
            if !matches!(kind, ArmErrorKind::Fault | ArmErrorKind::Disconnected | ArmErrorKind::NotEnabled) {
                bail!("`{line}`: unexpected kind of error: {message}");
            }
            let rest = rig.rest_after(at);
            figures.stopped(fault.name, (noticed.saturating_since(at), rest));
        }
    }
    if let Some(end) = fault.end {
        rig.fault(arm, &end.replace("AXIS", &axis.to_string()))?;
    }
    Ok(())
}

/// Shuffles the order.
fn shuffle<T>(items: &mut [T], random: &mut SplitMix64) {
    for left in (2..=items.len()).rev() {
        items.swap(left - 1, random.below(left as u32) as usize);
    }
}

/// The command line options.
struct Options {
    minutes: f64,
    losses_only: bool,
    seed: u64,
    page: Option<String>,
    origin: String,
}

impl Options {
    fn duration(&self) -> Duration {
        Duration::from_secs_f64(self.minutes * 60.0)
    }

    fn parse(mut args: impl Iterator<Item = String>) -> Result<Self> {
        let mut options = Self { minutes: 1.0, losses_only: false, seed: 1, page: None, origin: String::new() };
        while let Some(arg) = args.next() {
            let value = args.next().with_context(|| format!("{arg}: no value given"))?;
            match arg.as_str() {
                "--minutes" => {
                    options.minutes = value.parse().with_context(|| format!("--minutes {value}: not a number"))?
                }
                "--seed" => options.seed = value.parse().with_context(|| format!("--seed {value}: not a number"))?,
                "--what" if value == "losses" => options.losses_only = true,
                "--page" => options.page = Some(value),
                "--origin" => options.origin = value,
                other => bail!("unknown option {other}; options: --minutes, --what losses, --seed, --page, --origin"),
            }
        }
        if !(options.minutes > 0.0 && options.minutes <= MINUTES_MAX) {
            bail!("--minutes {}: give more than 0 and at most {MINUTES_MAX}", options.minutes);
        }
        Ok(options)
    }
}
