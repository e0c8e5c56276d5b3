//! Random tokens, and their comparison in constant time.

use std::fmt;

/// A session: the client that knows it commands, while it holds the lease.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Session([u8; 16]);

/// A nonce of a heartbeat.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Nonce([u8; 8]);

impl fmt::Debug for Session {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Session(..)")
    }
}

impl fmt::Debug for Nonce {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Nonce(..)")
    }
}

/// Source of random bytes; the system's in a run.
pub trait Random {
    /// Fills the buffer, or returns false if there are no random bytes.
    fn fill(&mut self, bytes: &mut [u8]) -> bool;
}

/// Random bytes of the operating system.
#[derive(Clone, Copy, Debug)]
pub struct SystemRandom;

impl Random for SystemRandom {
    fn fill(&mut self, bytes: &mut [u8]) -> bool {
        getrandom::fill(bytes).is_ok()
    }
}

impl Session {
    /// A new session; `None` without random bytes.
    pub fn new(random: &mut dyn Random) -> Option<Self> {
        let mut bytes = [0; 16];
        random.fill(&mut bytes).then_some(Self(bytes))
    }

    /// Reads 32 hexadecimal digits.
    pub fn from_hex(text: &str) -> Option<Self> {
        from_hex(text).map(Self)
    }

    /// 32 hexadecimal digits.
    pub fn to_hex(self) -> String {
        to_hex(&self.0)
    }

    /// Compares in constant time.
    pub fn is(&self, other: &Self) -> bool {
        is_same(&self.0, &other.0)
    }
}

impl Nonce {
    /// A new nonce; `None` without random bytes.
    pub fn new(random: &mut dyn Random) -> Option<Self> {
        let mut bytes = [0; 8];
        random.fill(&mut bytes).then_some(Self(bytes))
    }

    /// Reads 16 hexadecimal digits.
    pub fn from_hex(text: &str) -> Option<Self> {
        from_hex(text).map(Self)
    }

    /// 16 hexadecimal digits.
    pub fn to_hex(self) -> String {
        to_hex(&self.0)
    }

    /// Compares in constant time.
    pub fn is(&self, other: &Self) -> bool {
        is_same(&self.0, &other.0)
    }
}

/// Compares all bytes, whatever the first ones are; only the length is not secret.
pub fn is_same(a: &[u8], b: &[u8]) -> bool {
    let differences = a.iter().zip(b).fold(0, |all, (a, b)| std::hint::black_box(all | (a ^ b)));
    a.len() == b.len() && differences == 0
}

fn to_hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn from_hex<const N: usize>(text: &str) -> Option<[u8; N]> {
    let text = text.as_bytes();
    if text.len() != 2 * N {
        return None;
    }
    let mut bytes = [0; N];
    for (byte, digits) in bytes.iter_mut().zip(text.chunks_exact(2)) {
        let digit = |at: usize| char::from(digits[at]).to_digit(16);
        *byte = u8::try_from(digit(0)? * 16 + digit(1)?).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_read_back_and_differ() {
        let [first, second] = [(); 2].map(|()| Session::new(&mut SystemRandom).unwrap());
        assert!(!first.is(&second));
        assert!(Session::from_hex(&first.to_hex()).unwrap().is(&first));
        for wrong in ["", "00", "0x000000000000000000000000000000", "é0000000000000000000000000000000"] {
            assert!(Session::from_hex(wrong).is_none(), "{wrong}");
        }
    }

    #[test]
    fn a_token_is_never_printed() {
        let session = Session::from_hex("000102030405060708090a0b0c0d0e0f").unwrap();
        assert_eq!(format!("{session:?}"), "Session(..)");
        assert!(is_same(b"abc", b"abc") && !is_same(b"abc", b"abd") && !is_same(b"abc", b"ab"));
    }
}
