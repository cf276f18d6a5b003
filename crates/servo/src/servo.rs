//! One step of the loop after another.

use nalgebra::{Isometry3, Matrix2, Vector2, Vector3};
use vergence_capture::{SourceInfo, StereoFrame};
use vergence_control::{AxisState, ControlOutput, Drive, TargetEstimate as ControlTarget};
use vergence_geometry::{Camera, Eye};
use vergence_imaging::Gray;
use vergence_imaging::colour::luma_from_rgb_into;
use vergence_imaging::pyramid::Pyramid;
use vergence_stereo::measure::{self, MatchSettings, Matcher, Region};
use vergence_track::filter::{FilterSettings, Sight, TargetEstimate, Update};
use vergence_track::{
    EyeView, FollowSettings, FollowState, Follower, PixelBox, Prior, RangeNote, Report, Sighting,
    SightingKind, TwoViewSettings, TwoViewTracker,
};

use crate::bearings::Look;
use crate::error::ServoError;
use crate::prior::prior_from_estimate;
use crate::rigging::{Permit, Rigging, Stance};
use crate::spoilt::{self, Spoilt};
use crate::stages::{Stage, StageTimes};
use crate::step::{Measured, Step};
use crate::target::{Place, Target};
use crate::watch::{HealthNote, Watch, WatchSettings};
use crate::wide::{is_wide, look};
use crate::zeros::{LostZero, Zeros};

/// Levels of the pyramids: 64 x 48 pixels at the top of 1024 x 768.
const LEVELS: usize = 5;

/// Least width and height of a picture: the pyramid's top has 4 x 4 pixels then.
const LEAST_SIDE_PX: usize = 64;

/// Settings of the loop.
#[derive(Clone, Debug, Default)]
pub struct ServoSettings {
    /// How the target is found and followed.
    pub follow: FollowSettings,
    /// A box around the target in the first left picture; it is found by its motion otherwise.
    pub target: Option<PixelBox>,
    /// How its motion is filtered.
    pub filter: FilterSettings,
    /// How its disparity is measured.
    pub matching: MatchSettings,
    /// How the rig's health is watched. Cameras far apart are not: points of one are not found in the other.
    pub watch: WatchSettings,
}

/// The loop: owns the buffers and the state of every stage.
pub struct Servo {
    cameras: [Camera; 2],
    rigging: Rigging,
    pictures: [Pictures; 2],
    follower: Follower,
    /// Whether the target was given, and is nobody to be let go.
    is_given: bool,
    matcher: Matcher,
    relief_m: f64,
    target: Target,
    watch: Watch,
    zeros: Zeros,
    homings: u64,
    /// Set when the cameras stand too wide for patches of one to be found in the other.
    wide: Option<TwoViewTracker>,
    wide_state: FollowState,
    spoilt: Option<Spoilt>,
}

/// Grey picture and pyramid of one eye, kept between steps.
struct Pictures {
    luma: Gray,
    pyramid: Pyramid,
}

impl Servo {
    /// A loop on the cameras of a source, carried by `rigging`.
    pub fn new(
        info: &SourceInfo,
        rigging: Rigging,
        settings: &ServoSettings,
    ) -> Result<Self, ServoError> {
        match (&rigging, &info.fixed_base_from_cam) {
            (Rigging::Motors(_), Some(_)) => {
                return Err(ServoError::Rigging(
                    "the source says that its cameras do not move, but motors were given",
                ));
            }
            (Rigging::Fixed(_), None) => {
                return Err(ServoError::Rigging(
                    "the source's cameras are moved by motors, but none were given",
                ));
            }
            _ => {}
        }
        for (camera, eye) in info.cameras.iter().zip(["left", "right"]) {
            let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
            if width < LEAST_SIDE_PX || height < LEAST_SIDE_PX {
                return Err(ServoError::PictureTooSmall { eye, width, height });
            }
        }
        let follower = match settings.target {
            Some(target) => Follower::with_target(settings.follow, target),
            None => Follower::new(settings.follow),
        };
        let wide = match &rigging {
            Rigging::Fixed(poses) if is_wide(poses) => {
                if settings.target.is_some() {
                    return Err(ServoError::Rigging(
                        "a target's box in the left picture cannot be carried over to a right picture taken from so far aside",
                    ));
                }
                Some(TwoViewTracker::new(TwoViewSettings::default()))
            }
            _ => None,
        };
        let mut filter = settings.filter;
        if wide.is_some() {
            // A room's frame: nothing forbids a target beside or behind the line between the cameras.
            filter.nearest_z_m = None;
        }
        Ok(Self {
            wide,
            wide_state: FollowState::Searching,
            cameras: info.cameras,
            rigging,
            pictures: info.cameras.map(|c| Pictures::of(&c)),
            follower,
            is_given: settings.target.is_some(),
            relief_m: settings.matching.relief_m,
            matcher: Matcher::new(settings.matching),
            target: Target::new(filter, settings.follow.coast_s)?,
            watch: Watch::new(info.cameras, settings.watch),
            zeros: Zeros::new(&settings.watch),
            homings: 0,
            spoilt: None,
        })
    }

