//! Tables of approaches, singular poses and other laws.

use std::fmt::Write as _;

use crate::Findings;
use crate::cases::{Approached, LawFindings};
use crate::page::number;
use crate::ways::{SEEN_UP_TO_M, THERE_WITHIN, Way};

/// The section of the page.
pub fn sections(findings: &Findings) -> String {
    let (approaches, singular) = (approach_table(&findings.approaches), singular_table(&findings.singular));
    let (laws, far) = (law_table(&findings.laws), far_table(&findings.laws));
    let (mm, deg) = THERE_WITHIN;
    format!(
        "## Approach\n\n\
         The target is stationary, and the hand starts far away, or with joints near a singular pose or an end of a range; without images, with a tracker that sees up to {SEEN_UP_TO_M} m.\n\
         The hand has settled when it stays within {mm} mm and {deg} degrees of its desired pose.\n\
         Speeds, accelerations and angles are those of the simulated arm, relative to the limits of `configs/sim.toml` (60 % of the joints' speeds, the operating range).\n\
         A rotation of the target about its normal is commanded, because a tracker takes the axes of its model from its first image.\n\n\
         {approaches}\n\
         ## Through singular poses\n\n\
         The target moves along x of the world and returns; without images.\n\
         With shoulder and wrist straight (q2 = q6 = 0) the arm cannot move the hand sideways, and a path near that pose turns the first joint by up to half a turn at its largest speed: the hand lags meanwhile, and neither halts nor oscillates.\n\
         With the elbow stretched (q4 = 0) the arm is at the end of its reach: the elbow stops at `servo.damping.elbow_min_deg`, the arm holds and reports the reason, and it returns with the target.\n\n\
         {singular}\n\
         ## Other laws\n\n\
         The same workcell with the law of the paper's group, with classical image-based servoing (corners of a square of the model) and with 2 1/2-D servoing; these three have one gain and one smoothing of the target, and no feed-forward.\n\
         The experiment of Fig. 7, without images, rms:\n\n\
         {laws}\n\
         From far away, with a stationary target.\n\
         Aside is the largest distance of the path from the straight line between its ends; to border is the smallest distance between the target's outline and the border of either image.\n\
         For large rotations about the optical axis the image-based law retreats from the target.\n\n\
         {far}"
    )
}

fn used(way: &Way) -> String {
    let used = &way.used;
    format!(
        "{:.0} %: axis {} | {:.0} %: axis {} | {:.1}: axis {}",
        100.0 * used.speed.0,
        used.speed.1,
        100.0 * used.acceleration.0,
        used.acceleration.1,
        used.room_deg.0,
        used.room_deg.1
    )
}

/// Approaches, one row each.
pub fn approach_table(approaches: &[Approached]) -> String {
    let mut text = String::from(
        "| start | initial error, mm | deg | settling time, s | end state | final error, mm | deg | joint speed, of the limit | acceleration, of the limit | \
         smallest margin to an end of a range, deg | smallest singular value |\n|---|---:|---:|---:|---|---:|---:|---|---|---|---:|\n",
    );
    for Approached { way, .. } in approaches {
        let _ = writeln!(
            text,
            "| {} | {:.0} | {:.0} | {} | {} | {:.2} | {:.2} | {} | {:.3} |",
            way.name,
            way.off.0,
            way.off.1,
            number(way.there_after_s, 1),
            way.mode,
            way.left.0,
            way.left.1,
            used(way),
            way.singular_value_min,
        );
    }
    text
}

/// Paths through and to singular poses, one row each.
pub fn singular_table(ways: &[Way]) -> String {
    let mut text = String::from(
        "| path | smallest singular value | largest error, mm | deg | final error, mm | deg | on hold, % of the time | reason | joint reversals | \
         joint speed, of the limit | acceleration, of the limit | smallest margin to an end of a range, deg |\n\
         |---|---:|---:|---:|---:|---:|---:|---|---:|---|---|---|\n",
    );
    for way in ways {
        let (halts, why) = &way.held;
        let _ = writeln!(
            text,
            "| {} | {:.4} | {:.1} | {:.2} | {:.2} | {:.2} | {:.0} | {} | {} | {} |",
            way.name,
            way.singular_value_min,
            way.most.0,
            way.most.1,
            way.left.0,
            way.left.1,
            100.0 * halts,
            why.as_deref().unwrap_or("-"),
            way.used.turns,
            used(way),
        );
    }
    text
}

/// The experiment of Fig. 7 with each law.
pub fn law_table(laws: &[LawFindings]) -> String {
    let mut text = String::from(
        "| law | moving, mm | moving, deg | hold, mm | hold, deg | largest lag, ms |\n|---|---:|---:|---:|---:|---:|\n",
    );
    for LawFindings { law, fig7, .. } in laws {
        let locked = &fig7.summary.locked;
        let rms = |error: Option<pb3dp_cell::figures::RmsMax>, digits| number(error.map(|error| error.rms), digits);
        let lags = fig7.summary.channels.iter().filter_map(|channel| channel.lag_s);
        let lag_s = lags.max_by(|a, b| a.abs().total_cmp(&b.abs()));
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} |",
            law.name(),
            rms(locked.moving_mm, 2),
            rms(locked.moving_deg, 3),
            rms(locked.hold_mm, 2),
            rms(locked.hold_deg, 3),
            number(lag_s.map(|lag_s| lag_s * 1e3), 0),
        );
    }
    text
}

/// Approaches from far away with each law.
pub fn far_table(laws: &[LawFindings]) -> String {
    let mut text = String::from(
        "| start | law | settling time, s | end state | final error, mm | deg | path, mm | straight, mm | aside, mm | largest distance to the target, mm | \
         to border, px |\n|---|---|---:|---|---:|---:|---:|---:|---:|---:|---:|\n",
    );
    let count = laws.iter().map(|findings| findings.ways.len()).max().unwrap_or(0);
    for index in 0..count {
        for LawFindings { law, ways, .. } in laws {
            let Some(way) = ways.get(index) else { continue };
            let path = &way.path;
            let _ = writeln!(
                text,
                "| {} | {} | {} | {} | {:.2} | {:.2} | {:.0} | {:.0} | {:.0} | {:.0} | {:.0} |",
                way.name,
                law.name(),
                number(way.there_after_s, 1),
                way.mode,
                way.left.0,
                way.left.1,
                path.length_mm,
                path.straight_mm,
                path.aside_mm,
                path.farthest_mm,
                path.border_px,
            );
        }
    }
    text
}
