//! Protocol buffers, as far as recordings need them: fields written one after the other, and read back from bytes that nobody vouches for.
//!
//! Source: the encoding page of the Protocol Buffers documentation (proto3). A message is a row of fields; each begins with a varint
//! `number << 3 | wire type`. Fields at their default are left out, as proto3 asks for, except where presence matters
//! ([`Message::present`]).

use crate::error::RecordError;

/// How a value is laid out on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wire {
    Varint = 0,
    Fixed64 = 1,
    Length = 2,
    Fixed32 = 5,
}

/// A message while it is written.
#[derive(Clone, Debug, Default)]
pub struct Message {
    bytes: Vec<u8>,
}

impl Message {
    /// An empty message.
    pub fn new() -> Self {
        Self::default()
    }

    /// The bytes.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// A `double`, left out when it is +0.
    pub fn double(&mut self, number: u32, value: f64) -> &mut Self {
        if value.to_bits() != 0 {
            self.present().double(number, value);
        }
        self
    }

    /// A varint: `uint64`, `uint32`, `bool`, an enum; left out when 0.
    pub fn varint(&mut self, number: u32, value: u64) -> &mut Self {
        if value != 0 {
            self.present().varint(number, value);
        }
        self
    }

    /// A `fixed32`, left out when 0.
    pub fn fixed32(&mut self, number: u32, value: u32) -> &mut Self {
        if value != 0 {
            self.key(number, Wire::Fixed32);
            self.bytes.extend(value.to_le_bytes());
        }
        self
    }

    /// A `string`, left out when empty.
    pub fn string(&mut self, number: u32, text: &str) -> &mut Self {
        self.bytes(number, text.as_bytes())
    }

    /// `bytes`, left out when empty.
    pub fn bytes(&mut self, number: u32, bytes: &[u8]) -> &mut Self {
        if !bytes.is_empty() {
            self.present().bytes(number, bytes);
        }
        self
    }

    /// `repeated double`, packed.
    pub fn doubles(&mut self, number: u32, values: &[f64]) -> &mut Self {
        if !values.is_empty() {
            self.key(number, Wire::Length);
            push_varint(&mut self.bytes, 8 * values.len() as u64);
            for value in values {
                self.bytes.extend(value.to_le_bytes());
            }
        }
        self
    }

    /// A message within this one; there even when it is empty.
    pub fn message(&mut self, number: u32, write: impl FnOnce(&mut Message)) -> &mut Self {
        let mut inner = Message::new();
        write(&mut inner);
        self.present().bytes(number, &inner.bytes);
        self
    }

    /// Fields written from here are there whatever their value: those declared `optional`.
    pub fn present(&mut self) -> Present<'_> {
        Present(self)
    }

    fn key(&mut self, number: u32, wire: Wire) {
        push_varint(&mut self.bytes, u64::from(number) << 3 | wire as u64);
    }
}

/// Writes fields that are there whatever their value.
pub struct Present<'a>(&'a mut Message);

impl Present<'_> {
    /// A `double`.
    pub fn double(&mut self, number: u32, value: f64) {
        self.0.key(number, Wire::Fixed64);
        self.0.bytes.extend(value.to_le_bytes());
    }

    /// A varint.
    pub fn varint(&mut self, number: u32, value: u64) {
        self.0.key(number, Wire::Varint);
        push_varint(&mut self.0.bytes, value);
    }

    /// `bytes` or a `string`.
    pub fn bytes(&mut self, number: u32, bytes: &[u8]) {
        self.0.key(number, Wire::Length);
        push_varint(&mut self.0.bytes, bytes.len() as u64);
        self.0.bytes.extend(bytes);
    }
}

fn push_varint(bytes: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}

/// One field as read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Field<'a> {
    /// Its number.
    pub number: u32,
    /// Its value.
    pub value: Value<'a>,
}

/// A value as read: its layout says its size, the schema what it means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value<'a> {
    /// A varint.
    Varint(u64),
    /// Eight bytes.
    Fixed64(u64),
    /// Four bytes.
    Fixed32(u32),
    /// Bytes, text, a message or packed numbers.
    Bytes(&'a [u8]),
}

