//! Probe results of an arm, compared with its configuration.

use std::time::Duration;

use pb3dp_arm_pa10::arm::{ArmMonitor, ArmSnapshot};
use pb3dp_arm_pa10::driver::{ArmCondition, AxisLimits};
use pb3dp_arm_pa10_protocol::codec::{Axis, AxisStatus, CommStatus, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::HelloReply;
use pb3dp_cell::parts::ArmChoice;
use pb3dp_hal_platform::jitter::Jitter;
use pb3dp_setup::setup::{ArmLink, ArmSetup};
use pb3dp_wiring::commissioning::{LIMITS_TOLERANCE_DEG, is_of_another_format};
use pb3dp_wiring::{geometry_doubt, watchdog_refusal};
use serde::Serialize;

/// Largest share of lost messages on a link, percent.
const LOST_PERCENT_MAX: f64 = 1.0;

/// Probe results of an arm.
#[derive(Debug, Default, Serialize)]
pub struct ProbeReport {
    /// Its name.
    pub arm: &'static str,
    /// Address or port of its link.
    pub target: Option<String>,
    /// No problems.
    pub fits: bool,
    /// Problems, with remedies.
    pub problems: Vec<String>,
    /// Warnings.
    pub warnings: Vec<String>,
    /// State of the driver.
    pub state: Option<String>,
    /// Properties reported by the gateway.
    pub gateway: Option<GatewayFacts>,
    /// Joints, from the base.
    pub joints: Vec<JointFacts>,
    /// Status word of the controller.
    pub controller_word: Option<String>,
    /// The link.
    pub link: Option<LinkFacts>,
}

/// Properties reported by a gateway.
#[derive(Debug, Serialize)]
pub struct GatewayFacts {
    firmware: String,
    /// Determined by the length of the controller's replies; none before the first one.
    wire_format: Option<String>,
    geometry: String,
    state: String,
    cause: String,
    cycle_ms: f64,
    ramp_after_ms: f64,
    stop_after_ms: f64,
    /// None if not set at the gateway.
    controller_watchdog_ms: Option<f64>,
    brake_release_ms: f64,
}

/// One joint.
#[derive(Debug, Serialize)]
pub struct JointFacts {
    axis: u8,
    name: &'static str,
    now_deg: Option<f64>,
    start_deg: f64,
    from_start_deg: Option<f64>,
    /// Lower and upper limit in the controller's EEPROM.
    eeprom_deg: Option<[f64; 2]>,
    /// Limits of the robot description.
    configured_deg: [f64; 2],
    /// EEPROM minus configuration.
    difference_deg: Option<[f64; 2]>,
    status_word: Option<String>,
    alarm: Option<String>,
}

/// Message statistics of the link.
#[derive(Debug, Serialize)]
pub struct LinkFacts {
    sent: u64,
    answered: u64,
    lost: u64,
    late: u64,
    damaged: u64,
    mismatched: u64,
    /// How often bytes were skipped to find the next frame.
    resyncs: u64,
    /// Number of skipped bytes.
    skipped_bytes: u64,
    /// Commands with brakes on and servos off.
    round_trips: TimeFacts,
    /// All other messages; most of them read a limit.
    control_round_trips: TimeFacts,
    /// Lateness of the commands.
    lateness: TimeFacts,
}

/// Statistics of event times.
#[derive(Debug, Serialize)]
pub struct TimeFacts {
    count: u64,
    p50_ms: f64,
    p99_ms: f64,
    max_ms: f64,
}

impl From<Jitter> for TimeFacts {
    fn from(times: Jitter) -> Self {
        Self { count: times.cycles, p50_ms: millis(times.p50), p99_ms: millis(times.p99), max_ms: millis(times.max) }
    }
}

fn millis(time: Duration) -> f64 {
    (time.as_secs_f64() * 1e6).round() / 1e3
}

fn degrees(rad: f64) -> f64 {
    // Adding zero removes the sign of minus zero.
    (rad.to_degrees() * 1e4).round() / 1e4 + 0.0
}

impl ProbeReport {
    /// An empty report of an arm that is not reached yet.
    pub fn begin(choice: ArmChoice) -> Self {
        Self { arm: choice.name(), fits: true, ..Self::default() }
    }

    /// Adds a problem, with its remedy.
    pub fn refuse(&mut self, text: String) {
        self.fits = false;
        self.problems.push(text);
    }

    /// Adds a warning.
    pub fn warn(&mut self, text: impl Into<String>) {
        self.warnings.push(text.into());
    }

    /// Adds the results of an arm that was reached.
    pub fn add(&mut self, arm: &ArmSetup, target: String, monitor: &ArmMonitor) {
        let snapshot = monitor.snapshot();
        judge_stop(&snapshot, self);
        if let Some(hello) = &snapshot.gateway {
            judge_gateway(arm, hello, self);
        }
        self.joints = Axis::ALL.map(|axis| joint(arm, &snapshot, axis, self)).into();
        self.controller_word = snapshot.sample.or(snapshot.shown).map(|sample| controller(&sample.condition, self));
        self.link = Some(link(&snapshot, monitor, self));
        self.target = Some(target);
        self.state = Some(snapshot.state.to_string());
        self.gateway = snapshot.gateway.as_ref().map(GatewayFacts::of);
    }
}

fn judge_stop(snapshot: &ArmSnapshot, report: &mut ProbeReport) {
    let Some(latched) = &snapshot.latched else { return };
    report.refuse(format!("the arm is stopped: {}", latched.trip));
    match (&snapshot.sample, &snapshot.shown, &snapshot.gateway) {
        (Some(_), _, _) => {}
        (None, Some(shown), _) => {
            let seconds = shown.age.as_secs_f64();
            report.warn(format!("joints and status words are {seconds:.1} s old: the gateway does not measure now"));
        }
        (None, None, Some(_)) => {
            report.warn("no joints: the gateway has no measurement since its start; reset the arm");
        }
        (None, None, None) => report.warn("no joints: the arm was stopped before its first measurement"),
    }
    if is_of_another_format(&latched.trip) {
        report.refuse(
            "the length of the controller's answers does not match the configured wire format: set wire_format to the other one, here \
             and at the gateway if there is one"
                .to_owned(),
        );
    }
}

/// What the gateway states about itself that needs a warning or a refusal.
fn judge_gateway(arm: &ArmSetup, hello: &HelloReply, report: &mut ProbeReport) {
    if hello.controller_watchdog_us == 0 {
        report.warn("the gateway does not know the controller's watchdog: measure it on the rig, and set bus.controller_time_out_millis in the gateway's file");
    }
    if let ArmLink::Gateway(link, _) = &arm.link
        && let Some(doubt) = geometry_doubt(link.geometry, hello.geometry)
    {
        report.warn(doubt);
    }
    if let Some(refusal) = watchdog_refusal(arm.command_timeout, hello) {
        report.refuse(refusal);
    }
}

impl GatewayFacts {
    /// From its HELLO reply.
    pub fn of(hello: &HelloReply) -> Self {
        let ms = |us: u32| f64::from(us) / 1e3;
        Self {
            firmware: hello.firmware.as_str().to_owned(),
            wire_format: hello.wire_format.map(|format: WireFormat| format.to_string()),
            geometry: hello.geometry.to_string(),
            state: hello.state.to_string(),
            cause: hello.cause.to_string(),
            cycle_ms: ms(hello.cycle_us),
            ramp_after_ms: ms(hello.ramp_after_us),
            stop_after_ms: ms(hello.stop_after_us),
            controller_watchdog_ms: (hello.controller_watchdog_us > 0).then(|| ms(hello.controller_watchdog_us)),
            brake_release_ms: ms(hello.brake_release_us),
        }
    }
}

fn joint(arm: &ArmSetup, snapshot: &ArmSnapshot, axis: Axis, report: &mut ProbeReport) -> JointFacts {
    let index = axis.index();
    let hard = arm.limits.servo();
    let configured_deg = [degrees(hard.position_min_rad()[index]), degrees(hard.position_max_rad()[index])];
    let eeprom_deg =
        snapshot.limits[index].map(|limits: AxisLimits| [degrees(limits.lower_rad), degrees(limits.upper_rad)]);
    let difference_deg =
        eeprom_deg.map(|found| [0, 1].map(|end| ((found[end] - configured_deg[end]) * 1e4).round() / 1e4));
    match difference_deg {
        Some(difference) if difference.iter().any(|by| by.abs() > LIMITS_TOLERANCE_DEG) => report.refuse(format!(
            "{axis}: the controller's limits differ by {:+.3} and {:+.3} degrees from those of the robot description: check \
             whether this is the arm of {}, then correct the limits in {}.robot",
            difference[0],
            difference[1],
            arm.key,
            arm.key
        )),
        None if snapshot.latched.is_none() => {
            report.refuse(format!("{axis}: the controller did not send its limits; probe again"));
        }
        _ => {}
    }
    let sample = snapshot.sample.or(snapshot.shown);
    let now_rad = sample.map(|sample| sample.position_rad[index]);
    if let Some(angle) = now_rad {
        judge_angle(arm, (axis, angle), report);
    }
    let (word, alarm) = sample.map(|sample| status(&sample.condition, axis, report)).unwrap_or_default();
    JointFacts {
        axis: axis.number(),
        name: axis.name(),
        now_deg: now_rad.map(degrees),
        start_deg: degrees(arm.start_rad[index]),
        from_start_deg: now_rad.map(|angle| degrees(angle - arm.start_rad[index])),
        eeprom_deg,
        configured_deg,
        difference_deg,
        status_word: word,
        alarm,
    }
}

fn judge_angle(arm: &ArmSetup, (axis, angle_rad): (Axis, f64), report: &mut ProbeReport) {
    let index = axis.index();
    let operating = arm.limits.operating();
    let (lower, upper) = (operating.position_min_rad()[index], operating.position_max_rad()[index]);
    let (guard, angle) = (&arm.guard, angle_rad.to_degrees());
    if !(guard.mechanical_min_rad[index]..=guard.mechanical_max_rad[index]).contains(&angle_rad) {
        report.refuse(format!(
            "{axis}: {angle:.3} degrees is outside the mechanical range: encoder or zero point is wrong; do not move the arm"
        ));
    } else if !(lower..=upper).contains(&angle_rad) {
        report.refuse(format!(
            "{axis}: {angle:.3} degrees is outside the operating range {:.1} to {:.1}: jog it back",
            lower.to_degrees(),
            upper.to_degrees()
        ));
    }
}

/// The status word of an axis, and its alarm.
fn status(condition: &ArmCondition, axis: Axis, report: &mut ProbeReport) -> (Option<String>, Option<String>) {
    match condition.axes[axis.index()] {
        AxisStatus::Servo(word) => {
            let alarm = word.alarm().map(|alarm| alarm.to_string());
            if let Some(alarm) = &alarm {
                report.refuse(format!("{axis}: {alarm}: remove the cause"));
            }
            (Some(format!("0x{:04x}", word.0)), alarm)
        }
        AxisStatus::Undocumented(word) => {
            if word != 0 {
                report.warn(format!(
                    "{axis}: status word 0x{word:04x}; its bits are undocumented in format A: `pb3dp arm signals` finds those of the switches"
                ));
            }
            (Some(format!("0x{word:04x}")), None)
        }
    }
}

fn controller(condition: &ArmCondition, report: &mut ProbeReport) -> String {
    let word = match condition.comm {
        CommStatus::Comm(word) => word,
        CommStatus::Undocumented(word) => return format!("0x{word:04x}"),
    };
    if let Some(alarm) = word.alarm() {
        report.refuse(format!("controller: {alarm}: remove the cause"));
    }
    let flags = [
        (word.is_dead_man_on(), "dead-man on"),
        (word.is_power_too_warm(), "power supply too warm"),
        (word.is_100_v_output_on(), "100 V output on"),
        (word.is_e_stop_switch_open(), "emergency stop bit"),
        (word.is_teaching_switch_set(), "teaching switch"),
        (word.is_limit_switch_open(), "limit switch bit"),
        (word.is_uncontrollable(), "uncontrollable"),
    ];
    let set: Vec<&str> = flags.into_iter().filter_map(|(is_set, name)| is_set.then_some(name)).collect();
    format!("0x{:04x} ({})", word.0, if set.is_empty() { "none set".to_owned() } else { set.join(", ") })
}

fn link(snapshot: &ArmSnapshot, monitor: &ArmMonitor, report: &mut ProbeReport) -> LinkFacts {
    let counters = &snapshot.counters;
    let lost_percent = 100.0 * counters.lost as f64 / counters.sent.max(1) as f64;
    if lost_percent > LOST_PERCENT_MAX {
        report.refuse(format!(
            "{} of {} messages had no answer in time: check the latency timer of the adapter, the baud rate and the CPU load",
            counters.lost, counters.sent
        ));
    } else if counters.lost > 0 {
        report.warn(format!("{} of {} messages had no answer in time", counters.lost, counters.sent));
    }
    let bad = counters.damaged + counters.mismatched;
    if bad > 0 {
        report.refuse(format!("{bad} answers were damaged or foreign, limit 0: check cable, ground and baud rate"));
    }
    LinkFacts {
        sent: counters.sent,
        answered: counters.answered,
        lost: counters.lost,
        late: counters.late,
        damaged: counters.damaged,
        mismatched: counters.mismatched,
        resyncs: snapshot.line.resyncs,
        skipped_bytes: snapshot.line.skipped_bytes,
        round_trips: monitor.round_trips().into(),
        control_round_trips: monitor.control_trips().into(),
        lateness: monitor.jitter().into(),
    }
}

impl std::fmt::Display for ProbeReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (&self.target, &self.state) {
            (Some(target), Some(state)) => writeln!(f, "{} at {target}: {state}", self.arm)?,
            _ => writeln!(f, "{}: not reached", self.arm)?,
        }
        if let Some(gateway) = &self.gateway {
            writeln!(f, "{gateway}")?;
        }
        if !self.joints.is_empty() {
            writeln!(
                f,
                "axis   now deg  from start   EEPROM deg           configured deg       difference     status"
            )?;
        }
        for joint in &self.joints {
            writeln!(f, "{joint}")?;
        }
        if let Some(word) = &self.controller_word {
            writeln!(f, "controller: status {word}")?;
        }
        if let Some(link) = &self.link {
            writeln!(f, "{link}")?;
        }
        for warning in &self.warnings {
            writeln!(f, "warning: {warning}")?;
        }
        for problem in &self.problems {
            writeln!(f, "PROBLEM: {problem}")?;
        }
        f.write_str(if self.fits { "no problems found" } else { "problems found: see above" })
    }
}

