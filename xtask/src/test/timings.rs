//! Build and run time of each part.

use std::fs;
use std::path::Path;
use std::time::SystemTime;

use serde_json::Value;

use super::report::Report;

/// Rows of the table.
const ROWS: usize = 20;

/// One call of the compiler.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// Package.
    pub package: String,
    /// Name on cargo's page: `integration "test" (test)`; empty for a library.
    pub target: String,
    /// Duration, seconds.
    pub duration_s: f64,
}

/// The units of the newest page that `cargo --timings` has written to a folder; none without a page.
pub fn units(folder: &Path) -> Vec<Unit> {
    newest_page(folder).and_then(|text| parse(&text)).unwrap_or_default()
}

fn newest_page(folder: &Path) -> Option<String> {
    let written = |path: &Path| path.metadata().and_then(|data| data.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    let pages = fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let newest = pages
        .filter(|path| path.extension().is_some_and(|ending| ending == "html"))
        .max_by_key(|path| written(path))?;
    fs::read_to_string(newest).ok()
}

/// Cargo writes the units into the page as one line of JSON.
fn parse(page: &str) -> Option<Vec<Unit>> {
    let (_, rest) = page.split_once("const UNIT_DATA = ")?;
    let units: Value = serde_json::Deserializer::from_str(rest).into_iter().next()?.ok()?;
    let unit = |unit: &Value| {
        let text = |key: &str| unit[key].as_str().unwrap_or_default().trim().to_owned();
        Some(Unit { package: text("name"), target: text("target"), duration_s: unit["duration"].as_f64()? })
    };
    units.as_array().map(|units| units.iter().filter_map(unit).collect())
}

/// The slowest test programs, build and run time separately.
pub fn table(units: &[Unit], report: &Report) -> String {
    let build_s = |package: &str, target: &str| {
        let fits = |unit: &&Unit| {
            let is_unit_test =
                target == "unit tests" && unit.target.ends_with("(test)") && !unit.target.contains("\"test\"");
            unit.package == package
                && (is_unit_test || unit.target.starts_with(&format!("{target} \"")) && unit.target.ends_with("(test)"))
        };
        units.iter().filter(fits).fold(0.0, |sum, unit| sum + unit.duration_s)
    };
    let mut rows: Vec<(String, f64, f64)> = Vec::new();
    for program in &report.programs {
        let Some((package, target)) = program.name.split_once(' ') else { continue };
        let target = target.trim_end_matches(", real time");
        // Two runs of one program share its build.
        let is_first = !rows.iter().any(|(name, ..)| name.starts_with(&format!("{package} {target}")));
        rows.push((
            program.name.clone(),
            if is_first { build_s(package, target) } else { 0.0 },
            program.took.as_secs_f64(),
        ));
    }
    rows.sort_by(|left, right| (right.1 + right.2).total_cmp(&(left.1 + left.2)));
    let mut text = format!("\n{:<48} {:>8} {:>8}\n", "the slowest test programs", "build, s", "run, s");
    for (name, build_s, run_s) in rows.iter().take(ROWS) {
        text.push_str(&format!("{name:<48} {build_s:>8.1} {run_s:>8.1}\n"));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_from_the_page_of_cargo() {
        let page = "<script>\nconst UNIT_DATA = [{\"name\": \"pb3dp-servo\", \"target\": \" integration \\\"test\\\" (test)\", \
                    \"duration\": 5.9}, {\"name\": \"serde\", \"target\": \"\", \"duration\": 2}];\nconst X = 1;";
        let units = parse(page).unwrap();
        assert_eq!(units.len(), 2);
        assert_eq!(units[0].target, "integration \"test\" (test)");
        assert!(parse("<html>").is_none());
    }
}
