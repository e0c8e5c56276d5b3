//! `pb3dp identify delay`: delays from an exposure to the motion of the hand, measured on the rig.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::SystemTime;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use pb3dp_cell::attended_motion::instructions;
use pb3dp_cell::flight::Moment;
use pb3dp_cell::interruption::{INTERRUPTED, watch};
use pb3dp_cell::swing::{self, Swung};
use pb3dp_cell::terminal::print_line;
use pb3dp_commissioning::arm::confirm;
use pb3dp_commissioning::commissioned::check_arms;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_record::metrics::percentile;
use pb3dp_servo::identification::{
    ArmResponseEstimate, BATCHES, CameraOnHand, Excitation, Interval, arm_response, exposure_offset,
};
use pb3dp_setup::layers::SetupArgs;
use pb3dp_setup::region_spec::{REGION_HELP, RegionSpec};
use pb3dp_setup::setup::{Setup, read_layers};
use pb3dp_wiring::{Wired, accept_nominal, wire_at_rest, write_flights};
use serde::Serialize;

use crate::logging::final_flush;

/// Residual bound of an arm that responds with dead time and lag.
const RESIDUAL_MAX_DEG: f64 = 0.01;

/// Arguments of `pb3dp identify`.
#[derive(Debug, Args)]
pub struct IdentifyArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Move the hand by a few millimetres in front of a stationary target, and measure the delays from exposure to motion. Without
    /// --move only print the plan.
    Delay(DelayArgs),
}

#[derive(Debug, Args)]
struct DelayArgs {
    #[command(flatten)]
    setup: SetupArgs,
    #[arg(long, value_name = "REGION", help = format!("The target in the first left image of real cameras: {REGION_HELP}"))]
    region: Option<RegionSpec>,
    /// Move real arms with a calibration that states no measured cameras (`calibration_quality`: none).
    #[arg(long)]
    nominal_calibration: bool,
    /// Move the arm; real arms need the typed name vs-robot as confirmation. Without it nothing moves.
    #[arg(long = "move")]
    moves: bool,
    /// Amplitude of the motion, to the right and downwards, millimetres.
    #[arg(long, value_name = "MM", default_value_t = 10.0)]
    way: f64,
    /// Duration of the motion.
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    seconds: f64,
    /// One JSON object on standard output instead of a table.
    #[arg(long)]
    json: bool,
    /// Folder for the flight recorders if an arm stops.
    #[arg(long, value_name = "DIR", default_value = "out/identify")]
    out: PathBuf,
}

/// Runs the command.
///
/// # Errors
/// A refused setup or motion, a missing confirmation, a failed part, or a record without the delay.
pub fn run(args: &IdentifyArgs) -> Result<ExitCode> {
    let What::Delay(args) = &args.what;
    delay(args)
}

