//! Proves: whatever `ffmpeg` and `ffprobe` say and send is read without a panic and with bounds, and what they really say is understood. Whole videos are in
//! `tests/video.rs`.

use proptest::prelude::*;

use super::*;

/// Bytes as `ffmpeg` writes them, and damaged.
fn said() -> impl Strategy<Value = Vec<u8>> {
    let pieces = prop_oneof![
        Just(b"[Parsed_showinfo_0 @ 0x5559] [info] n:   1 pts:".to_vec()),
        Just(b"[Parsed_showinfo_0 @ 0x5559] [info] config in time_base: ".to_vec()),
        Just(b"[error] ".to_vec()),
        Just(b"1/1000, ".to_vec()),
        Just(b"\n".to_vec()),
        "-?[0-9/:. ]{0,24}".prop_map(String::into_bytes),
        proptest::collection::vec(any::<u8>(), 0..40),
    ];
    proptest::collection::vec(pieces, 0..40).prop_map(|all| all.concat())
}

/// The same for pictures: small sizes, so that some of them are whole.
fn drawn() -> impl Strategy<Value = Vec<u8>> {
    let pieces = prop_oneof![
        (1..5_usize, 1..5_usize, 0..3_usize).prop_map(|(w, h, lacks)| {
            let mut bytes = format!("P6\n{w} {h}\n255\n").into_bytes();
            bytes.extend(vec![7; 3 * w * h - lacks]);
            bytes
        }),
        "P6[ \n][0-9]{0,13} [0-9]{0,13}\n(255)?\n".prop_map(String::into_bytes),
        proptest::collection::vec(any::<u8>(), 0..40),
    ];
    proptest::collection::vec(pieces, 0..6).prop_map(|all| all.concat())
}

proptest! {
    /// Whatever stands on the standard error: no panic, times are numbers, complaints are short.
    #[test]
    fn any_words_are_heard(said in said()) {
        let (to, times) = sync_channel(TIMES_AHEAD);
        let words = Listener::Ffmpeg(to).last_complaint(&said[..], Path::new("x.mkv"));
        prop_assert!(words.chars().count() <= MAX_COMPLAINT);
        for time in &times {
            if let Some(s) = time.seconds((1_000_000, 1)) {
                prop_assert!(s.is_finite());
            }
        }
        let words = Listener::Plain.last_complaint(&said[..], Path::new("x.mkv"));
        prop_assert!(words.chars().count() <= MAX_COMPLAINT);
    }

    /// Whatever comes through the pipe: pictures of one size, and an end. What is promised and not there is no picture.
    #[test]
    fn any_bytes_are_read(drawn in drawn()) {
        let (mut pipe, mut size) = (&drawn[..], None);
        let mut taken = 0;
        while let Ok(Some(picture)) = picture_from_ppm(&mut pipe, &mut size, None) {
            prop_assert_eq!(Some(picture.size()), size);
            taken += 3 * picture.samples().len();
            prop_assert!(taken <= drawn.len());
        }
    }

    #[test]
    fn any_rates_are_read(text in "[0-9/]{0,20}") {
        if let Some((num, den)) = rate(&text) {
            prop_assert!(num > 0 && den > 0);
        }
    }

    /// Whatever `ffprobe` answers, whole, with some bytes changed, or cut short: a rate that a camera can have, or what is missing.
    #[test]
    fn any_answers_are_read(
        rates in ("[0-9]{0,6}/[0-9]{0,5}", "[0-9]{0,6}/[0-9]{0,5}"),
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<char>()), 0..4),
        cut in any::<prop::sample::Index>(),
        whole in any::<bool>(),
        other in any::<String>(),
    ) {
        let mut text: Vec<char> = answer(&rates.0, &rates.1).chars().collect();
        for (at, letter) in changes {
            let at = at.index(text.len());
            text[at] = letter;
        }
        if !whole {
            text.truncate(cut.index(text.len()));
        }
        for text in [text.into_iter().collect(), other] {
            match rate_in_answer(&text) {
                Ok(rate) => prop_assert!((0.0..=MAX_FPS).contains(&quotient(rate)) && rate.0 > 0),
                Err(what) => prop_assert!(["video", "frame rate"].contains(&what)),
            }
        }
    }
}

