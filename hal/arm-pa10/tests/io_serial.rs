//! Serial ports over pseudo-terminals, and TCP connections over the loopback.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::fs::File;
use std::net::{SocketAddr, TcpListener};
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::serial::{SerialConfig, SerialError, SerialLink};
use pb3dp_arm_pa10_test_support::byte_links::{LONG, read_exactly};
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::tcp::{TcpConfig, TcpLink};
use pb3dp_hal_platform::transport::{ByteLink, Connector};

pub fn config(path: &str) -> SerialConfig {
    SerialConfig { path: path.to_owned(), baud: 460_800, cycle: Duration::from_millis(10) }
}

pub fn open(pty: &Pty) -> Result<SerialLink, SerialError> {
    SerialLink::open(&config(pty.name()))
}

/// A TCP connection with both ends.
pub fn tcp_pair() -> (TcpLink, TcpLink) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let host = TcpLink::connect(&TcpConfig { address: listener.local_addr().unwrap() }).unwrap();
    (host, TcpLink::from_stream(listener.accept().unwrap().0).unwrap())
}

#[test]
fn every_byte_goes_through_both_ways() {
    let mut pty = Pty::open().unwrap();
    let mut port = open(&pty).unwrap();
    let (mut host, mut peer) = tcp_pair();
    let bytes: Vec<u8> = (0..=255).collect();
    let links: [(&mut dyn ByteLink, &mut dyn ByteLink); 2] = [(&mut port, &mut pty), (&mut host, &mut peer)];
    for (here, there) in links {
        assert_eq!(here.try_read(&mut [0; 8]), Ok(0), "{}", here.name());
        assert_eq!(here.try_write(&bytes), Ok(256), "{}", here.name());
        assert_eq!(read_exactly(there, 256), bytes, "{}", here.name());
        assert_eq!(there.try_write(&bytes), Ok(256), "{}", here.name());
        assert_eq!(read_exactly(here, 256), bytes, "{}", here.name());
    }
    assert_eq!((port.baud(), port.warning()), (460_800, None));
}

#[test]
fn what_came_before_the_port_was_opened_is_forgotten() {
    let mut pty = Pty::open().unwrap();
    pty.try_write(b"of yesterday").unwrap();
    let mut port = open(&pty).unwrap();
    assert_eq!(port.try_read(&mut [0; 64]), Ok(0));
    pty.try_write(&[1]).unwrap();
    assert_eq!(read_exactly(&mut port, 1), [1]);
}

/// The kernel's flag of exclusive use.
fn is_exclusive(pty: &Pty) -> bool {
    const TIOCGEXCL: u32 = 0x8004_5440;
    let line = rustix::fs::open(pty.path(), rustix::fs::OFlags::NOCTTY, rustix::fs::Mode::empty());
    let line = match line {
        Ok(line) => line,
        // A user other than root cannot even open it.
        Err(rustix::io::Errno::BUSY) => return true,
        Err(error) => panic!("{}: {error}", pty.name()),
    };
    // SAFETY: TIOCGEXCL fills an int.
    unsafe { rustix::ioctl::ioctl(line, rustix::ioctl::Getter::<TIOCGEXCL, i32>::new()) }.unwrap() != 0
}

#[test]
fn a_second_owner_is_refused_and_takes_nothing_away() {
    let mut pty = Pty::open().unwrap();
    let mut first = open(&pty).unwrap();
    assert!(is_exclusive(&pty));
    for _ in 0..3 {
        let error = open(&pty).unwrap_err();
        assert!(matches!(error, SerialError::InUse { .. }), "{error:?}");
        assert!(error.to_string().contains(pty.name()), "{error}");
        assert!(is_exclusive(&pty), "the refused one took the mark away");
    }
    first.try_write(&[5]).unwrap();
    assert_eq!(read_exactly(&mut pty, 1), [5]);
    drop(first);
    open(&pty).unwrap();
}

#[test]
fn a_port_that_can_not_be_used_is_refused_by_name() {
    let missing = SerialLink::open(&config("/dev/no-such-port")).unwrap_err();
    assert!(matches!(missing, SerialError::Missing { .. }), "{missing:?}");
    assert!(missing.to_string().contains("/dev/no-such-port does not exist"), "{missing}");
    let file = SerialLink::open(&config("/dev/null")).unwrap_err();
    assert!(matches!(file, SerialError::Open { .. }), "{file:?}");
    let pty = Pty::open().unwrap();
    let slow = SerialLink::open(&SerialConfig { baud: 115_200, ..config(pty.name()) }).unwrap_err();
    let SerialError::TooSlow { source, .. } = &slow else { panic!("{slow:?}") };
    assert!(source.to_string().contains("115200 baud take 15.19"), "{source}");
    // A rate that is too slow is refused before the port is opened.
    assert!(matches!(
        SerialLink::open(&SerialConfig { baud: 115_200, ..config("/dev/no-such-port") }),
        Err(SerialError::TooSlow { .. })
    ));
}

#[test]
fn a_peer_that_does_not_read_blocks_neither_write_nor_close() {
    let pty = Pty::open().unwrap();
    let mut port = open(&pty).unwrap();
    let (mut host, _peer) = tcp_pair();
    let begin = Instant::now();
    for link in [&mut port as &mut dyn ByteLink, &mut host] {
        let mut refused = 0;
        for _ in 0..1_000_000 {
            refused += u32::from(link.try_write(&[0x55; 147]).unwrap() == 0);
            if refused == 100 {
                break;
            }
        }
        assert_eq!(refused, 100, "{}", link.name());
    }
    drop(port);
    assert!(begin.elapsed() < LONG, "{:?}", begin.elapsed());
}

#[test]
fn a_line_is_opened_again_after_it_was_closed() {
    let mut pty = Pty::open().unwrap();
    let mut connector = config(pty.name());
    for round in 0..3u8 {
        let mut link = connector.connect().unwrap();
        link.try_write(&[round]).unwrap();
        assert_eq!(read_exactly(&mut pty, 1), [round]);
    }
    assert!(connector.target().contains("460800 baud"), "{}", connector.target());
}

#[test]
fn where_nobody_listens_there_is_no_connection() {
    let address: SocketAddr = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let error = TcpConfig { address }.connect().err().unwrap();
    assert!(error.to_string().contains(&address.to_string()), "{error}");
}

#[test]
fn a_lock_of_another_program_counts() {
    let pty = Pty::open().unwrap();
    let other = File::open(pty.path()).unwrap();
    rustix::fs::flock(&other, rustix::fs::FlockOperation::NonBlockingLockExclusive).unwrap();
    assert!(matches!(open(&pty), Err(SerialError::InUse { .. })));
}
