//! Writes MCAP into memory, chunk by chunk; what becomes of the bytes is the caller's business.
//!
//! The writer keeps offsets itself, so that every byte it hands out must be appended to one file in order.

use std::collections::BTreeMap;

use super::{MAGIC, PROFILE, crc, op};

/// Most chunks that are listed at the end of a file (a day at three a second). A longer file is whole and readable, but has no summary.
const MOST_INDEXED: usize = 300_000;

/// A kind of message.
#[derive(Clone, Debug)]
pub struct Schema {
    /// Full name, "foxglove.CompressedImage".
    pub name: String,
    /// Its descriptor, a serialized `FileDescriptorSet`.
    pub data: Vec<u8>,
}

/// A stream of messages of one kind.
#[derive(Clone, Debug)]
pub struct Channel {
    /// Its topic, "/left/image".
    pub topic: String,
    /// Index into the schemas given to [`Writer::new`].
    pub schema: usize,
}

/// An MCAP file while it is written.
pub struct Writer {
    schemas: Vec<Schema>,
    channels: Vec<Channel>,
    /// Records of the chunk that is open.
    records: Vec<u8>,
    /// First and last time of the open chunk, ns.
    times: Option<(u64, u64)>,
    /// Of the open chunk: time and offset of each channel's messages.
    indexes: BTreeMap<u16, Vec<(u64, u64)>>,
    sequences: Vec<u32>,
    /// Length of the file so far, with all that was handed out.
    length: u64,
    chunks: Vec<ChunkIndex>,
    attachments: Vec<Vec<u8>>,
    metadata: Vec<Vec<u8>>,
    chunk_count: u32,
    counts: BTreeMap<u16, u64>,
    whole: Option<(u64, u64)>,
}

struct ChunkIndex {
    times: (u64, u64),
    start: u64,
    length: u64,
    offsets: Vec<(u16, u64)>,
    index_length: u64,
    size: u64,
}

impl Writer {
    /// A writer of a new file, and its first bytes: header, schemas and channels. `library` names the program and its version.
    pub fn new(library: &str, schemas: Vec<Schema>, channels: Vec<Channel>) -> (Self, Vec<u8>) {
        let mut out = MAGIC.to_vec();
        let mut header = Vec::new();
        text(&mut header, PROFILE);
        text(&mut header, library);
        record(&mut out, op::HEADER, &header);
        for record in declarations(&schemas, &channels) {
            out.extend(record);
        }
        let writer = Self {
            sequences: vec![0; channels.len()],
            schemas,
            channels,
            records: Vec::new(),
            times: None,
            indexes: BTreeMap::new(),
            length: out.len() as u64,
            chunks: Vec::new(),
            attachments: Vec::new(),
            metadata: Vec::new(),
            chunk_count: 0,
            counts: BTreeMap::new(),
            whole: None,
        };
        (writer, out)
    }

    /// Bytes of the chunk that is open.
    pub fn open_bytes(&self) -> usize {
        self.records.len()
    }

    /// First and last time of the chunk that is open, ns.
    pub fn open_times(&self) -> Option<(u64, u64)> {
        self.times
    }

    /// Length of the file once everything that was handed out is in it.
    pub fn length(&self) -> u64 {
        self.length
    }

    /// Put a message of `channel` (an index into the channels) into the open chunk; times in nanoseconds.
    pub fn message(&mut self, channel: usize, log_ns: u64, publish_ns: u64, data: &[u8]) {
        let id = channel as u16;
        let at = self.records.len() as u64;
        let length = 2 + 4 + 8 + 8 + data.len();
        self.records.push(op::MESSAGE);
        self.records.extend((length as u64).to_le_bytes());
        self.records.extend(id.to_le_bytes());
        self.records.extend(self.sequences[channel].to_le_bytes());
        self.records.extend(log_ns.to_le_bytes());
        self.records.extend(publish_ns.to_le_bytes());
        self.records.extend(data);
        self.sequences[channel] = self.sequences[channel].wrapping_add(1);
        self.indexes.entry(id).or_default().push((log_ns, at));
        let (first, last) = self.times.unwrap_or((log_ns, log_ns));
        self.times = Some((first.min(log_ns), last.max(log_ns)));
    }

