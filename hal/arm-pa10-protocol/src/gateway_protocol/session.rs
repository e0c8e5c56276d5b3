//! Proof of a shared key, and records that carry frames over a line that other programs can reach (`docs/arm-protocol.md`).
//!
//! Host and gateway prove the key to each other with fresh nonces, then each frame travels in a record with a counter and a MAC.
//! A record that is forged, repeated, out of order, of the other direction or of another connection ends the connection.

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

use super::frame::{FRAME_BYTES_MAX, OVERHEAD};
use super::{ArmId, Frame, MessageError, Payload};
use crate::codec::ByteBuffer;

/// The type of CLIENT-NONCE, which comes first on a line that needs a key.
pub const CLIENT_NONCE: u8 = 0x10;
/// The type of PROOF.
pub const PROOF: u8 = 0x11;
/// The type of CHALLENGE.
pub const CHALLENGE: u8 = 0x90;

/// Bytes of a key at least.
pub const KEY_BYTES_MIN: usize = 32;

/// Bytes of a nonce.
pub const NONCE_BYTES: usize = 32;

/// Bytes of the MAC of a record: the first half of an HMAC-SHA256.
pub const MAC_BYTES: usize = 16;

/// A record starts with these.
const SYNC: [u8; 2] = [0xA6, 0x6A];

/// Sync bytes, length, counter.
const HEADER: usize = SYNC.len() + 1 + 8;

/// Longest record.
pub const RECORD_BYTES_MAX: usize = HEADER + FRAME_BYTES_MAX + MAC_BYTES;

/// An encoded record.
pub type RecordBytes = ByteBuffer<RECORD_BYTES_MAX>;

/// A random number that is used once.
pub type Nonce = [u8; NONCE_BYTES];

/// Proof that a side has the key.
pub type Proof = [u8; 32];

/// The key that host and gateway share. Nothing shows its bytes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct SharedKey([u8; 32]);

/// A key is too short.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the key has {got} bytes, at least {KEY_BYTES_MIN} are needed: make one with `pb3dp gateway key FILE`")]
pub struct KeyTooShort {
    got: usize,
}

impl SharedKey {
    /// A key from secret random bytes.
    ///
    /// # Errors
    /// If there are fewer than [`KEY_BYTES_MIN`].
    pub fn new(secret: &[u8]) -> Result<Self, KeyTooShort> {
        if secret.len() < KEY_BYTES_MIN {
            return Err(KeyTooShort { got: secret.len() });
        }
        Ok(Self(keyed(b"pb3dp gateway key 1").chain_update(secret).finalize().into_bytes().into()))
    }
}

impl std::fmt::Debug for SharedKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("SharedKey")
    }
}

/// HMAC-SHA256 with a key that is no longer than a block: zeros fill the block (RFC 2104, section 2).
fn keyed<const N: usize>(key: &[u8; N]) -> Hmac<Sha256> {
    const { assert!(N <= 64, "a longer key would be hashed first") };
    let mut block = hmac::digest::Key::<Hmac<Sha256>>::default();
    block[..N].copy_from_slice(key);
    Hmac::new(&block)
}

/// The nonces of both sides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Nonces {
    host: Nonce,
    gateway: Nonce,
}

/// What a connection is agreed on: key, arm and nonces of both sides.
#[derive(Clone, Copy, Debug)]
pub struct Agreement {
    key: SharedKey,
    arm: ArmId,
    nonces: Nonces,
}

impl Agreement {
    /// The agreement of a connection to one arm.
    pub fn new(key: SharedKey, arm: ArmId, host: Nonce, gateway: Nonce) -> Self {
        Self { key, arm, nonces: Nonces { host, gateway } }
    }

    /// HMAC of everything that is agreed on, for one purpose.
    fn derivation(&self, label: &[u8]) -> Hmac<Sha256> {
        let Self { key, arm, nonces } = self;
        keyed(&key.0).chain_update(label).chain_update([arm.0]).chain_update(nonces.host).chain_update(nonces.gateway)
    }

    fn proof_derivation(&self, side: Side) -> Hmac<Sha256> {
        self.derivation(side.pick(b"host proof", b"gateway proof"))
    }

