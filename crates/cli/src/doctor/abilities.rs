//! What a video device can do, in words.

use vergence_capture::live::{Abilities, ControlOffer, FormatOffer, SizeOffer};

/// So many sizes of a format, and formats that are not read, are told; cameras list up to thirty.
const LISTED: usize = 12;

/// "sends YUYV, NV12 (640x480 at 30/15 Hz), MJPG (1280x720 at 30 Hz); not read: H264; can set exposure 3 to 2047 (now 250); can switch off automatic focus".
pub(crate) fn told(abilities: &Abilities) -> String {
    let formats = abilities.formats.iter();
    let (read, others): (Vec<_>, Vec<_>) = formats.partition(|f| f.is_read);
    let mut parts = vec![match read[..] {
        [] => "sends nothing that is read".to_owned(),
        _ => format!("sends {}", formats_text(&read)),
    }];
    if !others.is_empty() {
        let names = others.iter().map(|f| f.name.clone());
        parts.push(format!("not read: {}", listed(names)));
    }
    if !abilities.controls.is_empty() {
        let controls = abilities
            .controls
            .iter()
            .map(control_text)
            .collect::<Vec<_>>();
        parts.push(format!("can set {}", controls.join(", ")));
    }
    if !abilities.automatics.is_empty() {
        parts.push(format!(
            "can switch off {}",
            abilities.automatics.join(", ")
        ));
    }
    parts.join("; ")
}

/// The first of them, and how many more there are.
fn listed(all: impl ExactSizeIterator<Item = String>) -> String {
    let more = all.len().saturating_sub(LISTED);
    let first: Vec<String> = all.take(LISTED).collect();
    let first = first.join(", ");
    match more {
        0 => first,
        _ => format!("{first} and {more} more"),
    }
}

/// Formats in their order; those of the same sizes and rates stand together.
fn formats_text(formats: &[&FormatOffer]) -> String {
    let mut groups: Vec<(Vec<&str>, &[SizeOffer])> = Vec::new();
    for format in formats {
        match groups.iter_mut().find(|group| group.1 == format.sizes) {
            Some(group) => group.0.push(&format.name),
            None => groups.push((vec![&format.name], &format.sizes)),
        }
    }
    let text = |(names, sizes): &(Vec<&str>, &[SizeOffer])| match sizes {
        [] => names.join(", "),
        _ => format!(
            "{} ({})",
            names.join(", "),
            listed(sizes.iter().map(size_text))
        ),
    };
    groups.iter().map(text).collect::<Vec<_>>().join(", ")
}

fn size_text(offer: &SizeOffer) -> String {
    let mut text = format!("{}x{}", offer.size.0, offer.size.1);
    if let Some((width, height)) = offer.up_to {
        text += &format!(" to {width}x{height}");
    }
    let rates: Vec<String> = offer.fps.iter().map(|&fps| rate_text(fps)).collect();
    match rates[..] {
        [] => text,
        _ => format!("{text} at {} Hz", rates.join("/")),
    }
}

/// 30, 29.97, 7.5.
pub(crate) fn rate_text(fps: f64) -> String {
    let text = format!("{fps:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn control_text(control: &ControlOffer) -> String {
    let ControlOffer {
        name,
        least,
        most,
        step,
        now,
    } = control;
    match step {
        0 | 1 => format!("{name} {least} to {most} (now {now})"),
        _ => format!("{name} {least} to {most} in steps of {step} (now {now})"),
    }
}

#[cfg(test)]
mod tests {
    //! Proves: what a device offers is told whole, in one line, and long lists are cut and say so.
    use super::*;

    fn size(width: u32, fps: &[f64]) -> SizeOffer {
        SizeOffer {
            size: (width, 480),
            up_to: None,
            fps: fps.to_vec(),
        }
    }

    fn format(name: &str, sizes: Vec<SizeOffer>) -> FormatOffer {
        FormatOffer {
            name: name.to_owned(),
            is_read: name != "H264",
            sizes,
        }
    }

    #[test]
    fn all_of_it_in_one_line() {
        let mut abilities = Abilities {
            formats: vec![
                format("YUYV", vec![size(640, &[30.0, 29.97, 7.5]), size(800, &[])]),
                format("MJPG", Vec::new()),
                format("H264", vec![size(640, &[30.0])]),
            ],
            ..Abilities::default()
        };
        let sends = "sends YUYV (640x480 at 30/29.97/7.5 Hz, 800x480), MJPG; not read: H264";
        assert_eq!(told(&abilities), sends);
        let control = |name, step| ControlOffer {
            name,
            least: 3,
            most: 2047,
            step,
            now: 250,
        };
        abilities.controls = vec![control("exposure", 1), control("focus", 5)];
        abilities.automatics = vec!["automatic exposure", "automatic focus"];
        assert_eq!(
            told(&abilities),
            format!(
                "{sends}; can set exposure 3 to 2047 (now 250), focus 3 to 2047 in steps of 5 (now 250); can switch off automatic exposure, automatic focus"
            )
        );
        assert_eq!(told(&Abilities::default()), "sends nothing that is read");
    }

    #[test]
    fn ranges_and_long_lists() {
        let range = SizeOffer {
            up_to: Some((1920, 1080)),
            ..size(16, &[60.0])
        };
        assert_eq!(size_text(&range), "16x480 to 1920x1080 at 60 Hz");
        let sizes: Vec<SizeOffer> = (0..30).map(|k| size(100 + k, &[])).collect();
        let many = [format("GREY", sizes.clone()), format("NV12", sizes)];
        let text = formats_text(&many.iter().collect::<Vec<_>>());
        assert!(text.starts_with("GREY, NV12 (100x480, "), "{text}");
        assert!(text.ends_with("111x480 and 18 more)"), "{text}");
        let two = [
            format("YUYV", vec![size(640, &[30.0])]),
            format("MJPG", vec![size(640, &[60.0])]),
        ];
        let text = formats_text(&two.iter().collect::<Vec<_>>());
        assert_eq!(text, "YUYV (640x480 at 30 Hz), MJPG (640x480 at 60 Hz)");
    }
}
