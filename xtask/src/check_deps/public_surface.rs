//! Size of the estimation's interface: counts what a user of its entry can reach.
//!
//! Reached are the public items of the entry's public modules, what these re-export, and each type of our packages that a reached item
//! names: in a public field, a variant, or the head of a public function. A type counts with its public functions and constants, wherever
//! it is defined: an item that is moved to another package and re-exported still counts. A package of others counts as one item.

use std::collections::{BTreeMap, BTreeSet};

use crate::rust_text::{code_only, items, paths, used_paths, without_test_items};
use crate::violation::Violation;
use crate::workspace::SourceFile;

/// The entry.
const ENTRY: &str = "estimation";

/// The packages whose types a user of the entry may hold: their names begin so.
const PACKAGES: [&str; 3] = ["estimation", "geometry", "computing"];

/// Maximum number of items that a user can reach.
const ITEMS_MAX: usize = 390;

/// A package, and a name in it.
type Key = (String, String);

/// Public items of one name in one package.
#[derive(Default)]
struct Item {
    /// Their number, with the functions and constants of a type.
    count: usize,
    /// The names in their declarations.
    named: BTreeSet<Key>,
}

type Items = BTreeMap<Key, Item>;

/// A file of one of the packages.
struct Source {
    package: String,
    /// Its path below `src`, without the ending.
    module: String,
    code: String,
    /// The paths in it.
    paths: Vec<String>,
}

/// Counts what a user of the entry can reach, and rejects re-exports that hide how many items they are.
pub fn check(files: &[SourceFile]) -> Vec<Violation> {
    let sources: Vec<Source> = files.iter().filter_map(Source::of).collect();
    let mut all = Items::new();
    sources.iter().for_each(|source| source.add_to(&mut all));
    let (mut count, mut open, mut violations) = (0, Vec::new(), Vec::new());
    let mut modules = vec!["lib".to_owned()];
    while let Some(module) = modules.pop() {
        let Some(source) = sources.iter().find(|source| source.package == ENTRY && source.module == module) else {
            continue;
        };
        for (head, body) in items(&source.code) {
            match public(head) {
                Some(("mod", name)) => {
                    modules.push(if module == "lib" { name.to_owned() } else { format!("{module}/{name}") });
                    count += 1;
                }
                Some(("use", _)) => {
                    let tree = head.trim_start_matches("pub use");
                    let tree = if body.is_empty() { tree.to_owned() } else { format!("{tree}{{{body}}}") };
                    for path in used_paths(&tree) {
                        let key = source.key(path.rsplit("::").next().unwrap_or_default());
                        let is_known = !keys(&key, &all).is_empty();
                        if path.contains("::") && !is_known {
                            let message = format!("`pub use {path}`: name each item, so that a reader can count them");
                            violations.push(Violation::of(&source.path(), "public-surface", message));
                        }
                        count += usize::from(!is_known);
                        open.push(key);
                    }
                }
                Some((_, name)) => open.push((ENTRY.to_owned(), name.to_owned())),
                None => {}
            }
        }
    }
    count += count_reached(open, &all);
    if count > ITEMS_MAX {
        let message =
            format!("a user can reach {count} public items, at most {ITEMS_MAX}: hide those that no user needs");
        violations.push(Violation::of(&format!("crates/{ENTRY}/src/"), "public-surface", message));
    }
    violations
}

/// The number of items with these names, and of all that they name.
fn count_reached(mut open: Vec<Key>, all: &Items) -> usize {
    let (mut reached, mut count) = (BTreeSet::new(), 0);
    while let Some(key) = open.pop() {
        for key in keys(&key, all) {
            if reached.insert(key) {
                count += all[key].count;
                open.extend(all[key].named.iter().cloned());
            }
        }
    }
    count
}

/// The item of a package with a name; of any package if this one re-exports it.
fn keys<'a>(key: &Key, all: &'a Items) -> Vec<&'a Key> {
    let is_own = all.contains_key(key);
    all.keys().filter(|other| other.1 == key.1 && (!is_own || other.0 == key.0)).collect()
}

impl Source {
    fn of(file: &SourceFile) -> Option<Self> {
        let (package, inside) = file.path.strip_prefix("crates/")?.split_once("/src/")?;
        let is_test = package.ends_with("test-support") || inside.ends_with("tests.rs") || inside.contains("tests/");
        if is_test || !PACKAGES.iter().any(|name| package.starts_with(name)) {
            return None;
        }
        let module = inside.strip_suffix(".rs")?;
        let module = module.strip_suffix("/mod").unwrap_or(module).to_owned();
        let code = without_test_items(&code_only(&file.text));
        let paths = paths(&code).into_iter().map(|(_, path)| path).collect();
        Some(Self { package: package.replace('-', "_"), module, code, paths })
    }

    fn path(&self) -> String {
        format!("crates/{}/src/{}.rs", self.package.replace('_', "-"), self.module)
    }

    /// What a name means in this file: an item of the package that a path states, or else of its own.
    fn key(&self, name: &str) -> Key {
        let stated = self.paths.iter().filter(|path| path.rsplit("::").next() == Some(name));
        let package = stated.filter_map(|path| path.strip_prefix("pb3dp_")?.split("::").next()).next();
        (package.unwrap_or(&self.package).to_owned(), name.to_owned())
    }