/// An answer as `ffprobe` gives it.
fn answer(base: &str, average: &str) -> String {
    format!(
        "{{\n \"programs\": [\n ],\n \"streams\": [\n  {{\n   \"r_frame_rate\": \"{base}\",\n   \"avg_frame_rate\": \"{average}\"\n  }}\n ]\n}}\n"
    )
}

/// Answers as `ffprobe` gives them are understood; one without a video or a rate is told from the other.
#[test]
fn answers_of_ffprobe() {
    assert_eq!(
        rate_in_answer(&answer("30000/1001", "29/1")),
        Ok((30_000, 1001))
    );
    assert_eq!(rate_in_answer(&answer("0/0", "25/1")), Ok((25, 1)));
    assert_eq!(rate_in_answer(&answer("0/0", "0/0")), Err("frame rate"));
    assert_eq!(rate_in_answer("{\"streams\": []}"), Err("video"));
    assert_eq!(rate_in_answer(""), Err("video"));
    // Deeper than any parser should follow by calling itself.
    assert_eq!(rate_in_answer(&"[".repeat(1 << 20)), Err("video"));
}

/// Lines as ffmpeg writes them: times are taken, the last error is kept without its mark, the rest is passed over.
#[test]
fn times_and_complaints_are_heard() {
    let said = "Input #0, matroska,webm, from 'file:[error] .mkv':\n\
        [Parsed_showinfo_0 @ 0x5559] [info] config in time_base: 1/1000, frame_rate: 30000/1001\n\
        [Parsed_showinfo_0 @ 0x5559] [info] n:   0 pts:      0 pts_time:0       pos:      587 fmt:bgr0\n\
        [Parsed_showinfo_0 @ 0x5559] [info] color_range:pc color_space:gbr\n\
        [matroska,webm @ 0x55e5] [error] File ended prematurely\n\
        [Parsed_showinfo_0 @ 0x5559] [info] n:   1 pts:     33 pts_time:0.033   pos:     1350 fmt:bgr0\n";
    let (to, times) = sync_channel(TIMES_AHEAD);
    let words = Listener::Ffmpeg(to).last_complaint(said.as_bytes(), Path::new("x.mkv"));
    assert_eq!(words, "[matroska,webm @ 0x55e5] File ended prematurely");
    let tick = (1, 1000);
    let told: Vec<FrameTime> = times.iter().collect();
    assert_eq!(told, [0, 33].map(|ticks| FrameTime { ticks, tick }));
    assert_eq!(complaint_in("Input #0, from '[error] .mkv':"), None);
    assert_eq!(
        complaint_in("[fatal] no such thing\n").as_deref(),
        Some("no such thing")
    );
    let words = Listener::Plain.last_complaint("one\ntwo\n\n".as_bytes(), Path::new("x.mkv"));
    assert_eq!(words, "two");
}

/// Times in coarse ticks stand on the even rate where they are within a tick of it, elsewhere they stay.
#[test]
fn even_rates_are_exact() {
    let tick = (1, 1000);
    let at = |ticks| FrameTime { ticks, tick }.seconds((30_000, 1001)).unwrap();
    assert_eq!(at(33), 1001.0 / 30_000.0);
    assert_eq!(at(67), 2.0 * 1001.0 / 30_000.0);
    assert_eq!(at(50), 0.05);
}

/// The nominal rate is the base rate; a base rate that is only a common divisor of uneven times is not one.
#[test]
fn nominal_rate() {
    assert_eq!(nominal(Some((30, 1)), Some((1169, 40))), Some((30, 1)));
    assert_eq!(nominal(Some((1000, 1)), Some((24, 1))), Some((24, 1)));
    assert_eq!(nominal(None, Some((25, 1))), Some((25, 1)));
    assert_eq!(nominal(None, None), None);
}
