//! Pictures of live cameras that made no pair, or a pair that was not passed on: counted where they come, told to the recording once a second.

use vergence_capture::LiveStatistics;

/// Time between two looks at the counts, s.
const EVERY_S: f64 = 1.0;

/// What has been told so far.
#[derive(Debug, Default)]
pub(crate) struct Unused {
    looked_s: Option<f64>,
    told: [u64; KINDS],
}

const KINDS: usize = 15;

/// The counts with what they mean.
fn counts(s: &LiveStatistics) -> [(u64, &'static str); KINDS] {
    let (left, right, pairing) = (&s.left.counts, &s.right.counts, &s.pairing);
    [
        (s.too_far_apart, "pairs further apart than the limit"),
        (s.skipped_pairs, "pairs that the loop did not fetch in time"),
        (pairing.unpaired, "pictures without a partner near enough"),
        (pairing.doubled, "pictures that came twice"),
        (
            pairing.backwards,
            "pictures stamped before one that came earlier",
        ),
        (
            pairing.overflowed,
            "pictures that waited too long for a partner",
        ),
        (pairing.untimed, "pictures without a time"),
        (left.torn, "torn pictures of the left camera"),
        (right.torn, "torn pictures of the right camera"),
        (left.frozen, "frozen pictures of the left camera"),
        (right.frozen, "frozen pictures of the right camera"),
        (left.lost, "pictures that the left camera lost"),
        (right.lost, "pictures that the right camera lost"),
        (
            left.overrun,
            "pictures of the left camera that the loop did not fetch in time",
        ),
        (
            right.overrun,
            "pictures of the right camera that the loop did not fetch in time",
        ),
    ]
}

impl Unused {
    /// Whether it is time for a look.
    pub(crate) fn is_due(&mut self, now_s: f64) -> bool {
        let due = self.looked_s.is_none_or(|then_s| now_s - then_s >= EVERY_S);
        if due {
            self.looked_s = Some(now_s);
        }
        due
    }

    /// What was not used since the last look; `None` when everything was.
    pub(crate) fn sentence(&mut self, statistics: &LiveStatistics) -> Option<String> {
        let mut parts = Vec::new();
        for (told, (count, what)) in self.told.iter_mut().zip(counts(statistics)) {
            let new = count.saturating_sub(std::mem::replace(told, count));
            if new > 0 {
                parts.push(format!("{new} {what}"));
            }
        }
        (!parts.is_empty()).then(|| format!("not used: {}", parts.join(", ")))
    }
}

#[cfg(test)]
mod tests {
    use super::super::cameras::tests::nothing;
    use super::*;

    /// What is new is told once, with its number; nothing new is not told, and a look is due once a second.
    #[test]
    fn what_is_new_is_told_once() {
        let mut statistics = nothing();
        statistics.too_far_apart = 2;
        let mut unused = Unused::default();
        let told = unused.sentence(&statistics);
        assert_eq!(
            told.as_deref(),
            Some("not used: 2 pairs further apart than the limit")
        );
        assert_eq!(unused.sentence(&statistics), None);
        statistics.too_far_apart = 3;
        statistics.right.counts.torn = 4;
        let told = unused.sentence(&statistics);
        assert_eq!(
            told.as_deref(),
            Some(
                "not used: 1 pairs further apart than the limit, 4 torn pictures of the right camera"
            )
        );
        let due: Vec<bool> = [0.0, 0.5, 1.0, 1.9, 2.1].map(|s| unused.is_due(s)).into();
        assert_eq!(due, [true, false, true, false, true]);
    }
}