    /// Close the open chunk and hand out its bytes with its index; empty when there is nothing in it.
    pub fn take_chunk(&mut self) -> Vec<u8> {
        let Some(times) = self.times.take() else {
            return Vec::new();
        };
        let records = std::mem::take(&mut self.records);
        let mut out = Vec::with_capacity(records.len() + 4096);
        let head = 8 + 8 + 8 + 4 + 4 + 8;
        out.push(op::CHUNK);
        out.extend((head + records.len() as u64).to_le_bytes());
        out.extend(times.0.to_le_bytes());
        out.extend(times.1.to_le_bytes());
        out.extend((records.len() as u64).to_le_bytes());
        out.extend(crc(&records).to_le_bytes());
        text(&mut out, "");
        out.extend((records.len() as u64).to_le_bytes());
        out.extend(&records);
        let length = out.len() as u64;
        let mut offsets = Vec::new();
        for (id, entries) in std::mem::take(&mut self.indexes) {
            offsets.push((id, self.length + out.len() as u64));
            *self.counts.entry(id).or_default() += entries.len() as u64;
            let mut content = id.to_le_bytes().to_vec();
            content.extend((16 * entries.len() as u32).to_le_bytes());
            for (time, offset) in entries {
                content.extend(time.to_le_bytes());
                content.extend(offset.to_le_bytes());
            }
            record(&mut out, op::MESSAGE_INDEX, &content);
        }
        if self.chunks.len() < MOST_INDEXED {
            self.chunks.push(ChunkIndex {
                times,
                start: self.length,
                length,
                offsets,
                index_length: out.len() as u64 - length,
                size: records.len() as u64,
            });
        }
        self.chunk_count += 1;
        self.whole = match self.whole {
            Some((first, last)) => Some((first.min(times.0), last.max(times.1))),
            None => Some(times),
        };
        self.length += out.len() as u64;
        out
    }

    /// A file within the file. The open chunk must have been taken.
    pub fn attachment(
        &mut self,
        name: &str,
        media_type: &str,
        log_ns: u64,
        data: &[u8],
    ) -> Vec<u8> {
        debug_assert!(self.times.is_none());
        let mut content = log_ns.to_le_bytes().to_vec();
        content.extend(log_ns.to_le_bytes());
        text(&mut content, name);
        text(&mut content, media_type);
        content.extend((data.len() as u64).to_le_bytes());
        content.extend(data);
        content.extend(crc(&content).to_le_bytes());
        let mut out = Vec::new();
        record(&mut out, op::ATTACHMENT, &content);
        let mut index = self.length.to_le_bytes().to_vec();
        index.extend((out.len() as u64).to_le_bytes());
        index.extend(log_ns.to_le_bytes());
        index.extend(log_ns.to_le_bytes());
        index.extend((data.len() as u64).to_le_bytes());
        text(&mut index, name);
        text(&mut index, media_type);
        self.attachments.push(index);
        self.length += out.len() as u64;
        out
    }

    /// Named facts. The open chunk must have been taken.
    pub fn metadata(&mut self, name: &str, facts: &[(String, String)]) -> Vec<u8> {
        debug_assert!(self.times.is_none());
        let mut content = Vec::new();
        text(&mut content, name);
        let mut map = Vec::new();
        for (key, value) in facts {
            text(&mut map, key);
            text(&mut map, value);
        }
        content.extend((map.len() as u32).to_le_bytes());
        content.extend(map);
        let mut out = Vec::new();
        record(&mut out, op::METADATA, &content);
        let mut index = self.length.to_le_bytes().to_vec();
        index.extend((out.len() as u64).to_le_bytes());
        text(&mut index, name);
        self.metadata.push(index);
        self.length += out.len() as u64;
        out
    }

    /// The end of the file: summary and footer. The open chunk must have been taken.
    pub fn finish(&self) -> Vec<u8> {
        debug_assert!(self.times.is_none());
        let mut out = Vec::new();
        // A checksum of the whole data section would have to be carried through every write; 0 says that there is none, the chunks have theirs.
        record(&mut out, op::DATA_END, &0u32.to_le_bytes());
        let indexed = self.chunk_count as usize == self.chunks.len();
        if !indexed {
            out.extend(footer(0, 0, &[]));
            out.extend(MAGIC);
            return out;
        }
        let start = self.length + out.len() as u64;
        let mut summary = Vec::new();
        let mut groups = Vec::new();
        let mut group = |summary: &mut Vec<u8>, opcode: u8, records: Vec<Vec<u8>>| {
            if records.is_empty() {
                return;
            }
            let from = summary.len();
            records.into_iter().for_each(|r| summary.extend(r));
            groups.push((opcode, start + from as u64, (summary.len() - from) as u64));
        };
        let declared = declarations(&self.schemas, &self.channels);
        let (schemas, channels) = declared.split_at(self.schemas.len());
        group(&mut summary, op::SCHEMA, schemas.to_vec());
        group(&mut summary, op::CHANNEL, channels.to_vec());
        group(&mut summary, op::STATISTICS, vec![self.statistics()]);
        let chunks = self.chunks.iter().map(ChunkIndex::record).collect();
        group(&mut summary, op::CHUNK_INDEX, chunks);
        let wrapped = |opcode, list: &[Vec<u8>]| {
            list.iter()
                .map(|content| {
                    let mut out = Vec::new();
                    record(&mut out, opcode, content);
                    out
                })
                .collect::<Vec<_>>()
        };
        let attachments = wrapped(op::ATTACHMENT_INDEX, &self.attachments);
        group(&mut summary, op::ATTACHMENT_INDEX, attachments);
        let metadata = wrapped(op::METADATA_INDEX, &self.metadata);
        group(&mut summary, op::METADATA_INDEX, metadata);
        let offsets = start + summary.len() as u64;
        for (opcode, from, length) in groups {
            let mut content = vec![opcode];
            content.extend(from.to_le_bytes());
            content.extend(length.to_le_bytes());
            record(&mut summary, op::SUMMARY_OFFSET, &content);
        }
        let footer = footer(start, offsets, &summary);
        out.extend(summary);
        out.extend(footer);
        out.extend(MAGIC);
        out
    }

