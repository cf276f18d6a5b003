//! Where the walker is at every moment: named paths, waypoints, smooth motion between them.

use std::path::Path as FilePath;
use std::str::FromStr;

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::error::SceneError;

/// Longest file of waypoints that is read, bytes.
pub const MAX_FILE_BYTES: u64 = 1 << 20;
/// Most waypoints of one path.
pub const MAX_WAYPOINTS: usize = 10_000;
/// Longest path, s.
pub const MAX_DURATION_S: f64 = 3600.0;
/// Fastest walk between two waypoints, m/s. The figure walks; at this speed it takes three steps a second, and whoever is faster
/// runs.
pub const MAX_SPEED_M_S: f64 = 2.0;

/// Farthest from the rig that a waypoint may name, m: the room ends long before.
const MAX_PLACE_M: f64 = 1000.0;

/// Half of the time over which a change of speed or direction is spread, s: a walker stops within twice this.
pub const BLEND_S: f64 = 0.5;

/// The body's vertical axis stands this far behind the visible chest, m: the named paths speak of the chest.
const CHEST_DEPTH_M: f64 = 0.12;

/// A place to be at a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Waypoint {
    /// When, s from the start; rises from waypoint to waypoint.
    pub time_s: f64,
    /// To the right in the base frame, m.
    pub x_m: f64,
    /// Forward in the base frame, m.
    pub z_m: f64,
}

/// Which way the person goes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PathSpec {
    /// From 10 m to 1 m straight towards the rig at 1 m/s.
    #[default]
    Walk,
    /// Across the picture and back at 3 to 4.5 m.
    Cross,
    /// Towards the rig from 9 m to 2 m in slants of 1.2 m to either side.
    Zigzag,
    /// Towards the rig from 9 m to 1.6 m with four stops.
    StopAndGo,
    /// Across at 5 m and back, twice behind a pillar at 3.6 m.
    Occlude,
    /// Towards the rig from 8 m while a second person crosses in front at 3 m.
    Two,
    /// Nobody: the room alone.
    Empty,
    /// Along waypoints; see [`parse_waypoints`].
    Waypoints(Vec<Waypoint>),
}

impl PathSpec {
    /// Name as typed: `walk`, `stop-and-go`, ...; `waypoints` for a list of them.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Walk => "walk",
            Self::Cross => "cross",
            Self::Zigzag => "zigzag",
            Self::StopAndGo => "stop-and-go",
            Self::Occlude => "occlude",
            Self::Two => "two",
            Self::Empty => "empty",
            Self::Waypoints(_) => "waypoints",
        }
    }

    /// All paths that have a name, in the order of the documentation.
    pub const NAMED: [PathSpec; 7] = [
        Self::Walk,
        Self::Cross,
        Self::Zigzag,
        Self::StopAndGo,
        Self::Occlude,
        Self::Two,
        Self::Empty,
    ];

    /// Waypoints of the first person (empty for [`PathSpec::Empty`]), moved sideways by `shift_m`.
    pub(crate) fn first_person(&self, shift_m: f64) -> Vec<Waypoint> {
        let d = CHEST_DEPTH_M;
        match self {
            Self::Walk => at_speed(1.0, &[(shift_m, 10.0 + d), (0.3 * shift_m, 1.0 + d)]),
            Self::Cross => at_speed(
                1.1,
                &[
                    (-1.3 + shift_m, 4.5),
                    (2.1, 4.5),
                    (-2.1, 3.7),
                    (2.1 + shift_m, 3.0),
                ],
            ),
            Self::Zigzag => at_speed(
                1.1,
                &[
                    (shift_m, 9.0 + d),
                    (1.2, 7.6),
                    (-1.2, 6.2),
                    (1.1, 4.8),
                    (-0.9, 3.5),
                    (0.5 + shift_m, 2.4),
                    (0.0, 2.0 + d),
                ],
            ),
            Self::StopAndGo => stop_and_go(shift_m),
            Self::Occlude => at_speed(
                1.0,
                &[(-1.4 + shift_m, 5.2), (2.1, 5.2), (-1.4 + shift_m, 4.9)],
            ),
            Self::Two => at_speed(0.8, &[(0.4 + shift_m, 8.0 + d), (shift_m, 2.2 + d)]),
            Self::Empty => Vec::new(),
            Self::Waypoints(list) => list.clone(),
        }
    }

    /// Waypoints of the second person, where there is one.
    pub(crate) fn second_person(&self, shift_m: f64) -> Option<Vec<Waypoint>> {
        let z = 3.1 + shift_m;
        (*self == Self::Two).then(|| {
            let mut list = at_speed(1.2, &[(-2.4, z), (2.4, z)]);
            list.iter_mut().for_each(|w| w.time_s += 2.0);
            list.insert(
                0,
                Waypoint {
                    time_s: 0.0,
                    ..list[0]
                },
            );
            list
        })
    }
}

