//! Common Data Representation (CDR), the encoding of ROS 2 messages: plain CDR (XCDR1) of the OMG specification DDSI-RTPS, chapter 10.
//!
//! A message begins with four bytes that name the byte order. A number is aligned to its own size, counted from the end of these bytes. A
//! string has its length with the final zero byte, a sequence its number of elements. [`to_bytes`] writes little-endian; [`from_bytes`]
//! reads both byte orders.

/// First bytes of a message: plain CDR, little-endian.
const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];
/// First bytes of a message: plain CDR, big-endian.
const BIG_ENDIAN: [u8; 4] = [0, 0, 0, 0];

/// Why bytes are not the expected message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// The first bytes name another encoding.
    #[error("the encoding {0:02x?} is not plain CDR")]
    Encoding([u8; 4]),
    /// The message ends early.
    #[error("the message ends at byte {length}, where {needed} more are needed")]
    Short {
        /// Length of the message, bytes.
        length: usize,
        /// Number of missing bytes.
        needed: usize,
    },
    /// A string is not UTF-8, or has no final zero byte.
    #[error("the string at byte {at} is damaged")]
    Text {
        /// Position of its first byte.
        at: usize,
    },
    /// A truth value is neither 0 nor 1.
    #[error("the truth value at byte {at} is {value}")]
    Bool {
        /// Its position.
        at: usize,
        /// The value.
        value: u8,
    },
}

/// A value with a CDR encoding and a ROS 2 type.
pub trait CdrValue: Sized {
    /// The name of the type in a message definition.
    fn ros_type() -> String;

    /// Adds the definitions of the messages in this type: name and fields, each message after those that contain it.
    fn define(_definitions: &mut Vec<(&'static str, String)>) {}

    /// Writes the value.
    fn write(&self, writer: &mut CdrWriter);

    /// Reads a value.
    ///
    /// # Errors
    /// If the bytes are not such a value.
    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError>;
}

/// Encodes a message.
pub fn to_bytes(message: &impl CdrValue) -> Vec<u8> {
    let mut writer = CdrWriter { bytes: LITTLE_ENDIAN.to_vec() };
    message.write(&mut writer);
    writer.bytes
}

/// Decodes a message; bytes behind it are ignored.
///
/// # Errors
/// If the bytes are not such a message.
pub fn from_bytes<T: CdrValue>(bytes: &[u8]) -> Result<T, CdrError> {
    let (head, body) = bytes
        .split_first_chunk::<4>()
        .ok_or(CdrError::Short { length: bytes.len(), needed: 4_usize.saturating_sub(bytes.len()) })?;
    let is_big_endian = match [head[0], head[1], 0, 0] {
        LITTLE_ENDIAN => false,
        BIG_ENDIAN => true,
        _ => return Err(CdrError::Encoding(*head)),
    };
    T::read(&mut CdrReader { body, at: 0, is_big_endian })
}

/// Writes values.
#[derive(Debug)]
pub struct CdrWriter {
    bytes: Vec<u8>,
}

impl CdrWriter {
    fn number<const N: usize>(&mut self, little_endian: [u8; N]) {
        let body = self.bytes.len() - LITTLE_ENDIAN.len();
        self.bytes.resize(LITTLE_ENDIAN.len() + body.next_multiple_of(N), 0);
        self.bytes.extend_from_slice(&little_endian);
    }

    /// A length or count. Messages longer than 4 GB cannot be written; no image is that large.
    fn count(&mut self, count: usize) {
        self.number(u32::try_from(count).unwrap_or(u32::MAX).to_le_bytes());
    }
}

/// Reads values.
#[derive(Debug)]
pub struct CdrReader<'a> {
    body: &'a [u8],
    at: usize,
    is_big_endian: bool,
}

impl<'a> CdrReader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], CdrError> {
        let left = self.body.len().saturating_sub(self.at);
        let taken = self.body.get(self.at..).and_then(|rest| rest.get(..count));
        let taken = taken.ok_or(CdrError::Short {
            length: LITTLE_ENDIAN.len() + self.body.len(),
            needed: count.saturating_sub(left),
        })?;
        self.at += count;
        Ok(taken)
    }

    /// The bytes of a number, least significant first.
    fn number<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        self.at = self.at.next_multiple_of(N);
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        if self.is_big_endian {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn count(&mut self) -> Result<usize, CdrError> {
        Ok(u32::from_le_bytes(self.number()?) as usize)
    }

    /// Position in the message, with the first four bytes.
    fn position(&self) -> usize {
        LITTLE_ENDIAN.len() + self.at
    }
}

