//! A USB camera after the USB video class 1.1: it answers the driver's requests, keeps its controls, remembers what was set, and sends the pictures
//! that it was given, one after the other, on a clock that both eyes share.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::descriptors::{self as tell, PAYLOAD};
use super::usbip::{Cable, Function, Pipe, Setup};

pub(crate) const SIZE: (usize, usize) = (320, 240);
/// Pictures a second.
pub(crate) const FPS: u32 = 15;

/// Camera terminal and processing unit.
pub(crate) const UNITS: [u8; 2] = [1, 2];

const SET_CUR: u8 = 0x01;
const GET_CUR: u8 = 0x81;
const GET_MIN: u8 = 0x82;
const GET_MAX: u8 = 0x83;
const GET_RES: u8 = 0x84;
const GET_INFO: u8 = 0x86;
const GET_DEF: u8 = 0x87;

/// Why a request was refused, as the driver asks for it afterwards (table 4-7).
const WRONG_STATE: u8 = 2;
const OUT_OF_RANGE: u8 = 4;
const UNKNOWN_REQUEST: u8 = 7;

/// What a control is to the class: its unit, selector, bit in the unit's list, and bytes.
pub(crate) struct Control {
    pub(crate) name: &'static str,
    pub(crate) unit: u8,
    pub(crate) selector: u8,
    pub(crate) bit: u8,
    bytes: usize,
    /// The control that must be off (have this value) before this one can be set.
    master: Option<(&'static str, i32)>,
}

const fn control(
    name: &'static str,
    [unit, selector, bit, bytes]: [u8; 4],
    master: Option<(&'static str, i32)>,
) -> Control {
    Control {
        name,
        unit,
        selector,
        bit,
        bytes: bytes as usize,
        master,
    }
}

/// The controls that such cameras have (tables 3-6 and 3-8).
pub(crate) const CONTROLS: [Control; 11] = [
    control("exposure mode", [1, 2, 1, 1], None),
    control("exposure before rate", [1, 3, 2, 1], None),
    control("exposure", [1, 4, 3, 4], Some(("exposure mode", 1))),
    control("focus", [1, 6, 5, 2], Some(("automatic focus", 0))),
    control("automatic focus", [1, 8, 17, 1], None),
    control("brightness", [2, 2, 0, 2], None),
    control("contrast", [2, 3, 1, 2], None),
    control("saturation", [2, 7, 3, 2], None),
    control("gain", [2, 4, 9, 2], None),
    control(
        "white balance",
        [2, 10, 6, 2],
        Some(("automatic white balance", 0)),
    ),
    control("automatic white balance", [2, 11, 12, 1], None),
];

/// A control's range and where it stands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Level {
    pub(crate) least: i32,
    pub(crate) most: i32,
    pub(crate) step: i32,
    pub(crate) now: i32,
}

impl Level {
    pub(crate) const fn new(least: i32, most: i32, step: i32, now: i32) -> Self {
        Self {
            least,
            most,
            step,
            now,
        }
    }
}

/// What is wrong with a picture that is sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Spoil {
    /// The first half only.
    Cut,
    /// Bytes in the middle are others.
    Garbled,
    /// Nothing but the ends of a JPEG.
    Hollow,
    /// A picture of another size.
    Foreign,
    /// Marked by the camera as damaged.
    Marked,
}

