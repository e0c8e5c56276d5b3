//! A USB adapter that is unplugged during motion: ten times the host's, once the gateway's.

use std::error::Error;
use std::path::Path;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::Duration;

use pb3dp_arm_pa10::arm::trip_line;
use pb3dp_arm_pa10::driver::{FaultCause, Latched, Trip};
use pb3dp_arm_pa10::serial::SerialLink;
use pb3dp_arm_pa10_protocol::gateway_protocol::StopCause;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmError, ArmErrorKind, ArmPower};
use pb3dp_hal_platform::realtime::{Realtime, enter, now, sleep_until};
use pb3dp_hal_platform::transport::{ByteLink, wait};

use crate::cell::{BAUD, CYCLE, Cell, Lines};
use crate::report::{Outcome, Report, ensure, plug, unplug};
use crate::serial::{GATEWAY, HOST, adapter, config};
use crate::system::{KernelLog, LONG, wait_for};

/// Number of times that the host's adapter is unplugged; maximum times from the kernel's message to the stop (median and
/// longest), and until the joints are stationary.
const PULLS: usize = 10;
const NOTICED_IN_MEDIAN: Duration = Duration::from_millis(20);
const NOTICED_IN: Duration = Duration::from_millis(100);
const AT_REST_IN: Duration = Duration::from_millis(100);

/// Number of times that a port is lost during output, and maximum time to close it: the kernel waits up to 30 s for unsent bytes.
const ROUNDS: u32 = 3;
const CLOSED_IN: Duration = Duration::from_millis(1500);

/// Cycles in which an arm that is plugged in again receives motion commands, and must not move.
const CYCLES_WITHOUT_RESET: u32 = 30;

/// Whose cable is pulled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Host,
    Gateway,
}

/// Priority of the control loop: below the thread of the arm, above everything else.
const LOOP: Realtime = Realtime { priority: Some(45), locks_memory: false, cpu: None };

pub fn check(report: &mut Report) {
    enter(&LOOP);
    report.check("a port that is lost while bytes go out is closed at once", close_a_lost_port);
    let mut cell = None;
    report.check("an arm moves through both adapters", || {
        let made =
            cell.insert(Cell::start(Lines::serial(&adapter(HOST)?, &adapter(GATEWAY)?), trip_line(1)?.remove(0))?);
        ensure(made.arm.warnings().is_empty(), || format!("{:?}", made.arm.warnings()))?;
        let before = made.position_rad();
        made.make_move()?;
        ensure((made.position_rad() - before).amax() > 0.01, || "no joint has moved".into())?;
        Ok(format!("answers after {:?} (half of them)", made.arm.monitor().round_trips().p50))
    });
    let Some(mut cell) = cell else { return };
    report.check("the host's adapter is pulled out ten times", || {
        let mut times = (0..PULLS).map(|_| pull(&mut cell, End::Host)).collect::<Result<Vec<Times>, _>>()?;
        times.sort_by_key(|times| times.stopped);
        let (median, longest) = (times[PULLS / 2].stopped, times[PULLS - 1].stopped);
        ensure(median <= NOTICED_IN_MEDIAN, || format!("noticed after {median:?} (median)"))?;
        let times: Vec<String> = times.iter().map(Times::to_string).collect();
        Ok(format!("stopped after {median:?} (median), {longest:?} at most; {}", times.join("; ")))
    });
    report.check("the gateway's adapter is pulled out", || Ok(pull(&mut cell, End::Gateway)?.to_string()));
}

/// Times since the kernel's message.
struct Times {
    /// The host has stopped the arm.
    stopped: Duration,
    /// The control loop has its error.
    reported_at: Duration,
    /// The gateway has stopped the arm.
    gateway: Duration,
    /// The joints are stationary.
    rest: Duration,
    /// The arm moves again; time since its reset.
    again: Duration,
}

impl std::fmt::Display for Times {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [stopped, reported_at, gateway, rest, again] =
            [self.stopped, self.reported_at, self.gateway, self.rest, self.again].map(|time| time.as_secs_f64() * 1e3);
        write!(
            f,
            "host stopped {stopped:.1} ms, loop told {reported_at:.1} ms, gateway stopped {gateway:.1} ms, joints at rest {rest:.1} ms; moves \
             {again:.0} ms after its reset"
        )
    }
}