    /// Everything that follows from one pair. `now_s` is the time at which the setpoints are given, on the clock of the
    /// pair's times: not before its arrival and never decreasing. Axes that refuse what follows are no error: the step says so.
    pub fn step(&mut self, pair: &StereoFrame, now_s: f64) -> Result<Step, ServoError> {
        self.check_sizes(pair)?;
        let mut times = StageTimes::default();
        times.timed(Stage::Pictures, || self.take_pictures(pair));
        let mut stance = self.rigging.stance_at(pair)?;
        let capture_s = pair.capture_s();
        self.target.begin(capture_s);

        if self.wide.is_some() {
            return self.step_wide(pair, &stance, now_s, times);
        }
        let health = times.timed(Stage::Health, || self.watch_rig(pair, &mut stance));
        let mut report = times.timed(Stage::Track, || self.follow(&stance, pair))?;
        if report.state == FollowState::Searching {
            self.target.forget();
        }
        let measured = times.timed(Stage::Measure, || self.range(&stance, pair, &mut report));
        let (update, estimate, aim, control) = times.timed(Stage::Control, || {
            self.target
                .put_on_probation(report.sighting.as_ref(), self.follower.probation());
            let update = report
                .sighting
                .as_ref()
                .and_then(|s| self.believe(&stance, s, measured.as_ref(), capture_s));
            let estimate = self.target.at(capture_s);
            let estimate = estimate.map(|e| self.rigging.honest(e));
            let mut aim = self.target.at(now_s);
            spoilt::aim(self.spoilt, &mut aim);
            // What was seen was seen, whether the axes take what follows from it or not.
            let control = match self.drive(&stance, aim.as_ref(), now_s) {
                Err(ServoError::Axis(error)) => (None, Some(error)),
                control => (control?, None),
            };
            Ok::<_, ServoError>((update, estimate, aim, control))
        })?;
        let (control, refused) = control;
        let lost_zero = times.timed(Stage::Health, || match refused {
            None => self.look_at_zeros(capture_s, &report, &stance),
            Some(_) => None,
        });
        Ok(Step {
            index: pair.index,
            capture_s,
            arrival_s: pair.arrival_s(),
            command_s: now_s,
            angles: stance.angles,
            base_from_cam: stance.base_from_cam,
            state: report.state,
            reason: report.reason,
            sighting: report.sighting,
            expected: report.expected,
            measured: measured.map(|m| m.result),
            update,
            estimate,
            aim,
            mode_change: control.as_ref().and_then(|c| c.mode_change.clone()),
            control,
            refused,
            homings: self.homings,
            health,
            lost_zero,
            times,
        })
    }

