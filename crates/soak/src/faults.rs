//! What goes wrong in a run, when, and for how long: all of it drawn from the seed.

use vergence_control::AxisName;
use vergence_geometry::Eye;

use crate::chance::Chance;

/// Before this nothing goes wrong: the rig starts and finds its target, s.
const FIRST_S: f64 = 9.0;

/// After this nothing goes wrong, so that coming back is seen, s before the end.
const LAST_S: f64 = 18.0;

/// Where in the program something is not a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NanIn {
    /// What is measured of the target.
    Measurement,
    /// Where the control law believes it to be.
    Aim,
    /// The setpoints, on their way to the driver.
    Setpoint,
    /// The program's clock.
    Clock,
}

impl NanIn {
    pub(crate) const ALL: [Self; 4] = [Self::Measurement, Self::Aim, Self::Setpoint, Self::Clock];
}

/// Something that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fault {
    /// Frames of one camera are lost, each with probability one half.
    FramesLost(Eye),
    /// Frames of both cameras come up to 0.6 s late, and out of order.
    FramesLate,
    /// One camera gives the same picture again and again, with new stamps.
    Frozen(Eye),
    /// Left and right are swapped.
    Swapped,
    /// The lower half of one camera's picture is of the frame before.
    Torn(Eye),
    /// Both pictures are dark.
    Dark,
    /// One camera is gone.
    CameraGone(Eye),
    /// Every frame comes twice.
    Doubled,
    /// The stamps of one camera are not numbers, or seconds off.
    BadStamps(Eye),
    /// Nobody is in the room.
    TargetLost,
    /// The program's clock jumps by this much, s.
    ClockJump(f64),
    /// The loop does not get to run.
    LoopStall,
    /// Readings of an axis are not numbers.
    NanReading(AxisName),
    /// Something in the program itself is not a number.
    Nan(NanIn),
    /// The controller answers late.
    AnswersLate,
    /// Bytes from the controller are changed.
    Garbled,
    /// Bytes from the controller come in pieces.
    Split,
    /// Bytes from the controller are lost.
    BytesLost,
    /// Bytes to the controller are changed.
    GarbledOut,
    /// The controller answers a command with an error.
    ErrorAnswer,
    /// The controller raises an alarm.
    Alarm,
    /// The controller loses its supply in mid-move and restarts.
    BrownOut,
    /// A motor stalls: the controller counts on, the axis stands.
    Stuck(AxisName),
    /// The controller forgets its zeros.
    LostHome,
    /// The port vanishes.
    PortGone,
    /// Nothing can be written to the disk.
    DiskFull,
    /// The disk takes next to nothing.
    DiskSlow,
}

impl Fault {
    /// Whether it is one of the controller or of its line, after which axes may have lost their zeros.
    pub(crate) fn may_take_zeros(self) -> bool {
        match self {
            Fault::NanReading(_)
            | Fault::Nan(_)
            | Fault::AnswersLate
            | Fault::Garbled
            | Fault::Split
            | Fault::BytesLost
            | Fault::GarbledOut
            | Fault::ErrorAnswer
            | Fault::Alarm
            | Fault::BrownOut
            | Fault::Stuck(_)
            | Fault::LostHome
            | Fault::PortGone => true,
            Fault::FramesLost(_)
            | Fault::FramesLate
            | Fault::Frozen(_)
            | Fault::Swapped
            | Fault::Torn(_)
            | Fault::Dark
            | Fault::CameraGone(_)
            | Fault::Doubled
            | Fault::BadStamps(_)
            | Fault::TargetLost
            | Fault::ClockJump(_)
            | Fault::LoopStall
            | Fault::DiskFull
            | Fault::DiskSlow => false,
        }
    }
}

/// A fault and its time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Planted {
    /// What.
    pub fault: Fault,
    /// From when, s of the world.
    pub from_s: f64,
    /// Until when, s of the world; moments (an alarm) happen at `from_s`.
    pub until_s: f64,
}

impl Planted {
    /// Whether it is at work.
    pub(crate) fn is_on(&self, world_s: f64) -> bool {
        (self.from_s..self.until_s).contains(&world_s)
    }

    /// Whether it ends in the step that ends at `world_s`.
    pub(crate) fn ends(&self, world_s: f64, step_s: f64) -> bool {
        self.until_s <= world_s && self.until_s > world_s - step_s
    }

    /// Whether it begins in the step that ends at `world_s`.
    pub(crate) fn begins(&self, world_s: f64, step_s: f64) -> bool {
        self.from_s <= world_s && self.from_s > world_s - step_s
    }
}

/// How many kinds there are to draw from.
const KINDS: u64 = 26;

/// The faults of a seed: one at a time for two seeds in three, several together for the third.
pub(crate) fn planted(seed: u64, seconds: f64) -> Vec<Planted> {
    let mut chance = Chance::new(seed);
    let together = seed % 3 == 2;
    let end_s = seconds - LAST_S;
    let mut faults = Vec::new();
    let mut from_s = FIRST_S + chance.between(0.0, 2.0);
    while from_s < end_s {
        let count = if together { 2 + chance.below(3) } else { 1 };
        let mut last_s = from_s;
        for _ in 0..count {
            let from_s = from_s
                + if together {
                    chance.between(0.0, 0.5)
                } else {
                    0.0
                };
            let until_s = from_s + chance.between(0.1, 2.5);
            let fault = drawn(&mut chance);
            faults.push(Planted {
                fault,
                from_s,
                until_s,
            });
            last_s = last_s.max(until_s);
        }
        from_s = last_s + chance.between(6.0, 10.0);
    }
    faults
}

fn drawn(chance: &mut Chance) -> Fault {
    let eye = if chance.below(2) == 0 {
        Eye::Left
    } else {
        Eye::Right
    };
    let axis = AxisName::ALL[chance.below(4) as usize];
    match chance.below(KINDS) {
        0 => Fault::FramesLost(eye),
        1 => Fault::FramesLate,
        2 => Fault::Frozen(eye),
        3 => Fault::Swapped,
        4 => Fault::Torn(eye),
        5 => Fault::Dark,
        6 => Fault::CameraGone(eye),
        7 => Fault::Doubled,
        8 => Fault::BadStamps(eye),
        9 => Fault::TargetLost,
        10 => Fault::ClockJump(chance.between(0.05, 5.0)),
        11 => Fault::ClockJump(-chance.between(0.01, 5.0)),
        12 => Fault::LoopStall,
        13 if eye == Eye::Left => Fault::NanReading(axis),
        13 => Fault::Nan(NanIn::ALL[axis.index()]),
        14 => Fault::AnswersLate,
        15 => Fault::Garbled,
        16 => Fault::Split,
        17 => Fault::BytesLost,
        18 => Fault::GarbledOut,
        19 => Fault::ErrorAnswer,
        20 => Fault::Alarm,
        21 => Fault::BrownOut,
        22 => Fault::Stuck(axis),
        23 => Fault::LostHome,
        24 => Fault::PortGone,
        _ if chance.below(2) == 0 => Fault::DiskFull,
        _ => Fault::DiskSlow,
    }
}
