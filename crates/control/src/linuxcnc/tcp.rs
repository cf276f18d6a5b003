//! The line to a controller: TCP that never blocks. Connecting runs on a thread of its own, one at a time.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::Duration;

/// A connection that is not there after this long is given up.
const CONNECT: Duration = Duration::from_secs(2);
/// Between two attempts, s.
const AGAIN_S: f64 = 0.5;
/// Bytes taken at once at most; the rest waits for the next call.
const MOST_TAKEN: usize = 64 * 1024;

/// What came of looking at a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Heard {
    /// It is being connected.
    Connecting,
    /// It is there since now.
    Connected,
    /// It is there; bytes may have come.
    Up,
    /// It is not there, and why.
    Down(String),
}

/// A line of bytes to a controller.
pub trait Line: Send {
    /// Look, and put what came in behind `bytes`.
    fn receive(&mut self, bytes: &mut Vec<u8>, now_s: f64) -> Heard;

    /// Send as much as goes and take it away from `bytes`.
    fn send(&mut self, bytes: &mut Vec<u8>) -> Result<(), String>;

    /// Give the connection up; a new one is tried later.
    fn drop_connection(&mut self, now_s: f64);
}

/// TCP to `host:port`.
pub struct TcpLine {
    address: String,
    stream: Option<TcpStream>,
    attempt: Option<Receiver<Result<TcpStream, String>>>,
    next_s: f64,
    reason: String,
}

impl TcpLine {
    /// A line that connects when it is first looked at.
    pub fn new(address: &str) -> Self {
        Self {
            address: address.to_owned(),
            stream: None,
            attempt: None,
            next_s: f64::NEG_INFINITY,
            reason: "not connected".to_owned(),
        }
    }

    fn connect(&mut self, now_s: f64) -> Heard {
        if let Some(attempt) = &self.attempt {
            let result = match attempt.try_recv() {
                Err(TryRecvError::Empty) => return Heard::Connecting,
                Err(TryRecvError::Disconnected) => Err("cannot connect".to_owned()),
                Ok(result) => result,
            };
            self.attempt = None;
            self.next_s = now_s + AGAIN_S;
            return match result {
                Ok(stream) => {
                    self.stream = Some(stream);
                    Heard::Connected
                }
                Err(reason) => {
                    self.reason = reason;
                    Heard::Down(self.reason.clone())
                }
            };
        }
        if now_s >= self.next_s {
            let (sender, receiver) = channel();
            let address = self.address.clone();
            let spawned = std::thread::Builder::new()
                .name("linuxcnc-connect".to_owned())
                // Nobody may be left to hear the answer.
                .spawn(move || drop(sender.send(connected(&address))));
            if spawned.is_ok() {
                self.attempt = Some(receiver);
                return Heard::Connecting;
            }
            self.next_s = now_s + AGAIN_S;
        }
        Heard::Down(self.reason.clone())
    }
}

fn connected(address: &str) -> Result<TcpStream, String> {
    let mut reason = "names no host and port, as in 127.0.0.1:5007".to_owned();
    let found = address.to_socket_addrs().map_err(|e| match e.kind() {
        ErrorKind::InvalidInput => reason.clone(),
        _ => format!("no such host: {e}"),
    })?;
    for place in found {
        match TcpStream::connect_timeout(&place, CONNECT) {
            Ok(stream) => {
                let set = stream
                    .set_nonblocking(true)
                    .and_then(|()| stream.set_nodelay(true));
                return set.map(|()| stream).map_err(|e| e.to_string());
            }
            Err(e) if e.kind() == ErrorKind::ConnectionRefused => {
                reason = "nobody listens there: is LinuxCNC running with linuxcncrsh?".to_owned();
            }
            Err(e) if e.kind() == ErrorKind::TimedOut => {
                reason = format!("no answer to connecting within {} s", CONNECT.as_secs());
            }
            Err(e) => reason = format!("cannot connect: {e}"),
        }
    }
    Err(reason)
}

impl Line for TcpLine {
    fn receive(&mut self, bytes: &mut Vec<u8>, now_s: f64) -> Heard {
        let Some(stream) = &mut self.stream else {
            return self.connect(now_s);
        };
        let mut buffer = [0; 4096];
        let mut taken = 0;
        let reason = loop {
            if taken >= MOST_TAKEN {
                return Heard::Up;
            }
            match stream.read(&mut buffer) {
                Ok(0) => break "it closed the connection".to_owned(),
                Ok(count) => {
                    taken += count;
                    bytes.extend_from_slice(&buffer[..count]);
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => return Heard::Up,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => break e.to_string(),
            }
        };
        self.reason.clone_from(&reason);
        self.drop_connection(now_s);
        Heard::Down(reason)
    }

    fn send(&mut self, bytes: &mut Vec<u8>) -> Result<(), String> {
        let Some(stream) = &mut self.stream else {
            return Ok(());
        };
        let mut sent = 0;
        let result = loop {
            if sent == bytes.len() {
                break Ok(());
            }
            match stream.write(&bytes[sent..]) {
                Ok(0) => break Err("it takes nothing".to_owned()),
                Ok(count) => sent += count,
                Err(e) if e.kind() == ErrorKind::WouldBlock => break Ok(()),
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => break Err(e.to_string()),
            }
        };
        bytes.drain(..sent);
        result
    }

    fn drop_connection(&mut self, now_s: f64) {
        self.stream = None;
        self.next_s = now_s + AGAIN_S;
    }
}
