//! Times of the pairs: rate, jitter, skew, gaps.

use std::time::Duration;

use pb3dp_camera_settings::SkewCost;
use pb3dp_camera_v4l2::{StereoCounters, StreamCounters};
use pb3dp_cell::finding::{Finding, Limits};

/// Tolerance of the rate, as a share.
const RATE_SHARE_MAX: f64 = 0.02;

/// 0.2 mm at 100 mm/s.
const JITTER_MAX_MS: f64 = 2.0;

/// Missing pairs, percent.
const MISSING_MAX_PERCENT: f64 = 1.0;

/// Times of a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moment {
    pub(super) sequence: u64,
    pub(super) exposed_at_s: f64,
    pub(super) skew_s: f64,
}

/// All measurements of the times.
pub(super) fn findings(
    moments: &[Moment],
    period: Duration,
    skew_limit: (Duration, &SkewCost),
    counters: &StereoCounters,
) -> Vec<Finding> {
    vec![rate(moments, period), jitter(moments), skew(moments, skew_limit, counters), missing(moments, counters)]
}

fn span(moments: &[Moment]) -> (f64, u64) {
    match (moments.first(), moments.last()) {
        (Some(first), Some(last)) => (last.exposed_at_s - first.exposed_at_s, last.sequence - first.sequence),
        _ => (0.0, 0),
    }
}

fn rate(moments: &[Moment], period: Duration) -> Finding {
    let asked_hz = 1.0 / period.as_secs_f64();
    let (seconds, _) = span(moments);
    let hz = moments.len().saturating_sub(1) as f64 / seconds;
    let limits = Limits::between(asked_hz * (1.0 - RATE_SHARE_MAX), asked_hz * (1.0 + RATE_SHARE_MAX));
    let advice = "a shorter exposure than the period, no automatic exposure that lowers the rate (its `dynamic framerate`), less load on USB and \
                  processor; if the camera cannot do better, ask for a rate that it keeps";
    Finding::judged("rate", (hz, "pairs per second"), limits, format!("asked for {asked_hz:.2}"), advice)
}

/// Deviation of the times from a uniform period, estimated from the pairs.
fn jitter(moments: &[Moment]) -> Finding {
    let (seconds, periods) = span(moments);
    let beat_s = seconds / periods as f64;
    let off: Vec<f64> = moments
        .windows(2)
        .map(|two| two[1].exposed_at_s - two[0].exposed_at_s - (two[1].sequence - two[0].sequence) as f64 * beat_s)
        .collect();
    let rms_ms = (off.iter().map(|s| s * s).sum::<f64>() / off.len() as f64).sqrt() * 1e3;
    let worst_ms = off.iter().fold(0.0_f64, |worst, s| worst.max(s.abs())) * 1e3;
    let advice = "the stamps are not even, so it is not known well when images were taken: less load on USB and computer, each camera at a \
                  controller of its own, or a hardware trigger";
    Finding::judged(
        "jitter",
        (rms_ms, "ms rms"),
        Limits::at_most(JITTER_MAX_MS),
        format!("at worst {worst_ms:.2} ms"),
        advice,
    )
}

fn skew(moments: &[Moment], (skew_max, cost): (Duration, &SkewCost), counters: &StereoCounters) -> Finding {
    let worst_ms = moments.iter().fold(0.0_f64, |worst, moment| worst.max(moment.skew_s.abs())) * 1e3;
    let mean_ms = moments.iter().map(|moment| moment.skew_s).sum::<f64>() / moments.len() as f64 * 1e3;
    let worst = Duration::try_from_secs_f64(worst_ms * 1e-3).unwrap_or_default();
    let mut found = format!("{}; right less left, in the mean {mean_ms:+.2} ms", cost.text(worst));
    if let Some(drift) = counters.drift {
        found += &format!(", drifting by {:+.1} ppm", drift.rate * 1e6);
        if let Some(seconds) = drift.seconds_until(skew_max).filter(|seconds| *seconds > 0.0 && *seconds < 3600.0) {
            found += &format!(", beyond the limit in {seconds:.0} s");
        }
    }
    let advice = "trigger both cameras by hardware; free-running ones drift through the whole period: start them again until they fit, or accept \
                  a larger limit (camera.skew_max_millis, --skew-max) and move slowly (docs/rig.md, Triggering)";
    Finding::judged("skew", (worst_ms, "ms at worst"), Limits::at_most(skew_max.as_secs_f64() * 1e3), found, advice)
}

