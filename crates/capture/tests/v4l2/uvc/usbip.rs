//! A USB device that lives in this process. The kernel's `vhci-hcd` takes one end of a socket pair for a cable and speaks USB/IP over it
//! (`Documentation/usb/usbip_protocol.rst` of the kernel): requests with a number come, answers with the same number go back.

use std::collections::VecDeque;
use std::io::{Read as _, Write as _};
use std::net::Shutdown;
use std::os::fd::AsRawFd as _;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The virtual host controller; its first ports are of high speed.
pub(crate) const HOST: &str = "/sys/devices/platform/vhci_hcd.0";

/// Bytes of every header.
const HEADER: usize = 48;

const CMD_SUBMIT: u32 = 1;
const CMD_UNLINK: u32 = 2;
const RET_SUBMIT: u32 = 3;
const RET_UNLINK: u32 = 4;

/// The kernel's `EPIPE`: the device refuses a request.
const STALL: i32 = -32;
/// The kernel's `ECONNRESET`: a request was taken back before it was answered.
const TAKEN_BACK: i32 = -104;

/// A request to the device's endpoint 0 (USB 2.0, table 9-2).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Setup {
    pub(crate) kind: u8,
    pub(crate) request: u8,
    pub(crate) value: u16,
    pub(crate) index: u16,
}

/// What a device does with requests to its endpoint 0.
pub(crate) trait Function: Send + 'static {
    /// The answer; `None` refuses. `data` is what came with the request.
    fn control(&mut self, setup: Setup, data: &[u8]) -> Option<Vec<u8>>;
}

/// The device's only other endpoint, a bulk one that sends: the host's requests that wait for data.
pub(crate) struct Pipe {
    waiting: Mutex<Waiting>,
    changed: Condvar,
    socket: Mutex<UnixStream>,
}

#[derive(Default)]
struct Waiting {
    /// Numbers of requests, oldest first.
    requests: VecDeque<u32>,
    closed: bool,
}

impl Pipe {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Wait for a request. False when none came in time, or the cable is out.
    pub(crate) fn is_asked(&self, wait: Duration) -> bool {
        self.asked(wait).is_some()
    }

