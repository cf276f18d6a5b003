//! Does the room still lie where the axes say? A motor without an encoder that misses steps says nothing of it; what the cameras saw before does.
//!
//! While the head does not turn fast, views of the room are remembered with the directions in which they were seen ([`Keyframe`]). A picture that shows one of
//! them elsewhere was taken by a head that stands otherwise than its counters say: in both cameras by the same angle, then pan or tilt has lost its
//! zero; in one of them, then its vergence axis has. Pairs whose eyes are swapped lie beside by opposite angles and say nothing, and so does a camera that
//! repeats its picture. Nothing is found before the same part of the room was in sight twice.

use std::cell::OnceCell;
use std::f64::consts::PI;

use nalgebra::{Isometry3, Unit, Vector3};
use vergence_control::AxisName;
use vergence_geometry::{Eye, HeadAngles};
use vergence_imaging::Gray;
use vergence_track::{EyeView, Keyframe, Panorama, PixelBox, Placed, Turned};

/// Time between two looks, s ...
const EVERY_S: f64 = 0.35;

/// ... and for a while after something seemed to be wrong.
const DOUBTFUL_EVERY_S: f64 = 0.12;
const DOUBTFUL_FOR_S: f64 = 1.0;

/// Views that are remembered; the one that was not seen for longest makes room.
const MOST_KEPT: usize = 48;

/// A new view is remembered where none is that lies within this share of the picture's width and height.
const APART: f64 = 0.2;

/// A view whose middle lies within this share of the picture from the picture's middle is in it, and is looked for where it should be, ...
const IN_PICTURE: f64 = 0.5;

/// ... of so many such the nearest ones.
const LOOKED_AT: usize = 3;

/// One that lies beyond this share of the picture can be elsewhere only with a picture that has not changed.
const NEIGHBOUR: f64 = 1.0;

/// Patches that a view must have, in each eye.
const LEAST_PATCHES: u32 = 7;

/// A view is about where it should be when so many patches are, and this share of those in the picture, ...
const THERE: (u32, f64) = (4, 0.25);

/// ... beside that when so many are, and elsewhere when so many, and this share, are there together, ...
const ELSEWHERE: u32 = 6;
const ELSEWHERE_SHARE: f64 = 0.45;

/// ... or this share, of a view that should not be in the picture: two walls may look alike. If no other is known that should be, it must have been
/// in its place so short a time ago, s: a picture that does not change while the axes say that they turned.
const UNCHANGED_SHARE: f64 = 0.75;
const UNCHANGED_S: f64 = 3.0;

/// So much of it must be in the picture there.
const LEAST_VISIBLE: f64 = 0.4;

/// What both eyes see must lie beside by the same angle, columns of a [`Panorama`] (0.9° for a lens that sees 31°) ...
const ALIKE: f64 = 2.6;

/// ... of at least so many to be pan's or tilt's fault (1.7°): more than is about its place, ...
const LEAST: f64 = vergence_track::keyframe::NEAR as f64 + 1.0;

/// ... and by one eye alone at least so many (0.5°), ...
const LEAST_VERGENCE: f64 = 1.5;

/// ... where the other one sees it in its place by no more than this beside (0.26°).
const EXACT: f64 = 0.75;

/// Beside that so long a turn of the head: pictures may be of another time than they say, s, ...
const DOUBTFUL_S: f64 = 0.15;

/// ... and those of a pair of times that differ by so much, s: of a torn picture a part is of the frame before.
const PAIR_DOUBTFUL_S: f64 = 0.07;

/// And what a lens has moved sideways since, seen from so far away, m.
const NEAREST_M: f64 = 1.5;

/// Slower than this a look that finds nothing wrong says that nothing is, rad/s (10°/s).
const SURE_RAD_S: f64 = 10.0 * PI / 180.0;

/// For so long an axis may lose its way before that is noticed, s.
const UNNOTICED_S: f64 = 0.5;

/// After something was found beside nothing new is remembered for so long, s.
const WARY_S: f64 = 3.0;

/// Views whose right eye was corrected otherwise by more than this are forgotten, rad (0.1°): they were remembered with another camera's pose.
const CORRECTED_RAD: f64 = 0.1 * PI / 180.0;

/// The speed of the head fades from memory within this time, s.
const FADES_S: f64 = 0.3;

/// Faster than this nothing is looked at, rad/s (30°/s).
const LOOK_RAD_S: f64 = 30.0 * PI / 180.0;

/// So many of the views that were seen last are looked for when nothing is where it should be.
const LATEST: usize = 3;

