//! Sequence numbers of frames, as the side that receives messages sees them.

/// What a sequence number says of the frame that carries it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// Newer than all before.
    Fresh {
        /// How many were lost before it.
        lost: u16,
    },
    /// Repeated or overtaken: must not be acted on.
    Stale,
}

/// Follows the sequence numbers of one sender through their wrap at 65536.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SequenceTracker {
    last: Option<u16>,
    lost: u64,
    stale: u64,
}

impl SequenceTracker {
    /// Takes the number of a frame. A number is newer than another if it is ahead of it by 1 to 32767.
    pub fn handle(&mut self, sequence: u16) -> Arrival {
        let ahead = match self.last {
            None => 1,
            Some(last) => sequence.wrapping_sub(last),
        };
        if !(1..0x8000).contains(&ahead) {
            self.stale = self.stale.saturating_add(1);
            return Arrival::Stale;
        }
        self.last = Some(sequence);
        let lost = ahead - 1;
        self.lost = self.lost.saturating_add(u64::from(lost));
        Arrival::Fresh { lost }
    }

    /// A new connection: any number may come next. The counts stay.
    pub fn restart(&mut self) {
        self.last = None;
    }

    /// Frames that never came.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Frames that came again or too late.
    pub fn stale(&self) -> u64 {
        self.stale
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_and_repetitions_are_distinguished_through_the_wrap() {
        let mut tracker = SequenceTracker::default();
        let arrivals = [65533, 65534, 65534, 1, 0, 2, 65533].map(|sequence| tracker.handle(sequence));
        let fresh = |lost| Arrival::Fresh { lost };
        use Arrival::Stale;
        assert_eq!(arrivals, [fresh(0), fresh(0), Stale, fresh(2), Stale, fresh(0), Stale]);
        assert_eq!((tracker.lost(), tracker.stale()), (2, 3));
        tracker.restart();
        assert_eq!(tracker.handle(40000), fresh(0));
        assert_eq!(tracker.handle(40000 - 32768), Stale);
    }
}
