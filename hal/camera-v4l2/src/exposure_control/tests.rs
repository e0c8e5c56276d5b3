//! Exposure control: reaction to darker scenes, limits, and when it changes nothing.

use proptest::prelude::*;

use super::*;

const PERIOD: Duration = Duration::from_nanos(33_333_333);
const LIMITS: ExposureLimits = ExposureLimits {
    time: UnitRange { min: 5, max: 80, step: 1, span: 4999 },
    gain: Some(UnitRange { min: 10, max: 60, step: 1, span: 255 }),
};

fn at(seconds: f64) -> MonotonicTime {
    MonotonicTime::ZERO + Duration::from_secs_f64(seconds)
}

/// Both images with this mean.
fn grey(grey: f64) -> [Brightness; 2] {
    [Brightness { grey, saturated_share: 0.0 }; 2]
}

/// A scene in front of cameras with a gamma curve: the grey level for an exposure.
fn brightness_of(light: f64, exposure: ExposureUnits, gamma: f64) -> f64 {
    let gain = 1.0 + f64::from(exposure.gain.unwrap_or(0)) / 64.0;
    (255.0 * (light * f64::from(exposure.time) * gain).powf(1.0 / gamma)).min(255.0)
}

/// Runs the controller for some seconds. Returns the changes with their times, and the last grey level.
fn run(
    light: impl Fn(f64) -> f64,
    (mut exposure, gamma): (ExposureUnits, f64),
    following: impl Fn(f64) -> FollowedTarget,
    seconds: f64,
) -> (Vec<(f64, ExposureUnits)>, f64) {
    let mut controller = ExposureController::new(110.0, LIMITS, PERIOD);
    let (mut changes, mut last) = (Vec::new(), 0.0);
    for number in 0..(seconds * 30.0) as u32 {
        let now_s = f64::from(number) / 30.0;
        last = brightness_of(light(now_s), exposure, gamma);
        if let Some((next, _)) = controller.observe((at(now_s), following(now_s)), grey(last), exposure) {
            controller.changed(at(now_s));
            exposure = next;
            changes.push((now_s, next));
        }
    }
    (changes, last)
}

const START: ExposureUnits = ExposureUnits { time: 40, gain: Some(10) };

#[test]
fn a_scene_that_becomes_darker_by_two_is_brought_back_slowly_while_a_target_is_followed() {
    for gamma in [1.0, 2.2] {
        // The grey level is 110 at the start.
        let bright = (110.0_f64 / 255.0).powf(gamma) / (40.0 * (1.0 + 10.0 / 64.0));
        let light = |now_s: f64| if now_s < 3.0 { bright } else { bright / 2.0 };
        let (changes, last) = run(light, (START, gamma), |_| FollowedTarget::Confident, 30.0);
        assert!(changes.iter().all(|(now_s, _)| *now_s > 3.0) && !changes.is_empty(), "{changes:?}");
        assert!((last / 110.0 - 1.0).abs() <= 0.11, "gamma {gamma}: {last} after {changes:?}");
        let mut before = START;
        let mut before_s = 3.0;
        for (now_s, next) in &changes {
            assert!(before == START || now_s - before_s >= 1.0, "{changes:?}");
            assert!(f64::from(next.time) <= 1.1 * f64::from(before.time), "{before:?} {next:?}");
            (before, before_s) = (*next, *now_s);
        }
        // It rests.
        assert!(before_s < 20.0, "{changes:?}");
    }
}

#[test]
fn without_a_target_the_brightness_is_reached_within_two_seconds() {
    for light in [0.003, 0.05] {
        let (changes, last) = run(|_| light, (START, 1.0), |_| FollowedTarget::Nothing, 4.0);
        assert!((last / 110.0 - 1.0).abs() <= 0.11, "{last} after {changes:?}");
        assert!(changes.iter().all(|(now_s, _)| *now_s < 2.0), "{changes:?}");
    }
}

#[test]
fn the_time_is_used_before_the_gain_and_both_end_at_their_limits() {
    let (changes, _) = run(|_| 1e-6, (START, 1.0), |_| FollowedTarget::Nothing, 10.0);
    let first_gain = changes.iter().position(|(_, next)| next.gain != START.gain).unwrap();
    assert_eq!(changes[first_gain].1.time, 80, "{changes:?}");
    assert_eq!(changes.last().unwrap().1, ExposureUnits { time: 80, gain: Some(60) });
    let begin = ExposureUnits { time: 80, gain: Some(60) };
    let (changes, _) = run(|_| 1e3, (begin, 1.0), |_| FollowedTarget::Nothing, 10.0);
    let first_time = changes.iter().position(|(_, next)| next.time != 80).unwrap();
    assert_eq!(changes[first_time].1.gain, Some(10), "{changes:?}");
    assert_eq!(changes.last().unwrap().1, ExposureUnits { time: 5, gain: Some(10) });
}