/// A single eye, and tilt, are searched for this far to both sides, rad (20°).
const NARROW_RAD: f64 = 20.0 * PI / 180.0;

/// A view that lies within this share of the picture should be found ...
const MISSED_WITHIN: f64 = 0.25;

/// ... and one that was not found where it should be so often, nor elsewhere, is forgotten: the room has changed.
const MISSES: u32 = 10;

/// A person seems so much wider, as a share of the picture's width to each side: where the right eye sees them is not known.
const WIDER: f64 = 0.04;

/// Level of the pyramids by which it is seen that a camera repeats its picture.
const REPEAT_LEVEL: usize = 2;

/// What a look says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Bearing {
    /// The room lies where it should.
    There,
    /// It lies beside by this angle (with a sign, rad), by the fault of this axis.
    Beside(AxisName, f64),
}

/// A view of the room.
struct Kept {
    eyes: [Keyframe; 2],
    /// Where its middle looked, by the axes, rad: about the vertical, and down.
    towards: [f64; 2],
    /// Where the lenses were, and what lay ahead, in base.
    lenses: [Vector3<f64>; 2],
    ahead: Vector3<f64>,
    /// What was corrected of the right camera, rad.
    right_offset_rad: f64,
    /// The homing after which it was last seen in its place ...
    last_homing: u32,
    /// ... and of how many it says the same, by itself or with others that were seen in their places: homed twice to the same place is no chance.
    agreed: u32,
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
    /// What is corrected of the right camera, rad.
    pub(crate) right_offset_rad: f64,
    /// Who is followed, in the left picture, ...
    pub(crate) person: Option<PixelBox>,
    /// ... and what else moves.
    pub(crate) movers: &'a [PixelBox],
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
    /// When something was found beside last, s.
    doubted_s: Option<f64>,
    shown: Option<[Gray; 2]>,
}

impl Bearings {
    /// Look at a pair when it is time to.
    pub(crate) fn look(&mut self, look: &Look) -> Option<Bearing> {
        self.note_speed(look);
        if look.time_s < self.due_s || self.fast_rad_s > LOOK_RAD_S {
            return None;
        }
        let is_doubtful = self.was_doubtful(DOUBTFUL_FOR_S, look.time_s);
        let every_s = if is_doubtful {
            DOUBTFUL_EVERY_S
        } else {
            EVERY_S
        };
        self.due_s = look.time_s + every_s;
        if self.repeats(look) {
            return None;
        }
        let corrected = |kept: &Kept| (kept.right_offset_rad - look.right_offset_rad).abs();
        self.kept.retain(|kept| corrected(kept) <= CORRECTED_RAD);

        let sight = Sight::new(look);
        let in_picture = self.in_picture(&sight);
        let placed: Vec<_> = (in_picture.iter())
            .map(|at| (*at, self.placed(*at, &sight)))
            .collect();
        let exact = (placed.iter()).find(|(_, there)| sight.is_exact(*there));
        let beside =
            (placed.iter()).find_map(|(at, there)| Some((*at, self.one_eye(*at, &sight, *there)?)));
        match (exact, beside) {
            (Some((at, _)), None) => {
                self.saw(*at, look.time_s);
                self.remember(&sight);
                // A turning head shows less of what is wrong.
                return (self.fast_rad_s <= SURE_RAD_S).then_some(Bearing::There);
            }
            // Views that contradict each other say nothing, and the one that says that something is wrong is forgotten if it goes on.
            (Some(_), Some((at, _))) => {
                self.kept[at].misses += 1;
                self.kept.retain(|kept| kept.misses < MISSES);
                return None;
            }
            (None, Some((at, bearing))) => return self.believed_or_forgotten(at, bearing, look),
            (None, None) => {}
        }
        if let Some((at, bearing)) = self.somewhere(&sight, &in_picture) {
            return self.believed_or_forgotten(at, bearing, look);
        }
        // About its place in both eyes, if not exactly: no sign of anything.
        if placed
            .iter()
            .any(|(_, there)| there.iter().all(Option::is_some))
        {
            return None;
        }
        if let Some(at) = in_picture.first()
            && !is_doubtful
            && sight.apart(&self.kept[*at]) <= MISSED_WITHIN
        {
            self.kept[*at].misses += 1;
        }
        self.kept.retain(|kept| kept.misses < MISSES);
        self.remember(&sight);
        None
    }