    /// The distance of what the follower saw, if that can be the target; else the sighting is taken out of `report`, and what the follower learned from it.
    fn range(
        &mut self,
        stance: &Stance,
        pair: &StereoFrame,
        report: &mut Report,
    ) -> Option<Measurement> {
        let capture_s = pair.capture_s();
        let Some(sighting) = report.sighting else {
            if !self.is_given && self.target.is_blank() {
                self.let_go(report);
            }
            return None;
        };
        let (measured, note) = self.measure(stance, &sighting, pair);
        let place = measured.as_ref().map(|m| self.place(stance, m));
        if !self.is_given && self.target.stays_blank(place.as_ref(), capture_s) {
            self.let_go(report);
            return None;
        }
        let anchor = &sighting.anchor_px;
        let moves = report.movers.iter().any(|mover| mover.contains(anchor));
        if (self.target).can_be(sighting.kind, place.as_ref(), moves, capture_s) {
            if let Some(note) = note {
                self.follower.note_range(note);
            }
            return measured;
        }
        self.follower.disown();
        report.sighting = None;
        report.state = match self.follower.state() {
            FollowState::Searching => {
                self.target.forget();
                FollowState::Searching
            }
            _ => FollowState::Occluded,
        };
        None
    }

    /// What was followed is nobody: whoever moves is looked for.
    fn let_go(&mut self, report: &mut Report) {
        self.follower.release();
        self.target.forget();
        report.sighting = None;
        report.expected = None;
        report.state = FollowState::Searching;
    }

    /// Take the answer of an earlier look at the rig when it is due, give the next pair when that is, and correct where the right camera stands.
    fn watch_rig(&mut self, pair: &StereoFrame, stance: &mut Stance) -> Option<HealthNote> {
        let capture_s = pair.capture_s();
        let note = match self.watch.is_answer_due(capture_s) {
            true => self.watch.answer(Some(capture_s)),
            false => None,
        };
        if self.watch.is_look_due(capture_s) {
            let pictures = [&self.pictures[0].luma, &self.pictures[1].luma];
            self.watch.look(capture_s, pictures, &stance.base_from_cam);
        }
        stance.base_from_cam = self.watch.corrected(capture_s, &stance.base_from_cam);
        if let Rigging::Motors(motors) = &mut self.rigging {
            motors.set_right_offset(self.watch.right_offset_rad(capture_s));
        }
        note
    }

    /// Whether the pictures say that axes have lost their zeros: after the setpoints, which do not wait for it. Cameras that do not move, and axes
    /// that have no zeros by their own word, are not asked about.
    fn look_at_zeros(
        &mut self,
        capture_s: f64,
        report: &Report,
        stance: &Stance,
    ) -> Option<LostZero> {
        let Rigging::Motors(motors) = &mut self.rigging else {
            return None;
        };
        let states = motors.drive_mut().states();
        if states.contains(&AxisState::Unhomed) {
            // Whoever homes them now, from a panel of their own as well.
            self.zeros.begin_homing();
        }
        if !(states.iter()).all(|s| matches!(s, AxisState::Ready | AxisState::Held)) {
            return None;
        }
        let look = Look {
            time_s: capture_s,
            angles: stance.angles,
            base_from_head: stance.base_from_head,
            views: Eye::BOTH.map(|eye| view(&self.pictures, &self.cameras, stance, eye)),
            right_offset_rad: self.watch.right_offset_rad(capture_s),
            person: report.sighting.map(|sighting| sighting.body),
            movers: &report.movers,
        };
        self.zeros.look(&look)
    }

    /// The axes are about to be homed: what the pictures said of their zeros, and what was corrected of the right one, counts no more.
    pub fn begin_homing(&mut self) {
        self.note_homings(self.homings.saturating_add(1));
    }

    /// The same, in a replay of a run in which that has been so often by now.
    pub fn note_homings(&mut self, homings: u64) {
        if homings > self.homings {
            self.homings = homings;
            self.zeros.begin_homing();
            self.watch.begin_anew();
        }
    }

    /// Take the answer of the look at the rig's health that is under way, if any: after the last step.
    pub fn last_look(&mut self) -> Option<HealthNote> {
        self.watch.answer(None)
    }

