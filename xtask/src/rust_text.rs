//! Minimal analysis of Rust source text for the checks: code without comments and literals, paths.
//!
//! It is not a parser. The checks ignore code that it cannot see (code from macros).

/// The source with every comment, string and character literal replaced by spaces; line breaks remain.
pub fn code_only(source: &str) -> String {
    let chars: Vec<char> = source.chars().collect();
    let mut code = String::with_capacity(source.len());
    let mut at = 0;
    while at < chars.len() {
        let end = end_of_opaque(&chars, at);
        if end == at {
            code.push(chars[at]);
            at += 1;
        } else {
            code.extend(chars[at..end].iter().map(|&c| if c == '\n' { '\n' } else { ' ' }));
            at = end;
        }
    }
    code
}

/// End of the comment or literal that starts at `at`, or `at` if none starts there.
fn end_of_opaque(chars: &[char], at: usize) -> usize {
    let next = chars.get(at + 1).copied();
    let inside_word = at > 0 && is_word(chars[at - 1]);
    match chars[at] {
        '/' if next == Some('/') => find(chars, at, |c| c == '\n'),
        '/' if next == Some('*') => end_of_block_comment(chars, at),
        '"' => end_of_quoted(chars, at, '"'),
        'r' if !inside_word || chars[at - 1] == 'b' => end_of_raw_string(chars, at).unwrap_or(at),
        '\'' => end_of_char(chars, at),
        _ => at,
    }
}

fn find(chars: &[char], from: usize, wanted: impl Fn(char) -> bool) -> usize {
    (from..chars.len()).find(|&i| wanted(chars[i])).unwrap_or(chars.len())
}

fn end_of_block_comment(chars: &[char], at: usize) -> usize {
    let (mut depth, mut i) = (0_usize, at);
    while i + 1 < chars.len() {
        match (chars[i], chars[i + 1]) {
            ('/', '*') => depth += 1,
            ('*', '/') => depth -= 1,
            _ => {
                i += 1;
                continue;
            }
        }
        i += 2;
        if depth == 0 {
            return i;
        }
    }
    chars.len()
}

fn end_of_quoted(chars: &[char], at: usize, quote: char) -> usize {
    let mut i = at + 1;
    while i < chars.len() {
        match chars[i] {
            '\\' => i += 2,
            c if c == quote => return i + 1,
            _ => i += 1,
        }
    }
    chars.len()
}

fn end_of_raw_string(chars: &[char], at: usize) -> Option<usize> {
    let hashes = chars[at + 1..].iter().take_while(|&&c| c == '#').count();
    let open = at + 1 + hashes;
    if chars.get(open) != Some(&'"') {
        return None;
    }
    let closes =
        |i: &usize| chars[*i] == '"' && chars[i + 1..].iter().take(hashes).filter(|&&c| c == '#').count() == hashes;
    let close = (open + 1..chars.len()).find(closes);
    Some(close.map_or(chars.len(), |i| i + 1 + hashes))
}

/// A character literal; a lifetime (`'a`) is not one.
fn end_of_char(chars: &[char], at: usize) -> usize {
    match (chars.get(at + 1), chars.get(at + 2)) {
        (Some('\\'), _) => end_of_quoted(chars, at, '\''),
        (Some(_), Some('\'')) => at + 3,
        _ => at,
    }
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Byte positions of `word` as a whole word in `code`.
pub fn word_positions<'a>(code: &'a str, word: &'a str) -> impl Iterator<Item = usize> + 'a {
    code.match_indices(word).map(|(at, _)| at).filter(move |&at| {
        let before = code[..at].chars().next_back();
        let after = code[at + word.len()..].chars().next();
        !before.is_some_and(is_word) && !after.is_some_and(is_word)
    })
}

/// Line, from 1, of a byte position.
pub fn line_at(text: &str, position: usize) -> usize {
    text[..position].matches('\n').count() + 1
}

/// Offset of the `{` or the `;` at which the head of an item ends.
fn head_end(signature: &str) -> Option<usize> {
    let mut depth = 0_i32;
    for (i, c) in signature.char_indices() {
        match c {
            '(' | '[' => depth += 1,
            ')' | ']' => depth -= 1,
            '{' | ';' if depth == 0 => return Some(i),
            _ => {}
        }
    }
    None
}

fn matching_brace(code: &str, open: usize) -> Option<usize> {
    let mut depth = 0_i32;
    for (i, c) in code[open..].char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            return Some(open + i);
        }
    }
    None
}

/// The items of a file or a body in braces: what stands before the braces or the semicolon of each, without attributes, and what is between
/// the braces.
pub fn items(code: &str) -> Vec<(&str, &str)> {
    let (mut found, mut rest) = (Vec::new(), code);
    while let Some(end) = head_end(rest) {
        let close = if rest[end..].starts_with('{') { matching_brace(rest, end) } else { Some(end) };
        let Some(close) = close else { break };
        let mut head = rest[..end].trim();
        while let Some(attribute) = head.strip_prefix('#') {
            head = attribute.split_once(']').map_or("", |(_, head)| head.trim_start());
        }
        if !head.is_empty() {
            found.push((head, rest.get(end + 1..close).unwrap_or_default()));
        }
        rest = &rest[close + 1..];
    }
    found
}