    /// The types in a text.
    fn types<'a>(&'a self, text: &'a str) -> impl Iterator<Item = Key> + 'a {
        words(text).filter(|word| word.starts_with(char::is_uppercase)).map(|word| self.key(word))
    }

    /// Adds the public items of the file.
    fn add_to(&self, all: &mut Items) {
        let mut add = |name: &str, count: usize, text: &str| {
            let item = all.entry((self.package.clone(), name.to_owned())).or_default();
            item.count += count;
            item.named.extend(self.types(text));
        };
        for (head, body) in items(&self.code) {
            match (public(head), implemented(head)) {
                (Some(("mod" | "use", _)), _) => {}
                (Some(("struct", name)), _) => {
                    let fields = body.lines().filter(|line| line.trim_start().starts_with("pub "));
                    add(name, 1, &format!("{head} {}", fields.collect::<String>()));
                }
                (Some(("enum", name)), _) => add(name, 1, &format!("{head} {body}")),
                (Some(("trait", name)), _) => {
                    add(name, 1, head);
                    items(body).into_iter().for_each(|(head, _)| add(name, 1, head));
                }
                (Some((_, name)), _) => add(name, 1, head.split(" = ").next().unwrap_or_default()),
                (None, Some(name)) => {
                    let members = items(body).into_iter().filter(|(head, _)| public(head).is_some());
                    members.for_each(|(head, _)| add(name, 1, head.split(" = ").next().unwrap_or_default()));
                }
                (None, None) => {}
            }
        }
    }
}

fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|word| !word.is_empty())
}

/// Kind and name of a public item.
fn public(head: &str) -> Option<(&str, &str)> {
    let mut words = words(head.strip_prefix("pub ")?).peekable();
    let mut kind = words.next()?;
    while ["unsafe", "async"].contains(&kind) || (kind == "const" && words.peek() == Some(&"fn")) {
        kind = words.next()?;
    }
    Some((kind, words.next().unwrap_or_default()))
}

/// The type of an `impl` without a trait.
fn implemented(head: &str) -> Option<&str> {
    let rest = head.strip_prefix("impl").filter(|rest| !rest.contains(" for "))?;
    let generics = if rest.starts_with('<') { rest.find("> ")? } else { 0 };
    words(&rest[generics..]).next()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(texts: &[(&str, String)]) -> usize {
        let file = |(path, text): &(&str, String)| SourceFile { path: (*path).to_owned(), text: text.clone() };
        check(&texts.iter().map(file).collect::<Vec<_>>()).len()
    }

    fn functions(count: usize) -> String {
        (0..count).map(|k| format!("pub fn f{k}() {{}}\n")).collect()
    }

    const LIB: &str = "crates/estimation/src/lib.rs";
    const CORE: &str = "crates/estimation-core/src/lib.rs";

    #[test]
    fn too_many_items_are_found_in_public_modules_only() {
        assert_eq!(rules(&[(LIB, functions(ITEMS_MAX))]), 0);
        assert_eq!(rules(&[(LIB, functions(ITEMS_MAX + 1))]), 1);
        assert_eq!(rules(&[("crates/servo/src/lib.rs", functions(ITEMS_MAX + 1))]), 0);
        let module = |head: &str| [(LIB, head.to_owned()), ("crates/estimation/src/a.rs", functions(ITEMS_MAX))];
        assert_eq!(rules(&module("mod a;")), 0);
        assert_eq!(rules(&module("pub mod a;")), 1);
    }

    /// A type of another package counts with all its functions, whether it is re-exported or only in a signature.
    #[test]
    fn a_re_export_or_a_mention_counts_with_all_that_it_leads_to() {
        let core = format!(
            "pub struct A {{\n pub b: B,\n c: C,\n}}\npub struct B;\npub struct C;\nimpl B {{ {} }}",
            functions(50)
        );
        let with = |own: usize, last: &str| rules(&[(LIB, functions(own) + last), (CORE, core.clone())]);
        assert_eq!(with(ITEMS_MAX - 52, "pub use pb3dp_estimation_core::A;"), 0);
        assert_eq!(with(ITEMS_MAX - 51, "pub use pb3dp_estimation_core::A;"), 1);
        assert_eq!(with(ITEMS_MAX - 53, "use pb3dp_estimation_core::A;\npub fn g(a: &A) {}"), 0);
        assert_eq!(with(ITEMS_MAX - 52, "use pb3dp_estimation_core::A;\npub fn g(a: &A) {}"), 1);
        assert_eq!(with(ITEMS_MAX, "use pb3dp_estimation_core::A;\nfn g(a: &A) {}"), 0);
    }

    #[test]
    fn re_exports_that_hide_their_number_are_found() {
        assert_eq!(rules(&[(LIB, "pub use a::*;".to_owned())]), 1);
        assert_eq!(rules(&[(LIB, "pub use pb3dp_estimation_core::a;".to_owned()), (CORE, "pub mod a;".to_owned())]), 1);
        assert_eq!(rules(&[(LIB, "pub use {image, nalgebra};\npub(crate) use a::*;".to_owned())]), 0);
    }
}