/// What the camera is and does; a test looks at it and changes it.
pub(crate) struct State {
    pub(crate) name: String,
    /// The formats that it has, by their numbers, and what it says of its rate.
    pub(crate) sends: Vec<u8>,
    pub(crate) fps: u32,
    pub(crate) levels: Vec<Level>,
    /// All that was set, in order.
    pub(crate) set: Vec<(&'static str, i32)>,
    /// What is sent in turn, as JPEG and as raw bytes.
    pub(crate) jpegs: Vec<Vec<u8>>,
    pub(crate) raws: Vec<Vec<u8>>,
    /// A JPEG of another size.
    pub(crate) foreign: Vec<u8>,
    /// What is wrong with the next pictures.
    pub(crate) spoil: VecDeque<Spoil>,
    /// The format that is being sent.
    sending: Option<u8>,
    agreed: u8,
    refusal: u8,
}

impl State {
    pub(crate) fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            sends: vec![tell::MJPEG, tell::YUYV],
            fps: FPS,
            levels: vec![
                // A list of bits: manual and aperture priority; the latter is on.
                Level::new(1, 8, 9, 8),
                Level::new(0, 1, 1, 1),
                Level::new(3, 2047, 1, 250),
                Level::new(0, 250, 5, 30),
                Level::new(0, 1, 1, 1),
                Level::new(-64, 64, 1, 0),
                Level::new(0, 95, 1, 32),
                Level::new(0, 255, 1, 128),
                Level::new(0, 255, 1, 20),
                Level::new(2800, 6500, 10, 4600),
                Level::new(0, 1, 1, 1),
            ],
            set: Vec::new(),
            jpegs: Vec::new(),
            raws: Vec::new(),
            foreign: Vec::new(),
            spoil: VecDeque::new(),
            sending: None,
            agreed: tell::MJPEG,
            refusal: 0,
        }
    }

    pub(crate) fn level(&mut self, name: &str) -> &mut Level {
        &mut self.levels[place(name)]
    }

    /// Exposure time.
    fn exposure(&mut self) -> Duration {
        Duration::from_micros(100 * self.level("exposure").now as u64)
    }

    fn refuse<T>(&mut self, why: u8) -> Option<T> {
        self.refusal = why;
        None
    }

    /// A request to a unit's control.
    fn unit(&mut self, setup: Setup, data: &[u8]) -> Option<Vec<u8>> {
        let [selector, unit] = [setup.value, setup.index].map(|v| (v >> 8) as u8);
        let found = |c: &Control| (c.unit, c.selector) == (unit, selector);
        let Some(which) = CONTROLS.iter().position(found) else {
            return self.refuse(UNKNOWN_REQUEST);
        };
        let (control, level) = (&CONTROLS[which], self.levels[which]);
        let value = match setup.request {
            SET_CUR => return self.set(which, data),
            // Readable, settable, and where there is an automatic it changes by itself.
            GET_INFO => return Some(vec![3 | u8::from(control.master.is_some()) << 3]),
            GET_CUR => level.now,
            GET_MIN => level.least,
            GET_MAX => level.most,
            GET_RES => level.step,
            GET_DEF => level.now,
            _ => return self.refuse(UNKNOWN_REQUEST),
        };
        Some(value.to_le_bytes()[..control.bytes].to_vec())
    }

    fn set(&mut self, which: usize, data: &[u8]) -> Option<Vec<u8>> {
        let control = &CONTROLS[which];
        let value = match *data {
            [a] => i32::from(a),
            [a, b] => i32::from(i16::from_le_bytes([a, b])),
            [a, b, c, d] => i32::from_le_bytes([a, b, c, d]),
            _ => return self.refuse(UNKNOWN_REQUEST),
        };
        if let Some((master, off)) = control.master
            && self.level(master).now != off
        {
            return self.refuse(WRONG_STATE);
        }
        let level = &mut self.levels[which];
        if !(level.least..=level.most).contains(&value) {
            return self.refuse(OUT_OF_RANGE);
        }
        level.now = value;
        self.set.push((control.name, value));
        Some(Vec::new())
    }

    /// The next picture's bytes, and whether it is marked as damaged.
    fn picture(&mut self, format: u8, number: usize) -> (Vec<u8>, bool) {
        let all = match format {
            tell::YUYV => &self.raws,
            _ => &self.jpegs,
        };
        let mut bytes = all[number % all.len()].clone();
        let half = bytes.len() / 2;
        let spoil = self.spoil.pop_front();
        match spoil {
            Some(Spoil::Cut) => bytes.truncate(half),
            Some(Spoil::Garbled) => bytes[half..half + 40].fill(0xff),
            Some(Spoil::Hollow) => bytes = vec![0xff, 0xd8, 0xff, 0xd9],
            Some(Spoil::Foreign) => bytes.clone_from(&self.foreign),
            Some(Spoil::Marked) | None => {}
        }
        (bytes, spoil == Some(Spoil::Marked))
    }
}

fn place(name: &str) -> usize {
    CONTROLS.iter().position(|c| c.name == name).unwrap()
}

/// The camera as its cable sees it.
struct Answers(Arc<Mutex<State>>);

