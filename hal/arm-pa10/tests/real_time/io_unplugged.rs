//! Time until the loss of a link is detected.

use std::time::{Duration, Instant};

use pb3dp_arm_pa10_test_support::byte_links::LONG;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::{ByteLink, wait};
use pb3dp_test_support::in_real_time_beside_others;
use pb3dp_test_support::real_time::note_lateness_at;

use crate::io_serial::{open, tcp_pair};

/// Two cycles of the arm. Both ends are in this process, and the kernel wakes the reader at once.
const NOTICED_WITHIN: Duration = Duration::from_millis(20);

#[test]
fn an_unplugged_link_is_noticed_at_once_and_stays_gone() {
    in_real_time_beside_others(|| {
        let pty = Pty::open().unwrap();
        let port = open(&pty).unwrap();
        let (host, peer) = tcp_pair();
        let links: [(Box<dyn ByteLink>, Box<dyn ByteLink>); 2] =
            [(Box::new(port), Box::new(pty)), (Box::new(host), Box::new(peer))];
        for (mut here, there) in links {
            let unplug = std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(50));
                let at = Instant::now();
                drop(there);
                at
            });
            let mut gone = false;
            while !gone {
                assert!(wait(Some(here.as_ref()), false, None, LONG).readable, "{}", here.name());
                gone = here.try_read(&mut [0; 8]).is_err();
            }
            let noticed = Instant::now();
            let after = noticed.saturating_duration_since(unplug.join().unwrap());
            if after >= NOTICED_WITHIN {
                note_lateness_at(noticed, after);
            }
            assert!(after < NOTICED_WITHIN, "{}: {after:?}", here.name());
            assert!(here.try_read(&mut [0; 8]).is_err() && here.try_write(&[1]).is_err(), "{}", here.name());
        }
    });
}
