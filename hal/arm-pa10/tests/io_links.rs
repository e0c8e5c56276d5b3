//! Byte links: bytes are transferred, a lost peer is one error, and nothing blocks.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::fs::File;
use std::io::{Read, Write};
use std::time::{Duration, Instant};

use pb3dp_arm_pa10_test_support::byte_links::{LONG, read_exactly};
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::{ByteLink, Symptom, judge, pair, wait};
use rustix::io::Errno;

#[test]
fn bytes_go_through_a_pair_both_ways() {
    let (mut host, mut peer) = pair("test").unwrap();
    assert_eq!(host.try_read(&mut [0; 8]), Ok(0));
    assert_eq!(host.try_write(&[1, 2, 0, 0xA5]), Ok(4));
    assert_eq!(peer.try_write(&[9]), Ok(1));
    assert_eq!(read_exactly(&mut peer, 4), [1, 2, 0, 0xA5]);
    assert_eq!(read_exactly(&mut host, 1), [9]);
    assert!(host.name().contains("test"), "{}", host.name());
}

#[test]
fn a_pseudo_terminal_is_raw_from_the_start() {
    let mut pty = Pty::open().unwrap();
    // Bytes with a special meaning in a terminal: end of file, interrupt, return, xoff. They arrive before the line is opened.
    let bytes = [4, 3, 13, 10, 0x13, 0x11, 0xFF, 0, 0x7F];
    assert_eq!(pty.try_write(&bytes), Ok(bytes.len()));
    let mut line = File::options().read(true).write(true).open(pty.path()).unwrap();
    let mut got = [0; 9];
    line.read_exact(&mut got).unwrap();
    assert_eq!(got, bytes);
    line.write_all(&bytes).unwrap();
    assert_eq!(read_exactly(&mut pty, bytes.len()), bytes);
    // No echo, and a closed line can be opened again.
    assert_eq!(pty.try_read(&mut got), Ok(0));
    drop(line);
    assert_eq!(pty.try_read(&mut got), Ok(0));
    File::options().write(true).open(pty.path()).unwrap().write_all(&[7]).unwrap();
    assert_eq!(read_exactly(&mut pty, 1), [7]);
}

#[test]
fn a_peer_that_is_gone_is_one_error_and_ends_the_wait() {
    let (mut host, peer) = pair("test").unwrap();
    drop(peer);
    assert!(wait(Some(&host), false, None, LONG).readable);
    assert_eq!(host.try_read(&mut [0; 8]).unwrap_err().symptom, Symptom::EndOfStream);
    assert_eq!(host.try_write(&[1]).unwrap_err().symptom, Symptom::EndOfStream, "the first symptom stays");
    let text = host.try_read(&mut [0; 8]).unwrap_err().to_string();
    assert!(text.contains("the link is gone (end of the stream)"), "{text}");
}

#[test]
fn every_symptom_is_the_same_error() {
    for number in [Errno::IO, Errno::PIPE, Errno::NODEV, Errno::NXIO, Errno::CONNRESET, Errno::BADF] {
        let gone = judge(Err(number.into()), true).unwrap_err();
        assert_eq!(gone.symptom, Symptom::Os(number));
    }
    assert_eq!(judge(Ok(0), true).unwrap_err().symptom, Symptom::EndOfStream);
    assert_eq!(judge(Ok(0), false), Ok(0));
    assert_eq!(judge(Err(Errno::AGAIN.into()), true), Ok(0));
    assert_eq!(judge(Err(Errno::INTR.into()), true), Ok(0));
}

#[test]
fn a_peer_that_does_not_read_blocks_nobody() {
    let pty = Pty::open().unwrap();
    let (pair_host, _peer) = pair("test").unwrap();
    let links: [Box<dyn ByteLink>; 2] = [Box::new(pty), Box::new(pair_host)];
    for mut link in links {
        let begin = Instant::now();
        let mut taken = 0;
        // Far more than any buffer can store.
        for _ in 0..20_000 {
            taken += link.try_write(&[0x55; 128]).unwrap();
        }
        assert!(taken < 2_560_000, "{}: {taken}", link.name());
        assert_eq!(link.try_write(&[1]), Ok(0), "{}", link.name());
        assert!(!wait(Some(link.as_ref()), true, None, Duration::from_millis(1)).writable, "{}", link.name());
        assert!(begin.elapsed() < LONG, "{}: {:?}", link.name(), begin.elapsed());
    }
}

#[test]
fn a_wait_ends_by_its_bound_or_by_its_waker() {
    let (host, _peer) = pair("test").unwrap();
    let (waker, mut hand) = pair("waker").unwrap();
    let begin = Instant::now();
    let timeout = Duration::from_millis(20);
    let ready = wait(Some(&host), false, waker.fd(), timeout);
    assert!(!ready.readable && !ready.woken && begin.elapsed() >= timeout, "{ready:?}");
    hand.try_write(&[1]).unwrap();
    let ready = wait(Some(&host), false, waker.fd(), LONG);
    assert!(ready.woken && !ready.readable, "{ready:?}");
}