fn missing(moments: &[Moment], counters: &StereoCounters) -> Finding {
    let (_, periods) = span(moments);
    let missing = (periods + 1).saturating_sub(moments.len() as u64);
    let percent = missing as f64 / (periods + 1) as f64 * 100.0;
    let side = |name: &str, counters: &StreamCounters| {
        let StreamCounters { lost, damaged, short, stale, superseded, unpaired, not_newer, future, unstamped, .. } =
            *counters;
        let parts = [
            (lost, "lost by the driver"),
            (damaged, "damaged"),
            (short, "short"),
            (stale, "too old"),
            (superseded, "taken too late"),
            (unpaired, "without a partner"),
            (not_newer + future + unstamped, "wrongly stamped"),
        ];
        let parts: Vec<String> =
            parts.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
        if parts.is_empty() { String::new() } else { format!("; {name}: {}", parts.join(", ")) }
    };
    let found =
        format!("{missing} of {} pairs{}{}", periods + 1, side("left", &counters.left), side("right", &counters.right));
    let advice = "damaged and lost images: cable, hub, another USB controller, or MJPG; images taken too late: less load on the processor";
    Finding::judged("missing", (percent, "%"), Limits::at_most(MISSING_MAX_PERCENT), found, advice)
}

#[cfg(test)]
mod tests {
    use pb3dp_cell::finding::Verdict;

    use super::*;

    const PERIOD: Duration = Duration::from_nanos(33_333_333);
    const COST: SkewCost = SkewCost { speed_m_per_s: 0.1, distance_m: 0.5, baseline_m: Some(0.1) };

    fn moments(change: impl Fn(u64, &mut Moment)) -> Vec<Moment> {
        (0..300)
            .map(|k| {
                let mut moment = Moment { sequence: k, exposed_at_s: 7.0 + k as f64 / 30.0, skew_s: 0.5e-3 };
                change(k, &mut moment);
                moment
            })
            .collect()
    }

    #[track_caller]
    fn check(moments: &[Moment], expected: [bool; 4]) -> Vec<Finding> {
        let findings = findings(moments, PERIOD, (Duration::from_millis(5), &COST), &StereoCounters::default());
        let found: Vec<bool> = findings.iter().map(|finding| finding.verdict == Verdict::Pass).collect();
        assert_eq!(found, expected, "{findings:?}");
        findings
    }

    #[test]
    fn each_fault_fails_its_own_check() {
        let good = check(&moments(|_, _| {}), [true; 4]);
        assert!((good[0].value.unwrap() - 30.0).abs() < 1e-6 && good[1].value.unwrap() < 1e-6);
        check(&moments(|k, moment| moment.exposed_at_s = 7.0 + k as f64 / 29.0), [false, true, true, true]);
        let uneven = check(
            &moments(|k, moment| moment.exposed_at_s += if k % 2 == 0 { 1.5e-3 } else { -1.5e-3 }),
            [true, false, true, true],
        );
        assert!((uneven[1].value.unwrap() - 3.0).abs() < 0.05, "{:?}", uneven[1]);
        let apart = check(
            &moments(|k, moment| moment.skew_s = -6e-3 * f64::from(u8::from(k == 70))),
            [true, true, false, true],
        );
        assert!((apart[2].value.unwrap() - 6.0).abs() < 1e-9);
        let found = &apart[2].found;
        assert!(found.starts_with("at 100 mm/s and a distance of 500 mm this is a depth error of 3.00 mm"), "{found}");
        let mut with_gaps = moments(|_, _| {});
        with_gaps.retain(|moment| moment.sequence % 60 != 30);
        let gaps = check(&with_gaps, [true, true, true, false]);
        assert!((gaps[3].value.unwrap() - 5.0 / 3.0).abs() < 1e-9 && gaps[3].found.starts_with("5 of 300 pairs"));
    }

    #[test]
    fn too_few_pairs_fail() {
        let findings = findings(&[], PERIOD, (Duration::from_millis(5), &COST), &StereoCounters::default());
        assert!(findings[..2].iter().all(|finding| finding.verdict == Verdict::Fail), "{findings:?}");
    }
}