macro_rules! numbers {
    ($($rust:ty = $ros:literal),+ $(,)?) => {$(
        impl CdrValue for $rust {
            fn ros_type() -> String {
                $ros.to_owned()
            }

            fn write(&self, writer: &mut CdrWriter) {
                writer.number(self.to_le_bytes());
            }

            fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
                Ok(Self::from_le_bytes(reader.number()?))
            }
        }
    )+};
}

numbers!(u8 = "uint8", i32 = "int32", u32 = "uint32", u64 = "uint64", f32 = "float32", f64 = "float64");

impl CdrValue for bool {
    fn ros_type() -> String {
        "bool".to_owned()
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.number([u8::from(*self)]);
    }

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let at = reader.position();
        match reader.number()? {
            [0] => Ok(false),
            [1] => Ok(true),
            [value] => Err(CdrError::Bool { at, value }),
        }
    }
}

impl CdrValue for String {
    fn ros_type() -> String {
        "string".to_owned()
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.count(self.len() + 1);
        writer.bytes.extend_from_slice(self.as_bytes());
        writer.bytes.push(0);
    }

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let length = reader.count()?;
        let at = reader.position();
        match reader.take(length)? {
            // Some writers omit the zero byte of an empty string.
            [] => Ok(Self::new()),
            [text @ .., 0] => Self::from_utf8(text.to_vec()).map_err(|_| CdrError::Text { at }),
            _ => Err(CdrError::Text { at }),
        }
    }
}

/// A sequence of bytes, such as the pixels of an image; as a `Vec<u8>`, but copied in one piece.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bytes(pub Vec<u8>);

impl CdrValue for Bytes {
    fn ros_type() -> String {
        "uint8[]".to_owned()
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.count(self.0.len());
        writer.bytes.extend_from_slice(&self.0);
    }

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let count = reader.count()?;
        Ok(Self(reader.take(count)?.to_vec()))
    }
}

impl<T: CdrValue> CdrValue for Vec<T> {
    fn ros_type() -> String {
        format!("{}[]", T::ros_type())
    }

    fn define(definitions: &mut Vec<(&'static str, String)>) {
        T::define(definitions);
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.count(self.len());
        self.iter().for_each(|element| element.write(writer));
    }

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        // Memory is taken for elements that are there, not for those that are announced.
        (0..reader.count()?).map(|_| T::read(reader)).collect()
    }
}

/// A list at the end of a message that older versions did not write: empty then.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Later<T>(pub Vec<T>);

impl<T: CdrValue> CdrValue for Later<T> {
    fn ros_type() -> String {
        Vec::<T>::ros_type()
    }

    fn define(definitions: &mut Vec<(&'static str, String)>) {
        Vec::<T>::define(definitions);
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.0.write(writer);
    }

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        if reader.at >= reader.body.len() { Ok(Self(Vec::new())) } else { Vec::read(reader).map(Self) }
    }
}

impl<T: CdrValue + Copy + Default, const N: usize> CdrValue for [T; N] {
    fn ros_type() -> String {
        format!("{}[{N}]", T::ros_type())
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.iter().for_each(|element| element.write(writer));
    }

    fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
        let mut elements = [T::default(); N];
        for element in &mut elements {
            *element = T::read(reader)?;
        }
        Ok(elements)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes by hand from the specification: alignment counts from the end of the first four bytes.
    #[test]
    fn numbers_are_aligned_to_their_size() {
        struct Mixed(u8, f64, String, u32, [f32; 2]);
        impl CdrValue for Mixed {
            fn ros_type() -> String {
                String::new()
            }
            fn write(&self, writer: &mut CdrWriter) {
                self.0.write(writer);
                self.1.write(writer);
                self.2.write(writer);
                self.3.write(writer);
                self.4.write(writer);
            }
            fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
                let (a, b, c) = (u8::read(reader)?, f64::read(reader)?, String::read(reader)?);
                Ok(Self(a, b, c, u32::read(reader)?, <[f32; 2]>::read(reader)?))
            }
        }
        let bytes = to_bytes(&Mixed(7, 1.0, "ab".to_owned(), 0x0102_0304, [0.5, -2.0]));
        let expected = [
            &[0, 1, 0, 0][..],
            &[7, 0, 0, 0, 0, 0, 0, 0],
            &[0, 0, 0, 0, 0, 0, 0xF0, 0x3F],
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[4, 3, 2, 1],
            &[0, 0, 0, 0x3F, 0, 0, 0, 0xC0],
        ]
        .concat();
        assert_eq!(bytes, expected);
        let Mixed(a, b, c, d, e) = from_bytes(&bytes).unwrap();
        assert_eq!((a, b, c.as_str(), d, e), (7, 1.0, "ab", 0x0102_0304, [0.5, -2.0]));
    }

    #[test]
    fn the_other_byte_order_is_read_too() {
        let bytes = [0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 1, 0, 0, 0, 0, 5];
        assert_eq!(from_bytes::<Vec<u32>>(&bytes).unwrap(), [256, 5]);
    }

    #[test]
    fn damaged_messages_are_refused() {
        assert_eq!(from_bytes::<u32>(&[0, 1]), Err(CdrError::Short { length: 2, needed: 2 }));
        assert_eq!(from_bytes::<u32>(&[0, 7, 0, 0, 1, 0, 0, 0]), Err(CdrError::Encoding([0, 7, 0, 0])));
        assert_eq!(from_bytes::<f64>(&[0, 1, 0, 0, 9]), Err(CdrError::Short { length: 5, needed: 7 }));
        // Four thousand million elements are announced.
        let announced = [0, 1, 0, 0, 255, 255, 255, 255, 1, 0, 0, 0];
        assert!(matches!(from_bytes::<Vec<u32>>(&announced), Err(CdrError::Short { .. })));
        assert!(matches!(from_bytes::<Bytes>(&announced), Err(CdrError::Short { .. })));
        assert!(matches!(from_bytes::<String>(&announced), Err(CdrError::Short { .. })));
        assert_eq!(from_bytes::<String>(&[0, 1, 0, 0, 2, 0, 0, 0, b'a', b'b']), Err(CdrError::Text { at: 8 }));
        assert_eq!(from_bytes::<bool>(&[0, 1, 0, 0, 2]), Err(CdrError::Bool { at: 4, value: 2 }));
        assert_eq!(from_bytes::<String>(&[0, 1, 0, 0, 0, 0, 0, 0]).unwrap(), "");
    }

    #[test]
    fn numbers_that_an_older_version_did_not_write_are_empty() {
        struct Longer(f64, Later<f64>, Later<f64>);
        impl CdrValue for Longer {
            fn ros_type() -> String {
                "test_msgs/Longer".to_owned()
            }

            fn define(_: &mut Vec<(&'static str, String)>) {}

            fn write(&self, writer: &mut CdrWriter) {
                self.0.write(writer);
                self.1.write(writer);
                self.2.write(writer);
            }

            fn read(reader: &mut CdrReader<'_>) -> Result<Self, CdrError> {
                Ok(Self(f64::read(reader)?, Later::read(reader)?, Later::read(reader)?))
            }
        }
        let Longer(first, one, two): Longer = from_bytes(&to_bytes(&2.5_f64)).unwrap();
        assert_eq!((first, one, two), (2.5, Later::default(), Later::default()));
        let bytes = to_bytes(&Longer(2.5, Later(vec![1.0, -2.0]), Later(vec![])));
        let Longer(_, one, two): Longer = from_bytes(&bytes).unwrap();
        assert_eq!((one, two), (Later(vec![1.0, -2.0]), Later(vec![])));
        // Numbers that were cut off are not the same as none.
        assert!(from_bytes::<Longer>(&bytes[..bytes.len() - 8]).is_err());
    }
}