/// Code in which every item with `#[cfg(test)]` and a body in braces is replaced by spaces.
pub fn without_test_items(code: &str) -> String {
    let mut kept = code.to_owned();
    for (at, mark) in code.match_indices("#[cfg(test)]") {
        let end = head_end(&code[at + mark.len()..])
            .map(|offset| at + mark.len() + offset)
            .filter(|&open| code[open..].starts_with('{'))
            .and_then(|open| matching_brace(code, open));
        if let Some(end) = end {
            let blank: String = code[at..=end].chars().map(|c| if c == '\n' { '\n' } else { ' ' }).collect();
            if blank.len() == end + 1 - at {
                kept.replace_range(at..=end, &blank);
            }
        }
    }
    kept
}

/// Every path in the code, with expanded `use` trees, and its line: `use std::{fs, time::Instant}` gives `std::fs` and
/// `std::time::Instant`.
pub fn paths(code: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for at in word_positions(code, "use") {
        let tree = code[at + 3..].split(';').next().unwrap_or_default();
        found.extend(used_paths(tree).into_iter().map(|path| (line_at(code, at), path)));
    }
    let mut at = 0;
    while let Some(offset) = code[at..].find(is_word) {
        let start = at + offset;
        let end = code[start..].find(|c: char| !is_word(c) && c != ':').map_or(code.len(), |n| start + n);
        if code[start..end].contains("::") {
            found.push((line_at(code, start), code[start..end].trim_end_matches(':').to_owned()));
        }
        at = end;
    }
    found
}

/// The paths of a `use` tree.
pub fn used_paths(tree: &str) -> Vec<String> {
    let mut found = Vec::new();
    expand_use_tree("", &tree.split_whitespace().collect::<Vec<_>>().join(" "), &mut |path| found.push(path));
    found
}

fn expand_use_tree(prefix: &str, tree: &str, emit: &mut impl FnMut(String)) {
    let tree = tree.trim();
    let Some(open) = tree.find('{') else {
        let path = tree.split(" as ").next().unwrap_or_default().trim();
        if !path.is_empty() {
            emit(if path == "self" { prefix.trim_end_matches(':').to_owned() } else { format!("{prefix}{path}") });
        }
        return;
    };
    let prefix = format!("{prefix}{}", tree[..open].trim());
    let inner = tree[open + 1..].trim_end().trim_end_matches('}');
    // `trim_end_matches` may have removed braces of inner trees; restore them.
    let missing = inner.matches('{').count().saturating_sub(inner.matches('}').count());
    let inner = format!("{inner}{}", "}".repeat(missing));
    let (mut depth, mut start) = (0_i32, 0);
    for (i, c) in inner.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                expand_use_tree(&prefix, &inner[start..i], emit);
                start = i + 1;
            }
            _ => {}
        }
    }
    expand_use_tree(&prefix, &inner[start..], emit);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comments_and_literals_become_spaces_and_lines_stay() {
        let source =
            "let a = \"dbg!(1) \\\" {\"; // todo!()\nlet b = '{'; let c: &'a str = r#\"}\"#; /* { /* } */ */ f()";
        let code = code_only(source);
        assert_eq!(code.len(), source.len());
        assert_eq!(code.matches('\n').count(), 1);
        for gone in ["dbg", "todo", "{", "}"] {
            assert!(!code.contains(gone), "{gone} in {code}");
        }
        assert!(code.contains("&'a str") && code.contains("f()"));
    }

    #[test]
    fn test_items_are_taken_out() {
        let code = without_test_items(
            "fn a() { x::y() }\n#[cfg(test)]\nmod tests { fn b() { std::fs::read() } }\nfn c() {}\n",
        );
        assert!(code.contains("fn a()") && code.contains("fn c()") && !code.contains("std::fs"));
        assert_eq!(line_at(&code, code.find("fn c").expect("kept")), 4);
    }

    #[test]
    fn items_are_separated() {
        let code = "#[derive(A)]\npub struct B { pub c: [u8; 2] }\npub use d::{E, F};\nconst G: [u8; 2] = [1, 2];\nimpl B { fn h() {} }";
        let heads: Vec<_> = items(code).into_iter().map(|(head, body)| format!("{head} | {}", body.trim())).collect();
        let wanted = [
            "pub struct B | pub c: [u8; 2]",
            "pub use d:: | E, F",
            "const G: [u8; 2] = [1, 2] |",
            "impl B | fn h() {}",
        ];
        assert_eq!(heads.iter().map(|head| head.trim_end()).collect::<Vec<_>>(), wanted);
    }

    #[test]
    fn use_trees_are_written_out() {
        let code = "use std::{fs, io::{self, Read as R}, time::{Duration}};\nfn f() { std::thread::spawn(g) }";
        let paths: Vec<_> = paths(code).into_iter().map(|(line, path)| format!("{line} {path}")).collect();
        for wanted in ["1 std::fs", "1 std::io", "1 std::io::Read", "1 std::time::Duration", "2 std::thread::spawn"] {
            assert!(paths.iter().any(|path| path == wanted), "{wanted} is missing from {paths:?}");
        }
    }
}
