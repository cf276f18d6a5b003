//! Gauges: a value on a line of three zones, good, look and bad.

use maud::{Markup, html};
use vergence_stereo::faults::Verdict;

/// Shares of the line at which good and look end.
const LOOK_AT: f64 = 40.0;
const BAD_AT: f64 = 70.0;

/// A gauge of a value that is good while small.
pub(super) struct Gauge<'a> {
    /// What is shown, for people who hear the page.
    pub(super) name: &'a str,
    /// The value, whose magnitude counts.
    pub(super) value: f64,
    /// Its standard deviation.
    pub(super) sigma: Option<f64>,
    /// Where good ends.
    pub(super) look: f64,
    /// Where bad begins.
    pub(super) bad: f64,
    /// The unit.
    pub(super) unit: &'a str,
    /// The verdict.
    pub(super) verdict: Verdict,
    /// What stands at the gauge's ends.
    pub(super) ends: [&'a str; 2],
}

impl Gauge<'_> {
    /// Where good and look end on the line; a yes or no has nothing between.
    fn zones(&self) -> [f64; 2] {
        match self.bad > self.look {
            true => [LOOK_AT, BAD_AT],
            false => [0.5 * (LOOK_AT + BAD_AT); 2],
        }
    }

    /// Where a magnitude lies on the line, 0 to 100: even within each zone, and bad ends at twice its beginning.
    fn place(&self, magnitude: f64) -> f64 {
        let [look_at, bad_at] = self.zones();
        let (look, bad) = (self.look.max(0.0), self.bad.max(self.look).max(1e-12));
        let place = if magnitude <= look {
            if look > 0.0 {
                look_at * magnitude / look
            } else {
                look_at
            }
        } else if magnitude <= bad {
            let span = bad - look;
            look_at
                + (bad_at - look_at)
                    * if span > 0.0 {
                        (magnitude - look) / span
                    } else {
                        1.0
                    }
        } else {
            bad_at + (100.0 - bad_at) * ((magnitude - bad) / bad).min(1.0)
        };
        place.clamp(0.0, 100.0)
    }

    /// The drawing with its limits as text below.
    pub(super) fn draw(&self) -> Markup {
        let [look_at, bad_at] = self.zones();
        // A long unit would run into the limits.
        let far = if self.ends[1].chars().count() > 6 {
            ""
        } else {
            self.ends[1]
        };
        let known = self.value.is_finite();
        let at = self.place(self.value.abs());
        let whisker = self.sigma.filter(|s| s.is_finite() && *s > 0.0).map(|s| {
            let from = self.place((self.value.abs() - s).max(0.0));
            [from, self.place(self.value.abs() + s)]
        });
        let label = format!(
            "{}: {} {}, {}; good up to {}, bad beyond {}",
            self.name,
            short(self.value),
            self.unit,
            word(self.verdict),
            short(self.look),
            short(self.bad)
        );
        html! {
            div.gauge {
                svg.gauge-bar viewBox="0 0 100 14" preserveAspectRatio="none" role="img" aria-label=(label) {
                    rect.zone-good x="0" y="3" width=(look_at) height="8" {}
                    rect.zone-look x=(look_at) y="3" width=(bad_at - look_at) height="8" {}
                    rect.zone-bad x=(bad_at) y="3" width=(100.0 - bad_at) height="8" {}
                    @if known {
                        @if let Some([from, to]) = whisker {
                            rect.whisker x=(fine(from)) y="6" width=(fine(to - from)) height="2" {}
                        }
                        rect.needle x=(fine((at - 0.9).clamp(0.0, 98.2))) y="0" width="1.8" height="14" {}
                    }
                }
                div.gauge-scale aria-hidden="true" {
                    span.gauge-end { (self.ends[0]) }
                    span.gauge-tick style=(format!("left:{look_at}%")) { (short(self.look)) }
                    @if bad_at > look_at { span.gauge-tick style=(format!("left:{bad_at}%")) { (short(self.bad)) } }
                    span.gauge-end.gauge-far { (far) }
                }
            }
        }
    }
}

/// Two decimals at most.
fn fine(value: f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A verdict as a word.
pub(super) fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Good => "good",
        Verdict::Look => "look",
        Verdict::Bad => "bad",
    }
}

/// A number with three significant digits, a true minus sign and no needless zeros.
pub(super) fn short(value: f64) -> String {
    if !value.is_finite() {
        return "unknown".to_owned();
    }
    let size = value.abs();
    let decimals = if size >= 100.0 || size == 0.0 {
        0
    } else {
        (2.0 - size.log10().floor()).clamp(0.0, 5.0) as usize
    };
    let text = format!("{value:.decimals$}");
    let text = match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.'),
        false => text.as_str(),
    };
    match text.strip_prefix('-') {
        Some("0") => "0".to_owned(),
        Some(digits) => format!("\u{2212}{digits}"),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gauge(look: f64, bad: f64) -> Gauge<'static> {
        Gauge {
            name: "x",
            value: 0.0,
            sigma: None,
            look,
            bad,
            unit: "px",
            verdict: Verdict::Good,
            ends: ["0", ""],
        }
    }

    #[test]
    fn values_fall_into_their_zones() {
        let g = gauge(1.0, 3.0);
        for (value, place) in [
            (0.0, 0.0),
            (1.0, 40.0),
            (2.0, 55.0),
            (3.0, 70.0),
            (4.5, 85.0),
            (99.0, 100.0),
        ] {
            assert!((g.place(value) - place).abs() < 1e-9, "{value}");
        }
        // A limit of nothing, and a yes or no.
        assert!(gauge(0.0, 0.0).place(1.0) > BAD_AT);
        let switch = gauge(0.5, 0.5);
        assert!(switch.place(0.5) <= switch.zones()[0] && switch.place(0.6) > switch.zones()[0]);
        assert!(gauge(f64::NAN, 1.0).place(0.5).is_finite());
    }

    #[test]
    fn numbers_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (-0.0, "0"),
            (1.5, "1.5"),
            (-0.04312, "\u{2212}0.0431"),
            (123.4, "123"),
            (1e-9, "0"),
            (f64::NAN, "unknown"),
        ] {
            assert_eq!(short(value), text, "{value}");
        }
    }
}