    /// The same for two cameras far apart, which stand still.
    fn step_wide(
        &mut self,
        pair: &StereoFrame,
        stance: &Stance,
        now_s: f64,
        mut times: StageTimes,
    ) -> Result<Step, ServoError> {
        let capture_s = pair.capture_s();
        let views = Eye::BOTH.map(|eye| view(&self.pictures, &self.cameras, stance, eye));
        let Some(tracker) = &mut self.wide else {
            return Err(ServoError::Rigging("no tracker for cameras far apart"));
        };
        let before = self.wide_state;
        let sight = times.timed(Stage::Track, || {
            look(tracker, views, &self.cameras, pair, before)
        })?;
        self.wide_state = sight.state;
        if matches!(sight.state, FollowState::Searching | FollowState::Lost) {
            self.target.forget();
        }
        let (update, estimate, aim) = times.timed(Stage::Control, || {
            if sight
                .sighting
                .is_some_and(|s| s.kind == SightingKind::Found)
            {
                self.target.forget();
            }
            let place = sight.place();
            let update = sight
                .observation
                .and_then(|seen| self.target.observe(seen.time_s, seen.sight, place.as_ref()));
            (update, self.target.at(capture_s), self.target.at(now_s))
        });
        Ok(Step {
            index: pair.index,
            capture_s,
            arrival_s: pair.arrival_s(),
            command_s: now_s,
            angles: stance.angles,
            base_from_cam: stance.base_from_cam,
            state: sight.state,
            reason: sight.reason,
            sighting: sight.sighting,
            expected: None,
            measured: sight.measured,
            update,
            estimate,
            aim,
            control: None,
            mode_change: None,
            health: None,
            lost_zero: None,
            refused: None,
            homings: self.homings,
            times,
        })
    }

    /// The cameras, left and right.
    pub fn cameras(&self) -> &[Camera; 2] {
        &self.cameras
    }

    /// What turns the cameras; `None` for cameras that do not move.
    pub fn drive_mut(&mut self) -> Option<&mut dyn Drive> {
        match &mut self.rigging {
            Rigging::Motors(motors) => Some(motors.drive_mut()),
            Rigging::Fixed(_) => None,
        }
    }

    /// Whether the setpoints of the coming steps may reach the axes.
    pub fn permit(&mut self, permit: Permit) {
        if let Rigging::Motors(motors) = &mut self.rigging {
            motors.permit(permit);
        }
    }

    /// Stop all motors within their limits.
    pub fn hold(&mut self, now_s: f64) -> Result<(), ServoError> {
        if let Rigging::Motors(motors) = &mut self.rigging {
            motors.hold(now_s)?;
        }
        Ok(())
    }

    /// From now on this is not a number; for simulations of faults.
    #[doc(hidden)]
    pub fn spoil(&mut self, spoilt: Option<Spoilt>) {
        self.spoilt = spoilt;
    }

    fn check_sizes(&self, pair: &StereoFrame) -> Result<(), ServoError> {
        for (eye, name) in Eye::BOTH.into_iter().zip(["left", "right"]) {
            let picture = &pair.of(eye).picture;
            let k = &self.cameras[eye as usize].intrinsics;
            if picture.size() != (k.width, k.height) {
                return Err(ServoError::PictureSize {
                    index: pair.index,
                    eye: name,
                    got_w: picture.width(),
                    got_h: picture.height(),
                    want_w: k.width,
                    want_h: k.height,
                });
            }
        }
        Ok(())
    }

    fn take_pictures(&mut self, pair: &StereoFrame) {
        for eye in Eye::BOTH {
            let pictures = &mut self.pictures[eye as usize];
            luma_from_rgb_into(&pair.of(eye).picture, &mut pictures.luma);
            pictures.pyramid.update(&pictures.luma);
        }
    }

    fn follow(&mut self, stance: &Stance, pair: &StereoFrame) -> Result<Report, ServoError> {
        let capture_s = pair.capture_s();
        let prior = self.prior(stance, capture_s);
        let mut right = view(&self.pictures, &self.cameras, stance, Eye::Right);
        // The left lens stays where it is: what stands still is told by it.
        let between_s = pair.of(Eye::Right).capture_s - pair.of(Eye::Left).capture_s;
        if let Some(velocity) = self.velocity(capture_s) {
            right.base_from_cam.translation.vector -= velocity * between_s;
        }
        let seen = vergence_track::Observation {
            left: view(&self.pictures, &self.cameras, stance, Eye::Left),
            right: Some(right),
            time_s: capture_s,
        };
        Ok(self.follower.step(&seen, prior.as_ref())?)
    }