impl Function for Answers {
    fn control(&mut self, setup: Setup, data: &[u8]) -> Option<Vec<u8>> {
        let mut state = lock(&self.0);
        let [low, high] = setup.value.to_le_bytes();
        match (setup.kind, setup.request, high) {
            (0x80, 6, 1) => Some(tell::device()),
            (0x80, 6, 2) => Some(tell::configuration(&state.sends, state.fps)),
            (0x80, 6, 3) => tell::string(low, &state.name),
            // Configuration and setting are the only ones; the state is "fed by the bus".
            (0x00, 9, _) | (0x01, 11, _) => Some(Vec::new()),
            (0x80..=0x82, 0, _) => Some(vec![0, 0]),
            // An endpoint of bulk is told that nobody wants pictures any more by clearing its halt.
            (0x02, 1, _) => {
                state.sending = None;
                Some(Vec::new())
            }
            (0x21 | 0xa1, request, selector @ (1 | 2)) if setup.index == 1 => {
                match (request, selector) {
                    (SET_CUR, 1) => state.agreed = *data.get(2)?,
                    (SET_CUR, _) => state.sending = Some(*data.get(2)?),
                    (GET_INFO, _) => return Some(vec![3]),
                    _ => return Some(tell::agreement(state.agreed, state.fps)),
                }
                Some(Vec::new())
            }
            // Why the last request was refused.
            (0xa1, GET_CUR, 2) if setup.index == 0 => Some(vec![state.refusal]),
            (0x21 | 0xa1, ..) => state.unit(setup, data),
            _ => state.refuse(UNKNOWN_REQUEST),
        }
    }
}

fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A camera that is plugged in; dropping it unplugs it.
pub(crate) struct Camera {
    state: Arc<Mutex<State>>,
    cable: Option<Cable>,
    sender: Option<JoinHandle<()>>,
}

impl Camera {
    /// Plug a camera into a port. Picture n is exposed around `epoch` + n periods.
    pub(crate) fn plug(port: usize, state: State, epoch: Instant) -> Self {
        let state = Arc::new(Mutex::new(state));
        let cable = Cable::plug(port, Answers(Arc::clone(&state)));
        let (sending, pipe) = (Arc::clone(&state), Arc::clone(&cable.pipe));
        let sender = std::thread::spawn(move || send(&sending, &pipe, epoch));
        Self {
            state,
            cable: Some(cable),
            sender: Some(sender),
        }
    }

    pub(crate) fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    fn pull(&mut self) {
        self.cable = None;
        if let Some(sender) = self.sender.take() {
            let _ = sender.join();
        }
    }
}

impl Drop for Camera {
    fn drop(&mut self) {
        self.pull();
    }
}

pub(crate) fn period() -> Duration {
    Duration::from_secs(1) / FPS
}

/// Expose and send, until the cable is out. A picture that nobody fetches is left out, as it is where there is no memory for two.
fn send(state: &Mutex<State>, pipe: &Pipe, epoch: Instant) {
    let mut toggle = 0;
    let mut last = 0;
    while !pipe.is_closed() {
        let passed = epoch.elapsed().as_nanos() / period().as_nanos();
        let number = (passed as usize + 1).max(last + 1);
        last = number;
        let middle = epoch + period() * number as u32;
        // The exposure ends half of it later; reading out takes no time.
        let exposed = middle + lock(state).exposure() / 2;
        std::thread::sleep(exposed.saturating_duration_since(Instant::now()));
        let Some(format) = lock(state).sending else {
            continue;
        };
        let late = exposed.elapsed() > period() / 8;
        if late || !pipe.is_asked(period() / 8) {
            continue;
        }
        let (bytes, marked) = lock(state).picture(format, number);
        let taken_us = middle.saturating_duration_since(epoch).as_micros() as u32;
        let mut pieces = bytes.chunks(PAYLOAD - 12).peekable();
        while let Some(piece) = pieces.next() {
            // Which of two pictures in turn, its end, damage, both times are there, end of the header.
            let end = u8::from(pieces.peek().is_none());
            let flags = toggle | end << 1 | 0x0c | u8::from(marked) << 6 | 0x80;
            let now_us = epoch.elapsed().as_micros() as u32;
            let frame = ((now_us / 1000) as u16 & 0x7ff).to_le_bytes();
            let header = [
                &[12, flags][..],
                &taken_us.to_le_bytes(),
                &now_us.to_le_bytes(),
                &frame,
            ];
            let payload = [&header.concat(), piece].concat();
            if !pipe.send(&payload, Duration::from_millis(500)) {
                break;
            }
        }
        toggle ^= 1;
    }
}
