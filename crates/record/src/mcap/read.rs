//! Reads MCAP from front to back, whatever happened to the file: what is whole is given out, what is not is told in a sentence and left out.
//!
//! The index at the end is not used: a file that was cut short has none, and one that lies could send a reader anywhere. Nothing is
//! allocated because a length says so: bytes are read first, up to [`LARGEST_RECORD`]. What is kept between records is the list of channels.

use std::collections::BTreeSet;
use std::io::Read;

use crate::error::RecordError;

use super::{MAGIC, crc, op};

/// Largest record that is read, bytes; our own chunks are a sixteenth of it.
pub const LARGEST_RECORD: u64 = 64 << 20;

/// Most schemas and most channels.
const MOST_DECLARED: usize = 1000;

/// Longest name or topic, bytes: thousands of them may be kept.
const LONGEST_NAME: usize = 1000;

/// Longest key or value of a fact, bytes; settings are attachments, not metadata.
const LONGEST_TEXT: usize = 1 << 20;

/// Most named facts of one metadata record.
const MOST_FACTS: usize = 10_000;

/// What a file gives out, in order.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// A kind of message was declared.
    Schema {
        /// Its number in this file.
        id: u16,
        /// Its full name.
        name: String,
        /// How its descriptor is written: "protobuf", "jsonschema" …
        encoding: String,
    },
    /// A stream of messages was declared.
    Channel {
        /// Its number in this file.
        id: u16,
        /// Number of its schema; 0 for none.
        schema: u16,
        /// Its topic.
        topic: String,
        /// How its messages are written: "protobuf", "json" …
        encoding: String,
    },
    /// A message.
    Message {
        /// Number of its channel, which was declared before.
        channel: u16,
        /// Its number within the channel.
        sequence: u32,
        /// When it was recorded, ns.
        log_ns: u64,
        /// When what it speaks of was so, ns.
        publish_ns: u64,
        /// Its content.
        data: Vec<u8>,
    },
    /// A chunk was read to its end: everything before is safe.
    Chunk {
        /// Where it began in the file.
        offset: u64,
        /// Its length in the file, bytes.
        length: u64,
    },
    /// A file within the file.
    Attachment {
        /// Its name.
        name: String,
        /// Its content.
        data: Vec<u8>,
    },
    /// Named facts.
    Metadata {
        /// Their common name.
        name: String,
        /// The facts.
        facts: Vec<(String, String)>,
    },
    /// Something is wrong; what follows is still given out where that is possible.
    Problem(Problem),
    /// The file was finished by its writer.
    Finished,
}

/// What is wrong with a file.
#[derive(Clone, Debug, PartialEq)]
pub enum Problem {
    /// The file ends within a record or without an end: its writer was killed, or had no room.
    CutShort {
        /// Where the last record that is whole ends.
        offset: u64,
    },
    /// A record is damaged and was left out.
    Damaged {
        /// Where it begins.
        offset: u64,
        /// What is wrong with it.
        reason: String,
        /// Whether reading ends here, because nothing says where the next record begins.
        last: bool,
    },
}

impl std::fmt::Display for Problem {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Problem::CutShort { offset } => write!(
                f,
                "the file was not finished: it ends after byte {offset}, and everything before that is read"
            ),
            Problem::Damaged {
                offset,
                reason,
                last: false,
            } => write!(f, "the record at byte {offset} is left out: {reason}"),
            Problem::Damaged { offset, reason, .. } => {
                write!(f, "reading ends at byte {offset}: {reason}")
            }
        }
    }
}

/// A file while it is read.
pub struct Reader<R> {
    input: R,
    offset: u64,
    /// What was read and not yet given out, last first.
    waiting: Vec<Event>,
    /// The chunk that is being given out: its bytes, where the next record in it begins, where it lies in the file.
    chunk: Option<OpenChunk>,
    channels: BTreeSet<u16>,
    schemas: BTreeSet<u16>,
    over: bool,
    seen_end: bool,
}

struct OpenChunk {
    bytes: Vec<u8>,
    at: usize,
    offset: u64,
    length: u64,
}

impl<R: Read> Reader<R> {
    /// Begin to read; the first eight bytes must be those of MCAP.
    pub fn new(mut input: R) -> Result<Self, RecordError> {
        let mut magic = Vec::new();
        input
            .by_ref()
            .take(8)
            .read_to_end(&mut magic)
            .map_err(failed)?;
        if magic != MAGIC {
            return Err(RecordError::Format(not_mcap(&magic)));
        }
        Ok(Self {
            input,
            offset: 8,
            waiting: Vec::new(),
            chunk: None,
            channels: BTreeSet::new(),
            schemas: BTreeSet::new(),
            over: false,
            seen_end: false,
        })
    }

    /// The next event; `None` at the end, and ever after. An error is one of the disk, not of the file.
    pub fn next_event(&mut self) -> Result<Option<Event>, RecordError> {
        loop {
            if let Some(event) = self.waiting.pop() {
                return Ok(Some(event));
            }
            if let Some(event) = self.next_in_chunk() {
                return Ok(Some(event));
            }
            if self.over {
                return Ok(None);
            }
            self.read_record()?;
        }
    }