impl<'a> Value<'a> {
    /// As a `double`; `None` for another layout.
    pub fn double(self) -> Option<f64> {
        match self {
            Value::Fixed64(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    /// As a whole number.
    pub fn varint(self) -> Option<u64> {
        match self {
            Value::Varint(value) => Some(value),
            _ => None,
        }
    }

    /// As bytes.
    pub fn bytes(self) -> Option<&'a [u8]> {
        match self {
            Value::Bytes(bytes) => Some(bytes),
            _ => None,
        }
    }

    /// As text; `None` when it is not UTF-8.
    pub fn text(self) -> Option<&'a str> {
        std::str::from_utf8(self.bytes()?).ok()
    }
}

/// The fields of a message, in the order in which they lie there. Ends after the first error.
pub fn fields(bytes: &[u8]) -> Fields<'_> {
    Fields { rest: bytes }
}

/// See [`fields`].
#[derive(Clone, Debug)]
pub struct Fields<'a> {
    rest: &'a [u8],
}

impl<'a> Iterator for Fields<'a> {
    type Item = Result<Field<'a>, RecordError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.rest.is_empty() {
            return None;
        }
        let field = self.field().ok_or_else(|| {
            RecordError::Message(format!(
                "a field ends {} bytes before the message says",
                self.rest.len()
            ))
        });
        if field.is_err() {
            self.rest = &[];
        }
        Some(field)
    }
}

impl<'a> Fields<'a> {
    fn field(&mut self) -> Option<Field<'a>> {
        let key = self.varint()?;
        let number = u32::try_from(key >> 3).ok().filter(|&n| n > 0)?;
        let value = match key & 7 {
            0 => Value::Varint(self.varint()?),
            1 => Value::Fixed64(u64::from_le_bytes(self.take(8)?.try_into().ok()?)),
            2 => {
                let length = usize::try_from(self.varint()?).ok()?;
                Value::Bytes(self.take(length)?)
            }
            5 => Value::Fixed32(u32::from_le_bytes(self.take(4)?.try_into().ok()?)),
            _ => return None,
        };
        Some(Field { number, value })
    }

    fn varint(&mut self) -> Option<u64> {
        let mut value = 0u64;
        for place in 0..10 {
            let byte = *self.take(1)?.first()?;
            value |= u64::from(byte & 0x7f) << (7 * place);
            if byte < 0x80 {
                return Some(value);
            }
        }
        None
    }

    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(head)
    }
}

#[cfg(test)]
mod tests {
    //! Proves: the bytes are those of the documentation's examples; what is written is read; cut messages end with an error.
    use super::*;

    /// `message Test1 { int32 a = 1; }` with a = 150 is 08 96 01; `string b = 2` "testing" is 12 07 and the letters.
    #[test]
    fn the_documentations_examples() {
        let mut m = Message::new();
        m.varint(1, 150).string(2, "testing");
        assert_eq!(
            m.into_bytes(),
            b"\x08\x96\x01\x12\x07testing".as_slice().to_vec()
        );
    }

    /// Defaults are left out, unless presence matters; a negative zero is not a default.
    #[test]
    fn defaults_are_left_out() {
        let mut m = Message::new();
        m.double(1, 0.0).varint(2, 0).string(3, "").fixed32(4, 0);
        assert!(m.clone().into_bytes().is_empty());
        m.double(1, -0.0);
        m.present().double(2, 0.0);
        let bytes = m.into_bytes();
        let read: Vec<_> = fields(&bytes).map(Result::unwrap).collect();
        assert_eq!(read.len(), 2);
        assert!(read[0].value.double().unwrap().is_sign_negative());
    }

    /// Every cut of a message inside a field is an error and nothing else.
    #[test]
    fn cut_messages() {
        let mut m = Message::new();
        m.double(1, 1.5)
            .message(2, |inner| {
                inner.varint(7, u64::MAX);
            })
            .doubles(3, &[1.0, 2.0]);
        let bytes = m.into_bytes();
        let whole = fields(&bytes).filter(Result::is_ok).count();
        assert_eq!(whole, 3);
        for cut in 1..bytes.len() {
            let read: Vec<_> = fields(&bytes[..cut]).collect();
            let good = read.iter().filter(|f| f.is_ok()).count();
            assert!(good < 3);
            assert!(read.iter().rev().skip(1).all(Result::is_ok));
        }
    }
}
