//! Does the room still lie where the axes say? A motor without an encoder that misses steps says nothing of it; what the cameras saw before does.
//!
//! While the head is slow, parts of the room are remembered with the directions in which they were seen ([`Keyframe`]). A picture that shows one of them
//! elsewhere was taken by a head that stands otherwise than its counters say: in both cameras by the same angle, then pan or tilt has lost its zero; in
//! one of them, then its vergence axis has. Pairs whose eyes are swapped lie beside by opposite angles and say nothing, and so does a camera that repeats its picture.
//! Nothing is found before the same part of the room was in sight twice.

use std::cell::OnceCell;
use std::f64::consts::PI;

use nalgebra::{Isometry3, Unit, Vector3};
use vergence_control::AxisName;
use vergence_geometry::{Eye, HeadAngles};
use vergence_imaging::Gray;
use vergence_track::{EyeView, Keyframe, Panorama, PixelBox, Turned};

/// Time between two looks, s ...
const EVERY_S: f64 = 0.35;

/// ... and for a while after something seemed to be wrong.
const DOUBTFUL_EVERY_S: f64 = 0.12;
const DOUBTFUL_FOR_S: f64 = 1.0;

/// Parts of the room that are remembered; the one that was not seen for longest makes room.
const MOST_KEPT: usize = 48;

/// A new part is remembered where none is that lies within this share of the picture's width and height.
const APART: f64 = 0.2;

/// A part that lies within this share of the picture is looked for where it should be.
const IN_VIEW: f64 = 0.5;

/// Patches that a part of the room must have, in each eye.
const LEAST_PATCHES: u32 = 7;

/// It is where it should be when so many patches are, and this share of those in the picture ...
const THERE: (u32, f64) = (4, 0.25);

/// ... and elsewhere when so many, and this share, are there together: a person who is followed is less of the picture, and seems to go with the camera ...
const ELSEWHERE: u32 = 6;
const ELSEWHERE_SHARE: f64 = 0.45;

/// ... and this share, if nothing is known of what should be there instead, of a part that was in its place so short a time ago, s, ...
const UNCHANGED_SHARE: f64 = 0.75;
const UNCHANGED_S: f64 = 3.0;

/// ... if so much of it would be in the picture there.
const IN_PICTURE: f64 = 0.4;

/// What both eyes see must lie beside by the same angle, rad (0.9°).
const ALIKE_RAD: f64 = 0.9 * PI / 180.0;

/// Least angle that counts for pan and tilt, rad (1.6°: what the way of the lens and one step of the search leave open) ...
const LEAST_RAD: f64 = 1.6 * PI / 180.0;

/// ... and for one eye alone, rad (0.5°), ...
const LEAST_VERGENCE_RAD: f64 = 0.5 * PI / 180.0;

/// ... where the other one lies beside by no more than this, rad (0.25°): eyes that are swapped both lie beside, to either side.
const OTHER_RAD: f64 = 0.25 * PI / 180.0;

/// Beside that so long a turn of the head: pictures may be of another time than they say, s, ...
const DOUBTFUL_S: f64 = 0.3;

/// ... and those of a pair of times that differ by so much, s: of a torn picture a part is of the frame before.
const PAIR_DOUBTFUL_S: f64 = 0.07;

/// Slower than this a look that finds nothing wrong says that nothing is, rad/s (10°/s).
const SURE_RAD_S: f64 = 10.0 * PI / 180.0;

/// After something was found beside nothing new is remembered for so long, s.
const WARY_S: f64 = 3.0;

/// So many parts in view are looked at, the nearest ones.
const LOOKED_AT: usize = 3;

/// The speed of the head fades from memory within this time, s.
const FADES_S: f64 = 0.3;

/// Faster than this nothing is looked at, rad/s (30°/s).
const LOOK_RAD_S: f64 = 30.0 * PI / 180.0;

/// So many of those that were seen last are looked for when nothing is where it should be: a head that stands still goes on seeing them.
const LATEST: usize = 3;

/// A single eye, and tilt, are searched for this far to both sides, rad (20°).
const NARROW_RAD: f64 = 20.0 * PI / 180.0;

/// A part that lies within this share of the picture should be found ...
const MISSED_WITHIN: f64 = 0.25;

/// ... and one that was not found where it should be so often, nor elsewhere, is forgotten: the room has changed.
const MISSES: u32 = 10;

/// Level of the pyramids by which it is seen that a camera repeats its picture.
const REPEAT_LEVEL: usize = 2;

/// What a look says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Bearing {
    /// The room lies where it should.
    There,
    /// It lies beside by this angle (absolute, rad), by the fault of this axis.
    Beside(AxisName, f64),
}

