//! The loop under its supervisor: what `vergence run` and the fault simulation drive.
//!
//! A [`Conductor`] owns the loop ([`Servo`]) and the supervisor, and sees to it that nothing reaches the motors that the supervisor did not allow:
//! pairs that cannot be trusted (stamped wrongly, frozen, dark) never reach the loop, errors of axes become doubts instead of ends, and the
//! drive is listened to between pairs.

mod centring;
mod sentry;
mod steady;

use vergence_capture::StereoFrame;
use vergence_control::supervisor::Decision;
use vergence_control::{
    AxisState, ControlError, ControlState, DriveEvent, Orders, RigState, Senses, Supervisor,
    SupervisorSettings,
};

use crate::error::ServoError;
use crate::rigging::Permit;
use crate::servo::Servo;
use crate::step::Step;
use centring::{Centring, is_centred};
use sentry::Sentry;
use steady::Steady;

/// The loop, its supervisor, and what they need to know of each other.
pub struct Conductor {
    servo: Servo,
    supervisor: Supervisor,
    steady: Steady,
    sentry: Sentry,
    centring: Option<Centring>,
    /// Homing was ordered, and the drive has not taken it yet.
    homing_due: bool,
    pictures_s: [Option<f64>; 2],
    /// Whether what each camera gave last showed nothing: then it lives no longer, however new its pictures are.
    blind: [bool; 2],
    following: Option<ControlState>,
    doubt: Option<String>,
    /// What the last step's pictures say of the axes' zeros, until the supervisor has heard it.
    lost_zero: Option<String>,
    events: Vec<DriveEvent>,
    refused_pairs: u64,
    /// Why the newest pair was not used.
    refusal: Option<String>,
    /// The step of the newest pair, if axes refused what followed from it.
    unfollowed: Option<Step>,
}

/// A pair that is so many times older than what makes a camera stale is not used at all.
const OLDEST_AS_STALE: f64 = 2.0;

/// So many events of the drive wait to be taken at most; the newest are kept.
const EVENTS_WAITING: usize = 256;

impl Conductor {
    /// A conductor of this loop; nothing moves before the first look.
    ///
    /// # Errors
    /// Settings of the supervisor that cannot be used.
    pub fn new(servo: Servo, settings: SupervisorSettings) -> Result<Self, ControlError> {
        Ok(Self {
            supervisor: Supervisor::new(settings)?,
            servo,
            steady: Steady::default(),
            sentry: Sentry::new(OLDEST_AS_STALE * settings.camera_stale_s),
            centring: None,
            homing_due: false,
            pictures_s: [None; 2],
            blind: [false; 2],
            following: None,
            doubt: None,
            lost_zero: None,
            unfollowed: None,
            events: Vec::new(),
            refused_pairs: 0,
            refusal: None,
        })
    }

    /// Between pairs, at least every 20 ms: listen to the drive, decide, and hold where that is due. `now_s` is the run's clock.
    pub fn look(&mut self, now_s: f64) {
        if self.servo.drive_mut().is_none() {
            return;
        }
        let Some(now_s) = self.time(now_s) else {
            return;
        };
        let orders = self.orders(now_s);
        self.obey(orders, now_s);
    }

    /// Take a pair: judge it, decide, and go through the loop with it. `None` when the pair was not used, or axes refused what follows from it
    /// ([`Self::take_unfollowed`]); [`Self::refusal`] says why.
    ///
    /// # Errors
    /// What a repetition would not mend: pictures of another size, tracking that cannot be set up. Axes that refuse are no error: they are a
    /// doubt, and the rig holds.
    pub fn take(&mut self, pair: &StereoFrame, now_s: f64) -> Result<Option<Step>, ServoError> {
        self.refusal = None;
        self.unfollowed = None;
        if self.servo.drive_mut().is_none() {
            return self.servo.step(pair, now_s).map(Some);
        }
        let Some(now_s) = self.time(now_s) else {
            self.refusal.clone_from(&self.doubt);
            return Ok(None);
        };
        let offset_s = self.steady.offset_s();
        let shifted;
        let pair = match offset_s == 0.0 {
            true => pair,
            false => {
                shifted = steady::shifted(pair, offset_s);
                &shifted
            }
        };
        self.refusal = match self.sentry.judge(pair, now_s) {
            Ok(faults) => {
                for (eye, frame) in [&pair.left, &pair.right].into_iter().enumerate() {
                    self.blind[eye] = faults[eye].is_some();
                    if faults[eye].is_none() {
                        self.pictures_s[eye] = Some(frame.capture_s);
                    }
                }
                sentry::sentence(faults)
            }
            Err(reason) => {
                self.doubt.get_or_insert_with(|| reason.clone());
                Some(reason)
            }
        };
        if self.refusal.is_some() {
            self.refused_pairs += 1;
        }
        let orders = self.orders(now_s);
        if self.refusal.is_some() || !matches!(orders, Orders::Follow | Orders::Hold) {
            self.refusal.get_or_insert_with(|| {
                let state = self.supervisor.state().name();
                format!("the rig is {state}: no pair is used")
            });
            self.obey(orders, now_s);
            return Ok(None);
        }
        self.servo.permit(match orders {
            Orders::Follow => Permit::Follow,
            _ => Permit::Hold,
        });
        match self.servo.step(pair, now_s) {
            Ok(step) => match step.refused {
                None => {
                    self.note_step(&step, now_s);
                    Ok(Some(step))
                }
                Some(error) => {
                    self.doubt_axes(&error.to_string(), now_s);
                    self.unfollowed = Some(step);
                    Ok(None)
                }
            },
            // Without positions there is no geometry.
            Err(ServoError::Axis(error)) => {
                self.doubt_axes(&error.to_string(), now_s);
                Ok(None)
            }
            Err(error) => {
                self.obey(Orders::Hold, now_s);
                Err(error)
            }
        }
    }

