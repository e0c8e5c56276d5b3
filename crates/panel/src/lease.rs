//! The lease: which session may command, and its signs of life. A pure state machine; the time is an argument.

use std::time::Duration;

use pb3dp_geometry::MonotonicTime;

use crate::refusal::Refusal;
use crate::secrets::{Nonce, Random, Session};

/// Silence of a holder after which anybody may take the lease: a reloaded page or a lost laptop does not block others for long.
pub const FREE_AFTER: Duration = Duration::from_secs(30);
/// Nonces that count; at 10 Hz an answer may take 0.2 s.
const NONCES_MAX: usize = 2;
/// Longest name of a holder, characters.
pub const NAME_MAX: usize = 40;

/// Who holds the lease; for everybody to see.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Number of the lease, from 1.
    pub id: u64,
    /// Name that the holder gave itself.
    pub name: String,
}

/// A lease just taken.
#[derive(Debug)]
pub struct Taken {
    /// The session; only its holder gets to know it.
    pub session: Session,
    /// First nonce.
    pub nonce: Nonce,
    /// The new holder.
    pub holder: Holder,
    /// Whether another session held the lease until now: every arm must hold.
    pub is_take_over: bool,
}

/// Contents of a heartbeat.
#[derive(Clone, Copy, Debug)]
pub struct Heartbeat {
    /// The answered nonce.
    pub nonce: Nonce,
    /// Whether the page is visible.
    pub visible: bool,
    /// Whether the operator presses the button of hold-to-run.
    pub pressed: bool,
    /// Whether only a pressed button counts: hold-to-run, and an arm may move.
    pub needs_press: bool,
}

/// What a heartbeat means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// A sign of life.
    Alive,
    /// The page is hidden: the operator counts as silent at once.
    Hidden,
    /// The button of hold-to-run is released: every arm must hold.
    Released,
}

/// The lease.
#[derive(Debug, Default)]
pub struct Lease {
    held: Option<Held>,
    /// Number of leases so far.
    count: u64,
}

#[derive(Debug)]
struct Held {
    holder: Holder,
    session: Session,
    /// The newest ones that were not answered, newest last.
    nonces: Vec<Nonce>,
    /// Last sign of life; `None` while the page is hidden.
    heartbeat_at: Option<MonotonicTime>,
    /// `time_ms` of the newest state on which the holder gave a command.
    acted_on_ms: f64,
    /// As `heartbeat_at`, but kept while the page is hidden.
    alive_at: MonotonicTime,
}

impl Lease {
    /// The holder, unless it was silent for [`FREE_AFTER`].
    pub fn holder(&self, now: MonotonicTime) -> Option<&Holder> {
        self.held(now).map(|held| &held.holder)
    }

    fn held(&self, now: MonotonicTime) -> Option<&Held> {
        self.held.as_ref().filter(|held| now.saturating_since(held.alive_at) < FREE_AFTER)
    }

    /// Last sign of life of the holder; `None` without a holder, or while its page is hidden.
    pub fn heartbeat_at(&self) -> Option<MonotonicTime> {
        self.held.as_ref()?.heartbeat_at
    }

    /// Time of the newest state on which the holder gave a command, ms of the run's clock; 0 before the first one.
    pub fn acted_on_ms(&self) -> f64 {
        self.held.as_ref().map_or(0.0, |held| held.acted_on_ms)
    }

    /// Notes the state on which the holder gave a command.
    pub fn note_acted_on(&mut self, time_ms: f64) {
        if let Some(held) = &mut self.held {
            held.acted_on_ms = held.acted_on_ms.max(time_ms);
        }
    }

