//! Tables of the fits: each group, fitted and left out side by side, and the best of the other tools.

use std::fmt::Write as _;
use std::rc::Rc;

use pb3dp_benchmarks::page::Part;
use pb3dp_benchmarks::table::{Column, cell, markdown};
use serde_json::{Value, json};

use super::constants::Constant;
use super::fit::Fitted;
use super::outcomes::Setting;
use crate::real::score::{CaseFacts, Entry, Maker};
use crate::real::table::{best_peer, groups};

const GROUPS: [Column<'_>; 10] = [
    ("group", "{group}"),
    ("values", "{method}"),
    ("n", "{cases}"),
    ("pass", "{passed}"),
    ("answered", "{answered}"),
    ("ok", "{ok}"),
    ("wrong ok", "{wrong_ok}"),
    ("in 2 sigmas %, depth / normal", "{in_2_sigmas_percent.0:0} / {in_2_sigmas_percent.1:0}"),
    ("within 1 px %", "{within_1px_percent:1}"),
    ("best other tool", "{best_other}"),
];
const CONSTANTS: [Column<'_>; 3] = [("constant", "`{name}`"), ("value", "{value}"), ("tried", "{tried.0}, {tried.1}")];

/// The name of the values fitted without the scene of a case.
pub const LEFT_OUT: &str = "left out";

/// The results with the present values, with those fitted on all cases, and with those fitted without the scene of each case.
pub fn entries(facts: &[Rc<CaseFacts>], fitted: &Fitted) -> Vec<Entry> {
    let values = [("present", &fitted.present), ("fitted", &fitted.fitted_on), (LEFT_OUT, &fitted.unseen)];
    let of_values = |(values, outcomes)| {
        let outcomes: &Vec<super::outcomes::Outcome> = outcomes;
        let entry = move |(facts, outcome): (&Rc<CaseFacts>, &super::outcomes::Outcome)| outcome.entry(facts, values);
        facts.iter().zip(outcomes).map(entry).collect::<Vec<_>>()
    };
    values.into_iter().flat_map(of_values).collect()
}

/// Rows of the groups, each with the other tool that passes most of its cases.
fn rows(entries: &[Entry]) -> Vec<Value> {
    let of_group = |(_, rows): (&str, Vec<Value>)| {
        let best = best_peer(&rows).map(|best| cell("{method} {passed}", best));
        let ours = rows.into_iter().filter(|row| row["ours"] == true).map(move |mut row| {
            row["best_other"] = best.clone().into();
            row
        });
        ours.collect::<Vec<_>>()
    };
    groups(entries).into_iter().flat_map(of_group).collect()
}

/// As saved: every case, the groups, and the constants. `entries`: ours and those of other tools.
pub fn kept(entries: &[Entry], constants: &[Constant], circumstances: Value) -> Value {
    let constants = constants.iter().map(|c| json!({"name": c.name, "value": c.value, "tried": c.tried}));
    json!({
        "bench": "left_out", "where": circumstances, "groups": rows(entries), "constants": constants.collect::<Vec<_>>(),
        "cases": entries.iter().filter(|entry| entry.maker == Maker::Ours).map(Entry::to_json).collect::<Vec<_>>(),
    })
}

/// The parts of the page, from what is saved; a fit made at most `changes` changes.
pub fn parts(
    kept: &Value,
    constants: &[Constant],
    fitted: &Fitted,
    (changes, origin): (usize, &str),
) -> [Part<'static>; 3] {
    let rows = |key: &str| kept[key].as_array().cloned().unwrap_or_default();
    let mut groups = markdown(&GROUPS, &rows("groups"));
    let _ = writeln!(groups, "\nThe fit on all cases changes: {}.", changes_of(constants, &fitted.setting));
    for fold in &fitted.folds {
        let _ = writeln!(groups, "* Without {}: {}.", fold.scene, changes_of(constants, &fold.setting));
    }
    let count = constants.len();
    [
        ("run", format!("{count} constants are fitted; a fit changes at most {changes} of them.\n\n{origin}")),
        ("groups", groups),
        ("constants", markdown(&CONSTANTS, &rows("constants"))),
    ]
}

fn changes_of(constants: &[Constant], setting: &Setting) -> String {
    let change = |&(index, value): &(usize, usize)| {
        let Constant { name, value: present, tried } = &constants[index];
        format!("`{name}` {present} to {}", tried[value])
    };
    let changes: Vec<String> = setting.iter().map(change).collect();
    if changes.is_empty() { "nothing".to_owned() } else { changes.join(", ") }
}

#[cfg(test)]
mod tests {
    use pb3dp_record::metrics::Group;

    use super::*;
    use crate::real::left_out::constants;
    use crate::real::score::tests::{answer, case, entry};

    #[test]
    fn groups_have_a_row_for_each_fit_and_the_best_other_tool() {
        let known = case("a", Group::Small, (1.0, 0.1));
        let ours = |values: &str, z_mm: f64| entry(&known, values, Some(answer(z_mm, 1.0)));
        let peer = Entry { maker: Maker::Peer, status: None, ..ours("bm", 0.0) };
        let entries = [ours("present", 0.0), ours("fitted", 0.0), ours(LEFT_OUT, 50.0), peer];
        let constants = constants::all();
        let kept = kept(&entries, &constants, Value::Null);
        let fitted =
            Fitted { present: vec![], fitted_on: vec![], unseen: vec![], setting: vec![(0, 1)], folds: Vec::new() };
        let parts = parts(&kept, &constants, &fitted, (1, "origin"));
        let expected =
            ["| small | fitted | 1 | 1 | 1 | 1 | 0 | bm 1 |", "| small | left out | 1 | 0 | 1 | 1 | 1 | bm 1 |"];
        expected.iter().for_each(|row| assert!(parts[1].1.contains(row), "{}", parts[1].1));
        assert!(parts[1].1.contains("changes: `search.noise_grey` 2 to 2.8.") && !parts[1].1.contains('?'));
        let folder = tempfile::tempdir().unwrap();
        pb3dp_benchmarks::page::update(&folder.path().join("left_out.md"), &parts).unwrap();
    }
}
