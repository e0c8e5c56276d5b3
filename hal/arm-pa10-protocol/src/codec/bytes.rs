//! Bytes on the stack.

/// At most `N` bytes, without allocation. Those that are not in use are zero, so equal contents are equal.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct ByteBuffer<const N: usize> {
    bytes: [u8; N],
    length: usize,
}

impl<const N: usize> ByteBuffer<N> {
    /// No bytes.
    pub const EMPTY: Self = Self { bytes: [0; N], length: 0 };

    /// A copy, or `None` if there are more than `N` bytes.
    pub fn from_slice(bytes: &[u8]) -> Option<Self> {
        let mut buffer = Self::EMPTY;
        buffer.bytes.get_mut(..bytes.len())?.copy_from_slice(bytes);
        buffer.length = bytes.len();
        Some(buffer)
    }

    /// The bytes.
    pub fn as_slice(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    /// Appends bytes that fit: callers choose `N` by the longest thing they encode.
    pub fn extend(&mut self, bytes: &[u8]) {
        let end = self.length + bytes.len();
        self.bytes[self.length..end].copy_from_slice(bytes);
        self.length = end;
    }
}

impl<const N: usize> std::ops::Deref for ByteBuffer<N> {
    type Target = [u8];
    fn deref(&self) -> &[u8] {
        self.as_slice()
    }
}

impl<const N: usize> std::fmt::Debug for ByteBuffer<N> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("[")?;
        for (index, byte) in self.as_slice().iter().enumerate() {
            let gap = if index == 0 { "" } else { " " };
            write!(f, "{gap}{byte:02x}")?;
        }
        f.write_str("]")
    }
}
