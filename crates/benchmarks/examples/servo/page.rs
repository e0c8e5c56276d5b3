//! Tables, page and figures.

use std::fmt::Write as _;

use nalgebra::UnitQuaternion;
use pb3dp_cell::figures::RmsMax;
use pb3dp_cell::log::{ControlSample, RunLog};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Hand, World};

use crate::ideal::{Ideal, TAPS};
use crate::limits::Check;
use crate::plot::{AxisKind, Line, Panel, svg_with_caption};
use crate::runs::{Fig7, Response, Step};
use crate::setups::{NOISE_GREY, Who};
use crate::{Findings, ways_page};

/// Time between two points of a line, seconds.
const LINE_STEP_S: f64 = 0.12;

/// The number with so many digits, or a dash.
pub fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.digits$}"))
}

/// `rms (max; ideal)`.
fn with_ideal(error: Option<RmsMax>, ideal: Option<Ideal>, pick: fn(Ideal) -> f64, digits: usize) -> String {
    let Some(error) = error else { return "-".to_owned() };
    let ideal = number(ideal.map(pick), digits);
    format!("{:.digits$} ({:.digits$}; {ideal})", error.rms, error.max)
}

/// The experiment of Fig. 7, one row per run.
pub fn fig7_table(runs: &[Fig7]) -> String {
    let mut text = String::from(
        "| target | led by | delay, ms | moving, mm | moving, deg | hold, mm | hold, deg | lag, ms | initial lock, mm (500 mm x sigma) | \
         noise at the hand, mm | deg | estimates, mm | deg | no pose |\n|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n",
    );
    for run in runs {
        let (locked, ideal) = (&run.summary.locked, &run.ideal);
        let lags: Vec<f64> = run.summary.channels.iter().filter_map(|channel| channel.lag_s).collect();
        let lag_s = lags.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()));
        let lock = run.summary.lock.as_ref();
        let length =
            |from: usize| run.noise.map(|noise| noise[from..from + 3].iter().map(|x| x * x).sum::<f64>().sqrt());
        let _ = writeln!(
            text,
            "| {} | {} | {:.0} | {} | {} | {} | {} | {} | {} ({}) | {} | {} | {} | {} | {} of {} |",
            run.target,
            run.who,
            run.delay_millis,
            with_ideal(locked.moving_mm, ideal.moving, |i| i.mm, 2),
            with_ideal(locked.moving_deg, ideal.moving, |i| i.deg, 3),
            with_ideal(locked.hold_mm, ideal.hold, |i| i.mm, 2),
            with_ideal(locked.hold_deg, ideal.hold, |i| i.deg, 3),
            number(lag_s.map(|lag_s| lag_s * 1e3), 1),
            number(lock.map(|lock| lock.hand_mm), 2),
            number(lock.and_then(|lock| lock.hand_by_tilt_sigma_mm), 2),
            number(length(0), 2),
            number(length(3), 3),
            number(run.estimates.map(|[mm, _]| mm), 2),
            number(run.estimates.map(|[_, deg]| deg), 3),
            run.summary.frames_without_pose,
            run.summary.frames,
        );
    }
    text
}

/// Each axis of each run separately.
pub fn axis_table(runs: &[Fig7]) -> String {
    let mut text = String::from(
        "| target | led by | delay, ms | axis | moving, mm | moving, deg | hold, mm | hold, deg | lag, ms |\n\
         |---|---|---:|---|---:|---:|---:|---:|---:|\n",
    );
    for run in runs {
        for (channel, ideal) in run.summary.channels.iter().zip(&run.channel_ideals) {
            let locked = &channel.locked;
            let _ = writeln!(
                text,
                "| {} | {} | {:.0} | {} | {} | {} | {} | {} | {} |",
                run.target,
                run.who,
                run.delay_millis,
                channel.channel,
                with_ideal(locked.moving_mm, ideal.moving, |i| i.mm, 2),
                with_ideal(locked.moving_deg, ideal.moving, |i| i.deg, 3),
                with_ideal(locked.hold_mm, ideal.hold, |i| i.mm, 2),
                with_ideal(locked.hold_deg, ideal.hold, |i| i.deg, 3),
                number(channel.lag_s.map(|lag_s| lag_s * 1e3), 1),
            );
        }
    }
    text
}

