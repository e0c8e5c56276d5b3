//! A gateway between an emulated controller and a host, through the kernel and in real time.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "helpers of tests")]

use std::net::SocketAddr;
use std::os::fd::BorrowedFd;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use pb3dp_arm_pa10::arm::{ArmOpenError, Pa10Arm, Pa10ArmConfig, RequestError, trip_line};
use pb3dp_arm_pa10::driver::{DriverConfig, DriverState, Request};
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_emulation::mock_controller::ControlMode;
use pb3dp_arm_pa10_gateway::bus::{BusDown, BusPort, FRAME_ROOM, FrameListener, FrameSocket};
use pb3dp_arm_pa10_gateway::service::{
    Access, BusOpener, GatewayEvent, GatewayServer, GatewayServerConfig, GatewayServerError, Happened, HostSide,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, StopCause};
use pb3dp_arm_pa10_test_support::world::{
    ARM, Emulation, Host, LONG, gateway_config, home, host_link, keyed, ms, tcp_side, test_key, velocity,
};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::local_socket::LocalConfig;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::realtime::{self, Realtime};
use pb3dp_hal_platform::transport::Connector;
use pb3dp_test_support::in_real_time_beside_others;
use pb3dp_test_support::real_time::note_lateness_at;

/// Real-time where permitted; the tests also run without it.
const REALTIME: Realtime = Realtime { priority: Some(20), locks_memory: false, cpu: None };

fn server(host: HostSide) -> (GatewayServer, Emulation) {
    let (gateway, controller) = FrameSocket::pair("bus").unwrap();
    let emulation = Emulation::start(Box::new(controller), Some(ms(400)));
    (start(once(gateway), host), emulation)
}

/// Opens a port that is already open, once.
fn once(port: FrameSocket) -> BusOpener {
    let mut port = Some(port);
    Box::new(move || Ok(Box::new(port.take().ok_or("it was opened before")?) as Box<dyn BusPort>))
}

fn start(bus: BusOpener, host: HostSide) -> GatewayServer {
    let config = GatewayServerConfig { gateway: gateway_config(), realtime: REALTIME };
    GatewayServer::start(config, bus, host).unwrap()
}

fn serial(path: &Path) -> HostSide {
    let path = path.to_str().unwrap().to_owned();
    HostSide::Line(Box::new(SerialConfig { path, baud: 921_600, cycle: ms(10) }))
}

fn connect(address: SocketAddr) -> Host {
    Host::new(keyed(address).connect().unwrap())
}

fn events(server: &GatewayServer) -> Vec<Happened> {
    std::iter::from_fn(|| server.try_event()).map(|GatewayEvent { what, .. }| what).collect()
}

/// Events up to a state.
fn events_until(server: &GatewayServer, wanted: GatewayState) -> Vec<Happened> {
    let (mut happened, since) = (Vec::new(), Instant::now());
    while !matches!(happened.last(), Some(Happened::State { to, .. }) if *to == wanted) {
        assert!(since.elapsed() < LONG, "never {wanted}: {happened:?}");
        match server.try_event() {
            Some(GatewayEvent { what: Happened::Overrun { .. }, .. }) => {}
            Some(event) => happened.push(event.what),
            None => std::thread::sleep(ms(2)),
        }
    }
    happened
}

/// Prints the events of a gateway if the test fails, and records its lateness.
struct Witness<'a>(&'a GatewayServer);

impl Drop for Witness<'_> {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            return;
        }
        // A late thread reports this when it runs again.
        std::thread::sleep(ms(1000));
        while let Some(GatewayEvent { at, what }) = self.0.try_event() {
            if let Happened::Overrun { late } = what {
                // The event is read a second later: the witnesses of the machine are asked about the cycle that began late.
                let ended = Instant::now().checked_sub(realtime::now().saturating_since(at));
                note_lateness_at(ended.unwrap(), late);
            }
            eprintln!("{at:?} {what:?}");
        }
    }
}

fn messages_until(server: &GatewayServer, word: &str) {
    let since = Instant::now();
    loop {
        if server.try_message().is_some_and(|text| text.contains(word)) {
            return;
        }
        assert!(since.elapsed() < LONG, "never said: {word}");
        std::thread::sleep(ms(2));
    }
}

