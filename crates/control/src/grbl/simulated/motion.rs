//! The simulated controller's planner and step generator: straight blocks, junction speeds, look-ahead, constant acceleration.
//!
//! Written from the description of Grbl's planner by its authors (S. K. Jeon, "Improving Grbl: Cornering Algorithm", 2011, for the junction
//! deviation). Positions are continuous functions of time, made of pieces of constant acceleration. As in Grbl the step generator works
//! ahead: what a new block, a hold or a cancel changes takes effect only after what is prepared already ([`PREPARED_S`]).

use std::collections::VecDeque;

use crate::grbl::protocol::AXES_MAX;

/// A value for each axis.
pub type Units = [f64; AXES_MAX];

/// Motion that the step generator has prepared and will not change, s: Grbl keeps six segments of 10 ms, of which the first runs.
pub const PREPARED_S: f64 = 0.05;

/// History of positions kept, s.
const KEPT_S: f64 = 5.0;

/// What a block may do, from the settings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MotionLimits {
    /// Highest speed of each axis, units/s.
    pub(crate) rate: Units,
    /// Acceleration of each axis, units/s².
    pub(crate) acceleration: Units,
    /// Junction deviation, units.
    pub(crate) deviation: f64,
}

#[derive(Clone, Debug)]
struct Block {
    unit: Units,
    end: Units,
    /// What is left of it, units.
    left: f64,
    acceleration: f64,
    nominal: f64,
    entry_max_sq: f64,
    entry_sq: f64,
}

/// A stretch of constant acceleration along a straight line.
#[derive(Clone, Copy, Debug)]
struct Piece {
    start_s: f64,
    end_s: f64,
    from: Units,
    unit: Units,
    speed: f64,
    acceleration: f64,
}

impl Piece {
    fn at(&self, at_s: f64) -> (Units, Units, f64) {
        let t = (at_s - self.start_s).clamp(0.0, self.end_s - self.start_s);
        let way = t * (self.speed + self.acceleration * t / 2.0);
        let running = at_s < self.end_s;
        let speed = if running {
            self.speed + self.acceleration * t
        } else {
            0.0
        };
        (
            std::array::from_fn(|i| self.from[i] + self.unit[i] * way),
            self.unit.map(|u| u * speed),
            if running { self.acceleration } else { 0.0 },
        )
    }
}

/// How often the generated motion passed what the settings allow. All zero, or there is a bug in the simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotionAudit {
    /// Pieces that were faster than an axis may be.
    pub speed: u64,
    /// Pieces that accelerated more than an axis may.
    pub acceleration: u64,
    /// Changes of speed between pieces that no junction explains.
    pub jumps: u64,
    /// Times that the motion was cut off in full speed, as a reset or a power cut does: no violation.
    pub cut: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Flow {
    Running,
    /// Slowing down, after a hold or a cancel.
    Stopping,
    /// Standing, with blocks left.
    Stopped,
}

/// Planner and step generator.
#[derive(Clone, Debug)]
pub(crate) struct Motion {
    blocks: VecDeque<Block>,
    /// Up to here the motion is generated.
    cursor_s: f64,
    /// Counter at the cursor.
    position: Units,
    /// Speed along the first block at the cursor.
    speed: f64,
    /// Where the last block ends.
    planned: Units,
    /// Direction and speed of the last block that was planned.
    last: Option<(Units, f64)>,
    pub(crate) flow: Flow,
    pieces: VecDeque<Piece>,
    /// Velocity at the end of the newest piece, for the audit.
    velocity: Units,
    pub(crate) audit: MotionAudit,
    limits: MotionLimits,
}

impl Motion {
    pub(crate) fn new(limits: MotionLimits, now_s: f64) -> Self {
        let mut motion = Self {
            blocks: VecDeque::new(),
            cursor_s: now_s,
            position: [0.0; AXES_MAX],
            speed: 0.0,
            planned: [0.0; AXES_MAX],
            last: None,
            flow: Flow::Running,
            pieces: VecDeque::new(),
            velocity: [0.0; AXES_MAX],
            audit: MotionAudit::default(),
            limits,
        };
        motion.set_position([0.0; AXES_MAX], now_s);
        motion
    }