/// Waypoints reached at one speed, from time 0.
fn at_speed(speed_m_s: f64, places: &[(f64, f64)]) -> Vec<Waypoint> {
    let mut time_s = 0.0;
    let mut last = places[0];
    places
        .iter()
        .map(|&(x_m, z_m)| {
            time_s += (x_m - last.0).hypot(z_m - last.1) / speed_m_s;
            last = (x_m, z_m);
            Waypoint { time_s, x_m, z_m }
        })
        .collect()
}

fn stop_and_go(shift_m: f64) -> Vec<Waypoint> {
    const SPEED_M_S: f64 = 1.1;
    const PAUSE_S: f64 = 1.4;
    let mut list: Vec<Waypoint> = Vec::new();
    let mut time_s = 0.0;
    for (i, z) in [9.0, 7.0, 5.2, 3.6, 2.4, 1.6].into_iter().enumerate() {
        let (x_m, z_m) = (shift_m * (1.0 - 0.15 * i as f64), z + CHEST_DEPTH_M);
        if let Some(last) = list.last().copied() {
            time_s += (x_m - last.x_m).hypot(z_m - last.z_m) / SPEED_M_S;
        }
        list.push(Waypoint { time_s, x_m, z_m });
        if (1..5).contains(&i) {
            time_s += PAUSE_S;
            list.push(Waypoint { time_s, x_m, z_m });
        }
    }
    list
}

impl FromStr for PathSpec {
    type Err = SceneError;

    fn from_str(name: &str) -> Result<Self, SceneError> {
        Self::NAMED
            .into_iter()
            .find(|p| p.name() == name)
            .ok_or_else(|| SceneError::UnknownPath {
                name: name.to_owned(),
            })
    }
}

/// Waypoints from a file; see [`parse_waypoints`].
pub fn read_waypoints(path: &FilePath) -> Result<Vec<Waypoint>, SceneError> {
    use std::io::Read as _;
    let io = |source| SceneError::Io {
        source,
        path: path.to_owned(),
    };
    let mut bytes = Vec::new();
    std::fs::File::open(path)
        .map_err(io)?
        .take(MAX_FILE_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    waypoints_from_bytes(bytes).map_err(|fault| SceneError::File {
        fault: Box::new(fault),
        path: path.to_owned(),
    })
}

fn waypoints_from_bytes(bytes: Vec<u8>) -> Result<Vec<Waypoint>, SceneError> {
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(refused(
            1,
            format!("the file is longer than {MAX_FILE_BYTES} bytes"),
        ));
    }
    let text = String::from_utf8(bytes)
        .map_err(|_| refused(1, "the file is not UTF-8 text".to_owned()))?;
    parse_waypoints(&text)
}

/// Waypoints from text: comma-separated lines below a header that is `time_s,x_m,z_m` (when to be where) or
/// `x_m,z_m,speed_m_s` (where to go, and how fast to go there from the place before; the first speed is not used).
///
/// Empty lines and lines that begin with `#` are skipped, and so is a byte order mark, which spreadsheets write. At least two and at most [`MAX_WAYPOINTS`] lines, times
/// from 0 that rise, speeds above 0 and at most [`MAX_SPEED_M_S`], at most [`MAX_DURATION_S`] in all.
pub fn parse_waypoints(text: &str) -> Result<Vec<Waypoint>, SceneError> {
    let mut lines = text
        .trim_start_matches('\u{feff}')
        .lines()
        .enumerate()
        .map(|(i, l)| (i + 1, l.trim()))
        .filter(|(_, l)| !l.is_empty() && !l.starts_with('#'));
    let (line, header) = lines
        .next()
        .ok_or_else(|| refused(1, "the file is empty".to_owned()))?;
    let columns: Vec<&str> = header.split(',').map(str::trim).collect();
    let by_time = match columns.as_slice() {
        ["time_s", "x_m", "z_m"] => true,
        ["x_m", "z_m", "speed_m_s"] => false,
        _ => {
            return Err(refused(
                line,
                "the header must be \"time_s,x_m,z_m\" or \"x_m,z_m,speed_m_s\"".to_owned(),
            ));
        }
    };
    let mut list: Vec<Waypoint> = Vec::new();
    for (line, text) in lines {
        if list.len() == MAX_WAYPOINTS {
            return Err(refused(
                line,
                format!("more than {MAX_WAYPOINTS} waypoints"),
            ));
        }
        let [a, b, c] = three_numbers(line, text)?;
        let next = if by_time {
            Waypoint {
                time_s: a,
                x_m: b,
                z_m: c,
            }
        } else {
            timed(line, list.last(), [a, b, c])?
        };
        list.push(next);
        check_newest(line, &list)?;
    }
    if list.len() < 2 {
        return Err(refused(
            line,
            "at least two waypoints are needed".to_owned(),
        ));
    }
    Ok(list)
}

