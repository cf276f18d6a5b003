//! MCAP, the container: written for crashes, read with suspicion.
//!
//! Source: the MCAP format specification, version "0" (mcap.dev). A file is the magic bytes, records, and the magic bytes again; a
//! record is an opcode, a length of eight bytes and its content, all little-endian. Messages lie in chunks with a checksum each. A file without its
//! end is readable to its last whole chunk, because nothing in the chunks refers to the end.

pub mod read;
pub mod write;

pub use read::{Event, Problem, Reader};
pub use write::{Channel, Schema, Writer};

/// The first and the last bytes of every file.
pub const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', b'0', b'\r', b'\n'];

/// Kinds of record, by the specification.
pub(crate) mod op {
    pub(crate) const HEADER: u8 = 0x01;
    pub(crate) const FOOTER: u8 = 0x02;
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
    pub(crate) const MESSAGE_INDEX: u8 = 0x07;
    pub(crate) const CHUNK_INDEX: u8 = 0x08;
    pub(crate) const ATTACHMENT: u8 = 0x09;
    pub(crate) const ATTACHMENT_INDEX: u8 = 0x0a;
    pub(crate) const STATISTICS: u8 = 0x0b;
    pub(crate) const METADATA: u8 = 0x0c;
    pub(crate) const METADATA_INDEX: u8 = 0x0d;
    pub(crate) const SUMMARY_OFFSET: u8 = 0x0e;
    pub(crate) const DATA_END: u8 = 0x0f;
}

/// The profile that our files name in their header; the kinds of channel that they hold are described in docs/reference-recording.md.
pub const PROFILE: &str = "vergence";

/// The checksum of the format: CRC-32 as of Ethernet and zip.
pub(crate) fn crc(bytes: &[u8]) -> u32 {
    crc32fast::hash(bytes)
}