/// Gain and phase of both laws, and the demands of the motion.
pub fn response_table(responses: &[Response]) -> String {
    let mut text = String::from(
        "| axis | period, s | gain, dB | phase, deg | published law: gain, dB | phase, deg | largest share of all limits | of the speed limits |\n\
         |---|---:|---:|---:|---:|---:|---|---|\n",
    );
    for ours in responses.iter().filter(|response| response.who == Who::Ours.name()) {
        let same = |other: &&Response| other.channel == ours.channel && other.period_s == ours.period_s;
        let published = responses.iter().filter(same).find(|other| other.who == Who::Published.name());
        let demand = |only_speeds: bool| -> String {
            let Some(demands) = &ours.demands else { return ours.refusal.clone().unwrap_or_default() };
            let first = demands.iter().find(|demand| demand.is_speed || !only_speeds);
            first.map_or("-".to_owned(), |demand| format!("{:.0} %: {}", 100.0 * demand.share, demand.what))
        };
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {} | {} | {} | {} |",
            ours.channel,
            ours.period_s,
            number(ours.gain_db, 2),
            number(ours.phase_deg, 1),
            number(published.and_then(|other| other.gain_db), 2),
            number(published.and_then(|other| other.phase_deg), 1),
            demand(false),
            demand(true),
        );
    }
    text
}

/// Steps with both laws.
pub fn step_table(steps: &[Step]) -> String {
    let mut text = String::from(
        "| step | law | settling time, s | overshoot, % | lower bound, s | set by |\n|---|---|---:|---:|---:|---|\n",
    );
    for Step { who, summary, shortest_s, set_by } in steps {
        let size = if summary.unit == "mm" { "50 mm" } else { "15 deg" };
        let _ = writeln!(
            text,
            "| {} {size} | {who} | {} | {} | {shortest_s:.2} | {set_by} |",
            summary.channel,
            number(summary.settled_after_s, 2),
            number(summary.overshoot_percent, 1),
        );
    }
    text
}

/// The limits and the measured values.
pub fn limit_table(checks: &[Check]) -> String {
    let mut text = String::from("| quantity | measured | limit | |\n|---|---:|---:|---|\n");
    for check in checks {
        let verdict = if check.is_kept() { "kept" } else { "**missed**" };
        let (found, unit) = (number(check.found, 3), check.unit);
        let _ = writeln!(text, "| {} | {found} {unit} | {} {unit} | {verdict} |", check.what, check.most);
    }
    text
}

/// The documentation page.
pub fn page(findings: &Findings, checks: &[Check], origin: &str) -> String {
    let missed = checks.iter().filter(|check| !check.is_kept()).count();
    let fig7 = fig7_table(&findings.fig7);
    let axes = axis_table(&findings.fig7);
    let (responses, steps, limits) =
        (response_table(&findings.responses), step_table(&findings.steps), limit_table(checks));
    let (speed, ways) = (findings.geometric_times_real_time, ways_page::sections(findings));
    format!(
        "# The servo\n\n\
         This page is written by the command below; change the program, not the page.\n\n\
         ```text\ncargo xtask bench servo\n```\n\n{origin}\n\n\
         {missed} of {} limits are missed: [limits](#limits).\n\n\
         ## The experiment of Fig. 7\n\n\
         ![The six panels](servo.svg)\n\n\
         30 images per second, fx 740, baseline 100 mm, image noise of {NOISE_GREY} grey levels, rendered; the arms of `configs/sim.toml`.\n\
         The delay is the total one, from the middle of an exposure to the motion that it causes, with the lag of the drives (30 ms) and the mean wait for the next control step.\n\
         `direct` is the setup of `configs/sim.toml`, `published` that of `configs/published.toml`: the published method with the published law.\n\n\
         Errors are those of the hand relative to its desired pose: distance and angle, rms (max; ideal).\n\
         The desired pose follows from the initial lock, which uses the mean of the estimates before the first move as the true pose.\n\
         Moving: the target moves.\n\
         Hold: from one second after the move.\n\
         The initial lock has a constant error.\n\
         In brackets: the displacement at 500 mm that results from a tilt of one standard deviation of the first estimate.\n\
         The noise is the white part of the estimates at the hand (second differences); the error of the estimates is their whole error relative to the initial lock.\n\n\
         Ideal is the error of the best linear filter: a weighted sum of the last {TAPS} frames that are old enough, with weights chosen for this noise, this delay and this very motion, separately for each axis.\n\
         One set of weights is chosen for all moves and another for all holds, so no linear filter is better at either; a filter for both is worse at each.\n\
         It is no bound for adaptive filters, and it ignores errors of the estimates that are not white noise.\n\n\
         {fig7}\n\
         ### Each axis\n\n\
         {axes}\n\
         ## Frequency response\n\n\
         ![Gain and phase](servo_response.svg)\n\n\
         The target oscillates with an amplitude of 100 mm or 20 degrees; gain and phase of the hand relative to its desired motion come from least-squares fits of a sinusoid.\n\
         No images are rendered: the poses are the true ones with the noise of `estimator.geometric` in the configuration.\n\
         No arm carries the target, so its motion is not limited.\n\
         The last columns give the demand of a hand without lag as a share of all limits (speeds and accelerations of the axes and of the hand) and of the speed limits alone: above 100 % it cannot follow.\n\n\
         {responses}\n\
         ## Steps\n\n\
         The target jumps by 50 mm or 15 degrees, and later back; also without images.\n\
         Settled: the hand stays within 1 mm and 0.3 degrees of its desired pose; the longer of both directions counts.\n\
         A target that jumps is an outlier at first, and is accepted only after some images.\n\
         The lower bound is the delay without the drives' lag, plus the time of the slowest axis from rest to rest at its largest speed and acceleration, or of the hand at its largest speed.\n\n\
         {steps}\n\
         {ways}\n\
         ## Limits\n\n\
         {limits}\n\
         A run of Fig. 7 without images took 1/{speed:.0} of its simulated time on one core of this machine.\n",
        checks.len(),
    )
}