    /// The angle by which pan or tilt has lost its zero at least, rad, where a look says `by_rad`: a view that was remembered while the head turned may be beside
    /// itself, to either side, if the axis was losing its way then. Looks for all views, which takes its time.
    pub(crate) fn at_least(&self, look: &Look, axis: AxisName, by_rad: f64) -> f64 {
        let sight = Sight::new(look);
        let views = (0..self.kept.len()).filter(|at| sight.apart(&self.kept[*at]) <= NEIGHBOUR);
        let sure = views.filter_map(|at| match self.elsewhere(at, &sight, ELSEWHERE_SHARE)? {
            Bearing::Beside(name, rad) if name == axis && rad * by_rad > 0.0 => {
                Some(rad.abs() - UNNOTICED_S * self.kept[at].fast_rad_s)
            }
            _ => None,
        });
        let least_rad = LEAST * sight.step_rad();
        sure.fold(least_rad, f64::max).min(by_rad.abs())
    }

    /// The axes are about to be homed, or have lost their zeros by their own word.
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

    /// Whether something was found beside no longer ago than this.
    fn was_doubtful(&self, for_s: f64, now_s: f64) -> bool {
        self.doubted_s
            .is_some_and(|doubted_s| now_s < doubted_s + for_s)
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

    /// The views that should be in the picture and lie nearest to its middle.
    fn in_picture(&self, sight: &Sight) -> Vec<usize> {
        let mut near: Vec<(usize, f64)> = (self.kept.iter().enumerate())
            .map(|(at, kept)| (at, sight.apart(kept)))
            .filter(|(_, apart)| *apart <= IN_PICTURE)
            .collect();
        near.sort_by(|a, b| a.1.total_cmp(&b.1));
        near.truncate(LOOKED_AT);
        near.into_iter().map(|(at, _)| at).collect()
    }

    /// By how much each eye sees a view beside where it should be, rad, if about there.
    fn placed(&self, at: usize, sight: &Sight) -> [Option<Placed>; 2] {
        [0, 1].map(|eye| {
            let placed = self.kept[at].eyes[eye].placed(&sight.upright[eye]);
            let is_there = placed.agreement.is_at_least(THERE.0, THERE.1);
            is_there.then_some(placed)
        })
    }

    /// A view was seen where it should be. If two homings agree on that the zeros are right, and were when others were seen in their places since the last.
    fn saw(&mut self, at: usize, time_s: f64) {
        let mut kept = self.kept.remove(at);
        kept.seen_s = time_s;
        kept.misses = 0;
        if kept.last_homing != self.homing {
            kept.last_homing = self.homing;
            kept.agreed += 1;
        }
        if kept.agreed >= 2 {
            let since = self.kept.iter_mut();
            for other in since.filter(|other| other.last_homing == kept.last_homing) {
                other.agreed = other.agreed.max(2);
            }
        }
        self.kept.push(kept);
        self.next = 0;
    }

    /// One eye sees a view exactly where it should be, the other beside that, by little or much.
    fn one_eye(&self, at: usize, sight: &Sight, there: [Option<Placed>; 2]) -> Option<Bearing> {
        let is_exact = |placed: Option<Placed>| placed.is_some_and(|p| sight.is_exactly(p.by_rad));
        let eye = match there.map(is_exact) {
            [true, false] => Eye::Right,
            [false, true] => Eye::Left,
            _ => return None,
        };
        let by_rad = match there[eye as usize] {
            // About the vertical, while the eye turns about an axis that leans with the head.
            Some(placed) if placed.agreement.found >= ELSEWHERE => {
                placed.by_rad * sight.towards[1].cos()
            }
            Some(_) => return None,
            None => {
                let axis = sight.head_axis(Vector3::y());
                let seen = Panorama::new(&sight.look.views[eye as usize], &axis, &[]);
                let range = [-NARROW_RAD, NARROW_RAD];
                (self.turned(at, eye, &seen, range, ELSEWHERE_SHARE)?).by_rad
            }
        };
        let name = match eye {
            Eye::Left => AxisName::LeftVergence,
            Eye::Right => AxisName::RightVergence,
        };
        let least_rad = LEAST_VERGENCE * sight.step_rad()
            + self.moved_rad(at, sight)
            + PAIR_DOUBTFUL_S * (self.fast_rad_s + self.kept[at].fast_rad_s);
        (by_rad.abs() >= least_rad).then_some(Bearing::Beside(name, by_rad))
    }

    /// A view that is seen where it should not be, by both eyes: those that should be in the picture and are not where they should be, those that were seen
    /// last, and another one each time.
    fn somewhere(&mut self, sight: &Sight, in_picture: &[usize]) -> Option<(usize, Bearing)> {
        let all = self.kept.len();
        let before = all.saturating_sub(LATEST);
        let other = (before > 0).then(|| {
            self.next = (self.next + 1) % before;
            before - 1 - self.next
        });
        let missed = in_picture.iter().copied();
        let found = missed.clone().find_map(|at| {
            let bearing = self.elsewhere(at, sight, ELSEWHERE_SHARE)?;
            Some((at, bearing))
        });
        let since_s = sight.look.time_s - UNCHANGED_S;
        let can_be = |at: &usize| {
            let kept = &self.kept[*at];
            match in_picture.is_empty() {
                true => kept.seen_s >= since_s,
                false => !in_picture.contains(at) && sight.apart(kept) <= NEIGHBOUR,
            }
        };
        found.or_else(|| {
            (before..all)
                .rev()
                .chain(other)
                .filter(can_be)
                .find_map(|at| {
                    let bearing = self.elsewhere(at, sight, UNCHANGED_SHARE)?;
                    Some((at, bearing))
                })
        })
    }

    /// Both eyes see a view, wherever that is, but beside where it should be: about the vertical if pan has lost its zero, up or down if tilt has.
    fn elsewhere(&self, at: usize, sight: &Sight, share: f64) -> Option<Bearing> {
        let kept = &self.kept[at];
        let least_rad = LEAST * sight.step_rad()
            + self.moved_rad(at, sight)
            + DOUBTFUL_S * (self.fast_rad_s + kept.fast_rad_s);
        let beside = |name, by_rad: f64| {
            (by_rad.abs() >= least_rad).then_some(Bearing::Beside(name, by_rad))
        };
        let [across, up] = sight.shares_to(kept);
        if up <= IN_PICTURE {
            let to = sight.towards[0] - kept.towards[0];
            let reach = IN_PICTURE * sight.field[0];
            if let Some(by_rad) = self.both(at, sight.empty(), [to - reach, to + reach], share) {
                return beside(AxisName::Pan, by_rad);
            }
        }
        if across <= IN_PICTURE
            && let Some(by_rad) = self.both(at, sight.sideways(), [-NARROW_RAD, NARROW_RAD], share)
        {
            return beside(AxisName::Tilt, by_rad);
        }
        None
    }

    /// The one angle by which both eyes see a view beside where it should be.
    fn both(&self, at: usize, seen: &[Panorama; 2], range: [f64; 2], share: f64) -> Option<f64> {
        let left = self.turned(at, Eye::Left, &seen[0], range, share)?;
        let right = self.turned(at, Eye::Right, &seen[1], range, share)?;
        let alike = (left.by_rad - right.by_rad).abs() <= ALIKE * seen[0].step_rad();
        alike.then_some((left.by_rad + right.by_rad) / 2.0)
    }

    fn turned(
        &self,
        at: usize,
        eye: Eye,
        seen: &Panorama,
        range: [f64; 2],
        share: f64,
    ) -> Option<Turned> {
        let keyframe = &self.kept[at].eyes[eye as usize];
        let turned = keyframe.turned(seen, range)?;
        let least = LEAST_VISIBLE * f64::from(keyframe.count());
        let is_found = turned.is_clear(ELSEWHERE, share);
        (is_found && f64::from(turned.agreement.visible) >= least).then_some(turned)
    }

    /// By how much a view may lie beside because the lenses have moved sideways since, rad.
    fn moved_rad(&self, at: usize, sight: &Sight) -> f64 {
        let kept = &self.kept[at];
        let ahead = (kept.ahead + sight.ahead).normalize();
        let sideways = kept
            .lenses
            .iter()
            .zip(&sight.look.views)
            .map(|(then, view)| {
                let way = view.lens().coords - then;
                (way - ahead * way.dot(&ahead)).norm()
            });
        sideways.fold(0.0, f64::max) / NEAREST_M
    }

    /// A view lies beside. That is believed of what was seen in its place since the axes were last homed, or of what two homings agreed on. Else it may as well
    /// have been remembered while a zero was lost, and is forgotten.
    fn believed_or_forgotten(
        &mut self,
        at: usize,
        bearing: Bearing,
        look: &Look,
    ) -> Option<Bearing> {
        let kept = self.kept.remove(at);
        if kept.last_homing != self.homing && kept.agreed < 2 {
            return None;
        }
        self.kept.push(kept);
        self.doubted_s = Some(look.time_s);
        self.due_s = look.time_s + DOUBTFUL_EVERY_S;
        Some(bearing)
    }

    /// Remember what is in sight, unless something like it is.
    fn remember(&mut self, sight: &Sight) {
        let look = sight.look;
        let is_known = (self.kept.iter()).any(|kept| sight.apart(kept) <= APART);
        if is_known || self.was_doubtful(WARY_S, look.time_s) {
            return;
        }
        let eyes =
            [0, 1].map(|eye: usize| Keyframe::new(&look.views[eye], &sight.boxes(eye, true)));
        if eyes.iter().any(|eye| eye.count() < LEAST_PATCHES) {
            return;
        }
        if self.kept.len() == MOST_KEPT {
            self.kept.remove(0);
        }
        self.kept.push(Kept {
            eyes,
            towards: sight.towards,
            lenses: look.views.map(|view| view.lens().coords),
            ahead: sight.ahead,
            right_offset_rad: look.right_offset_rad,
            last_homing: self.homing,
            agreed: 1,
            seen_s: look.time_s,
            fast_rad_s: self.fast_rad_s,
            misses: 0,
        });
    }
}

/// A look with what follows from it.
struct Sight<'a> {
    look: &'a Look<'a>,
    /// What lies ahead of the head, in base ...
    ahead: Vector3<f64>,
    /// ... by its angles, rad: about the vertical, and down.
    towards: [f64; 2],
    /// The left camera's field of view, across and down, rad.
    field: [f64; 2],
    /// What both eyes see, about the vertical, ...
    upright: [Panorama; 2],
    /// ... the same without people, who seem to go with a head that follows them, ...
    empty: OnceCell<[Panorama; 2]>,
    /// ... and that about the axis through both lenses.
    sideways: OnceCell<[Panorama; 2]>,
}