/// From HELLO through motion to a stop.
fn go_up_and_down(host: &mut Host, emulation: &Emulation) {
    host.open();
    host.lead_to_moving();
    assert!(
        host.run_for(ms(500), |_| false) || host.driver.state() == DriverState::Moving,
        "{:?}",
        host.driver.latched()
    );
    let observed = emulation.observed();
    let moved = observed.position_rad - home();
    assert!(moved[6] > 0.25 * velocity()[6], "{moved}");
    host.do_it(Request::Stop);
    host.must_be(DriverState::Connected);
    emulation.wait_for("at rest", |observed| observed.is_braked && observed.mode == ControlMode::Adjustment);
    let counters = emulation.observed().counters;
    assert_eq!((counters.forbidden, counters.malformed, counters.odd, counters.released), (0, 0, 0, 0));
    assert_eq!(counters.watchdog_trips, 0, "E came before the controller stopped by itself");
}

#[test]
fn an_arm_goes_up_and_down_over_a_pseudo_terminal() {
    in_real_time_beside_others(up_and_down_over_a_pseudo_terminal);
}

fn up_and_down_over_a_pseudo_terminal() {
    let pty = Pty::open().unwrap();
    let (server, emulation) = server(serial(pty.path()));
    messages_until(&server, "is open");
    let mut host = Host::new(Box::new(pty));
    let witness = Witness(&server);
    go_up_and_down(&mut host, &emulation);
    drop(witness);
    let mut happened = events_until(&server, GatewayState::Moving);
    happened.extend(events_until(&server, GatewayState::Idle));
    assert!(happened.contains(&Happened::HostGreeted), "{happened:?}");
    let states = happened.iter().filter_map(|what| match what {
        Happened::State { to, .. } => Some(*to),
        _ => None,
    });
    let states = states.collect::<Vec<_>>();
    use GatewayState::{Holding, Idle, Moving, Started};
    assert!(states.windows(3).any(|run| run == [Started, Holding, Moving]), "{states:?}");
    assert_eq!(states.last(), Some(&Idle), "{states:?}");
    let status = server.end().unwrap();
    assert_eq!((status.cause, status.answers_dropped), (StopCause::None, 0));
    // The line ends with its owner.
    assert!(!host.run_for(ms(5), |host| host.is_gone));
}

#[test]
fn a_line_that_is_unplugged_in_motion_stops_the_arm_and_is_tried_again() {
    in_real_time_beside_others(unplugged_in_motion);
}

fn unplugged_in_motion() {
    let pty = Pty::open().unwrap();
    // Another test may get the number of the terminal: the gateway therefore opens a unique name.
    let folder = tempfile::tempdir().unwrap();
    let line = folder.path().join("line");
    std::os::unix::fs::symlink(pty.path(), &line).unwrap();
    let (server, emulation) = server(serial(&line));
    messages_until(&server, "is open");
    let witness = Witness(&server);
    let mut host = Host::new(Box::new(pty));
    host.open();
    host.lead_to_moving();
    drop(witness);
    std::fs::remove_file(&line).unwrap();
    drop(host);
    emulation.wait_for("braked", |observed| observed.is_braked && observed.mode == ControlMode::Adjustment);
    assert_eq!(emulation.observed().counters.watchdog_trips, 0, "the gateway stopped it");
    let happened = events_until(&server, GatewayState::Fault);
    assert!(happened.iter().any(|what| matches!(what, Happened::HostGone(_))), "{happened:?}");
    let silent = |what: &Happened| matches!(what, Happened::State { cause: StopCause::HostSilent, .. });
    assert!(happened.iter().any(silent), "{happened:?}");
    messages_until(&server, "cannot be opened");
}

#[test]
fn a_host_whose_connection_ends_in_motion_is_silent_and_the_next_one_has_to_reset() {
    in_real_time_beside_others(|| {
        let (side, address) = tcp_side();
        connection_ends_in_motion(side, || Box::new(keyed(address)), "127.0.0.1 port ");
    });
}

#[test]
fn the_same_holds_for_a_host_on_the_computer_of_the_gateway() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("arm1.sock");
    let config = LocalConfig { path: path.clone() };
    in_real_time_beside_others(move || {
        let side = HostSide::listen_at_socket(&path, ARM).unwrap();
        connection_ends_in_motion(side, || Box::new(config.clone()), "this computer: end the program there");
    });
    assert!(!folder.path().join("arm1.sock").exists(), "the socket vanishes with the gateway");
}