    /// Read one record into `waiting` or `chunk`.
    fn read_record(&mut self) -> Result<(), RecordError> {
        let start = self.offset;
        let mut head = Vec::new();
        self.fill(&mut head, 9)?;
        if self.seen_end && head == MAGIC {
            self.over = true;
            self.waiting.push(Event::Finished);
            return Ok(());
        }
        if head.len() < 9 {
            self.cut(start);
            return Ok(());
        }
        let opcode = head[0];
        let length = u64::from_le_bytes(eight(&head[1..9]));
        if !(op::HEADER..=op::DATA_END).contains(&opcode) && opcode < 0x80 {
            self.stop(start, format!("there is no kind of record {opcode:#04x}"));
            return Ok(());
        }
        if length > LARGEST_RECORD {
            let reason = format!(
                "a record says that it has {length} bytes; the largest that is read has {LARGEST_RECORD}"
            );
            self.stop(start, reason);
            return Ok(());
        }
        let mut content = Vec::new();
        self.fill(&mut content, length)?;
        if (content.len() as u64) < length {
            self.cut(start);
            return Ok(());
        }
        self.take(opcode, &content, start);
        Ok(())
    }

    /// Read up to `count` bytes.
    fn fill(&mut self, bytes: &mut Vec<u8>, count: u64) -> Result<(), RecordError> {
        let read = self
            .input
            .by_ref()
            .take(count)
            .read_to_end(bytes)
            .map_err(failed)?;
        self.offset += read as u64;
        Ok(())
    }

    fn cut(&mut self, offset: u64) {
        self.over = true;
        self.waiting
            .push(Event::Problem(Problem::CutShort { offset }));
    }

    fn stop(&mut self, offset: u64, reason: String) {
        self.over = true;
        let last = true;
        self.waiting.push(Event::Problem(Problem::Damaged {
            offset,
            reason,
            last,
        }));
    }

    /// One whole record of the file.
    fn take(&mut self, opcode: u8, content: &[u8], offset: u64) {
        let mut rest = Bytes(content);
        let taken = match opcode {
            op::CHUNK => open_chunk(&mut rest, offset, 9 + content.len() as u64).map(|chunk| {
                self.chunk = Some(chunk);
                None
            }),
            op::ATTACHMENT => attachment(content).map(Some),
            op::METADATA => metadata(&mut rest).map(Some),
            op::FOOTER => {
                self.seen_end = true;
                Ok(None)
            }
            op::SCHEMA | op::CHANNEL | op::MESSAGE => self.declared(opcode, rest),
            // Indexes and statistics say what was read already; kinds from 0x80 on are private by the specification.
            _ => Ok(None),
        };
        match taken {
            Ok(event) => self.waiting.extend(event),
            Err(reason) => self.waiting.push(Event::Problem(Problem::Damaged {
                offset,
                reason,
                last: false,
            })),
        }
    }

    /// The next record of the open chunk.
    fn next_in_chunk(&mut self) -> Option<Event> {
        loop {
            let mut chunk = self.chunk.take()?;
            if chunk.at == chunk.bytes.len() {
                return Some(Event::Chunk {
                    offset: chunk.offset,
                    length: chunk.length,
                });
            }
            let offset = chunk.offset;
            let mut rest = Bytes(&chunk.bytes[chunk.at..]);
            let read = (|| {
                let opcode = rest.byte()?;
                let length = rest.count()?;
                Ok((opcode, rest.slice(length)?))
            })();
            let taken = read.and_then(|(opcode, content)| self.declared(opcode, Bytes(content)));
            match taken {
                Ok(event) => {
                    chunk.at = chunk.bytes.len() - rest.0.len();
                    self.chunk = Some(chunk);
                    if event.is_some() {
                        return event;
                    }
                }
                // The checksum was right, so that whoever wrote this wrote it so: the rest of the chunk means nothing.
                Err(reason) => {
                    return Some(Event::Problem(Problem::Damaged {
                        offset,
                        reason: format!("a record within the chunk: {reason}"),
                        last: false,
                    }));
                }
            }
        }
    }

    /// Schemas, channels and messages, which may stand in chunks or beside them.
    fn declared(&mut self, opcode: u8, mut rest: Bytes<'_>) -> Result<Option<Event>, String> {
        match opcode {
            op::SCHEMA => {
                let id = rest.u16()?;
                let name = rest.name()?;
                let encoding = rest.name()?;
                let known = !self.schemas.insert(id);
                if self.schemas.len() > MOST_DECLARED {
                    self.schemas.remove(&id);
                    return Err(format!("more than {MOST_DECLARED} schemas"));
                }
                Ok((!known).then_some(Event::Schema { id, name, encoding }))
            }
            op::CHANNEL => {
                let id = rest.u16()?;
                let schema = rest.u16()?;
                let topic = rest.name()?;
                let encoding = rest.name()?;
                let known = !self.channels.insert(id);
                if self.channels.len() > MOST_DECLARED {
                    self.channels.remove(&id);
                    return Err(format!("more than {MOST_DECLARED} channels"));
                }
                Ok((!known).then_some(Event::Channel {
                    id,
                    schema,
                    topic,
                    encoding,
                }))
            }
            op::MESSAGE => {
                let channel = rest.u16()?;
                if !self.channels.contains(&channel) {
                    return Err(format!(
                        "a message of channel {channel}, which was never declared"
                    ));
                }
                Ok(Some(Event::Message {
                    channel,
                    sequence: rest.u32()?,
                    log_ns: rest.u64()?,
                    publish_ns: rest.u64()?,
                    data: rest.0.to_vec(),
                }))
            }
            _ => Ok(None),
        }
    }
}