/// Unplugs the adapter of a moving arm; the arm moves again afterwards.
fn pull(cell: &mut Cell, end: End) -> Result<Times, Box<dyn Error>> {
    let (device, name) = match end {
        End::Host => ("host", HOST),
        End::Gateway => ("gateway", GATEWAY),
    };
    let path = adapter(name)?;
    cell.gateway_stops();
    cell.gateway_messages();
    let mut log = KernelLog::open()?;
    let asked = now();
    unplug(device);
    let error = move_until_stopped(cell, asked)?;
    let reported_at = now();
    let noticed = log.wait_for("USB disconnect")?;
    let latched = cell.arm.monitor().snapshot().latched.ok_or("there is an error, and the arm is not stopped")?;
    wait_for("the port is gone", || (!Path::new(&path).exists()).then_some(()))?;
    let stop = judge_stop(cell, end, noticed, reported_at, &error, &latched);
    let position = cell.position_rad();
    plug(device);
    let again = adapter(name)?;
    ensure(again == path, || format!("it was {path} and is {again} now: somebody has kept the old port open"))?;
    let times = stop?;
    for _ in 0..CYCLES_WITHOUT_RESET {
        let refused = cell.exchange().err().ok_or("an arm that was not reset takes commands")?;
        ensure(refused.kind() == error.kind(), || format!("first `{error}`, then `{refused}`"))?;
    }
    let enabled = cell.arm.enable().is_ok();
    let moved = (cell.position_rad() - position).amax();
    ensure(!enabled && moved < 1e-6 && cell.is_at_rest(), || {
        format!("not reset, and: enabled {enabled}, moved by {moved} rad, at rest {}", cell.is_at_rest())
    })?;
    if end == End::Gateway {
        let mut messages = Vec::new();
        wait_for("the gateway opens its port again", || {
            messages.extend(cell.gateway_messages());
            messages.iter().any(|text| text.contains("is open")).then_some(())
        })
        .map_err(|error| format!("{error}: {messages:?}"))?;
    }
    let reset = now();
    cell.make_move()?;
    ensure((cell.position_rad() - position).amax() > 0.01, || "it was reset, and no joint moves".into())?;
    Ok(Times { again: now().saturating_since(reset), ..times })
}

/// The loss of the port appears as a failed write, before the kernel has removed the port: unsent bytes must not delay the
/// program that closes the port, nor the kernel.
fn close_a_lost_port() -> Outcome {
    let far = SerialLink::open(&config(&adapter(GATEWAY)?, BAUD, CYCLE))?;
    let (over, is_over) = channel();
    // The output must be read, because a full emulated cable stops the computer.
    let reader = std::thread::spawn(move || drain(far, &is_over));
    let (mut longest, mut symptoms) = (Duration::ZERO, Vec::new());
    for _ in 0..ROUNDS {
        let path = adapter(HOST)?;
        let mut link = SerialLink::open(&config(&path, BAUD, CYCLE))?;
        let begin = now();
        unplug("host");
        let gone = loop {
            if let Err(gone) = link.try_write(&[0x55; 16]) {
                break gone;
            }
            ensure(now().saturating_since(begin) < LONG, || "it was pulled out, and writing does not fail".into())?;
            sleep_until(now() + Duration::from_micros(200));
        };
        let lost = now();
        drop(link);
        longest = longest.max(now().saturating_since(lost));
        symptoms.push(gone.symptom.to_string());
        wait_for("the port is gone", || (!Path::new(&path).exists()).then_some(()))?;
        plug("host");
        adapter(HOST)?;
    }
    drop(over);
    reader.join().map_err(|_| "the reader has panicked")?;
    ensure(longest < CLOSED_IN, || format!("closing took {longest:?} ({})", symptoms.join(", ")))?;
    Ok(format!("in {:.1} ms at most ({})", longest.as_secs_f64() * 1e3, symptoms.join(", ")))
}

fn drain(mut link: SerialLink, is_over: &Receiver<()>) {
    while is_over.try_recv() != Err(TryRecvError::Disconnected) {
        wait(Some(&link), false, None, Duration::from_millis(5));
        if link.try_read(&mut [0; 512]).is_err() {
            return;
        }
    }
}

fn move_until_stopped(cell: &mut Cell, since: MonotonicTime) -> Result<ArmError, Box<dyn Error>> {
    loop {
        if let Err(error) = cell.exchange() {
            return Ok(error);
        }
        ensure(now().saturating_since(since) < LONG, || "nobody has noticed that the cable is gone".into())?;
    }
}

/// Checks the times and causes of the stop.
fn judge_stop(
    cell: &mut Cell,
    end: End,
    noticed: MonotonicTime,
    reported_at: MonotonicTime,
    error: &ArmError,
    latched: &Latched,
) -> Result<Times, Box<dyn Error>> {
    wait_for("the arm comes to rest", || cell.is_at_rest().then_some(()))?;
    let stops = cell.gateway_stops();
    let (kind, cause_fits) = match (end, latched.trip) {
        (End::Host, Trip::Fault(cause)) => (ArmErrorKind::Disconnected, cause == FaultCause::Unplugged),
        (End::Gateway, Trip::Fault(cause)) => (ArmErrorKind::Fault, matches!(cause, FaultCause::LinkLost { .. })),
        (_, Trip::EStop(_)) => (ArmErrorKind::Fault, false),
    };
    ensure(error.kind() == kind && cause_fits, || format!("{:?} `{error}`, stopped by {latched:?}", error.kind()))?;
    let latency = latched.at.saturating_since(noticed);
    ensure(latency < NOTICED_IN, || format!("the host has noticed after {latency:?}"))?;
    let rest = cell.last_motion().saturating_since(noticed);
    ensure(rest < AT_REST_IN, || format!("the joints were at rest after {rest:?}"))?;
    let [(stopped, StopCause::HostSilent)] = stops.as_slice() else {
        return Err(format!("the gateway has stopped the arm by {stops:?}").into());
    };
    let counters = cell.mock.report().counters;
    ensure(counters.watchdog_trips == 0, || "the controller's own time-out has stopped it".into())?;
    let still = cell.arm.monitor().snapshot().latched;
    ensure(still == Some(*latched), || format!("first {latched:?}, then {still:?}"))?;
    Ok(Times {
        stopped: latency,
        reported_at: reported_at.saturating_since(noticed),
        gateway: stopped.saturating_since(noticed),
        rest,
        again: Duration::ZERO,
    })
}