fn connection_ends_in_motion(side: HostSide, connector: impl Fn() -> Box<dyn Connector>, holder: &str) {
    let connect = || Host::new(connector().connect().unwrap());
    let (server, emulation) = server(side);
    let witness = Witness(&server);
    let mut host = connect();
    host.open();
    host.lead_to_moving();
    // While this host is connected, others are refused, and learn by whom it is held.
    let mut second = connect();
    second.link.open(realtime::now());
    assert!(second.run_for(LONG, |host| host.link.hello_error().is_some()));
    let refused = second.link.hello_error().unwrap().to_string();
    assert!(refused.contains(&format!("the gateway is held by the host at {holder}")), "{refused}");
    messages_until(&server, "was turned away: another host is connected");
    assert!(second.run_for(LONG, |host| host.is_gone));
    host.must_be(DriverState::Moving);
    let link = host_link();
    let config = Pa10ArmConfig::new("second", DriverConfig::with_cycle(link.cycle), link);
    let (connector_of_second, seat) = (connector(), trip_line(1).unwrap().remove(0));
    let open = move || Pa10Arm::open(config, connector_of_second, Arc::new(SystemClock::new()), seat).err();
    let opening = std::thread::spawn(open);
    assert!(host.run_for(LONG, |_| opening.is_finished()));
    let refused = opening.join().unwrap().expect("a second arm was opened");
    assert!(matches!(&refused, ArmOpenError::Connect { source: RequestError::Gateway(_), .. }), "{refused:?}");
    host.must_be(DriverState::Moving);
    // As after kill -9 of the host.
    drop(host);
    emulation.wait_for("braked", |observed| observed.is_braked && observed.mode == ControlMode::Adjustment);
    let mut next = connect();
    next.open();
    assert_eq!(next.link.hello().unwrap().cause, StopCause::HostSilent);
    next.do_it(Request::Connect);
    assert!(next.driver.latched().is_some(), "a latched gateway does not start");
    next.do_it(Request::Reset);
    next.lead_on_to_moving();
    next.must_be(DriverState::Moving);
    drop(witness);
    let happened = events(&server);
    assert!(happened.iter().any(|what| matches!(what, Happened::HostGone(_))), "{happened:?}");
    // The owner ends the gateway during motion, which executes the stop order.
    let status = server.end().unwrap();
    assert_eq!((status.state, status.cause), (GatewayState::Idle, StopCause::None));
    let observed = emulation.observed();
    assert!(observed.is_braked && observed.mode == ControlMode::Adjustment, "{observed:?}");
    assert_eq!(observed.counters.watchdog_trips, 0);
    assert!(next.run_for(LONG, |host| host.is_gone));
    assert!(next.driver.latched().is_some());
}

/// The time that a bus takes to open is no lateness of the first cycle.
#[test]
fn the_first_cycle_is_not_late() {
    in_real_time_beside_others(|| {
        let (gateway, controller) = FrameSocket::pair("bus").unwrap();
        let _emulation = Emulation::start(Box::new(controller), Some(ms(400)));
        let mut open = once(gateway);
        let slow_bus: BusOpener = Box::new(move || {
            std::thread::sleep(ms(300));
            open()
        });
        let (side, _) = tcp_side();
        let server = start(slow_bus, side);
        let witness = Witness(&server);
        let begin = Instant::now();
        let late = std::iter::from_fn(|| {
            std::thread::sleep(ms(1));
            (begin.elapsed() < ms(500)).then(|| server.try_event())
        });
        let late = late.flatten().filter_map(|event| match event.what {
            Happened::Overrun { late } => Some(late),
            _ => None,
        });
        let longest = late.max().unwrap_or_default();
        assert!(longest < ms(250), "{longest:?}");
        drop(witness);
    });
}

#[test]
fn a_connection_that_has_been_silent_for_a_second_gives_way() {
    let (side, address) = tcp_side();
    let (server, _emulation) = server(side);
    // Half-open: the host sends nothing after HELLO, and its end is never reported.
    let mut silent = connect(address);
    silent.open();
    messages_until(&server, "a host connected");
    std::thread::sleep(ms(1200));
    let mut host = connect(address);
    host.open();
    let happened = events(&server);
    assert!(happened.contains(&Happened::HostReplaced), "{happened:?}");
    drop(silent);
}

#[test]
fn a_bus_that_goes_down_stops_the_arm_and_may_come_back() {
    in_real_time_beside_others(bus_goes_down);
}

