//! A camera as a network stream: whoever connects is sent uncompressed pictures with their capture times, in Matroska (RFC 9559).

use std::io::Write as _;
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use vergence_imaging::Rgb;

/// Pictures that wait for a slow reader; it loses those that come then.
const WAITING: usize = 2;

/// Between two looks at the door.
const LOOK: Duration = Duration::from_millis(5);

/// One camera's cable. Clones are the same one; the threads behind it end with the process.
#[derive(Clone)]
pub(crate) struct Plug(Arc<Inner>);

struct Inner {
    port: u16,
    is_in: AtomicBool,
    readers: Mutex<Vec<SyncSender<Arc<Vec<u8>>>>>,
}

impl Plug {
    /// A camera of this size and rate on a port of its own, plugged in.
    pub(crate) fn new(size: (usize, usize), fps: f64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let plug = Self(Arc::new(Inner {
            port: listener.local_addr().unwrap().port(),
            is_in: AtomicBool::new(true),
            readers: Mutex::default(),
        }));
        let head = head(size, fps);
        let of_thread = plug.clone();
        std::thread::spawn(move || of_thread.serve(listener, &head));
        plug
    }

    /// Where it is.
    pub(crate) fn url(&self) -> String {
        format!("tcp://127.0.0.1:{}", self.0.port)
    }

    /// Plug it in or out. Who reads a camera that is unplugged sees the end of its stream.
    pub(crate) fn set(&self, is_in: bool) {
        self.0.is_in.store(is_in, Ordering::Relaxed);
    }

    /// Send a picture to whoever reads.
    pub(crate) fn send(&self, picture: &Rgb, capture_s: f64) {
        let cluster = Arc::new(cluster(picture.samples().as_flattened(), capture_s));
        for reader in self.0.readers.lock().unwrap().iter() {
            // A reader that is too slow loses it; one that has gone is swept out with the next one that comes.
            let _ = reader.try_send(Arc::clone(&cluster));
        }
    }

    fn serve(&self, listener: TcpListener, head: &[u8]) {
        let mut open = Some(listener);
        loop {
            if !self.0.is_in.load(Ordering::Relaxed) {
                open = None;
                self.0.readers.lock().unwrap().clear();
            } else if open.is_none() {
                open = TcpListener::bind(("127.0.0.1", self.0.port)).ok();
            }
            if let Some(listener) = &open {
                listener.set_nonblocking(true).unwrap();
                if let Ok((stream, _)) = listener.accept() {
                    self.admit(stream, head.to_vec());
                }
            }
            std::thread::sleep(LOOK);
        }
    }

    fn admit(&self, stream: TcpStream, head: Vec<u8>) {
        let (sender, pictures) = sync_channel(WAITING);
        self.0.readers.lock().unwrap().push(sender);
        std::thread::spawn(move || write(stream, &head, &pictures));
    }
}

/// Write until the reader goes or the plug is pulled.
fn write(mut stream: TcpStream, head: &[u8], pictures: &Receiver<Arc<Vec<u8>>>) {
    stream.set_nonblocking(false).unwrap();
    if stream.write_all(head).is_err() {
        return;
    }
    while let Ok(cluster) = pictures.recv() {
        if stream.write_all(&cluster).is_err() {
            return;
        }
    }
}

/// An element: its number, its length in eight bytes, what is in it.
fn element(id: u32, content: &[u8]) -> Vec<u8> {
    let mut out = numbered(id);
    out.extend((content.len() as u64 | 1 << 56).to_be_bytes());
    out.extend_from_slice(content);
    out
}

fn numbered(id: u32) -> Vec<u8> {
    let bytes = id.to_be_bytes();
    bytes[id.leading_zeros() as usize / 8..].to_vec()
}

fn number(id: u32, value: u64) -> Vec<u8> {
    element(id, &value.to_be_bytes())
}

/// What stands before the pictures: times in microseconds, one track of RGB.
fn head((width, height): (usize, usize), fps: f64) -> Vec<u8> {
    let video = [
        number(0xB0, width as u64),
        number(0xBA, height as u64),
        element(0x2E_B524, b"RGB\x18"),
    ]
    .concat();
    let track = [
        number(0xD7, 1),
        number(0x73C5, 1),
        number(0x83, 1),
        number(0x9C, 0),
        number(0x23_E383, (1e9 / fps).round() as u64),
        element(0x86, b"V_UNCOMPRESSED"),
        element(0xE0, &video),
    ]
    .concat();
    // A segment of unknown length: it ends when the camera does.
    let segment = [
        numbered(0x1853_8067),
        vec![0x01, 255, 255, 255, 255, 255, 255, 255],
    ]
    .concat();
    [
        element(0x1A45_DFA3, &element(0x4282, b"matroska")),
        segment,
        element(0x1549_A966, &number(0x2A_D7B1, 1000)),
        element(0x1654_AE6B, &element(0xAE, &track)),
    ]
    .concat()
}

/// One picture with its time.
fn cluster(picture: &[u8], capture_s: f64) -> Vec<u8> {
    // Track 1, no time beside the cluster's, a key frame.
    let block = [&[0x81, 0, 0, 0x80], picture].concat();
    let time = number(0xE7, (capture_s * 1e6).round() as u64);
    element(0x1F43_B675, &[time, element(0xA3, &block)].concat())
}
