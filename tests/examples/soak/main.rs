//! Two arms over pseudo-terminals, for minutes: faults at random, and how long it takes until both arms are at rest.
//!
//! The arms are those of `configs/hil.toml`, emulated byte by byte, behind all that stands before a real arm; both move, at 100 Hz.
//! One reply in a hundred is lost all the time, never three in a row. Run it by `cargo xtask soak`.
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

/// How long a fault may take to be noticed.
const NOTICE_MAX: Duration = Duration::from_secs(1);
/// What is borne is waited for so long.
const BORNE_AFTER: Duration = Duration::from_millis(300);
/// A week.
const MINUTES_MAX: f64 = 10_080.0;

fn main() -> Result<()> {
    let options = Options::parse(std::env::args().skip(1))?;
    let faults = if options.losses_only { None } else { Some(with_faults(&options)?) };
    let losses = if options.losses_only || options.page.is_some() { Some(losses_only(&options)?) } else { None };
    if let (Some(file), Some(faults), Some(losses)) = (&options.page, &faults, &losses) {
        let page = figures::page(&options.origin, (options.minutes, options.seed), (faults, losses));
        std::fs::write(file, page).with_context(|| format!("{file} cannot be written"))?;
    }
    faults.iter().chain(&losses).try_for_each(Figures::judge)
}

/// Nothing but lost replies: of the controllers, and of the gateways.
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

/// Faults of all kinds, one after the other.
fn with_faults(options: &Options) -> Result<Figures> {
    let mut rig = Rig::new(options.seed)?;
    let mut random = SplitMix64::new(options.seed);
    let mut figures = Figures::default();
    let end = rig.clock.now() + options.duration();
    let mut order: Vec<&Fault> = Vec::new();
    while rig.clock.now() < end {
        rig.make_ready(&mut figures)?;
        if order.is_empty() {
            // Every kind once, in another order each time.
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

/// One fault: until it is noticed and both arms are at rest, or has been borne.
fn inject(rig: &mut Rig, fault: &Fault, arm: usize, random: &mut SplitMix64, figures: &mut Figures) -> Result<()> {
    let axis = 1 + random.below(7);
    let line = fault.begin.replace("AXIS", &axis.to_string());
    let at = rig.fault(arm, &line)?;
    figures.injected(fault.name, fault.rest_max_millis);
    let outcome = rig.cycle_for(if fault.rest_max_millis.is_some() { NOTICE_MAX } else { BORNE_AFTER }, figures);
    match outcome {
        // What is to stop the arms and did not is counted by what is missing.
        Ok(()) if fault.rest_max_millis.is_some() => {}
        Ok(()) => figures.borne(fault.name),
        Err(stopped) => {
            let Stopped { at: noticed, kind, message, .. } = &stopped;
            if fault.rest_max_millis.is_none() {
                let message = format!("after `{line}`, which is to be borne: {message}");
                figures.not_borne(fault.name);
                return figures.stopped_by_itself(&Stopped { message, ..stopped });
            }
            if !matches!(kind, ArmErrorKind::Fault | ArmErrorKind::Disconnected | ArmErrorKind::NotEnabled) {
                bail!("`{line}`: an error of another kind: {message}");
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

/// Another order.
fn shuffle<T>(items: &mut [T], random: &mut SplitMix64) {
    for left in (2..=items.len()).rev() {
        items.swap(left - 1, random.below(left as u32) as usize);
    }
}

/// What the command line says.
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

    fn parse(mut words: impl Iterator<Item = String>) -> Result<Self> {
        let mut options = Self { minutes: 1.0, losses_only: false, seed: 1, page: None, origin: String::new() };
        while let Some(word) = words.next() {
            let value = words.next().with_context(|| format!("{word}: give a value"))?;
            match word.as_str() {
                "--minutes" => {
                    options.minutes = value.parse().with_context(|| format!("--minutes {value}: no number"))?
                }
                "--seed" => options.seed = value.parse().with_context(|| format!("--seed {value}: no number"))?,
                "--what" if value == "losses" => options.losses_only = true,
                "--page" => options.page = Some(value),
                "--origin" => options.origin = value,
                other => bail!("{other}: known are --minutes, --what losses, --seed, --page and --origin"),
            }
        }
        if !(options.minutes > 0.0 && options.minutes <= MINUTES_MAX) {
            bail!("--minutes {}: give more than 0 and at most {MINUTES_MAX}", options.minutes);
        }
        Ok(options)
    }
}