    fn statistics(&self) -> Vec<u8> {
        let mut content = self.counts.values().sum::<u64>().to_le_bytes().to_vec();
        content.extend((self.schemas.len() as u16).to_le_bytes());
        content.extend((self.channels.len() as u32).to_le_bytes());
        content.extend((self.attachments.len() as u32).to_le_bytes());
        content.extend((self.metadata.len() as u32).to_le_bytes());
        content.extend(self.chunk_count.to_le_bytes());
        let (first, last) = self.whole.unwrap_or_default();
        content.extend(first.to_le_bytes());
        content.extend(last.to_le_bytes());
        content.extend((10 * self.counts.len() as u32).to_le_bytes());
        for (id, count) in &self.counts {
            content.extend(id.to_le_bytes());
            content.extend(count.to_le_bytes());
        }
        let mut out = Vec::new();
        record(&mut out, op::STATISTICS, &content);
        out
    }
}

impl ChunkIndex {
    fn record(&self) -> Vec<u8> {
        let mut content = self.times.0.to_le_bytes().to_vec();
        content.extend(self.times.1.to_le_bytes());
        content.extend(self.start.to_le_bytes());
        content.extend(self.length.to_le_bytes());
        content.extend((10 * self.offsets.len() as u32).to_le_bytes());
        for (id, offset) in &self.offsets {
            content.extend(id.to_le_bytes());
            content.extend(offset.to_le_bytes());
        }
        content.extend(self.index_length.to_le_bytes());
        text(&mut content, "");
        content.extend(self.size.to_le_bytes());
        content.extend(self.size.to_le_bytes());
        let mut out = Vec::new();
        record(&mut out, op::CHUNK_INDEX, &content);
        out
    }
}

/// Schemas (ids from 1) and channels (ids from 0) as records.
fn declarations(schemas: &[Schema], channels: &[Channel]) -> Vec<Vec<u8>> {
    let mut records = Vec::new();
    for (index, schema) in schemas.iter().enumerate() {
        let mut content = (index as u16 + 1).to_le_bytes().to_vec();
        text(&mut content, &schema.name);
        text(&mut content, "protobuf");
        content.extend((schema.data.len() as u32).to_le_bytes());
        content.extend(&schema.data);
        let mut out = Vec::new();
        record(&mut out, op::SCHEMA, &content);
        records.push(out);
    }
    for (index, channel) in channels.iter().enumerate() {
        let mut content = (index as u16).to_le_bytes().to_vec();
        content.extend((channel.schema as u16 + 1).to_le_bytes());
        text(&mut content, &channel.topic);
        text(&mut content, "protobuf");
        content.extend(0u32.to_le_bytes());
        let mut out = Vec::new();
        record(&mut out, op::CHANNEL, &content);
        records.push(out);
    }
    records
}

/// The footer; its checksum is over the summary and the footer itself up to the checksum.
fn footer(summary_start: u64, offsets_start: u64, summary: &[u8]) -> Vec<u8> {
    let mut out = vec![op::FOOTER];
    out.extend(20u64.to_le_bytes());
    out.extend(summary_start.to_le_bytes());
    out.extend(offsets_start.to_le_bytes());
    let mut sum = crc32fast::Hasher::new();
    sum.update(summary);
    sum.update(&out);
    out.extend(sum.finalize().to_le_bytes());
    out
}

fn record(out: &mut Vec<u8>, opcode: u8, content: &[u8]) {
    out.push(opcode);
    out.extend((content.len() as u64).to_le_bytes());
    out.extend(content);
}

fn text(out: &mut Vec<u8>, text: &str) {
    out.extend((text.len() as u32).to_le_bytes());
    out.extend(text.as_bytes());
}
