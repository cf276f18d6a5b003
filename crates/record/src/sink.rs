//! From what waits to bytes on a disk: pictures are encoded, messages gathered into chunks, chunks appended. No threads, no clock: whoever calls
//! [`Sink::work`] decides when, on which thread and at what time.
//!
//! A chunk that the storage does not take stays here until it does, byte for byte, and nothing else is begun: so the file is always whole chunks and
//! at most one that is cut short, and what does not fit waits in the bounded queue.

use std::io;

use crate::error::RecordError;
use crate::mcap::{Channel, Schema, Writer};
use crate::picture::Pictures;
use crate::queue::{PicturePair, Work};
use crate::storage::Storage;

/// A chunk is closed when it spans so much time of its messages, ns: what a crash costs at most is this and what waits in the queue.
const CHUNK_NS: u64 = 500_000_000;

/// A chunk is closed when it has so many bytes; a pair of pictures may come on top.
const CHUNK_BYTES: usize = 2 << 20;

/// Time between two attempts at a storage that failed, s.
const RETRY_S: f64 = 0.5;

/// Time between two syncs, s.
const SYNC_S: f64 = 1.0;

/// Where pictures go: the channels of left and right, and how they are written.
#[derive(Clone, Copy, Debug)]
pub struct PictureChannels {
    /// Indexes of the channels, left and right.
    pub channels: [usize; 2],
    /// Names of the cameras' frames.
    pub frames: [&'static str; 2],
    /// How they are written.
    pub pictures: Pictures,
}

/// How a recording on its way to its storage stands.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SinkStatus {
    /// Why the storage takes nothing now; `None` while it does.
    pub failure: Option<String>,
    /// How often the storage began to fail.
    pub failures: u64,
    /// Pictures that could not be encoded.
    pub pictures_failed: u64,
    /// Bytes that the storage took.
    pub bytes: u64,
    /// What was taken from the queue and is not in the file, known at its end.
    pub lost: Taken,
}

/// What was taken from the queue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Taken {
    /// Messages.
    pub numbers: u64,
    /// Pairs of pictures.
    pub pictures: u64,
}

impl Taken {
    fn add(&mut self, other: Taken) {
        self.numbers += other.numbers;
        self.pictures += other.pictures;
    }
}

/// A recording while it is written.
pub struct Sink<S> {
    storage: S,
    writer: Writer,
    pictures: PictureChannels,
    /// Bytes that the storage has not taken yet, from `taken` on.
    out: Vec<u8>,
    taken: usize,
    /// Length of the file up to the last whole chunk.
    whole: u64,
    next_try_s: f64,
    synced_s: f64,
    unsynced: bool,
    status: SinkStatus,
    /// What lies in the open chunk, and in chunks that the storage has not taken yet.
    open: Taken,
    closed: Taken,
}

impl<S: Storage> Sink<S> {
    /// A recording that begins; nothing is written before [`Sink::work`] or [`Sink::drain`] is called.
    pub fn new(
        storage: S,
        library: &str,
        schemas: Vec<Schema>,
        channels: Vec<Channel>,
        pictures: PictureChannels,
    ) -> Self {
        let (writer, out) = Writer::new(library, schemas, channels);
        Self {
            storage,
            writer,
            pictures,
            out,
            taken: 0,
            whole: 0,
            next_try_s: f64::NEG_INFINITY,
            synced_s: f64::NEG_INFINITY,
            unsynced: false,
            status: SinkStatus::default(),
            open: Taken::default(),
            closed: Taken::default(),
        }
    }

    /// How it stands.
    pub fn status(&self) -> &SinkStatus {
        &self.status
    }

    /// Whether the storage takes nothing now.
    pub fn has_failed(&self) -> bool {
        self.status.failure.is_some()
    }

    /// Whether more work can be begun: everything handed out so far was taken.
    pub fn is_ready(&self) -> bool {
        self.taken == self.out.len()
    }