    pub(crate) fn set_limits(&mut self, limits: MotionLimits) {
        self.limits = limits;
    }

    /// Blocks that the planner holds.
    pub(crate) fn blocks(&self) -> usize {
        self.blocks.len()
    }

    /// Where the last planned block ends, units.
    pub(crate) fn planned(&self) -> &Units {
        &self.planned
    }

    /// When everything that is planned (or held) has come to rest, as soon as that is generated.
    pub(crate) fn rest_s(&self) -> Option<f64> {
        let resting = match self.flow {
            Flow::Running => self.blocks.is_empty(),
            Flow::Stopping => false,
            Flow::Stopped => true,
        };
        resting.then_some(self.cursor_s)
    }

    /// Counter, velocity and acceleration along the path at a time that is generated and kept.
    pub(crate) fn at(&self, at_s: f64) -> (Units, Units, f64) {
        let after = self.pieces.partition_point(|p| p.start_s <= at_s);
        match self.pieces.get(after.saturating_sub(1)) {
            Some(piece) => piece.at(at_s),
            None => (self.position, [0.0; AXES_MAX], 0.0),
        }
    }

    /// A straight block to `end` at `rate` units/s, limited by what each axis may do; `false` when it has no length.
    pub(crate) fn plan(&mut self, end: &Units, rate: f64, now_s: f64) -> bool {
        let delta: Units = std::array::from_fn(|i| end[i] - self.planned[i]);
        let length = delta.iter().map(|d| d * d).sum::<f64>().sqrt();
        if length < 1e-9 {
            return false;
        }
        let unit = delta.map(|d| d / length);
        let limited = |limit: &Units| {
            unit.iter()
                .zip(limit)
                .filter(|(u, _)| u.abs() > 1e-12)
                .map(|(u, l)| l / u.abs())
                .fold(f64::INFINITY, f64::min)
        };
        let acceleration = limited(&self.limits.acceleration);
        let nominal = rate.min(limited(&self.limits.rate));
        if self.blocks.is_empty() {
            self.begin(now_s);
        }
        let entry_max_sq = match (&self.last, self.blocks.is_empty()) {
            (Some((last_unit, last_nominal)), false) => {
                let most = nominal.min(*last_nominal);
                self.junction_sq(last_unit, &unit).min(most * most)
            }
            _ => 0.0,
        };
        self.blocks.push_back(Block {
            unit,
            end: *end,
            left: length,
            acceleration,
            nominal,
            entry_max_sq,
            entry_sq: entry_max_sq,
        });
        self.planned = *end;
        self.last = Some((unit, nominal));
        self.look_ahead();
        true
    }

    /// Square of the highest speed from one direction into another: the centripetal acceleration along a circle that stays within the
    /// deviation of the corner.
    fn junction_sq(&self, from: &Units, to: &Units) -> f64 {
        let cos = -from.iter().zip(to).map(|(a, b)| a * b).sum::<f64>();
        if cos > 0.999_999 {
            return 0.0;
        }
        let diff: Units = std::array::from_fn(|i| to[i] - from[i]);
        let size = diff.iter().map(|d| d * d).sum::<f64>().sqrt();
        if cos < -0.999_999 || size < 1e-12 {
            return f64::INFINITY;
        }
        let acceleration = diff
            .iter()
            .zip(&self.limits.acceleration)
            .filter(|(d, _)| d.abs() > 1e-12)
            .map(|(d, a)| a * size / d.abs())
            .fold(f64::INFINITY, f64::min);
        let half = ((1.0 - cos) / 2.0).sqrt();
        acceleration * self.limits.deviation * half / (1.0 - half)
    }