fn refused(line: usize, reason: String) -> SceneError {
    SceneError::Waypoints { line, reason }
}

fn three_numbers(line: usize, text: &str) -> Result<[f64; 3], SceneError> {
    let numbers: Vec<f64> = text
        .split(',')
        .map(|s| s.trim().parse::<f64>().unwrap_or(f64::NAN))
        .collect();
    match numbers.as_slice() {
        &[a, b, c] if [a, b, c].iter().all(|v| v.is_finite()) => Ok([a, b, c]),
        _ => Err(refused(
            line,
            format!(
                "\"{}\" is not three numbers with commas between them",
                text.chars().take(60).collect::<String>()
            ),
        )),
    }
}

fn timed(
    line: usize,
    last: Option<&Waypoint>,
    [x_m, z_m, speed]: [f64; 3],
) -> Result<Waypoint, SceneError> {
    let Some(last) = last else {
        return Ok(Waypoint {
            time_s: 0.0,
            x_m,
            z_m,
        });
    };
    if !(speed > 0.0 && speed <= MAX_SPEED_M_S) {
        let speed = if speed.abs() < 1e6 {
            speed.to_string()
        } else {
            format!("{speed:e}")
        };
        return Err(refused(
            line,
            format!("a speed of {speed} m/s; it must be above 0 and at most {MAX_SPEED_M_S} m/s"),
        ));
    }
    let way_m = (x_m - last.x_m).hypot(z_m - last.z_m);
    if way_m == 0.0 {
        return Err(refused(
            line,
            "the place is that of the line before; use times to let the walker wait".to_owned(),
        ));
    }
    Ok(Waypoint {
        time_s: last.time_s + way_m / speed,
        x_m,
        z_m,
    })
}

/// The newest of `list` against the one before it.
fn check_newest(line: usize, list: &[Waypoint]) -> Result<(), SceneError> {
    let new = list[list.len() - 1];
    if ![new.time_s, new.x_m, new.z_m].iter().all(|v| v.is_finite()) {
        return Err(refused(line, "a number that is not finite".to_owned()));
    }
    if let Some(far_m) = [new.x_m, new.z_m]
        .into_iter()
        .find(|v| v.abs() > MAX_PLACE_M)
    {
        return Err(refused(
            line,
            format!("a place {far_m:e} m away; at most {MAX_PLACE_M} m"),
        ));
    }
    if new.time_s.abs() > MAX_DURATION_S {
        return Err(refused(
            line,
            format!(
                "time {:e} s; a path lasts at most {MAX_DURATION_S} s",
                new.time_s
            ),
        ));
    }
    if list.len() == 1 {
        return if new.time_s == 0.0 {
            Ok(())
        } else {
            Err(refused(
                line,
                format!("the first time is {} s; it must be 0", new.time_s),
            ))
        };
    }
    let last = list[list.len() - 2];
    let step_s = new.time_s - last.time_s;
    if step_s <= 0.0 {
        return Err(refused(
            line,
            format!(
                "time {} s does not come after {} s",
                new.time_s, last.time_s
            ),
        ));
    }
    let speed = (new.x_m - last.x_m).hypot(new.z_m - last.z_m) / step_s;
    if speed > MAX_SPEED_M_S * (1.0 + 1e-9) {
        let speed = if speed < 1e6 {
            format!("{speed:.2}")
        } else {
            format!("{speed:.0e}")
        };
        return Err(refused(
            line,
            format!("the walker would need {speed} m/s; at most {MAX_SPEED_M_S} m/s"),
        ));
    }
    Ok(())
}