    /// The target's velocity as far as it is known, m/s: over its last step, or of the moment.
    fn velocity(&self, capture_s: f64) -> Option<Vector3<f64>> {
        let expected = self.target.at(capture_s)?;
        Some(self.target.pace().unwrap_or(expected.velocity_in_base))
    }

    /// Where the filter expects the target in the left picture.
    fn prior(&self, stance: &Stance, capture_s: f64) -> Option<Prior> {
        let estimate = self.target.at(capture_s)?;
        prior_from_estimate(&estimate, &self.cameras[0], &stance.base_from_cam[0])
    }

    fn measure(
        &mut self,
        stance: &Stance,
        sighting: &Sighting,
        pair: &StereoFrame,
    ) -> (Option<Measurement>, Option<RangeNote>) {
        let capture_s = pair.capture_s();
        let prior = self.depth_prior(stance, sighting, capture_s);
        let poses = self.poses_for_a_moving_target(stance, pair);
        let views = [0, 1].map(|eye| measure::View {
            pyramid: &self.pictures[eye].pyramid,
            camera: &self.cameras[eye],
            base_from_cam: &poses[eye],
        });
        let region = Region {
            centre_px: sighting.anchor_px,
            width_px: sighting.torso.w,
            height_px: sighting.torso.h,
        };
        let report = self.matcher.measure(&views, &region, prior.as_ref());
        let nearer_fraction = report.nearer_fraction(prior.as_ref(), self.relief_m);
        let mut found = report.outcome.ok();
        spoilt::measurement(self.spoilt, &mut found);
        let note =
            distance_of(found.as_ref(), prior.as_ref()).map(|(distance_m, sigma_m)| RangeNote {
                distance_m,
                sigma_m,
                nearer_fraction,
            });
        (found.and_then(|f| measurement(stance, sighting, &f)), note)
    }

    /// Poses from which a target that stood still would look as the moving one does in two pictures of slightly different times: each
    /// lens is moved against the target's way since the pair's time. Else the way between the exposures would count as disparity.
    fn poses_for_a_moving_target(
        &self,
        stance: &Stance,
        pair: &StereoFrame,
    ) -> [Isometry3<f64>; 2] {
        let mut poses = stance.base_from_cam;
        let Some(velocity) = self.velocity(pair.capture_s()) else {
            return poses;
        };
        for eye in Eye::BOTH {
            let later_s = pair.of(eye).capture_s - pair.capture_s();
            poses[eye as usize].translation.vector -= velocity * later_s;
        }
        poses
    }

    /// What is known of the target's inverse depth in the left camera before the pair is looked at: the filter's prediction,
    /// or the follower's own coarse range when the filter has none.
    fn depth_prior(
        &self,
        stance: &Stance,
        sighting: &Sighting,
        capture_s: f64,
    ) -> Option<measure::Prior> {
        let left = &stance.base_from_cam[0];
        if let Some(estimate) = self.target.at(capture_s)
            && sighting.kind == SightingKind::Followed
        {
            let depth = (left.inverse() * estimate.position_in_base).z;
            let sigma_m = estimate.position_covariance().trace().max(0.0).sqrt();
            if depth > 0.1 {
                return Some(measure::Prior {
                    inverse_depth_per_m: 1.0 / depth,
                    sigma_per_m: sigma_m / (depth * depth),
                });
            }
        }
        sighting.distance_m.map(|distance| measure::Prior {
            inverse_depth_per_m: 1.0 / distance,
            // The follower's coarse range is good to about half a pixel of a quarter-size picture.
            sigma_per_m: 2.0 / (self.cameras[0].intrinsics.fx * self.interaxial_m(stance)),
        })
    }

    fn interaxial_m(&self, stance: &Stance) -> f64 {
        let [l, r] = &stance.base_from_cam;
        (r.translation.vector - l.translation.vector).norm()
    }

    /// Give the filter what was seen: with range where there is one, the direction alone elsewhere.
    fn believe(
        &mut self,
        stance: &Stance,
        sighting: &Sighting,
        measured: Option<&Measurement>,
        capture_s: f64,
    ) -> Option<Update> {
        if sighting.kind == SightingKind::Found {
            self.target.forget();
        }
        let sight = match measured {
            Some(measurement) => measurement.sight,
            None => self.direction(stance, sighting)?,
        };
        let place = measured.map(|m| self.place(stance, m));
        self.target.observe(capture_s, sight, place.as_ref())
    }