    /// Axes refused: what moves, stands.
    fn doubt_axes(&mut self, reason: &str, now_s: f64) {
        self.refusal = Some(reason.to_owned());
        self.doubt.get_or_insert_with(|| reason.to_owned());
        self.obey(Orders::Hold, now_s);
    }

    /// The step of the newest pair, where the loop saw it and believed it, but the axes refused what followed from it: it belongs to the record, and is no
    /// step of a rig that follows.
    pub fn take_unfollowed(&mut self) -> Option<Step> {
        self.unfollowed.take()
    }

    /// How often a picture must come again bit for bit until its camera is frozen; 0: never. Video streams repeat a scene that stands still.
    pub fn set_frozen_after(&mut self, pictures: u32) {
        self.sentry.set_frozen_after(pictures);
    }

    /// The source gave no pair, but knows when each camera gave its newest picture, s on the run's clock. A camera whose last picture in a pair was
    /// dark or frozen is not believed before a pair shows something.
    pub fn note_pictures(&mut self, newest_s: [Option<f64>; 2]) {
        for (eye, newest) in newest_s.into_iter().enumerate() {
            let known = &mut self.pictures_s[eye];
            if !self.blind[eye]
                && let Some(newest_s) = newest.map(|s| s + self.steady.offset_s())
                && known.is_none_or(|known_s| newest_s > known_s)
            {
                *known = Some(newest_s);
            }
        }
    }

    /// A person asks for homing.
    pub fn ask_home(&mut self) {
        self.supervisor.ask_home();
    }

    /// A person has looked at a fault and clears it: at the controller too.
    pub fn ask_clear(&mut self, now_s: f64) {
        let now_s = self.time(now_s).unwrap_or_else(|| self.steady.last_s());
        if let Some(drive) = self.servo.drive_mut()
            && let Err(error) = drive.clear(now_s)
        {
            let text = format!("not cleared: {error}");
            self.supervisor.memory_mut().note(now_s, text);
            return;
        }
        self.supervisor.ask_clear();
    }

    /// A person stops the rig: the axes first. Final.
    pub fn stop(&mut self, now_s: f64, reason: &str) {
        if self.servo.drive_mut().is_none() {
            return;
        }
        self.supervisor.ask_stop(reason);
        let now_s = self.time(now_s).unwrap_or_else(|| self.steady.last_s());
        let orders = self.orders(now_s);
        self.obey(orders, now_s);
    }

    /// What the rig is doing.
    pub fn state(&self) -> RigState {
        self.supervisor.state()
    }

    /// The last decisions, oldest first.
    pub fn decisions(&self) -> impl Iterator<Item = &Decision> {
        self.supervisor.memory().entries()
    }

    /// The changes of state since the last call, at most 64.
    pub fn take_changes(&mut self) -> Vec<Decision> {
        self.supervisor.memory_mut().take_changes()
    }

    /// Changes of state that nobody took in time, so far.
    pub fn forgotten_changes(&self) -> u64 {
        self.supervisor.memory().forgotten()
    }

    /// What the drive said since the last call, at most 256 events.
    pub fn take_events(&mut self) -> Vec<DriveEvent> {
        std::mem::take(&mut self.events)
    }

    /// Pairs that were not used because they could not be trusted.
    pub fn refused_pairs(&self) -> u64 {
        self.refused_pairs
    }