/// Checks a list of waypoints as [`parse_waypoints`] does, with the number of the waypoint for the line.
pub fn check_waypoints(list: &[Waypoint]) -> Result<(), SceneError> {
    if list.len() < 2 {
        return Err(refused(
            list.len().max(1),
            "at least two waypoints are needed".to_owned(),
        ));
    }
    if list.len() > MAX_WAYPOINTS {
        return Err(refused(
            MAX_WAYPOINTS + 1,
            format!("more than {MAX_WAYPOINTS} waypoints"),
        ));
    }
    (1..=list.len()).try_for_each(|n| check_newest(n, &list[..n]))
}

/// Where somebody walks, and how, at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stride {
    /// Place of the body's axis on the floor, (x, z) in the base frame, m.
    pub place: Vector2<f64>,
    /// Its velocity, m/s.
    pub velocity: Vector2<f64>,
    /// Direction that the body faces, rad: 0 along z (away from the rig), + towards x.
    pub heading: f64,
    /// Phase of the gait, in cycles of two steps; an integer when the left heel strikes.
    pub cycle: f64,
    /// Speed along the way, m/s.
    pub speed: f64,
}

/// Smooth motion along waypoints.
///
/// The straight, constant-speed legs between waypoints are convolved with a triangle of +-[`BLEND_S`], so that
/// velocity and acceleration are continuous: with L the broken line and B its second antiderivative,
/// `p(t) = (B(t + b) - 2 B(t) + B(t - b)) / b²`, and likewise velocity and acceleration from the antiderivatives
/// below it. Corners are cut on the inside. Before the start the first leg is continued backwards (whoever walks at
/// the start has walked before); after the end the walker stands.
#[derive(Clone, Debug)]
pub struct Trajectory {
    knots: Vec<Knot>,
    duration_s: f64,
    /// Heading and gait cycle at every [`TABLE_STEP_S`] from time 0.
    table: Vec<(f64, f64)>,
}

#[derive(Clone, Copy, Debug)]
struct Knot {
    time_s: f64,
    place: Vector2<f64>,
    velocity: Vector2<f64>,
    /// First and second antiderivative of the place up to this knot.
    first: Vector2<f64>,
    second: Vector2<f64>,
}

/// Spacing of the heading table, s. Fine enough that linear interpolation of a turn is good to 1e-5 rad.
const TABLE_STEP_S: f64 = 0.005;
/// A turn is spread over twice this, s.
const TURN_S: f64 = 0.45;
/// Below this speed the direction of walking is not defined, m/s.
const STANDING_M_S: f64 = 0.08;

impl Trajectory {
    /// Motion along waypoints that passed [`check_waypoints`]; `phase` is the gait's cycle at the start.
    pub(crate) fn new(waypoints: &[Waypoint], phase: f64) -> Self {
        let place = |w: &Waypoint| Vector2::new(w.x_m, w.z_m);
        let mut knots: Vec<Knot> = Vec::with_capacity(waypoints.len() + 1);
        for (i, w) in waypoints.iter().enumerate() {
            let velocity = waypoints.get(i + 1).map_or(Vector2::zeros(), |n| {
                (place(n) - place(w)) / (n.time_s - w.time_s)
            });
            let (first, second) = knots.last().map_or_else(
                || (Vector2::zeros(), Vector2::zeros()),
                |k| k.antiderivatives(w.time_s),
            );
            knots.push(Knot {
                time_s: w.time_s,
                place: place(w),
                velocity,
                first,
                second,
            });
        }
        let mut new = Self {
            duration_s: knots.last().map_or(0.0, |k| k.time_s) + BLEND_S,
            knots,
            table: Vec::new(),
        };
        new.table = new.heading_and_cycle(phase);
        new
    }

    /// When the walker has come to rest at the last waypoint, s.
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// Place, velocity and acceleration of the body's axis, (x, z) in the base frame.
    pub fn motion(&self, t: f64) -> [Vector2<f64>; 3] {
        let b = BLEND_S;
        let [hi, mid, lo] = [t + b, t, t - b].map(|t| {
            let k = self.knot(t);
            let (first, second) = k.antiderivatives(t);
            [second, first, k.place + k.velocity * (t - k.time_s)]
        });
        std::array::from_fn(|i| (hi[i] - 2.0 * mid[i] + lo[i]) / (b * b))
    }

