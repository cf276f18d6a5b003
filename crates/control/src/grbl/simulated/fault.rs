//! What the simulated controller can be made to do wrong.

use super::{Said, SimulatedGrbl, State, UNREAD_MAX};

/// Which way bytes go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// From the program to the controller.
    In,
    /// From the controller to the program.
    Out,
}

/// One misbehaviour, from the moment that it is planted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GrblFault {
    /// Every answer comes this much later.
    Late {
        /// s.
        by_s: f64,
        /// End of the fault, s.
        until_s: f64,
    },
    /// Bits of bytes flip.
    Garbled {
        /// Which way.
        way: Way,
        /// Part of the bytes, 0 to 1.
        part: f64,
        /// End of the fault, s.
        until_s: f64,
    },
    /// What is written or said in one go vanishes.
    Lost {
        /// Which way.
        way: Way,
        /// Part of the lines, 0 to 1.
        part: f64,
        /// End of the fault, s.
        until_s: f64,
    },
    /// Lines are cut in two with a pause between, as USB bridges do.
    Split {
        /// The pause, s.
        pause_s: f64,
        /// End of the fault, s.
        until_s: f64,
    },
    /// The next line is answered with this error instead of being obeyed.
    Error(u16),
    /// This alarm, now: the steps are cut off. 1 and 2 leave the controller mute until a reset.
    Alarm(u16),
    /// The supply drops for this long: the counters are lost, the welcome comes afterwards.
    BrownOut {
        /// s.
        for_s: f64,
    },
    /// The rotor of an axis is blocked, or free again: the counter runs on, the axis does not.
    Stuck {
        /// Place of the axis (0 is X).
        axis: usize,
        /// Blocked or free.
        stuck: bool,
    },
    /// An axis is knocked: it truly stands elsewhere than its counter says.
    Knocked {
        /// Place of the axis (0 is X).
        axis: usize,
        /// Units.
        by: f64,
    },
    /// It hears and says nothing, but goes on with what it has.
    Silent {
        /// End of the fault, s.
        until_s: f64,
    },
    /// The port vanishes and can be opened again afterwards; the controller goes on.
    PortGone {
        /// End of the fault, s.
        until_s: f64,
    },
    /// The safety door opens or closes.
    Door {
        /// Open or closed.
        open: bool,
    },
}

/// Faults that last.
#[derive(Clone, Debug, Default)]
pub(crate) struct Lasting {
    pub(crate) late: (f64, f64),
    pub(crate) garbled: [(f64, f64); 2],
    pub(crate) lost: [(f64, f64); 2],
    pub(crate) split: (f64, f64),
    pub(crate) silent_until_s: f64,
    pub(crate) gone_until_s: f64,
    pub(crate) error: Option<u16>,
}

impl Lasting {
    /// The size of a fault that lasts `(size, until)`; 0 when it is over.
    pub(crate) fn size(fault: (f64, f64), now_s: f64) -> f64 {
        if now_s < fault.1 { fault.0 } else { 0.0 }
    }
}

/// Random numbers for answer times and faults: SplitMix64 (Steele, Lea, Flood, 2014).
#[derive(Clone, Debug)]
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

impl SimulatedGrbl {
    pub(super) fn misbehave(&mut self, fault: GrblFault, now_s: f64) {
        let f = &mut self.faults;
        match fault {
            GrblFault::Late { by_s, until_s } => f.late = (by_s, until_s),
            GrblFault::Garbled { way, part, until_s } => f.garbled[way as usize] = (part, until_s),
            GrblFault::Lost { way, part, until_s } => f.lost[way as usize] = (part, until_s),
            GrblFault::Split { pause_s, until_s } => f.split = (pause_s, until_s),
            GrblFault::Error(code) => f.error = Some(code),
            GrblFault::Silent { until_s } => f.silent_until_s = until_s,
            GrblFault::PortGone { until_s } => {
                f.gone_until_s = until_s;
                self.arriving.clear();
                self.said.clear();
            }
            GrblFault::Alarm(code) => {
                if self.state != State::Off {
                    self.alarm(code);
                }
            }
            GrblFault::BrownOut { for_s } => self.power_off(for_s, now_s),
            GrblFault::Stuck { axis, stuck } => {
                let counter = self.motion.at(now_s).0;
                self.truth.stick(now_s, &counter, axis, stuck);
            }
            GrblFault::Knocked { axis, by } => {
                let counter = self.motion.at(now_s).0;
                self.truth.knock(now_s, &counter, axis, by);
            }
            GrblFault::Door { open } => self.door(open),
        }
    }

    fn door(&mut self, open: bool) {
        self.door_open = open;
        if !open || matches!(self.state, State::Off | State::Alarm | State::Home) {
            return;
        }
        match self.state {
            // A jog is cancelled; the door shows when it has come to rest.
            State::Jog => self.hold(),
            State::Run => {
                self.hold();
                self.state = State::Door;
            }
            _ => self.state = State::Door,
        }
    }

    /// Say something, at the line's rate and with the faults that there are.
    pub(super) fn say(&mut self, text: &str) {
        let now_s = self.clock_s;
        if now_s < self.faults.silent_until_s || now_s < self.faults.gone_until_s {
            return;
        }
        let lost = Lasting::size(self.faults.lost[1], now_s);
        if lost > 0.0 && self.random.unit() < lost {
            return;
        }
        let garbled = Lasting::size(self.faults.garbled[1], now_s);
        let mut bytes = text.as_bytes().to_vec();
        for byte in &mut bytes {
            *byte = self.flipped(*byte, garbled);
        }
        let late_s = Lasting::size(self.faults.late, now_s);
        let start_s = self.said_s.max(now_s + late_s);
        let pause_s = Lasting::size(self.faults.split, now_s);
        if pause_s > 0.0 && bytes.len() > 2 {
            let cut = 1 + (self.random.unit() * (bytes.len() - 1) as f64) as usize;
            let rest = bytes.split_off(cut);
            let start_s = self.put(bytes, start_s);
            self.put(rest, start_s + pause_s);
        } else {
            self.put(bytes, start_s);
        }
    }

    fn put(&mut self, bytes: Vec<u8>, start_s: f64) -> f64 {
        self.said_s = start_s + bytes.len() as f64 * self.byte_s();
        if self.said.len() == UNREAD_MAX {
            self.said.pop_front();
        }
        self.said.push_back(Said {
            start_s,
            bytes,
            taken: 0,
        });
        self.said_s
    }

    pub(super) fn flipped(&mut self, byte: u8, part: f64) -> u8 {
        if part > 0.0 && self.random.unit() < part {
            byte ^ (1 << (self.random.bits() % 8))
        } else {
            byte
        }
    }
}