    /// Why the newest pair was not used; `None` when it was.
    pub fn refusal(&self) -> Option<&str> {
        self.refusal.as_deref()
    }

    /// How much later than the run's clock this conductor's times are, s: what the clock went back so far.
    pub fn offset_s(&self) -> f64 {
        self.steady.offset_s()
    }

    /// The loop.
    pub fn servo(&self) -> &Servo {
        &self.servo
    }

    /// The loop, to end it.
    pub fn servo_mut(&mut self) -> &mut Servo {
        &mut self.servo
    }

    /// `now_s` without jumps backwards; `None` when it is no number (a doubt).
    fn time(&mut self, now_s: f64) -> Option<f64> {
        match self.steady.take(now_s) {
            Ok(now_s) => Some(now_s),
            Err(steady::Odd::Back { by_s, now_s }) => {
                self.doubt
                    .get_or_insert(format!("the clock went back by {by_s:.3} s"));
                Some(now_s)
            }
            Err(steady::Odd::NotFinite) => {
                self.doubt
                    .get_or_insert("the clock shows no number".to_owned());
                None
            }
        }
    }

    /// Listen to the drive and let the supervisor decide.
    fn orders(&mut self, now_s: f64) -> Orders {
        let homing = self.supervisor.state() == RigState::Homing;
        let Some(drive) = self.servo.drive_mut() else {
            return Orders::Hold;
        };
        drive.update(now_s);
        let (link, events) = (drive.link(), drive.take_events());
        // While the drive has not taken the order to home, what it says of its zeros is from before.
        let axes = match self.homing_due {
            true => [AxisState::Unhomed; 4],
            false => drive.states(),
        };
        let centred = homing && !self.homing_due && is_centred(drive, now_s);
        let doubt = self.doubt.take();
        let lost_zero = self.lost_zero.take();
        let orders = self.supervisor.look(&Senses {
            now_s,
            pictures_s: self.pictures_s,
            link: &link,
            axes,
            events: &events,
            centred,
            following: self.following,
            lost_zero: lost_zero.as_deref(),
            doubt: doubt.as_deref(),
        });
        if orders == Orders::Home {
            self.servo.begin_homing();
        }
        self.events.extend(events);
        let excess = self.events.len().saturating_sub(EVENTS_WAITING);
        self.events.drain(..excess);
        orders
    }

    /// Do what was ordered without a pair.
    fn obey(&mut self, orders: Orders, now_s: f64) {
        let Some(drive) = self.servo.drive_mut() else {
            return;
        };
        if orders != Orders::Centre {
            self.centring = None;
        }
        if matches!(orders, Orders::Follow | Orders::Hold) {
            self.homing_due = false;
        }
        match orders {
            // Between pairs the axes go on by their last setpoints.
            Orders::Follow => {}
            Orders::Hold => {
                for answer in drive.hold(now_s) {
                    if let Err(error) = answer {
                        self.doubt.get_or_insert(error.to_string());
                    }
                }
            }
            Orders::Centre => {
                let centring = self
                    .centring
                    .get_or_insert_with(|| Centring::new(drive, now_s));
                for answer in drive.command(&centring.commands(now_s), now_s) {
                    if let Err(error) = answer {
                        self.doubt.get_or_insert(error.to_string());
                    }
                }
            }
            Orders::Home | Orders::Wait => {
                self.homing_due |= orders == Orders::Home;
                // A controller that was just cleared takes a moment; the supervisor's time for homing ends the trying.
                self.homing_due = self.homing_due && drive.home(now_s).is_err();
                if self.homing_due {
                    // What moves cannot be homed; who refuses to stand is asked again at the next look.
                    let _ = drive.hold(now_s);
                }
            }
        }
    }

    /// Keep what a step says of itself.
    fn note_step(&mut self, step: &Step, now_s: f64) {
        if let Some(lost) = &step.lost_zero {
            match lost.was_right {
                true => self.lost_zero = Some(lost.sentence()),
                // They never stood right: homing again would not mend that.
                false => self.supervisor.memory_mut().note(now_s, lost.sentence()),
            }
        }
        let Some(control) = &step.control else {
            return;
        };
        self.following = Some(control.state);
        if let Some(refused) = &control.refused {
            let text = refused.to_string();
            self.supervisor.memory_mut().note(now_s, text.clone());
            if !matches!(refused, ControlError::Estimate { .. }) {
                self.doubt.get_or_insert(text);
            }
        }
        if let Some(transition) = &control.transition {
            let text = format!("the control law: {}", transition.reason);
            self.supervisor.memory_mut().note(now_s, text);
        }
    }
}