    /// Entry speeds from which every later block can still stop at the end of the last one.
    fn look_ahead(&mut self) {
        let mut exit_sq = 0.0;
        for i in (1..self.blocks.len()).rev() {
            let b = &mut self.blocks[i];
            b.entry_sq = b.entry_max_sq.min(exit_sq + 2.0 * b.acceleration * b.left);
            exit_sq = b.entry_sq;
        }
        let mut entry_sq = self.speed * self.speed;
        for i in 1..self.blocks.len() {
            let before = &self.blocks[i - 1];
            let reached = entry_sq + 2.0 * before.acceleration * before.left;
            let b = &mut self.blocks[i];
            b.entry_sq = b.entry_sq.min(reached);
            entry_sq = b.entry_sq;
        }
    }

    /// Begin anew from rest.
    fn begin(&mut self, now_s: f64) {
        self.cursor_s = self.cursor_s.max(now_s);
        self.speed = 0.0;
    }

    /// Generate motion up to `until_s`, or to where it rests.
    pub(crate) fn generate(&mut self, until_s: f64) {
        while self.cursor_s < until_s && !self.blocks.is_empty() && self.flow != Flow::Stopped {
            self.generate_piece(until_s - self.cursor_s);
        }
        while self.pieces.len() > 2 && self.pieces[1].end_s < until_s - KEPT_S {
            self.pieces.pop_front();
        }
    }

    /// One piece, at most `most_s` long.
    fn generate_piece(&mut self, most_s: f64) {
        let exit_sq = match self.flow {
            Flow::Running => self.blocks.get(1).map_or(0.0, |b| b.entry_sq),
            _ => 0.0,
        };
        let b = &self.blocks[0];
        let (v, a) = (self.speed, b.acceleration);
        let (acceleration, whole_s) = if self.flow == Flow::Stopping {
            // To rest, or to the end of this block if that comes first.
            let end_speed = (v * v - 2.0 * a * b.left).max(0.0).sqrt();
            (-a, (v - end_speed) / a)
        } else {
            phase(v, a, b.nominal, exit_sq, b.left)
        };
        let span = whole_s.min(most_s);
        let way = (span * (v + acceleration * span / 2.0)).clamp(0.0, b.left);
        self.push(span, acceleration);
        let b = &mut self.blocks[0];
        b.left -= way;
        self.speed = (v + acceleration * span).max(0.0);
        let stopped = self.flow == Flow::Stopping && (self.speed < 1e-9 || whole_s < 1e-12);
        // A nanometre is rounding.
        if b.left < 1e-9 {
            self.position = b.end;
            self.blocks.pop_front();
            if self.blocks.is_empty() {
                self.speed = 0.0;
            }
        }
        if stopped || (self.flow == Flow::Stopping && self.blocks.is_empty()) {
            self.speed = 0.0;
            self.flow = Flow::Stopped;
        }
    }

    fn push(&mut self, span: f64, acceleration: f64) {
        if span <= 0.0 {
            return;
        }
        let unit = self.blocks[0].unit;
        let piece = Piece {
            start_s: self.cursor_s,
            end_s: self.cursor_s + span,
            from: self.position,
            unit,
            speed: self.speed,
            acceleration,
        };
        self.audit_piece(&piece);
        let way = span * (piece.speed + acceleration * span / 2.0);
        for (p, u) in self.position.iter_mut().zip(&unit) {
            *p += u * way;
        }
        self.cursor_s = piece.end_s;
        self.pieces.push_back(piece);
    }

    fn audit_piece(&mut self, piece: &Piece) {
        let end_speed = piece.speed + piece.acceleration * (piece.end_s - piece.start_s);
        let contiguous = self.pieces.back().is_some_and(|p| p.end_s == piece.start_s);
        for i in 0..AXES_MAX {
            let l = &self.limits;
            let u = piece.unit[i];
            let fastest = piece.speed.max(end_speed) * u.abs();
            self.audit.speed += u64::from(fastest > l.rate[i] * (1.0 + 1e-6) + 1e-9);
            let harder = piece.acceleration.abs() * u.abs();
            self.audit.acceleration += u64::from(harder > l.acceleration[i] * (1.0 + 1e-6));
            let before = if contiguous { self.velocity[i] } else { 0.0 };
            let jump = (piece.speed * u - before).abs();
            self.audit.jumps += u64::from(jump > self.jump_max(i) + 1e-6);
            self.velocity[i] = end_speed * u;
        }
    }

