//! A TCP connection to a gateway whose key is proven on both sides, and whose frames travel in records.

use std::os::fd::BorrowedFd;
use std::path::Path;
use std::time::Duration;

use pb3dp_arm_pa10_protocol::gateway_protocol::{
    Agreement, ArmId, FRAME_BYTES_MAX, FirstFrame, Frame, GatewayMessage, Handshake, KEY_BYTES_MIN, Opener,
    RejectReason, Sealer, SharedKey, Side, first_frame,
};
use pb3dp_hal_platform::key_file::{KeyFileError, random_bytes, read_key};
use pb3dp_hal_platform::realtime::now;
use pb3dp_hal_platform::tcp::{TcpConfig, TcpLink};
use pb3dp_hal_platform::transport::{ByteLink, ConnectError, Connector, Symptom, Unplugged, wait};
use pb3dp_message_codes::codes;

use crate::link::HELLO_TIMEOUT;

/// Bytes that are read at once.
const PIECE: usize = 512;

/// Frames that wait in a full line: more are not accepted.
const UNSENT_MAX: usize = 4096;

/// A link whose frames travel in records, after both sides have proven their key.
///
/// Only authentic frames in order come out of [`ByteLink::try_read`]; the first other byte ends the link.
#[derive(Debug)]
pub struct KeyedLink<L> {
    link: L,
    sealer: Sealer,
    opener: Opener,
    /// Opened frames that were not read yet.
    unread: Vec<u8>,
    /// Records that the line did not accept yet.
    unsent: Vec<u8>,
}

impl<L: ByteLink> KeyedLink<L> {
    /// One side of a connection on this link, after the handshake.
    pub fn new(link: L, agreement: &Agreement, side: Side) -> Self {
        let (sealer, opener) = agreement.records(side);
        let (unread, unsent) = (Vec::with_capacity(2 * PIECE), Vec::with_capacity(UNSENT_MAX));
        Self { link, sealer, opener, unread, unsent }
    }

    fn flush(&mut self) -> Result<(), Unplugged> {
        while !self.unsent.is_empty() {
            match self.link.try_write(&self.unsent)? {
                0 => return Ok(()),
                count => drop(self.unsent.drain(..count)),
            }
        }
        Ok(())
    }
}

impl<L: ByteLink> ByteLink for KeyedLink<L> {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        self.flush()?;
        let mut piece = [0; PIECE];
        // At most until a record is complete: a caller that waits for the next byte of the line must not wait for one that was read.
        while self.unread.is_empty() {
            // As much as fits into `buffer` together with a record that is completed: nothing is left over that no poll reports.
            let room = buffer.len().saturating_sub(self.opener.pending()).clamp(1, PIECE);
            let count = self.link.try_read(&mut piece[..room])?;
            if count == 0 {
                break;
            }
            let unread = &mut self.unread;
            let opened = self.opener.feed(&piece[..count], |frame| unread.extend_from_slice(frame));
            // Frames before the forged record are authentic, but the link is at its end.
            opened.map_err(|_| Unplugged { symptom: Symptom::NotAuthentic })?;
        }
        let count = self.unread.len().min(buffer.len());
        buffer[..count].copy_from_slice(&self.unread[..count]);
        self.unread.drain(..count);
        Ok(count)
    }

    /// Accepts a whole frame or nothing.
    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.flush()?;
        if bytes.is_empty() || self.unsent.len() + 2 * FRAME_BYTES_MAX > UNSENT_MAX {
            return Ok(0);
        }
        let length = match first_frame(bytes) {
            FirstFrame::Frame { length, .. } => length,
            FirstFrame::Incomplete { .. } | FirstFrame::None => bytes.len().min(FRAME_BYTES_MAX),
        };
        self.unsent.extend_from_slice(&self.sealer.seal(&bytes[..length]));
        self.flush()?;
        Ok(length)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.link.fd()
    }

    fn has_unread(&self) -> bool {
        !self.unread.is_empty() || self.link.has_unread()
    }

    fn warning(&self) -> Option<String> {
        self.link.warning()
    }
}

/// Reads the key that a gateway and its hosts share.
///
/// # Errors
/// If the file cannot be read, others can read it, or it holds no key.
pub fn read_shared_key(file: &Path) -> Result<SharedKey, KeyFileError> {
    let secret = read_key(file, KEY_BYTES_MIN)?;
    SharedKey::new(&secret).map_err(|_| KeyFileError::NoKey { file: file.to_owned(), bytes_min: KEY_BYTES_MIN })
}

/// A gateway on TCP, and the key that it shares with this host.
#[derive(Clone, Debug)]
pub struct KeyedTcp {
    /// Address of the gateway.
    pub tcp: TcpConfig,
    /// The key.
    pub key: SharedKey,
    /// The arm at the gateway.
    pub arm: ArmId,
}

