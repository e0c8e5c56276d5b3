//! Cycles between the modules of one parent: those that `lib.rs` declares, and those of each folder below. A module counts with
//! everything below it.
//!
//! A parent and its own children may use each other: a parent that hands requests to its children defines the types of these
//! requests. Only moving each such type into a file of its own would avoid it.

use std::collections::{BTreeMap, BTreeSet};

use crate::rust_text::{code_only, paths, without_test_items};
use crate::violation::Violation;
use crate::workspace::SourceFile;

/// Modules of one parent that use names from each other: from, to, and a position of such a use.
type Arrows<'a> = BTreeMap<(&'a str, &'a str), (&'a str, usize)>;

/// The uses among the modules of each parent, by the parent's path below the package.
type ByParent<'a> = BTreeMap<Vec<&'a str>, Arrows<'a>>;

/// Checks all packages.
pub fn check(files: &[SourceFile]) -> Vec<Violation> {
    let mut packages: BTreeMap<&str, Vec<(&str, &SourceFile)>> = BTreeMap::new();
    for file in files {
        if let Some((package, inside)) = product_file(&file.path) {
            packages.entry(package).or_default().push((inside, file));
        }
    }
    let of_package = |(package, files): (&&str, &Vec<(&str, &SourceFile)>)| {
        let of_parent = |(parent, arrows): (&Vec<&str>, &Arrows<'_>)| {
            let place = [&[*package], &parent[..]].concat().join("/");
            circles(arrows).iter().map(|circle| of_circle(&place, circle, arrows)).collect::<Vec<_>>()
        };
        by_parent(files).iter().flat_map(of_parent).collect::<Vec<_>>()
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

fn by_parent<'a>(files: &[(&'a str, &'a SourceFile)]) -> ByParent<'a> {
    let modules: BTreeSet<Vec<&str>> = files.iter().map(|(inside, _)| module_of(inside)).collect();
    let mut found = ByParent::new();
    for (inside, file) in files {
        let module = module_of(inside);
        for (line, name) in paths(&without_test_items(&code_only(&file.text))) {
            let Some(used) = absolute(&name, &module) else { continue };
            let shared = module.iter().zip(&used).take_while(|(from, to)| *from == *to).count();
            let (Some(from), Some(to)) = (module.get(shared), used.get(shared)) else { continue };
            let is_sibling = |known: &&Vec<&str>| known.starts_with(&module[..shared]) && known.get(shared) == Some(to);
            if let Some(sibling) = modules.iter().find(is_sibling) {
                let arrows = found.entry(module[..shared].to_vec()).or_default();
                arrows.entry((*from, sibling[shared])).or_insert((&file.path, line));
            }
        }
    }
    found
}

/// The parts of a path used in `module`, from the root of the package; `None` for other packages and own children.
fn absolute<'p>(path: &'p str, module: &[&'p str]) -> Option<Vec<&'p str>> {
    let mut parts = path.split("::").map(str::trim).peekable();
    let mut base = match parts.next()? {
        "crate" => Vec::new(),
        "super" => module[..module.len().checked_sub(1)?].to_vec(),
        _ => return None,
    };
    while parts.next_if_eq(&"super").is_some() {
        base.pop()?;
    }
    base.extend(parts);
    Some(base)
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

fn of_circle(place: &str, circle: &[&str], arrows: &Arrows<'_>) -> Violation {
    let within = arrows.iter().filter(|((from, to), _)| circle.contains(from) && circle.contains(to));
    let ties: Vec<String> =
        within.map(|((from, to), (file, line))| format!("{from} -> {to} ({file}:{line})")).collect();
    let message = format!("the modules {circle:?} form a cycle: {}; move common code below them", ties.join(", "));
    Violation::of(place, "module-circle", message)
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

    #[test]
    fn a_planted_circle_of_siblings_below_a_module_is_found() {
        let planted = files(&[
            ("crates/a/src/top.rs", "mod one;\nmod two;\npub struct Common;"),
            ("crates/a/src/top/one.rs", "use super::two::B;"),
            ("crates/a/src/top/two.rs", "use super::Common;\nuse crate::top::one::A;"),
        ]);
        let [violation] = &check(&planted)[..] else { panic!("one cycle") };
        assert!(violation.to_string().contains("crates/a/top"), "{violation}");
        assert!(violation.message.contains("two -> one (crates/a/src/top/two.rs:2)"), "{violation}");
    }
}