    /// Largest change of an axis' speed at a junction, units/s: `sqrt(8 a δ)`, the limit of the junction formula for small angles; the
    /// acceleration is that of the junction's direction, which this axis allows at most `a`, and √2 covers the whole range of angles.
    pub(crate) fn jump_max(&self, axis: usize) -> f64 {
        let l = &self.limits;
        (8.0 * l.acceleration[axis] * l.deviation).sqrt() * std::f64::consts::SQRT_2
    }

    /// Begin to slow down; takes effect after what is prepared.
    pub(crate) fn stop(&mut self, now_s: f64) {
        self.generate(now_s + PREPARED_S);
        if self.flow == Flow::Running {
            self.flow = if self.speed > 0.0 && !self.blocks.is_empty() {
                Flow::Stopping
            } else {
                Flow::Stopped
            };
        }
    }

    /// Go on after a hold.
    pub(crate) fn resume(&mut self, now_s: f64) {
        self.flow = Flow::Running;
        self.begin(now_s);
        if let Some(first) = self.blocks.front_mut() {
            first.entry_sq = 0.0;
        }
        self.look_ahead();
    }

    /// Forget all blocks; only at rest.
    pub(crate) fn flush(&mut self) {
        self.blocks.clear();
        self.flow = Flow::Running;
        self.speed = 0.0;
        self.planned = self.position;
        self.last = None;
    }

    /// Stop the steps at once, as a reset does; whether anything moved.
    pub(crate) fn cut(&mut self, now_s: f64) -> bool {
        let (position, velocity, _) = self.at(now_s);
        while self.pieces.back().is_some_and(|p| p.start_s >= now_s) {
            self.pieces.pop_back();
        }
        if let Some(last) = self.pieces.back_mut() {
            last.end_s = last.end_s.min(now_s);
        }
        let moved = velocity.iter().any(|v| v.abs() > 0.0);
        self.audit.cut += u64::from(moved);
        self.set_position(position, now_s);
        moved
    }

    /// Say where the counter is; only at rest.
    pub(crate) fn set_position(&mut self, position: Units, now_s: f64) {
        self.position = position;
        self.cursor_s = now_s;
        self.flush();
        self.velocity = [0.0; AXES_MAX];
        self.pieces.push_back(Piece {
            start_s: now_s,
            end_s: now_s,
            from: position,
            unit: [0.0; AXES_MAX],
            speed: 0.0,
            acceleration: 0.0,
        });
    }
}

/// Acceleration and length of the next phase of a block with `left` to go: up to the nominal speed, along at it, down to the exit speed.
fn phase(v: f64, a: f64, nominal: f64, exit_sq: f64, left: f64) -> (f64, f64) {
    let v_sq = v * v;
    let exit = exit_sq.sqrt();
    let braking = (v_sq - exit_sq) / (2.0 * a);
    if braking >= left - 1e-12 {
        // Down to the exit; where rounding left too little way, to the end of the block.
        let end_speed = (v_sq - 2.0 * a * left).max(0.0).sqrt().max(exit.min(v));
        let span = if v - end_speed > 1e-12 {
            (v - end_speed) / a
        } else {
            left / v.max(1e-9)
        };
        return (-a * f64::from(u8::from(v - end_speed > 1e-12)), span);
    }
    if v > nominal * (1.0 + 1e-12) {
        return (-a, (v - nominal) / a);
    }
    let peak_sq = ((2.0 * a * left + v_sq + exit_sq) / 2.0)
        .min(nominal * nominal)
        .min(v_sq + 2.0 * a * left);
    let peak = peak_sq.sqrt();
    if peak > v * (1.0 + 1e-12) + 1e-12 {
        return (a, (peak - v) / a);
    }
    let cruise = left - (v_sq - exit_sq).max(0.0) / (2.0 * a);
    (0.0, cruise / v.max(1e-9))
}