/// The six panels: the desired and the actual motion of the hand with both setups.
pub fn motion_figure(runs: &[Fig7]) -> Option<String> {
    let ours = runs.iter().find(|run| run.who == Who::Ours.name())?;
    let published = runs.iter().find(|run| run.who == Who::Published.name() && run.delay_millis == ours.delay_millis);
    let (wanted, hand): (Pick, Pick) = (|s| &s.world_from_hand_locked, |s| &s.world_from_hand);
    let mut lines = vec![("wanted", &ours.log, wanted)];
    lines.extend(published.map(|published| ("published", &published.log, hand)));
    lines.push(("direct", &ours.log, hand));
    let axes = ours.log.control.first()?.world_from_target.rotation();
    let panels: Vec<Panel> = (0..6).map(|row| motion_panel(row, &lines, &axes)).collect();
    let caption = format!(
        "Translation and rotation of the hand since the start, in the target's axes at the start; direct method: {}{}; total delay {:.0} ms.",
        ours.target,
        published.map_or(String::new(), |run| format!("; published method: {}", run.target)),
        ours.delay_millis
    );
    Some(svg_with_caption(&panels, 2, &[caption]))
}

type Pick = fn(&ControlSample) -> &Pose<World, Hand>;

fn motion_panel(row: usize, lines: &[(&'static str, &RunLog, Pick)], axes: &UnitQuaternion<f64>) -> Panel {
    let letter = ["a", "b", "c", "d", "e", "f"][row];
    let axis = ["x", "y", "z"][row % 3];
    let title = match row < 3 {
        true => format!("({letter}) position {axis}, mm"),
        false => format!("({letter}) orientation {axis}, deg"),
    };
    let value = |start: &Pose<World, Hand>, now: &Pose<World, Hand>| -> f64 {
        let turned = (now.rotation() * start.rotation().inverse()).scaled_axis();
        match row < 3 {
            true => (axes.inverse() * (now.translation_m() - start.translation_m()))[row] * 1e3,
            false => (axes.inverse() * turned)[row - 3].to_degrees(),
        }
    };
    let line = |(name, log, pick): &(&str, &RunLog, Pick)| {
        let start = log.control.first().map(|first| first.world_from_hand_locked);
        let mut next_s = 0.0;
        let mut points = Vec::new();
        for (sample, start) in log.control.iter().zip(std::iter::repeat(start).flatten()) {
            if sample.t_s >= next_s {
                next_s += LINE_STEP_S;
                points.push([sample.t_s, value(&start, pick(sample))]);
            }
        }
        Line { name: (*name).to_owned(), points, is_bound: *name == "wanted" }
    };
    linear(title, "time, s", lines.iter().map(line).collect())
}

fn linear(title: String, x: &str, lines: Vec<Line>) -> Panel {
    Panel { title, x: x.to_owned(), axes: [AxisKind::Linear; 2], lines }
}

/// Gain and phase over the period, for a translation and a rotation, with both laws.
pub fn response_figure(responses: &[Response]) -> String {
    type Figure = fn(&Response) -> Option<f64>;
    let figures: [(&str, Figure); 2] = [("gain, dB", |r| r.gain_db), ("phase, deg", |r| r.phase_deg)];
    let lines = [(Who::Published, "x"), (Who::Published, "ry"), (Who::Ours, "x"), (Who::Ours, "ry")];
    let panel = |(title, pick): (&str, Figure)| {
        let line = |(who, channel): &(Who, &str)| {
            let mine = responses.iter().filter(|r| r.who == who.name() && r.channel == *channel);
            let mut points: Vec<[f64; 2]> = mine.filter_map(|r| Some([r.period_s, pick(r)?])).collect();
            points.sort_by(|a, b| a[0].total_cmp(&b[0]));
            Line { name: format!("{channel}, {}", who.name()), points, is_bound: false }
        };
        linear(title.to_owned(), "period, s", lines.iter().map(line).collect())
    };
    let caption = "Sinusoids of 100 mm (x) and 20 degrees (ry), without images.".to_owned();
    svg_with_caption(&figures.map(panel), 2, &[caption])
}
