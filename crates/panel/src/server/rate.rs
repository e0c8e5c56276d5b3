//! Limit of the rate of requests; `stop` and `hold` have none.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use crate::refusal::Refusal;
use crate::secrets::Session;

/// Requests per second: a page that drags sends 30, and a heartbeat 10.
const RATE_MAX: u32 = 60;
/// Requests at once.
const BURST_MAX: f64 = 120.0;
/// Clients that are known; more than connections are possible.
const CLIENTS_MAX: usize = 256;

/// Whose requests are counted together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Client {
    address: IpAddr,
    /// The holder of the lease is counted apart from the others on its computer.
    session: Option<Session>,
}

impl Client {
    /// A client by its address and, if it holds the lease, its session.
    pub fn new(address: IpAddr, session: Option<Session>) -> Self {
        Self { address, session }
    }
}

/// Requests that each client may still send.
#[derive(Debug, Default)]
pub struct Rates(Mutex<HashMap<(IpAddr, bool), (f64, Instant)>>);

impl Rates {
    /// Counts a request.
    ///
    /// # Errors
    /// If the client has sent too many.
    pub fn count(&self, client: Client, now: Instant) -> Result<(), Refusal> {
        let mut clients = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (client.address, client.session.is_some());
        if clients.len() >= CLIENTS_MAX && !clients.contains_key(&key) {
            clients.clear();
        }
        let (left, before) = clients.entry(key).or_insert((BURST_MAX, now));
        let regained = now.saturating_duration_since(*before).as_secs_f64() * f64::from(RATE_MAX);
        *left = (*left + regained).min(BURST_MAX);
        *before = now;
        if *left < 1.0 {
            return Err(Refusal::TooMany { limit: RATE_MAX });
        }
        *left -= 1.0;
        Ok(())
    }
}

/// Lines of the log about refused requests per second: a hostile page must not fill a disk.
const REFUSALS_LOGGED: u32 = 20;

/// Limit of log lines about refused requests.
#[derive(Debug, Default)]
pub struct RefusalLog(Mutex<Option<(Instant, u32)>>);

impl RefusalLog {
    /// Whether one more may be logged.
    pub fn may_log(&self, now: Instant) -> bool {
        let mut second = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_same = |(begin, _): &(Instant, u32)| now.saturating_duration_since(*begin).as_secs() == 0;
        let (begin, count) = second.filter(is_same).unwrap_or((now, 0));
        *second = Some((begin, count.saturating_add(1)));
        count < REFUSALS_LOGGED
    }
}

#[cfg(test)]
mod tests {
    use std::net::Ipv4Addr;
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_burst_passes_and_a_flood_does_not() {
        let (rates, start) = (Rates::default(), Instant::now());
        let client = Client::new(IpAddr::V4(Ipv4Addr::LOCALHOST), None);
        let passed = (0..500).filter(|_| rates.count(client, start).is_ok()).count();
        assert_eq!(passed, 120);
        let other = Client::new(IpAddr::V4(Ipv4Addr::new(10, 0, 0, 1)), None);
        assert!(rates.count(other, start).is_ok());
        let later = start + Duration::from_millis(500);
        assert_eq!((0..500).filter(|_| rates.count(client, later).is_ok()).count(), 30);
    }

    #[test]
    fn refused_requests_do_not_flood_the_log() {
        let (log, start) = (RefusalLog::default(), Instant::now());
        assert_eq!((0..500).filter(|_| log.may_log(start)).count(), 20);
        assert!(!log.may_log(start + Duration::from_millis(900)));
        assert!(log.may_log(start + Duration::from_millis(1100)));
    }
}