    /// The proof that a side sends.
    pub fn proof(&self, side: Side) -> Proof {
        self.proof_derivation(side).finalize().into_bytes().into()
    }

    /// Whether a proof is that of a side; compares in constant time.
    pub fn is_proof(&self, side: Side, proof: &Proof) -> bool {
        self.proof_derivation(side).verify_slice(proof).is_ok()
    }

    /// The records of one side: what it seals, and what it opens of the other one.
    pub fn records(&self, side: Side) -> (Sealer, Opener) {
        let of = |side: Side| {
            let key: [u8; 32] =
                self.derivation(side.pick(b"host records", b"gateway records")).finalize().into_bytes().into();
            keyed(&key)
        };
        let sealer = Sealer { mac: of(side), counter: 0 };
        (sealer, Opener { mac: of(side.other()), counter: 0, buffer: RecordBytes::EMPTY, is_broken: false })
    }
}

/// An end of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The host.
    Host,
    /// The gateway.
    Gateway,
}

impl Side {
    fn other(self) -> Self {
        match self {
            Self::Host => Self::Gateway,
            Self::Gateway => Self::Host,
        }
    }

    fn pick<'a>(self, host: &'a [u8], gateway: &'a [u8]) -> &'a [u8] {
        match self {
            Self::Host => host,
            Self::Gateway => gateway,
        }
    }
}

/// A message before the first record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handshake {
    /// The host opens the connection.
    ClientNonce(Nonce),
    /// The gateway answers with its nonce and its proof.
    Challenge(Nonce, Proof),
    /// The proof of the host. What follows are records.
    Proof(Proof),
}

impl Handshake {
    /// The frame of this message. It needs no time: nonces make it new.
    pub fn frame(&self, arm: ArmId) -> Frame {
        let mut payload = Payload::EMPTY;
        let frame_type = match self {
            Self::ClientNonce(nonce) => {
                payload.extend(nonce);
                CLIENT_NONCE
            }
            Self::Challenge(nonce, proof) => {
                payload.extend(nonce);
                payload.extend(proof);
                CHALLENGE
            }
            Self::Proof(proof) => {
                payload.extend(proof);
                PROOF
            }
        };
        Frame { arm, frame_type, sequence: 0, timestamp_us: 0, payload }
    }

    /// The message in a frame.
    ///
    /// # Errors
    /// If the type is another one, or the payload does not fit it.
    pub fn decode(frame: &Frame) -> Result<Self, MessageError> {
        let frame_type = frame.frame_type;
        let fields = |length| super::fields::Fields::new(frame_type, &frame.payload, length);
        Ok(match frame_type {
            CLIENT_NONCE => Self::ClientNonce(fields(NONCE_BYTES)?.bytes()),
            CHALLENGE => {
                let mut fields = fields(NONCE_BYTES + 32)?;
                Self::Challenge(fields.bytes(), fields.bytes())
            }
            PROOF => Self::Proof(fields(32)?.bytes()),
            got => return Err(MessageError::Type { got }),
        })
    }
}

/// Makes the records of one side.
pub struct Sealer {
    mac: Hmac<Sha256>,
    counter: u64,
}

impl Sealer {
    /// The record of a frame.
    pub fn seal(&mut self, frame: &[u8]) -> RecordBytes {
        let mut record = RecordBytes::EMPTY;
        record.extend(&SYNC);
        let length = frame.len().min(FRAME_BYTES_MAX);
        // A frame has fewer than 256 bytes.
        record.extend(&[length as u8]);
        record.extend(&self.counter.to_le_bytes());
        record.extend(&frame[..length]);
        let tag = self.mac.clone().chain_update(record.as_slice()).finalize().into_bytes();
        record.extend(&tag[..MAC_BYTES]);
        // 2^64 records take longer than any connection.
        self.counter = self.counter.wrapping_add(1);
        record
    }
}

/// A record that is not the next one of the other side: the connection must end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a record was forged, repeated or out of order")]
pub struct NotAuthentic;

/// Opens the records of the other side, in order.
pub struct Opener {
    mac: Hmac<Sha256>,
    counter: u64,
    buffer: RecordBytes,
    is_broken: bool,
}

impl Opener {
    /// Bytes of a record that is not complete yet.
    pub fn pending(&self) -> usize {
        self.buffer.len()
    }

