//! Tables of the fits: each group, fitted and left out side by side, and the other tools.

use std::fmt::Write as _;
use std::rc::Rc;

use pb3dp_record::metrics::Group;
use serde_json::{Value, json};

use super::constants::Listed;
use super::fit::Fitted;
use super::outcomes::{Outcome, Setting};
use crate::common::circumstances::Circumstances;
use crate::real::score::{CaseFacts, Entry, Grade};

/// What the tables are made of.
pub struct Report<'a> {
    /// The constants.
    pub listed: &'a [Listed],
    /// The cases.
    pub facts: &'a [Rc<CaseFacts>],
    /// The fits.
    pub fitted: &'a Fitted,
    /// The other tools.
    pub peers: &'a [Entry],
    /// Largest number of changes of a fit.
    pub changes: usize,
}

/// Sums over the cases of a group.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sums {
    cases: usize,
    passed: usize,
    answered: usize,
    answered_passed: usize,
    ok: usize,
    wrong_ok: usize,
    depth: [usize; 2],
    normal: [usize; 2],
    within: f64,
}

impl Sums {
    fn of<'a>(outcomes: impl Iterator<Item = &'a Outcome>) -> Self {
        let mut sums = Self::default();
        for outcome in outcomes {
            sums.cases += 1;
            sums.passed += usize::from(outcome.passed);
            sums.answered += usize::from(outcome.answered);
            sums.ok += usize::from(outcome.ok);
            sums.wrong_ok += usize::from(outcome.wrong_ok);
            for (sum, covered) in [(&mut sums.depth, outcome.depth_covered), (&mut sums.normal, outcome.normal_covered)]
            {
                if let Some(covered) = covered {
                    sum[0] += usize::from(covered);
                    sum[1] += 1;
                }
            }
            sums.within += outcome.within_1px.unwrap_or(0.0);
        }
        sums
    }

    fn cells(&self) -> Vec<String> {
        let covered = |[within, of]: [usize; 2]| match of {
            0 => "-".to_owned(),
            of => format!("{:.0}", 100.0 * within as f64 / of as f64),
        };
        vec![
            self.passed.to_string(),
            self.answered.to_string(),
            self.ok.to_string(),
            self.wrong_ok.to_string(),
            format!("{} / {}", covered(self.depth), covered(self.normal)),
        ]
    }
}

