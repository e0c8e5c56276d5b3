//! Seeds of runs that once violated an invariant: each full measurement repeats them.

use anyhow::{Context, Result, ensure};

use crate::scenario::{Draw, Scenario};

/// One seed per line, after the name of its draw: a later draw leaves the runs of an earlier one as they are.
const SEEDS: &str = include_str!("kept_seeds.txt");

/// The scenarios of the kept seeds.
///
/// # Errors
/// A line that names no draw or no seed.
pub fn scenarios() -> Result<Vec<Scenario>> {
    let lines = SEEDS.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    lines.map(|line| scenario(line).with_context(|| format!("kept_seeds.txt: {line}"))).collect()
}

fn scenario(line: &str) -> Result<Scenario> {
    let mut fields = line.split_whitespace();
    let (draw, seed) = (fields.next().unwrap_or(""), fields.next().context("no seed")?);
    let seed = seed.parse().context("a seed is a whole number")?;
    ensure!(fields.next().is_some(), "say what this seed has found");
    let draw = Draw::named(draw).context("the draw is `first`, `wide`, `stalls`, `starts` or `cells`")?;
    Ok(Scenario::of(draw, seed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kept_seed_has_a_scenario() {
        let scenarios = scenarios().unwrap();
        assert!(scenarios.len() >= 7);
        assert!(scenario("first 12").is_err() && scenario("other 12 reason").is_err() && scenario("wide x y").is_err());
    }
}
