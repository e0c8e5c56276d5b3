//! docs/start-and-resume.md lists ways to start or resume wrongly, each with its test.

use system_tests::repository;

/// The page lists at least 50 ways, each with an existing test.
#[test]
fn each_way_of_the_page_has_its_test() {
    let page = std::fs::read_to_string(repository().join("docs/start-and-resume.md")).unwrap();
    let rows = page.lines().filter_map(|line| {
        let cells: Vec<&str> = line.strip_prefix("| ")?.split(" | ").collect();
        let number: usize = cells.first()?.trim().parse().ok()?;
        let [file, name] = cells.last()?.trim_end_matches(" |").trim_matches('`').split("::").collect::<Vec<_>>()[..]
        else {
            panic!("row {number} names no test: {line}")
        };
        Some((number, file.to_owned(), name.to_owned()))
    });
    let mut count = 0;
    for (number, file, name) in rows {
        count += 1;
        assert_eq!(number, count, "the rows are numbered in order");
        let source =
            std::fs::read_to_string(repository().join(&file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        assert!(
            source.contains(&format!("#[test]\nfn {name}()"))
                || source.contains(&format!("    #[test]\n    fn {name}()")),
            "{file} has no test {name}"
        );
    }
    assert!(count >= 50, "{count} ways");
}
