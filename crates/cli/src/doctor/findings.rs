//! What was measured of two live cameras, judged: what is good, what is wrong, and what to do about it.

use vergence_capture::live::{
    Agreement, CameraMode, CameraStatistics, ClockDomain, LiveKind, LiveStatistics,
};
use vergence_capture::{SourceEvent, SourceEventKind};

use super::abilities::rate_text;
use super::cameras::GROUP;
use super::{Check, Status};

/// A rate that differs by more than this part of what it should be is another one: over three seconds the median period of 30 pictures a second is known to 1 %.
const RATE: f64 = 0.05;

/// More than this share of pictures lost, torn, doubled or unfetched is wrong, unless it is a single one; fewer are a note.
const MISSING: f64 = 0.01;

/// More than this share of late pictures is wrong; the loop waits for each of them.
const LATE: f64 = 0.05;

/// More than this share of frames without a partner is wrong.
const ALONE: f64 = 0.05;

/// Jitter beyond this part of a period takes pictures out of their pair, which may be a fifth of a period apart.
const JITTER: f64 = 0.2;

/// A steady offset of the exposures beyond this part of a period is worth a trigger.
const OFFSET: f64 = 0.1;

/// So many pictures of a camera must come before it can be said that there is no steady offset.
const ENOUGH: u64 = 48;

/// What was measured.
#[derive(Clone, Debug)]
pub(crate) struct Watched {
    pub(crate) kind: LiveKind,
    /// How long was watched, s.
    pub(crate) seconds: f64,
    pub(crate) agreement: Agreement,
    /// The rate that was asked for, 1/s.
    pub(crate) asked_fps: Option<f64>,
    /// Nobody locked the controls (`--leave-controls`).
    pub(crate) is_left_alone: bool,
    /// What was said when the cameras were opened.
    pub(crate) remarks: Vec<String>,
    /// How far apart two frames may be to be a pair, s.
    pub(crate) limit_s: f64,
    /// When watching began, and when it ended.
    pub(crate) before: LiveStatistics,
    pub(crate) after: LiveStatistics,
    /// Right times minus left times of every pair, s.
    pub(crate) apart_s: Vec<f64>,
    pub(crate) events: Vec<SourceEvent>,
}

/// A camera, as it was judged.
struct Eye<'a> {
    seen: &'a Watched,
    item: String,
    mode: CameraMode,
    before: &'a CameraStatistics,
    after: &'a CameraStatistics,
}

/// Everything that can be said of the cameras.
pub(crate) fn checks(seen: &Watched) -> Vec<Check> {
    let [left, right] = &seen.agreement.modes;
    let eyes = [
        Eye::new("left", *left, seen, [&seen.before.left, &seen.after.left]),
        Eye::new(
            "right",
            *right,
            seen,
            [&seen.before.right, &seen.after.right],
        ),
    ];
    let mut checks = Vec::new();
    for eye in &eyes {
        checks.push(eye.found());
        checks.extend(eye.rates());
        checks.extend(eye.missing());
        checks.extend(eye.regularity());
    }
    checks.extend(controls(seen));
    checks.extend(pairs(seen));
    checks.extend(unlike_rates(&eyes));
    checks.push(offset(seen));
    checks.extend(events(seen));
    checks
}

fn is_stream(kind: LiveKind) -> bool {
    kind != LiveKind::V4l2
}

/// What lets more pictures through.
fn relief(kind: LiveKind) -> &'static str {
    match kind {
        LiveKind::V4l2 => {
            "give each camera a USB port of its own controller, or send less: --pixels mjpeg, a smaller --size, a lower --fps"
        }
        LiveKind::Rtsp | LiveKind::Stream => {
            "connect the cameras by cable, lower their bit rate in their own settings, and leave --udp out"
        }
    }
}

fn share(part: u64, whole: u64) -> f64 {
    part as f64 / whole.max(1) as f64
}

fn ms(seconds: f64) -> String {
    format!("{:.1} ms", seconds * 1e3)
}

