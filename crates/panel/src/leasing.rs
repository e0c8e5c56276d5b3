//! The lease as the rest of the panel uses it: each end of a lease holds every arm, and each sign of life reaches the control thread.

use std::sync::atomic::Ordering;

use crate::hub::Hub;
use crate::lease::{Heartbeat, Holder, Sign, Taken};
use crate::messages::requests::HeartbeatRequest;
use crate::refusal::Refusal;
use crate::secrets::{Nonce, Session, SystemRandom};

impl Hub {
    /// Takes the lease; a take-over holds every arm.
    ///
    /// # Errors
    /// As [`crate::lease::Lease::take`].
    pub fn take_lease(&self, name: &str, take_over: bool) -> Result<Taken, Refusal> {
        let now = self.now();
        let mut lease = self.lease();
        let taken = lease.take(name, take_over, &mut SystemRandom, now)?;
        self.is_pressed.store(false, Ordering::SeqCst);
        *self.commander() = None;
        if taken.is_take_over {
            self.link.hold_every_arm(now);
        }
        self.link.set_heartbeat_at(lease.heartbeat_at());
        Ok(taken)
    }

    /// Gives the lease back; every arm holds.
    ///
    /// # Errors
    /// If the session does not hold it.
    pub fn release_lease(&self, session: Option<Session>) -> Result<Holder, Refusal> {
        let now = self.now();
        let mut lease = self.lease();
        let holder = lease.release(session, now)?;
        *self.commander() = None;
        self.link.hold_every_arm(now);
        self.link.set_heartbeat_at(None);
        Ok(holder)
    }

    /// Ends the lease of a holder that was silent for too long; every arm holds.
    pub fn expire_lease(&self) {
        let now = self.now();
        let mut lease = self.lease();
        let Some(holder) = lease.expire(now) else { return };
        *self.commander() = None;
        self.link.hold_every_arm(now);
        self.link.set_heartbeat_at(None);
        tracing::info!(target: "pb3dp_panel::audit", holder = holder.id, name = holder.name, "lease ended by silence");
    }

    /// Checks that the session holds the lease.
    ///
    /// # Errors
    /// If it does not.
    pub fn check_holder(&self, session: Option<Session>) -> Result<Holder, Refusal> {
        self.lease().check(session, self.now()).cloned()
    }

    /// A heartbeat.
    ///
    /// # Errors
    /// If it is none of the holder.
    pub fn heartbeat(&self, session: Option<Session>, request: &HeartbeatRequest) -> Result<Sign, Refusal> {
        let now = self.now();
        let needs_press = self.config.hold_to_run && self.link.may_begin_to_move.load(Ordering::SeqCst);
        let nonce = Nonce::from_hex(&request.nonce).ok_or(Refusal::Nonce)?;
        let HeartbeatRequest { visible, pressed, .. } = *request;
        let mut lease = self.lease();
        let sign = lease.heartbeat(session, Heartbeat { nonce, visible, pressed, needs_press }, now)?;
        self.is_pressed.store(pressed && visible, Ordering::SeqCst);
        match sign {
            Sign::Alive | Sign::Hidden => self.link.set_heartbeat_at(lease.heartbeat_at()),
            Sign::Released => self.link.hold_every_arm(now),
        }
        Ok(sign)
    }

    /// A new nonce for the holder.
    ///
    /// # Errors
    /// If the session does not hold the lease.
    pub fn next_nonce(&self, session: Option<Session>) -> Result<Nonce, Refusal> {
        self.lease().next_nonce(session, &mut SystemRandom, self.now())
    }

    /// The connection of the holder's page is closed: every arm holds at once, before the silence is noticed.
    pub fn connection_closed(&self, connection: u64) {
        let mut commander = self.commander();
        if *commander == Some(connection) {
            *commander = None;
            self.link.hold_every_arm(self.now());
            tracing::info!(target: "pb3dp_panel::audit", connection, "the page of the holder is gone: every arm holds");
        }
    }
}