/// Name of a group of the tables, and its members.
type Members = (&'static str, fn(Group) -> bool);

/// The groups of the tables.
fn groups() -> [Members; 7] {
    [
        ("textured", |group| group == Group::Textured),
        ("boards", |group| group == Group::Boards),
        ("small", |group| group == Group::Small),
        ("straddling", |group| group == Group::Occluded),
        ("low texture", |group| group == Group::LowTexture),
        ("non-planar", |group| group == Group::NonPlanar),
        ("all planar", |group| group != Group::NonPlanar),
    ]
}

const HEAD: &str = "| group | values | n | pass | answered | ok | wrong ok | in 2 sigmas %, depth / normal | best other tool |\n|---|---|---:|---:|---:|---:|---:|---:|---|\n";

impl Report<'_> {
    /// The tables.
    pub fn text(&self) -> String {
        let mut text = String::from(HEAD);
        for (name, is_member) in groups() {
            let members: Vec<usize> = (0..self.facts.len()).filter(|&i| is_member(self.facts[i].group)).collect();
            if members.is_empty() {
                continue;
            }
            let others = self.best_other(&members);
            for (values, outcomes) in self.columns() {
                let sums = Sums::of(members.iter().map(|&i| &outcomes[i]));
                let _ =
                    writeln!(text, "| {name} | {values} | {} | {} | {others} |", sums.cases, sums.cells().join(" | "));
            }
            if name == "non-planar" {
                let shares = self.columns().map(|(values, outcomes)| {
                    let sums = Sums::of(members.iter().map(|&i| &outcomes[i]));
                    format!("{values} {:.1} %", 100.0 * sums.within / sums.cases as f64)
                });
                let _ = writeln!(
                    text,
                    "| non-planar, disparities within 1 px | {} | {} | | | | | | |",
                    shares.join(", "),
                    members.len()
                );
            }
        }
        let _ = writeln!(text, "\nThe fit on all cases changes: {}.", self.words(&self.fitted.setting));
        for fold in &self.fitted.folds {
            let _ = writeln!(text, "* Without {}: {}.", fold.scene, self.words(&fold.setting));
        }
        text
    }

    fn columns(&self) -> [(&'static str, &[Outcome]); 3] {
        [("present", &self.fitted.present), ("fitted", &self.fitted.seen), ("left out", &self.fitted.unseen)]
    }

    /// The other tool that passes most of these cases.
    fn best_other(&self, members: &[usize]) -> String {
        let mut counts: Vec<(&str, usize)> = Vec::new();
        for entry in self.peers {
            if !members.iter().any(|&i| self.facts[i].name == entry.case.name) {
                continue;
            }
            let passed = usize::from(entry.grade() == Some(Grade::Pass));
            match counts.iter_mut().find(|(name, _)| *name == entry.method) {
                Some((_, count)) => *count += passed,
                None => counts.push((&entry.method, passed)),
            }
        }
        let best = counts.iter().rev().max_by_key(|(_, count)| *count);
        best.map_or("-".to_owned(), |(name, count)| format!("{name} {count}"))
    }

    fn words(&self, setting: &Setting) -> String {
        if setting.is_empty() {
            return "nothing".to_owned();
        }
        let change = |&(index, value): &(usize, usize)| {
            let Listed { constant, value: present, .. } = &self.listed[index];
            format!("`{}` {present} to {}", constant.name, constant.tried[value])
        };
        setting.iter().map(change).collect::<Vec<_>>().join(", ")
    }

    /// The cases that do not pass or are wrong and `ok` when left out.
    pub fn failures(&self) -> String {
        let mut text = String::new();
        for (facts, (unseen, present)) in self.facts.iter().zip(self.fitted.unseen.iter().zip(&self.fitted.present)) {
            if unseen.passed && !unseen.wrong_ok {
                continue;
            }
            let errors = unseen.answer.map_or("no answer".to_owned(), |answer| {
                format!(
                    "z {:+.2} % (sigma {:.2}), normal {:.1} deg (sigma {:.1})",
                    100.0 * answer.z_m / facts.z_m,
                    100.0 * answer.z_sigma_m.unwrap_or(f64::NAN) / facts.z_m,
                    answer.normal_rad.to_degrees(),
                    answer.normal_sigma_rad.unwrap_or(f64::NAN).to_degrees()
                )
            });
            let status = match (unseen.ok, unseen.wrong_ok) {
                (true, true) => "WRONG OK",
                (true, false) => "ok",
                _ => "unsure",
            };
            let before = if present.passed { "" } else { ", also with the present values" };
            let _ = writeln!(text, "{}: {status}: {errors}{before}", facts.name);
        }
        text
    }

    /// As saved.
    pub fn to_json(&self, circumstances: &Circumstances) -> Value {
        let cases = self.facts.iter().enumerate().map(|(i, facts)| {
            let kept = |outcome: &Outcome| {
                json!({"pass": outcome.passed, "answered": outcome.answered, "ok": outcome.ok, "wrong_ok": outcome.wrong_ok})
            };
            json!({
                "case": facts.name,
                "present": kept(&self.fitted.present[i]),
                "fitted": kept(&self.fitted.seen[i]),
                "left_out": kept(&self.fitted.unseen[i]),
            })
        });
        json!({"bench": "left_out", "where": circumstances.to_json(), "cases": cases.collect::<Vec<_>>()})
    }

    /// The page.
    pub fn page(&self, circumstances: &Circumstances) -> String {
        let mut text = String::from(PAGE_TOP);
        let _ = writeln!(
            text,
            "{} constants are fitted; a fit changes at most {} of them.\n",
            self.listed.len(),
            self.changes
        );
        let changed = if circumstances.changed { ", with uncommitted changes" } else { "" };
        let Circumstances { commit, compiler, .. } = circumstances;
        let _ = writeln!(text, "Commit {commit}{changed}; {compiler}.\n");
        text.push_str(&self.text());
        text.push_str("\n## The constants\n\n| constant | value | tried | place |\n|---|---:|---|---|\n");
        for Listed { constant, place, value } in self.listed {
            let tried = constant.tried.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
            let _ = writeln!(text, "| `{}` | {value} | {tried} | {place} |", constant.name);
        }
        text.push_str(PAGE_END);
        text
    }
}

const PAGE_TOP: &str = "# Scenes left out

This page is written by the command below; change the program, not the page.

The constants of the method `direct` were set on public scenes, so its figures there say little about other scenes.
For this page each scene is left out once.
A program fits all constants that choose the surface on the other scenes, and the result is judged on the scene that was left out.
Scenes of one place, board or rig are left out together.

* **present**: the values in the program.
* **fitted**: the values fitted on all scenes, these included.
* **left out**: for each case, the values fitted without its scene; only this row says what to expect of an unseen scene.
* **pass**: as on the page of the [real stereo cases](real.md).
* **wrong ok**: status `ok`, but off by more than 3 standard deviations (the truth's included) and by more than 1 % of the depth or 5 degrees.
* **in 2 sigmas**: share of the answers that are off by at most two standard deviations, the truth's included.

A fit starts from the present values and makes the one change that lowers the loss most, several times.
The loss counts 1 for a case that does not pass, 5 for a wrong `ok`, 0.2 for a correct plane without `ok`, and 1 for each change.
Cases with a doubtful truth and the scenes of `crates/benchmarks/held_back.txt` take no part.

```text
cargo xtask bench real -- --leave-one-scene-out --cases DIR --more-cases DIR --peer-results FILE
```

";

const PAGE_END: &str = "
Numbers of points, draws and steps (`SAMPLE_MAX`, `FEW_MAX`, `DRAWS`, `STEPS` and the like) are not fitted: they bound the work, and more is never worse.

## What was tried in the structure of the choice

Measured in November 2026 on 368 random windows of 17 of these scenes (64 textured, 85 small, 170 straddling a depth edge, 49 of low texture), their truth fitted to the measured disparities, and on the cases of this page.
Before, 136 of the 170 straddling windows passed and 7 were wrong and `ok`; of all windows 315 passed and 302 were `ok`.
Of the straddling cases 19 of 29 passed.
Every change was made alone, and the one that is kept was chosen on these windows and cases.

| change | straddling windows, pass | wrong ok | all windows, pass | ok | straddling cases, pass |
|---|---:|---:|---:|---:|---:|
| none | 136 | 7 | 315 | 302 | 19 |
| the refinement stays 3 px away from pixels that contradict the plane | 131 | 6 | 308 | 299 | 18 |
| the same, 5 px | 133 | 6 | 311 | 296 | 19 |
| the same, 7 px (radius of a patch) | 128 | 6 | 305 | 293 | 19 |
| single pixels count 2.5 times in the score | 136 | 6 | 315 | 302 | 20 |
| choice by the likelihood of all clear disparities: one to four planes and clutter, by Schwarz's criterion | 138 | 6 | 317 | 299 | 20 |
| the same with half of the points, more dependence between them, and only where no plane has half of the points | 135 | 7 | 314 | 301 | 20 |
| distance from the plane through the clear disparities counts as error, always | 136 | 3 | 315 | 247 | 19 |
| the same, if less than 70 % of the region supports the plane: kept | 136 | 4 | 315 | 284 | 19 |

Fits on windows and cases together (544, at most one change) agree: each of the 22 without one place sets `search.tolerance_px` from 0.5 to 0.35.
On the places left out, with the last row of the table in place or not:

| planar windows and cases, 537 | pass | ok | wrong ok | in 2 sigmas %, depth / normal |
|---|---:|---:|---:|---:|
| before | 463 | 450 | 11 | 85 / 90 |
| tolerance fitted without the place | 465 | 448 | 8 | 85 / 90 |
| the last row of the table, nothing fitted: kept | 463 | 429 | 8 | 87 / 92 |
| both | 465 | 427 | 5 | 87 / 92 |
| block matching with a plane | 440 | - | - | - |

The tolerance of 0.35 px is not taken over yet: on rendered pairs, an answer in the right range becomes `ambiguous` because of a plane beyond it, and a tilt limit that is too small is no longer named as the reason.
It costs 0.2 ms (median 2.1 ms, 90th percentile 4.3).

On the cases alone, three changes are more than 169 planar cases can bear: fitted no wrong `ok` is left, left out five.

The choice between the candidates that the search finds is not what is missing: a right candidate was not the first one in 9 of 44 straddling windows and cases that did not pass.
In 16 of them no candidate was right, and in 19 the first one was right within a pixel, and mostly the tilt was off by 5 to 15 degrees.
The likelihood of all pixels repairs 5 cases and loses 2 of 537, and a change of its details moves as many; so it was left out.

### Later: three constants and two rules

Measured in November 2026 on 674 new random windows of the same 17 scenes (340 across a depth edge, 169 small, 57 of low texture, 108 textured) and on 175 cases of both folders.
Each row adds its change to the rows above.

| change | all 849, pass | ok | wrong ok |
|---|---:|---:|---:|
| none | 720 | 674 | 18 |
| `refine.place_sigma_px` 0.05 to 0.1: steep gradients count less | 731 | 675 | 16 |
| the refinement leaves out 1 px at the outline, not 2 | 734 | 683 | 16 |
| `patches.support_px` 0.5 to 0.35, as in the fits above | 734 | 676 | 11 |
| `refine.place_sigma_px` 0.13, and a region that mostly supports its plane is not a curved surface | 746 | 679 | 5 |
| a plane on which single disparities lie is given, `ambiguous`, even where patches mix surfaces | 749 | 679 | 5 |

Of the 43 scenes 14 gain cases and 1 loses 2, so a choice without any one scene is the same.
Straddling windows: 288 of 340 pass, before 273; small ones 152 of 169, before 143.
With `search.quick_share_min` at 0.75 (more regions get the finer search) 751 pass and 4 are wrong and `ok`, but the NEES of rendered shells of 10 mm grows from 1.2 to 7.7: their surface is not recognised as one there.
Without a gain: penalties of the aggregation, uniqueness, the left-right check, more draws or candidates, a tolerance of 0.35 or 0.7 px, weights of patches, a second level of refinement, only the finest search.

### The scenes that were held back

12 scenes were chosen before anybody looked at them (`crates/benchmarks/held_back.txt`) and were opened once, on 27 November 2026, with the values of commit 5836fac6.
`cargo xtask bench real -- --leave-one-scene-out --open-held-back ...` repeats it.

| group | n | pass | left out above | answered | ok | wrong ok | in 2 sigmas %, depth / normal | best other tool |
|---|---:|---:|---:|---:|---:|---:|---:|---|
| textured | 14 | 14 | 98 % | 14 | 14 | 0 | 100 / 86 | sgbm 14 |
| boards | 3 | 3 | 100 % | 3 | 3 | 0 | 100 / 100 | sgbm 3 |
| small | 10 | 8 | 81 % | 10 | 7 | 0 | 100 / 100 | bm 10 |
| straddling | 8 | 6 | 76 % | 8 | 5 | 1 | 88 / 75 | sgbm3way 8 |
| low texture | 7 | 5 | 75 % | 6 | 3 | 0 | 100 / 100 | sgbm 5 |
| all planar | 42 | 36 | 89 % | 41 | 32 | 1 | 98 / 90 | bm 36 |

No group is more than 4 points below the scenes left out, so the constants do not follow single scenes.
What remains is the method's own: the wrong `ok` is a folded cloth (`Cloth1_occl`): a plane through the fold is within 1.5 px of 84 % of the region, the plane of its larger side within 0.35 px of 55 %.
Two small regions of `terrains_2s` have disparities of 10 px, and the normal is off by 7 and 10 degrees; both are `weak-tilt`.
In a group of 8 to 10 cases one case is 10 to 13 points, so windows were drawn in the eight scenes of images as well, after they were opened:

| 160 random windows of these scenes | n | pass | ok | wrong ok | in 2 sigmas %, depth / normal | bm | sgbm3way |
|---|---:|---:|---:|---:|---:|---:|---:|
| textured | 22 | 22 | 22 | 0 | 95 / 100 | 22 | 22 |
| small | 48 | 46 | 47 | 0 | 81 / 96 | 46 | 37 |
| straddling | 77 | 63 | 56 | 0 | 86 / 91 | 60 | 50 |
| low texture | 13 | 8 | 6 | 1 | 90 / 100 | 9 | 6 |
";