    /// Everything that the figure needs at a time.
    pub fn at(&self, t: f64) -> Stride {
        let [place, velocity, _] = self.motion(t);
        let x = (t / TABLE_STEP_S).clamp(0.0, (self.table.len() - 1) as f64);
        let i = (x as usize).min(self.table.len().saturating_sub(2));
        let f = x - i as f64;
        let (a, b) = (self.table[i], self.table[(i + 1).min(self.table.len() - 1)]);
        let speed = velocity.norm();
        // Before the table the gait runs on backwards at the speed of the start.
        let before = t.min(0.0) * cycles_per_s(speed);
        Stride {
            place,
            velocity,
            heading: a.0 + f * (b.0 - a.0),
            cycle: a.1 + f * (b.1 - a.1) + before,
            speed,
        }
    }

    /// The knot whose leg holds at time t; the first leg also holds before it.
    fn knot(&self, t: f64) -> &Knot {
        let i = self.knots.partition_point(|k| k.time_s <= t);
        &self.knots[i.saturating_sub(1)]
    }

    fn heading_and_cycle(&self, phase: f64) -> Vec<(f64, f64)> {
        let n = ((self.duration_s + TURN_S) / TABLE_STEP_S).ceil() as usize + 1;
        let margin = (TURN_S / TABLE_STEP_S) as usize;
        let velocities: Vec<Vector2<f64>> = (0..n + 2 * margin)
            .map(|i| self.motion((i as f64 - margin as f64) * TABLE_STEP_S)[1])
            .collect();
        let facing = unwrapped_directions(&velocities);
        // Hann window: smooth, and without overshoot.
        let window: Vec<f64> = (0..=2 * margin)
            .map(|j| {
                1.0 - (std::f64::consts::TAU * (j as f64 + 0.5) / (2 * margin + 1) as f64).cos()
            })
            .collect();
        let total: f64 = window.iter().sum();
        let mut cycle = phase;
        (0..n)
            .map(|i| {
                let heading = facing[i..]
                    .iter()
                    .zip(&window)
                    .map(|(a, w)| a * w)
                    .sum::<f64>()
                    / total;
                if i > 0 {
                    let mean =
                        (velocities[i + margin].norm() + velocities[i + margin - 1].norm()) / 2.0;
                    cycle += cycles_per_s(mean) * TABLE_STEP_S;
                }
                (heading, cycle)
            })
            .collect()
    }
}

impl Knot {
    fn antiderivatives(&self, t: f64) -> (Vector2<f64>, Vector2<f64>) {
        let d = t - self.time_s;
        (
            self.first + self.place * d + self.velocity * (d * d / 2.0),
            self.second
                + self.first * d
                + self.place * (d * d / 2.0)
                + self.velocity * (d * d * d / 6.0),
        )
    }
}

/// Length of one step at a walking speed, m. Linear about the usual 0.65 m at 1 m/s (adults lengthen and quicken
/// their steps in about equal parts); approximate. Above 1.12 m/s only the cadence grows.
pub fn step_length_m(speed_m_s: f64) -> f64 {
    0.35 + 0.30 * speed_m_s.min(LONGEST_STEP_AT_M_S)
}

/// From this speed on the steps grow no longer, m/s: the figure's legs, 0.86 m, would not reach the ground at both ends of a longer
/// one with the pelvis as high as it is.
const LONGEST_STEP_AT_M_S: f64 = 1.12;

/// Gait cycles (two steps each) per second at a speed.
fn cycles_per_s(speed_m_s: f64) -> f64 {
    speed_m_s / (2.0 * step_length_m(speed_m_s))
}

/// Direction of each velocity, without jumps of a full turn; where somebody stands, the direction before it
/// (or, at the start, the first one after it; towards the rig when there is none).
fn unwrapped_directions(velocities: &[Vector2<f64>]) -> Vec<f64> {
    use std::f64::consts::{PI, TAU};
    let direction = |v: &Vector2<f64>| (v.norm() > STANDING_M_S).then(|| v.x.atan2(v.y));
    let mut last = velocities.iter().find_map(direction).unwrap_or(PI);
    velocities
        .iter()
        .map(|v| {
            if let Some(d) = direction(v) {
                let mut turn = (d - last).rem_euclid(TAU);
                // Half turns go by way of the rig's side: people turn towards what they look at.
                let towards_rig = last.sin() > 0.0;
                if turn > PI + 0.5 || (turn > PI - 0.5 && !towards_rig) {
                    turn -= TAU;
                }
                last += turn;
            }
            last
        })
        .collect()
}
