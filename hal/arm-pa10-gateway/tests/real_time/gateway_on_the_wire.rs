//! Somebody on the wire between host and gateway, without the key: records of a connection that moves the arm are repeated, exchanged
//! or left out. The gateway ends the connection, and the arm stops.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::os::fd::BorrowedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use pb3dp_arm_pa10_test_support::world::{Host, LONG, keyed, ms};
use pb3dp_hal_platform::tcp::{TcpConfig, TcpLink};
use pb3dp_hal_platform::transport::{ByteLink, Unplugged};
use pb3dp_test_support::in_real_time_beside_others;

use super::gateway_access::started;

/// What is done once to the records on their way to the gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Meddling {
    Repeat = 1,
    Exchange,
    LeaveOut,
}

/// A line on which somebody meddles once, when `wanted` has the number of a [`Meddling`].
struct Meddled {
    line: TcpLink,
    wanted: Arc<AtomicU8>,
    /// The record that comes after the next one.
    held: Option<Vec<u8>>,
}

impl ByteLink for Meddled {
    fn name(&self) -> &str {
        self.line.name()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        self.line.try_read(buffer)
    }

    /// A host writes one record at a time, and loopback takes it whole.
    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        let wanted = self.wanted.swap(0, Ordering::SeqCst);
        if wanted == Meddling::Exchange as u8 {
            self.held = Some(bytes.to_vec());
            return Ok(bytes.len());
        }
        if wanted == Meddling::LeaveOut as u8 {
            return Ok(bytes.len());
        }
        let again = (wanted == Meddling::Repeat as u8).then(|| bytes.to_vec());
        let count = self.line.try_write(bytes)?;
        assert_eq!(count, bytes.len(), "a record was divided");
        for record in [again, self.held.take()].into_iter().flatten() {
            self.line.try_write(&record)?;
        }
        Ok(count)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.line.fd()
    }
}

#[test]
fn records_that_are_repeated_exchanged_or_left_out_end_the_connection_and_the_motion() {
    for meddling in [Meddling::Repeat, Meddling::Exchange, Meddling::LeaveOut] {
        in_real_time_beside_others(|| {
            let (server, emulation, address) = started();
            let wanted = Arc::new(AtomicU8::new(0));
            let line = TcpLink::connect(&TcpConfig { address }).unwrap();
            let line = Meddled { line, wanted: Arc::clone(&wanted), held: None };
            let mut host = Host::new(Box::new(keyed(address).open(line).unwrap()));
            host.open();
            host.lead_to_moving();
            assert!(!emulation.observed().is_braked);
            wanted.store(meddling as u8, Ordering::SeqCst);
            assert!(host.run_for(LONG, |host| host.is_gone), "{meddling:?}: the connection stays open");
            emulation.wait_for("braked", |observed| observed.is_braked);
            let rested_rad = emulation.observed().position_rad;
            std::thread::sleep(ms(100));
            assert_eq!(emulation.observed().position_rad, rested_rad, "{meddling:?}");
            drop(server);
        });
    }
}
