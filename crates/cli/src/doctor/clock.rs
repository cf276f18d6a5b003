//! The machine's clock: frames are timed by the monotonic one, recordings are named and aligned by the wall's.

use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

use super::{Check, Status};

const GROUP: &str = "clock";

/// Looked at for so long.
const WATCHED: Duration = Duration::from_millis(300);

/// A sleep that ends this much late is worth a word, s: half a period of 30 Hz leaves no time for the loop.
const LATE_S: f64 = 0.015;

/// The two clocks may go apart by this, s: 0.3 ms over the time watched is 1000 ppm, twice the most by which a clock is slewed.
const APART_S: f64 = 0.0003;

pub(crate) fn checks() -> Vec<Check> {
    vec![synchronised(), steady()]
}

fn synchronised() -> Check {
    let item = "synchronisation";
    let told = Path::new("/run/systemd/timesync/synchronized").exists();
    let daemons = [
        "/run/chrony/chronyd.pid",
        "/run/chronyd.pid",
        "/run/ntpd.pid",
        "/run/ptp4l.pid",
    ];
    let daemon = daemons.iter().find(|p| Path::new(p).exists());
    match (told, daemon) {
        (true, _) => Check::new(GROUP, item, Status::Good, "the wall clock is synchronised by systemd-timesyncd"),
        (false, Some(file)) => Check::new(GROUP, item, Status::Good, format!("a time daemon is running ({file})")),
        (false, None) => Check::new(GROUP, item, Status::Note, "nobody is seen to synchronise the wall clock: recordings of two machines cannot be aligned by it")
            .next("timedatectl set-ntp true, or install chrony; one machine alone needs neither"),
    }
}

/// Compare the monotonic with the wall's clock, and see how late a sleep ends.
fn steady() -> Check {
    let item = "steadiness";
    let (monotonic, wall) = (Instant::now(), SystemTime::now());
    let mut late_s = 0.0_f64;
    while monotonic.elapsed() < WATCHED {
        let before = Instant::now();
        std::thread::sleep(Duration::from_millis(5));
        late_s = late_s.max(before.elapsed().as_secs_f64() - 0.005);
    }
    let went_s = monotonic.elapsed().as_secs_f64();
    // A wall clock that was set back has no elapsed time at all.
    let wall_s = wall
        .elapsed()
        .map_or(f64::NEG_INFINITY, |d| d.as_secs_f64());
    let apart_s = (wall_s - went_s).abs();
    let found = format!("sleeps of 5 ms end up to {:.1} ms late", late_s * 1e3);
    if apart_s > APART_S {
        let apart = match apart_s.is_finite() {
            true => format!(
                "the wall clock went {:.1} ms apart from the monotonic one",
                apart_s * 1e3
            ),
            false => "the wall clock was set back".to_owned(),
        };
        return Check::new(GROUP, item, Status::Note, format!("{apart}; {found}"))
            .next("wait until the clock is synchronised before recording");
    }
    if late_s > LATE_S {
        return Check::new(GROUP, item, Status::Note, found)
            .next("the machine is busy: close other programs before a run");
    }
    Check::new(GROUP, item, Status::Good, found)
}
