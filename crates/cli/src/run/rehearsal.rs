//! The twin's pictures before the run: the same loop is gone through once as fast as it goes, and what was rendered on the way is kept.
//!
//! On the simulated clock the loop does the same in real time as it does without waiting, so the pictures fit. The run in real time then has the
//! machine to itself, as it has with cameras, which render nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use vergence_capture::Rehearsed;
use vergence_servo::Conductor;

use crate::fault;

use super::build::Built;
use super::feed::Feed;
use super::session;

/// Most bytes of pictures that are kept: 22 s of pairs of 1024x768 at 30 a second.
const MOST_BYTES: u64 = 3 << 30;

/// Go through the run and keep its pictures; refused when they would take too much memory.
pub(crate) fn rehearse(built: Built, stop: &Arc<AtomicBool>) -> anyhow::Result<Rehearsed> {
    let Built {
        mut feed,
        servo,
        plan,
    } = built;
    check_size(&feed, plan.seconds)?;
    let pace = session::pace(&feed);
    let mut conductor = Conductor::new(servo, pace)?;
    let mut rehearsed = Rehearsed::default();
    let mut first_s = None;
    while let Some(pair) = feed.next_pair(None)? {
        let elapsed_s = pair.capture_s() - *first_s.get_or_insert(pair.capture_s());
        let over = plan.seconds.is_some_and(|limit| elapsed_s >= limit);
        if over || stop.load(Ordering::Relaxed) {
            break;
        }
        conductor.take(&pair, session::given_s(&pair))?;
        let truth = match &feed {
            Feed::Twin(twin) => twin.truth_at(pair.index),
            Feed::Files(_) | Feed::Live(_) => None,
        };
        if let Some(truth) = truth {
            rehearsed.push(*truth, [pair.left.picture, pair.right.picture]);
        }
    }
    Ok(rehearsed)
}

fn check_size(feed: &Feed, seconds: Option<f64>) -> anyhow::Result<()> {
    let info = feed.info();
    let wanted = seconds.map(|s| (s * info.fps).ceil() as u64 + 1);
    let pairs = match (wanted, info.pairs) {
        (Some(a), Some(b)) => a.min(b),
        (a, b) => a.or(b).unwrap_or(u64::MAX),
    };
    let pair: u64 = (info.cameras.iter())
        .map(|c| (c.intrinsics.width * c.intrinsics.height * size_of::<[u8; 3]>()) as u64)
        .sum();
    if pairs.saturating_mul(pair) <= MOST_BYTES {
        return Ok(());
    }
    let most_s = (MOST_BYTES / pair.max(1)) as f64 / info.fps;
    Err(fault::usage(format!(
        "--rehearse would keep {pairs} pairs in memory, {:.1} GB; {:.1} GB are allowed",
        pairs as f64 * pair as f64 * 1e-9,
        MOST_BYTES as f64 * 1e-9
    ))
    .hint(format!("give --seconds, up to {:.0}s", most_s.floor()))
    .into())
}

/// The run again, with the pictures of its rehearsal.
pub(crate) fn with_pictures(mut built: Built, rehearsed: Rehearsed) -> Built {
    if let Feed::Twin(twin) = built.feed {
        built.feed = Feed::Twin(Box::new(twin.with_rehearsed(rehearsed)));
    }
    built.plan.rehearsed = true;
    built
}