    /// The requests, once there is one.
    fn asked(&self, wait: Duration) -> Option<MutexGuard<'_, Waiting>> {
        let nothing = |waiting: &mut Waiting| waiting.requests.is_empty() && !waiting.closed;
        let woken = self.changed.wait_timeout_while(self.lock(), wait, nothing);
        let waiting = woken.unwrap_or_else(PoisonError::into_inner).0;
        (!waiting.closed && !waiting.requests.is_empty()).then_some(waiting)
    }

    /// Send data with the oldest request; waits for one. False when none came in time, or the cable is out.
    pub(crate) fn send(&self, data: &[u8], wait: Duration) -> bool {
        let Some(mut waiting) = self.asked(wait) else {
            return false;
        };
        if let Some(number) = waiting.requests.pop_front() {
            // Whoever takes the request back now must find it answered, or the kernel hangs up: so nobody is let in between.
            self.answer(RET_SUBMIT, number, 0, data.len(), data);
        }
        true
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.lock().closed
    }

    fn close(&self) {
        self.lock().closed = true;
        self.changed.notify_all();
    }

    fn answer(&self, command: u32, number: u32, status: i32, length: usize, data: &[u8]) {
        let mut bytes = vec![0; HEADER];
        let words = [command, number, 0, 0, 0, status as u32, length as u32];
        for (place, word) in bytes.chunks_exact_mut(4).zip(words) {
            place.copy_from_slice(&word.to_be_bytes());
        }
        bytes.extend_from_slice(data);
        let mut socket = self.socket.lock().unwrap_or_else(PoisonError::into_inner);
        // Whoever has pulled the cable wants no answer.
        let _ = socket.write_all(&bytes);
    }

    /// Answer requests until the cable is out.
    fn serve(&self, mut socket: UnixStream, mut function: impl Function) -> std::io::Result<()> {
        let mut header = [0; HEADER];
        loop {
            socket.read_exact(&mut header)?;
            let word = |i: usize| {
                let at: [u8; 4] = header[4 * i..4 * i + 4].try_into().unwrap();
                u32::from_be_bytes(at)
            };
            let (command, number, incoming, endpoint) = (word(0), word(1), word(3) == 1, word(4));
            match (command, endpoint) {
                (CMD_SUBMIT, 0) => {
                    let length = word(6) as usize;
                    let mut data = vec![0; if incoming { 0 } else { length }];
                    socket.read_exact(&mut data)?;
                    let [kind, request, v0, v1, i0, i1, ..]: [u8; 8] =
                        header[40..].try_into().unwrap();
                    let setup = Setup {
                        kind,
                        request,
                        value: u16::from_le_bytes([v0, v1]),
                        index: u16::from_le_bytes([i0, i1]),
                    };
                    match function.control(setup, &data) {
                        Some(mut answer) if incoming => {
                            answer.truncate(length);
                            self.answer(RET_SUBMIT, number, 0, answer.len(), &answer);
                        }
                        Some(_) => self.answer(RET_SUBMIT, number, 0, length, &[]),
                        None => self.answer(RET_SUBMIT, number, STALL, 0, &[]),
                    }
                }
                (CMD_SUBMIT, _) => {
                    self.lock().requests.push_back(number);
                    self.changed.notify_all();
                }
                (CMD_UNLINK, _) => {
                    let which = word(5);
                    let mut waiting = self.lock();
                    let place = waiting.requests.iter().position(|&n| n == which);
                    let status = match place.and_then(|place| waiting.requests.remove(place)) {
                        Some(_) => TAKEN_BACK,
                        None => 0,
                    };
                    self.answer(RET_UNLINK, number, status, 0, &[]);
                }
                _ => return Err(std::io::ErrorKind::InvalidData.into()),
            }
        }
    }
}

/// A device that is plugged in; dropping it pulls the cable.
pub(crate) struct Cable {
    pub(crate) pipe: Arc<Pipe>,
    port: usize,
    socket: UnixStream,
    server: Option<JoinHandle<()>>,
}

impl Cable {
    /// Plug a device into a port.
    pub(crate) fn plug(port: usize, function: impl Function) -> Self {
        let (ours, theirs) = UnixStream::pair().unwrap();
        let pipe = Arc::new(Pipe {
            waiting: Mutex::default(),
            changed: Condvar::new(),
            socket: Mutex::new(ours.try_clone().unwrap()),
        });
        let (serving, socket) = (Arc::clone(&pipe), ours.try_clone().unwrap());
        let server = std::thread::spawn(move || {
            let _ = serving.serve(socket, function);
            serving.close();
        });
        // Port, the kernel's end, number of the device at the other end (any), high speed. A port that was just left is free a moment later.
        let line = format!("{port} {} {} 3", theirs.as_raw_fd(), 0x1_0002 + port);
        let until = Instant::now() + Duration::from_secs(5);
        while let Err(error) = std::fs::write(Path::new(HOST).join("attach"), &line) {
            assert!(Instant::now() < until, "port {port}: {error}");
            std::thread::sleep(Duration::from_millis(20));
        }
        Self {
            pipe,
            port,
            socket: ours,
            server: Some(server),
        }
    }

    /// Where the kernel shows the device at a port, once it is there.
    pub(crate) fn shown(port: usize) -> PathBuf {
        let bus = (1..10)
            .map(|n| Path::new(HOST).join(format!("usb{n}")))
            .find(|bus| bus.exists())
            .unwrap();
        let number = bus.file_name().unwrap().to_str().unwrap()[3..].to_owned();
        bus.join(format!("{number}-{}", port + 1))
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        let _ = self.socket.shutdown(Shutdown::Both);
        self.pipe.close();
        if let Some(server) = self.server.take() {
            let _ = server.join();
        }
        let until = Instant::now() + Duration::from_secs(5);
        while Self::shown(self.port).exists() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}
