//! Rules for Rust files: size, and forbidden items.

use crate::rust_text::{code_only, functions, line_at, word_positions};
use crate::tidy::exceptions::{Exceptions, LIST};
use crate::violation::Violation;

const FILE_LINES_MAX: usize = 600;
const FUNCTION_LINES_MAX: usize = 70;
const UNFINISHED: [&str; 3] = ["todo", "unimplemented", "dbg"];

/// All rules for one file.
pub fn check(path: &str, text: &str, exceptions: &mut Exceptions) -> Vec<Violation> {
    let code = code_only(text);
    let mut violations = sizes(path, &code, exceptions);
    violations.extend(unfinished(path, &code));
    violations.extend(test_attributes(path, &code));
    violations
}

fn sizes(path: &str, code: &str, exceptions: &mut Exceptions) -> Vec<Violation> {
    let mut violations = Vec::new();
    let lines = code.lines().count();
    let max = exceptions.lines_max(path, None, lines, FILE_LINES_MAX);
    if lines > max {
        let message = format!("{lines} lines, at most {max}: split it by topic (or give a reason in {LIST})");
        violations.push(Violation::of(path, "file-length", message));
    }
    for function in functions(code) {
        let max = exceptions.lines_max(path, Some(&function.name), function.lines, FUNCTION_LINES_MAX);
        if function.lines > max {
            let message =
                format!("`{}` has {} lines, at most {max}: move parts into functions", function.name, function.lines);
            violations.push(Violation::at(path, function.line, "function-length", message));
        }
    }
    violations
}

fn unfinished(path: &str, code: &str) -> Vec<Violation> {
    let mut violations = Vec::new();
    for name in UNFINISHED {
        for at in word_positions(code, name).filter(|at| code[at + name.len()..].starts_with('!')) {
            violations.push(Violation::at(path, line_at(code, at), "unfinished", format!("`{name}!`: finish it")));
        }
    }
    violations
}

fn test_attributes(path: &str, code: &str) -> Vec<Violation> {
    let mut violations = Vec::new();
    for (at, _) in code.match_indices("#[") {
        let attribute = code[at + 2..].split(']').next().unwrap_or_default();
        let names = |word: &str| word_positions(attribute, word).next().is_some();
        let is_test_switch = attribute.starts_with("ignore") || attribute.starts_with("cfg_attr");
        if is_test_switch && names("ignore") {
            let message = "an ignored test proves nothing: make it run, or remove it";
            violations.push(Violation::at(path, line_at(code, at), "ignored-test", message));
        }
        if names("should_panic") {
            let message = "check the returned error, or catch the panic around the one call that must panic";
            violations.push(Violation::at(path, line_at(code, at), "should-panic", message));
        }
    }
    violations
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(text: &str) -> Vec<&'static str> {
        check("a.rs", text, &mut Exceptions::default()).into_iter().map(|v| v.rule).collect()
    }

    #[test]
    fn a_long_file_is_caught() {
        assert!(rules(&"// x\n".repeat(600)).is_empty());
        assert_eq!(rules(&"// x\n".repeat(601)), ["file-length"]);
    }

    #[test]
    fn a_long_function_is_caught() {
        assert!(rules(&format!("fn f() {{\n{}}}\n", "g();\n".repeat(68))).is_empty());
        assert_eq!(rules(&format!("fn f() {{\n{}}}\n", "g();\n".repeat(69))), ["function-length"]);
    }

    #[test]
    fn unfinished_code_is_caught_in_code_alone() {
        assert_eq!(rules("fn f() { todo!() }"), ["unfinished"]);
        assert_eq!(rules("fn f() { std::unimplemented!(\"x\") }"), ["unfinished"]);
        assert_eq!(rules("fn f() { dbg!(1); }"), ["unfinished"]);
        assert!(rules("// todo!() \nfn f() { g(\"dbg!(1)\"); not_todo!(); }").is_empty());
    }

    #[test]
    fn tests_that_do_not_test_are_caught() {
        assert_eq!(rules("#[test]\n#[ignore = \"slow\"]\nfn f() {}"), ["ignored-test"]);
        assert_eq!(rules("#[cfg_attr(miri, ignore)]\nfn f() {}"), ["ignored-test"]);
        assert_eq!(rules("#[test]\n#[should_panic(expected = \"x\")]\nfn f() {}"), ["should-panic"]);
        assert!(rules("#[must_use]\n#[serde(ignore_unknown)]\nfn ignore() {}").is_empty());
    }
}