    fn place(&self, stance: &Stance, measured: &Measurement) -> Place {
        let point_in_base = measured.result.point_in_base;
        let distance_m = point_in_base.coords.norm();
        let px_m = self.cameras[0].intrinsics.fx * self.interaxial_m(stance);
        Place {
            point_in_base,
            sigma_m: measured.result.sigma_px * distance_m * distance_m / px_m,
        }
    }

    fn direction(&self, stance: &Stance, sighting: &Sighting) -> Option<Sight> {
        let ray = self.cameras[0].ray(&sighting.anchor_px)?;
        let ray = stance
            .base_from_head
            .inverse_transform_vector(&stance.base_from_cam[0].transform_vector(&ray));
        let sigma = sighting.anchor_sigma_px / self.cameras[0].intrinsics.fx;
        (ray.z > 0.0).then(|| Sight::Direction {
            base_from_head: stance.base_from_head,
            value: Vector2::new(ray.x / ray.z, ray.y / ray.z),
            covariance: Matrix2::identity() * sigma * sigma,
        })
    }

    fn drive(
        &mut self,
        stance: &Stance,
        aim: Option<&TargetEstimate>,
        now_s: f64,
    ) -> Result<Option<ControlOutput>, ServoError> {
        let (Rigging::Motors(motors), Some(readings)) = (&mut self.rigging, &stance.readings)
        else {
            return Ok(None);
        };
        let target = aim.map(|aim| ControlTarget {
            time_s: aim.time_s,
            seen_s: aim.time_s - aim.unseen_s,
            position_in_base: aim.position_in_base,
            velocity_in_base: aim.velocity_in_base,
            covariance: aim.covariance,
        });
        motors.follow(target.as_ref(), readings, now_s).map(Some)
    }
}

/// Distance from the left lens with its deviation: as measured, or as expected where nothing was (then only the share of nearer
/// surfaces is news).
fn distance_of(
    found: Option<&measure::Measurement>,
    prior: Option<&measure::Prior>,
) -> Option<(f64, f64)> {
    match (found, prior) {
        (Some(m), _) => {
            let distance_m = m.distance_m();
            let relative = m.inverse_depth_sigma_per_m / m.inverse_depth_per_m;
            Some((distance_m, relative * distance_m))
        }
        (None, Some(p)) => {
            let distance_m = 1.0 / p.inverse_depth_per_m;
            Some((distance_m, p.sigma_per_m * distance_m * distance_m))
        }
        (None, None) => None,
    }
}

fn view<'a>(
    pictures: &'a [Pictures; 2],
    cameras: &'a [Camera; 2],
    stance: &Stance,
    eye: Eye,
) -> EyeView<'a> {
    EyeView {
        pyramid: &pictures[eye as usize].pyramid,
        camera: &cameras[eye as usize],
        base_from_cam: stance.base_from_cam[eye as usize],
    }
}

/// What the filter and the step take of a measurement; `None` behind the head.
fn measurement(
    stance: &Stance,
    sighting: &Sighting,
    found: &measure::Measurement,
) -> Option<Measurement> {
    let (value, covariance) = found.in_head(&stance.base_from_head, sighting.anchor_sigma_px)?;
    Some(Measurement {
        sight: Sight::Stereo {
            base_from_head: stance.base_from_head,
            value,
            covariance,
        },
        result: Measured {
            left_px: found.left_px,
            right_px: found.right_px,
            disparity_px: found.disparity_px,
            sigma_px: found.sigma_px,
            point_in_base: found.point_in_base,
            patches: [found.inliers, found.total],
        },
    })
}

struct Measurement {
    sight: Sight,
    result: Measured,
}

impl Pictures {
    fn of(camera: &Camera) -> Self {
        let luma = Gray::filled(camera.intrinsics.width, camera.intrinsics.height, 0);
        Self {
            pyramid: Pyramid::new(&luma, LEVELS),
            luma,
        }
    }
}