/// A part of the room.
struct Kept {
    eyes: [Keyframe; 2],
    /// Where the middle of the view looked, by the axes, rad: about the vertical, and up.
    towards: [f64; 2],
    /// The homing after which it was last seen in its place ...
    homing: u32,
    /// ... and after how many different ones it was, or others that were seen after the same: homed twice to the same place is no chance.
    homings: u32,
    /// When it was seen in its place last, s.
    seen_s: f64,
    /// The speed of the head when it was remembered, rad/s.
    fast_rad_s: f64,
    misses: u32,
}

/// A head and what it sees.
pub(crate) struct Look<'a> {
    pub(crate) time_s: f64,
    pub(crate) angles: HeadAngles,
    pub(crate) base_from_head: Isometry3<f64>,
    pub(crate) views: [EyeView<'a>; 2],
    /// Who is followed, in the left picture.
    pub(crate) person: Option<PixelBox>,
}

/// What is remembered of the room.
#[derive(Default)]
pub(crate) struct Bearings {
    /// The one that was seen last is the last.
    kept: Vec<Kept>,
    next: usize,
    homing: u32,
    before: Option<(f64, HeadAngles)>,
    fast_rad_s: f64,
    due_s: f64,
    wary_s: f64,
    shown: Option<[Gray; 2]>,
}

impl Bearings {
    /// Look at a pair when it is time to.
    pub(crate) fn look(&mut self, look: &Look) -> Option<Bearing> {
        self.note_speed(look);
        if look.time_s < self.due_s || self.fast_rad_s > LOOK_RAD_S {
            return None;
        }
        let is_doubtful = look.time_s < self.wary_s - WARY_S + DOUBTFUL_FOR_S;
        self.due_s = look.time_s
            + if is_doubtful {
                DOUBTFUL_EVERY_S
            } else {
                EVERY_S
            };
        if self.repeats(look) {
            return None;
        }
        let sight = Sight::new(look);
        let in_view = self.in_view(&sight);
        let placed: Vec<_> = (in_view.iter())
            .map(|at| (*at, self.placed(*at, &sight)))
            .collect();
        for (at, there) in &placed {
            if let Some(bearing) = self.one_eye(*at, &sight, *there) {
                return self.doubt(*at, bearing, look.time_s);
            }
        }
        if let Some((at, there)) =
            (placed.iter()).find(|(_, there)| there.iter().all(Option::is_some))
        {
            let is_exact = there
                .iter()
                .flatten()
                .all(|by_rad| by_rad.abs() <= OTHER_RAD);
            self.saw(*at, look.time_s);
            if is_exact {
                self.remember(&sight);
            }
            return (self.fast_rad_s <= SURE_RAD_S).then_some(Bearing::There);
        }
        if let Some(at) = in_view.first()
            && !is_doubtful
            && sight.apart(&self.kept[*at]) <= MISSED_WITHIN
        {
            self.kept[*at].misses += 1;
        }
        if let Some(bearing) = self.somewhere(&sight, !in_view.is_empty()) {
            return Some(bearing);
        }
        self.kept.retain(|kept| kept.misses < MISSES);
        self.remember(&sight);
        None
    }

    /// Whether a part of the room is in sight that should not be: those that were seen last, and another one each time. `missed` says that another should be
    /// in sight and is not. Where nothing is known of what should be, only a picture that has not changed while the axes say that they turned is a sign: two
    /// walls may look alike.
    fn somewhere(&mut self, sight: &Sight, missed: bool) -> Option<Bearing> {
        let all = self.kept.len();
        let before = all.saturating_sub(LATEST);
        let other = (before > 0 && missed).then(|| {
            self.next = (self.next + 1) % before;
            before - 1 - self.next
        });
        let share = if missed {
            ELSEWHERE_SHARE
        } else {
            UNCHANGED_SHARE
        };
        let since_s = sight.look.time_s - UNCHANGED_S;
        let (at, bearing) = (before..all)
            .rev()
            .chain(other)
            .filter(|at| missed || self.kept[*at].seen_s >= since_s)
            .find_map(|at| Some((at, self.elsewhere(at, sight, share)?)))?;
        self.doubt(at, bearing, sight.look.time_s)
    }

    /// The axes are about to be homed.
    pub(crate) fn begin_homing(&mut self) {
        self.homing += 1;
        self.before = None;
        self.fast_rad_s = 0.0;
    }

    /// The room is another one, or the head stands elsewhere.
    pub(crate) fn forget(&mut self) {
        self.kept.clear();
    }

    fn note_speed(&mut self, look: &Look) {
        let Some((before_s, before)) = self.before.replace((look.time_s, look.angles)) else {
            return;
        };
        let passed_s = (look.time_s - before_s).max(1e-3);
        let turns = look.angles.to_array().into_iter().zip(before.to_array());
        let fastest = turns
            .map(|(now, then)| (now - then).abs() / passed_s)
            .fold(0.0, f64::max);
        self.fast_rad_s = fastest.max(self.fast_rad_s * (-passed_s / FADES_S).exp());
    }