fn delay(args: &DelayArgs) -> Result<ExitCode> {
    // Before any thread starts: a signal that ended the program would leave the arms to their gateways.
    let mut signals = StopSignals::take_over().context("the signals that end the program cannot be taken over")?;
    let region = args.region.as_ref().map(ToString::to_string);
    let mut setup = read_layers(&args.setup.clone().with("--region", "camera.region", region))?;
    accept_nominal(&mut setup, args.nominal_calibration);
    let motion = Excitation::new(args.way * 1e-3, args.seconds).context("--way is in mm, --seconds in s")?;
    let plan = format!(
        "vs-robot: the hand swings by {:.1} mm to its right and downwards for {:.0} s, at most {:.0} mm/s, and comes back; tc-robot holds \
         the target still",
        args.way,
        args.seconds,
        motion.speed_max_m_per_s() * 1e3
    );
    if !args.moves {
        print_line(&format!("{plan}\nnothing was moved; add --move"))?;
        return Ok(ExitCode::SUCCESS);
    }
    // Before a port opens, as for `pb3dp run`.
    if !setup.is_emulated() {
        confirm::need_no_button(&setup)?;
    }
    let records = check_arms(&setup, SystemTime::now())?;
    let person = match setup.is_emulated() {
        true => None,
        false => {
            confirm::need_person()?;
            let how = instructions(setup.operator_key_within);
            tracing::warn!("{plan}; both arms will be enabled. {how} Type vs-robot and Enter to go on:");
            Some(confirm::typed("vs-robot", &mut signals)?)
        }
    };
    // Before anything moves: the flight recorder must exist when an arm stops.
    std::fs::create_dir_all(&args.out).with_context(|| format!("{}: cannot be created", args.out.display()))?;
    let Wired { parts, monitors, .. } = wire_at_rest(&setup, swing::duration(&motion))?;
    records.iter().try_for_each(|record| record.check(&monitors))?;
    let interrupt = Arc::clone(&parts.interrupt);
    let was_interrupted = watch(signals, &interrupt, final_flush)?;
    let (clock, flights) = (Arc::clone(&parts.clock), parts.flights.clone());
    // Standard output is for the result.
    let listen = |console| confirm::attend(console, setup.operator_key_within, &parts, std::io::stderr());
    let attended = person.map(listen).transpose()?;
    let swung = swing::run(&setup, parts, motion);
    if let Err(failure) = &swung {
        let moment = Moment { monotonic: clock.now(), wall: SystemTime::now() };
        write_flights((&args.out, 1), &flights, &monitors, failure, moment);
    }
    let swung = swung?;
    let was_ended = attended.is_some_and(|attended| attended.ended().is_some());
    if was_ended || was_interrupted.load(Ordering::SeqCst) {
        return Ok(ExitCode::from(INTERRUPTED));
    }
    let delays = Delays::of(&setup, &swung)?;
    let text = if args.json { serde_json::to_string(&delays)? } else { delays.text(&setup) };
    print_line(&text)?;
    Ok(ExitCode::SUCCESS)
}

/// A time with its 95 % confidence interval, milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
struct Millis {
    value: f64,
    half_width_95: f64,
}

impl From<Interval> for Millis {
    fn from(interval: Interval) -> Self {
        Self { value: interval.value * 1e3, half_width_95: interval.half_width_95 * 1e3 }
    }
}

impl std::fmt::Display for Millis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.1} +- {:.1}", self.value, self.half_width_95)
    }
}

/// Results, milliseconds.
#[derive(Clone, Copy, Debug, Serialize)]
struct Delays {
    /// From the timestamp of a pair to the control step that used its estimate.
    stamp_to_use_p50: f64,
    stamp_to_use_p95: f64,
    stamp_to_use_max: f64,
    /// Delay between the timestamps of pairs and their exposure, on the clock of the joints.
    stamp_to_exposure: Millis,
    /// From a command to the start of the motion.
    arm_delay: Millis,
    /// Time constant of the lag after it.
    arm_lag: Millis,
    /// Sum of both.
    command_to_motion: Millis,
    /// From exposure to motion.
    total: Millis,
    /// Residual of the joint angles, degrees.
    arm_residual_deg: f64,
    /// Used estimates, and those without confidence.
    estimates: usize,
    untrusted: usize,
}