#[test]
fn nothing_changes_while_the_pose_is_doubtful_and_only_slowly_after_that() {
    // A hand in front of the cameras for 1.5 s.
    let light = |now_s: f64| if (3.0..4.5).contains(&now_s) { 0.001 } else { 0.0107 };
    let doubtful =
        |now_s: f64| if (3.0..4.6).contains(&now_s) { FollowedTarget::Doubtful } else { FollowedTarget::Confident };
    let start = ExposureUnits { time: 35, gain: Some(10) };
    let (changes, _) = run(light, (start, 1.0), doubtful, 10.0);
    assert_eq!(changes, vec![]);
    let (changes, _) = run(|_| 0.001, (start, 1.0), |_| FollowedTarget::Doubtful, 6.0);
    assert!(changes[0].0 >= 2.0 && changes.len() <= 4, "{changes:?}");
}

#[test]
fn a_failed_change_is_tried_again_later() {
    let mut controller = ExposureController::new(110.0, LIMITS, PERIOD);
    let mut tries = Vec::new();
    for number in 0..700 {
        let now_s = f64::from(number) / 30.0;
        if controller.observe((at(now_s), FollowedTarget::Nothing), grey(30.0), START).is_some() {
            tries.push(now_s);
            controller.failed(at(now_s));
        }
    }
    assert_eq!(tries.len(), 3, "{tries:?}");
    assert!(tries.windows(2).all(|two| two[1] - two[0] >= 10.0), "{tries:?}");
}

#[test]
fn images_that_differ_are_not_judged_and_saturated_ones_are_not_made_brighter() {
    let side = |grey, saturated_share| Brightness { grey, saturated_share };
    let judged = |left, right| judge(110.0, [left, right]);
    assert_eq!(judged(side(90.0, 0.0), side(10.0, 0.0)), Verdict::Good, "a covered lens");
    assert_eq!(judged(side(115.0, 0.0), side(103.0, 0.0)), Verdict::Good);
    assert!(matches!(judged(side(80.0, 0.0), side(80.0, 0.02)), Verdict::TooDark(_)));
    assert_eq!(judged(side(60.0, 0.0), side(60.0, 0.07)), Verdict::Good);
    assert!(matches!(judged(side(100.0, 0.0), side(100.0, 0.2)), Verdict::TooBright(_)));
    assert_eq!(judged(side(60.0, 0.2), side(60.0, 0.2)), Verdict::Good, "a lamp in a dark scene");
}

#[test]
fn steps_that_are_too_large_for_a_target_are_left_out() {
    let coarse = ExposureLimits {
        time: UnitRange { min: 2, max: 9, step: 1, span: 100 },
        gain: Some(UnitRange { min: 0, max: 10, step: 1, span: 10 }),
    };
    let now = ExposureUnits { time: 5, gain: Some(3) };
    for verdict in [Verdict::TooDark(2.0), Verdict::TooBright(0.5)] {
        assert_eq!(next(verdict, now, &coarse, StepSize::Followed), None);
        assert!(next(verdict, now, &coarse, StepSize::Free).is_some());
    }
}

fn any_brightness() -> impl Strategy<Value = Brightness> {
    let number = || {
        prop_oneof![
            Just(0.0),
            Just(255.0),
            Just(f64::NAN),
            Just(f64::INFINITY),
            Just(f64::NEG_INFINITY),
            0.0..=255.0,
            any::<f64>()
        ]
    };
    (number(), number()).prop_map(|(grey, saturated_share)| Brightness { grey, saturated_share })
}

fn any_range() -> impl Strategy<Value = UnitRange> {
    (-1000..5000_i32, 0..5000_i32, 1..40_i32).prop_map(|(min, span, step)| UnitRange {
        min,
        max: min + span,
        step,
        span,
    })
}

fn is_within(value: i32, range: &UnitRange) -> bool {
    (range.min..=range.max).contains(&value) && (value - range.min) % range.step == 0
}

proptest! {
    #[test]
    fn exposure_and_gain_stay_within_their_limits_for_any_brightness(
        target_grey in prop_oneof![Just(f64::NAN), 1.0..=254.0],
        sides in prop::collection::vec((any_brightness(), any_brightness(), 0..3_u8), 1..60),
        time in any_range(),
        gain in prop::option::of(any_range()),
        start in (any::<i32>(), any::<i32>()),
    ) {
        let limits = ExposureLimits { time, gain };
        let mut exposure = limits.clamp(ExposureUnits { time: start.0, gain: Some(start.1) });
        let mut controller = ExposureController::new(target_grey, limits, PERIOD);
        for (number, (left, right, following)) in sides.into_iter().enumerate() {
            prop_assert!(is_within(exposure.time, &time), "{:?} of {:?}", exposure, time);
            prop_assert_eq!(exposure.gain.is_some(), gain.is_some());
            if let Some((gain, value)) = gain.zip(exposure.gain) {
                prop_assert!(is_within(value, &gain), "{:?} of {:?}", exposure, gain);
            }
            let following = [FollowedTarget::Nothing, FollowedTarget::Confident, FollowedTarget::Doubtful][usize::from(following)];
            for pair in 0..6 {
                let now = at(number as f64 * 10.0 + f64::from(pair) / 30.0);
                if let Some((next, _)) = controller.observe((now, following), [left, right], exposure) {
                    if following != FollowedTarget::Nothing && exposure.time > 0 {
                        let factor = f64::from(next.time) / f64::from(exposure.time);
                        prop_assert!((1.0 / 1.1 - 1e-6..=1.1 + 1e-6).contains(&factor), "{} of {:?}", factor, exposure);
                    }
                    controller.changed(now);
                    exposure = next;
                }
            }
        }
    }
}