    /// Whether a camera shows what it showed at the last look.
    fn repeats(&mut self, look: &Look) -> bool {
        let now = [0, 1].map(|eye: usize| look.views[eye].pyramid.level(REPEAT_LEVEL));
        let same =
            (self.shown.as_ref()).is_some_and(|shown| (0..2).any(|eye| shown[eye] == *now[eye]));
        if !same {
            self.shown = Some(now.map(Gray::clone));
        }
        same
    }

    /// The parts of the room that lie nearest to the middle of the view, of those in it.
    fn in_view(&self, sight: &Sight) -> Vec<usize> {
        let mut in_view: Vec<(usize, f64)> = (self.kept.iter().enumerate())
            .map(|(at, kept)| (at, sight.apart(kept)))
            .filter(|(_, apart)| *apart <= IN_VIEW)
            .collect();
        in_view.sort_by(|a, b| a.1.total_cmp(&b.1));
        in_view.truncate(LOOKED_AT);
        in_view.into_iter().map(|(at, _)| at).collect()
    }

    /// By how much each eye sees it beside where it should be, rad, if about there.
    fn placed(&self, at: usize, sight: &Sight) -> [Option<f64>; 2] {
        [0, 1].map(|eye| {
            let keyframe = &self.kept[at].eyes[eye];
            let placed = keyframe.placed(&sight.upright[eye], &Vector3::y_axis());
            let is_there = placed.agreement.is_at_least(THERE.0, THERE.1);
            is_there.then_some(placed.by_rad)
        })
    }

    /// It was seen where it should be. After two homings: then the zeros are right, and were when anything else was seen in its place since the last one.
    fn saw(&mut self, at: usize, time_s: f64) {
        let mut kept = self.kept.remove(at);
        kept.seen_s = time_s;
        kept.misses = 0;
        if kept.homing != self.homing {
            kept.homing = self.homing;
            kept.homings += 1;
        }
        if kept.homings >= 2 {
            for other in self.kept.iter_mut().filter(|k| k.homing == kept.homing) {
                other.homings = other.homings.max(2);
            }
        }
        self.kept.push(kept);
        self.next = 0;
    }

    /// One eye sees it where it should be, the other beside that, by little or much.
    fn one_eye(&self, at: usize, sight: &Sight, there: [Option<f64>; 2]) -> Option<Bearing> {
        let is_right = |by: Option<f64>| by.is_some_and(|by: f64| by.abs() <= OTHER_RAD);
        let eye = match there.map(is_right) {
            [true, false] => Eye::Right,
            [false, true] => Eye::Left,
            _ => return None,
        };
        let by_rad = match there[eye as usize] {
            Some(by_rad) => by_rad,
            None => {
                let axis = sight.head_axis(Vector3::y());
                let seen = Panorama::new(&sight.look.views[eye as usize], &axis);
                let range = [-NARROW_RAD, NARROW_RAD];
                (self.turned(at, eye, &seen, &axis, range, ELSEWHERE_SHARE)?).by_rad
            }
        };
        let fast_rad_s = self.fast_rad_s + self.kept[at].fast_rad_s;
        let least_rad = LEAST_VERGENCE_RAD + PAIR_DOUBTFUL_S * fast_rad_s;
        let name = match eye {
            Eye::Left => AxisName::LeftVergence,
            Eye::Right => AxisName::RightVergence,
        };
        (by_rad.abs() >= least_rad).then_some(Bearing::Beside(name, by_rad.abs()))
    }

    /// Both eyes see it, wherever that is, but beside where it should be: about the vertical if pan has lost its zero, up or down if tilt has.
    fn elsewhere(&self, at: usize, sight: &Sight, share: f64) -> Option<Bearing> {
        let least_rad = LEAST_RAD + self.doubtful_rad(at);
        let [across, up] = sight.shares_to(&self.kept[at]);
        let beside = |name, by_rad: f64| {
            (by_rad.abs() >= least_rad).then_some(Bearing::Beside(name, by_rad.abs()))
        };
        if up <= IN_VIEW {
            let axis = Vector3::y_axis();
            let to = sight.towards[0] - self.kept[at].towards[0];
            let reach = IN_VIEW * sight.field[0];
            let range = [to - reach, to + reach];
            if let Some(by_rad) = self.both(at, &sight.upright, &axis, range, share) {
                return beside(AxisName::Pan, by_rad);
            }
        }
        if across <= IN_VIEW {
            let axis = sight.head_axis(Vector3::x());
            let seen = sight.sideways(&axis);
            let range = [-NARROW_RAD, NARROW_RAD];
            if let Some(by_rad) = self.both(at, seen, &axis, range, share) {
                return beside(AxisName::Tilt, by_rad);
            }
        }
        None
    }

