//! Reading and writing little-endian fields one after the other.

use super::{MessageError, Payload};

/// Reads the fields of a payload whose length was checked.
pub(super) struct Fields<'a> {
    frame_type: u8,
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    /// Fields of a payload that must have this length.
    pub fn new(frame_type: u8, payload: &'a [u8], expected: usize) -> Result<Self, MessageError> {
        let got = payload.len();
        if got == expected {
            Ok(Self { frame_type, rest: payload })
        } else {
            Err(MessageError::Length { frame_type, got, expected })
        }
    }

    /// The next bytes. Callers read no more than they announced.
    pub fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let (bytes, rest) = self.rest.split_at(N);
        self.rest = rest;
        let mut field = [0; N];
        field.copy_from_slice(bytes);
        field
    }

    pub fn u8(&mut self) -> u8 {
        self.bytes::<1>()[0]
    }

    pub fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.bytes())
    }

    pub fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.bytes())
    }

    pub fn i32(&mut self) -> i32 {
        i32::from_le_bytes(self.bytes())
    }

    /// A number that stands for something.
    pub fn code<T>(&mut self, field: &'static str, from_byte: fn(u8) -> Option<T>) -> Result<T, MessageError> {
        let byte = self.u8();
        from_byte(byte).ok_or(self.no_meaning(field, i64::from(byte)))
    }

    /// A version, of which only one is known.
    pub fn version(&mut self, field: &'static str, known: u8) -> Result<(), MessageError> {
        let got = self.u8();
        if got == known { Ok(()) } else { Err(self.no_meaning(field, i64::from(got))) }
    }

    pub fn no_meaning(&self, field: &'static str, got: i64) -> MessageError {
        MessageError::Value { frame_type: self.frame_type, field, got }
    }
}

/// Writes a field.
pub(super) trait Put {
    fn put_u8(&mut self, value: u8);
    fn put_u16(&mut self, value: u16);
    fn put_u32(&mut self, value: u32);
    fn put_i32(&mut self, value: i32);
}

impl Put for Payload {
    fn put_u8(&mut self, value: u8) {
        self.extend(&[value]);
    }
    fn put_u16(&mut self, value: u16) {
        self.extend(&value.to_le_bytes());
    }
    fn put_u32(&mut self, value: u32) {
        self.extend(&value.to_le_bytes());
    }
    fn put_i32(&mut self, value: i32) {
        self.extend(&value.to_le_bytes());
    }
}
