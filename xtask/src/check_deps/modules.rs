//! Cycles between the modules of a package. A module is what `lib.rs` declares, with everything below it.

use std::collections::{BTreeMap, BTreeSet};

use crate::rust_text::{code_only, paths, without_test_items};
use crate::violation::Violation;
use crate::workspace::SourceFile;

/// Modules of one package that use names from each other: from, to, and a position of such a use.
type Arrows<'a> = BTreeMap<(&'a str, &'a str), (&'a str, usize)>;

/// Checks all packages.
pub fn check(files: &[SourceFile]) -> Vec<Violation> {
    let mut packages: BTreeMap<&str, Vec<(&str, &SourceFile)>> = BTreeMap::new();
    for file in files {
        if let Some((package, inside)) = product_file(&file.path) {
            packages.entry(package).or_default().push((inside, file));
        }
    }
    let of_package = |(package, files): (&&str, &Vec<(&str, &SourceFile)>)| {
        let arrows = arrows(files);
        circles(&arrows).iter().map(|circle| of_circle(package, circle, &arrows)).collect::<Vec<_>>()
    };
    packages.iter().flat_map(of_package).collect()
}

/// The package's folder and the path below its `src`, for a file of product code.
fn product_file(path: &str) -> Option<(&str, &str)> {
    let (package, inside) = path.split_once("/src/")?;
    let is_test = inside.ends_with("_tests.rs") || inside.split('/').any(|part| part == "tests" || part == "tests.rs");
    let is_ours = (package.starts_with("crates/") || package.starts_with("hal/")) && package.matches('/').count() == 1;
    (is_ours && !is_test).then_some((package, inside))
}

/// The module path of a file: `a/b.rs` and `a/b/mod.rs` are `[a, b]`, the root of a package is empty.
fn module_of(inside: &str) -> Vec<&str> {
    let mut parts: Vec<&str> = inside.trim_end_matches(".rs").split('/').collect();
    if parts.last().is_some_and(|last| ["mod", "lib", "main"].contains(last)) {
        parts.pop();
    }
    parts
}

fn arrows<'a>(files: &[(&'a str, &'a SourceFile)]) -> Arrows<'a> {
    let tops: BTreeSet<&str> = files.iter().filter_map(|(inside, _)| module_of(inside).first().copied()).collect();
    let mut arrows = Arrows::new();
    for (inside, file) in files {
        let module = module_of(inside);
        let Some(&from) = module.first() else { continue };
        for (line, name) in paths(&without_test_items(&code_only(&file.text))) {
            let Some(to) = top_of(&name, &module).and_then(|to| tops.get(to.as_str()).copied()) else { continue };
            if to != from {
                arrows.entry((from, to)).or_insert((&file.path, line));
            }
        }
    }
    arrows
}

/// The topmost module of a path in `module`; `None` for other packages.
fn top_of(path: &str, module: &[&str]) -> Option<String> {
    let mut parts = path.split("::").map(str::trim);
    let ups = match parts.next()? {
        "crate" => module.len(),
        "super" => 1 + parts.clone().take_while(|part| *part == "super").count(),
        _ => return None,
    };
    let inner = module.get(..module.len().checked_sub(ups)?)?;
    match inner.first() {
        Some(top) => Some((*top).to_owned()),
        None => path.split("::").map(str::trim).find(|part| !["crate", "super"].contains(part)).map(str::to_owned),
    }
}

/// Strongly connected sets of modules, sorted.
fn circles<'a>(arrows: &Arrows<'a>) -> Vec<Vec<&'a str>> {
    let modules: BTreeSet<&str> = arrows.keys().flat_map(|(from, to)| [*from, *to]).collect();
    let reach: BTreeMap<&str, BTreeSet<&str>> =
        modules.iter().map(|module| (*module, reachable(module, arrows))).collect();
    let mut circles: BTreeSet<Vec<&str>> = BTreeSet::new();
    for module in &modules {
        let back = |other: &&&str| reach[module].contains(**other) && reach[**other].contains(module);
        let circle: Vec<&str> = modules.iter().filter(back).copied().collect();
        if circle.len() > 1 {
            circles.insert(circle);
        }
    }
    circles.into_iter().collect()
}

fn reachable<'a>(start: &str, arrows: &Arrows<'a>) -> BTreeSet<&'a str> {
    let mut found = BTreeSet::new();
    let mut open: Vec<&str> = vec![start];
    while let Some(module) = open.pop() {
        for (_, to) in arrows.keys().filter(|(from, _)| *from == module) {
            if found.insert(*to) {
                open.push(to);
            }
        }
    }
    found
}

fn of_circle(package: &str, circle: &[&str], arrows: &Arrows<'_>) -> Violation {
    let within = arrows.iter().filter(|((from, to), _)| circle.contains(from) && circle.contains(to));
    let ties: Vec<String> =
        within.map(|((from, to), (file, line))| format!("{from} -> {to} ({file}:{line})")).collect();
    let message = format!("the modules {circle:?} form a cycle: {}; move common code below them", ties.join(", "));
    Violation::of(package, "module-circle", message)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(texts: &[(&str, &str)]) -> Vec<SourceFile> {
        texts.iter().map(|(path, text)| SourceFile { path: (*path).to_owned(), text: (*text).to_owned() }).collect()
    }

    #[test]
    fn a_planted_circle_is_found_with_its_places() {
        let planted = files(&[
            ("crates/a/src/lib.rs", "pub mod one; pub mod two; pub mod three;"),
            ("crates/a/src/one.rs", "use crate::two::B;\nmod inner;"),
            ("crates/a/src/one/inner.rs", "use super::super::three::C;"),
            ("crates/a/src/two/mod.rs", "use super::{one::A};"),
            ("crates/a/src/three.rs", "pub struct C;"),
        ]);
        let [violation] = &check(&planted)[..] else { panic!("one cycle") };
        assert!(violation.message.contains(r#"["one", "two"]"#), "{violation}");
        assert!(violation.message.contains("two -> one (crates/a/src/two/mod.rs:1)"), "{violation}");
    }

    #[test]
    fn below_a_module_and_in_tests_names_go_both_ways() {
        let sound = files(&[
            ("hal/a/src/one.rs", "use self::inner::B;\nmod inner;\nuse crate::two::C;"),
            ("hal/a/src/one/inner.rs", "use super::A;"),
            ("hal/a/src/two.rs", "#[cfg(test)]\nmod tests { use crate::one::A; }"),
            ("hal/a/src/two_tests.rs", "use crate::one::A;"),
        ]);
        assert_eq!(check(&sound), []);
    }
}