impl std::fmt::Display for GatewayFacts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let format = self.wire_format.as_deref().unwrap_or("format unknown yet");
        writeln!(f, "gateway: {:?}, {format}, geometry {}, {}", self.firmware, self.geometry, self.state)?;
        let controller = self.controller_watchdog_ms.map_or("unknown".to_owned(), |ms| format!("{ms} ms"));
        write!(
            f,
            "  cycle {} ms; without commands: slower after {} ms, stopped after {} ms; controller's watchdog {controller}; brakes \
             {} ms",
            self.cycle_ms, self.ramp_after_ms, self.stop_after_ms, self.brake_release_ms
        )
    }
}

impl std::fmt::Display for JointFacts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.3}"));
        let range = |ends: Option<[f64; 2]>| ends.map_or("-".to_owned(), |[low, high]| format!("{low:.3} {high:.3}"));
        let difference = self.difference_deg.map_or("-".to_owned(), |[low, high]| format!("{low:+.3} {high:+.3}"));
        write!(
            f,
            "{} {}  {:>8}  {:>10}   {:<19}  {:<19}  {difference:<13}  {} {}",
            self.axis,
            self.name,
            number(self.now_deg),
            number(self.from_start_deg),
            range(self.eeprom_deg),
            range(Some(self.configured_deg)),
            self.status_word.as_deref().unwrap_or("-"),
            self.alarm.as_deref().unwrap_or("")
        )
    }
}

impl std::fmt::Display for LinkFacts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "link: {} messages, {} answered, {} lost, {} late, {} damaged, {} foreign; {} resyncs, {} bytes skipped",
            self.sent,
            self.answered,
            self.lost,
            self.late,
            self.damaged,
            self.mismatched,
            self.resyncs,
            self.skipped_bytes
        )?;
        writeln!(f, "  commands:       round trip {}", self.round_trips)?;
        writeln!(f, "  other messages: round trip {}", self.control_round_trips)?;
        write!(f, "  commands sent late by {}", self.lateness)
    }
}

impl std::fmt::Display for TimeFacts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { count, p50_ms, p99_ms, max_ms } = self;
        write!(f, "p50 {p50_ms:.3} ms, p99 {p99_ms:.3} ms, max {max_ms:.3} ms (of {count})")
    }
}