impl Delays {
    fn of(setup: &Setup, swung: &Swung) -> Result<Self> {
        if swung.observed.is_empty() {
            bail!(
                "no estimate could be stood by in {} pairs: look at the target with pb3dp run first",
                swung.untrusted
            );
        }
        let camera = CameraOnHand {
            chain: &setup.rig.arms.vs.chain,
            flange_from_hand: setup.controller.flange_from_hand,
            hand_from_cam_left: setup.controller.hand_from_cam_left,
        };
        let poses: Vec<_> = swung.observed.iter().map(|observed| (observed.at, observed.cam_left_from_model)).collect();
        let offset = exposure_offset(&poses, &swung.joints, &camera).context("stamps of the images")?;
        let ArmResponseEstimate { delay, lag, total: arm, residual_rms_rad } =
            arm_response(&swung.given, &swung.joints).context("vs-robot")?;
        let ages_s: Vec<f64> =
            swung.observed.iter().map(|observed| observed.used_at.seconds_since(observed.at)).collect();
        let age_ms = |share: f64| percentile(&ages_s, share).map_or(f64::NAN, |age_s| age_s * 1e3);
        let p50 = age_ms(50.0);
        let total = Interval {
            value: p50 * 1e-3 - offset.value + arm.value,
            half_width_95: offset.half_width_95.hypot(arm.half_width_95),
        };
        Ok(Self {
            stamp_to_use_p50: p50,
            stamp_to_use_p95: age_ms(95.0),
            stamp_to_use_max: age_ms(100.0),
            stamp_to_exposure: offset.into(),
            arm_delay: delay.into(),
            arm_lag: lag.into(),
            command_to_motion: arm.into(),
            total: total.into(),
            arm_residual_deg: residual_rms_rad.to_degrees(),
            estimates: swung.observed.len(),
            untrusted: swung.untrusted,
        })
    }

    fn text(&self, setup: &Setup) -> String {
        let mut text = String::new();
        let mut line = |what: &str, value: String| {
            let _ = writeln!(text, "{what:<58} {value}");
        };
        line("from the stamp of a pair to its use, p50 / p95 / max, ms", {
            format!("{:.1} / {:.1} / {:.1}", self.stamp_to_use_p50, self.stamp_to_use_p95, self.stamp_to_use_max)
        });
        line("from the stamp to the true exposure, ms", self.stamp_to_exposure.to_string());
        line("from command to motion: dead time, ms", self.arm_delay.to_string());
        line("from command to motion: lag, ms", self.arm_lag.to_string());
        line("from command to motion: both, ms", self.command_to_motion.to_string());
        line("from exposure to motion, ms", self.total.to_string());
        line("left of the joint angles by this model, deg rms", format!("{:.5}", self.arm_residual_deg));
        line("estimates used, and not stood by", format!("{}, {}", self.estimates, self.untrusted));
        let _ = write!(text, "\nintervals: 95 % ({BATCHES} pieces of the record)\n\n{}", self.advice(setup));
        text
    }

    /// Advice on the use of the results.
    fn advice(&self, setup: &Setup) -> String {
        let mut advice = format!(
            "[servo.arm_response]\ndelay_millis = {:.1}\nlag_millis = {:.1}\n",
            self.arm_delay.value.max(0.0),
            self.arm_lag.value.max(0.0)
        );
        let total_s = self.total.value * 1e-3;
        let _ = write!(
            advice,
            "\nwithout feed-forward gains up to {:.1} 1/s have no overshoot, and up to {:.1} 1/s the loop is stable\n",
            1.0 / (std::f64::consts::E * total_s),
            std::f64::consts::FRAC_PI_2 / total_s
        );
        if self.arm_residual_deg > RESIDUAL_MAX_DEG {
            let _ = writeln!(
                advice,
                "dead time and lag leave {:.4} deg of the joint angles, more than {RESIDUAL_MAX_DEG}: the limiter has rounded the motion off, \
                 or the arm answers in another way; try a longer --seconds or a smaller --way",
                self.arm_residual_deg
            );
        }
        let exposure_ms = setup.rig.frames.exposure.as_secs_f64() * 1e3;
        if self.stamp_to_exposure.value.abs() > self.stamp_to_exposure.half_width_95.max(1.0) {
            let _ = writeln!(
                advice,
                "the stamps are wrong by {:.1} ms (the exposure takes {exposure_ms:.1} ms): a target that the hand passes at 100 mm/s is \
                 seen {:.1} mm off; stamp the middle of the exposure, on the clock of the joints",
                self.stamp_to_exposure.value,
                0.1 * self.stamp_to_exposure.value.abs()
            );
        }
        advice
    }
}