impl<'a> Sight<'a> {
    fn new(look: &'a Look<'a>) -> Self {
        let ahead = look.base_from_head.rotation * Vector3::z();
        let k = &look.views[0].camera.intrinsics;
        let field = [(k.width, k.fx), (k.height, k.fy)];
        let axis = Vector3::y_axis();
        let upright = look.views.map(|view| Panorama::new(&view, &axis, &[]));
        Self {
            look,
            ahead,
            towards: [ahead.x.atan2(ahead.z), ahead.y.clamp(-1.0, 1.0).asin()],
            field: field.map(|(size, focal_px)| 2.0 * (size as f64 / 2.0 / focal_px).atan()),
            upright,
            empty: OnceCell::new(),
            sideways: OnceCell::new(),
        }
    }

    /// The angle between two columns, rad.
    fn step_rad(&self) -> f64 {
        self.upright[0].step_rad()
    }

    fn is_exactly(&self, by_rad: f64) -> bool {
        by_rad.abs() <= EXACT * self.step_rad()
    }

    /// Whether both eyes see a view exactly where it should be.
    fn is_exact(&self, there: [Option<Placed>; 2]) -> bool {
        there
            .iter()
            .all(|placed| placed.is_some_and(|p| self.is_exactly(p.by_rad)))
    }

