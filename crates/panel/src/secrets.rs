//! Random tokens, and their comparison in constant time.

use std::fmt;

/// Random bytes that are hard to guess, written in hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Secret<const BYTES: usize>([u8; BYTES]);

/// A session: the client that knows it commands, while it holds the lease.
pub type Session = Secret<16>;

/// A nonce of a heartbeat.
pub type Nonce = Secret<8>;

impl<const BYTES: usize> fmt::Debug for Secret<BYTES> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
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

impl<const BYTES: usize> Secret<BYTES> {
    /// A new one; `None` without random bytes.
    pub fn new(random: &mut dyn Random) -> Option<Self> {
        let mut bytes = [0; BYTES];
        random.fill(&mut bytes).then_some(Self(bytes))
    }

    /// Reads two hexadecimal digits for each byte.
    pub fn from_hex(text: &str) -> Option<Self> {
        let text = text.as_bytes();
        if text.len() != 2 * BYTES {
            return None;
        }
        let mut bytes = [0; BYTES];
        for (byte, digits) in bytes.iter_mut().zip(text.chunks_exact(2)) {
            let digit = |at: usize| char::from(digits[at]).to_digit(16);
            *byte = u8::try_from(digit(0)? * 16 + digit(1)?).ok()?;
        }
        Some(Self(bytes))
    }

    /// Two hexadecimal digits for each byte.
    pub fn to_hex(self) -> String {
        self.0.iter().map(|byte| format!("{byte:02x}")).collect()
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
        assert_eq!(format!("{session:?}"), "Secret(..)");
        assert!(is_same(b"abc", b"abc") && !is_same(b"abc", b"abd") && !is_same(b"abc", b"ab"));
    }
}
