//! A limit on chunks that a few bytes would decompress to gigabytes.
//!
//! The reader of MCAP decompresses a chunk up to the size that the chunk announces, whatever this is.

use std::io::{Error, ErrorKind, Read, Result};

use crate::raw::RECORD_MAX;

/// Largest chunk after decompression, bytes. Chosen: twice the longest record; writers end a chunk after some megabytes.
const DECOMPRESSED_MAX: u64 = 2 * RECORD_MAX as u64;

/// Bytes before the first record: magic (MCAP specification, "Format Description").
const MAGIC_BYTES: u64 = 8;
/// Opcode and length of a record.
const HEAD_BYTES: usize = 9;
/// Begin of a chunk with its head: times, size after decompression, check sum, and length of the name of its compression.
const CHUNK_BYTES: usize = HEAD_BYTES + 32;
const OP_CHUNK: u8 = 6;

/// Passes the bytes of an MCAP file on up to the first compressed chunk that announces too much.
pub(crate) struct ChunkLimit<R> {
    source: R,
    /// Bytes before the next record.
    skipped: u64,
    /// The begin of the present record.
    head: Vec<u8>,
}

impl<R> ChunkLimit<R> {
    /// `source`: a file from its begin.
    pub(crate) fn new(source: R) -> Self {
        Self { source, skipped: MAGIC_BYTES, head: Vec::with_capacity(CHUNK_BYTES) }
    }

    fn check(&mut self, mut bytes: &[u8]) -> Result<()> {
        while !bytes.is_empty() {
            let skipped = bytes.len().min(usize::try_from(self.skipped).unwrap_or(usize::MAX));
            self.skipped -= skipped as u64;
            bytes = &bytes[skipped..];
            let needed = if self.head.first() == Some(&OP_CHUNK) { CHUNK_BYTES } else { HEAD_BYTES };
            let (taken, rest) = bytes.split_at(bytes.len().min(needed - self.head.len()));
            self.head.extend_from_slice(taken);
            bytes = rest;
            let is_whole = match self.head[..] {
                [OP_CHUNK, ..] => self.head.len() == CHUNK_BYTES,
                _ => self.head.len() == HEAD_BYTES,
            };
            if is_whole {
                self.check_head()?;
            }
        }
        Ok(())
    }

    fn check_head(&mut self) -> Result<()> {
        let number = |at: usize| self.head[at..at + 8].iter().rev().fold(0, |sum, byte| sum << 8 | u64::from(*byte));
        let beyond_head = (self.head.len() - HEAD_BYTES) as u64;
        if self.head[0] == OP_CHUNK {
            let decompressed = number(HEAD_BYTES + 16);
            let is_compressed = self.head[CHUNK_BYTES - 4..] != [0; 4];
            if is_compressed && decompressed > DECOMPRESSED_MAX {
                let message = format!(
                    "a chunk has {decompressed} bytes after decompression, at most {DECOMPRESSED_MAX} are read"
                );
                return Err(Error::new(ErrorKind::InvalidData, message));
            }
        }
        self.skipped = number(1).saturating_sub(beyond_head);
        self.head.clear();
        Ok(())
    }
}

impl<R: Read> Read for ChunkLimit<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let read = self.source.read(buffer)?;
        self.check(&buffer[..read])?;
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(opcode: u8, content: &[u8]) -> Vec<u8> {
        [&[opcode][..], &(content.len() as u64).to_le_bytes(), content].concat()
    }

    fn chunk(decompressed: u64, compression: &str) -> Vec<u8> {
        let name = [&(compression.len() as u32).to_le_bytes(), compression.as_bytes()].concat();
        record(OP_CHUNK, &[&[1; 16][..], &decompressed.to_le_bytes(), &[9; 4], &name, &[7; 100]].concat())
    }

    /// A reader that delivers `step` bytes at a time.
    struct Slow<'a>(&'a [u8], usize);

    impl Read for Slow<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
            let length = buffer.len().min(self.1);
            self.0.read(&mut buffer[..length])
        }
    }

    #[test]
    fn a_compressed_chunk_that_announces_too_much_ends_the_file() {
        let read = |records: &[Vec<u8>], step: usize| {
            let file = [vec![b'M'; 8], records.concat()].concat();
            let mut passed = Vec::new();
            let result = ChunkLimit::new(Slow(&file, step)).read_to_end(&mut passed);
            result.map(|_| assert_eq!(passed, file)).map_err(|error| error.to_string())
        };
        let small = [record(1, b"header"), record(4, &[]), chunk(DECOMPRESSED_MAX, "zstd"), chunk(u64::MAX, "")];
        for step in [1, 7, 9, 50, 4096] {
            assert_eq!(read(&small, step), Ok(()));
            let large = [&small[..], &[chunk(DECOMPRESSED_MAX + 1, "lz4"), record(15, b"end")]].concat();
            let refused = "a chunk has 1073741825 bytes after decompression, at most 1073741824 are read";
            assert_eq!(read(&large, step), Err(refused.to_owned()));
        }
        // A file that ends within a record.
        assert_eq!(read(&[chunk(5, "zstd")[..20].to_vec()], 3), Ok(()));
        assert_eq!(read(&[vec![OP_CHUNK, 3, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3]], 3), Ok(()));
    }
}
