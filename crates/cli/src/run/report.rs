//! The summary as a person reads it.

use std::fmt::Write as _;

use super::session::Outcome;
use super::statistics::{Quantiles, Spread};
use super::summary::Summary;
use vergence_capture::LiveStatistics;
use vergence_capture::live::{CameraStatistics, ClockDomain};
use vergence_servo::Rest;

pub(crate) fn text_of(outcome: &Outcome) -> String {
    let s = &outcome.summary;
    let mut out = String::new();
    let mut line = |label: &str, text: &str| {
        // A String takes every write.
        let _ = writeln!(out, "{label:<18}{text}");
    };
    line("source", &s.source);
    for remark in &s.remarks {
        line("note", remark);
    }
    line("run", &run(s));
    line("target", &target(s));
    if let Some(error) = s.vergence_error_px {
        let meaning = "px of disparity at the target while zero was asked for";
        line("vergence error", &format!("{} {meaning}", spread(&error)));
    }
    if let Some(parallax) = s.parallax_px {
        let meaning = "px of disparity of the target as shown";
        line("parallax", &format!("{} {meaning}", spread(&parallax)));
    }
    if let Some(error) = s.pointing_error_px {
        line(
            "pointing error",
            &format!("{} px from the centre", spread(&error)),
        );
    }
    if let Some(range) = &s.range_error {
        let percent = 100.0 * range.rms_relative;
        line(
            "range error",
            &format!("{:.3} m RMS, {percent:.2} % of the distance", range.rms_m),
        );
    }
    if let Some(error) = s.epipolar_error_px {
        let meaning = "px between the target's pixels and their epipolar line";
        line("calibration", &format!("{} {meaning}", spread(&error)));
    }
    if let Some(nis) = s.filter.nis_mean {
        let (updates, rejected) = (s.filter.updates, s.filter.rejected);
        line(
            "filter",
            &format!(
                "mean NIS {nis:.2} per degree of freedom (1 when consistent) over {updates} updates, {rejected} rejected"
            ),
        );
    }
    for (label, text) in s.health.iter().flat_map(super::watched::lines) {
        line(label, &text);
    }
    for change in &s.mode_changes {
        let text = format!(
            "{} → {} at {:.2} s: {}",
            change.from, change.to, change.time_s, change.reason
        );
        line("mode", &text);
    }
    for (label, text) in s.latency_ms.iter().map(|l| latency(s, l)).chain(stages(s)) {
        line(label, &text);
    }
    for (label, text) in s.cameras.iter().flat_map(cameras) {
        line(label, &text);
    }
    if let Some(rest) = &s.rest {
        line("axes", &axes(s.limit_violations, rest));
    }
    if let Some(failed) = &s.failed {
        line("failed", failed);
    }
    out
}

/// From capture to setpoint.
fn latency(s: &Summary, latency: &Quantiles) -> (&'static str, String) {
    let rendered = match s.cameras {
        Some(_) => "",
        None => " (rendering not counted)",
    };
    let text = format!(
        "{:.1} ms median, {:.1} ms p95, {:.1} ms p99, capture to setpoint{rendered}",
        latency.p50, latency.p95, latency.p99
    );
    ("latency", text)
}

/// What the loop's stages took.
fn stages(s: &Summary) -> Option<(&'static str, String)> {
    let total = s.stage_ms.get("loop")?;
    let stages: Vec<String> = (s.stage_ms.iter())
        .filter(|(name, _)| **name != "loop")
        .map(|(name, q)| format!("{name} {:.1}", q.p50))
        .collect();
    let text = format!("{:.1} ms a pair ({})", total.p50, stages.join(", "));
    Some(("loop", text))
}

