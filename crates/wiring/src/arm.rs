//! Both arms: their backends, the layers in front of them, and the joint sources of the simulated workcell.

use std::sync::mpsc::sync_channel;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10::arm::{
    ArmMonitor, KeyedTcp, Pa10Arm, Pa10ArmConfig, TripHandle, TripSeat, VirtualTime, read_shared_key, trip_line,
    virtual_trip_line,
};
use pb3dp_arm_pa10::driver::{DriverConfig, LimitsCheck};
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_emulation::far_end::FarEnd;
use pb3dp_arm_pa10_emulation::line::mock_server::{MockFace, MockPort, MockServer, MockServerConfig};
use pb3dp_arm_pa10_emulation::line::virtual_end::VirtualEnd;
use pb3dp_arm_pa10_emulation::mock::{MockArm, MockArmConfig};
use pb3dp_arm_pa10_emulation::mock_controller::{MockController, MockControllerConfig, Script, pa10_joints};
use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig};
use pb3dp_arm_pa10_protocol::gateway_protocol::Firmware;
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_cell::cell::{ArmSite, JointSource};
use pb3dp_cell::flight::FLIGHT;
use pb3dp_cell::parts::{ArmControl, EmulatedArm, GatewayLimits, LinkCounts, LinkMonitor};
use pb3dp_hal_api::{Arm, ArmPower, Clock, JointState};
use pb3dp_hal_middleware::{FlightLog, Guard, Limiter, Recorded, SampleListener, couple};
use pb3dp_hal_platform::jitter::Jitter;
use pb3dp_hal_platform::only_program::OnlyProgram;
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_hal_platform::transport::Connector;
use pb3dp_setup::setup::{ArmLink, ArmSetup, GatewayWay, Setup};
use pb3dp_sim::joint_dynamics::{JointPlant, JointPlantConfig};

use super::gateway_check;
use super::nominal_calibration::EMULATION;
use super::simulated_arms::{SharedPlant, SimulatedArm};
use super::sole_program::sole_program;

/// Largest difference between the limits in a controller's EEPROM and those of the robot description, degrees.
pub const LIMITS_TOLERANCE_DEG: f64 = 0.5;

/// An emulated arm takes its speed from the link; this rate only has to be high enough.
const EMULATED_BAUD: u32 = 921_600;

/// Thread priority of an emulated arm, between control loop and arm driver: a real arm waits for no process.
const EMULATION_PRIORITY: u8 = 45;

/// Capacity for measured joints that are not consumed yet: two seconds at 500 Hz.
const JOINTS_WAITING_MAX: usize = 1000;