fn bus_goes_down() {
    let folder = std::env::temp_dir().join(format!("pb3dp-gateway-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("bus");
    let listener = FrameListener::bind(&path).unwrap();
    let its_path = path.clone();
    let (side, address) = tcp_side();
    let opener: BusOpener = Box::new(move || Ok(Box::new(FrameSocket::connect(&its_path)?) as Box<dyn BusPort>));
    let server = start(opener, side);
    let accept = || {
        let since = Instant::now();
        loop {
            if let Some(socket) = listener.try_accept().unwrap() {
                return Box::new(socket);
            }
            assert!(since.elapsed() < LONG);
            std::thread::sleep(ms(2));
        }
    };
    let emulation = Emulation::start(accept(), None);
    let witness = Witness(&server);
    let mut host = connect(address);
    host.open();
    host.lead_to_moving();
    let mut controller = emulation.unplug();
    assert!(host.run_for(LONG, |host| host.driver.state() == DriverState::Fault));
    // The arm still moves long after the stop order was sent in vain.
    host.run_for(ms(700), |_| false);
    controller.advance(realtime::now());
    let (_, speed) = controller.true_joints();
    assert!((speed - velocity()).amax() < 1e-3, "{speed}");
    let emulation = Emulation::carry_on(accept(), controller);
    // The repeated stop order stops it, without a request.
    emulation.wait_for("stopped", |observed| observed.is_braked && observed.mode == ControlMode::Adjustment);
    let resting = emulation.observed().position_rad;
    assert!(host.run_for(LONG, |host| host.driver.activity() == pb3dp_arm_pa10::driver::Activity::None));
    assert!((emulation.observed().position_rad - resting).amax() < 1e-6);
    host.must_be(DriverState::Fault);
    host.do_it(Request::Reset);
    host.must_be(DriverState::Connected);
    drop(witness);
    let happened = events(&server);
    let position =
        |wanted: fn(&Happened) -> bool| happened.iter().position(wanted).unwrap_or_else(|| panic!("{happened:?}"));
    assert!(position(|what| matches!(what, Happened::BusDown(_))) < position(|what| matches!(what, Happened::BusUp)));
    drop((host, server, emulation));
    std::fs::remove_dir_all(&folder).unwrap();
}

/// A bus with a bug: from a moment on, receiving panics once or always.
struct Mistaken {
    port: FrameSocket,
    is_wrong: Arc<AtomicBool>,
    is_wrong_always: bool,
}

impl BusPort for Mistaken {
    fn name(&self) -> &str {
        self.port.name()
    }

    fn try_send(&mut self, frame: &[u8]) -> Result<bool, BusDown> {
        self.port.try_send(frame)
    }

    fn try_receive(&mut self, buffer: &mut [u8; FRAME_ROOM]) -> Result<Option<usize>, BusDown> {
        assert!(!self.is_wrong.fetch_and(self.is_wrong_always, Ordering::SeqCst), "a mistake, for this test");
        self.port.try_receive(buffer)
    }

    fn fd(&self) -> BorrowedFd<'_> {
        self.port.fd()
    }
}

/// R8: a panic of the program does not leave the arm moving.
#[test]
fn a_thread_that_panics_in_motion_stops_the_arm() {
    in_real_time_beside_others(panics_in_motion);
}

fn panics_in_motion() {
    for is_wrong_always in [false, true] {
        let (port, controller) = FrameSocket::pair("bus").unwrap();
        let is_wrong = Arc::new(AtomicBool::new(false));
        let mut port = Some(Mistaken { port, is_wrong: Arc::clone(&is_wrong), is_wrong_always });
        let opener: BusOpener =
            Box::new(move || Ok(Box::new(port.take().ok_or("it was opened before")?) as Box<dyn BusPort>));
        let emulation = Emulation::start(Box::new(controller), Some(ms(400)));
        let (side, address) = tcp_side();
        let server = start(opener, side);
        let witness = Witness(&server);
        let mut host = connect(address);
        host.open();
        host.lead_to_moving();
        drop(witness);
        is_wrong.store(true, Ordering::SeqCst);
        emulation.wait_for("at rest", |observed| observed.is_braked && observed.mode == ControlMode::Adjustment);
        assert_eq!(emulation.observed().counters.watchdog_trips, 0, "the gateway stopped it");
        assert!(host.run_for(LONG, |host| host.driver.latched().is_some()), "the host learns of it");
        assert_eq!(server.end(), None);
    }
}

#[test]
fn what_can_not_be_started_is_refused_by_name() {
    let (side, address) = tcp_side();
    let error = HostSide::listen(address, ARM, Access::from_this_computer(test_key())).err().unwrap();
    assert!(matches!(error, GatewayServerError::Listen { .. }), "{error}");
    let nobody: BusOpener = Box::new(|| Err("nobody there".into()));
    let config = GatewayServerConfig { gateway: gateway_config(), realtime: REALTIME };
    let error = GatewayServer::start(config, nobody, side).unwrap_err();
    assert!(matches!(error, GatewayServerError::Bus(_)), "{error}");
}