    /// Takes bytes in pieces of any size, and hands on the frame of each authentic record.
    ///
    /// # Errors
    /// At the first record that is not the next one, and ever after.
    pub fn feed(&mut self, mut bytes: &[u8], mut each: impl FnMut(&[u8])) -> Result<(), NotAuthentic> {
        while !bytes.is_empty() && !self.is_broken {
            let missing = self.length()?.saturating_sub(self.buffer.len());
            let (now, later) = bytes.split_at(missing.min(bytes.len()));
            self.buffer.extend(now);
            bytes = later;
            let length = self.length()?;
            if self.buffer.len() == length && length > HEADER {
                self.open(length, &mut each)?;
            }
        }
        if self.is_broken { Err(NotAuthentic) } else { Ok(()) }
    }

    /// Length of the record in the buffer, or of the part that shows it.
    fn length(&mut self) -> Result<usize, NotAuthentic> {
        let is_record = self.buffer.iter().zip(SYNC).all(|(got, sync)| *got == sync);
        match self.buffer.get(SYNC.len()) {
            _ if !is_record || self.is_broken => self.fail(),
            None => Ok(SYNC.len() + 1),
            Some(&length) if (OVERHEAD..=FRAME_BYTES_MAX).contains(&usize::from(length)) => {
                Ok(HEADER + usize::from(length) + MAC_BYTES)
            }
            Some(_) => self.fail(),
        }
    }

    fn open(&mut self, length: usize, each: &mut impl FnMut(&[u8])) -> Result<(), NotAuthentic> {
        let record = std::mem::replace(&mut self.buffer, RecordBytes::EMPTY);
        let (sealed, tag) = record.split_at(length - MAC_BYTES);
        let is_authentic = self.mac.clone().chain_update(sealed).verify_truncated_left(tag).is_ok();
        let is_next = sealed[SYNC.len() + 1..HEADER] == self.counter.to_le_bytes();
        if !is_authentic || !is_next {
            return self.fail();
        }
        self.counter = self.counter.wrapping_add(1);
        each(&sealed[HEADER..]);
        Ok(())
    }

    fn fail<T>(&mut self) -> Result<T, NotAuthentic> {
        self.is_broken = true;
        self.buffer = RecordBytes::EMPTY;
        Err(NotAuthentic)
    }
}

impl std::fmt::Debug for Sealer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Sealer {{ counter: {} }}", self.counter)
    }
}

impl std::fmt::Debug for Opener {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Opener {{ counter: {}, is_broken: {} }}", self.counter, self.is_broken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gateway_protocol::HostMessage;

    fn agreement(secret: u8) -> Agreement {
        Agreement::new(SharedKey::new(&[secret; 32]).unwrap(), ArmId(2), [1; 32], [2; 32])
    }

    fn frames() -> Vec<Vec<u8>> {
        (0..4).map(|sequence| HostMessage::Heartbeat.frame(ArmId(2), sequence, 9).encode().to_vec()).collect()
    }

    fn opened(opener: &mut Opener, bytes: &[u8]) -> (Vec<Vec<u8>>, bool) {
        let mut frames = Vec::new();
        let result = opener.feed(bytes, |frame| frames.push(frame.to_vec()));
        (frames, result.is_ok())
    }

    #[test]
    fn frames_pass_in_pieces_of_any_size() {
        for size in [1, 2, 3, 7, 46, 47, 500] {
            let (mut sealer, _) = agreement(7).records(Side::Host);
            let (_, mut opener) = agreement(7).records(Side::Gateway);
            let bytes: Vec<u8> = frames().iter().flat_map(|frame| sealer.seal(frame).to_vec()).collect();
            let mut got = Vec::new();
            for piece in bytes.chunks(size) {
                let (some, is_ok) = opened(&mut opener, piece);
                assert!(is_ok);
                got.extend(some);
            }
            assert_eq!((got, opener.pending()), (frames(), 0));
        }
    }

    #[test]
    fn the_longest_frame_passes() {
        let (mut sealer, _) = agreement(7).records(Side::Host);
        let (_, mut opener) = agreement(7).records(Side::Gateway);
        let frame = vec![0x5A; FRAME_BYTES_MAX];
        let record = sealer.seal(&frame);
        assert_eq!(record.len(), RECORD_BYTES_MAX);
        assert_eq!(opened(&mut opener, &record), (vec![frame], true));
    }

