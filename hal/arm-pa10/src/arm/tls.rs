//! TLS around a byte link: frames that nobody on the network can read, and a gateway that is known by its certificate.

use std::io::{ErrorKind, Read as _, Write};
use std::os::fd::BorrowedFd;

use pb3dp_arm_pa10_protocol::gateway_protocol::{FRAME_BYTES_MAX, FirstFrame, first_frame};
use pb3dp_hal_platform::transport::{ByteLink, Symptom, Unplugged};
use rustls::Connection;

/// Bytes that are read from the line at once.
const PIECE: usize = 4096;

/// Pieces that one read decrypts: a peer that sends empty records must not keep the thread that reads.
const PIECES_MAX: usize = 4;

/// Bytes of frames that one call accepts, and thereby the largest record that waits in a full line.
const UNSENT_MAX: usize = 4096;

/// Why a TLS connection does not open.
#[derive(Debug, thiserror::Error)]
pub enum HandshakeError {
    /// The other side answers with a frame instead of TLS.
    #[error("the other side uses no TLS")]
    Plain {
        /// Its first bytes.
        bytes: Vec<u8>,
    },
    /// The line is gone.
    #[error(transparent)]
    Gone(#[from] Unplugged),
    /// The other side, or its certificate, is refused.
    #[error(transparent)]
    Tls(#[from] rustls::Error),
}

/// A link whose bytes travel in records of TLS 1.3.
///
/// The first record that is not authentic ends the link. At most one record waits in a full line, and a record is written when the line
/// takes bytes again: with the next read or write. The link ends without a closing alert: every end counts as a silent peer.
pub struct TlsLink<L> {
    link: L,
    connection: Connection,
    /// Whether the other side has sent something.
    is_received: bool,
    /// Decrypted bytes that were not read yet.
    unread: usize,
    /// A lost link stays lost.
    gone: Option<Unplugged>,
}

impl<L: ByteLink> TlsLink<L> {
    /// One side of a connection on this link, before its handshake.
    pub fn new(link: L, connection: impl Into<Connection>) -> Self {
        let mut connection = connection.into();
        connection.set_buffer_limit(Some(UNSENT_MAX));
        Self { link, connection, is_received: false, unread: 0, gone: None }
    }

    /// Continues the handshake without blocking; whether it is complete.
    ///
    /// # Errors
    /// If the link is gone, or the other side is refused or uses no TLS.
    pub fn advance_handshake(&mut self) -> Result<bool, HandshakeError> {
        self.flush()?;
        while self.connection.is_handshaking() {
            let received = self.receive();
            // The Finished of this side, or an alert that says why there is none.
            self.flush()?;
            if received? == 0 {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// The line below, when there is no TLS on it.
    pub fn into_line(self) -> L {
        self.link
    }

    /// The line below, to write a refusal without TLS.
    pub fn line(&mut self) -> &mut L {
        &mut self.link
    }

    /// Decrypts the bytes that the line has, at most one piece; their number.
    fn receive(&mut self) -> Result<usize, HandshakeError> {
        let mut piece = [0; PIECE];
        let count = self.link.try_read(&mut piece)?;
        let mut bytes = &piece[..count];
        // A record of TLS never begins like a frame.
        if count > 0
            && !std::mem::replace(&mut self.is_received, true)
            && !matches!(first_frame(&bytes[..count.min(FRAME_BYTES_MAX)]), FirstFrame::None)
        {
            return Err(HandshakeError::Plain { bytes: bytes.to_vec() });
        }
        while !bytes.is_empty() {
            let taken =
                self.connection.read_tls(&mut bytes).map_err(|_| Unplugged { symptom: Symptom::NotAuthentic })?;
            self.unread = self.connection.process_new_packets()?.plaintext_bytes_to_read();
            if taken == 0 {
                // The other side has sent its closing alert.
                return Err(Unplugged { symptom: Symptom::EndOfStream }.into());
            }
        }
        Ok(count)
    }

    fn flush(&mut self) -> Result<(), Unplugged> {
        let mut line = Line { link: &mut self.link, gone: None };
        while self.connection.wants_write() {
            if self.connection.write_tls(&mut line).is_err() {
                return line.gone.map_or(Ok(()), Err);
            }
        }
        Ok(())
    }

    /// Decrypts until there is something to read, the line has no more, or enough was decrypted: a poll reports the rest of the line.
    fn fill(&mut self) -> Result<(), Unplugged> {
        self.flush()?;
        for _ in 0..PIECES_MAX {
            if self.unread > 0 {
                break;
            }
            let received = self.receive().map_err(|error| match error {
                HandshakeError::Gone(gone) => gone,
                HandshakeError::Tls(_) | HandshakeError::Plain { .. } => Unplugged { symptom: Symptom::NotAuthentic },
            });
            if received? == 0 {
                break;
            }
        }
        Ok(())
    }

    /// Encrypts what the buffer takes, and writes what the line takes.
    fn send(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.flush()?;
        if self.connection.wants_write() {
            return Ok(0);
        }
        let broken = |_| Unplugged { symptom: Symptom::NotAuthentic };
        let count = self.connection.writer().write(bytes).map_err(broken)?;
        self.flush()?;
        Ok(count)
    }

    /// Runs unless the link is lost, and notes its loss.
    fn unless_gone<T>(&mut self, run: impl FnOnce(&mut Self) -> Result<T, Unplugged>) -> Result<T, Unplugged> {
        if let Some(gone) = self.gone {
            return Err(gone);
        }
        run(self).inspect_err(|&gone| self.gone = Some(gone))
    }
}

impl<L: ByteLink> ByteLink for TlsLink<L> {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        self.unless_gone(|link| {
            link.fill()?;
            if link.unread == 0 {
                return Ok(0);
            }
            let broken = |_| Unplugged { symptom: Symptom::NotAuthentic };
            let count = link.connection.reader().read(buffer).map_err(broken)?;
            link.unread = link.unread.saturating_sub(count);
            Ok(count)
        })
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.unless_gone(|link| link.send(bytes))
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.link.fd()
    }

    fn has_unread(&self) -> bool {
        self.unread > 0
    }

    fn warning(&self) -> Option<String> {
        self.link.warning()
    }
}

/// A byte link as rustls writes to it.
struct Line<'a, L> {
    link: &'a mut L,
    gone: Option<Unplugged>,
}

impl<L: ByteLink> Write for Line<'_, L> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        match self.link.try_write(bytes) {
            Ok(0) => Err(ErrorKind::WouldBlock.into()),
            Ok(count) => Ok(count),
            Err(gone) => {
                self.gone = Some(gone);
                Err(ErrorKind::NotConnected.into())
            }
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "helpers of tests")]