/// Each live camera and what the two are to each other.
fn cameras(seen: &LiveStatistics) -> [(&'static str, String); 3] {
    let camera = |c: &CameraStatistics| {
        let counts = &c.counts;
        let mut text = format!(
            "{}: {:.2} fps, jitter p95 {:.1} ms, latency {:.1} ms (p95 {:.1}) by the {} clock",
            c.name,
            1.0 / c.period.median_s.max(1e-9),
            c.jitter.p95_s * 1e3,
            c.latency.median_s * 1e3,
            c.latency.p95_s * 1e3,
            match counts.clock {
                ClockDomain::Machine => "machine's",
                ClockDomain::Own => "stream's",
                ClockDomain::Arrival => "arrival's",
            }
        );
        for (count, what) in [
            (counts.lost, "lost"),
            (counts.torn, "torn"),
            (counts.frozen, "frozen"),
            (c.late, "late"),
            (counts.overrun, "not fetched"),
            (counts.gone, "times gone"),
            (counts.clock_jumps, "jumps of its clock"),
        ] {
            if count > 0 {
                let _ = write!(text, ", {count} {what}");
            }
        }
        text
    };
    let mut pair = format!(
        "{:.1} ms apart (p95 {:.1}, max {:.1})",
        seen.skew.median_s * 1e3,
        seen.skew.p95_s * 1e3,
        seen.skew.max_s * 1e3
    );
    if let Some(offset_s) = seen.offset_s {
        let _ = write!(
            pair,
            " beside a steady {:+.1} ms{}",
            offset_s * 1e3,
            if seen.offset_of_exposure {
                " between the exposures"
            } else {
                " between the clocks, taken out"
            }
        );
    }
    for (count, what) in [
        (seen.pairing.lost_pairs, "without a partner"),
        (seen.pairing.doubled, "doubled"),
        (seen.too_far_apart, "too far apart"),
        (seen.skipped_pairs, "passed over"),
    ] {
        if count > 0 {
            let _ = write!(pair, ", {count} {what}");
        }
    }
    [
        ("left camera", camera(&seen.left)),
        ("right camera", camera(&seen.right)),
        ("pairs", pair),
    ]
}

fn run(s: &Summary) -> String {
    let mut text = format!(
        "{} frames, {:.2} s of the run's clock, {:.1} fps",
        s.frames, s.seconds, s.fps
    );
    let pace = if s.real_time {
        "real time"
    } else {
        "as fast as it can"
    };
    let _ = write!(text, " ({pace})");
    for (count, what) in [
        (s.dropped_pairs, "pairs dropped"),
        (s.late_frames, "frames late"),
    ] {
        if count > 0 {
            let _ = write!(text, ", {count} {what}");
        }
    }
    if s.interrupted {
        text.push_str(", interrupted");
    }
    text
}

fn axes(violations: u64, rest: &Rest) -> String {
    let mut text = format!("{violations} limit violations; ");
    text.push_str(match (rest.stopped, rest.parked) {
        (true, true) => "stopped and parked",
        (true, false) => "stopped, not parked",
        _ => "NOT all stopped",
    });
    let _ = write!(text, " {:.1} s after the last setpoint", rest.seconds);
    for fault in &rest.faults {
        let _ = write!(text, "; {fault}");
    }
    text
}

fn target(s: &Summary) -> String {
    let Some(found) = s.target.found_after_s else {
        return "not found".to_owned();
    };
    let mut text = format!("found after {found:.2} s");
    if let Some(share) = s.target.tracked_fraction {
        let _ = write!(
            text,
            ", tracked in {:.1} % of the frames since",
            100.0 * share
        );
    }
    for refound in &s.target.refound_after_s {
        let _ = match refound {
            Some(seconds) => write!(text, ", seen again {seconds:.2} s after it reappeared"),
            None => write!(text, ", not seen again after it reappeared"),
        };
    }
    if s.target.ended_on_target == Some(false) {
        text.push_str(", not on the target at the end");
    }
    text
}

fn spread(s: &Spread) -> String {
    format!("{:.2} RMS, {:.2} p95, {:.2} largest,", s.rms, s.p95, s.max)
}