    /// Takes the lease, with `take_over` also from another holder.
    ///
    /// # Errors
    /// If another session holds it, or the name is unusable, or the system has no random bytes.
    pub fn take(
        &mut self,
        name: &str,
        take_over: bool,
        random: &mut dyn Random,
        now: MonotonicTime,
    ) -> Result<Taken, Refusal> {
        let name = checked_name(name)?;
        if let Some(Held { holder, .. }) = self.held(now).filter(|_| !take_over) {
            return Err(Refusal::Held { name: holder.name.clone(), id: holder.id });
        }
        let no_random = || Refusal::Thread { cause: "the system has no random bytes".to_owned() };
        let session = Session::new(random).ok_or_else(no_random)?;
        let nonce = Nonce::new(random).ok_or_else(no_random)?;
        self.count += 1;
        let holder = Holder { id: self.count, name };
        let held = Held {
            holder: holder.clone(),
            session,
            nonces: vec![nonce],
            heartbeat_at: Some(now),
            acted_on_ms: 0.0,
            alive_at: now,
        };
        let is_take_over = self.held.replace(held).is_some();
        Ok(Taken { session, nonce, holder, is_take_over })
    }

    /// Checks that the session holds the lease.
    ///
    /// # Errors
    /// If it does not, with the holder.
    pub fn check(&self, session: Option<Session>, now: MonotonicTime) -> Result<&Holder, Refusal> {
        match (self.held(now), session) {
            (Some(held), Some(session)) if held.session.is(&session) => Ok(&held.holder),
            (held, _) => Err(Refusal::NotHolder {
                holder: held
                    .map_or_else(|| "nobody holds it".to_owned(), |held| format!("{:?} does", held.holder.name)),
            }),
        }
    }

    /// Gives the lease back.
    ///
    /// # Errors
    /// If the session does not hold it.
    pub fn release(&mut self, session: Option<Session>, now: MonotonicTime) -> Result<Holder, Refusal> {
        let holder = self.check(session, now)?.clone();
        self.held = None;
        Ok(holder)
    }

    /// Ends a lease whose holder was silent for [`FREE_AFTER`]; returns that holder.
    pub fn expire(&mut self, now: MonotonicTime) -> Option<Holder> {
        if self.held.is_some() && self.held(now).is_none() { self.held.take().map(|held| held.holder) } else { None }
    }

    /// A new nonce for the holder; the older ones beyond the two newest no longer count.
    ///
    /// # Errors
    /// If the session does not hold the lease, or the system has no random bytes.
    pub fn next_nonce(
        &mut self,
        session: Option<Session>,
        random: &mut dyn Random,
        now: MonotonicTime,
    ) -> Result<Nonce, Refusal> {
        self.check(session, now)?;
        let nonce =
            Nonce::new(random).ok_or_else(|| Refusal::Thread { cause: "the system has no random bytes".to_owned() })?;
        if let Some(held) = &mut self.held {
            held.nonces.push(nonce);
            let old = held.nonces.len().saturating_sub(NONCES_MAX);
            held.nonces.drain(..old);
        }
        Ok(nonce)
    }

    /// A heartbeat of the holder.
    ///
    /// # Errors
    /// If the session does not hold the lease, or the nonce does not count; this is no sign of life then.
    pub fn heartbeat(
        &mut self,
        session: Option<Session>,
        heartbeat: Heartbeat,
        now: MonotonicTime,
    ) -> Result<Sign, Refusal> {
        self.check(session, now)?;
        let held = self.held.as_mut().ok_or(Refusal::Nonce)?;
        let at = held.nonces.iter().position(|nonce| nonce.is(&heartbeat.nonce)).ok_or(Refusal::Nonce)?;
        // An answer to a newer nonce makes the older ones worthless.
        held.nonces.drain(..=at);
        Ok(match heartbeat {
            Heartbeat { visible: false, .. } => {
                held.heartbeat_at = None;
                Sign::Hidden
            }
            Heartbeat { needs_press: true, pressed: false, .. } => Sign::Released,
            _ => {
                held.heartbeat_at = Some(now);
                held.alive_at = now;
                Sign::Alive
            }
        })
    }
}

fn checked_name(name: &str) -> Result<String, Refusal> {
    let name = name.trim();
    let length = name.chars().count();
    if !(1..=NAME_MAX).contains(&length) || name.chars().any(char::is_control) {
        return Err(Refusal::Body {
            cause: format!("name has {length} characters; give 1 to {NAME_MAX}, without control characters"),
        });
    }
    Ok(name.to_owned())
}

#[cfg(test)]
mod tests;
