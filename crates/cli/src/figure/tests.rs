//! Figures are whole XML, the same bytes every time, with every glyph in our typeface and no text outside the sheet's edge.

use super::axis::{Axis, fixed};
use super::lines::{Band, Level, Panel, Series, Stack, Stretch, Stroke};

fn stack() -> Stack {
    let wave = (0..100)
        .map(|i| (f64::from(i) * 0.1, (f64::from(i) * 0.1).sin()))
        .collect();
    let mut panel = Panel::new(
        Axis::linear("*p* / mm", -1.5, 1.5),
        vec![
            Series::new("a < b & c", wave),
            Series::new("gap", vec![(1.0, f64::NAN), (2.0, 0.5)]).stroke(Stroke::Points),
        ],
    );
    panel.bands.push(Band {
        label: "band".to_owned(),
        from: 0.5,
        to: 9.0,
        colour: super::colour::PALE,
    });
    panel.levels.push(Level {
        label: "level".to_owned(),
        at: 0.0,
    });
    let mut stack = Stack::new(
        "Title",
        "What it shows.",
        Axis::linear("time / s", 0.0, 10.0),
        vec![panel.clone(), panel],
    );
    stack.stretches.push(Stretch {
        label: "hidden".to_owned(),
        from: 3.0,
        to: 4.0,
    });
    stack.marks.push(Level {
        label: "here".to_owned(),
        at: 5.0,
    });
    stack
}

#[test]
fn same_data_give_the_same_bytes() {
    let (a, b) = (stack().draw(), stack().draw());
    assert_eq!(a.svg(), b.svg());
    assert_eq!(a.png().unwrap(), b.png().unwrap());
    assert!(a.svg().contains("a &lt; b &amp; c"));
    assert!(a.svg().contains("\u{2212}1"), "minus signs are typographic");
}

#[test]
fn png_is_twice_the_drawing_and_not_blank() {
    let png = stack().draw().png().unwrap();
    let (width, _) = (u32::from_be_bytes([png[16], png[17], png[18], png[19]]), 0);
    assert_eq!(width, 2 * 760);
    assert!(
        png.len() > 10_000,
        "{} bytes hold no plot with text",
        png.len()
    );
}

#[test]
fn ticks_are_round_and_inside() {
    for (min, max) in [
        (0.0, 10.0),
        (-0.3, 0.7),
        (1e-4, 3e-4),
        (-22.75, 22.75),
        (5.0, 5.0),
    ] {
        let axis = Axis::linear("", min, max);
        let ticks = axis.ticks(6);
        assert!((2..=14).contains(&ticks.len()), "{min} {max}: {ticks:?}");
        for (value, text) in &ticks {
            assert!(axis.share(*value) > -1e-6 && axis.share(*value) < 1.0 + 1e-6);
            let read: f64 = text.replace('\u{2212}', "-").parse().unwrap();
            assert!(
                (read - value).abs() < 1e-9 * (max - min).abs().max(1.0),
                "{text} for {value}"
            );
        }
    }
    let log: Vec<_> = Axis::log("", 1.0, 10.0)
        .ticks(9)
        .into_iter()
        .map(|t| t.0)
        .collect();
    assert_eq!(log.first(), Some(&1.0));
    assert_eq!(log.last(), Some(&10.0));
    assert_eq!(fixed(-0.001, 1), "0.0");
}

#[test]
fn typeface_has_the_signs_that_figures_use() {
    assert!(super::text::has_glyphs(
        "abcXYZ0189 −–°′″²³±×·βσηµ%/()[],.;:éö"
    ));
}

#[test]
fn markup_does_not_change_the_width_of_the_letters() {
    let plain = super::text::width("abc", 10.0, false);
    assert!(plain > 12.0 && plain < 24.0, "{plain}");
    assert!(super::text::width("a_{bc}", 10.0, false) < plain);
}

/// Captions break at spaces, but never between a number and its unit.
#[test]
fn no_break_spaces_do_not_break() {
    let text = "one two *t*\u{a0}=\u{a0}1000\u{a0}mm three";
    for width in [20.0, 40.0, 80.0, 120.0, 400.0] {
        let lines = super::lines::wrapped(text, width, 11.0);
        assert!(
            lines
                .iter()
                .any(|l| l.contains("*t*\u{a0}=\u{a0}1000\u{a0}mm")),
            "{width}: {lines:?}"
        );
        assert_eq!(lines.join(" "), text);
    }
    assert!(super::text::has_glyphs("\u{a0}"));
}
