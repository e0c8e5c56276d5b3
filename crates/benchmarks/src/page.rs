//! Pages of docs/benchmarks: their text is written by hand, and a benchmark fills in its figures between marks.
//!
//! ```text
//! <!-- figures: NAME -->
//! ...
//! <!-- end -->
//! ```

use std::path::Path;

use anyhow::Context;

/// A part of a page: the name of its mark, and what belongs below.
pub type Part<'a> = (&'a str, String);

const END: &str = "<!-- end -->";

/// Replaces these parts of a page; the others stay as they are. A page that does not exist yet begins as that of the repository.
///
/// # Errors
/// A page that cannot be read or written, or a mark that it lacks.
pub fn update(page: &Path, parts: &[Part<'_>]) -> anyhow::Result<()> {
    let committed = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/benchmarks");
    let from = if page.is_file() { page.to_owned() } else { committed.join(page.file_name().unwrap_or_default()) };
    let before = std::fs::read_to_string(&from).with_context(|| format!("cannot read {}", from.display()))?;
    let after = filled(&before, parts).with_context(|| from.display().to_string())?;
    save(page, &after)
}

/// Writes a file, and its folder if it does not exist, and names it on standard error.
///
/// # Errors
/// If that is not possible.
#[allow(clippy::print_stderr, reason = "the programs that use it report to their user")]
pub fn save(file: &Path, text: &str) -> anyhow::Result<()> {
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    std::fs::write(file, text).with_context(|| format!("cannot write {}", file.display()))?;
    eprintln!("written: {}", file.display());
    Ok(())
}

/// The parts for a terminal: cells of one column have the same width.
pub fn text(parts: &[Part<'_>]) -> String {
    let mut shown = String::new();
    for (name, text) in parts {
        shown.push_str(&format!("== {name}\n\n"));
        let lines: Vec<&str> = text.trim().lines().collect();
        for block in lines.chunk_by(|a, b| a.starts_with("| ") == b.starts_with("| ")) {
            shown.push_str(&aligned(block));
        }
        shown.push('\n');
    }
    shown
}

/// Lines of text as they are, lines of a table with padded cells.
fn aligned(lines: &[&str]) -> String {
    let mut rows: Vec<Vec<String>> = lines.iter().map(|line| line.split(" | ").map(str::to_owned).collect()).collect();
    for column in 0..rows.iter().map(Vec::len).min().unwrap_or(0) {
        let width = rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
        rows.iter_mut().for_each(|row| row[column] = format!("{:width$}", row[column]));
    }
    rows.iter().map(|row| row.join(" | ").trim_end().to_owned() + "\n").collect()
}

fn filled(page: &str, parts: &[Part<'_>]) -> anyhow::Result<String> {
    let mut page = page.to_owned();
    for (name, text) in parts {
        let mark = format!("<!-- figures: {name} -->\n");
        let begin = page.find(&mark).with_context(|| format!("the page has no `{}`", mark.trim_end()))? + mark.len();
        let end = page[begin..].find(END).with_context(|| format!("no `{END}` below `{}`", mark.trim_end()))?;
        page.replace_range(begin..begin + end, &format!("\n{}\n\n", text.trim()));
    }
    Ok(page)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cells_of_a_table_have_the_same_width_on_a_terminal() {
        let shown = text(&[("rows", "What it is.\n\n| a | b |\n| --- | ---: |\n| longer | 1 |\n".to_owned())]);
        assert_eq!(shown, "== rows\n\nWhat it is.\n\n| a      | b |\n| ---    | ---: |\n| longer | 1 |\n\n");
    }

    #[test]
    fn a_part_is_replaced_and_the_text_around_it_stays() {
        let page = "# A\n\nWhy.\n\n<!-- figures: run -->\n\nold\n\n<!-- end -->\n\n<!-- figures: rows -->\n<!-- end -->\nEnd.\n";
        let new = filled(page, &[("rows", "| a |\n".to_owned()), ("run", "new".to_owned())]).unwrap();
        assert_eq!(
            new,
            "# A\n\nWhy.\n\n<!-- figures: run -->\n\nnew\n\n<!-- end -->\n\n<!-- figures: rows -->\n\n| a |\n\n<!-- end -->\nEnd.\n"
        );
        assert_eq!(filled(&new, &[("run", "new".to_owned())]).unwrap(), new);
        let missing = filled(page, &[("runs", String::new())]).unwrap_err().to_string();
        assert!(missing.contains("<!-- figures: runs -->"), "{missing}");
    }
}