    #[test]
    fn repeated_reordered_reflected_and_foreign_records_end_the_connection() {
        let sealed = |secret, side| {
            let (mut sealer, _) = agreement(secret).records(side);
            frames().iter().map(|frame| sealer.seal(frame).to_vec()).collect::<Vec<_>>()
        };
        let host = sealed(7, Side::Host);
        let cases = [
            ("repeated", [host[0].clone(), host[0].clone()], 1),
            ("reordered", [host[1].clone(), host[0].clone()], 0),
            ("skipped", [host[0].clone(), host[2].clone()], 1),
            ("reflected", [sealed(7, Side::Gateway)[0].clone(), host[0].clone()], 0),
            ("another key", [sealed(8, Side::Host)[0].clone(), host[0].clone()], 0),
        ];
        for (name, records, good) in cases {
            let (_, mut opener) = agreement(7).records(Side::Gateway);
            let (frames, is_ok) = opened(&mut opener, &records.concat());
            assert_eq!((frames.len(), is_ok), (good, false), "{name}");
            // The connection stays broken, whatever follows.
            assert_eq!(opened(&mut opener, &host[good]), (Vec::new(), false), "{name}");
        }
        let other = Agreement::new(SharedKey::new(&[7; 32]).unwrap(), ArmId(2), [1; 32], [3; 32]);
        assert!(!opened(&mut other.records(Side::Gateway).1, &host[0]).1, "another connection");
        let other = Agreement::new(SharedKey::new(&[7; 32]).unwrap(), ArmId(3), [1; 32], [2; 32]);
        assert!(!opened(&mut other.records(Side::Gateway).1, &host[0]).1, "another arm");
    }

    #[test]
    fn each_flipped_bit_ends_the_connection() {
        let good = agreement(7).records(Side::Host).0.seal(&frames()[0]).to_vec();
        for bit in 0..good.len() * 8 {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            let (_, mut opener) = agreement(7).records(Side::Gateway);
            let (frames, is_ok) = opened(&mut opener, &bad);
            // A longer announced length waits for the rest, and delivers nothing.
            assert!(frames.is_empty() && (!is_ok || opener.pending() > 0), "bit {bit}");
        }
    }

    /// From Python's `hmac` and `hashlib`, by the text of `docs/arm-protocol.md`: key, then proof of the gateway, then MAC of the host's
    /// first record.
    #[test]
    fn proofs_and_records_are_those_of_another_implementation() {
        let proof = [0x0a, 0x3f, 0x48, 0x6b, 0x96, 0xc8, 0x83, 0x93];
        assert_eq!(agreement(7).proof(Side::Gateway)[..8], proof);
        let frame: Vec<u8> = (0..20).collect();
        let mac = [0x37, 0x1a, 0x52, 0xd4, 0xb7, 0x9e, 0x4e, 0x4c, 0x09, 0x12, 0x0d, 0xca, 0x81, 0xad, 0xdf, 0xa7];
        let record = agreement(7).records(Side::Host).0.seal(&frame);
        assert_eq!(record[record.len() - MAC_BYTES..], mac);
    }

    #[test]
    fn proofs_belong_to_key_arm_side_and_nonces() {
        let here = agreement(7);
        assert!(here.is_proof(Side::Host, &here.proof(Side::Host)));
        assert!(!here.is_proof(Side::Host, &here.proof(Side::Gateway)));
        assert!(!here.is_proof(Side::Host, &agreement(8).proof(Side::Host)));
        let key = SharedKey::new(&[7; 32]).unwrap();
        for other in [
            Agreement::new(key, ArmId(3), [1; 32], [2; 32]),
            Agreement::new(key, ArmId(2), [2; 32], [1; 32]),
            Agreement::new(key, ArmId(2), [1; 32], [1; 32]),
        ] {
            assert!(!here.is_proof(Side::Host, &other.proof(Side::Host)));
        }
        assert!(SharedKey::new(&[7; 31]).is_err());
        assert_eq!(format!("{key:?} {here:?}").matches('7').count(), 0);
    }
}