/// Both arms with all layers in front of them.
pub struct WiredArms {
    /// Their base poses and joint sources in the workcell.
    pub sites: [ArmSite; 2],
    /// Their motion interfaces.
    pub driven: [Box<dyn ArmControl>; 2],
    /// Their flight recorders.
    pub flights: [(&'static str, FlightLog); 2],
    /// Link monitors; arms without a link have none.
    pub monitors: Vec<(&'static str, ArmMonitor)>,
    /// The emulated arms at the other ends of the links.
    pub emulated: Vec<MockServer>,
    /// Arms that are emulated in simulated time.
    pub standing: Vec<SimulatedArm>,
}

/// The link of a real or emulated arm.
pub(super) struct MonitoredLink {
    pub monitor: ArmMonitor,
    pub period: Duration,
}

impl LinkMonitor for MonitoredLink {
    fn period(&self) -> Duration {
        self.period
    }

    fn lateness(&self) -> Jitter {
        self.monitor.jitter()
    }

    fn counts(&self) -> LinkCounts {
        let counters = self.monitor.snapshot().counters;
        LinkCounts { missed: counters.overruns, replies_lost: counters.lost }
    }

    fn gateway_limits(&self) -> Option<GatewayLimits> {
        let axes = self.monitor.snapshot().gateway_found?.limits.axes.map(|axis| axis.to_si());
        Some(GatewayLimits {
            speed_max_rad_per_s: axes.map(|axis| axis.speed_max_rad_per_s),
            range_rad: [0, 1].map(|end| axes.map(|axis| axis.range_rad[end])),
        })
    }
}

/// An arm that is emulated in this process, in real time.
pub(super) struct EmulatedServer(pub MockServer);

impl EmulatedArm for EmulatedServer {
    fn command_line(&self, line: &str) -> anyhow::Result<()> {
        Ok(self.0.command_line(line)?)
    }
}

/// Wires both arms: the one with the cameras, the one with the target. `time` is the time of `clock`, if it is simulated.
/// Order from the inside out: backend, recorder, guard, coupling, limiter.
///
/// # Errors
/// If a part refuses its parameters, or an arm does not answer.
pub fn wire_arms(setup: &Setup, clock: &Arc<dyn Clock>, time: Option<&Arc<VirtualTime>>) -> Result<WiredArms> {
    wire_arms_to(setup, clock, time, &[])
}

/// As [`wire_arms`], to emulated arms that another program has moved before.
pub(super) fn wire_arms_to(
    setup: &Setup,
    clock: &Arc<dyn Clock>,
    time: Option<&Arc<VirtualTime>>,
    standing: &[SimulatedArm],
) -> Result<WiredArms> {
    let (vs_name, tc_name) = ("vs-robot", "tc-robot");
    let seats = match time {
        None => trip_line(2).context("the trip line between the arms")?,
        Some(_) => virtual_trip_line(2),
    };
    let mut seats = seats.into_iter();
    let mut seat = || seats.next().context("a seat on the trip line between the arms");
    let wanted = |name, arm| Wanted {
        standing: standing.iter().find(|arm| arm.name == name),
        ..Wanted { name, arm, control_period: setup.control_period, clock, time, standing: None }
    };
    let (vs_wanted, tc_wanted) = (wanted(vs_name, &setup.rig.arms.vs), wanted(tc_name, &setup.rig.arms.tc));
    // Before a port opens.
    [vs_wanted.arm, tc_wanted.arm].into_iter().try_for_each(ArmSetup::check_signals)?;
    let sole = sole_program(&[vs_wanted.arm, tc_wanted.arm])?;
    let (vs, tc) = (wire_backend(vs_wanted, seat()?, &sole)?, wire_backend(tc_wanted, seat()?, &sole)?);
    let (vs_guarded, vs_flight) = guarded(vs_wanted, vs.backend, vs.trip, vs.listener)?;
    let (tc_guarded, tc_flight) = guarded(tc_wanted, tc.backend, tc.trip, tc.listener)?;
    let pair = ((vs_guarded, setup.rig.arms.vs.coupled()), (tc_guarded, setup.rig.arms.tc.coupled()));
    let (vs_coupled, tc_coupled) = couple(pair.0, pair.1, setup.rig.least_room_m, clock).context("table [arms]")?;
    let monitors = [(vs_name, vs.monitor), (tc_name, tc.monitor)];
    Ok(WiredArms {
        sites: [vs.site, tc.site],
        driven: [limited(vs_wanted, vs_coupled)?, limited(tc_wanted, tc_coupled)?],
        flights: [(vs_name, vs_flight), (tc_name, tc_flight)],
        monitors: monitors.into_iter().filter_map(|(name, monitor)| Some((name, monitor?))).collect(),
        standing: [(vs_name, &vs.emulated), (tc_name, &tc.emulated)].into_iter().filter_map(standing_arm).collect(),
        emulated: [vs.emulated, tc.emulated].into_iter().flatten().filter_map(Emulation::into_server).collect(),
    })
}

/// Wires one arm alone, without the other one, for commissioning. From the inside out: backend, recorder, guard, limiter.
///
/// # Errors
/// If a part refuses its parameters, or the arm does not answer.
pub(super) fn wire_alone(wanted: Wanted<'_>) -> Result<SingleArm> {
    wanted.arm.check_signals()?;
    let sole = sole_program(&[wanted.arm])?;
    let wired = wire_backend(wanted, alone()?, &sole)?;
    let (guarded, flight) = guarded(wanted, wired.backend, wired.trip, wired.listener)?;
    let emulated = wired.emulated.and_then(Emulation::into_server);
    Ok(SingleArm { driven: limited(wanted, guarded)?, monitor: wired.monitor, flight, emulated })
}

/// A seat on a trip line without other seats.
pub(super) fn alone() -> Result<TripSeat> {
    trip_line(1)?.pop().context("a seat on the trip line between the arms")
}

/// One arm with all layers in front of it, without the other arm.
pub struct SingleArm {
    /// Its motion interface.
    pub driven: Box<dyn ArmControl>,
    /// Monitor of its link, if it has one.
    pub monitor: Option<ArmMonitor>,
    /// Its flight recorder.
    pub flight: FlightLog,
    /// The emulated arm at the other end, if there is one.
    pub emulated: Option<MockServer>,
}

/// An arm to be wired.
#[derive(Clone, Copy)]
pub(super) struct Wanted<'a> {
    /// Name in messages.
    pub name: &'a str,
    /// Its part of the setup.
    pub arm: &'a ArmSetup,
    /// Control period.
    pub control_period: Duration,
    /// The clock, shared by all arms.
    pub clock: &'a Arc<dyn Clock>,
    /// The simulated time of the clock; none in real time, where links and emulated arms have threads.
    pub time: Option<&'a Arc<VirtualTime>>,
    /// The arm in simulated time, if another program has moved it before.
    pub standing: Option<&'a SimulatedArm>,
}

fn guarded(
    wanted: Wanted<'_>,
    backend: Box<dyn Backend>,
    trip: Option<TripHandle>,
    listener: Option<SampleListener>,
) -> Result<(GuardedArm, FlightLog)> {
    let Wanted { name, arm, control_period, clock, .. } = wanted;
    let cycles = FLIGHT.as_secs_f64() / control_period.as_secs_f64();
    let flight = FlightLog::with_capacity(cycles.ceil() as usize);
    let recorded = Recorded::new(backend, Arc::clone(clock), flight.clone()).with_listener(listener);
    let guard = Guard::new(recorded, arm.limits, arm.guard.clone()).with_context(|| format!("{name}: guard"))?;
    // A joint that does not follow its drive is held only by its brake.
    let guard = match trip {
        Some(trip) => guard.on_stop(move || trip.trip()),
        None => guard,
    };
    Ok((guard, flight))
}

fn limited<A: Arm + ArmPower + 'static>(wanted: Wanted<'_>, inner: A) -> Result<Box<dyn ArmControl>> {
    let limiter = Limiter::new(inner, wanted.arm.limits, wanted.arm.limiter.clone(), Arc::clone(wanted.clock));
    Ok(Box::new(limiter.with_context(|| format!("{}: limiter", wanted.name))?))
}

/// A wired backend.
struct WiredBackend {
    site: ArmSite,
    backend: Box<dyn Backend>,
    monitor: Option<ArmMonitor>,
    trip: Option<TripHandle>,
    /// Copies the measurements to the simulated workcell.
    listener: Option<SampleListener>,
    emulated: Option<Emulation>,
}

/// The far end of an emulated arm.
pub(super) enum Emulation {
    /// On a thread.
    Server(MockServer),
    /// In simulated time.
    Virtual(VirtualEnd, SharedPlant),
}

impl Emulation {
    /// The emulated arm on a thread, if it is one.
    pub(super) fn into_server(self) -> Option<MockServer> {
        match self {
            Self::Server(server) => Some(server),
            Self::Virtual(..) => None,
        }
    }
}

/// Wires the configured backend. An arm that is not emulated keeps the right to be moved by this program.
fn wire_backend(wanted: Wanted<'_>, seat: TripSeat, sole: &Option<Arc<OnlyProgram>>) -> Result<WiredBackend> {
    let Wanted { name, arm, control_period, clock, .. } = wanted;
    let Some((line, emulated)) = line(wanted)? else {
        let plant = shared_plant(arm.plant.clone(), wanted)?;
        let config =
            MockArmConfig { name: name.to_owned(), cycle: control_period, command_timeout: arm.command_timeout };
        let mock = MockArm::new(config, Arc::clone(&plant), Arc::clone(clock));
        let site = ArmSite::of(arm, JointSource::plant(plant));
        return Ok(WiredBackend {
            site,
            backend: Box::new(mock),
            monitor: None,
            trip: None,
            listener: None,
            emulated: None,
        });
    };
    let opened = open(line, seat, wanted)?;
    let (monitor, trip) = (Some(opened.monitor()), Some(opened.trip_handle()));
    if let Some((emulation, plant)) = emulated {
        let site = ArmSite::of(arm, JointSource::plant(plant));
        return Ok(WiredBackend {
            site,
            backend: Box::new(opened),
            monitor,
            trip,
            listener: None,
            emulated: Some(emulation),
        });
    }
    // The joints are not simulated in this process: the workcell uses the measured ones.
    let (sender, samples) = sync_channel(JOINTS_WAITING_MAX);
    let sole = sole.clone();
    let listener = move |measured: &JointState| {
        // The right to move this arm lasts as long as the arm itself.
        let _kept = &sole;
        // Measurements that the workcell does not consume in time are dropped.
        sender.try_send(*measured).ok();
    };
    let site = ArmSite::of(arm, JointSource::measured(samples, arm.start_rad));
    let listener: SampleListener = Box::new(listener);
    Ok(WiredBackend { site, backend: Box::new(opened), monitor, trip, listener: Some(listener), emulated: None })
}

/// The link to an arm, with the emulated arm and its joints if there is one at the far end; `None` if the arm is simulated in process.
pub(super) fn line(wanted: Wanted<'_>) -> Result<Option<(Line<'_>, Option<ArmAndPlant>)>> {
    Ok(Some(match &wanted.arm.link {
        ArmLink::InProcess => return Ok(None),
        ArmLink::Gateway(link, GatewayWay::Emulated) => {
            if let Some(time) = wanted.time {
                let (end, plant) = match wanted.standing {
                    Some(arm) => (arm.end.clone(), Arc::clone(&arm.plant)),
                    None => emulate_virtually(link, wanted)?,
                };
                let emulation = Emulation::Virtual(end.clone(), Arc::clone(&plant));
                return Ok(Some((Line::Virtual(link, end, time), Some((emulation, plant)))));
            }
            let (server, plant) = emulate(MockFace::Pty, link, wanted)?;
            let port = Box::new(emulated_port(link, &server));
            (Line::Gateway(link, port), Some((Emulation::Server(server), plant)))
        }
        ArmLink::Gateway(link, GatewayWay::Serial { path, baud }) => {
            (Line::Gateway(link, Box::new(SerialConfig::of_link(path.clone(), *baud, link))), None)
        }
        ArmLink::Gateway(link, GatewayWay::Tcp { tcp, key_file }) => {
            let key = read_shared_key(key_file).with_context(|| format!("{}.gateway.key_file", wanted.arm.key))?;
            (Line::Gateway(link, Box::new(KeyedTcp { tcp: *tcp, key, arm: link.arm })), None)
        }
        ArmLink::Gateway(link, GatewayWay::Local(socket)) => (Line::Gateway(link, Box::new(socket.clone())), None),
    }))
}

/// An emulated arm and its joints.
type ArmAndPlant = (Emulation, SharedPlant);

/// Interface of every backend.
trait Backend: Arm + ArmPower {}

impl<A: Arm + ArmPower> Backend for A {}

type GuardedArm = Guard<Recorded<Box<dyn Backend>>>;

/// The arm with this name, if it is emulated in simulated time.
fn standing_arm((name, emulated): (&'static str, &Option<Emulation>)) -> Option<SimulatedArm> {
    let Some(Emulation::Virtual(end, plant)) = emulated else { return None };
    Some(SimulatedArm { name, end: end.clone(), plant: Arc::clone(plant) })
}

fn shared_plant(config: JointPlantConfig, wanted: Wanted<'_>) -> Result<SharedPlant> {
    let Wanted { name, arm, clock, .. } = wanted;
    let plant = JointPlant::new(config, arm.start_rad, clock.now()).with_context(|| format!("{name}: start"))?;
    Ok(Arc::new(Mutex::new(plant)))
}

/// The emulated far end of this arm's link, and its pose in the workcell, for a world simulated around the program.
///
/// # Errors
/// If the arm has no gateway, or the emulation cannot be created.
pub fn far_side(
    (name, arm): (&str, &ArmSetup),
    face: impl FnOnce(GatewayConfig) -> MockFace,
    clock: &Arc<dyn Clock>,
) -> Result<(MockServer, ArmSite)> {
    let ArmLink::Gateway(link, _) = &arm.link else { bail!("{name}: this emulation needs an arm with a gateway") };
    let wanted = Wanted { name, arm, control_period: link.cycle, clock, time: None, standing: None };
    let (server, plant) = emulate(face, link, wanted)?;
    Ok((server, ArmSite::of(arm, JointSource::plant(plant))))
}

/// An emulated arm at its host address, with the configured joints. The link adds its own delay.
pub(super) fn emulate(
    face: impl FnOnce(GatewayConfig) -> MockFace,
    link: &GatewayLinkConfig,
    wanted: Wanted<'_>,
) -> Result<(MockServer, SharedPlant)> {
    let Wanted { name, arm, clock, .. } = wanted;
    let (controller, gateway, plant) = emulated_parts(link, wanted)?;
    let realtime = Realtime { priority: Some(EMULATION_PRIORITY), locks_memory: false, cpu: None };
    let config = MockServerConfig { controller, seed: arm.emulation_seed, script: Script::default(), realtime };
    let server = MockServer::start(config, face(gateway), Arc::clone(&plant), Arc::clone(clock))
        .with_context(|| format!("{name}: emulation"))?;
    Ok((server, plant))
}

/// The same in simulated time.
fn emulate_virtually(link: &GatewayLinkConfig, wanted: Wanted<'_>) -> Result<(VirtualEnd, SharedPlant)> {
    let Wanted { name, arm, clock, .. } = wanted;
    let (controller, gateway, plant) = emulated_parts(link, wanted)?;
    let now = clock.now();
    let controller = MockController::new(controller, Arc::clone(&plant), arm.emulation_seed, now);
    let controller = controller.with_context(|| format!("{name}: emulation"))?;
    let gateway = Gateway::new(gateway, now).with_context(|| format!("{name}: emulation"))?;
    let end = VirtualEnd::new(FarEnd::new(controller, Some(gateway), now), EMULATED_BAUD);
    Ok((if let Some(key) = arm.emulation_key { end.with_key(key, link.arm) } else { end }, plant))
}

/// The parts of an emulated arm, and its joints.
fn emulated_parts(
    link: &GatewayLinkConfig,
    wanted: Wanted<'_>,
) -> Result<(MockControllerConfig, GatewayConfig, SharedPlant)> {
    let arm = wanted.arm;
    let joints = JointPlantConfig {
        command_delay: Duration::ZERO,
        acceleration_max_rad_per_s2: pa10_joints()?.acceleration_max_rad_per_s2,
        ..arm.plant.clone()
    };
    let plant = shared_plant(joints, wanted)?;
    let servo = arm.limits.servo();
    let controller = MockControllerConfig {
        lower_limit_rad: *servo.position_min_rad(),
        upper_limit_rad: *servo.position_max_rad(),
        ..MockControllerConfig::new(link.format)
    };
    let firmware = Firmware::new(EMULATION).context("a name for the gateway")?;
    let gateway = GatewayConfig {
        geometry: link.geometry,
        signals: link.signals,
        ..GatewayConfig::new(link.arm, link.format, firmware, link.limits.allowed)
    };
    Ok((controller, gateway, plant))
}

/// The port of an emulated arm, for any terminal.
fn emulated_port(link: &GatewayLinkConfig, server: &MockServer) -> MockPort {
    server.port(SerialConfig { path: server.address(), baud: EMULATED_BAUD, cycle: link.cycle })
}

/// The link to an arm.
pub(super) enum Line<'a> {
    /// A byte stream with a gateway at its end.
    Gateway(&'a GatewayLinkConfig, Box<dyn Connector>),
    /// The same in simulated time.
    Virtual(&'a GatewayLinkConfig, VirtualEnd, &'a Arc<VirtualTime>),
}

impl Line<'_> {
    /// Its far end, for messages.
    pub(super) fn target(&self) -> String {
        match self {
            Self::Gateway(_, connector) => connector.target(),
            Self::Virtual(..) => "emulated in simulated time".to_owned(),
        }
    }
}

fn open(line: Line<'_>, seat: TripSeat, wanted: Wanted<'_>) -> Result<Pa10Arm> {
    let Wanted { name, arm, .. } = wanted;
    let servo = arm.limits.servo();
    let limits = LimitsCheck::Compare {
        lower_rad: *servo.position_min_rad(),
        upper_rad: *servo.position_max_rad(),
        tolerance_rad: LIMITS_TOLERANCE_DEG.to_radians(),
    };
    let opened = connect(line, (seat, limits), wanted)?;
    for warning in opened.warnings() {
        tracing::warn!("{name}: {warning}");
    }
    let snapshot = opened.monitor().snapshot();
    if let Some(refusal) =
        snapshot.gateway.and_then(|hello| gateway_check::watchdog_refusal(arm.command_timeout, &hello))
    {
        bail!("{name} cannot be used: {refusal}");
    }
    if let Some(latched) = snapshot.latched {
        let arm = name.split('-').next().unwrap_or(name);
        bail!(
            "{name} cannot be used: {}; it was latched before this run; reset it with `pb3dp arm reset --config FILE --arm {arm}`",
            latched.trip
        );
    }
    Ok(opened)
}

/// Opens the link to an arm and checks the arm; its brakes stay closed.
pub(super) fn connect(line: Line<'_>, (seat, limits): (TripSeat, LimitsCheck), wanted: Wanted<'_>) -> Result<Pa10Arm> {
    let Wanted { name, arm, clock, .. } = wanted;
    let clock = Arc::clone(clock);
    let config = |link: &GatewayLinkConfig| {
        let driver = DriverConfig {
            limits,
            deceleration_rad_per_s2: *arm.limits.acceleration_max_rad_per_s2(),
            signals: link.signals,
            ..DriverConfig::with_cycle(link.cycle)
        };
        Pa10ArmConfig::new(name, driver, *link)
    };
    Ok(match line {
        Line::Virtual(link, end, time) => Pa10Arm::open_virtual(config(link), Box::new(end), time, seat)?,
        Line::Gateway(link, connector) => {
            let opened = Pa10Arm::open(config(link), connector, clock, seat)?;
            if let Some(hello) = &opened.monitor().snapshot().gateway {
                gateway_check::tell(name, link.geometry, hello);
            }
            opened
        }
    })
}