    use std::time::Duration;

    use pb3dp_hal_platform::transport::{PairLink, pair, wait};

    use super::super::certificate::{GatewayIdentity, PinnedCertificate, write_new_certificate};
    use super::*;

    fn connected() -> [TlsLink<PairLink>; 2] {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("gateway.crt");
        let key = write_new_certificate(&file).unwrap();
        let (gateway, host) = pair("tls").unwrap();
        let tcp = pb3dp_hal_platform::tcp::TcpConfig { address: "127.0.0.1:1".parse().unwrap() };
        let gateway = GatewayIdentity::read(&file, &key).unwrap().accept(gateway).unwrap();
        let host = PinnedCertificate::read(&file).unwrap().connect(host, &tcp).unwrap();
        let mut ends = [gateway, host];
        while ends.iter().any(|end| end.connection.is_handshaking()) {
            for end in &mut ends {
                end.advance_handshake().unwrap();
            }
        }
        ends
    }

    fn read_all(link: &mut impl ByteLink, length: usize) -> Vec<u8> {
        let (mut bytes, mut buffer) = (Vec::new(), [0; 7]);
        while bytes.len() < length {
            let count = link.try_read(&mut buffer).unwrap();
            bytes.extend_from_slice(&buffer[..count]);
        }
        bytes
    }

    #[test]
    fn bytes_pass_both_ways_also_after_new_keys() {
        let [mut gateway, mut host] = connected();
        for round in 0..4u8 {
            for (from, to) in [(0, 1), (1, 0)] {
                let ends = [&mut gateway, &mut host];
                let bytes: Vec<u8> = (0..200).map(|byte| byte ^ round).collect();
                assert_eq!(ends[from].try_write(&bytes).unwrap(), bytes.len());
                assert_eq!(read_all(ends[to], bytes.len()), bytes);
            }
            // As rustls does after 2^24 records of AES-GCM: hours of a run.
            host.connection.refresh_traffic_keys().unwrap();
        }
    }

    /// rustls accepts 32 requests for new keys in a row.
    #[test]
    fn a_peer_that_only_asks_for_new_keys_is_cut_off() {
        let [mut gateway, mut host] = connected();
        for _ in 0..40 {
            host.connection.refresh_traffic_keys().unwrap();
            host.flush().unwrap();
        }
        let mut read = Ok(0);
        for _ in 0..10 {
            read = gateway.try_read(&mut [0; 40]);
        }
        assert_eq!(read.unwrap_err().symptom, Symptom::NotAuthentic);
    }

    /// Nobody waits for bytes that were received already.
    #[test]
    fn bytes_that_were_received_end_a_wait() {
        let [mut gateway, mut host] = connected();
        host.try_write(&[1; 100]).unwrap();
        assert!(!gateway.has_unread());
        assert_eq!(gateway.try_read(&mut [0; 40]).unwrap(), 40);
        assert!(gateway.has_unread());
        assert!(wait(Some(&gateway), false, None, Duration::from_secs(60)).readable);
        assert_eq!(read_all(&mut gateway, 60), [1; 60]);
        assert!(!gateway.has_unread());
        assert_eq!(gateway.try_read(&mut [0; 40]).unwrap(), 0);
    }

    #[test]
    fn a_changed_record_ends_the_link() {
        let [mut gateway, mut host] = connected();
        host.try_write(&[1; 100]).unwrap();
        let mut record = [0; 512];
        let length = gateway.link.try_read(&mut record).unwrap();
        record[length - 1] ^= 1;
        host.link.try_write(&record[..length]).unwrap();
        let gone = Unplugged { symptom: Symptom::NotAuthentic };
        for _ in 0..2 {
            assert_eq!(gateway.try_read(&mut [0; 512]).unwrap_err(), gone);
        }
        assert_eq!(gateway.try_write(&[1]).unwrap_err(), gone);
    }

    /// A peer that does not read: the link keeps one record, and delivers it later.
    #[test]
    fn a_full_line_takes_no_more_and_loses_nothing() {
        let [mut gateway, mut host] = connected();
        let mut sent = 0;
        loop {
            let count = host.try_write(&[3; 2 * UNSENT_MAX]).unwrap();
            assert!(count <= UNSENT_MAX);
            if count == 0 {
                break;
            }
            sent += count;
        }
        let mut buffer = [0; PIECE];
        let mut received = 0;
        while received < sent {
            received += gateway.try_read(&mut buffer).unwrap();
            assert_eq!(host.try_read(&mut buffer).unwrap(), 0);
        }
        assert_eq!(received, sent);
        drop(host);
        assert_eq!(gateway.try_read(&mut buffer).unwrap_err().symptom, Symptom::EndOfStream);
    }
}