    /// Facts and files that stand before the first message, recorded at this time.
    pub fn begin(
        &mut self,
        facts: &[(String, String)],
        attachments: &[(String, &'static str, Vec<u8>)],
        log_ns: u64,
    ) {
        let metadata = self.writer.metadata("vergence", facts);
        self.hand_out(metadata);
        for (name, media_type, data) in attachments {
            let attachment = self.writer.attachment(name, media_type, log_ns, data);
            self.hand_out(attachment);
        }
    }

    /// Take one piece of work into the open chunk, and hand that out when it is full. To be called only while [`Sink::is_ready`].
    pub fn work(&mut self, work: Work, now_s: f64) -> Option<PicturePair> {
        let log_ns = match &work {
            Work::Numbers { log_ns, .. } | Work::Pictures { log_ns, .. } => *log_ns,
        };
        if let Some((first, _)) = self.writer.open_times()
            && (log_ns.saturating_sub(first) >= CHUNK_NS || log_ns < first)
        {
            self.close_chunk();
        }
        let pair = match work {
            Work::Numbers { items, .. } => {
                self.open.numbers += items.len() as u64;
                for item in items {
                    self.writer
                        .message(item.channel, log_ns, item.publish_ns, &item.data);
                }
                None
            }
            Work::Pictures { pair, .. } => {
                self.open.pictures += 1;
                self.pictures(&pair, log_ns);
                Some(pair)
            }
        };
        if self.writer.open_bytes() >= CHUNK_BYTES {
            self.close_chunk();
        }
        self.drain(now_s);
        pair
    }

    fn pictures(&mut self, pair: &PicturePair, log_ns: u64) {
        let to = self.pictures;
        for eye in 0..2 {
            let capture_ns = pair.capture_ns[eye];
            match to.pictures.encode(&pair.pictures[eye]) {
                Ok(file) => {
                    let format = to.pictures.format();
                    let data = crate::foxglove::compressed_image(
                        capture_ns,
                        to.frames[eye],
                        format,
                        &file,
                    );
                    self.writer
                        .message(to.channels[eye], log_ns, capture_ns, &data);
                }
                Err(_) => self.status.pictures_failed += 1,
            }
        }
    }

    /// Hand out the open chunk when its first message is older than this: what there is shall not wait for what comes.
    pub fn close_older(&mut self, than_ns: u64) {
        let old = self
            .writer
            .open_times()
            .is_some_and(|(first, _)| first < than_ns);
        if old && self.is_ready() {
            self.close_chunk();
        }
    }

    /// Hand out what lies in the open chunk.
    pub fn close_chunk(&mut self) {
        let chunk = self.writer.take_chunk();
        self.closed.add(std::mem::take(&mut self.open));
        self.hand_out(chunk);
    }

    fn hand_out(&mut self, bytes: Vec<u8>) {
        if self.is_ready() {
            self.out = bytes;
            self.taken = 0;
        } else {
            self.out.extend(bytes);
        }
    }

    /// Give the storage what it has not taken yet; one that failed is asked again after half a second.
    pub fn drain(&mut self, now_s: f64) {
        if self.has_failed() && now_s < self.next_try_s {
            return;
        }
        while !self.is_ready() {
            match self.storage.append(&self.out[self.taken..]) {
                Ok(0) => break,
                Ok(count) => {
                    self.taken += count.min(self.out.len() - self.taken);
                    self.status.bytes += count as u64;
                    self.status.failure = None;
                    self.unsynced = true;
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => break,
                Err(e) => {
                    self.failed(&e, now_s);
                    return;
                }
            }
        }
        if self.is_ready() {
            self.whole = self.writer.length();
            self.closed = Taken::default();
            self.sync(now_s, SYNC_S);
        }
    }

    fn sync(&mut self, now_s: f64, every_s: f64) {
        if !self.unsynced || now_s - self.synced_s < every_s {
            return;
        }
        self.synced_s = now_s;
        match self.storage.sync() {
            Ok(()) => self.unsynced = false,
            Err(e) => self.failed(&e, now_s),
        }
    }

    fn failed(&mut self, e: &io::Error, now_s: f64) {
        if !self.has_failed() {
            self.status.failures += 1;
        }
        self.status.failure = Some(e.to_string());
        self.next_try_s = now_s + RETRY_S;
    }

    /// Ask the storage once more, however short ago it failed; whether it has taken everything.
    pub fn ask_again(&mut self, now_s: f64) -> bool {
        self.next_try_s = f64::NEG_INFINITY;
        self.drain(now_s);
        self.is_ready()
    }

    /// End the file: the open chunk, the summary. When the storage takes no more, what is there is cut to the last whole chunk, and the error
    /// says why. The length of the file. Nothing may be written afterwards.
    pub fn finish(&mut self, now_s: f64) -> Result<u64, RecordError> {
        self.end(now_s).map_err(|source| {
            // Best effort: what is left after the last whole chunk is no chunk, and a reader passes over it as well.
            let _ = self.storage.cut(self.whole);
            self.status.lost = self.closed;
            self.status.lost.add(self.open);
            RecordError::Io {
                action: "finishing",
                source,
            }
        })
    }

    fn end(&mut self, now_s: f64) -> io::Result<u64> {
        // A storage that failed is asked a last time at once; one that takes nothing "now" is asked no more than a bounded number of times.
        if self.ask_again(now_s) {
            self.close_chunk();
        }
        if !self.ask_again(now_s) {
            let reason = self.status.failure.clone();
            return Err(io::Error::other(
                reason.unwrap_or_else(|| "it takes nothing".to_owned()),
            ));
        }
        let end = self.writer.finish();
        let mut taken = 0;
        while taken < end.len() {
            match self.storage.append(&end[taken..]) {
                Ok(0) => return Err(io::Error::other("it takes nothing")),
                Ok(count) => taken += count,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        self.storage.sync()?;
        self.status.bytes += end.len() as u64;
        Ok(self.status.bytes)
    }
}