/// Why a gateway on TCP lets this host not in, or is not trusted by it.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// This computer is not on the gateway's list.
    #[error("the gateway at {target} refuses this computer: add its address to `access.peers` in the gateway's file")]
    PeerNotAllowed {
        /// The gateway.
        target: String,
    },
    /// The gateway has too many connections.
    #[error("the gateway at {target} has too many new connections; end the program that opens them, then try again")]
    TooManyPeers {
        /// The gateway.
        target: String,
    },
    /// The keys differ.
    #[error("the gateway at {target} has another key: copy the gateway's key file to `gateway.key_file` of this arm")]
    KeyMismatch {
        /// The gateway.
        target: String,
    },
    /// Another refusal.
    #[error("the gateway at {target} refused the connection: {reason}; compare the number of the arm and the versions")]
    Refused {
        /// The gateway.
        target: String,
        /// Its reason.
        reason: RejectReason,
    },
    /// There is no gateway of this version.
    #[error(
        "{target} accepts connections, but does not answer as a gateway with a key within {HELLO_TIMEOUT:?}: check address, number of \
         the arm and versions"
    )]
    NoChallenge {
        /// The gateway.
        target: String,
    },
    /// The connection was closed.
    #[error("the gateway at {target} closed the connection before it was open: look at the gateway's log")]
    Closed {
        /// The gateway.
        target: String,
        /// How.
        #[source]
        source: Unplugged,
    },
    /// No nonce.
    #[error(transparent)]
    Random(#[from] KeyFileError),
}

impl Connector for KeyedTcp {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        Ok(Box::new(self.open(TcpLink::connect(&self.tcp)?)?))
    }

    fn target(&self) -> String {
        self.tcp.target()
    }
}

impl KeyedTcp {
    /// Proves the key on an open connection, and checks that the gateway has it.
    ///
    /// # Errors
    /// If the gateway refuses this host, has another key or does not answer in time.
    pub fn open<L: ByteLink>(&self, mut link: L) -> Result<KeyedLink<L>, AccessError> {
        let target = || self.target();
        let closed = |source| AccessError::Closed { target: self.target(), source };
        let nonce = random_bytes()?;
        // A refusal may be on its way although the gateway no longer reads.
        let sent = write_all(&mut link, &Handshake::ClientNonce(nonce).frame(self.arm).encode());
        let frame = match read_frame(&mut link) {
            Ok(Some(frame)) => frame,
            Ok(None) => return Err(AccessError::NoChallenge { target: target() }),
            Err(gone) => return Err(closed(sent.err().unwrap_or(gone))),
        };
        if let Ok(GatewayMessage::Reject(reject)) = GatewayMessage::decode(&frame) {
            return Err(self.refusal(reject.reason));
        }
        let Ok(Handshake::Challenge(gateway_nonce, proof)) = Handshake::decode(&frame) else {
            return Err(AccessError::NoChallenge { target: target() });
        };
        let agreement = Agreement::new(self.key, self.arm, nonce, gateway_nonce);
        if !agreement.is_proof(Side::Gateway, &proof) {
            return Err(AccessError::KeyMismatch { target: target() });
        }
        let proof = Handshake::Proof(agreement.proof(Side::Host));
        write_all(&mut link, &proof.frame(self.arm).encode()).map_err(closed)?;
        Ok(KeyedLink::new(link, &agreement, Side::Host))
    }

    fn refusal(&self, reason: RejectReason) -> AccessError {
        let target = self.target();
        match reason {
            RejectReason::PeerNotAllowed => AccessError::PeerNotAllowed { target },
            RejectReason::TooManyPeers => AccessError::TooManyPeers { target },
            RejectReason::KeyMismatch => AccessError::KeyMismatch { target },
            reason => AccessError::Refused { target, reason },
        }
    }
}

/// Writes a frame of the handshake: a new connection has room for it.
fn write_all(link: &mut impl ByteLink, bytes: &[u8]) -> Result<(), Unplugged> {
    let (mut written, end) = (0, now() + HELLO_TIMEOUT);
    while written < bytes.len() && now() < end {
        written += link.try_write(&bytes[written..])?;
    }
    Ok(())
}

/// Reads one frame and no byte more; `None` if none comes in time, or other bytes do.
fn read_frame(link: &mut impl ByteLink) -> Result<Option<Frame>, Unplugged> {
    let (mut bytes, end) = ([0; FRAME_BYTES_MAX], now() + HELLO_TIMEOUT);
    let mut length = 0;
    loop {
        let needed = match first_frame(&bytes[..length]) {
            FirstFrame::Frame { frame, .. } => return Ok(Some(frame)),
            FirstFrame::None => return Ok(None),
            FirstFrame::Incomplete { needed } => needed,
        };
        let left = end.saturating_since(now());
        if left == Duration::ZERO {
            return Ok(None);
        }
        // What follows the frame belongs to the records.
        match link.try_read(&mut bytes[length..needed])? {
            0 => drop(wait(Some(link), false, None, left)),
            count => length += count,
        }
    }
}

codes! {
    AccessError, "A gateway on TCP does not open the connection" {
        PeerNotAllowed = "PB3DP-ARM-601": "The address of this computer is not on the gateway's list."; "Add it to `access.peers` in the gateway's file, and start the gateway again.";
        TooManyPeers = "PB3DP-ARM-602": "The gateway gets more new connections than it examines."; "End the program that opens them, then try again.";
        KeyMismatch = "PB3DP-ARM-603": "Host and gateway have different keys, or different numbers of the arm."; "Copy the gateway's key file to this computer, and compare the numbers.";
        Refused = "PB3DP-ARM-604": "The gateway refused the connection. The message names its reason."; "Compare the number of the arm and the versions of both sides.";
        NoChallenge = "PB3DP-ARM-605": "The other side is no gateway with a key, or is too slow."; "Check address, number of the arm and versions.";
        Closed = "PB3DP-ARM-606": "The gateway closed the connection before it was open."; "Look at the gateway's log.";
        Random = "PB3DP-ARM-607": "The operating system gives no random bytes."; "Start the computer again; report it with the version of the kernel.";
    }
}