impl<'a> Eye<'a> {
    fn new(
        eye: &str,
        mode: CameraMode,
        seen: &'a Watched,
        [before, after]: [&'a CameraStatistics; 2],
    ) -> Self {
        Self {
            seen,
            item: format!("{eye} {}", after.name),
            mode,
            before,
            after,
        }
    }

    fn check(&self, status: Status, found: String) -> Check {
        Check::new(GROUP, self.item.clone(), status, found)
    }

    /// How many more there are than when watching began.
    fn more(&self, count: fn(&CameraStatistics) -> u64) -> u64 {
        count(self.after).saturating_sub(count(self.before))
    }

    fn frames(&self) -> u64 {
        self.more(|c| c.counts.frames)
    }

    /// Pictures a second; `None` without two that followed one another.
    fn fps(&self) -> Option<f64> {
        let period_s = self.after.period.median_s;
        (period_s > 0.0).then(|| 1.0 / period_s)
    }

    /// What it sends and what came of it.
    fn found(&self) -> Check {
        let frames = self.frames();
        let format = self.mode.format.unwrap_or("pictures through ffmpeg");
        let nominal = match self.mode.fps {
            Some(fps) => format!("{} a second by its own account", rate_text(fps)),
            None => "no rate told".to_owned(),
        };
        let came = self
            .fps()
            .map_or("nothing".to_owned(), |fps| format!("{fps:.2} a second"));
        let jitter = match self.after.jitter.count {
            0 => "jitter not known yet".to_owned(),
            _ => format!("jitter {} (p95)", ms(self.after.jitter.p95_s)),
        };
        let clock = match self.after.counts.clock {
            ClockDomain::Machine => "this machine's clock",
            ClockDomain::Own => "a clock of its own",
            ClockDomain::Arrival => "their arrival",
        };
        let (width, height) = self.mode.size;
        let found = format!(
            "{format} {width}x{height}, {nominal}; came {came} ({frames} in {:.1} s), {jitter}, {} lost, {} late, {} torn; times by {clock}",
            self.seen.seconds,
            self.more(|c| c.counts.lost),
            self.more(|c| c.late),
            self.more(|c| c.counts.torn),
        );
        match frames {
            0 => self
                .check(Status::Wrong, found)
                .next("no picture came while it was watched: see that it is on and connected"),
            _ => self.check(Status::Good, found),
        }
    }

    /// Rates that are not what was asked for or told.
    fn rates(&self) -> Option<Check> {
        if let (Some(asked), Some(told)) = (self.seen.asked_fps, self.mode.fps)
            && (told / asked - 1.0).abs() > RATE
        {
            let [asked, told] = [asked, told].map(rate_text);
            let found = format!("{asked} pictures a second were asked for, it is set to {told}");
            let next = format!("ask for a rate that it has in this size and format: --fps {told}");
            return Some(self.check(Status::Wrong, found).next(next));
        }
        let wanted = self.mode.fps.or(self.seen.asked_fps)?;
        let fps = self.fps()?;
        let found = format!(
            "gives {fps:.2} pictures a second where {} were to come",
            rate_text(wanted)
        );
        let next = match fps < wanted {
            true if is_stream(self.seen.kind) => {
                "set the rate in the camera's own settings, and see that the network carries it"
            }
            true => "dim light makes many cameras slower: add light, or set a shorter --exposure",
            false => "say the rate that it has: --fps",
        };
        ((fps / wanted - 1.0).abs() > RATE).then(|| self.check(Status::Wrong, found).next(next))
    }

    /// Pictures that did not come whole, or not in time.
    fn missing(&self) -> Vec<Check> {
        let (lost, torn) = (self.more(|c| c.counts.lost), self.more(|c| c.counts.torn));
        let unfetched = self.more(|c| c.counts.overrun);
        let all = self.frames() + lost + torn;
        let slow = "the machine is too slow for these pictures: a smaller --size or a lower --fps, and no other work beside it";
        let told = [
            (lost, "were lost on the way", relief(self.seen.kind)),
            (
                torn,
                "came damaged and were not used",
                relief(self.seen.kind),
            ),
            (unfetched, "were not fetched in time", slow),
        ];
        let check = |(count, what, next): (u64, &str, &str)| {
            let status = match count > 1 && share(count, all) > MISSING {
                true => Status::Wrong,
                false => Status::Note,
            };
            let found = format!("{count} of {all} pictures {what}");
            (count > 0).then(|| self.check(status, found).next(next))
        };
        told.into_iter().filter_map(check).collect()
    }

    /// Pictures that came late or at uneven times.
    fn regularity(&self) -> Vec<Check> {
        let mut checks = Vec::new();
        let late = self.more(|c| c.late);
        if share(late, self.frames()) > LATE {
            let found = format!("{late} of {} pictures came late", self.frames());
            let next = format!(
                "let nothing else use the machine and the way to it; {}",
                relief(self.seen.kind)
            );
            checks.push(self.check(Status::Wrong, found).next(next));
        }
        let (jitter, period_s) = (&self.after.jitter, self.after.period.median_s);
        if jitter.count == 0 {
            let found = "too few pictures came to know their jitter".to_owned();
            checks.push(
                self.check(Status::Note, found)
                    .next("watch longer: --seconds 10s"),
            );
        } else if jitter.p95_s > JITTER * period_s {
            let found = format!(
                "pictures come unevenly: 95 % lie within {} of their period of {}",
                ms(jitter.p95_s),
                ms(period_s)
            );
            let next = match is_stream(self.seen.kind) {
                true => {
                    "set a constant rate in the camera's own settings, and a short distance between key frames"
                }
                false => {
                    "switch off what varies its rate (--exposure sets a fixed one), and let nothing else use its USB controller"
                }
            };
            checks.push(self.check(Status::Wrong, found).next(next));
        }
        checks
    }
}

/// Controls that have one value on both, and those that have not.
fn controls(seen: &Watched) -> Vec<Check> {
    if is_stream(seen.kind) {
        return Vec::new();
    }
    let item = "controls";
    if seen.is_left_alone {
        let found = "left to each camera (--leave-controls): the two pictures may differ";
        return vec![
            Check::new(GROUP, item, Status::Note, found)
                .next("leave --leave-controls out, and both get the same values"),
        ];
    }
    let all = seen.agreement.controls.iter();
    let all: Vec<String> = all.map(|c| format!("{} {}", c.name, c.value)).collect();
    let mut checks = vec![match all.is_empty() {
        true => Check::new(GROUP, item, Status::Note, "none that could be made equal")
            .next("set both cameras alike by their own means, or use two that can be set"),
        false => Check::new(
            GROUP,
            item,
            Status::Good,
            format!("the same on both: {}", all.join(", ")),
        ),
    }];
    checks.extend(seen.remarks.iter().map(|remark| {
        match seen.agreement.unset.contains(remark) {
            true => Check::new(GROUP, item, Status::Wrong, remark.clone()).next(
                "leave its flag out, use two cameras of one type and firmware, or set this by their own means",
            ),
            false => Check::new(GROUP, item, Status::Note, remark.clone())
                .next("name a value that both take, or leave it so"),
        }
    }));
    checks
}

/// How many pairs came, and how near their two frames were.
fn pairs(seen: &Watched) -> Vec<Check> {
    let more =
        |count: fn(&LiveStatistics) -> u64| count(&seen.after).saturating_sub(count(&seen.before));
    let check = |status, found| Check::new(GROUP, "pair", status, found);
    let paired = more(|s| s.pairing.paired);
    let alone = more(|s| s.pairing.unpaired);
    let doubled = more(|s| s.pairing.doubled);
    let mut checks = Vec::new();
    let found = format!(
        "{paired} pairs in {:.1} s, skew {} (p95) where {} are allowed, {alone} frames without a partner, {doubled} doubled",
        seen.seconds,
        ms(skew_p95_s(seen)),
        ms(seen.limit_s)
    );
    let frames = 2 * paired + alone + doubled;
    checks.push(match (paired, share(alone, frames) > ALONE) {
        (0, _) | (_, true) => check(Status::Wrong, found)
            .next("put right what is said of each camera's rate, gaps and jitter and of the offset: that keeps their frames from meeting"),
        (_, false) => check(Status::Good, found),
    });
    if share(doubled, frames) > MISSING {
        let found = format!(
            "{doubled} of {frames} frames came less than half a period after the one before"
        );
        checks.push(
            check(Status::Wrong, found).next("set one constant rate in the cameras' own settings"),
        );
    }
    let far = more(|s| s.too_far_apart);
    if far > 0 {
        let found = format!("{far} pairs were further apart than --max-apart allows");
        checks.push(
            check(Status::Wrong, found)
                .next("trigger both cameras together, or allow more with --max-apart"),
        );
    }
    checks
}

/// The time between the two of a pair beside the steady offset, below which 95 % lie, s; 0 without pairs.
fn skew_p95_s(seen: &Watched) -> f64 {
    let steady_s = match seen.after.offset_of_exposure {
        true => seen.after.offset_s.unwrap_or(0.0),
        // It was taken out of the right times already.
        false => 0.0,
    };
    let mut all: Vec<f64> = seen.apart_s.iter().map(|s| (s - steady_s).abs()).collect();
    all.sort_by(f64::total_cmp);
    let at = (0.95 * all.len().saturating_sub(1) as f64).round() as usize;
    all.get(at).copied().unwrap_or(0.0)
}

fn unlike_rates([left, right]: &[Eye<'_>; 2]) -> Option<Check> {
    let (l, r) = (left.fps()?, right.fps()?);
    let found = format!("left gives {l:.2} pictures a second, right {r:.2}");
    let check = Check::new(GROUP, "pair", Status::Wrong, found).next(
        "set both to one rate (--fps, or the cameras' own settings) and give both the same light",
    );
    ((l / r - 1.0).abs() > RATE).then_some(check)
}

/// The steady time between left and right pictures.
fn offset(seen: &Watched) -> Check {
    let check = |status, found| Check::new(GROUP, "offset", status, found);
    let period_s = seen
        .after
        .left
        .period
        .median_s
        .max(seen.after.right.period.median_s);
    let Some(offset_s) = seen.after.offset_s else {
        let frames = seen
            .after
            .left
            .counts
            .frames
            .min(seen.after.right.counts.frames);
        let few = frames < ENOUGH;
        return match few {
            true => check(Status::Note, "too few pictures came to know it".to_owned())
                .next("watch longer: --seconds 10s"),
            false => check(
                Status::Wrong,
                "none that is steady: the cameras' times drift against each other or are too uneven".to_owned(),
            )
            .next("give both one constant rate, or trigger them together"),
        };
    };
    let told = format!("{:+.1} ms", offset_s * 1e3);
    if seen.after.offset_ambiguous {
        let found = format!(
            "right pictures come {told} after the left ones, about half a period of {}: which belong together is a guess",
            ms(period_s)
        );
        return check(Status::Wrong, found)
            .next("trigger both together, or start one camera again until the offset is smaller");
    }
    if !seen.after.offset_of_exposure {
        let found = format!(
            "right pictures are stamped {told} after the left ones, by unlike clocks; that is taken out of their times"
        );
        return check(Status::Good, found);
    }
    let found = format!(
        "right pictures are taken {told} after the left ones: what moves 1 m/s across is seen {:.1} mm displaced",
        offset_s.abs() * 1e3
    );
    match offset_s.abs() > OFFSET * period_s {
        true => check(Status::Note, found)
            .next("a common trigger is the cure; --max-apart refuses such pairs"),
        false => check(Status::Good, found),
    }
}

/// What happened to a camera meanwhile: one of each kind and camera.
fn events(seen: &Watched) -> Vec<Check> {
    let mut told: Vec<&SourceEvent> = Vec::new();
    let mut checks = Vec::new();
    for event in &seen.events {
        let Some(next) = cure(event.kind, seen.kind) else {
            continue;
        };
        if told
            .iter()
            .any(|t| (t.kind, t.eye) == (event.kind, event.eye))
        {
            continue;
        }
        told.push(event);
        let check = Check::new(GROUP, "while watched", Status::Wrong, event.text.clone());
        checks.push(check.next(next));
    }
    checks
}

/// What to do about an event; `None` where it is none to worry about, or told elsewhere.
fn cure(event: SourceEventKind, kind: LiveKind) -> Option<&'static str> {
    Some(match event {
        SourceEventKind::Gone if is_stream(kind) => {
            "see that the camera stays on and the network carries its pictures"
        }
        SourceEventKind::Gone => "try another cable and port; a hub needs a supply of its own",
        SourceEventKind::Frozen => {
            "unplug it and plug it in again; where the scene truly stands still to the last bit, --frozen-after 0"
        }
        SourceEventKind::Dark => "take the cap off, add light, or set a longer --exposure",
        SourceEventKind::ClockJumped if !is_stream(kind) => {
            "its driver's times are not to be believed, and the pictures' arrival stands in for them: --delay says how long their way is"
        }
        SourceEventKind::ClockJumped => {
            "let the camera keep its clock: no time server that sets it while it runs"
        }
        SourceEventKind::Rate => {
            "keep the rate fixed: enough light, a shorter --exposure, a rate that the camera has (--fps)"
        }
        SourceEventKind::Control => "use two cameras of one type and firmware",
        SourceEventKind::Back
        | SourceEventKind::Thawed
        | SourceEventKind::Light
        | SourceEventKind::Offset => return None,
    })
}

#[cfg(test)]
mod tests;