fn open_chunk(rest: &mut Bytes<'_>, offset: u64, length: u64) -> Result<OpenChunk, String> {
    let _times = (rest.u64()?, rest.u64()?);
    let size = rest.u64()?;
    let sum = rest.u32()?;
    let compression = rest.name()?;
    let stored = rest.count()?;
    let records = rest.slice(stored)?;
    if !compression.is_empty() {
        return Err(format!(
            "its chunk is compressed ({}); only chunks without compression are read, `mcap compress --compression none` makes them",
            compression.escape_debug()
        ));
    }
    if size != records.len() as u64 {
        return Err(format!(
            "its chunk says that it has {size} bytes, and has {}",
            records.len()
        ));
    }
    // 0 says that there is no checksum.
    let found = crc(records);
    if sum != 0 && sum != found {
        return Err(format!(
            "its checksum is {found:#010x} where {sum:#010x} was written"
        ));
    }
    Ok(OpenChunk {
        bytes: records.to_vec(),
        at: 0,
        offset,
        length,
    })
}

fn attachment(content: &[u8]) -> Result<Event, String> {
    let mut rest = Bytes(content);
    let _times = (rest.u64()?, rest.u64()?);
    let name = rest.name()?;
    let _media_type = rest.name()?;
    let length = rest.count()?;
    let data = rest.slice(length)?.to_vec();
    let covered = content.len() - rest.0.len();
    let sum = rest.u32()?;
    let found = crc(&content[..covered]);
    if sum != 0 && sum != found {
        return Err(format!(
            "the checksum of the attachment {name:?} is {found:#010x} where {sum:#010x} was written"
        ));
    }
    Ok(Event::Attachment { name, data })
}

fn metadata(rest: &mut Bytes<'_>) -> Result<Event, String> {
    let name = rest.name()?;
    let length = rest.u32()? as usize;
    let mut map = Bytes(rest.slice(length)?);
    let mut facts = Vec::new();
    while !map.0.is_empty() {
        if facts.len() == MOST_FACTS {
            return Err(format!("more than {MOST_FACTS} facts of {name:?}"));
        }
        facts.push((map.text(LONGEST_TEXT)?, map.text(LONGEST_TEXT)?));
    }
    Ok(Event::Metadata { name, facts })
}

/// Bytes that are read from the front.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn slice(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (head, rest) = self.0.split_at_checked(count).ok_or_else(|| {
            format!(
                "{count} bytes are announced where {} are left",
                self.0.len()
            )
        })?;
        self.0 = rest;
        Ok(head)
    }

    fn byte(&mut self) -> Result<u8, String> {
        Ok(self.slice(1)?[0])
    }

    fn u16(&mut self) -> Result<u16, String> {
        let b = self.slice(2)?;
        Ok(u16::from_le_bytes([b[0], b[1]]))
    }

    fn u32(&mut self) -> Result<u32, String> {
        let b = self.slice(4)?;
        Ok(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }

    fn u64(&mut self) -> Result<u64, String> {
        Ok(u64::from_le_bytes(eight(self.slice(8)?)))
    }

    /// A length of eight bytes.
    fn count(&mut self) -> Result<usize, String> {
        let count = self.u64()?;
        usize::try_from(count).map_err(|_| format!("a length of {count} bytes"))
    }

    fn name(&mut self) -> Result<String, String> {
        self.text(LONGEST_NAME)
    }

    fn text(&mut self, longest: usize) -> Result<String, String> {
        let length = self.u32()? as usize;
        if length > longest {
            return Err(format!("a text of {length} bytes, at most {longest}"));
        }
        let bytes = self.slice(length)?;
        String::from_utf8(bytes.to_vec()).map_err(|_| "a text that is not UTF-8".to_owned())
    }
}

fn eight(bytes: &[u8]) -> [u8; 8] {
    std::array::from_fn(|i| bytes[i])
}

fn failed(source: std::io::Error) -> RecordError {
    RecordError::Io {
        action: "reading",
        source,
    }
}

/// What a file is that does not begin as MCAP does.
fn not_mcap(first: &[u8]) -> String {
    if first.is_empty() {
        return "the file is empty, not a recording".to_owned();
    }
    if first.len() == 8 && first[..5] == MAGIC[..5] && first[6..] == MAGIC[6..] {
        return format!(
            "the recording is of MCAP version '{}'; this program reads version '0'",
            char::from(first[5]).escape_default()
        );
    }
    "the file is not an MCAP recording: it does not begin as one".to_owned()
}
