//! How the arms of a cell stop each other.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use pb3dp_arm_pa10_protocol::gateway_protocol::ArmId;
use pb3dp_safeguards::{Safeguard, is_off};
use rustix::event::{EventfdFlags, eventfd};

use crate::driver::{FaultCause, Trip};

/// Nobody has tripped.
const NOBODY: u32 = 0;
/// Not an arm has tripped, but the program.
const SUPERVISOR: u32 = 1;
/// Plus the number of the arm that has tripped.
const ARM: u32 = 0x100;

/// The line along which the arms of a cell stop each other: an arm that stops by a fault or an emergency stop stops all others.
///
/// Tripping is two calls that never wait; the thread of each arm that is tripped wakes up at once.
#[derive(Debug)]
struct Member {
    tripped_by: AtomicU32,
    waker: Waker,
}

/// Wakes the thread of an arm.
#[derive(Debug)]
enum Waker {
    /// Its thread waits for this.
    Event(OwnedFd),
    /// Who simulates its time looks at this.
    Flag(AtomicBool),
}

/// The place of one arm on its line.
#[derive(Debug)]
pub struct TripSeat {
    members: Arc<[Member]>,
    index: usize,
}

/// Stops one arm from anywhere.
#[derive(Clone, Debug)]
pub struct TripHandle {
    members: Arc<[Member]>,
    index: usize,
}

/// A line with a place for each of so many arms.
///
/// # Errors
/// If the operating system has no more file descriptors.
pub fn trip_line(arms: usize) -> std::io::Result<Vec<TripSeat>> {
    let member = |_| -> std::io::Result<Member> {
        let waker = eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC)?;
        Ok(Member { tripped_by: AtomicU32::new(NOBODY), waker: Waker::Event(waker) })
    };
    Ok(seats((0..arms).map(member).collect::<Result<_, _>>()?))
}

/// The same for arms in [virtual time](super::VirtualTime), whose threads are none.
pub fn virtual_trip_line(arms: usize) -> Vec<TripSeat> {
    let member = |_| Member { tripped_by: AtomicU32::new(NOBODY), waker: Waker::Flag(AtomicBool::new(false)) };
    seats((0..arms).map(member).collect())
}

fn seats(members: Arc<[Member]>) -> Vec<TripSeat> {
    (0..members.len()).map(|index| TripSeat { members: Arc::clone(&members), index }).collect()
}

impl Member {
    fn wake(&self) {
        match &self.waker {
            // It fails only if the count is full: then the arm is awake.
            Waker::Event(event) => drop(rustix::io::write(event, &1u64.to_ne_bytes())),
            Waker::Flag(flag) => flag.store(true, Ordering::Release),
        }
    }

    fn trip(&self, by: u32) {
        // The first one counts, until the arm has seen it.
        let _ = self.tripped_by.compare_exchange(NOBODY, by, Ordering::Release, Ordering::Relaxed);
        self.wake();
    }
}

impl TripSeat {
    /// Stops this arm from anywhere.
    pub fn handle(&self) -> TripHandle {
        TripHandle { members: Arc::clone(&self.members), index: self.index }
    }

    /// Stops all arms but this one, which has this number.
    pub(super) fn trip_others(&self, this: ArmId) {
        for (index, member) in self.members.iter().enumerate() {
            if index != self.index && !is_off(Safeguard::TripLine) {
                member.trip(ARM + u32::from(this.0));
            }
        }
    }

    /// Why this arm is to stop, if it is: told once.
    pub(super) fn take(&self) -> Option<Trip> {
        let by = self.members[self.index].tripped_by.swap(NOBODY, Ordering::Acquire);
        match by {
            NOBODY => None,
            SUPERVISOR => Some(Trip::Fault(FaultCause::Supervisor)),
            // The number of an arm has 8 bits.
            arm => Some(Trip::Fault(FaultCause::OtherArm { arm: (arm - ARM) as u8 })),
        }
    }

    /// Readable after something woke this arm; nothing in virtual time.
    pub(super) fn waker(&self) -> Option<BorrowedFd<'_>> {
        match &self.members[self.index].waker {
            Waker::Event(event) => Some(event.as_fd()),
            Waker::Flag(_) => None,
        }
    }

    /// Whether something woke this arm in virtual time.
    pub(super) fn is_woken(&self) -> bool {
        matches!(&self.members[self.index].waker, Waker::Flag(flag) if flag.load(Ordering::Acquire))
    }

    /// Makes [`Self::waker`] wait for the next waking.
    pub(super) fn forget_wakings(&self) {
        match &self.members[self.index].waker {
            Waker::Event(event) => drop(rustix::io::read(event, &mut [0u8; 8])),
            Waker::Flag(flag) => flag.store(false, Ordering::Release),
        }
    }
}

impl TripHandle {
    /// Stops the arm, as a fault: it ramps down within its emergency ramp, closes its brakes and stays stopped until an operator
    /// resets it. Never waits, and may be called from anywhere.
    pub fn trip(&self) {
        self.members[self.index].trip(SUPERVISOR);
    }

    /// Makes the thread of the arm look around.
    pub(super) fn wake(&self) {
        self.members[self.index].wake();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_stops_all_others_once() {
        for seats in [trip_line(3).unwrap(), virtual_trip_line(3)] {
            stop_each_other(&seats);
        }
    }

    fn stop_each_other(seats: &[TripSeat]) {
        seats[1].trip_others(ArmId(7));
        assert_eq!(seats[1].take(), None);
        for index in [0, 2] {
            assert_eq!(seats[index].take(), Some(Trip::Fault(FaultCause::OtherArm { arm: 7 })));
            assert_eq!(seats[index].take(), None);
        }
        seats[2].handle().trip();
        seats[0].trip_others(ArmId(255));
        assert_eq!(seats[2].take(), Some(Trip::Fault(FaultCause::Supervisor)), "the first one counts");
        assert_eq!(seats[1].take(), Some(Trip::Fault(FaultCause::OtherArm { arm: 255 })));
    }
}
