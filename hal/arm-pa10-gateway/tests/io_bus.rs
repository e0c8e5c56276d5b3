//! The bus through the kernel: a packet socket on an ARCNET interface whose other end is a TUN device, and a socket in its place.

#![allow(clippy::unwrap_used, reason = "a test may fail")]

use std::time::Duration;

use pb3dp_arm_pa10_gateway::bus::{
    ArcnetError, ArcnetSocket, BusPort, FRAME_ROOM, FrameListener, FrameSocket, FrameSocketError,
};
use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{ArmCommand, AxisCommand, ControlMessage, ControlPacket, Supervision, WireFormat};
use pb3dp_arm_pa10_test_support::tunnel::Tunnel;
use pb3dp_hal_platform::transport::Symptom;
use pb3dp_test_support::not_checked;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

/// A test fails after this time without progress.
const LONG: Timespec = Timespec { tv_sec: 5, tv_nsec: 0 };

fn frame(format: WireFormat) -> arcnet::Frame {
    let command = ArmCommand::uniform(AxisCommand::Off, Supervision::default());
    let packet = ControlPacket { sequence: 9, message: ControlMessage::Cyclic(command) }.encode(format).unwrap();
    arcnet::encode(Route::TO_CONTROLLER, &packet).unwrap()
}

fn receive(port: &mut dyn BusPort) -> Vec<u8> {
    let mut buffer = [0; FRAME_ROOM];
    loop {
        if let Some(count) = port.try_receive(&mut buffer).unwrap() {
            return buffer[..count].to_vec();
        }
        let mut fds = [PollFd::from_borrowed_fd(port.fd(), PollFlags::IN)];
        assert_eq!(poll(&mut fds, Some(&LONG)), Ok(1), "nothing came");
    }
}

/// In its own network namespace, so that the machine is not affected; for the calling thread.
fn tunnel(name: &str) -> Result<Tunnel, String> {
    // SAFETY: no pointers are passed; only this thread changes its network namespace.
    if unsafe { libc::unshare(libc::CLONE_NEWNET) } != 0 {
        return Err(format!("no network of its own: {}", std::io::Error::last_os_error()));
    }
    Tunnel::open(name).map_err(|error| format!("no tunnel: {error}"))
}

#[test]
fn frames_go_through_an_arcnet_interface_whole() {
    let mut tunnel = match tunnel("arctest0") {
        Ok(tunnel) => tunnel,
        Err(why) => return not_checked("io_bus::frames_go_through_an_arcnet_interface_whole", &why),
    };
    assert_eq!(ArcnetSocket::open("arctest0").unwrap_err(), ArcnetError::Down { name: "arctest0".into() });
    tunnel.switch(true).unwrap();
    let first = ArcnetSocket::open("arctest0").unwrap();
    assert_eq!(ArcnetSocket::open("arctest0").unwrap_err(), ArcnetError::InUse { name: "arctest0".into() });
    drop(first);
    let mut port = ArcnetSocket::open("arctest0").unwrap();
    for format in WireFormat::ALL {
        let frame = frame(format);
        assert_eq!(port.try_send(&frame), Ok(true));
        assert_eq!(receive(&mut tunnel), frame.as_slice());
        assert_eq!(tunnel.try_send(&frame), Ok(true));
        assert_eq!(receive(&mut port), frame.as_slice());
    }
    assert_eq!(port.try_receive(&mut [0; FRAME_ROOM]), Ok(None));
    tunnel.switch(false).unwrap();
    let down = port.try_send(&frame(WireFormat::ALL[0])).unwrap_err();
    assert!(down.to_string().contains("the bus is down"), "{down}");
    // Up again the same bus works, after the kernel has reported once more that it was down.
    tunnel.switch(true).unwrap();
    assert_eq!(port.try_send(&frame(WireFormat::ALL[0])), Err(down));
    assert_eq!(port.try_send(&frame(WireFormat::ALL[0])), Ok(true));
    // A removed interface is gone for good.
    drop(tunnel);
    let gone = port.try_send(&frame(WireFormat::ALL[0])).unwrap_err();
    assert!(gone.to_string().contains("the bus is down"), "{gone}");
    assert_eq!(ArcnetSocket::open("arctest0").unwrap_err(), ArcnetError::Missing { name: "arctest0".into() });
}