    /// The one angle by which both eyes see it beside where it should be.
    fn both(
        &self,
        at: usize,
        seen: &[Panorama; 2],
        axis: &Unit<Vector3<f64>>,
        range: [f64; 2],
        share: f64,
    ) -> Option<f64> {
        let left = self.turned(at, Eye::Left, &seen[0], axis, range, share)?;
        let right = self.turned(at, Eye::Right, &seen[1], axis, range, share)?;
        let alike = (left.by_rad - right.by_rad).abs() <= ALIKE_RAD;
        alike.then_some((left.by_rad + right.by_rad) / 2.0)
    }

    /// What pictures of another time than they say explain, rad.
    fn doubtful_rad(&self, at: usize) -> f64 {
        DOUBTFUL_S * (self.fast_rad_s + self.kept[at].fast_rad_s)
    }

    fn turned(
        &self,
        at: usize,
        eye: Eye,
        seen: &Panorama,
        axis: &Unit<Vector3<f64>>,
        range: [f64; 2],
        share: f64,
    ) -> Option<Turned> {
        let keyframe = &self.kept[at].eyes[eye as usize];
        let turned = keyframe.turned(seen, axis, range)?;
        let in_picture = IN_PICTURE * f64::from(keyframe.count());
        let enough =
            turned.is_clear(ELSEWHERE, share) && f64::from(turned.agreement.visible) >= in_picture;
        enough.then_some(turned)
    }

    /// Something lies elsewhere: believed of what was seen in its place since the axes were last homed, or after two homings. Else it may as well have
    /// been remembered while the zeros were lost.
    fn doubt(&mut self, at: usize, bearing: Bearing, time_s: f64) -> Option<Bearing> {
        let kept = self.kept.remove(at);
        if kept.homing != self.homing && kept.homings < 2 {
            return None;
        }
        self.kept.push(kept);
        self.wary_s = time_s + WARY_S;
        self.due_s = time_s + DOUBTFUL_EVERY_S;
        Some(bearing)
    }

    /// Remember what is in sight, unless something like it is.
    fn remember(&mut self, sight: &Sight) {
        let is_known = (self.kept.iter()).any(|kept| sight.apart(kept) <= APART);
        if is_known || sight.look.time_s < self.wary_s {
            return;
        }
        let look = sight.look;
        let eyes = [0, 1].map(|eye: usize| Keyframe::new(&look.views[eye], look.person.as_ref()));
        if eyes.iter().any(|eye| eye.count() < LEAST_PATCHES) {
            return;
        }
        if self.kept.len() == MOST_KEPT {
            self.kept.remove(0);
        }
        self.kept.push(Kept {
            eyes,
            towards: sight.towards,
            homing: self.homing,
            homings: 1,
            seen_s: look.time_s,
            fast_rad_s: self.fast_rad_s,
            misses: 0,
        });
    }
}

/// A look with what follows from it.
struct Sight<'a> {
    look: &'a Look<'a>,
    /// Where the middle of the view looks, by the axes, rad: about the vertical, and up.
    towards: [f64; 2],
    /// The left camera's field of view, across and down, rad.
    field: [f64; 2],
    /// What both eyes see, about the vertical ...
    upright: [Panorama; 2],
    /// ... and about the axis through both lenses, when it was asked for.
    sideways: OnceCell<[Panorama; 2]>,
}

impl<'a> Sight<'a> {
    fn new(look: &'a Look<'a>) -> Self {
        let ahead = look.base_from_head.rotation * Vector3::z();
        let k = &look.views[0].camera.intrinsics;
        let field = [(k.width, k.fx), (k.height, k.fy)];
        Self {
            look,
            towards: [ahead.x.atan2(ahead.z), ahead.y.clamp(-1.0, 1.0).asin()],
            field: field.map(|(size, focal_px)| 2.0 * (size as f64 / 2.0 / focal_px).atan()),
            upright: (look.views).map(|view| Panorama::new(&view, &Vector3::y_axis())),
            sideways: OnceCell::new(),
        }
    }

    fn sideways(&self, axis: &Unit<Vector3<f64>>) -> &[Panorama; 2] {
        let laid_out = || self.look.views.map(|view| Panorama::new(&view, axis));
        self.sideways.get_or_init(laid_out)
    }

    /// How far a part of the room should be from the middle of the view, as shares of its width and height.
    fn shares_to(&self, kept: &Kept) -> [f64; 2] {
        [0, 1].map(|i| (kept.towards[i] - self.towards[i]).abs() / self.field[i])
    }

    fn apart(&self, kept: &Kept) -> f64 {
        let [across, up] = self.shares_to(kept);
        across.max(up)
    }

    fn head_axis(&self, axis: Vector3<f64>) -> Unit<Vector3<f64>> {
        Unit::new_normalize(self.look.base_from_head.rotation * axis)
    }
}
