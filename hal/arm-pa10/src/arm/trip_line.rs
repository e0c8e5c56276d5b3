//! The arms of a workcell stop each other.

use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use pb3dp_arm_pa10_protocol::gateway_protocol::ArmId;
use rustix::event::{EventfdFlags, eventfd};

use crate::driver::{FaultCause, Trip};

/// No arm has tripped.
const NOBODY: u32 = 0;
/// The program has tripped.
const SUPERVISOR: u32 = 1;
/// Plus the number of the tripped arm.
const ARM: u32 = 0x100;

/// Connection of the arms of a workcell: an arm that stops by a fault or an emergency stop stops all others.
///
/// Tripping takes two non-blocking calls; the thread of each tripped arm wakes up at once.
#[derive(Debug)]
struct Member {
    tripped_by: AtomicU32,
    waker: Waker,
}

/// Wakes the thread of an arm.
#[derive(Debug)]
enum Waker {
    /// File descriptor that its thread waits for.
    Event(OwnedFd),
    /// Flag for arms in simulated time.
    Flag(AtomicBool),
}

/// Place of one arm on its line.
#[derive(Debug)]
pub struct TripSeat {
    members: Arc<[Member]>,
    index: usize,
}

/// Stops one arm from any thread.
#[derive(Clone, Debug)]
pub struct TripHandle {
    members: Arc<[Member]>,
    index: usize,
}

/// Creates a line with this number of places.
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

/// The same for arms in [virtual time](super::VirtualTime), which have no threads.
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
            // The write fails only if the counter is full: then the arm is awake.
            Waker::Event(event) => drop(rustix::io::write(event, &1u64.to_ne_bytes())),
            Waker::Flag(flag) => flag.store(true, Ordering::Release),
        }
    }

    fn trip(&self, by: u32) {
        // The first one counts, until the arm has handled it.
        let _ = self.tripped_by.compare_exchange(NOBODY, by, Ordering::Release, Ordering::Relaxed);
        self.wake();
    }
}

impl TripSeat {
    /// A handle that stops this arm.
    pub fn handle(&self) -> TripHandle {
        TripHandle { members: Arc::clone(&self.members), index: self.index }
    }

    /// Stops all arms except this one, which has this number.
    pub(super) fn trip_others(&self, this: ArmId) {
        for (index, member) in self.members.iter().enumerate() {
            if index != self.index {
                member.trip(ARM + u32::from(this.0));
            }
        }
    }

    /// Why this arm must stop, if so: reported once.
    pub(super) fn take(&self) -> Option<Trip> {
        let by = self.members[self.index].tripped_by.swap(NOBODY, Ordering::Acquire);
        match by {
            NOBODY => None,
            SUPERVISOR => Some(Trip::Fault(FaultCause::Supervisor)),
            // The number of an arm has 8 bits.
            arm => Some(Trip::Fault(FaultCause::OtherArm { arm: (arm - ARM) as u8 })),
        }
    }

    /// Readable after a wake-up of this arm; `None` in virtual time.
    pub(super) fn waker(&self) -> Option<BorrowedFd<'_>> {
        match &self.members[self.index].waker {
            Waker::Event(event) => Some(event.as_fd()),
            Waker::Flag(_) => None,
        }
    }

    /// Whether this arm was woken in virtual time.
    pub(super) fn is_woken(&self) -> bool {
        matches!(&self.members[self.index].waker, Waker::Flag(flag) if flag.load(Ordering::Acquire))
    }

    /// Clears [`Self::waker`] for the next wake-up.
    pub(super) fn forget_wakings(&self) {
        match &self.members[self.index].waker {
            Waker::Event(event) => drop(rustix::io::read(event, &mut [0u8; 8])),
            Waker::Flag(flag) => flag.store(false, Ordering::Release),
        }
    }
}

impl TripHandle {
    /// Stops the arm with a fault: it decelerates within its emergency ramp, closes its brakes and stays stopped until an operator
    /// resets it. Never blocks, and may be called from any thread.
    pub fn trip(&self) {
        self.members[self.index].trip(SUPERVISOR);
    }

    /// Wakes the thread of the arm.
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