#[test]
fn an_interface_that_is_none_is_refused_by_name() {
    for name in ["", "no-such-if0", "../../etc", "a\0b", "a-name-that-is-too-long"] {
        let error = ArcnetSocket::open(name).unwrap_err();
        assert_eq!(error, ArcnetError::Missing { name: name.into() });
        assert!(error.to_string().contains("arc_rawmode"), "{error}");
    }
    let error = ArcnetSocket::open("lo").unwrap_err();
    assert_eq!(error, ArcnetError::OtherKind { name: "lo".into(), got: 772 });
}

#[test]
fn a_socket_in_the_place_of_the_bus_keeps_frames_apart() {
    let folder = std::env::temp_dir().join(format!("pb3dp-bus-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("bus");
    assert_eq!(FrameSocket::connect(&path).unwrap_err(), FrameSocketError::Nobody { path: path.clone() });
    let listener = FrameListener::bind(&path).unwrap();
    assert!(listener.try_accept().unwrap().is_none());
    let mut gateway = FrameSocket::connect(&path).unwrap();
    let mut controller = listener.try_accept().unwrap().unwrap();
    assert_eq!(FrameListener::bind(&path).unwrap_err(), FrameSocketError::InUse { path: path.clone() });
    for count in 1..=3u8 {
        assert_eq!(gateway.try_send(&vec![count; 40 * usize::from(count)]), Ok(true));
    }
    for count in 1..=3u8 {
        assert_eq!(receive(&mut controller), vec![count; 40 * usize::from(count)]);
    }
    assert_eq!(controller.try_send(&[7, 8]), Ok(true));
    assert_eq!(receive(&mut gateway), [7, 8]);
    assert_eq!(gateway.try_receive(&mut [0; FRAME_ROOM]), Ok(None));
    // A controller that does not read: frames are lost, and nothing blocks.
    let mut sent = 0;
    while gateway.try_send(&[0; 40]).unwrap() {
        sent += 1;
        assert!(sent < 1_000_000);
    }
    drop(controller);
    let gone = gateway.try_receive(&mut [0; FRAME_ROOM]).unwrap_err();
    assert!(matches!(gone.symptom, Symptom::EndOfStream | Symptom::Os(_)), "{gone}");
    assert!(gateway.try_send(&[1]).is_err());
    drop(listener);
    assert!(!path.exists());
    // The socket of a killed program is replaced; a file that is not a socket is left alone.
    drop(std::os::unix::net::UnixListener::bind(&path).unwrap());
    drop(FrameListener::bind(&path).unwrap());
    std::fs::write(&path, "notes").unwrap();
    assert!(matches!(FrameListener::bind(&path).unwrap_err(), FrameSocketError::Os { .. }));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "notes");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn sleeping_to_a_moment_ends_after_it_and_soon() {
    use pb3dp_hal_platform::realtime::{Realtime, enter, now, sleep_until};
    let shortfalls = std::thread::spawn(|| {
        let wanted = Realtime { priority: Some(10), locks_memory: false, cpu: Some(0) };
        enter(&wanted)
    });
    for shortfall in shortfalls.join().unwrap() {
        let text = shortfall.to_string();
        assert!(text.contains("is not available"), "{text}");
    }
    let never = Realtime { priority: Some(0), locks_memory: false, cpu: Some(1 << 20) };
    let texts = enter(&never).iter().map(ToString::to_string).collect::<Vec<_>>();
    assert!(texts[0].contains("SCHED_FIFO with priority 0") && texts[0].contains("CAP_SYS_NICE"), "{texts:?}");
    assert!(texts[1].contains("processor 1048576"), "{texts:?}");
    for _ in 0..20 {
        let deadline = now() + Duration::from_millis(3);
        sleep_until(deadline);
        assert!(now() >= deadline);
        assert!(now().saturating_since(deadline) < Duration::from_secs(2));
        sleep_until(deadline);
    }
}