    fn empty(&self) -> &[Panorama; 2] {
        let axis = Vector3::y_axis();
        self.empty.get_or_init(|| self.without_people(&axis))
    }

    fn sideways(&self) -> &[Panorama; 2] {
        let axis = self.head_axis(Vector3::x());
        self.sideways.get_or_init(|| self.without_people(&axis))
    }

    fn without_people(&self, axis: &Unit<Vector3<f64>>) -> [Panorama; 2] {
        let laid_out = |eye: usize| {
            let person = self.boxes(eye, false);
            Panorama::new(&self.look.views[eye], axis, &person)
        };
        [0, 1].map(laid_out)
    }

    /// Columns of an eye's picture that show who is followed, and whatever else moves.
    fn boxes(&self, eye: usize, movers: bool) -> Vec<PixelBox> {
        let widths = self
            .look
            .views
            .map(|view| view.camera.intrinsics.width as f64);
        let scale = widths[eye] / widths[0];
        let wider = |person: &PixelBox| PixelBox {
            x: person.x * scale - WIDER * widths[eye],
            w: person.w * scale + 2.0 * WIDER * widths[eye],
            ..*person
        };
        let movers = if movers { self.look.movers } else { &[] };
        (self.look.person.iter()).chain(movers).map(wider).collect()
    }

    fn head_axis(&self, axis: Vector3<f64>) -> Unit<Vector3<f64>> {
        Unit::new_normalize(self.look.base_from_head.rotation * axis)
    }

    /// How far a view should be from the middle of the picture, as shares of its width and height ...
    fn shares_to(&self, kept: &Kept) -> [f64; 2] {
        [0, 1].map(|i| (kept.towards[i] - self.towards[i]).abs() / self.field[i])
    }

    /// ... and the larger of the two.
    fn apart(&self, kept: &Kept) -> f64 {
        let [across, down] = self.shares_to(kept);
        across.max(down)
    }
}

#[cfg(test)]
mod tests;
